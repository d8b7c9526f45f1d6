"""Several laws as one: on ranges of some conditions, under another law that reads their forces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.memory import NO_MEMORY, Memory
from hhr_dolfinx.plugins.contact_laws.interface import Interface
from hhr_dolfinx.plugins.contact_laws.range_increments import joined
from hhr_dolfinx.plugins.contact_laws.ranges import (
    Linearised,
    OffDiagonal,
    RangeSolver,
    RangeStep,
)

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.contact_laws.range_increments import RangeState


class StepOfRanges(RangeStep):
    """Increments of several laws, each on its rows among k."""

    def __init__(self, ranges: Sequence[tuple[np.ndarray, RangeStep]], count: int):
        self._ranges = ranges
        self.shift = np.zeros(count)
        for places, step in self._ranges:
            self.shift[places] = step.shift

    def linearised(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, attempt: int
    ) -> Linearised:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
            attempt: number of the way to choose statuses.
        """
        off, on_forces, on_slack, right = np.zeros((4, forces.size))
        active = np.zeros(forces.size, dtype=bool)
        keys = []
        couplings = []
        for places, step in self._ranges:
            at = step.linearised(forces[places], slack[places], stiffness[places], attempt)
            for values, of_range in zip((off, on_forces, on_slack, right), at, strict=False):
                values[places] = of_range
            active[places] = at.active
            keys.append(at.key)
            if at.coupling is not None:
                rows, columns, *entries = at.coupling
                couplings.append((places[rows], places[columns], *entries))
        coupling = (
            OffDiagonal(*(np.concatenate(arrays) for arrays in zip(*couplings, strict=True)))
            if couplings
            else None
        )
        return Linearised(off, on_forces, on_slack, right, b"".join(keys), active, coupling)

    def after(self, forces: np.ndarray, slack: np.ndarray, active: np.ndarray) -> Memory:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            active: rows that touch, (k,) bool.
        """
        return joined(
            [
                step.after(forces[places], slack[places], active[places])
                for places, step in self._ranges
            ]
        )

    def after_slip(self, memory: Memory, rubbed: np.ndarray) -> Memory:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`.

        Args:
            memory: that of ``after``.
            rubbed: pressure integrated along the slip of the increment, (k,).
        """
        for places, step in self._ranges:
            memory = memory | step.after_slip(memory, rubbed[places])
        return memory

    def slopes(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray
    ) -> np.ndarray | float:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
        """
        found = [
            (places, step.slopes(forces[places], slack[places], stiffness[places]))
            for places, step in self._ranges
        ]
        given = [(places, slopes) for places, slopes in found if isinstance(slopes, np.ndarray)]
        if not given:
            return 0.0
        every = np.zeros((forces.size, given[0][1].shape[1]))
        for places, slopes in given:
            every[places] = slopes
        return every

    def shifted(self, before: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`.

        Args:
            before: derivatives of the memory, (k, P).
        """
        return self._each(before, lambda step, places: step.shifted(before[places]))

    def carried(
        self, before: np.ndarray, forces: np.ndarray, slack: np.ndarray, active: np.ndarray
    ) -> np.ndarray:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`.

        Args:
            before: derivatives of the shift, (k, P).
            forces: derivatives of the forces, (k, P).
            slack: derivatives of the slacks, (k, P).
            active: rows that touch, (k,) bool.
        """
        return self._each(
            before,
            lambda step, places: step.carried(
                before[places], forces[places], slack[places], active[places]
            ),
        )

    def grazing(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, near: float
    ) -> np.ndarray:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
            near: force below which a row counts as at a kink.
        """
        return self._each(
            np.zeros(forces.size, dtype=bool),
            lambda step, places: step.grazing(
                forces[places], slack[places], stiffness[places], near
            ),
        )

    def _each(
        self, like: np.ndarray, made: Callable[[RangeStep, np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """Values that each law makes of its rows, in the order of all, as an array like another."""
        values = np.zeros_like(like)
        for places, step in self._ranges:
            values[places] = made(step, places)
        return values


class SolverOfRanges(RangeSolver[Interface, "RangeState"]):
    """Solver of several laws as one."""

    def __init__(self, law: Interface):
        super().__init__(law)
        self._solvers = [(part.rows, part.law.remembers, part.solver()) for part in law.ranges]

    def compliance(self, diagonal: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeSolver`."""
        compliance = np.zeros(diagonal.size)
        for rows, _, solver in self._solvers:
            compliance[rows] = solver.compliance(diagonal[rows])
        return compliance

    def coupling(self, schur: np.ndarray, rows: np.ndarray, point: np.ndarray) -> float:
        """Sum over the laws.

        Args:
            schur: S, (M, M).
            rows: numbers of the rows among all conditions, (k,).
            point: parameter, (P,).
        """
        return sum(solver.coupling(schur, rows[some], point) for some, _, solver in self._solvers)

    def at_rest(self) -> Memory:
        """Memory of undeformed bodies."""
        return joined([solver.at_rest() for _, _, solver in self._solvers])

    def memory_at_rest(self, gaps: np.ndarray, point: np.ndarray) -> Memory:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeSolver`.

        Args:
            gaps: gaps of the rows, (k,).
            point: parameter at rest, (P,).
        """
        return joined(
            [solver.memory_at_rest(gaps[rows], point) for rows, _, solver in self._solvers]
        )

    def step(self, before: Memory, point: np.ndarray, seconds: float) -> StepOfRanges:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeSolver`.

        Args:
            before: memory at its start.
            point: parameter at its end, (P,).
            seconds: its duration.
        """
        steps = [
            (
                rows,
                solver.step(before, point, seconds)
                if remembers
                else solver.step(NO_MEMORY, point, np.nan),
            )
            for rows, remembers, solver in self._solvers
        ]
        return StepOfRanges(steps, sum(rows.size for rows, _ in steps))

    def difference(
        self, off: float, ends: Sequence[RangeState], rows: np.ndarray, largest: float
    ) -> float:
        """Largest error of a law.

        Args:
            off: error of the forces, relative to ``largest``.
            ends: states at the start, after the first half, after the second, and after the whole
                step.
            rows: numbers of the rows among all conditions, (k,).
            largest: largest norm of the forces so far.
        """
        return max(
            solver.difference(off, ends, rows[some], largest) for some, _, solver in self._solvers
        )

    def check(self, memory: Memory, place: str) -> None:
        """Check the memories of all laws.

        Args:
            memory: memory at the end of a step.
            place: the parameter, in words.
        """
        for _, _, solver in self._solvers:
            solver.check(memory, place)
