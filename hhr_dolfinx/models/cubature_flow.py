"""Equilibrium of bodies that flow on few weighted Gauss points, in the place of all those of a RID.

Internal forces are V[A]^T f = ∫ (G V[A])^T σ by a cubature that was fitted to training states
(:mod:`hhr_dolfinx.reduction.cubature_flow`), tangents the same sum with their moduli, the elastic one too: where the
cells of A are the whole mesh, test functions are the modes themselves, and with weights that are not negative a tangent
is as definite as the moduli of the laws (Farhat, Chapman and Avery, 2015, doi 10.1002/nme.4820). A cubature of the
plastic part alone, beside the exact elastic one, has not this property: on the pellet its tangents became indefinite.
So the elastic stiffness of a point of the parameters, whose moduli may be formulas, is summed up here too: the parts of
K~ on the whole RID are not used.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.materials.update import Material, Update
from hhr_dolfinx.models.answer import Answer, GaussState
from hhr_dolfinx.models.linearised_step import LinearisedStepper
from hhr_dolfinx.models.path import MarchSettings
from hhr_dolfinx.models.projected import ReducedProblem
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.models.reduced_flow import DenseLinearisation, ProjectedEquilibrium
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.trained import Signs

UNKNOWN = "plastic strains at the points of the cubature differ from combinations of trained ones"
"""What its signs say, in words."""


@dataclass(frozen=True)
class CubatureFlow:
    """What is known of flow at n weighted Gauss points, as arrays (c components of a strain).

    Attributes:
        points: numbers of the Gauss points in the full model, (n,).
        per_cell: Gauss points of a cell there.
        trial: strain of the modes V, (n, c, ell).
        test: strain of the modes cut off outside A, times the weight of the point, (n, c, ell).
        given: strain of imposed displacements less that which is without stress, for each term of θ, sparse,
            (n c, 1 + T).
        loads: external loads on the test functions, (ell, 1 + T).
        material: laws at these points.
    """

    points: Annotated[Integers, "points", "< gauss points"]
    per_cell: int
    trial: Annotated[Floats, "points", "components", "ell"]
    test: Annotated[Floats, "points", "components", "ell"]
    given: Annotated[csc_matrix, "points * components", "terms"]
    loads: Annotated[Floats, "ell", "terms"]
    material: Material

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Points that are there twice, lie in no cell, or are not those of its material."""
        if self.material.gauss_points != self.points.size:
            yield f"{self.material.gauss_points} points of the material are not {self.points.size}"
        if np.unique(self.points).size < self.points.size or self.per_cell < 1:
            yield f"points of a cubature must be different numbers, with {self.per_cell} of a cell"

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
        problem: the elastic projection, (5.23), whose contact conditions hold here too.
        flow: weighted Gauss points and their laws.
        parameters: the box of the parameters.
        fields: what completes its answers.
    """

    def __init__(self, problem: ReducedProblem, flow: CubatureFlow, parameters: ParameterSpace, fields: Reconstruction):
        super().__init__(problem, flow.material, parameters, fields)
        self.flow, self.points, self.per_cell = flow, flow.points, flow.per_cell
        self._shape = flow.trial.shape[:2]
        self._trial, self._test = flow.trial.reshape(-1, self.size), flow.test.reshape(-1, self.size)
        self._parts = np.abs(self._test)
        self._given = bool(flow.given.nnz)
        self._set_middle()

    def _set_elasticity(self, material: Material, problem: ReducedProblem) -> None:
        self.material, self.problem = material, problem
        self._elastic = self._test.T @ self._flux(material.elastic, np.arange(len(self.points)))
        self.elastic = DenseLinearisation(problem, self._elastic, material.elastic)
        self._sizes = np.abs(self._elastic)

    def strain(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Strain at the Gauss points, lift included, less that which is without stress."""
        strain = self._trial @ x
        return (strain + self.flow.given @ theta if self._given else strain).reshape(self._shape)

    def strain_of(self, change: np.ndarray) -> np.ndarray:
        """Strain of a change of gamma at the Gauss points."""
        return (self._trial @ change).reshape(self._shape)

    def residual(self, x: np.ndarray, gauss: GaussState | Update, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
        """V[A]^T of loads less internal forces, and the norm of what they are made of, (1,)."""
        loads, flat = self.flow.loads @ theta, gauss.stress.ravel()
        return loads - self._test.T @ flat, self.norms(loads) + self.norms(self._parts.T @ np.abs(flat))

    def round_off(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Residual that comes of adding stiffness times displacement in double precision, (1,)."""
        return 1e-13 * (self.norms(self._sizes @ np.abs(x)) + self.norms(self.flow.loads @ theta))

    def signs(self, answer: Answer) -> Signs:
        """What the modes of training cannot say of the plastic strain at the points, and gaps on the whole surface.

        There are no dofs of A here on which forces could be out of balance; but flow that was never trained, whose
        integral the weights do not know, is no combination of the trained one.
        """
        theta, gauss, flow = self.amplitudes(answer.parameter), answer.state(), self.fields.flow
        flowed = gauss.state.cumulated
        known = None if flow is None else flow.cumulated
        fitted = 0.0 if known is None else known.modes[self.points] @ (known.fit @ flowed)
        depth = (self.fields.contact_basis @ answer.unknown - self.fields.gaps @ theta).max()
        wrong, size = float(np.linalg.norm(flowed - fitted)), float(np.linalg.norm(flowed))
        left = (0.0, 0.0) if flow is None else flow.unexplained(gauss.stress)
        return Signs(wrong, size, max(float(depth), 0.0), UNKNOWN, *left)

    def tangent(self, tangents: np.ndarray) -> np.ndarray:
        """Projected consistent tangent, (ell, ell); points where it is elastic are passed over."""
        change = tangents - self.material.elastic
        flowing = np.flatnonzero(np.abs(change).max(axis=(1, 2), initial=0.0))
        test = self.flow.test[flowing].reshape(-1, self.size)
        return self._elastic + test.T @ self._flux(change[flowing], flowing)

    def stepper(self, settings: MarchSettings) -> LinearisedStepper:
        """What solves the steps of a history."""
        return LinearisedStepper(self, settings)

    def _flux(self, moduli: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Stress of the modes at some points, each under its moduli, (n c, ell)."""
        return (moduli @ self.flow.trial[points]).reshape(-1, self.size)
