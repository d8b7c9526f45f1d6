"""Displacements along other directions than the axes of the mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.amplitudes import Amplitude, check_amplitude
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.loads import Assembler
from hhr_dolfinx.parameters import Place, Tag, as_tuple, check_place, is_number
from hhr_dolfinx.plugins.constraints.elimination import ConstraintEquations
from hhr_dolfinx.plugins.constraints.equations import equations_of, nodes_at
from hhr_dolfinx.plugins.constraints.loose_equations import first_largest

ROUND = ("radial", "tangential")
ON_AXIS = 1e-9
"""Distance from the axis over the size of the mesh up to which a node lies on it."""


@dataclass(frozen=True)
class DirectedDisplacement:
    """The component of the displacement of each node along a direction, as ``*TRANSFORM`` with
    ``*BOUNDARY`` of decks.

    Attributes:
        place: surface or set of nodes.
        direction: vector of any length, (dim,); or ``radial`` or ``tangential``, about the axis.
        amplitude: displacement along it: a number, an Amplitude, or a formula of the parameters as
            text.
        axis_point: a point of the axis, (dim,); None for the origin.
        axis_direction: direction of the axis in space, (3,), of any length; in the plane it is the
            normal.
    """

    place: Tag | Place
    direction: tuple[float, ...] | str
    amplitude: Amplitude | Formula = Amplitude()
    axis_point: tuple[float, ...] | None = None
    axis_direction: tuple[float, ...] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        check_place("directed displacement", self.place)
        description = f"the directed displacement of {self.place!r}"
        vectors = ["axis_direction"] + ["direction"] * (self.direction not in ROUND)
        for name in (*vectors, *(["axis_point"] if self.axis_point is not None else [])):
            vector = as_tuple(f"{name} of {description}", getattr(self, name))
            if not all(map(is_number, vector)) or (name in vectors and not any(vector)):
                raise SceneError(
                    f"{name} = {vector} of {description} must be finite numbers, and not all zero"
                )
            object.__setattr__(self, name, tuple(map(float, vector)))
        check_amplitude(self, description, formulas=True)

    def equations(self, assembler: Assembler) -> ConstraintEquations:
        """See :class:`~hhr_dolfinx.plugins.constraints.elimination.Constraint`.

        Raises:
            SceneError: for a vector of another dimension, and for nodes on the axis of a round
                direction.
        """
        (dim,) = assembler.test.ufl_shape
        nodes, points = nodes_at(assembler, self.place, self)
        ways = self._directions(points, dim, float(np.ptp(assembler.points(), axis=0).max()))
        dofs = dim * nodes[:, None] + np.arange(dim)
        rows = np.repeat(np.arange(nodes.size), dim)
        dependent = dofs[np.arange(nodes.size), first_largest(np.abs(ways))]
        entries = [(ways.ravel(), rows, dofs.ravel())]
        return equations_of(entries, dependent, assembler.size, np.ones(nodes.size), loose=True)

    def _directions(self, points: np.ndarray, dim: int, size: float) -> np.ndarray:
        """Unit vectors at points, (n, dim) each."""
        if not isinstance(self.direction, str):
            if len(self.direction) != dim:
                raise SceneError(
                    f"the direction of {self!r} must have {dim} components, as the mesh"
                )
            return np.tile(
                np.array(self.direction) / np.linalg.norm(self.direction), (len(points), 1)
            )
        start = (0.0,) * dim if self.axis_point is None else self.axis_point
        if len(start) != dim or len(self.axis_direction) != 3:
            raise SceneError(
                f"the axis of {self!r} needs a point of {dim} coordinates and a direction of 3"
            )
        axis = np.array(self.axis_direction if dim == 3 else (0.0, 0.0, 1.0))
        axis = axis / np.linalg.norm(axis)
        away = np.zeros((len(points), 3))
        away[:, :dim] = points - np.array(start)
        away -= (away @ axis)[:, None] * axis
        lengths = np.linalg.norm(away, axis=1)
        if lengths.min() <= ON_AXIS * size:
            on_axis = points[lengths.argmin()].tolist()
            raise SceneError(
                f"{self!r}: the node at {on_axis} is on the axis: leave it out, or hold it by a "
                "Displacement"
            )
        radial = away / lengths[:, None]
        return (radial if self.direction == "radial" else np.cross(axis, radial))[:, :dim]
