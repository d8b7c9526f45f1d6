"""Protocols of equilibrium: what a history needs of a full model, one cut to a RID, or one of small arrays.

An elastic scene has a linearisation that never changes. Its models solve with that one and need no other part of the
protocols.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.active_set import Statuses
from hhr_dolfinx.contact.law import UNILATERAL_STEP, ContactLaw, StepContact
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer import Answer, Fields
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.inelastic.state import GaussState
from hhr_dolfinx.plugins.inelastic.trained import Signs, TrainedPaths

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix, csr_matrix

    from hhr_dolfinx.contact.active_set import SchurEqualities
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.materials.strain import StrainOperator
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.plugins.inelastic.points import Points
    from hhr_dolfinx.plugins.inelastic.update import Material, Update


class Correction(NamedTuple):
    """Solution of one linearised contact problem."""

    change: np.ndarray  # of the unknown
    found: Statuses  # total contact forces and their statuses


class Changing(Protocol):
    """A converged step, for its derivatives."""

    def changed(self, residual: np.ndarray, gaps: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve K δ + B^T λ = residual, B δ = gaps where active, λ = 0 elsewhere: (δ, λ) of a small change."""


class Linearisation(Changing, Protocol):
    """Linearisation of a model; exact for elastic models."""

    @property
    def moduli(self) -> np.ndarray:
        """Tangents H at its Gauss points, (points, components, components)."""

    def correct(
        self,
        residual: np.ndarray,
        x: np.ndarray,
        theta: Theta,
        active: np.ndarray,
        contact: StepContact = UNILATERAL_STEP,
    ) -> Correction:
        """Solve K δ + B^T λ = residual, B (x + δ) <= gaps from some statuses, by the law of the contacts."""


class Diverged(Exception):
    """A step did not converge: the reason, and the Gauss point with the largest change or flow, if known."""

    def __init__(self, why: str, worst: int | None = None):
        super().__init__(why)
        self.worst = worst


class Goal(NamedTuple):
    """Time and parameter to reach."""

    time: float
    parameter: np.ndarray


class Stepper(Protocol):
    """Solves the steps of one history."""

    def step(self, trail: tuple[Answer, ...], goal: Goal) -> Answer:
        """Answer at a goal from the last answers, at most three; the last of them is the present one.

        Raises:
            Diverged: if it was not found.
        """

    def learn(self, answer: Answer) -> None:
        """Take in a step that was solved before."""

    def signs(self, answer: Answer) -> Signs:
        """Signs at a solved step that the model left its training."""


class Marching(Protocol):
    """Model whose histories are solved step by step and differentiated; ``x`` is the unknown."""

    parameters: ParameterSpace  # the box of the parameters
    material: Material  # elasticity and laws at its Gauss points; ``material.at(parameter)`` has their constants there
    young: tuple[str, ...]  # formulas of Young's moduli of all bodies, also of those without Gauss points in the model
    points: np.ndarray  # numbers of these points in the full model; of the points of all ranks
    together: Points  # reductions over the Gauss points of all ranks
    per_cell: int  # Gauss points of a cell of the full model
    # size, conditions: number of unknowns and of contact conditions
    size: int
    conditions: int
    law: ContactLaw  # law of its contact conditions

    @property
    def fields(self) -> Fields:
        """Completion of its answers."""

    @property
    def trained(self) -> TrainedPaths | None:
        """Training range of a reduced model; None for a full one."""

    @property
    def lock(self) -> AbstractContextManager:
        """Lock to hold during a history."""

    def amplitudes(self, point: np.ndarray) -> Theta:
        """θ at a parameter."""

    def stepper(self, settings: MarchSettings) -> Stepper:
        """Solver of the steps of a history."""

    def at(self, point: np.ndarray) -> Marching:
        """The model with the elasticity of a point, (P,); itself for constant elasticity.

        The one of the last elasticity is kept. If elasticity varies, the model itself has formulas in its material, and
        the elastic linearisation of the middle of the box.
        """

    def responding_at(self, point: np.ndarray) -> Marching:
        """The model whose strain, gaps and residual at a given unknown have the elasticity of a point, (P,)."""

    def strain(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Strain at all Gauss points, lift included, minus strains without stress: the input of laws."""

    def strain_of(self, change: np.ndarray) -> np.ndarray:
        """Strain of a change of the unknown."""

    def gaps(self, theta: Theta) -> np.ndarray:
        """Gaps minus the known part of the motion, (conditions,): upper bounds of B x."""

    def gaps_at(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Gaps for the unknowns next to a given one: with the motion by its forces, if these are unknowns."""

    def residual(self, x: np.ndarray, gauss: GaussState | Update, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
        """Residual at an unknown with stress and state, in the test space, and the size of its terms."""

    def signs(self, answer: Answer) -> Signs:
        """Signs at a solved step that the model left its training."""

    def linearised(self, tangents: Any) -> Changing:
        """Linearisation for consistent tangents; linearisations of earlier tangents become invalid."""


class Equilibrium(Marching, Protocol):
    """Additional interface for steps by linearisation; ``x`` is U0 or gamma."""

    @property
    def elastic(self) -> Linearisation:
        """The elastic linearisation."""

    def at(self, point: np.ndarray) -> Equilibrium:
        """See :class:`Marching`."""

    def residual(self, x: np.ndarray, gauss: GaussState | Update, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
        """Loads minus internal forces, in the test space, and the size of both for each body, (bodies,)."""

    def norms(self, residual: np.ndarray) -> np.ndarray:
        """Norm of a residual for each body, (bodies,)."""

    def round_off(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Size of round-off in the residual at an unknown, for each body, (bodies,)."""

    def contact_load(self, forces: np.ndarray) -> np.ndarray:
        """B^T λ in the test space."""

    def linearised(self, tangents: Any) -> Linearisation:
        """See :class:`Marching`."""


def extrapolated(trail: Sequence[Answer], time: float, count: int | None = None) -> np.ndarray:
    """Extrapolation of the (first ``count``) unknowns of some answers to a later time, by a polynomial."""
    x = np.zeros_like(trail[0].unknown[:count])
    for answer in trail:
        # Lagrange's polynomials
        others = [other.time for other in trail if other is not answer]
        x += prod((time - other) / (answer.time - other) for other in others) * answer.unknown[:count]
    return x


class MeshLinearisation(Linearisation, Protocol):
    """Linearisation on the whole mesh."""

    @property
    def equalities(self) -> SchurEqualities:
        """Equality problems on S = B K^-1 B^T, with K of this linearisation."""


class MeshEquilibrium(Equilibrium, Protocol):
    """Equilibrium of the whole mesh, from which reductors take Gauss points and tangents."""

    @property
    def problem(self) -> ContactProblem:
        """The contact problem."""

    @property
    def operator(self) -> StrainOperator:
        """Strain at the Gauss points of a displacement."""

    @property
    def eigenstrains(self) -> csc_matrix:
        """Strains without stress for each term of θ, (Gauss points * components, 1 + T)."""

    @property
    def elastic(self) -> MeshLinearisation:
        """The elastic linearisation."""

    def at(self, point: np.ndarray) -> MeshEquilibrium:
        """The equilibrium with the elasticity of a point, (P,)."""

    def stiffness(self, tangents: np.ndarray) -> csr_matrix:
        """K_T of consistent tangents at all Gauss points, (N, N)."""


def equilibrium_of(full: FullModel) -> MeshEquilibrium:
    """Equilibrium of a full model whose bodies are inelastic.

    Raises:
        NotOfferedError: for laws that another plug-in reads, whose equilibrium has no Gauss points of ours.
    """
    found: Any = full.equilibrium
    if found is None or found.reader != "inelastic":
        raise NotOfferedError(f"bodies of scene '{full.scene.name}' have no laws of plasticity or creep")
    return found
