"""Folded cells of second order: mended, said, and refused where their corners are folded."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileContentError, MeshWarning, SceneError, SceneWarning
from hhr_dolfinx.geometries.cells import DIMENSION, EDGES, FACES, outer_faces_of_cells
from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.second_order.untangled import folded, mended

KINDS = sorted(DIMENSION)
ELEMENTS = {"triangle": "CPE6", "quadrilateral": "CPE8", "tetrahedron": "C3D10", "hexahedron": "C3D20"}
YOUNG, POISSON = 1000.0, 0.3


def lattice(kind, counts):
    """Corners of a unit box and its cells."""
    dim = len(counts)
    shape = [count + 1 for count in counts]
    points = np.stack(np.meshgrid(*(np.linspace(0, 1, n) for n in shape), indexing="ij"), axis=-1).reshape(-1, dim)
    number = np.arange(len(points)).reshape(shape)
    low = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, dim)
    around = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    if dim == 3:
        around = np.vstack([np.column_stack([around, np.full(4, height)]) for height in (0, 1)])
    boxes = number[tuple(np.moveaxis(low[:, None] + around, -1, 0))]
    parts = {
        "triangle": [(0, 1, 2), (0, 2, 3)],
        "tetrahedron": [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)],
    }
    return points, np.vstack([boxes[:, part] for part in parts[kind]]) if kind in parts else boxes  # fmt: skip


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
    """Middles of sides; those of sides along x in the inside move along them by .3 of their length, which folds cells."""
    inside = ((ends > 0.01) & (ends < 0.99)).all(axis=(1, 2))
    along = np.ptp(ends, axis=1)
    moved = inside & (along[:, 1:] < 1e-9).all(axis=1)
    assert moved.any()
    return ends.mean(axis=1) + 0.3 * moved[:, None] * along


def written(path, raw, surfaces):
    """A deck of Abaqus with a mesh and surfaces, each a condition on the corners of facets, (f, k, dim): (f,)."""
    rows = ["*NODE", *(f"{n}, {', '.join(map(repr, place))}" for n, place in enumerate(raw.points.tolist(), 1))]
    rows.append(f"*ELEMENT, TYPE={ELEMENTS[raw.kind]}, ELSET=BODY")
    for n, nodes in enumerate(np.hstack([raw.cells, raw.sides]).tolist(), 1):
        first, last = [n, *(node + 1 for node in nodes)][:11], [node + 1 for node in nodes][10:]
        rows.append(", ".join(map(str, first)) + ("," if last else ""))
        rows += [", ".join(map(str, last))] if last else []
    facets, owners = outer_faces_of_cells(raw.kind, raw.cells)
    for name, held in surfaces.items():
        rows.append(f"*SURFACE, NAME={name}")
        for facet, owner in zip(facets[held(raw.points[facets])], owners[held(raw.points[facets])], strict=True):
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
@pytest.mark.parametrize("kind", KINDS)
def test_a_mended_mesh_passes_the_patch_test(kind, tmp_path):
    """A uniform stress: displacements are linear, 1e-12 was measured; without mending the scene is refused."""
    path = block(tmp_path / "block.inp", kind, shifted)
    dim = DIMENSION[kind]
    with pytest.raises(SceneError, match=r"folded or turned inside out.*hhr\.Untangled\(MeshFile\(path=.*block\.inp"):
        hhr.FullOrderModel(pressed(hhr.MeshFile(path), dim), MPI.COMM_SELF)
    with pytest.warns(MeshWarning, match=r"cells of .*block\.inp were folded or nearly so.*\(straight\): "):
        full = hhr.FullOrderModel(pressed(hhr.Untangled(path), dim), MPI.COMM_SELF)
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
    """Corners and the outer surface stay, and so does each node that is on no folded cell or its neighbours."""
    raw = of_second_order(kind, (3,) * DIMENSION[kind], bend=shifted)
    first = folded(raw)
    found, bad = mended(raw, "block")
    assert first.size and np.isin(first, bad).all() and not folded(found).size
    moved = np.flatnonzero((found.points != raw.points).any(axis=1))
    assert np.isin(moved, raw.sides[bad]).all() and not np.isin(moved, raw.cells).any()
    # a fold by a shift of a part s of the side ends at s = 1/4, where the Jacobian at one end is 0, before the middle
    middles = of_second_order(kind, (3,) * DIMENSION[kind], bend=straight).points
    left = np.linalg.norm(found.points - middles, axis=1)[moved] / np.linalg.norm(raw.points - middles, axis=1)[moved]
    assert (left * 0.3 < 0.25).all() and (left > 0.5).all()
    again, none = mended(found, "block")
    assert not none.size and again.points is not raw.points
    np.testing.assert_array_equal(again.points, found.points)


HOLE, RIM, LAYER = 1.0, 4.0, 0.05


def ring(kind, cells=(2, 4), layer=LAYER):
    """A quarter of a disc with a hole, as generators curve it: the nodes on the hole and on the rim are on circles.

    The first layer at the hole is thinner than its arcs are high, .076 of the radius with two cells.
    """
    rows = np.array([HOLE, HOLE + layer, 1.4, 2.2, RIM])

    def place(points):
        angle, radius = points[:, 0] * np.pi / 2, np.interp(points[:, 1], np.linspace(0, 1, len(rows)), rows)
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
    return written(path, raw, flat | ({"LOW2": on(2, 0.0), "HIGH2": on(2, 1.0)} if raw.dim == 3 else {}))


def squeezed(geometry, dim):
    """The disc in plane strain under a pressure on its rim; the side y = 0 lies on a rigid plane."""
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
    rim = np.flatnonzero(np.isclose(full.problem.points[:, 0], RIM) & (full.problem.points[:, 1] == 0.0))
    lame = (1 - 2 * POISSON) * RIM + HOLE**2 / RIM
    lame *= -2.0 * RIM**2 * (1 + POISSON) / (YOUNG * (RIM**2 - HOLE**2))
    np.testing.assert_allclose(answer.displacement().reshape(-1, dim)[rim, 0], lame, rtol=0.02)
