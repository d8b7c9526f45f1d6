"""Equations of user-defined systems, compared with what they state: symmetry of K, and its
parts.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.full_order.system import SystemAt
from hhr_dolfinx.parameters import ParameterSpace

VALUE_ROUND_OFF = 1e-12
"""Part of the terms of a value up to which it is round-off: sums of some hundred terms have
1e-14.
"""


def samples(space: ParameterSpace) -> np.ndarray:
    """Points at which equations are compared: middle, two corners, two random ones, (5, P).

    Weights that vanish in the middle, or at an end, hide their part there.
    """
    return np.vstack([space.middle, space.lower, space.upper, space.random(2, seed=1)])


def check_symmetric(at: SystemAt, matrix: csr_matrix, name: str) -> None:
    """Check that K is symmetric, by x^T K y and y^T K x: factors read one half of K.

    Args:
        at: the system at a point.
        matrix: local rows of K, (own, N).
        name: name of the scene.

    Raises:
        SceneError: if they differ by more than round-off.
    """
    problem = at.problem
    first, second = np.random.default_rng(0).standard_normal((2, problem.free.size))
    mine = first[problem.rows], second[problem.rows]
    off = mine[0] @ (matrix @ second) - mine[1] @ (matrix @ first)
    size = abs(mine[0]) @ (abs(matrix) @ abs(second))
    off, size = problem.spread.sum(np.array([off, size]))
    if not abs(off) <= VALUE_ROUND_OFF * size:
        raise SceneError(
            f"K of the system of scene '{name}' is not symmetric at "
            f"{problem.parameters.described(at.point)}: factors read one half of it. Give the K of "
            "an energy"
        )


def check_parts(at: SystemAt, matrix: csr_matrix, problem: ContactProblem, name: str) -> None:
    """Compare K, loads and contact of a system with those of a problem.

    The problem has the parts that the system states: reductors answer by these alone. An entry of K
    is compared with the diagonal of its row and column, not with the norm of K: a soft bedding
    beside a stiff body would be round-off of that.

    Args:
        at: the system at a point.
        matrix: local rows of K, (own, N).
        problem: the problem with the parts.
        name: name of the scene.

    Raises:
        SceneError: if they differ by more than round-off.
    """
    theta = problem.amplitudes(at.point)
    weights = problem.weights(at.point) if problem.moduli else np.ones(len(problem.stiffness_terms))
    stated = 0.0 * matrix
    sizes = abs(matrix)
    for weight, term in zip(weights, problem.stiffness_terms, strict=True):
        stated = stated + weight * term
        sizes = sizes + abs(weight * term)
    lifted = abs(problem.lifts @ theta)
    loads = problem.spread.of(problem.loads_at(at.point, theta))
    acting = abs(problem.spread.of(problem.external) @ theta) + sizes @ lifted
    gaps = problem.gaps @ theta
    reach = abs(gaps) + abs(problem.contact) @ lifted
    errors = {
        "K": _of_diagonal(csr_matrix(matrix - stated), csr_matrix(sizes), problem),
        "the loads": _largest(at.loads - loads, problem) / (_largest(acting, problem) or 1.0),
        "B": abs(at.problem.contact - problem.contact).max() / (abs(problem.contact).max() or 1.0),
        "the gaps": _largest(at.gaps - gaps, problem) / (_largest(reach, problem) or 1.0),
    }
    for quantity, error in errors.items():
        if not error <= VALUE_ROUND_OFF:
            raise SceneError(
                f"the system of scene '{name}' states parts, and {quantity} of its equations "
                f"differ from their sum by {error:.2g} of it at "
                f"{problem.parameters.described(at.point)}: reductors read the parts alone. "
                "State all that depends on parameters there, or return None"
            )


def _largest(values: np.ndarray, problem: ContactProblem) -> float:
    """Largest size of values on all ranks; NaN if one is."""
    return float(np.max(problem.group.gathered(np.abs(values).max(initial=0.0))))


def _of_diagonal(off: csr_matrix, sizes: csr_matrix, problem: ContactProblem) -> float:
    """Largest entry of local rows over the root of the diagonals of its row and column.

    The rows are (own, N).
    """
    diagonal = np.zeros(problem.free.size)
    diagonal[problem.rows] = sizes.diagonal(problem.first)
    root = np.sqrt(problem.spread.sum(diagonal))
    rows = problem.first + np.repeat(np.arange(off.shape[0]), np.diff(off.indptr))
    scale = root[rows] * root[off.indices]
    with np.errstate(divide="ignore", invalid="ignore"):
        return _largest(np.where(off.data == 0.0, 0.0, off.data / scale), problem)
