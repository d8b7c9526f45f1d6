"""Meshes of files that are cut along sections through a body, such as those of preloaded bolts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.cells import EDGES, FACES
from hhr_dolfinx.geometries.mesh_file import MeshFile
from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.parameters import as_tuple

OTHER_SIDE = "_other"
"""End of the name of the second side of a section."""
FLAT_SECTION = 1e-6
"""Distance of a node from the plane of its section over the size of the section above which it is
not flat.
"""


@dataclass(frozen=True)
class CutMesh(MeshFile):
    """A mesh file with bodies cut along flat sections: the sides are the surfaces ``name`` and
    ``name_other``.

    Attributes:
        sections: names of surfaces or sets of nodes inside bodies, each across the whole of its
            body.
    """

    sections: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "sections", as_tuple("the sections of a CutMesh", self.sections))

    def read(self) -> RawMesh:
        """See :class:`MeshFile`; FileContentError for a section that is missing, not flat, or
        outside of bodies.
        """
        raw = super().read()
        for name in self.sections:
            raw = cut(raw, name)
        return raw


def cut(raw: RawMesh, name: str) -> RawMesh:
    """The mesh in which cells on the upper side of a section have separate nodes.

    Args:
        raw: the mesh.
        name: surface or set of nodes on the section.

    Raises:
        FileContentError: for a missing section, one that is not flat, or one with cells on one side
            alone.
    """
    nodes = (
        np.unique(raw.surfaces[name])
        if name in raw.surfaces
        else raw.nodes.get(name, np.zeros(0, dtype=int))
    )
    if nodes.size < raw.dim:
        raise FileContentError(
            f"there is no section {name!r} in the file: name a surface, or a set of nodes"
        )
    on_section = np.isin(raw.cells, nodes)
    upper = on_section.any(axis=1) & (
        _heights(raw, name, nodes, raw.points[raw.cells].mean(axis=1)) > 0
    )
    lower = on_section.any(axis=1) & ~upper
    doubled = (
        nodes if raw.sides is None else np.union1d(nodes, _between(raw, raw.sides, on_section))
    )
    numbers = np.arange(len(raw.points))
    numbers[doubled] = len(raw.points) + np.arange(doubled.size)
    cells = np.where(upper[:, None], numbers[raw.cells], raw.cells)
    sides = None if raw.sides is None else np.where(upper[:, None], numbers[raw.sides], raw.sides)
    pair = []
    for mask in (lower, upper):
        faces = [
            cells[np.ix_(mask & on_section[:, face].all(axis=1), face)]
            for face in map(list, FACES[raw.kind])
        ]
        pair.append(np.concatenate(faces))
    if not all(map(len, pair)):
        raise FileContentError(
            f"the section {name!r} has cells on one side alone: it must lie inside a body"
        )
    surfaces = {
        key: _turned(raw, value, upper, numbers)
        for key, value in raw.surfaces.items()
        if key != name
    }
    return replace(
        raw,
        points=np.vstack([raw.points, raw.points[doubled]]),
        cells=cells,
        sides=sides,
        surfaces={**surfaces, name: pair[0], f"{name}{OTHER_SIDE}": pair[1]},
        nodes={key: value for key, value in raw.nodes.items() if key != name},
    )


def _heights(raw: RawMesh, name: str, nodes: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Distances of places, (n, dim), above the plane of a section, along the axis that it faces
    most.
    """
    section_points = raw.points[nodes]
    middle = section_points.mean(axis=0)
    normal = np.linalg.svd(section_points - middle)[2][-1]
    normal = normal * np.sign(normal[np.abs(normal).argmax()])
    if (
        np.abs((section_points - middle) @ normal).max()
        > FLAT_SECTION * np.ptp(section_points, axis=0).max()
    ):
        raise FileContentError(f"the section {name!r} is not flat: cut along a plane")
    return (places - middle) @ normal


def _between(raw: RawMesh, sides: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Nodes in the middle of edges with both ends on the section."""
    return np.unique(sides[inside[:, np.array(EDGES[raw.kind])].all(axis=2)])


def _turned(raw: RawMesh, facets: np.ndarray, upper: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Facets of another surface, with the new nodes where they are sides of upper cells."""
    upper_facets = np.concatenate(
        [raw.cells[np.ix_(upper, face)] for face in map(list, FACES[raw.kind])]
    )
    upper_sides = {tuple(sorted(row)) for row in upper_facets.tolist()}
    on_upper_side = np.array(
        [tuple(sorted(row)) in upper_sides for row in facets.tolist()], dtype=bool
    )
    return np.where(on_upper_side[:, None], numbers[facets], facets) if len(facets) else facets
