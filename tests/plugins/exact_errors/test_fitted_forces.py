"""Hyper-reduced contacts with laws of several plug-ins, or of one of an outsider: forces and
memories everywhere.
"""

import my_contact_law
import numpy as np
import pytest
import toy_increments
from mpi4py import MPI
from my_contact_law import Wear
from my_gasket import Gasket, Gaskets
from needs import needs
from stacked_pairs import stacked, with_plugins

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, ReductionError
from hhr_dolfinx.memory import NO_MEMORY
from hhr_dolfinx.plugins.contact_laws.reduction import completed
from hhr_dolfinx.registry import Plugin

pytestmark = needs("exact_errors", "friction")
KNOWN = [Gaskets, my_contact_law.Wearing]
RATE = 0.05


@pytest.fixture(autouse=True)
def plugins(monkeypatch):
    with_plugins(monkeypatch)


def laws_of(name):
    """Laws of the pair of blocks, of the floor and of the wall."""
    rubs = hhr.Coulomb("mu")
    return {
        "three": (rubs, Gasket("k", 50.0), Wear(RATE)),
        "soft": (rubs, Gasket(1e-3, 1e-2), Wear(RATE)),
        "wear": (Wear(RATE),),
        "gasket": (Gasket("k", 50.0),),
    }[name]


def space_of(name):
    """Loads, and the constants that the laws name."""
    count = {"wear": 2, "gasket": 3, "soft": 3}.get(name, 4)
    names = ("push", "slide", "k", "mu") if name == "gasket" else ("push", "slide", "mu", "k")
    of = {"push": (0.0, 0.3), "slide": (-0.2, 0.2), "mu": (0.1, 0.6), "k": (0.5, 5.0)}
    return hhr.ParameterSpace(names[:count], *zip(*(of[one] for one in names[:count]), strict=True))


def paths(space, count, seed, steps=9):
    """Through random points; constants of laws stay along each, and it begins at rest."""
    random = np.random.default_rng(seed)
    low, high = np.array([0.0, -0.04]), np.array([0.06, 0.04])
    fine = np.linspace(0.0, 4.0, steps)
    found = []
    for _ in range(count):
        points = low + random.random((5, 2)) * (high - low)
        points[0] = 0.0
        moved = np.array([np.interp(fine, np.arange(5), column) for column in points.T]).T
        rest = (
            space.lower[2:]
            + random.random(len(space.names) - 2) * np.subtract(space.upper, space.lower)[2:]
        )
        found.append(
            [(float(time), np.append(point, rest)) for time, point in zip(fine, moved, strict=True)]
        )
    return found


def scene_of(name, **changes):
    return stacked(*laws_of(name), **{"parameters": space_of(name)} | changes)


def full_of(name, **changes):
    return hhr.FullOrderModel(scene_of(name, **changes), MPI.COMM_SELF)


def trained(name, count=8, recipe=None, **changes):
    """A full model and a hyper-reduced one, by the default recipe without another one."""
    scene = scene_of(name, **changes)
    training = hhr.train(
        scene,
        paths(scene.parameters, count, 1),
        held_out=paths(scene.parameters, 2, 2),
        comm=MPI.COMM_SELF,
    )
    return training.full_order, training.build(recipe)


def arrays(law, answer):
    return {"forces": answer.forces(), **law.stored(answer.memory)}


@pytest.mark.parametrize(
    ("name", "tolerance"), [("three", 1e-20), ("wear", 1e-20), ("gasket", 1e-16)]
)
def test_on_the_whole_mesh_it_is_the_full_order(name, tolerance):
    """On its own training, which its modes hold up to the root of the tolerance: forces, fields and
    all memories.
    """
    full = full_of(name)
    known = [full.march(path) for path in paths(full.parameters, 2, 7)]
    everywhere = hhr.Zone(lambda problem: np.arange(len(problem.points)))
    recipe = hhr.Recipe.of_paths(
        basis=hhr.Pod(tolerance), nodes=(everywhere,), enrichment=hhr.Enrich(1.0)
    )
    model = hhr.build(full, hhr.SnapshotSet.of_histories(known), recipe.as_it_is())
    assert model.own_conditions == full.conditions and model.law.plugins == full.law.plugins
    for history in known:
        for one, other in zip(history.answers, model.march(history.path).answers, strict=True):
            np.testing.assert_allclose(other.displacement(), one.displacement(), atol=1e-9)
            for (key, value), found in zip(
                arrays(full.law, one).items(), arrays(full.law, other).values(), strict=True
            ):
                np.testing.assert_allclose(found, value, atol=1e-8, err_msg=key)


def check_unseen(name, cells, count, most, recipe=None):
    """Largest errors of forces and of memories on paths that were not trained, each over its
    largest value.
    """
    full, model = trained(name, count, recipe, cells=cells)
    assert 0 < model.own_conditions < full.conditions
    pairs = [(full.march(path), model.march(path)) for path in paths(full.parameters, 4, 3)]
    kept = [
        [arrays(full.law, answer) for answer in history.answers]
        for pair in pairs
        for history in pair
    ]
    for key in kept[0][0]:
        if key == "statuses":
            continue
        one, other = (
            np.array([[values[key] for values in history] for history in kept[k::2]])
            for k in (0, 1)
        )
        off = np.linalg.norm(other - one, axis=-1).max() / np.linalg.norm(one, axis=-1).max()
        assert off < most, key
    return full, model, pairs


@pytest.mark.parametrize("name", ["wear", "gasket"])
def test_unseen_paths_of_one_law(name):
    """An outsider's law alone, with memory and without.

    Forces outside the RID too, 9e-4 and 1e-4 measured.
    """
    check_unseen(name, 4, 6, 0.01)


def few():
    """A recipe of a smaller RID."""
    nodes = hhr.Deim(), hhr.ForceDeim(1e-2), hhr.LoadNodes()
    return hhr.Recipe.of_paths(basis=hhr.Pod(1e-8), nodes=nodes, domain=hhr.Rid(1, 1))


def test_unseen_paths_of_three_laws():
    """Friction, a gasket and wear, with forces limited outside the RID; 8e-3 measured."""
    full, model, pairs = check_unseen("three", 8, 8, 0.02, few())
    outside = ~np.isin(np.arange(full.conditions), model.fields.A_lambda)
    friction = full.law.of("friction")
    for answer in (answer for _, history in pairs for answer in history.answers):
        forces = answer.forces()
        np.testing.assert_array_equal(forces[~outside], answer.multipliers)
        assert (forces[full.law.pressing(full.conditions)] >= -1e-12 * forces.max()).all()
        bound = answer.parameter[2] * forces[friction.normal]
        assert (friction.lengths(forces[friction.tangential]) <= bound + 1e-9 * forces.max()).all()


def test_unseen_paths_of_three_laws_by_the_default_recipe():
    """On a finer mesh, where its RID does not hold all contacts; 2e-3 measured."""
    check_unseen("three", 16, 8, 0.01)


def check_file(model, history, folder):
    """A file answers as the model to round-off, since it has other factors, and as the file of that
    one exactly.
    """
    first, second = folder / "first.npz", folder / "second.npz"
    hhr.save_model(first, model)
    kept = hhr.load_model(first, known=KNOWN)
    hhr.save_model(second, kept)
    again = hhr.load_model(second, known=KNOWN)
    ends = [history.answers, *(one.march(history.path).answers for one in (kept, again))]
    for here, there, third in zip(*ends, strict=True):
        for key, value in arrays(model.fields.interface.whole, there).items():
            own = arrays(model.fields.interface.whole, here)[key]
            assert np.abs(value - own).max(initial=0.0) <= 1e-9 * max(
                np.abs(own).max(initial=0.0), 1e-3
            )
            np.testing.assert_array_equal(value, arrays(model.fields.interface.whole, third)[key])
        np.testing.assert_array_equal(there.displacement(), third.displacement())
        assert there.estimate() == third.estimate()


@pytest.fixture(scope="module")
def small():
    """Three laws on a coarse mesh."""
    with pytest.MonkeyPatch.context() as patch:
        with_plugins(patch)
        return trained("three", 6, few(), cells=8)


def test_a_file_of_one_law(tmp_path):
    _, model = trained("wear", 3)
    check_file(model, model.march(paths(model.parameters, 1, 5)[0][:5]), tmp_path)


def test_files(small, tmp_path):
    _, model = small
    check_file(model, model.march(paths(model.parameters, 1, 5)[0]), tmp_path)


def test_gradients_are_those_of_differences(small):
    """Of all forces along the path, constants of laws among the parameters."""
    _, model = small
    path = [
        (time, point + np.array([1e-3, 0.0, 0.0, 0.0]))
        for time, point in paths(model.parameters, 1, 11)[0][:6]
    ]  # within the box
    answer = model.march(path, hhr.MarchSettings(gradient=True, cuts=0)).answers[-1]
    assert not answer.gradient.one_sided
    found = model.fields._all_force_changes(answer, np.zeros((0, 4)))
    for number, step in enumerate(1e-6 * np.array([0.3, 0.1, 0.3, 1.0])):
        shift = step * np.eye(4)[number]
        ends = []
        for sign in (1.0, -1.0):
            moved = [(time, point + sign * shift) for time, point in path]
            ends.append(
                model.march(moved, hhr.MarchSettings(outside="ignore", cuts=0)).answers[-1].forces()
            )
        expected = (ends[0] - ends[1]) / (2.0 * step)
        assert np.abs(found[:, number] - expected).max() <= 1e-4 * np.abs(found).max()


def test_laws_limit_what_is_fitted(small):
    """By hand: a pressure below 0 is none, and a tangential force goes down to its bound.

    In each range by its own.
    """
    full, model = small
    fields = model.fields.interface
    friction, point = full.law.of("friction"), np.array([0.05, 0.0, 0.3, 1.0])
    forces = np.zeros(full.conditions)
    forces[friction.normal] = 2.0
    forces[friction.tangential] = -1.0
    changes = np.random.default_rng(0).standard_normal((full.conditions, 4))
    part = next(part for part in full.law.ranges if part.law.plugin == "friction")
    own = part.law
    fitted = np.ones(part.rows.size, dtype=bool)
    found, slopes, active = own.limited(forces[part.rows], changes[part.rows], fitted, point)
    np.testing.assert_allclose(found[own.tangential], -0.6)
    # bound μ p: -(μ' p + μ p') of the limited force
    expected = -(np.array([0.0, 0.0, 2.0, 0.0]) + 0.3 * changes[part.rows][own.normal])
    np.testing.assert_allclose(slopes[own.tangential], expected[own.owner], atol=1e-12)
    assert active[own.normal].all() and not active[own.tangential].any()
    kept, _, _ = own.limited(forces[part.rows], changes[part.rows], ~fitted, point)
    np.testing.assert_array_equal(kept, forces[part.rows])
    assert fields.whole.plugins == full.law.plugins


def test_weak_laws_are_not_taken_for_open():
    """A gasket whose forces are 1e-4 of the others: over their own largest, outside the RID.

    2e-2 measured.
    """
    full, model = trained("soft", 6, few(), cells=8)
    rows = next(part.rows for part in full.law.ranges if part.law.plugin == "my_gasket")
    assert not np.isin(rows, model.fields.A_lambda).all()
    for path in paths(full.parameters, 2, 3):
        pairs = [
            [answer.forces()[rows] for answer in one.march(path).answers] for one in (full, model)
        ]
        assert np.abs(np.subtract(*pairs)).max() <= 0.05 * np.abs(pairs[0]).max()


def test_what_closes_outside_without_forces_inside_is_unknown(small):
    """Overlap of a gasket is its closure; a worn depth is none.

    Nothing else shows contact that has left the RID.
    """
    full, model = small
    indicator, scale = model.fields.interface, model.fields.gap_scale
    outside = np.setdiff1d(np.arange(full.conditions), model.fields.A_lambda)
    nothing = np.zeros(model.own_conditions)
    memory = full.march(paths(full.parameters, 1, 3)[0][:2]).answers[-1].memory
    slack = 1.0 * scale
    assert indicator.indicated(nothing, slack, scale, memory) == 0.0
    pressing = outside[full.law.pressing(full.conditions)[outside]]
    slack[pressing[0]] = -0.1 * scale[pressing[0]]
    assert np.isinf(indicator.indicated(nothing, slack, scale, memory))


def test_worn_depths_are_no_overlap():
    full, model = trained("soft", 3, cells=8)
    indicator, scale = model.fields.interface, model.fields.gap_scale
    (wearing,) = (part.rows for part in full.law.ranges if part.law.plugin == "my_contact_law")
    row = np.setdiff1d(wearing, model.fields.A_lambda)[0]
    slack = 1.0 * scale
    slack[row] = -0.5 * scale[row]
    worn = np.zeros(wearing.size)
    assert indicator.overlap(slack, scale, NO_MEMORY | {"worn": worn}) == pytest.approx(0.5)
    worn[wearing == row] = 0.5 * scale[row]
    assert indicator.overlap(slack, scale, NO_MEMORY | {"worn": worn}) == pytest.approx(
        0.0, abs=1e-12
    )


def test_what_is_not_solved_by_ranges_is_refused(monkeypatch):
    """A law with increments of its own alone: nothing completes its memory outside the RID."""
    with_plugins(monkeypatch, toy_increments.PLUGIN)
    full = full_of("wear")
    known = hhr.SnapshotSet.of_histories([full.march(paths(full.parameters, 1, 1)[0])])
    with pytest.raises(
        NotOfferedError,
        match=r"wear next to .*, or hyper-reduced, is not built in.* no facet 'range'",
    ):
        hhr.build(full, known)


def test_without_what_completes_forces_it_is_refused(monkeypatch):
    full = full_of("gasket")
    known = hhr.SnapshotSet.of_histories([full.march(paths(full.parameters, 1, 1)[0])])
    with_plugins(monkeypatch, Plugin(name="exact_errors"))
    with pytest.raises(
        NotOfferedError, match="hyper-reduction of contacts with a gasket needs a plug-in"
    ):
        hhr.build(full, known)


@needs("inelastic")
def test_inelastic_bodies_are_refused():
    """Full models answer them."""
    bodies = hhr.Body(1, 2.0, 0.3), hhr.Body(2, 5.0, 0.3, hhr.Plasticity(0.1, 1.0))
    with pytest.raises(
        NotOfferedError,
        match="and of inelastic bodies, is not built in: a step starts from the memory",
    ):
        completed(full_of("three", bodies=bodies))


@needs("fallback")
def test_a_safe_model_falls_back_and_knows_its_scene(small):
    """Another constant of a law, and another modulus, are other scenes."""
    full, model = small
    safe = hhr.FallbackModel(model, full, 0.02, of="forces")
    path = paths(model.parameters, 1, 5)[0]
    for one, other in zip(full.march(path).answers, safe.march(path).answers, strict=True):
        assert (
            np.linalg.norm(one.forces() - other.forces())
            <= 0.02 * np.linalg.norm(one.forces()) + 1e-12
        )
    stiffer = hhr.Body(1, 2.01, 0.3), hhr.Body(2, 5.0, 0.3)
    laws = hhr.Coulomb("mu"), Gasket("k", 51.0), Wear(RATE)
    fewer = stacked(hhr.Coulomb("mu"), Gasket("k", 50.0), parameters=full.parameters)
    for scene in (
        scene_of("three", bodies=stiffer),
        stacked(*laws, parameters=full.parameters),
        fewer,
    ):
        with pytest.raises(
            ReductionError, match=r"of another scene or mesh|unlike the reduced one"
        ):
            hhr.FallbackModel(model, hhr.FullOrderModel(scene, MPI.COMM_SELF), of="forces")
