"""Slip state of the contacts of a whole surface, of which a model may solve for a part only."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from hhr_dolfinx.plugins.friction.fields import FrictionalFields
from hhr_dolfinx.plugins.friction.laws import Friction, SlipState
from hhr_dolfinx.plugins.friction.sliding_set import Increment, Sliding, bounds


class Surface(Protocol):
    """Contacts with friction; a model solves for some or all of them.

    Attributes:
        whole: friction of the whole contact surface, whose slip is stored.
    """

    whole: Friction

    def position(self, slip: SlipState) -> np.ndarray:
        """Position of the tangential rows that a model solves for, (T,)."""

    def after(
        self, before: SlipState, given: Increment, found: Sliding, unknown: Callable[[], np.ndarray], point: np.ndarray
    ) -> SlipState:
        """Slip state after an increment.

        Args:
            before: slip state before it.
            given, found: input of the increment, and its solution.
            unknown: computes the primal unknown at its end, (n,).
            point: parameter there, (P,).
        """


def surface_of(model: Any) -> Surface:
    """Surface of a model or an equilibrium, by its law and its fields."""
    return WholeSurface(model.law) if model.fields.interface is None else PartSurface(model.fields)


class WholeSurface:
    """Surface of a model that solves for all contacts."""

    def __init__(self, friction: Friction):
        self.whole = friction

    def position(self, slip: SlipState) -> np.ndarray:
        """See :class:`Surface`."""
        return slip.position

    def after(
        self, before: SlipState, given: Increment, found: Sliding, unknown: Callable[[], np.ndarray], point: np.ndarray
    ) -> SlipState:
        """See :class:`Surface`."""
        bound = given.bounds(self.whole, found.forces)
        return before.after(self.whole, found.forces, found.slack, found.active, bound)


class PartSurface:
    """Surface of a model that solves for the contacts of a RID; those outside follow the displacement.

    Args:
        fields: of a hyper-reduced model with friction, at one shape of its bodies.
    """

    def __init__(self, fields: Any):
        self._fields = fields
        self._frictional: FrictionalFields = fields.interface
        self.whole = self._frictional.friction

    def position(self, slip: SlipState) -> np.ndarray:
        """See :class:`Surface`."""
        return slip.position[self._frictional.own]

    def after(
        self, before: SlipState, given: Increment, found: Sliding, unknown: Callable[[], np.ndarray], point: np.ndarray
    ) -> SlipState:
        """See :class:`Surface`."""
        parts = self._frictional
        friction = parts.friction
        slack = np.zeros(self._fields.conditions)
        slack[friction.tangential[parts.own]] = found.slack[parts.inside.tangential]
        outside = parts.rows_outside
        if outside.size:
            gaps, on_modes = self._rows_outside
            position = gaps @ self._fields.amplitudes(point) - on_modes @ unknown()
            slack[friction.tangential[outside]] = position - before.position[outside]
        forces = parts.forces(found.forces, point)
        bound = bounds(*friction.bounds(point), forces[friction.normal])
        return before.after(friction, forces, slack, parts.active(found.active, forces, bound), bound)

    @cached_property
    def _rows_outside(self) -> tuple[np.ndarray, np.ndarray]:
        """Gaps of the tangential rows outside the RID, (t, 1 + T), and B V, (t, ell)."""
        rows = self.whole.tangential[self._frictional.rows_outside]
        return np.asfortranarray(self._fields.gaps[rows]), self._fields.contact_basis[rows]
