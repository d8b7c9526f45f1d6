"""Increments of elastic bodies with friction, whose memory is their slip.

An increment goes from one point of a path to the next and slips in a straight line, backward Euler
for the rate of slip. A step in two halves differs from the whole one by its forces and its
dissipated work. A contact that closes within an increment sticks relative to the start of the
increment, as a whole and in halves alike: its sticking force counts as an error too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.memory import NO_MEMORY, Memory
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.eliminations.elimination import CondensedContact
from hhr_dolfinx.models.gradient import Gradient
from hhr_dolfinx.plugins.contact_laws.increments import PATH_GRADIENT_NOTE, IncrementEnd, unknown_of
from hhr_dolfinx.plugins.friction.laws import SLIP, Friction, SlipState
from hhr_dolfinx.plugins.friction.sliding_set import Sliding, SlidingContact, SlidingIncrement
from hhr_dolfinx.plugins.friction.surfaces import FarSliding, SolvedContacts

WORK = 1e-3
"""Part of the elastic energy of contact below which dissipated work counts as zero."""
OPEN_GAP = 1e-9
"""Part of the largest gap above which a contact is open."""


class SlidingState(NamedTuple):
    """State of a history at the end of an increment."""

    point: np.ndarray
    time: float
    forces: np.ndarray
    active: np.ndarray | None
    gap: np.ndarray
    """Gaps of contacts with friction, (C,)."""
    slip: SlipState
    weights: np.ndarray
    """Derivative of each parameter here along that of the whole history, (P,)."""
    changes: np.ndarray
    """Derivatives of the position of tangential rows, (T, P)."""
    closing: np.ndarray
    """Change of these if an open contact closes next: its position where it closes moves too, (T,
    P).
    """
    displacement: np.ndarray | None = None
    surface_forces: np.ndarray | None = None
    """Displacement of, and forces on, all dofs of surfaces, (n,), for surfaces that are paired
    again.
    """
    laws: Memory = NO_MEMORY
    """What laws of other plug-ins remember, of such surfaces."""


class SolvedSliding(NamedTuple):
    """An increment: its solution, the state at its end, the contact problem there, and derivatives
    if requested.
    """

    found: Sliding
    reached: SlidingState
    contact: CondensedContact
    gradient: Gradient | None

    @property
    def status(self) -> Status:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.increments.SolvedIncrement`."""
        return self.found.status

    @property
    def iterations(self) -> int:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.increments.SolvedIncrement`."""
        return self.found.iterations

    @property
    def cycled(self) -> bool:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.increments.SolvedIncrement`."""
        return self.found.sweeps > 0


class Slider:
    """Solves increments of one model; see
    :class:`~hhr_dolfinx.plugins.contact_laws.increments.Increments`.

    The model is full or condensed, with a :class:`Friction` as its law; its ``contacts`` makes the
    contact problems.

    Attributes:
        friction: on the conditions of the model.
        surface: the whole contact surface, whose slip is stored.
        largest, energy: largest norm of forces, and elastic energy of contact, so far: the units of
            errors.
    """

    def __init__(self, model: Any, gradient: bool = False, limit: bool = False):
        self.model = model
        self.gradient = gradient
        self._limit = limit
        self.friction: Friction = model.law
        self._far = FarSliding()
        self.surface = SolvedContacts.of(model)
        self._contact_at: Callable[[np.ndarray], CondensedContact] = model.contacts()
        self._sliding: SlidingContact | None = None
        self.largest = 0.0
        self.energy = 0.0

    def at_rest(self, time: float, point: np.ndarray, weights: np.ndarray) -> SlidingState:
        """Undeformed bodies without slip.

        Args:
            time: time in seconds.
            point: parameter, (P,).
            weights: derivative of each parameter along that of the whole history, (P,).
        """
        forces = np.zeros(self.model.own_conditions)
        slack = self._contact_at(point).free_slack
        gap = slack[self.friction.normal]
        slip = self.surface.at_rest(slack, point)
        return SlidingState(
            point, time, forces, None, gap, slip, weights, self._no_changes, self._no_changes
        )

    @property
    def _no_changes(self) -> np.ndarray:
        return np.zeros((self.friction.tangential.size, len(self.model.parameters.names)))

    def going_on(self, answer: Answer, weights: np.ndarray) -> SlidingState:
        """State after a step that the full model solved before.

        Args:
            answer: answer at the end of the last step.
            weights: derivative of each parameter along that of the whole history, (P,).
        """
        schur = self._contact_at(answer.parameter).schur
        forces = answer.multipliers
        self.largest = max(self.largest, float(np.linalg.norm(forces)))
        self.energy = max(self.energy, 0.5 * float(forces @ (schur @ forces)))
        problem = self.model.problem.at(answer.parameter)
        slack = (
            problem.gaps @ problem.amplitudes(answer.parameter) - problem.contact @ answer.unknown
        )
        gap = slack[self.friction.normal]
        slip = answer.memory[SLIP]
        nothing = self._no_changes
        return SlidingState(
            answer.parameter,
            answer.time,
            forces,
            answer.active,
            gap,
            slip,
            weights,
            nothing,
            nothing,
        )

    def increment(self, before: SlidingState, target: IncrementEnd) -> SolvedSliding:
        """Solve one increment; it may not converge.

        Args:
            before: state at the start of the increment.
            target: end of the increment.
        """
        point = target.point
        contact = self._contact_at(point)
        of_motions = (
            None if contact.kernel is None else contact.kernel.equalities.contact_of_motions
        )
        if self._sliding is None or self._sliding.given is not contact.schur:
            self._sliding = SlidingContact(contact.schur, self.friction, of_motions)
        slack = contact.free_slack.copy()
        slack[self.friction.tangential] -= self.surface.position(before.slip)
        driving = np.zeros(0) if contact.kernel is None else contact.kernel.driving
        loads = SlidingIncrement(slack, *self.friction.bounds(point), driving)
        solution = self._sliding.increment(loads, before.forces, before.active)
        slip = self.surface.after(
            before.slip, loads, solution, partial(unknown_of, contact, solution), point
        )
        gradient = None
        changes = before.changes
        closing = self._no_changes
        if self.gradient and solution.status is Status.CONVERGED:
            closes = self._closes(before, solution)
            references = before.changes + np.where(closes, before.closing, 0.0)
            gradient = self._gradient(references, target, loads, solution, contact)
            # one that closes within an increment may slip in it alone, as it is drawn from the
            # start of the increment
            follows = ~solution.active[self.friction.tangential, None] & ~closes
            changes = references + np.where(follows, gradient.slack[self.friction.tangential], 0.0)
            closing = self._closing(before, solution, gradient)
        return SolvedSliding(
            solution, self._reached(target, solution, slip, (changes, closing)), contact, gradient
        )

    def _closes(self, before: SlidingState, found: Sliding) -> np.ndarray:
        """Tangential rows of contacts that close in an increment, if derivatives are those of a
        limit, (T, 1) bool.
        """
        friction = self.friction
        if not self._limit or before.active is None:
            return np.zeros((friction.tangential.size, 1), dtype=bool)
        return (found.active & ~before.active)[friction.normal[friction.owner], None]

    def _closing(self, before: SlidingState, found: Sliding, gradient: Gradient) -> np.ndarray:
        """Derivatives of the position at which open contacts will close, less those at a fixed
        time, (T, P).

        A contact that closes at the time t sticks at its position g_t(t) then, and t changes by -dg
        / (dg/dt) of its gap g. In increments the position is that at the start of one, whose
        derivative always misses this.
        """
        friction = self.friction
        gap = found.slack[friction.normal]
        towards = before.gap - gap
        nears = ~found.active[friction.normal] & (towards > 0)
        share = np.divide(1.0, towards, out=np.zeros_like(towards), where=nears)[friction.owner]
        along = found.slack[friction.tangential] * share
        return along[:, None] * gradient.slack[friction.normal][friction.owner]

    def _reached(
        self,
        target: IncrementEnd,
        found: Sliding,
        slip: SlipState,
        changes: tuple[np.ndarray, np.ndarray],
    ) -> SlidingState:
        """State at the end of an increment, whose forces count for the unit of errors."""
        if found.status is Status.CONVERGED:
            self.largest = max(self.largest, float(np.linalg.norm(found.forces)))
        gap = found.slack[self.friction.normal]
        state = found.forces, found.active, gap, slip
        return SlidingState(target.point, target.time, *state, target.weights, *changes)

    def _gradient(
        self,
        references: np.ndarray,
        target: IncrementEnd,
        given: SlidingIncrement,
        found: Sliding,
        contact: CondensedContact,
    ) -> Gradient:
        """Derivatives of an increment at fixed statuses, also of the increments before."""
        assert self._sliding is not None
        floating = contact.kernel
        unknown = unknown_of(contact, found)
        slack, of_unknown = (
            slope * target.weights for slope in contact.at_fixed_forces(found.forces, unknown)
        )
        slack = slack.copy()
        slack[self.friction.tangential] -= references
        bounds = [slope * target.weights for slope in self.friction.bound_slopes(target.point)]
        driving = np.zeros((0, slack.shape[1]))
        if floating is not None:
            driving = floating.drift(found.forces, unknown) * target.weights
        forces, motions = self._sliding.changes(
            given, found, slack, (bounds[0], bounds[1]), driving
        )
        slack = slack + self._sliding.schur @ forces - self._sliding.contact_of_motions @ motions
        slack[found.active] = 0.0
        of_unknown = of_unknown - contact.response_to_forces(forces)
        if floating is not None:
            of_unknown = of_unknown + floating.modes @ motions
        return Gradient(
            of_unknown,
            forces,
            self._sliding.grazing(given, found),
            slack,
            note=PATH_GRADIENT_NOTE,
        )

    def held(self, before: SlidingState, after: SlidingState) -> float:
        """Sticking force of contacts that closed in this increment.

        Its reference is the start of the increment.

        Args:
            before: state at its start.
            after: state at its end.
        """
        assert after.active is not None
        friction = self.friction
        # a contact that was closed at the start has no motion before its closing
        closed = after.active[friction.normal] & (
            before.gap > OPEN_GAP * np.abs(before.gap).max(initial=0.0)
        )
        return float(np.linalg.norm(after.forces[friction.tangential][closed[friction.owner]]))

    def difference(
        self, before: SlidingState, half: SolvedSliding, second: SolvedSliding, whole: SolvedSliding
    ) -> float:
        """Error of a step in two halves.

        Of forces it is over the largest so far, of work over the dissipated work.

        Args:
            before: state at the start of the step.
            half: first half of the step.
            second: second half of the step.
            whole: the step as one increment.
        """
        closing = np.linalg.norm(
            [self.held(before, half.reached), self.held(half.reached, second.reached)]
        )
        off = np.linalg.norm(second.found.forces - whole.found.forces) + closing
        work = float(second.reached.slip.work.sum())
        change = abs(work - float(whole.reached.slip.work.sum()))
        return max(float(off) / (self.largest or 1.0), change / (work + WORK * self.energy or 1.0))

    def compare(self, solved: SolvedSliding) -> None:
        """Take in the elastic energy of an increment."""
        self.energy = max(self.energy, self.elastic_energy(solved))

    def check(self, place: SlidingState) -> None:
        """Check the sliding distance."""
        self._far.check(
            self.surface.whole, place.slip, self.model.parameters.described(place.point)
        )

    def advice(self, solved: SolvedSliding) -> Mapping[Status, str]:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.increments.Increments`."""
        solution = solved.found
        if solution.status is Status.ADRIFT:
            return {solution.status: "friction does not bear its loads, or nothing presses on it"}
        if not solution.unsettled.size:
            return {}
        return {
            solution.status: (
                f"between stick and slip, conditions {solution.unsettled[:8].tolist()} keep "
                "changing"
            )
        }

    def elastic_energy(self, solved: SolvedSliding) -> float:
        """Elastic energy of contact forces."""
        forces = solved.found.forces
        return 0.5 * float(forces @ (solved.contact.schur @ forces))

    def answer(self, solved: SolvedSliding) -> Answer:
        """Answer of an increment."""
        solution, reached, contact, gradient = solved
        return Answer(
            reached.point,
            unknown_of(contact, solution),
            solution.forces,
            solution.active,
            solution.iterations,
            solution.status,
            solution.sweeps > 0,
            self.model.fields,
            time=reached.time,
            gradient=gradient,
            memory=Memory(slip=reached.slip),
            undetermined=self._undetermined(contact, solution),
        )

    def _undetermined(self, contact: CondensedContact, found: Sliding) -> np.ndarray | None:
        """Motions that neither closed nor sticking contacts hold, see :class:`Answer`.

        None if there are none.
        """
        floating = contact.kernel
        if floating is None or found.status is not Status.CONVERGED:
            return None
        rows = self.friction.tangential
        pressures = found.forces.copy()
        pressures[rows] = 0.0
        holding = floating.equalities.bearing(pressures, contact.free_slack)
        holding[rows] = holding[self.friction.normal[self.friction.owner]] & found.active[rows]
        ways = floating.equalities.left_open(holding)
        return floating.modes @ ways if ways.shape[1] else None
