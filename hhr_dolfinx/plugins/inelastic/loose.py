"""Bodies that contact alone holds, in the linearised contact problems of a step: the interface of
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
    modes: np.ndarray  #: the motions as unknowns, (n, r)

    def solved(
        self, contact: StepContact, free_slack: np.ndarray, residual: np.ndarray,
        unknown: Callable[[np.ndarray], np.ndarray], active: np.ndarray, pairs: Pairs | None,
    ) -> tuple[Statuses, np.ndarray]:  # fmt: skip
        """Forces with their statuses, and the motion, (n,).

        An undetermined motion is the least one.

        Args:
            contact: law of the contacts in this step.
            free_slack: slack without contact forces, (m,).
            residual: residual without contact forces, (n,).
            unknown: function that maps forces to the unknown without the motion, (n,).
            active: statuses, (m,) bool.
            pairs: contact pair of each condition; None for one pair.
        """

    def changed(
        self, residual: np.ndarray, free_slack: np.ndarray, active: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces, (m, K), and motions, (n, K), of small changes at constant statuses.

        Args:
            residual: changes of the residual, (n, K).
            free_slack: changes of the slack, (m, K).
            active: statuses, (m,) bool.
        """

    def undetermined(
        self, forces: np.ndarray, slack: np.ndarray, holding: np.ndarray | None
    ) -> np.ndarray | None:
        """Motions, (n, d), that forces leave undetermined, or None.

        Args:
            forces: contact forces, (m,).
            slack: slack under them, (m,).
            holding: conditions that hold bodies without a pressure, (m,) bool; None for none.
        """
