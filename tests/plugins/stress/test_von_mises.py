"""Von Mises' stress as an output, beside the stress of the mesh."""

import dataclasses

import numpy as np
import pytest
import ufl
from needs import needs, present
from scenes import pressed_block, with_bodies

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block
from hhr_dolfinx.materials.elasticity import von_mises

pytestmark = needs("volume_loads")


def hooke(strain):
    return 1.7 * ufl.tr(strain) * ufl.Identity(3) + 2 * 1.1 * strain


ELASTIC = {"isotropic": {}, "hooke": {"stress": hooke}}
if present("inelastic"):
    axes = (0.8, 0.6, 0.0), (-0.6, 0.8, 0.0), (0.0, 0.0, 1.0)
    ELASTIC["wood"] = {"law": hhr.Orthotropic(9.0, 3.0, 1.5, 0.4, 0.3, 0.2, 1.0, 0.8, 0.3, axes)}


@needs("elasticity")
@pytest.mark.parametrize("elastic", ELASTIC)
@pytest.mark.parametrize("hypothesis", ["plane_strain", "plane_stress", "axisymmetric", "solid"])
def test_von_mises_stress_of_heated_bodies(hypothesis, elastic):
    """That of the stress of the mesh in the middle of each cell.

    A strain without stress is no part of it.

    In plane stress that is more than its change of volume, as is the stress of wood for a strain
    that is the same in all directions. Derivatives by differences.
    """
    scene = with_bodies(pressed_block(hypothesis, cells=3), **ELASTIC[elastic])
    names = hhr.ParameterSpace(("push", "T"), (0.0, 0.0), (0.1, 1.0))
    heat = hhr.ThermalExpansion(block.SOLID, "2e-2", "T", lambda x: 1 + x[0] / 4)
    swell = hhr.Eigenstrain(block.SOLID, "T", np.diag([0.01, 0.0, 0.0]).tolist())
    outputs = hhr.VonMises("peak", block.SOLID), hhr.VonMises("mean", block.SOLID, kind="mean")
    for loads in ((heat,), (heat, swell)):
        full = hhr.FullOrderModel(
            dataclasses.replace(scene, parameters=names, loads=loads, outputs=outputs)
        )
        answer = full.solve({"push": 0.05, "T": 0.7})
        found = full.outputs({"push": 0.05, "T": 0.7}, gradient=True)
        assert found["peak"] == pytest.approx(von_mises(answer.stress()).max(), rel=1e-12)
        for name, slope in found.gradient.items():
            ends = [
                full.solve({"push": 0.05, "T": 0.7 + step}).outputs()[name]
                for step in (-1e-5, 1e-5)
            ]
            assert slope[1] == pytest.approx((ends[1] - ends[0]) / 2e-5, rel=1e-6), name


@needs("elasticity")
@pytest.mark.parametrize("elastic", ELASTIC)
@pytest.mark.parametrize("hypothesis", ["plane_stress", "axisymmetric", "solid"])
def test_a_free_body_has_no_stress_by_heat_or_swelling(hypothesis, elastic):
    """Rollers on three sides, far from the obstacle: any uniform strain is free, whatever C is.

    Stresses are round-off of C times the strain, about 3 times 0.02. In axisymmetry swelling is the
    same along r and θ.
    """
    scene = with_bodies(pressed_block(hypothesis, cells=3), **ELASTIC[elastic])
    up = 2 if hypothesis == "solid" else 1
    rollers = tuple(
        hhr.Displacement(block.side(axis, upper=False), axis)
        for axis in range(up + 1)
        if hypothesis != "axisymmetric" or axis == up
    )
    across = {"plane_stress": (0, 1), "axisymmetric": (0, 2), "solid": (0,)}[hypothesis]
    strain = np.diag([0.02 if axis in across else 0.0 for axis in range(3)])
    loads = (
        hhr.ThermalExpansion(block.SOLID, "2e-2", "push"),
        hhr.Eigenstrain(block.SOLID, "push", strain.tolist()),
    )
    far = (hhr.Obstacle(block.side(up, upper=True), tuple(np.eye(up + 1)[up]), 50.0),)
    outputs = (hhr.VonMises("peak", block.SOLID),)
    free = dataclasses.replace(
        scene, displacements=rollers, loads=loads, contacts=far, outputs=outputs
    )
    answer = hhr.FullOrderModel(free).solve(scene.parameters.upper)
    assert np.abs(answer.displacement()).max() > 1e-3
    assert answer.outputs()["peak"] < 1e-12
