"""What ranks do with bodies and contacts of plug-ins: the same on 1, 2 and 3."""

import pytest
from needs import needs, present
from numbers_of_ranks import assert_same, numbers_of_ranks

OF_PLUGINS = {
    "moduli": """
# what is made of a training on one full model of all ranks
together = hhr.train(scale.scene((5, 3), (4, 2)), hhr.Sobol(6), held_out=0, together=True)
note("trained", together.condense().solve(together.full_order.parameters.random(1, 5)[0]))
""",
    "inelastic mortar": """
import flowing as pellets
import indentation
import pellet_cladding_plastic as pellet
from hhr_dolfinx.forms import laws as forms
@dataclasses.dataclass(frozen=True)
class Brittle(hhr.Law):
    "Elasticity that breaks off where stresses are large."
    most: float
    def statement(self, at):
        stress = forms.hooke(at.strain, at.constants)
        limit = at.constants.most - forms.equivalent(forms.deviator(stress))
        return forms.Stated(stress, limit=limit, reason="it breaks")

# bodies that flow: ranks share the factors; a history goes on behind what one of them has kept
flowing = hhr.FullOrderModel(indentation.scene(6))
low, high = np.array([flowing.parameters.lower, flowing.parameters.upper])
path = [(float(k), low + share * (high - low)) for k, share in enumerate((0.0, 0.5, 1.0))]
path = [(time, np.append(point[:1], (low + high)[1:] / 2)) for time, point in path]
for search in ("elastic", "tangent"):
    history = flowing.march(path, hhr.MarchSettings(search=search))
    out[f"flowed {{search}}"] = history.answers[-1].forces().tolist()
    out[f"plastic {{search}}"] = float(np.linalg.norm(history.answers[-1].plastic_strain()))
shared = hhr.SnapshotStore(f"{folder}/shared {{comm.size}}", flowing)
for steps in (2, 3):
    kept_steps = hhr.compute_snapshots(flowing, [path[:steps]], store=shared)
out["goes on"] = kept_steps.histories[0].answers[-1].forces().tolist()
out["steps found"] = comm.bcast(shared.found)
# creep beside plasticity, in parts of steps too, and a modulus that is a parameter: each rank has
# some of the points
creeping = pellets.flowing_full()
asked = {{"creeps": {{"time_error": True}}, "creeps in parts": {{"time_tolerance": 0.02}}}}
for name, settings in asked.items():
    history = creeping.march(pellet.path(5.0, 4), hhr.MarchSettings(**settings))
    last = history.answers[-1]
    fields = last.forces(), last.stress(), last.plastic_strain()
    out[name] = [float(np.linalg.norm(item)) for item in fields]
    parts = [answer.parts for answer in history.answers]
    out[name + ", errors"] = [*history.time_error.tolist(), *parts]
    out[name + ", points"] = list(last.stress().shape)
softer = hhr.FullOrderModel(indentation.scene(6, young="E"))
ends = np.array([softer.parameters.lower, softer.parameters.upper])
rest = ends.mean(axis=0)[1:] * 1.1
away = [(float(k), np.append(share * ends[1, :1], rest)) for k, share in enumerate((0.0, 1.0))]
out["softer"] = softer.march(away).answers[-1].forces().tolist()
# a law that breaks off on a rank
plain = indentation.scene(6)
bodies = plain.bodies[0], dataclasses.replace(plain.bodies[1], law=Brittle(100.0))
broken = hhr.FullOrderModel(dataclasses.replace(plain, bodies=bodies))
out["brittle"] = comm.allgather(said(lambda: broken.march(path)))
""",
    "friction": """
import fretting
points = (0.0, 0.0, 0.3), (0.004, 0.0, 0.3), (0.004, 0.0013, 0.3), (0.004, -0.001, 0.3)
for answer in hhr.FullOrderModel(fretting.scene(24)).march(list(enumerate(points))).answers:
    out[f"rubbed {{answer.time}}"] = answer.forces().tolist()
    out[f"slipped {{answer.time}}"] = answer.slip.path.tolist()
""",
}


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    parts = (part for plugins, part in OF_PLUGINS.items() if present(*plugins.split()))
    return numbers_of_ranks(tmp_path_factory.mktemp("snapshots"), *parts)


@needs("nonmatching")
@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_do_not_change_the_answer(found, ranks):
    assert_same(found[1], found[ranks], ["brittle"])


@needs("inelastic", "mortar")
@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_a_law_that_fails_on_one_rank_fails_on_all(found, ranks):
    brittle = found[ranks]["brittle"]
    assert len(brittle) == ranks
    for text in brittle:
        assert (
            text.startswith("ConvergenceError: step 1 to t = 1 s")
            and "Brittle has no answer at" in text
        )
        assert "it breaks" in text
