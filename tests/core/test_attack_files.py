"""Mesh files and decks, attacked: groups that overlap, shared names, odd decks, sides of hexahedra, CalculiX."""

import json

import gmsh
import numpy as np
import pytest
import ufl
from bare import SCENE_FOLDERS
from dolfinx import fem
from launched import launch
from libraries import MED, needs_med
from mpi4py import MPI
from needs import needs
from test_mesh_files import write_exodus

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileContentError


def size_of(found, name, dim, density=1.0):
    """Length, area or volume of what a name stands for, or the integral of a density over it, on all ranks."""
    mesh, cells, facets = found
    (numbers,) = [own for key, (of, own) in found.physical_groups if key == name and of == dim]
    measure, tags = (ufl.dx, cells) if dim == mesh.topology.dim else (ufl.ds, facets)
    form = fem.form(density * fem.Constant(mesh, 1.0) * measure(subdomain_data=tags)(tuple(numbers)))
    return mesh.comm.allreduce(fem.assemble_scalar(form))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two rectangles in every format of gmsh, with overlapping groups, and a name that a body and a line share."""
    path = tmp_path_factory.mktemp("meshes")
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    lower, upper = (gmsh.model.occ.addRectangle(0, y, 0, 2, 1) for y in (0, 2))
    gmsh.model.occ.synchronize()
    for dim, members, name in ((2, [lower], "a b"), (2, [upper], "upper"), (2, [lower, upper], "both"),
                               (1, [1, 2], "corner"), (1, [5, 6], "upper"), (1, [2], "right")):  # fmt: skip
        gmsh.model.addPhysicalGroup(dim, members, tag=78 if name == "corner" else -1, name=name)
    gmsh.model.addPhysicalGroup(1, [1], tag=77)
    gmsh.model.mesh.setSize(gmsh.model.getEntities(0), 0.5)
    gmsh.model.mesh.generate(2)
    for version in (2.2, 4.1):
        for binary in (0, 1):
            gmsh.option.setNumber("Mesh.MshFileVersion", version)
            gmsh.option.setNumber("Mesh.Binary", binary)
            gmsh.write(str(path / f"{version}_{binary}.msh"))
    gmsh.option.setNumber("Mesh.Binary", 0)
    gmsh.write(str(path / "flat.inp"))
    if MED:
        gmsh.write(str(path / "flat.med"))
    gmsh.finalize()
    return path


FILES = [f"{version}_{binary}.msh" for version in (2.2, 4.1) for binary in (0, 1)]


@pytest.mark.parametrize("name", [*FILES, pytest.param("flat.med", marks=needs_med), "flat.inp"])
def test_groups_of_gmsh_that_overlap_or_share_a_name(name, folder):
    found = hhr.MeshFile(folder / name)(MPI.COMM_SELF)
    assert found[0].topology.index_map(2).size_local == 44
    body = "a_b" if name.endswith("inp") else "a b"
    wanted = [(body, 2, 2), ("upper", 2, 2), ("both", 2, 4), ("corner", 1, 3), ("upper", 1, 3), ("right", 1, 1)]
    # numbers are as good as names, of lines that are in several groups too
    wanted += [(77, 1, 2), (78, 1, 3)] if name.endswith("msh") else []
    for key, dim, size in wanted:
        assert size_of(found, key, dim) == pytest.approx(size, rel=1e-12), key


DECK = """*HEADING
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
    (tmp_path / "deck.inp").write_bytes(b"\xef\xbb\xbf" + DECK.replace("\n", "\r\n").encode())
    found = hhr.MeshFile(tmp_path / "deck.inp", scale=2.0)(MPI.COMM_SELF)
    assert found[0].geometry.x.shape == (6, 3)
    for name, size in (("left part", 1), ("right", 2), ("BOTH", 3), ("every", 3)):
        assert size_of(found, name, 2) == pytest.approx(4.0 * size), name
    assert size_of(found, "under side", 1) == pytest.approx(2.0 * (1 + 3))
    assert size_of(found, "base", 1) == size_of(found, "knots", 1) == pytest.approx(2.0 * 3)
    assert "nothing" not in {key for key, _ in found.physical_groups}


@pytest.mark.parametrize(("kind", "count"), [("COH2D4", 4), ("AC3D8", 8), ("CCL12", 6)])
def test_elements_that_are_no_solids_are_refused_by_name(kind, count, tmp_path):
    nodes = "\n".join(f"{n}, {n % 2}, {n // 2 % 2}, {n // 4}" for n in range(count))
    (tmp_path / "d.inp").write_text(f"*NODE\n{nodes}\n*ELEMENT, TYPE={kind}\n1, {', '.join(map(str, range(count)))}\n")
    with pytest.raises(FileContentError, match=kind):
        hhr.MeshFile(tmp_path / "d.inp")(MPI.COMM_SELF)


def test_sides_of_hexahedra_of_exodus(tmp_path):
    """By the manual: -y, +x, +y, -x, -z, +z, and a set that is empty; areas and the normals that point out."""
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
    nodes = "\n".join(f"{n}, {1e6 + 1e-3 * (n % 3):.10f}, {-1e6 + 1e-3 * (n // 3):.10f}" for n in range(6))
    text = f"*NODE\n{nodes}\n*ELEMENT, TYPE=CPS4, ELSET=b\n1,0,1,4,3\n2,1,2,5,4\n*NSET, NSET=low\n0,1,2\n"
    (tmp_path / "far.inp").write_text(text)
    found = hhr.MeshFile(tmp_path / "far.inp")(MPI.COMM_SELF)
    assert size_of(found, "b", 2) == pytest.approx(2e-6, rel=1e-6)
    assert size_of(found, "low", 1) == pytest.approx(2e-3, rel=1e-6)


PROGRAM = """
import json, sys
sys.path[:0] = {folders!r}
import hhr_dolfinx as hhr
import test_attack_files as own
from mpi4py import MPI
sizes = {{}}
for path in {paths!r}:
    found = hhr.MeshFile(path)(MPI.COMM_WORLD)
    sizes |= {{path + str(key): own.size_of(found, key, dim) for key, (dim, _) in found.physical_groups}}
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps(sizes))
"""


@needs("ranks")
def test_ranks_have_the_same_surfaces(folder):
    program = PROGRAM.format(folders=SCENE_FOLDERS, paths=[str(folder / name) for name in ("2.2_1.msh", "flat.inp")])
    one, three = (json.loads(launch(n, ["-c", program]).splitlines()[-1]) for n in (1, 3))
    assert three == pytest.approx(one, rel=1e-12)
