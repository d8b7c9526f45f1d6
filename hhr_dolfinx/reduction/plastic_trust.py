"""Whether a reduced model of histories may be used: what it answers on histories that are known."""

from __future__ import annotations

import math

import numpy as np

from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.flow.quasi_static import History, MarchSettings, march
from hhr_dolfinx.reduction.trust import Comparison
from hhr_dolfinx.snapshots.accuracy import FORCE_FLOOR, Residuals, norm, slack_residuals


def force_floor_of(histories: list[History]) -> float:
    """Force norm below which a relative error means nothing."""
    return FORCE_FLOOR * max(float(np.linalg.norm(point.forces)) for history in histories for point in history.points)


def compare_histories(full, reduction, histories: list[History], labels: list[str], floor: float):
    """Errors of known histories solved by the reduced model, and their largest imbalance.

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
        A :class:`Comparison`, and the imbalances, one per history.
    """
    primal, dual, residuals, imbalances = [], [], [], []
    for history in histories:
        try:
            answer = march(reduction.model, history.path, MarchSettings(outside="ignore"))
        except HHRError:
            primal.append(math.inf)
            dual.append(math.inf)
            residuals.append(None)
            imbalances.append(math.inf)
            continue
        displacement, forces = largest_errors(full, reduction, answer, history, floor)
        primal.append(displacement)
        dual.append(forces)
        residuals.append(residuals_of(full, reduction, answer.points[-1]))
        imbalances.append(max(answer.imbalances))
    return Comparison(list(labels), np.array(primal), np.array(dual), residuals), np.array(imbalances)


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
