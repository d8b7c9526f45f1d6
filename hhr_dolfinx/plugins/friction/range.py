"""Facet ``range`` of friction: increments next to laws of other plug-ins, see
:mod:`plugins.contact_laws.ranges`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hhr_dolfinx.memory import Memory
from hhr_dolfinx.plugins.contact_laws.ranges import (
    Linearised,
    OffDiagonal,
    RangeSolver,
    RangeStep,
    UnilateralStep,
)
from hhr_dolfinx.plugins.friction.laws import SLIP, Friction, SlipState, bounds
from hhr_dolfinx.plugins.friction.slider import OPEN_GAP, WORK
from hhr_dolfinx.plugins.friction.sliding_set import STIFFNESS_FACTORS, elastic_slip
from hhr_dolfinx.plugins.friction.surfaces import FarSliding
from hhr_dolfinx.plugins.friction.uniqueness import coupling

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.contact_laws.range_increments import RangeState


class FrictionRange(RangeSolver):
    """Friction of the conditions of a range."""

    def __init__(self, law: Friction):
        super().__init__(law)
        self._far = FarSliding()

    def compliance(self, diagonal: np.ndarray) -> np.ndarray:
        """Elastic slip of rows that leave their forces undetermined."""
        compliance = np.zeros(diagonal.size)
        compliance[self.law.twice] = elastic_slip(diagonal, self.law)
        return compliance

    def at_rest(self) -> Memory:
        """No slip, and no contact."""
        contacts = np.zeros(self.law.normal.size)
        rows = np.zeros(self.law.tangential.size)
        nothing = (contacts,) * 5
        return Memory(slip=SlipState(rows, *nothing, np.zeros(contacts.size, dtype=np.int64)))

    def memory_at_rest(self, gaps: np.ndarray, point: np.ndarray) -> Memory:
        """No slip; contacts that touch stick.

        Args:
            gaps: gaps of the rows, (k,).
            point: parameter at rest, (P,).
        """
        return Memory(slip=SlipState.at_rest(self.law, gaps[self.law.normal], point))

    def step(self, before: Memory, point: np.ndarray, seconds: float) -> FrictionStep:
        """One increment.

        Args:
            before: memory at its start.
            point: parameter at its end, (P,).
            seconds: its duration, which friction does not read.
        """
        return FrictionStep(self.law, before[SLIP], point)

    def difference(
        self, off: float, ends: Sequence[RangeState], rows: np.ndarray, largest: float
    ) -> float:
        """As that of :class:`~hhr_dolfinx.plugins.friction.slider.Slider`, of the contacts of the
        range.

        Args:
            off: error of the forces of the rows, relative to ``largest``.
            ends: states at the start, after the first half, after the second, and after the whole
                step.
            rows: numbers of the rows among all conditions, (k,).
            largest: largest norm of the forces so far.
        """
        friction = self.law
        held = []
        for before, after in pairwise(ends[:3]):
            gap = before.slack[rows[friction.normal]]
            closed = after.memory[SLIP].pressure > 0
            closed &= gap > OPEN_GAP * np.abs(gap).max(initial=0.0)
            held.append(
                np.linalg.norm(after.forces[rows[friction.tangential]][closed[friction.owner]])
            )
        _, _, second, undivided = ends
        work = float(second.memory[SLIP].work.sum())
        change = abs(work - float(undivided.memory[SLIP].work.sum()))
        return max(
            off + float(np.linalg.norm(held)) / largest,
            change / (work + WORK * second.energy or 1.0),
        )

    def check(self, memory: Memory, place: str) -> None:
        """Check the sliding distance.

        Args:
            memory: memory at the end of a step.
            place: description of the point, for messages.
        """
        self._far.check(self.law, memory[SLIP], place)

    def coupling(self, schur: np.ndarray, rows: np.ndarray, point: np.ndarray) -> float:
        """See :mod:`.uniqueness`, on the whole S: monotone laws of other rows only add to the
        left-hand side.

        Args:
            schur: S, (M, M).
            rows: numbers of the rows among all conditions, (k,).
            point: parameter, (P,).
        """
        coefficient, _ = self.law.bounds(point)
        return coupling(schur, self.law.among(rows), coefficient)


class _At(NamedTuple):
    """Statuses of the contacts, (C,), and vectors of tangential rows, (T,), at an iterate."""

    stiffness: np.ndarray  #: c of all rows, the same for both directions of a contact
    normal: Linearised  #: law of the pressures
    bound: np.ndarray
    limited: np.ndarray  #: bool
    bears: np.ndarray  #: bool
    slips: np.ndarray  #: bool
    direction: np.ndarray  #: (T,)
    size: np.ndarray  #: length of the vector by which statuses are chosen


class FrictionStep(RangeStep):
    """Friction from a slip state to a point, (P,).

    ``under`` is the law of the pressures, unilateral by default.
    """

    def __init__(
        self,
        friction: Friction,
        before: SlipState,
        point: np.ndarray,
        under: RangeStep | None = None,
    ):
        self.friction = friction
        self.under = under or UnilateralStep(friction.normal.size)
        self.before = before
        self.point = point
        self.coefficient, self.limit = friction.bounds(point)
        self.shift = np.zeros(friction.normal.size + friction.tangential.size)
        self.shift[friction.tangential] = -before.position
        self.shift[friction.normal] = self.under.shift
        self._turns = (
            np.bincount(friction.owner, minlength=friction.normal.size)[friction.owner] > 1
        )

    def _at(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, attempt: int
    ) -> _At:
        friction = self.friction
        rows = friction.tangential
        pressures = friction.normal
        least = np.full(pressures.size, np.inf)
        np.minimum.at(least, friction.owner, stiffness[rows])
        c = stiffness.copy()
        c[rows] = least[friction.owner]
        normal = self.under.linearised(forces[pressures], slack[pressures], c[pressures], attempt)
        borne = forces[pressures] - normal.off
        bound = bounds(self.coefficient, self.limit, borne)
        probed = forces[rows] - STIFFNESS_FACTORS[attempt] * c[rows] * slack[rows]
        size = friction.lengths(probed)
        bears = (bound > 0) | (borne > 0)
        direction = probed / np.where(size > 0, size, 1.0)[friction.owner]
        return _At(
            c, normal, bound, bound >= self.limit, bears, bears & (size > bound), direction, size
        )

    def linearised(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, attempt: int
    ) -> Linearised:
        """Newton's rows for the projection on the disc, see :mod:`.sliding_system`.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
            attempt: number of the way to choose statuses; 1 gives those of the residual.
        """
        friction = self.friction
        rows = friction.tangential
        pressures = friction.normal
        owner = friction.owner
        at = self._at(forces, slack, stiffness, attempt)
        y = forces[rows] - at.stiffness[rows] * slack[rows]
        trial = friction.lengths(y)
        share = np.divide(at.bound, trial, out=np.ones(trial.size), where=trial > at.bound)
        off, on_forces, on_slack, right = np.zeros((4, forces.size))
        for values, own_part in zip((off, on_forces, on_slack, right), at.normal, strict=False):
            values[pressures] = own_part
        off[rows] = forces[rows] - y * share[owner]
        bears = at.bears[owner]
        slips = at.slips[owner]
        d = np.where(slips, at.direction, 0.0)
        # across the slip a turning contact sticks, with a compliance that grows with the slip
        yielding = np.where(
            slips & self._turns, at.bound[owner] / np.where(slips, at.size[owner], 1.0), 0.0
        )
        across = yielding * (1.0 - d**2)
        probe = STIFFNESS_FACTORS[attempt] * at.stiffness[rows]
        on_forces[rows] = np.where(slips, 1.0 - across, ~bears)
        on_slack[rows] = np.where(slips, probe * across, np.where(bears, at.stiffness[rows], 0.0))
        limited = at.limited[owner]
        right[rows] = np.where(limited & slips, at.bound[owner] * d, 0.0)
        follows = np.flatnonzero(slips & ~limited)
        turning = np.flatnonzero(slips & self._turns)
        partner = turning.reshape(-1, 2)[:, ::-1].ravel()
        mixed = yielding[turning] * d[turning] * d[partner]
        beside = OffDiagonal(
            np.concatenate([rows[follows], rows[turning]]),
            np.concatenate([pressures[owner[follows]], rows[partner]]),
            np.concatenate([-self.coefficient[owner[follows]] * d[follows], mixed]),
            np.concatenate([np.zeros(follows.size), -probe[turning] * mixed]),
        )
        active = np.zeros(forces.size, dtype=bool)
        active[pressures] = at.normal.active
        active[rows] = bears & ~slips
        key = (
            at.normal.key
            + at.bears.tobytes()
            + at.slips.tobytes()
            + np.sign(d).tobytes()
            + limited.tobytes()
        )
        return Linearised(
            off, on_forces, on_slack, right, key, active, self._with_under(beside, at.normal)
        )

    def _with_under(self, beside: OffDiagonal, normal: Linearised) -> OffDiagonal:
        """Entries of friction, and those of the law of the pressures."""
        if normal.coupling is None:
            return beside
        rows, columns, *entries = normal.coupling
        of_pressures = self.friction.normal[rows], self.friction.normal[columns], *entries
        return OffDiagonal(
            *(np.concatenate(pair) for pair in zip(beside, of_pressures, strict=True))
        )

    def after(self, forces: np.ndarray, slack: np.ndarray, active: np.ndarray) -> Memory:
        """Slip at the end.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            active: rows that touch or stick, (k,) bool.
        """
        friction = self.friction
        bound = bounds(self.coefficient, self.limit, forces[friction.normal])
        slip = self.before.after(friction, forces, np.where(active, 0.0, slack), active, bound)
        normal = self.under.after(
            forces[friction.normal], slack[friction.normal], active[friction.normal]
        )
        rubbed = slip.wear - self.before.wear
        return Memory(slip=slip) | self.under.after_slip(normal, rubbed)

    def slopes(self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """Derivatives of the residual by coefficient and limit, (k, P).

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
        """
        friction = self.friction
        at = self._at(forces, slack, stiffness, 1)
        coefficient, limit = friction.bound_slopes(self.point)
        pressure = np.maximum(forces[friction.normal] - at.normal.off, 0.0)[:, None]
        grown = np.where(at.limited[:, None], limit, coefficient * pressure)[friction.owner]
        slopes = np.zeros((forces.size, grown.shape[1]))
        slopes[friction.tangential] = (
            np.where(at.slips[friction.owner], -at.direction, 0.0)[:, None] * grown
        )
        slopes[friction.normal] = self.under.slopes(
            forces[friction.normal], slack[friction.normal], at.stiffness[friction.normal]
        )
        return slopes

    def shifted(self, before: np.ndarray) -> np.ndarray:
        """Of a law of the pressures as it has it.

        Args:
            before: derivatives of the memory, (k, P).
        """
        changes = before.copy()
        normal = self.friction.normal
        changes[normal] = self.under.shifted(before[normal])
        return changes

    def carried(
        self, before: np.ndarray, forces: np.ndarray, slack: np.ndarray, active: np.ndarray
    ) -> np.ndarray:
        """The shift is minus the position, which grows by the slip, a slack that has the shift in
        it.

        Args:
            before: derivatives of the shift, (k, P).
            forces: derivatives of the forces, (k, P).
            slack: derivatives of the slacks, (k, P).
            active: rows that touch or stick, (k,) bool.
        """
        friction = self.friction
        changes = before.copy()
        changes[friction.tangential] -= np.where(
            active[friction.tangential, None], 0.0, slack[friction.tangential]
        )
        of_pressures = (values[friction.normal] for values in (before, forces, slack, active))
        changes[friction.normal] = self.under.carried(*of_pressures)
        return changes

    def grazing(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, near: float
    ) -> np.ndarray:
        """Mask of pressures about to open or to close, and of contacts about to stick or to slip.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
            near: force below which a row counts as at a kink.
        """
        friction = self.friction
        at = self._at(forces, slack, stiffness, 1)
        mask = np.zeros(forces.size, dtype=bool)
        normal = friction.normal
        mask[normal] = self.under.grazing(forces[normal], slack[normal], at.stiffness[normal], near)
        slip = friction.lengths(at.stiffness[friction.tangential] * slack[friction.tangential])
        close = np.where(
            at.slips, slip <= near, friction.lengths(forces[friction.tangential]) >= at.bound - near
        )
        mask[friction.tangential] = (close & at.bears)[friction.owner]
        return mask
