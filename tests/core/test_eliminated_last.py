"""K^-1 between a few dofs by Schur complements: that of solutions, after other values too, and what
cannot be had.
"""

import contract
import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import check_like, largest_difference
from scipy.sparse import block_diag, csc_matrix, csr_matrix, diags, identity, kron, triu

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotSolvableError
from hhr_dolfinx.linear import schur, sparse
from hhr_dolfinx.linear.factors import Factors, Pattern

pytestmark = pytest.mark.skipif(
    schur._library() is None, reason="PETSc has no Schur complements here"
)
SIDE = 7


LINE, ONE = (
    csr_matrix(2 * np.eye(SIDE) - np.eye(SIDE, k=1) - np.eye(SIDE, k=-1)),
    identity(SIDE, format="csr"),
)
MATRIX = csr_matrix(
    kron(kron(LINE, ONE), ONE) + kron(kron(ONE, LINE), ONE) + kron(kron(ONE, ONE), LINE)
)
"""A Laplacian on a cube, (343, 343)."""
FREE = np.arange(SIDE**3) % SIDE**2 > 0
"""All dofs but those of one side."""
LAST = np.arange(40, 90)
"""Some of them are imposed."""


def factors(last, matrix=MATRIX, free=FREE, **how):
    return sparse.FreeCholesky(
        matrix, free, slice(0, len(free)), "cube", "mumps", MPI.COMM_SELF, last=last, **how
    )


def rows_at(places):
    """Rows of which each has entries at two of some dofs."""
    rng = np.random.default_rng(0)
    dense = np.zeros((9, len(FREE)))
    for row in dense:
        row[rng.choice(places, 2, replace=False)] = rng.standard_normal(2)
    return csr_matrix(dense)


@pytest.mark.parametrize("low_rank", [None, 1e-10])
def test_the_inverse_between_dofs_is_that_of_solutions(low_rank):
    made, plain = factors(LAST, low_rank=low_rank), factors(None)
    assert made.last is not None and FREE[made.last].all() and plain.last is None
    rows = rows_at(LAST)
    for times in (1.0, 4.0):
        for each in (made, plain):
            each.refactor(csr_matrix(times * MATRIX))
        assert (
            largest_difference(made.between_last(rows), rows @ plain.solve_columns(rows.T.tocsc()))
            < 1e-12
        )
        rhs = np.random.default_rng(1).standard_normal(len(FREE))
        assert largest_difference(made.solve(rhs), plain.solve(rhs)) < 1e-12


def test_rows_that_reach_beyond_take_solutions():
    assert factors(LAST).between_last(rows_at(np.arange(200, 210))) is None


def test_nothing_moves_under_no_loads():
    """Some columns without an entry, and only such ones, which MUMPS refuses."""
    made, columns = factors(LAST), csc_matrix((len(FREE), 5))
    assert not made.solve_columns(columns).any()
    columns[100, 3] = 1.0
    found = made.solve_columns(columns)
    assert found[:, 3].any() and not found[:, :3].any() and not found[:, 4].any()


def test_loads_that_reach_none_of_them_move_what_they_push():
    """Nothing couples the second part with the rows that are eliminated last, and all columns push
    that alone.
    """
    count, both, free = (
        len(FREE),
        csr_matrix(block_diag([MATRIX, MATRIX])),
        np.concatenate([FREE, FREE]),
    )
    made, rng = factors(LAST, both, free), np.random.default_rng(0)
    for reached in (slice(0, count), slice(count, 2 * count)):
        loads = np.zeros((2 * count, 3))
        loads[reached] = (
            rng.standard_normal((count, 3)) * FREE[:, None] * (rng.random((count, 3)) < 0.1)
        )
        assert np.abs((both @ made.solve_columns(csc_matrix(loads)) - loads)[free]).max() < 1e-12


@pytest.mark.parametrize("last", [None, slice(0), slice(1), slice(None)])
def test_nothing_is_last_or_all_is(last):
    """Then K^-1 takes solutions."""
    made = factors(None if last is None else np.arange(len(FREE))[last])
    assert made.last is None and made.between_last(rows_at(LAST)) is None
    assert np.abs(MATRIX @ made.solve(FREE * 1.0) - FREE)[FREE].max() < 1e-12


@pytest.mark.parametrize("last", [None, LAST])
def test_factors_that_refused_a_matrix_take_another_one(last):
    made = factors(last)
    with pytest.raises(NotSolvableError):
        made.refactor(
            csr_matrix((0.0 * MATRIX.data, MATRIX.indices, MATRIX.indptr), shape=MATRIX.shape)
        )
    with pytest.raises(NotSolvableError, match="refactor"):
        made.solve(FREE * 1.0)
    again = csr_matrix(2.0 * MATRIX)
    made.refactor(again)
    assert np.abs(again @ made.solve(FREE * 1.0) - FREE)[FREE].max() < 1e-12


def test_a_matrix_that_is_singular_between_them_is_refused():
    """Its singular direction is left to the Schur complement, of which the factorisation before
    says nothing.
    """
    values = MATRIX.toarray()
    values[60:80] = values[:, 60:80] = 0.0
    values[60:80, 60:80] = 1.0
    with pytest.raises(NotSolvableError, match="singular"):
        factors(np.arange(55, 85), csr_matrix(values))


@pytest.mark.parametrize("place", [LAST[0], LAST[-1], 5])
def test_entries_that_are_no_numbers_are_refused(place):
    """Pivots before them are far from round-off."""
    values = MATRIX.toarray()
    values[place, place] = np.nan
    with pytest.raises(NotSolvableError, match="singular"):
        factors(LAST, csr_matrix(values))


@pytest.mark.parametrize(("last", "ordering"), [(None, "mumps"), (LAST, "mumps"), (None, "qmd")])
def test_pivots_of_either_sign_show_a_singular_matrix(last, ordering):
    """Springs between points that nothing holds: the last pivot is round-off, and about half of
    them are positive.

    With a spring of 1e-6 to the ground at one point the matrix is regular, and its condition is
    about 1e9.
    """
    free = np.ones(len(FREE), dtype=bool)
    made = sparse.FreeCholesky(
        MATRIX, free, slice(0, free.size), "cube", ordering, MPI.COMM_SELF, last=last
    )
    one, other = triu(MATRIX, 1).nonzero()
    for seed in range(20):
        modulus = np.random.default_rng(seed).uniform(1.0, 2.0, one.size)
        coupled = csr_matrix((modulus, (one, other)), shape=MATRIX.shape)
        coupled = coupled + coupled.T
        loose = csr_matrix(diags(np.asarray(coupled.sum(axis=1)).ravel()) - coupled)
        with pytest.raises(NotSolvableError, match="singular"):
            made.refactor(loose)
        held = csr_matrix(loose + csr_matrix(([1e-6], ([0], [0])), shape=loose.shape))
        made.refactor(held)
        assert made.solve(held @ np.ones(free.size)) == pytest.approx(1.0, abs=1e-5)


@needs("elasticity")
def test_without_the_functions_of_petsc_answers_are_the_same(monkeypatch):
    make = lambda: contract.blocks((3.0, "n"), box={"n": (0.1, 0.4)})  # noqa: E731
    with_them = hhr.FullOrderModel(make(), MPI.COMM_SELF)
    with monkeypatch.context() as patch:
        patch.setattr(schur, "_library", lambda: None)
        without = hhr.FullOrderModel(make(), MPI.COMM_SELF)
    assert with_them.store.first.last is not None and without.store.first.last is None
    for point in with_them.parameters.random(3, 0):
        one, other = (full.solve(point, gradient=True) for full in (with_them, without))
        check_like(one, other, forces=1e-10, displacement=1e-10)
        for of in ("multipliers", "unknown"):
            assert (
                largest_difference(getattr(one.gradient, of), getattr(other.gradient, of)) < 1e-10
            )


@needs("elasticity")
def test_an_answer_is_completed_after_another_point_was_factored():
    """What contact forces push takes a solution by factors of its own point, whoever has put others
    in their place.
    """
    full = hhr.FullOrderModel(contract.blocks((3.0, "n"), box={"n": (0.1, 0.4)}), MPI.COMM_SELF)
    first, second = full.parameters.random(2, 1)
    alone, contacts = full.solve(first), full.contacts()
    contact, _ = contacts(first), contacts(second)
    full.solve(second)
    response = contact.response_to_forces(alone.multipliers)
    check_like(full.solve(first), alone, displacement=1e-12)
    problem = full.problem.at(first)
    free = problem.held
    exact, load = np.zeros(len(free)), problem.contact.T @ alone.multipliers
    exact[free] = np.linalg.solve(problem.stiffness[free][:, free].toarray(), load[free])
    assert largest_difference(response, exact) < 1e-9


def test_compressed_factors_beside_others_leave_the_schur_complement():
    """2, -1 on 30 rows with the last one kept: what is left is 2 - 29/30.

    A PETSc before 3.23 keeps more memory.
    """
    upper = triu(diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(30, 30)), format="csr")
    pattern = Pattern(upper.indptr, upper.indices, np.arange(upper.nnz))
    own = Factors(
        pattern,
        upper.data,
        "few_",
        "mumps",
        MPI.COMM_SELF,
        low_rank=1e-10,
        last=np.array([29]),
        inverted=False,
    )
    assert own.factor()
    with own.left() as left:
        assert left[0, 0] == pytest.approx(2 - 29 / 30, rel=1e-13)
    own.destroy()
