"""Forces and heat flows of the contacts together, by a semi-smooth Newton's method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

Conductance = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Maps pressures and gaps, (m,) each, to conductances and their derivatives along both."""
STEPS = 60
"""Most steps; a solution takes five to ten where the conductance is smooth."""
BALANCED_STEP = 1e-12
"""Step over the size of the unknown at which a solution is accepted: its error is the square."""
STALLED_STEP = 1e-8
"""Step at which one is accepted that is not half of the one before: round-off of soft springs."""
GAP_CONDUCTANCES = 10.0 ** -np.arange(0.0, 13.0)
"""Parts of the largest conductance that gaps get, one after another, where no start ends."""
HALVINGS = 8
"""Most halvings of a step whose residual grows tenfold."""
FALLING_HALVINGS = 30
"""Most halvings of a step whose residual must fall."""


class SlidingResponse(NamedTuple):
    """Heat that forces make where surfaces slide; the slack of its expansion is in ``schur``."""

    jump: np.ndarray  #: of the temperature per force, (m, m)
    supplied: np.ndarray  #: heat to each body that contact alone feeds, per force, (b, m)


class CoupledContact(NamedTuple):
    """Contact and heat at one parameter (m conditions, b bodies that contact alone feeds)."""

    slack: np.ndarray  #: without forces and heat, (m,)
    schur: np.ndarray  #: slack per force, (m, m)
    compliances: np.ndarray  #: slack of each condition per its force, without heat, (m,)
    per_heat: np.ndarray  #: slack per heat flow and temperature of a body, (m, m + b)
    jump: np.ndarray  #: of the temperature, first surface less second, without heat flows, (m,)
    compliance: np.ndarray  #: jump that a heat flow takes away, (m, m)
    levels: np.ndarray  #: jump per temperature of a body, (m, b)
    supplied: np.ndarray  #: heat that is supplied to each of these bodies, (b,)
    areas: np.ndarray  #: tributary areas, (m,)
    conductance: Conductance
    sliding: SlidingResponse | None = None

    def jump_at(self, forces: np.ndarray, flows: np.ndarray) -> np.ndarray:
        """Jump of the temperature, first surface less second, (m,).

        Args:
            forces: (m,).
            flows: heat flows and temperatures of bodies, (m + b,).
        """
        m = self.slack.size
        jump: np.ndarray = self.jump - self.compliance @ flows[:m] + self.levels @ flows[m:]
        return jump if self.sliding is None else jump + self.sliding.jump @ forces

    def surplus(self, forces: np.ndarray, flows: np.ndarray) -> np.ndarray:
        """Heat that leaves each body that contact alone feeds, less what enters it, (b,).

        Args:
            forces: (m,).
            flows: heat flows and temperatures of bodies, (m + b,).
        """
        surplus: np.ndarray = self.levels.T @ flows[: self.slack.size] - self.supplied
        return surplus if self.sliding is None else surplus - self.sliding.supplied @ forces


@dataclass(frozen=True, eq=False)
class CoupledSolution:
    """Solution of contact and heat together; NaN without one."""

    forces: np.ndarray  #: (m,)
    slack: np.ndarray  #: (m,)
    heat: np.ndarray  #: heat flow from the first to the second surface, (m,)
    levels: np.ndarray  #: temperatures of bodies that contact alone feeds, (b,)
    steps: int
    converged: bool


class Scales(NamedTuple):
    """Sizes of slack, forces, heat flows and temperatures, so that a matrix has entries of one
    size.
    """

    slack: float
    force: float
    heat: float
    level: float


def solved_together(
    contact: CoupledContact, forces: np.ndarray, flows: np.ndarray, *, falling: bool = False
) -> CoupledSolution:
    """Solve for forces, heat flows and temperatures of bodies together.

    The conditions are λ >= 0, s >= 0, λ s = 0 with s = slack + S λ + D q, and q = a h(λ / a, s) j
    with j = jump - C q; a body that contact alone feeds passes on what it is supplied with. Where
    surfaces slide, forces make heat: S has its expansion and is not symmetric, and j its jump.

    Args:
        contact: the problem.
        forces: forces to start from, (m,).
        flows: heat flows and temperatures of bodies to start from, (m + b,).
        falling: shorten steps until the residual falls: slower, and where full ones go to and fro.
    """
    m = forces.size
    scales = scales_of(contact)
    unknown = np.concatenate(
        [forces / scales.force, flows[:m] / scales.heat, flows[m:] / scales.level]
    )
    steps = 0
    size = np.inf
    settled = False
    with np.errstate(all="ignore"):
        residual, jacobian, active = _linearised(contact, scales, unknown)
        while steps < STEPS:
            steps += 1
            if not np.isfinite(residual).all() or not np.isfinite(jacobian).all():
                break
            try:
                step = np.linalg.solve(jacobian, -residual)
            except np.linalg.LinAlgError:
                break
            before = active
            last = size
            unknown, residual, jacobian, active = _moved(
                contact, scales, unknown, step, residual, falling
            )
            size = np.abs(step).max() / max(np.abs(unknown).max(), 1e-300)
            settled = size <= BALANCED_STEP or (size <= STALLED_STEP and size > last / 2)
            if settled and np.array_equal(before, active):
                break
        else:
            settled = False
    converged = settled and bool(np.isfinite(unknown).all())
    if not converged:
        unknown = np.full(unknown.size, np.nan)
    forces = np.where(active, unknown[:m] * scales.force, 0.0)
    flows = np.concatenate([unknown[m : 2 * m] * scales.heat, unknown[2 * m :] * scales.level])
    slack = contact.slack + contact.schur @ forces + contact.per_heat @ flows
    slack = np.where(active, 0.0, slack)
    return CoupledSolution(forces, slack, flows[:m], flows[m:], steps, converged)


class CoupledChanges(NamedTuple):
    """Derivatives of a coupled problem along parameters at constant unknowns."""

    slack: np.ndarray  #: (m, P)
    jump: np.ndarray  #: (m, P)
    supplied: np.ndarray  #: (b, P)
    conductance: np.ndarray  #: (m, P)


def changes_of(
    contact: CoupledContact, found: CoupledSolution, along: CoupledChanges
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of forces, (m, P), and of heat flows and temperatures of bodies, (m + b, P),
    along parameters.

    By the implicit function theorem, at the statuses of the solution.

    Args:
        contact: the problem.
        found: its solution.
        along: derivatives of the problem.
    """
    m = found.forces.size
    scales = scales_of(contact)
    unknown = np.concatenate(
        [found.forces / scales.force, found.heat / scales.heat, found.levels / scales.level]
    )
    _, jacobian, active = _linearised(contact, scales, unknown)
    pressed = found.forces / contact.areas
    opened = np.maximum(found.slack, 0.0)
    conducted, _, of_gap = contact.conductance(pressed, opened)
    jump = contact.jump_at(found.forces, np.concatenate([found.heat, found.levels]))
    open_ = ~active & (found.slack > 0)
    more = along.conductance + np.where(open_, of_gap, 0.0)[:, None] * along.slack
    flows = contact.areas[:, None] * (more * jump[:, None] + conducted[:, None] * along.jump)
    right = np.vstack(
        [
            np.where(active[:, None], along.slack / scales.slack, 0.0),
            -flows / scales.heat,
            -along.supplied / scales.heat,
        ]
    )
    step = np.linalg.solve(jacobian, -right)
    flows = np.vstack([step[m : 2 * m] * scales.heat, step[2 * m :] * scales.level])
    return step[:m] * scales.force, flows


def by_conducting_gaps(
    contact: CoupledContact, forces: np.ndarray, flows: np.ndarray
) -> CoupledSolution:
    """Solve with a conductance that is added everywhere, less and less of it, and last with none.

    Heat then changes little by little while contacts open and close.

    Args:
        contact: the problem.
        forces: forces to start from, (m,).
        flows: heat flows and temperatures of bodies to start from, (m + b,).
    """
    pressures = np.abs(forces).max(initial=0.0) / contact.areas
    largest = float(
        np.nan_to_num(contact.conductance(pressures, 0 * pressures)[0]).max(initial=0.0)
    )
    largest = max(largest, 1.0 / max(float(np.diag(contact.compliance).mean()), 1e-300))
    found = None
    for part in (*GAP_CONDUCTANCES, 0.0):
        added = part * largest
        more = contact._replace(conductance=_with_gas(contact.conductance, added))
        found = solved_together(more, forces, flows)
        if not found.converged:
            found = solved_together(more, forces, flows, falling=True)
        if found.converged:
            forces, flows = found.forces, np.concatenate([found.heat, found.levels])
    assert found is not None
    return found


def _with_gas(conductance: Conductance, added: float) -> Conductance:
    """A conductance with a constant one beside it."""

    def more(pressures: np.ndarray, gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        conducted, of_pressure, of_gap = conductance(pressures, gaps)
        return conducted + added, of_pressure, of_gap

    return more


def scales_of(contact: CoupledContact) -> Scales:
    """Sizes of the unknowns of a problem.

    Args:
        contact: the problem.
    """
    slack = max(float(np.abs(contact.slack).max(initial=0.0)), 1e-300)
    force = slack / max(float(contact.compliances.mean()), 1e-300)
    pressed = force / contact.areas
    flows = contact.areas * contact.conductance(pressed, np.zeros(pressed.size))[0]
    conducted = max(float(np.nan_to_num(flows, posinf=0.0).max(initial=0.0)), 1e-300)
    supplied = float(np.abs(contact.supplied).max(initial=0.0))
    jump = float(np.abs(contact.jump).max(initial=0.0))
    if contact.sliding is not None:
        jump = max(jump, force * float(np.abs(contact.sliding.jump).max(initial=0.0)))
    level = max(jump, supplied / conducted, 1e-300)
    return Scales(slack, force, max(conducted * level, supplied, 1e-300), level)


def _moved(
    contact: CoupledContact,
    scales: Scales,
    unknown: np.ndarray,
    step: np.ndarray,
    residual: np.ndarray,
    falling: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The unknown after a step, or the first part of it whose residual is finite and not far above
    that before; with its residual, derivatives and closed contacts.
    """
    size = np.linalg.norm(residual)
    for k in range(FALLING_HALVINGS if falling else HALVINGS):
        there = unknown + step / 2**k
        found = _linearised(contact, scales, there)
        most = (1 - 0.1 / 2**k) * size if falling else 10 * size
        if np.isfinite(found[0]).all() and np.linalg.norm(found[0]) <= most:
            break
    return there, *found


def _linearised(
    contact: CoupledContact, scales: Scales, unknown: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residual, (2 m + b,), its derivatives, and closed contacts, (m,) bool."""
    m = contact.slack.size
    b = contact.supplied.size
    forces = unknown[:m] * scales.force
    flows = np.concatenate([unknown[m : 2 * m] * scales.heat, unknown[2 * m :] * scales.level])
    slack = contact.slack + contact.schur @ forces + contact.per_heat @ flows
    active = forces * contact.compliances > slack
    pressed = np.where(active, np.maximum(forces, 0.0), 0.0) / contact.areas
    opened = np.where(active, 0.0, np.maximum(slack, 0.0))
    conducted, of_pressure, of_gap = contact.conductance(pressed, opened)
    jump = contact.jump_at(forces, flows)
    residual = np.concatenate(
        [
            np.where(active, slack / scales.slack, unknown[:m]),
            (flows[:m] - contact.areas * conducted * jump) / scales.heat,
            contact.surplus(forces, flows) / scales.heat,
        ]
    )
    jacobian = np.zeros((2 * m + b, 2 * m + b))
    widths = np.concatenate([np.full(m, scales.heat), np.full(b, scales.level)])
    jacobian[:m, :m] = np.where(
        active[:, None], contact.schur * (scales.force / scales.slack), np.eye(m)
    )
    jacobian[:m, m:] = np.where(active[:, None], contact.per_heat * widths / scales.slack, 0.0)
    by_pressure = np.where(active & (forces > 0), of_pressure * jump, 0.0)
    by_gap = np.where(~active & (slack > 0), contact.areas * of_gap * jump, 0.0)
    of_forces = np.diag(by_pressure) + by_gap[:, None] * contact.schur
    if contact.sliding is not None:
        of_forces += (contact.areas * conducted)[:, None] * contact.sliding.jump
        jacobian[2 * m :, :m] = -contact.sliding.supplied * (scales.force / scales.heat)
    jacobian[m : 2 * m, :m] = -of_forces * (scales.force / scales.heat)
    of_flows = contact.areas[:, None] * conducted[:, None] * contact.compliance + np.eye(m)
    of_flows -= by_gap[:, None] * contact.per_heat[:, :m]
    jacobian[m : 2 * m, m : 2 * m] = of_flows
    of_levels = -contact.areas[:, None] * conducted[:, None] * contact.levels
    of_levels -= by_gap[:, None] * contact.per_heat[:, m:]
    jacobian[m : 2 * m, 2 * m :] = of_levels * (scales.level / scales.heat)
    jacobian[2 * m :, m : 2 * m] = contact.levels.T
    return residual, jacobian, active
