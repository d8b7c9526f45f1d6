"""Bodies that contact alone holds, in the linearised contact problems of a step: what is asked of
their kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs, Statuses
from hhr_dolfinx.contact.law import StepContact


class LinearisedKernel(Protocol):
    """Motions as unknowns of the linearised contact problems of one S (n unknowns, m
    conditions).
    """

    contact_of_motions: np.ndarray  #: (m, r)
    modes: np.ndarray  #: they as unknowns, (n, r)

    def solved(
        self, contact: StepContact, free_slack: np.ndarray, residual: np.ndarray,
        unknown: Callable[[np.ndarray], np.ndarray], active: np.ndarray, pairs: Pairs | None,
    ) -> tuple[Statuses, np.ndarray]:  # fmt: skip
        """Forces with their statuses, and the motion, (n,), under a free slack, (m,), and a
        residual, (n,).

        ``unknown`` maps forces to the unknown without the motion, (n,), of which an undetermined
        one is the least.
        """

    def changed(
        self, residual: np.ndarray, free_slack: np.ndarray, active: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces, (m, K), and motions, (n, K), of small changes at constant statuses."""

    def undetermined(
        self, forces: np.ndarray, slack: np.ndarray, holding: np.ndarray | None
    ) -> np.ndarray | None:
        """Motions, (n, d), that forces on conditions, beside those that hold anyway, leave
        undetermined, or None.
        """
