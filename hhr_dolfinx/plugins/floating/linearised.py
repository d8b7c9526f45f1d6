"""Rigid motions in the linearised contact problems of a step, whose S depends on the tangents of
inelastic bodies.

A tangent of a body leaves its rigid motions without stiffness as its elasticity does: stress
depends on strain alone, and a stress does no work along a rigid motion. K of the pinned body is
therefore definite where tangents are, and the contact problem has the form of
:mod:`hhr_dolfinx.plugins.floating.statuses`, with R^T times the residual as loads.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Status, Statuses
from hhr_dolfinx.contact.law import UNILATERAL_STEP, StepContact
from hhr_dolfinx.plugins.floating.statuses import (
    BALANCED_FORCES,
    PROXIMAL_STEPS,
    FloatingEqualities,
    floating_set,
    open_motions,
)

BALANCE_ROUND_OFF = 1e-10
"""Imbalance at which the search may end if one more step does not halve it: round-off of laws."""


class LinearisedMotions:
    """Motions R as unknowns beside those of a linearisation (n unknowns, m conditions, r motions).

    ``equalities`` are those on S of the pinned bodies, ``contact_of_motions`` is B R, (m, r), and
    ``modes`` are the motions as unknowns, (n, r).
    """

    def __init__(
        self, equalities: SchurEqualities, contact_of_motions: np.ndarray, modes: np.ndarray
    ):
        self._pinned = equalities
        self.contact_of_motions = contact_of_motions
        self.modes = modes

    @cached_property
    def equalities(self) -> FloatingEqualities:
        """Equality problems on S with the motions."""
        return FloatingEqualities(self._pinned.whole(), self.contact_of_motions)

    def solved(
        self, contact: StepContact, free_slack: np.ndarray, residual: np.ndarray,
        unknown: Callable[[np.ndarray], np.ndarray], active: np.ndarray, pairs: Pairs | None,
    ) -> tuple[Statuses, np.ndarray]:  # fmt: skip
        """Forces with their statuses, and the motion, under a slack without contact forces.

        Unilateral contact that leaves motions undetermined gets the least ones of the unknown under
        its forces.

        Args:
            contact: law of the contacts in this step.
            free_slack: slack without contact forces, (m,).
            residual: residual without contact forces, (n,).
            unknown: function of the unknown under contact forces, without the motions.
            active: statuses, (m,) bool.
            pairs: contact pair of each condition; None for one pair.

        Returns:
            The statuses, and the motion, (n,).
        """
        driving = self.modes.T @ residual
        if contact is not UNILATERAL_STEP:
            statuses, motions = self._by_springs(contact, free_slack, driving, active, pairs)
            return statuses, self.modes @ motions
        equalities = self.equalities
        statuses, motions = floating_set(equalities, free_slack, driving, active, pairs)
        if statuses.status is Status.CONVERGED and self._open(statuses.forces, free_slack).shape[1]:
            slack = (
                free_slack + equalities.schur @ statuses.forces - self.contact_of_motions @ motions
            )
            amplitudes = self.modes.T @ unknown(statuses.forces) + motions
            open_ = open_motions(equalities, statuses.forces, free_slack, slack, amplitudes)
            if open_ is not None:
                motions = motions + open_.shift
                statuses = statuses._replace(active=statuses.active & ~open_.opened)
        return statuses, self.modes @ motions

    def _open(self, forces: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Amplitudes of the motions that unilateral forces leave undetermined, (r, d)."""
        return self.equalities.left_open(self.equalities.bearing(forces, slack))

    def _by_springs(
        self,
        contact: StepContact,
        free_slack: np.ndarray,
        driving: np.ndarray,
        active: np.ndarray,
        pairs: Pairs | None,
    ) -> tuple[Statuses, np.ndarray]:
        """Solve by any law: springs hold the bodies, and their ends move until they bear
        nothing.
        """
        ends = np.zeros(driving.size)
        spent = 0
        for compliance, held in self.equalities.springs:
            before = np.inf
            for _ in range(PROXIMAL_STEPS):
                statuses = contact.solved(
                    held,
                    free_slack - self.contact_of_motions @ (ends + compliance * driving),
                    active,
                    pairs,
                )
                spent += statuses.iterations
                if statuses.status is not Status.CONVERGED:
                    return statuses._replace(iterations=spent), ends
                imbalance = driving - statuses.forces @ self.contact_of_motions
                ends = ends + compliance * imbalance
                active = statuses.active
                sizes = np.abs(driving) + np.abs(statuses.forces) @ np.abs(self.contact_of_motions)
                off = float((np.abs(imbalance) / (sizes.max() or 1.0)).max())
                if off <= BALANCED_FORCES or (off <= BALANCE_ROUND_OFF and not off < 0.5 * before):
                    return statuses._replace(iterations=spent), ends
                before = off
        return statuses._replace(iterations=spent, status=Status.ADRIFT), ends

    def changed(
        self, residual: np.ndarray, free_slack: np.ndarray, active: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces and motions of a small change at constant statuses.

        Args:
            residual: changes of the residual, (n, K).
            free_slack: changes of the slack, (m, K).
            active: statuses, (m,) bool.

        Returns:
            Forces, (m, K), and motions, (n, K).
        """
        forces, _, motions = self.equalities.several(active, free_slack, self.modes.T @ residual)
        return forces, self.modes @ motions

    def undetermined(
        self, forces: np.ndarray, slack: np.ndarray, holding: np.ndarray | None
    ) -> np.ndarray | None:
        """Motions, (n, d), that forces leave undetermined; None without any.

        Args:
            forces: contact forces, (m,).
            slack: slack under them, (m,).
            holding: conditions that hold in addition to those with a pressure, such as tangential
                rows, (m,) bool; None for none.
        """
        bearing = self.equalities.bearing(forces, slack)
        ways = self.equalities.left_open(bearing if holding is None else bearing | holding)
        return self.modes @ ways if ways.shape[1] else None
