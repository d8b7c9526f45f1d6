"""Positions in pictures of studies, in the units of the scene, and times of queries."""

import numpy as np
import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotSolvableError, StudyError
from hhr_dolfinx.plugins.studies.plots import along, in_units
from hhr_dolfinx.plugins.studies.points import WARM_UP, time_queries
from hhr_dolfinx.plugins.studies.settings import View

WIDE = np.array([[0.0, 1.0], [4.0, 1.1], [2.0, 1.0]])


def test_positions_are_along_the_longer_side_in_the_unit_of_the_scene():
    for turned, name in ((WIDE, "x"), (WIDE[:, ::-1], "y")):
        where, label = along(View(), turned, 1, hhr.Units("mm", "MPa"))
        assert where.tolist() == [0.0, 4.0, 2.0] and label == f"{name} [mm]"
    assert along(View(), WIDE, 0, None)[1] == "x" and in_units(View(), None).stress == "Pa"
    assert in_units(View(), hhr.Units("mm", "MPa")).stress == "MPa"
    assert in_units(View(stress="kPa"), None).stress == "kPa"


def test_a_position_of_ones_own_is_that_of_its_contact():
    view = View(position=lambda places: -places[:, 1], label="depth [m]")
    assert along(view, WIDE, 0, None)[1] == "depth [m]" and along(view, WIDE, 0, None)[0][1] == -1.1
    assert along(view, WIDE, 1, None)[1] == "x"


def test_queries_are_timed_behind_a_warm_up():
    asked = []

    def solve(point):
        asked.append(point)
        raise NotSolvableError("counts with its time")

    times = time_queries({"model": solve}, np.arange(WARM_UP + 3.0)[:, None])
    assert times["model"].shape == (3,) and len(asked) == WARM_UP + 3
    with pytest.raises(StudyError, match=f"5 points cannot be timed: {WARM_UP} are a warm-up"):
        time_queries({"model": solve}, np.zeros((WARM_UP, 1)))
