"""Constants of ellipticity on spectra whose eigenvalues lie close."""

import numpy as np
import pytest
from scipy.sparse import diags

from hhr_dolfinx.certify import eigenvalues
from hhr_dolfinx.certify.constants import smallest_singular_value
from hhr_dolfinx.errors import NotSolvableError
from hhr_dolfinx.plugins.theorems import ellipticity
from hhr_dolfinx.plugins.theorems.ellipticity import largest_eigenvalue, smallest_eigenvalue


def clustered(size, width):
    """Eigenvalues of which half lie within a small width from 1 on, and the others up to 2."""
    rng = np.random.default_rng(0)
    values = 1 + width * np.sort(rng.random(size))
    values[size // 2 :] += rng.random(size - size // 2)
    return values


@pytest.mark.parametrize("width", [1e-3, 1e-5, 1e-7])
@pytest.mark.parametrize("size", [216, 3000])
def test_eigenvalues_that_lie_close(size, width):
    """LAPACK finds those of few rows to round-off; of 3000 rows the value is as near as the second tolerance, 1e-5."""
    values = clustered(size, width)
    accuracy = 1e-12 if size <= eigenvalues.DENSE else eigenvalues.TOLERANCES[1]
    matrix, turned = diags(values).tocsr(), diags(5 - values).tocsr()
    assert smallest_singular_value(diags(np.sqrt(values)).tocsr()) == pytest.approx(np.sqrt(values.min()), rel=accuracy)
    assert smallest_eigenvalue(matrix, lambda rhs: rhs / values) == pytest.approx(values.min(), rel=accuracy)
    assert largest_eigenvalue(turned) == pytest.approx(5 - values.min(), rel=accuracy)


def test_bounds_stay_on_the_safe_side_of_eigenvalues_that_lie_close():
    """Continuity is not below the largest eigenvalue, and coercivity not above the smallest one."""
    values = clustered(3000, 1e-3)
    assert largest_eigenvalue(diags(5 - values).tocsr()) >= 5 - values.min()
    assert smallest_eigenvalue(diags(values).tocsr(), lambda rhs: rhs / values) <= values.min()


def test_an_eigenvalue_of_k_that_is_not_found_is_named(monkeypatch):
    """Theorems need their constants, and say so."""
    monkeypatch.setattr(ellipticity, "DENSE", 0)
    monkeypatch.setattr(ellipticity, "extreme_eigenvalue", lambda prepared: None)
    with pytest.raises(NotSolvableError, match="no eigenvalue of K"):
        largest_eigenvalue(diags(np.ones(3)).tocsr())
