"""Equilibrium of inelastic bodies: what a history needs of a full model, one cut to a RID, or one
of small arrays.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from copy import copy
from dataclasses import dataclass
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes, Theta
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Statuses
from hhr_dolfinx.contact.law import UNILATERAL_STEP, ContactLaw, StepContact
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.inelastic.law import Update
from hhr_dolfinx.plugins.inelastic.loose import LinearisedKernel
from hhr_dolfinx.plugins.inelastic.points import ALL_HERE, GaussPoints
from hhr_dolfinx.plugins.inelastic.state import GaussState
from hhr_dolfinx.plugins.inelastic.trained import Signs, TrainedPaths
from hhr_dolfinx.plugins.inelastic.update import LastOf, Material

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from hhr_dolfinx.formulas import Modulus


@dataclass(frozen=True)
class Linearisation:
    """Linearised problem of U0 or gamma, with an elastic or a tangent stiffness K.

    Exact for elastic bodies.
    """

    rows: np.ndarray | csr_matrix  #: B
    gaps: np.ndarray  #: as terms of θ
    pairs: Pairs | None  #: conditions by contact pair
    moduli: np.ndarray  #: tangents H at the Gauss points, (points, components, components)
    solve: Callable[[np.ndarray], np.ndarray]  #: K^-1 times a residual
    push: Callable[[np.ndarray], np.ndarray]  #: K^-1 B^T times forces
    equalities: SchurEqualities  #: on S = B K^-1 B^T
    held: Callable[[], AbstractContextManager] = nullcontext  #: keeps the factors of K meanwhile
    motions: LinearisedKernel | None = (
        None  # of bodies that contact alone holds, which K pins; None without any
    )

    def correct(
        self,
        residual: np.ndarray,
        x: np.ndarray,
        theta: Theta,
        active: np.ndarray,
        contact: StepContact = UNILATERAL_STEP,
    ) -> tuple[np.ndarray, Statuses]:
        """Solve K δ + B^T λ = residual, B (x + δ) <= gaps, by the law of the contacts.

        Args:
            residual: residual without contact forces, (n,).
            x: unknown, (n,).
            theta: amplitudes θ at the parameter.
            active: statuses to start from, (m,) bool.
            contact: law of the contacts in this step.

        Returns:
            The change δ of the unknown, and total contact forces with their statuses.
        """
        with self.held():  # columns of S may be solved for within the active set
            free = self.solve(residual)
            slack = self.gaps @ theta - self.rows @ (x + free)
            if self.motions is not None:

                def still(forces: np.ndarray) -> np.ndarray:
                    return x + free - self.push(forces)

                statuses, motion = self.motions.solved(
                    contact, slack, residual, still, active, self.pairs
                )
                return free - self.push(statuses.forces) + motion, statuses
            statuses = contact.solved(self.equalities, slack, active, self.pairs)
        return free - self.push(statuses.forces), statuses

    def schur(self) -> np.ndarray:
        """S, (m, m)."""
        return self.equalities.whole()

    def undetermined(
        self, found: Statuses, x: np.ndarray, theta: Theta, law: ContactLaw
    ) -> np.ndarray | None:
        """Rigid motions of an unknown that forces leave undetermined, (n, d); None without any.

        Args:
            found: forces with their statuses.
            x: unknown, (n,).
            theta: amplitudes θ at the parameter.
            law: law of the contacts.
        """
        return undetermined(self.motions, found, lambda: self.slack_of(self.gaps @ theta, x), law)

    def slack_of(self, gaps: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Slack of an unknown, gaps - B x, or the change of it by changes."""
        return gaps - self.rows @ x

    def changed(
        self, residual: np.ndarray, gaps: np.ndarray, active: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve K δ + B^T λ = residual, B δ = gaps where active, λ = 0 elsewhere: (δ, λ) of a small
        change.
        """
        with self.held():
            free = self.solve(residual)
            if self.motions is not None:
                slack = gaps - self.rows @ free
                forces, motion = (
                    column[:, 0]
                    for column in self.motions.changed(residual[:, None], slack[:, None], active)
                )
                return free - self.push(forces) + motion, forces
            forces, _ = self.equalities(active, gaps - self.rows @ free)
            return free - self.push(forces), forces


def undetermined(
    motions: LinearisedKernel | None,
    found: Statuses,
    slack: Callable[[], np.ndarray],
    law: ContactLaw,
) -> np.ndarray | None:
    """Rigid motions that forces leave undetermined, (n, d); None without any.

    Args:
        motions: linearised motions; None without any.
        found: forces with their statuses.
        slack: function of the slack under the forces, (m,).
        law: law of the contacts.
    """
    if motions is None:
        return None
    pressing = law.pressing(found.forces.size) & ~law.pulling(found.forces.size)
    holding = None if pressing.all() else found.active & ~pressing
    return motions.undetermined(np.where(pressing, found.forces, 0.0), slack(), holding)


class Diverged(Exception):
    """A step did not converge: the reason, and the Gauss point with the largest change or flow, if
    known.
    """

    def __init__(self, why: str, worst: int | None = None):
        super().__init__(why)
        self.worst = worst


class Goal(NamedTuple):
    """Time and parameter to reach."""

    time: float
    parameter: np.ndarray


class ParameterDirection(NamedTuple):
    """A point of the parameters and a direction from it, with the amplitudes there and their
    derivatives.
    """

    point: np.ndarray  #: (P,)
    direction: np.ndarray  #: (P,)
    theta: Theta
    change: Theta  #: derivative of θ along the direction


class Stepper(ABC):
    """Solves the steps of one history of a model, with numbers as moduli."""

    def __init__(self, model: Any, settings: MarchSettings):
        self.model = model
        self.settings = settings

    @abstractmethod
    def step(self, trail: tuple[Answer, ...], goal: Goal) -> Answer:
        """Answer at a goal from the last answers.

        Args:
            trail: last answers, at most three, the present one last.
            goal: time and parameter at the end of the step.

        Raises:
            Diverged: if there is none.
        """

    @abstractmethod
    def learn(self, answer: Answer) -> None:
        """Take in a step that was solved before."""

    def advance(self, trail: tuple[Answer, ...], goal: Goal) -> list[Answer]:
        """Solve a step as given, or in 2, 4, ... parts, each of which is tried like a step.

        Args:
            trail: last answers, at most three, the present one last.
            goal: time and parameter at the end of the step.

        Returns:
            The answers at the ends of the parts; the iterations of the first one include those of
            failed attempts.

        Raises:
            Diverged: if the most parts fail too.
        """
        present = trail[-1]
        spent = 0
        for count in (2**halvings for halvings in range(self.settings.cuts + 1)):
            last = trail
            answers = list[Answer]()
            try:
                for share in (number / count for number in range(1, count + 1)):
                    time = present.time + share * (goal.time - present.time)
                    after = self.step(
                        last, Goal(time, (1 - share) * present.parameter + share * goal.parameter)
                    )
                    answers.append(after)
                    last = (*last[-2:], after)
                answers[0] = answers[0]._replace(iterations=answers[0].iterations + spent)
                return answers
            except Diverged as error:
                failure = error
                spent += self.settings.iterations + sum(after.iterations for after in answers)
        raise failure


class MaterialEquilibrium(ABC):
    """Equilibrium of a full or a small model; its unknown ``x`` is U0, gamma, or g followed by λ.

    Outside of :meth:`at` its material has the formulas of moduli, and its elasticity is that of the
    middle of the box.
    """

    trained: TrainedPaths | None = None  #: training range of a reduced model
    together: GaussPoints = ALL_HERE  #: reductions over the Gauss points of all ranks
    lock: AbstractContextManager = nullcontext()  #: held during a history
    symmetric = False  # whether linearisations have the symmetric part of tangents alone
    parameters: ParameterSpace
    fields: Any  #: completes its answers
    material: Material  #: at its Gauss points
    moduli: tuple[
        str, ...
    ]  #: formulas of the elasticity of all bodies, also of those without Gauss points in the model
    points: np.ndarray  #: numbers of its Gauss points in the full model
    per_cell: int  #: Gauss points of a cell of the full model
    size: int  #: number of unknowns
    conditions: int
    law: ContactLaw
    amplitudes: Amplitudes
    problem: Any  #: with gaps as terms of θ

    def __init__(self) -> None:
        self._middle = self
        self._elasticities = LastOf()

    def at(self, point: np.ndarray) -> Self:
        """The model with the elasticity of a point, (P,), the last one of which is kept.

        Itself if that is constant.

        SceneError for an impossible modulus, NotSolvableError for a singular stiffness.
        """
        if not self.moduli:
            return self
        weights = self._middle._weights(point)
        return self._elasticities.of(weights.tobytes(), lambda: self._middle._with(weights, point))

    def _with(self, weights: np.ndarray, point: np.ndarray) -> Self:
        equilibrium = copy(self)
        equilibrium.material = self.material.moduli_at(point)
        equilibrium._set_elasticity(weights, point)
        return equilibrium

    @abstractmethod
    def _weights(self, point: np.ndarray) -> np.ndarray:
        """Numbers that the elasticity at a point depends on."""

    @abstractmethod
    def _set_elasticity(self, weights: np.ndarray, point: np.ndarray) -> None:
        """Set all that depends on elasticity but the material."""

    def gaps(self, theta: Theta) -> np.ndarray:
        """Gaps minus the known part of the motion, (conditions,): upper bounds of B x."""
        return self.problem.gaps @ theta

    def strain_along(self, x: np.ndarray, way: ParameterDirection) -> np.ndarray:
        """Derivative of :meth:`strain` along a way at a given unknown.

        Args:
            x: unknown, (n,).
            way: point and direction of the parameters.
        """
        return self.strain(np.zeros_like(x), way.change)

    def gaps_along(self, x: np.ndarray, way: ParameterDirection) -> np.ndarray:
        """Derivative along a way of the gaps, with the motion by the forces of an unknown that has
        them.

        Args:
            x: unknown, (n,).
            way: point and direction of the parameters.
        """
        return self.gaps(way.change)

    def residual_along(self, x: np.ndarray, change: Update, way: ParameterDirection) -> np.ndarray:
        """Derivative of :meth:`residual` along a way at a given unknown, by that of stress and
        state.

        Args:
            x: unknown, (n,).
            change: derivatives of stress and state.
            way: point and direction of the parameters.
        """
        return self.residual(np.zeros_like(x), change, way.change)[0]

    @abstractmethod
    def stepper(self, settings: MarchSettings) -> Stepper:
        """Solver of the steps of a history."""

    def alongside(self) -> Self:
        """The model for another history that is solved in turns with one of this model."""
        return self

    @abstractmethod
    def strain(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Strain at all Gauss points, lift included, minus strains without stress: the input of
        laws.

        Args:
            x: unknown, (n,).
            theta: amplitudes θ at the parameter.
        """

    @abstractmethod
    def strain_of(self, change: np.ndarray) -> np.ndarray:
        """Strain of a change of the unknown."""

    @abstractmethod
    def residual(
        self, x: np.ndarray, gauss: GaussState | Update, theta: Theta
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residual at an unknown with stress and state, in the test space, and the size of its
        terms.

        Args:
            x: unknown, (n,).
            gauss: stress and state at the Gauss points.
            theta: amplitudes θ at the parameter.
        """

    @abstractmethod
    def signs(self, answer: Answer) -> Signs:
        """Signs at a solved step that the model left its training."""

    @abstractmethod
    def linearised(self, tangents: np.ndarray) -> Any:
        """Linearisation for consistent tangents, with ``changed``.

        Those of earlier tangents become invalid.
        """


def texts_of(moduli: Iterable[Modulus]) -> tuple[str, ...]:
    """Formulas of moduli, and names of parameters in what else varies."""
    moduli = tuple(moduli)
    rests = (name for modulus in moduli for name in modulus.rest_scalar.formula.variables)
    return (*(modulus.factor for modulus in moduli), *rests)


def extrapolated(trail: Sequence[Answer], time: float, count: int | None = None) -> np.ndarray:
    """Extrapolation of unknowns of some answers to a later time, by a polynomial.

    Args:
        trail: answers, in the order of time.
        time: time to extrapolate to, in seconds.
        count: number of unknowns to take; None for all.
    """
    x = np.zeros_like(trail[0].unknown[:count])
    for answer in trail:
        # Lagrange's polynomials
        nodes = [node.time for node in trail if node is not answer]
        x += prod((time - node) / (answer.time - node) for node in nodes) * answer.unknown[:count]
    return x
