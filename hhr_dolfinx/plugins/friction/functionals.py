"""Outputs of frictional contact: slip, and areas that stick or slip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.models.functionals.functional import Functional, State
from hhr_dolfinx.plugins.friction.laws import SLIP, SLIPS, STICKS


@dataclass(frozen=True, eq=False)
class Remembered(Functional):
    """Slip path, work or wear of some contacts, times a factor: the largest value, or the sum."""

    differentiable: ClassVar[bool] = False

    contacts: Annotated[Integers, "contacts"]  #: numbers of contacts with friction, (c,)
    quantity: str  #: `path`, `work` or `wear`, see SlipState
    factor: float
    largest: bool

    def value(self, state: State) -> float:
        """Value up to the time of the answer."""
        if SLIP not in state.memory:
            return 0.0
        amounts = self.factor * getattr(state.memory[SLIP], self.quantity)[self.contacts]
        return float(amounts.max() if self.largest else amounts.sum())


@dataclass(frozen=True, eq=False)
class RememberedShare(Remembered):
    """Sum of such a quantity, of which the pair of the output has a share in some contacts."""

    shares: Annotated[Floats, "contacts"]  #: (c,)

    def value(self, state: State) -> float:
        """Value up to the time of the answer."""
        if SLIP not in state.memory:
            return 0.0
        return float(
            self.factor * (self.shares @ getattr(state.memory[SLIP], self.quantity)[self.contacts])
        )


@dataclass(frozen=True, eq=False)
class StatusArea(Functional):
    """Tributary areas, (c,), of the closed ones of some contacts with friction, by number, that
    stick, or that slip.
    """

    differentiable: ClassVar[bool] = False

    contacts: Annotated[Integers, "contacts"]
    areas: Annotated[Floats, "contacts"]
    sticks: bool

    def value(self, state: State) -> float:
        """Area at the time of the answer."""
        if SLIP not in state.memory:
            return 0.0
        meant = STICKS if self.sticks else SLIPS
        return float(self.areas[state.memory[SLIP].statuses[self.contacts] == meant].sum())
