"""Increments of hyper-reduced bodies with friction, whose contacts outside the RID remember their slip too."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.contact.friction import SlipState
from hhr_dolfinx.contact.sliding_set import Increment, Sliding, bounds
from hhr_dolfinx.models.eliminations.elimination import CondensedContact
from hhr_dolfinx.models.frictional_fields import FrictionalFields
from hhr_dolfinx.models.histories.sliding import Reached, Slider, unknown_of


class CompletingSlider(Slider):
    """Solves increments on the contacts of the RID, and follows the slip of all others by the displacement.

    Args:
        model: whose ``friction`` is that of its RID, and whose fields know that of the whole surface.
        gradient: whether derivatives go along.
    """

    def __init__(self, model: Any, gradient: bool = False):
        super().__init__(model, gradient)
        self.frictional: FrictionalFields = model.fields.frictional
        self.surface = self.frictional.friction
        self._rows: tuple[np.ndarray, np.ndarray] | None = None

    def _at_rest(self) -> SlipState:
        return SlipState.at_rest(self.frictional.friction)

    def _position(self, before: Reached) -> np.ndarray:
        return before.slip.position[self.frictional.own]

    def _slipped(
        self, before: Reached, given: Increment, found: Sliding, contact: CondensedContact, point: np.ndarray
    ) -> SlipState:
        whole = self.frictional
        friction = whole.friction
        slack = np.zeros(self.model.conditions)
        slack[friction.tangential[whole.own]] = found.slack[self.friction.tangential]
        outside = whole.rows_outside
        position = self._position_outside(unknown_of(contact, found), point)
        slack[friction.tangential[outside]] = position - before.slip.position[outside]
        forces = whole.forces(found.forces, point)
        bound = bounds(*friction.bounds(point), forces[friction.normal])
        active = whole.active(found.active, forces, bound)
        return before.slip.after(friction, forces, slack, active, bound)

    def _position_outside(self, unknown: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Slack D - B u of the tangential rows outside the RID under gamma, (ell,): (t,)."""
        if not self.frictional.rows_outside.size:
            return np.zeros(0)
        gaps, on_modes = self._rows_outside(point)
        return gaps @ self.model.fields.amplitudes(point) - on_modes @ unknown

    def _rows_outside(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gaps of these rows, (t, 1 + T), and B V, (t, ell)."""
        if self._rows is None:
            rows = self.frictional.friction.tangential[self.frictional.rows_outside]
            gaps, on_modes = self.model.fields.contact_at(point)
            self._rows = np.asfortranarray(gaps[rows]), on_modes[rows]
        return self._rows
