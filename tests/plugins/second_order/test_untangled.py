"""Folded cells of second order: mended, said, and refused where their corners are folded."""

import re
import sys
from dataclasses import replace

import gmsh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from libraries import MED
from mpi4py import MPI
from needs import needs
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.command.loading import scene_of
from hhr_dolfinx.errors import (
    FileContentError,
    MeshWarning,
    MissingPackageError,
    SceneError,
    SceneWarning,
)
from hhr_dolfinx.geometries.cells import DIMENSION, EDGES, FACES, outer_faces_of_cells
from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.second_order import by_gmsh
from hhr_dolfinx.plugins.second_order.untangled import folded, mended

KINDS = sorted(DIMENSION)
ELEMENTS = {
    "triangle": "CPE6",
    "quadrilateral": "CPE8",
    "tetrahedron": "C3D10",
    "hexahedron": "C3D20",
}
YOUNG, POISSON = 1000.0, 0.3


def lattice(kind, counts):
    """Corners of a unit box and its cells."""
    dim = len(counts)
    shape = [count + 1 for count in counts]
    points = np.stack(
        np.meshgrid(*(np.linspace(0, 1, n) for n in shape), indexing="ij"), axis=-1
    ).reshape(-1, dim)
    number = np.arange(len(points)).reshape(shape)
    low = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, dim)
    around = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    if dim == 3:
        around = np.vstack([np.column_stack([around, np.full(4, height)]) for height in (0, 1)])
    boxes = number[tuple(np.moveaxis(low[:, None] + around, -1, 0))]
    parts = {
        "triangle": [(0, 1, 2), (0, 2, 3)],
        "tetrahedron": [
            (0, 1, 2, 6),
            (0, 2, 3, 6),
            (0, 3, 7, 6),
            (0, 7, 4, 6),
            (0, 4, 5, 6),
            (0, 5, 1, 6),
        ],
    }
    return points, np.vstack([boxes[:, part] for part in parts[kind]]) if kind in parts else boxes


def of_second_order(kind, counts, place=lambda points: points, bend=lambda points: points):
    """A box whose corners are moved by ``place``, and whose nodes on straight sides by ``bend``."""
    points, cells = lattice(kind, counts)
    points = place(points)
    ends = np.sort(cells[:, np.array(EDGES[kind])], axis=2)
    every, which = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
    whole = np.vstack([points, bend(points[every])])
    sides = len(points) + which.reshape(ends.shape[:2])
    return RawMesh(whole, kind, cells, {"BODY": np.arange(len(cells))}, sides=sides)


def straight(ends):
    return ends.mean(axis=1)


def shifted(ends):
    """Middles of sides; those of sides along x in the inside move along them by .3 of their length:
    folded cells.
    """
    inside = ((ends > 0.01) & (ends < 0.99)).all(axis=(1, 2))
    along = np.ptp(ends, axis=1)
    moved = inside & (along[:, 1:] < 1e-9).all(axis=1)
    assert moved.any()
    return ends.mean(axis=1) + 0.3 * moved[:, None] * along


def written(path, raw, surfaces):
    """A deck of Abaqus with a mesh and surfaces, each a condition on the corners of facets, (f, k,
    dim): (f,).
    """
    rows = [
        "*NODE",
        *(f"{n}, {', '.join(map(repr, place))}" for n, place in enumerate(raw.points.tolist(), 1)),
    ]
    rows.append(f"*ELEMENT, TYPE={ELEMENTS[raw.kind]}, ELSET=BODY")
    for n, nodes in enumerate(np.hstack([raw.cells, raw.sides]).tolist(), 1):
        first, last = [n, *(node + 1 for node in nodes)][:11], [node + 1 for node in nodes][10:]
        rows.append(", ".join(map(str, first)) + ("," if last else ""))
        rows += [", ".join(map(str, last))] if last else []
    facets, owners = outer_faces_of_cells(raw.kind, raw.cells)
    for name, held in surfaces.items():
        rows.append(f"*SURFACE, NAME={name}")
        for facet, owner in zip(
            facets[held(raw.points[facets])], owners[held(raw.points[facets])], strict=True
        ):
            face = [set(raw.cells[owner][list(one)]) for one in FACES[raw.kind]].index(set(facet))
            rows.append(f"{owner + 1}, S{face + 1}")
    path.write_text("\n".join(rows) + "\n")
    return path


def on(axis, value):
    return lambda corners: np.isclose(corners[:, :, axis], value).all(axis=1)


def block(path, kind, bend):
    """A unit block with surfaces on its sides x = 0, y = 0 (z = 0), and its top."""
    raw = of_second_order(kind, (3,) * DIMENSION[kind], bend=bend)
    named = {f"LOW{k}": on(k, 0.0) for k in range(raw.dim)} | {"TOP": on(raw.dim - 1, 1.0)}
    return written(path, raw, named)


def pressed(geometry, dim):
    """The block under a pressure, on a rigid plane, its low sides slide."""
    last = dim - 1
    return hhr.Scene(
        name="block",
        geometry=geometry,
        hypothesis="solid" if dim == 3 else "plane_strain",
        bodies=(hhr.Body("BODY", young=YOUNG, poisson=POISSON),),
        contacts=(hhr.Obstacle(f"LOW{last}", normal=(*[0.0] * last, -1.0), offset=0.0),),
        displacements=tuple(hhr.Displacement(f"LOW{k}", k) for k in range(last)),
        loads=(hhr.Pressure("TOP", "p"),),
        parameters=hhr.ParameterSpace(("p",), (1.0,), (3.0,)),
    )


@needs("floating")
@pytest.mark.parametrize("how", ["straight", "gmsh"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_mended_mesh_passes_the_patch_test(kind, how, tmp_path):
    """A uniform stress: displacements are linear, 1e-12 was measured.

    Without mending the scene is refused.
    """
    path = block(tmp_path / "block.inp", kind, shifted)
    dim = DIMENSION[kind]
    with pytest.raises(
        SceneError, match=r"folded or turned inside out.*hhr\.Untangled\('/.*block\.inp'\)"
    ):
        hhr.FullOrderModel(pressed(hhr.MeshFile(path), dim), MPI.COMM_SELF)
    with pytest.warns(
        MeshWarning, match=r"cells of .*block\.inp were folded or nearly so.*\((straight|gmsh)\): "
    ):
        full = hhr.FullOrderModel(pressed(hhr.Untangled(path, how=how), dim), MPI.COMM_SELF)
    answer = full.solve({"p": 2.0})
    np.testing.assert_allclose(answer.forces() / full.problem.contact_areas, 2.0, rtol=1e-10)
    # strains under -p along the last axis; in the plane the strain across it is zero
    axial = -(1 - POISSON**2) / YOUNG if dim == 2 else -1 / YOUNG
    across = POISSON * (1 + POISSON) / YOUNG if dim == 2 else POISSON / YOUNG
    strain = 2.0 * np.array([across] * (dim - 1) + [axial])
    np.testing.assert_allclose(
        answer.displacement().reshape(-1, dim), full.problem.points[:, :dim] * strain, atol=1e-12
    )


@pytest.mark.parametrize("kind", KINDS)
def test_only_nodes_on_sides_of_folded_cells_move(kind):
    """Corners and the outer surface stay, and so does each node that is on no folded cell or its
    neighbours.
    """
    raw = of_second_order(kind, (3,) * DIMENSION[kind], bend=shifted)
    first = folded(raw)
    found, bad, _ = mended(raw, "block")
    assert first.size and np.isin(first, bad).all() and not folded(found).size
    moved = np.flatnonzero((found.points != raw.points).any(axis=1))
    assert np.isin(moved, raw.sides[bad]).all() and not np.isin(moved, raw.cells).any()
    # a fold by a shift of a part s of the side ends at s = 1/4, where the Jacobian at one end is 0,
    # before the middle
    middles = of_second_order(kind, (3,) * DIMENSION[kind], bend=straight).points
    left = (
        np.linalg.norm(found.points - middles, axis=1)[moved]
        / np.linalg.norm(raw.points - middles, axis=1)[moved]
    )
    assert (left * 0.3 < 0.25).all() and (left > 0.5).all()
    again, none, _ = mended(found, "block")
    assert not none.size
    np.testing.assert_array_equal(again.points, found.points)


HOLE, RIM, LAYER = 1.0, 4.0, 0.05


def ring(kind, cells=(2, 4), layer=LAYER):
    """A quarter of a disc with a hole, as generators curve it: the nodes on the hole and on the rim
    are on circles.

    The first layer at the hole is thinner than its arcs are high, .076 of the radius with two
    cells.
    """
    rows = np.array([HOLE, HOLE + layer, 1.4, 2.2, RIM])

    def place(points):
        angle, radius = (
            points[:, 0] * np.pi / 2,
            np.interp(points[:, 1], np.linspace(0, 1, len(rows)), rows),
        )
        flat = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        return np.column_stack([flat, points[:, 2:]])

    def bend(ends):
        found = straight(ends)
        lengths = np.linalg.norm(ends[..., :2], axis=2)
        for radius in (HOLE, RIM):
            own = np.isclose(lengths, radius).all(axis=1)
            found[own, :2] *= (radius / np.linalg.norm(found[own, :2], axis=1))[:, None]
        return found

    return of_second_order(kind, (*cells, 1)[: DIMENSION[kind]], place, bend)


def round_at(radius):
    return lambda corners: np.isclose(np.linalg.norm(corners[..., :2], axis=2), radius).all(axis=1)


def disc(path, kind):
    raw = ring(kind)
    flat = {"LOW0": on(0, 0.0), "LOW1": on(1, 0.0), "RIM": round_at(RIM), "HOLE": round_at(HOLE)}
    return written(
        path, raw, flat | ({"LOW2": on(2, 0.0), "HIGH2": on(2, 1.0)} if raw.dim == 3 else {})
    )


def squeezed(geometry, dim):
    """The disc in plane strain under a pressure on its rim; the side y = 0 lies on a rigid
    plane.
    """
    return hhr.Scene(
        name="disc",
        geometry=geometry,
        hypothesis="solid" if dim == 3 else "plane_strain",
        bodies=(hhr.Body("BODY", young=YOUNG, poisson=POISSON),),
        contacts=(hhr.Obstacle("LOW1", normal=(0.0, -1.0, 0.0)[:dim], offset=0.0),),
        displacements=(
            hhr.Displacement("LOW0", 0),
            *(hhr.Displacement(name, 2) for name in ("LOW2", "HIGH2")[: 2 * (dim - 2)]),
        ),
        loads=(hhr.Pressure("RIM", "p"),),
        parameters=hhr.ParameterSpace(("p",), (1.0,), (3.0,)),
    )


@needs("floating")
@pytest.mark.parametrize("how", ["straight", "gmsh"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_disc_with_a_hole_that_folds_its_cells(kind, how, tmp_path):
    """The contact carries p R, and the rim moves by u of Lame."""
    dim = DIMENSION[kind]
    path = disc(tmp_path / "disc.inp", kind)
    assert folded(hhr.MeshFile(path).read()).size
    with pytest.warns(MeshWarning, match=how):
        full = hhr.FullOrderModel(squeezed(hhr.Untangled(path, how=how), dim), MPI.COMM_SELF)
    answer = full.solve({"p": 2.0})
    # the rim of a mesh is made of parabolas, of which the ends are exact: so is the resultant
    assert answer.forces().sum() == pytest.approx(2.0 * RIM, rel=1e-9)
    rim = np.flatnonzero(
        np.isclose(full.problem.points[:, 0], RIM) & (full.problem.points[:, 1] == 0.0)
    )
    lame = (1 - 2 * POISSON) * RIM + HOLE**2 / RIM
    lame *= -2.0 * RIM**2 * (1 + POISSON) / (YOUNG * (RIM**2 - HOLE**2))
    np.testing.assert_allclose(answer.displacement().reshape(-1, dim)[rim, 0], lame, rtol=0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_gmsh_keeps_curved_surfaces_and_those_between_bodies(kind):
    """Nodes on the hole, on the rim, and of two bodies stay; straightening moves the hole."""
    raw = ring(kind)
    angles = np.arctan2(*raw.points[raw.cells].mean(axis=1).T[1::-1])
    raw = replace(
        raw,
        bodies={
            "LOW": np.flatnonzero(angles < np.pi / 4),
            "HIGH": np.flatnonzero(angles > np.pi / 4),
        },
    )
    found, bad, straightened = mended(raw, "disc", "gmsh")
    assert bad.size and not folded(found).size
    # gmsh 4.13 leaves two of the hexahedra folded, which are straightened
    assert not straightened.size or tuple(map(int, gmsh.__version__.split(".")[:2])) < (4, 14)
    radius = np.linalg.norm(raw.points[:, :2], axis=1)
    round_nodes = np.isclose(radius, HOLE) | np.isclose(radius, RIM)
    held = round_nodes | np.isclose(raw.points[:, 0], raw.points[:, 1])
    held[np.asarray(raw.sides)[straightened]] = False
    np.testing.assert_allclose(found.points[held], raw.points[held], atol=1e-12)
    if raw.dim == 3:
        caps = np.isclose(raw.points[:, 2] % 1.0, 0.0)
        np.testing.assert_allclose(found.points[caps, 2], raw.points[caps, 2], atol=1e-9)
    straight_ones = mended(raw, "disc").raw.points
    moves = np.linalg.norm(straight_ones - raw.points, axis=1)
    assert (
        moves[np.isclose(radius, HOLE)].max() > 0.01 and not moves[~np.isclose(radius, HOLE)].any()
    )


def test_nodes_that_match_still_match():
    """Two bodies with nodes at the same places, one of them folded at their common surface: both
    follow.
    """
    low, high = ring("quadrilateral"), ring("quadrilateral", layer=0.3)
    count = len(low.points)
    both = RawMesh(
        np.vstack([low.points, high.points]),
        low.kind,
        np.vstack([low.cells, high.cells + count]),
        {"LOW": np.arange(8), "HIGH": np.arange(8, 16)},
        sides=np.vstack([low.sides, high.sides + count]),
    )
    assert (folded(both) < 8).all() and folded(both).size
    found = mended(both, "discs").raw.points
    hole = np.isclose(np.linalg.norm(low.points, axis=1), HOLE)
    assert (found[:count] != low.points)[hole].any()
    np.testing.assert_array_equal(found[:count][hole], found[count:][hole])


def inverted(path, kind):
    """A block of which one inner corner is beyond the next one: cells are folded by their
    corners.
    """

    def place(points):
        corner = np.isclose(points, 1 / 3).all(axis=1)
        return points + 0.5 * corner[:, None] * np.eye(points.shape[1])[0]

    raw = of_second_order(kind, (3,) * DIMENSION[kind], place, straight)
    return written(
        path,
        raw,
        {"LOW0": on(0, 0.0), f"LOW{raw.dim - 1}": on(raw.dim - 1, 0.0), "TOP": on(raw.dim - 1, 1)},
    )


@pytest.mark.parametrize("how", ["straight", "gmsh"])
@pytest.mark.parametrize("kind", ["quadrilateral", "hexahedron"])
def test_folded_corners_are_refused(kind, how, tmp_path):
    path = inverted(tmp_path / "block.inp", kind)
    with pytest.raises(
        FileContentError,
        match=r"\d+ cells of .*block\.inp are folded by their corners alone, .*around",
    ):
        hhr.Untangled(path, how=how).read()


@needs("floating")
@pytest.mark.parametrize("kind", ["triangle", "tetrahedron"])
def test_inverted_simplices_are_refused_by_the_scene(kind, tmp_path):
    path = inverted(tmp_path / "block.inp", kind)
    with pytest.raises(
        SceneError, match=r"\d+ pairs of neighbouring cells lie on the same side .* at \["
    ):
        hhr.FullOrderModel(pressed(hhr.Untangled(path), DIMENSION[kind]), MPI.COMM_SELF)


def test_arguments(tmp_path):
    """Other ways and cells of first order; a mesh file is wrapped with its scale.

    Without gmsh the extra is named.
    """
    with pytest.raises(
        SceneError, match=r"how='elastic' of Untangled.* must be 'straight' or 'gmsh'"
    ):
        hhr.Untangled("part.msh", how="elastic")
    with pytest.raises(SceneError, match="must be a text or a Path"):
        hhr.Untangled(3)
    path = disc(tmp_path / "disc.inp", "triangle")
    geometry = hhr.Untangled(hhr.MeshFile(path, scale=1e-3))
    assert geometry.scale == 1e-3 and geometry == hhr.Untangled(hhr.MeshFile(path, scale=1e-3))
    with pytest.warns(MeshWarning, match=r"at most, on the outside of bodies by \d\.\d+e-05"):
        mesh = geometry(MPI.COMM_SELF)[0]
    assert np.linalg.norm(mesh.geometry.x, axis=1).max() == pytest.approx(RIM * 1e-3, rel=1e-12)
    text = path.read_text().replace("CPE6", "CPE3")
    path.write_text(
        "\n".join(
            line.rsplit(",", 3)[0] if line.count(",") == 6 else line for line in text.split("\n")
        )
    )
    with pytest.warns(
        SceneWarning, match="has no effect on .*disc.inp, whose cells are of first order"
    ):
        hhr.Untangled(path).read()


def test_without_gmsh(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "gmsh", None)
    path = disc(tmp_path / "disc.inp", "triangle")
    with pytest.raises(
        MissingPackageError,
        match=r"how='gmsh'.* needs the package gmsh.*pip install hhr_dolfinx\[mesh\]",
    ):
        hhr.Untangled(path, how="gmsh").read()


def drilled(path):
    """A plate with a hole by a CAD kernel, whose sides are curved there: cells at the hole are thin
    and fold.
    """
    import gmsh

    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        kernel, mesh = gmsh.model.occ, gmsh.model.mesh
        plate, hole = kernel.addRectangle(-3, -3, 0, 6, 6), kernel.addDisk(0, 0, 0, 1, 1)
        kernel.cut([(2, plate)], [(2, hole)])
        turns = np.pi / 8 + np.arange(8) * np.pi / 4
        points = [kernel.addPoint(1.03 * np.cos(turn), 1.03 * np.sin(turn), 0) for turn in turns]
        kernel.synchronize()
        mesh.embed(0, points, 2, plate)
        circle = [
            tag for _, tag in gmsh.model.getEntitiesInBoundingBox(-1.1, -1.1, -1, 1.1, 1.1, 1, 1)
        ]
        mesh.setTransfiniteCurve(circle[0], 9)
        gmsh.model.addPhysicalGroup(2, [plate], name="BODY")
        gmsh.model.addPhysicalGroup(1, circle, name="HOLE")
        mesh.generate(2)
        mesh.setOrder(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()
    return path


@needs("mesh_formats")
@pytest.mark.parametrize(
    "ending", [".msh", pytest.param(".med", marks=pytest.mark.skipif(not MED, reason="no MED"))]
)
@pytest.mark.parametrize("how", ["straight", "gmsh"])
def test_a_hole_of_a_cad_kernel(ending, how, tmp_path):
    """Its area is that within parabolas through three points of circles, 2/3 of an arc's height
    times its chord.
    """
    path = drilled(tmp_path / f"plate{ending}")
    raw = hhr.MeshFile(path).read()
    assert folded(raw).size
    with pytest.warns(MeshWarning, match=how):
        mesh = hhr.Untangled(path, how=how)(MPI.COMM_SELF)[0]
    chord, height = 2 * np.sin(np.pi / 8), 1 - np.cos(np.pi / 8)
    polygon = 4 * np.sin(np.pi / 4)
    area = fem.assemble_scalar(fem.form(fem.Constant(mesh, 1.0) * ufl.dx))
    exact = 36 - polygon - 8 * 2 / 3 * chord * height
    if how == "gmsh":
        assert area == pytest.approx(exact, rel=1e-12)
    else:  # a part of the height is lost at all eight arcs
        assert 0.1 < (area - exact) / (8 * 2 / 3 * chord * height) < 0.7


@needs("decks", "scene_checks")
@pytest.mark.parametrize("kind", ["quadrilateral", "tetrahedron"])
def test_start_writes_it_and_check_names_it(kind, tmp_path):
    """A folded deck runs without an edit; its mesh alone is said to be folded."""
    path = block(tmp_path / "block.inp", kind, shifted)
    code, said = invoke("check", path)
    assert code == 0 and re.search(
        r"cells of second order are folded, .*: take hhr.Untangled\('.*block.inp'\)", said
    )
    assert "MeshFile" not in said
    dim = DIMENSION[kind]
    steel = "*MATERIAL, NAME=M\n*ELASTIC\n1000., 0.3\n*SOLID SECTION, ELSET=BODY, MATERIAL=M\n"
    held = "".join(f"LOW{k}, {k + 1}, {k + 1}\n" for k in range(dim))
    path.write_text(
        f"{path.read_text()}{steel}*BOUNDARY\n{held}*STEP\n*STATIC\n*DSLOAD\nTOP, P, 2.\n*END "
        "STEP\n"
    )
    code, said = invoke("start", path)
    assert code == 0 and "cells are folded, and hhr.Untangled moves the middles" in " ".join(
        said.split()
    ), said
    scene = scene_of(str(path.with_suffix(".py")))
    assert scene.geometry == hhr.Untangled(path)
    with pytest.warns(MeshWarning, match=r"block\.inp were folded"):
        full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    moved = full.solve(scene.parameters.middle).displacement().reshape(-1, dim)[:, -1]
    top = np.isclose(full.problem.points[:, dim - 1], 1.0)
    np.testing.assert_allclose(
        moved[top], -0.002 * (1.0 if dim == 3 else 1 - POISSON**2), rtol=1e-9
    )
    code, said = invoke("check", path.with_suffix(".py"), "--picture", tmp_path / "block.png")
    assert code == 0 and "were folded or nearly so" in " ".join(said.split()), said


def test_gmsh_may_fail(tmp_path, monkeypatch):
    """A run that takes too long, and one that ends its process, leave the cells to be
    straightened.
    """
    path = disc(tmp_path / "disc.inp", "triangle")
    expected = mended(hhr.MeshFile(path).read(), "disc").raw.points
    with monkeypatch.context() as patch:
        patch.setattr(by_gmsh, "OPTIMISER_SECONDS", 0.0)
        with pytest.warns(
            MeshWarning, match=r"\(gmsh; sides of 2 that gmsh left folded are straightened\)"
        ):
            np.testing.assert_array_equal(hhr.Untangled(path, how="gmsh").read().points, expected)
    monkeypatch.setattr(by_gmsh, "WAYS", {2: ("Nothing",)})
    with pytest.warns(MeshWarning, match=r"left folded are straightened"):
        np.testing.assert_array_equal(hhr.Untangled(path, how="gmsh").read().points, expected)
