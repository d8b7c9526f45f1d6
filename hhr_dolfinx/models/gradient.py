"""Derivatives of an answer along the parameters, on its active set.

An answer has a kink where a condition is neither open nor closed by more than round-off. The
derivative is then that of the side on which the statuses stay as they are, and the gradient is
marked as one-sided.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

CHANGING_STATUS = 1e-7
"""Part of the largest force, or slack, below which a condition counts as about to change its
status.
"""


class Gradient(NamedTuple):
    """Derivatives along the P parameters, with the statuses fixed.

    Attributes:
        unknown: of the unknown of the model, (n, P).
        multipliers: of the forces on its conditions, (m, P).
        grazing: conditions about to change their status, whose derivative is one-sided, (m,) bool.
        slack: of the slack, (m, P).
        kinks: number of material points at a kink of their law, and of such points and conditions
            in earlier steps.
        note: path along which the derivatives are computed, and how far they have converged, if
            they depend on one.
    """

    unknown: np.ndarray
    multipliers: np.ndarray
    grazing: np.ndarray
    slack: np.ndarray
    kinks: int = 0
    note: str = ""

    @property
    def one_sided(self) -> bool:
        """True if the derivative holds on one side only."""
        return bool(self.grazing.any()) or self.kinks > 0


def grazing(active: np.ndarray, forces: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """Conditions about to change their status, (m,) bool.

    Args:
        active: statuses, (m,) bool.
        forces: contact forces, (m,).
        slack: slack, (m,).
    """
    near = (
        CHANGING_STATUS * np.abs(forces).max(initial=0.0),
        CHANGING_STATUS * np.abs(slack).max(initial=0.0),
    )
    return np.where(active, forces <= near[0], slack <= near[1])
