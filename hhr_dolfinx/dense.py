"""Small dense systems, solved by a PETSc KSP that is factored once (``preonly`` with LU)."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from hhr_dolfinx.errors import NotSolvableError


class DenseLU:
    """LU factors of a dense matrix, by LAPACK inside PETSc.

    Args:
        matrix: (n, n), need not be symmetric.

    Raises:
        NotSolvableError: if the matrix is singular or not finite.
    """

    def __init__(self, matrix: np.ndarray):
        n = matrix.shape[0]
        if not np.isfinite(matrix).all():
            raise NotSolvableError(f"a dense block of size {n} is not finite: check materials and loads")
        mat = PETSc.Mat().createDense((n, n), array=np.array(matrix, dtype=float, order="F"), comm=PETSc.COMM_SELF)
        mat.assemble()
        self._ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        self._ksp.setOptionsPrefix("hhr_dense_")
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        self._ksp.getPC().setType(PETSc.PC.Type.LU)
        self._ksp.setOperators(mat)
        self._ksp.setFromOptions()
        self._rhs = np.zeros(n)
        self._solution = np.zeros(n)
        self._b = PETSc.Vec().createWithArray(self._rhs, comm=PETSc.COMM_SELF)
        self._x = PETSc.Vec().createWithArray(self._solution, comm=PETSc.COMM_SELF)
        try:
            self._ksp.setUp()
            failed = self._ksp.getPC().getFailedReason() != 0
        except PETSc.Error:
            failed = True
        if failed:
            raise NotSolvableError(
                f"a dense block of size {n} is singular: the contact rows are dependent on this basis, "
                "thesis (1.67); add modes or use fewer contact points in the RID"
            )

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve for one right-hand side, (n,). The result is a buffer that the next call overwrites."""
        self._rhs[:] = rhs
        self._ksp.solve(self._b, self._x)
        return self._solution

    def solve_columns(self, rhs: np.ndarray) -> np.ndarray:
        """Solve for every column of (n, m)."""
        solution = np.empty_like(rhs)
        for k, column in enumerate(rhs.T):
            solution[:, k] = self.solve(column)
        return solution
