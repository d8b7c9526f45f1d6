"""Heat flows of contacts with forces eliminated, for statuses that seldom change: the fast way."""

from __future__ import annotations

from collections import OrderedDict
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.plugins.contact_heat.newton import (
    CoupledContact,
    CoupledSolution,
    scales_of,
    solved_together,
)

KEPT_SETS = 64
"""Most sets of closed contacts whose responses are kept."""
SETTLED_STEP = 1e-9
"""Step over the size of the heat flows after which a solution is accepted: its error is about the
square.
"""
SET_STEPS = 25
"""Most steps, changes of statuses included; two to six are usual along a history."""
WRONG_SIGN = 1e-12
"""Part of the largest force, or slack, by which a sign is wrong: round-off is less."""


class SetResponse(NamedTuple):
    """Responses of forces and slacks to heat flows at fixed statuses (a closed contacts)."""

    closed: np.ndarray  #: their numbers, (a,)
    inverse: np.ndarray  #: of S between them, (a, a)
    forces: np.ndarray  #: of closed contacts per flow, zero rows elsewhere, (m, m + b)
    slack: np.ndarray  #: of open contacts per flow, zero rows elsewhere, (m, m + b)


class SetResponses:
    """Responses of the sets of closed contacts that were used last.

    Args:
        schur: slack per force, (m, m).
        per_heat: slack per heat flow and temperature of a body, (m, m + b).
    """

    def __init__(self, schur: np.ndarray, per_heat: np.ndarray):
        self._schur = schur
        self._per_heat = per_heat
        self._kept: OrderedDict[bytes, SetResponse] = OrderedDict()

    def of(self, active: np.ndarray) -> SetResponse:
        """Response of a set.

        Args:
            active: closed contacts, (m,) bool.

        Raises:
            LinAlgError: of NumPy, for dependent conditions.
        """
        key = active.tobytes()
        found = self._kept.get(key)
        if found is None:
            closed = np.flatnonzero(active)
            inverse = np.linalg.inv(self._schur[np.ix_(closed, closed)])
            forces = np.zeros_like(self._per_heat)
            forces[closed] = -inverse @ self._per_heat[closed]
            slack = self._per_heat + self._schur[:, closed] @ forces[closed]
            slack[closed] = 0.0
            found = self._kept[key] = SetResponse(closed, inverse, forces, slack)
            while len(self._kept) > KEPT_SETS:
                self._kept.pop(next(iter(self._kept)), None)
        return found


def solved(
    contact: CoupledContact, forces: np.ndarray, flows: np.ndarray, responses: SetResponses
) -> CoupledSolution:
    """Solve with forces eliminated, or together where that fails.

    Args:
        contact: the problem.
        forces: forces to start from, (m,).
        flows: heat flows and temperatures of bodies to start from, (m + b,).
        responses: of sets of closed contacts.
    """
    if contact.sliding is None:  # responses have S of no heat
        found = solved_by_sets(contact, responses, forces > 0, flows)
        if found is not None:
            return found
    return solved_together(contact, forces, flows)


@np.errstate(all="ignore")  # steps that run away end in NaN, which has no step
def solved_by_sets(
    contact: CoupledContact, responses: SetResponses, active: np.ndarray, flows: np.ndarray
) -> CoupledSolution | None:
    """Solve for heat flows and temperatures of bodies, and change statuses that are wrong.

    None if that does not end, or a matrix is singular: take the coupled method then.

    Args:
        contact: the problem.
        responses: of sets of closed contacts.
        active: contacts that are closed at first, (m,) bool.
        flows: heat flows and temperatures of bodies to start from, (m + b,).
    """
    m = contact.slack.size
    scales = scales_of(contact)
    widths = np.concatenate([np.ones(m), np.full(flows.size - m, scales.level / scales.heat)])
    settled = False
    for steps in range(SET_STEPS):
        try:
            response = responses.of(active)
        except np.linalg.LinAlgError:
            return None
        closed = response.closed
        forces = response.forces @ flows
        forces[closed] -= response.inverse @ contact.slack[closed]
        slack = contact.slack + contact.schur[:, closed] @ forces[closed]
        slack += contact.per_heat @ flows
        slack[closed] = 0.0
        wrong = forces < -WRONG_SIGN * np.abs(forces).max(initial=0.0)
        wrong |= ~active & (slack < -WRONG_SIGN * scales.slack)
        if wrong.any():
            active = active ^ wrong
            settled = False
            continue
        forces = np.maximum(forces, 0.0)
        if settled:
            return CoupledSolution(forces, slack, flows[:m], flows[m:], steps, True)
        step = _step(contact, response, (forces, np.maximum(slack, 0.0)), flows, widths)
        if step is None:
            return None
        flows = flows + step
        size = np.abs(step / widths).max() / max(np.abs(flows / widths).max(), 1e-300)
        settled = size <= SETTLED_STEP
    return None


def _step(
    contact: CoupledContact,
    response: SetResponse,
    state: tuple[np.ndarray, np.ndarray],
    flows: np.ndarray,
    widths: np.ndarray,
) -> np.ndarray | None:
    """Newton's step of heat flows and temperatures at fixed statuses, (m + b,)."""
    m = contact.slack.size
    forces, gaps = state
    conducted, of_pressure, of_gap = contact.conductance(forces / contact.areas, gaps)
    jump = contact.jump - contact.compliance @ flows[:m] + contact.levels @ flows[m:]
    through = contact.areas * conducted
    matrix = np.zeros((flows.size, flows.size))
    matrix[:m, :m] = through[:, None] * contact.compliance
    matrix[:m, m:] = -through[:, None] * contact.levels
    # rows of open contacts have no forces, and those of closed ones no slack
    if of_pressure.any():
        by_pressure = np.where(forces > 0, of_pressure * jump, 0.0)
        matrix[:m] -= by_pressure[:, None] * response.forces
    if of_gap.any() and gaps.any():
        by_gap = np.where(gaps > 0, contact.areas * of_gap * jump, 0.0)
        matrix[:m] -= by_gap[:, None] * response.slack
    matrix.flat[: m * flows.size : flows.size + 1] += 1.0
    matrix[m:, :m] = contact.levels.T
    residual = np.concatenate(
        [flows[:m] - through * jump, contact.levels.T @ flows[:m] - contact.supplied]
    )
    matrix *= widths
    if not (np.isfinite(matrix).all() and np.isfinite(residual).all()):
        return None
    try:
        step: np.ndarray = -widths * np.linalg.solve(matrix, residual)
    except np.linalg.LinAlgError:
        return None
    return step
