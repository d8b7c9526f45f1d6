"""Strains that are not small: warned of from a tenth, refused from one, along histories and in
training.
"""

import dataclasses
import re
import warnings
from contextlib import nullcontext

import numpy as np
import pytest
from needs import needs
from scenes import block_scene, pressed_block, slope, space, squeezed
from tubes import tube

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.errors import (
    ConvergenceError,
    OutsideTrainingError,
    OutsideTrainingWarning,
    ReductionError,
    SmallStrainWarning,
)
from hhr_dolfinx.geometries import block
from hhr_dolfinx.plugins.small_strains import cells
from hhr_dolfinx.plugins.small_strains.limit import narrowed
from hhr_dolfinx.study.condensing import condensed
from hhr_dolfinx.trained import TrainedRange
from hhr_dolfinx.warn import collected


def held(seconds, steps=8):
    """A pressure put on at once and held."""
    return [(0.0, [0.0]), *((seconds * k / steps, [1.0]) for k in range(1, steps + 1))]


@needs("inelastic")
def test_histories_full_and_small():
    """A tube that creeps under pressure, full and condensed: strains grow with time."""
    import condensing

    full = hhr.FullOrderModel(condensing.walled_tube(hhr.Norton(1.0, 1.0), wall=100.0, cells=4))
    known = [full.march(held(seconds)) for seconds in (0.01, 0.02)]
    for model in (full, condensing.condensed(full, known, trust=None)):
        with warnings.catch_warnings(action="error", category=SmallStrainWarning):
            short = model.march(held(0.02), condensing.QUIET)
        assert short.answers[-1].plastic_strain().max() < 0.1
        with pytest.warns(
            SmallStrainWarning, match="no small strain, and answers are those of small strains"
        ):
            model.march(held(0.3), condensing.QUIET)
        with pytest.raises(ConvergenceError, match="no small strain"):
            model.march(held(10.0), dataclasses.replace(condensing.QUIET, cuts=0))


def test_strains_in_cells_are_those_of_a_linear_field():
    """A linear field on the tube has its own strain in each cell, the hoop one among them."""
    problem = hhr.FullOrderModel(tube(None, 1.0, cells=3)).problem
    r, z = problem.points.T
    field = np.stack([0.2 * r + 0.06 * z, 0.04 * r - 0.1 * z], axis=1).ravel()
    found = (cells.strain_kinds(problem, axisymmetric=True)[0].matrix @ field).reshape(
        len(problem.cell_nodes), 4
    )
    middle = problem.points[problem.cell_nodes].mean(axis=1)
    assert found[:, :3] == pytest.approx(np.tile([0.2, 0.05, -0.1], (len(middle), 1)), abs=1e-14)
    assert found[:, 3] == pytest.approx(0.2 + 0.06 * middle[:, 1] / middle[:, 0], abs=1e-14)


@pytest.mark.parametrize("hypothesis", ["plane_strain", "solid"])
def test_rotations_in_cells_are_those_of_a_rigid_motion(hypothesis):
    """u = w x p about an axis has the rotation w in each cell, and no strain."""
    problem = hhr.FullOrderModel(pressed_block(hypothesis)).problem
    dim = problem.points.shape[1]
    turn = np.zeros((dim, dim))
    turn[np.triu_indices(dim, 1)] = -np.arange(1, dim * (dim - 1) // 2 + 1) / 10.0
    turn -= turn.T
    field = (problem.points @ turn.T).ravel()
    strain, rotation = cells.strain_kinds(problem, axisymmetric=False)
    found = (rotation.matrix @ field).reshape(len(problem.cell_nodes), -1)
    assert found == pytest.approx(
        np.tile(-turn[np.triu_indices(dim, 1)], (len(found), 1)), abs=1e-13
    )
    assert np.abs(strain.matrix @ field).max() < 1e-13


def strip(push):
    """A strip of 20 x 0.5, clamped at one end, the other one pushed down over a floor that lies 1
    below it.
    """
    left, right, floor = (
        block.side(0, upper=False),
        block.side(0, upper=True),
        block.side(1, upper=False),
    )
    held = (*hhr.Displacement.clamp(left, 2), hhr.Displacement(right, 1, slope("push", -1.0)))
    contacts = (hhr.Obstacle(floor, (0.0, -1.0), 20.0),)
    size = {"upper": (20, 0.5), "cells": (80, 2)}
    return block_scene(
        "strip", {"push": (0.0, push)}, contacts=contacts, displacements=held, **size
    )


def shortened(push):
    """A block of height 2: the strain is a little less than half of the push."""
    return dataclasses.replace(pressed_block("plane_strain"), parameters=space(push=(0.0, push)))


@pytest.mark.parametrize(
    ("scene", "warned", "refused"),
    [
        (shortened(0.15), None, None),
        (shortened(0.5), "push = 0.5: a strain of 0.25 ", None),
        (shortened(4.0), None, r"push = 4: a strain of 2 at .* mean nothing at 1"),
        (strip(0.5), None, None),
        (strip(4.0), r"push = 4: a rotation of 0\.3 rad.*w\^2 / 2 = 0\.04", None),
        (strip(18.0), None, r"push = 18: a rotation of 1\.\d+ rad in more than 1% of the cells"),
    ],
)
def test_training_of_elastic_bodies(scene, warned, refused):
    """The end of the strip turns by 3/2 of push / 20, and strains by a fortieth of that."""
    raises = pytest.raises(ReductionError, match=refused) if refused else nullcontext()
    with collected(SmallStrainWarning) as caught, raises:
        hhr.train(scene, 3, held_out=0)
    assert len(caught) == (warned is not None) and all(
        re.search(warned, item.message) for item in caught
    )


@pytest.mark.filterwarnings("ignore:.*kept out of training")
def test_corners_of_the_box_of_a_model_are_looked_at():
    """A training may keep clear of them: a strain of (deepest - .5) / 10 is that of the whole
    block.
    """
    full = hhr.FullOrderModel(squeezed(12.0))
    with pytest.raises(ReductionError, match=r"at down = 12: a strain of 1\.[12]"):
        full.strains.check_corners(full, condensed(full))
    with warnings.catch_warnings(action="error", category=SmallStrainWarning):
        hhr.condense(squeezed(1.0))
        full = hhr.FullOrderModel(squeezed(3.0))
        with pytest.raises(SmallStrainWarning, match=r"at down = 3: a strain of 0\.2"):
            full.strains.check_corners(full, condensed(full))


def test_each_verb_warns_of_strains_that_are_large():
    """The full model at the first answer that has them, and once more beyond all sense.

    Condensation of its box.
    """
    full = hhr.FullOrderModel(squeezed(12.0))
    with collected(SmallStrainWarning) as caught:
        for down in (0.7, 3.0, 3.5, 11.9, 12.0):
            full.solve([down])
    first, second = (item.message for item in caught)
    assert first.startswith("at down = 3: a strain of 0.2") and second.startswith(
        "at down = 11.9: a strain of 1.2"
    )
    with pytest.warns(SmallStrainWarning, match=r"at down = 12: a strain of .*narrow it"):
        hhr.condense(squeezed(12.0))


def test_a_model_keeps_the_limit_of_its_strains(tmp_path):
    """A strain of 1 is that of (down - .5) / 10 within a tenth.

    A file, its answers and a table know the limit.
    """
    with pytest.warns(
        SmallStrainWarning, match=r"are refused or warned of beyond down = 0 to (9|10)\."
    ):
        model = hhr.condense(squeezed(12.0))
    (limit,) = model.trained.upper
    strain = (
        hhr.FullOrderModel(squeezed(12.0))
        .strains._of_corners(model, np.array([[0.0], [limit]]))[1]
        .max()
    )
    assert 0.99 < strain <= 1 and limit == pytest.approx(10.5, rel=0.1)
    hhr.save_model(tmp_path / "model.npz", model)
    read = hhr.load_model(tmp_path / "model.npz")
    with pytest.warns(
        OutsideTrainingWarning, match="strains or rotations above 1, .* lower the load"
    ):
        read.solve(11.9)
    with pytest.raises(OutsideTrainingError, match="beyond down = 0 to"):
        read.solve(11.9, outside="refuse")
    with warnings.catch_warnings(action="error"):
        read.solve(0.9 * limit)


def test_a_load_that_is_largest_in_the_middle_of_the_box():
    """The lid goes down by 12 t (2 - t), and not at all in the corners.

    A strain of 1 is that of t = 0.6.
    """
    scene = squeezed(12.0)
    still, moved = scene.displacements
    moved = dataclasses.replace(moved, amplitude="-12 * t * (2 - t)")
    space = hhr.ParameterSpace(("t",), (0.0,), (2.0,))
    with pytest.warns(
        SmallStrainWarning, match=r"at t = 1: a strain of 1\.[12].*beyond t = 0 to 0\.5"
    ):
        model = hhr.condense(
            dataclasses.replace(scene, displacements=(still, moved), parameters=space)
        )
    assert model.trained.upper == pytest.approx([0.6], abs=0.05)


def test_one_parameter_is_narrowed_if_that_is_enough():
    """Strains are 1.25 |a|, and grow no more with E: a is kept as far as it may go, E whole.

    A range before is kept.
    """
    space = hhr.ParameterSpace(("a", "E"), (-1.0, 1.0), (2.0, 3.0))
    found = narrowed(space, lambda ends: 1.25 * np.abs(ends[:, 0]).max(), None)
    assert found.upper == pytest.approx([0.8, 3.0], rel=2e-3) and found.lower == pytest.approx(
        [-0.4, 1.0], rel=2e-3
    )
    before = TrainedRange(("a", "E"), np.array([0.0, 1.5]), np.array([2.0, 3.0]))
    assert narrowed(space, lambda ends: 1.25 * np.abs(ends[:, 0]).max(), before).lower.tolist() == [
        0.0,
        1.5,
    ]
    assert narrowed(space, lambda ends: 2.0, None) is None


def test_cells_that_are_looked_at_stand_for_all(monkeypatch):
    """Every third cell of a field that is the same in all."""
    monkeypatch.setattr(cells, "SAMPLED_CELLS", 6)
    problem = hhr.FullOrderModel(squeezed(3.0)).problem
    strain = cells.strain_kinds(problem, axisymmetric=False)[0]
    assert 4 <= strain.cells <= 6
    assert strain.sizes((problem.points * [0.25, 0.0]).ravel()[:, None]) == pytest.approx(0.25)


def test_without_the_plug_in_nothing_is_checked(monkeypatch):
    monkeypatch.setattr(registry, "offered", lambda word: None)
    with warnings.catch_warnings(action="error", category=SmallStrainWarning):
        assert (
            hhr.condense(full := hhr.FullOrderModel(squeezed(12.0))).fields.exact
            and full.solve([12.0]).converged
        )
