"""Fields of condensed flow on the whole mesh: displacement exact up to the correction, stress of its strain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from scipy.sparse import csr_matrix, diags

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.models.answer import Answer, ModelFields
from hhr_dolfinx.models.condensed_flow import PartFactors
from hhr_dolfinx.models.estimates import STRESS, Estimate
from hhr_dolfinx.models.plastic_fields import PlasticFields
from hhr_dolfinx.trained import share_of_stress

if TYPE_CHECKING:
    from hhr_dolfinx.models.functionals import Functionals


@dataclass(frozen=True)
class CondensedFlowFields(ModelFields):
    """What completes answers of condensed flow, see :class:`hhr_dolfinx.models.answer.Fields`.

    Attributes:
        amplitudes: θ as a function of the parameters.
        factors: moduli of the parts of the stiffness.
        parts: part that holds each dof, (N,).
        basis: V, (N, ell).
        per_force: K^-1 B^T in the middle of the box, (N, m).
        forced: K^-1 F there, (N, 1 + T).
        given: imposed displacements and what follows them, (N, 1 + T).
        dimension: components of the displacement at a node.
        flow: what completes stress and plastic strain.
        functionals: outputs of the scene; None where it has none.
    """

    amplitudes: Amplitudes
    factors: PartFactors
    parts: Annotated[Integers, "N"]
    basis: Annotated[Floats, "N", "ell"]
    per_force: Annotated[Floats, "N", "m"]
    forced: Annotated[Floats, "N", "terms"]
    given: Annotated[Floats, "N", "terms"]
    dimension: int
    flow: PlasticFields
    functionals: Functionals | None = None

    @property
    def conditions(self) -> int:
        """Number of contact conditions, all of which are kept."""
        return self.per_force.shape[1]

    def displacement(self, answer: Answer) -> np.ndarray:
        """Displacement on the whole mesh, lift included, (N,)."""
        return self._elastic(answer) + self.basis @ answer.unknown[: self.basis.shape[1]]

    def _elastic(self, answer: Answer) -> np.ndarray:
        """What of it loads and contact forces make, and what is imposed."""
        theta = self.amplitudes(answer.parameter)
        elastic = self.forced @ theta - self.per_force @ answer.multipliers
        if self.factors.moduli:
            elastic *= self.factors.compliances(answer.parameter)[self.parts]
        return elastic + self.given @ theta

    def forces(self, answer: Answer) -> np.ndarray:
        """The multipliers, all of which the model has, (m,)."""
        return answer.multipliers.copy()

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress at all Gauss points, Kelvin's notation, (Gauss points, components)."""
        theta, plastic = self._dense(answer.parameter), answer.state().state.plastic
        return self.flow.stress(self._elastic(answer), theta, plastic) / self._giving(answer.parameter)

    def plastic_strain(self, answer: Answer) -> np.ndarray:
        """Cumulated plastic strain at all Gauss points."""
        return self.flow.cumulated_everywhere(answer.state().state.cumulated)

    def estimate(self, answer: Answer) -> Estimate | None:
        """What an indicator says, see :meth:`unexplained`, over the stress; None without an answer."""
        if not answer.converged:
            return None
        return Estimate.indicated(share_of_stress(*self.unexplained(answer)), STRESS)

    def unexplained(self, answer: Answer) -> tuple[float, float]:
        """Stress of the plastic strain where laws are evaluated that the others do not foretell, and |σ| there."""
        gauss, inside = answer.state(), self.flow.points
        left = self.flow.unforeseen(gauss.state.plastic) / self._giving(answer.parameter, inside)
        return float(np.linalg.norm(left)), float(np.linalg.norm(gauss.stress))

    def _giving(self, point: np.ndarray, places: Any = slice(None)) -> Any:
        """How much more some Gauss points give than in the middle of the box, (places, 1); 1 of constant moduli."""
        if not self.factors.moduli:
            return 1.0
        return self.factors.compliances(point)[self._parts_of_points[places]][:, None]

    @cached_property
    def _parts_of_points(self) -> np.ndarray:
        """Part of the stiffness that holds each Gauss point."""
        strain = self.flow.strain
        return np.repeat(self.parts[strain.dofs[:, 0]], strain.per_cell)

    @cached_property
    def _measures(self) -> tuple[np.ndarray, ...]:
        """Rows of the outputs times all that the displacement is made of; what is elastic for each part."""
        functionals: Any = self.functionals
        rows = csr_matrix(functionals.rows)
        count = max(len(self.factors.moduli), 1)
        masked = [rows @ diags((self.parts == part).astype(float)) for part in range(count)]
        per_force, forced = (np.array([part @ item for part in masked]) for item in (self.per_force, self.forced))
        return rows @ self.basis, rows @ self.given, per_force, forced

    def measured(self, answer: Answer, theta: np.ndarray) -> np.ndarray:
        """Rows of the outputs times the displacement, (K,)."""
        per_mode, given, per_force, forced = self._measures
        elastic = forced @ theta - per_force @ answer.multipliers
        found = given @ theta + per_mode @ answer.unknown[: per_mode.shape[1]]
        return found + self.factors.compliances(answer.parameter) @ elastic

    def measured_changes(self, answer: Answer, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all forces and of these products, see :class:`~models.functionals.MeasuredFields`."""
        assert answer.gradient is not None
        per_mode, given, per_force, forced = self._measures
        theta, compliances = self._dense(answer.parameter), self.factors.compliances(answer.parameter)
        forces = answer.gradient.multipliers
        elastic = forced @ theta - per_force @ answer.multipliers
        found = given @ changes + per_mode @ answer.gradient.unknown[: per_mode.shape[1]]
        found = found + np.tensordot(compliances, forced @ changes - per_force @ forces, 1)
        return forces, found + elastic.T @ self.factors.slopes(answer.parameter)

    def _dense(self, point: np.ndarray) -> np.ndarray:
        """θ as an array, (1 + T,)."""
        given, theta = self.amplitudes(point), np.zeros(self.forced.shape[1])
        theta[given.terms] = given.values
        return theta
