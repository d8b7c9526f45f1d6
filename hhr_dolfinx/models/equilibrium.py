"""The contract of equilibrium: what a history needs of a model, whether full, cut to a RID, or reduced to small arrays.

A scene in which nothing flows is one whose linearisation never changes: its models solve with that one and need no
more of the contract.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.active_set import Statuses
from hhr_dolfinx.models.answer import Answer, Fields
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.trained import Signs, TrainedPaths

if TYPE_CHECKING:
    from hhr_dolfinx.materials.update import Material


class Correction(NamedTuple):
    """Solution of one linearised contact problem.

    Attributes:
        change: of the unknown.
        found: total contact forces and their statuses.
    """

    change: np.ndarray
    found: Statuses


class Linearisation(Protocol):
    """A linear model in the place of a model, exact for one in which nothing flows.

    Attributes:
        moduli: tangents H at its Gauss points, (points, components, components).
    """

    moduli: np.ndarray

    def correct(self, residual: np.ndarray, x: np.ndarray, theta: Theta, active: np.ndarray) -> Correction:
        """Solve K δ + B^T λ = residual, B (x + δ) <= gaps, from some statuses."""

    def changed(self, residual: np.ndarray, gaps: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve K δ + B^T λ = residual, B δ = gaps where active, λ = 0 elsewhere: (δ, λ) of a small change."""


class Equilibrium(Protocol):
    """What the loop over time steps needs of a model; ``x`` is its unknown, U0 or gamma.

    Attributes:
        parameters: the box of the parameters.
        material: laws at its Gauss points; ``material.at(parameter)`` has their constants there.
        points: their numbers in the full model.
        per_cell: Gauss points of a cell there.
        elastic: the elastic linearisation.
        size, conditions: number of unknowns and of contact conditions.
        fields: what completes its answers.
        trained: what a reduced model was trained on; None for a full one.
        lock: held through a history.
    """

    parameters: ParameterSpace
    material: Material
    points: np.ndarray
    per_cell: int
    elastic: Linearisation
    size: int
    conditions: int
    fields: Fields
    trained: TrainedPaths | None
    lock: AbstractContextManager

    def amplitudes(self, point: np.ndarray) -> Theta:
        """θ at a parameter."""

    def strain(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Strain at all Gauss points, lift included."""

    def strain_of(self, change: np.ndarray) -> np.ndarray:
        """Strain of a change of the unknown."""

    def gaps(self, theta: Theta) -> np.ndarray:
        """Gaps less the lift on the own conditions, (conditions,), which bound B x."""

    def residual(self, stress: np.ndarray, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
        """Loads less internal forces, in the test space, and the size of both for each body, (bodies,)."""

    def norms(self, residual: np.ndarray) -> np.ndarray:
        """Norm of a residual for each body, (bodies,)."""

    def round_off(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Residual that is round-off at an unknown, for each body, (bodies,)."""

    def contact_load(self, forces: np.ndarray) -> np.ndarray:
        """B^T λ in the test space."""

    def signs(self, answer: Answer) -> Signs:
        """What shows at a solved step whether the model still knows what it does."""

    def linearised(self, tangents: Any) -> Linearisation:
        """The linearisation of consistent tangents; those of earlier tangents are then out of date."""
