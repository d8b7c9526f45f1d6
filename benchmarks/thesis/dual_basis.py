"""Theorems 1 and 2 of the thesis, (2.52), (2.53), (2.68) and (2.69), on models with a dual basis.

Theorem 1 is on a model of the plug-in rivals, theorem 2 on the reduced basis model (2.62) on the
RID of an HHR model, under hypothesis (H). Norms are those in which the constants are sharp: the
energy norm of displacements, in which M_a = alpha_Ker = 1, and |q|_S of forces with S = B K^-1 B^T,
in which M_b = 1 and, with the supremizers of the model of theorem 1, beta_RB = 1; V^0_HR has none,
and beta_RB enters theorem 2 by its inverse. The infimum of (2.52) and
(2.68) is that of the proof, over v for which v - u_RB lies in the kernel of b on the reduced
spaces, as for theorems 4 to 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy import linalg
from scipy.optimize import nnls
from scipy.sparse.linalg import splu

from hhr_dolfinx.certify.constants import inf_sup
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.plugins.rivals.projection import ConeModel, least_distance
from hhr_dolfinx.plugins.theorems.rid_norms import Domain
from hhr_dolfinx.plugins.theorems.theorems import ImposedInterface

DEPENDENT_FORCES = 1e-10
"""Part of the largest singular value of a cone below which its functions are dependent."""


class DualBounds(NamedTuple):
    """Both sides at points, (n, 2) each: left and right; and the inf-sup constant."""

    displacements: np.ndarray  #: (2.52) or (2.68), in energy
    forces: np.ndarray  #: (2.53) or (2.69), in the S norm
    beta_RB: float


@dataclass(frozen=True, eq=False)
class DualBasis:
    """Reduced spaces of displacements and forces, and the matrices of their norms.

    Attributes:
        stiffness: K, (N, N).
        basis: basis of displacements, (N, ell).
        rows: b on both bases, (r, ell).
        root: upper Cholesky factor of S, (m, m).
        cone: basis of forces, (m, r).
    """

    stiffness: Any
    basis: np.ndarray
    rows: np.ndarray
    root: np.ndarray
    cone: np.ndarray

    @cached_property
    def beta(self) -> float:
        """Inf-sup constant, (2.51) or (2.65), over the span of the cone, which may have dependent
        functions.
        """
        gram = self.basis.T @ (self.stiffness @ self.basis)
        span = linalg.orth(self._weighted, rcond=DEPENDENT_FORCES)
        rows = linalg.lstsq(self._weighted, span, cond=DEPENDENT_FORCES)[0].T @ self.rows
        return float(inf_sup(rows, gram, np.eye(len(rows))))

    @cached_property
    def _weighted(self) -> np.ndarray:
        weighted: np.ndarray = self.root @ self.cone
        return weighted

    @cached_property
    def _kernel(self) -> tuple[np.ndarray, Any]:
        """K times the kernel of b, (N, k), and factors of its Gram matrix."""
        kernel = self.basis @ linalg.null_space(self.rows)
        moved = self.stiffness @ kernel
        return moved, linalg.cho_factor(kernel.T @ moved)

    def sides(
        self, error: np.ndarray, forces: np.ndarray, exact: np.ndarray
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Left and right side of both inequalities.

        Args:
            error: error of the displacement, (N,).
            forces: forces of the model, (m,).
            exact: those of the full model, (m,).
        """
        moved, factor = self._kernel
        size = float(np.sqrt(error @ (self.stiffness @ error)))
        seen = moved.T @ error
        nearest = np.sqrt(max(size**2 - seen @ linalg.cho_solve(factor, seen), 0.0))
        outside = nnls(self._weighted, self.root @ exact)[1]
        off = float(np.linalg.norm(self.root @ (exact - forces)))
        return (size, 2 * nearest + outside), (
            off,
            (1 + 1 / self.beta) * outside + size / self.beta,
        )


def theorem_1(full: FullOrderModel, model: ConeModel, points: np.ndarray) -> DualBounds:
    """Both sides of (2.52) and (2.53) at points, (n, P).

    Args:
        full: the full model.
        model: a model with a dual basis of it.
        points: points of the box, (n, P).
    """
    problem = full.problem
    cone = model.fields.cone
    basis = model.fields.basis
    rows = cone.T @ (problem.contact @ basis)
    spaces = DualBasis(problem.stiffness, basis, rows, linalg.cholesky(full.schur), cone)
    found = []
    for point in points:
        answer = model.solve(point, outside="ignore")
        exact = full.solve(point)
        error = exact.displacement() - answer.displacement()
        found.append(spaces.sides(error, answer.forces(), exact.forces()))
    return _bounds(found, spaces)


def theorem_2(
    full: FullOrderModel, model: ReducedModel, cone: np.ndarray, points: np.ndarray
) -> DualBounds:
    """Both sides of (2.68) and (2.69) at points, (n, P), under (H): the interface of the RID has
    the displacements of the full model.

    Args:
        full: the full model.
        model: an HHR model of it, whose modes, cut off outside the RID, are the space V^0_HR.
        cone: basis of forces on all conditions, (N_lambda, r), which is restricted to the RID.
        points: points of the box, (n, P).
    """
    problem = full.problem
    sets = model.offline.sets
    domain = Domain.of(full, sets)
    imposed = ImposedInterface.of(problem, domain, model.offline.basis[sets.A])
    basis = imposed.space.vectors
    inside = cone[sets.A_lambda]
    inside = inside[:, inside.any(axis=0)]
    rows = inside.T @ imposed.contact
    acting = domain.acting.toarray()
    compliance = acting.T @ splu(domain.inner.tocsc()).solve(acting)
    spaces = DualBasis(domain.inner, basis, rows, linalg.cholesky(compliance), inside)
    found = []
    for point in points:
        exact = full.solve(point)
        theta = problem.amplitudes(point)
        lift = exact.unknown.copy()  # without imposed displacements, which loads and gaps have
        field = lift[sets.A].copy()
        lift[sets.A] = 0.0
        free = basis.T @ ((problem.loads @ theta)[sets.A] - domain.rows @ lift)
        gaps = problem.gaps[sets.A_lambda] @ theta - domain.contact @ lift
        kept, _ = least_distance(rows, inside.T @ gaps - rows @ free)
        assert kept is not None
        error = field - basis @ (free - rows.T @ kept)
        found.append(spaces.sides(error, inside @ kept, exact.forces()[sets.A_lambda]))
    return _bounds(found, spaces)


def _bounds(found: list, spaces: DualBasis) -> DualBounds:
    displacements, forces = (np.array(sides) for sides in zip(*found, strict=True))
    return DualBounds(displacements, forces, spaces.beta)
