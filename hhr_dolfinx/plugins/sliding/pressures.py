"""Laws of other plug-ins on pressures, beside the friction of surfaces that slide.

What a law remembers of a pair belongs to the nodes of its slave, and moves with them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.contact.law import UNILATERAL, ContactLaw
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.plugins.contact_laws.interface import Interface, Range, ranged
from hhr_dolfinx.plugins.contact_laws.layers import StepOfRanges
from hhr_dolfinx.plugins.contact_laws.range_increments import SolversOfRanges, joined
from hhr_dolfinx.plugins.contact_laws.ranges import (
    Linearised,
    OffDiagonal,
    Ranges,
    RangeStep,
    Together,
)
from hhr_dolfinx.plugins.friction.laws import Friction, places_of
from hhr_dolfinx.plugins.friction.over import FrictionWithPressureLaws
from hhr_dolfinx.plugins.friction.range import FrictionRange, FrictionStep
from hhr_dolfinx.plugins.friction.sliding_set import Sliding

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.friction.slider import IncrementEnd, SlidingState
    from hhr_dolfinx.plugins.friction.sliding_set import SlidingIncrement


FACING = "facing_share"
"""Name of the memory of the share of each contact's area that faces its master."""


@dataclass(frozen=True)
class SlidingFriction(Friction):
    """Friction of all contacts, the slave nodes of pairs that slide first."""

    @property
    def layout(self) -> dict[str, tuple[str, ...]]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {**super().layout, FACING: ("float", "frictional")}

    def stored(self, memory: Memory) -> dict[str, np.ndarray]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {**super().stored(memory), FACING: memory[FACING]}

    def restored(self, arrays: Mapping[str, np.ndarray]) -> Memory:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return super().restored(arrays) | Memory(**{FACING: arrays[FACING]})


@dataclass(frozen=True)
class FrictionBesideLaws(FrictionWithPressureLaws, SlidingFriction):
    """Friction of all contacts, and laws on the pressures of some."""

    #: laws on all pressures: those of the pairs that do not slide, then of the slave nodes. Each
    #: range of them is of contacts with friction alone, or of none
    pressures: Range

    @classmethod
    def of_laws(cls, friction: Friction, pressures: Range) -> FrictionBesideLaws:
        """Friction beside laws on pressures.

        Args:
            friction: friction of all contacts.
            pressures: the laws, and the rows of the pressures.
        """
        known = {each.name: getattr(friction, each.name) for each in fields(friction)}
        return cls(**known, pressures=pressures)

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults: those of friction, and ranges of which friction has a part."""
        yield from super().faults(sizes)
        law = self.pressures.law
        if not isinstance(law, Interface):
            yield "laws of pressures are not on ranges"
            return
        for law_range in law.ranges:
            with_friction = np.isin(self.pressures.rows[law_range.rows], self.normal)
            if with_friction.any() and not with_friction.all():
                yield "a law of pressures is on contacts with friction and on others"


def before_dofs(law: ContactLaw, kept: int, count: int) -> ContactLaw:
    """The law of the pairs that do not slide, on conditions that rows of dofs follow.

    Args:
        law: law of the pairs that do not slide, on their conditions.
        kept: number of these.
        count: number of all rows.
    """
    if isinstance(law, Friction) or not law.plugin:
        return law
    rest = Range(UNILATERAL, np.arange(kept, count))
    return Interface((*ranged(law, kept).ranges, rest))


def beside_laws(
    friction: Friction, of_others: ContactLaw, of_slaves: Sequence[Range], first: int
) -> Friction:
    """Friction of all contacts, beside laws on pressures if there are any.

    Args:
        friction: friction of all contacts, in the order of all rows.
        of_others: law of the pairs that do not slide.
        of_slaves: laws of the pairs that slide, on their slave nodes.
        first: row of the first slave node.

    Raises:
        SceneError: for two laws of one plug-in, on pairs that slide and on others.
    """
    others = [item for item in ranged(of_others, first).ranges if item.law.plugin != "friction"]
    slaves = [Range(item.law, first + item.rows) for item in of_slaves]
    given = [item for item in (*others, *slaves) if item.law.plugin]
    if not given:
        return friction
    _check_once(given)
    slave_nodes = friction.normal[friction.normal >= first]
    rows = np.concatenate([np.setdiff1d(np.arange(first), friction.tangential), slave_nodes])
    placed = [Range(item.law, places_of(item.rows, rows)) for item in given]
    free = np.setdiff1d(rows, np.concatenate([item.rows for item in given]))
    with_friction = np.isin(free, friction.normal)
    placed += [
        Range(UNILATERAL, places_of(some, rows))
        for some in (free[with_friction], free[~with_friction])
        if some.size
    ]
    return FrictionBesideLaws.of_laws(friction, Range(Interface(tuple(placed)), rows))


def _check_once(ranges: Sequence[Range]) -> None:
    """Raise SceneError for two ranges of one plug-in: its memory has the rows of one."""
    names = [item.law.plugin for item in ranges]
    for name in names:
        if names.count(name) > 1:
            raise SceneError(
                f"pairs that slide and others have laws of the plug-in '{name}', whose memory has "
                "the conditions of one of both: that is not built in. Give one of both another law"
            )


class _FacingStep(RangeStep):
    """A law on contacts of which a share of the area faces the master, (k,).

    Forces of a law are pressures times areas: those on a share are the share of its forces.
    """

    def __init__(self, step: RangeStep, share: np.ndarray):
        self._step = step
        self._share = share
        self.shift = step.shift

    def linearised(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, attempt: int
    ) -> Linearised:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`: P x + Q s = r of forces
        x / share is P x + share Q s = share r.

        Args:
            forces: forces of the contacts, (k,).
            slack: slacks of the contacts, (k,).
            stiffness: c, force per slack of each contact, (k,).
            attempt: number of the way to choose statuses.
        """
        share = self._share
        at = self._step.linearised(forces / share, slack, stiffness / share, attempt)
        coupling = at.coupling
        if coupling is not None:
            rows, columns, on_forces, on_slack = coupling
            on_forces = on_forces * share[rows] / share[columns]
            coupling = OffDiagonal(rows, columns, on_forces, on_slack * share[rows])
        return at._replace(
            off=at.off * share,
            on_slack=at.on_slack * share,
            right=at.right * share,
            coupling=coupling,
        )

    def after(self, forces: np.ndarray, slack: np.ndarray, active: np.ndarray) -> Memory:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`.

        Args:
            forces: forces of the contacts, (k,).
            slack: slacks of the contacts, (k,).
            active: contacts that touch, (k,) bool.
        """
        return self._step.after(forces / self._share, slack, active)


class PressureLaws:
    """Solves increments on one pairing after another, with friction beside laws on pressures."""

    def __init__(self, law: FrictionBesideLaws):
        self._pressures = law.pressures.rows
        self._solvers = SolversOfRanges(law.laws_of_pressures)
        self._rows = [self._pressures[rows] for rows in self._solvers.rows]
        self._with_friction = [bool(np.isin(rows, law.normal).all()) for rows in self._rows]

    def at_rest(self, gaps: np.ndarray, point: np.ndarray) -> Memory:
        """Memory of undeformed bodies.

        Args:
            gaps: gaps of all rows, (M,).
            point: parameter at rest, (P,).
        """
        return self._solvers.at_rest(gaps[self._pressures], point)

    def solved(
        self,
        schur: np.ndarray,
        friction: Friction,
        given: SlidingIncrement,
        share: np.ndarray,
        before: SlidingState,
        target: IncrementEnd,
    ) -> tuple[Sliding, Memory]:
        """Solution of an increment on one pairing, and the memory of the laws on pressures.

        Args:
            schur: S of the pairing, (M, M).
            friction: friction of its rows.
            given: loads and bounds of friction.
            share: part of the area of each contact that faces its master, (C,).
            before: state at the start.
            target: end of the increment.
        """
        of_friction = np.sort(np.concatenate([friction.normal, friction.tangential]))
        local = friction.within(of_friction)
        steps = self._solvers.steps(before.laws, target.point, target.time - before.time)
        laws = list(zip(self._rows, steps, self._with_friction, strict=True))
        under = [(places_of(rows, friction.normal), step) for rows, step, both in laws if both]
        alone = [(rows, step) for rows, step, both in laws if not both]
        facing = [(places, _FacingStep(step, share[places])) for places, step in under]
        of_contacts = StepOfRanges(facing, friction.normal.size)
        step_of_friction = FrictionStep(local, before.slip, target.point, of_contacts)
        step_of_friction.coefficient = given.coefficient
        step_of_friction.limit = given.limit
        compliance = np.zeros(len(schur))
        diagonal = np.abs(np.diag(schur))[of_friction]
        compliance[of_friction] = FrictionRange(local).compliance(diagonal)
        free = given.slack.copy()
        # slacks are slips of the increment: the step of friction would take off what was before
        free[friction.tangential] += before.slip.position
        ranges = Ranges(schur, [of_friction, *(rows for rows, _ in alone)], compliance)
        every = [step_of_friction, *(step for _, step in alone)]
        found = _as_sliding(ranges.solve(free, every, before.forces), friction)
        memories = [
            step.after(found.forces[rows], found.slack[rows], found.active[rows])
            for rows, step in ((friction.normal, of_contacts), *alone)
        ]
        return found, joined(memories)


def _as_sliding(found: Together, friction: Friction) -> Sliding:
    """The outcome as one of friction: contacts that stick do not slip by round-off."""
    slack = found.slack.copy()
    slack[np.intersect1d(np.flatnonzero(found.active), friction.tangential)] = 0.0
    return Sliding(
        found.forces,
        found.active,
        slack,
        np.zeros(0),
        found.iterations,
        found.projections,
        found.status,
        found.unsettled,
    )
