"""Stiffness of cells of degree 1 from their corners, in NumPy: what a reduced model assembles on its own.

Cells are triangles, quadrilaterals, tetrahedra and hexahedra, their nodes in the order of DOLFINx (tensor order where
there is a choice).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from hhr_dolfinx.declared import Floats
from hhr_dolfinx.errors import ParameterError


@dataclass(frozen=True)
class CellRule:
    """Quadrature on the reference cell.

    Attributes:
        points: (q, dim).
        weights: (q,).
        simplex: whether the cell is a triangle or a tetrahedron, else a square or a cube.
    """

    points: Annotated[Floats, "points", "dim"]
    weights: Annotated[Floats, "points"]
    simplex: bool

    @cached_property
    def functions(self) -> tuple[np.ndarray, np.ndarray]:
        """Shape functions at the points, (q, n), and their slopes, (q, n, dim)."""
        count, dim = self.points.shape
        if self.simplex:
            values = np.column_stack([1 - self.points.sum(axis=1), self.points])
            slopes = np.vstack([-np.ones(dim), np.eye(dim)])
            return values, np.broadcast_to(slopes, (count, dim + 1, dim))
        upper = (np.arange(2**dim)[:, None] >> np.arange(dim)) & 1
        along = np.where(upper, self.points[:, None], 1 - self.points[:, None])
        slopes = np.empty((count, 2**dim, dim))
        for axis in range(dim):
            others = np.delete(along, axis, axis=2).prod(axis=2)
            slopes[:, :, axis] = np.where(upper[:, axis], others, -others)
        return along.prod(axis=2), slopes


def element_stiffness(
    corners: np.ndarray, rule: CellRule, hypothesis: str, volume: float, shape: float, mean_dilatation: bool
) -> np.ndarray:
    """Stiffness of isotropic cells, (c, n dim, n dim), dofs node by node.

    With g the gradients of the shape functions, it is the sum over Gauss points of λ' tr ε tr ε + 2 μ' ε : ε, and
    2 ε : ε of u_ai and u_bj is g_aj g_bi + δ_ij g_a·g_b, in axisymmetry with the strain u_r / r besides. A mean
    dilatation m in place of the trace t, a third of it on each axis, changes these to m² and ε : ε + (m² - t²) / 3.

    Args:
        corners: coordinates of the nodes, (c, n, dim).
        rule: quadrature.
        hypothesis: of the scene; axisymmetric weights are 2 π r.
        volume: λ', weight of the change of volume.
        shape: μ', weight of the change of shape.
        mean_dilatation: whether every point takes the mean of the trace over the volume of its cell.

    Raises:
        ParameterError: for cells without volume.
    """
    count, nodes, dim = corners.shape
    gradients, measures = _gradients(corners, rule)
    hoops = None
    if hypothesis == "axisymmetric":
        radii = corners[:, :, 0] @ rule.functions[0].T
        measures = measures * (2 * np.pi * radii)
        hoops = np.zeros((count, len(rule.weights), nodes, dim))
        hoops[..., 0] = rule.functions[0] / radii[:, :, None]
    roots = np.sqrt(measures)[:, :, None, None]
    gradients *= roots
    products = _squared(gradients)
    traces = products
    if hoops is not None:
        hoops *= roots
        gradients += hoops
        traces = _squared(gradients)
    by_node = products.reshape(count, nodes, dim, nodes, dim)
    stiffness = by_node.transpose(0, 1, 4, 3, 2) * shape
    laplace = sum(by_node[:, :, axis, :, axis] for axis in range(dim)) * shape
    for axis in range(dim):
        stiffness[:, :, axis, :, axis] += laplace
    stiffness = stiffness.reshape(products.shape)
    if hoops is not None:
        stiffness += 2 * shape * _squared(hoops)
    if not mean_dilatation:
        stiffness += volume * traces
        return stiffness
    mean = (roots[:, :, 0] * gradients.reshape(count, len(rule.weights), -1)).sum(axis=1)
    means = mean[:, :, None] * (mean / measures.sum(axis=1)[:, None])[:, None]
    stiffness += (volume + 2 * shape / 3) * means
    stiffness -= 2 * shape / 3 * traces
    return stiffness


def _gradients(corners: np.ndarray, rule: CellRule) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the shape functions, (c, q, n, dim), and volumes of the Gauss points without weight, (c, q)."""
    count, nodes, dim = corners.shape
    slopes = rule.functions[1]
    flat = np.ascontiguousarray(slopes.transpose(1, 2, 0)).reshape(nodes, -1)
    # d x_i / d ξ_k at each point: jacobian[i, k] is (c, q)
    jacobian = (np.ascontiguousarray(corners.transpose(2, 0, 1)) @ flat).reshape(dim, count, dim, -1).swapaxes(1, 2)
    inverse, determinant = _inverse(jacobian)
    if not (np.abs(determinant) > 0).all():
        raise ParameterError("a cell of the reduced domain has no volume for this shape: narrow the box")
    gradients = np.empty((count, len(rule.weights), nodes, dim))
    for axis in range(dim):
        parts = (slopes[:, :, k] * inverse[k][axis][:, :, None] for k in range(dim))
        gradients[..., axis] = sum(parts)
    return gradients, np.abs(determinant) * rule.weights


def _inverse(matrix: np.ndarray) -> tuple[list[list[np.ndarray]], np.ndarray]:
    """Inverse, by rows, and determinant of many matrices of 2 or 3 rows, (dim, dim, c, q)."""
    if len(matrix) == 2:
        (a, b), (c, d) = matrix
        determinant = a * d - b * c
        return [[d / determinant, -b / determinant], [-c / determinant, a / determinant]], determinant
    minor = [
        [
            matrix[(i + 1) % 3, (k + 1) % 3] * matrix[(i + 2) % 3, (k + 2) % 3]
            - matrix[(i + 1) % 3, (k + 2) % 3] * matrix[(i + 2) % 3, (k + 1) % 3]
            for i in range(3)
        ]
        for k in range(3)
    ]
    determinant = sum(matrix[i, 0] * minor[0][i] for i in range(3))
    return [[minor[k][i] / determinant for i in range(3)] for k in range(3)], determinant


def _squared(rows: np.ndarray) -> np.ndarray:
    """Products of all dofs summed over the points of each cell, (c, q, n, dim) -> (c, n dim, n dim)."""
    flat = rows.reshape(*rows.shape[:2], -1)
    return flat.transpose(0, 2, 1) @ flat
