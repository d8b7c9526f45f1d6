"""What the loop over time steps needs of a model, full or reduced."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import NamedTuple, Protocol

import numpy as np

from hhr_dolfinx.contact.problem import Status
from hhr_dolfinx.materials.strain import StrainOperator
from hhr_dolfinx.materials.update import Material
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.trained import Signs, TrainedPaths


class Correction(NamedTuple):
    """Solution of one linearised contact problem.

    Attributes:
        change: of the unknown.
        forces: contact forces, total.
        active: statuses.
        status: why the active set stopped.
    """

    change: np.ndarray
    forces: np.ndarray
    active: np.ndarray
    status: Status


class Operator(Protocol):
    """A linearisation of a model.

    Attributes:
        moduli: tangents H at its Gauss points, (points, components, components).
    """

    moduli: np.ndarray

    def correct(self, residual, x, theta, active) -> Correction:
        """Solve K δ + B^T λ = residual, B (x + δ) <= gaps."""


class Equilibrium(Protocol):
    """What the loop needs of a model; ``x`` is its unknown, U0 or gamma.

    Attributes:
        material: laws at its Gauss points.
        operator: strain at these points.
        points: their numbers in the full model.
        parameters: the box of the parameters.
        elastic: the elastic linearisation.
        size, conditions: number of unknowns and of contact conditions.
        trained: what a reduced model was trained on; None for a full one.
        lock: held through a history.
    """

    trained: TrainedPaths | None
    lock: AbstractContextManager
    material: Material
    operator: StrainOperator
    points: np.ndarray
    parameters: ParameterSpace
    elastic: Operator
    size: int
    conditions: int

    def amplitudes(self, point):
        """θ at a parameter."""

    def strain(self, x, theta):
        """Strain at all Gauss points, lift included."""

    def strain_of(self, change):
        """Strain of a change of the unknown."""

    def residual(self, stress, theta):
        """Loads less internal forces, in the test space, and the size of both for each body, (bodies,)."""

    def norms(self, residual):
        """Norm of a residual for each body, (bodies,)."""

    def round_off(self, x, theta):
        """Residual that is round-off at an unknown, for each body, (bodies,)."""

    def contact_load(self, forces):
        """B^T λ in the test space."""

    def signs(self, point) -> Signs:
        """What shows at a solved step whether the model still knows what it does."""

    def linearised(self, tangents) -> Operator:
        """The operator of consistent tangents; operators of earlier tangents are then out of date."""
