"""Bolts that are shortened or pulled at a section through their shank."""

from dataclasses import replace

import numpy as np
import pytest
from bolted_columns import AREA, LENGTH, YOUNG, column, scene
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileContentError, SceneError


@pytest.mark.parametrize("order", [1, pytest.param(2, marks=needs("second_order"))])
def test_a_bolt_without_resistance_gets_shorter(order, tmp_path):
    """By the shortening, without any stress."""
    path = column(tmp_path / "bolt.inp", order)
    full = hhr.FullOrderModel(scene(path, (hhr.Preload("CUT", "0.01 * p"),)))
    answer = full.solve(0.5)
    assert answer.outputs()["head"] == pytest.approx(-0.005, abs=1e-12)
    assert answer.stress() == pytest.approx(0 * answer.stress(), abs=1e-9)


@pytest.mark.filterwarnings("ignore:kappa")
@pytest.mark.parametrize("order", [1, pytest.param(2, marks=needs("second_order"))])
def test_a_bolt_pushed_apart_presses_the_plate(order, tmp_path):
    """A negative shortening against a plate: force E A (δ - gap) / L, in full, condensed and
    hyper-reduced models.
    """
    path = column(tmp_path / "bolt.inp", order)
    training = hhr.train(
        scene(path, (hhr.Preload("CUT", "-0.01 * p"),), gap=0.002), hhr.Sobol(8), held_out=2
    )
    for model in (training.full_order, hhr.condense(training.full_order), training.build()):
        found = model.solve(0.8).outputs()
        assert abs(found["plate"]) == pytest.approx(
            YOUNG * AREA * (0.008 - 0.002) / LENGTH, rel=1e-6
        )
        assert model.solve(0.15).outputs()["plate"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.filterwarnings("ignore:kappa")
@needs("moduli", "nodal_loads")
def test_the_modulus_of_a_bolt_may_be_a_parameter(tmp_path):
    """The force on the plate is E A (δ - gap) / L for any E, also with the modulus of a spring
    beside it.
    """
    path = column(tmp_path / "bolt.inp")
    varied = {"parameters": hhr.ParameterSpace(("p", "E"), (0.1, 500.0), (1.0, 2000.0))}
    made = scene(path, (hhr.Preload("CUT", "-0.01 * p"),), gap=0.002)
    made = replace(made, bodies=(hhr.Body("BOLT", young="E", poisson=0.3),), **varied)
    for loads, spring in (((), 0.0), ((hhr.Springs("HEAD", 2, 50.0, bedding=True),), 50.0)):
        training = hhr.train(replace(made, loads=loads), hhr.Sobol(8), held_out=2)
        for model in (training.full_order, training.condense(), training.build()):
            for young in (700.0, 1900.0):
                plate = young * AREA * (0.008 - 0.002) / LENGTH - spring * 0.002
                assert abs(model.solve([0.8, young]).outputs()["plate"]) == pytest.approx(
                    plate, rel=1e-6
                )


@needs("elasticity", "nodal_loads")
def test_a_force_draws_the_sides_together(tmp_path):
    """The head is held by a spring: tension F everywhere, the shortening F L / (E A) + F / k, F a
    parameter.
    """
    path = column(tmp_path / "bolt.inp")
    spring = hhr.Springs("HEAD", 2, 50.0, bedding=True)
    loads = (hhr.BoltForce("CUT", "2 * p"), spring)
    full = hhr.FullOrderModel(scene(path, (hhr.ForcedSection("CUT"),), loads))
    answer = full.solve(0.5)
    assert answer.stress()[:, 2] == pytest.approx(np.full(3, 1.0 / AREA), rel=1e-9)
    assert answer.outputs()["head"] == pytest.approx(-1.0 / 50.0, rel=1e-9)


def test_a_section_that_is_no_section_is_refused(tmp_path):
    path = column(tmp_path / "bolt.inp")
    with pytest.raises(FileContentError, match="no section 'NONE'"):
        hhr.CutMesh(path, sections=("NONE",)).read()
    with pytest.raises(FileContentError, match="cells on one side alone"):
        hhr.CutMesh(path, sections=("FOOT",)).read()
    whole = scene(path, (hhr.Preload("CUT", "p"),), sections=())
    with pytest.raises(SceneError, match="no surface of the mesh is called 'CUT'"):
        hhr.FullOrderModel(whole)
    with pytest.raises(SceneError, match="must be a tuple"):
        hhr.CutMesh(path, sections="CUT")
    bent = replace(hhr.CutMesh(column(tmp_path / "bent.inp", slope=0.2)), sections=("CUT",)).read()
    assert len(bent.surfaces["CUT"]) == 1  # an inclined plane is flat


@pytest.mark.parametrize(
    "constraints", [(), (hhr.Preload("CUT", 0.0),), (hhr.ForcedSection("OTHER"),)]
)
def test_a_force_without_its_section_is_refused(constraints, tmp_path):
    """Else it would be a force at two nodes, or none at all."""
    with pytest.raises(SceneError, match="must follow: add ForcedSection"):
        scene(column(tmp_path / "bolt.inp"), constraints, (hhr.BoltForce("CUT", "p"),))
