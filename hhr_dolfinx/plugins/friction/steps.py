"""Facet ``steps`` of friction, see :class:`~hhr_dolfinx.models.histories.steps.Steps`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Status, Statuses
from hhr_dolfinx.contact.law import StepContact
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.plugins.contact_laws.increments import Increments
from hhr_dolfinx.plugins.contact_laws.steps import LawSteps
from hhr_dolfinx.plugins.friction.laws import SLIP, SlipState
from hhr_dolfinx.plugins.friction.slider import Slider
from hhr_dolfinx.plugins.friction.sliding_set import Sliding, SlidingContact, SlidingIncrement
from hhr_dolfinx.plugins.friction.surfaces import FarSliding, SolvedContacts

if TYPE_CHECKING:
    from hhr_dolfinx.models.model import AnsweringModel


class _RubbingStep:
    """Contact problems of the linearisations of one step of inelastic bodies, from a slip state and
    forces, (m,).

    All measure slip from the beginning of the step, backward Euler for the rate of slip, to a
    point, (P,). The last one, at which the stress has converged, gives the slip of the step.
    ``earlier`` is that of another step.
    """

    def __init__(
        self,
        model: Any,
        point: np.ndarray,
        before: SlipState,
        forces: np.ndarray,
        earlier: _RubbingStep | None,
    ):
        self._friction = model.law
        self._surface = SolvedContacts.of(model)
        self._point = point
        self._coefficient, self._limit = self._friction.bounds(point)
        self._before = before
        self._position = self._surface.position(before)
        self._forces = forces
        self._on: SchurEqualities | None = None if earlier is None else earlier._on
        self._contact: SlidingContact | None = None if earlier is None else earlier._contact
        self._last: tuple[SlidingIncrement, Sliding] | None = None

    def solved(
        self,
        equalities: SchurEqualities,
        free_slack: np.ndarray,
        active: np.ndarray,
        pairs: Pairs | None,
    ) -> Statuses:
        """See :class:`~hhr_dolfinx.contact.law.StepContact`.

        Args:
            equalities: equality problems on S of the linearisation.
            free_slack: slack without contact forces, (m,).
            active: statuses to start from, (m,) bool.
            pairs: not read: one problem has all pairs.
        """
        if self._contact is None or equalities is not self._on:
            self._contact = SlidingContact(equalities.whole(), self._friction)
            self._on = equalities
        slack = free_slack.copy()
        slack[self._friction.tangential] -= self._position
        loads = SlidingIncrement(slack, self._coefficient, self._limit, np.zeros(0))
        solution = self._contact.increment(loads, self._forces, active)
        if solution.status is Status.CONVERGED:  # else no start for the next one
            self._forces = solution.forces
        self._last = loads, solution
        return Statuses(
            solution.forces,
            solution.active,
            solution.iterations,
            solution.status,
            solution.sweeps > 0,
        )

    def changes(
        self, equalities: SchurEqualities, found: Statuses, slack: np.ndarray
    ) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.law.StepContact`.

        Args:
            equalities: not read: those of the solution.
            found: solution, which the step has stored.
            slack: derivatives of the slack, (m, K).
        """
        assert self._contact is not None and self._last is not None
        same = np.zeros((self._friction.normal.size, slack.shape[1]))
        return self._contact.changes(
            *self._last, slack, (same, same), np.zeros((0, slack.shape[1]))
        )[0]

    def memory(self, unknown: np.ndarray) -> Memory:
        assert self._last is not None
        return Memory(
            slip=self._surface.after(self._before, *self._last, lambda: unknown, self._point)
        )


class _FrictionSteps(LawSteps):
    completes = True

    def increments(self, model: AnsweringModel, settings: MarchSettings) -> Increments:
        """Increments of friction, see :class:`~hhr_dolfinx.models.histories.steps.Steps`.

        Args:
            model: model with friction.
            settings: settings of the history.
        """
        return Slider(model, settings.gradient, settings.limit)

    def step_contact(
        self,
        model: Any,
        before: Answer,
        point: np.ndarray,
        time: float,
        last: Any = None,
    ) -> StepContact:
        """Friction on the S of each linearisation.

        See :class:`~hhr_dolfinx.models.histories.steps.Steps`.

        Args:
            model: model with friction.
            before: answer at the start of the step.
            point: parameter, (P,).
            time: time at the end of the step in seconds.
            last: contact problems of another step, whose factors can serve; None for none.
        """
        return _RubbingStep(model, point, before.memory[SLIP], before.multipliers, last)

    def at_rest(self, model: Any) -> Memory:
        return Memory(slip=SlipState.at_rest(SolvedContacts.of(model).whole))

    def watch(self, model: Any) -> Callable[[Answer], None]:
        far = FarSliding()
        friction = SolvedContacts.of(model).whole
        return lambda answer: far.check(
            friction, answer.memory[SLIP], model.parameters.described(answer.parameter)
        )

    def coupling(self, model: Any, point: np.ndarray) -> float:
        """f κ of :mod:`.uniqueness`; NaN of inelastic bodies and of rigid motions.

        Args:
            model: model with friction.
            point: parameter, (P,).
        """
        if model.equilibrium is not None:  # each linearisation has another S
            return np.nan
        from hhr_dolfinx.plugins.friction.uniqueness import coupling

        contact = model.contacts()(point)
        coefficient, _ = model.law.bounds(point)
        return (
            np.nan
            if contact.kernel is not None
            else coupling(contact.schur, model.law, coefficient)
        )

    def known_error(self, known: str) -> str:
        return (
            f"{known}; with friction of one answer, of several unless uniqueness(mu) says 'one "
            "answer'"
        )


FRICTION_STEPS = _FrictionSteps()
"""The facet, without state."""
