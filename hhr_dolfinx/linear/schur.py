"""K^-1 among a few dofs without a solution for each: by Schur complements of MUMPS.

Where these dofs are eliminated last what is left of K is its Schur complement on them, whose inverse is K^-1 there
(MUMPS users' guide, section on the Schur complement). PETSc has it in C, and petsc4py does not wrap it: its functions
are called in the library that petsc4py has loaded. Where they are missing whoever asks takes solutions.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np
from petsc4py import PETSc
from scipy.linalg import LinAlgError, cho_factor
from scipy.linalg.lapack import dpotri

_FUNCTIONS = (
    "MatFactorSetSchurIS", "MatFactorInvertSchurComplement", "MatFactorGetSchurComplement",
    "MatFactorRestoreSchurComplement", "MatDenseGetArrayRead", "MatDenseRestoreArrayRead",
)  # fmt: skip


@cache
def _library() -> ctypes.CDLL | None:
    """PETSc, if all is there that is called; numbers must be real."""
    try:
        found = ctypes.CDLL(PETSc.__file__)
        for name in _FUNCTIONS:
            getattr(found, name).restype = ctypes.c_int
    except (OSError, AttributeError):
        return None
    return found if PETSc.ScalarType == np.float64 else None


SCOTCH = 3
"""Ordering of MUMPS on several ranks: with that of METIS it ended in a segmentation fault where rows are eliminated
last, seen with MUMPS 5.8.2."""


def eliminate_last(factor: PETSc.Mat, places: np.ndarray) -> bool:
    """Have a matrix that MUMPS is going to factor eliminate some rows last, (n,); whether that is possible. Collective.

    What is left of several ranks is on the first one.
    """
    library = _library()
    if library is None:
        return False
    if factor.comm.size > 1:
        factor.setMumpsIcntl(28, 1)  # one rank orders
        factor.setMumpsIcntl(7, SCOTCH)
    own = places if factor.comm.rank == 0 else places[:0]
    chosen = PETSc.IS().createGeneral(own.astype(PETSc.IntType), comm=factor.comm)
    return library.MatFactorSetSchurIS(ctypes.c_void_p(factor.handle), ctypes.c_void_p(chosen.handle)) == 0


def invert_last(factor: PETSc.Mat) -> bool:
    """Make the inverse on the rows that were eliminated last, on one rank; False where it is not positive definite."""
    library = _library()
    assert library is not None
    return library.MatFactorInvertSchurComplement(ctypes.c_void_p(factor.handle)) == 0


def take_inverse(factor: PETSc.Mat, count: int) -> np.ndarray | None:
    """The inverse on these ``count`` rows of factors of several ranks: all of it on the first one, nothing on others.

    PETSc solves nothing with such factors. By them MUMPS solves for the other rows alone from here on, see its users'
    guide on ICNTL(26). None where the matrix is not positive definite. Collective.
    """
    comm = factor.comm.tompi4py()
    found: np.ndarray | None = np.zeros((0, count))
    if comm.rank == 0:
        with inverse_of_last(factor, count) as given:
            try:
                found = _inverse(given)
            except LinAlgError:
                found = None
    if not comm.bcast(found is not None):
        return None
    factor.setMumpsIcntl(19, 0)
    factor.setMumpsIcntl(26, 0)
    return found


def ask_again(factor: PETSc.Mat) -> None:
    """Before other values are factored: several ranks have what is left of them centralised."""
    factor.setMumpsIcntl(19, 1)


@contextmanager
def inverse_of_last(factor: PETSc.Mat, count: int) -> Iterator[np.ndarray]:
    """K^-1 on the rows that were eliminated last, (count, count), once it is made: PETSc's own, not to be written to.

    On several ranks, where it is not made, what is left of K on these rows: a triangle of it, on the first rank.

    Raises:
        MemoryError: if PETSc does not hand it out.
    """
    library = _library()
    assert library is not None
    handle = ctypes.c_void_p(factor.handle)
    matrix = ctypes.c_void_p()
    status = ctypes.c_int()
    values = ctypes.POINTER(ctypes.c_double)()
    failed = library.MatFactorGetSchurComplement(handle, ctypes.byref(matrix), ctypes.byref(status))
    failed = failed or library.MatDenseGetArrayRead(matrix, ctypes.byref(values))
    if failed:
        raise MemoryError("PETSc does not hand the inverse on the dofs of contact out")
    try:
        yield np.ctypeslib.as_array(values, shape=(count, count))  # symmetric
    finally:
        library.MatDenseRestoreArrayRead(matrix, ctypes.byref(values))
        library.MatFactorRestoreSchurComplement(handle, ctypes.byref(matrix), status)


def _inverse(given: np.ndarray) -> np.ndarray:
    """Inverse of a definite matrix of which one triangle is given; the other is zero, or what is left of other work."""
    lower = bool(np.tril(given, -1).any())
    factors, _ = cho_factor(np.asfortranarray(given), lower=lower, overwrite_a=True, check_finite=False)
    found, _ = dpotri(factors, lower=lower, overwrite_c=True)
    half = np.tril(found) if lower else np.triu(found).T
    return half + np.tril(half, -1).T
