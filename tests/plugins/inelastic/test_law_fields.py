"""Constants of laws that vary in space: formulas of coordinates, in full, reduced and condensed
models and files.
"""

import dataclasses

import contract
import numpy as np
import pytest
from condensing import FINE, QUIET, condensed
from mpi4py import MPI
from points import WOOD
from scenes import block_scene
from tubes import YOUNG, tube
from yielding_scenes import bar

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries import block
from hhr_dolfinx.materials.elasticity import von_mises

TIGHT = hhr.MarchSettings("tangent", 1e-10, 1e-9, 1e-12, outside="ignore")


def test_each_point_yields_at_its_own_stress():
    """A bar whose yield stress grows along it and with its parameter, under the same strain
    everywhere.
    """
    material = hhr.FullOrderModel(bar(hhr.Plasticity("1 + z + pull"))).equilibrium.material
    group = material.groups[0]
    assert group.coordinates == ("r", "z") and np.ptp(group.places[:, 1]) > 1.5
    strain = np.tile([0.0, 0.1, -0.1, 0.05], (material.gauss_points, 1))
    found = material.at(np.array([0.05])).update(strain, material.at_rest(), 1.0, tangent=True)
    assert von_mises(found.stress) == pytest.approx(1.05 + group.places[:, 1], rel=1e-12)


def test_a_field_that_is_constant_is_a_number():
    """To round-off of the formula."""
    histories = []
    for resistance in (2.0, "2 + 0 * x"):
        law = hhr.Norton(resistance, 4.0)
        scene = block_scene(
            "creeping",
            {"pull": (0.0, 0.1)},
            upper=(1, 1),
            cells=(2, 2),
            bodies=(hhr.Body(block.SOLID, YOUNG, 0.3, law),),
            contacts=(hhr.Obstacle(block.side(0, upper=True), (1, 0), 2.0),),
            displacements=(
                hhr.Displacement(block.side(0, upper=False), 0),
                hhr.Displacement(block.side(1, upper=False), 1),
                hhr.Displacement(block.side(1, upper=True), 1, hhr.Amplitude(slopes={"pull": 1.0})),
            ),
        )
        path = [(float(k), np.array([0.01 * k])) for k in range(4)]
        histories.append(hhr.FullOrderModel(scene).march(path, TIGHT))
    one, other = (history.answers[-1] for history in histories)
    assert one.stress() == pytest.approx(other.stress(), rel=1e-12)


def test_a_tube_under_a_temperature_field():
    """Elastic, free of load: Timoshenko's stress of T = T_i ln(b/r)/ln(b/a), by a law that is
    heated.
    """
    law = hhr.Heated(hhr.Plasticity(1e6), 1e-5, "100 * p * log(2 / r) / log(2)")
    full = hhr.FullOrderModel(tube(law, 1.0, cells=24))
    inner, outer, poisson = 1.0, 2.0, 0.3
    load = [(0.0, np.zeros(1)), (1.0, np.ones(1))]
    answer = full.march(load, TIGHT).answers[-1]
    cold = hhr.FullOrderModel(tube(hhr.Plasticity(1e6), 1.0, cells=24)).march(load, TIGHT)
    radius = full.equilibrium.material.groups[0].places[:, 0]
    ratio = outer / inner
    scale = YOUNG * 1e-5 * 100 / (2 * (1 - poisson) * np.log(ratio))
    radial = -np.log(outer / radius) - (1 - outer**2 / radius**2) / (ratio**2 - 1) * np.log(ratio)
    hoop = 1 - np.log(outer / radius) - (1 + outer**2 / radius**2) / (ratio**2 - 1) * np.log(ratio)
    found = answer.stress() - cold.answers[-1].stress()
    # in the mean over a cell, in which the dilatation is constant and the heat is not
    for place, known in ((0, radial), (2, hoop)):
        means = (values.reshape(-1, 4).mean(axis=1) for values in (found[:, place], scale * known))
        assert next(means) == pytest.approx(next(means), abs=0.005 * scale)


def test_reduced_and_condensed_models_and_files_have_the_field(tmp_path):
    """Kinematic hardening whose yield stress grows upwards, on a path between those of the
    training.
    """
    scene = contract.blocks(law=hhr.Chaboche("0.03 * (1 + y / 2)", ((0.3, 3.0),)))
    paths = [contract.path(top) for top in (0.03, 0.05, 0.04)]
    training = hhr.train(scene, paths[:2], held_out=paths[2:], comm=MPI.COMM_SELF)
    exact = training.full_order.march(paths[2], QUIET).answers[-1]
    assert exact.state().state.memory.any()
    models = {
        "condensed": contract.condensed_flow(training),
        "reduced": contract.reduced_flow(training),
    }
    for name, model in models.items():
        groups = model.flow.groups if name == "condensed" else model.flow.material.groups
        placed = next(group for group in groups if group.coordinates)
        assert placed.places.shape == (placed.indices.size, 2)
        answer = model.march(paths[2], QUIET).answers[-1]
        assert answer.forces() == pytest.approx(exact.forces(), abs=0.02 * exact.forces().max())
        assert answer.plastic_strain() == pytest.approx(
            exact.plastic_strain(), abs=0.05 * exact.plastic_strain().max()
        )
        hhr.save_model(tmp_path / f"{name}.npz", model)
        again = hhr.load_model(tmp_path / f"{name}.npz").march(paths[2], QUIET).answers[-1]
        assert np.array_equal(again.forces(), answer.forces())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 + x", r"body \d of scene 'tube': .*names \['x'\]"),
        ("1.5 - r", "yield_stress = -.* must be a number above 0"),
    ],
)
def test_fields_that_cannot_be_are_refused(text, said):
    """A coordinate that the mesh does not have, and a value that is none somewhere."""
    scene = tube(hhr.Plasticity(text), 1.0, cells=4)
    with pytest.raises(SceneError, match=said):
        hhr.FullOrderModel(scene)


@pytest.mark.filterwarnings("ignore:no training solution has contact")
def test_a_block_of_wood_is_as_stiff_as_its_law():
    """Pulled along its third axis, which the frame turns into the second of the mesh.

    Heated it is condensed too.
    """
    wood = hhr.Orthotropic(*WOOD, frame=((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)))
    sides = [hhr.Displacement(block.side(axis, upper=False), axis) for axis in range(3)]
    pulled = hhr.Displacement(block.side(1, upper=True), 1, hhr.Amplitude(slopes={"pull": 1.0}))
    scene = block_scene(
        "wood",
        {"pull": (0.0, 0.1)},
        lower=(0, 0, 0),
        upper=(1, 1, 1),
        cells=(1, 2, 1),
        hypothesis="solid",
        bodies=(hhr.Body(block.SOLID, 1e3, 0.3, wood),),
        displacements=(*sides, pulled),
        contacts=(hhr.Obstacle(block.side(0, upper=True), (1, 0, 0), 2.0),),
    )
    full = hhr.FullOrderModel(scene)
    history = full.march([(0.0, np.zeros(1)), (1.0, np.array([0.1]))], TIGHT)
    stress = history.answers[-1].stress()
    assert stress[:, 1] == pytest.approx(WOOD[2] * 0.1, rel=1e-9)
    assert np.abs(np.delete(stress, 1, axis=1)).max() < 1e-9 * WOOD[2]
    assert not history.answers[-1].plastic_strain().any()
    warm = dataclasses.replace(scene.bodies[0], law=hhr.Heated(wood, 0.1, "pull * (1 + y)"))
    full = hhr.FullOrderModel(dataclasses.replace(scene, bodies=(warm,)))
    path = [(0.1 * step, np.array([0.01 * step])) for step in range(11)]
    model = condensed(full, [full.march(path, TIGHT)])
    one, other = (
        item.march([path[0], (0.5, np.array([0.055]))], FINE).answers[-1] for item in (full, model)
    )
    assert other.displacement() == pytest.approx(
        one.displacement(), abs=1e-7 * np.abs(one.displacement()).max()
    )
    assert other.stress() == pytest.approx(one.stress(), abs=1e-6 * np.abs(one.stress()).max())
