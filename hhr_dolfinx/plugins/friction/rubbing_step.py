"""Frictional contact within a step of inelastic bodies: the contact problem of each linearisation.

All linearisations of a step measure slip from its beginning, backward Euler for the rate of slip. The last one, at
which the stress has converged, gives the slip of the step.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Statuses
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.plugins.friction.laws import SlipState
from hhr_dolfinx.plugins.friction.sliding_set import Increment, Sliding, SlidingContact
from hhr_dolfinx.plugins.friction.surfaces import Surface

NOTHING = np.zeros(0)


class RubbingStep:
    """Solves the contact problems of one step with friction from a slip state and forces, (m,), to a point, (P,).

    The model is an equilibrium with a :class:`Friction` as its law.
    """

    def __init__(self, model: Any, point: np.ndarray, before: SlipState, forces: np.ndarray):
        self._friction = model.law
        self._surface = Surface.of(model)
        self._point = point
        self._coefficient, self._limit = self._friction.bounds(point)
        self._before = before
        self._position = self._surface.position(before)
        self._forces = forces
        self._on: SchurEqualities | None = None
        self._contact: SlidingContact | None = None
        self._last: tuple[Increment, Sliding] | None = None

    def solved(
        self, equalities: SchurEqualities, free_slack: np.ndarray, active: np.ndarray, pairs: Pairs | None
    ) -> Statuses:
        """Forces under a free slack, (m,), for the S of the given equality problems."""
        if self._contact is None or equalities is not self._on:
            self._contact = SlidingContact(equalities.whole(), self._friction)
            self._on = equalities
        slack = free_slack.copy()
        slack[self._friction.tangential] -= self._position
        given = Increment(slack, self._coefficient, self._limit, NOTHING)
        found = self._contact.increment(given, self._forces, active)
        self._forces = found.forces
        self._last = given, found
        return Statuses(found.forces, found.active, found.iterations, found.status, found.sweeps > 0)

    def memory(self, unknown: np.ndarray) -> Memory:
        """Slip state after the step, by the last linearisation, at whose unknown it ends, (n,)."""
        assert self._last is not None
        return Memory(slip=self._surface.after(self._before, *self._last, lambda: unknown, self._point))
