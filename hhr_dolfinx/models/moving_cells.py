"""Strain in the middles of cells whose nodes are moved by shapes, without a mesh: cells of degree 1 in NumPy.

Interpolated instead, strain would suffer from cancellation: it is a small difference of displacements that are large.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from hhr_dolfinx.declared import Booleans, Floats, Integers
from hhr_dolfinx.shapes import Shape


class CellStrain(NamedTuple):
    """Strain of fields on cells that lie in one way; multiplies values at their nodes like a matrix.

    Attributes:
        cells: nodes of each, (c, k).
        gradients: of the shape functions in the middles, (c, dim, k).
        hoop: shape functions over the radius, (c, k); None outside axisymmetry.
        dilatation: mean of what the trace takes of each dof, (c, k, dim); None where it is that of the middle.
    """

    cells: np.ndarray
    gradients: np.ndarray
    hoop: np.ndarray | None
    dilatation: np.ndarray | None

    def __matmul__(self, field: np.ndarray) -> np.ndarray:
        """Kelvin's notation, cell by cell, (c components, ...), of values node by node, (n dim, ...)."""
        dim, columns = self.gradients.shape[1], field.shape[1:]
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
    """Cells of a body, and how shapes move their nodes; maps a point to the strain of cells that lie as they do there.

    Attributes:
        shapes: that move any of its nodes.
        moved: which of its nodes each moves, (n,) bool.
        coordinates: names of the coordinates in their formulas.
        parameters: names of the parameters.
        points: the nodes as the mesh of the scene has them, (n, dim).
        nodes: their numbers in the mesh, (n,).
        cells: places of the nodes of each cell among these, (c, k).
        values, slopes: of the shape functions in the middle of the reference cell, (k,) and (k, dim).
        weights: of the points where the dilatation is taken, (q,); none where it is that of the middle.
        gauss_values, gauss_slopes: of the shape functions there, (q, k) and (q, k, dim).
        axisymmetric: whether the first coordinate is a radius.
    """

    shapes: tuple[Shape, ...]
    moved: tuple[Annotated[Booleans, "nodes"], ...]
    coordinates: tuple[str, ...]
    parameters: tuple[str, ...]
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
        values, points = dict(zip(self.parameters, point.tolist(), strict=True)), self.points.copy()
        for shape, moved in zip(self.shapes, self.moved, strict=True):
            points[moved] = shape.moved(self.points[moved], self.coordinates, values)
        corners = points[self.cells]
        gradients, _ = _gradients(corners, self.slopes)
        hoop = self.values / (corners[:, :, 0] @ self.values)[:, None] if self.axisymmetric else None
        return CellStrain(self.cells, gradients, hoop, self._dilatation(corners) if self.weights.size else None)

    def _dilatation(self, corners: np.ndarray) -> np.ndarray:
        """Mean over the volume of each cell of what the trace of the strain takes of each dof, (c, k, dim)."""
        total, volume = np.zeros_like(corners), np.zeros(len(corners))
        for weight, values, slopes in zip(self.weights, self.gauss_values, self.gauss_slopes, strict=True):
            gradients, size = _gradients(corners, slopes)
            if self.axisymmetric:
                radius = corners[:, :, 0] @ values
                gradients[:, 0] += values / radius[:, None]
                size = size * radius
            total += (weight * size)[:, None, None] * gradients.transpose(0, 2, 1)
            volume += weight * size
        return total / volume[:, None, None]


def _gradients(corners: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the shape functions, (c, dim, k), and sizes of the map, (c,), from slopes on the reference cell."""
    count, dim = len(corners), slopes.shape[1]
    # one product for all cells and an inverse by hand: a quarter of the time of numpy's own for thousands of matrices
    jacobians = np.ascontiguousarray(corners.transpose(0, 2, 1)).reshape(-1, len(slopes)) @ slopes
    columns = np.ascontiguousarray(jacobians.reshape(count, dim, dim).transpose(2, 0, 1))
    if len(columns) == 2:
        (first, second), (third, fourth) = columns[0].T, columns[1].T
        rows = np.stack([np.column_stack([fourth, -third]), np.column_stack([-second, first])], axis=1)
    else:
        rows = np.stack([np.cross(columns[k - 2], columns[k - 1]) for k in range(3)], axis=1)
    sizes = np.einsum("ci,ci->c", columns[0], rows[:, 0])
    inverses = np.ascontiguousarray((rows / sizes[:, None, None]).transpose(0, 2, 1))
    return (inverses.reshape(-1, dim) @ slopes.T).reshape(count, dim, len(slopes)), np.abs(sizes)
