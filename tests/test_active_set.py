"""The active set on linear complementarity problems w = g + S z, w >= 0, z >= 0, w z = 0."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hhr_dolfinx.contact.active_set import SchurEqualities, active_set
from hhr_dolfinx.contact.condensed import CondensedContact, KnownStatuses, Responses
from hhr_dolfinx.contact.dense import LapackLU, PetscLU
from hhr_dolfinx.contact.problem import Status, outcome
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError
from hhr_dolfinx.parameters import Amplitudes, ParameterSpace


def solve(schur, gap, start=None):
    schur, gap = np.asarray(schur, dtype=float), np.asarray(gap, dtype=float)
    start = gap < 0 if start is None else np.asarray(start)
    return active_set(SchurEqualities.of(schur), gap, start)


@settings(max_examples=200, deadline=None)
@given(size=st.integers(1, 12), seed=st.integers(0, 10**6), skew=st.floats(0, 10))
def test_solves_every_positive_definite_problem(size, seed, skew):
    """S + S^T positive definite makes S a P-matrix, symmetric or not: one solution, always found."""
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


CYCLIC = [[1, 2, 0], [0, 1, 2], [2, 0, 1]]
"""A P-matrix on which Alg. 1.1 cycles (Ben Gharbia and Gilbert, Math. Program. 134, 2012)."""


@pytest.mark.parametrize("start", [(True, False, False), (False, True, True), (False, False, False)])
def test_cycling_is_detected_and_ended(start):
    found = solve(CYCLIC, [-1, -1, -1], start)
    assert found.status is Status.CONVERGED
    assert found.forces == pytest.approx([1 / 3] * 3)


def test_the_plain_rule_does_cycle_there():
    """Guards the test above: without the terminating rule it would prove nothing."""
    assert solve(CYCLIC, [-1, -1, -1], (True, False, False)).cycled


def test_no_solution_is_said_not_answered():
    """S = -1, g = -1: any force makes it worse, so there is no solution and the statuses alternate."""
    found = solve([[-1.0]], [-1.0])
    assert found.status is Status.CYCLING


def test_iteration_limit_is_a_status():
    found = active_set(SchurEqualities.of(np.array([[2.0]])), np.array([-1.0]), np.array([False]), max_iterations=1)
    assert found.status is Status.ITERATION_LIMIT


def test_singular_active_block_is_a_status():
    found = solve([[1.0, 1.0], [1.0, 1.0]], [-1.0, -1.0])
    assert found.status is Status.SINGULAR and "1.67" in found.status.value


def test_start_is_not_modified():
    start = np.array([True, False, False])
    solve(CYCLIC, [-1, -1, -1], start)
    assert start.tolist() == [True, False, False]


@pytest.mark.parametrize("factorise", [PetscLU, LapackLU])
def test_factors_are_kept_replaced_and_right(factorise):
    """Many sets of one size, twice over and with a singular one between them: each answer is the direct one."""
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
    """Neither a zero row nor a negative S has a solution; nothing of the last iterate is handed out."""
    space = ParameterSpace(("mu",), (0.0,), (1.0,))
    amplitudes = Amplitudes(np.array([1.0]), np.array([[0.0]]))
    for schur, status in ((np.zeros((1, 1)), Status.SINGULAR), (-np.ones((1, 1)), Status.CYCLING)):
        model = CondensedContact(
            space,
            amplitudes,
            Responses(np.ones((2, 1)), np.ones((2, 1)), -np.ones((1, 1)), schur),
            KnownStatuses(np.array([[0.5]]), np.array([[False]])),
        )
        with pytest.raises((NotSolvableError, ConvergenceError)):
            model.solve(0.5)
        solution = model.solve(0.5, raise_on_failure=False)
        assert solution.status is status and not solution.converged
        assert np.isnan(solution.primal).all() and np.isnan(solution.forces).all()


@pytest.mark.parametrize("gap", [[np.nan, np.nan], [1.0, np.nan], [-1.0, np.inf * 0]])
def test_nan_is_never_a_solution(gap):
    found = solve(np.eye(2), gap)
    assert found.status is Status.NOT_FINITE and not found.forces.any()
    with pytest.raises(NotSolvableError, match="finite"):
        outcome(np.ones(1), found, 0.5, raise_on_failure=True)
    assert np.isnan(outcome(np.ones(1), found, 0.5, raise_on_failure=False).forces).all()


def test_a_singular_set_is_not_handed_on():
    """What comes back may serve as a start: the statuses asked with, not the set that was singular."""
    start = np.array([True, False])
    found = solve([[1.0, -1.0], [-1.0, 1.0]], [-1.0, 0.5], start)
    assert found.status is Status.SINGULAR and np.array_equal(found.active, start)
