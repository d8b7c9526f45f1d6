"""Small dense systems, factored once and solved often, by objects that several threads may use.

A PETSc KSP (``preonly`` with LU) takes options on the command line with the prefix ``hhr_dense_``;
LAPACK itself is the reference in tests and the fallback without PETSc.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from threading import Lock
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs, dpotrf, dpotrs

from hhr_dolfinx.errors import HHRError, NotSolvableError, SingularError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from petsc4py import PETSc


@lru_cache(maxsize=1)
def petsc() -> Any:
    """The module PETSc, loaded at first use.

    None on a machine without it, which can only evaluate models.
    """
    try:
        from petsc4py import PETSc
    except ImportError:
        return None
    return PETSc


class Factor(Protocol):
    """Factors of a dense matrix."""

    @property
    def nbytes(self) -> int:
        """Memory of the factors, in bytes."""

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve for one right-hand side, (n,); the result is a new array."""

    def refactor(self, matrix: np.ndarray) -> None:
        """Factor another matrix of the same size.

        SingularError, or NotSolvableError if it is not finite.
        """


Factorise = Callable[[np.ndarray], Factor]


def dense_factors(matrix: np.ndarray) -> Factor:
    """LU factors by PETSc, or by LAPACK on a machine without petsc4py."""
    return LapackLU(matrix) if petsc() is None else PetscLU(matrix)


_PREFIX = "hhr_dense_"
_MISSING_PACKAGE = 92  # PETSC_ERR_MISSING_FACTOR
_OBJECTS = 22_000
"""Bytes of the PETSc objects of one factor without its numbers (measured with n = 1)."""


def factorised(ksp: PETSc.KSP) -> bool:
    """Factor the matrix of a direct solver.

    Returns:
        False if the matrix is singular.

    Raises:
        NotSolvableError: without the package of PETSc that factors it.
    """
    try:
        ksp.setUp()
    except petsc().Error as error:
        if error.ierr == _MISSING_PACKAGE:
            raise NotSolvableError(
                f"this PETSc lacks the package that should factor a matrix: {error}"
            ) from error
        return False
    return ksp.getPC().getFailedReason() == 0


class PetscLU:
    """LU factors by LAPACK inside a PETSc KSP.

    HHRError if petsc4py is not installed, else see :class:`Factor`.
    """

    def __init__(self, matrix: np.ndarray):
        PETSc = petsc()
        if PETSc is None:
            raise HHRError(
                "petsc4py is not installed: give LapackLU, or no factorisation at all, for LAPACK"
            )
        n = matrix.shape[0]
        self._values = np.zeros((n, n), order="F")
        self._mat = PETSc.Mat().createDense((n, n), array=self._values, comm=PETSc.COMM_SELF)
        self._ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        self._ksp.getPC().setType(PETSc.PC.Type.LU)
        # the lookup takes 1 us; without options, setting them would take 10 of 50 us
        if PETSc.Options(_PREFIX).getAll():
            self._ksp.setOptionsPrefix(_PREFIX)
            self._ksp.setFromOptions()
        self._rhs = np.zeros(n)
        self._solution = np.zeros(n)
        self._b, self._x = (
            PETSc.Vec().createWithArray(array, comm=PETSc.COMM_SELF)
            for array in (self._rhs, self._solution)
        )
        # the matrix and its factors, the two vectors
        self.nbytes = 2 * self._values.nbytes + 2 * self._rhs.nbytes + _OBJECTS
        self._lock = Lock()
        self.refactor(matrix)

    def refactor(self, matrix: np.ndarray) -> None:
        """Factor another matrix of the same size, in half the time of a new object.

        Raises:
            SingularError: if the matrix is singular.
        """
        _check_finite(matrix)
        with self._lock:
            self._values[:] = matrix
            self._mat.assemble()
            self._ksp.setOperators(self._mat)
            if not factorised(self._ksp):
                raise _singular(matrix.shape[0])

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve for one right-hand side, (n,)."""
        with self._lock:
            self._rhs[:] = rhs
            self._ksp.solve(self._b, self._x)
            return self._solution.copy()


class LapackLU:
    """LU factors by LAPACK; see :class:`PetscLU`."""

    def __init__(self, matrix: np.ndarray):
        self._lock = Lock()
        self.refactor(matrix)

    @property
    def nbytes(self) -> int:
        """Memory of the factors."""
        return sum(array.nbytes for array in self._factors)

    def refactor(self, matrix: np.ndarray) -> None:
        """Factor a matrix.

        Raises:
            SingularError: if the matrix is singular.
        """
        _check_finite(matrix)
        factors, pivots, info = dgetrf(matrix)
        if info > 0:
            raise _singular(matrix.shape[0])
        with self._lock:
            self._factors = factors, pivots

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve for one right-hand side, (n,), or several, (n, m)."""
        # SciPy counts the pivots from 1 in place during the call of LAPACK
        with self._lock:
            return dgetrs(*self._factors, rhs)[0]


class LapackCholesky:
    """Cholesky factors by LAPACK of a symmetric block, half the work of LU.

    LU if it is not definite.
    """

    def __init__(self, matrix: np.ndarray):
        self.refactor(matrix)

    @property
    def nbytes(self) -> int:
        """Memory of the factors."""
        return self._other.nbytes if self._other is not None else self._factor.nbytes

    def refactor(self, matrix: np.ndarray) -> None:
        """Factor a matrix; only its upper triangle is read."""
        self._other: LapackLU | None = None
        self._factor, info = dpotrf(matrix, clean=0)
        # a NaN passes LAPACK and reaches the last pivot
        if info or not math.isfinite(self._factor[-1, -1]):
            self._other = LapackLU(matrix)

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve for one right-hand side, (n,), or several, (n, m)."""
        return dpotrs(self._factor, rhs)[0] if self._other is None else self._other.solve(rhs)


def solve_columns(factor: Factor, rhs: np.ndarray) -> np.ndarray:
    """Solve for every column of ``rhs``, (n, m).

    Args:
        factor: factors of a matrix, (n, n).
        rhs: right-hand sides, (n, m).
    """
    if isinstance(factor, LapackLU | LapackCholesky):
        return factor.solve(rhs)
    solution = np.empty_like(rhs, order="F")
    for k, column in enumerate(rhs.T):
        solution[:, k] = factor.solve(column)
    return solution


def _check_finite(matrix: np.ndarray) -> None:
    if not np.isfinite(matrix).all():
        raise NotSolvableError(
            f"a dense block of size {matrix.shape[0]} is not finite: check materials and loads"
        )


def _singular(n: int) -> SingularError:
    return SingularError(f"a dense block of size {n} is singular")


class GrowingColumns:
    """A matrix in Fortran order, (N, k), that gains columns at its end without a copy each time."""

    def __init__(self, matrix: np.ndarray) -> None:
        self._held = np.asfortranarray(matrix)
        self._count = matrix.shape[1]

    @property
    def all(self) -> np.ndarray:
        """The matrix."""
        return self._held[:, : self._count]

    def append(self, column: np.ndarray) -> None:
        """Append a column, (N,)."""
        if self._count == self._held.shape[1]:
            larger = np.empty((len(self._held), 2 * self._count + 16), order="F")
            larger[:, : self._count] = self._held
            self._held = larger
        self._held[:, self._count] = column
        self._count += 1


def lay_out(owner: DataclassInstance) -> None:
    """Copy arrays of a dataclass that are in neither C nor Fortran order to C order.

    For ``__post_init__``.

    Files and copies preserve these orders: in others, sums would differ in the last digits.
    """
    for name, value in vars(owner).items():
        if isinstance(value, np.ndarray) and not value.flags.forc:
            object.__setattr__(owner, name, np.ascontiguousarray(value))
