"""One eigenvalue of a symmetric matrix, even if others are close to it.

On free meshes the smallest eigenvalues of B B^T lie within 1e-5 of each other. A small subspace does not separate
them, although any of them would do: only the value is needed, not its vector. LAPACK computes those of small matrices
without difficulty; a large matrix gets a wide subspace, and a looser tolerance if the strict one is not reached.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slepc4py import SLEPc

DENSE = 1000
"""Rows up to which LAPACK finds all eigenvalues, in half a second: SLEPc may take as long for a single one."""
SUBSPACE = 64
"""Vectors of the subspace. Of 216 rows of mortar on tetrahedra 16 vectors needed 475 restarts, and 64 vectors 4."""
TOLERANCES = (1e-10, 1e-5, 1e-3)
"""Relative residuals, tried in this order: some eigenvalue is as near as the residual."""
RESTARTS = 50
"""Restarts for each tolerance."""


def extreme_eigenvalue(prepared: Callable[[], SLEPc.EPS]) -> tuple[float, float] | None:
    """The eigenvalue for which SLEPc solvers are set up, and its relative residual; None if they find none.

    ``prepared`` returns a new solver: one that has failed keeps its count of restarts, and would stop at once.
    """
    from slepc4py import SLEPc

    for tolerance in TOLERANCES:
        solver = prepared()
        solver.setDimensions(1, SUBSPACE)
        solver.setTolerances(tolerance, RESTARTS)
        solver.setFromOptions()
        solver.solve()
        if solver.getConverged():
            residual = solver.computeError(0, SLEPc.EPS.ErrorType.RELATIVE)
            return float(solver.getEigenvalue(0).real), float(residual)
    return None
