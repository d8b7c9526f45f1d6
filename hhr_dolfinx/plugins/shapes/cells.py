"""Cells whose nodes shapes move, in NumPy: their strain from their nodes and tabulated shape
functions.

The displacement has the shape functions of the geometry. The strain at cell midpoints is computed
again for each shape: interpolated, it would suffer from cancellation, as a small difference of
large displacements.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from hhr_dolfinx.declared import Booleans, Floats, Integers
from hhr_dolfinx.plugins.shapes.shape import Shape


@dataclass(frozen=True)
class Middles:
    """Nodes at the mean of others, wherever these lie."""

    nodes: Annotated[Integers, "middles"]  #: their numbers, (h,)
    #: nodes whose mean each is, (h, k); a node may repeat, and each entry weighs 1 / k
    between: Annotated[Integers, "middles", "weights"]

    def placed(self, points: np.ndarray) -> np.ndarray:
        """Coordinates of all nodes, (n, dim), with the midpoints recomputed in place."""
        points[self.nodes] = points[self.between].mean(axis=1)
        return points

    def among(self, nodes: np.ndarray) -> Middles:
        """Middles among ``nodes``, which ascend, by their indices there.

        ``nodes`` must hold all of ``between`` too.
        """
        present = np.isin(self.nodes, nodes)
        return Middles(
            np.searchsorted(nodes, self.nodes[present]),
            np.searchsorted(nodes, self.between[present]),
        )


class CellStrain(NamedTuple):
    """Strain of fields on cells with given nodes.

    It multiplies values at their nodes like a matrix.
    """

    cells: np.ndarray  #: nodes of each, (c, k)
    gradients: np.ndarray  #: of the shape functions at the midpoints, (c, dim, k)
    hoop: np.ndarray | None  #: shape functions over the radius, (c, k); None outside axisymmetry
    dilatation: (
        np.ndarray | None
    )  #: mean contribution of each dof to the trace, (c, k, dim); None for the midpoint's

    def __matmul__(self, field: np.ndarray) -> np.ndarray:
        """Kelvin's notation of the strain, cell by cell, (c components, ...).

        The field has values node by node, (n dim, ...).
        """
        dim = self.gradients.shape[1]
        columns = field.shape[1:]
        at_corners = field.reshape(-1, dim * int(np.prod(columns)))[self.cells]
        slopes = np.matmul(self.gradients, at_corners)
        slopes = slopes.reshape(
            len(self.cells), dim, dim, -1
        )  # derivative along, component of the field, column
        strain = np.zeros((len(self.cells), 6 if dim == 3 else 4, slopes.shape[3]))
        for axis in range(dim):
            strain[:, axis] = slopes[:, axis, axis]
        if self.hoop is not None:
            radial = at_corners.reshape(*self.cells.shape, dim, -1)[:, :, 0]
            strain[:, 2] = np.einsum("ck,ckp->cp", self.hoop, radial)
        for row, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))[: strain.shape[1] - 3], start=3):
            strain[:, row] = (slopes[:, i, j] + slopes[:, j, i]) / np.sqrt(2)
        if self.dilatation is not None:
            corners = at_corners.reshape(len(self.cells), -1, strain.shape[2])
            mean = np.einsum("ck,ckp->cp", self.dilatation.reshape(len(self.cells), -1), corners)
            strain[:, :3] += ((mean - strain[:, :3].sum(axis=1)) / 3)[:, None]
        return strain.reshape(-1, *columns)


@dataclass(frozen=True, eq=False)
class MovingCells:
    """Cells of a body whose nodes depend on shapes; maps a point to the strain of the cells."""

    shapes: tuple[Shape, ...]  #: of the scene that move any of its nodes
    moved: tuple[Annotated[Booleans, "nodes"], ...]  #: nodes that each shape moves, (n,)
    coordinates: tuple[str, ...]  #: names of the coordinates in their formulas
    parameters: tuple[str, ...]  #: names of the parameters
    middles: Middles  #: nodes that stay at the midpoint of others, by their indices among these
    points: Annotated[
        Floats, "nodes", "dim"
    ]  #: the nodes as the mesh of the scene has them, (n, dim)
    nodes: Annotated[Integers, "nodes"]  #: their numbers in the mesh, (n,)
    cells: Annotated[
        Integers, "cells", "nodes of a cell", "< nodes"
    ]  #: indices of their nodes among these, (c, k)
    values: Annotated[
        Floats, "nodes of a cell"
    ]  #: of the shape functions at the midpoint of the reference cell, (k,)
    slopes: Annotated[Floats, "nodes of a cell", "dim"]  #: their derivatives there, (k, dim)
    weights: Annotated[
        Floats, "points"
    ]  #: of the points where the dilatation is evaluated, (q,); empty: the midpoint
    gauss_values: Annotated[
        Floats, "points", "nodes of a cell"
    ]  #: of the shape functions there, (q, k), and the next
    gauss_slopes: Annotated[
        Floats, "points", "nodes of a cell", "dim"
    ]  #: their derivatives there, (q, k, dim)
    axisymmetric: bool  #: the first coordinate is a radius

    @property
    def dofs(self) -> np.ndarray:
        """Dofs of its nodes, (n dim,)."""
        dim = self.points.shape[1]
        return (dim * self.nodes[:, None] + np.arange(dim)).ravel()

    def __call__(self, point: np.ndarray) -> CellStrain:
        """The strain at a point, (P,)."""
        values = dict(zip(self.parameters, point.tolist(), strict=True))
        points = self.points.copy()
        for shape, moved_nodes in zip(self.shapes, self.moved, strict=True):
            points[moved_nodes] = shape.moved(self.points[moved_nodes], self.coordinates, values)
        corners = self.middles.placed(points)[self.cells]
        gradients, _ = _mapped_gradients(corners, self.slopes)
        hoop = (
            self.values / (corners[:, :, 0] @ self.values)[:, None] if self.axisymmetric else None
        )
        return CellStrain(
            self.cells, gradients, hoop, self._dilatation(corners) if self.weights.size else None
        )

    def _dilatation(self, corners: np.ndarray) -> np.ndarray:
        """Mean contribution of each dof to the trace of the strain in each cell, (c, k, dim)."""
        total = np.zeros_like(corners)
        volume = np.zeros(len(corners))
        for weight, values, slopes in zip(
            self.weights, self.gauss_values, self.gauss_slopes, strict=True
        ):
            gradients, size = _mapped_gradients(corners, slopes)
            if self.axisymmetric:
                radius = corners[:, :, 0] @ values
                gradients[:, 0] += values / radius[:, None]
                size = size * radius
            total += (weight * size)[:, None, None] * gradients.transpose(0, 2, 1)
            volume += weight * size
        return total / volume[:, None, None]


def _mapped_gradients(corners: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the shape functions, (c, dim, k), and sizes of the map, (c,).

    They follow from slopes on the reference cell.
    """
    count = len(corners)
    dim = slopes.shape[1]
    # one product for all cells and an explicit inverse: a quarter of the time of numpy's for
    # thousands of matrices
    jacobians = np.ascontiguousarray(corners.transpose(0, 2, 1)).reshape(-1, len(slopes)) @ slopes
    columns = np.ascontiguousarray(jacobians.reshape(count, dim, dim).transpose(2, 0, 1))
    if len(columns) == 2:
        first, second = columns[0].T
        third, fourth = columns[1].T
        rows = np.stack(
            [np.column_stack([fourth, -third]), np.column_stack([-second, first])], axis=1
        )
    else:
        rows = np.stack([np.cross(columns[k - 2], columns[k - 1]) for k in range(3)], axis=1)
    sizes = np.einsum("ci,ci->c", columns[0], rows[:, 0])
    inverses = np.ascontiguousarray((rows / sizes[:, None, None]).transpose(0, 2, 1))
    return (inverses.reshape(-1, dim) @ slopes.T).reshape(count, dim, len(slopes)), np.abs(sizes)
