"""A field with values at points, as the ``field`` of a load on a body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import cKDTree

from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import SceneError

if TYPE_CHECKING:
    from ufl.core.expr import Expr

ONE_OF_POINTS = 1e-6
"""Distance over the size of the points up to which a node is one of them."""
BEYOND_MESH = 0.05
"""Part of its size by which points may lie outside the box around a mesh."""
ON_A_LINE = 1e-9
"""Part of the size of points up to which they lie on a line, or in a plane, where nothing is
between them.
"""
FEWEST_NODES = 2
"""Nodes of the mesh, at least, that are among the points or between them."""


@dataclass(frozen=True, eq=False)
class NodalField(KnownArguments):
    """A field by its values at points, such as a temperature at the nodes of another program.

    It is the ``field`` of a :class:`~hhr_dolfinx.plugins.volume_loads.loads.ThermalExpansion` or an
    ``Eigenstrain``. A node of the mesh that is one of the points has its value. Others have the
    linear interpolation between points, and beyond them the value of the nearest. In cells it is
    interpolated by their functions.

    Attributes:
        points: coordinates, (n, dim), in the unit of the mesh.
        values: values, (n,).

    Raises:
        SceneError: for values that are not finite, or other shapes.

    Example:
        >>> at = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
        >>> field = hhr.NodalField(at, 20.0 + 100.0 * at[:, 0])
        >>> float(field.at(np.array([[0.25, 0.5]]))[0])
        45.0
    """

    points: np.ndarray
    values: np.ndarray

    def __post_init__(self) -> None:
        points = _numbers("points", self.points)
        values = _numbers("values", self.values)
        if points.ndim != 2 or points.shape[1] not in (2, 3) or values.shape != points.shape[:1]:
            raise SceneError(
                f"a nodal field needs points, (n, 2 or 3), and values, (n,), not {points.shape} "
                f"and {values.shape}"
            )
        if not (np.isfinite(points).all() and np.isfinite(values).all()):
            raise SceneError("points and values of a nodal field must be finite numbers")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "values", values)

    def __repr__(self) -> str:
        low, high = self.values.min(initial=np.inf), self.values.max(initial=-np.inf)
        return f"<nodal field of {len(self.values)} points, {low:.6g} to {high:.6g}>"

    def at(self, places: np.ndarray) -> np.ndarray:
        """Values at places, (m,).

        Args:
            places: coordinates, (m, dim).
        """
        size = np.ptp(self.points, axis=0).max() or 1.0
        distance, nearest = cKDTree(self.points).query(places)
        values: np.ndarray = self.values[nearest]
        others = distance > ONE_OF_POINTS * size
        spread = np.linalg.svd(self.points - self.points.mean(axis=0), compute_uv=False)
        if (
            others.any()
            and spread.size == self.points.shape[1]
            and spread[-1] > ON_A_LINE * spread[0]
        ):
            between = LinearNDInterpolator(self.points, self.values)(places[others])
            beyond = np.isnan(between)
            outer = NearestNDInterpolator(self.points, self.values)(places[others])
            values[others] = np.where(beyond, outer, between)
        return values

    def __call__(self, x: Expr) -> Any:
        """Field at the UFL coordinates ``x``, a function of the mesh.

        Args:
            x: coordinates of the mesh.

        Raises:
            SceneError: for points of another place or unit than the mesh.
        """
        from dolfinx import fem
        from dolfinx.mesh import Mesh
        from ufl.domain import extract_unique_domain

        domain = extract_unique_domain(x)
        mesh = Mesh(domain.ufl_cargo(), domain)
        dim = mesh.geometry.dim
        degree = domain.ufl_coordinate_element().degree
        space = fem.functionspace(mesh, ("Lagrange", degree))
        places = space.tabulate_dof_coordinates()[:, :dim]
        self._check(places, mesh.comm)
        field = fem.Function(space)
        field.x.array[:] = self.at(places)
        return field

    def _check(self, places: np.ndarray, comm: Any) -> None:
        """Refuse points that are not those of the mesh, whose nodes on this rank are (m, dim)."""
        if places.shape[1] != self.points.shape[1]:
            raise SceneError(
                f"points of a nodal field have {self.points.shape[1]} coordinates, and the mesh "
                f"{places.shape[1]}"
            )
        ends = comm.allgather(
            (places.min(axis=0, initial=np.inf), -places.max(axis=0, initial=-np.inf))
        )
        lower, upper = np.min(ends, axis=0) * [[1.0], [-1.0]]
        margin = BEYOND_MESH * (upper - lower).max()
        beyond = ((self.points < lower - margin) | (self.points > upper + margin)).any(axis=1)
        low = self.points.min(axis=0)
        high = self.points.max(axis=0)
        slack = ONE_OF_POINTS * (high - low).max()
        inside = ((places >= low - slack) & (places <= high + slack)).all(axis=1)
        if beyond.any() or comm.allreduce(int(inside.sum())) < FEWEST_NODES:
            raise SceneError(
                f"points of a nodal field lie between {low.tolist()} and {high.tolist()}, and the "
                f"mesh between {lower.tolist()} and {upper.tolist()}: give them in the unit of the "
                "mesh, and those of its bodies alone"
            )


def _numbers(name: str, given: Any) -> np.ndarray:
    """An array of numbers."""
    try:
        return np.array(given, dtype=float)
    except (TypeError, ValueError):
        raise SceneError(f"{name} of a nodal field must be numbers, not {given!r:.80}") from None
