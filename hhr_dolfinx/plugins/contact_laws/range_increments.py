"""Increments with laws of several plug-ins, or without memory, each on its range of the
conditions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Status, Statuses
from hhr_dolfinx.memory import NO_MEMORY, Memory
from hhr_dolfinx.models.answer import Answer, InterfaceCompletion
from hhr_dolfinx.models.eliminations.elimination import CondensedContact
from hhr_dolfinx.models.gradient import CHANGING_STATUS, Gradient
from hhr_dolfinx.plugins.contact_laws.increments import PATH_GRADIENT_NOTE, IncrementEnd, unknown_of
from hhr_dolfinx.plugins.contact_laws.interface import Interface
from hhr_dolfinx.plugins.contact_laws.ranges import Ranges, RangeStep, Together

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.models.model import AnsweringModel

WEAK_RANGE = 1e-8
"""Part of the largest force of all ranges below which differences of one range are not measured by
its own forces.
"""


class RangeState(NamedTuple):
    """State of a history at the end of an increment (M rows)."""

    time: float
    point: np.ndarray
    weights: np.ndarray
    forces: np.ndarray
    memory: Memory
    slack: np.ndarray  #: without the shifts of memories, 0 of active rows, (M,)
    energy: float  #: largest elastic energy of contact so far
    changes: np.ndarray  #: derivatives of the shifts of all rows, (M, P)
    whole: Memory  #: of the whole contact surface, of which a hyper-reduced model solves for a part


class SolvedRange(NamedTuple):
    """An increment, see :class:`~hhr_dolfinx.plugins.contact_laws.increments.SolvedIncrement`."""

    found: Together
    contact: CondensedContact
    reached: RangeState
    gradient: Gradient | None
    status: Status
    iterations: int
    cycled: bool


class SolversOfRanges:
    """Solvers of the laws of an interface, on one S after another."""

    def __init__(self, law: Interface):
        self.law = law
        self.solvers = [law_range.solver() for law_range in law.ranges]
        self.rows = [law_range.rows for law_range in law.ranges]
        self.ranges: Ranges | None = None

    def at_rest(self, gaps: np.ndarray, point: np.ndarray) -> Memory:
        """Memory of undeformed bodies.

        Args:
            gaps: gaps of all rows, (M,).
            point: parameter at rest, (P,).
        """
        both = zip(self.solvers, self.rows, strict=True)
        return joined([solver.memory_at_rest(gaps[rows], point) for solver, rows in both])

    def on(self, schur: np.ndarray, motions: np.ndarray | None = None) -> Ranges:
        """Solver of the laws on one S.

        Args:
            schur: S, (M, M).
            motions: effect of rigid motions on the rows, (M, r); None without any.
        """
        if self.ranges is None or self.ranges.given is not schur:
            compliance = np.zeros(len(schur))
            for rows, solver in zip(self.rows, self.solvers, strict=True):
                compliance[rows] = solver.compliance(np.abs(np.diag(schur))[rows])
            self.ranges = Ranges(schur, self.rows, compliance, motions)
        return self.ranges

    def steps(self, before: Memory, point: np.ndarray, seconds: float) -> list[RangeStep]:
        """Increments of all laws; a law without memory gets none.

        Args:
            before: memory at their start.
            point: parameter at their end, (P,).
            seconds: their duration.
        """
        both = zip(self.solvers, self.law.ranges, strict=True)
        starts = [
            (solver, (before, seconds) if law_range.law.remembers else (NO_MEMORY, np.nan))
            for solver, law_range in both
        ]
        return [solver.step(memory, point, duration) for solver, (memory, duration) in starts]

    def after(self, steps: Sequence[RangeStep], found: Together) -> Memory:
        """Memory at the end of an increment.

        Args:
            steps: increment of each law.
            found: solution of the increment.
        """
        both = zip(self.rows, steps, strict=True)
        return joined(
            [
                step.after(found.forces[rows], found.slack[rows], found.active[rows])
                for rows, step in both
            ]
        )


def joined(memories: Sequence[Memory]) -> Memory:
    """Memory with the parts of several."""
    joined = NO_MEMORY
    for memory in memories:
        joined = joined | memory
    return joined


class RangesIncrements:
    """Increments of one history of a model whose law is an :class:`.Interface`."""

    def __init__(self, model: AnsweringModel, gradient: bool):
        self.model = model
        self.gradient = gradient
        self.laws = SolversOfRanges(cast("Interface", model.law))
        self.contact_at = model.contacts()
        self.largest = np.zeros(len(self.laws.rows))  # norm of the forces of each range so far
        completion = model.fields.interface
        self.everywhere = self.laws if completion is None else SolversOfRanges(completion.whole)

    def at_rest(self, time: float, point: np.ndarray, weights: np.ndarray) -> RangeState:
        """Undeformed bodies.

        Args:
            time: time in seconds.
            point: parameter, (P,).
            weights: derivative of each parameter along that of the whole history, (P,).
        """
        slack = self.contact_at(point).free_slack
        nothing = (
            np.zeros(slack.size),
            self.laws.at_rest(slack, point),
            slack,
            0.0,
            np.zeros((slack.size, point.size)),
        )
        fields = self.model.fields
        gaps = slack if fields.interface is None else fields.gaps @ fields.amplitudes(point)
        everywhere = self.everywhere.at_rest(gaps, point)
        return RangeState(time, point, weights, *nothing, everywhere)

    def going_on(self, answer: Answer, weights: np.ndarray) -> RangeState:
        """State after a step that the full model solved before.

        Args:
            answer: answer at the end of the last step.
            weights: derivative of each parameter along that of the whole history, (P,).
        """
        forces = answer.multipliers
        point = answer.parameter
        self._grow(forces)
        problem = cast("FullModel", self.model).problem.at(point)
        slack = problem.gaps @ problem.amplitudes(point) - problem.contact @ answer.unknown
        energy = 0.5 * float(forces @ (self.contact_at(point).schur @ forces))
        state = forces, answer.memory, np.where(answer.active, 0.0, slack), energy
        nothing = np.zeros((forces.size, point.size))
        return RangeState(answer.time, point, weights, *state, nothing, answer.memory)

    def increment(self, before: RangeState, target: IncrementEnd) -> SolvedRange:
        """Solve one increment; it may not converge.

        Args:
            before: state at its start.
            target: end of the increment.
        """
        contact = self.contact_at(target.point)
        kernel = contact.kernel
        motions, driving = (
            (None, None)
            if kernel is None
            else (kernel.equalities.contact_of_motions, kernel.driving)
        )
        ranges = self.laws.on(contact.schur, motions)
        steps = self.laws.steps(before.memory, target.point, target.time - before.time)
        solution = ranges.solve(contact.free_slack, steps, before.forces, driving)
        gradient = None
        changes = before.changes
        if self.gradient and solution.status is Status.CONVERGED:
            gradient, changes = self._gradient(ranges, before, target, solution, steps, contact)
        loaded = contact.schur @ solution.forces
        slack = contact.free_slack + loaded - ranges.motions @ solution.motions
        memory = of_surface = self.laws.after(steps, solution)
        if self.everywhere is not self.laws and solution.status is Status.CONVERGED:
            of_surface = self._completed(before, target, solution, unknown_of(contact, solution))
        energy = max(before.energy, 0.5 * float(solution.forces @ loaded))
        state = (
            solution.forces,
            memory,
            np.where(solution.active, 0.0, slack),
            energy,
            changes,
            of_surface,
        )
        reached = RangeState(target.time, target.point, target.weights, *state)
        return SolvedRange(
            solution,
            contact,
            reached,
            gradient,
            solution.status,
            solution.iterations,
            solution.projections > 0,
        )

    def _completed(
        self, before: RangeState, target: IncrementEnd, found: Together, unknown: np.ndarray
    ) -> Memory:
        """Memory of the whole surface: outside the RID forces are fitted, and slacks follow the
        displacement.
        """
        fields = self.model.fields
        completion: InterfaceCompletion = fields.interface
        forces, active = completion.completed(found.forces, found.active, target.point)
        slack = fields.gaps @ fields.amplitudes(target.point) - fields.contact_basis @ unknown
        steps = self.everywhere.steps(before.whole, target.point, target.time - before.time)
        for rows, step in zip(self.everywhere.rows, steps, strict=True):
            slack[rows] += step.shift
        slack[completion.within] = found.slack
        return self.everywhere.after(
            steps, found._replace(forces=forces, slack=slack, active=active)
        )

    def _gradient(
        self,
        ranges: Ranges,
        before: RangeState,
        target: IncrementEnd,
        found: Together,
        steps: list[RangeStep],
        contact: CondensedContact,
    ) -> tuple[Gradient, np.ndarray]:
        """Derivatives at the statuses of the solution, by the implicit function: P x' + Q (s' + S
        x' - G a') = -r'.
        """
        unknown = unknown_of(contact, found)
        of_slack, of_unknown = (
            change * target.weights for change in contact.at_fixed_forces(found.forces, unknown)
        )
        linearisations = ranges.linearised(found.slack, steps, found.forces, ranges.stiffness, 1)
        for rows, step in zip(self.laws.rows, steps, strict=True):
            of_slack[rows] += step.shifted(before.changes[rows])
        m = len(of_slack)
        right = np.zeros((m + found.motions.size, of_slack.shape[1]))
        kinks = np.zeros(m, dtype=bool)
        states = [
            (rows, found.forces[rows], found.slack[rows], ranges.stiffness[rows])
            for rows in self.laws.rows
        ]
        for (rows, *at), step, linearised in zip(states, steps, linearisations, strict=True):
            right[rows] = -linearised.of_slack(of_slack[rows]) - step.slopes(*at) * target.weights
            kinks[rows] = step.grazing(
                at[0], at[1], at[2], CHANGING_STATUS * np.abs(at[0]).max(initial=0.0)
            )
        if contact.kernel is not None:
            right[m:] = contact.kernel.drift(found.forces, unknown) * target.weights
        forces, motions = np.split(ranges.slopes(linearisations, right), [m])
        slack = of_slack + ranges.schur @ forces - ranges.motions @ motions
        changes = before.changes.copy()
        for rows, step in zip(self.laws.rows, steps, strict=True):
            changes[rows] = step.carried(
                before.changes[rows], forces[rows], slack[rows], found.active[rows]
            )
        of_unknown = of_unknown - contact.response_to_forces(forces)
        if contact.kernel is not None:
            of_unknown = of_unknown + contact.kernel.modes @ motions
        return Gradient(of_unknown, forces, kinks, slack, note=PATH_GRADIENT_NOTE), changes

    def _grow(self, forces: np.ndarray) -> None:
        self.largest = np.maximum(
            self.largest, [np.linalg.norm(forces[rows]) for rows in self.laws.rows]
        )

    def compare(self, solved: SolvedRange) -> None:
        """Take in the sizes of forces."""
        self._grow(solved.found.forces)

    def difference(
        self, before: RangeState, half: SolvedRange, second: SolvedRange, whole: SolvedRange
    ) -> float:
        """Largest error of a range: of forces over its largest so far, or what its law measures.

        Args:
            before: state at the start of the step.
            half: first half of the step.
            second: second half of the step.
            whole: the step as one increment.
        """
        ends = before, half.reached, second.reached, whole.reached
        worst = 0.0
        for rows, solver, norm in zip(self.laws.rows, self.laws.solvers, self.largest, strict=True):
            largest = max(float(norm), WEAK_RANGE * float(self.largest.max())) or 1.0
            off = float(np.linalg.norm((second.found.forces - whole.found.forces)[rows])) / largest
            worst = max(worst, solver.difference(off, ends, rows, largest))
        return worst

    def check(self, place: RangeState) -> None:
        """Check the memories."""
        for solver in self.everywhere.solvers:
            solver.check(place.whole, self.model.parameters.described(place.point))

    def answer(self, solved: SolvedRange) -> Answer:
        """Answer of an increment."""
        solution = solved.found
        reached = solved.reached
        return Answer(
            reached.point,
            unknown_of(solved.contact, solution),
            solution.forces,
            solution.active,
            solution.iterations,
            solution.status,
            solution.projections > 0,
            self.model.fields,
            time=reached.time,
            gradient=solved.gradient,
            memory=reached.whole,
            undetermined=self._undetermined(solved.contact, solution),
        )

    def _undetermined(self, contact: CondensedContact, found: Together) -> np.ndarray | None:
        """Motions that neither forces nor sticking contacts hold, see :class:`Answer`.

        None if there are none.
        """
        kernel = contact.kernel
        if kernel is None or found.status is not Status.CONVERGED:
            return None
        law = self.model.law
        pressing = law.pressing(found.forces.size) & ~law.pulling(found.forces.size)
        holding = kernel.equalities.bearing(
            np.where(pressing, found.forces, 0.0), contact.free_slack
        )
        ways = kernel.equalities.left_open(np.where(pressing, holding, found.active))
        return kernel.modes @ ways if ways.shape[1] else None

    def advice(self, solved: SolvedRange) -> Mapping[Status, str]:
        """Rows that still change."""
        solution = solved.found
        if solution.status is Status.ADRIFT:
            return {
                solution.status: (
                    f"{self.model.law.name} do not bear its loads, or nothing presses on them"
                )
            }
        return (
            {solution.status: f"conditions {solution.unsettled[:8].tolist()} change"}
            if solution.unsettled.size
            else {}
        )


class RangesStep:
    """Contact problems of the linearisations of one step of inelastic bodies, from an answer to a
    point, (P,).

    ``earlier`` is that of another step.
    """

    def __init__(
        self,
        law: Interface,
        before: Answer,
        point: np.ndarray,
        time: float,
        earlier: RangesStep | None = None,
    ):
        self._laws: SolversOfRanges = SolversOfRanges(law) if earlier is None else earlier._laws
        self._steps = self._laws.steps(before.memory, point, time - before.time)
        self._forces = before.multipliers
        self._equalities: SchurEqualities | None = None if earlier is None else earlier._equalities
        self._schur: np.ndarray = np.zeros((0, 0)) if earlier is None else earlier._schur
        self._last: Together | None = None

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
            active: statuses to start from, which are not needed.
            pairs: not read: ranges have their own scales.
        """
        if equalities is not self._equalities:
            self._equalities = equalities
            self._schur = equalities.whole()
        self._last = solution = self._laws.on(self._schur).solve(
            free_slack, self._steps, self._forces
        )
        if solution.status is Status.CONVERGED:  # else no start for the next one
            self._forces = solution.forces
        return Statuses(
            solution.forces,
            solution.active,
            solution.iterations,
            solution.status,
            solution.projections > 0,
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
        last = self._last
        assert last is not None
        ranges = self._laws.on(self._schur)
        right = np.zeros_like(slack)
        linearisations = ranges.linearised(
            last.slack, self._steps, last.forces, ranges.stiffness, 1
        )
        for rows, linearised in zip(ranges.rows, linearisations, strict=True):
            right[rows] = -linearised.of_slack(slack[rows])
        return ranges.solved(linearisations, right)

    def memory(self, unknown: np.ndarray) -> Memory:
        """See :class:`~hhr_dolfinx.contact.law.StepContact`."""
        assert self._last is not None
        return self._laws.after(self._steps, self._last)
