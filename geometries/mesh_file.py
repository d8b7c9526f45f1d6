"""Meshes from files: gmsh's ``.msh``, Abaqus' ``.inp``, Exodus, MED, XDMF, and whatever else meshio reads.

Bodies and surfaces have the names that the file gives them: physical groups of gmsh, sets and surfaces of Abaqus,
blocks and side sets of Exodus, groups of MED. A set of nodes stands for the outer facets that it holds wholly.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.compat import NamedMesh, extra, linear_mesh, tags_of
from hhr_dolfinx.errors import FileContentError, HHRError, SceneError
from hhr_dolfinx.geometries.cells import (
    CORNERS,
    DIMENSION,
    FACES,
    FACET_KINDS,
    KINDS,
    OF_CORNERS,
    OTHERS,
    one_kind,
    sides_of,
)
from hhr_dolfinx.geometries.partition import shares
from hhr_dolfinx.geometries.raw_mesh import Numbers, RawMesh, facets_by_number

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.geometries.gmsh_model import Entity

BY_GMSH = (".med", ".unv", ".bdf", ".nas", ".cgns")
"""Endings of files that are read by gmsh: meshio reads MED by h5py, which does not get on with the HDF5 of DOLFINx."""

ENDINGS = (".msh", ".inp", ".e", ".xdmf", ".vtk", ".vtu", *BY_GMSH)
"""Endings of the usual formats, for messages."""


Groups = list[tuple[str, tuple[int, int]]]
"""Names with number and dimension."""


@dataclass(frozen=True)
class MeshFile:
    """A geometry: the mesh of a file, whose bodies and surfaces are known by their names.

    Attributes:
        path: the file.
        scale: what its coordinates are multiplied by: 1e-3 for a file in mm and a scene in m.
    """

    path: Path | str
    scale: float = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.path, Path | str):
            raise SceneError(f"the path {self.path!r} of a mesh file must be a text or a Path")
        if not isinstance(self.scale, int | float) or not 0 < self.scale < np.inf:
            raise SceneError(f"the scale {self.scale!r} of mesh file {self.path} must be a positive number")

    def __call__(self, comm: Comm) -> NamedMesh:
        """Read on the first rank, shared out among all.

        Raises:
            FileContentError: for a file that cannot be read, or holds no mesh of one kind of cells.
        """
        path = Path(self.path)
        if path.suffix.lower() == ".xdmf" and path.is_file():
            from hhr_dolfinx.geometries.xdmf import read_xdmf

            return read_xdmf(path, comm, self.scale)
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
        return _shared(raw, comm, self.scale)

    def read(self) -> RawMesh:
        """What the file holds, before it is shared out."""
        path = Path(self.path)
        if not path.is_file():
            raise FileContentError(f"there is no mesh file {path}: {_found_instead(path)}")
        try:
            return _reader(path)(path).once().compact()
        except HHRError:
            raise
        except Exception as error:
            # readers of other people's files fail in many ways
            raise FileContentError(
                f"mesh file {path} cannot be read: {type(error).__name__}: {error} {_advice(path)}"
            ) from error


def _found_instead(path: Path) -> str:
    """What there is where a file is not: those of its name or ending."""
    if not path.parent.is_dir():
        return f"there is no folder {path.parent.absolute()}. Give the path from where the command is run"
    beside = [item.name for item in path.parent.iterdir() if path.stem == item.stem or path.suffix == item.suffix]
    if beside:
        return f"{path.parent.absolute()} has {', '.join(sorted(beside)[:5])}"
    return f"{path.absolute()} is looked for. Give the path from where the command is run"


def _advice(path: Path) -> str:
    """What to do with a file that no reader takes."""
    if path.suffix.lower() in (".step", ".stp", ".iges", ".igs", ".brep", ".geo", ".stl"):
        return f"{path.suffix} is geometry and no mesh: mesh its volumes in gmsh, and save them as .msh"
    return f"Write it again, or in another format: {', '.join(ENDINGS)}"


def _reader(path: Path) -> Any:
    """What reads a file, by its ending."""
    ending = path.suffix.lower()
    if ending == ".inp":
        from hhr_dolfinx.geometries.abaqus_deck import read_deck

        return read_deck
    if ending in (".e", ".ex2", ".exo", ".exii"):
        from hhr_dolfinx.geometries.exodus import read_exodus

        return read_exodus
    return read_by_gmsh if ending in BY_GMSH or _version(path) >= 4 else read_by_meshio


def _version(path: Path) -> float:
    """Of gmsh's own format; 0 for a file of another one.

    From version 4 on groups are of entities, which may be in several, and meshio keeps the first of them. Before, they
    are of elements, each of which is in the file once for each group; gmsh would add them to whole entities.
    """
    if path.suffix.lower() != ".msh":
        return 0.0
    with path.open("rb") as file, suppress(ValueError, IndexError):
        for line in file:
            if line.strip() == b"$MeshFormat":
                return float(next(file).split()[0])
    return 0.0


def read_by_gmsh(path: Path) -> RawMesh:
    """What gmsh reads and names better than meshio."""
    from hhr_dolfinx.geometries.gmsh_model import entities_of

    try:
        points, entities = entities_of(path)
    except Exception as error:
        if "compiled" not in str(error):
            raise
        # that of Debian has no MED; meshio may read it, or say why not
        return read_by_meshio(path)
    kinds = {(DIMENSION[kind], CORNERS[kind]): kind for kind in CORNERS}
    there = {(entity.dim, entity.corners.shape[1]) for entity in entities}
    dim = max((one[0] for one in there if one in kinds or one[0] == 3), default=0)
    if not dim:
        raise FileContentError(f"{path} has no triangles, quadrilaterals, tetrahedra or hexahedra")
    kind = one_kind((kinds.get(one) or OF_CORNERS[one[1]] for one in there if one[0] == dim), path)
    own = [entity for entity in entities if entity.dim == dim]
    order = sides_of(kind, (entity.nodes for entity in own), path, "gmsh")
    cells, bodies = _joined(own, CORNERS[kind])
    width = len(FACES[kind][0])
    sides = [entity for entity in entities if entity.dim == dim - 1 and entity.corners.shape[1] == width]
    facets, surfaces = _joined(sides, width)
    return RawMesh(points, kind, cells, bodies or {1: np.arange(len(cells))},
                   {name: facets[rows] for name, rows in surfaces.items()}, sides=order)  # fmt: skip


def _joined(entities: list[Entity], width: int) -> tuple[np.ndarray, dict[str | int, np.ndarray]]:
    """Corners of all elements, (n, width), and rows of each group by its number and by its name."""
    starts = np.cumsum([0, *(len(entity.corners) for entity in entities)])
    found: dict[str | int, list[np.ndarray]] = {}
    for start, entity in zip(starts, entities, strict=False):
        for number, name in entity.groups:
            for tag in (number, name) if name else (number,):
                found.setdefault(tag, []).append(start + np.arange(len(entity.corners)))
    corners = [entity.corners for entity in entities]
    every = np.concatenate(corners) if corners else np.zeros((0, width), dtype=np.int64)
    return every, {tag: np.unique(np.concatenate(rows)) for tag, rows in found.items()}


def read_by_meshio(path: Path) -> RawMesh:
    """Whatever meshio reads; sets by the names of gmsh, MED and meshio's own, else by numbers."""
    with extra("mesh", f"the mesh file {path}"):
        import meshio
    said = StringIO()
    # it says on the console what it cannot read, and ends the program
    try:
        with redirect_stdout(said):
            mesh = meshio.read(path)
    except SystemExit:
        raise FileContentError(f"mesh file {path} cannot be read: {' '.join(said.getvalue().split())}") from None
    there = [block.type for block in mesh.cells if block.type in KINDS]
    if not there and not any(block.type.startswith(tuple(OTHERS)) for block in mesh.cells):
        kinds = sorted({block.type for block in mesh.cells})
        raise FileContentError(f"{path} has cells of kinds {kinds}, and none of {sorted(KINDS)}")
    others = {name for block in mesh.cells for start, name in OTHERS.items() if block.type.startswith(start)}
    dim = 3 if others else max(DIMENSION[KINDS[kind]] for kind in there)
    kind = one_kind([*others, *(KINDS[kind] for kind in there if DIMENSION[KINDS[kind]] == dim)], path)
    own = [k for k, block in enumerate(mesh.cells) if KINDS.get(block.type) == kind]
    order = sides_of(kind, (mesh.cells[k].data for k in own), path)
    width = len(FACES[kind][0])
    sides = [k for k, block in enumerate(mesh.cells) if FACET_KINDS.get(block.type) == width and k not in own]
    cells = _corners(mesh, own, CORNERS[kind])
    facets = _corners(mesh, sides, width)
    groups = _physical_names(path)
    bodies = _sets(mesh, own, dim, groups)
    surfaces = {name: facets[rows] for name, rows in _sets(mesh, sides, dim - 1, groups).items()}
    nodes = {str(name): np.asarray(rows) for name, rows in mesh.point_sets.items()}
    return RawMesh(mesh.points, kind, cells, bodies or {1: np.arange(len(cells))}, surfaces, nodes, order)


def _physical_names(path: Path) -> Groups:
    """Names of gmsh with number and dimension: a body and a surface may share one, of which meshio keeps the last."""
    if path.suffix.lower() != ".msh":
        return []
    text = path.read_bytes().partition(b"$PhysicalNames")[2].partition(b"$EndPhysicalNames")[0]
    found = re.findall(r'^\s*(\d+)\s+(\d+)\s+"(.*)"\s*$', text.decode(errors="replace"), re.MULTILINE)
    return [(name, (int(number), int(dim))) for dim, number, name in found]


def _corners(mesh: Any, blocks: list[int], count: int) -> np.ndarray:
    """Corners of the cells of some blocks, (c, count)."""
    parts = [np.asarray(mesh.cells[k].data)[:, :count] for k in blocks]
    return np.concatenate(parts) if parts else np.zeros((0, count), dtype=np.int64)


def _sets(mesh: Any, blocks: list[int], dim: int, groups: Groups) -> dict[str | int, np.ndarray]:
    """Places in some blocks, one after another, by name or number."""
    starts = np.cumsum([0, *(len(mesh.cells[k].data) for k in blocks)])
    found: dict[str | int, list[np.ndarray]] = {}
    sets = {name.strip() for name in mesh.cell_sets}
    for name, parts in mesh.cell_sets.items():
        if not name.startswith("gmsh:"):
            rows = [start + np.asarray(parts[k], dtype=np.int64) for start, k in zip(starts, blocks, strict=False)
                    if parts[k] is not None]  # fmt: skip
            found.setdefault(name.strip(), []).extend(rows)
    names = _names_of_numbers(mesh, dim, groups)
    for key in ("gmsh:physical", "cell_tags", "medit:ref", "gambit:group", "su2:tag", "MaterialID"):
        for start, k in zip(starts, blocks, strict=False):
            if key in mesh.cell_data:
                values = np.asarray(mesh.cell_data[key][k]).ravel()
                for value in np.unique(values[values != 0]).tolist():
                    rows = start + np.flatnonzero(values == value)
                    for name in (value, *names.get(value, ())):
                        if name is value or name not in sets:
                            found.setdefault(name, []).append(rows)
    joined = {name: np.concatenate(parts) for name, parts in found.items() if parts}
    return {name: rows for name, rows in joined.items() if rows.size and not (isinstance(name, int) and name < 0)}


def _names_of_numbers(mesh: Any, dim: int, groups: Groups) -> Mapping[int, list[str]]:
    """Names of a number of the cells of a dimension: physical groups of gmsh, groups of MED."""
    names: dict[int, list[str]] = {}
    for name, group in groups or mesh.field_data.items():
        with suppress(TypeError, ValueError, IndexError):
            if int(group[1]) == dim:
                names.setdefault(int(group[0]), []).append(name.strip())
    for number, own in getattr(mesh, "cell_tags", {}).items():
        names.setdefault(int(number), []).extend(own)
    return names


def _arrays(raw: RawMesh, scale: float) -> tuple[tuple[np.ndarray, ...], Any]:
    """Points, cells, tagged cells and facets, the tags of both; and the names of tags."""
    bodies = Numbers.of(raw.bodies, len(raw.cells))
    facets, surfaces = facets_by_number(raw)
    points, whole = raw.whole()
    cells = raw.ordered()
    groups = [(name, (dim, numbers)) for dim, sets in ((raw.dim, bodies.sets), (raw.dim - 1, surfaces.sets))
              for name, numbers in sets.items()]  # fmt: skip
    return (points * scale, whole, cells[bodies.items], facets, bodies.values, surfaces.values), groups


def _shared(raw: RawMesh | None, comm: Comm, scale: float) -> NamedMesh:
    """The mesh of the first rank, shared out."""
    arrays, groups = ((), None) if raw is None else _arrays(raw, scale)
    kind, groups, shapes = comm.bcast(raw and (raw.kind, groups, [array.shape[1:] for array in arrays]))
    points, cells, *tagged = arrays or (np.zeros((0, *shape)) for shape in shapes)
    mesh = linear_mesh(comm, points, cells, kind, 1 if shapes[1][0] == CORNERS[kind] else 2, shares)
    top = mesh.topology.dim
    of_cells, of_facets = (tags_of(mesh, top - k, tagged[k], tagged[k + 2]) for k in (0, 1))
    return NamedMesh(mesh, of_cells, of_facets, groups)
