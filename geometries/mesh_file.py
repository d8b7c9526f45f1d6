"""Meshes from files: gmsh's ``.msh``, Abaqus' ``.inp``, Exodus, MED, XDMF, formats of plug-ins, and
those of meshio.

Bodies and surfaces have their names in the file: physical groups of gmsh, sets and surfaces of
Abaqus, blocks and side sets of Exodus, groups of MED. A set of nodes stands for the outer facets
whose nodes are all in the set.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.compat import NamedMesh, linear_mesh, tags_of
from hhr_dolfinx.errors import FileContentError, HHRError, SceneError
from hhr_dolfinx.geometries.by_meshio import read_by_meshio
from hhr_dolfinx.geometries.cells import (
    CORNERS,
    DIMENSION,
    FACES,
    OF_CORNERS,
    of_other_kinds,
    one_kind,
    sides_of,
)
from hhr_dolfinx.geometries.conforming import conforming
from hhr_dolfinx.geometries.partition import shares
from hhr_dolfinx.geometries.raw_mesh import ItemNumbers, RawMesh, facets_by_number
from hhr_dolfinx.geometries.summary import Summary, summary_of
from hhr_dolfinx.registry import load, named, remedy

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.geometries.gmsh_model import Entity

FAR = 1e100
"""Coordinates from which on squares of lengths overflow: such places, and those that are no number,
are mistakes.
"""
NodesOf = Callable[[Path, np.ndarray, np.ndarray], dict[str, np.ndarray]]
"""Rows of sets of nodes by name, of a path, points and their numbers in gmsh."""
TagsOfNames = list[tuple[str | int, tuple[int, tuple[int, ...]]]]
"""Names with their dimension and their tags."""
BY_GMSH = (".med", ".mmed", ".rmed", ".cgns")
"""Endings of files that gmsh reads: meshio reads MED by h5py, which is incompatible with the HDF5
of DOLFINx.
"""

MESH_ENDINGS = (".msh", ".inp", ".e", ".xdmf", ".vtk", ".vtu", ".med", ".cgns")
"""Endings of the usual formats, for messages."""


@dataclass(frozen=True)
class MeshFile:
    """A geometry: the mesh of a file, with its bodies and surfaces by name.

    Attributes:
        path: path of the file.
        scale: factor of the coordinates, for example 1e-3 for a file in mm and a scene in m.

    Example:
        >>> import meshio
        >>> corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        >>> meshio.write_points_cells("part.msh", corners, {"triangle": np.array([[0, 1, 2]])})
        >>> mesh = hhr.MeshFile("part.msh", scale=1e-3).read()
        >>> mesh.kind, len(mesh.points), list(mesh.bodies)
        ('triangle', 3, [1])
    """

    path: Path | str
    scale: float = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.path, Path | str):
            raise SceneError(f"the path {self.path!r} of a mesh file must be a text or a Path")
        if not isinstance(self.scale, int | float) or not 0 < self.scale < np.inf:
            raise SceneError(
                f"the scale {self.scale!r} of mesh file {self.path} must be a positive number"
            )

    def __call__(self, comm: Comm) -> NamedMesh:
        """Read the file on the first rank and distribute the mesh.

        Raises:
            FileContentError: for a file that cannot be read, or has no mesh of one kind of cells.
        """
        raw = None
        error = None
        if comm.rank == 0:
            try:
                raw = self.read()
            except HHRError as found:
                error = found
        error = comm.bcast(error)
        if error is not None:
            raise error
        summary = None if raw is None else summary_of(raw, Path(self.path), self.scale)
        return _shared(raw, comm, self.scale, comm.bcast(summary))

    def read(self) -> RawMesh:
        """Contents of the file, before the mesh is distributed.

        Raises:
            FileContentError: for a file that is missing or damaged, or has no mesh of one kind of
                cells.
        """
        path = Path(self.path)
        if path.is_dir():
            raise FileContentError(
                f"{path} is a folder, and a mesh is a file. Of a mesh of Elmer's `ElmerGrid 2 4 "
                f"{path}` makes a .msh"
            )
        if not path.is_file():
            raise FileContentError(f"there is no mesh file {path}: {_found_instead(path)}")
        try:
            raw = conforming(reader_of(path)(path).once()).compact()
            far = np.flatnonzero(~(np.abs(raw.points) < FAR).all(axis=1))
            if far.size:
                raise FileContentError(
                    f"mesh file {path} has a node at {raw.points[far[0]].tolist()}: correct it"
                )
            return raw
        except HHRError:
            raise
        except Exception as error:
            # readers raise many kinds of errors for damaged files, and gmsh Exception without a
            # text
            kind = "" if type(error) is Exception else f"{type(error).__name__}: "
            reason = f"{kind}{error}".rstrip(": .") or "it is damaged"
            raise FileContentError(
                f"mesh file {path} cannot be read: {reason}. {_advice(path)}"
            ) from error


def _found_instead(path: Path) -> str:
    """Message for a missing file, with the files of the same name or ending in its folder."""
    if not path.parent.is_dir():
        return (
            f"there is no folder {path.parent.absolute()}. Give the path from where the command "
            "is run"
        )
    beside = [
        file.name
        for file in path.parent.iterdir()
        if path.stem == file.stem or path.suffix == file.suffix
    ]
    if beside:
        return f"{path.parent.absolute()} has {', '.join(sorted(beside)[:5])}"
    return f"{path.absolute()} is looked for. Give the path from where the command is run"


def _advice(path: Path) -> str:
    """Advice for a file that no reader can read."""
    if path.suffix.lower() in (".step", ".stp", ".iges", ".igs", ".brep", ".geo", ".stl"):
        return (
            f"{path.suffix} is geometry and no mesh: mesh its volumes in gmsh, and save them as "
            ".msh"
        )
    if path.suffix.lower() in (".pvd", ".pvtu"):
        return "It names other files: give one of the .vtu files in it"
    return (
        "Write it again, or in another format: "
        f"{', '.join(dict.fromkeys((*MESH_ENDINGS, *named('readers'))))}"
    )


def reader_of(path: Path) -> Callable[[Path], RawMesh]:
    """Reader of a file by its ending.

    Decks of Abaqus are also found by their first word, as cgx names them .msh.

    Raises:
        FileContentError: for an ending that only a plug-in which is not installed reads.
    """
    ending = path.suffix.lower()
    if (import_path := named("readers").get(ending)) is not None:
        return load(import_path)
    if advice := remedy("readers", ending):
        raise FileContentError(f"no installed plug-in reads files {ending}, such as {path}{advice}")
    if ending == ".inp" or begins_as_deck(path):
        from hhr_dolfinx.geometries.abaqus_deck import read_deck

        return read_deck
    if ending in (".e", ".ex2", ".exo", ".exii", ".g", ".gen"):
        from hhr_dolfinx.geometries.exodus import read_exodus

        return read_exodus
    if ending == ".xdmf":
        from hhr_dolfinx.geometries.xdmf import read_xdmf

        return read_xdmf
    return read_by_gmsh if ending in BY_GMSH or _version(path) >= 4 else read_by_meshio


def begins_as_deck(path: Path) -> bool:
    """True if a file begins as an Abaqus deck: by ``*NODE``, ``*HEADING`` or a comment."""
    with path.open("rb") as file:
        start = file.read(4096).lstrip().upper()
    return start.startswith((b"**", b"*NODE", b"*HEADING", b"*INCLUDE", b"*PART"))


def _version(path: Path) -> float:
    """Version of gmsh's format; 0 for a file of another format.

    From version 4 on groups consist of entities, which may be in several groups; meshio keeps the
    first one. In earlier versions they consist of elements, which are in the file once for each
    group; gmsh would add whole entities.
    """
    if path.suffix.lower() != ".msh":
        return 0.0
    with path.open("rb") as file, suppress(ValueError, IndexError):
        for line in file:
            if line.strip() == b"$MeshFormat":
                return float(next(file).split()[0])
            if line.strip() == b"$NOD":  # version 1, which meshio does not read
                return np.inf
    return 0.0


def read_by_gmsh(path: Path, nodes_of: NodesOf | None = None) -> RawMesh:
    """Read a file of a format that gmsh supports better than meshio.

    Args:
        path: path of the file.
        nodes_of: function that reads sets of nodes; None for none.

    Raises:
        FileContentError: for a file without cells, or with several kinds of them.
    """
    from hhr_dolfinx.geometries.gmsh_model import entities_of

    try:
        points, numbers, entities = entities_of(path)
    except Exception as error:
        if "compiled" not in str(error):
            raise
        # the gmsh of Debian has no MED; meshio may read the file, or explain why not
        return read_by_meshio(path)
    kinds = {(DIMENSION[kind], CORNERS[kind]): kind for kind in CORNERS}
    shapes = {(entity.dim, entity.corners.shape[1]) for entity in entities}
    dim = max((shape[0] for shape in shapes if shape in kinds or shape[0] == 3), default=0)
    if not dim:
        raise FileContentError(f"{path} has no triangles, quadrilaterals, tetrahedra or hexahedra")
    solid = [entity for entity in entities if entity.dim == dim]
    of = {
        entity: kinds.get((dim, entity.corners.shape[1])) or OF_CORNERS[entity.corners.shape[1]]
        for entity in solid
    }
    kind, left_out = one_kind(((of[entity], entity.nodes) for entity in solid), path)
    main = [entity for entity in solid if of[entity] == kind]
    order = sides_of(kind, (entity.nodes for entity in main), path, "gmsh")
    width = len(FACES[kind][0])
    sides = [
        entity for entity in entities if entity.dim == dim - 1 and entity.corners.shape[1] == width
    ]
    cells, bodies = _joined(main, CORNERS[kind])
    lost: dict[str | int, Counter[str]] = {}
    for entity in (lost_entity for lost_entity in solid if of[lost_entity] != kind):
        for tag in {tag for group in entity.groups for tag in group if tag}:
            lost.setdefault(tag, Counter())[of[entity]] += len(entity.nodes)
    bodies = {tag: rows for tag, rows in bodies.items() if tag not in lost}
    left_out |= of_other_kinds(lost, kind)
    facets, surfaces = _joined(sides, width)
    nodes = nodes_of(path, points, numbers) if nodes_of else {}
    for entity in entities:
        for name in {
            name or f"nodes {number}" for number, name in entity.groups if entity.dim < dim - 1
        }:
            nodes[name] = np.union1d(
                nodes.get(name, np.zeros(0, dtype=np.int64)), entity.nodes.ravel()
            )
    return RawMesh(
        points,
        kind,
        cells,
        bodies or {1: np.arange(len(cells))},
        {name: facets[rows] for name, rows in surfaces.items()},
        nodes,
        order,
        left_out,
    )


def _joined(entities: list[Entity], width: int) -> tuple[np.ndarray, dict[str | int, np.ndarray]]:
    """Corners of all elements, (n, width), and rows of each group by its number and by its name.

    If no group has any elements, the numbers are those of the entities, such as the lines of a
    .geo.
    """
    starts = np.cumsum([0, *(len(entity.corners) for entity in entities)])
    rows_of: dict[str | int, list[np.ndarray]] = {}
    for start, entity in zip(starts, entities, strict=False):
        rows = start + np.arange(len(entity.corners))
        for number, name in entity.groups:
            for tag in (number, name) if name else (number,):
                rows_of.setdefault(tag, []).append(rows)
    corners = [entity.corners for entity in entities]
    all_corners = np.concatenate(corners) if corners else np.zeros((0, width), dtype=np.int64)
    joined = {tag: np.unique(np.concatenate(rows)) for tag, rows in rows_of.items()}
    joined = {tag: rows for tag, rows in joined.items() if rows.size}
    tags = sorted({entity.tag for entity in entities})
    if joined or not tags:
        return all_corners, joined
    numbered: dict[str | int, np.ndarray] = {}
    for start, entity in zip(starts, entities, strict=False):
        rows = start + np.arange(len(entity.corners))
        numbered[entity.tag] = np.concatenate([numbered.get(entity.tag, rows[:0]), rows])
    return all_corners, numbered if len(tags) > 1 else {1: np.arange(len(all_corners)), **numbered}


def _arrays(raw: RawMesh, scale: float) -> tuple[tuple[np.ndarray, ...], TagsOfNames]:
    """Points, cells, tagged cells and facets with their tags, and the names of tags."""
    bodies = ItemNumbers.of(raw.bodies, len(raw.cells))
    facets, surfaces = facets_by_number(raw)
    points, cell_nodes = raw.whole()
    cells = raw.ordered()
    groups = [
        (name, (dim, numbers))
        for dim, sets in ((raw.dim, bodies.sets), (raw.dim - 1, surfaces.sets))
        for name, numbers in sets.items()
    ]
    return (
        points * scale,
        cell_nodes,
        cells[bodies.items],
        facets,
        bodies.values,
        surfaces.values,
    ), groups


def _shared(raw: RawMesh | None, comm: Comm, scale: float, summary: Summary | None) -> NamedMesh:
    """Distribute the mesh of the first rank."""
    arrays, groups = ((), None) if raw is None else _arrays(raw, scale)
    kind, groups, shapes, nodes = comm.bcast(
        raw and (raw.kind, groups, [array.shape[1:] for array in arrays], dict(raw.nodes))
    )
    points, cells, *tagged = arrays or (np.zeros((0, *shape)) for shape in shapes)
    mesh = linear_mesh(comm, points, cells, kind, 1 if shapes[1][0] == CORNERS[kind] else 2, shares)
    top = mesh.topology.dim
    of_cells, of_facets = (tags_of(mesh, top - k, tagged[k], tagged[k + 2]) for k in (0, 1))
    return NamedMesh(mesh, of_cells, of_facets, groups, summary, nodes)
