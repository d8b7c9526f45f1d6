"""Completion of the contact forces of a hyper-reduced model on the whole surface, by a law of interfaces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from hhr_dolfinx.contact.law import ContactLaw
    from hhr_dolfinx.contact.problem import ContactProblem


class InterfaceCompletion(Protocol):
    """Completes the forces of a law that has its own way."""

    @property
    def within(self) -> np.ndarray:
        """Conditions of the RID, (m,)."""

    @property
    def whole(self) -> ContactLaw:
        """Law of the whole contact surface."""

    @property
    def inside(self) -> ContactLaw:
        """Law of the RID, with the row numbers of the RID."""

    def forces(self, inside: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Forces on all conditions from those of the RID, (m,), at a point, (N_lambda,)."""

    def force_changes(self, inside: np.ndarray, changes: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Derivatives of :meth:`forces`, (N_lambda, P), from those of the RID, (m, P)."""

    def indicated(self, inside: np.ndarray, slack: np.ndarray, scale: np.ndarray) -> float:
        """Estimated relative error of forces.

        Args:
            inside: forces in the RID, (m,).
            slack: of all conditions under the displacement, (N_lambda,).
            scale: length by which the gap of each is measured, (N_lambda,).
        """

    def differences(self, problem: ContactProblem, point: np.ndarray) -> str:
        """Difference of the problem of a full model to the one of the training, in words; empty if there is none."""
