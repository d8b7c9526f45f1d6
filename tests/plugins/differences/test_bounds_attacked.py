"""Attacks on estimates that succeeded: what must hold, and did not when these tests were written."""

import dolfinx
import numpy as np
import pytest
from needs import needs
from scenes import pressed_pair

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.geometries import block, two_blocks


@needs("moduli")
@pytest.mark.parametrize("poisson", ["0.3 + 0.15 * a * b", "0.3 + 0.15 * a * sin(pi * b)"])
def test_a_product_of_parameters_is_seen_by_the_interpolation(poisson):
    """The formula is constant along each axis through the middle of the box, where sparse grids look first."""
    scene = pressed_pair("plane_strain", ((2.0, 0.3), (1.0, poisson)), {"a": (-1.0, 1.0), "b": (-1.0, 1.0)}, cells=3)
    training = hhr.train(scene, hhr.Sobol(64), held_out=0)
    full, model = training.full_order, training.build(checked=False)
    for point in full.parameters.random(20, 5):
        stiffness = full.problem.at(point).stiffness
        exact, answer = full.solve(point), model.solve(point, outside="ignore")
        off = answer.displacement() - exact.displacement()
        estimate = answer.estimate()
        assert estimate is None or np.sqrt(off @ (stiffness @ off)) <= estimate.primal


@needs("fallback")
def test_a_full_model_with_other_loads_is_that_of_another_scene():
    flank, models = two_blocks.side(two_blocks.SECOND, 0, True), []
    for slope in (1.0, 5.0):
        load = hhr.Pressure(flank, hhr.Amplitude(slopes={"load": slope}))
        scene = pressed_pair("plane_strain", ((2.0, 0.3), (1.0, 0.2)), cells=3, loads=(load,))
        models.append(hhr.train(scene, hhr.Sobol(8), held_out=0))
    with pytest.raises(ReductionError, match="another scene"):
        hhr.FallbackModel(models[0].build(checked=False), models[1].full_order, 0.01)


def layers(young, box):
    """A block of two layers that hang together, of which the upper one has a modulus of parameters."""

    def geometry(comm):
        mesh, _, facets = block.block(comm, lower=(0.0, 0.0), upper=(1.0, 1.0), cells=(4, 4))
        cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        above = (dolfinx.mesh.compute_midpoints(mesh, 2, cells)[:, 1] > 0.5).astype(np.int32)
        return mesh, dolfinx.mesh.meshtags(mesh, 2, cells, above + 1), facets

    box = {"gap": (-0.02, 0.005)} | box
    bottom = block.side(1, upper=False)
    return hhr.Scene(
        name="layers",
        geometry=geometry,
        hypothesis="plane_strain",
        bodies=(hhr.Body(1, 1.0, 0.3), hhr.Body(2, young, 0.3)),
        contacts=(hhr.Obstacle(block.side(1, upper=True), (0.0, 1.0), 1.0),),
        parameters=hhr.ParameterSpace(tuple(box), *zip(*box.values(), strict=True)),
        displacements=tuple(hhr.Displacement(bottom, axis) for axis in (0, 1)),
        openings=(hhr.Opening(0, hhr.Amplitude(slopes={"gap": 1.0})),),
    )


@needs("moduli")
@pytest.mark.parametrize(
    ("young", "box"), [("E2", {"E2": (1e-2, 1e3)}), ("1 + 0.9 * a * b", {"a": (-1.0, 1.0), "b": (-1.0, 1.0)})]
)
def test_what_cannot_be_interpolated_costs_no_model(young, box):
    """A modulus of five decades in a body of two layers: a bound is as good as its interpolation, or left out."""
    training = hhr.train(layers(young, box), hhr.Sobol(24), held_out=0)
    full, model = training.full_order, training.build(checked=False)
    for point in full.parameters.random(10, 5):
        stiffness = full.problem.at(point).stiffness
        exact, answer = full.solve(point), model.solve(point, outside="ignore", raise_on_failure=False)
        off, estimate = answer.displacement() - exact.displacement(), answer.estimate()
        assert estimate is None or np.sqrt(off @ (stiffness @ off)) <= estimate.primal


@needs("moduli")
def test_a_wide_range_of_poisson_s_ratio_is_known_to_be_resolved():
    """Shares of the change of volume above 3/5 do not occur: at a ratio near 0 they would be all that counts."""
    scene = pressed_pair("plane_strain", ((2.0, "nu"), (1.0, 0.2)), {"nu": (0.001, 0.4)}, cells=3)
    training = hhr.train(scene, hhr.Sobol(16), held_out=0)
    bound = training.build(checked=False).fields.bound
    assert bound.proved and bound.inexact < 1e-8


@needs("moduli")
def test_a_formula_that_repeats_itself_between_the_nodes_is_found_out():
    scene = pressed_pair("plane_strain", ((2.0, "0.3 + 0.15 * sin(2000 * pi * T)"), (1.0, 0.2)), {"T": (0.0, 1.0)})
    training = hhr.train(scene, hhr.Sobol(8), held_out=0)
    assert training.build(checked=False).fields.bound is None
