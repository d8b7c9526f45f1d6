"""Outputs of bodies whose shape depends on parameters: those of a mesh of that shape, from every
model, with slopes.
"""

import dataclasses

import numpy as np
import press_fit as demo
import pytest
from my_output import MyOutput
from needs import present
from scenes import block_scene, meshed, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import coordinate_names
from hhr_dolfinx.geometries import block
from hhr_dolfinx.geometries import press_fit as geometry

FLOOR, LID, AXIS = block.side(1, upper=False), block.side(1, upper=True), block.side(0, upper=False)
SMALL_FIT = {"around": 3, "hub_cells": (2, 4), "shaft_cells": (2, 5)}
pytestmark = pytest.mark.filterwarnings("ignore")


def crown_at(x, y, crown):
    """Where the crowned block has the point (x, y) of the mesh."""
    return x, y * (1 + crown) + 0.3 * crown * x**2 * (1 - y)


def crowned(hypothesis, *, poisson=0.3, simplices=False, outputs=None):
    """A block with a crowned lower side, pressed on a floor.

    Crown, push, E and the pull of a side are parameters.
    """
    corner = crown_at(1.5, 0.0, 0.1)
    axis = [] if hypothesis == "axisymmetric" else [(0.2, 0.0)]
    torques = [hhr.Torque("torque", 0, 0.3, *axis)] if present("friction") else []
    named = (
        hhr.LargestPressure("peak", 0),
        hhr.ContactForce("up", 0, (0.0, 1.0)),
        *torques,
        hhr.ContactWidth("area", 0),
        hhr.LostContact("lost", 0),
        hhr.GapAt("gap", 0, corner),
        hhr.DisplacementAt("u_x", corner, 0),
        hhr.VonMises("largest", block.SOLID),
        hhr.VonMises("mean", block.SOLID, "mean"),
        hhr.VonMises("below", block.SOLID, "max", ((0.0, 0.0), (2.0, 0.45))),
        hhr.ElasticEnergy("energy"),
        hhr.LinearForm("side", lambda a: a.test[0] * a.ds(block.side(0, upper=True))),
        MyOutput("mean pressure", 0),
    )
    x, y = coordinate_names(hypothesis)
    return block_scene(
        "crowned",
        {"push": (0.05, 0.15), "crown": (0.05, 0.15), "E": (1.0, 3.0), "pull": (0.0, 0.1)},
        upper=(1.5, 1.0),
        cells=(6, 4),
        young="E",
        poisson=poisson,
        simplices=simplices,
        hypothesis=hypothesis,
        contacts=(hhr.Obstacle(FLOOR, (0.0, -1.0), 0.01),),
        displacements=(hhr.Displacement(AXIS, 0), hhr.Displacement(LID, 1, slope("push", -1.0))),
        loads=(hhr.Traction(block.side(0, upper=True), (1, 0), slope("pull")),),
        shapes=(
            hhr.Shape(block.SOLID, (x, f"{y} * (1 + crown) + 0.3 * crown * {x}**2 * (1 - {y})")),
        ),
        outputs=named if outputs is None else outputs,
    )


def small_fit():
    """The press fit on a small mesh, with more outputs."""
    more = (
        hhr.LargestPressure("peak", 0),
        hhr.ContactForce("force", 0, (1.0, 0.0, 0.0)),
        hhr.VonMises("shaft", geometry.SHAFT),
        hhr.ElasticEnergy("energy"),
        hhr.GapAt("gap", 0, (20.0, 0.0, 15.0)),
        hhr.DisplacementAt("u", (20.0, 0.0, 0.0), 0, geometry.HUB),
    )
    given = demo.scene(**SMALL_FIT)
    return dataclasses.replace(given, outputs=given.outputs + more)


def placed(scene, point):
    """The block's outputs, with the corner where it lies at a point."""
    corner = crown_at(1.5, 0.0, point[1])
    there = [
        dataclasses.replace(item, place=corner) if hasattr(item, "place") else item
        for item in scene.outputs
    ]
    return dataclasses.replace(scene, outputs=tuple(there))


@pytest.fixture(scope="module")
def trainings():
    """Of blocks by hypothesis, the axisymmetric one nearly incompressible, and of the fit."""
    blocks = {
        "plane_strain": crowned("plane_strain"),
        "axisymmetric": crowned("axisymmetric", poisson=0.47),
    }
    return {
        name: hhr.train(scene, hhr.Sobol(4), held_out=1)
        for name, scene in (blocks | {"fit": small_fit()}).items()
    }


@pytest.fixture(scope="module")
def fulls(trainings):
    """Full models, by name."""
    return {name: training.full_order for name, training in trainings.items()}


@pytest.fixture(scope="module")
def condensed(trainings):
    """Condensed models, by name."""
    from hhr_dolfinx.plugins.moduli.interpolate import GridSettings

    finer = GridSettings(1e-5)  # the forces of the fit have an error of 1e-3 with the usual one
    return {name: training.condense(finer) for name, training in trainings.items()}


def check_close(found, expected, tolerance, scale=1.0):
    """Outputs agree relative to their size; gaps, which nearly vanish, to the length of the
    scene.
    """
    assert found.keys() == expected.keys()
    for name in expected:
        assert abs(found[name] - expected[name]) <= tolerance * max(abs(expected[name]), scale), (
            name
        )


NAMED = "plane_strain", "axisymmetric", "fit"


@pytest.mark.parametrize("name", NAMED)
def test_a_full_model_has_the_outputs_of_a_mesh_of_that_shape(fulls, name):
    full = fulls[name]
    point = full.parameters.random(1, seed=3)[0]
    scene = full.scene if name == "fit" else placed(full.scene, point)
    expected = hhr.FullOrderModel(meshed(scene, point)).outputs(point)
    check_close(full.outputs(point), expected, 1e-8, 1e-3)


@pytest.mark.parametrize("name", NAMED)
def test_condensation_has_the_outputs_of_the_full_model(fulls, condensed, name):
    full, model = fulls[name], condensed[name]
    for point in full.parameters.random(3, seed=4):
        check_close(model.outputs(point), full.outputs(point), 1e-3, 1e-2)


@pytest.mark.parametrize(
    "kind, name",
    [*(("fulls", name) for name in NAMED[:2]), *(("condensed", name) for name in NAMED)],
)
def test_slopes_of_outputs_are_those_of_the_model(request, kind, name):
    model = request.getfixturevalue(kind)[name]
    low, high = np.array([model.parameters.lower, model.parameters.upper])
    point = low + 0.45 * (high - low)
    exact = model.outputs(point, gradient=True)
    for axis, step in enumerate(1e-4 * (high - low)):
        before, after = (
            model.outputs(point + sign * step * np.eye(low.size)[axis]) for sign in (-1, 1)
        )
        for key in exact:
            expected = (after[key] - before[key]) / (2 * step)
            size = max(abs(exact.gradient[key]) @ (high - low), abs(exact[key]), 1e-3)
            assert abs(exact.gradient[key][axis] - expected) * (high - low)[axis] <= 1e-6 * size, (
                key,
                axis,
            )


def of_second_order(simplices):
    """The crowned block on curved cells of second order."""
    from hhr_dolfinx.geometries.gmsh_model import gmsh, mesh_of

    def make():
        gmsh.model.occ.addRectangle(0, 0, 0, 1.5, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(2, [1], block.SOLID)
        for number, side in enumerate((FLOOR, block.side(0, upper=True), LID, AXIS), start=1):
            gmsh.model.addPhysicalGroup(1, [number], side)
        gmsh.model.mesh.setTransfiniteAutomatic(recombine=not simplices)
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(2)

    stress = (hhr.VonMises("stress", block.SOLID), hhr.VonMises("mean", block.SOLID, "mean"))
    scene = crowned("axisymmetric", outputs=stress)
    return dataclasses.replace(scene, geometry=lambda comm: mesh_of(make, comm, 2))


def flat(simplices):
    """The same on flat cells whose displacement is of second order."""
    scene = of_second_order(simplices)
    cells = crowned("axisymmetric", simplices=simplices).geometry
    return dataclasses.replace(scene, geometry=cells, order=2)


@pytest.mark.parametrize("make", [of_second_order, flat])
@pytest.mark.parametrize("simplices", [True, False])
def test_stress_on_cells_of_second_order(simplices, make):
    full = hhr.FullOrderModel(make(simplices))
    assert full.discretisation.order == 2
    point = full.parameters.random(1, seed=3)[0]
    check_close(
        full.outputs(point), hhr.FullOrderModel(meshed(full.scene, point)).outputs(point), 1e-6
    )
    if not present("moduli"):
        return
    model = hhr.condense(full, fields=True)
    for place in full.parameters.random(3, seed=4):
        check_close(model.outputs(place), full.outputs(place), 1e-2)


@pytest.mark.parametrize(
    "case",
    [
        "plane_strain",
        "simplices",
        "axisymmetric",
        "plane_stress",
        "fit",
        "triangles",
        "quadrilaterals",
    ],
)
def test_strain_of_moved_cells_is_that_of_the_mesh(case, fulls):
    if case in fulls:
        full = fulls[case]
    elif case in ("triangles", "quadrilaterals"):
        full = hhr.FullOrderModel(of_second_order(case == "triangles"))
    else:
        hypothesis = "plane_stress" if case == "plane_stress" else "plane_strain"
        stress = (hhr.VonMises("stress", block.SOLID),)
        full = hhr.FullOrderModel(
            crowned(hypothesis, simplices=case == "simplices", outputs=stress)
        )
    point = full.parameters.random(1, seed=5)[0]
    field = np.random.default_rng(0).normal(size=(full.problem.free.size, 2))
    tried = [item for item in full.functionals.at(point).items if hasattr(item, "cells")]
    assert tried
    for item in tried:
        expected = item.matrix(len(field)) @ field
        found = item.cells(point) @ field[item.cells.dofs]
        assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()
        assert np.allclose(
            item.cells(point) @ field[item.cells.dofs, 0], found[:, 0], rtol=1e-12, atol=1e-12
        )


def test_a_model_file_keeps_them(condensed, tmp_path):
    from hhr_dolfinx.plugins.shapes.functionals import ReshapedFunctionals

    model = condensed["fit"]
    hhr.save_model(tmp_path / "model.npz", model)
    loaded = hhr.load_model(tmp_path / "model.npz")
    assert isinstance(loaded.fields.functionals, ReshapedFunctionals)
    point = model.parameters.random(1, seed=6)[0]
    found, expected = (item.outputs(point, gradient=True) for item in (loaded, model))
    assert found.values == expected.values and found.units == expected.units
    assert all(np.array_equal(found.gradient[name], expected.gradient[name]) for name in expected)


@dataclasses.dataclass(frozen=True)
class OfOtherConditions(MyOutput):
    """Mean pressure of what lies high enough, which is another number of conditions on another
    shape.
    """

    def prepared(self, probe):
        """Of some conditions."""
        made = super().prepared(probe)
        high = probe.problem.contact_points[made.conditions][:, 1] > 0.03
        return dataclasses.replace(
            made, conditions=made.conditions[high], weights=made.weights[high]
        )


def test_an_output_that_jumps_between_shapes_is_refused():
    from hhr_dolfinx.plugins.moduli.interpolate import GridSettings
    from hhr_dolfinx.plugins.shapes.interpolated import reshaped_functionals

    full = hhr.FullOrderModel(crowned("plane_strain", outputs=(OfOtherConditions("high", 0),)))
    basis = np.ones((full.problem.free.size, 1))
    with pytest.raises(SceneError, match="output 'high' is made of other conditions"):
        reshaped_functionals(full.functionals, full.problem, basis, GridSettings())
