"""Wear of all conditions, and its increments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.plugins.contact_laws.ranges import Linearised, RangeSolver, RangeStep, closing

WORN = "worn_depth"
"""Name of the memory."""


@dataclass(frozen=True, eq=False)
class WornConditions(ContactLaw):
    """Depth that a condition loses per force and second, (m,), or per pressure and slip; zero where
    nothing wears.

    The rates are numbers, not parameters, so ``fixed`` is empty.
    """

    plugin: ClassVar[str] = "wear"
    name: ClassVar[str] = "wear"
    fixed: ClassVar[np.ndarray] = np.zeros(0, dtype=np.int64)  # type: ignore[misc]

    rate: Annotated[Floats, "m"]
    along: Annotated[Floats, "m"]  #: depth per pressure and length of slip, (m,)

    def within(self, conditions: np.ndarray) -> WornConditions:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return WornConditions(self.rate[conditions], self.along[conditions])

    def parts(self) -> list[str | np.ndarray]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return [self.rate, self.along]

    def opened(self, memory: Memory) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`: the worn depth is a part of the gap."""
        depth: np.ndarray = memory[WORN]
        return depth

    @property
    def layout(self) -> dict[str, tuple[str, ...]]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {WORN: ("float", "N_lambda")}

    def stored(self, memory: Memory) -> dict[str, np.ndarray]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {WORN: memory[WORN]}

    def restored(self, arrays: Mapping[str, np.ndarray]) -> Memory:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return Memory(**{WORN: arrays[WORN]})


class WearRange(RangeSolver[WornConditions, Memory]):
    """Facet ``range``, by which models solve."""

    def at_rest(self) -> Memory:
        """Nothing is worn."""
        return Memory(**{WORN: np.zeros(self.law.rate.size)})

    def step(self, before: Memory, point: np.ndarray, seconds: float) -> WearStep:
        """Backward Euler for the depth.

        Args:
            before: memory at the start.
            point: parameter at the end, (P,).
            seconds: duration.
        """
        return WearStep(self.law.rate * seconds, before[WORN], self.law.along)


class WearStep(RangeStep):
    """Conditions in one increment: slack and worn depth are zero together, or the force is.

    With the depth per force d the force is the projection max(0, y) / (1 + c d) of y = x - c s.

    Args:
        depth: depth per force, (k,).
        worn: depth at the start, (k,).
        along: depth per pressure and slip, (k,), which the next increment knows.
    """

    def __init__(self, depth: np.ndarray, worn: np.ndarray, along: np.ndarray):
        self.shift = worn
        self._depth = depth
        self._along = along

    def linearised(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, attempt: int
    ) -> Linearised:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`."""
        y = forces - stiffness * slack
        slope = (y > 0) / (1.0 + stiffness * self._depth)
        return closing(forces, slack, stiffness, slope * y, slope)

    def after(self, forces: np.ndarray, slack: np.ndarray, active: np.ndarray) -> Memory:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`."""
        return Memory(**{WORN: self.shift + self._depth * forces})

    def after_slip(self, memory: Memory, rubbed: np.ndarray) -> Memory:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`.

        Args:
            memory: depths at the end, but for those of the slip.
            rubbed: pressure integrated along the slip of the increment, (k,).
        """
        return Memory(**{WORN: memory[WORN] + self._along * rubbed})

    def carried(
        self, before: np.ndarray, forces: np.ndarray, slack: np.ndarray, active: np.ndarray
    ) -> np.ndarray:
        """Derivatives of the depths, (k, P).

        Args:
            before: those at the start, (k, P).
            forces: derivatives of the forces, (k, P).
            slack: not read.
            active: not read.

        Raises:
            NotOfferedError: for depths along the slip.
        """
        if self._along.any():
            raise NotOfferedError("derivatives of wear along the slip are not built in")
        return before + self._depth[:, None] * forces
