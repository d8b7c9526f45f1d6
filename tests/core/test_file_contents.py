"""Contents of mesh files: nothing is dropped without a word, and nothing that no scene names
refuses the rest.

Most files hold two unit cubes, 0.01 apart, in the way of their format. E = 1000, nu = 0 and closed
by 0.02 beyond the gap over two unit lengths: the pressure is 10, a closed form, so that tolerances
are those of round-off. The last tests attack the readers: groups that overlap, shared names, odd
decks, sides of hexahedra.
"""

import json
import re
import warnings
from dataclasses import replace

import gmsh
import meshio
import numpy as np
import pytest
import ufl
from cubes_in_files import (
    CUBES,
    DECK,
    EDGES_OF_A_CUBE,
    FACES,
    NAMES,
    NUMBERS,
    POINTS,
    by_meshio,
    nodes_of_deck,
    pressure,
    reasons,
    size_of,
    two_cubes,
    write_exodus,
    written,
)
from dolfinx import io
from libraries import MED, needs_med
from mpi4py import MPI
from mpirun import launch
from needs import needs
from processes import folders_of
from scenes import block_scene, slope, space

import hhr_dolfinx as hhr
from hhr_dolfinx.compat import linear_mesh, netcdf4, tags_of
from hhr_dolfinx.errors import FileContentError, SceneError
from hhr_dolfinx.geometries.mesh_file import summary_of

TOOL = nodes_of_deck([(x, y, 9.0) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], 100)
WEDGE = [(x, y, z) for z in (5.0, 6.0) for x, y in ((0, 0), (1, 0), (0, 1))]


EXTRA = {
    "rigid tool": (
        TOOL
        + (
            "*ELEMENT, TYPE=R3D4, ELSET=TOOL\n3, 100, 101, 102, 103\n"
            "*SURFACE, NAME=S_TOOL\nTOOL, SNEG\n"
        ),
        {"TOOL": "1 element of type R3D4", "S_TOOL": "no sides of cells"},
    ),
    "skin": (
        "*ELEMENT, TYPE=S4, ELSET=SKIN\n3, 13, 14, 15, 16\n*SURFACE, NAME=S_SKIN\nSKIN, SPOS\n",
        {},
    ),
    "shell": (
        TOOL + "*ELEMENT, TYPE=S4, ELSET=TABLE\n3, 100, 101, 102, 103\n",
        {"TABLE": "1 element of type S4"},
    ),
    "beam": (
        "*ELEMENT, TYPE=B31, ELSET=ROD\n3, 1, 16\n*SURFACE, NAME=S_ROD\n3, S1\n",
        {"ROD": "1 element of type B31", "S_ROD": "elements of type B31"},
    ),
    "pipe in no set": (
        "*ELEMENT, TYPE=PIPE31\n3, 1, 16\n",
        {"1 element of type PIPE31": "neither cells nor sides"},
    ),
    "glue": (
        TOOL
        + nodes_of_deck([(x, y, 9.0) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], 104)
        + "*ELEMENT, TYPE=COH3D8, ELSET=GLUE\n3, 100, 101, 102, 103, 104, 105, 106, 107\n",
        {"GLUE": "1 element of type COH3D8"},
    ),
    "analytical": (
        "*SURFACE, TYPE=CYLINDER, NAME=RIGID\nSTART, 0., 0.\nLINE, 1., 0.\n",
        {"RIGID": "TYPE=CYLINDER are not read"},
    ),
    "union": ("*SURFACE, NAME=BOTH, COMBINE=UNION\nMASTER, SLAVE\n", {}),
    "difference": (
        "*SURFACE, NAME=LESS, COMBINE=DIFFERENCE\nMASTER, SLAVE\n",
        {"LESS": "COMBINE=DIFFERENCE"},
    ),
    "nothing there": (
        "*SURFACE, NAME=LOST\nNOWHERE, S1\n",
        {"LOST": "'NOWHERE' has no cells of the mesh"},
    ),
    "wedge": (
        nodes_of_deck(WEDGE, 100)
        + "*ELEMENT, TYPE=C3D6, ELSET=OTHER\n3, 100, 101, 102, 103, 104, 105\n",
        {"OTHER": "1 prism in it", "1 prism": "not supported"},
    ),
}


@needs("nonmatching")
@pytest.mark.parametrize("what", EXTRA)
def test_what_no_scene_names_does_not_refuse_a_deck(what, tmp_path):
    text, wanted = EXTRA[what]
    path = written(tmp_path / "blocks.inp", DECK + text)
    assert pressure(path, NAMES) == pytest.approx(10.0, rel=1e-9)
    found = reasons(path)
    assert found.keys() == wanted.keys() and all(why in found[name] for name, why in wanted.items())


def test_surfaces_of_skins_unions_and_whole_outsides(tmp_path):
    text = DECK + EXTRA["skin"][0] + EXTRA["union"][0] + "*SURFACE, NAME=OUTSIDE\nUPPER,\n"
    surfaces = hhr.MeshFile(written(tmp_path / "blocks.inp", text)).read().surfaces
    facets = {
        name: {frozenset((own + 1).tolist()) for own in rows} for name, rows in surfaces.items()
    }
    assert facets["S_SKIN"] == facets["SKIN"] == {frozenset(FACES[14])}
    assert facets["BOTH"] == {frozenset(FACES[12]), frozenset(FACES[13])}
    assert len(facets["OUTSIDE"]) == 6 and frozenset(FACES[13]) in facets["OUTSIDE"]


@needs("nonmatching")
def test_sets_that_overlap_are_surfaces_and_bodies(tmp_path):
    """A set of all elements, and one of nodes around everything, beside those that are used."""
    around = "*NSET, NSET=AROUND\n" + "".join(f"{k},\n" for k in range(1, 17))
    path = written(tmp_path / "blocks.inp", f"{DECK}*ELSET, ELSET=EVERY\nLOWER, UPPER\n{around}")
    assert pressure(path, NAMES) == pytest.approx(10.0, rel=1e-9)
    assert pressure(path, ("EVERY", None, *NAMES[2:])) == pytest.approx(10.0, rel=1e-9)
    with pytest.raises(SceneError, match=r"bodies 'LOWER' and 'EVERY' have cells in common"):
        pressure(path, ("LOWER", "EVERY", *NAMES[2:]))


def test_a_wedge_that_touches_a_hexahedron_is_no_body_of_its_own(tmp_path):
    nodes, wedge = (
        nodes_of_deck([(0.5, 2, 2.01), (0.5, 2, 1.01)], 100),
        "3, 15, 16, 100, 11, 12, 101\n",
    )
    path = written(
        tmp_path / "mixed.inp", f"{DECK}{nodes}*ELEMENT, TYPE=C3D6, ELSET=UPPER\n{wedge}"
    )
    with pytest.raises(FileContentError, match="mixes hexahedra and prisms"):
        hhr.MeshFile(path).read()


OTHERS = {
    "wedge": (
        [(x, y, z) for z in (5.0, 6.0) for x, y in ((0, 0), (1, 0), (0, 1))],
        "C3D6",
        "WEDGE6",
        "prism",
    ),
    "tetra": ([(0, 0, 5.0), (1, 0, 5.0), (0, 1, 5.0), (0, 0, 6.0)], "C3D4", "TET4", "tetrahedron"),
}


def with_another_kind(path, what):
    """The two cubes and a cell of another kind above them.

    Number 3 and the name OTHER, and part of EVERY.
    """
    places, of_deck, of_exodus, _ = OTHERS[what]
    points = [*POINTS, *places]
    other = [*range(17, len(points) + 1)]
    if path.suffix == ".inp":
        element = f"*ELEMENT, TYPE={of_deck}, ELSET=OTHER\n3, {', '.join(map(str, other))}\n"
        return written(
            path,
            f"{DECK}{nodes_of_deck(places, 17)}{element}*ELSET, ELSET=EVERY\nLOWER, UPPER, OTHER\n",
        )
    if path.suffix == ".e":
        blocks = {k: ("HEX8", [cube]) for k, cube in enumerate(CUBES, 1)} | {
            3: (of_exodus, [other])
        }
        blocks |= {n: ("QUAD4", [face]) for n, face in FACES.items()}
        names = dict(zip((1, 2, 3, *FACES), ("LOWER", "UPPER", "OTHER", *NAMES[2:]), strict=True))
        return write_exodus(path, points, blocks, names=names)
    cells = [("hexahedron", np.array(CUBES) - 1), ("quad", np.array([*FACES.values()]) - 1)]
    cells += [(what, np.array([other]) - 1)]
    numbers = [np.array([1, 2]), np.array([*FACES]), np.array([3])]
    data = (
        {"gmsh:physical": numbers, "gmsh:geometrical": numbers}
        if path.suffix == ".msh"
        else {"part": numbers}
    )
    names = dict(zip(NAMES, [(1, 3), (2, 3), *((n, 2) for n in FACES)], strict=True)) | {
        "OTHER": (3, 3)
    }
    fields = (
        {name: np.array(group) for name, group in names.items()} if path.suffix == ".msh" else {}
    )
    meshio.write(path, meshio.Mesh(np.array(points), cells, cell_data=data, field_data=fields),
                 {"old.msh": "gmsh22"}.get(path.name))  # fmt: skip
    return path


@needs("nonmatching", "mesh_formats")
@pytest.mark.parametrize("name", ["c.inp", "c.e", "old.msh", "new.msh", "c.vtu"])
@pytest.mark.parametrize("what", OTHERS)
def test_a_body_of_another_kind_of_cells_is_left_out_by_name(what, name, tmp_path):
    """The rest is answered; a scene that names the body, or a set with part of it, is refused with
    the reason.
    """
    if name == "new.msh":  # meshio writes no entities of version 4
        gmsh.initialize()
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(with_another_kind(tmp_path / "old.msh", what)))
        gmsh.write(str(tmp_path / name))
        gmsh.finalize()
        path = tmp_path / name
    else:
        path = with_another_kind(tmp_path / name, what)
    numbers = name == "c.vtu"
    assert pressure(path, NUMBERS if numbers else NAMES) == pytest.approx(10.0, rel=1e-9)
    wanted = [3] if numbers else ["OTHER"]
    for tag in [*wanted, "EVERY"] if name == "c.inp" else wanted:
        with pytest.raises(SceneError) as found:
            pressure(path, (tag, None, *(NUMBERS if numbers else NAMES)[2:]))
        kind = OTHERS[what][-1]
        assert f"{tag!r} is in the file: 1 {kind} in it, and a mesh has cells of one kind" in str(
            found.value
        )
    assert any(f"1 {OTHERS[what][-1]}" in str(key) for key in reasons(path))


@needs("nonmatching")
def test_an_element_ends_when_it_has_its_nodes(tmp_path):
    """And goes on where it has not; a deck is read by its content, whatever its ending."""
    path = written(
        tmp_path / "commas.inp", re.sub(r"^(\d+(?:, \d+){8})$", r"\1,", DECK, flags=re.MULTILINE)
    )
    assert path.read_text().count("8,\n") == 1
    assert pressure(path, NAMES) == pytest.approx(10.0, rel=1e-9)
    path = written(tmp_path / "cgx.msh", DECK.replace("1, 1, 2, 3, 4, 5", "1, 1, 2, 3, 4,\n5"))
    found = hhr.MeshFile(path).read()
    assert len(found.cells) == 2 and found.kind == "hexahedron"


def nastran():
    rows = ["BEGIN BULK"]
    rows += [
        f"GRID    {k:<8d}        {x:<8.4f}{y:<8.4f}{z:<8.4f}"
        for k, (x, y, z) in enumerate(POINTS, 1)
    ]
    for k, cube in enumerate(CUBES, 1):
        words = "".join(f"{n:<8d}" for n in cube)
        rows += [f"CHEXA   {k:<8d}{k:<8d}{words[:48]}+", f"+       {words[48:]}"]
    rows += [
        f"CQUAD4  {n:<8d}{n:<8d}" + "".join(f"{k:<8d}" for k in face) for n, face in FACES.items()
    ]
    return "\n".join([*rows, "ENDDATA", ""])


def unv(data_set):
    rows = ["    -1", "  2411"]
    for k, (x, y, z) in enumerate(POINTS, 1):
        rows += [f"{k:10d}{1:10d}{1:10d}{11:10d}", f"{x:25.16E}{y:25.16E}{z:25.16E}"]
    rows += ["    -1", "    -1", "  2412"]
    for k, cube in enumerate(CUBES, 1):
        rows += [f"{k:10d}{115:10d}{2:10d}{1:10d}{7:10d}{8:10d}", "".join(f"{n:10d}" for n in cube)]
    for n, face in FACES.items():
        rows += [f"{n:10d}{44:10d}{1:10d}{1:10d}{7:10d}{4:10d}", "".join(f"{k:10d}" for k in face)]
    rows += ["    -1", "    -1", f"  {data_set}"]
    groups = {
        "LOWER": [(8, 1)],
        "UPPER": [(8, 2)],
        "FLOOR": [(8, 11)],
        "MASTER": [(8, 12)],
        "SLAVE": [(8, 13)],
    }
    groups["LID"] = [(7, k) for k in FACES[14]]  # of nodes
    for number, (name, members) in enumerate(groups.items(), 1):
        rows += [f"{number:10d}" + f"{0:10d}" * 6 + f"{len(members):10d}", name]
        pairs = [f"{kind:10d}{k:10d}{0:10d}{0:10d}" for kind, k in members]
        rows += ["".join(pairs[k : k + 2]) for k in range(0, len(pairs), 2)]
    return "\n".join([*rows, "    -1", ""])


def su2():
    rows = ["NDIME= 3", "NELEM= 2"]
    rows += ["12 " + " ".join(str(k - 1) for k in cube) for cube in CUBES]
    rows += [f"NPOIN= {len(POINTS)}", *(f"{x} {y} {z}" for x, y, z in POINTS), "NMARK= 4"]
    for name, face in zip(NAMES[2:], FACES.values(), strict=True):
        rows += [
            f"MARKER_TAG= {name}",
            "MARKER_ELEMS= 1",
            "9 " + " ".join(str(k - 1) for k in face),
        ]
    return "\n".join([*rows, ""])


TWO_ARRAYS = {"rank": [0, 1, 0, 0, 1, 1], "marker": NUMBERS}
MARKERS = {
    "properties of Nastran": ("c.bdf", nastran(), NUMBERS),
    "entities of gmsh": ("c.msh", {"gmsh:physical": [0] * 6, "gmsh:geometrical": NUMBERS}, NUMBERS),
    "an array of any name": ("c.vtu", {"marker": NUMBERS}, NUMBERS),
    "numbers beside ghosts and a field": (
        "c.vtu", {"part": NUMBERS, "vtkGhostType": [0] * 6, "heat": [0.5] * 6}, NUMBERS),
    "one of two arrays": ("c.vtu", TWO_ARRAYS, ("marker:1", 2, 11, 12, 13, 14)),
    "data set 2467": ("c.unv", unv(2467), NAMES),
    "data set 2477": ("c.unv", unv(2477), NAMES),
    "markers of SU2": ("c.su2", su2(), (1, None, *NAMES[2:])),
}  # fmt: skip


@needs("nonmatching", "mesh_formats")
@pytest.mark.parametrize(
    "what",
    [
        pytest.param(
            what, marks=needs("mesh_formats") if held[0].endswith((".unv", ".bdf")) else ()
        )
        for what, held in MARKERS.items()
    ],
)
def test_numbers_and_names_of_a_file_are_there(what, tmp_path):
    name, held, names = MARKERS[what]
    path = (
        written(tmp_path / name, held)
        if isinstance(held, str)
        else by_meshio(tmp_path / name, **held)
    )
    assert pressure(path, names) == pytest.approx(10.0, rel=1e-9)


@needs("nonmatching", "mesh_formats")
def test_numbers_that_several_arrays_have_are_named_by_their_array(tmp_path):
    with pytest.raises(
        SceneError, match=r"1 is in the file: is in several arrays: name it 'rank:1' or 'marker:1'"
    ):
        pressure(by_meshio(tmp_path / "c.vtu", **TWO_ARRAYS))


def test_groups_of_lines_and_points_of_gmsh_are_sets_of_nodes(tmp_path):
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    box = gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    for dim, tag, name in ((3, box, "body"), (2, 1, "left"), (1, 1, "edge"), (0, 3, "pin")):
        gmsh.model.addPhysicalGroup(dim, [tag], name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMin", 1.0)
    gmsh.model.mesh.generate(3)
    for version in (2.2, 4.1):
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.write(str(tmp_path / "lines.msh"))
        found = hhr.MeshFile(tmp_path / "lines.msh").read()
        edge, pin = (found.points[found.nodes[name]] for name in ("edge", "pin"))
        assert edge == pytest.approx(np.array([[0, 0, 1], [0, 0, 0]])) and pin == pytest.approx(
            np.array([[0, 1, 1]])
        )
    gmsh.finalize()


def by_dolfinx(folder, *, split=False, ascii_=False):
    order, path = [0, 1, 3, 2, 4, 5, 7, 6], folder / "cubes.xdmf"
    mesh = linear_mesh(MPI.COMM_SELF, np.array(POINTS), np.array(CUBES)[:, order] - 1, "hexahedron")
    tagged = {"cells": tags_of(mesh, 3, np.array(CUBES)[:, order] - 1, np.array([1, 2]))}
    parts = {"supports": (11, 14), "contacts": (12, 13)} if split else {"facets": (11, 12, 13, 14)}
    for name, own in parts.items():
        corners = np.array([FACES[n] for n in own])[:, [0, 1, 3, 2]] - 1
        tagged[name] = tags_of(mesh, 2, corners, np.array(own))
    encoding = io.XDMFFile.Encoding.ASCII if ascii_ else io.XDMFFile.Encoding.HDF5
    with io.XDMFFile(MPI.COMM_SELF, str(path), "w", encoding=encoding) as file:
        file.write_mesh(mesh)
        for name, tags in tagged.items():
            tags.name = name
            file.write_meshtags(tags, mesh.geometry)
    return path


def points_apart(folder):
    path = by_dolfinx(folder)
    text = path.read_text()
    geometry = re.search(r"<Geometry.*?</Geometry>", text, re.DOTALL)[0]
    first, last = text.index("<Grid "), text.index("</Grid>")
    text = text[:first] + f'<Grid Name="points" GridType="Uniform">{geometry}' + text[last:]
    pointer = "<xi:include xpointer=\"xpointer(/Xdmf/Domain/Grid[@Name='points']/Geometry)\" />"
    path.write_text(re.sub(r"<xi:include [^>]*/>", pointer, text))
    return path


def points_repeated(folder):
    """Each grid has a pointer to the same points."""
    path = by_dolfinx(folder)
    text = path.read_text()
    geometry = re.search(r"<Geometry.*?</Geometry>", text, re.DOTALL)[0]
    path.write_text(re.sub(r"<xi:include [^>]*/>", geometry, text))
    return path


def compressed(folder):
    path = by_dolfinx(folder)
    text = path.read_text()
    with warnings.catch_warnings(action="ignore"):
        old = netcdf4("a test").Dataset(path.with_suffix(".h5"))
        with old, netcdf4("a test").Dataset(folder / "gz.h5", "w") as new:
            old.set_auto_mask(False)
            for k, place in enumerate(re.findall(r"cubes.h5:(\S+?)<", text)):
                values = old[place][:]
                axes = [
                    new.createDimension(f"axis{k}{n}", size).name
                    for n, size in enumerate(values.shape)
                ]
                new.createVariable(place, values.dtype, axes, zlib=True)[:] = values
    path.write_text(text.replace("cubes.h5", "gz.h5"))
    path.with_suffix(".h5").unlink()
    return path


def mixed_in_xml(folder):
    """All elements in one grid, as meshio writes several kinds: 9 is a hexahedron and 5 a
    quadrilateral.
    """
    cells = [(9, *(k - 1 for k in cube)) for cube in CUBES] + [
        (5, *(k - 1 for k in face)) for face in FACES.values()
    ]

    def item(kind, shape, values):
        numbers = " ".join(str(value) for row in values for value in np.atleast_1d(row))
        return (
            f'<DataItem DataType="{kind}" Dimensions="{shape}" Format="XML" Precision="8">'
            f"{numbers}</DataItem>"
        )

    (folder / "m.xdmf").write_text(
        '<Xdmf Version="3.0"><Domain><Grid Name="Grid"><Geometry GeometryType="XYZ">'
        + item("Float", "16 3", POINTS)
        + '</Geometry><Topology TopologyType="Mixed" NumberOfElements="6">'
        + item("Int", str(sum(map(len, cells))), cells)
        + "</Topology>"
        + '<Attribute Name="tag" AttributeType="Scalar" Center="Cell">'
        + item("Int", "6", NUMBERS)
        + "</Attribute>"
        + "</Grid></Domain></Xdmf>"
    )
    return folder / "m.xdmf"


XDMF = {
    "usual": by_dolfinx,
    "points in a grid of their own": points_apart,
    "points repeated in each grid": points_repeated,
    "numbers in the file": lambda folder: by_dolfinx(folder, ascii_=True),
    "tags in two grids": lambda folder: by_dolfinx(folder, split=True),
    "compressed": compressed,
    "mixed cells in the file": mixed_in_xml,
}


@needs("nonmatching")
@pytest.mark.parametrize("what", XDMF)
def test_xdmf_of_others(what, tmp_path):
    """PETSc is loaded by then, whose HDF5 is another one than netCDF4's."""
    assert pressure(XDMF[what](tmp_path)) == pytest.approx(10.0, rel=1e-9)


def test_xdmf_without_its_numbers(tmp_path):
    path = by_dolfinx(tmp_path)
    path.with_suffix(".h5").unlink()
    with pytest.raises(
        FileContentError,
        match=r"keeps its numbers in cubes\.h5, which is not in .*put it there too",
    ):
        hhr.MeshFile(path)(MPI.COMM_SELF)


def test_packed_and_odd_items_of_xdmf_are_refused(tmp_path):
    path = mixed_in_xml(tmp_path)
    text = path.read_text()
    for more, why in (('Compression="Zlib"', "Zlib"), ('ItemType="HyperSlab"', "HyperSlab")):
        path.write_text(text.replace("<DataItem", f"<DataItem {more}", 1))
        with pytest.raises(
            FileContentError,
            match=f"DataItem of type {why}, which is not understood: write the mesh",
        ):
            hhr.MeshFile(path).read()


@needs("nonmatching")
@pytest.mark.parametrize("kind", ["NETCDF3_64BIT_OFFSET", "NETCDF4"])
def test_blocks_of_faces_and_lines_of_exodus(kind, tmp_path):
    """Blocks of hexahedra, of faces and of a line, as meshio and MOOSE write them."""
    blocks = {1: ("HEX8", [CUBES[0]]), 5: ("BAR2", [(1, 16)]), 2: ("HEX8", [CUBES[1]])}
    blocks |= {n: ("QUAD4", [face]) for n, face in FACES.items() if n != 14}
    # side 6 of the third element of the file, which is the second hexahedron
    path = write_exodus(tmp_path / "c.e", POINTS, blocks, {14: [(3, 6)]}, form=kind)
    assert pressure(path) == pytest.approx(10.0, rel=1e-9)
    assert reasons(path) == {5: "a block of 1 elements of type BAR2, which are no cells"}


EDGES = {
    "C3D10": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "C3D20": EDGES_OF_A_CUBE,
    "CPE6": ((0, 1), (1, 2), (2, 0)),
}
SQUARE = ((0, 0), (1, 0), (1, 1), (0, 1))
CELLS = {
    "CPE6": ([[(0, 0), (1, 0), (1, 1)], [(0, 0), (1, 1), (0, 1)]], ("1, S1", "2, S2")),
    "C3D10": (
        [
            [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
            [(0, 0, 0), (0, 1, 0), (1, 0, 0), (0, 0, -1)],
        ],
        ("2, S3", "1, S3"),
    ),
    "C3D20": (
        [[(x, y, z + w) for w in (0, 1) for x, y in SQUARE] for z in (0, 1)],
        ("1, S1", "2, S2"),
    ),
}


def bar(path, kind, shared, off=0.0):
    """Two cells of second order, whose common sides have one node, or one for each cell, ``off``
    apart.
    """
    cells, (foot, top) = CELLS[kind]
    number, places, rows = {}, [], []

    def node(key, place):
        if key not in number:
            places.append(tuple(place))
            number[key] = len(places)
        return number[key]

    for which, cell in enumerate(cells):
        row = [node(place, place) for place in cell]
        for a, b in EDGES[kind]:
            key = (frozenset((cell[a], cell[b])), 0 if shared else which)
            middle = (np.array(cell[a]) + cell[b]) / 2
            middle[-1] += which * off
            row.append(node(key, middle.tolist()))
        rows.append(row)
    text = nodes_of_deck(places) + f"*ELEMENT, TYPE={kind}, ELSET=BAR\n"
    for k, row in enumerate(rows, 1):
        text += (
            f"{k}, "
            + ",\n".join(", ".join(map(str, row[i : i + 12])) for i in range(0, len(row), 12))
            + "\n"
        )
    path.write_text(text + f"*SURFACE, NAME=FOOT\n{foot}\n*SURFACE, NAME=TOP\n{top}\n")
    return path


def pulled(path, dim):
    up = (0,) * (dim - 1) + (1,)
    scene = block_scene(
        "bar",
        {"pull": (0.0, 10.0)},
        geometry=hhr.MeshFile(path),
        hypothesis="plane_strain" if dim == 2 else "solid",
        bodies=(hhr.Body("BAR", young=1e3, poisson=0.0),),
        contacts=(hhr.Obstacle("TOP", normal=up, offset=9.0),),
        displacements=(
            *hhr.Displacement.clamp("FOOT", dim),
            *hhr.Displacement.clamp("TOP", dim - 1),
        ),
        loads=(hhr.Traction("TOP", up, slope("pull")),),
    )
    return np.abs(
        hhr.FullOrderModel(scene, MPI.COMM_SELF).solve({"pull": 5.0}).displacement()
    ).max()


@pytest.mark.parametrize(("kind", "count"), [("CPE6", 1), ("C3D10", 3), ("C3D20", 4)])
def test_common_sides_with_nodes_at_two_places_are_named(kind, count, tmp_path):
    path = bar(tmp_path / "two.inp", kind, shared=False, off=1e-3)
    with pytest.raises(
        FileContentError, match=rf"^{count} sides? of .*side from \[.*do not meet there"
    ):
        hhr.MeshFile(path)(MPI.COMM_SELF)


@pytest.mark.parametrize("kind", CELLS)
def test_nodes_in_the_middle_of_a_common_side_are_one_where_they_coincide(kind, tmp_path):
    """As in the mesh in which they are shared; of the bar of two bricks p h / E = 5 * 2 / 1000."""
    dim = 2 if kind == "CPE6" else 3
    right, own = (pulled(bar(tmp_path / "bar.inp", kind, shared), dim) for shared in (True, False))
    assert own == pytest.approx(right, rel=1e-9) and (
        kind != "C3D20" or own == pytest.approx(0.01, rel=1e-9)
    )


def test_a_node_of_a_side_that_is_a_corner_is_refused_before_dolfinx_sees_it(tmp_path):
    places = [
        (0, 0),
        (2, 0),
        (0, 2),
        (1, 0),
        (1, 1),
        (0, 1),
        (1, -1),
        (0.5, 0),
        (1, -0.5),
        (0.5, -0.5),
    ]
    cells = "*ELEMENT, TYPE=CPE6, ELSET=A\n1, 1, 2, 3, 4, 5, 6\n2, 1, 7, 4, 10, 9, 8\n"
    with pytest.raises(
        FileContentError, match="that is that of another side or a corner of a cell"
    ):
        hhr.MeshFile(written(tmp_path / "lame.inp", nodes_of_deck(places) + cells))(MPI.COMM_SELF)


@pytest.fixture
def beam(tmp_path):
    return written(
        tmp_path / "beam.inp",
        DECK + "*NSET, NSET=EDGE\n1, 2\n*NSET, NSET=PIN\n1\n" + EXTRA["shell"][0],
    )


def test_a_summary_of_a_file(beam):
    text = summary_of(hhr.MeshFile(beam).read(), beam, scale=2.0).text()
    assert text.startswith(
        "beam.inp: 16 nodes, 2 hexahedra of first order, x 0 to 2, y 0 to 2, z 0 to 4.02\n"
    )
    assert "    UPPER  1 cell, x 0 to 2, y 0 to 2, z 2.02 to 4.02\n" in text
    assert "    SLAVE   1 facet, x 0 to 2, y 0 to 2, z = 2.02\n" in text
    assert "    EDGE  2 nodes, x 0 to 2, y = 0, z = 0\n" in text
    assert text.endswith("    TABLE  1 element of type S4 in it, neither cells nor sides of cells")


def test_a_number_of_a_named_set_stands_after_its_name(beam):
    """As in files of gmsh; a number of other cells, and two names of one set, have a line each."""
    raw = hhr.MeshFile(beam).read()
    upper = raw.bodies["UPPER"]
    lines = summary_of(
        replace(raw, bodies={7: upper, "UPPER": upper, "TOP": upper, 8: raw.bodies["LOWER"]}), beam
    )
    assert [name for name, _ in lines.parts["bodies"]] == ["UPPER (7)", "TOP (7)", "8"]


@needs("nonmatching")
@pytest.mark.parametrize(
    ("tag", "why"),
    [("EDGE", "'EDGE' is in the file: a set of 2 nodes that holds no whole facet"),
     ("TABLE", "'TABLE' is in the file: 1 element of type S4"), ("WHERE", "Name one of these")],
)  # fmt: skip
def test_a_missing_name_is_answered_with_what_the_file_has(tag, why, beam):
    with pytest.raises(SceneError, match=f"no surface of the mesh is called '{tag}'.*") as found:
        pressure(beam, (*NAMES[:3], tag, *NAMES[4:]))
    assert why in str(found.value) and "beam.inp: 16 nodes" in str(found.value)


@needs("nonmatching", "mesh_formats")
def test_missing_numbers_are_answered_with_what_the_file_has(tmp_path):
    with pytest.raises(SceneError, match=r"facet tags \[15\] are not in the mesh") as found:
        pressure(written(tmp_path / "c.bdf", nastran()), (1, 2, 11, 12, 13, 15))
    assert "    14  1 facet, x 0 to 1, y 0 to 1, z = 2.01" in str(found.value)


@needs("scene_checks", "nonmatching")
def test_checks_of_a_scene_and_of_a_file_name_what_is_left_out(beam, tmp_path, monkeypatch):
    from shell import invoke

    from hhr_dolfinx.plugins.scene_checks.check import check_scene

    notes = [
        finding.text
        for finding in check_scene(two_cubes(beam, NAMES)).findings
        if finding.level == "note"
    ]
    assert any("TABLE: 1 element of type S4" in text for text in notes)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    code, said = invoke("check", "beam.inp")
    assert code == 0 and "hhr.MeshFile('beam.inp')" in said
    assert "TABLE  1 element of type S4" in said and "EDGE" in said
    for name, message in (("folder", "ElmerGrid"), ("none.msh", "there is no mesh file none.msh")):
        code, said = invoke("check", name)
        assert code == 3 and message in said, said
    assert invoke("check", "beam.inp", "--at", "load=3")[0] == 2


@needs("scene_checks", "nonmatching")
def test_gaps_of_a_look_are_those_that_are_drawn(tmp_path):
    """Where moduli vary, imposed displacements had closed them already: -0.015 for a mesh that is
    drawn with 0.01.
    """
    from hhr_dolfinx.plugins.scene_checks.check import check_scene

    scene = two_cubes(written(tmp_path / "blocks.inp", DECK), NAMES)
    varying = replace(
        scene,
        parameters=space(down=(0.0, 0.05), E=(500.0, 1500.0)),
        bodies=(hhr.Body("LOWER", "E", 0.0), scene.bodies[1]),
    )
    brought = "as drawn, which imposed displacements bring to -0.015 to -0.015 at down = 0.025"
    for one, said in ((varying, f" {brought}"), (scene, ", facets")):
        (text,) = [item.text for item in check_scene(one).findings if "gaps from" in item.text]
        assert f"gaps from 0.01 to 0.01{said}" in text


# ---------------------------------------------------------------- attacks


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two rectangles in every format of gmsh, with overlapping groups, and a name that a body and a
    line share.
    """
    path = tmp_path_factory.mktemp("meshes")
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    lower, upper = (gmsh.model.occ.addRectangle(0, y, 0, 2, 1) for y in (0, 2))
    gmsh.model.occ.synchronize()
    groups = (
        (2, [lower], "a b"),
        (2, [upper], "upper"),
        (2, [lower, upper], "both"),
        (1, [1, 2], "corner"),
        (1, [5, 6], "upper"),
        (1, [2], "right"),
    )
    for dim, members, name in groups:
        gmsh.model.addPhysicalGroup(dim, members, tag=78 if name == "corner" else -1, name=name)
    gmsh.model.addPhysicalGroup(1, [1], tag=77)
    gmsh.model.mesh.setSize(gmsh.model.getEntities(0), 0.5)
    gmsh.model.mesh.generate(2)
    for version, binary in ((2.2, 1), (4.1, 1), (2.2, 0), (4.1, 0)):
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.write(str(path / f"{version}_{binary}.msh"))
    gmsh.write(str(path / "flat.inp"))
    if MED:
        gmsh.write(str(path / "flat.med"))
        (path / "flat.mmed").write_bytes((path / "flat.med").read_bytes())
    gmsh.finalize()
    return path


@pytest.mark.parametrize(
    "name",
    [
        *(f"{v}_{b}.msh" for v in (2.2, 4.1) for b in (0, 1)),
        *(
            pytest.param(name, marks=(needs_med, needs("mesh_formats")))
            for name in ("flat.med", "flat.mmed")
        ),
        "flat.inp",
    ],
)
def test_groups_of_gmsh_that_overlap_or_share_a_name(name, folder):
    found = hhr.MeshFile(folder / name)(MPI.COMM_SELF)
    assert found[0].topology.index_map(2).size_local == 44
    body = "a_b" if name.endswith("inp") else "a b"
    wanted = [
        (body, 2, 2),
        ("upper", 2, 2),
        ("both", 2, 4),
        ("corner", 1, 3),
        ("upper", 1, 3),
        ("right", 1, 1),
    ]
    # numbers are as good as names, of lines that are in several groups too
    wanted += [(77, 1, 2), (78, 1, 3)] if name.endswith("msh") else []
    for key, dim, size in wanted:
        assert size_of(found, key, dim) == pytest.approx(size, rel=1e-12), key


ODD_DECK = """*HEADING
 a deck, by hand
  ** a comment that is set in
*node, nset="all nodes"
10, , , 0.
20,1.0D+00,0.,
30,1.,\t1.
40,0.,1.
*INCLUDE, INPUT=more.txt
*Element, TYPE=CPE4R,
 ELSET="left part"
7,10,20,
30,40
*ELEMENT, TYPE=CAX4, ELSET=right
 1000,20,50,60,30
*NODE OUTPUT
 U
*Elset, elset=every, generate
7, 1000, 993
*ELSET, ELSET=BOTH
"left part", right
*NSET, NSET=base, GENERATE
10, 20, 10
50, 50, 1
*NSET, NSET=nothing
9999
*SURFACE, NAME="under side", TYPE=ELEMENT
"left part", S1
both, S3
*SURFACE, TYPE=NODE, NAME=knots
base, 1.
*STEP
*END STEP
"""


def test_a_deck_with_every_oddity(tmp_path):
    (tmp_path / "more.txt").write_text("50, 3., 0.\n60, 3., 1.\n*NODE\n99, 7., 7.\n")
    (tmp_path / "deck.inp").write_bytes(b"\xef\xbb\xbf" + ODD_DECK.replace("\n", "\r\n").encode())
    found = hhr.MeshFile(tmp_path / "deck.inp", scale=2.0)(MPI.COMM_SELF)
    assert found[0].geometry.x.shape == (6, 3)
    for name, size in (("left part", 1), ("right", 2), ("BOTH", 3), ("every", 3)):
        assert size_of(found, name, 2) == pytest.approx(4.0 * size), name
    assert size_of(found, "under side", 1) == pytest.approx(2.0 * (1 + 3))
    assert size_of(found, "base", 1) == size_of(found, "knots", 1) == pytest.approx(2.0 * 3)
    assert "nothing" not in {key for key, _ in found.physical_groups}


@pytest.mark.parametrize(("kind", "count"), [("COH2D4", 4), ("AC3D8", 8), ("CCL12", 6)])
def test_elements_that_are_no_solids_are_refused_by_name(kind, count, tmp_path):
    nodes = nodes_of_deck([(n % 2, n // 2 % 2, n // 4) for n in range(count)], 0)
    path = written(
        tmp_path / "d.inp",
        f"{nodes}*ELEMENT, TYPE={kind}\n1, {', '.join(map(str, range(count)))}\n",
    )
    with pytest.raises(FileContentError, match=kind):
        hhr.MeshFile(path)(MPI.COMM_SELF)


def test_sides_of_hexahedra_of_exodus(tmp_path):
    """By the manual: -y, +x, +y, -x, -z, +z, and a set that is empty.

    Areas and the normals that point out.
    """
    corners, lengths = [(0, 0), (1, 0), (1, 1), (0, 1)], np.array([1.0, 2.0, 4.0])
    points = [(*corner, z) for z in (0, 1) for corner in corners] * lengths
    sides = {10 + k: [(1, k)] for k in range(1, 7)} | {17: None}
    path = write_exodus(tmp_path / "box.exo", points, {5: ("HEX8", [range(1, 9)])}, sides)
    found = hhr.MeshFile(path)(MPI.COMM_SELF)
    normal = ufl.FacetNormal(found[0])
    for k, (axis, sign) in enumerate([(1, -1), (0, 1), (1, 1), (0, -1), (2, -1), (2, 1)], 11):
        assert size_of(found, k, 2) == pytest.approx(8.0 / lengths[axis])
        assert size_of(found, k, 2, normal[axis]) == pytest.approx(sign * 8.0 / lengths[axis])


def test_small_cells_far_from_the_origin(tmp_path):
    nodes = nodes_of_deck([(1e6 + 1e-3 * (n % 3), -1e6 + 1e-3 * (n // 3)) for n in range(6)], 0)
    text = f"{nodes}*ELEMENT, TYPE=CPS4, ELSET=b\n1,0,1,4,3\n2,1,2,5,4\n*NSET, NSET=low\n0,1,2\n"
    found = hhr.MeshFile(written(tmp_path / "far.inp", text))(MPI.COMM_SELF)
    assert size_of(found, "b", 2) == pytest.approx(2e-6, rel=1e-6)
    assert size_of(found, "low", 1) == pytest.approx(2e-3, rel=1e-6)


def print_sizes(*paths):
    """Of all groups of mesh files, by the first rank."""
    sizes = {}
    for path in paths:
        found = hhr.MeshFile(path)(MPI.COMM_WORLD)
        sizes |= {
            path + str(key): size_of(found, key, dim) for key, (dim, _) in found.physical_groups
        }
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(sizes))


@needs("ranks")
def test_ranks_have_the_same_surfaces(folder):
    paths = [str(folder / name) for name in ("2.2_1.msh", "flat.inp")]
    program = (
        f"import sys; sys.path[:0] = {folders_of(__file__)!r}; import test_file_contents as t; "
        f"t.print_sizes(*{paths!r})"
    )
    one, three = (json.loads(launch(n, ["-c", program]).splitlines()[-1]) for n in (1, 3))
    assert three == pytest.approx(one, rel=1e-12)
