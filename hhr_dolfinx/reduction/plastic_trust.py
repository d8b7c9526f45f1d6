"""Whether a reduced model of histories may be used: what it answers on histories that are known."""

from __future__ import annotations

import math

import numpy as np

from hhr_dolfinx.certify.accuracy import FORCE_FLOOR, Residuals, norm, slack_residuals
from hhr_dolfinx.certify.trust import Comparison
from hhr_dolfinx.errors import HHRError, ReductionError
from hhr_dolfinx.models.march import History, MarchSettings, march


def force_floor_of(histories: list[History]) -> float:
    """Force norm below which a relative error means nothing."""
    return FORCE_FLOOR * max(float(np.linalg.norm(point.forces)) for history in histories for point in history.points)


def compare_histories(full, reduction, histories: list[History], labels: list[str], floor: float):
    """Errors of known histories solved by the reduced model, and the signs that its steps show.

    The error of a history is the largest of its steps over the largest displacement or force of the history: the
    first touch, with forces of a twentieth of the last ones, would otherwise decide. A history that fails has infinite
    errors.

    Args:
        full: the full model.
        reduction: with ``model``, ``displacement_everywhere`` and ``forces_everywhere``.
        histories: of the full model.
        labels: one for each, for messages.
        floor: force norm below which a relative error means nothing.

    Returns:
        A :class:`Comparison`, and the signs along each history that did not fail.
    """
    primal, dual, residuals, signs = [], [], [], []
    for history in histories:
        try:
            answer = march(reduction.model, history.path, MarchSettings(outside="ignore"))
        except HHRError:
            primal.append(math.inf)
            dual.append(math.inf)
            residuals.append(None)
            continue
        displacement, forces = largest_errors(full, reduction, answer, history, floor)
        primal.append(displacement)
        dual.append(forces)
        residuals.append(residuals_of(full, reduction, answer.points[-1]))
        signs.append(answer.signs)
    return Comparison(list(labels), np.array(primal), np.array(dual), residuals), signs


def largest_errors(full, reduction, answer: History, exact: History, floor: float) -> tuple[float, float]:
    """Largest errors of the displacement (L2) and of the forces everywhere over their largest size in the history."""
    mass, pairs = full.problem.mass, list(zip(answer.points, exact.points, strict=True))
    fields = [full.displacement(there) for _, there in pairs]
    wrong = [reduction.displacement_everywhere(here) - field for (here, _), field in zip(pairs, fields, strict=True)]
    forces = [np.linalg.norm(reduction.forces_everywhere(here) - there.forces) for here, there in pairs]
    largest = max(max(float(np.linalg.norm(there.forces)) for _, there in pairs), floor)
    length = max(norm(field, mass) for field in fields)
    return (
        max(norm(field, mass) for field in wrong) / length if length > 0 else 0.0,
        float(max(forces)) / largest if largest > 0 else 0.0,
    )


def residuals_of(full, reduction, point) -> Residuals:
    """Residuals of what is handed out at one step: equilibrium of the stress everywhere, gaps, signs."""
    theta = full.amplitudes(point.parameter)
    forces, stress = reduction.forces_everywhere(point), reduction.stress_everywhere(point)
    left, sizes = full.residual(stress, theta)
    residual = (left - full.contact_load(forces)) * full.problem.free
    equilibrium = float(np.linalg.norm(residual) / (np.linalg.norm(sizes) or 1.0))
    homogeneous = reduction.displacement_everywhere(point) - full.problem.lifts @ theta
    return Residuals(equilibrium, *slack_residuals(full.problem, homogeneous, forces, theta))


def largest_motion(full, histories: list[History]) -> float:
    """Largest gap or relative motion of contact surfaces in some histories."""
    problem, largest = full.problem, 0.0
    for history in histories:
        for point in history.points:
            gaps = problem.gaps @ full.amplitudes(point.parameter)
            motion = problem.contact @ point.unknown
            largest = max(largest, float(np.abs(gaps).max()), float(np.abs(motion).max()))
    return largest


def checked_histories(full, histories) -> list[History]:
    """Histories of a list or a generator, which can be gone through once only.

    Raises:
        ReductionError: for what is no history, one without a step, or one of another model.
    """
    if isinstance(histories, History):
        raise ReductionError("give a list of histories, [history], not a single one")
    histories, parameters = list(histories), len(full.parameters.names)
    for number, history in enumerate(histories):
        if not isinstance(history, History):
            raise ReductionError(f"history {number} is {history!r}: give what march returns")
        if not history.points:
            raise ReductionError(f"history {number} has no step: it needs at least one")
        last, shape = history.points[-1], (full.operator.gauss_points, full.material.components)
        sizes = last.unknown.size, last.forces.size, last.parameter.size
        if sizes != (full.size, full.conditions, parameters) or last.stress.shape != shape:
            raise ReductionError(
                f"history {number} has {sizes[0]} dofs, {sizes[1]} contacts, {sizes[2]} parameters and stresses of "
                f"shape {last.stress.shape}, the model {full.size}, {full.conditions}, {parameters} and {shape}: it "
                "belongs to another mesh or scene"
            )
    return histories
