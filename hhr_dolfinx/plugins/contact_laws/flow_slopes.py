"""Facet ``flow_slopes`` of laws on ranges: derivatives of their contacts in histories of bodies
with laws.

With the consistent tangent of a step its unknown is eliminated, and contact forces solve the laws
on S = B K_T^-1 B^T: their rows at the solution are P x' + Q (s' + S x') = -r', see
:mod:`.range_increments`. What a memory adds to the slack hands on its derivative,
:meth:`~.ranges.RangeStep.carried`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.gradient import CHANGING_STATUS
from hhr_dolfinx.plugins.contact_laws.range_increments import SolversOfRanges, joined
from hhr_dolfinx.plugins.inelastic.contact_slopes import ContactChange, LinearisedStep, columnwise

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.contact_laws.interface import Interface


class HasInterface(Protocol):
    """Equilibrium whose contacts have laws of several plug-ins."""

    @property
    def law(self) -> Interface:
        """Law of the contact conditions."""


class RangeSlopes:
    """See :class:`~hhr_dolfinx.plugins.inelastic.contact_slopes.ContactSlopes`, for one history of
    an equilibrium.
    """

    def __init__(self, model: HasInterface, count: int):
        self._laws = SolversOfRanges(model.law)
        self._memory = joined([solver.at_rest() for solver in self._laws.solvers])
        self._changes = np.zeros(
            (sum(rows.size for rows in self._laws.rows), count)
        )  # of the shifts of all rows

    @property
    def remembers(self) -> bool:
        """See :class:`~hhr_dolfinx.plugins.inelastic.contact_slopes.ContactSlopes`."""
        return bool(self._changes.any())

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
            seconds: duration of the step.
        """
        with linear.held():
            laws = self._laws
            forces = answer.multipliers
            loose = linear.motions
            ranges = laws.on(linear.schur(), None if loose is None else loose.contact_of_motions)
            steps = laws.steps(self._memory, answer.parameter, seconds)
            slack = slack + (ranges.schur - ranges.given) @ forces  # of elastic tangential rows
            for rows, step in zip(laws.rows, steps, strict=True):
                slack[rows] += step.shift
            residual, gaps = right
            free = columnwise(linear.solve, residual)
            of_slack = linear.slack_of(gaps, free)
            linearisations = ranges.linearised(slack, steps, forces, ranges.stiffness, 1)
            for rows, step in zip(laws.rows, steps, strict=True):
                of_slack[rows] += step.shifted(self._changes[rows])
            off = np.zeros((forces.size + ranges.motions.shape[1], of_slack.shape[1]))
            kinks = np.zeros(forces.size, dtype=bool)
            for rows, step, linearised in zip(laws.rows, steps, linearisations, strict=True):
                at = forces[rows], slack[rows], ranges.stiffness[rows]
                off[rows] = -linearised.of_slack(of_slack[rows])
                if np.ndim(slopes := step.slopes(*at)):
                    off[rows] -= slopes @ way
                kinks[rows] = step.grazing(*at, CHANGING_STATUS * np.abs(at[0]).max(initial=0.0))
            if loose is not None:
                off[forces.size :] = loose.modes.T @ residual
            force_slopes, motion_slopes = np.split(
                ranges.solved(linearisations, off), [forces.size]
            )
            opened = of_slack + ranges.schur @ force_slopes - ranges.motions @ motion_slopes
            changes = self._changes.copy()
            for rows, step in zip(laws.rows, steps, strict=True):
                changes[rows] = step.carried(
                    self._changes[rows], force_slopes[rows], opened[rows], answer.active[rows]
                )
            self._changes, self._memory = changes, answer.memory
            unknown = free - columnwise(linear.push, force_slopes)
            return ContactChange(
                unknown if loose is None else unknown + loose.modes @ motion_slopes,
                force_slopes,
                opened,
                kinks,
            )
