"""Strains and rotations of cells, and their limits, beyond which the theory is inaccurate."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

if TYPE_CHECKING:
    from hhr_dolfinx.contact.problem import ContactProblem


LARGE_STRAIN = 0.1
"""Strain that raises a warning: the neglected squares, e^2 / 2, are a twentieth of it."""
STRAIN_LIMIT = 1.0
"""Strain at which small-strain theory has no solution.

Beyond a limit load, the only balance is round-off.
"""
EXEMPT_POINTS = 0.01
"""Part of the points that may have larger strains: at the corner of a punch they depend on the
mesh.
"""
FLAT = 1e-9
"""Size of a cell across its largest one up to which it is round-off: pairs of nodes are such
cells.
"""
SAMPLED_CELLS = 20_000
"""Most cells whose strains are evaluated: they estimate the largest hundredth as well as all
cells.
"""


def spread_strain(sizes: np.ndarray) -> float:
    """Strain that is exceeded at a hundredth of the points, from the sizes at each, (points,)."""
    count = max(int(EXEMPT_POINTS * sizes.size), 1)
    return float(np.partition(sizes, -count)[-count])


def large_strain(strain: float) -> str:
    """Message on a large strain."""
    return (
        f"a strain of {strain:.2g} at more than {EXEMPT_POINTS:.0%} of the points is no "
        f"small strain, and "
        f"answers are those of small strains, which are a few per cent off at "
        f"{LARGE_STRAIN:g} and mean "
        f"nothing at {STRAIN_LIMIT:g}: lower the load, check units and moduli, or take a "
        f"program for "
        "finite strains"
    )


def _large_rotation(rotation: float) -> str:
    return (
        f"a rotation of {rotation:.2g} rad in more than {EXEMPT_POINTS:.0%} of the cells "
        f"is not small, "
        "and answers are those of small displacements, to which a rotation of w is a strain of "
        f"w^2 / 2 = {rotation**2 / 2:.2g} that is not there: lower the load, or take a program "
        "for large displacements"
    )


class StrainKind(NamedTuple):
    """Strains or rotations of cells: (cells * k, N) maps displacements to their components.

    And their message.
    """

    matrix: csr_matrix
    cells: int
    in_words: Callable[[float], str]

    def sizes(self, displacements: np.ndarray) -> np.ndarray:
        """The largest component in each cell, (cells, S), of displacements, (N, S)."""
        components = np.abs(self.matrix @ displacements)
        return components.reshape(self.cells, -1, components.shape[1]).max(axis=1)


def strain_kinds(problem: ContactProblem, *, axisymmetric: bool) -> tuple[StrainKind, StrainKind]:
    """Strains, and rotations in radians, of at most :data:`SAMPLED_CELLS` cells of a mesh.

    There is one rotation in the plane, and three in space. They are those of the linear field
    nearest to the displacement in each cell.

    Args:
        problem: the contact problem.
        axisymmetric: add the hoop strain.
    """
    cells = problem.cell_nodes[:: -(-len(problem.cell_nodes) // SAMPLED_CELLS)]
    corners = problem.points[cells]
    # values at the nodes of each cell to the gradient there, (cells, dim, n)
    gradients = np.linalg.pinv(corners - corners.mean(axis=1, keepdims=True), rcond=FLAT)
    strains = _halves(gradients, 1)
    if axisymmetric:
        radius = corners[:, :, 0].sum(axis=1)
        hoop = np.zeros_like(strains[:, :1])
        hoop[:, 0, :, 0] = (1 / np.where(radius > 0, radius, np.inf))[:, None]
        strains = np.concatenate([strains, hoop], axis=1)
    strain = StrainKind(_matrix(problem, cells, strains), len(cells), large_strain)
    return strain, StrainKind(
        _matrix(problem, cells, _halves(gradients, -1)), len(cells), _large_rotation
    )


def _halves(gradients: np.ndarray, sign: int) -> np.ndarray:
    """Strains (sign 1) or rotations (-1) of each cell, (cells, k, n, dim).

    They follow from its gradients, (cells, dim, n).
    """
    cells, dim, nodes = gradients.shape
    rows, columns = np.triu_indices(dim, k=0 if sign > 0 else 1)
    values = np.zeros((cells, rows.size, nodes, dim))
    for number, (i, j) in enumerate(zip(rows, columns, strict=True)):
        values[:, number, :, i] += sign * gradients[:, j] / 2
        values[:, number, :, j] += gradients[:, i] / 2
    return values


def _matrix(problem: ContactProblem, nodes_of: np.ndarray, values: np.ndarray) -> csr_matrix:
    """Rows of each cell on the displacements of its nodes, as a sparse matrix, (cells * k, N).

    The rows are (cells, k, n, dim).
    """
    dim = values.shape[3]
    columns = dim * nodes_of[:, None, :, None] + np.arange(dim)
    rows = np.arange(values.shape[0] * values.shape[1]).reshape(*values.shape[:2], 1, 1)
    where = (
        np.broadcast_to(rows, values.shape).ravel(),
        np.broadcast_to(columns, values.shape).ravel(),
    )
    return csr_matrix((values.ravel(), where), shape=(rows.size, problem.free.size))
