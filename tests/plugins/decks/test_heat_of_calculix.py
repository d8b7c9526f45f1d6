"""Decks with heat: `hhr start` writes scene and heat, whose answers are those of CalculiX."""

import runpy
import subprocess
import sys

import numpy as np
import pytest
from deck_runs import run_calculix, started
from deck_texts import block_lines
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ParameterError

pytestmark = [needs("contact_heat"), pytest.mark.filterwarnings("ignore:parameters")]
TABLE = "2., 0., 0.\n30., 20., 0.\n50., 60., 0."
OF_TABLE = "table(p, 0.0, 2.0, 20.0, 30.0, 60.0, 50.0, 1000000000.0, 50.0)"
CONDUCTIVITY, EXPANSION, COLD, WARM = 20.0, 1e-4, 0.0, 100.0
THERMAL = f"*EXPANSION, ZERO=0.\n{EXPANSION}\n*CONDUCTIVITY\n{CONDUCTIVITY}"


def deck(poisson, cold="LOWER_Z0", conductance=None, kind="NODE TO SURFACE"):
    """Two cubes pressed on each other, with heat where there is a conductance."""
    lines = block_lines("LOWER", 1, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (3, 3, 2))
    lines += block_lines("UPPER", 1001, (0.0, 0.0, 1.0), (1.0, 1.0, 2.0), (3, 3, 2))
    lines += [f"*MATERIAL, NAME=STEEL\n*ELASTIC\n1000., {poisson}"]
    lines += [THERMAL] if conductance else []
    lines += [f"*SOLID SECTION, ELSET={name}, MATERIAL=STEEL" for name in ("LOWER", "UPPER")]
    lines += ["*SURFACE INTERACTION, NAME=TOUCH"]
    if conductance:
        lines += ["*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR\n1e7"]
        lines += [f"*GAP CONDUCTANCE\n{conductance}"]
    lines += [f"*CONTACT PAIR, INTERACTION=TOUCH, TYPE={kind}\nUPPER_BOTTOM, LOWER_TOP"]
    lines += ["*BOUNDARY\nLOWER_Z0, 1, 3\nUPPER_Z1, 1, 2\nUPPER_Z0, 1, 2\nLOWER_Z1, 1, 2"]
    if not conductance:
        return "\n".join([*lines, "*STEP\n*STATIC\n*BOUNDARY\nUPPER_Z1, 3, 3, -.02\n*END STEP\n"])
    lines += ["*INITIAL CONDITIONS, TYPE=TEMPERATURE\nALL, 0."]
    lines += ["*STEP, INC=1000\n*COUPLED TEMPERATURE-DISPLACEMENT, STEADY STATE\n1., 1."]
    lines += [
        "*BOUNDARY\nUPPER_Z1, 3, 3, -.02",
        f"{cold}, 11, 11, {COLD}\nUPPER_Z1, 11, 11, {WARM}",
    ]
    return "\n".join([*lines, "*END STEP\n"])


def by_place(places, temperatures):
    """Temperatures in the order of their places; of two nodes at one, the colder first."""
    return temperatures[np.lexsort([temperatures, *np.round(places, 9).T])]


def asked(cold):
    force = "*NODE PRINT, NSET=LOWER_Z0, TOTALS=ONLY\nRF"
    flow = f"*NODE PRINT, NSET={cold}, TOTALS=ONLY\nRFL"
    return f"{force}\n{flow}\n*NODE PRINT, NSET=ALL\nNT"


def heated(folder, text):
    """Scene and heat of a deck, and what the command printed."""
    scene, said = started(folder, text)
    return scene, runpy.run_path(folder / "deck.py")["HEAT"], said


def temperatures_are_theirs(scene, answer, text, rows, close):
    """At all nodes of a deck, whose rows are numbers and temperatures."""
    lines = [line.split(", ") for line in text.splitlines()]
    places = {int(line[0]): line[1:] for line in lines if len(line) == 4 and "." in line[1]}
    expected = np.array([row[1] for row in rows])
    theirs = by_place(np.array([places[int(row[0])] for row in rows], dtype=float), expected)
    ours = by_place(hhr.FullOrderModel(scene).problem.points, answer.temperature())
    np.testing.assert_allclose(ours, theirs, atol=close * WARM)


@pytest.mark.parametrize(
    ("poisson", "cold", "line", "formula", "kind", "close"),
    [
        # flows from one side to another one around a corner, which the contact determines
        (0.3, "LOWER_X0", "20., , 0.", 20.0, "NODE TO SURFACE", 1e-5),
        (0.3, "LOWER_Z0", "20., , 0.", 20.0, "NODE TO SURFACE", 1e-5),
        # its pairs of nodes do not know their pressure, so by surfaces, whose integrals are ours
        # where pressure and temperature do not change along them
        (0.0, "LOWER_Z0", TABLE, OF_TABLE, "SURFACE TO SURFACE", 2e-3),
    ],
)
def test_flows_and_forces_are_those_of_calculix(
    poisson, cold, line, formula, kind, close, tmp_path
):
    text = deck(poisson, cold, line, kind)
    scene, heat, said = heated(tmp_path, text)
    assert heat.conductance == {0: formula} and scene.parameters.names[1] == "temperature"
    assert ("in Abaqus, without PRESSURE, it is a clearance" in said) == (line is TABLE)
    rows = run_calculix(tmp_path, text, asked(cold))
    if not rows:
        pytest.skip("ccx, CalculiX, is not installed")
    answer = hhr.condense_heat(scene, heat).solve(scene.parameters.middle)
    force, flow = rows[0][2], rows[1][0]
    assert answer.forces().sum() == pytest.approx(force, rel=2e-3)
    assert answer.heat_through(0) == pytest.approx(-flow, rel=close)
    temperatures_are_theirs(scene, answer, text, rows[2:], close)


SUPPLIES = """*DFLUX
LOWER, BF, 30.
FRONT, S3, 4.
*FILM
1, F3, 10., 2.5
2, F3, 10., 2.5
"""
FRONT = "*ELSET, ELSET=FRONT\n1001, 1002, 1003, 1010, 1011, 1012\n*MATERIAL"


def test_fluxes_sources_and_films_are_those_of_calculix(tmp_path):
    """Heat in a body, through faces of its elements by their numbers, and to the surroundings."""
    text = deck(0.3, "LOWER_Z0", "20., , 0.").replace("*MATERIAL", FRONT)
    text = text.replace("*END STEP", SUPPLIES + "*END STEP")
    scene, heat, said = heated(tmp_path, text)
    kinds = [type(supply).__name__ for supply in heat.supplies]
    assert kinds == ["HeatSource", "HeatFlux", "Convection"], said
    rows = run_calculix(tmp_path, text, asked("LOWER_Z0"))
    if not rows:
        pytest.skip("ccx, CalculiX, is not installed")
    answer = hhr.condense_heat(scene, heat).solve(scene.parameters.middle)
    temperatures_are_theirs(scene, answer, text, rows[2:], 1e-4)
    assert answer.temperature().max() > WARM or answer.temperature().min() > COLD - 1


def test_steps_in_time_are_printed_by_the_file(tmp_path):
    """Ten implicit steps, with *DENSITY and *SPECIFIC HEAT, from the initial state."""
    text = deck(0.3, "LOWER_Z0", "20., , 0.")
    text = text.replace("*CONDUCTIVITY", "*DENSITY\n2.\n*SPECIFIC HEAT\n1.5\n*CONDUCTIVITY")
    text = text.replace(", STEADY STATE\n1., 1.", "\n.01, .1").replace("ALL, 0.", "ALL, 7.")
    scene, heat, _ = heated(tmp_path, text)
    assert heat.capacity == {"LOWER": 3.0, "UPPER": 3.0}
    assert heat.reference == {"LOWER": 7.0, "UPPER": 7.0}
    times = [0.1 * (k + 1) / 10 for k in range(10)]
    answers = hhr.condense_transient_heat(scene, heat).march(scene.parameters.middle, times, 7.0)
    said = printed(tmp_path)
    assert said.count("heat 0") == 10
    for answer in answers:
        assert f"heat 0 = {answer.heat_through(0):.6g}" in said


def test_histories_are_those_of_calculix(tmp_path):
    """At a time when 13 degrees of 100 are left to the steady state.

    Short steps here, as those of CalculiX are of another order than implicit ones: ten of them are
    1.4 degrees off, a hundred .42, which is within what lumping the capacities of cells of half a
    cube moves such a column by, .9. A capacity that is 10 % off is 1.6 or 2.4 off. Its steps have
    inertia, so the density is small.
    """
    text = deck(0.3, "LOWER_Z0", "20., , 0.").replace("ALL, 0.", "ALL, 7.")
    heat_words = "*DENSITY\n2e-9\n*SPECIFIC HEAT\n1.5e9\n*CONDUCTIVITY"
    text = text.replace("*CONDUCTIVITY", heat_words).replace("*STEP", "*STEP, AMPLITUDE=STEP")
    text = text.replace(", STEADY STATE\n1., 1.", ", DIRECT\n.01, .1")
    scene, heat, _ = heated(tmp_path, text)
    rows = run_calculix(tmp_path, text, asked("LOWER_Z0"))
    if not rows:
        pytest.skip("ccx, CalculiX, is not installed")
    model = hhr.condense_transient_heat(scene, heat, tolerance=0)
    times = np.linspace(0.001, 0.1, 100)
    answer = model.march(scene.parameters.middle, times, 7.0)[-1]
    count = len(answer.temperature())
    temperatures_are_theirs(
        scene, answer, text, [row for row in rows if len(row) == 2][-count:], 0.01
    )
    force = [row for row in rows if len(row) == 3][-1][2]
    assert answer.forces().sum() == pytest.approx(force, rel=5e-3)


def test_bodies_start_from_their_own_temperatures(tmp_path):
    """As *INITIAL CONDITIONS of two sets say; amplitudes of a step in time are a TODO line."""
    text = deck(0.3, "LOWER_Z0", "20., , 0.")
    text = text.replace("*CONDUCTIVITY", "*DENSITY\n2.\n*SPECIFIC HEAT\n1.5\n*CONDUCTIVITY")
    text = text.replace(", STEADY STATE\n1., 1.", "\n.01, .1")
    sets = "*NSET, NSET=NLO, ELSET=LOWER\n*NSET, NSET=NUP, ELSET=UPPER\n*MATERIAL"
    text = text.replace("*MATERIAL", sets).replace("ALL, 0.", "NLO, 20.\nNUP, 60.")
    curve = "*AMPLITUDE, NAME=A\n0., 0., .1, 1.\n*SURFACE INTERACTION"
    text = text.replace("*SURFACE INTERACTION", curve)
    text = text.replace("*END STEP", "*DFLUX, AMPLITUDE=A\nLOWER, BF, 3.\n*END STEP")
    scene, heat, said = heated(tmp_path, text)
    assert "AMPLITUDE: its value at the end counts in all steps" in said
    model = hhr.condense_transient_heat(scene, heat, tolerance=0)
    start = {"LOWER": 20.0, "UPPER": 60.0}
    full = hhr.FullOrderModel(scene)
    of_upper = np.zeros(len(full.problem.points), dtype=bool)
    of_upper[full.discretisation.surface("UPPER_BOTTOM").nodes] = True
    of_upper |= full.problem.points[:, 2] > 1.1
    by_node = np.where(of_upper, 60.0, 20.0)
    answers = [
        model.march(scene.parameters.middle, [0.01], given)[0].temperature()
        for given in (start, by_node)
    ]
    np.testing.assert_allclose(answers[0], answers[1], rtol=1e-12)
    assert '"UPPER": 60.0})' in (tmp_path / "deck.py").read_text()
    with pytest.raises(ParameterError, match="the start names bodies"):
        model.march(scene.parameters.middle, [0.1], {"LOWER": 20.0})


def test_values_of_one_block_have_a_common_factor(tmp_path):
    text = deck(0.3, "LOWER_Z0", "20., , 0.").replace(f"11, 11, {COLD}", "11, 11, 20.")
    scene, heat, _ = heated(tmp_path, text)
    texts = [item.temperature.text for item in heat.temperatures]
    assert texts == ["20.0 * temperature", "100.0 * temperature"]
    assert scene.parameters.middle[1] == pytest.approx(1.0)


def printed(folder):
    """What the file prints."""
    ended = subprocess.run(
        [sys.executable, "deck.py"], cwd=folder, capture_output=True, text=True, check=True
    )
    return ended.stdout


def test_a_file_solves_contact_and_heat_by_itself(tmp_path):
    scene, heat, _ = heated(tmp_path, deck(0.3, "LOWER_Z0", "20., , 0."))
    answer = hhr.condense_heat(scene, heat).solve(scene.parameters.middle)
    assert f"heat 0 = {answer.heat_through(0):.6g}" in printed(tmp_path)


def sliding_deck(share, speed=20.0):
    """Without a change across, the upper cube moves aside by a little, which its friction needs."""
    text = deck(0.0, conductance="20., , 0.", kind="SURFACE TO SURFACE")
    rubbed = f"*FRICTION\n.3, 1e7\n*GAP HEAT GENERATION\n1., {share}, {speed}\n*CONTACT PAIR"
    aside = "".join(f"{name}, 1, 1, .0002\n" for name in ("UPPER_Z1", "UPPER_Z0"))
    for before, after in (
        ("*CONTACT PAIR", rubbed),
        ("UPPER_Z1, 1, 2\nUPPER_Z0, 1, 2", "UPPER_Z1, 2, 2\nUPPER_Z0, 2, 2"),
        ("UPPER_Z1, 3, 3, -.02\n", "UPPER_Z1, 3, 3, -.02\n" + aside),
        ("STEADY STATE\n1., 1.", "STEADY STATE\n0.1, 1."),
    ):
        text = text.replace(before, after)
    return text


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_heat_of_friction_is_that_of_calculix(share, tmp_path):
    """`*GAP HEAT GENERATION`; it takes heat from the iteration before, so at a low speed, at which
    the share moves flows by 4 %.
    """
    scene, heat, said = heated(tmp_path, sliding_deck(share))
    assert "pairs without friction" in said and heat.sliding[0].share == share
    flow = "*NODE PRINT, NSET={}, TOTALS=ONLY\nRFL"
    asked_for = "\n".join(flow.format(name) for name in ("LOWER_Z0", "UPPER_Z1"))
    rows = run_calculix(tmp_path, sliding_deck(share), asked_for)
    if not rows:
        pytest.skip("ccx, CalculiX, is not installed")
    outputs = hhr.condense_heat(scene, heat).solve(scene.parameters.middle).outputs()
    made, flow = outputs["friction heat 0"], outputs["heat 0"]
    # UPPER_BOTTOM is the first surface, and the slave there
    assert rows[-2][0] == pytest.approx(-((1 - share) * made + flow), rel=4e-3)
    assert rows[-1][0] == pytest.approx(flow - share * made, rel=4e-3)


@pytest.mark.parametrize(
    ("before", "after", "todo"),
    [
        ("*GAP CONDUCTANCE\n20., , 0.", "*GAP CONDUCTANCE\n9., 0.\n1., .1", "as a clearance"),
        ("*END STEP", "*CFLUX\nUPPER_Z1, 11, 5.\n*END STEP", "heat of single nodes"),
        ("*END STEP", "*DFLUX\nUPPER, S3NU, 5.\n*END STEP", "no counterpart: S3NU"),
        ("*END STEP", "*DFLUX\nNONE, BF, 5.\n*END STEP", "holds no whole body"),
        ("*CONDUCTIVITY\n20.0", "*DENSITY\n1.", "body 'LOWER' has no *CONDUCTIVITY"),
        ("ALL, 0.", "ALL, 0.\n*TIE, NAME=T\nUPPER_TOP, LOWER_BOTTOM", "without constraints"),
        ("*CONDUCTIVITY", "*DENSITY\n1.\n*CONDUCTIVITY", "no *DENSITY or no *SPECIFIC HEAT"),
        ("*CONTACT PAIR", "*GAP HEAT GENERATION\n1., .5, 9.\n*CONTACT PAIR", "makes no heat"),
        (
            "*CONTACT PAIR",
            "*FRICTION\n.3\n*GAP HEAT GENERATION\n.5, .2\n*CONTACT PAIR",
            "hhr.SlidingHeat(0.15, SPEED, 0.2)",
        ),
        ("PRESSURE-OVERCLOSURE=LINEAR\n1e7", "NO SEPARATION", "law=hhr.NoSeparation() is left out"),
        ("*END STEP", "*RADIATE\nLOWER, R5, 10., .9\n*END STEP", "*RADIATE: no counterpart"),
    ],
)
def test_what_has_no_counterpart_is_a_line(before, after, todo, tmp_path):
    text = deck(0.3, conductance="20., , 0.").replace(before, after)
    if "DENSITY" in todo:
        text = text.replace(", STEADY STATE", "")
    said = started(tmp_path, text)[1]
    assert todo in " ".join(said.split())
    heat = runpy.run_path(tmp_path / "deck.py").get("HEAT")
    assert (heat is None) == ("*CONDUCTIVITY" in todo or "constraints" in todo)
    if heat is not None:
        assert "heat 0 = " in printed(tmp_path)
    if "as a clearance" in todo:
        assert heat.conductance[0] == "table(g, 0.0, 9.0, 0.1, 1.0, 1000000000.0, 1.0)"
