"""Greedy training: what it chooses, when it stops, how it goes on, and the indicators it takes."""

import dataclasses
import itertools
import math
import sys
import threading

import numpy as np
import pellet_cladding
import pytest
from flowing import SMALL_MESH
from mpi4py import MPI
from needs import needs
from pellet_families import families
from scenes import lying, pressed_block, pressed_pair, space
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.linalg import splu
from scipy.stats import spearmanr
from toy_greedy import printed_greedy

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import force_floor
from hhr_dolfinx.errors import ParameterError, ReductionError, SceneWarning, StudyError
from hhr_dolfinx.geometries import stacked_blocks
from hhr_dolfinx.plugins.greedy import greedy as module
from hhr_dolfinx.plugins.greedy import indicators
from hhr_dolfinx.plugins.greedy.digest import digest_of_values
from hhr_dolfinx.plugins.greedy.greedy import independent
from hhr_dolfinx.plugins.greedy.indicators import CellStiffness
from hhr_dolfinx.study.training.train import train

QUICK = hhr.Greedy(
    tolerance=1e-9,
    budget=30,
    start=hhr.Sobol(4),
    candidates=hhr.Lattice(100, levels=10),
    together=6,
)
PELLET = pellet_cladding.scene(radial_cells=6, axial_cells=12, cladding_radial_cells=2)
"""On a coarse mesh; no few answers span all."""


def silent(label):
    """No progress."""
    return iter


def trained(scene=PELLET, greedy=QUICK, folder=None, progress=silent, **changes):
    """A training by a greedy choice with some changes."""
    greedy = dataclasses.replace(greedy, **changes)
    return train(scene, greedy, held_out=0, comm=MPI.COMM_SELF, folder=folder, progress=progress)


@pytest.fixture(scope="module")
def case():
    return trained()


@pytest.fixture(scope="module")
def half(case):
    """A model of the first answers, and these."""
    known = case.snapshots.take(slice(0, 16))
    return hhr.build(case.full_order, known, hhr.Recipe(cone=True).as_it_is()), known


def test_it_spends_its_budget_on_new_points(case):
    points, rounds, recipe = case.choice
    assert case.build(checked=False).offline.recipe == recipe.as_it_is()
    assert len(points) == len(case.snapshots.points) == QUICK.budget
    assert np.array_equal(points, case.snapshots.points)
    assert len(np.unique(points, axis=0)) == QUICK.budget
    assert np.array_equal(points[:4], QUICK.start.points(case.full_order.parameters))
    candidates = QUICK.candidates.points(case.full_order.parameters).tolist()
    assert all(point in candidates for point in points[4:].tolist())
    assert [item.answers for item in rounds] == [4, 10, 16, 22, 28, 30]
    assert all(item.middle <= item.worst for item in rounds) and rounds[-1].worst < rounds[0].worst


def test_it_stops_where_nothing_is_left():
    """Two blocks on each other, of which some answers span all: no candidate is worse than
    round-off.
    """
    found = trained(pressed_pair("plane_strain", ((1.0, 0.3), (2.0, 0.25))))
    assert (
        len(found.choice.points) < QUICK.budget and found.choice.rounds[-1].worst <= QUICK.tolerance
    )


def test_an_answer_is_told_its_error(case):
    """Where the stiffness is constant the usual indicator is the error of the forces."""
    full, model = case.full_order, case.build(checked=False)
    points = full.parameters.random(20, 3)
    answers = list(model.solve_many(points, outside="ignore"))
    told = hhr.ForceError().prepared(full)(model, case.snapshots, answers)
    exact = [full.solve(point).forces() for point in points]
    sizes = np.maximum(np.linalg.norm(exact, axis=1), force_floor(full.problem, case.snapshots))
    errors = (
        np.array([np.linalg.norm(a.forces() - b) for a, b in zip(answers, exact, strict=True)])
        / sizes
    )
    assert np.abs(np.linalg.norm(told, axis=1) - errors).max() <= 1e-9


def test_what_is_wrong_in_the_same_way_is_mended_once():
    errors = np.array([[3.0, 0.0, 0.0], [2.9, 0.0, 0.1], [0.0, 1.0, 0.0], [-3.0, 0.0, 0.0]])
    assert independent(errors, 2).tolist() == [0, 2]
    assert independent(errors, 9).tolist() == [0, 2, 1]


@pytest.mark.parametrize(("indicator", "rank"), [(hhr.Eta(), 0.2), (hhr.Eta2(), 0.4)])
def test_indicators_of_the_thesis(case, half, indicator, rank):
    """They vanish where the model was trained.

    Elsewhere they follow errors of V gamma, eta less (section 2.6.3.e).
    """
    full, (model, known) = case.full_order, half
    points, score = full.parameters.random(40, 7), indicator.prepared(full)
    there, elsewhere = (
        list(model.solve_many(some, outside="ignore")) for some in (known.points, points)
    )
    told = score(model, known, elsewhere)
    exact = np.array([full.solve(point).displacement() for point in points])
    errors = np.linalg.norm([answer.displacement() for answer in elsewhere] - exact, axis=1)
    assert score(model, known, there).max() <= 1e-3 * np.median(told)
    assert spearmanr(told, errors / np.linalg.norm(exact, axis=1)).statistic > rank


VARIED = pressed_pair("plane_strain", (("E", 0.3), (2.0, 0.25)), {"E": (0.5, 2.0)})


@needs("moduli")
@pytest.mark.parametrize("indicator", [None, hhr.Eta2()])
def test_indicators_follow_a_stiffness_of_parameters(indicator):
    both = hhr.Recipe(
        basis=hhr.Pod(1e-13, relative=True)
    )  # modes of one body each would span all at once
    found = trained(VARIED, indicator=indicator, budget=10, recipe=both)
    assert len(found.choice.points) == 10 and 0 < found.choice.rounds[-1].worst < np.inf


@needs("moduli")
def test_a_stiffness_of_parameters_is_trained_on_spread_points_and_body_by_body():
    found = trained(VARIED, hhr.Greedy(tolerance=2e6, budget=8, candidates=hhr.Sobol(16)))
    assert np.array_equal(found.choice.points, hhr.Sobol(4).points(VARIED.parameters))
    assert (
        found.choice.recipe.basis.by_body and len(found.choice.rounds) == 1
    )  # it stops at the wished error


def test_a_killed_training_goes_on(tmp_path, monkeypatch, case):
    built = []

    def counted(*given, **others):
        built.append(len(given[1].points))
        return hhr.build(*given, **others)

    monkeypatch.setattr(module, "build", counted)

    def killed(items):
        yield from itertools.islice(items, 3)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        trained(folder=tmp_path, progress=lambda label: killed)
    assert built == [4, 10, 16]
    found = trained(folder=tmp_path)
    assert built == [4, 10, 16, 22, 28, 30]
    assert np.array_equal(found.choice.points, case.choice.points)
    assert trained(folder=tmp_path).choice.rounds == found.choice.rounds and len(built) == 6
    # another question is none of its business
    trained(budget=4, folder=tmp_path)
    assert built[6:] == [4]


@needs("inelastic", "nonmatching", "paths")
def test_histories():
    """Paths of a family are chosen by the part of the stress of their worst step that training does
    not explain.
    """
    import pellet_cladding_plastic as demo

    family = families(4)["loading"]
    greedy = hhr.Greedy(
        tolerance=1e-9,
        budget=4,
        start=hhr.Sobol(2),
        candidates=hhr.Sobol(4, seed=3),
        together=1,
        family=family,
    )
    found = train(demo.scene(**SMALL_MESH), greedy, comm=MPI.COMM_SELF)
    assert len(found.snapshots.histories) == 4 and found.choice.points.shape == (4, 2)
    assert [item.answers for item in found.choice.rounds] == [2, 3, 4]
    assert all(0 < item.worst for item in found.choice.rounds)
    model = found.build(found.choice.recipe, checked=False)
    own = [model.march(family.paths(points)[0], hhr.MarchSettings(outside="ignore"))
           for points in (found.choice.points[:1], [[9.0, 1.2]])]  # fmt: skip
    steps = [[answer.estimate() for answer in history.answers] for history in own]
    assert {step.kind for history in steps for step in history} == {"indicator of the stress"}
    told = hhr.LargestEstimate().prepared(found.full_order)(model, found.snapshots, [*own, None])
    assert told.tolist() == [
        *(max(step.primal_relative for step in history) for history in steps),
        np.inf,
    ]
    assert told[0] < 0.25 * told[1]


WORDS = {
    "start": 16,
    "candidates": [1, 2],
    "indicator": "eta",
    "recipe": "usual",
    "family": "paths",
}


@pytest.mark.parametrize(
    ("word", "bad"), [*WORDS.items(), ("tolerance", 0.0), ("budget", 2.5), ("together", 0)]
)
def test_what_is_no_greedy_is_refused(word, bad):
    with pytest.raises(StudyError, match=f"^{word} = "):
        hhr.Greedy(**{word: bad})


@needs("inelastic", "nonmatching", "paths")
def test_what_does_not_suit_a_scene_is_refused_before_anything_is_solved():
    import pellet_cladding_plastic as demo

    loading = families(4)["loading"]
    with pytest.raises(StudyError, match="chooses among the paths of a family"):
        train(demo.scene(**SMALL_MESH), hhr.Greedy())
    with pytest.raises(StudyError, match="chooses points, not paths"):
        train(pressed_block("plane_strain"), hhr.Greedy(family=loading))


@needs("floating", "elasticity")
def test_a_body_held_by_contact_alone_whose_modulus_varies_is_refused_at_the_door(monkeypatch):
    """Nothing there says how wrong forces are: the indicators that would answer are 1e6 times too
    large.
    """
    bodies = (
        hhr.Body(stacked_blocks.LOWER_BLOCK, "E", 0.3),
        hhr.Body(stacked_blocks.UPPER_BLOCK, 9, 0.3),
    )
    scene = lying(bodies=bodies, parameters=space(p=(1.0, 10.0), E=(1e3, 4e3)))
    monkeypatch.setattr("hhr_dolfinx.study.training.train.spread_snapshots", None)
    with (
        pytest.warns(SceneWarning, match="no contact resists"),
        pytest.raises(StudyError, match="--sobol 128"),
    ):
        train(scene, hhr.Greedy())


def test_snapshots_are_joined_with_answers_of_their_kind(case):
    known = case.snapshots
    answers = [case.full_order.solve(point) for point in case.full_order.parameters.random(2, 2)]
    found = known.joined(hhr.SnapshotSet.of_answers(answers))
    assert len(found.points) == len(known.points) + 2 and not found.histories
    assert np.array_equal(found.displacements[:, -1], answers[1].unknown)
    assert np.array_equal(found.forces[:, -2], answers[0].multipliers)
    other = hhr.FullOrderModel(pressed_block("plane_strain"))
    with pytest.raises(ReductionError, match="cannot be joined"):
        known.joined(hhr.compute_snapshots(other, other.parameters.random(2, 1)))


def test_a_lattice_shares_coordinates():
    space = hhr.ParameterSpace(("a", "b"), (0.0, 5.0), (1.0, 9.0))
    assert np.array_equal(hhr.Lattice(12, levels=(4, 3)).points(space), space.grid((4, 3)))
    drawn = hhr.Lattice(50, levels=11).points(space)
    assert drawn.shape == (50, 2) and len(np.unique(drawn, axis=0)) == 50
    assert np.array_equal(drawn[:4], space.grid((2, 2)))
    assert (
        np.allclose(np.round(drawn[:, 0] * 10) / 10, drawn[:, 0])
        and len(np.unique(drawn[:, 1])) == 11
    )
    for bad, why in (
        *((given, r"^Lattice\(") for given in ({"count": 0}, {"levels": 1}, {"seed": -1})),
        ({"levels": (3, 3, 3)}, "one for each"),
    ):
        with pytest.raises(ParameterError, match=why):
            hhr.Lattice(**{"count": 5} | bad).points(space)


def test_a_choice_of_another_box_is_another_one(tmp_path):
    """The box is no part of a problem, and the answers in the folder are the same."""
    box = PELLET.parameters
    narrow = dataclasses.replace(
        box, upper=tuple(box.lower + 0.3 * np.subtract(box.upper, box.lower))
    )
    trained(dataclasses.replace(PELLET, parameters=narrow), budget=10, folder=tmp_path)
    wide = trained(budget=10, folder=tmp_path)
    assert (wide.choice.points.max(axis=0) > narrow.upper).all()


class Fixed:
    def __init__(self, points):
        self.table = points

    def points(self, space):
        return self.table


@dataclasses.dataclass(frozen=True)
class Shifted:
    move: object

    def points(self, space):
        return self.move(space.random(4, 0))


def samplings(value):
    """Points of which ``repr``, of arrays above a thousand entries, does not show the middle.

    An object, a function.
    """
    points = np.linspace(0, 1, 2001)[:, None]
    points[1000] = value
    return Fixed(points), Fixed([[value]]), Shifted(lambda points: points + value)


def test_what_has_no_values_is_refused_by_name():
    circle = []
    circle.append(circle)
    locked = r"holds <.*lock.*no digest .* frozen dataclass"
    for start, why in (
        (Fixed(LOCK), locked),
        (Shifted(guarded), locked),
        (Fixed(circle), "50 deep, or itself"),
    ):
        with pytest.raises(StudyError, match=why):
            digest_of_values(start, "it")


def test_digests_tell_types_shapes_and_order_apart():
    """The ``repr`` of an object is another one in each run: nothing that was chosen was ever found
    again.
    """
    values = [
        1,
        1.0,
        "1",
        (1,),
        [1],
        {"a": 1},
        {"a": 1.0},
        np.array([1]),
        np.array([1.0]),
        np.array([[1.0]]),
        None,
        [[1], 2],
        [1, [2]],
        np.float64,
        math.sin,
        csr_matrix([[0.0, 1.0]]),
        csr_matrix([[1.0, 0.0]]),
    ]
    values += [*samplings(0.0), *samplings(0.1), Shifted(lambda points: points * 2)]
    digests = [digest_of_values(value, "it") for value in values]
    assert len(set(digests)) == len(values)
    assert [digest_of_values(value, "it") for value in samplings(0.1)] == digests[-4:-1]
    assert digest_of_values({"a": 1, "b": 2}, "it") == digest_of_values({"b": 2, "a": 1}, "it")


@needs("elasticity")
@pytest.mark.parametrize("young", [1.0, "E"])
@pytest.mark.parametrize("poisson", [0.3, 0.48])
def test_cells_have_the_energy_of_their_strain(poisson, young):
    """Area times density of a uniform strain, with a mean dilatation too (nu = 0.48).

    None of a rigid motion.
    """
    box = {"E": (0.5, 2.0)} if young == "E" else {}
    full = hhr.FullOrderModel(pressed_pair("plane_strain", ((young, poisson), (2.0, 0.25)), box))
    problem = full.problem
    point = full.parameters.random(1, 0)[0]
    some = np.flatnonzero(problem.points[problem.cell_nodes][:, :, 1].mean(axis=1) < 1.0)[::3]
    stiffness = CellStiffness.of(full, some).at(point)
    field = (problem.points @ np.array([[0.1, 0.02], [0.02, -0.3]])).ravel()
    modulus = point[full.parameters.names.index("E")] if young == "E" else young
    lam, mu = modulus * poisson / ((1 + poisson) * (1 - 2 * poisson)), modulus / (2 * (1 + poisson))
    density = lam * (0.1 - 0.3) ** 2 + 2 * mu * (0.1**2 + 0.3**2 + 2 * 0.02**2)
    assert field @ stiffness @ field == pytest.approx(len(some) / 16 * density, rel=1e-12)
    turned = (problem.points @ np.array([[0.0, 1.0], [-1.0, 0.0]])).ravel()
    assert turned @ stiffness @ turned <= 1e-12 * density
    rest = np.setdiff1d(np.arange(len(problem.cell_nodes)), some)
    whole = stiffness + CellStiffness.of(full, rest).at(point)
    assert abs(whole - problem.at(point).stiffness).max() <= 1e-13 * abs(whole).max()


def test_eta2_is_the_bound_of_the_thesis(case, half, monkeypatch):
    """(2.124) written out, and (2.122): with true values on the interface no less than the error on
    the RID.
    """
    full, (model, known) = case.full_order, half
    answers = list(model.solve_many(full.parameters.random(20, 7), outside="ignore"))
    exact = np.array([full.solve(answer.parameter).unknown for answer in answers])
    monkeypatch.setattr(
        indicators, "_interpolated", lambda problem, known, answers, dofs: exact[:, dofs]
    )
    told = hhr.Eta2().prepared(full)(model, known, answers)
    stiffness = CellStiffness.of(full, model.offline.sets.cells).at(full.problem.middle)

    def size(field):
        return np.sqrt(field @ stiffness @ field)

    inner = model.offline.sets.A
    solve = splu(csc_matrix(full.problem.stiffness[inner][:, inner])).solve
    outer = np.ones(full.problem.free.size)
    outer[inner] = 0.0

    for said, answer, true in zip(told, answers, exact, strict=True):
        field = model.offline.basis @ answer.unknown
        pulled = full.problem.contact[model.offline.sets.A_lambda].T @ answer.multipliers
        left = (
            full.problem.loads @ full.problem.theta(answer.parameter)
            - full.problem.stiffness @ field
            - pulled
        )
        printed = np.sqrt(left[inner] @ solve(left[inner])) + 2 * size(outer * (true - field))
        assert said == pytest.approx(printed / size(field), rel=1e-8)
        assert said >= size(field - true) / size(field)


def test_the_algorithm_of_the_thesis_as_printed():
    """Each time the parameter with the largest indicator, one at a time.

    The one at which it stops is selected too.
    """
    full = hhr.FullOrderModel(PELLET)
    grid = full.parameters.grid([3] * len(full.parameters.names))
    first = [0, len(grid) // 2, len(grid) - 1]
    recipe = hhr.Recipe(cone=True)
    selected, rounds = printed_greedy(full, grid, first, 3, 1e-12, hhr.Eta2(), recipe)
    assert len(selected) == len(set(selected)) == 6
    assert [int(eta.argmax()) for eta in rounds] == selected[3:]
    assert all(np.isneginf(eta[selected[: 3 + k]]).all() for k, eta in enumerate(rounds))
    early, told = printed_greedy(full, grid, first, 3, 1.01 * rounds[0].max(), hhr.Eta2(), recipe)
    assert early == selected[:4] and np.array_equal(told[0], rounds[0])


LIMIT, STEP, LOCK = 1, {"of": [0.5]}, threading.Lock()


def limited(points):
    """A choice that reads a global, one by a function, and one by a function that is made in it."""
    return [stepped(point) for point in points if point < LIMIT]


def stepped(point):
    return point * STEP["of"][0] if point else stepped(point + 1)


def guarded(points):
    with LOCK:
        return points


class Choosing:
    """A sampling with a number that its class holds, and a method."""

    count = 4

    @property
    def twice(self):
        return 2 * LIMIT

    def points(self, space):
        return space.random(self.count, self.twice)


HERE = sys.modules[__name__]


@pytest.mark.parametrize(
    ("value", "holder", "name", "other"),
    [
        *(
            (value, HERE, "LIMIT", 2)
            for value in (
                limited,
                lambda points: limited(points),
                Choosing(),
                Choosing,
                [Shifted(limited)],
            )
        ),
        (limited, HERE, "STEP", {"of": [0.25]}),
        (Choosing(), Choosing, "count", 5),
        (Choosing(), Choosing, "points", lambda self, space: space.random(3, 0)),
    ],
)
def test_a_digest_knows_what_functions_read(value, holder, name, other, monkeypatch):
    """Globals of a module, of functions that are called too, attributes and methods.

    And nothing that is not read.
    """
    before, unread = (digest_of_values(item, "it") for item in (value, stepped))
    assert digest_of_values(value, "it") == before
    with monkeypatch.context() as changed:
        changed.setattr(holder, name, other)
        assert digest_of_values(value, "it") != before
        assert (digest_of_values(stepped, "it") == unread) == (name != "STEP")
    assert digest_of_values(value, "it") == before
