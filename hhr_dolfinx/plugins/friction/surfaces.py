"""Slip state of the contacts of a whole surface, of which a model may solve for a part only."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, cast

import numpy as np

from hhr_dolfinx.errors import FarSlidingWarning
from hhr_dolfinx.models.answer import InterfaceCompletion
from hhr_dolfinx.plugins.friction.laws import Friction, SlipState, bounds
from hhr_dolfinx.plugins.friction.sliding_set import Sliding, SlidingIncrement
from hhr_dolfinx.warn import is_first, warn

LOADED_PRESSURE = 1e-9
"""Part of the largest pressure of a history below which a contact is not under load."""


class SolvedContacts:
    """Contacts with friction of a model that solves for all of them.

    ``whole`` is the friction whose slip is stored.
    """

    def __init__(self, friction: Friction):
        self.whole = friction

    @classmethod
    def of(cls, model: Any) -> SolvedContacts:
        """Surface of a model or an equilibrium, by its law and its fields."""
        return (
            SolvedContacts(model.law)
            if model.fields.interface is None
            else _PartSurface(model.fields)
        )

    def at_rest(self, gaps: np.ndarray, point: np.ndarray) -> SlipState:
        """Slip state of undeformed bodies.

        Args:
            gaps: gaps of the rows that the model solves for, (M,).
            point: parameter at rest, (P,).
        """
        return SlipState.at_rest(self.whole, gaps[self.whole.normal], point)

    def position(self, slip: SlipState) -> np.ndarray:
        """Position of the tangential rows that a model solves for, (T,)."""
        return slip.position

    def after(
        self,
        before: SlipState,
        given: SlidingIncrement,
        found: Sliding,
        unknown: Callable[[], np.ndarray],
        point: np.ndarray,
    ) -> SlipState:
        """Slip state after an increment with a solution.

        Args:
            before: slip state at its start.
            given: loads and friction bounds of the increment.
            found: its solution.
            unknown: function of the primal unknown at its end, (n,).
            point: parameter at its end, (P,).
        """
        bound = given.bounds(self.whole, found.forces)
        return before.after(self.whole, found.forces, found.slack, found.active, bound)


class _PartSurface(SolvedContacts):
    """Surface of a hyper-reduced model, at one shape.

    Contacts outside its RID follow the displacement.
    """

    def __init__(self, fields: Any):
        self._fields = fields
        self._parts: InterfaceCompletion = fields.interface
        # friction of the RID, with the row numbers of the RID
        self._inside = cast("Friction", self._parts.inside)
        super().__init__(cast("Friction", self._parts.whole))

    def at_rest(self, gaps: np.ndarray, point: np.ndarray) -> SlipState:
        normal = self.whole.normal
        everywhere = self._fields.gaps[normal] @ self._fields.amplitudes(point)
        return SlipState.at_rest(self.whole, everywhere, point)

    def position(self, slip: SlipState) -> np.ndarray:
        return slip.position[self._own]

    def after(
        self,
        before: SlipState,
        given: SlidingIncrement,
        found: Sliding,
        unknown: Callable[[], np.ndarray],
        point: np.ndarray,
    ) -> SlipState:
        """See :class:`SolvedContacts`; contacts outside the RID follow the displacement.

        Args:
            before: slip state at its start.
            given: loads and friction bounds of the increment.
            found: its solution.
            unknown: function of the primal unknown at its end, (n,).
            point: parameter at its end, (P,).
        """
        friction = self.whole
        slack = np.zeros(self._fields.conditions)
        slack[friction.tangential[self._own]] = found.slack[self._inside.tangential]
        following = self._outside
        if following.size:
            gaps, on_modes = self._rows_outside
            position = gaps @ self._fields.amplitudes(point) - on_modes @ unknown()
            slack[friction.tangential[following]] = position - before.position[following]
        forces, active = self._parts.completed(found.forces, found.active, point)
        bound = bounds(*friction.bounds(point), forces[friction.normal])
        return before.after(friction, forces, slack, active, bound)

    @cached_property
    def _own(self) -> np.ndarray:
        """Indices of the tangential rows of the RID among all tangential ones, in the order of the
        RID.
        """
        return np.searchsorted(self.whole.tangential, self._parts.within[self._inside.tangential])

    @cached_property
    def _outside(self) -> np.ndarray:
        """Indices of the tangential rows outside the RID among all tangential ones, (t,)."""
        return np.flatnonzero(~np.isin(self.whole.tangential, self._parts.within))

    @cached_property
    def _rows_outside(self) -> tuple[np.ndarray, np.ndarray]:
        """Gaps of the tangential rows outside the RID, (t, 1 + T), and B V, (t, ell)."""
        rows = self.whole.tangential[self._outside]
        return np.asfortranarray(self._fields.gaps[rows]), self._fields.contact_basis[rows]


class FarSliding:
    """Warns once of a history in which a surface slides too far for the pairing of its undeformed
    meshes.
    """

    def __init__(self) -> None:
        self._largest = 0.0
        self._said = False

    def check(self, friction: Friction, slip: SlipState, place: str) -> None:
        """Check the slip of the whole contact surface after a step.

        Args:
            friction: friction of the whole contact surface.
            slip: its slip state.
            place: the parameter in words.

        Warns:
            FarSlidingWarning: once.
        """
        self._largest = max(self._largest, float(slip.pressure.max(initial=0.0)))
        pressing = (slip.pressure > LOADED_PRESSURE * self._largest) & (friction.spacing > 0)
        slid = friction.lengths(slip.position)
        share = np.divide(slid, friction.spacing, out=np.zeros(slid.size), where=pressing)
        if self._said or not share.max(initial=0.0) > 1.0:
            return
        self._said = True
        if not is_first("far sliding"):
            return
        at = int(share.argmax())
        warn(
            f"at {place}: contact {at} has slid by {slid[at]:.3g}, {share[at]:.2g} times the "
            "distance between the nodes it faces where it was meshed, and still presses on these. "
            "Pair surfaces that slide far anew, hhr.slide(scene)",
            FarSlidingWarning,
        )
