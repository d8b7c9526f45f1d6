"""Pictures of studies: where pressures lie, in the units of the scene, and what stands on that of all methods."""

import numpy as np
import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.study.report.plots import _front, _point, plot_work_precision
from hhr_dolfinx.study.report.view import View

WIDE = np.array([[0.0, 1.0], [4.0, 1.1], [2.0, 1.0]])


def test_positions_are_along_the_longer_side_in_the_unit_of_the_scene():
    for turned, name in ((WIDE, "x"), (WIDE[:, ::-1], "y")):
        where, label = View().along(turned, 1, hhr.Units("mm", "MPa"))
        assert where.tolist() == [0.0, 4.0, 2.0] and label == f"{name} [mm]"
    assert View().along(WIDE, 0, None)[1] == "x" and View().of(None).stress == "Pa"
    assert View().of(hhr.Units("mm", "MPa")).stress == "MPa" and View(stress="kPa").of(None).stress == "kPa"


def test_a_position_of_ones_own_is_that_of_its_contact():
    view = View(position=lambda places: -places[:, 1], label="depth [m]")
    assert view.along(WIDE, 0, None)[1] == "depth [m]" and view.along(WIDE, 0, None)[0][1] == -1.1
    assert view.along(WIDE, 1, None)[1] == "x"


ROW = {"method": "HHR", "setting": "modes 20", "online_s": 2e-5, "primal_l2": 1e-4, "primal_l2_p95": 1e-3,
       "primal_l2_max": 1e-2, "dual_full_floored": 1e-3}  # fmt: skip


def test_each_method_is_a_point_with_its_worst(tmp_path):
    found = _point(ROW, "primal_l2")
    assert (found.median, found.p95, found.worst) == (1e-4, 1e-3, 1e-2) and not found.exact
    assert _point(ROW, "dual_full_floored").worst == 1e-3  # where nothing else is known
    exact = {**ROW, "method": "condensed", "setting": "exact", "primal_l2": 1e-15, "dual_full_floored": 1e-14}
    assert _point(exact, "primal_l2").exact
    rows = [ROW, exact, {"method": "NNMF", "setting": "40", "refused": "no cone"}, {**ROW, "primal_l2": np.inf}]
    plot_work_precision(rows, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000


def test_nothing_on_the_front_is_beaten():
    assert _front([(1.0, 3.0), (2.0, 4.0), (3.0, 1.0), (1.5, 2.0), (4.0, 1.0)]) == [(1.0, 3.0), (1.5, 2.0), (3.0, 1.0)]


@pytest.mark.parametrize("rows", [[], [{**ROW, "primal_l2": 1e-16, "dual_full_floored": 1e-15}]])
def test_a_picture_without_errors_is_drawn(rows, tmp_path):
    plot_work_precision(rows, tmp_path / "picture.png")
