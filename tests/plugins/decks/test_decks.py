"""Decks of CalculiX and Abaqus become scenes: through the written file, against closed forms."""

import dataclasses
import re

import numpy as np
import pytest
from deck_runs import by_calculix, end, moved_by_calculix, solved, started
from deck_texts import STEEL, bar, block_lines, blocks
from mpi4py import MPI
from needs import needs
from scenes import slope
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.geometries import two_blocks


def as_calculix(folder, text, moved):
    """CalculiX moves the end of a bar as far, to its seven digits."""
    found = moved_by_calculix(folder, text, "BAR_X1", 5)
    assert found is None or found[0] == pytest.approx(moved, rel=2e-6)


@pytest.mark.parametrize(
    ("step", "more", "poisson", "box", "moved"),
    [
        ("*DLOAD\n4, P4, -10.", "", 0.3, ("pressure", -12, -8), 0.04),
        ("*CLOAD\nBAR_X1, 1, 2.5", "", 0.3, ("force", 2, 3), 0.04),
        ("*CLOAD\n5, 1, 2.5\n10, 1, 2.5\n15, 1, 2.5\n20, 1, 2.5", "", 0.3, ("force", 2, 3), 0.04),
        ("*BOUNDARY\nBAR_X1, 1, 1, 0.04", "", 0.3, ("displacement", 0.032, 0.048), 0.04),
        ("*TEMPERATURE\nALL, 120.", "*EXPANSION\n1e-4\n", 0.3, ("temperature", 96, 144), 0.048),
        (
            "*TEMPERATURE\nALL, 120.",
            "*EXPANSION\n1e-4\n*INITIAL CONDITIONS, TYPE=TEMPERATURE\nALL, 20.\n",
            0.3,
            ("temperature", 80, 120),
            0.04,
        ),
        (
            "*BOUNDARY\nBAR_X0, XSYMM\nBAR_X1, ENCASTRE\nBAR_X1, 1, 1, 0.04",
            "",
            0.0,
            ("displacement", 0.032, 0.048),
            0.04,
        ),
        (
            (
                "*AMPLITUDE, NAME=A, TIME=TOTAL TIME\n0., 0., 2., 2.\n*CLOAD, "
                "AMPLITUDE=A\nBAR_X1, 1, 2.5D0"
            ),
            "",
            0.3,
            ("force", 2, 3),
            0.04,
        ),
        ("*DLOAD\nBAR, GRAV, 5., 1., 0., 0.", "*DENSITY\n2.\n", 0.0, ("weight", 8, 12), 0.08),
        # rho w^2 L^3 / 3 E: linear elements are exact at nodes of a bar, but for the middle of each
        # cell, 1/4 L (h/L)^2
        (
            "*DLOAD\nBAR, CENTRIF, 3., 0., 0., 0., 0., 0., 1.",
            "*DENSITY\n2.\n",
            0.0,
            ("rotation", 4.8, 7.2),
            0.128,
        ),
        ("*DLOAD\nBAR, BX, 10.", "", 0.0, ("body_force", 8, 12), 0.08),
    ],
)
def test_a_bar(step, more, poisson, box, moved, tmp_path):
    """u = p L / E, alpha T L, rho g L^2 / 2 E, rho w^2 L^3 / 3 E, and CalculiX where it has the
    words.

    It has no XSYMM and BX, and asks for *INITIAL CONDITIONS, without which bodies begin at 0 by the
    manual of Abaqus.
    """
    text = bar(step, more, poisson)
    scene, _ = started(tmp_path, text)
    if "SYMM" not in step and "BX" not in step and ("TEMP" not in step or "INITIAL" in more):
        as_calculix(tmp_path, text, moved)
    space = scene.parameters
    assert (space.names, *space.lower, *space.upper) == (
        (box[0],),
        *(pytest.approx(value) for value in box[1:]),
    )
    assert end(*solved(scene))[0] == pytest.approx(moved, rel=1e-9)


@pytest.mark.parametrize(
    ("more", "seconds", "moved"),
    [
        ("*PLASTIC\n8., 0.\n12., 0.04\n", 1.0, 0.04 + 4 * 0.02),
        ("*PLASTIC, HARDENING=KINEMATIC\n8., 0.\n12., 0.04\n", 1.0, 0.04 + 4 * 0.02),
        ("*PLASTIC\n8., 0., 20.\n12., 0.04, 20.\n1., 0., 99.\n", 1.0, 0.04 + 4 * 0.02),
        ("*CREEP, LAW=NORTON\n1e-6, 3., 0.\n", 10.0, 0.04 + 4 * 1e-6 * 1e3 * 10),
        (
            "*PLASTIC\n8., 0.\n12., 0.04\n*CREEP\n1e-6, 3., 0.\n",
            10.0,
            0.04 + 4 * (0.02 + 1e-6 * 1e3 * 10),
        ),
        ("*CREEP\n3e-6, 3., -0.5\n", 4.0, 0.04 + 4 * 3e-6 / 0.5 * 1e3 * 2),
    ],
)
def test_a_bar_that_flows(more, seconds, moved, tmp_path):
    """u / L = p / E + the plastic strain of the table, or A p^n t^(m + 1) / (m + 1).

    One step is exact.
    """
    scene, output = started(tmp_path, bar("*DLOAD\n4, P4, -10.", more))
    # laws of creep are solved to some 1e-5
    assert end(*solved(scene, seconds))[0] == pytest.approx(
        moved, rel=1e-4 if "CREEP" in more else 1e-6
    )
    if "8., 0.\n12." in more and "CREEP" not in more and "KINEMATIC" not in more:
        assert scene.bodies[0].law.points[-1] == (
            10.04,
            12.0,
        )  # the last stress goes on, as in the deck
    assert ("depends on temperature" in output) == ("99." in more)


@pytest.mark.parametrize(("time", "share"), [("", 0.5), (", TIME=TOTAL TIME", 1.0)])
def test_steps_and_amplitudes(time, share, tmp_path):
    """Of the last step: the amplitude at its end, and what the first step put on and OP=NEW did not
    take off.

    CalculiX owns the meaning.
    """
    step = (
        f"*CLOAD\nBAR_X1, 2, 1.\n*DLOAD\n4, P4, -10.\n*END STEP\n*AMPLITUDE, NAME=RISE{time}\n0., "
        "0., 2., 1.\n*STEP\n*STATIC\n0.1, 1.\n*CLOAD, OP=NEW, AMPLITUDE=RISE\nBAR_X1, 1, 2."
    )
    as_calculix(tmp_path, bar(step), 0.004 * (10 + 4 * 2 * share))
    scene, _ = started(tmp_path, bar(step))
    assert scene.parameters.names == ("pressure", "force")
    assert end(*solved(scene))[0] == pytest.approx(0.004 * (10 + 4 * 2 * share), rel=1e-9)
    assert len(scene.loads) == 2


@pytest.mark.parametrize(
    ("rows", "moved"),
    [
        ("*CLOAD\nBAR_X1, 1, 2.5\nBAR_X1, 1, 1.5", 0.064),
        ("*CLOAD\nBAR_X1, 1, 2.5\n*CLOAD\nBAR_X1, 1, 2.5", 0.08),
        ("*DLOAD\n4, P4, -10.\n4, P4, -5.", 0.06),
        ("*CLOAD\nBAR_X1, 1, 2.5\n*END STEP\n*STEP\n*STATIC\n*CLOAD\nBAR_X1, 1, 1.5", 0.024),
        ("*BOUNDARY\nBAR_X1, 1, 1, 0.1\nBAR_X1, 1, 1, 0.04", 0.04),
        (
            (
                "*DLOAD\nBAR, GRAV, 5., 1., 0., 0.\n*END STEP\n*STEP\n*STATIC\n*DLOAD\nBAR, GRAV, "
                "2.5, -1., 0., 0."
            ),
            0.04,
        ),
    ],
)
def test_repeated_rows(rows, moved, tmp_path):
    """Loads of one step add up, later steps replace them, of supports the last one holds: as in
    CalculiX 2.20.
    """
    more = "*DENSITY\n2.\n" if "GRAV" in rows else ""
    as_calculix(tmp_path, bar(rows, more, 0.0 if more else 0.3), moved)
    scene, _ = started(tmp_path, bar(rows, more, 0.0 if more else 0.3))
    assert end(*solved(scene))[0] == pytest.approx(moved, rel=1e-9)


@needs("floating")
@pytest.mark.parametrize(("upper", "kind"), [((3, 3, 1), hhr.Mortar), ((2, 2, 1), hhr.NodeToNode)])
def test_pressed_blocks(upper, kind, tmp_path):
    """A pressure of 10 passes through, by names that capitals do not change."""
    scene, output = started(
        tmp_path, blocks("*DSLOAD\npart-1.upper_top, P, 10.", "Upper_Bottom, LOWER_TOP", upper)
    )
    assert "TODO" not in output and type(scene.contacts[0]) is kind
    full, answer = solved(scene)
    pressures = answer.forces() / full.problem.contact_areas
    np.testing.assert_allclose(pressures, 10.0, rtol=1e-9)
    assert answer.outputs()["largest pressure 0"] == pytest.approx(10.0)


@needs("floating")
def test_a_traction_and_three_parameters_at_most(tmp_path):
    """Tractions of 10 along (0, 0, -2) / 2 at most: what is beyond three parameters stays a
    number.
    """
    step = "*DSLOAD\nUPPER_TOP, TRVEC, 4., 0., 0., -2.\n" + "*DSLOAD, OP=MOD\nUPPER_TOP, P, 1.\n"
    step += "*CLOAD\nUPPER_Z1, 3, -0.0625\n*DLOAD\nUPPER, BZ, -4."
    scene, _ = started(tmp_path, blocks(step))
    assert len(scene.parameters.names) == 3 and "traction" in scene.parameters.names
    full, answer = solved(scene)
    assert full.pressures(answer).sum() == pytest.approx(4 + 1 + 1 + 4, rel=1e-9)


STIFF = "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR\n1e7"


@pytest.mark.parametrize(
    ("drawn", "value", "moved", "pressure"),
    [(0.01, 0.005, -0.02, 7.5), (0.2, -0.02, 0.0, 10.0), (0.1, 0.0, -0.02, 10.0)],
)
def test_a_clearance_overwrites_the_drawn_gap(drawn, value, moved, pressure, tmp_path):
    """p = E (motion - value) / 2, whatever the mesh has: manual of CalculiX 2.20, *CLEARANCE, and
    its force.
    """
    lid = f"*BOUNDARY\nUPPER_Z1, 3, 3, {moved}"
    before = f"*CLEARANCE, SLAVE=UPPER_BOTTOM, MASTER=LOWER_TOP, VALUE={value}"
    text = blocks(lid, gap=drawn, before=before, interaction=STIFF, kind="SURFACE TO SURFACE")
    scene, _ = started(tmp_path, text)
    assert scene.parameters.names == tuple(
        name for name, one in (("displacement", moved), ("gap", value)) if one
    )
    assert solved(scene)[1].outputs()["largest pressure 0"] == pytest.approx(pressure, rel=1e-8)
    assert by_calculix(tmp_path, text, "LOWER_Z0")[2] == pytest.approx(
        pressure, rel=1e-3
    )  # of its penalty


CLEARANCES = "\n".join(
    f"*CLEARANCE, SLAVE=UPPER_BOTTOM, MASTER=LOWER_TOP, VALUE={value}" for value in (0.015, 0.005)
)


def cleared_twice():
    lid = "*BOUNDARY\nUPPER_Z1, 3, 3, -0.02"
    return blocks(lid, gap=0.01, before=CLEARANCES, interaction=STIFF, kind="SURFACE TO SURFACE")


def test_the_last_clearance_of_a_pair_is_read(tmp_path):
    """The owner of which counts is CalculiX, see the next test. The line of the first one says
    so.
    """
    scene, output = started(tmp_path, cleared_twice())
    assert output.count("*CLEARANCE") == 1 and "*CLEARANCE: the one of deck.inp:" in output
    assert scene.parameters.names == ("displacement", "gap")
    np.testing.assert_allclose(scene.parameters.middle, (-0.02, 0.005), rtol=1e-12)


def test_the_last_clearance_of_a_pair_counts(tmp_path):
    """p = E (motion - last value) / 2 = 7.5, also in CalculiX."""
    scene, _ = started(tmp_path, cleared_twice())
    assert solved(scene)[1].outputs()["largest pressure 0"] == pytest.approx(7.5, rel=1e-8)
    assert by_calculix(tmp_path, cleared_twice(), "LOWER_Z0")[2] == pytest.approx(
        7.5, rel=1e-3
    )  # of its penalty


@pytest.mark.parametrize("again", ["UPPER", "BOTH"])
def test_the_last_section_of_a_cell_counts(again, tmp_path):
    """Cubes of 1000 and 500 in series, pressed by 0.03: 0.03 / (1 / 1000 + 1 / 500) = 10, and
    CalculiX.
    """
    soft = "*MATERIAL, NAME=SOFT\n*ELASTIC\n500., 0.\n"
    second = f"{soft}*SOLID SECTION, ELSET=UPPER, MATERIAL=SOFT"
    text = blocks("*BOUNDARY\nUPPER_Z1, 3, 3, -0.03", interaction=STIFF, kind="SURFACE TO SURFACE")
    text = text.replace("*SURFACE INTERACTION", f"{second}\n*SURFACE INTERACTION")
    if again == "BOTH":
        first = (
            "*SOLID SECTION, ELSET=LOWER, MATERIAL=STEEL\n"
            "*SOLID SECTION, ELSET=UPPER, MATERIAL=STEEL"
        )
        assert first in text
        text = text.replace(
            first, "*ELSET, ELSET=BOTH\nLOWER, UPPER\n*SOLID SECTION, ELSET=BOTH, MATERIAL=STEEL"
        )
    scene, output = started(tmp_path, text)
    assert {body.tag: body.young for body in scene.bodies} == {"LOWER": 1000.0, "UPPER": 500.0}
    assert (
        output.count("SECTION") == 1
        and "*SOLID SECTION: later sections count for cells of it" in output
    )
    if again == "BOTH":  # the answer is that of the other deck
        return
    assert solved(scene)[1].outputs()["largest pressure 0"] == pytest.approx(10.0, rel=1e-8)
    assert by_calculix(tmp_path, text, "LOWER_Z0")[2] == pytest.approx(
        10.0, rel=1e-3
    )  # of its penalty


@pytest.mark.parametrize("direction", ["1., 0., 0.", "2., 0., 0.", "0.1, 0., 0."])
def test_gravity_has_the_direction_alone(direction, tmp_path):
    """rho g L^2 / 2 E for a direction of any length, also in CalculiX."""
    text = bar(f"*DLOAD\nBAR, GRAV, 10., {direction}", "*DENSITY\n2.\n", 0.0)
    scene, _ = started(tmp_path, text)
    assert scene.loads[0].direction == (1.0, 0.0, 0.0)
    as_calculix(tmp_path, text, 2.0 * 10.0 * 16.0 / 2000.0)


@pytest.mark.parametrize("load", ["GRAV, 10., 0., 0., 0.", "GRAV, 10."])
def test_gravity_without_a_direction_is_left(load, tmp_path):
    _, output = started(tmp_path, bar(f"*DLOAD\nBAR, {load}\n4, P4, 1.", "*DENSITY\n2.\n"))
    assert "*DLOAD: its direction is zero, and it does not act" in output


def test_creep_without_a_law_is_that_of_norton(tmp_path):
    """The manual of CalculiX 2.20: the default of LAW is NORTON."""
    _, output = started(tmp_path, bar("*DLOAD\n4, P4, -10.", "*CREEP\n1e-6, 3., 0.5\n"))
    assert "*CREEP: LAW=NORTON with 1e-6, 3., 0.5 has no counterpart" in output


@pytest.mark.parametrize(
    ("law", "said"),
    [("", "NORTON"), (", LAW=NORTON", "NORTON"), (", LAW=TIME", "TIME"), (", LAW=STRAIN", "")],
)
def test_creep_that_slows_with_time_is_named(law, said, tmp_path):
    """The rate A q^n t^m depends on the time, in the manual of CalculiX 2.20, and PrimaryCreep on
    strain.
    """
    _, output = started(tmp_path, bar("*DLOAD\n4, P4, -10.", f"*CREEP{law}\n3e-6, 3., -0.5\n"))
    assert (f"*CREEP: LAW={said}: it slows with the strain here" in output) == bool(said)


@pytest.mark.parametrize(
    ("words", "limit"), [("*FRICTION\n0.25, 1e6", None), ("*FRICTION, TAUMAX=0.5\n0.25, 1e6", 0.5)]
)
def test_friction(words, limit, tmp_path):
    """Pressed by .01 and drawn by .02 along x: mu N = .25 of the normal force, which is E .01 / 2,
    also in CalculiX.

    With TAUMAX, of Abaqus alone, its manual has min(mu p, TAUMAX), which is .5 on an area of 1.
    """
    step = "*BOUNDARY\nUPPER_Z1, 3, 3, -0.01\nUPPER_Z1, 1, 1, 0.02"
    text = blocks(step, interaction=f"{STIFF}\n{words}", kind="SURFACE TO SURFACE").replace(
        "\nUPPER_X0, 1\n", "\n"
    )
    scene, _ = started(tmp_path, text)
    outputs = (
        hhr.ContactForce("normal", 0, (0.0, 0.0, 1.0)),
        hhr.FrictionForce("friction", 0, (1.0, 0.0, 0.0)),
    )
    found = solved(dataclasses.replace(scene, outputs=outputs))[1].outputs()
    assert scene.parameters.upper == pytest.approx((0.024,)) or len(scene.parameters.names) == 1
    assert found["friction"] == pytest.approx(-(limit or 0.25 * found["normal"]), rel=1e-9)
    assert 4.0 < found["normal"] < 6.0
    if limit is None:
        reactions = by_calculix(tmp_path, text, "LOWER_Z0")
        assert abs(reactions[0]) == pytest.approx(0.25 * reactions[2], rel=1e-3)  # of its penalty


GROUND = "*NODE\n901, 0., 0., -1.\n902, 1., 0., -1.\n903, 0., 1., -1.\n904, 1., 1., -1.\n"
LINKS = "*ELEMENT, TYPE=GAPUNI, ELSET=GAPS\n901, 901, 1\n902, 902, 2\n903, 903, 3\n904, 904, 4\n"


@pytest.mark.parametrize("held", [True, False])
def test_gap_elements_to_the_ground(held, tmp_path):
    """A cube moved down by .05 above a gap of .01 is shortened by .04: p = E .04.

    Manual of CalculiX, *GAP.

    Between two bodies, or to a ground that may move, they are named, and the scene has no contact.
    """
    lines = block_lines("CUBE", 1, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1, 1, 1))
    lines += [
        STEEL.format(poisson=0.0, more=""),
        "*SOLID SECTION, ELSET=CUBE, MATERIAL=STEEL",
        GROUND + LINKS.rstrip(),
    ]
    lines += [
        "*GAP, ELSET=GAPS",
        "0.01, 0., 0., 1.",
        "*NSET, NSET=GROUND",
        "901, 902, 903, 904",
        "*BOUNDARY",
    ]
    lines += [
        "GROUND, 1, 3" if held else "GROUND, 1, 2",
        "CUBE_X0, 1",
        "CUBE_Y0, 2",
        "*STEP",
        "*STATIC",
        "*BOUNDARY",
    ]
    text = "\n".join([*lines, "CUBE_Z1, 3, 3, -0.05", "*END STEP"]) + "\n"
    scene, output = started(tmp_path, text, code=0 if held else 3)
    assert ("TODO" in output) != held
    if held:
        (floor,) = scene.contacts
        assert isinstance(floor, hhr.Obstacle) and tuple(floor.normal) == (0.0, 0.0, -1.0)
        assert solved(scene)[1].forces().sum() == pytest.approx(40.0, rel=1e-9)
    else:
        assert (
            "*GAP: no counterpart: a gap between a whole flat side of a body and a ground" in output
        )


@needs("floating")
def test_a_rigid_plane_that_moves(tmp_path):
    """Rigid elements at z = 4.2 move down by .3: the upper block is pressed by .1 over two lengths,
    p = E .1 / 2.
    """
    tool = (
        "*NODE\n9001, -1., -1., 2.2\n9002, 2., -1., 2.2\n9003, 2., 2., 2.2\n9004, -1., 2., "
        "2.2\n9009, 0., 0., 3.\n*ELEMENT, TYPE=R3D4, ELSET=TOOL\n9001, 9001, 9002, 9003, "
        "9004\n*SURFACE, NAME=STAMP\nTOOL, SNEG\n*RIGID BODY, ELSET=TOOL, REF NODE=9009\n*CONTACT "
        "PAIR, INTERACTION=TOUCH\nUPPER_TOP, STAMP"
    )
    scene, output = started(
        tmp_path, blocks("*BOUNDARY\n9009, 1, 2\n9009, 3, 3, -0.3\n9009, 4, 6", before=tool)
    )
    assert "TODO" not in output and isinstance(scene.contacts[1], hhr.Obstacle)
    full, answer = solved(scene)
    assert answer.forces()[full.problem.pressing_of(1)].sum() == pytest.approx(50.0, rel=1e-8)


@needs("floating")
@pytest.mark.parametrize("turned", [False, True])
def test_a_rigid_line(turned, tmp_path):
    """A square of plane strain, E = 1000 and nu = 0, pressed by 10 onto a straight profile below or
    above.
    """
    text = (
        "*NODE\n1, 0., 0.\n2, 1., 0.\n3, 1., 1.\n4, 0., 1.\n*ELEMENT, TYPE=CPE4, ELSET=BODY\n7, "
        "1, 2, 3, 4\n*MATERIAL, NAME=M\n*ELASTIC\n1000., 0.\n*SOLID SECTION, ELSET=BODY, "
        "MATERIAL=M\n2.\n*SURFACE, NAME=BASE\n7, S1\n*CONTACT PAIR, INTERACTION=I\nBASE, "
        "FLOOR\n*SURFACE, TYPE=SEGMENTS, NAME=FLOOR\nSTART, -5., -0.1\nLINE, 5., "
        "-0.1\n*BOUNDARY\n1, 1\n4, 1\n*STEP\n*STATIC\n*CLOAD\n3, 2, -10.\n4, 2, -10.\n"
    )
    if turned:
        text = (
            text.replace("S1", "S3")
            .replace("-0.1", "1.1")
            .replace("3, 2, -10.\n4, 2, -10.", "1, 2, 10.\n2, 2, 10.")
        )
    scene, _ = started(tmp_path, text)
    assert scene.hypothesis == "plane_strain"
    answer = solved(scene)[1]
    assert answer.forces().sum() == pytest.approx(
        10.0, rel=1e-9
    )  # per depth, of 20 on a thickness of 2
    assert np.abs(answer.displacement().reshape(-1, 2)[:, 1]).max() == pytest.approx(0.11, rel=1e-9)


EIGHT = """*NODE
1, 0., 0.
2, 1., 0.
3, 1., 1.
4, 0., 1.
5, 0.5, 0.
6, 1., 0.5
7, 0.5, 1.
8, 0., 0.5
*ELEMENT, TYPE={kind}, ELSET=BODY
1, 1, 2, 3, 4, 5, 6, 7, 8
*NSET, NSET=LID
3, 4, 7
*NSET, NSET=CORNERS
3, 4
*MATERIAL, NAME=M
*ELASTIC
1000., 0.
*SOLID SECTION, ELSET=BODY, MATERIAL=M
{thickness}
*SURFACE, NAME=BASE
1, S1
*SURFACE, TYPE=SEGMENTS, NAME=FLOOR
START, 0., 0.
LINE, 2., 0.
*CONTACT PAIR, INTERACTION=I
BASE, FLOOR
*BOUNDARY
4, 1
8, 1
1, 1
*STEP
*STATIC
*CLOAD
{load}
"""


@needs("floating", "second_order")
@pytest.mark.parametrize(
    ("kind", "thickness", "load", "total"),
    [
        ("CPE8", "", "LID, 2, -1.", 3.0),
        ("CPS8R", "0.5", "CORNERS, 2, -1.", 4.0),
        ("CAX8", "0.01", "LID, 2, -1.", 3.0),
        ("CPE8", "", "3, 2, -1.\n4, 2, -1.", 2.0),
    ],
)
def test_forces_on_cells_of_second_order_act_at_the_nodes_of_the_file(
    kind, thickness, load, total, tmp_path
):
    """The floor bears as many forces as nodes are listed, over the thickness, which axisymmetry has
    none of.
    """
    full, answer = solved(
        started(tmp_path, EIGHT.format(kind=kind, thickness=thickness, load=load))[0]
    )
    assert full.pressures(answer).sum() == pytest.approx(total, rel=1e-9)


THICK = """*NODE
1, 0., 0.
2, 1., 0.
3, 1., 1.
4, 0., 1.
5, 0., 2.
6, 1., 2.
*ELEMENT, TYPE=CPS4, ELSET=LOW
1, 1, 2, 3, 4
*ELEMENT, TYPE=CPS4, ELSET=UP
2, 4, 3, 6, 5
*NSET, NSET=FOOT
1, 2
*NSET, NSET=LID
5, 6
*MATERIAL, NAME=M
*ELASTIC
1000., 0.
*SOLID SECTION, ELSET=LOW, MATERIAL=M
2.
*SOLID SECTION, ELSET=UP, MATERIAL=M
1.
*BOUNDARY
FOOT, 1, 2
*STEP
*STATIC
*CLOAD
LID, 2, 3.
"""


def test_bodies_of_several_thicknesses(tmp_path):
    """Springs of 2000 and 1000 in series under 6, once the advice is followed."""
    scene, output = started(tmp_path, THICK)
    (factor,) = re.findall(
        r"'UP' is 1 thick, and bodies before it 2; .* pressures on them, by (\S+)", output
    )
    low, up = scene.bodies
    _, answer = solved(
        dataclasses.replace(
            scene, bodies=(dataclasses.replace(low, young=float(factor) * low.young), up)
        )
    )
    assert answer.displacement().max() == pytest.approx(6 / 2000 + 6 / 1000, rel=1e-9)
    assert (
        " thick, and"
        not in started(tmp_path, THICK.replace("\n1.\n*BOUND", "\n2.\n*BOUND"), "same.inp")[1]
    )


def test_a_cylinder_on_a_rigid_plane(tmp_path):
    """Hertz: p0 = (F E* / pi R)^(1/2), on a mesh of some twelve nodes over the contact."""
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ = gmsh.model.occ
    disc = occ.addDisk(0, 8, 0, 8, 8)
    occ.intersect([(2, disc)], [(2, occ.addRectangle(-8, 0, 0, 16, 8))])
    occ.synchronize()
    field = gmsh.model.mesh.field
    field.add("MathEval", 1)
    field.setString(1, "F", "0.04 + 0.15 * Sqrt(x*x + y*y)")
    field.setAsBackgroundMesh(1)
    gmsh.model.mesh.generate(2)
    numbers, points, _ = gmsh.model.mesh.getNodes()
    cells = gmsh.model.mesh.getElementsByType(2)[1].reshape(-1, 3).tolist()
    gmsh.finalize()
    places = dict(zip(numbers.tolist(), points.reshape(-1, 3).tolist(), strict=True))
    round_side = [
        k for k, (x, y, _) in places.items() if abs(np.hypot(x, y - 8) - 8) < 1e-9 and y < 2
    ]
    rows = [
        "*NODE",
        *(f"{k}, {x!r}, {y!r}" for k, (x, y, _) in places.items()),
        "*ELEMENT, TYPE=CPE3, ELSET=DISC",
    ]
    rows += [f"{k}, {', '.join(map(str, nodes))}" for k, nodes in enumerate(cells, 1)]
    rows += ["*NSET, NSET=TOP", *(str(k) for k, (_, y, _) in places.items() if abs(y - 8) < 1e-9)]
    rows += ["*SURFACE, NAME=ROUND, TYPE=NODE", *map(str, round_side)]
    rows += ["*SURFACE, NAME=PLANE, TYPE=SEGMENTS", "START, 9., 0.", "LINE, -9., 0."]
    rows += [
        "*MATERIAL, NAME=M",
        "*ELASTIC",
        "1000., 0.3",
        "*SOLID SECTION, ELSET=DISC, MATERIAL=M",
        "1.",
    ]
    rows += [
        "*CONTACT PAIR, INTERACTION=I",
        "ROUND, PLANE",
        "*STEP",
        "*STATIC",
        "*BOUNDARY",
        "TOP, 1",
        "TOP, 2, 2, -0.08",
    ]
    full, answer = solved(started(tmp_path, "\n".join(rows))[0])
    force = full.pressures(answer).sum()
    peak = np.sqrt(force * 1000 / (1 - 0.3**2) / (np.pi * 8))
    assert int((answer.forces() > 0).sum()) > 10
    assert answer.outputs()["largest pressure 0"] == pytest.approx(peak, rel=0.05)


def test_a_deck_without_names(tmp_path):
    """No surface, no set and no contact: the outside of all bodies is the surface of a plane out of
    reach.
    """
    text = bar("*CLOAD\n20, 1, 10.")
    lines = text.splitlines()
    kept = (
        lines[: lines.index("*NSET, NSET=BAR_X0")]
        + lines[text[: text.index("*MATERIAL")].count("\n") :]
    )
    held = "1, 1, 3\n6, 1\n11, 1\n16, 1\n6, 3\n11, 2"
    scene, _ = started(tmp_path, "\n".join(kept).replace("BAR_X0, 1\nBAR_Y0, 2\nbar_z0, 3", held))
    assert isinstance(scene.geometry, hhr.WithOutside)
    full, answer = solved(scene)
    assert full.pressures(answer).sum() == 0 and end(full, answer, (4.0, 1.0, 1.0))[0] > 0.1


def test_many_forces_are_one_load(tmp_path):
    """Different ones at all nodes, nu = 0: the mean of the end moves by the sum of F x / E A, by
    reciprocity.
    """
    forces = {k: 0.1 * k for k in range(1, 21)}
    rows = "\n".join(f"{k}, 1, {value!r}" for k, value in forces.items())
    scene, _ = started(tmp_path, bar(f"*CLOAD\n{rows}", poisson=0.0))
    assert isinstance(scene.loads[0], hhr.NodalForces) and scene.parameters.names == ("force",)
    full, answer = solved(scene)
    moved = np.mean([end(full, answer, (4.0, y, z))[0] for y in (0, 1) for z in (0, 1)])
    assert moved == pytest.approx(
        sum(value * ((k - 1) % 5) for k, value in forces.items()) / 1000, rel=1e-9
    )


@needs("exporters", "floating")
def test_our_own_decks_come_back(tmp_path):
    """Forces and supports of our export are numbers of nodes: the same contact forces as of the
    scene.
    """
    from hhr_dolfinx.plugins.exporters.deck import write_deck

    first = ((1.0, 0.0), (2.0, 1.0), (3, 3))
    second = ((1.0, 1.0), (2.0, 2.0), (4, 4))
    side = two_blocks.side
    scene = hhr.Scene(
        name="pressed",
        geometry=lambda comm: two_blocks.two_blocks(comm, first=first, second=second),
        hypothesis="plane_strain",
        bodies=(hhr.Body(1, 1000.0, 0.3), hhr.Body(2, 2000.0, 0.2)),
        contacts=(hhr.Mortar(side(1, 1, True), side(2, 1, False)),),
        displacements=(
            *hhr.Displacement.clamp(side(1, 1, False), 2),
            hhr.Displacement(side(2, 0, False), 0),
        ),
        loads=(
            hhr.Pressure(side(2, 1, True), slope("p")),
            hhr.Pressure(side(2, 0, True), slope("p", 0.5)),
        ),
        parameters=hhr.ParameterSpace(("p",), (0.0,), (10.0,)),
    )
    write_deck(tmp_path / "own.inp", Discretisation(scene, MPI.COMM_SELF), 5.0)
    again, output = started(tmp_path, (tmp_path / "own.inp").read_text())
    assert "contact is hard here" in output
    own, found = (
        model.forces() for model in (hhr.FullOrderModel(scene).solve(5.0), solved(again)[1])
    )
    np.testing.assert_allclose(np.sort(found), np.sort(own), atol=1e-9 * own.max())


def test_parts_without_counterpart_are_named(tmp_path):
    step = (
        "*DLOAD\n4, P4, -10.\nNOWHERE, GRAV, 9.81, 0., 0., -1.\n*CLOAD\n77, 1, 1.\n"
        "*BOUNDARY, FIXED\n99, 1\n"
    )
    before = (
        "*EQUATION\n2\n5, 2, 1., 77777, 2, -1.\n*RIGID BODY, NSET=BAR_X1, REF NODE=99\n"
        "*CONTACT PAIR, INTERACTION=I\n"
    )
    before += "BAR_TOP, ROUND\n*COHESIVE BEHAVIOR\n*STEP, NLGEOM"
    text = bar(step + "*DYNAMIC\n0.1, 1.").replace("*STEP", before)
    scene, output = started(tmp_path, text, code=3)
    assert "deck.inp states contact, and" in output  # the answers of this scene are those without
    written = (tmp_path / "deck.py").read_text()
    line = 1 + text.splitlines().index("*EQUATION")
    for words in (
        f"TODO deck.inp:{line} *EQUATION: '77777' has no node",
        "NLGEOM",
        "'NOWHERE' holds no whole body",
        "'77' is no node of the mesh",
        "'99' is no node",
        "*RIGID BODY: '99' is not one node",
        "FIXED: it keeps",
        "*DYNAMIC: the state is that at rest",
        "'ROUND' is no surface",
        "*COHESIVE BEHAVIOR: no counterpart",
    ):
        assert words in output and words in written
    assert end(*solved(scene))[0] == pytest.approx(0.04, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (("1000., 0.3", "1000., soft"), "deck.inp:\\d+ .ELASTIC: 'soft' is no finite number"),
        (
            ("*ELASTIC\n1000., 0.3\n", ""),
            "deck.inp:\\d+ .SOLID SECTION: material 'STEEL' has no .ELASTIC",
        ),
        (
            ("*ELASTIC", "*ELASTIC, TYPE=ORTHO"),
            "deck.inp:\\d+ .ELASTIC: TYPE=ORTHO: E and nu are needed",
        ),
        (("ELSET=BAR, MATERIAL", "MATERIAL"), "deck.inp:\\d+ .SOLID SECTION has no option ELSET="),
        (("*SOLID SECTION, ELSET=BAR, MATERIAL=STEEL\n", ""), "deck.inp has no .SOLID SECTION"),
        (("BAR_X0, 1", "BAR_X0, all"), "'ALL' is no number of a component"),
        (("BAR_X0, 1", "BAR_X0"), "'BAR_X0' has too few words"),
        (("*CLOAD", "*CLOAD, AMPLITUDE=RISE"), "there is no amplitude 'RISE'"),
        (
            ("*BOUNDARY", "*BOUNDARY, OP=NEW\n*FREQUENCY"),
            "so its bodies are free: hold them by .BOUNDARY",
        ),
        (
            ("*STEP", "*INCLUDE, INPUT=nowhere.inp\n*STEP"),
            "deck.inp:\\d+ .INCLUDE: the file .* does not exist",
        ),
        (
            ("*STEP", "*INCLUDE, INPUT=deck.inp\n*STEP"),
            "deck.inp:\\d+ .INCLUDE: the file .* includes itself",
        ),
        (("*NODE, NSET=ALL", "*NOTE"), ""),
    ],
)
def test_mistakes(change, why, tmp_path):
    import re

    text = bar("*CLOAD\nBAR_X1, 1, 2.5")
    assert change[0] in text
    (tmp_path / "deck.inp").write_text(text.replace(*change, 1))
    code, output = invoke("start", tmp_path / "deck.inp")
    assert code == 3 and re.search(why, output), output
    assert not (tmp_path / "deck.py").exists()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (
            ("INTERACTION=TOUCH\nUP", "INTERACTION=TUCH\nUP"),
            "*CONTACT PAIR: there is no *SURFACE INTERACTION 'TUCH'",
        ),
        (
            ("PAIR, INTER", "PAIR, ADJUST=0.1, INTER"),
            "*CONTACT PAIR: ADJUST=0.1: no node moves here",
        ),
        (("UPPER_TOP, P,", "UPPER_TOP, PRES,"), "*DSLOAD: no counterpart: load PRES"),
        (
            ("*STEP", "*CLEARANCE, SLAVE=LOWER_TOP, MASTER=UPPER_BOTTOM, VALUE=0.1\n*STEP"),
            "*CLEARANCE: no pair has this slave and master",
        ),
    ],
)
def test_words_without_effect_are_named(change, why, tmp_path):
    text = blocks("*DSLOAD\nUPPER_TOP, P, 1.")
    assert change[0] in text
    _, output = started(tmp_path, text.replace(*change))
    assert output.count("TODO") == 1 and why in output


def test_a_scene_file_is_written_as_python_is(tmp_path):
    """Strings in double quotes, no empty parts, lines of 120 signs: a long table breaks, and is the
    same when read.
    """
    table = [(200.0 + k, k / 512) for k in range(40)]
    rows = "\n".join(f"{stress}, {strain}" for stress, strain in table)
    scene, _ = started(tmp_path, bar("*CLOAD\nBAR_X1, 1, 2.5", f"*PLASTIC\n{rows}"))
    (body,) = scene.bodies
    assert body.law.points[:-1] == tuple((strain, stress) for stress, strain in table)
    written = (tmp_path / "deck.py").read_text()
    assert "'" not in written and "openings" not in written
    assert max(map(len, written.splitlines())) <= 120 < len(repr(table))


def test_a_file_that_is_there_stays(tmp_path):
    (tmp_path / "deck.inp").write_text(bar("*CLOAD\nBAR_X1, 1, 2.5"))
    (tmp_path / "deck.py").write_text("mine")
    code, output = invoke("start", tmp_path / "deck.inp")
    assert code == 3 and "--force" in output and (tmp_path / "deck.py").read_text() == "mine"
    assert invoke("start", tmp_path / "deck.inp", "--force")[0] == 0
    code, output = invoke("solve", tmp_path / "deck.py")
    assert code == 0 and "force, middle of its box: 2.5" in output
    assert invoke("check", tmp_path / "deck.py", "--picture", tmp_path / "deck.png")[0] == 0
    assert invoke("start", tmp_path / "none.inp")[0] == 3
    code, output = invoke("start", tmp_path)
    assert code == 3 and "is a folder: name a deck" in output


@needs("floating")
def test_a_part_in_two_instances(tmp_path):
    """A section in a part is one of each of its instances.

    The upper cube presses the lower one, u = -2 p / E.
    """
    part = [
        "*PART, NAME=CUBE",
        *block_lines("CUBE", 1, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1, 1, 1)),
    ]
    part += ["*SOLID SECTION, ELSET=CUBE, MATERIAL=STEEL", "*END PART", "*ASSEMBLY, NAME=A"]
    part += [
        "*INSTANCE, NAME=LOW, PART=CUBE",
        "*END INSTANCE",
        "*INSTANCE, NAME=UP, PART=CUBE",
        "0., 0., 1.",
    ]
    part += [
        "*END INSTANCE",
        "*END ASSEMBLY",
        STEEL.format(poisson=0.3, more="*EXPANSION, TYPE=ORTHO\n1e-5, 0., 0."),
    ]
    part += ["*CONTACT PAIR", "UP.CUBE_BOTTOM, LOW.CUBE_TOP", "*BOUNDARY", "LOW.CUBE_Z0, 3"]
    part += [
        f"{name}.CUBE_{side}0, {axis}"
        for name in ("LOW", "UP")
        for axis, side in ((1, "X"), (2, "Y"))
    ]
    text = "\n".join([*part, "*STEP", "*STATIC", "*DSLOAD", "UP.CUBE_TOP, P, 10.", "*END STEP"])
    name, output = started(tmp_path, text + "\n")
    assert (
        output.count("TODO") == 1
        and "TYPE=ORTHO: its first number counts in all directions" in output
    )
    full, answer = solved(name)
    assert end(full, answer, (1.0, 1.0, 2.0)) == pytest.approx((0.003, 0.003, -0.02), rel=1e-9)


def test_a_body_with_a_law_on_another_one(tmp_path):
    """Contact alone would hold it: soft springs do, and change u = -2 p / E by less than a
    thousandth.
    """
    text = blocks("*DSLOAD\nUPPER_TOP, P, 1.").replace(
        "1000., 0.0\n", "1000., 0.0\n*PLASTIC\n8., 0.\n12., 0.04\n"
    )
    name, output = started(tmp_path, text)
    assert output.count("TODO") == 1 and "soft springs are added" in output
    full, answer = solved(name)
    assert end(full, answer, (1.0, 1.0, 2.0))[2] == pytest.approx(-0.002, rel=1e-3)


@pytest.mark.parametrize(
    ("kind", "right", "wrong"),
    [("CPE4", "0., 0., 1.", "0., 1., 0."), ("CAX4", "0., 1., 0.", "0., 0., 1.")],
)
def test_axes_of_rotation_in_two_dimensions(kind, right, wrong, tmp_path):
    """The normal of the plane, or the axis of symmetry; no force stands for another one."""
    text = (
        "*NODE\n1, 1., 0.\n2, 2., 0.\n3, 2., 1.\n4, 1., 1.\n"
        f"*ELEMENT, TYPE={kind}, ELSET=BODY\n7, 1, 2, 3, 4\n"
    )
    text += (
        STEEL.format(poisson=0.3, more="*DENSITY\n2.\n")
        + "*SOLID SECTION, ELSET=BODY, MATERIAL=STEEL\n"
    )
    text += (
        "*BOUNDARY\n1, 1, 2\n4, 1, 2\n*STEP\n*STATIC\n"
        "*DLOAD\nBODY, CENTRIF, 3., 0., 0., 0., AXIS\n*END STEP\n"
    )
    scene, output = started(tmp_path, text.replace("AXIS", right), "right.inp")
    assert "TODO" not in output and type(scene.loads[0]) is hhr.Centrifugal
    scene, output = started(tmp_path, text.replace("AXIS", wrong), "wrong.inp")
    assert "in two dimensions bodies rotate about the axis" in output and not scene.loads
