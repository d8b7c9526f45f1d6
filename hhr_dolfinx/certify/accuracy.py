"""Errors of a model against the full order, thesis (3.6)-(3.9), and their summaries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import History

FORCE_FLOOR = 1e-3
"""Fraction of the largest training force below which a relative dual error is meaningless."""

ROUND_OFF_FORCE = 1e-9
"""Fraction of the forces in the bodies below which contact forces are round-off: there is no
contact.
"""
PRODUCT_ROUND_OFF = 1e-14
"""Relative error of a sum of products K_ij u_j.

50 units in the last place, for rows of some dozen entries.
"""


class Solutions(Protocol):
    """Answers of a full model, for training or validation.

    See :class:`hhr_dolfinx.snapshots.records.SnapshotSet`.
    """

    @property
    def points(self) -> np.ndarray:
        """Parameters, (S, P)."""

    @property
    def displacements(self) -> np.ndarray:
        """U0, (N, S), local rows of it if the full model is distributed."""

    @property
    def forces(self) -> np.ndarray:
        """Λ, (N_lambda, S)."""

    @property
    def histories(self) -> Sequence[History]:
        """For laws that remember, the load paths whose steps these answers are."""

    @property
    def states(self) -> Sequence[Memory]:
        """Memory of laws of bodies; empty for elastic bodies."""

    def take(self, rows: np.ndarray) -> Solutions:
        """Select some of them, by number."""

    def any_contact(self, problem: ContactProblem) -> bool:
        """True if any condition bears a force in any of them."""


def force_floor(problem: ContactProblem, training: Solutions) -> float:
    """Force norm below which a relative dual error is meaningless.

    Args:
        problem: the contact problem.
        training: training answers.
    """
    floor = FORCE_FLOOR * float(np.linalg.norm(training.forces, axis=0).max())
    return floor if training.histories else max(floor, round_off_force(problem, training))


def least_sizes(
    problem: ContactProblem, schur: np.ndarray, forces: np.ndarray | None
) -> np.ndarray:
    """Smallest sizes of contact forces that relative errors divide by, (3,).

    S norm, Euclidean norm and peak pressure: a thousandth of the largest training force; zero
    without training.

    Args:
        problem: the contact problem.
        schur: S in the middle of the box, (N_lambda, N_lambda).
        forces: training forces, (N_lambda, S); None without training.
    """
    if forces is None:
        return np.zeros(3)
    pressures = forces / np.where(problem.contact_areas > 0, problem.contact_areas, np.inf)[:, None]
    squares = np.einsum("ms,ms->s", forces, schur @ forces)
    largest = (
        np.sqrt(squares.max(initial=0.0)),
        np.linalg.norm(forces, axis=0).max(initial=0.0),
        pressures.max(initial=0.0),
    )
    return FORCE_FLOOR * np.array(largest)


def round_off_force(problem: ContactProblem, solutions: Solutions) -> float:
    """Force norm that is round-off compared with the internal forces K U of some solutions.

    U is the whole displacement: loads F - K lift include the reaction to a rigid motion, compared
    with which all contact forces would be noise, while K U includes only its round-off.

    Args:
        problem: the contact problem.
        solutions: answers whose internal forces give the scale.
    """
    # some of the largest and some evenly chosen solutions give the scale of all
    count = solutions.displacements.shape[1]
    rows = problem.spread
    stiffness = problem.stiffness_of_rows
    largest = np.argsort(rows.norms(solutions.displacements))[-10:]
    solutions = solutions.take(
        np.union1d(largest, np.linspace(0, count - 1, min(10, count)).astype(int))
    )
    lifts = rows.of(problem.amplitudes.sum_columns(problem.lifts, solutions.points))
    fields = solutions.displacements + lifts
    internal = rows.norms(stiffness @ fields).max()
    products = rows.norms(abs(stiffness) @ np.abs(fields)).max()
    return max(ROUND_OFF_FORCE * float(internal), PRODUCT_ROUND_OFF * float(products))


@dataclass(frozen=True)
class Residuals:
    """Residuals of the contact problem for an answer, each relative to its scale.

    Attributes:
        equilibrium: norm of K u + B^T λ - F on free dofs over that of the loads or the contact
            forces.
        penetration: deepest violation of a gap over the largest gap or relative motion of its pair,
            or a thousandth of the largest displacement.
        sign: largest tensile force over the largest contact force.
    """

    equilibrium: float
    penetration: float
    sign: float


def contact_residuals(
    problem: ContactProblem,
    displacement: np.ndarray,
    forces: np.ndarray,
    theta: Theta,
    opened: float | np.ndarray = 0.0,
) -> Residuals:
    """Residuals of (1.21) for an answer as it is returned to a user.

    Args:
        problem: the contact problem at the parameter.
        displacement: displacement, lift included, (N,).
        forces: contact forces, (N_lambda,).
        theta: amplitudes at the parameter.
        opened: part of the gaps that the memory of a law adds, (N_lambda,), see
            :meth:`ContactLaw.opened`.
    """
    homogeneous = displacement - problem.lifts @ theta
    load = problem.loads @ theta
    contact_load = problem.contact.T @ forces
    rows = problem.spread
    residual = problem.own_stiffness @ homogeneous + rows.of(contact_load - load)
    if (
        problem.kernel is not None
    ):  # the moment of facets of round surfaces is distributed over the body
        idle = rows.of(problem.kernel.idle)
        residual = residual - idle @ rows.sum(idle.T @ residual)
    # K lift, the reaction to imposed displacements, is far larger than the forces on a body
    scale = max(norm(problem.external @ theta), norm(contact_load))
    if scale <= PRODUCT_ROUND_OFF * norm(
        load
    ):  # nothing presses: forces are zero but for round-off
        scale = norm(load)
    free_residual = residual * rows.of(problem.free)
    imbalance = (
        float(np.sqrt(rows.sum(free_residual @ free_residual))) / scale if scale > 0 else 0.0
    )
    return Residuals(imbalance, *slack_residuals(problem, homogeneous, forces, theta, opened))


def slack_residuals(
    problem: ContactProblem,
    homogeneous: np.ndarray,
    forces: np.ndarray,
    theta: Theta,
    opened: float | np.ndarray = 0.0,
) -> tuple[float, float]:
    """``(penetration, sign)`` of :class:`Residuals` for a displacement less its lift, (N,).

    Args:
        problem: the contact problem at the parameter.
        homogeneous: displacement less its lift, (N,).
        forces: contact forces, (N_lambda,).
        theta: amplitudes at the parameter.
        opened: see :func:`contact_residuals`.
    """
    gaps = problem.gaps @ theta + opened
    motion = problem.contact @ homogeneous
    # a closed pair does not move: relative to its round-off every penetration would be large
    least = 1e-3 * np.abs(homogeneous).max()
    pressing = problem.pressing  # other forces have any sign, and their rows no gap
    penetration = 0.0
    for pair in np.unique(problem.contact_pairs):
        of_pair = (problem.contact_pairs == pair) & pressing
        length = max(np.abs(gaps[of_pair]).max(), np.abs(motion[of_pair]).max(), least)
        depth = (motion - gaps)[of_pair].max()
        penetration = max(penetration, float(depth / length) if length > 0 else 0.0)
    largest = np.abs(forces).max()
    pushing = forces[pressing & ~problem.law.pulling(len(forces))]
    return penetration, float(abs(pushing.min(initial=0.0)) / largest) if largest > 0 else 0.0


def mass_norm(problem: ContactProblem, field: np.ndarray) -> float:
    """L2 norm of a field.

    Args:
        problem: the contact problem, whose Gram matrix the ranks may share by rows.
        field: all of its values, on each rank, (N,).
    """
    mass_times = problem.node_mass @ field.reshape(-1, problem.block_size)  # components do not meet
    square = problem.spread.sum(problem.spread.of(field) @ mass_times.ravel())
    return float(np.sqrt(max(square, 0.0)))


def relative_error(
    approximation: np.ndarray,
    reference: np.ndarray,
    gram: csr_matrix | None = None,
    floor: float = 0.0,
) -> float:
    """Error ``|a - r| / max(|r|, floor)`` in the norm of ``gram``, (3.6)-(3.8); Euclidean if None.

    If both the reference and the floor are zero the error is 0 for an exact answer and infinite
    otherwise.

    Args:
        approximation: approximate vector, (n,).
        reference: exact vector, (n,).
        gram: Gram matrix of the norm, (n, n); None for the Euclidean norm.
        floor: smallest denominator, in the unit of the norm.
    """
    return of_size(norm(approximation - reference, gram), max(norm(reference, gram), floor))


def of_size(error: float, size: float) -> float:
    """Error relative to a size; of size zero it is 0 for an exact answer and infinite otherwise.

    Args:
        error: norm of the error.
        size: norm of the exact answer.
    """
    if size == 0:
        return 0.0 if error == 0 else np.inf
    return error / size


def energy_minimum(problem: ContactProblem, displacement: np.ndarray, theta: Theta) -> float:
    """Potential energy a(u, u)/2 - l(u) of thesis (1.10), in the unit of energy of the scene.

    With U = U0 + L θ, (N,), J = U^T K U / 2 - F^T U, where F acts on all dofs.

    Args:
        problem: the contact problem.
        displacement: displacement, lift included, (N,).
        theta: amplitudes at the parameter.

    Raises:
        NotOfferedError: if K is not a sum of known parts.
    """
    problem.require_parts()
    unknown = displacement - problem.lifts @ theta
    return 0.5 * problem.doubled_energy(unknown, theta) - float(
        (problem.forces @ theta) @ displacement
    )


def summary(values: Sequence[float] | np.ndarray) -> dict[str, float]:
    """Median, 95th percentile and maximum of errors or times, without exclusions."""
    values = np.asarray(values, dtype=float)
    # order statistics: an infinite error stays infinite and does not become NaN
    median, p95 = np.percentile(values, [50, 95], method="higher")
    return {
        "median": float(median),
        "p95": float(p95),
        "max": float(values.max()),
        "n": int(values.size),
    }


def norm(vector: np.ndarray, gram: csr_matrix | None = None) -> float:
    """Norm of a vector by a Gram matrix, Euclidean if None.

    Args:
        vector: vector, (n,).
        gram: Gram matrix, (n, n); None for the Euclidean norm.

    Raises:
        SceneError: if the Gram matrix has another number of rows, as on several ranks.
    """
    if gram is not None and gram.shape[0] != vector.size:
        raise SceneError(
            f"the Gram matrix has {gram.shape[0]} rows for {vector.size} dofs: where ranks share "
            "the rows take full.gathered(), problem.gathered(comm)"
        )
    square = vector @ vector if gram is None else vector @ (gram @ vector)
    return float(np.sqrt(max(square, 0.0)))
