"""Names of a mesh file as decks spell them, and the places of its surfaces."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from hhr_dolfinx.geometries.cells import outer_faces, outer_faces_of_cells
from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.decks.deck import Pair, Support, Tag
from hhr_dolfinx.plugins.decks.with_outside import OUTSIDE_SURFACE
from hhr_dolfinx.plugins.scene_checks.candidates import outward

FLAT_SURFACE = 1e-6
"""Deviation of unit normals up to which a surface is flat, and of nodes, over its extent, up to
which they coincide.
"""
FAR = 100.0
"""Distance of a plane that is out of reach, over the extent of the mesh."""


@dataclass(frozen=True)
class NamedParts:
    """Bodies, surfaces and sets of nodes of a mesh by their names, in which capitals do not
    matter.
    """

    raw: RawMesh

    @cached_property
    def surfaces(self) -> dict[Tag, np.ndarray]:
        """Corners of the facets of surfaces, (f, k), by name.

        Sets of nodes that hold whole facets are surfaces too.
        """
        return self.raw.all_surfaces()

    def body(self, name: str) -> Tag | None:
        """Name of a set of cells as the mesh spells it; None without cells."""
        return _spelt(name, self.raw.bodies)

    def surface(self, name: str) -> Tag | None:
        """Name of a surface as the mesh spells it; None without facets."""
        return _spelt(name, self.surfaces)

    def place(self, name: str) -> Tag | None:
        """Name of a set of nodes, or of a surface, as the mesh spells it; None without nodes."""
        return _spelt(
            name,
            {key for key, nodes in self.raw.nodes.items() if len(nodes)} | self.surfaces.keys(),
        )

    def nodes(self, name: Tag) -> np.ndarray:
        """Nodes of a set or of a surface by its spelling in the mesh."""
        arrays = [self.raw.nodes[name]] if name in self.raw.nodes else []
        arrays += [self.surfaces[name].ravel()] if name in self.surfaces else []
        return np.unique(np.concatenate(arrays))

    def named_in(self, text: str) -> list[Tag]:
        """Surfaces and sets of nodes whose names are in a text of Python."""
        return [
            name
            for name in (*self.surfaces, *self.raw.nodes)
            if isinstance(name, str) and repr(name) in text
        ]

    def bodies_in(self, name: str, tags: Iterable[Tag]) -> list[Tag]:
        """Bodies among ``tags`` whose cells all belong to a set.

        Args:
            name: name of the set of cells.
            tags: bodies to choose from.
        """
        spelling = self.body(name)
        rows = self.raw.bodies[spelling] if spelling is not None else np.zeros(0)
        return [tag for tag in tags if np.isin(self.raw.bodies[tag], rows).all()]

    def apart(self) -> list[Tag]:
        """Bodies without common cells: sets with names come first, then small ones."""
        free = np.ones(len(self.raw.cells), dtype=bool)
        selected = []
        for tag in sorted(
            self.raw.bodies, key=lambda body: (isinstance(body, int), len(self.raw.bodies[body]))
        ):
            if free[self.raw.bodies[tag]].all() and len(self.raw.bodies[tag]):
                free[self.raw.bodies[tag]] = False
                selected.append(tag)
        return selected

    @cached_property
    def _owners(self) -> dict[tuple[int, ...], int]:
        facets, owners = outer_faces_of_cells(self.raw.kind, self.raw.cells)
        return dict(zip(map(tuple, np.sort(facets, axis=1).tolist()), owners.tolist(), strict=True))

    def owners(self, name: Tag) -> np.ndarray:
        """Cell of each outer facet of a surface, (f,); -1 for facets within a body."""
        return np.array(
            [
                self._owners.get(tuple(facet), -1)
                for facet in np.sort(self.surfaces[name], axis=1).tolist()
            ]
        )

    def normals(self, name: Tag) -> np.ndarray:
        """Outer unit normals of the facets of a surface, (f, dim)."""
        cell_centres = self.raw.points[self.raw.cells[self.owners(name)]].mean(axis=1)
        return outward(self.raw.points[self.surfaces[name]], cell_centres)

    def flat_normal(self, name: Tag) -> np.ndarray | None:
        """Outer unit normal of a flat surface, (dim,); None for a curved one."""
        normals = self.normals(name)
        mean = normals.mean(axis=0)
        return mean.round(12) + 0.0 if np.abs(normals - mean).max() < FLAT_SURFACE else None

    def pair(self, slave: Tag, master: Tag, friction: float, source: str) -> Pair:
        """Contact pair of two surfaces.

        Node to node for flat surfaces whose nodes coincide, otherwise mortar.

        Args:
            slave: name of the slave surface.
            master: name of the master surface.
            friction: coefficient of friction.
            source: file and line, for comments.
        """
        normal = self.flat_normal(slave)
        slave_points, master_points = (
            self.raw.points[self.nodes(name)] for name in (slave, master)
        )
        if normal is not None and len(slave_points) == len(master_points):
            distance, partner = cKDTree(master_points).query(slave_points)
            if (distance <= FLAT_SURFACE * np.ptp(slave_points, axis=0).max()).all() and np.unique(
                partner
            ).size == len(slave_points):
                text = f"hhr.NodeToNode({slave!r}, {master!r}, {tuple(normal.tolist())}{{}})"
                return Pair(text, friction, source)
        return Pair(f"hhr.Mortar({slave!r}, {master!r}{{}})", friction, source)

    def towards(self, name: Tag, normal: np.ndarray) -> np.ndarray:
        """A unit normal, (dim,), with the sign with which it points out of a surface.

        Args:
            name: name of the surface.
            normal: unit normal of either sign, (dim,).
        """
        towards: np.ndarray = normal * np.sign(normal @ self.normals(name).mean(axis=0)) + 0.0
        return towards

    def on_plane(
        self, name: Tag, point: np.ndarray, normal: np.ndarray, friction: float, source: str
    ) -> Pair:
        """Obstacle in front of a surface: a rigid plane.

        Args:
            name: name of the surface.
            point: a point of the plane, (dim,).
            normal: unit normal of either sign, (dim,).
            friction: coefficient of friction.
            source: file and line, for comments.
        """
        normal = self.towards(name, normal)
        text = f"hhr.Obstacle({name!r}, {tuple(normal.tolist())}, {float(point @ normal)!r}{{}})"
        return Pair(text, friction, source)

    def out_of_reach(
        self, supports: Sequence[Support], among: Container[Tag] | None = None
    ) -> tuple[Pair, ...]:
        """A rigid plane that no body reaches, for a file without a contact pair.

        A scene needs a pair. The plane faces a flat surface, or the outside of all bodies.

        Args:
            supports: supports; the plane faces a surface that they do not hold.
            among: surfaces to choose from; None for all.
        """
        held = np.zeros(self.raw.points.shape, dtype=bool)
        for support in supports:
            held[self.nodes(support.place), support.component] = True
        candidates = self.surfaces if among is None else among
        names = [
            name for name in self.surfaces if name in candidates and (self.owners(name) >= 0).all()
        ]
        flat = {name: self.flat_normal(name) for name in names}
        surfaces = [
            (name, normal, self.nodes(name)) for name, normal in flat.items() if normal is not None
        ]
        outer = np.unique(outer_faces(self.raw.kind, self.raw.cells))
        for name, normal, nodes in (
            *surfaces,
            *((OUTSIDE_SURFACE, axis, outer) for axis in np.eye(self.raw.dim)),
        ):
            if (~held[nodes] & (np.abs(normal) > FLAT_SURFACE)).any():
                offset = float(
                    (self.raw.points @ normal).max() + FAR * np.ptp(self.raw.points, axis=0).max()
                )
                text = f"hhr.Obstacle({name!r}, {tuple(normal.tolist())}, {offset!r})"
                return (Pair(text, 0.0, "no contact in the file: a plane out of reach"),)
        return ()


def _spelt(name: str, names: Iterable[Tag]) -> Tag | None:
    """A name, or its last part after the name of an instance, among names in which capitals do not
    matter.
    """
    spelling_of = {str(spelling).upper(): spelling for spelling in names}
    return spelling_of.get(name.upper(), spelling_of.get(name.upper().rpartition(".")[2]))
