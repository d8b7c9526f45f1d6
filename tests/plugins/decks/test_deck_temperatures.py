"""Temperatures of decks that differ from node to node."""

import dataclasses
import shutil
import subprocess

import numpy as np
import pytest
from deck_texts import bar, blocks, started_file
from deck_writer import Writer, at
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.command.loading import beside, scene_of
from hhr_dolfinx.errors import SceneError

EXPANSION = "*EXPANSION\n1e-4\n"
ALONG = "".join(f"{1 + k}, {20.0 + 30.0 * (k % 5)!r}\n" for k in range(20))
"""20 at x = 0 to 140 at x = 4: nodes are numbered along x first."""
START = "*INITIAL CONDITIONS, TYPE=TEMPERATURE\nALL, 20.\n"


def test_a_bar_with_a_gradient(tmp_path):
    """The end moves by alpha L times the mean rise of 60, by reciprocity with a uniform pressure
    there.
    """
    name, output = started_file(tmp_path, bar("*TEMPERATURE\n" + ALONG, EXPANSION + START))
    assert "TODO" not in output
    scene = scene_of(name)
    assert scene.parameters.middle == pytest.approx([120.0])
    full = hhr.FullOrderModel(scene)
    moved = full.solve([120.0]).displacement().reshape(-1, 3)
    end = moved[full.problem.points[:, 0] > 4 - 1e-9]
    assert len(end) == 4
    assert end[:, 0].mean() == pytest.approx(4 * 1e-4 * 60, rel=1e-12)


@pytest.mark.skipif(shutil.which("ccx") is None, reason="ccx, CalculiX, is not installed")
def test_as_calculix(tmp_path):
    """Displacements of CalculiX on the same cells.

    In it the temperature of a cell of C3D8 is constant, its mean.
    """
    places = [
        (x, y, z)
        for z in (0.0, 0.5, 1.0)
        for y in (0.0, 0.5, 1.0)
        for x in np.linspace(0.0, 4.0, 9).tolist()
    ]
    rows = "".join(
        f"{1 + k}, {20.0 + 10.0 * x * x + 8.0 * x * y!r}\n" for k, (x, y, _) in enumerate(places)
    )
    text = bar(
        "*TEMPERATURE\n" + rows + "*NODE PRINT, NSET=ALL\nU", EXPANSION + START, cells=(8, 2, 2)
    )
    name, _ = started_file(tmp_path, text)
    subprocess.run(["ccx", "deck"], cwd=tmp_path, check=True, capture_output=True)
    lines = (tmp_path / "deck.dat").read_text().splitlines()
    printed = np.array([line.split() for line in lines if len(line.split()) == 4], dtype=float)[
        :, 1:
    ]
    full = hhr.FullOrderModel(scene_of(name))
    moved = full.solve(full.parameters.middle).displacement().reshape(-1, 3)
    order = [np.abs(full.problem.points - place).sum(axis=1).argmin() for place in places]
    np.testing.assert_allclose(moved[order], printed, atol=1e-6 * np.abs(printed).max())


@pytest.mark.parametrize("kind", ["C3D20", "C3D10", "CPE8", "CPE6"])
def test_nodes_on_edges_have_temperatures(kind, tmp_path):
    """A bar at 10 x^2, of which corners alone have 3 % more: the end moves by alpha times the
    integral, by reciprocity.

    Without Poisson's ratio also in the plane.
    """
    dim = 2 if kind.startswith("CPE") else 3
    deck = Writer()
    made = deck.box("EALL", kind, (4, 1, 1)[:dim], (0,) * dim, (4, 1, 1)[:dim])
    for axis in range(dim):
        deck.nset(f"LOW{axis}", made.nodes(at(axis, 0)))
    deck.material(1000.0, 0.0, more="*EXPANSION/1e-4")
    deck.section()
    rows = zip(made.numbers.tolist(), made.points[:, 0].tolist(), strict=True)
    deck.add(
        "*BOUNDARY/"
        + "/".join(f"LOW{axis}, {axis + 1}" for axis in range(dim))
        + "/*STEP/*STATIC/*TEMPERATURE"
    )
    deck.add("/".join(f"{node}, {10.0 * x * x!r}" for node, x in rows) + "/*END STEP")
    name, output = started_file(tmp_path, deck.text)
    assert "TODO" not in output
    full = hhr.FullOrderModel(scene_of(name))
    moved = full.solve(full.parameters.middle).displacement().reshape(-1, dim)[:, 0]
    tip = np.abs(full.problem.points[:, 0] - 4.0) < 1e-9
    # shares of nodes in a uniform pressure, by the number of their coordinates in the middle
    middles = (np.abs(full.problem.points[tip, 1:dim] - 0.5) < 1e-9).sum(axis=1)
    shares = {"C3D20": (1 / 36, 1 / 9, 4 / 9), "C3D10": (0, 1 / 6, 1 / 3)}.get(kind, (1 / 6, 2 / 3))
    mean = np.array(shares)[middles] @ moved[tip]
    assert mean == pytest.approx(1e-4 * 10.0 * 4.0**3 / 3, rel=1e-6)


def test_a_set_with_membranes_too(tmp_path):
    """The end moves as without one on a side of its cells."""
    membrane = "*ELEMENT, TYPE=M3D4, ELSET=BAR\n900, 1, 2, 7, 6\n*MATERIAL"
    text = bar("*TEMPERATURE\n" + ALONG, EXPANSION + START).replace("*MATERIAL", membrane, 1)
    full = hhr.FullOrderModel(scene_of(started_file(tmp_path, text)[0]))
    moved = full.solve(full.parameters.middle).displacement().reshape(-1, 3)
    tip = np.abs(full.problem.points[:, 0] - 4.0) < 1e-9
    assert moved[tip, 0].mean() == pytest.approx(1e-4 * 4 * 60, rel=1e-9)


@needs("floating")
def test_one_body_of_two(tmp_path):
    """A body with one temperature keeps a number.

    Nodes that coincide with hot ones of the other body stay cold.
    """
    hot = "".join(f"{1001 + k}, {50.0 + k!r}\n" for k in range(32))
    text = blocks("*TEMPERATURE\nLOWER_Z0, 0.\n" + hot).replace(
        "1000., 0.0\n", "1000., 0.0\n*EXPANSION\n1e-4\n"
    )
    name, _ = started_file(tmp_path, text)
    (load,) = scene_of(name).loads
    assert (load.tag, load.field.tag) == ("UPPER", "UPPER")
    assert hhr.FullOrderModel(scene_of(name)).solve([81.0]).converged


def test_a_course_over_steps(tmp_path):
    """Heated and cooled down: the field follows with one factor."""
    step = "*AMPLITUDE, NAME=A\n0., 0., .5, 1., 1., .2\n*TEMPERATURE, AMPLITUDE=A\n" + ALONG
    name, output = started_file(tmp_path, bar(step, EXPANSION + "*PLASTIC\n8., 0.\n12., 0.04\n"))
    assert "TODO" not in output
    path = beside(name, "PATHS")
    assert [point[0] for _, point in path.path(path.own.middle)][::4] == pytest.approx(
        [0.0, 140.0, 28.0]
    )


def test_a_distribution_that_changes(tmp_path):
    """It has no one field, and is said."""
    step = (
        "*TEMPERATURE\n" + ALONG + "*END STEP\n*STEP\n*STATIC\n1., 1.\n*TEMPERATURE\nBAR_X0, 140.\n"
    )
    _, output = started_file(tmp_path, bar(step, EXPANSION + "*PLASTIC\n8., 0.\n12., 0.04\n"))
    assert "the distribution of the temperature of body 'BAR' changes with the steps" in output


def test_a_body_that_is_not_there(tmp_path):
    """A field of an unknown body is refused by its name."""
    (tmp_path / "deck.inp").write_text(bar("*TEMPERATURE\n" + ALONG, EXPANSION))
    name, _ = started_file(tmp_path, bar("*TEMPERATURE\n" + ALONG, EXPANSION))
    scene = scene_of(name)
    field = hhr.DeckTemperatures(tmp_path / "deck.inp", "BEAM")
    wrong = dataclasses.replace(
        scene, loads=(hhr.ThermalExpansion("BAR", 1e-4, "temperature", field=field),)
    )
    with pytest.raises(SceneError, match="has no body 'BEAM'"):
        hhr.FullOrderModel(wrong)


def test_nodes_that_coincide_keep_their_temperatures(tmp_path):
    """Two cubes of one set, of which the upper one is heated by 50 and held at its foot: only it
    expands.
    """
    hot = "UPPER_Z0, 50.\nUPPER_Z1, 50.\nLOWER_Z0, 0.\nLOWER_Z1, 0.\n"
    text = blocks("*TEMPERATURE\n" + hot, before="UPPER_Z0, 3").replace(
        "1000., 0.0\n", "1000., 0.0\n*EXPANSION\n1e-4\n"
    )
    sections = (
        "*SOLID SECTION, ELSET=LOWER, MATERIAL=STEEL\n*SOLID SECTION, ELSET=UPPER, MATERIAL=STEEL\n"
    )
    assert sections in text
    both = "*ELSET, ELSET=BOTH\nLOWER, UPPER\n*SOLID SECTION, ELSET=BOTH, MATERIAL=STEEL\n"
    name, output = started_file(tmp_path, text.replace(sections, both))
    assert "TODO" not in output
    full = hhr.FullOrderModel(scene_of(name))
    answer = full.solve(full.parameters.middle)
    moved = answer.displacement().reshape(-1, 3)
    lid = full.problem.points[:, 2] > 1.9
    assert moved[lid, 2] == pytest.approx(np.full(lid.sum(), 50e-4), rel=1e-9)
    assert np.abs(moved[full.problem.points[:, 2] < 0.1]).max() < 1e-12
