"""Errors of a model against the full order, thesis (3.6)-(3.9), and their summaries."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.parameters import Theta
from hhr_dolfinx.snapshots.solutions import SnapshotSet

FORCE_FLOOR = 1e-3
"""Fraction of the largest training force below which a relative dual error means nothing."""

ROUND_OFF_FORCE = 1e-9
"""Contact forces below this fraction of the loads are round-off: there is no contact."""


def force_floor(problem: ContactProblem, training: SnapshotSet) -> float:
    """Force norm below which a relative dual error means nothing."""
    largest = float(np.linalg.norm(training.forces, axis=0).max())
    return max(FORCE_FLOOR * largest, round_off_force(problem, training.points))


def round_off_force(problem: ContactProblem, points: np.ndarray) -> float:
    """Force norm that is round-off beside the loads at the given parameters."""
    loads = problem.amplitudes.sum_columns(problem.loads, points)
    return ROUND_OFF_FORCE * float(np.linalg.norm(loads, axis=0).max())


def relative_error(approximation: np.ndarray, reference: np.ndarray, gram=None, floor: float = 0.0) -> float:
    """Error ``|a - r| / max(|r|, floor)`` in the norm of ``gram``, (3.6)-(3.8); Euclidean if None.

    Where the reference and the floor are zero the error is 0 for an exact answer and infinite otherwise.
    """
    error, size = _norm(approximation - reference, gram), max(_norm(reference, gram), floor)
    if size == 0:
        return 0.0 if error == 0 else np.inf
    return error / size


def energy_minimum(problem: ContactProblem, displacement: np.ndarray, theta: Theta) -> float:
    """Potential energy a(u, u)/2 - l(u) of thesis (1.10), in the unit of energy of the scene.

    With U = U0 + lift and loads = F - K lift on free dofs, J = U^T K U / 2 - F^T U.
    """
    return 0.5 * displacement @ (problem.stiffness @ displacement) - (problem.external @ theta) @ displacement


def summary(values) -> dict:
    """Median, 95th percentile and maximum of errors or times over all points, none dropped."""
    values = np.asarray(values, dtype=float)
    # order statistics, so that an infinite error stays infinite instead of becoming NaN
    median, p95 = np.percentile(values, [50, 95], method="higher")
    return {"median": float(median), "p95": float(p95), "max": float(values.max()), "n": int(values.size)}


def _norm(vector, gram):
    square = vector @ vector if gram is None else vector @ (gram @ vector)
    return float(np.sqrt(max(square, 0.0)))
