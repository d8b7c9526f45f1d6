"""Cells in NumPy: their stiffness and strain from their nodes and tabulated shape functions, without a mesh library.

The displacement has the shape functions of the geometry. If shapes move the nodes, the strain at cell midpoints is
recomputed: interpolated, it would suffer from cancellation, as a small difference of large displacements.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from hhr_dolfinx.declared import Booleans, Floats, Integers
from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.shapes import Shape


@dataclass(frozen=True)
class CellRule:
    """Quadrature on the reference cell, and the shape functions at its points.

    Attributes:
        weights: (q,).
        values: of the shape functions, (q, n).
        slopes: of the shape functions, (q, n, dim).
    """

    weights: Annotated[Floats, "points"]
    values: Annotated[Floats, "points", "nodes of a cell"]
    slopes: Annotated[Floats, "points", "nodes of a cell", "dim"]


@dataclass(frozen=True)
class Middles:
    """Nodes at the mean of others, wherever these lie.

    Attributes:
        nodes: their numbers, (h,).
        between: nodes whose mean each is, (h, k); a node may repeat, and each entry weighs 1 / k.
    """

    nodes: Annotated[Integers, "middles"]
    between: Annotated[Integers, "middles", "weights"]

    def placed(self, points: np.ndarray) -> np.ndarray:
        """Coordinates of all nodes, (n, dim), with the midpoints recomputed in place."""
        points[self.nodes] = points[self.between].mean(axis=1)
        return points

    def among(self, nodes: np.ndarray) -> Middles:
        """Middles among ``nodes``, which ascend, by their indices there; ``nodes`` must hold all of ``between`` too."""
        kept = np.isin(self.nodes, nodes)
        return Middles(np.searchsorted(nodes, self.nodes[kept]), np.searchsorted(nodes, self.between[kept]))


def element_stiffness(
    nodes: np.ndarray, rule: CellRule, hypothesis: str, volume: float, shape: float, mean_dilatation: bool
) -> np.ndarray:
    """Stiffness of isotropic cells, (c, n dim, n dim), dofs node by node.

    With g the gradients of the shape functions, it is the sum over Gauss points of λ' tr ε tr ε + 2 μ' ε : ε, and
    2 ε : ε of u_ai and u_bj is g_aj g_bi + δ_ij g_a·g_b; in axisymmetry the strain u_r / r is added. A mean
    dilatation m instead of the trace t, a third of it on each axis, changes these to m² and ε : ε + (m² - t²) / 3.

    Args:
        nodes: their coordinates, (c, n, dim).
        rule: quadrature.
        hypothesis: of the scene; axisymmetric weights are 2 π r.
        volume: λ', weight of the change of volume.
        shape: μ', weight of the change of shape.
        mean_dilatation: whether every point has the mean of the trace over the volume of its cell.

    Raises:
        ParameterError: for cells without volume.
    """
    count, size, dim = nodes.shape
    gradients, measures = _gradients(nodes, rule)
    hoops = None
    if hypothesis == "axisymmetric":
        radii = nodes[:, :, 0] @ rule.values.T
        measures = measures * (2 * np.pi * radii)
        hoops = np.zeros((count, len(rule.weights), size, dim))
        hoops[..., 0] = rule.values / radii[:, :, None]
    roots = np.sqrt(measures)[:, :, None, None]
    gradients *= roots
    products = _squared(gradients)
    traces = products
    if hoops is not None:
        hoops *= roots
        gradients += hoops
        traces = _squared(gradients)
    by_node = products.reshape(count, size, dim, size, dim)
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


def _gradients(nodes: np.ndarray, rule: CellRule) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the shape functions, (c, q, n, dim), and volumes of the Gauss points without weight, (c, q)."""
    count, size, dim = nodes.shape
    slopes = rule.slopes
    flat = np.ascontiguousarray(slopes.transpose(1, 2, 0)).reshape(size, -1)
    # d x_i / d ξ_k at each point: jacobian[i, k] is (c, q)
    jacobian = (np.ascontiguousarray(nodes.transpose(2, 0, 1)) @ flat).reshape(dim, count, dim, -1).swapaxes(1, 2)
    inverse, determinant = _inverse(jacobian)
    if not (np.abs(determinant) > 0).all():
        raise ParameterError("a cell of the reduced domain has no volume for this shape: narrow the box")
    gradients = np.empty((count, len(rule.weights), size, dim))
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


class CellStrain(NamedTuple):
    """Strain of fields on cells with given nodes; multiplies values at their nodes like a matrix.

    Attributes:
        cells: nodes of each, (c, k).
        gradients: of the shape functions at the midpoints, (c, dim, k).
        hoop: shape functions over the radius, (c, k); None outside axisymmetry.
        dilatation: mean contribution of each dof to the trace, (c, k, dim); None for the trace at the midpoint.
    """

    cells: np.ndarray
    gradients: np.ndarray
    hoop: np.ndarray | None
    dilatation: np.ndarray | None

    def __matmul__(self, field: np.ndarray) -> np.ndarray:
        """Kelvin's notation, cell by cell, (c components, ...), of values node by node, (n dim, ...)."""
        dim = self.gradients.shape[1]
        columns = field.shape[1:]
        at_corners = field.reshape(-1, dim * int(np.prod(columns)))[self.cells]
        slopes = np.matmul(self.gradients, at_corners)
        slopes = slopes.reshape(len(self.cells), dim, dim, -1)  # derivative along, component of the field, column
        strain = np.zeros((len(self.cells), 6 if dim == 3 else 4, slopes.shape[3]))
        for axis in range(dim):
            strain[:, axis] = slopes[:, axis, axis]
        if self.hoop is not None:
            radial = at_corners.reshape(*self.cells.shape, dim, -1)[:, :, 0]
            strain[:, 2] = np.einsum("ck,ckp->cp", self.hoop, radial)
        for place, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))[: strain.shape[1] - 3], start=3):
            strain[:, place] = (slopes[:, i, j] + slopes[:, j, i]) / np.sqrt(2)
        if self.dilatation is not None:
            corners = at_corners.reshape(len(self.cells), -1, strain.shape[2])
            mean = np.einsum("ck,ckp->cp", self.dilatation.reshape(len(self.cells), -1), corners)
            strain[:, :3] += ((mean - strain[:, :3].sum(axis=1)) / 3)[:, None]
        return strain.reshape(-1, *columns)


@dataclass(frozen=True, eq=False)
class MovingCells:
    """Cells of a body whose nodes depend on shapes; maps a point to the strain of the cells there.

    Attributes:
        shapes: of the scene that move any of its nodes.
        moved: nodes that each shape moves, (n,) bool.
        coordinates: names of the coordinates in their formulas.
        parameters: names of the parameters.
        middles: nodes that stay at the midpoint of others, by their indices among these.
        points: the nodes as the mesh of the scene has them, (n, dim).
        nodes: their numbers in the mesh, (n,).
        cells: indices of the nodes of each cell among these, (c, k).
        values, slopes: of the shape functions at the midpoint of the reference cell, (k,) and (k, dim).
        weights: of the points where the dilatation is evaluated, (q,); empty for the midpoint.
        gauss_values, gauss_slopes: of the shape functions there, (q, k) and (q, k, dim).
        axisymmetric: whether the first coordinate is a radius.
    """

    shapes: tuple[Shape, ...]
    moved: tuple[Annotated[Booleans, "nodes"], ...]
    coordinates: tuple[str, ...]
    parameters: tuple[str, ...]
    middles: Middles
    points: Annotated[Floats, "nodes", "dim"]
    nodes: Annotated[Integers, "nodes"]
    cells: Annotated[Integers, "cells", "nodes of a cell", "< nodes"]
    values: Annotated[Floats, "nodes of a cell"]
    slopes: Annotated[Floats, "nodes of a cell", "dim"]
    weights: Annotated[Floats, "points"]
    gauss_values: Annotated[Floats, "points", "nodes of a cell"]
    gauss_slopes: Annotated[Floats, "points", "nodes of a cell", "dim"]
    axisymmetric: bool

    @property
    def dofs(self) -> np.ndarray:
        """Dofs of its nodes, (n dim,)."""
        dim = self.points.shape[1]
        return (dim * self.nodes[:, None] + np.arange(dim)).ravel()

    def __call__(self, point: np.ndarray) -> CellStrain:
        """The strain at a point, (P,)."""
        values = dict(zip(self.parameters, point.tolist(), strict=True))
        points = self.points.copy()
        for shape, own in zip(self.shapes, self.moved, strict=True):
            points[own] = shape.moved(self.points[own], self.coordinates, values)
        corners = self.middles.placed(points)[self.cells]
        gradients, _ = _mapped_gradients(corners, self.slopes)
        hoop = self.values / (corners[:, :, 0] @ self.values)[:, None] if self.axisymmetric else None
        return CellStrain(self.cells, gradients, hoop, self._dilatation(corners) if self.weights.size else None)

    def _dilatation(self, corners: np.ndarray) -> np.ndarray:
        """Mean contribution of each dof to the trace of the strain over the volume of each cell, (c, k, dim)."""
        total = np.zeros_like(corners)
        volume = np.zeros(len(corners))
        for weight, values, slopes in zip(self.weights, self.gauss_values, self.gauss_slopes, strict=True):
            gradients, size = _mapped_gradients(corners, slopes)
            if self.axisymmetric:
                radius = corners[:, :, 0] @ values
                gradients[:, 0] += values / radius[:, None]
                size = size * radius
            total += (weight * size)[:, None, None] * gradients.transpose(0, 2, 1)
            volume += weight * size
        return total / volume[:, None, None]


def _mapped_gradients(corners: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the shape functions, (c, dim, k), and sizes of the map, (c,), from slopes on the reference cell."""
    count = len(corners)
    dim = slopes.shape[1]
    # one product for all cells and an explicit inverse: a quarter of the time of numpy's for thousands of matrices
    jacobians = np.ascontiguousarray(corners.transpose(0, 2, 1)).reshape(-1, len(slopes)) @ slopes
    columns = np.ascontiguousarray(jacobians.reshape(count, dim, dim).transpose(2, 0, 1))
    if len(columns) == 2:
        first, second = columns[0].T
        third, fourth = columns[1].T
        rows = np.stack([np.column_stack([fourth, -third]), np.column_stack([-second, first])], axis=1)
    else:
        rows = np.stack([np.cross(columns[k - 2], columns[k - 1]) for k in range(3)], axis=1)
    sizes = np.einsum("ci,ci->c", columns[0], rows[:, 0])
    inverses = np.ascontiguousarray((rows / sizes[:, None, None]).transpose(0, 2, 1))
    return (inverses.reshape(-1, dim) @ slopes.T).reshape(count, dim, len(slopes)), np.abs(sizes)
