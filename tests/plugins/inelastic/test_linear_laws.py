"""Bodies whose laws are linear elasticity: condensed without inelastic strain, as exact as the full
model.
"""

import dataclasses

import numpy as np
import pytest
from condensing import apart
from needs import needs, present
from scenes import pressed_block, pressed_pair

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ReductionError, SceneError
from hhr_dolfinx.forms.laws import Stated, hooke, trace
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND
from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings
from hhr_dolfinx.plugins.inelastic.law import Law
from hhr_dolfinx.plugins.inelastic.laws import Elasticity

AXES = (0.8, 0.6, 0.0), (-0.6, 0.8, 0.0), (0.0, 0.0, 1.0)
WOOD = hhr.Orthotropic(9.0, 3.0, 1.5, 0.4, 0.3, 0.2, 1.0, 0.8, 0.3, AXES)


@dataclasses.dataclass(frozen=True)
class AtPoints(hhr.Orthotropic):
    """The same elasticity as a law that does not say that it is linear: solved at Gauss points."""

    linear_stress = None


WOOD_AT_POINTS = AtPoints(9.0, 3.0, 1.5, 0.4, 0.3, 0.2, 1.0, 0.8, 0.3, AXES)
EXACT = hhr.MarchSettings(
    search="tangent",
    relative_stress=1e-12,
    relative_force=1e-12,
    floor_stress=1e-10,
    outside="ignore",
)


@dataclasses.dataclass(frozen=True)
class Stiffening(Law):
    """Elasticity that grows with the square of the change of volume, C at rest: it has no memory,
    and is not linear.
    """

    def statement(self, at):
        return Stated((1 + trace(at.strain) ** 2) * hooke(at.strain, at.constants))


def path(push, slide, *young):
    """Pushed, then slid under a load of the flank, then let go."""
    points = [
        (0.006, 0.0, 0.0, 0.0),
        (push, slide / 2, 0.0, 0.0),
        (push, slide, 0.05, 0.001),
        (push / 3, 0.0, 0.02, 0.0),
    ]
    return [(float(k), np.array([*point, *young])) for k, point in enumerate(points)]


@pytest.mark.parametrize("hypothesis", ["plane_strain", "plane_stress", "axisymmetric"])
@pytest.mark.parametrize("second", ["wood", "modulus"])
def test_wood_condenses_to_round_off(hypothesis, second, tmp_path):
    """Forces, displacements and stress of other histories than those of training, to the residual
    of full steps, 1e-12 of the forces; from a file to round-off. Beside wood the other body is wood
    too, or elastic with E as a parameter.
    """
    other = (
        hhr.Body(SECOND, "E", 0.3)
        if second == "modulus"
        else hhr.Body(SECOND, 4.0, 0.3, WOOD_AT_POINTS)
    )
    box, young = ({"E": (2.0, 6.0)}, (3.0,)) if second == "modulus" else ({}, ())
    outputs = (
        hhr.LargestPressure("peak", 0),
        *((hhr.ElasticEnergy("energy"),) if present("stress") else ()),
    )
    bodies = hhr.Body(FIRST, 4.0, 0.3, WOOD_AT_POINTS), other
    full = hhr.FullOrderModel(pressed_pair(hypothesis, bodies, box, cells=3, outputs=outputs))
    training = full.march(path(0.03, 0.0, *(2.5,) * len(young)), EXACT)
    model = hhr.build(full, hhr.SnapshotSet.of_histories([training]), CorrectionSettings())
    tried = path(0.05, 0.02, *young)
    exact, found = full.march(tried, EXACT), model.march(tried, EXACT)
    graded = model.march(tried, dataclasses.replace(EXACT, gradient=True)).answers[-1].outputs()
    known = full.march(tried, dataclasses.replace(EXACT, gradient=True)).answers[-1].outputs()
    np.testing.assert_allclose(
        graded.gradient["peak"], known.gradient["peak"], rtol=1e-7, atol=1e-9
    )
    assert exact.answers[1].forces().max() > 0
    assert max(apart(found, exact, ("displacement", "forces", "stress"))) < 1e-9
    for one, two in zip(found.answers, exact.answers, strict=True):
        assert dict(one.outputs()) == pytest.approx(dict(two.outputs()), rel=1e-8)
        assert np.abs(one.plastic_strain()).max() < 1e-14
    hhr.save_model(tmp_path / "wood.npz", model)
    kept = hhr.load_model(tmp_path / "wood.npz").march(tried, EXACT)
    assert max(apart(kept, found, ("displacement", "forces", "stress"))) < 1e-12


@needs("stress")
@pytest.mark.filterwarnings("ignore:body .* has a law, and its cells")
@pytest.mark.parametrize("graded", [False, True])
@pytest.mark.parametrize(
    "cells", ["thin", pytest.param("of_second_order", marks=needs("second_order")), "solid"]
)
def test_wood_is_elastic_from_the_start(cells, graded):
    """As the same law at Gauss points: forces, displacements, energy to round-off; heated too.

    Cells are those that have no mean dilatation beside a law, so that both integrate the same
    stress.
    """
    hypothesis = {"thin": "plane_stress", "of_second_order": "plane_strain", "solid": "solid"}[
        cells
    ]
    scene = pressed_block(hypothesis, simplices=cells == "solid", cells=2)
    outputs = (hhr.ElasticEnergy("energy"),)
    order = 2 if cells == "of_second_order" else 1
    tag = scene.bodies[0].tag
    heat = (hhr.ThermalExpansion(tag, "2e-3", 1.0),) if present("volume_loads") else ()
    grading = (lambda x: 1 + x[0] / 4) if graded else None
    found, kinds = [], []
    for law in (WOOD, WOOD_AT_POINTS):
        bodies = (hhr.Body(tag, 3.0, 0.3, law, grading),)
        full = hhr.FullOrderModel(
            dataclasses.replace(scene, bodies=bodies, outputs=outputs, order=order, loads=heat)
        )
        kinds.append(full.equilibrium is None)
        path = [(0.0, scene.parameters.lower), (1.0, scene.parameters.upper)]
        found.append(full.march(path, EXACT).answers[-1])
    elastic, by_points = found
    assert kinds == [True, False]
    assert elastic.forces().sum() > 0.1
    for one, other in zip(*((item.forces(), item.displacement()) for item in found), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-10 * np.abs(other).max())
    assert dict(elastic.outputs()) == pytest.approx(dict(by_points.outputs()), rel=1e-9)


def test_a_frame_across_the_plane_is_refused_at_the_door():
    """Shear across a plane body would move it out of its plane, which it cannot."""
    across = dataclasses.replace(WOOD, frame=((0.8, 0.0, 0.6), (0.0, 1.0, 0.0), (-0.6, 0.0, 0.8)))
    with pytest.raises(SceneError, match="turns the axis across the plane"):
        pressed_pair("plane_strain", (hhr.Body(FIRST, 4.0, 0.3, across), (4.0, 0.3)), cells=2)


def test_laws_that_could_flow_are_refused_where_they_did_not():
    """At low loads a plastic body looks elastic: training says nothing of what it does beyond."""
    for law in (hhr.Plasticity(1e6, 1.0), hhr.Voce(1e6, 1.0, 1.0)):
        full = hhr.FullOrderModel(
            pressed_pair("plane_strain", (hhr.Body(FIRST, 4.0, 0.3, law), (4.0, 0.3)), cells=2)
        )
        histories = hhr.SnapshotSet.of_histories([full.march(path(0.03, 0.0))])
        with pytest.raises(ReductionError, match="no body flows in any training history"):
            hhr.build(full, histories, CorrectionSettings())


@pytest.mark.parametrize("thin", [False, True])
def test_which_laws_are_linear(thin):
    """By their programs, not by their names.

    In plane stress with a strain across that is solved for.
    """
    linear = {law: law.at_points(4, plane_stress=thin).linear for law in (WOOD, Elasticity())}
    assert all(linear.values())
    curved = Stiffening(), hhr.Plasticity(1.0, 1.0), hhr.Voce(1.0, 1.0, 1.0), hhr.Norton(1.0, 3.0)
    assert not any(law.at_points(4, plane_stress=thin).linear for law in curved)
    assert WOOD.at_points(6).linear and not Stiffening().at_points(6).linear
