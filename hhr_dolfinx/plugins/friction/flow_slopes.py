"""Facet ``flow_slopes`` of friction: derivatives of its contacts in histories of inelastic bodies,
step by step.

See :mod:`hhr_dolfinx.plugins.inelastic.history_gradient`. With the consistent tangent of a step its
unknown is eliminated, and contact forces solve an increment of friction on S = B K_T^-1 B^T. Their
derivative is that of this increment at its statuses, under the derivative of the slack and of the
bounds. Slip hands on the derivative of the position at which contacts stick: the slack of an
increment is measured from there.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.plugins.friction.laws import SLIP, SlipState
from hhr_dolfinx.plugins.friction.sliding_set import Sliding, SlidingContact, SlidingIncrement
from hhr_dolfinx.plugins.friction.surfaces import SolvedContacts
from hhr_dolfinx.plugins.inelastic.contact_slopes import ContactChange, LinearisedStep, columnwise

NO_MOTIONS = np.zeros(0)
"""Amplitudes of rigid motions, and loads along them: there are none here."""


class SlidingSlopes:
    """See :class:`~hhr_dolfinx.plugins.inelastic.contact_slopes.ContactSlopes`, for one history of
    an equilibrium.
    """

    def __init__(self, model: Any, count: int):
        self._friction = model.law
        self._surface = SolvedContacts.of(model)
        self._slip: SlipState | None = None  # of the step before; None at rest, without slip
        self._position = np.zeros(
            (self._friction.tangential.size, count)
        )  # its derivatives, (T, K)

    @property
    def remembers(self) -> bool:
        """See :class:`~hhr_dolfinx.plugins.inelastic.contact_slopes.ContactSlopes`."""
        return bool(self._position.any())

    def step(
        self,
        linear: LinearisedStep,
        answer: Answer,
        slack: np.ndarray,
        right: tuple[np.ndarray, np.ndarray],
        way: np.ndarray,
        seconds: float,
    ) -> ContactChange:
        """See :class:`~hhr_dolfinx.plugins.inelastic.contact_slopes.ContactSlopes`.

        Args:
            linear: linearisation of the step.
            answer: answer at the end of the step.
            slack: slack of all rows at its end, (m,).
            right: derivatives of residual and gaps at a given unknown, (n, K) and (m, K).
            way: directions of the parameter, (P, K).
            seconds: duration of the step, which Coulomb's law does not read.
        """
        with linear.held():
            friction = self._friction
            rows = friction.tangential
            residual, gaps = right
            loose = linear.motions
            contact = SlidingContact(
                linear.schur(), friction, None if loose is None else loose.contact_of_motions
            )
            driving = np.zeros((0, way.shape[1])) if loose is None else loose.modes.T @ residual
            slack = slack.copy()
            if self._slip is not None:
                slack[rows] -= self._surface.position(self._slip)
            slack[answer.active] = 0.0
            forces = answer.multipliers
            solution = Sliding(forces, answer.active, slack, NO_MOTIONS, 0, 0, Status.CONVERGED)
            coefficients, limits = friction.bounds(answer.parameter)
            loads = SlidingIncrement(
                slack - contact.schur @ forces, coefficients, limits, NO_MOTIONS
            )
            free = columnwise(linear.solve, residual)
            opened = linear.slack_of(gaps, free)
            opened[rows] -= self._position
            coefficient, limit = (slope @ way for slope in friction.bound_slopes(answer.parameter))
            force_slopes, motion_slopes = contact.changes(
                loads, solution, opened, (coefficient, limit), driving
            )
            opened = (
                opened + contact.schur @ force_slopes - contact.contact_of_motions @ motion_slopes
            )
            opened[answer.active] = 0.0
            self._position = self._position + opened[rows]  # none where contacts stick
            self._slip = answer.memory[SLIP]
            unknown = free - columnwise(linear.push, force_slopes)
            unknown = unknown if loose is None else unknown + loose.modes @ motion_slopes
            return ContactChange(unknown, force_slopes, opened, contact.grazing(loads, solution))
