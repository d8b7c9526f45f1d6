"""Continuity and coercivity of a(v, w) = v^T K w: by the formulas of the thesis, and by
eigenvalues.

LAPACK finds the eigenvalues of small matrices, SLEPc those of large ones: no dense matrix of the
size of the mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from scipy import linalg
from scipy.sparse import csr_matrix

from hhr_dolfinx.errors import BoundError, NotSolvableError
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.plugins.theorems.full_constants import DENSE, extreme_eigenvalue

if TYPE_CHECKING:
    from petsc4py import PETSc

    from hhr_dolfinx.body import Body


@dataclass(frozen=True)
class Ellipticity:
    """Constants of a in some norm.

    |a(v, w)| <= M_a |v| |w|, (2.7), and a(v, v) >= alpha |v|^2, (2.9).

    Attributes:
        continuity: M_a.
        coercivity: alpha.
    """

    continuity: float
    coercivity: float

    @classmethod
    def of(cls, full: FullModel) -> Ellipticity:
        """Constants of a full model in the Euclidean norm of nodal values.

        They are those in the middle of the box, and cached with the model.

        Raises:
            BoundError: if ranks share the factors of K.
        """
        if full in _KNOWN:
            return _KNOWN[full]
        problem = full.problem
        size = problem.free.size
        if len(full.per_force) != size:
            raise BoundError(
                "ranks share the factors of K, and its constants need whole columns: build on "
                "MPI.COMM_SELF"
            )
        free = np.flatnonzero(problem.free)
        _KNOWN[full] = of_stiffness(
            problem.stiffness[free][:, free], on_dofs(full.stiffness.solve, free, size)
        )
        return _KNOWN[full]

    @classmethod
    def of_materials(cls, bodies: Iterable[Body]) -> Ellipticity:
        """Constants of materials by (2.143) and (2.144).

        The largest 2 (lambda + mu) and the smallest 2 mu of all bodies.

        These are constants of a in the norm of the strain in the plane. The thesis takes them for
        those in the Euclidean norm of nodal values, in which they are constants for no mesh: see
        docs/bounds_thesis.md.

        Raises:
            BoundError: if moduli depend on parameters or on the place.
        """
        pairs = [_moduli(body) for body in bodies]
        return cls(max(pair[0] for pair in pairs), min(pair[1] for pair in pairs))

    def scaled(self, factor: float) -> Ellipticity:
        """Both constants times a number, as for another unit."""
        return Ellipticity(factor * self.continuity, factor * self.coercivity)


_KNOWN: WeakKeyDictionary[FullModel, Ellipticity] = WeakKeyDictionary()


def of_stiffness(stiffness: csr_matrix, solve: Callable[[np.ndarray], np.ndarray]) -> Ellipticity:
    """Constants of a symmetric K in the Euclidean norm.

    Args:
        stiffness: K on free dofs, (n, n).
        solve: K^-1 times a vector, (n,).
    """
    return Ellipticity(largest_eigenvalue(stiffness), smallest_eigenvalue(stiffness, solve))


def smallest_eigenvalue(
    matrix: csr_matrix, solve: Callable[[np.ndarray], np.ndarray], gram: csr_matrix | None = None
) -> float:
    """Lower bound of the smallest eigenvalue of K v = alpha G v, by K^-1 of a vector.

    Args:
        matrix: K, (n, n).
        solve: K^-1 times a vector, (n,).
        gram: G, (n, n); None for the identity.
    """
    if matrix.shape[0] <= DENSE:
        return float(linalg.eigvalsh(matrix.toarray(), None if gram is None else gram.toarray())[0])
    value, residual = _extreme(matrix, gram, solve)
    return value * (1 - residual)


def largest_eigenvalue(matrix: csr_matrix) -> float:
    """Upper bound of the largest eigenvalue of a symmetric matrix, (n, n)."""
    if matrix.shape[0] <= DENSE:
        return float(linalg.eigvalsh(matrix.toarray())[-1])
    value, residual = _extreme(matrix)
    return value * (1 + residual)


class _Inverse:
    """K^-1 as a preconditioner of PETSc."""

    def __init__(self, solve: Callable[[np.ndarray], np.ndarray]) -> None:
        self._solve = solve

    def apply(self, _: PETSc.PC, rhs: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Write K^-1 times a vector into another, for PETSc.

        Args:
            _: the preconditioner, unused.
            rhs: the vector, (n,).
            solution: receives the result, (n,).
        """
        solution.array[:] = self._solve(rhs.array_r)


def _extreme(
    matrix: csr_matrix,
    gram: csr_matrix | None = None,
    solve: Callable[[np.ndarray], np.ndarray] | None = None,
) -> tuple[float, float]:
    """The smallest eigenvalue by shift and invert with K^-1, or the largest without.

    And its relative residual.
    """
    from petsc4py import PETSc
    from slepc4py import SLEPc

    operators = [_petsc(operator) for operator in (matrix, gram) if operator is not None]

    def prepared() -> SLEPc.EPS:
        solver = SLEPc.EPS().create(PETSc.COMM_SELF)
        solver.setOptionsPrefix("hhr_ellipticity_")
        solver.setOperators(*operators)
        solver.setProblemType(
            SLEPc.EPS.ProblemType.HEP if gram is None else SLEPc.EPS.ProblemType.GHEP
        )
        if solve is None:
            solver.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_REAL)
            return solver
        solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        solver.setTarget(0.0)
        transform = solver.getST()
        transform.setType(SLEPc.ST.Type.SINVERT)
        transform.getKSP().setType("preonly")
        preconditioner = transform.getKSP().getPC()
        preconditioner.setType("python")
        preconditioner.setPythonContext(_Inverse(solve))
        return solver

    if (eigenvalue := extreme_eigenvalue(prepared)) is None:
        raise NotSolvableError(
            "SLEPc found no eigenvalue of K: look for moduli many powers of ten apart"
        )
    return eigenvalue


def _petsc(matrix: csr_matrix) -> PETSc.Mat:
    from petsc4py import PETSc

    matrix = csr_matrix(matrix)
    matrix.sort_indices()
    return PETSc.Mat().createAIJ(
        matrix.shape, csr=(matrix.indptr, matrix.indices, matrix.data), comm=PETSc.COMM_SELF
    )


def on_dofs(
    solve: Callable[[np.ndarray], np.ndarray], dofs: np.ndarray, size: int
) -> Callable[..., np.ndarray]:
    """Solver on some dofs, from a solver for vectors of all dofs.

    Args:
        solve: solves for vectors of all dofs, (size,).
        dofs: these dofs, (n,).
        size: number of all dofs.
    """

    def solved(rhs: np.ndarray) -> np.ndarray:
        padded = np.zeros(size)
        padded[dofs] = rhs
        return solve(padded)[dofs]

    return solved


def _moduli(body: Body) -> tuple[float, float]:
    """2 (lambda + mu) and 2 mu of a body."""
    if (
        body.grading is not None
        or not isinstance(body.young, Real)
        or not isinstance(body.poisson, Real)
    ):
        raise BoundError(
            f"moduli of body {body.tag} depend on parameters or on the place: (2.143) takes numbers"
        )
    young = float(body.young)
    poisson = float(body.poisson)
    shear = 0.5 * young / (1 + poisson)
    return 2 * (young * poisson / ((1 + poisson) * (1 - 2 * poisson)) + shear), 2 * shear
