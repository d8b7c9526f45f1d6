"""Contact forces on the whole surface from those of a RID.

A model has one of three ways, which its parts decide once: a law of interfaces, S, or training
forces. Each makes from an answer an object with all forces, and their derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from scipy.linalg import solve_triangular

from hhr_dolfinx.errors import ConvergenceError
from hhr_dolfinx.models.answer import Answer, InterfaceCompletion

if TYPE_CHECKING:
    from hhr_dolfinx.amplitudes import Theta
    from hhr_dolfinx.models.bound import Bound, BoundThere
    from hhr_dolfinx.models.gradient import Gradient


class ContactSurface(Protocol):
    """The contact surface of a model in the columns of its displacement."""

    def surface_at(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gaps as terms of θ, (N_lambda, 1 + T), and B times the columns, (N_lambda, c).

        Args:
            point: parameter, (P,).
        """

    def slack_changes(self, answer: Answer, changes: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Derivatives of the slack of some conditions, (n, P), of an answer with a gradient.

        Args:
            answer: the answer.
            changes: derivatives of θ, (1 + T, P).
            rows: the conditions, (n,).
        """


class OfAnswer(Protocol):
    """What a way needs of an answer, computed once for all that ask."""

    @property
    def answer(self) -> Answer:
        """The answer."""

    @property
    def theta(self) -> Theta:
        """θ, (1 + T,)."""

    @property
    def bound(self) -> BoundThere:
        """The bound at the parameter."""


class WholeForces(Protocol):
    """Forces of one answer on the whole contact surface."""

    @property
    def forces(self) -> np.ndarray:
        """Of all conditions, (N_lambda,)."""

    def changes(self, changes: np.ndarray) -> np.ndarray:
        """Derivatives of all forces, (N_lambda, P), of an answer with a gradient.

        Args:
            changes: derivatives of θ, (1 + T, P).
        """


class ForceCompletion(Protocol):
    """How a model completes forces; made once for a model."""

    def of(self, of_answer: OfAnswer) -> WholeForces:
        """Forces of an answer that converged."""


def gradient_of(answer: Answer) -> Gradient:
    """The gradient of an answer that was solved with one."""
    assert answer.gradient is not None
    return answer.gradient


@dataclass(frozen=True, eq=False)
class ByLaw:
    """A law of interfaces completes forces in its own way."""

    interface: InterfaceCompletion

    def of(self, of_answer: OfAnswer) -> WholeForces:
        """See :class:`ForceCompletion`."""
        return _ForcesByLaw(self.interface, of_answer.answer)


@dataclass(frozen=True, eq=False)
class _ForcesByLaw:
    interface: InterfaceCompletion
    answer: Answer

    @cached_property
    def forces(self) -> np.ndarray:
        """See :class:`WholeForces`."""
        return self.interface.forces(self.answer.multipliers, self.answer.parameter)

    def changes(self, changes: np.ndarray) -> np.ndarray:
        """See :class:`WholeForces`."""
        own = gradient_of(self.answer).multipliers
        return self.interface.force_changes(self.answer.multipliers, own, self.answer.parameter)


@dataclass(frozen=True, eq=False)
class ByS:
    """S is known: forces outside the RID close the remaining gaps, a small contact problem.

    Attributes:
        bound: holds S.
        within: conditions of the RID, (m,).
    """

    bound: Bound
    within: np.ndarray

    @cached_property
    def outside(self) -> Any:
        """Partition with free conditions outside the RID."""
        return self.bound.prepared(self.within)

    def of(self, of_answer: OfAnswer) -> WholeForces:
        """See :class:`ForceCompletion`."""
        return _ForcesByS(self, of_answer)


@dataclass(frozen=True, eq=False)
class _ForcesByS:
    way: ByS
    of_answer: OfAnswer

    @cached_property
    def forces(self) -> np.ndarray:
        """See :class:`WholeForces`."""
        multipliers = self.of_answer.answer.multipliers
        return self.of_answer.bound.completed(multipliers[None], self.way.outside)[0]

    def changes(self, changes: np.ndarray) -> np.ndarray:
        """See :class:`WholeForces`."""
        gradient = gradient_of(self.of_answer.answer)
        return self.of_answer.bound.force_changes(self.forces, self.way.outside, gradient, changes)


@dataclass(frozen=True, eq=False)
class ByTraining:
    """Non-negative combinations of training forces, thesis (1.70)-(1.71).

    They are fitted to the forces inside the RID, and penalised outside where the reconstructed gap
    is open; inside, forces at open gaps are 0 already.

    Attributes:
        snapshots: columns of S_lambda whose cone contains all of them, (N_lambda, S').
        within: conditions of the RID, (m,).
        gap_scale: length scale of the gap of each condition, (N_lambda,).
        surface: gaps and columns of the model.
    """

    snapshots: np.ndarray
    within: np.ndarray
    gap_scale: np.ndarray
    surface: ContactSurface

    @cached_property
    def outer(self) -> np.ndarray:
        """Conditions outside the RID."""
        return np.setdiff1d(np.arange(len(self.snapshots)), self.within)

    @cached_property
    def fitted_rows(self) -> np.ndarray:
        """Snapshots inside the RID, (m, S')."""
        return self.snapshots[self.within]

    @cached_property
    def penalised_rows(self) -> np.ndarray:
        """Snapshots outside the RID, (N_lambda - m, S')."""
        return self.snapshots[self.outer]

    def of(self, of_answer: OfAnswer) -> WholeForces:
        """See :class:`ForceCompletion`.

        Raises:
            ConvergenceError: if the forces could not be fitted.
        """
        # imported here: loading a model is faster without, and few answers need it
        from scipy.optimize import nnls

        answer = of_answer.answer
        gaps, columns = self.surface.surface_at(answer.parameter)
        slack = gaps[self.outer] @ of_answer.theta - columns[self.outer] @ answer.unknown
        open_gap = np.maximum(slack, 0.0) / self.gap_scale[self.outer]
        matrix = np.vstack([self.fitted_rows, open_gap[:, None] * self.penalised_rows])
        target = np.concatenate([answer.multipliers, np.zeros(open_gap.size)])
        try:
            weights, _ = nnls(matrix, target, maxiter=30 * matrix.shape[1])
        # scipy's iteration limit, numbers that overflow
        except (RuntimeError, ValueError) as error:
            reason = f"the forces outside the RID could not be fitted: {error}"
            raise ConvergenceError(reason) from error
        return _ForcesByTraining(self, answer, weights, matrix, target, open_gap)


@dataclass(frozen=True, eq=False)
class _ForcesByTraining:
    """Non-negative fit of training forces: weights, matrix M, target t, and open gaps."""

    way: ByTraining
    answer: Answer
    weights: np.ndarray
    matrix: np.ndarray
    target: np.ndarray
    open_gap: np.ndarray

    @cached_property
    def forces(self) -> np.ndarray:
        """See :class:`WholeForces`."""
        forces = self.way.snapshots @ self.weights
        forces[self.way.within] = self.answer.multipliers
        return forces

    def changes(self, changes: np.ndarray) -> np.ndarray:
        """See :class:`WholeForces`.

        The set of combined training forces is constant. The weights w solve a least-squares problem
        whose matrix changes with the open gaps: M^T M w' = M'^T (t - M w) + M^T (t' - M' w).
        """
        way = self.way
        gradient = gradient_of(self.answer)
        slack = way.surface.slack_changes(self.answer, changes, way.outer)
        opening = slack * (self.open_gap > 0)[:, None] / way.gap_scale[way.outer][:, None]
        used = np.flatnonzero(self.weights)
        combined = way.penalised_rows @ self.weights
        misfit = self.target[len(way.within) :] - self.open_gap * combined
        orthogonal, triangle = np.linalg.qr(self.matrix[:, used])
        right = np.vstack([gradient.multipliers, -opening * combined[:, None]])
        turned = solve_triangular(
            triangle, way.penalised_rows[:, used].T @ (opening * misfit[:, None]), trans="T"
        )
        weights = solve_triangular(triangle, orthogonal.T @ right + turned)
        forces = way.snapshots[:, used] @ weights
        forces[way.within] = gradient.multipliers
        return forces
