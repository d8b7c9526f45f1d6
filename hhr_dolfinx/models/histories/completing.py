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

    def _at_rest(self) -> SlipState:
        return SlipState.at_rest(self.frictional.friction)

    def _position(self, before: Reached) -> np.ndarray:
        return before.slip.position[self.frictional.own]

    def _slipped(
        self, before: Reached, given: Increment, found: Sliding, contact: CondensedContact, point: np.ndarray
    ) -> SlipState:
        whole = self.frictional
        friction = whole.friction
        position = before.slip.position + self._moved_outside(before, contact, found, point)
        position[whole.own] = before.slip.position[whole.own] + found.slack[self.friction.tangential]
        slack = np.zeros(self.model.conditions)
        slack[friction.tangential] = position - before.slip.position
        forces = whole.forces(found.forces, point)
        bound = bounds(*friction.bounds(point), forces[friction.normal])
        active = whole.active(found.active, forces, bound)
        return before.slip.after(friction, forces, slack, active, bound)

    def _moved_outside(
        self, before: Reached, contact: CondensedContact, found: Sliding, point: np.ndarray
    ) -> np.ndarray:
        """What all tangential rows have moved by since the increment before, (T,)."""
        if not self.frictional.outside.size:
            return np.zeros(before.slip.position.size)
        rows = self.frictional.friction.tangential
        fields = self.model.fields
        gaps, on_modes = fields.contact_at(point)
        return (
            gaps[rows] @ fields.amplitudes(point) - on_modes[rows] @ unknown_of(contact, found) - before.slip.position
        )
