"""Surfaces that have slid so far that they press on what they were paired with where they were meshed."""

from __future__ import annotations

import warnings

import numpy as np

from hhr_dolfinx.contact.friction import Friction, SlipState
from hhr_dolfinx.errors import FarSlidingWarning

PRESSED = 1e-9
"""Part of the largest pressure of a history below which a contact only touches."""


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
        at = int(share.argmax())
        warnings.warn(
            f"at {place}: contact {at} has slid by {slid[at]:.3g}, {share[at]:.2g} times the distance to the next node "
            "of its surface, and presses on what it was paired with where it was meshed. Pair surfaces that slide far "
            "anew, hhr.slide(scene)",
            FarSlidingWarning,
            stacklevel=4,
        )
