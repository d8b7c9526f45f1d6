"""Surfaces that have slid so far that they press on what they were paired with where they were meshed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.errors import FarSlidingWarning
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.contact.friction import Friction, SlipState

PRESSED = 1e-9
"""Part of the largest pressure of a history below which a contact only touches."""


_TOLD: ContextVar[list[str] | None] = ContextVar("what several histories have told", default=None)


@contextmanager
def first_alone() -> Iterator[None]:
    """Of the histories in a block, the first that slides far is told of."""
    if _TOLD.get() is not None:  # whoever asked first
        yield
        return
    token = _TOLD.set([])
    try:
        yield
    finally:
        _TOLD.reset(token)


class FarSliding:
    """Looks at the steps of one history; what has slid far is said once."""

    def __init__(self) -> None:
        self._largest = 0.0
        self._said = False

    def check(self, friction: Friction, slip: SlipState, place: str) -> None:
        """Look at a step.

        Args:
            friction: of the whole contact surface.
            slip: what it remembers.
            place: the parameter, in words.

        Warns:
            FarSlidingWarning: once.
        """
        self._largest = max(self._largest, float(slip.pressure.max(initial=0.0)))
        pressing = (slip.pressure > PRESSED * self._largest) & (friction.spacing > 0)
        slid = friction.slid(slip.position)
        share = np.divide(slid, friction.spacing, out=np.zeros(slid.size), where=pressing)
        if self._said or not share.max(initial=0.0) > 1.0:
            return
        self._said = True
        told = _TOLD.get()
        if told:
            return
        if told is not None:
            told.append(place)
        at = int(share.argmax())
        warn(
            f"at {place}: contact {at} has slid by {slid[at]:.3g}, {share[at]:.2g} times the distance between the "
            "nodes it faces where it was meshed, and still presses on these. Pair surfaces that slide far anew, "
            "hhr.slide(scene)",
            FarSlidingWarning,
            stacklevel=4,
        )
