"""Sparse Cholesky factors by PETSc, and the check that a stiffness holds its bodies."""

from __future__ import annotations

from collections.abc import Callable
from threading import RLock

import numpy as np
from petsc4py import PETSc

from hhr_dolfinx.contact.dense import factorised
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import NotSolvableError


def cholesky_solver(matrix: PETSc.Mat, ordering: str, prefix: str) -> PETSc.KSP:
    """A direct solver for a symmetric matrix, on any number of ranks; PETSc options can change how.

    Args:
        matrix: its values may change, its pattern not.
        ordering: of PETSc's own Cholesky; ``mumps`` takes MUMPS, which several ranks always need.
        prefix: of PETSc options.
    """
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    ksp = PETSc.KSP().create(matrix.comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setOperators(matrix)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    pc = ksp.getPC()
    pc.setType(PETSc.PC.Type.CHOLESKY)
    if ordering == "mumps" or matrix.comm.size > 1:
        pc.setFactorSolverType("mumps")
    else:
        pc.setFactorOrdering(ordering)
    ksp.setFromOptions()
    return ksp


def check_regular(problem: ContactProblem, solve: Callable[[np.ndarray], np.ndarray], scene: str) -> None:
    """Refuse a K that is singular to round-off, which a factorisation does not always notice.

    Solving for a known vector loses about cond(K) times 1e-16: up to 1e-5 was seen with bodies a million
    times as stiff as others, and all digits where parts can move freely.

    Args:
        problem: the full problem.
        solve: K^-1 on free dofs, (N,) -> (N,).
        scene: its name, for the message.

    Raises:
        NotSolvableError: if K is singular.
    """
    known = np.random.default_rng(0).standard_normal(problem.free.size) * problem.free
    found = solve(problem.stiffness @ known * problem.free)
    if not np.linalg.norm(found - known) <= 1e-3 * np.linalg.norm(known):
        raise NotSolvableError(singular_stiffness(scene))


def singular_stiffness(scene: str) -> str:
    """Message for a stiffness that is singular; ``checks.check_held`` has refused bodies that move as a whole."""
    return (
        f"the stiffness of scene '{scene}' is singular to round-off, though every body is held as a whole: look for "
        "parts that hang together at single nodes or edges, E many powers of ten apart, nu next to 0.5, needle-like "
        "cells"
    )


class FreeCholesky:
    """Factors of a stiffness on its free dofs, made for many refactorisations; serial.

    Who solves with factors that others may replace meanwhile holds ``lock`` and calls :meth:`refactor` before.

    Args:
        stiffness: K, CSR, (N, N).
        free: dofs that are not imposed, (N,) bool.
        scene: its name, for messages and the prefix of PETSc options.

    Attributes:
        lock: held while the factors are replaced or used; a thread may take it twice.

    Raises:
        NotSolvableError: if K is singular.
    """

    def __init__(self, stiffness, free: np.ndarray, scene: str):
        self._free, self._scene = np.flatnonzero(free), scene
        self._inside = stiffness[self._free][:, self._free]
        # place of each kept entry in the data of the whole matrix
        marks = stiffness.copy()
        marks.data = np.arange(1.0, marks.nnz + 1)
        self._places = (marks[self._free][:, self._free].data - 1).astype(np.int64)
        self._matrix = _petsc_matrix(self._inside)
        # factored again and again: 31 ms and 1.1 ms a solve at 13,700 dofs, against 53 and 1.4 ms with qmd
        self._ksp = cholesky_solver(self._matrix, "nd", f"hhr_{scene}_plastic_")
        if not factorised(self._ksp):
            raise NotSolvableError(singular_stiffness(scene))
        self._rhs, self._x = self._matrix.createVecs()
        self._size, self._factored, self.lock = free.size, stiffness, RLock()

    def refactor(self, stiffness) -> None:
        """Take the values of another matrix with the same pattern; no work if its factors are those at hand."""
        with self.lock:
            if stiffness is self._factored:
                return
            self._factored = None
            data = stiffness.data[self._places]
            self._matrix.setValuesCSR(self._inside.indptr, self._inside.indices, data)
            self._matrix.assemble()
            self._ksp.setOperators(self._matrix)
            if not factorised(self._ksp):
                raise NotSolvableError(
                    f"the tangent stiffness of the full model of scene '{self._scene}' is singular: it flows freely "
                    "beyond its limit load, or the slope of a law is wrong. Take smaller steps, or compare the slope "
                    "with differences of the flow"
                )
            self._factored = stiffness

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solution on all dofs, zero on imposed ones."""
        solution = np.zeros(self._size)
        with self.lock:
            self._rhs.array[:] = rhs[self._free]
            self._ksp.solve(self._rhs, self._x)
            solution[self._free] = self._x.array_r
        return solution


def _petsc_matrix(matrix) -> PETSc.Mat:
    """Copy of a CSR matrix on one rank."""
    return PETSc.Mat().createAIJ(matrix.shape, csr=(matrix.indptr, matrix.indices, matrix.data), comm=PETSc.COMM_SELF)
