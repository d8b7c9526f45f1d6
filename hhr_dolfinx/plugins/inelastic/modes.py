"""Modes of plastic corrections: proper orthogonal decomposition in energy."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.plugins.inelastic.elastic_response import ElasticResponse

SMALL_CORRECTION = 1e-3
"""Size of a correction, relative to the largest, above which its weight is the root of its size."""


def correction_modes(
    problem: ContactProblem, corrections: np.ndarray, elastic: ElasticResponse, left_out: float, most: int | None
) -> tuple[np.ndarray, np.ndarray]:
    """Modes of corrections, (N, S), orthonormal in energy, (N, ell), and the energy norm of each state, (S,).

    They leave out a part of the summed norm of all corrections, unless there would be more than ``most``. Each counts
    by the root of its size. By their sizes, corrections of training part loads were left out compared with those of
    full loads, and the remaining stress was 75 to 90 % wrong on a cantilever, 12 to 25 % on the pellet; by the root 2
    to 3 and 1 %, with twice as many modes. With equal weights there were three times as many.

    If moduli vary, each part has separate modes: a mode across parts would have no definite energy.
    """
    sizes = np.sqrt(np.maximum(np.einsum("ns,ns->s", corrections, problem.stiffness @ corrections), 0.0))
    weights = 1 / np.sqrt(np.maximum(sizes, SMALL_CORRECTION * sizes.max(initial=0.0)) + np.finfo(float).tiny)
    found = []
    for part in np.unique(elastic.parts):
        own = np.where((elastic.parts == part)[:, None], corrections * weights, 0.0)
        found.append(_energy_modes(problem, own, left_out * np.linalg.norm(sizes * weights)))
    values = np.concatenate([value for _, value in found])
    modes = np.concatenate([columns for columns, _ in found], axis=1)
    order = np.argsort(-values)[:most]
    return _orthonormal(problem, modes[:, order]), sizes


def _energy_modes(problem: ContactProblem, columns: np.ndarray, left_out: float) -> tuple[np.ndarray, np.ndarray]:
    """POD modes in energy that leave out a given norm, and their singular values."""
    squares, weights = linalg.eigh(columns.T @ (problem.stiffness @ columns))
    squares = np.maximum(squares[::-1], 0.0)
    weights = weights[:, ::-1]
    rest = np.append(np.cumsum(squares[::-1])[::-1], 0.0)
    noise = np.finfo(float).eps * len(squares) * (squares[0] if squares.size else 0.0)
    count = min(int(np.argmax(rest <= left_out**2)), int((squares > noise).sum()))
    values = np.sqrt(squares[:count])
    return columns @ (weights[:, :count] / np.where(values > 0, values, 1.0)), values


def _orthonormal(problem: ContactProblem, modes: np.ndarray) -> np.ndarray:
    """Basis of the same span, orthonormal in energy to round-off."""
    for _ in range(2):
        lower = np.linalg.cholesky(modes.T @ (problem.stiffness @ modes))
        modes = linalg.solve_triangular(lower, modes.T, lower=True).T
    return np.ascontiguousarray(modes)
