"""Strains and rotations in the cells of a mesh, and warnings of answers with large ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import SmallStrainWarning
from hhr_dolfinx.models.histories.small_strains import LARGE, MOST, large_rotation, large_strain, spread_strain
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer


CELLS = 20_000
"""Most cells whose strains are evaluated: they estimate the largest hundredth as well as all cells."""
GROWN = 1.5
"""Growth of the squared displacement after which strains of a full model are checked again."""


class StrainKind(NamedTuple):
    """Strains or rotations of cells: (cells * k, N) maps displacements to their components; and their message."""

    matrix: csr_matrix
    cells: int
    in_words: Callable[[float], str]

    def sizes(self, displacements: np.ndarray) -> np.ndarray:
        """The largest component in each cell, (cells, S), of displacements, (N, S)."""
        found = np.abs(self.matrix @ displacements)
        return found.reshape(self.cells, -1, found.shape[1]).max(axis=1)


class StrainOperators(NamedTuple):
    """Strains and rotations of cells of a mesh, by the linear field nearest to the displacement in each."""

    kinds: tuple[StrainKind, StrainKind]

    @classmethod
    def of(cls, problem: ContactProblem, *, axisymmetric: bool) -> StrainOperators:
        """Operators of at most :data:`CELLS` cells, evenly distributed over the mesh."""
        cells = problem.cell_nodes[:: -(-len(problem.cell_nodes) // CELLS)]
        gradients = _gradients(problem, cells)
        strains = _strains(problem, cells, gradients, axisymmetric)
        rotations = _rotations(problem, cells, gradients)
        strain = StrainKind(strains, len(cells), large_strain)
        return cls((strain, StrainKind(rotations, len(cells), large_rotation)))


class StrainGuard:
    """Warns of the first answer of a full model with a large strain or rotation, and of the first with an absurd one.

    Answers of elastic bodies are checked if their displacement is larger than that of all before, so that most cost one
    scalar product.

    Args:
        problem: the problem that is solved.
        axisymmetric: whether strains have a hoop component.
    """

    def __init__(self, problem: ContactProblem, *, axisymmetric: bool):
        self.limit = LARGE
        """The strain or rotation above which the next warning is due."""
        self._problem = problem
        self._axisymmetric = axisymmetric
        self._looked = 0.0
        self._paused = False

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Suspend the check in a block whose caller checks all answers at once."""
        before, self._paused = self._paused, True
        try:
            yield
        finally:
            self._paused = before

    @cached_property
    def operators(self) -> StrainOperators:
        """Strains and rotations of cells of the mesh."""
        return StrainOperators.of(self._problem, axisymmetric=self._axisymmetric)

    def look(self, answer: Answer) -> None:
        """Check an :class:`~hhr_dolfinx.models.answer.Answer` of the full model.

        Warns:
            SmallStrainWarning: if one is above :data:`LARGE`, and once more above :data:`MOST`.
        """
        unknown = answer.unknown
        size = unknown @ unknown
        if self._paused or not size > GROWN * self._looked:
            return
        self._looked = size
        whole = answer.displacement()[:, None]
        for kind in self.operators.kinds:
            size = spread_strain(kind.sizes(whole)[:, 0])
            if size > self.limit:
                self.limit = MOST if size <= MOST else np.inf
                where = self._problem.parameters.described(answer.parameter)
                warn(f"at {where}: {kind.in_words(size)}", SmallStrainWarning, stacklevel=4)
                return


def _strains(problem: ContactProblem, nodes_of: np.ndarray, gradients: np.ndarray, axisymmetric: bool) -> csr_matrix:
    """Maps displacements, (N,), to the strain in each cell, by the linear field nearest to it, (cells * k, N)."""
    cells, dim, nodes = gradients.shape
    pairs = [(i, j) for i in range(dim) for j in range(i, dim)]
    values = np.zeros((cells, len(pairs) + axisymmetric, nodes, dim))
    for row, (i, j) in enumerate(pairs):
        values[:, row, :, i] += gradients[:, j] / 2
        values[:, row, :, j] += gradients[:, i] / 2
    if axisymmetric:
        radius = problem.points[nodes_of, 0].sum(axis=1)
        values[:, -1, :, 0] = (1 / np.where(radius > 0, radius, np.inf))[:, None]
    return _matrix(problem, nodes_of, values)


def _rotations(problem: ContactProblem, nodes_of: np.ndarray, gradients: np.ndarray) -> csr_matrix:
    """Maps displacements, (N,), to rotations in cells, radians, (cells * k, N): one in the plane, three in space."""
    cells, dim, nodes = gradients.shape
    pairs = [(i, j) for i in range(dim) for j in range(i + 1, dim)]
    values = np.zeros((cells, len(pairs), nodes, dim))
    for row, (i, j) in enumerate(pairs):
        values[:, row, :, i] -= gradients[:, j] / 2
        values[:, row, :, j] += gradients[:, i] / 2
    return _matrix(problem, nodes_of, values)


def _gradients(problem: ContactProblem, nodes_of: np.ndarray) -> np.ndarray:
    """Maps values at the nodes of each cell to the gradient of the linear field nearest to them, (cells, dim, n)."""
    places = problem.points[nodes_of]
    return np.linalg.pinv(places - places.mean(axis=1, keepdims=True))


def _matrix(problem: ContactProblem, nodes_of: np.ndarray, values: np.ndarray) -> csr_matrix:
    """Rows of each cell on the displacements of its nodes, (cells, k, n, dim), as a sparse matrix, (cells * k, N)."""
    dim = values.shape[3]
    columns = dim * nodes_of[:, None, :, None] + np.arange(dim)
    rows = np.arange(values.shape[0] * values.shape[1]).reshape(*values.shape[:2], 1, 1)
    where = np.broadcast_to(rows, values.shape).ravel(), np.broadcast_to(columns, values.shape).ravel()
    return csr_matrix((values.ravel(), where), shape=(rows.size, problem.free.size))
