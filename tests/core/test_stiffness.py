"""Stiffness at a point as a value, and the store that its factors are leased from."""

import numpy as np
import pytest
from needs import needs
from scenes import pressed_pair
from threads import THREADS, at_once

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.stiffness import FactorStore, SparseStiffness
from hhr_dolfinx.errors import NotSolvableError

pytestmark = pytest.mark.usefixtures("restless")

BOTH = (("E1", 0.3), ("E2", 0.3)), {"E1": (2.0, 4.0), "E2": (2.0, 5.0)}


@pytest.fixture(scope="module")
def full():
    """Two blocks, each with a modulus of its own."""
    return hhr.FullOrderModel(pressed_pair("plane_strain", *BOTH))


@pytest.fixture(scope="module")
def matrices(full):
    """K at eight points, and by dense algebra S of each, (8, m, m)."""
    problem, free = full.problem, full.problem.free
    found = [problem.at(point).own_stiffness for point in full.parameters.random(THREADS, 1)]
    rows = problem.contact[:, free].toarray()
    return found, [rows @ np.linalg.solve(one.toarray()[np.ix_(free, free)], rows.T) for one in found]


def counting(full):
    """What makes factors, and the list of those it has made."""
    made = []

    def make(matrix):
        made.append(full.factors_of(matrix, "nd"))
        return made[-1]

    return make, made


def stiffness(full, matrix, store, kind=SparseStiffness):
    return kind(matrix, full.problem, store)


@pytest.mark.parametrize("most", [1, 2, THREADS])
def test_threads_share_a_store(most, full, matrices):
    """Each solves with its own matrix, bit by bit as one thread, and S is that of dense algebra; the store has room."""
    make, made = counting(full)
    store, loads = FactorStore(make, most), np.linspace(-1.0, 1.0, full.problem.free.size)

    def job(k):
        one = stiffness(full, matrices[0][k], store)
        solved = [one.solve(loads) for _ in range(4)]
        return np.concatenate([*solved, one.schur.ravel(), one.response_to_forces(np.ones(full.conditions))])

    expected = [job(k) for k in range(THREADS)]
    for found, known in zip(at_once([lambda k=k: job(k) for k in range(THREADS)]), expected, strict=True):
        assert found.tobytes() == known.tobytes()
    for k, schur in enumerate(matrices[1]):
        found = stiffness(full, matrices[0][k], store).schur
        assert np.abs(found - schur).max() <= 1e-12 * np.abs(schur).max()
    assert len(made) == most


def test_what_is_in_the_store_is_not_factored_again(full, matrices):
    """The matrix that was not used for longest gives way."""
    make, made = counting(full)
    store = FactorStore(make, 2)
    first, second, third = matrices[0][:3]
    for matrix in (first, second, first):
        with store.of(matrix):
            pass
    assert [item.holds(matrix) for item, matrix in zip(made, (first, second), strict=True)] == [True, True]
    with store.of(third) as factors:
        assert factors is made[1] and factors.holds(third)
    with store.of(first) as factors:
        assert factors is made[0]


def test_a_thread_leases_one_matrix_at_a_time(full, matrices):
    """The same one again within its lease; another one is refused, since threads would wait for each other."""
    store = FactorStore(counting(full)[0], 2)
    one, other = matrices[0][:2]
    with store.of(one) as factors:
        with store.of(one) as again:
            assert again is factors
        with pytest.raises(RuntimeError, match="factors of two matrices are leased"), store.of(other):
            pass
        assert factors.holds(one)
    with store.of(other) as factors:
        assert factors.holds(other)


def test_a_refused_matrix_leaves_the_store_as_it_was(full, matrices):
    """Behind one that is singular others are factored, by the same thread and by others."""
    store = FactorStore(counting(full)[0])
    good = stiffness(full, matrices[0][0], store)
    expected, singular = good.solve(np.ones(full.problem.free.size)), good.matrix.copy()
    singular.data[:] = 0.0
    with pytest.raises(NotSolvableError):
        stiffness(full, singular, store).solve(np.ones(full.problem.free.size))
    for found in at_once([lambda: good.solve(np.ones(full.problem.free.size))] * 2):
        np.testing.assert_array_equal(found, expected)


@needs("inelastic")
def test_lazy_columns_are_those_of_s(full, matrices):
    """Of the conditions that were active; forces elsewhere are none."""
    from hhr_dolfinx.plugins.inelastic.lazy_stiffness import LazyStiffness

    store = FactorStore(counting(full)[0])
    lazy = stiffness(full, matrices[0][0], store, LazyStiffness)
    active = np.arange(full.conditions) < 3
    forces, slack = lazy.equalities(active, -np.ones(full.conditions))
    known = stiffness(full, matrices[0][0], store)
    for mine, other in zip((forces, slack), known.equalities(active, -np.ones(full.conditions)), strict=True):
        assert np.abs(mine - other).max() <= 1e-12 * np.abs(other).max()
    expected = known.response_to_forces(forces)
    assert np.abs(lazy.response_to_forces(forces) - expected).max() <= 1e-12 * np.abs(expected).max()
