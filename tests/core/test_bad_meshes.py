"""Meshes, tags, loads and supports that do not suit a scene get a clear error before anything is
assembled.
"""

import dataclasses
import re
import warnings
from types import SimpleNamespace

import contact_patch_test as patch
import gmsh
import numpy as np
import pytest
from dolfinx import mesh as dmesh
from mpi4py import MPI
from needs import needs
from scenes import pressed_block, slope, space, with_bodies

import hhr_dolfinx as hhr
from hhr_dolfinx import compat
from hhr_dolfinx.errors import NotSolvableError, SceneError, SceneWarning
from hhr_dolfinx.forms.elasticity import HYPOTHESES
from hhr_dolfinx.full_order.checks import build_geometry, corner_jacobians
from hhr_dolfinx.geometries import block, two_blocks
from hhr_dolfinx.geometries.gmsh_model import mesh_of

LOWER, UPPER, LEFT = block.side(1, False), block.side(1, True), block.side(0, False)


def refused(scene, message, kind=SceneError):
    with pytest.raises(kind, match=message):
        hhr.FullOrderModel(scene)


def changed(hypothesis="plane_strain", geometry=None, **changes):
    """The pressed block whose geometry is passed through a function."""
    scene = pressed_block(hypothesis)
    if geometry is not None:
        changes["geometry"] = lambda comm: geometry(*scene.geometry(comm))
    return dataclasses.replace(scene, **changes)


@pytest.mark.parametrize("hypothesis", HYPOTHESES)
def test_a_mesh_of_another_dimension(hypothesis):
    other, needs, has = ("plane_strain", 3, 2) if hypothesis == "solid" else ("solid", 2, 3)
    scene = dataclasses.replace(pressed_block(other), hypothesis=hypothesis)
    refused(scene, f"'{hypothesis}' .* needs a mesh of dimension {needs}.* has {has}")


def moved(move):
    """A geometry whose coordinates are a function of those of the block."""

    def geometry(mesh, cells, facets):
        mesh.geometry.x[:] = move(mesh.geometry.x)
        return mesh, cells, facets

    return geometry


def inner_corner(x):
    """The node that the left bottom cell shares with three others, (n, 1) bool."""
    return np.isclose(x, (0.375, 0.5, 0.0)).all(axis=1, keepdims=True)


def close(x):
    """Move the second node of the floor onto the first one, at a corner of the block."""
    second = np.isclose(x[:, :2], (0.375, 0.0)).all(axis=1, keepdims=True)
    return np.where(second, x * (0.0, 1.0, 1.0), x)


def shell(tilt):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, tilt]])
    return (
        compat.linear_mesh(MPI.COMM_WORLD, points, np.arange(4)[None], "quadrilateral"),
        None,
        None,
    )


SHELL = r"dimension 2 in a space of dimension 3: .*"
GEOMETRIES = [
    (lambda mesh, cells, facets: mesh, r"must return \(mesh, cell_tags, facet_tags\)"),
    (lambda mesh, cells, facets: (mesh, cells), r"must return \(mesh, cell_tags, facet_tags\)"),
    (lambda mesh, cells, facets: (mesh, None, facets), "returned None for the cell tags"),
    (lambda mesh, cells, facets: (mesh, cells, None), "returned None for the facet tags"),
    (
        lambda mesh, cells, facets: (mesh, facets, cells),
        "returned tags of dimension 1 for the cell tags",
    ),
    (lambda *_: shell(0.0), SHELL + r"lie in one plane: .*gdim=2"),
    (lambda *_: shell(0.1), SHELL + "shells.*are not supported: mesh the volume"),
    (
        lambda *_: (dmesh.create_unit_interval(MPI.COMM_WORLD, 3), None, None),
        "kind interval .* not supported, only t",
    ),
    (
        moved(lambda x: np.where(inner_corner(x), (0.75, 1.05, 0.0), x)),
        r"2 cells .* inside out, e\.g\. around \[0\.2",
    ),
    (
        moved(lambda x: np.maximum(x, (0.0, 0.5, 0.0))),
        r"4 cells of the mesh have no volume, e\.g\. around \[",
    ),
    (
        moved(lambda x: np.where(inner_corner(x), np.nan, x)),
        "4 cells of the mesh have coordinates that are not finite",
    ),
    (moved(close), rf"1 facets of contact surface {LOWER} have no area, e\.g\. at \["),
]


@pytest.mark.parametrize(("geometry", "message"), GEOMETRIES)
def test_geometries_that_make_no_mesh_of_bodies(geometry, message):
    refused(changed(geometry=geometry), message)


@pytest.mark.parametrize("hypothesis", ["plane_strain", "solid"])
def test_simplices_that_are_turned_inside_out(hypothesis):
    """The middle of a block of triangles or tetrahedra is moved out of the cells around it."""
    scene = pressed_block(hypothesis, cells=2, simplices=True)
    middle = [0.75, 0.75, 1.0] if hypothesis == "solid" else [0.75, 1.0, 0.0]
    out = moved(
        lambda x: np.where(
            np.isclose(x, middle).all(axis=1, keepdims=True), np.add(x, (0.9, 0.0, 0.0)), x
        )
    )
    hhr.FullOrderModel(scene)
    turned = dataclasses.replace(scene, geometry=lambda comm: out(*scene.geometry(comm)))
    refused(
        turned,
        r"pairs of neighbouring cells lie on the same side of their common facet, e\.g\. at \[",
    )


def test_cells_of_third_order():
    def make():
        gmsh.model.occ.addRectangle(0, 0, 0, 1, 1, tag=1)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(2, [1], 1)
        gmsh.model.addPhysicalGroup(1, [1], LOWER)
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(3)

    refused(
        changed(geometry=lambda *_: mesh_of(make, MPI.COMM_WORLD, 2)),
        r"of order 3 are not supported: .*setOrder\(2\)",
    )


def test_triangles_beside_quadrilaterals():
    def make():
        bodies = [gmsh.model.occ.addRectangle(x, 0, 0, 1, 1) for x in (0, 2)]
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(2, bodies, 1)
        gmsh.model.mesh.setTransfiniteAutomatic(recombine=False)
        gmsh.model.mesh.setRecombine(2, bodies[0])
        gmsh.model.mesh.generate(2)

    with pytest.raises(SceneError, match="mesh all bodies with one kind of cells"):
        mesh_of(make, MPI.COMM_SELF, 2)


def test_facets_that_no_cell_has():
    """As automatic transfinite tetrahedra of second order have; DOLFINx ends the process."""

    def make():
        gmsh.model.occ.addBox(0, 0, 0, 2, 1, 1, tag=1)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(3, [1], 1)
        gmsh.model.addPhysicalGroup(2, [1, 2, 3], LOWER)
        gmsh.model.mesh.setTransfiniteAutomatic(recombine=False)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)

    with pytest.raises(SceneError, match="nodes that no cell has"):
        mesh_of(make, MPI.COMM_SELF, 3, options={"Mesh.MeshSizeMax": 0.6})


def test_a_mesh_on_another_communicator():
    own = dataclasses.replace(changed(), geometry=lambda _: changed().geometry(MPI.COMM_SELF))
    with pytest.raises(
        SceneError,
        match=r"spread over 1 ranks and was requested on 2: .* on the communicator it is given",
    ):
        build_geometry(own, SimpleNamespace(size=2, comm=MPI.COMM_SELF))


def test_cells_that_are_good_are_not_refused():
    """Needles of aspect 1e4, a mirrored mesh, and quadrilaterals with two corners in one place."""
    for factor in (1e-4, -1):
        hhr.FullOrderModel(changed(geometry=moved(lambda x: x * [factor, 1, 1])))
    collapsed = np.array([[[0.0, 0], [1, 0], [0, 0], [1, 1]]])
    assert corner_jacobians(collapsed) == pytest.approx(np.array([[0.0, 1.0, 0.0, 1.0]]))


@pytest.mark.parametrize("simplices", [True, False])
def test_jacobians_at_corners_are_volumes_of_boxes(simplices):
    for dim in (2, 3):
        box = {"lower": (0,) * dim, "upper": (2.0,) * dim, "cells": (2,) * dim}
        mesh, *_ = block.block(MPI.COMM_WORLD, **box, simplices=simplices)
        corners = mesh.geometry.x[compat.geometry_dofmap(mesh)][..., :dim]
        assert np.abs(corner_jacobians(corners)) == pytest.approx(1.0)


def with_inner_tag(mesh, cells, facets):
    """The block with the facets at half its height tagged 99."""
    inner = dmesh.locate_entities(mesh, 1, lambda x: np.isclose(x[1], 1.0))
    indices, values = (
        np.append(facets.indices, inner),
        np.append(facets.values, np.full(inner.size, 99)),
    )
    order = np.argsort(indices)
    return mesh, cells, dmesh.meshtags(mesh, 1, indices[order], values[order].astype(np.int32))


@pytest.mark.parametrize(
    ("load", "message"),
    [
        (
            hhr.Pressure(99, 1.0),
            r"4 facets tagged 99 under a Pressure lie inside the mesh, e\.g\. at \[.*, 1\.0\]",
        ),
        (hhr.Traction(99, (0.0, 1.0), 1.0), "under a Traction lie inside"),
        (
            hhr.Traction(LEFT, (0.0, 1.0, 0.0), 1.0),
            rf"\(0\.0, 1\.0, 0\.0\) on tag {LEFT} must have 2 components",
        ),
        (
            hhr.PartialPressure(LEFT, 1.0, "push", axis=0),
            r"not straight along it.*2 along axis 1\. Set its axis to 1",
        ),
        (
            hhr.PartialPressure(UPPER, 1.0, "push"),
            r"not straight along it.*1\.5 along axis 0.*Set its axis to 0",
        ),
    ],
)
def test_loads_that_would_do_nothing_or_fail(load, message):
    refused(changed(geometry=with_inner_tag, loads=(load,)), message)


def test_contact_inside_the_mesh():
    scene = changed(geometry=with_inner_tag, contacts=(hhr.Obstacle(99, (0.0, 1.0), 2.0),))
    refused(scene, "contact surface 99 has facets inside the mesh, around")


def test_axisymmetric_scenes_know_their_axis():
    aside = moved(lambda x: x - [0.2, 0.0, 0.0])
    refused(
        changed("axisymmetric", aside),
        r"5 nodes .* have r < 0, e\.g\. at \[-0\.2, .*the axis is r = 0",
    )
    load = hhr.PartialPressure(UPPER, 1.0, "push", axis=0)
    refused(
        changed("axisymmetric", loads=(load,)), "acts along the radius of an axisymmetric scene"
    )


def test_a_partial_pressure_on_two_pieces():
    """The facet in the middle of its line is not tagged."""

    def broken(mesh, cells, facets):
        middles = dmesh.compute_midpoints(mesh, 1, facets.indices)
        kept = ~((facets.values == UPPER) & (np.abs(middles[:, 0] - 0.5625) < 0.1))
        return mesh, cells, dmesh.meshtags(mesh, 1, facets.indices[kept], facets.values[kept])

    scene = changed(geometry=broken, loads=(hhr.PartialPressure(UPPER, 1.0, "push", axis=0),))
    refused(scene, rf"tagged {UPPER} .* not in one piece from .* to 1\.5 along axis 0")


def held(*displacements, hypothesis="plane_strain"):
    load = hhr.Pressure(
        block.side(2 if hypothesis == "solid" else 1, True), hhr.Amplitude(0, {"push": 1})
    )
    return changed(hypothesis, displacements=displacements, loads=(load,))


def motions_said(scene):
    """What is said of the motions of bodies when a model is built."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            said = hhr.FullOrderModel(scene).problem.kernel.described
        except NotSolvableError as error:
            said = str(error)
    return "; ".join([said, *(str(item.message) for item in caught)])


@needs("floating", "inelastic")
@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (held(), "body 1 of .* moves along axis 0, .*turns"),
        (held(hhr.Displacement(UPPER, 1)), "body 1 of .* moves along axis 0"),
        (held(hhr.Displacement(LEFT, 1)), "body 1 of .* moves along axis 0, .*turns"),
        (held(hypothesis="axisymmetric"), "body 1 of .* moves along axis 1"),
        (
            held(hhr.Displacement(31, 2), hhr.Displacement(10, 0), hypothesis="solid"),
            "body 1 of .* along axis 1",
        ),
    ],
)
def test_motions_of_a_body_that_flows_are_named_as_those_of_an_elastic_one(scene, message):
    said = motions_said(with_bodies(scene, law=hhr.Plasticity(1.0)))
    assert said == motions_said(scene) and re.search(message, said)


@needs("floating", "inelastic", "mortar")
@pytest.mark.parametrize("loose", [1, 2])
def test_the_free_one_of_two_bodies_is_named(loose):
    """Its end is held along axis 0 only."""
    scene = patch.scene()
    end = patch.geometry.outer_end(loose, 2)
    kept = tuple(item for item in scene.displacements if item.tag != end or item.component == 0)
    flowing = with_bodies(scene, law=hhr.Plasticity(1e6))
    said = motions_said(dataclasses.replace(flowing, displacements=kept))
    assert re.search(rf"body {loose} of .* moves along axis 1, turns", said)


def test_bodies_that_hang_together_at_a_node_are_not_called_free():
    """Two blocks joined at one corner are one body with a hinge: held as a whole, and singular all
    the same.
    """

    def hinge(comm):
        points = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1], [2, 1], [1, 2], [2, 2]])
        mesh = compat.linear_mesh(
            comm, points, np.array([[0, 1, 2, 3], [3, 4, 5, 6]]), "quadrilateral"
        )
        facets = dmesh.locate_entities_boundary(
            mesh, 1, lambda x: np.isclose(x[1], 0) | np.isclose(x[1], 2)
        )
        values = (dmesh.compute_midpoints(mesh, 1, facets)[:, 1] > 1).astype(np.int32) + 1
        cells = dmesh.meshtags(mesh, 2, np.arange(2, dtype=np.int32), np.ones(2, dtype=np.int32))
        return mesh, cells, dmesh.meshtags(mesh, 1, facets, values)

    scene = changed(
        geometry=lambda *_: hinge(MPI.COMM_WORLD),
        contacts=(hhr.Obstacle(2, (0.0, 1.0), 2.1),),
        displacements=tuple(hhr.Displacement(1, axis) for axis in (0, 1)),
        loads=(hhr.Pressure(2, slope("push")),),
    )
    refused(scene, "singular to round-off, though every body is held as a whole", NotSolvableError)


def test_imposed_nodes_that_penetrate():
    """The left side is pushed down by up to 0.1 with its lowest node, which hangs 0.01 above the
    floor.
    """
    scene = pressed_block("plane_strain")
    side = hhr.Displacement(LEFT, 1, slope("push", -1.0))
    pushed = dataclasses.replace(scene, displacements=(*scene.displacements, side))
    with pytest.warns(
        SceneWarning, match=r"at 1 places .* penetrate, most \(0\.09\) at \[.*\] for {'push': 0\.1}"
    ):
        hhr.FullOrderModel(pushed)
    # an opening that outruns the push, and a floor that is out of reach
    hhr.FullOrderModel(dataclasses.replace(pushed, openings=(hhr.Opening(0, slope("push")),)))
    hhr.FullOrderModel(
        dataclasses.replace(pushed, contacts=(hhr.Obstacle(LOWER, (0.0, -1.0), 0.11),))
    )


@pytest.mark.parametrize("text", ["-push", "-10 * push**2", "-0.1 * sin(15.7 * push)"])
def test_imposed_nodes_that_penetrate_by_a_formula(text):
    """The node is pushed down by the formula, 0.1 at the most, and hangs 0.01 above the floor."""
    scene = pressed_block("plane_strain")
    fixed, top = scene.displacements
    moved = [hhr.Displacement(tag, 1, text) for tag in (top.tag, LEFT)]
    pushed = dataclasses.replace(scene, displacements=(fixed, *moved))
    with pytest.warns(
        SceneWarning, match=r"at 1 places .* penetrate, most \(0\.09\) at \[.*\] for {'push': 0\.1}"
    ):
        hhr.FullOrderModel(pushed)
    hhr.FullOrderModel(
        dataclasses.replace(pushed, contacts=(hhr.Obstacle(LOWER, (0.0, -1.0), 0.11),))
    )


def test_parameters_without_effect():
    box, zero = (
        space(push=(0.0, 0.1), idle=(0.0, 0.1), zero=(0.0, 0.1)),
        hhr.Amplitude(1.0, {"zero": 0.0}),
    )
    with pytest.warns(
        SceneWarning,
        match=r"parameters \('idle', 'zero'\) of scene 'pressed_plane_strain' have no effect",
    ):
        hhr.FullOrderModel(
            changed(parameters=box, loads=(hhr.Pressure(block.side(0, True), zero),))
        )


@pytest.mark.parametrize(
    "box",
    [
        {"lower": (0.0, 0.0), "upper": (1.0, 1.0), "cells": (0, 4)},
        {"lower": (0.0, 0.0), "upper": (1.0, 0.0), "cells": (4, 4)},
        {"lower": (0.0, 0.0), "upper": (1.0, 1.0), "cells": (4, 4, 4)},
        {"lower": (0.0, 0.0), "upper": (1.0, 1.0), "cells": (4, 2.5)},
    ],
)
def test_blocks_without_volume_or_cells(box):
    for build in (
        lambda: block.block(MPI.COMM_WORLD, **box),
        lambda: two_blocks.two_blocks(
            MPI.COMM_WORLD, first=tuple(box.values()), second=tuple(box.values())
        ),
    ):
        with pytest.raises(ValueError, match="needs 2 or 3 of each"):
            build()
