"""Local models from a training: clusters as in the thesis, and a box that is split until models are
small and right.
"""

import dataclasses

import numpy as np
import pytest
from local_models_by_hand import AS_IT_IS, pellet_training
from local_report import local_part, near_borders, stripe
from mpi4py import MPI
from needs import needs
from scenes import pressed_pair, references_at

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import (
    LocalModelWarning,
    ReductionError,
    StudyError,
    TrainingWarning,
    UnstableModelError,
)
from hhr_dolfinx.plugins.local_models import splitting
from hhr_dolfinx.plugins.local_models.clustered import built, least_forces, moving
from hhr_dolfinx.plugins.local_models.clusters import forest_tree, separating_cut, tree_of_cells

FINE = hhr.Recipe(hhr.Pod(1e-12, relative=True)).as_it_is()


@pytest.fixture(scope="module")
def training():
    return pellet_training((8, 10))


@pytest.fixture(scope="module")
def regular(training):
    return training.local(hhr.Clusters(3), recipe=AS_IT_IS)


@pytest.fixture(scope="module")
def split(training):
    return training.local(hhr.Splitting(modes=40, forces=2e-3, checks=60), recipe=FINE)


def moving_block():
    """Two blocks, pressed and pulled along each other, from nothing on."""
    box = {"push": (0.0, 0.02), "slide": (0.0, 0.02), "load": (0.0, 0.1)}
    return pressed_pair("plane_strain", ((2.0, 0.3), (1.0, 0.2)), box, cells=4)


def errors_of(training, model, count=60):
    """References at random points, all errors, and those of the forces on the whole surface."""
    points = training.full_order.parameters.random(count, 5)
    references = references_at(points, training.full_order, training.snapshots)
    errors = references.errors(model)
    return references, errors, errors.values["dual_full_floored"]


def test_a_grid_is_cut_along_its_lines(training, regular):
    """A cell belongs to one model with all that lies in it, and snapshots by a border to both
    sides.
    """
    points, choice = training.snapshots.points, regular.choice
    for axis, values in enumerate(map(np.unique, points.T)):
        cuts = choice.cut[choice.axis == axis]
        assert cuts.size == 0 or np.abs(cuts[:, None] - values).min(axis=1).max() < 1e-12
    members = [set(member.snapshots) for member in regular.offline.members]
    assert set.union(*members) == set(range(len(points))) and sum(map(len, members)) > len(points)
    for number, low, high in choice.boxes(
        training.full_order.parameters.lower, training.full_order.parameters.upper
    ):
        inside = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        assert set(inside) <= members[number]


def test_clusters_of_a_grid_follow_the_height(regular):
    """As figure 4.2b: the moving end of the contact makes solutions unlike each other, not the
    pressure.
    """
    points = np.array(
        [
            (pressure, height)
            for pressure in (20, 60, 100, 150)
            for height in np.linspace(0.7, 5.9, 40)
        ]
    )
    labels = regular.choice.many(points)[0].reshape(4, 40)
    assert regular.choice.axis[0] == 1 and (labels == labels[1]).mean() > 0.9


@needs("studies")
def test_clusters_of_any_points_ask_a_forest(training):
    scattered = dataclasses.replace(
        training, snapshots=training.snapshots.take(np.r_[0:80:3, 1:80:7, 2:80:5])
    )
    local = scattered.local(hhr.Clusters(2, overlap=0.1), recipe=AS_IT_IS)
    points, members = scattered.snapshots.points, local.offline.members
    labels = local.choice.many(points)[0]
    for number, member in enumerate(members):
        # what the forest says is among what it is trained on, and what lies by a border besides
        assert set(np.flatnonzero(labels == number)) <= set(member.snapshots)
    assert sum(len(member.snapshots) for member in members) > len(points)
    assert np.median(errors_of(scattered, local)[-1]) < 0.1


def test_one_tree_stands_for_a_forest():
    from sklearn.ensemble import RandomForestClassifier

    space = hhr.ParameterSpace(("a", "b"), (-3.0, 10.0), (5.0, 90.0))
    points = space.random(200, 1)
    labels = ((points[:, 0] + 3) / 8 + (points[:, 1] - 10) / 80 > 1).astype(int)
    unit = (points - [-3, 10]) / [8, 80]
    forest = RandomForestClassifier(100, random_state=0).fit(unit, labels)
    others = space.random(2000, 2)
    same = forest_tree(points, labels, space).many(others)[0] == forest.predict(
        (others - [-3, 10]) / [8, 80]
    )
    assert same.mean() > 0.98


def test_a_cut_keeps_clusters_apart():
    rng = np.random.default_rng(1)
    unit = rng.random((100, 3))
    axis, cut = separating_cut(unit, (unit[:, 1] > 0.6).astype(int), 0.25)
    below = np.sort(unit[unit[:, 1] <= 0.6, 1])[-1]
    assert axis == 1 and below <= cut <= np.sort(unit[unit[:, 1] > 0.6, 1])[0]
    assert separating_cut(unit, np.zeros(100, dtype=int), 0.25) is None


@needs("exact_errors")
def test_a_split_box_has_small_models_that_are_right(training, split):
    """Sizes below what was wished; estimates too, and so are true errors, in the S norm."""
    assert len(split) > 1
    for model, member in zip(split.models, split.offline.members, strict=True):
        assert (len(model.problem.stiffness), len(model.problem.gaps)) == (
            member.ell_bar,
            member.N_lambda_C,
        )
        assert member.ell_bar <= 40 and member.estimate <= 2e-3
    full, floor = training.full_order, least_forces(training.full_order, training.snapshots)
    for point in full.parameters.random(80, 9):
        exact, found = full.solve(point).forces(), split.solve(point).forces()
        off, size = (np.sqrt(value @ full.schur @ value) for value in (found - exact, exact))
        # a hundred random points may miss the worst one
        assert off <= 5 * 2e-3 * max(size, floor)


def test_each_model_has_a_region_and_its_training(training, split):
    space, points = training.full_order.parameters, split.offline.points
    boxes = split.choice.boxes(space.lower, space.upper)
    assert sorted(number for number, *_ in boxes) == list(range(len(split)))
    for number, low, high in boxes:
        member = split.offline.members[number]
        reach = 0.2 * (high - low) + 1e-9
        near = (
            (points[member.snapshots] >= low - reach) & (points[member.snapshots] <= high + reach)
        ).all(axis=1)
        assert near.all() and len(member.snapshots) >= member.own


@needs("studies")
def test_what_is_wrong_is_asked_of_the_full_model(training):
    """From so few answers that nothing is right: the training grows, and errors fall."""
    few = dataclasses.replace(training, snapshots=training.snapshots.take(np.arange(0, 80, 9)))
    how = hhr.Splitting(modes=60, forces=1e-3, checks=60, rounds=2, most=2)
    grown, still = (
        few.local(how, recipe=FINE),
        few.local(dataclasses.replace(how, rounds=0), recipe=FINE),
    )
    assert (
        len(grown.offline.points) >= len(few.snapshots.points) + 20
        and len(still.offline.points) <= 20
    )
    worse, better = (np.percentile(errors_of(training, model)[-1], 90) for model in (still, grown))
    assert better < 0.2 * worse


@needs("studies")
def test_no_stripe_by_the_borders(training, split, regular):
    references, errors, of_forces = errors_of(training, split, 150)
    part = local_part(split, references, errors, training.full_order.parameters.random(20, 1))
    points = references.solutions.points
    assert part["K"] == len(split) == len(part["sizes"]) and 0 < part["choice_s"] < 1e-4
    assert part["stripe"] == stripe(split, points, of_forces)
    cut = regular.choice.cut[0]
    assert near_borders(regular, np.array([[50.0, cut + 0.05]])).all()
    assert near_borders(regular, points).mean() < 0.5
    # twice as wrong by a border
    wrong = np.where(near_borders(regular, points), 2.0, 1.0)
    assert stripe(regular, points, wrong) == 2.0 and np.isnan(
        stripe(regular, points[:1], wrong[:1])
    )


def test_solutions_that_do_not_move():
    """A training that begins without load is split, and clustered, all the same."""
    scene = moving_block()
    points = np.vstack([scene.parameters.lower, scene.parameters.random(60, 1)])
    still = hhr.train(scene, points, held_out=0, comm=MPI.COMM_SELF)
    assert not moving(still.snapshots.displacements).all()
    assert len(still.local(hhr.Splitting(modes=5, most=4, checks=20), recipe=AS_IT_IS)) > 1
    assert len(still.local(hhr.Clusters(2), recipe=AS_IT_IS)) == 2


@needs("exact_errors")
def test_wishes_that_do_not_hold_are_told(training):
    with pytest.warns(LocalModelWarning, match="modes instead of 6"):
        small = training.local(hhr.Splitting(modes=6, most=1, checks=20), recipe=FINE)
    assert small.offline.members[0].ell_bar > 6 and small.offline.missed
    with pytest.warns(LocalModelWarning, match="forces may be off"):
        training.local(
            hhr.Splitting(modes=60, forces=1e-8, most=2, checks=20, rounds=0), recipe=FINE
        )


def test_what_splitting_does_not_mend_ends_soon(training, monkeypatch):
    """A recipe that the check refuses in parts of any size: after three cuts, and not after a
    hundred.
    """
    tried = []
    monkeypatch.setattr(splitting, "built", lambda *given: tried.append(1) or built(*given))
    with pytest.raises(UnstableModelError, match=r"of the part .* no model is to be trusted"):
        training.local(
            hhr.Splitting(modes=60, checks=20),
            recipe=hhr.Recipe(hhr.Pod(0.3), domain=hhr.Rid(0, 0)),
        )
    assert len(tried) <= 16


def test_a_part_is_not_blamed_for_the_training(training):
    """Points of a diagonal leave their box empty: true of one model, and of no use of each of
    several.
    """
    space = training.full_order.parameters
    ends = np.array([space.lower, space.upper])
    line = ends[0] + np.linspace(0, 1, 40)[:, None] * (ends[1] - ends[0])
    snapshots = hhr.compute_snapshots(training.full_order, line)
    recipe = hhr.Recipe(hhr.Pod(1e-11, relative=True), trust=hhr.TrustLimits())
    with pytest.warns(TrainingWarning, match="empty"):
        hhr.build(training.full_order, snapshots, recipe, snapshots)
    assert not any(
        "empty" in text for text in built(training.full_order, snapshots, recipe, snapshots)[1]
    )


@needs("greedy")
def test_the_recipe_of_a_greedy_training():
    chosen = hhr.train(
        moving_block(), hhr.Greedy(budget=12, tolerance=1e-9), held_out=0, comm=MPI.COMM_SELF
    )
    one = chosen.build(checked=False)
    assert chosen.local(hhr.Clusters(1), checked=False).offline.members[0].ell_bar == len(
        one.problem.stiffness
    )


def test_narrow_cells_have_their_own_models():
    """Lines of a grid a billionth of the box apart."""
    ends = np.geomspace(1e-9, 1.0, 20)
    cells = np.stack([ends[:-1], ends[1:]], axis=1)[:, :, None]
    labels = np.arange(19) % 3
    assert (tree_of_cells(cells, labels).many(cells.mean(axis=1))[0] == labels).all()


def test_the_same_twice(training, split):
    again = training.local(hhr.Splitting(modes=40, forces=2e-3, checks=60), recipe=FINE)
    assert np.array_equal(again.choice.cut, split.choice.cut)
    point = training.full_order.parameters.random(1, 8)[0]
    assert again.solve(point).forces() == pytest.approx(
        split.solve(point).forces(), rel=1e-9, abs=1e-9
    )


def test_the_best_recipe_that_fits(training):
    coarse, fine = (
        hhr.Recipe(hhr.Pod(tolerance, relative=True)).as_it_is() for tolerance in (1e-4, 1e-11)
    )
    local = training.local(hhr.Clusters(2, others=(fine,)), recipe=coarse)
    plain = training.local(hhr.Clusters(2), recipe=coarse)
    assert all(
        a.ell_bar > b.ell_bar
        for a, b in zip(local.offline.members, plain.offline.members, strict=True)
    )
    most = max(member.ell_bar for member in plain.offline.members)
    small = training.local(hhr.Clusters(2, others=(fine,), modes=most), recipe=coarse)
    assert [member.ell_bar for member in small.offline.members] == [
        member.ell_bar for member in plain.offline.members
    ]
    with pytest.raises(StudyError, match="modes"):
        training.local(hhr.Clusters(2, modes=3), recipe=fine)


def test_checked_as_one_model(training):
    """Each is held against answers of the full model in its own part."""
    fine = hhr.Recipe(hhr.Pod(1e-11, relative=True))
    local = training.local(hhr.Splitting(modes=60, checks=20, rounds=0, most=2), recipe=fine)
    assert all(model.offline.comparison is not None for model in local.models)


BAD = {
    "modes": 1,
    "forces": 0.0,
    "overlap": -0.1,
    "checks": 2.5,
    "conditions": 0,
    "strip": np.nan,
    "seed": 2**70,
}


def test_wishes_that_cannot_be(training):
    bad = {"overlap": 2, "modes": 0, "others": AS_IT_IS}.items()
    clusters = ({"count": 0}, *({"count": 3, name: value} for name, value in bad))
    for kind, cases in (
        (hhr.Splitting, [{name: value} for name, value in BAD.items()]),
        (hhr.Clusters, clusters),
    ):
        for given in cases:
            with pytest.raises(StudyError):
                kind(**given)
    for how, recipe, error, why in (
        *((way, None, StudyError, "Splitting") for way in (3, "regular", hhr.Splitting)),
        (hhr.Clusters(2), 3, StudyError, "recipe"),
        (hhr.Clusters(200), AS_IT_IS, ReductionError, "clusters"),
    ):
        with pytest.raises(error, match=why):
            training.local(how, recipe=recipe)
