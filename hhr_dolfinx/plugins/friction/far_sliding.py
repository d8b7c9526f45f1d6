"""Detection of surfaces that have slid too far for the pairing of their undeformed meshes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.errors import FarSlidingWarning
from hhr_dolfinx.warn import is_first, warn

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.friction.laws import Friction, SlipState

PRESSED = 1e-9
"""Part of the largest pressure of a history below which a contact is not under load."""


class FarSliding:
    """Checks the steps of one history for far sliding; warns once."""

    def __init__(self) -> None:
        self._largest = 0.0
        self._said = False

    def check(self, friction: Friction, slip: SlipState, place: str) -> None:
        """Check a step.

        Args:
            friction: of the whole contact surface.
            slip: slip state of the step.
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
        if not is_first("far sliding"):
            return
        at = int(share.argmax())
        warn(
            f"at {place}: contact {at} has slid by {slid[at]:.3g}, {share[at]:.2g} times the distance between the "
            "nodes it faces where it was meshed, and still presses on these. Pair surfaces that slide far anew, "
            "hhr.slide(scene)",
            FarSlidingWarning,
            stacklevel=4,
        )
