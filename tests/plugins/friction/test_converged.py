"""Answers and derivatives of one proportional load with friction: what they say of their path, and
their limit.
"""

import re

import numpy as np
import pytest
from sheared_blocks import lifted, rubbing

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, ParameterError, TimeStepWarning
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side
from hhr_dolfinx.plugins.contact_laws import increments

POINT = np.array([0.0213, 0.0187, 0.3])
"""Push, shear and coefficient of friction: contact grows while it is sheared, and no status is
about to change.
"""


def model(cells):
    """Two blocks, of which the upper one touches with a round side."""
    scene = rubbing(
        "mu",
        box={"mu": (0.1, 0.5)},
        geometry=lambda comm: lifted(
            comm, lambda x, y: 0.2 * (x - 0.5) ** 2 * (2 - y), (cells, cells)
        ),
        outputs=(hhr.FrictionForce("friction", 0, (1.0, 0.0)),),
    )
    return hhr.condense(hhr.FullOrderModel(scene))


def marched(made, point, count, **settings):
    """Answer at the end of a proportional load in equal increments."""
    start = np.array([0.0, 0.0, point[2]])
    path = [
        (share, start + share * (point - start))
        for share in np.linspace(0.0, 1.0, count + 1).tolist()
    ]
    weights = np.column_stack([[time for time, _ in path]] * 2 + [np.ones(count + 1)])
    return made.follow(
        path, hhr.MarchSettings(outside="ignore", **settings), weights=weights
    ).answers[-1]


def differences(made, count, steps):
    """Central differences of forces at the end of a path in equal increments, times the sides of
    the box, (m, P).
    """
    found = []
    for axis, step in enumerate(steps):
        ends = [
            marched(made, POINT + way * step * np.eye(3)[axis], count).multipliers
            for way in (1, -1)
        ]
        found.append((ends[0] - ends[1]) / (2 * step))
    return (
        np.stack(found, axis=1)
        * np.subtract(made.parameters.upper, made.parameters.lower)[: len(steps)]
    )


def off(made, answer, right):
    """Error of derivatives of forces over the box, relative to all of them."""
    sides = np.subtract(made.parameters.upper, made.parameters.lower)
    found = (answer.gradient.multipliers * sides)[:, : right.shape[1]]
    return np.linalg.norm(found - right) / np.linalg.norm(right)


def test_answers_and_derivatives_say_that_they_are_of_one_proportional_load():
    """The path starts at the corner of the box, on which the answer depends: it is named."""
    answer = model(4).solve(POINT, gradient=True)
    note = (
        r"one proportional load from push = 0, shear = 0, mu = 0.3 in \d+ increments, forces "
        r"converged to 0?[.\d]+ %"
    )
    for text in (str(answer), answer.note, answer.gradient.note, answer.outputs().note):
        assert re.search(note, text)
    assert (
        "derivatives are those of these increments, and not of their limit" in answer.gradient.note
    )


def test_derivatives_of_the_limit_of_small_increments():
    """By differences of a path of more increments.

    Those of the increments themselves never come near.

    In increments contact sticks to where it was at the start of one, which does not move when the
    load does.
    """
    made = model(6)
    right = differences(made, 256, (4e-4,))
    increments_alone, limit = (
        marched(made, POINT, 64, gradient=True, limit=limit) for limit in (False, True)
    )
    assert off(made, limit, right) < 0.02
    assert off(made, increments_alone, right) > 0.05


def test_converged_derivatives_are_those_of_a_much_finer_path():
    """Differences of a thousand increments, along all parameters."""
    made = model(6)
    right = differences(made, 1000, (4e-4, 4e-4, 2e-3))
    usual, converged = (
        made.solve(POINT, gradient=True),
        made.solve(POINT, gradient=True, converged=True),
    )
    assert off(made, converged, right) < 0.01 < 0.04 < off(made, usual, right)
    fine = marched(made, POINT, 1000).multipliers
    assert np.linalg.norm(converged.multipliers - fine) < 1e-3 * np.linalg.norm(fine)
    assert (
        "those of the limit of small increments, which has converged to" in converged.outputs().note
    )


def test_increments_that_are_too_few_are_named(monkeypatch):
    monkeypatch.setattr(increments, "MOST_INCREMENTS", 4)
    with pytest.warns(TimeStepWarning, match="4 increments of one proportional load are too few"):
        model(4).solve(POINT, converged=True)


def test_converged_is_an_argument_with_friction_alone():
    faces = side(FIRST, 1, True), side(SECOND, 1, False)
    smooth = hhr.FullOrderModel(rubbing(pairing=hhr.NodeToNode(*faces, (0.0, 1.0)), cells=2))
    with pytest.raises(NotOfferedError, match="solve has no argument converged here"):
        smooth.solve([0.02, 0.01], converged=True)
    with pytest.raises(ParameterError, match="limit = 1 must be True or False"):
        hhr.MarchSettings(limit=1)
