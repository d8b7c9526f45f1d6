"""Schur complements of MUMPS on the rows that are eliminated last.

The inverse of a Schur complement is K^-1 between these rows (MUMPS users' guide, section on the
Schur complement). petsc4py does not wrap the functions of PETSc for it: they are called in the C
library that petsc4py has loaded. Without them callers compute K^-1 by solutions. All of this is for
factors on one rank.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np
from petsc4py import PETSc

_FUNCTIONS = (
    "MatFactorSetSchurIS MatFactorInvertSchurComplement MatFactorGetSchurComplement "
    "MatFactorRestoreSchurComplement MatDenseGetArrayRead MatDenseRestoreArrayRead"
).split()


@cache
def _library() -> ctypes.CDLL | None:
    """Library of PETSc, or None if it lacks one of the functions or its numbers are not real."""
    try:
        library = ctypes.CDLL(PETSc.__file__)
        for name in _FUNCTIONS:
            getattr(library, name).restype = ctypes.c_int
    except (OSError, AttributeError):
        return None
    return library if PETSc.ScalarType == np.float64 else None


def eliminate_last(factor: PETSc.Mat, places: np.ndarray) -> bool:
    """Make MUMPS eliminate some rows, (n,), last when it factors a matrix.

    Args:
        factor: factor matrix of PETSc, not yet factored.
        places: indices of the rows, (n,).

    Returns:
        False if that is impossible.
    """
    library = _library()
    if library is None:
        return False
    chosen = PETSc.IS().createGeneral(places.astype(PETSc.IntType), comm=factor.comm)
    return (
        library.MatFactorSetSchurIS(ctypes.c_void_p(factor.handle), ctypes.c_void_p(chosen.handle))
        == 0
    )


def invert_last(factor: PETSc.Mat) -> bool:
    """Invert the Schur complement on the rows that were eliminated last.

    False if it is not positive definite.
    """
    library = _library()
    assert library is not None
    return library.MatFactorInvertSchurComplement(ctypes.c_void_p(factor.handle)) == 0


@contextmanager
def left_of(factor: PETSc.Mat, count: int) -> Iterator[np.ndarray]:
    """Schur complement on the rows that were eliminated last, or its inverse.

    Args:
        factor: factor matrix of PETSc.
        count: number of these rows.

    Yields:
        PETSc's read-only array, (count, count). Of the complement only the upper triangle is valid.

    Raises:
        MemoryError: if PETSc does not return the array.
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
        raise MemoryError(
            "PETSc does not hand out what is left of a matrix between the dofs of contact"
        )
    try:
        yield np.ctypeslib.as_array(values, shape=(count, count))
    finally:
        library.MatDenseRestoreArrayRead(matrix, ctypes.byref(values))
        library.MatFactorRestoreSchurComplement(handle, ctypes.byref(matrix), status)
