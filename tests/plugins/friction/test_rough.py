"""Surfaces that never slip: a large coefficient of friction, and words for an infinite one."""

import dataclasses

import numpy as np
import pytest
import split_interface
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError

pytestmark = needs("friction")


def scene(friction):
    pair = hhr.NodeToNode(
        split_interface.UPPER[0], split_interface.LOWER[0], (0, -1), friction=friction
    )
    return split_interface.scene((pair,), split=False, outputs=())


@pytest.mark.parametrize("endless", [float("inf"), np.float64("inf"), "inf", "Infinity", "rough"])
def test_an_infinite_coefficient_names_the_large_one(endless):
    with pytest.raises(
        SceneError, match=r"must be finite: surfaces that never slip .* a large number, such as 1e6"
    ):
        scene(endless)
    with pytest.raises(SceneError, match=r"must be finite: .* take a Tie"):
        scene(hhr.Coulomb(0.3, endless))


def test_a_parameter_may_have_the_name():
    box = hhr.ParameterSpace(("press", "rough"), (0.0, 0.0), (20.0, 1.0))
    pair = dataclasses.replace(scene(0.3).contacts[0], friction="rough")
    made = split_interface.scene((pair,), split=False, outputs=(), parameters=box)
    assert made.laws[0].coefficient == "rough"


def test_large_coefficients_stick_with_the_same_digits():
    """A sheared pair sticks: with nu = 0 the blocks are one column, whose shear is that of all
    answers.
    """
    pull = hhr.Displacement(
        split_interface.side(split_interface.SECOND, 1, upper=True),
        0,
        hhr.Amplitude(slopes={"press": 1e-3}),
    )
    found = []
    for friction in (1e3, 1e9):
        made = scene(friction)
        made = dataclasses.replace(
            made, displacements=(*made.displacements[:2], made.displacements[3], pull)
        )
        answer = hhr.FullOrderModel(made).march([(0.0, 0.0), (1.0, 10.0)]).answers[-1]
        assert (answer.slip.statuses[answer.slip.pressure > 0] == 1).all()
        found.append(answer.displacement())
    assert found[1] == pytest.approx(found[0], rel=1e-9, abs=1e-15)
