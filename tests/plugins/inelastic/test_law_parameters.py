"""Constants of laws that are formulas of the parameters: histories, reduced models, files, derivatives."""

import dataclasses
import pickle
import subprocess
import sys
import warnings
from typing import Literal

import flowing
import numpy as np
import pellet_cladding_plastic as demo
import pytest
from bare import WAIT
from kept_values import put, rewrite_model
from marched import flat, marched_elsewhere
from needs import present
from test_plastic import bar, of_all_functions
from toy_law import Bingham
from tubes import POISSON, YOUNG

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.errors import ConvergenceError, ModelFileError, ParameterError, SceneError, SceneWarning
from hhr_dolfinx.plugins.inelastic.constants import formulas_of, law_at
from hhr_dolfinx.plugins.inelastic.history_gradient import history_gradient
from hhr_dolfinx.plugins.inelastic.project import training_tangents
from hhr_dolfinx.plugins.inelastic.update import Group, Material

TIGHT = hhr.MarchSettings("tangent", relative_stress=1e-10, floor_stress=1e-9, relative_force=1e-12, outside="ignore")
QUIET = hhr.MarchSettings(outside="ignore")
SPACE = hhr.ParameterSpace(
    ("P1", "h1", "gap", "sy", "K"), (0.0, 0.5, 4e-3, 60.0, 800.0), (460.0, 1.5, 16e-3, 100.0, 1200.0)
)
FORMULAS = hhr.Plasticity("sy", hardening=1e3), hhr.Norton("K", 4.0)
NUMBERS = hhr.Plasticity(80.0, 1e3), hhr.Norton(1e3, 4.0)


def pellet(laws, space=SPACE):
    """The small flowing scene with other laws."""
    base = demo.scene(**flowing.SMALL_MESH)
    bodies = tuple(dataclasses.replace(body, law=law) for body, law in zip(base.bodies, laws, strict=True))
    return dataclasses.replace(base, bodies=bodies, parameters=space)


def path(gap=10.0, yield_stress=80.0, resistance=1e3, steps=flowing.STEPS):
    return [(time, np.append(point, (yield_stress, resistance))) for time, point in demo.path(gap, steps)]


def same(one, other):
    return flat(one).tobytes() == flat(other).tobytes()


@pytest.fixture(scope="module")
def full():
    return hhr.FullOrderModel(pellet(FORMULAS))


@pytest.fixture(scope="module")
def corners(full):
    return [full.march(path(gap, yield_stress)) for gap in flowing.TRAINING for yield_stress in (62.0, 98.0)]


@pytest.fixture(scope="module")
def reduction(full, corners):
    return hhr.build(full, hhr.SnapshotSet.of_histories(corners), hhr.Recipe.flowing().as_it_is())


def test_formulas_of_constants_are_the_constants(full):
    """To the last bit, with and without a parameter."""
    alone = hhr.Plasticity("160 / 2", "1e3"), hhr.Norton("10 ** 3", "2 * 2")
    base = demo.scene(**flowing.SMALL_MESH).parameters
    one, other = (hhr.FullOrderModel(pellet(laws, base)).march(demo.path(8.0, 6)) for laws in (alone, NUMBERS))
    assert same(one, other)
    with warnings.catch_warnings():
        # no parameter is idle that a law names
        warnings.simplefilter("error")
        hhr.FullOrderModel(pellet(FORMULAS))
    with pytest.warns(SceneWarning, match=r"parameters \('sy', 'K'\) .* have no effect: .* law or shape names them"):
        numbers = hhr.FullOrderModel(pellet(NUMBERS))
    assert same(full.march(path()), numbers.march(path()))


def test_a_step_has_the_constants_of_its_end(full):
    """Only the last step is weaker: those before are those of the strong body, bit for bit."""
    strong, mixed = path(), [*path()[:-1], path(yield_stress=70.0)[-1]]
    one, other = full.march(strong).answers, full.march(mixed).answers
    assert all(np.array_equal(a.gauss.stress, b.gauss.stress) for a, b in zip(one[:-1], other[:-1], strict=True))
    assert other[-1].plastic_strain().max() > one[-1].plastic_strain().max() * 1.001


def warm_bar(law, **others):
    """The bar under uniaxial stress with a temperature."""
    base = bar(law)
    space = hhr.ParameterSpace(("pull", "T"), (-0.1, 20.0), (0.1, 600.0))
    return dataclasses.replace(base, parameters=space, **others)


def axial(history):
    """The stress along the bar, the same everywhere."""
    stresses = np.array([answer.stress()[:, 1] for answer in history.answers])
    assert np.ptp(stresses, axis=1).max() < 1e-6
    return stresses[:, 0]


def test_a_bar_follows_its_yield_stress():
    """Held at a strain and heated, the stress relaxes to the yield stress; cooled, it stays where it was."""
    temperatures = np.array([20.0, 20.0, 20.0, 300.0, 600.0, 310.0, 20.0])
    pulls = np.array([0.0, 0.002, 0.02, 0.02, 0.02, 0.02, 0.02])
    path = [(float(k), np.array(point)) for k, point in enumerate(zip(pulls, temperatures, strict=True))]
    full = hhr.FullOrderModel(warm_bar(hhr.Plasticity("table(T, 20, 1.0, 300, 0.9, 600, 0.5)")))
    expected = [YOUNG * 0.002, 1.0, 0.9, 0.5, 0.5, 0.5]
    assert axial(full.march(path, TIGHT)) == pytest.approx(expected, rel=1e-6)


@dataclasses.dataclass(frozen=True)
class Patient:
    """Perfect plasticity that gives up in long steps, in words of its own."""

    threshold: float | str
    longest: float
    name: str = "T"
    style: Literal["T"] = "T"
    rates: tuple[float, ...] = (1.0,)

    def flow(self, trial, plastic_strain, shear, dt):
        if dt > self.longest:
            raise ArithmeticError("too long")
        return hhr.Plasticity(self.threshold).flow(trial, plastic_strain, shear, dt)


def test_parts_of_a_step_have_constants_of_their_own():
    """A step that is cut is the same as its parts asked for one by one: the parameter is linear along it."""
    full = hhr.FullOrderModel(warm_bar(Patient("1 - (T / 1000) ** 2", 0.3)))
    coarse = [(float(k), np.array([0.02 * k, 20.0 + 290.0 * k])) for k in range(3)]
    fine = [(k / 4, np.array([0.005 * k, 20.0 + 72.5 * k])) for k in range(9)]
    history = full.march(coarse, TIGHT)
    assert history.cuts == 2
    assert axial(history) == pytest.approx(axial(full.march(fine, TIGHT))[3::4], rel=1e-9)
    assert axial(history) == pytest.approx([1 - 0.31**2, 1 - 0.6**2], rel=1e-6)
    with pytest.raises(ConvergenceError, match="step 1 of the history was solved in parts"):
        history_gradient(full.equilibrium, history)


def test_words_of_a_law_are_no_formulas():
    """Only what may be a float; the word T stays a word although a parameter has its name."""
    law = Patient("2 * T", 1.0)
    assert formulas_of(law) == {"threshold": "2 * T"}
    assert law_at(law, ("pull", "T"), np.array([0.0, 30.0])) == Patient(60.0, 1.0)
    assert law_at(law_at(law, ("T",), np.array([3.0])), (), np.zeros(0)) == Patient(6.0, 1.0)
    assert formulas_of(dataclasses.make_dataclass("Local", [("x", "Unknown")], frozen=True)("T")) == {}
    assert formulas_of(Patient) == formulas_of(None) == formulas_of("sy") == {}


def test_the_material_of_a_point_is_made_once():
    group = Group(np.arange(3), YOUNG, POISSON, hhr.Plasticity("sy"))
    material = Material([group], 4, ("sy",))
    one = material.at(np.array([2.0]))
    assert one is material.at(np.array([2.0])) and one.groups[0].law == hhr.Plasticity(2.0)
    assert material.at(np.array([3.0])).groups[0].law == hhr.Plasticity(3.0)
    assert one.at(np.array([3.0])) is one and one.elastic is material.elastic
    plain = Material([dataclasses.replace(group, law=hhr.Plasticity(1.0))], 4, ("sy",))
    assert plain.at(np.array([3.0])) is plain
    assert material.restricted(np.array([1])).at(np.array([2.0])).groups[0].law == hhr.Plasticity(2.0)


def test_laws_of_numbers_load_no_formulas():
    program = (
        "import sys, numpy as np\n"
        "from hhr_dolfinx.plugins.inelastic import laws, update\n"
        "group = update.Group(np.arange(2), 1.0, 0.3, laws.Plasticity(1.0))\n"
        "material = update.Material([group], 4, ('p',)).at(np.zeros(1))\n"
        "material.update(np.zeros((2, 4)), material.at_rest(), 1.0, tangent=True)\n"
        "assert 'hhr_dolfinx.formulas' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=WAIT)


# reduced models


def test_the_whole_basis_gives_the_full_history(full):
    """All functions on all cells, with constants that change along the path: to the tolerance of the solver."""
    weaker = [(time, point - [0, 0, 0, 10.0 * time, 100.0 * time]) for time, point in path()]
    exact = full.march(weaker, TIGHT)
    reduced = of_all_functions(full, exact)
    for there, here in zip(exact.answers, reduced.march(weaker, TIGHT).answers, strict=True):
        assert here.displacement() == pytest.approx(there.displacement(), abs=1e-8 * np.abs(there.unknown).max())
        assert here.plastic_strain() == pytest.approx(there.plastic_strain(), abs=1e-9)


def test_a_model_of_four_histories_knows_what_lies_between(full, reduction):
    asked = path(8.0, 77.0)
    histories = [model.march(asked, QUIET) for model in (reduction, full)]
    here, there = (history.answers[-1] for history in histories)
    assert relative_error(here.displacement(), there.displacement()) < 0.02
    assert relative_error(here.stress().ravel(), there.stress().ravel()) < 0.03
    if present("studies"):
        from hhr_dolfinx.plugins.inelastic.study import seconds_of_parts

        assert seconds_of_parts(reduction, histories[0])["laws"] > 0


def test_training_tangents_have_the_constants_of_their_history(full, corners):
    """Those with numbers in the place of the formulas."""
    states = training_tangents(full.equilibrium, hhr.SnapshotSet.of_histories(corners[:2]), 1)
    for history, (tangents, _) in zip(corners[:2], states, strict=True):
        law = hhr.Plasticity(history.answers[-1].parameter[3], 1e3), NUMBERS[1]
        groups = [dataclasses.replace(group, law=law[k]) for k, group in enumerate(full.equilibrium.material.groups)]
        last, before = history.answers[-1], history.answers[-2]
        strain = full.equilibrium.strain(last.unknown, full.equilibrium.amplitudes(last.parameter))
        step = last.time - before.time
        again = Material(groups, 4).update(strain, before.gauss.state, step, tangent=True)
        assert np.array_equal(again.tangents, tangents) and np.array_equal(again.stress, last.gauss.stress)


def test_a_model_file_keeps_formulas(reduction, tmp_path):
    """Read again, and in a process without DOLFINx: to the last bit."""
    hhr.save_model(tmp_path / "model.npz", reduction)
    stored = hhr.load_model(tmp_path / "model.npz")
    assert [group.law for group in stored.flow.material.groups] == list(FORMULAS)
    asked = path(9.0, 71.0, 950.0)
    assert same(stored.march(asked, QUIET), reduction.march(asked, QUIET))
    assert same(pickle.loads(pickle.dumps(reduction)).march(asked, QUIET), reduction.march(asked, QUIET))
    found = marched_elsewhere(tmp_path / "model.npz", path(9.0, 71.0), tmp_path)
    assert found.tobytes() == flat(reduction.march(path(9.0, 71.0), QUIET)).tobytes()


@pytest.mark.parametrize(
    ("text", "why"),
    [("sy +", "cannot be read"), ("sz", "names"), ("sy - 60", "refuses"), ("__import__('os')", "unknown|known")],
)
def test_a_file_with_another_formula_is_refused(reduction, tmp_path, text, why):
    file = tmp_path / "model.npz"
    hhr.save_model(file, reduction)
    rewrite_model(file, put("flow.material.groups.0.law.yield_stress", text))
    with pytest.raises(ModelFileError, match=rf"{why}.*build the model again"):
        hhr.load_model(file)


@dataclasses.dataclass(frozen=True)
class Undeclared:
    """A law that says nothing of formulas, and takes them all the same."""

    threshold: float

    def flow(self, trial, plastic_strain, shear, dt):
        return hhr.Plasticity(self.threshold).flow(trial, plastic_strain, shear, dt)


def test_a_law_of_a_users_own_takes_formulas(reduction, full, tmp_path):
    one, other = (pellet((law, NUMBERS[1])) for law in (Undeclared("sy"), hhr.Plasticity("sy")))
    with pytest.warns(SceneWarning, match=r"parameters \('K',\)"):
        one, other = hhr.FullOrderModel(one), hhr.FullOrderModel(other)
    assert same(one.march(path()), other.march(path()))
    flow = dataclasses.replace(reduction.flow, material=one.equilibrium.material.restricted(reduction.flow.points))
    with pytest.raises(ModelFileError, match=r"threshold of Undeclared is 'sy', .*declare it float \| str"):
        hhr.save_model(tmp_path / "model.npz", reduction.changed(flow=flow))


def test_a_store_tells_formulas_apart(full, tmp_path):
    """What was solved is found again, and not by another formula, class or parameter."""

    def found(model, yield_stress=80.0):
        return len(hhr.SnapshotStore(tmp_path, model).steps(path(yield_stress=yield_stress), TIGHT).load())

    kept = hhr.SnapshotStore(tmp_path, full).steps(path(), TIGHT)
    full.march(path(), TIGHT, keep=kept.save)
    assert found(hhr.FullOrderModel(pellet(FORMULAS))) == flowing.STEPS
    wider = dataclasses.replace(SPACE, upper=(*SPACE.upper[:3], 110.0, 1300.0))
    assert found(hhr.FullOrderModel(pellet(FORMULAS, wider))) == flowing.STEPS
    for law in (hhr.Plasticity("sy + 0", 1e3), hhr.Plasticity("sy", "1e3"), hhr.Plasticity("sy", 1001.0)):
        assert found(hhr.FullOrderModel(pellet((law, FORMULAS[1])))) == 0
    assert found(full, 81.0) == 0


# what cannot be


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (hhr.Plasticity("sx"), r"names \['sx'\], and the parameters are \('pull', 'T'\): correct the formula"),
        (
            hhr.Plasticity("1 - T / 500"),
            r"Plasticity refuses yield_stress = 1 - T / 500 = -.* at pull = .*narrow the box",
        ),
        (hhr.Plasticity(1.0, "T - 21"), r"refuses hardening = T - 21 = -1 at .*T = 20.*narrow the box"),
        (hhr.Norton(1.0, "20 / T"), r"Norton refuses exponent = .*narrow the box"),
        (hhr.Plasticity("table(T, 20, 1, 500, 2)"), r"outside the table from 20 to 500.*further points, or narrow"),
        (Undeclared("log(T - 100)"), r"threshold = log\(T - 100\) of Undeclared is nan at .*: change the formula"),
        (hhr.Plasticity("(-8) ** 0.5"), r"yield_stress = .* of Plasticity is nan at .*: change the formula"),
        (Undeclared("T +"), r"threshold of Undeclared: the formula 'T \+' cannot be read"),
    ],
)
def test_laws_that_are_impossible_somewhere_name_their_body(law, message):
    with pytest.raises(SceneError, match=rf"body \d+ of scene 'bar': .*{message}"):
        hhr.FullOrderModel(warm_bar(law))


@pytest.mark.parametrize("law", [
    lambda: hhr.Plasticity("2 +"), lambda: hhr.Plasticity(1.0, "open('x')"), lambda: hhr.Norton("", 2.0),
    lambda: hhr.Plasticity("sy", -1.0), lambda: hhr.Norton("K", 0.5), lambda: hhr.Norton("K", None),
])  # fmt: skip
def test_what_is_no_formula_is_refused_where_it_is_written(law):
    with pytest.raises(SceneError, match=r"of (Plasticity|Norton): .*formula|must be positive"):
        law()


def test_a_formula_has_no_flow_of_its_own():
    material = Material([Group(np.arange(1), YOUNG, POISSON, hhr.Norton("K", 2.0))], 4, ("K",))
    with pytest.raises(SceneError, match=r"'K' is a formula of the parameters: law_at\(law, names, point\)"):
        material.update(np.ones((1, 4)), material.at_rest(), 1.0, tangent=False)


def test_a_law_that_refuses_texts_says_so():
    """A law of a user's own that looks at its numbers must let texts pass."""
    with pytest.raises(TypeError, match="str"):
        Bingham("sy", 1.0)


# derivatives


def difference(model, history, direction, h):
    """Central differences of whole histories along a direction of the path, (steps + 1, P)."""

    def marched(sign):
        pairs = zip(history.path, direction, strict=True)
        return model.march([(time, point + sign * h * change) for (time, point), change in pairs], TIGHT).answers

    return [
        ((one.unknown - other.unknown) / (2 * h), (one.multipliers - other.multipliers) / (2 * h))
        for one, other in zip(marched(1), marched(-1), strict=True)
    ]


def check_gradients(model, history, gradients, directions, steps, accuracy=1e-6):
    """At every step, to a part of the largest derivative along the history."""
    for k, h in enumerate(steps):
        found = difference(model, history, directions[:, :, k], h)
        for part in (0, 1):
            size = max(np.linalg.norm(pair[part]) for pair in found)
            assert size > 0
            for pair, gradient in zip(found, gradients, strict=True):
                assert np.linalg.norm(gradient[part][:, k] - pair[part]) < accuracy * size


@pytest.mark.parametrize("which", ["full", "reduced"])
def test_derivatives_are_those_of_whole_histories(full, reduction, which):
    """Gap, yield stress and resistance, and a pressure that grows along the path: measured 1e-8."""
    model = full if which == "full" else reduction
    history = model.march(path(10.0, 80.0, 1e3), TIGHT)
    gradients = history_gradient(model.equilibrium, history)
    asked = model.march(history.path, dataclasses.replace(TIGHT, gradient=True)).answers[-1].gradient
    assert np.array_equal(asked.unknown, gradients[-1].unknown) and not asked.one_sided
    assert gradients[0].unknown.shape == (model.equilibrium.size, 5)
    assert gradients[0].multipliers.shape == (model.equilibrium.conditions, 5)
    shifts = np.broadcast_to(np.eye(5), (len(history.path), 5, 5))
    check_gradients(model, history, [type(g)(*(part[:, 2:] for part in g)) for g in gradients], shifts[:, :, 2:],
                    (1e-7, 1e-3, 1e-2))  # fmt: skip
    times = np.array([time for time, _ in history.path])
    along = np.zeros((len(times), 5, 1))
    along[:, 0, 0], along[:, 3, 0] = -times, 0.1 * times**2
    check_gradients(model, history, history_gradient(model.equilibrium, history, along), along, (1e-2,))


def test_derivatives_at_the_end_of_a_table():
    """One step beyond, there is no law: differences are taken to the inside."""
    model = hhr.FullOrderModel(warm_bar(hhr.Plasticity("table(T, 20, 1.0, 600, 0.5) + 0 * pull", 5.0))).equilibrium
    for temperature, inside in ((20.0, 1.0), (600.0, -1.0)):
        ends = []
        for h in (0.0, 0.1, 0.2):
            path = [(float(k), np.array([0.01 * k, temperature + inside * h])) for k in range(3)]
            ends.append(model.fields.march(path, TIGHT))
        start, near, far = (history.answers[-1].unknown for history in ends)
        slope = history_gradient(model, ends[0])[-1].unknown[:, 1]
        expected = inside * (4 * near - far - 3 * start) / 0.2
        assert np.abs(slope).max() > 0
        assert slope == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("directions", [np.zeros((3, 5, 1)), np.zeros((7, 5)), np.full((7, 5, 1), np.nan)])
def test_directions_that_are_none(full, directions):
    history = full.march(path())
    with pytest.raises(ParameterError, match=r"must be finite and of the shape \(7, 5, K\)"):
        history_gradient(full.equilibrium, history, directions)
