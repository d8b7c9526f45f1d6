"""Outputs of a full model whose shape depends on parameters: prepared on the mesh of each shape."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem

from hhr_dolfinx import compat
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.formulas import coordinate_names
from hhr_dolfinx.full_order.outputs import prepared_outputs, probe_of
from hhr_dolfinx.models.functionals.functional import Functional, Functionals
from hhr_dolfinx.outputs import ModelProbe, Output
from hhr_dolfinx.plugins.shapes.cells import MovingCells
from hhr_dolfinx.plugins.shapes.functionals import MovingMises, OverShapes

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
    from hhr_dolfinx.plugins.shapes.reshaped import Reshaped

SHAPES = 8
"""Number of shapes whose outputs a full model keeps."""


class FullShapeFunctionals(OverShapes):
    """Outputs of a full model with variable shape, prepared on the mesh at a point.

    See :class:`~hhr_dolfinx.models.functionals.functional.ShapeFunctionals`.

    Args:
        discretisation: mesh and forms.
        reshaped: deforms the mesh.
        problem: that of the middle of the box.

    Raises:
        SceneError: for an output that the model does not support.
    """

    def __init__(self, discretisation: DiscreteSpace, reshaped: Reshaped, problem: ContactProblem):
        self.axes = np.array(reshaped.axes, dtype=np.int64)
        self.parameters = problem.parameters
        self.amplitudes = problem.amplitudes
        self._discretisation = discretisation
        self._reshaped = reshaped
        self._base = problem
        self._prepared = lru_cache(maxsize=SHAPES)(self._made)
        self.items = self.at(problem.middle).items

    def at(self, point: np.ndarray) -> Functionals:
        """Outputs for the shape at a point, (P,)."""
        return self._prepared(np.ascontiguousarray(point[self.axes], dtype=float).tobytes())

    def _made(self, key: bytes) -> Functionals:
        """Outputs for values of the parameters of the shape; the other parameters do not change their arrays."""
        point = self._base.middle
        point[self.axes] = np.frombuffer(key)
        there = self._reshaped(point)
        with self._reshaped.at(point):
            return prepared_outputs([self._probe(output, there) for output in self._discretisation.scene.outputs])

    def _probe(self, output: Output, problem: ContactProblem) -> MovingProbe:
        probe = probe_of(output, self._discretisation, problem, None, self._base)
        given: dict[str, Any] = {item.name: getattr(probe, item.name) for item in fields(probe)}
        return MovingProbe(**given, reshaped=self._reshaped)


@dataclass(frozen=True)
class MovingProbe(ModelProbe):
    """Interface for an output where shapes are parameters: other terms of θ may act on another shape, and cells move.

    Attributes:
        reshaped: deforms the mesh.
    """

    reshaped: Reshaped

    def on_cells(self, found: Functional, cells: np.ndarray) -> MovingMises:
        """Von Mises' stress of cells that move."""
        discretisation = self.discretisation
        mean = bool(np.array(discretisation.mean_dilatation)[discretisation.cell_bodies()[cells[0]]])
        moving = moving_cells(discretisation, self.reshaped, cells, mean_dilatation=mean)
        return MovingMises(**{item.name: getattr(found, item.name) for item in fields(found)}, cells=moving)

    def terms(self, entries: np.ndarray) -> np.ndarray:
        """All terms of θ."""
        return np.arange(entries.size)


def moving_cells(
    discretisation: DiscreteSpace, reshaped: Reshaped, cells: np.ndarray, *, mean_dilatation: bool
) -> MovingCells:
    """Cells of a mesh with variable shape, as arrays; serial."""
    mesh = discretisation.mesh
    scene = discretisation.scene
    kind = mesh.topology.cell_name()
    space = discretisation.space
    middle = compat.interpolation_points(fem.functionspace(mesh, ("Discontinuous Lagrange", 0)).element)
    points, weights = compat.quadrature(kind, discretisation.gauss_degree)
    # displacement and geometry have the same shape functions, with the same middles
    values, slopes = compat.shape_functions(kind, np.vstack([middle, points]), discretisation.order)
    nodes, cells_here = np.unique(space.dofmap.list[cells], return_inverse=True)
    cells_here = cells_here.reshape(len(cells), -1).astype(np.int64)
    geometry = compat.geometry_dofmap(mesh)[cells]
    of_geometry = np.full(nodes.size, -1)
    of_geometry[cells_here[:, : geometry.shape[1]]] = geometry
    moves = [np.isin(of_geometry, own) for own in reshaped.nodes]
    given = [(shape, mask) for shape, mask in zip(scene.shapes, moves, strict=True) if mask.any()]
    selected = slice(1, None) if mean_dilatation else slice(1, 1)
    return MovingCells(
        shapes=tuple(shape for shape, _ in given),
        moved=tuple(mask for _, mask in given),
        coordinates=coordinate_names(scene.hypothesis),
        parameters=scene.parameters.names,
        middles=reshaped.middles().among(nodes),
        points=reshaped.reference[of_geometry, : mesh.geometry.dim].copy(),
        nodes=nodes.astype(np.int64),
        cells=cells_here,
        values=values[0],
        slopes=slopes[0],
        weights=weights if mean_dilatation else np.zeros(0),
        gauss_values=values[selected],
        gauss_slopes=slopes[selected],
        axisymmetric=scene.hypothesis == "axisymmetric",
    )
