"""Equilibrium of bodies that flow on few weighted Gauss points, in the place of all those of a RID.

What is elastic is projected once, as where nothing flows; of the internal forces only the plastic part is integrated
online: V[A]^T f = K~ γ + lift - ∫ (G V[A])^T C ε_p, by a cubature that was fitted to training states
(:mod:`hhr_dolfinx.reduction.cubature`). Without flow its answers are those of the RID to round-off, whatever the
weights, and nothing grows with the cells of the RID.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.materials.update import Material
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.projected import ReducedProblem
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.models.reduced_flow import ProjectedEquilibrium
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.trained import Signs


@dataclass(frozen=True)
class CubatureFlow:
    """What is known of flow at n weighted Gauss points, as arrays (c components of a strain).

    Attributes:
        points: numbers of the Gauss points in the full model, (n,).
        per_cell: Gauss points of a cell there.
        trial: strain of the modes V, (n, c, ell).
        test: strain of the modes cut off outside A, times the weight of the point, (n, c, ell).
        lifts: strain of imposed displacements, sparse, (n c, 1 + T).
        material: laws at these points.
    """

    points: np.ndarray
    per_cell: int
    trial: np.ndarray
    test: np.ndarray
    lifts: csc_matrix
    material: Material

    @property
    def cells(self) -> np.ndarray:
        """Numbers of the cells in which the points lie."""
        return np.unique(self.points // self.per_cell)

    def equilibrium(
        self, problem: ReducedProblem, parameters: ParameterSpace, fields: Reconstruction
    ) -> CubatureEquilibrium:
        """The equilibrium of gamma by these points."""
        return CubatureEquilibrium(problem, self, parameters, fields)


class CubatureEquilibrium(ProjectedEquilibrium):
    """Equilibrium of gamma, see :class:`hhr_dolfinx.models.equilibrium.Equilibrium`.

    Args:
        problem: the elastic projection, (5.23).
        flow: weighted Gauss points and their laws.
        parameters: the box of the parameters.
        fields: what completes its answers.
    """

    def __init__(
        self, problem: ReducedProblem, flow: CubatureFlow, parameters: ParameterSpace, fields: Reconstruction
    ):
        super().__init__(problem, flow.material, parameters, fields)
        self.flow, self.points, self.per_cell = flow, flow.points, flow.per_cell
        self._shape = flow.trial.shape[:2]
        self._trial = flow.trial.reshape(-1, self.size)
        self._test = flow.test.reshape(-1, self.size)
        self._lifted = bool(flow.lifts.nnz)
        self._sizes = np.abs(problem.stiffness)

    def strain(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Strain at the Gauss points, lift included."""
        strain = self._trial @ x
        return (strain + self.flow.lifts @ theta if self._lifted else strain).reshape(self._shape)

    def strain_of(self, change: np.ndarray) -> np.ndarray:
        """Strain of a change of gamma at the Gauss points."""
        return (self._trial @ change).reshape(self._shape)

    def residual(self, x: np.ndarray, stress: np.ndarray, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
        """V[A]^T of loads less internal forces, and the norm of what they are made of, (1,)."""
        elastic = np.einsum("nij,nj->ni", self.material.elastic, self.strain(x, theta))
        loads, inner, plastic = self.problem.loads @ theta, self.problem.stiffness @ x, self._test.T @ (
            elastic - stress
        ).ravel()
        return loads - inner + plastic, self.norms(loads) + self.norms(inner) + self.norms(plastic)

    def round_off(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Residual that comes of adding stiffness times displacement in double precision, (1,)."""
        return 1e-13 * (self.norms(self._sizes @ np.abs(x)) + self.norms(self.problem.loads @ theta))

    def signs(self, answer: Answer) -> Signs:
        """What the modes of training cannot say of the plastic strain at the points, and gaps on the whole surface.

        There are no dofs of A here on which forces could be out of balance; but flow that was never trained, whose
        integral the weights do not know, is no combination of the trained one.
        """
        theta = self.amplitudes(answer.parameter)
        flowed = answer.state().state.cumulated
        depth = (self.fields.contact_basis @ answer.unknown - self.fields.gaps @ theta).max()
        flow = self.fields.flow
        known = flow.cumulated if flow is not None else None
        fitted = 0.0 if known is None else known.modes[self.points] @ (known.fit @ flowed)
        return Signs(float(np.linalg.norm(flowed - fitted)), float(np.linalg.norm(flowed)), max(float(depth), 0.0))

    def tangent(self, tangents: np.ndarray) -> np.ndarray:
        """Projected consistent tangent, (ell, ell): what is elastic from the projection, the change by the points."""
        change = tangents - self.material.elastic
        flowing = np.flatnonzero(np.abs(change).max(axis=(1, 2), initial=0.0))
        flux = change[flowing] @ self.flow.trial[flowing]
        size = self.size
        return self.problem.stiffness + self.flow.test[flowing].reshape(-1, size).T @ flux.reshape(-1, size)
