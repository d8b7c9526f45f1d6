"""Conditions that hold their surfaces together once these have pressed, and their increments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.plugins.contact_laws.ranges import Linearised, RangeSolver, RangeStep, closing

HELD_ONCE = "held"
"""Name of the memory: 1 of conditions that have pressed, 0 of others."""
NOTHING_FITTED = 1e-3
"""Part of the largest force below which a fitted one counts as none: modes are no closer there."""
ROUND_OFF_OVERLAP = 1e-12
"""Overlap over the size of the mesh up to which surfaces that touch have not pressed."""


@dataclass(frozen=True, eq=False)
class HeldConditions(ContactLaw):
    """Conditions whose surfaces do not separate any more once they have pressed, (m,).

    It has no parameters, so ``fixed`` is empty.
    """

    plugin: ClassVar[str] = "no_separation"
    name: ClassVar[str] = "contact without separation"
    floats: ClassVar[bool] = True
    reshapes: ClassVar[bool] = True
    fixed: ClassVar[np.ndarray] = np.zeros(0, dtype=np.int64)  # type: ignore[misc]

    least: Annotated[Floats, "m"]  #: overlap without contact from which on they press, (m,)

    def within(self, conditions: np.ndarray) -> HeldConditions:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return HeldConditions(self.least[conditions])

    def parts(self) -> list[str | np.ndarray]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return [self.least]

    def pulling(self, count: int) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`: all."""
        return np.ones(count, dtype=bool)

    def limited(
        self, forces: np.ndarray, changes: np.ndarray, fitted: np.ndarray, point: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fitted forces, of which small ones are none, see
        :class:`~hhr_dolfinx.contact.law.ContactLaw`.

        Args:
            forces: forces, (m,).
            changes: their derivatives, (m, P).
            fitted: forces to limit, (m,) bool.
            point: not read.
        """
        small = np.abs(forces) <= NOTHING_FITTED * np.abs(forces).max(initial=0.0)
        none = fitted & small
        kept = np.where(none, 0.0, forces)
        return kept, np.where(none[:, None], 0.0, changes), kept != 0

    @property
    def layout(self) -> dict[str, tuple[str, ...]]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {HELD_ONCE: ("float", "N_lambda")}

    def stored(self, memory: Memory) -> dict[str, np.ndarray]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {HELD_ONCE: memory[HELD_ONCE]}

    def restored(self, arrays: Mapping[str, np.ndarray]) -> Memory:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return Memory(**{HELD_ONCE: arrays[HELD_ONCE]})


class HoldingRange(RangeSolver[HeldConditions, Memory]):
    """Facet ``range``, by which models solve."""

    def at_rest(self) -> Memory:
        """Nothing has pressed."""
        return Memory(**{HELD_ONCE: np.zeros(self.law.least.size)})

    def step(self, before: Memory, point: np.ndarray, seconds: float) -> HoldingStep:
        """One increment.

        Args:
            before: memory at its start.
            point: not read.
            seconds: not read.
        """
        return HoldingStep(before[HELD_ONCE] > 0, self.law.least)


class HoldingStep(RangeStep):
    """Unilateral conditions, and held ones, whose slack is zero under any force.

    Args:
        held: conditions that have pressed before, (k,) bool.
        least: overlap from which on others press, (k,).
    """

    def __init__(self, held: np.ndarray, least: np.ndarray):
        self._least = least
        self.shift = np.zeros(held.size)
        self._held = held

    def linearised(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, attempt: int
    ) -> Linearised:
        """The projection of y = x - c s is y of held conditions, and max(0, y) of others, where
        round-off is no force.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
            attempt: not read.
        """
        y = forces - stiffness * slack
        closed = self._held | (y > stiffness * self._least)
        return closing(forces, slack, stiffness, np.where(closed, y, 0.0), closed.astype(float))

    def after(self, forces: np.ndarray, slack: np.ndarray, active: np.ndarray) -> Memory:
        """Conditions that have pressed are held from now on.

        Args:
            forces: forces of the rows, (k,).
            slack: not read.
            active: not read.
        """
        return Memory(**{HELD_ONCE: (self._held | (forces > 0)).astype(float)})

    def grazing(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, near: float
    ) -> np.ndarray:
        """Conditions that are not held, and about to open or to close, (k,) bool.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
            near: force below which a row counts as at a kink.
        """
        return ~self._held & super().grazing(forces, slack, stiffness, near)
