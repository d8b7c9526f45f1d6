"""Strains and rotations of elastic bodies in the cells of their mesh: whether they are small."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.certify.accuracy import Solutions
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ReductionError, SmallStrainWarning
from hhr_dolfinx.models.histories.small_strains import LARGE, MOST, large_rotation, large_strain, spread_strain
from hhr_dolfinx.warn import warn

CORNERS = 16
"""Corners of the box, at most, in which strains of a model are looked at."""
TOGETHER = 50
"""Answers whose strains are made at once; one, of which ranks that share rows have all values for that long."""


def check_small_strains(full: Any, *sets: Solutions | None) -> None:
    """Look at strains and rotations of answers of a full model at single parameters.

    Strains of histories were looked at step by step; their rotations are not.

    Raises:
        ReductionError: where any has strains or rotations that no theory of small strains knows.

    Warns:
        SmallStrainWarning: where they are large in any, with the parameter.
    """
    given = [item for item in sets if item is not None]
    if full.equilibrium is None and given:
        _check(full, given)


def check_corners(full: Any, model: Any) -> None:
    """Look at strains and rotations of a model's answers in corners of the box, where loads are largest.

    Raises, warns: see :func:`check_small_strains`.
    """
    if full.equilibrium is not None:
        return
    problem = full.problem
    ends = np.array([problem.parameters.lower, problem.parameters.upper], dtype=float)
    count = 2 ** min(ends.shape[1], 10)
    numbers = np.unique(np.linspace(0, count - 1, min(count, CORNERS)).astype(int))
    axes = np.arange(ends.shape[1])
    corners = np.array([ends[(number >> (axes % 10)) & 1, axes] for number in numbers])
    many = model.solve_many(corners, raise_on_failure=False, outside="ignore")
    found = [answer for answer in many if answer.converged]
    if found:
        points = np.array([answer.parameter for answer in found])
        lifts = problem.amplitudes.sum_columns(problem.lifts, points)
        whole = np.stack([answer.displacement() for answer in found], axis=1)
        _check(full, [_Answers(points, problem.spread.of(whole - lifts))])


class _Answers(NamedTuple):
    """Answers of a model: parameters, (S, P), and own rows of displacements without lifts, (own, S)."""

    points: np.ndarray
    displacements: np.ndarray


def _check(full: Any, given: Sequence[Any]) -> None:
    """See :func:`check_small_strains`."""
    problem = full.problem
    points = np.concatenate([item.points for item in given])
    gradients = _gradients(problem)
    strains = _strains(problem, gradients, full.scene.hypothesis == "axisymmetric")
    for operator, in_words in ((strains, large_strain), (_rotations(problem, gradients), large_rotation)):
        spread = np.concatenate([_spread(problem, operator, item) for item in given])
        worst = int(spread.argmax())
        if spread[worst] <= LARGE:
            continue
        message = f"at {problem.parameters.described(points[worst])}: {in_words(spread[worst])}"
        if spread[worst] > MOST:
            raise ReductionError(message)
        warn(message, SmallStrainWarning, stacklevel=3)


def _spread(problem: ContactProblem, operator: csr_matrix, solutions: Solutions | _Answers) -> np.ndarray:
    """The strain or rotation of each answer that few cells exceed, (S,)."""
    spread = []
    each = TOGETHER if problem.comm is None else 1
    for first in range(0, len(solutions.points), each):
        part = slice(first, first + each)
        lifts = problem.amplitudes.sum_columns(problem.lifts, solutions.points[part])
        found = np.abs(operator @ (problem.spread.whole(solutions.displacements[:, part]) + lifts))
        sizes = found.reshape(len(problem.cell_nodes), -1, found.shape[1]).max(axis=1)
        spread += [spread_strain(column) for column in sizes.T]
    return np.array(spread)


def _strains(problem: ContactProblem, gradients: np.ndarray, axisymmetric: bool) -> csr_matrix:
    """Maps displacements, (N,), to the strain in each cell, by the linear field nearest to it, (cells * k, N)."""
    cells, dim, nodes = gradients.shape
    pairs = [(i, j) for i in range(dim) for j in range(i, dim)]
    values = np.zeros((cells, len(pairs) + axisymmetric, nodes, dim))
    for row, (i, j) in enumerate(pairs):
        values[:, row, :, i] += gradients[:, j] / 2
        values[:, row, :, j] += gradients[:, i] / 2
    if axisymmetric:
        radius = problem.points[problem.cell_nodes, 0].sum(axis=1)
        values[:, -1, :, 0] = (1 / np.where(radius > 0, radius, np.inf))[:, None]
    return _matrix(problem, values)


def _rotations(problem: ContactProblem, gradients: np.ndarray) -> csr_matrix:
    """The same for the rotation in each cell, in radians, (cells * k, N): one in the plane, three in space."""
    cells, dim, nodes = gradients.shape
    pairs = [(i, j) for i in range(dim) for j in range(i + 1, dim)]
    values = np.zeros((cells, len(pairs), nodes, dim))
    for row, (i, j) in enumerate(pairs):
        values[:, row, :, i] -= gradients[:, j] / 2
        values[:, row, :, j] += gradients[:, i] / 2
    return _matrix(problem, values)


def _gradients(problem: ContactProblem) -> np.ndarray:
    """Maps values at the nodes of each cell to the gradient of the linear field nearest to them, (cells, dim, n)."""
    places = problem.points[problem.cell_nodes]
    return np.linalg.pinv(places - places.mean(axis=1, keepdims=True))


def _matrix(problem: ContactProblem, values: np.ndarray) -> csr_matrix:
    """Rows of each cell on the displacements of its nodes, (cells, k, n, dim), as a sparse matrix, (cells * k, N)."""
    dim = values.shape[3]
    columns = dim * problem.cell_nodes[:, None, :, None] + np.arange(dim)
    rows = np.arange(values.shape[0] * values.shape[1]).reshape(*values.shape[:2], 1, 1)
    where = np.broadcast_to(rows, values.shape).ravel(), np.broadcast_to(columns, values.shape).ravel()
    return csr_matrix((values.ravel(), where), shape=(rows.size, problem.free.size))
