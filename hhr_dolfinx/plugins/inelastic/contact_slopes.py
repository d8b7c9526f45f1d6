"""Derivatives of contacts in histories of inelastic bodies: by a law of interfaces, and of
unilateral contact.

A law that remembers has them as its facet ``flow_slopes``, a function of an equilibrium and the
number of directions.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.gradient import grazing
from hhr_dolfinx.plugins.inelastic.loose import LinearisedKernel

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.inelastic.equilibrium import MaterialEquilibrium


class ContactChange(NamedTuple):
    """Derivatives of a step along K directions."""

    unknown: np.ndarray  #: (n, K)
    forces: np.ndarray  #: (m, K)
    slack: np.ndarray  #: (m, K); of tangential rows that of the slip of the step
    grazing: np.ndarray  #: conditions about to change their status, (m,) bool


class LinearisedStep(Protocol):
    """Linearisation of a step, from which its unknown is eliminated, but motions of bodies that
    contact alone holds.
    """

    motions: LinearisedKernel | None  #: these; None without any

    def held(self) -> AbstractContextManager:
        """Keeps its factors meanwhile."""

    def schur(self) -> np.ndarray:
        """S of the contact rows, (m, m)."""

    def solve(self, residual: np.ndarray) -> np.ndarray:
        """The unknown under a residual, without contact forces, (n,)."""

    def push(self, forces: np.ndarray) -> np.ndarray:
        """The unknown less that under contact forces, (m,): (n,)."""

    def slack_of(self, gaps: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Slack of an unknown, (m, K), by gaps and unknowns, (n, K).

        Args:
            gaps: gaps, (m, K).
            x: unknowns, (n, K).
        """

    def changed(
        self, residual: np.ndarray, gaps: np.ndarray, active: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The unknown, (n,), and forces, (m,), of small changes at constant statuses.

        Args:
            residual: change of the residual, (n,).
            gaps: change of the gaps, (m,).
            active: statuses, (m,) bool.
        """


class ContactSlopes(Protocol):
    """Derivatives of the contacts of one history, step by step."""

    @property
    def remembers(self) -> bool:
        """True if the memory of contacts has derivatives so far, which it hands on."""

    def step(
        self,
        linear: LinearisedStep,
        answer: Answer,
        slack: np.ndarray,
        right: tuple[np.ndarray, np.ndarray],
        way: np.ndarray,
        seconds: float,
    ) -> ContactChange:
        """Derivatives of the next step.

        Args:
            linear: linearisation of the step, see :class:`LinearisedStep`.
            answer: of the step.
            slack: of all rows at its end, (m,).
            right: derivatives of residual and gaps at a given unknown, (n, K) and (m, K).
            way: directions of the parameter, (P, K).
            seconds: duration of the step.

        Raises:
            NotSolvableError: if the step has no derivative.
        """


class UnilateralSlopes:
    """Unilateral contact, which remembers nothing."""

    remembers = False

    def step(
        self,
        linear: LinearisedStep,
        answer: Answer,
        slack: np.ndarray,
        right: tuple[np.ndarray, np.ndarray],
        way: np.ndarray,
        seconds: float,
    ) -> ContactChange:
        """See :class:`ContactSlopes`.

        Args:
            linear: linearisation of the step.
            answer: answer at the end of the step.
            slack: slack of all rows at its end, (m,).
            right: derivatives of residual and gaps at a given unknown, (n, K) and (m, K).
            way: directions of the parameter, (P, K).
            seconds: duration of the step.
        """
        columns = []
        for residual, gaps in zip(*(derivatives.T for derivatives in right), strict=True):
            dx, forces = linear.changed(residual, gaps, answer.active)
            columns.append((dx, forces, linear.slack_of(gaps, dx)))
        unknown, force_slopes, opened = (
            np.stack(vectors, axis=1) for vectors in zip(*columns, strict=True)
        )
        return ContactChange(
            unknown, force_slopes, opened, grazing(answer.active, answer.multipliers, slack)
        )


def slopes_of_contacts(model: MaterialEquilibrium, count: int) -> ContactSlopes:
    """Derivatives of the contacts of a history along some directions.

    Args:
        model: equilibrium of the history.
        count: number of directions, K.

    Raises:
        NotOfferedError: if the law of its contacts has none.
    """
    if not model.law.remembers:
        return UnilateralSlopes()
    capability = (
        f"a derivative of histories in which bodies flow and contacts have {model.law.name}"
    )
    slopes: ContactSlopes = registry.facet(model.law.plugin, "flow_slopes", capability)(
        model, count
    )
    return slopes


def columnwise(function: Callable[[np.ndarray], np.ndarray], values: np.ndarray) -> np.ndarray:
    """A function of vectors for columns, (n, K).

    Args:
        function: maps a vector, (m,), to a vector, (n,).
        values: columns, (m, K).
    """
    return np.stack([function(np.ascontiguousarray(column)) for column in values.T], axis=1)
