"""Small dense systems, factored once and solved often.

Two backends with the same call: a PETSc KSP (``preonly`` with LU), which takes options on the command line
with the prefix ``hhr_dense_``, and LAPACK itself, which serves as its measure.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Protocol

import numpy as np
from petsc4py import PETSc
from scipy.linalg.lapack import dgetrf, dgetrs

from hhr_dolfinx.errors import NotSolvableError, SingularError


class Factor(Protocol):
    """LU factors of a dense matrix."""

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve for one right-hand side, (n,); the result may be a buffer that the next call overwrites."""

    def refactor(self, matrix: np.ndarray) -> None:
        """Replace the factors by those of another matrix of the same size.

        Raises:
            NotSolvableError: if the matrix is singular or not finite.
        """


Factorise = Callable[[np.ndarray], Factor]


_PREFIX = "hhr_dense_"
_MISSING_PACKAGE = 92  # PETSC_ERR_MISSING_FACTOR


@lru_cache(maxsize=1)
def _user_options() -> bool:
    """Whether there are options for dense solves; asking PETSc for each block took a third of its time."""
    return bool(PETSc.Options(_PREFIX).getAll())


@lru_cache(maxsize=512)
def _buffers(n: int):
    """Right-hand side and solution of size n with their PETSc vectors, shared by all factors of that size."""
    rhs, solution = np.zeros(n), np.zeros(n)
    vectors = [PETSc.Vec().createWithArray(array, comm=PETSc.COMM_SELF) for array in (rhs, solution)]
    return rhs, solution, *vectors


def factorised(ksp: PETSc.KSP) -> bool:
    """Let a direct solver factor its matrix; False if the matrix is singular.

    Raises:
        NotSolvableError: if PETSc was built without the package that should factor it.
    """
    try:
        ksp.setUp()
    except PETSc.Error as error:
        if error.ierr == _MISSING_PACKAGE:
            raise NotSolvableError(f"this PETSc lacks the package that should factor a matrix: {error}") from error
        return False
    return ksp.getPC().getFailedReason() == 0


class PetscLU:
    """LU factors by LAPACK inside a PETSc KSP.

    Args:
        matrix: (n, n), need not be symmetric.

    Raises:
        NotSolvableError: if the matrix is singular or not finite.
    """

    def __init__(self, matrix: np.ndarray):
        n = matrix.shape[0]
        self._values = np.zeros((n, n), order="F")
        self._mat = PETSc.Mat().createDense((n, n), array=self._values, comm=PETSc.COMM_SELF)
        self._ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        self._ksp.getPC().setType(PETSc.PC.Type.LU)
        if _user_options():
            self._ksp.setOptionsPrefix(_PREFIX)
            self._ksp.setFromOptions()
        self._rhs, self._solution, self._b, self._x = _buffers(n)
        self.refactor(matrix)

    def refactor(self, matrix: np.ndarray) -> None:
        """Factor another matrix of the same size; half the time of a new object."""
        _check_finite(matrix)
        self._values[:] = matrix
        self._mat.assemble()
        self._ksp.setOperators(self._mat)
        if not factorised(self._ksp):
            raise SingularError(_singular(matrix.shape[0]))

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve for one right-hand side, (n,). The result is a buffer that the next call overwrites."""
        self._rhs[:] = rhs
        self._ksp.solve(self._b, self._x)
        return self._solution


class LapackLU:
    """LU factors by LAPACK; see :class:`PetscLU`."""

    def __init__(self, matrix: np.ndarray):
        self.refactor(matrix)

    def refactor(self, matrix: np.ndarray) -> None:
        """Factor a matrix."""
        _check_finite(matrix)
        self._factors, self._pivots, info = dgetrf(matrix)
        if info > 0:
            raise SingularError(_singular(matrix.shape[0]))

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve for one right-hand side, (n,), or several, (n, m)."""
        return dgetrs(self._factors, self._pivots, rhs)[0]


def solve_columns(factor: Factor, rhs: np.ndarray) -> np.ndarray:
    """Solve for every column of ``rhs``, (n, m)."""
    solution = np.empty_like(rhs, order="F")
    for k, column in enumerate(rhs.T):
        solution[:, k] = factor.solve(column)
    return solution


def _check_finite(matrix):
    if not np.isfinite(matrix).all():
        raise NotSolvableError(f"a dense block of size {matrix.shape[0]} is not finite: check materials and loads")


def _singular(n):
    return (
        f"a dense block of size {n} is singular: the contact rows are dependent on this basis, "
        "thesis (1.67); add modes or use fewer contact points in the RID"
    )
