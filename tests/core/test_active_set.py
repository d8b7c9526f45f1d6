"""The active set on linear complementarity problems w = g + S z, w >= 0, z >= 0, w z = 0."""

import dataclasses
from itertools import combinations, product
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from needs import needs
from scenes import Twice, pair_scene, pressed_block, slope, space, whole_domain

import hhr_dolfinx as hhr
from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Status, active_set
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError, SingularError
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.linear.dense import LapackLU, PetscLU
from hhr_dolfinx.models.answer import ElasticFields, found_as, outcome
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.eliminations.constant import ConstantElimination
from hhr_dolfinx.models.eliminations.elimination import Responses
from hhr_dolfinx.models.reduced import ADVICE, ReducedModel, ReducedProblem
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.reduction.completion import ReconstructionData
from hhr_dolfinx.reduction.exact import exact_condensation
from hhr_dolfinx.reduction.projection import project


def solve(schur, gap, start=None, **how):
    schur, gap = np.asarray(schur, dtype=float), np.asarray(gap, dtype=float)
    start = gap < 0 if start is None else np.asarray(start)
    return active_set(SchurEqualities.of(schur), gap, start, **how)


@settings(max_examples=200, deadline=None)
@given(size=st.integers(1, 12), seed=st.integers(0, 10**6), skew=st.floats(0, 10))
def test_solves_every_positive_definite_problem(size, seed, skew):
    """S + S^T positive definite makes S a P-matrix, symmetric or not: one solution, always
    found.
    """
    rng = np.random.default_rng(seed)
    root, turn = rng.normal(size=(2, size, size))
    schur = root @ root.T + 0.1 * np.eye(size) + skew * (turn - turn.T)
    gap = rng.normal(size=size)
    found = solve(schur, gap, start=rng.random(size) < 0.5)
    slack = gap + schur @ found.forces
    assert found.status is Status.CONVERGED
    scale = np.abs(schur).max() * (1 + found.forces.max())
    assert found.forces.min() >= -1e-10 * (1 + found.forces.max())
    assert slack.min() >= -1e-10 * scale
    assert np.abs(slack * found.forces).max() <= 1e-9 * scale * (1 + found.forces.max())


@pytest.mark.parametrize(
    "start", [(True, False, False), (False, True, True), (False, False, False)]
)
def test_cycling_is_detected_and_ended(start):
    """On a P-matrix on which Alg. 1.1 cycles (Ben Gharbia and Gilbert, Math. Program. 134,
    2012).
    """
    given = np.array(start)
    found = solve([[1, 2, 0], [0, 1, 2], [2, 0, 1]], [-1, -1, -1], given)
    assert found.status is Status.CONVERGED and found.forces == pytest.approx([1 / 3] * 3)
    assert given.tolist() == list(start), "a start is not modified"
    assert found.cycled or start != (True, False, False), "the plain rule cycles there"


def test_no_solution_is_said_not_answered():
    """S = -1, g = -1: any force makes it worse, so there is no solution and the statuses
    alternate.
    """
    assert solve([[-1.0]], [-1.0]).status is Status.CYCLING
    assert solve([[2.0]], [-1.0], [False], max_iterations=1).status is Status.ITERATION_LIMIT


@pytest.mark.parametrize("size", [2, 3, 5])
def test_the_same_row_twice_is_a_status(size):
    """One row after another could bear the force, or all of them: no answer is the answer."""
    found = solve(np.ones((size, size)) + np.diag([0.0, 0.0, *[1.0] * (size - 2)]), -np.ones(size))
    assert found.status is Status.SINGULAR and "1.67" in found.status.value
    # what comes back may serve as a start: the statuses asked with, not the set that was singular
    start = np.array([True, False])
    found = solve([[1.0, -1.0], [-1.0, 1.0]], [-1.0, 0.5], start)
    assert found.status is Status.SINGULAR and np.array_equal(found.active, start)


def test_a_status_speaks_of_no_model():
    """Full models have neither a RID nor modes: what helps is added by the model that was asked, of
    whose point.
    """
    for status in Status:
        assert not any(word in status.value for word in ("RID", "basis", "modes", "reduced"))
    with pytest.raises(NotSolvableError) as caught:
        PetscLU(np.zeros((3, 3)))
    assert "singular" in str(caught.value) and "RID" not in str(caught.value)
    iterate = found_as(solve([[-1.0]], [-1.0]), np.array([0.5]), np.ones(1), ElasticFields())
    with pytest.raises(
        ConvergenceError, match=r"\[0\.5\] after \d+ iterations: .*P-matrix: more layers$"
    ):
        outcome(iterate, True, {Status.CYCLING: "more layers"})
    assert "RID" in ADVICE[Status.SINGULAR] and "RID" in ADVICE[Status.CYCLING]


def every_solution(schur, gap):
    """Forces of all solutions by trying every set of statuses that is not singular."""
    found = []
    for bits in product([False, True], repeat=gap.size):
        active = np.array(bits)
        block = schur[np.ix_(active, active)]
        if active.any() and abs(np.linalg.det(block)) < 1e-9:
            continue
        forces = np.zeros(gap.size)
        forces[active] = np.linalg.solve(block, -gap[active])
        if min(forces.min(), np.where(active, 0.0, gap + schur @ forces).min()) >= 0:
            found.append(forces)
    return found


def test_a_singular_set_on_the_way_is_gone_round():
    """Brute force over 600 problems: what is answered is right, and the way round is found in two
    of three.

    S is not symmetric and has two rows that are alike on their own two conditions.
    """
    singular, round_it = 0, 0
    for seed in range(600):
        rng = np.random.default_rng(seed)
        root, turn = rng.normal(size=(2, 4, 4))
        schur = root @ root.T + 0.3 * np.eye(4) + turn - turn.T
        schur[np.ix_(*[rng.choice(4, 2, replace=False)] * 2)] = 2.0
        gap, start = rng.normal(size=4), rng.random(4) < 0.5
        solutions = every_solution(schur, gap)
        if len(solutions) != 1:
            continue
        met, solved = [], SchurEqualities.of(schur, LapackLU)

        def equalities(active, free_slack):
            try:
                return solved(active, free_slack)
            except NotSolvableError:
                met.append(active)
                raise

        found = active_set(equalities, gap, start)
        if found.status is Status.CONVERGED:
            # S has conditions of 1e3 and more where it is nearly singular
            assert found.forces == pytest.approx(solutions[0], abs=1e-8 * (1 + solutions[0].max()))
        if met and found.status is not Status.CYCLING:
            singular += 1
            round_it += found.status is Status.CONVERGED
            assert found.status is Status.CONVERGED or np.array_equal(found.active, start)
    assert singular > 50 and round_it > 0.6 * singular


def test_going_round_ends_at_the_limit():
    calls = []

    def equalities(active, free_slack):
        calls.append(active)
        if active.sum() != 0:
            raise SingularError("all but the empty set")
        return np.zeros(active.size), free_slack

    found = active_set(equalities, -np.ones(50), np.ones(50, dtype=bool), max_iterations=10)
    assert found.status is Status.SINGULAR and len(calls) <= 12 and found.active.all()


PAIRS = np.array([0, 0, 1, 1])


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [2, 0, 3, 1]])
@pytest.mark.parametrize(
    ("ratio", "pull"), [(3e9, 0.029), (1e10, 0.08), (1e11, 0.91), (1e11, 1e-3)]
)
def test_a_strong_pair_does_not_let_a_weak_one_pull(ratio, pull, order):
    """Forces apart by the ratio, started from statuses under which the weak pair pulls."""
    schur = np.kron(np.eye(2), [[1.0, 0.5], [0.5, 1.0]])
    schur[2:, 2:] *= 3.0
    gap = (-schur @ np.array([ratio, 2 * ratio, 1.0, -pull]))[order]
    schur, pairs = schur[np.ix_(order, order)], PAIRS[order]
    found = solve(schur, gap, [True] * 4, pairs=Pairs.of(pairs))
    assert found.status is Status.CONVERGED
    assert found.forces[pairs == 1].min() == 0.0
    assert found.forces[pairs == 1].max() == pytest.approx(1.0 - pull * 0.5, rel=1e-9)


def test_a_far_obstacle_does_not_let_another_pair_penetrate():
    """Gaps 1e8 apart: a thousandth of the near gap is no round-off."""
    found = solve(np.eye(4), [1.0, -9e-4, 1e8, 1e8], [False] * 4, pairs=Pairs.of(PAIRS))
    assert found.status is Status.CONVERGED and found.forces[1] == pytest.approx(9e-4, rel=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_round_off_between_pairs_ends(seed):
    """Forces up to 1e12 apart: round-off of the strong pair reaches the weak one with 1e-15 of its
    size.
    """
    rng = np.random.default_rng(seed)
    m, pairs = 40, np.repeat([0, 1], 20)
    root = rng.normal(size=(m, 2 * m))
    schur, groups = root @ root.T / m, Pairs.of(pairs)
    for _ in range(50):
        ratio = np.where(pairs == 0, 10.0 ** rng.uniform(0, 12), 1.0)
        forces = ratio * rng.exponential(size=m) * (rng.random(m) < 0.6)
        gap = (
            ratio * rng.exponential(size=m) * (rng.random(m) < 0.5) * (forces == 0) - schur @ forces
        )
        found = solve(schur, gap, pairs=groups)
        assert found.status is Status.CONVERGED and not found.cycled
        weak = found.forces[pairs == 1]
        assert weak.min() >= -1e-11 * weak.max() - 1e-15 * found.forces.max()


def two_blocks_of_unlike_stiffness(law=None):
    """A stiff and a soft block, each pushed towards an obstacle of its own.

    The soft one does not reach it.
    """
    tops, floors = ([two_blocks.side(body, 1, upper) for body in (1, 2)] for upper in (True, False))
    return pair_scene(
        "unlike_blocks",
        {"push": (0.0, 0.05)},
        ((0, 0), (1, 1), (2, 2)),
        ((3, 0), (4, 1), (2, 2)),
        ((1e12, 0.3, law), (1.0, 0.3, law)),
        contacts=(
            hhr.Obstacle(floors[0], (0.0, -1.0), 0.0),
            hhr.Obstacle(floors[1], (0.0, -1.0), 0.1),
        ),
        displacements=tuple(
            hhr.Displacement(tag, k, slope("push", -1.0 * k)) for tag in tops for k in (0, 1)
        ),
    )


@pytest.fixture(scope="module")
def unlike():
    return hhr.FullOrderModel(two_blocks_of_unlike_stiffness())


FLOW = [pytest.param(kind, marks=needs("inelastic")) for kind in ("flow", "reduced flow")]


@pytest.mark.parametrize("kind", ["full", "condensed", "reduced", *FLOW])
def test_every_model_keeps_its_pairs_apart(kind, unlike):
    """Forces 1e12 apart: started with both blocks on their obstacles, the soft one is let go."""
    full, problem = unlike, unlike.problem
    point, everything = np.array([0.05]), np.ones(len(problem.contact_pairs), dtype=bool)
    known = KnownStatuses(point[None], everything[None])
    free, sets = np.flatnonzero(problem.free), whole_domain(problem)
    basis = np.eye(problem.free.size)[:, free]
    if kind == "full":
        forces = full.solve(point, start=everything).forces()
    elif kind == "condensed":
        forces = exact_condensation(full, known).solve(point).forces()
    elif kind == "reduced":
        completion = ReconstructionData.of(problem, hhr.SnapshotSet.of_answers([full.solve(point)]))
        fields = completion.reconstruction(problem, basis, sets)
        reduced = ReducedModel(
            project(problem, basis, sets), problem.parameters, fields, known=known
        )
        forces = reduced.solve(point).forces()
    else:
        flow = hhr.FullOrderModel(two_blocks_of_unlike_stiffness(hhr.Plasticity(1e30)))
        theta, model = problem.amplitudes(point), flow.equilibrium
        loads = flow.problem.loads @ theta
        if kind == "reduced flow":
            from hhr_dolfinx.plugins.inelastic.project import project_flow

            fields = SimpleNamespace(amplitudes=problem.amplitudes, interface=None)
            projected, points = project(flow.problem, basis, sets), project_flow(model, basis, sets)
            model, loads = (
                ReducedModel(projected, problem.parameters, fields, flow=points).equilibrium,
                loads[free],
            )
        forces = model.elastic.correct(loads, np.zeros(model.size), theta, everything)[1].forces
    stiff, soft = (forces[problem.contact_pairs == pair] for pair in (0, 1))
    assert stiff.min() > 1e8 and not soft.any()


@pytest.mark.parametrize("factorise", [PetscLU, LapackLU])
def test_factors_are_kept_replaced_and_right(factorise):
    """Many sets of one size, twice over and with a singular one between them: each answer is the
    direct one.
    """
    rng = np.random.default_rng(4)
    schur = rng.normal(size=(6, 6)) + 6 * np.eye(6)
    schur[:2, :2] = 1.0  # the set {0, 1} is singular
    equalities, free_slack = SchurEqualities.of(schur, factorise), rng.normal(size=6)
    for first, second in [*combinations(range(6), 2)] * 2:
        active = np.zeros(6, dtype=bool)
        active[[first, second]] = True
        if (first, second) == (0, 1):
            with pytest.raises(NotSolvableError):
                equalities(active, free_slack)
            continue
        forces, slack = equalities(active, free_slack)
        direct = np.linalg.solve(schur[np.ix_(active, active)], -free_slack[active])
        assert forces[active] == pytest.approx(direct, rel=1e-12) and not forces[~active].any()
        assert slack == pytest.approx(np.where(active, 0.0, free_slack + schur @ forces), abs=1e-12)
    assert len(equalities._entries) <= SchurEqualities.KEPT_PER_SIZE


def test_singular_and_cycling_answers_hold_nan_and_a_status():
    """Neither a zero row nor a negative S has a solution.

    Nothing of the last iterate is handed out.
    """
    for value, status in ((0.0, Status.SINGULAR), (-1.0, Status.CYCLING)):
        model = condensed([[value]], [-1.0], [False], unknowns=2)
        with pytest.raises((NotSolvableError, ConvergenceError)):
            model.solve(0.5)
        solution = model.solve(0.5, raise_on_failure=False)
        assert solution.status is status and not solution.converged
        assert (
            np.isnan(solution.unknown).all()
            and solution.unknown.size == 2
            and np.isnan(solution.forces()).all()
        )


@pytest.mark.parametrize("first", [np.nan, np.inf, 1.0, -1.0])
@pytest.mark.parametrize("second", [np.nan, np.inf, -np.inf])
@pytest.mark.filterwarnings(
    "ignore:invalid value:RuntimeWarning"
)  # 0 times infinity, on some processors
def test_what_is_not_finite_is_never_a_solution(first, second):
    found = solve(np.eye(2), [first, second])
    assert found.status is Status.NOT_FINITE and not found.forces.any()


def condensed(schur, gap, known, advice=None, unknowns=0):
    """A model with one parameter that changes nothing."""
    gap, size = np.asarray(gap, dtype=float), len(gap)
    responses = (
        np.ones((unknowns, 1)),
        np.ones((unknowns, size)),
        gap[:, None],
        np.asarray(schur, dtype=float),
    )
    return CondensedModel(
        space(mu=(0.0, 1.0)),
        ConstantElimination(Responses(*responses), Amplitudes(np.array([1.0]), np.array([[0.0]]))),
        KnownStatuses(np.array([[0.5]]), np.array([known])),
        ElasticFields(),
        advice=advice or {},
    )


def test_known_statuses_that_are_singular_do_not_stop_a_model():
    """There is no affine map for them; the active set goes round."""
    solution = condensed([[2, 2], [2, 2]], [-1, 1], [True, True]).solve(0.5)
    assert solution.converged and solution.forces().tolist() == [0.5, 0.0]


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
@pytest.mark.parametrize("start", ["nearest", None])
def test_an_infinite_gap_is_refused_tabulated_or_not(start):
    model = condensed(np.eye(2), [np.inf, 1.0], [False, False])
    with pytest.raises(NotSolvableError, match="finite"):
        model.solve(0.5, start=start)
    solution = model.solve(0.5, start=start, raise_on_failure=False)
    assert solution.status is Status.NOT_FINITE and np.isnan(solution.forces()).all()


def test_each_model_adds_its_own_advice():
    model = condensed([[1, 1], [1, 1]], [-1, -1], [True, True], ADVICE)
    with pytest.raises(NotSolvableError, match=r"1\.67.*: add modes"):
        model.solve(0.5)
    zero = ReducedProblem(
        np.zeros((1, 1)), *[np.ones((2, 1))] * 2, np.ones((1, 1)), np.ones((2, 1)), np.zeros(2, int)
    )
    fields = SimpleNamespace(amplitudes=model.eliminated.amplitudes, interface=None)
    with pytest.raises(SingularError, match=r"K~ cannot be eliminated.*singular: add RID layers"):
        ReducedModel(zero, model.parameters, fields, known=model.known)


def test_a_pair_listed_twice_is_named_in_a_full_model():
    scene = pressed_block("plane_strain")
    with pytest.raises(NotSolvableError, match="list each contact pair once") as caught:
        hhr.FullOrderModel(dataclasses.replace(scene, contacts=(Twice(scene.contacts[0]),))).solve(
            0.05
        )
    assert not any(word in str(caught.value) for word in ("RID", "modes", "basis"))
