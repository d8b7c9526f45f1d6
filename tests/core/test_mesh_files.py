"""Mesh files: the same mesh, names and answers from every format; sets that overlap.

What cannot be read.
"""

import dataclasses
import shutil

import basix.ufl
import gmsh
import meshio
import numpy as np
import pytest
import ufl
import your_scene
from cubes_in_files import write_exodus
from dolfinx import fem, io
from dolfinx import mesh as dmesh
from mpi4py import MPI
from needs import needs, present
from scenes import largest_difference, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.compat import degree_of
from hhr_dolfinx.errors import FileContentError, SceneError, SceneWarning
from hhr_dolfinx.full_order.discretisation import Discretisation

POINT = {"travel": 0.9, "lowered": 0.0}
MESH = meshio.read(your_scene.MESH)
LINES = {name: tag for name, (tag, dim) in MESH.field_data.items() if dim == 1}


@pytest.fixture(scope="module")
def exact():
    model = hhr.FullOrderModel(your_scene.scene(), MPI.COMM_SELF)
    return model, model.solve(POINT)


def answers_alike(scene, exact):
    """Forces in the order of places along the surfaces, of a scene or its mesh file: nodes may have
    other numbers.
    """
    scene = scene if isinstance(scene, hhr.Scene) else your_scene.scene(scene)
    model, answer = hhr.FullOrderModel(scene, MPI.COMM_SELF), exact[1]
    found = model.solve(POINT)
    np.testing.assert_allclose(
        model.problem.contact_points, exact[0].problem.contact_points, atol=1e-9
    )
    np.testing.assert_allclose(found.forces(), answer.forces(), atol=1e-8 * answer.forces().max())
    assert list(found.outputs().values.values()) == pytest.approx(
        list(answer.outputs().values.values()), rel=1e-8
    )


def by_numbers(scene):
    numbers = {name: int(tag) for name, (tag, _) in MESH.field_data.items()}
    return dataclasses.replace(
        scene,
        bodies=tuple(dataclasses.replace(body, tag=numbers[body.tag]) for body in scene.bodies),
        contacts=tuple(
            hhr.NodeToSurface(*(numbers[tag] for tag in pair.tags)) for pair in scene.contacts
        ),
        displacements=tuple(
            dataclasses.replace(item, tag=numbers[item.tag]) for item in scene.displacements
        ),
    )


@needs("exporters", "nonmatching")
def test_the_deck_that_a_scene_writes_is_the_scene_again(tmp_path, exact):
    from hhr_dolfinx.plugins.exporters.deck import write_deck

    path = tmp_path / "out.inp"
    write_deck(path, Discretisation(your_scene.scene(), MPI.COMM_SELF), POINT)
    answers_alike(path, exact)
    again = tmp_path / "again.inp"
    write_deck(again, Discretisation(your_scene.scene(path), MPI.COMM_SELF), POINT)
    answers_alike(again, exact)


@needs("nonmatching")
def test_the_deck_beside_the_mesh_is_of_the_same_scene(exact):
    answers_alike(your_scene.MESH.with_suffix(".inp"), exact)


@needs("nonmatching")
def test_exodus_by_blocks_and_side_sets(tmp_path, exact):
    blocks = {k: ("TRI3", block.data + 1) for k, block in enumerate(MESH.cells[-3:], start=1)}
    cells = enumerate(np.concatenate([block.data for block in MESH.cells[-3:]]).tolist(), start=1)
    # element and face, from 1 on, by the nodes of a side
    faces = {
        frozenset((cell[k], cell[(k + 1) % 3])): (number, k + 1)
        for number, cell in cells
        for k in range(3)
    }
    marked = [
        item
        for item in zip(MESH.cells, MESH.cell_data["gmsh:physical"], strict=True)
        if item[0].type == "line"
    ]
    sides = {
        k: [
            faces[frozenset(side)]
            for block, own in marked
            for side in block.data[own == tag].tolist()
        ]
        for k, tag in enumerate(LINES.values(), start=10)
    }
    names = dict(zip((*blocks, *sides), ("spring", "roller", "stop", *LINES), strict=True))
    answers_alike(
        write_exodus(tmp_path / "mesh.e", MESH.points[:, :2], blocks, sides, names), exact
    )


@needs("nonmatching")
def test_xdmf_as_dolfinx_writes_it_by_numbers(tmp_path, exact):
    mesh, cells, facets = hhr.MeshFile(your_scene.MESH)(MPI.COMM_SELF)
    cells.name, facets.name = "cells", "facets"
    with io.XDMFFile(MPI.COMM_SELF, str(tmp_path / "mesh.xdmf"), "w") as file:
        file.write_mesh(mesh)
        for tags in (cells, facets):
            mesh.topology.create_connectivity(tags.dim, 2)
            file.write_meshtags(tags, mesh.geometry)
    answers_alike(by_numbers(your_scene.scene(tmp_path / "mesh.xdmf")), exact)


@needs("nonmatching")
def test_numbers_of_the_file_are_as_good_as_names(exact):
    scene = your_scene.scene()
    answers_alike(dataclasses.replace(scene, bodies=by_numbers(scene).bodies), exact)


@needs("nonmatching")
def test_a_file_in_other_units(tmp_path, exact):
    small = meshio.Mesh(
        MESH.points * 1e-3, MESH.cells, cell_data=MESH.cell_data, field_data=MESH.field_data
    )
    meshio.gmsh.write(tmp_path / "m.msh", small, fmt_version="2.2")
    scene = dataclasses.replace(
        your_scene.scene(), geometry=hhr.MeshFile(tmp_path / "m.msh", scale=1e3)
    )
    answers_alike(scene, exact)


def of_second_order(kind, incomplete, folder):
    """Files of a disc, a ball or a cylinder of radius 1 as gmsh meshes it with cells of second
    order.
    """
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.SecondOrderIncomplete", int(incomplete))
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
    if kind in ("quad", "hexahedron"):
        gmsh.option.setNumber("Mesh.RecombineAll", 1)
        gmsh.option.setNumber("Mesh.SubdivisionAlgorithm", 1)
    occ, dim = gmsh.model.occ, 3 if kind in ("tetra", "hexahedron") else 2
    made = (
        [(3, occ.addSphere(0, 0, 0, 1))] if kind == "tetra" else [(2, occ.addDisk(0, 0, 0, 1, 1))]
    )
    if kind == "hexahedron":
        made = [
            item
            for item in occ.extrude(made, 0, 0, 1, numElements=[2], recombine=True)
            if item[0] == 3
        ]
    occ.synchronize()
    gmsh.model.addPhysicalGroup(dim, [tag for _, tag in made], name="body")
    gmsh.model.addPhysicalGroup(
        dim - 1, [tag for _, tag in gmsh.model.getBoundary(made, oriented=False)], name="skin"
    )
    gmsh.model.mesh.generate(dim)
    gmsh.model.mesh.setOrder(2)
    files = []
    for name, version in (("4.msh", 4.1), ("2.msh", 2.2), ("m.inp", 0), ("m.unv", 0)):
        if version:
            gmsh.option.setNumber("Mesh.MshFileVersion", version)
        if name != "m.unv" or (
            incomplete and present("mesh_formats")
        ):  # of quadrilaterals of nine nodes it keeps the corners
            files.append(folder / name)
            gmsh.write(str(files[-1]))
    gmsh.finalize()
    read = meshio.read(folder / "2.msh")
    files.append(folder / "m.vtu")
    meshio.write(
        files[-1], meshio.Mesh(read.points, [block for block in read.cells if block.dim == dim])
    )
    return files


def test_cells_of_third_order_are_refused_with_the_order(tmp_path):
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.addPhysicalGroup(2, [gmsh.model.occ.addDisk(0, 0, 0, 1, 1)], name="disc")
    gmsh.model.occ.synchronize()
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(3)
    for version, why in (
        (2.2, r"of order 1 or 2: mesh with .* by setOrder\(2\)"),
        (4.1, r"10 nodes, and those of order 1"),
    ):
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.write(str(tmp_path / "m.msh"))
        with pytest.raises(FileContentError, match=why):
            hhr.MeshFile(tmp_path / "m.msh").read()
    gmsh.finalize()


@needs("mesh_formats")
@pytest.mark.parametrize(
    ("kind", "incomplete", "exact"),
    [
        ("triangle", False, (np.pi, 2 * np.pi)),
        ("quad", False, (np.pi, 2 * np.pi)),
        ("quad", True, (np.pi, 2 * np.pi)),
        ("tetra", False, (4 / 3 * np.pi, 4 * np.pi)),
        ("hexahedron", False, (np.pi, 4 * np.pi)),
        ("hexahedron", True, (np.pi, 4 * np.pi)),
    ],
)
def test_cells_of_second_order_keep_their_curved_sides(kind, incomplete, exact, tmp_path):
    """Area and volume of a disc of chords of .5 are a few per cent off by its corners.

    2e-4 was measured at most.
    """
    for path in of_second_order(kind, incomplete, tmp_path):
        mesh, _, facets, *_ = hhr.MeshFile(path)(MPI.COMM_SELF)
        assert degree_of(mesh) == 2, path
        one = fem.Constant(mesh, 1.0)
        sizes = [
            fem.assemble_scalar(fem.form(one * measure(mesh, degree=6)))
            for measure in (ufl.dx, ufl.ds)
        ]
        np.testing.assert_allclose(sizes, exact, rtol=1e-3, err_msg=str(path))
        if path.suffix != ".vtu":  # meshio writes no names there
            mesh.topology.create_connectivity(mesh.topology.dim - 1, mesh.topology.dim)
            np.testing.assert_array_equal(
                facets.indices, dmesh.exterior_facet_indices(mesh.topology), err_msg=str(path)
            )


def test_nodes_on_sides_in_another_order_and_cells_of_two_orders_are_refused(tmp_path):
    points = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0], [0.5, 0.5], [0, 0.5], [1, 1]], dtype=float)
    points = np.pad(points, ((0, 0), (0, 1)))
    for cells, why in (
        ([("triangle6", [[0, 1, 2, 4, 5, 3]])], "their nodes in an order that is not understood"),
        (
            [("triangle6", [[0, 1, 2, 3, 4, 5]]), ("triangle", [[1, 6, 2]])],
            "have 3 or 6 nodes: .* with cells of one order",
        ),
    ):
        meshio.write(tmp_path / "m.vtk", meshio.Mesh(points, cells))
        with pytest.raises(FileContentError, match=why):
            hhr.MeshFile(tmp_path / "m.vtk")(MPI.COMM_SELF)


@pytest.mark.parametrize("name", ["m.e", "m.g", "m.exo"])
def test_second_order_from_exodus(name, tmp_path):
    points = np.array([[0, 1, 0, 0.5, 0.6, 0], [0, 0, 1, 0, 0.6, 0.5]]).T
    raw = hhr.MeshFile(
        write_exodus(tmp_path / name, points, {1: ("TRI6", [[1, 2, 3, 4, 5, 6]])})
    ).read()
    # edges of DOLFINx lie opposite of the corners
    np.testing.assert_array_equal(raw.whole()[1], [[0, 1, 2, 4, 5, 3]])


def test_second_order_from_xdmf(tmp_path):
    points = np.array([[0, 0], [1, 0], [0, 1], [0.6, 0.6], [0, 0.5], [0.5, 0]], dtype=float)
    domain = ufl.Mesh(basix.ufl.element("Lagrange", "triangle", 2, shape=(2,)))
    curved = dmesh.create_mesh(MPI.COMM_SELF, cells=np.arange(6)[None], x=points, e=domain)
    curved.topology.create_connectivity(1, 2)
    tags = dmesh.meshtags(curved, 1, np.arange(3, dtype=np.int32), np.arange(3, dtype=np.int32))
    tags.name = "facets"
    with io.XDMFFile(MPI.COMM_SELF, str(tmp_path / "m.xdmf"), "w") as file:
        file.write_mesh(curved)
        file.write_meshtags(tags, curved.geometry)
    mesh, _, facets, *_ = hhr.MeshFile(tmp_path / "m.xdmf")(MPI.COMM_SELF)
    assert degree_of(mesh) == 2 and len(facets.indices) == 3


TRIANGLE = "*Node\n1,0,0\n2,1,0\n3,0,1\n4,1,1\n*Element,type=CPE3,elset=a\n1,1,2,3\n"
LINE = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n2\n1 0 0 0\n2 1 0 0\n$EndNodes\n"
LINE += "$Elements\n1\n1 1 2 1 1 1 2\n$EndElements\n"
WRONG = {
    "nothing.msh": (None, "there is no mesh file .*nothing.msh: .* has other.msh"),
    "text.msh": ("not a mesh", "text.msh cannot be read.*Couldn't read file"),
    "line.msh": (LINE, r"has cells of kinds \['line'\], .*of a format that is not understood"),
    "empty.inp": ("*Heading\n", "has no elements of the plane or of space"),
    "parts.inp": ("*Instance, name=A, part=P\n1, 2, 3\n", "line 1: there is no part 'P' before it"),
    "set.inp": (
        "*Node\n1, 0, 0\n*Nset, nset=a\nnone\n",
        "line 3: there is no set 'none' before it",
    ),
    "lost.inp": (
        "*Node\n1, 0, 0\n*Element, type=CPE3, elset=a\n1, 1, 2, 3\n",
        "element 1 has a node that is not in",
    ),
    "face.inp": (TRIANGLE + "*Surface, name=s\na, S5\n", "surface 's': 'a, S5' is no face"),
    "mixed.inp": (
        TRIANGLE + "*Element,type=CPE4\n2,1,2,4,3\n",
        "mixes quadrilaterals and triangles, 1 and 1 of them, and.*SubdivisionAlgorithm = 1",
    ),
    "prism.inp": (
        (
            "*Node\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n5,1,0,1\n6,0,1,1\n"
            "*Element,type=C3D6\n1,1,2,3,4,5,6\n"
        ),
        (
            "has prisms, and a mesh must have cells of one kind: .*SubdivisionAlgorithm = 2 for "
            "hexahedra"
        ),
    ),
    "twice.inp": (TRIANGLE + "2,1,1,3\n", "1 of 2 triangles have a node twice"),
    "no.xdmf": ("<Xdmf><Domain/></Xdmf>", "has no grid of triangles"),
    "bad.xdmf": ("<Xdmf>", "is no XDMF"),
}


@pytest.mark.parametrize("name", WRONG)
def test_files_that_are_no_meshes_are_refused_with_the_reason(name, tmp_path):
    text, message = WRONG[name]
    shutil.copy(your_scene.MESH, tmp_path / "other.msh")
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(FileContentError, match=message):
        hhr.MeshFile(tmp_path / name)(MPI.COMM_SELF)


@pytest.mark.parametrize("version", [2.2, 4.1])
def test_groups_of_reversed_entities_have_their_names(version, tmp_path):
    """Manual of gmsh: ``Physical Curve("floor", 5) = {-1}`` has line 1 with reversed orientation in
    group 5.
    """
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.model.occ.addRectangle(0, 0, 0, 2, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(1, [-1], 5, name="floor")
    gmsh.model.addPhysicalGroup(1, [-3, 3], 6, name="lid")
    gmsh.model.addPhysicalGroup(2, [-1], 7, name="body")
    gmsh.model.mesh.generate(2)
    gmsh.write(str(tmp_path / "turned.msh"))
    gmsh.finalize()
    read = hhr.MeshFile(tmp_path / "turned.msh").read()
    assert read.bodies.keys() == {7, "body"} and read.surfaces.keys() == {5, "floor", 6, "lid"}
    assert len(read.bodies["body"]) == len(read.cells)
    for name, height in (("floor", 0.0), ("lid", 1.0)):
        assert np.ptp(read.points[read.surfaces[name]][:, :, 0]) == pytest.approx(2.0)
        assert (read.points[read.surfaces[name]][:, :, 1] == height).all()


@pytest.mark.parametrize("version", [2.2, 4.1])
def test_prisms_are_called_prisms(version, tmp_path):
    """Their sides are plane cells, which were taken for the mesh: a shell."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.MeshSizeMin", 1.0)
    ground = gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
    gmsh.model.occ.extrude([(2, ground)], 0, 0, 1, numElements=[1], recombine=True)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [1], name="body")
    gmsh.model.addPhysicalGroup(2, [ground], name="ground")
    gmsh.model.mesh.generate(3)
    gmsh.write(str(tmp_path / "prisms.msh"))
    gmsh.finalize()
    with pytest.raises(FileContentError, match=r"prisms\.msh has prisms, and .*tetrahedra, or "):
        hhr.MeshFile(tmp_path / "prisms.msh")(MPI.COMM_SELF)


WORDS = {(3,): "path 3 of a mesh file", ("a.msh", 0.0): "scale 0.0", ("a.msh", "mm"): "scale 'mm'"}


@pytest.mark.parametrize("given", WORDS)
def test_arguments_that_are_none(given):
    with pytest.raises(SceneError, match=WORDS[given]):
        hhr.MeshFile(*given)


@needs("nonmatching")
def test_names_in_a_scene_whose_mesh_has_none():
    scene = dataclasses.replace(
        your_scene.scene(), geometry=lambda comm: tuple(hhr.MeshFile(your_scene.MESH)(comm))
    )
    with pytest.raises(
        SceneError, match="no surface of the mesh has a name, and 'clamp' is requested"
    ):
        hhr.FullOrderModel(scene)


@needs("nonmatching")
def test_a_model_by_names_is_saved_and_read(tmp_path):
    with pytest.warns(UserWarning):  # few answers
        model = hhr.train(your_scene.scene(), hhr.Sobol(16), comm=MPI.COMM_SELF).build()
    hhr.save_model(tmp_path / "m.npz", model)
    again = hhr.load_model(tmp_path / "m.npz").solve(POINT)
    assert largest_difference(again.multipliers, model.solve(POINT).multipliers) < 1e-12


@needs("floating", "nonmatching")
def test_a_roller_that_nothing_but_contact_holds_is_named(tmp_path):
    scene = your_scene.scene()
    free = tuple(item for item in scene.displacements if item.tag != "roller_flat")
    load = hhr.Traction("roller_flat", (0.0, -1.0), slope("travel", 3.0))
    with pytest.warns(SceneWarning, match="body roller .* which no contact resists"):
        model = hhr.FullOrderModel(
            dataclasses.replace(scene, displacements=free, loads=(load,)), MPI.COMM_SELF
        )
    answer = model.solve({"travel": 0.5, "lowered": 0.0})
    assert answer.outputs()["force on the roller"] == pytest.approx(
        0.5 * 3.0 * 20 * np.sin(np.pi / 3), rel=1e-10
    )
