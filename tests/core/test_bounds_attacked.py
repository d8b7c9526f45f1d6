"""Attacks on estimates that succeeded: what must hold, and did not when these tests were written."""

import dolfinx
import numpy as np
import pytest
from needs import needs
from scenes import block_scene, pressed_pair, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block


def layers(young, box):
    """A block of two layers that hang together, of which the upper one has a modulus of parameters."""

    def geometry(comm):
        mesh, _, facets = block.block(comm, lower=(0.0, 0.0), upper=(1.0, 1.0), cells=(4, 4))
        cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        above = (dolfinx.mesh.compute_midpoints(mesh, 2, cells)[:, 1] > 0.5).astype(np.int32)
        return mesh, dolfinx.mesh.meshtags(mesh, 2, cells, above + 1), facets

    return block_scene(
        "layers",
        {"gap": (-0.02, 0.005)} | box,
        geometry=geometry,
        bodies=(hhr.Body(1, 1.0, 0.3), hhr.Body(2, young, 0.3)),
        contacts=(hhr.Obstacle(block.side(1, upper=True), (0.0, 1.0), 1.0),),
        displacements=hhr.Displacement.clamp(block.side(1, upper=False), 2),
        openings=(hhr.Opening(0, slope("gap")),),
    )


SQUARE = {"a": (-1.0, 1.0), "b": (-1.0, 1.0)}
SCENES = {
    "five decades": (layers("E2", {"E2": (1e-2, 1e3)}), 24),
    "product in a layer": (layers("1 + 0.9 * a * b", SQUARE), 24),
    "product": (pressed_pair("plane_strain", ((2.0, 0.3), (1.0, "0.3 + 0.15 * a * b")), SQUARE, cells=3), 64),
    "wave": (pressed_pair("plane_strain", ((2.0, 0.3), (1.0, "0.3 + 0.15 * a * sin(pi * b)")), SQUARE, cells=3), 64),
}


@needs("moduli")
@pytest.mark.parametrize("name", SCENES)
def test_a_bound_is_as_good_as_its_interpolation_or_left_out(name):
    """Products of parameters are constant along each axis through the middle of the box, where grids look first."""
    scene, count = SCENES[name]
    training = hhr.train(scene, hhr.Sobol(count), held_out=0)
    full, model = training.full_order, training.build(checked=False)
    for point in full.parameters.random(20, 5):
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
