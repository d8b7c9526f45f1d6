"""Condensation without a training: forces as the full model has them, fields if they are asked
for.
"""

import numpy as np
import pytest
from needs import needs, present
from scenes import check_alike, largest_difference, pressed_pair
from tubes import tube

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import HHRError, ReductionError, SceneError
from hhr_dolfinx.formulas import coordinate_names
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.eliminations.constant import ConstantElimination

OUTPUTS = hhr.LargestPressure("peak", 0), hhr.ContactForce("force", 0, (0.0, 1.0))
MATERIALS = {"E1": (1.0, 6.0), "nu1": (0.1, 0.42), "E2": (2.0, 90.0)}


def scene(name, **changes):
    """Of constant stiffness, of moduli that vary, or of a shape that does."""
    bodies, box, more = ((3.0, 0.3), (4.0, 0.3)), {}, {"outputs": OUTPUTS, "cells": 4}
    if name == "moduli":
        bodies, box = (("E1", "nu1"), ("E2", 0.3)), MATERIALS
    if name == "shape":
        x, y = coordinate_names("plane_strain")
        box = {"wide": (0.0, 0.05)}
        more |= {
            "matching": False,
            "shapes": (hhr.Shape(two_blocks.SECOND, (f"1 + ({x} - 1) * (1 + wide)", y)),),
            "cells": 2,
        }
    return pressed_pair("plane_strain", bodies, box, **more | changes)


KINDS = ["constant", pytest.param("moduli", marks=needs("moduli"))]
KINDS += [pytest.param("shape", marks=needs("nonmatching", "shapes"))]


@pytest.fixture(scope="module", params=KINDS)
def untrained(request):
    """The kind, the full model, and its condensation."""
    full = hhr.FullOrderModel(scene(request.param))
    return request.param, full, hhr.condense(full)


def test_forces_and_their_outputs_are_those_of_the_full_model(untrained):
    """The usual grid leaves 1e-5 of S; a constant stiffness leaves round-off."""
    name, full, model = untrained
    assert isinstance(model, CondensedModel)
    assert isinstance(model.eliminated, ConstantElimination) == (name == "constant")
    tolerance = 1e-11 if name == "constant" else 1e-4
    points = full.parameters.random(20, 0)
    check_alike(full, model, points, forces=tolerance)
    for point in points:
        assert dict(model.outputs(point)) == pytest.approx(dict(full.outputs(point)), rel=tolerance)


def test_it_starts_near_the_end(untrained):
    """Statuses were solved for on S: more than two equality problems are rare."""
    _, full, model = untrained
    counts = [model.solve(point).iterations for point in full.parameters.random(40, 1)]
    assert np.mean(counts) < 2


def test_fields_are_refused_by_name_until_they_are_asked_for(untrained):
    name, full, model = untrained
    answer = model.solve(full.problem.middle)
    if name == "constant":
        assert (
            largest_difference(
                answer.displacement(), full.solve(full.problem.middle).displacement()
            )
            < 1e-11
        )
        return
    with pytest.raises(HHRError, match=r"condensed for contact forces.*fields=True"):
        answer.displacement()
    assert answer.estimate() is None


@needs("moduli")
def test_fields_without_snapshots():
    """Galerkin on what forces move at some nodes: 1e-3 at worst of 20 points, and a bound."""
    model = hhr.condense(scene("moduli"), fields=True)
    full = hhr.FullOrderModel(scene("moduli"))
    off = []
    for point in full.parameters.random(20, 3):
        answer, exact = model.solve(point), full.solve(point)
        off.append(largest_difference(answer.displacement(), exact.displacement()))
        assert answer.estimate() is not None
    assert max(off) < 1e-3 and np.median(off) < 1e-5


@needs("moduli")
def test_an_output_of_the_displacement_brings_fields():
    moved = hhr.DisplacementAt("moved", (1.5, 1.5), 0)
    model = hhr.condense(scene("moduli", outputs=(*OUTPUTS, moved)))
    assert np.isfinite(model.outputs(model.parameters.lower)["moved"])


def test_what_cannot_be_condensed_is_refused():
    with pytest.raises(SceneError, match="is no scene"):
        hhr.condense("scene")
    if present("inelastic"):
        with pytest.raises(ReductionError, match=r"have laws.*made of histories"):
            hhr.condense(tube(hhr.Plasticity(1.0, 0.1), 1.0))
    with pytest.raises(ReductionError, match="fields = 'yes'"):
        hhr.condense(scene("constant"), fields="yes")
