"""Facet ``range`` of friction: increments next to laws of other plug-ins, see
:mod:`plugins.contact_laws.ranges`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

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


class FrictionRange(RangeSolver):
    """Friction of the conditions of a range."""

    def __init__(self, law: Friction):
        super().__init__(law)
        self._far = FarSliding()

    def compliance(self, diagonal: np.ndarray) -> np.ndarray:
        """Elastic slip of rows that leave their forces undetermined."""
        found = np.zeros(diagonal.size)
        found[self.law.twice] = elastic_slip(diagonal, self.law)
        return found

    def at_rest(self) -> Memory:
        """No slip."""
        return Memory(slip=SlipState.at_rest(self.law))

    def step(self, before: Mapping[str, Any], point: np.ndarray, seconds: float) -> FrictionStep:
        """One increment."""
        return FrictionStep(self.law, before[SLIP], point)

    def difference(
        self, off: float, ends: Sequence[Any], rows: np.ndarray, largest: float
    ) -> float:
        """As that of :class:`~hhr_dolfinx.plugins.friction.slider.Slider`, of the contacts of the
        range.
        """
        own = self.law
        held = []
        for before, after in pairwise(ends[:3]):
            gap = before.slack[rows[own.normal]]
            closed = after.memory[SLIP].pressure > 0
            closed &= gap > OPEN_GAP * np.abs(gap).max(initial=0.0)
            held.append(np.linalg.norm(after.forces[rows[own.tangential]][closed[own.owner]]))
        _, _, second, whole = ends
        work = float(second.memory[SLIP].work.sum())
        change = abs(work - float(whole.memory[SLIP].work.sum()))
        return max(
            off + float(np.linalg.norm(held)) / largest,
            change / (work + WORK * second.energy or 1.0),
        )

    def check(self, memory: Mapping[str, Any], place: str) -> None:
        """Check the sliding distance."""
        self._far.check(self.law, memory[SLIP], place)

    def coupling(self, schur: np.ndarray, rows: np.ndarray, point: np.ndarray) -> float:
        """See :mod:`.uniqueness`, on the whole S: monotone laws of other rows only add to the
        left-hand side.
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
        own = self.friction
        rows = own.tangential
        pressures = own.normal
        least = np.full(pressures.size, np.inf)
        np.minimum.at(least, own.owner, stiffness[rows])
        c = stiffness.copy()
        c[rows] = least[own.owner]
        normal = self.under.linearised(forces[pressures], slack[pressures], c[pressures], attempt)
        borne = forces[pressures] - normal.off
        bound = bounds(self.coefficient, self.limit, borne)
        probed = forces[rows] - STIFFNESS_FACTORS[attempt] * c[rows] * slack[rows]
        size = own.lengths(probed)
        bears = (bound > 0) | (borne > 0)
        direction = probed / np.where(size > 0, size, 1.0)[own.owner]
        return _At(
            c, normal, bound, bound >= self.limit, bears, bears & (size > bound), direction, size
        )

    def linearised(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, attempt: int
    ) -> Linearised:
        """Newton's rows for the projection on the disc, see :mod:`.sliding_system`."""
        own = self.friction
        rows = own.tangential
        pressures = own.normal
        owner = own.owner
        at = self._at(forces, slack, stiffness, attempt)
        y = forces[rows] - at.stiffness[rows] * slack[rows]
        trial = own.lengths(y)
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
        own = self.friction.normal[rows], self.friction.normal[columns], *entries
        return OffDiagonal(*(np.concatenate(pair) for pair in zip(beside, own, strict=True)))

    def after(self, forces: np.ndarray, slack: np.ndarray, active: np.ndarray) -> Memory:
        """Slip at the end."""
        own = self.friction
        bound = bounds(self.coefficient, self.limit, forces[own.normal])
        slip = self.before.after(own, forces, np.where(active, 0.0, slack), active, bound)
        normal = self.under.after(forces[own.normal], slack[own.normal], active[own.normal])
        return Memory(slip=slip) | normal

    def slopes(self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """By coefficient and limit, (k, P)."""
        own = self.friction
        at = self._at(forces, slack, stiffness, 1)
        coefficient, limit = own.bound_slopes(self.point)
        pressure = np.maximum(forces[own.normal] - at.normal.off, 0.0)[:, None]
        grown = np.where(at.limited[:, None], limit, coefficient * pressure)[own.owner]
        found = np.zeros((forces.size, grown.shape[1]))
        found[own.tangential] = np.where(at.slips[own.owner], -at.direction, 0.0)[:, None] * grown
        found[own.normal] = self.under.slopes(
            forces[own.normal], slack[own.normal], at.stiffness[own.normal]
        )
        return found

    def carried(
        self, before: np.ndarray, forces: np.ndarray, slack: np.ndarray, active: np.ndarray
    ) -> np.ndarray:
        """The shift is minus the position, which grows by the slip, a slack that has the shift in
        it.
        """
        own = self.friction
        found = before.copy()
        found[own.tangential] -= np.where(active[own.tangential, None], 0.0, slack[own.tangential])
        of_pressures = (part[own.normal] for part in (before, forces, slack, active))
        found[own.normal] = self.under.carried(*of_pressures)
        return found

    def grazing(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, near: float
    ) -> np.ndarray:
        """Pressures about to open or to close, and contacts about to stick or to slip."""
        own = self.friction
        at = self._at(forces, slack, stiffness, 1)
        found = np.zeros(forces.size, dtype=bool)
        normal = own.normal
        found[normal] = self.under.grazing(
            forces[normal], slack[normal], at.stiffness[normal], near
        )
        slip = own.lengths(at.stiffness[own.tangential] * slack[own.tangential])
        close = np.where(
            at.slips, slip <= near, own.lengths(forces[own.tangential]) >= at.bound - near
        )
        found[own.tangential] = (close & at.bears)[own.owner]
        return found
