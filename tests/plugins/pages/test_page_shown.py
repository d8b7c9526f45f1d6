"""What a page shows and does: its scripts in jsdom, beside the numbers of the model in Python."""

import dataclasses
from functools import cache
from itertools import pairwise

import contract
import numpy as np
import pytest
from condensing import FINE as QUIET
from mpi4py import MPI
from needs import needs
from page_scenes import in_space, known, made, rubbed
from pages_in_node import THERE, drawn_field, rows_of, said, shown

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.pages import page

WIDE, HIGH = 400, 240
"""Size of all canvases in jsdom."""


pytestmark = pytest.mark.skipif(not THERE, reason="node or its package jsdom is not there")


def canvas(view, name):
    """A canvas by its id, or the beginning of its label where it has none."""
    (found,) = [
        item for item in view["canvases"] if (item["id"] or item["label"] or "").startswith(name)
    ]
    return found


def drawn(view, name, call):
    """Arguments of all calls of one kind on a canvas."""
    return [given for kind, *given in canvas(view, name)["calls"] if kind == call]


@cache
def elastic():
    """A page of two blocks whose moduli vary, from a model and the scenery."""
    _, model, scenery = known("moduli")
    return model, scenery, page.page_text(model, scenery)


START = {"push": 0.05, "load": 0.02, "E1": 3.0, "nu": 0.25}
ADDRESS = "&".join(f"{name}={value}" for name, value in START.items())


@cache
def views_of_elastic():
    """At an address, with a slider moved, a number written, reset, stress chosen, copied, and
    another address.
    """
    acts = [
        ("slide", "E1", "4"),
        ("write", "push", "0.01"),
        ("choose", "component", "0"),
        ("choose", "component", "stress"),
        ("choose", "exaggerate", "0"),
        ("click", "copy"),
        ("drag", "pad", (WIDE, 0), (0, HIGH / 2)),
        ("key", "pad", "ArrowRight"),
        ("click", "reset"),
        ("address", "#E1=2&what=1"),
    ]
    return shown(elastic()[2], ADDRESS, *acts)


def test_each_contact_has_its_share_of_a_common_node():
    """The sums of both contacts are their resultants, as outputs of Python say them."""
    _, model, scenery = known("halves")
    (view,) = shown(page.page_text(model, scenery), "press=10")
    sums = [float(row[1]) for row in view["table"] if row[0].startswith("sum of forces")]
    outputs = model.solve({"press": 10.0}).outputs()
    assert sums == [said(outputs[f"force {k}"]) for k in (0, 1)]


@needs("moduli")
def test_numbers_are_those_of_the_model():
    model, scenery, _ = elastic()
    first, slid, written, *_ = views_of_elastic()
    for view, change in ((first, {}), (slid, {"E1": 4.0}), (written, {"E1": 4.0, "push": 0.01})):
        point = START | change
        answer = model.solve(point, gradient=True)
        forces, outputs, rows = answer.forces(), answer.outputs(), rows_of(view)
        assert float(rows["peak"]) == said(outputs["peak"]) and float(rows["force"]) == said(
            outputs["force"]
        )
        assert float(rows["sum of forces"]) == said(forces.sum())
        assert float(rows["largest pressure"]) == said((forces / scenery.areas).max())
        assert rows["active contacts"] == f"{(forces > 0).sum()} of {len(forces)}"
        (slopes,) = [row[2:] for row in view["table"] if row[0] == "peak"]
        exact = outputs.gradient["peak"]
        np.testing.assert_allclose(
            [float(item) for item in slopes], exact, rtol=0, atol=1e-5 * np.abs(exact).max()
        )
        assert view["texts"]["where"] == "at " + ", ".join(
            f"{name} = {value:.15g}" for name, value in point.items()
        )
        assert view["converged"] == "true" and "a proved bound" in view["texts"]["error"]


@needs("moduli")
def test_parameters_go_to_the_address_and_come_from_it():
    *_, pulled, keyed, reset, elsewhere = views_of_elastic()
    model = elastic()[0]
    names, lower, upper = model.parameters.names, model.parameters.lower, model.parameters.upper
    slid = views_of_elastic()[1]
    assert slid["hash"] == "#push=0.05&load=0.02&E1=4&nu=0.25" and slid["inputs"][2] == 4
    # the pad is across the first parameter and up the second: dragged to its right upper corner,
    # and to the left edge
    assert pulled["inputs"][:2] == pytest.approx([lower[0], (lower[1] + upper[1]) / 2], rel=1e-12)
    assert keyed["inputs"][0] == pytest.approx(lower[0] + 0.02 * (upper[0] - lower[0]), rel=1e-12)
    np.testing.assert_allclose(reset["inputs"], (np.array(lower) + upper) / 2, rtol=1e-12)
    assert elsewhere["inputs"][2] == 2 and "does not know: what." in elsewhere["texts"]["wrong"]
    assert list(names) == ["push", "load", "E1", "nu"]


@needs("moduli")
def test_parameters_have_no_units_of_javascript():
    """Every object of JavaScript has a ``constructor``, and it is not the unit of a parameter of
    this name.
    """
    _, model, scenery = made(contract.blocks(("constructor", 0.3), box={"constructor": (1.0, 6.0)}))
    (view,) = shown(page.page_text(model, scenery), "")
    assert view["labels"] == ["push", "load", "constructor"]


@needs("moduli")
def test_pressures_are_drawn_to_scale_along_the_contact():
    model, scenery, _ = elastic()
    answer = model.solve(START)
    pressures = answer.forces() / scenery.areas
    dots = [(x, y) for x, y, radius, *_ in drawn(views_of_elastic()[0], "pressure along x", "arc")]
    order = np.argsort(scenery.contact_points[:, 0])
    xs, ys = np.array(dots).T
    places, values = scenery.contact_points[order, 0], pressures[order]
    # from the left edge of the plot to its right one, and upwards from zero in one scale
    np.testing.assert_allclose(
        xs, 64 + (places - places[0]) / np.ptp(places) * (WIDE - 64 - 13), atol=1e-9
    )
    zero = HIGH - 36
    scale = (zero - ys[0]) / values[0]
    np.testing.assert_allclose(zero - ys, scale * values, atol=1e-6)
    assert 0 < (zero - ys).max() < HIGH - 36 - 24


@needs("moduli")
def test_the_mesh_is_drawn_where_it_has_moved():
    """Places of nodes are those of the mesh and as many times of the displacement as the page
    says.
    """
    model, scenery, _ = elastic()
    first, _, written, across, stress, still, *_ = views_of_elastic()
    at = START | {"E1": 4.0, "push": 0.01}
    exact, there = (
        drawn_field(model.solve(point), scenery).reshape(-1, 2) for point in (START, at)
    )
    places = np.array(drawn(first, "field", "bufferData")[1][1]).reshape(-1, 3)[:, :2]
    times = float(first["texts"]["times"].split()[0])
    moved = (places - scenery.points) / times
    # drawn by few modes, and times has two digits
    assert np.linalg.norm(moved - exact) < 0.08 * np.linalg.norm(exact)
    assert float(across["texts"]["most"]) == pytest.approx(
        there[:, 0].max(), abs=0.03 * np.abs(there).max()
    )
    assert float(written["texts"]["most"]) == pytest.approx(
        np.linalg.norm(there, axis=1).max(), rel=0.03
    )
    assert (
        "In the middle of cells" in stress["texts"]["drawnby"]
        and float(stress["texts"]["least"]) >= 0
    )
    assert (
        len(drawn(stress, "field", "drawArrays")) == 1
        and len(drawn(first, "field", "drawArrays")) == 0
    )
    assert still["texts"]["times"] == "not at all"


@needs("moduli")
def test_numbers_are_copied_as_a_table():
    view = views_of_elastic()[6]
    assert view["texts"]["said"] in ("", "copied")
    lines = dict(line.split("\t") for line in views_of_elastic()[7]["copied"].splitlines())
    assert float(lines["E1"]) == 4 and float(lines["push"]) == 0.01
    assert said(float(lines["peak"])) == float(rows_of(views_of_elastic()[2])["peak"])


@needs("friction")
def test_a_surface_is_drawn_from_above():
    """A disc for each condition, in the colour of its pressure; a drag turns the mesh."""
    _, model, scenery = made(in_space(0.3, cells=3))
    acts = (
        ("drag", "field", (100, 100), (140, 90)),
        ("key", "field", "ArrowLeft"),
        ("wheel", "field", -250),
    )
    first, turned, keyed, zoomed = shown(page.page_text(model, scenery), "", *acts)
    answer = model.solve(model.parameters.middle)
    forces, own = (values[model.law.normal] for values in (answer.multipliers, scenery.areas))
    discs = drawn(first, "pressures on the surface", "arc")
    # and a dot on each that is closed, by which it sticks or slips
    assert len(discs) == len(forces) + (forces > 0).sum()
    assert all(8 <= x <= WIDE - 8 and 0 <= y <= HIGH for x, y, *_ in discs)
    label = canvas(first, "pressures on the surface")["label"]
    assert float(label.split("at most ")[1]) == pytest.approx((forces / own).max(), rel=1e-5)
    matrices = [
        np.array(drawn(view, "field", "uniformMatrix4fv")[-1][2])
        for view in (first, turned, keyed, zoomed)
    ]
    assert all(np.abs(one - other).max() > 1e-3 for one, other in pairwise(matrices))
    # nearer by what the wheel says, in the two directions of the screen
    screen = np.arange(16) % 4 < 2
    np.testing.assert_allclose(matrices[3][screen], np.exp(0.5) * matrices[2][screen], rtol=1e-6)


@needs("friction")
def test_a_path_with_friction_is_kept_drawn_and_begun_anew():
    _, model, scenery = made(rubbed("Coulomb"))
    acts = (
        ("slide", "shear", "-0.05"),
        ("click", "keep"),
        ("choose", "drawn", "1"),
        ("click", "anew"),
    )
    first, sheared, _, chosen, anew = shown(
        page.page_text(model, scenery), "push=0.03&shear=0.05", *acts
    )
    assert (
        set(first["hidden"]) == {"pace", "hold"}
        and "What has slipped is remembered" in first["texts"]["memory"]
    )
    lines = [line.split("\t") for line in anew["copied"].splitlines()]
    assert lines[0] == ["time", "push", "shear"]
    path = [(float(time), np.array([float(item) for item in point])) for time, *point in lines[1:]]
    np.testing.assert_allclose([path[0][1], path[-1][1]], [[0.0, 0.0], [0.03, -0.05]])
    answer = model.march(path).answers[-1]
    normal = model.law.normal
    dragged = -(answer.multipliers[model.law.tangential] @ model.law.tangents[:, 0])
    for view, exact in ((sheared, answer), (anew, model.solve({"push": 0.03, "shear": -0.05}))):
        rows, statuses = rows_of(view), exact.slip.statuses
        assert float(rows["sum of forces"]) == pytest.approx(
            exact.multipliers[normal].sum(), rel=1e-5
        )
        assert rows["sticking contacts"] == f"{(statuses == 1).sum()} of {len(statuses)}"
        assert rows["slipping contacts"] == f"{(statuses == 2).sum()} of {len(statuses)}"
        assert float(rows["dissipated work"]) == pytest.approx(exact.slip.work.sum(), rel=1e-5)
        assert float(rows["largest accumulated slip"]) == pytest.approx(
            exact.slip.path.max(), rel=1e-5
        )
    assert float(rows_of(sheared)["friction on the first surface, along x"]) == pytest.approx(
        dragged, rel=1e-5
    )
    assert float(rows_of(sheared)["dissipated work"]) > float(rows_of(anew)["dissipated work"])
    # one point of the curve for each increment; another number is another curve
    curves = [drawn(view, "loop", "lineTo") for view in (sheared, chosen)]
    assert len(curves[0]) >= len(path) - 1 and curves[0] != curves[1]


@needs("inelastic", "moduli")
def test_creep_goes_on_where_a_load_is_held():
    """For the seconds that are given; a copied path has its times."""
    from flowing_pages import pair

    model, scenery = (
        pair("back stresses, creep")[1],
        hhr.scenery_of(pair("back stresses, creep")[0]),
    )
    acts = (("set", "seconds", "500"), ("click", "hold"), ("click", "keep"))
    first, _, held, copied = shown(page.page_text(model, scenery), "push=0.04&E1=3", *acts)
    assert "pace" not in first["hidden"] and "hold" not in first["hidden"]
    path = [list(map(float, line.split("\t"))) for line in copied["copied"].splitlines()[1:]]
    times = np.array(path)[:, 0]
    assert times[-11] == pytest.approx(1.0) and times[-1] == pytest.approx(501.0)
    assert np.diff(times[-11:]) == pytest.approx(50.0)
    answer = model.march([(time, np.array(point)) for time, *point in path], QUIET).answers[-1]
    rows = [rows_of(view) for view in (first, held)]
    relaxed, loaded = float(rows[1]["sum of forces"]), float(rows[0]["sum of forces"])
    assert relaxed == pytest.approx(answer.forces().sum(), rel=1e-5) and relaxed < 0.98 * loaded


def test_axes_of_axisymmetry_are_r_and_z():
    scene = dataclasses.replace(contract.blocks(), hypothesis="axisymmetric")
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    (view,) = shown(page.page_text(hhr.condense(full), hhr.scenery_of(full)), "")
    assert canvas(view, "pressure along r")["label"].startswith("pressure along r,")
