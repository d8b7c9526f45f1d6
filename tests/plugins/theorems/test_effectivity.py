"""The effectivity of the bound of forces from above: attained, never exceeded."""

import numpy as np
import pytest
from scipy import linalg, optimize

from hhr_dolfinx.plugins.theorems.effectivity import largest_effectivity


def definite(rng, m):
    root = rng.standard_normal((m, m + 3))
    return root @ root.T / m + 0.02 * np.eye(m)


def solved(schur, free):
    """Forces by non-negative least squares of the root of S."""
    root = linalg.cholesky(schur)
    return optimize.nnls(root, linalg.solve_triangular(root, -free, trans=1))[0]


@pytest.mark.parametrize("seed", range(6))
def test_it_is_attained_and_never_exceeded(seed):
    rng = np.random.default_rng(seed)
    m = 9
    schur = definite(rng, m)
    closed = rng.random(m) < 0.5
    closed[:2] = True, False
    limit = largest_effectivity(schur, closed)
    own = schur[np.ix_(closed, closed)]
    outer = np.linalg.inv(schur)[np.ix_(closed, closed)]
    values, vectors = linalg.eigh(outer, np.linalg.inv(own))
    assert values[-1] ** 0.5 == pytest.approx(limit, rel=1e-9)
    for r in (vectors[:, -1], *rng.standard_normal((20, closed.sum()))):
        ratio = np.sqrt(r @ outer @ r / (r @ np.linalg.solve(own, r)))
        assert 1 - 1e-9 <= ratio <= limit * (1 + 1e-9)
    assert largest_effectivity(schur, np.ones(m, dtype=bool)) == 1.0
    assert largest_effectivity(schur, np.zeros(m, dtype=bool)) == 1.0


@pytest.mark.parametrize("seed", range(6))
def test_bounds_of_forces_of_an_interpolated_s_stay_below_it(seed):
    """λ' solves the contact problem of another S, near enough to have the statuses of λ."""
    rng = np.random.default_rng(20 + seed)
    m = 8
    schur = definite(rng, m)
    free = rng.standard_normal(m)
    exact = solved(schur, free)
    off = rng.standard_normal((m, m))
    other = schur + 1e-5 * (off + off.T)
    found = solved(other, free)
    closed = exact > 0
    assert np.array_equal(found > 0, closed)
    slack = free + schur @ found
    assert slack[~closed].min() > 0
    residual = np.where((found > 0) | (slack < 0), slack, 0.0)
    error = np.sqrt((found - exact) @ schur @ (found - exact))
    bound = np.sqrt(residual @ np.linalg.solve(schur, residual))
    assert error * (1 - 1e-6) <= bound <= error * largest_effectivity(schur, closed) * (1 + 1e-6)
