"""Files and scenes of others that ended wrong, in silence or in a foreign error: small, by
generators.
"""

from __future__ import annotations

import csv
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from subprocess import run as run_program
from typing import Any

import meshio
import numpy as np
from deck_commands import command, said
from deck_entries import Case
from deck_writer import Writer, at

import hhr_dolfinx as hhr
from hhr_dolfinx.compat import netcdf4
from hhr_dolfinx.errors import HHRError

POINTS = np.array(
    [(x, y, z) for z in (0.0, 1.0, 1.01, 2.01) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
)
CUBES = np.arange(16).reshape(2, 8)
FACES = np.arange(16).reshape(4, 4)
TAGS = 1, 2, 11, 12, 13, 14
NAMES = "lower", "upper", "floor", "top", "under", "lid"
"""Two cubes, .01 apart, one on the other.

Their numbers, those of their faces, and names of them all.
"""


def pressed(path: Path, tags: Sequence[Any] = TAGS) -> float:
    """Pressure of two cubes, E = 1000 and nu = 0, that are closed by .02: 10."""
    lower, upper, floor, top, under, lid = tags
    bodies = tuple(hhr.Body(tag, 1e3, 0.0) for tag in dict.fromkeys((lower, upper)))
    scene = hhr.Scene(
        "two_cubes",
        hhr.MeshFile(path),
        "solid",
        bodies,
        (hhr.NodeToSurface(under, top),),
        hhr.ParameterSpace(("down",), (0.0,), (0.05,)),
        displacements=(
            *hhr.Displacement.clamp(floor, 3),
            *hhr.Displacement.clamp(lid, 2),
            hhr.Displacement(lid, 2, "-down"),
        ),
        outputs=(hhr.LargestPressure("pressure", contact=0),),
    )
    return hhr.FullOrderModel(scene).solve(0.03).outputs()["pressure"]


# A2: cells of second order, each with nodes of its own in the middle of edges


def apart(kind: str, folder: Path) -> float:
    """Displacement of the end of a bar, 2 long, E = 1000 and nu = 0, under a traction of 5: .01."""
    deck = Writer()
    dim = 2 if kind.startswith("CPE") else 3
    bar = deck.box(
        "BAR", kind, (1,) * (dim - 1) + (2,), (0,) * dim, (1,) * (dim - 1) + (2,), shared=False
    )
    deck.surface("FOOT", bar.faces(at(dim - 1, 0)))
    deck.surface("TOP", bar.faces(at(dim - 1, 2)))
    path = folder / f"apart_{kind.lower()}.inp"
    path.write_text(deck.text)
    up = (0,) * (dim - 1) + (1,)
    scene = hhr.Scene(
        "bar",
        hhr.MeshFile(path),
        "plane_strain" if dim == 2 else "solid",
        (hhr.Body("BAR", 1e3, 0.0),),
        (hhr.Obstacle("TOP", up, 9.0),),
        hhr.ParameterSpace(("pull",), (0.0,), (10.0,)),
        displacements=hhr.Displacement.clamp("FOOT", dim),
        loads=(hhr.Traction("TOP", up, "pull"),),
    )
    return float(np.abs(hhr.FullOrderModel(scene).solve(5.0).displacement()).max())


# A3: XDMF of other writers


def _xdmf(variant: str, folder: Path) -> Path:
    """Two cubes: cells and facets in grids, with numbers in the file, compressed, or in a file that
    is not there.
    """
    path = folder / f"cubes_{variant.replace(' ', '_')}.xdmf"
    data = path.with_suffix(".h5")
    arrays: dict[str, np.ndarray] = {}

    def item(values: np.ndarray) -> str:
        kind = "Float" if values.dtype.kind == "f" else "Int"
        shape = " ".join(map(str, values.shape))
        head = f'<DataItem DataType="{kind}" Precision="8" Dimensions="{shape}"'
        if variant in ("numbers inside", "apart", "two grids"):
            return f'{head} Format="XML">{" ".join(map(str, values.ravel()))}</DataItem>'
        arrays[f"a{len(arrays)}"] = values
        return f'{head} Format="HDF">{data.name}:/a{len(arrays) - 1}</DataItem>'

    def grid(name: str, kind: str, cells: np.ndarray, tags: Sequence[int]) -> str:
        count = f'NumberOfElements="{len(cells)}"'
        topology = f'<Topology TopologyType="{kind}" {count}>{item(cells)}</Topology>'
        numbers = f'<Attribute Name="{name}" Center="Cell">{item(np.array(tags))}</Attribute>'
        return f'<Grid Name="{name}" GridType="Uniform">{geometry}{topology}{numbers}</Grid>'

    geometry = f'<Geometry GeometryType="XYZ">{item(POINTS)}</Geometry>'
    grids = []
    if variant == "apart":
        grids = [f'<Grid Name="points" GridType="Uniform">{geometry}</Grid>']
        geometry = "<xi:include xpointer=\"xpointer(/Xdmf/Domain/Grid[@Name='points']/Geometry)\"/>"
    parts = (
        {"supports": [0, 3], "contacts": [1, 2]}
        if variant == "two grids"
        else {"facets": [0, 1, 2, 3]}
    )
    grids += [grid("cells", "Hexahedron", CUBES, TAGS[:2])]
    grids += [
        grid(name, "Quadrilateral", FACES[own], [TAGS[2 + one] for one in own])
        for name, own in parts.items()
    ]
    include = 'xmlns:xi="http://www.w3.org/2001/XInclude"'
    path.write_text(f'<Xdmf Version="3.0" {include}><Domain>{"".join(grids)}</Domain></Xdmf>')
    if variant == "compressed":
        with netcdf4("the compressed file").Dataset(data, "w") as file:
            for name, values in arrays.items():
                axes = [
                    file.createDimension(f"{name}{k}", size).name
                    for k, size in enumerate(values.shape)
                ]
                file.createVariable(name, values.dtype, axes, zlib=True)[:] = values
    return path


def _by_dolfinx(ascii_: bool, folder: Path) -> Path:
    """Tetrahedra, their tags and those of facets by ``XDMFFile``."""
    from dolfinx import io
    from dolfinx import mesh as meshes
    from mpi4py import MPI

    deck = Writer()
    for k, low in enumerate((0.0, 1.01)):
        deck.box(f"B{k}", "C3D4", (2, 2, 2), (0, 0, low), (1, 1, low + 1))
    source = folder / "tetrahedra.inp"
    source.write_text(deck.text)
    mesh = hhr.MeshFile(source)(MPI.COMM_SELF)[0]
    places = dict(zip(TAGS[2:], (0.0, 1.0, 1.01, 2.01), strict=True))
    mesh.topology.create_entities(2)
    mesh.topology.create_connectivity(2, 3)
    found = {
        tag: meshes.locate_entities_boundary(mesh, 2, lambda x, z=z: np.isclose(x[2], z))
        for tag, z in places.items()
    }
    facets = np.concatenate(list(found.values()))
    values = np.concatenate(
        [np.full(len(some), tag, dtype=np.int32) for tag, some in found.items()]
    )
    order = np.argsort(facets)
    cells = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    upper = meshes.compute_midpoints(mesh, 3, cells)[:, 2] > 1.005
    path = folder / f"tetrahedra{'_ascii' if ascii_ else ''}.xdmf"
    encoding = io.XDMFFile.Encoding.ASCII if ascii_ else io.XDMFFile.Encoding.HDF5
    with io.XDMFFile(mesh.comm, str(path), "w", encoding=encoding) as file:
        file.write_mesh(mesh)
        for name, dim, own, numbers in (
            ("cells", 3, cells, 1 + upper),
            ("facets", 2, facets[order], values[order]),
        ):
            tags = meshes.meshtags(mesh, dim, own, numbers.astype(np.int32))
            tags.name = name
            file.write_meshtags(tags, mesh.geometry)
    return path


# A8: numbers and names of bodies and surfaces, as formats keep them


def _by_meshio(ending: str, folder: Path) -> Path:
    """A cell array called ``marker``, properties of Nastran, or entities of gmsh without physical
    ones.
    """
    tags = [np.array(TAGS[:2]), np.array(TAGS[2:])]
    keys = {".bdf": "nastran:ref", ".msh": "gmsh:geometrical"}
    data = {keys.get(ending, "marker"): tags}
    if ending == ".msh":
        data["gmsh:physical"] = [0 * part for part in tags]
    path = folder / f"markers{ending}"
    formats = {".bdf": "nastran", ".msh": "gmsh22"}
    binary = {} if ending == ".bdf" else {"binary": False} if ending == ".msh" else {"binary": True}
    mesh = meshio.Mesh(POINTS, [("hexahedron", CUBES), ("quad", FACES)], cell_data=data)
    mesh.write(path, file_format=formats.get(ending, ending[1:]), **binary)
    return path


def _exodus(folder: Path) -> Path:
    """Blocks of cells, of faces, each a surface, and of a line, by meshio."""
    blocks = [("hexahedron", cube[None]) for cube in CUBES] + [
        ("quad", face[None]) for face in FACES
    ]
    path = folder / "blocks.e"
    netcdf4("the writer")  # before meshio loads it: PETSc has another HDF5
    meshio.Mesh(POINTS, [*blocks, ("line", FACES[:1, :2])]).write(path, file_format="exodus")
    return path


def _unv(folder: Path) -> Path:
    """Groups of elements, and one of nodes, in data set 2467."""

    def line(*numbers: int) -> str:
        return "".join(f"{number:10d}" for number in numbers)

    rows = ["    -1", "  2411"]
    for k, place in enumerate(POINTS, 1):
        rows += [line(k, 1, 1, 11), "".join(f"{value:25.16E}" for value in place)]
    rows += ["    -1", "    -1", "  2412"]
    elements = [(115, cell) for cell in CUBES] + [(44, face) for face in FACES]
    for tag, (kind, nodes) in zip(TAGS, elements, strict=True):
        rows += [line(tag, kind, 1, 1, 7, len(nodes)), line(*(nodes + 1))]
    rows += ["    -1", "    -1", "  2467"]
    groups = {name: [(8, tag)] for name, tag in zip(NAMES, TAGS, strict=True)}
    groups["nodes of lid"] = [(7, node + 1) for node in FACES[3]]
    for number, (name, members) in enumerate(groups.items(), 1):
        rows += [line(number, *(0,) * 6, len(members)), name]
        rows += [
            line(*(word for kind, one in members[k : k + 2] for word in (kind, one, 0, 0)))
            for k in range(0, len(members), 2)
        ]
    path = folder / "groups.unv"
    path.write_text("\n".join([*rows, "    -1", ""]))
    return path


def _su2(folder: Path) -> Path:
    """Names of surfaces in SU2; it has no names of bodies, whose cells are one."""
    rows = [
        "NDIME= 3",
        "NELEM= 2",
        *(f"12 {' '.join(map(str, cell))} {k}" for k, cell in enumerate(CUBES)),
    ]
    rows += ["NPOIN= 16", *(f"{x} {y} {z} {k}" for k, (x, y, z) in enumerate(POINTS)), "NMARK= 4"]
    for name, face in zip(NAMES[2:], FACES, strict=True):
        rows += [f"MARKER_TAG= {name}", "MARKER_ELEMS= 1", f"9 {' '.join(map(str, face))}"]
    path = folder / "markers.su2"
    path.write_text("\n".join([*rows, ""]))
    return path


# A4: displacements of second order on straight sides


def roller(kind: str, order: int | None, folder: Path) -> float:
    """Largest pressure below a quarter of a disc of radius 50, pressed on a plane by .1, over that
    of Hertz.
    """

    def arcs(points: np.ndarray) -> np.ndarray:
        turn, depth = points[:, 0] ** 1.5 * np.pi / 2, points[:, 1]
        there = np.stack([50 * np.sin(turn), 50 * (1 - np.cos(turn)), 0 * turn], axis=1)
        middle = np.stack([50 * points[:, 0], np.full_like(turn, 50), 0 * turn], axis=1)
        return there + depth[:, None] ** 2 * (middle - there)

    deck = Writer()
    disc = deck.box("ROLLER", kind, (120, 30), (0, 0), (1, 1), arcs)
    for name, where in (("ROUND", at(1, 0)), ("MIDDLE", at(0, 0)), ("LID", at(1, 1))):
        deck.surface(name, disc.faces(where))
    path = folder / f"roller_{kind.lower()}.inp"
    path.write_text(deck.text)
    scene = hhr.Scene(
        "roller",
        hhr.MeshFile(path),
        "plane_strain",
        (hhr.Body("ROLLER", 210e3, 0.3),),
        (hhr.Obstacle("ROUND", (0, -1), 0.0),),
        hhr.ParameterSpace(("down",), (0.0,), (0.2,)),
        order=order,
        displacements=(hhr.Displacement("MIDDLE", 0), hhr.Displacement("LID", 1, "-down")),
        outputs=(hhr.LargestPressure("p0", 0), hhr.ContactForce("half", 0, direction=(0.0, 1.0))),
    )
    found = hhr.FullOrderModel(scene).solve(0.1).outputs()
    return found["p0"] / np.sqrt(2 * found["half"] * 210e3 / 0.91 / np.pi / 50)


# B2: a rigid plane below a whole round


def whole_round(plate: bool, folder: Path) -> float:
    """Largest pressure of a ring, cut at its top, over that of Hertz.

    Its surface is all of its outside.
    """

    def bend(points: np.ndarray) -> np.ndarray:
        turn = np.pi * (np.sign(points[:, 0]) * points[:, 0] ** 2 - 0.5)
        radius = 1 - 0.7 * (1 - points[:, 1]) ** 1.8
        return np.stack([radius * np.cos(turn), radius * np.sin(turn), 0 * turn], axis=1)

    def graded(points: np.ndarray) -> np.ndarray:
        wide = np.sign(points[:, 0]) * points[:, 0] ** 2
        return np.stack([wide, 0.3 * points[:, 1] - 1, points[:, 2]], axis=1)

    deck = Writer()
    ring = deck.box("RING", "CPE4", (160, 24), (-1, 0), (1, 1), bend)
    floor = deck.box("PLATE", "CPE4", (100, 3), (-1, -1), (1, 0), graded)
    surfaces = {
        "ROUND": (ring, at(1, 1)),
        "BORE": (ring, at(1, 0)),
        "TOP": (floor, at(1, 0)),
        "FOOT": (floor, at(1, -1)),
    }
    for name, (box, where) in surfaces.items():
        deck.surface(name, box.faces(where))
    path = folder / "ring.inp"
    path.write_text(deck.text)
    scene = hhr.Scene(
        "ring",
        hhr.MeshFile(path),
        "plane_strain",
        (hhr.Body("RING", 1e3, 0.3), hhr.Body("PLATE", 1e9, 0.3)),
        (hhr.NodeToSurface("ROUND", "TOP") if plate else hhr.Obstacle("ROUND", (0, -1), 1.0),),
        hhr.ParameterSpace(("down",), (0.0,), (0.01,)),
        displacements=(
            *hhr.Displacement.clamp("FOOT", 2),
            hhr.Displacement("BORE", 0),
            hhr.Displacement("BORE", 1, "-down"),
        ),
        outputs=(hhr.LargestPressure("p0", 0), hhr.ContactForce("force", 0, direction=(0.0, 1.0))),
    )
    found = hhr.FullOrderModel(scene).solve(0.005).outputs()
    return found["p0"] / np.sqrt(found["force"] * 1e3 / 0.91 / np.pi)


# B3: words


def _deck(parts: bool = False) -> str:
    """Two cubes as one deck, or as parts of an assembly."""
    rows = ["*NODE", *(f"{k}, {x}, {y}, {z}" for k, (x, y, z) in enumerate(POINTS, 1))]
    cells = [", ".join(map(str, cell + 1)) for cell in CUBES]
    if not parts:
        for name, number, cell in zip(NAMES, (1, 2), cells, strict=False):
            rows += [f"*ELEMENT, TYPE=C3D8, ELSET={name}", f"{number}, {cell}"]
        for name, face in zip(NAMES[2:], ("1, S1", "1, S2", "2, S1", "2, S2"), strict=True):
            rows += [f"*SURFACE, NAME={name}", face]
        return "\n".join([*rows, ""])
    rows = []
    for k, name in enumerate(NAMES[:2]):
        rows += [f"*PART, NAME={name}", "*NODE"]
        rows += [f"{n}, {x}, {y}, {z}" for n, (x, y, z) in enumerate(POINTS[8 * k : 8 * k + 8], 1)]
        rows += ["*ELEMENT, TYPE=C3D8, ELSET=all", "1, 1, 2, 3, 4, 5, 6, 7, 8"]
        rows += ["*SURFACE, NAME=under", "1, S1", "*SURFACE, NAME=over", "1, S2", "*END PART"]
    rows += ["*ASSEMBLY, NAME=both"]
    for name in NAMES[:2]:
        rows += [f"*INSTANCE, NAME={name}-1, PART={name}", "*END INSTANCE"]
    return "\n".join([*rows, "*END ASSEMBLY", ""])


def written(name: str, text: str, folder: Path) -> Path:
    """A file with a text."""
    path = folder / name
    path.write_text(text)
    return path


SHELL = (
    "*NODE/20, 0, 0, 3/21, 1, 0, 3/22, 1, 1, 3/23, 0, 1, 3/*ELEMENT, TYPE=S4, ELSET=TABLE/3, 20, "
    "21, 22, 23"
)
OF_PARTS = "lower-1", "upper-1", "lower-1.under", "lower-1.over", "upper-1.under", "upper-1.over"


def listed(words: Sequence[str], name: str, text: str, folder: Path) -> float:
    """Number of words that ``hhr check`` has on a mesh."""
    written(name, text, folder)
    found = said(folder, "check", name)
    return float(sum(re.search(word, found, re.IGNORECASE) is not None for word in words))


def of_elmer(folder: Path) -> float:
    """A folder in the place of a file."""
    (folder / "elmer").mkdir(exist_ok=True)
    written("elmer/mesh.header", "16 2 4\n", folder)
    return pressed(folder / "elmer")


def kratos(folder: Path) -> float:
    """Two cubes of Kratos, with sub model parts of elements and of nodes."""
    rows = [
        "Begin Nodes",
        *(f"{k} {x} {y} {z}" for k, (x, y, z) in enumerate(POINTS, 1)),
        "End Nodes",
    ]
    rows += ["Begin Elements SmallDisplacementElement3D8N"]
    rows += [f"{k} 0 {' '.join(map(str, cell + 1))}" for k, cell in enumerate(CUBES, 1)] + [
        "End Elements"
    ]
    for k, name in enumerate(NAMES):
        inside = k < 2
        rows += [
            f"Begin SubModelPart {name}",
            f"Begin SubModelPart{'Elements' if inside else 'Nodes'}",
        ]
        rows += [str(k + 1)] if inside else [str(node + 1) for node in FACES[k - 2]]
        rows += [f"End SubModelPart{'Elements' if inside else 'Nodes'}", "End SubModelPart"]
    return pressed(written("cubes.mdpa", "\n".join([*rows, ""]), folder), NAMES)


def gaps_of_moduli(folder: Path) -> float:
    """Gap as drawn that ``hhr check`` gives where a modulus varies and a body is moved as a whole:
    .01.
    """
    written("two.inp", _deck(), folder)
    written(
        "two.py",
        """import hhr_dolfinx as hhr

scene = hhr.Scene(
    "two", hhr.MeshFile("two.inp"), "solid",
    (hhr.Body("lower", "E", 0.0), hhr.Body("upper", 1e3, 0.0)),
    (hhr.NodeToSurface("under", "top"),),
    hhr.ParameterSpace(("push", "E"), (0.0, 5e2), (0.05, 1.5e3)),
    displacements=(
        *hhr.Displacement.clamp("floor", 3), *hhr.Displacement.clamp("lid", 2),
        hhr.Displacement("lid", 2, "-push"),
    ),
)
""",
        folder,
    )
    found = re.search(r"gaps from (\S+) to (\S+) as drawn", said(folder, "check", "two.py"))
    return float(found[1]) if found else float("nan")


def folded(folder: Path) -> float:
    """A tetrahedron of second order with a node in the middle of an edge moved to four fifths of
    it.
    """
    deck = Writer()
    box = deck.box("BLOCK", "C3D10", (1, 1, 1), (0, 0, 0), (1, 1, 1))
    number = box.numbers[np.linalg.norm(box.points - (0.5, 0, 0), axis=1).argmin()]
    lines = [
        f"{number}, 0.8, 0, 0" if line.startswith(f"{number}, 0.5, 0, 0") else line
        for line in deck.text.splitlines()
    ]
    deck.text = "\n".join([*lines, ""])
    for name, where in (("FOOT", at(2, 0)), ("LID", at(2, 1))):
        deck.surface(name, box.faces(where))
    path = written("folded.inp", deck.text, folder)
    scene = hhr.Scene(
        "folded",
        hhr.MeshFile(path),
        "solid",
        (hhr.Body("BLOCK", 1e3, 0.0),),
        (hhr.Obstacle("LID", (0, 0, 1), 0.0),),
        hhr.ParameterSpace(("down",), (0.0,), (1.0,)),
        displacements=hhr.Displacement.clamp("FOOT", 3),
    )
    return float(hhr.FullOrderModel(scene).solve(0.5).displacement().max())


def sorted_imports(folder: Path) -> float:
    """First lines of a script as sorters of imports order them, and the base of all errors: the
    exit code.
    """
    text = (
        "from dolfinx import mesh\n\nimport hhr_dolfinx as hhr\n\n"
        "assert mesh and issubclass(hhr.HHRError, Exception)\n"
    )
    return float(run_program([sys.executable, written("imports.py", text, folder)]).returncode == 0)


# A6: strains that are not small


def rubber(folder: Path) -> Path:
    """The scene of a block, 10 x 10, that is squeezed by up to 10 on a floor .5 lower."""
    deck = Writer()
    block = deck.box("RUBBER", "CPE4", (6, 6), (0, 0), (10, 10))
    deck.surface("FOOT", block.faces(at(1, 0)))
    deck.surface("LID", block.faces(at(1, 10)))
    (folder / "rubber.inp").write_text(deck.text)
    path = folder / "rubber.py"
    path.write_text(
        """import hhr_dolfinx as hhr

scene = hhr.Scene(
    "rubber", hhr.MeshFile("rubber.inp"), "plane_strain", (hhr.Body("RUBBER", 3.0, 0.45),),
    (hhr.Obstacle("FOOT", (0, -1), 0.5),), hhr.ParameterSpace(("down",), (0.0,), (10.0,)),
    displacements=(hhr.Displacement("LID", 0), hhr.Displacement("LID", 1, "-down")),
    outputs=(hhr.LargestPressure("pressure", contact=0),),
)
"""
    )
    return path


def strained(words: Sequence[str], folder: Path) -> float:
    """Run a command on the scene; 0, if it ends well."""
    rubber(folder)
    said(folder, *words)
    return 0.0


def strained_row(folder: Path) -> float:
    """Pressure of a model at the corner of the box by a table: its status refuses it."""
    rubber(folder)
    (folder / "rubber.csv").write_text("down\n1\n10\n")
    said(folder, "reduce", "rubber.py", "--out", "rubber")
    command(
        folder, "answer", "rubber/model.npz", "rubber.csv"
    )  # ends with the code of a table with bad rows
    with (folder / "answers.csv").open(newline="") as file:
        row = list(csv.DictReader(file))[-1]
    if row["status"] != "ok":
        raise HHRError(row["status"])
    return float(row["pressure"])


def _folder(write: Callable[[Path], Path], tags: Sequence[Any], folder: Path) -> float:
    return pressed(write(folder), tags)


def _read(
    source: str,
    kind: str,
    write: Callable[[Path], Path],
    tags: Sequence[Any] = TAGS,
    reference: Any = 10.0,
) -> Case:
    return Case(source, kind, partial(_folder, write, tags), "pressure", reference)


XDMF: Mapping[str, float | str] = {
    "numbers inside": 10.0,
    "compressed": 10.0,
    "apart": 10.0,
    "two grids": 10.0,
    "no h5": "put it there too",
}
CASES = (
    *(
        Case(f"case A2, {kind}", f"{kind}, do not meet", partial(apart, kind), "displacement", 0.01)
        for kind in ("CPE6", "C3D10", "C3D20")
    ),
    *(
        _read(f"case A3, {name}", "XDMF", partial(_xdmf, name), reference=reference)
        for name, reference in XDMF.items()
    ),
    *(
        _read(f"case A3, DOLFINx{', ASCII' if one else ''}", "XDMF", partial(_by_dolfinx, one))
        for one in (False, True)
    ),
    *(
        _read(f"case A8, {ending}", ending, partial(_by_meshio, ending))
        for ending in (".bdf", ".msh", ".vtu", ".vtk")
    ),
    _read("case A9, .e, blocks of faces", ".e", _exodus, range(6)),
    _read("case A8, .unv, set 2467", ".unv", _unv, NAMES),
    _read("case A8, .su2", ".su2", _su2, (1, 1, *NAMES[2:])),
    Case(
        "case A4, first order",
        "CPE4",
        partial(roller, "CPE4", 1),
        "pressure over that of Hertz",
        1.0,
    ),
    Case(
        "case A4, second order on chords",
        "CPE4",
        partial(roller, "CPE4", 2),
        "",
        "first order, Scene(order=1)",
    ),
    Case(
        "case A4, second order on arcs",
        "CPE8",
        partial(roller, "CPE8", None),
        "pressure over that of Hertz",
        1.0,
    ),
    *(
        Case(
            f"case A6, hhr {words[0]}",
            "CPE4, strain of 1.1",
            partial(strained, words),
            "",
            "a program for finite",
        )
        for words in (
            ("solve", "rubber.py", "--at", "down=10"),
            ("train", "rubber.py", "--sobol", "8"),
        )
    ),
    Case(
        "case A6, hhr answer",
        "CPE4, strain of 1.1",
        strained_row,
        "",
        "lower the load, or take a program for large",
    ),
    Case("case B2, plane", "CPE4", partial(whole_round, False), "pressure over that of Hertz", 1.0),
    Case("case B2, plate", "CPE4", partial(whole_round, True), "pressure over that of Hertz", 1.0),
    Case(
        "case B3 1, check of a mesh",
        ".inp",
        partial(listed, NAMES, "cubes.inp", _deck()),
        "names listed",
        6.0,
    ),
    _read("case B3 2, a deck called .msh", ".msh", partial(written, "cgx.msh", _deck()), NAMES),
    Case("case B3 3, a folder of Elmer", "folder", of_elmer, "", "ElmerGrid"),
    Case(
        "case B3 4, shells left out",
        "C3D8 and S4",
        partial(
            listed,
            ("left out", "TABLE.*S4"),
            "table.inp",
            _deck() + SHELL.replace("/", "\n") + "\n",
        ),
        "words of what is left out",
        2.0,
    ),
    _read("case B3 5, parts", ".inp", partial(written, "parts.inp", _deck(parts=True)), OF_PARTS),
    Case("case B3 6, gaps of check", "C3D8", gaps_of_moduli, "gap as drawn", 0.01),
    Case("case B3 7, Kratos", ".mdpa", kratos, "pressure", 10.0),
    Case("case B3 9, folded cells", "C3D10", folded, "", "Untangled"),
    Case("case B4, imports sorted", "script", sorted_imports, "runs", 1.0),
)
