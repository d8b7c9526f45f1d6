"""Elasticity of a user's own in UFL: that of Hooke gives the same answers, an orthotropic one its closed form."""

import dataclasses

import numpy as np
import pytest
import ufl
from mpi4py import MPI
from needs import needs
from scenes import pressed_block
from toy_law import Bingham

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries import block

LAMBDA, SHEAR = 3.0 * 0.3 / 1.3 / 0.4, 3.0 / 2.6
"""Of E = 3 and nu = 0.3, as the block has."""


def hooke(strain):
    return LAMBDA * ufl.tr(strain) * ufl.Identity(3) + 2 * SHEAR * strain


def own(scene, stress):
    return dataclasses.replace(scene, bodies=tuple(dataclasses.replace(body, stress=stress) for body in scene.bodies))


@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric", "solid"])
def test_hookes_law_written_out(hypothesis):
    scene = pressed_block(hypothesis)
    one, two = (hhr.FullOrderModel(item, MPI.COMM_SELF).solve(0.05) for item in (scene, own(scene, hooke)))
    np.testing.assert_allclose(two.displacement(), one.displacement(), atol=1e-12 * abs(one.displacement()).max())
    np.testing.assert_allclose(two.stress(), one.stress(), atol=1e-11 * abs(one.stress()).max())


def test_layers_across_the_load_are_as_stiff_as_they_are():
    """Without coupling of the axes a column in plane strain has the pressure E_y times its shortening."""
    stiff = (30.0, 7.0, 1.0)

    def layered(strain):
        rows = [[stiff[i] if i == j else 2.0 for j in range(3)] for i in range(3)]
        return ufl.elem_mult(ufl.as_tensor(rows), strain)

    training = hhr.train(own(pressed_block("plane_strain"), layered), [8], comm=MPI.COMM_SELF, held_out=20)
    full, model = training.full_order, training.build()
    for exact in (full.solve(0.05), model.solve(0.05)):
        # the gap of 0.02 closes first; the block is 2 high and 1.5 wide in this scene
        stress = exact.stress()[:, 1]
        assert np.ptp(stress) < 1e-9 * abs(stress).max()
        assert exact.forces().sum() == pytest.approx(-stress.mean() * 1.5, rel=1e-9)
    strain = -full.solve(0.05).stress()[:, 1].mean() / 7.0
    top = full.problem.points[:, 1] == full.problem.points[:, 1].max()
    moved = full.solve(0.05).displacement().reshape(-1, 2)[:, 1]
    bottom = full.problem.points[:, 1] == full.problem.points[:, 1].min()
    height = np.ptp(full.problem.points[:, 1])
    assert strain == pytest.approx((moved[bottom].mean() - moved[top].mean()) / height, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stress": 3.0}, "the stress 3.0 must be a function of the strain"),
        pytest.param({"law": Bingham(1.0, 1.0)}, "a stress of its own, and a law", marks=needs("inelastic")),
        ({"grading": lambda x: 1 + x[0]}, "a stress of its own, and a law, a grading"),
        ({"young": "push + 1"}, "a stress of its own, and a law, a grading or formulas"),
    ],
)
def test_what_is_not_built_in_is_refused(change, message):
    with pytest.raises(SceneError, match=message):
        hhr.Body(block.SOLID, **({"young": 1.0, "poisson": 0.3, "stress": hooke} | change))


@needs("stress")
def test_plane_stress_and_outputs_that_need_moduli():
    with pytest.raises(SceneError, match=r"a stress of their own: .* not in plane stress"):
        own(pressed_block("plane_stress"), hooke)
    scene = dataclasses.replace(
        own(pressed_block("plane_strain"), hooke), outputs=(hhr.VonMises("stress", block.SOLID),))  # fmt: skip
    with pytest.raises(SceneError, match=r"output 'stress': body .* has a stress of its own"):
        hhr.FullOrderModel(scene)
