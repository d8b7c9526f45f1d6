"""Mesh files whose folded cells of second order are straightened, or untangled by gmsh.

Generators curve the sides of cells that lie on a curved surface and leave the others straight. If a
cell is thinner than the arc is high, these sides cross.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from hhr_dolfinx.compat import nodes_of_cell, shape_functions
from hhr_dolfinx.errors import FileContentError, MeshWarning, SceneError, SceneWarning, rounded
from hhr_dolfinx.full_order.checks import FOLDED, corner_jacobians
from hhr_dolfinx.full_order.free_bodies import components_of_nodes
from hhr_dolfinx.geometries.cells import EDGES
from hhr_dolfinx.geometries.mesh_file import MeshFile
from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.second_order.by_gmsh import borders, optimised
from hhr_dolfinx.warn import warn

HOWS = ("straight", "gmsh")
BAD = 0.1
"""Smallest Jacobian of a curved cell over that of the cell with straight sides below which it is
mended.
"""
MOVE_PARTS = 10
"""Number of equal parts of the way to the middle of a side by which its node moves."""
LATTICE = 4
"""Degree of the cell at whose nodes Jacobians are evaluated.

They include those of degree 2, which a scene checks.
"""
CELLS_AT_ONCE = 8192
"""Number of cells whose Jacobians are evaluated at once, for memory."""
MIDDLE_NODES = 1e-9
"""Distance over the extent of the mesh below which nodes coincide, and nodes of sides lie in the
middle.
"""


@dataclass(frozen=True)
class Untangled(MeshFile):
    """A mesh file of second order whose folded or nearly folded cells are mended, which a
    MeshWarning reports.

    With ``how="straight"`` nodes on sides of such cells move towards the middles of these sides, by
    tenths of the way, until no cell is folded; corners stay. A curved surface loses a part of its
    curvature there, and nowhere else. Nodes at the same place move as one, so that surfaces with
    matching nodes still match.

    With ``how="gmsh"`` the optimiser of gmsh moves nodes inside of bodies, corners too, and in flat
    sides; those on curved surfaces and between bodies stay. The sides of cells that it leaves
    folded are straightened.

    Attributes:
        mesh: path of the file, or a mesh file such as ``CutMesh("part.msh", sections=("cut",))``.
        how: ``straight`` or ``gmsh``.
    """

    path: Path | str = field(init=False, repr=False)
    scale: float = field(init=False, repr=False)
    mesh: MeshFile | Path | str
    how: str = "straight"

    def __post_init__(self) -> None:
        of = self.mesh if isinstance(self.mesh, MeshFile) else MeshFile(self.mesh)
        for name, value in (("mesh", of), ("path", of.path), ("scale", of.scale)):
            object.__setattr__(self, name, value)
        if self.how not in HOWS:
            raise SceneError(
                f"how={self.how!r} of Untangled({of.path}) must be {' or '.join(map(repr, HOWS))}"
            )

    def read(self) -> RawMesh:
        """See :class:`MeshFile`.

        Raises:
            FileContentError: for cells that are folded by their corners alone.
        """
        raw = self.mesh.read() if isinstance(self.mesh, MeshFile) else super().read()
        if raw.sides is None:
            warn(
                (
                    f"Untangled has no effect on {self.path}, whose cells are of first order: take "
                    "MeshFile"
                ),
                SceneWarning,
            )
            return raw
        if raw.points.shape[1] != raw.dim:  # a surface in space, which a scene refuses
            return raw
        result = mended(raw, f"{self.path}", self.how)
        if result.bad.size:
            self._report(raw, result)
        return result.raw

    def _report(self, raw: RawMesh, result: Mended) -> None:
        moves = np.linalg.norm(result.raw.points - raw.points, axis=1) * self.scale
        outer = moves[
            borders(raw.kind, raw.cells, np.asarray(raw.sides), np.zeros(len(raw.cells)))[0]
        ].max()
        centre = raw.points[raw.cells[result.bad[0]]].mean(axis=0) * self.scale
        straightened = result.straightened.size
        count = np.count_nonzero(moves > MIDDLE_NODES * moves.max())
        remedy = (
            f"; sides of {straightened} that gmsh left folded are straightened"
            if self.how == "gmsh" and straightened
            else ""
        )
        warn(
            f"{len(result.bad)} of {len(raw.cells)} cells of {self.path} were folded or nearly so, "
            f"e.g. around {rounded(centre)}, and are mended ({self.how}{remedy}): {count} nodes "
            f"move, by {moves.max():.3g} at most, on the outside of bodies by {outer:.3g}. "
            "Cells that are thicker or shorter along curved surfaces need no mending",
            MeshWarning,
        )


class Mended(NamedTuple):
    """A mesh without folded cells, the rows of cells that were folded or nearly so, and of those
    straightened.
    """

    raw: RawMesh
    bad: np.ndarray
    straightened: np.ndarray


def mended(raw: RawMesh, name: str, how: str = "straight") -> Mended:
    """The mesh of a file without folded cells.

    Args:
        raw: the mesh.
        name: name of the file, for messages.
        how: ``straight`` or ``gmsh``, see :class:`Untangled`.

    Raises:
        FileContentError: for cells that are folded by their corners alone.
        MissingPackageError: without gmsh, if it is needed.
    """
    sides = _Sides.of(raw)
    _refuse_corners(raw, name, sides)
    bad = sides.bad(sides.curved, raw.points)
    start = raw
    if how == "gmsh" and bad.size:
        start = _by_gmsh(raw, bad)
        sides = _Sides.of(start)
    remaining = sides.bad(sides.curved, start.points)
    return Mended(replace(raw, points=_straightened(start, sides, remaining)), bad, remaining)


def _by_gmsh(raw: RawMesh, rows: np.ndarray) -> RawMesh:
    """The mesh after gmsh mended as many of its bad cells as it can, by their rows."""
    same = _coinciding(raw.points, np.arange(len(raw.points)))

    def count(points: np.ndarray) -> int:
        try:
            sides = _Sides.of(replace(raw, points=points))
            _refuse_corners(sides.raw, "gmsh", sides)
        except FileContentError:  # nodes far from their sides, or folded corners
            return len(raw.cells) + 1
        return len(sides.bad(sides.curved, points))

    return replace(raw, points=optimised(raw, rows, (np.bincount(same) > 1)[same], count))


def folded(raw: RawMesh) -> np.ndarray:
    """Rows of the cells of second order that a scene refuses as folded; none at first order."""
    if raw.sides is None or raw.points.shape[1] != raw.dim:
        return np.zeros(0, dtype=np.int64)
    sides = _Sides.of(raw, 2)
    # the sign of the mean is that of the order of the nodes, which differs between formats
    bad = [
        rows[
            (values * np.sign(values.mean(axis=1))[:, None]).min(axis=1)
            < -FOLDED * np.abs(values).max(axis=1)
        ]
        for rows, values in sides.jacobians(sides.curved, raw.points)
    ]
    return np.concatenate([sides.curved[:0], *bad])


def folded_in_words(raw: RawMesh, name: str) -> str:
    """Number and position of folded cells of a mesh file, and the geometry of a scene.

    Empty if none is folded.

    Args:
        raw: the mesh.
        name: path of the file.
    """
    rows = folded(raw)
    if not rows.size:
        return ""
    centre = rounded(raw.points[raw.cells[rows[0]]].mean(axis=0))
    return (
        f"{rows.size} cells of second order are folded, e.g. around {centre}, and a scene refuses "
        f"them: take hhr.Untangled({name!r}) as its geometry, which straightens them"
    )


def mending(geometry: object) -> str:
    """Advice for a scene with folded cells of second order, by its geometry."""
    if isinstance(geometry, Untangled):
        return "mend the mesh there"
    wrapped = "Untangled of a mesh file"
    if isinstance(geometry, MeshFile):
        named = str(geometry.path) if geometry == MeshFile(geometry.path) else geometry
        wrapped = f"Untangled({named!r})"
    return f"mend the mesh there, or take geometry=hhr.{wrapped}, which straightens them"


@dataclass(frozen=True, eq=False)
class _Sides:
    """Nodes on the sides of cells, and the middles of these sides.

    Attributes:
        raw: the mesh.
        nodes: nodes on the sides of its cells, (c, edges).
        middles: coordinates of all nodes, with those on sides in the middle of these, (nodes, dim).
        curved: rows of the cells with a side that is not straight.
        slopes: slopes of the shape functions where Jacobians are evaluated, (q, k, dim).
    """

    raw: RawMesh
    nodes: np.ndarray
    middles: np.ndarray
    curved: np.ndarray
    slopes: np.ndarray

    @classmethod
    def of(cls, raw: RawMesh, lattice: int = LATTICE) -> _Sides:
        """Sides of a mesh of second order, with Jacobians at the nodes of cells of a degree.

        Args:
            raw: the mesh, of second order.
            lattice: degree of the cell at whose nodes Jacobians are evaluated.
        """
        raw.whole()  # refuses nodes that lie far from their sides
        ends = raw.points[raw.cells[:, np.array(EDGES[raw.kind])]]
        nodes = np.asarray(raw.sides)
        middles = raw.points.copy()
        middles[nodes] = ends.mean(axis=2)
        off = np.linalg.norm(middles - raw.points, axis=1)[nodes]
        lengths = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
        curved = np.flatnonzero((off > MIDDLE_NODES * lengths).any(axis=1))
        return cls(
            raw,
            nodes,
            middles,
            curved,
            shape_functions(raw.kind, nodes_of_cell(raw.kind, lattice), 2)[1],
        )

    def jacobians(
        self, rows: np.ndarray, points: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Rows of some cells, (r,), and their Jacobians, (r, q), block by block.

        Args:
            rows: rows of the cells.
            points: coordinates of all nodes, (nodes, dim).
        """
        for start in range(0, len(rows), CELLS_AT_ONCE):
            selected = rows[start : start + CELLS_AT_ONCE]
            block = RawMesh(
                points, self.raw.kind, self.raw.cells[selected], {}, sides=self.nodes[selected]
            )
            coordinates, cell_nodes = block.whole()
            yield (
                selected,
                np.linalg.det(np.einsum("qkd,ckx->cqdx", self.slopes, coordinates[cell_nodes])),
            )

    def bad(self, rows: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Rows of the cells among some that are folded or nearly so.

        Args:
            rows: rows of the cells.
            points: coordinates of all nodes, (nodes, dim).
        """
        # relative to the cell with straight sides, whose Jacobians have one sign, that of the order
        # of its nodes
        bad_rows = [
            cells[
                (values * np.sign(straight[:, :1])).min(axis=1) < BAD * np.abs(straight).min(axis=1)
            ]
            for (cells, values), (_, straight) in zip(
                self.jacobians(rows, points), self.jacobians(rows, self.middles), strict=True
            )
        ]
        return np.concatenate([rows[:0], *bad_rows])


def _refuse_corners(raw: RawMesh, name: str, sides: _Sides) -> None:
    """Raise FileContentError for cells that are folded with straight sides too.

    Scenes refuse inverted simplices.
    """
    values = corner_jacobians(raw.points[raw.ordered()])
    wrong = values.min(axis=1) * values.max(axis=1) <= 0
    for rows, inner in sides.jacobians(sides.curved, sides.middles):
        wrong[rows] |= inner.min(axis=1) * inner.max(axis=1) <= 0
    if wrong.any():
        centre = rounded(raw.points[raw.cells[wrong][0]].mean(axis=0))
        raise FileContentError(
            f"{int(wrong.sum())} cells of {name} are folded by their corners alone, e.g. around "
            f"{centre}: straight sides do not mend them. Move their corners, or mesh again"
        )


def _straightened(raw: RawMesh, sides: _Sides, bad: np.ndarray) -> np.ndarray:
    """Coordinates with which no cell is bad: nodes of bad cells move by parts of the way to the
    middles of their sides.

    A node that moves may fold its other cells, whose nodes move then. The loop ends, as each round
    moves a node of each bad cell, and with all of its nodes in the middles no cell is bad.
    """
    points = raw.points
    same = _coinciding(points, np.unique(sides.nodes))
    steps = np.zeros(len(points), dtype=np.int64)  # of the way that each node has gone
    while bad.size:
        moving = np.isin(same, same[sides.nodes[bad]])
        steps[moving] = np.minimum(steps[moving] + 1, MOVE_PARTS)
        points = raw.points + (steps / MOVE_PARTS)[:, None] * (sides.middles - raw.points)
        touched = sides.curved[moving[sides.nodes[sides.curved]].any(axis=1)]
        bad = sides.bad(touched, points)
    return points


def _coinciding(points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """A label for each node, common to those among ``nodes`` that have the same place, (nodes,)."""
    pairs = cKDTree(points[nodes]).query_pairs(
        MIDDLE_NODES * np.ptp(points, axis=0).max(), output_type="ndarray"
    )
    return components_of_nodes(len(points), nodes[pairs])
