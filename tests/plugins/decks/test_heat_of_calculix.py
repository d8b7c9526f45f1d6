"""Heat through contacts beside CalculiX: `*GAP CONDUCTANCE`, constant or by pressure."""

import numpy as np
import pytest
from deck_runs import run_calculix, started
from deck_texts import block_lines
from needs import needs

import hhr_dolfinx as hhr

pytestmark = needs("contact_heat")
TABLE = "2., 0., 0.\n30., 20., 0.\n50., 60., 0."
OF_TABLE = "table(p, 0, 2, 20, 30, 60, 50, 1e9, 50)"
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
    scene, _ = started(tmp_path, deck(poisson))
    rows = run_calculix(tmp_path, deck(poisson, cold, line, kind), asked(cold))
    if not rows:
        pytest.skip("ccx, CalculiX, is not installed")
    both = ("LOWER", "UPPER")
    heat = hhr.Heat(
        conductivity=dict.fromkeys(both, CONDUCTIVITY),
        conductance={0: formula},
        expansion=dict.fromkeys(both, EXPANSION),
        temperatures=[hhr.FixedTemperature(cold, COLD), hhr.FixedTemperature("UPPER_Z1", WARM)],
    )
    answer = hhr.condense_heat(scene, heat).solve(scene.parameters.middle)
    force, flow = rows[0][2], rows[1][0]
    assert answer.forces().sum() == pytest.approx(force, rel=2e-3)
    assert answer.heat_through(0) == pytest.approx(-flow, rel=close)
    lines = [line.split(", ") for line in deck(poisson).splitlines()]
    places = {int(line[0]): line[1:] for line in lines if len(line) == 4 and "." in line[1]}
    expected = np.array([row[1] for row in rows[2:]])
    theirs = by_place(np.array([places[int(row[0])] for row in rows[2:]], dtype=float), expected)
    ours = by_place(hhr.FullOrderModel(scene).problem.points, answer.temperature())
    np.testing.assert_allclose(ours, theirs, atol=close * WARM)


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
    scene, _ = started(tmp_path, deck(0.0))
    flow = "*NODE PRINT, NSET={}, TOTALS=ONLY\nRFL"
    asked_for = "\n".join(flow.format(name) for name in ("LOWER_Z0", "UPPER_Z1"))
    rows = run_calculix(tmp_path, sliding_deck(share), asked_for)
    if not rows:
        pytest.skip("ccx, CalculiX, is not installed")
    both = ("LOWER", "UPPER")
    heat = hhr.Heat(
        conductivity=dict.fromkeys(both, CONDUCTIVITY),
        conductance={0: 20.0},
        expansion=dict.fromkeys(both, EXPANSION),
        temperatures=[
            hhr.FixedTemperature("LOWER_Z0", COLD),
            hhr.FixedTemperature("UPPER_Z1", WARM),
        ],
        sliding={0: hhr.SlidingHeat(0.3, 20.0, share)},
    )
    outputs = hhr.condense_heat(scene, heat).solve(scene.parameters.middle).outputs()
    made, flow = outputs["friction heat 0"], outputs["heat 0"]
    # UPPER_BOTTOM is the first surface, and the slave there
    assert rows[-2][0] == pytest.approx(-((1 - share) * made + flow), rel=4e-3)
    assert rows[-1][0] == pytest.approx(flow - share * made, rel=4e-3)
