"""From the reduced answer to fields everywhere, thesis section 1.4.6."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.sparse import csc_matrix

from hhr_dolfinx.errors import ConvergenceError
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.parameters import Theta


@dataclass(frozen=True)
class Reconstruction:
    """Displacement on the whole mesh and contact forces on the whole contact surface.

    Attributes:
        basis: V, (N, ell).
        lifts: imposed displacements, sparse, (N, 1 + T).
        contact_basis: B V, (N_lambda, ell).
        gaps: D as terms of θ, (N_lambda, 1 + T).
        A_lambda: contact conditions of the RID.
        force_snapshots: columns of S_lambda whose cone holds all of them, (N_lambda, S').
        gap_scale: length by which the gap of each condition is measured, so that (1.70) does not depend on units,
            (N_lambda,).
    """

    basis: np.ndarray
    lifts: csc_matrix
    contact_basis: np.ndarray
    gaps: np.ndarray
    A_lambda: np.ndarray
    force_snapshots: np.ndarray
    gap_scale: np.ndarray

    def __post_init__(self):
        """Cut the snapshots once into what is fitted, inside the RID, and what is penalised, outside."""
        outside = np.setdiff1d(np.arange(len(self.gaps)), self.A_lambda)
        parts = outside, self.force_snapshots[self.A_lambda], self.force_snapshots[outside]
        object.__setattr__(self, "_parts", parts)

    def displacement(self, gamma: np.ndarray, theta: Theta) -> np.ndarray:
        """Displacement V gamma + lift, thesis (1.69), (N,)."""
        return self.basis @ gamma + self.lifts @ theta

    def forces(self, gamma: np.ndarray, inside: np.ndarray, theta: Theta) -> np.ndarray:
        """Contact forces on all conditions, (N_lambda,): the model's own inside the RID, (1.70)-(1.71) outside.

        Non-negative combinations of training forces are fitted to the forces inside the RID, and penalised outside
        where the reconstructed gap is open; inside, forces at open gaps are 0 already.

        Args:
            gamma: coordinates of the displacement, (ell,).
            inside: forces of the model, (N_lambda_C,).
            theta: θ.

        Raises:
            ConvergenceError: if the fit does not end.
        """
        outside, fitted, penalised = self._parts
        slack = self.gaps[outside] @ theta - self.contact_basis[outside] @ gamma
        open_gap = np.maximum(slack, 0.0) / self.gap_scale[outside]
        matrix = np.vstack([fitted, open_gap[:, None] * penalised])
        target = np.concatenate([inside, np.zeros(open_gap.size)])
        try:
            weights, _ = nnls(matrix, target)
        except (RuntimeError, ValueError) as error:  # scipy's iteration limit, numbers that overflow
            raise ConvergenceError(f"the forces outside the RID could not be fitted: {error}") from error
        forces = self.force_snapshots @ weights
        forces[self.A_lambda] = inside
        return forces


@dataclass(frozen=True)
class OnlineModel:
    """What answers parameters: small arrays and the way back to whole fields; this is what a file holds.

    Attributes:
        model: from a parameter to (gamma, lambda on A_lambda).
        reconstruction: fields and forces everywhere.
        dimension: components of the displacement at a node.
    """

    model: ReducedModel
    reconstruction: Reconstruction
    dimension: int

    def solve_everywhere(self, mu, *, outside: str = "warn") -> tuple[np.ndarray, np.ndarray]:
        """Displacement (N,) and contact forces (N_lambda,) on the whole mesh, for one parameter.

        Args:
            mu: number, sequence or mapping by name.
            outside: what happens outside what was trained, see :meth:`CondensedContact.solve`.

        Raises:
            ParameterError, ConvergenceError, NotSolvableError: see :meth:`CondensedContact.solve`.
        """
        solution, theta, fields = self.model.solve(mu, outside=outside), self.model.theta(mu), self.reconstruction
        displacement = fields.displacement(solution.primal, theta)
        return displacement, fields.forces(solution.primal, solution.forces, theta)
