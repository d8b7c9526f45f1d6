"""What is left of a matrix between rows that are eliminated last: the Schur complements of MUMPS.

Their inverse is K^-1 there (MUMPS users' guide, section on the Schur complement). PETSc has it in C, and petsc4py does
not wrap it: its functions are called in the library that petsc4py has loaded. Where they are missing whoever asks takes
solutions. All of it is for factors of one rank.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np
from petsc4py import PETSc

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


def eliminate_last(factor: PETSc.Mat, places: np.ndarray) -> bool:
    """Have a matrix that MUMPS is going to factor eliminate some rows last, (n,); whether that is possible."""
    library = _library()
    if library is None:
        return False
    chosen = PETSc.IS().createGeneral(places.astype(PETSc.IntType), comm=factor.comm)
    return library.MatFactorSetSchurIS(ctypes.c_void_p(factor.handle), ctypes.c_void_p(chosen.handle)) == 0


def invert_last(factor: PETSc.Mat) -> bool:
    """Make the inverse on the rows that were eliminated last; False where it is not positive definite."""
    library = _library()
    assert library is not None
    return library.MatFactorInvertSchurComplement(ctypes.c_void_p(factor.handle)) == 0


@contextmanager
def left_of(factor: PETSc.Mat, count: int) -> Iterator[np.ndarray]:
    """What is left of K on the ``count`` rows that were eliminated last: PETSc's own, not to be written to.

    Their inverse, where that was made, (count, count); else the triangle of it above the diagonal: what is below is not
    always zero.

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
        raise MemoryError("PETSc does not hand out what is left of a matrix between the dofs of contact")
    try:
        yield np.ctypeslib.as_array(values, shape=(count, count))
    finally:
        library.MatDenseRestoreArrayRead(matrix, ctypes.byref(values))
        library.MatFactorRestoreSchurComplement(handle, ctypes.byref(matrix), status)
