"""Constraints of decks become those of scenes: against CalculiX 2.20, whose displacements are
numbers here, or exactly.

Its elements of first order, C3D8, are those of the scene.
"""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from deck_runs import end, solved, started
from deck_texts import bar, block_lines, blocks
from needs import needs
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.command.loading import scene_of

PILOTS = "*NODE\n901, 5., 0.2, 0.9\n902, 5., 0.2, 0.9\n903, 0., 0., 2.\n"
FACE = "*SURFACE, NAME=HEAD\n4, S4\n"
CLAMPED = "*BOUNDARY\nBAR_X0, 1, 3\n"


def coupled(lines, step):
    """The bar, clamped at x = 0, with constraints and a step."""
    text = bar(step).replace(
        "*BOUNDARY\nBAR_X0, 1\nBAR_Y0, 2\nbar_z0, 3\n", PILOTS + FACE + lines + CLAMPED
    )
    assert lines in text
    return text


RIGID = "*RIGID BODY, NSET=BAR_X1, REF NODE=901, ROT NODE=902\n"
KINEMATIC = "*COUPLING, REF NODE=901, SURFACE=HEAD, CONSTRAINT NAME=C\n*KINEMATIC\n1, 3\n"
ALONG = KINEMATIC.replace("1, 3", "1, 1")
FORCES = "*CLOAD\n901, 3, -0.3\n901, 1, 2.\n"
# step, and the displacement of the corner (4, 0, 0) by CalculiX 2.20
BY_CCX = {
    "rigid, force": (RIGID, FORCES + "902, 1, 0.5\n", (-0.009215145, 0.05514585, -0.1367317)),
    "rigid, moved": (
        RIGID,
        "*BOUNDARY\n901, 1, 3, 0.01\n902, 1, 1, 0.02\n902, 2, 3\n",
        (0.01, 0.028, 0.006),
    ),
    "kinematic": (KINEMATIC, FORCES + "901, 4, 0.5\n", (-0.009215145, 0.05514585, -0.1367317)),
    "kinematic, moved": (
        KINEMATIC,
        "*BOUNDARY\n901, 2, 2, 0.01\n901, 4, 4, 0.02\n",
        (0.002559315, 0.02288137, -0.01),
    ),
    "along x": (ALONG, "*BOUNDARY\n901, 1, 1, 0.01\n901, 4, 6\n", (0.01, 3.836317e-4, 3.836317e-4)),
    "distributing": (
        KINEMATIC.replace("KINEMATIC", "DISTRIBUTING").replace("1, 3", "1, 6"),
        FORCES,
        (-0.009114184, 0.03912611, -0.120558),
    ),
    "coupled forces": (
        "*ELEMENT, TYPE=DCOUP3D, ELSET=D\n700, 901\n*DISTRIBUTING COUPLING, ELSET=D\nBAR_X1, 1.\n",
        FORCES,
        (-0.001387526, 0.0002358058, -0.05068077),
    ),
    # nodes of the set hold whole facets, whose areas differ: the forces on all nodes are alike
    "coupled forces on facets": (
        "*NSET, NSET=LID\n12, 13, 14, 17, 18, 19\n"
        "*ELEMENT, TYPE=DCOUP3D, ELSET=D\n700, 901\n*DISTRIBUTING COUPLING, ELSET=D\nLID, 1.\n",
        FORCES,
        (-0.006453153, 0.00003160203, -0.06073182),
    ),
    "mean rotation": (
        "*NODE\n904, 1., 0., 0.\n*MPC\nMEANROT, 5, 5, 5, 10, 10, 10, 15, 15, 15, 20, 20, 20, 904\n",
        "*BOUNDARY\n904, 1, 1, 0.02\n",
        (0.0, 0.01, -0.01),
    ),
    # nodes at different distances from the axis, whose angles count alike
    "mean rotation of a block": (
        "*NODE\n904, 0., 1., 0.\n*MPC\nMEANROT, 3, 3, 3, 4, 4, 4, 5, 5, 5, 8, 8, 8,\n9, 9, 9, 10, "
        "10, 10, 13, 13, 13, 14, 14, 14,\n15, 15, 15, 18, 18, 18, 19, 19, 19, 20, 20, 20, 904\n",
        "*BOUNDARY\n904, 1, 1, 0.02\n",
        (-0.01103928, -5.534173e-05, -0.05462017),
    ),
    "equations": (
        (
            "*EQUATION\n3\n5, 3, 1., 10, 3, -2., 15, 1, 0.5\n2\n20, 2, 1., 901, 2, -1.\n2\n901, 2, "
            "1., 15, 2, -2.\n"
        ),
        "*CLOAD\nBAR_X1, 3, -0.1\n901, 2, 0.2\n",
        (-0.003305866, 0.02071484, -0.03736907),
    ),
}


@pytest.mark.parametrize("name", BY_CCX)
def test_constraints_of_a_bar(name, tmp_path):
    lines, step, moved = BY_CCX[name]
    scene, output = started(tmp_path, coupled(lines, step))
    assert ("TODO" in output) == (
        "as in CalculiX, its reference node counts as the centre" in output
    )
    assert end(*solved(scene)) == pytest.approx(moved, abs=2e-7)


@pytest.mark.parametrize("step", ["*CLOAD\n901, 1, 10.", "*BOUNDARY\n901, 1, 1, 0.04"])
def test_a_set_follows_a_node_without_cells(step, tmp_path):
    """All of the end moves as the node does, which no cell has: u = F L / E A."""
    text = bar(step).replace("*STEP", PILOTS + "*EQUATION\n2\nBAR_X1, 1, 1., 901, 1, -1.\n*STEP")
    scene, output = started(tmp_path, text)
    assert "TODO" not in output
    for place in ((4.0, 0.0, 0.0), (4.0, 1.0, 1.0)):
        assert end(*solved(scene), place)[0] == pytest.approx(0.04, rel=1e-9)


@pytest.mark.parametrize(
    ("step", "moved"), [("*BOUNDARY\n903, 1, 1, 0.02", 0.01), ("*CLOAD\n903, 1, 5.", 0.01)]
)
def test_a_preloaded_bar(step, moved, tmp_path):
    """Both ends are held: the shortening s strains both halves by s / L, the force F by F / E A, in
    tension.
    """
    text = bar(step).replace("BAR_X0, 1\n", "BAR_X0, 1\nBAR_X1, 1\n")
    text = text.replace(
        "*STEP",
        PILOTS + "*SURFACE, NAME=CUT\n2, S4\n*PRE-TENSION SECTION, SURFACE=CUT, NODE=903\n*STEP",
    )
    scene, output = started(tmp_path, text)
    assert "TODO" not in output and isinstance(scene.geometry, hhr.CutMesh)
    full, answer = solved(scene)
    assert answer.stress()[:, 0] == pytest.approx(np.full(4, 5.0), rel=1e-9)
    assert end(full, answer, (1.0, 0.0, 0.0))[0] == pytest.approx(moved / 2, rel=1e-9)


def test_a_set_at_the_section_of_a_bolt(tmp_path):
    """A force on nodes of both sides of the cut, which separates the facets of their set, by
    CalculiX 2.20.
    """
    text = bar("*CLOAD\n903, 1, 5.\n901, 3, -3.").replace(
        "BAR_X0, 1\nBAR_Y0, 2\nbar_z0, 3\n", "BAR_X0, 1, 3\nBAR_X1, 1, 3\n"
    )
    text = text.replace(
        "*STEP",
        PILOTS + "*NSET, NSET=LID\n13, 14, 18, 19\n*ELEMENT, TYPE=DCOUP3D, ELSET=D\n700, 901\n"
        "*DISTRIBUTING COUPLING, ELSET=D\nLID, 1.\n*SURFACE, NAME=CUT\n2, S4\n"
        "*PRE-TENSION SECTION, SURFACE=CUT, NODE=903\n*STEP",
    )
    scene, _ = started(tmp_path, text)
    assert end(*solved(scene), (3.0, 0.0, 0.0)) == pytest.approx(
        (-0.002598121, 0.000687988, -0.005878261), abs=2e-7
    )


def test_the_force_of_a_bolt_in_the_plane(tmp_path):
    """The deck has a force F on the thickness t = 0.5: the stress is F / (t h)."""
    text = (
        "*NODE\n1, 0., 0.\n2, 1., 0.\n3, 2., 0.\n4, 0., 1.\n5, 1., 1.\n6, 2., 1.\n7, 0., 0.\n"
        "*ELEMENT, TYPE=CPS4, ELSET=BODY\n1, 1, 2, 5, 4\n2, 2, 3, 6, 5\n"
        "*MATERIAL, NAME=M\n*ELASTIC\n1000., 0.\n*SOLID SECTION, ELSET=BODY, MATERIAL=M\n0.5\n"
        "*BOUNDARY\n1, 1, 2\n3, 1, 2\n4, 1\n6, 1\n*SURFACE, NAME=CUT\n1, S2\n"
        "*PRE-TENSION SECTION, SURFACE=CUT, NODE=7\n1., 0.\n*STEP\n*STATIC\n*CLOAD\n7, 1, "
        "5.\n*END STEP\n"
    )
    scene, _ = started(tmp_path, text)
    assert solved(scene)[1].stress()[:, 0] == pytest.approx(np.full(2, 10.0), rel=1e-9)


@pytest.mark.parametrize(("face", "normal", "sign"), [("2, S4", "", 1), ("2, S4", "1., 0., 0.", 1),
    ("2, S4", "-1., 0., 0.", -1), ("3, S6", "1., 0., 0.", -1), ("3, S6", "", 1)])  # fmt: skip
@pytest.mark.parametrize("step", ["*BOUNDARY\n903, 1, 1, 0.02", "*CLOAD\n903, 1, 5."])
def test_the_normal_of_a_section(face, normal, sign, step, tmp_path):
    """CalculiX 2.20 presses the bar if the normal points into the elements of the surface."""
    text = bar(step).replace("BAR_X0, 1\n", "BAR_X0, 1\nBAR_X1, 1\n")
    section = (
        f"*SURFACE, NAME=CUT\n{face}\n*PRE-TENSION SECTION, SURFACE=CUT, NODE=903\n{normal}\n*STEP"
    )
    scene, _ = started(tmp_path, text.replace("*STEP", PILOTS + section.replace("\n\n", "\n")))
    assert solved(scene)[1].stress()[:, 0] == pytest.approx(np.full(4, sign * 5.0), rel=1e-9)


@pytest.mark.parametrize(
    ("normal", "said"),
    [("1., 0., 0.", ""), ("3., 0., 0.001", ""), ("1., 0., 0.2", "11 degrees off")],
)
def test_a_normal_that_is_not_that_of_its_section(normal, said, tmp_path):
    """CalculiX draws the sides together along it, and a scene along their own one: it is said."""
    text = bar("*BOUNDARY\n903, 1, 1, 0.02").replace("BAR_X0, 1\n", "BAR_X0, 1\nBAR_X1, 1\n")
    section = (
        f"*SURFACE, NAME=CUT\n2, S4\n*PRE-TENSION SECTION, SURFACE=CUT, NODE=903\n{normal}\n*STEP"
    )
    _, output = started(tmp_path, text.replace("*STEP", PILOTS + section))
    assert said in output and ("TODO" in output) == bool(said)


FIXED = "*END STEP\n*STEP\n*STATIC\n*BOUNDARY, FIXED\n903, 1, 1"


@pytest.mark.parametrize("first", ["*BOUNDARY\n903, 1, 1, 0.02", "*CLOAD\n903, 1, 5."])
def test_a_fixed_bolt_keeps_its_preload(first, tmp_path):
    """The second step of most decks of bolts: the stress stays 5, not that of a bolt that was never
    drawn.
    """
    text = bar(f"{first}\n{FIXED}").replace("BAR_X0, 1\n", "BAR_X0, 1\nBAR_X1, 1\n")
    section = "*SURFACE, NAME=CUT\n2, S4\n*PRE-TENSION SECTION, SURFACE=CUT, NODE=903\n*STEP"
    scene, output = started(tmp_path, text.replace("*STEP", PILOTS + section, 1))
    assert "FIXED: it keeps" in output
    assert solved(scene)[1].stress()[:, 0] == pytest.approx(np.full(4, 5.0), rel=1e-9)


@pytest.mark.parametrize("more", ["", "*NSET, NSET=LID\n13, 14, 18, 19\n"])
def test_a_preloaded_bar_without_other_surfaces(more, tmp_path):
    """Its section is the surface of the plane out of reach, and no set whose facets the cut
    separates.
    """
    text = bar("*BOUNDARY\n903, 1, 1, 0.02").replace("BAR_X0, 1\n", "BAR_X0, 1\nBAR_X1, 1\n")
    lines = text.splitlines()
    kept = [
        line
        for line in lines
        if not line.startswith("*SURFACE") and not line.endswith((", S1", ", S2"))
    ]
    # no set has a whole side either
    held = "1, 1\n6, 1\n11, 1\n16, 1\n5, 1\n10, 1\n15, 1\n20, 1\n1, 2\n5, 2\n1, 3\n5, 3\n10, 3"
    first = kept.index("*NSET, NSET=BAR_X0")
    last = kept.index("*MATERIAL, NAME=STEEL")
    text = "\n".join(kept[:first] + kept[last:]).replace(
        "BAR_X0, 1\nBAR_X1, 1\nBAR_Y0, 2\nbar_z0, 3", held
    )
    section = "*SURFACE, NAME=CUT\n2, S4\n*PRE-TENSION SECTION, SURFACE=CUT, NODE=903\n*STEP"
    scene, output = started(tmp_path, text.replace("*STEP", PILOTS + more + section))
    assert "TODO" not in output
    assert solved(scene)[1].stress()[:, 0] == pytest.approx(np.full(4, 5.0), rel=1e-9)


def tied(step="*CLOAD\nUPPER_X1, 1, 0.1\nUPPER_Z1, 3, 0.1"):
    """Two unit cubes with meshes that do not match, tied one on the other."""
    text = blocks(step, upper=(3, 3, 2))
    text = text.replace("UPPER_X0, 1\nUPPER_Y0, 2\n", "")
    pair = text[text.index("*SURFACE INTERACTION") : text.index("*BOUNDARY")]
    return text.replace(pair, "*TIE, NAME=T, POSITION TOLERANCE=0.1\nUPPER_BOTTOM, LOWER_TOP\n")


def test_a_tie(tmp_path):
    """CalculiX ties nodes to the surface, and the scene means of it: corners of the lid agree to 1
    %.
    """
    scene, output = started(tmp_path, tied())
    assert "TODO" not in output and isinstance(scene.constraints[0], hhr.Tie)
    moved = end(*solved(scene), (1.0, 1.0, 2.0))
    assert moved == pytest.approx((0.02074459, -0.0004041438, -0.002264094), rel=0.01)


def test_nodes_beyond_the_tolerance_of_a_tie_are_named(tmp_path):
    """Manual of CalculiX, *TIE: nodes farther than POSITION TOLERANCE are not tied; here they
    are.
    """
    pair = "*TIE, NAME=T, POSITION TOLERANCE={}\nUPPER_BOTTOM, LOWER_TOP\n"
    for gap, said in ((0.05, False), (0.2, True)):
        text = blocks("*CLOAD\nUPPER_Z1, 3, -0.1", gap=gap)
        cut = text[text.index("*SURFACE INTERACTION") : text.index("*BOUNDARY")]
        _, output = started(tmp_path, text.replace(cut, pair.format(0.1)), f"gap{said}.inp")
        assert ("nodes up to 0.2 apart are tied, too" in output) == said


@pytest.mark.filterwarnings("ignore:body LID .* which no contact resists")
@needs("floating", "scene_checks")
def test_contact_alone_holds_a_lid(tmp_path, monkeypatch):
    """A lid is pressed on tied cubes, which the tie holds: forces are those of the pressure, and it
    has no springs.
    """
    monkeypatch.chdir(tmp_path)  # for the picture
    lid = "\n".join(block_lines("LID", 2001, (0.0, 0.0, 2.0), (1.0, 1.0, 3.0), (3, 3, 1)))
    pair = (
        "*SOLID SECTION, ELSET=LID, MATERIAL=STEEL\n*SURFACE INTERACTION, NAME=I\n"
        "*CONTACT PAIR, INTERACTION=I\n"
    )
    text = tied("*DSLOAD\nLID_TOP, P, 10.").replace("*MATERIAL", f"{lid}\n*MATERIAL", 1)
    text = text.replace("*TIE", f"{pair}LID_BOTTOM, UPPER_TOP\n*TIE")
    scene, output = started(tmp_path, text)
    assert "TODO" not in output
    assert not [one for one in scene.loads if isinstance(one, hhr.Springs)]
    assert solved(scene)[1].forces().sum() == pytest.approx(10.0, rel=1e-9)
    code, output = invoke("check", tmp_path / "deck.py")
    assert code == 0 and "held by contact alone" in output and "go through each other" not in output
    # with a law of a body soft springs hold it
    text = text.replace("1000., 0.0\n", "1000., 0.0\n*PLASTIC\n1000., 0.\n", 1)
    scene, output = started(tmp_path, text, "plastic.inp")
    assert output.count("TODO") == 1 and "soft springs are added" in output
    springs = [one for one in scene.loads if isinstance(one, hhr.Springs)]
    assert [(one.place, one.component) for one in springs] == [("LID_BOTTOM", k) for k in range(3)]
    # the springs, 1e-7 E per area, bear 1e-4 times the sinking of the lid, two cubes' 2 p / E =
    # 0.02
    assert solved(scene, 1.0)[1].forces().sum() == pytest.approx(10.0 - 1e-4 * 0.02, rel=1e-6)


@needs("floating", "scene_checks")
def test_contact_alone_holds_a_jack_that_a_force_opens(tmp_path, monkeypatch):
    """A column of unit area is cut, and a force of 4 presses its lower half on the cube: the
    contact bears it.
    """
    monkeypatch.chdir(tmp_path)  # for the picture
    text = blocks("*CLOAD\n903, 1, -4.", upper=(2, 2, 2)).replace(
        "UPPER_X0, 1\nUPPER_Y0, 2\n", "UPPER_Z1, 1, 3\n"
    )
    section = "*SURFACE, NAME=CUT\n" + "".join(f"{1001 + k}, S2\n" for k in range(4))
    section += "*PRE-TENSION SECTION, SURFACE=CUT, NODE=903\n*STEP"
    scene, output = started(tmp_path, text.replace("*STEP", PILOTS + section))
    assert "TODO" not in output
    assert invoke("check", tmp_path / "deck.py")[0] == 0
    assert solved(scene)[1].forces().sum() == pytest.approx(4.0, rel=1e-9)


def sector(step="*DSLOAD\nSIDES, P, 10.", count=4):
    """A quarter of a square plate of 2 x 2 about z, between planes of symmetry."""
    lines = block_lines("BAR", 1, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (2, 2, 1))
    lines += ["*SURFACE, NAME=SIDES", "2, S4", "4, S4", "3, S5", "4, S5"]
    lines += [
        "*MATERIAL, NAME=STEEL",
        "*ELASTIC",
        "1000., 0.3",
        "*SOLID SECTION, ELSET=BAR, MATERIAL=STEEL",
    ]
    lines += ["*SURFACE, NAME=S, TYPE=NODE", "BAR_X0", "*SURFACE, NAME=M, TYPE=NODE", "BAR_Y0"]
    lines += [
        "*TIE, NAME=T, CYCLIC SYMMETRY",
        "S, M",
        f"*CYCLIC SYMMETRY MODEL, N={count}, TIE=T",
        "0., 0., 0., 0., 0., 1.",
    ]
    lines += ["*BOUNDARY", "BAR_Z0, 3", "BAR_Z1, 3", "3, 2", "*STEP", "*STATIC", step, "*END STEP"]
    return "\n".join(lines) + "\n"


def test_a_cyclic_structure(tmp_path):
    """Under pressure all around strains are alike, and the axis stays.

    A sector of another angle is left.
    """
    scene, output = started(tmp_path, sector())
    assert "TODO" not in output
    full, answer = solved(scene)
    shrunk = 10.0 * (1 - 2 * 0.3) * (1 + 0.3) / 1000.0
    u = answer.displacement().reshape(-1, 3)
    assert u[:, :2] == pytest.approx(-shrunk * full.problem.points[:, :2], abs=1e-10)
    _, output = started(tmp_path, sector(count=5), "other.inp")
    assert "turned by the angle, do not coincide" in output


def test_the_plane_out_of_reach_is_on_no_rigid_face(tmp_path):
    """All motions of the end are imposed, so that a contact there would be empty: u = 0.04 at the
    end.
    """
    imposed = "*BOUNDARY\n901, 1, 1, 0.04\n901, 2, 6\n"
    lines = KINEMATIC.replace("1, 3", "1, 6")
    text = coupled(lines, imposed).replace(FACE, "")
    text = text.replace("*SURFACE, NAME=BAR_BOTTOM", f"{FACE}*SURFACE, NAME=BAR_BOTTOM")
    scene, output = started(tmp_path, text)
    assert "TODO" not in output
    assert scene.contacts[0].surface != "HEAD"
    assert end(*solved(scene))[0] == pytest.approx(0.04, rel=1e-9)


def test_all_components_need_no_local_axes(tmp_path):
    """A coupling of all of them is the same in any axes."""
    axes = "*ORIENTATION, NAME=O\n1., 1., 0., -1., 1., 0.\n"
    scenes = [
        started(
            tmp_path,
            coupled(more + KINEMATIC.replace("CONSTRAINT", f"{words}CONSTRAINT"), FORCES),
            name,
        )
        for name, more, words in (("one.inp", "", ""), ("other.inp", axes, "ORIENTATION=O, "))
    ]
    assert "TODO" not in scenes[1][1]
    assert scenes[0][0].constraints == scenes[1][0].constraints


def test_what_cannot_be_is_left(tmp_path):
    lines = (
        "*ORIENTATION, NAME=O\n1., 0., 0., 0., 1., 0.\n"
        + ALONG.replace("CONSTRAINT", "ORIENTATION=O, CONSTRAINT")
        + (
            "*TIE, NAME=T\nHEAD, NOWHERE\n*EQUATION\n2\n5, 1, 1., 903, 1, -1.\n3\n"
            "901, 1, 1., 902, 1, 1., 5, 1, 1.\n"
        )
        + "*PRE-TENSION SECTION, SURFACE=HEAD, NODE=903\n*RIGID BODY, NSET=NOWHERE, REF NODE=901\n"
        + "*MPC\nPLANE, 5, 10, 15, 20\n"
    )
    _, output = started(tmp_path, coupled(lines, "*CLOAD\nBAR_X1, 1, 2."))
    for words in (
        "*COUPLING: no counterpart: local axes",
        "*TIE: 'NOWHERE' is no surface",
        "*PRE-TENSION SECTION: the",
        "several nodes that belong to no cell",
        "*RIGID BODY: it has no nodes",
        "*MPC: no counterpart: PLANE",
    ):
        assert words in output


ARC = (
    "*SURFACE, TYPE=SEGMENTS, NAME=TOOL\nSTART, -2., 3.\nCIRCL, 0., 1., 0., 3.\nCIRCL, 2., 3., "
    "0., 3.\n*RIGID BODY, ANALYTICAL SURFACE=TOOL, REF NODE=9\n*NODE\n9, 0., 3.\n"
)
LINES = (
    "*NODE\n9, 0., 3.\n20, -2., 1.2\n21, 0., 1.\n22, 2., 1.2\n*ELEMENT, TYPE=R2D2, "
    "ELSET=TOOL\n90, 20, 21\n91, 21, 22\n*SURFACE, NAME=TOOL\nTOOL, SPOS\n*RIGID BODY, "
    "ELSET=TOOL, REF NODE=9\n"
)


@needs("obstacles")
@pytest.mark.parametrize("tool", [ARC, LINES])
def test_a_curved_tool_presses_a_node(tool, tmp_path):
    """The middle of the lid of a strip goes down by 0.03, but for the slope of the chord of 1
    degree that it meets.
    """
    text = (
        "*NODE\n1, -1., 0.\n2, 0., 0.\n3, 1., 0.\n4, -1., 1.\n5, 0., 1.\n6, 1., 1.\n"
        "*ELEMENT, TYPE=CPE4, ELSET=BODY\n"
    )
    text += "1, 1, 2, 5, 4\n2, 2, 3, 6, 5\n*MATERIAL, NAME=M\n*ELASTIC\n1000., 0.3\n"
    text += (
        "*SOLID SECTION, ELSET=BODY, MATERIAL=M\n*SURFACE, NAME=LID\n1, S3\n2, S3\n"
        + tool
        + "*SURFACE INTERACTION, NAME=I\n*CONTACT PAIR, INTERACTION=I\nLID, TOOL\n"
    )
    text += (
        "*BOUNDARY\n1, 1, 2\n2, 1, 2\n3, 1, 2\n*STEP\n*STATIC\n"
        "*BOUNDARY\n9, 1, 1, 0.\n9, 2, 2, -0.03\n9, 6, 6\n"
    )
    scene, output = started(tmp_path, text)
    assert "TODO" not in output and isinstance(scene.contacts[0], hhr.Profile)
    assert scene.parameters.names == ("motion",)
    full, answer = solved(scene)
    node = np.linalg.norm(full.problem.points - (0.0, 1.0), axis=1).argmin()
    assert answer.displacement().reshape(-1, 2)[node] == pytest.approx((0.0, -0.03), abs=2e-5)
    assert (answer.forces() > 0).sum() == 1


@needs("floating", "obstacles")
def test_a_tool_of_rigid_elements(tmp_path):
    """A roof above the upper block, whose ridge comes down by 0.1, presses its middle.

    At a crease one side counts.
    """
    tool = (
        "*NODE\n9001, -1., -1., 2.5\n9002, 0.5, -1., 2.\n9003, 2., -1., 2.5\n9004, -1., 2., "
        "2.5\n9005, 0.5, 2., 2.\n9006, 2., 2., 2.5\n9009, 0., 0., 3.\n*ELEMENT, TYPE=R3D4, "
        "ELSET=TOOL\n9001, 9001, 9002, 9005, 9004\n9002, 9002, 9003, 9006, 9005\n*SURFACE, "
        "NAME=STAMP\nTOOL, SNEG\n*RIGID BODY, ELSET=TOOL, REF NODE=9009\n*CONTACT PAIR, "
        "INTERACTION=TOUCH\nUPPER_TOP, STAMP"
    )
    text = blocks(
        "*BOUNDARY\n9009, 1, 2\n9009, 3, 3, -0.1\n9009, 4, 6", before=tool, upper=(4, 4, 1)
    )
    scene, output = started(tmp_path, text)
    assert "TODO" not in output and isinstance(scene.contacts[1], hhr.RigidMesh)
    full, answer = solved(scene)
    forces = answer.forces()[full.problem.pressing_of(1)]
    assert (forces > 0).sum() == 5 and end(full, answer, (0.5, 0.5, 2.0))[2] == pytest.approx(
        -0.1, abs=5e-4
    )


def test_check_knows_the_places_of_constraints(tmp_path):
    """Numbers of components are no numbers of surfaces, and places stand in terms of equations
    too.
    """
    from hhr_dolfinx.plugins.scene_checks.check import check_scene
    from hhr_dolfinx.plugins.scene_checks.findings import NOTE

    (tmp_path / "bar.inp").write_text(bar(""))
    plain = hhr.Scene(
        name="bar",
        geometry=hhr.MeshFile(tmp_path / "bar.inp"),
        hypothesis="solid",
        bodies=(hhr.Body("BAR", 1000.0, 0.3),),
        contacts=(hhr.Obstacle("BAR_TOP", (0.0, 0.0, 1.0), 9.0),),
        displacements=hhr.Displacement.clamp("BAR_X0", 3),
        loads=(hhr.Pressure("BAR_TOP", "p"),),
        parameters=hhr.ParameterSpace(("p",), (0.0,), (1.0,)),
    )
    means = tuple(hhr.MeanMotion("BAR_X1", k) for k in (1, 2))
    equation = hhr.Equation((("BAR_X1", 1, 1.0), (hhr.Nodes.near((4.0, 0.0, 0.0)), 2, -1.0)))
    idle = []
    for constraints in ((), means, (equation,)):
        found = check_scene(replace(plain, constraints=constraints)).findings
        notes = [one.text for one in found if one.level == NOTE and "nothing names" in one.text]
        idle.append(set(notes[0].rpartition(": ")[2].split(", ")))
    assert "BAR_X1" in idle[0] and idle[1] == idle[2] == idle[0] - {"BAR_X1"}


ROUND = {
    "ball": (
        "REVOLUTION, FILLET RADIUS=.1",
        "2., .5, 6., 2., .5, 7.\nSTART, 5., 0.\nCIRCL, 0., -5., 0., 0.\n",
        {"kind": "Sphere", "center": (2.0, 0.5, "6 - down"), "radius": 5.0},
    ),
    # arcs of 3 degrees, whose chords are within 1.7e-4 of this radius of 0.5
    "pin": (
        "REVOLUTION",
        "2.02, .48, 1.5, 2.02, .48, 2.5\nSTART, .5, 3.\nLINE, .5, 0.\nCIRCL, 0., -.5, 0., 0.\n",
        {"kind": "Sphere", "center": (2.02, 0.48, "1.5 - down"), "radius": 0.5},
    ),
    "roller": (
        "CYLINDER",
        "2., .5, 6., 3., .5, 6.\n2., 1., 6.\nSTART, -5., 0.\nCIRCL, 0., -5., 0., 0.\n"
        "CIRCL, 5., 0., 0., 0.\n",
        {"kind": "Cylinder", "point": (2.0, 0.5, "6 - down"), "axis": (0, 1, 0), "radius": 5.0},
    ),
    "cone": (
        "REVOLUTION",
        "2.1, .4, 1., 2.1, .4, 2.\nSTART, 0., 0.\nLINE, 30., 0.3\n",
        {
            "kind": "Cone",
            "tip": (2.1, 0.4, "1 - down"),
            "axis": (0, 0, 1),
            "angle": np.rad2deg(np.arctan(100.0)),
        },
    ),
}
"""Analytical rigid surfaces above a bar of 4 x 1 x 1, which they touch in its middle."""


@needs("obstacles")
@pytest.mark.parametrize("name", ROUND)
def test_analytical_rigid_surfaces_in_space(name, tmp_path):
    """They press as spheres, cylinders and cones do; arcs and turns of facets are off by little."""
    kind, lines, exact = ROUND[name]
    tool = f"*NODE\n900, 2., .5, 9.\n*SURFACE, TYPE={kind}, NAME=TOOL\n{lines}"
    tool += "*RIGID BODY, ANALYTICAL SURFACE=TOOL, REF NODE=900\n*SURFACE INTERACTION, NAME=I\n"
    tool += "*CONTACT PAIR, INTERACTION=I\nBAR_TOP, TOOL\n*STEP"
    text = bar("*BOUNDARY\n900, 3, 3, -0.01", cells=(8, 2, 2)).replace("*STEP", tool, 1)
    scene, output = started(tmp_path, text)
    assert "TODO" not in output
    # 3,800 facets of the pin in one line took half a minute
    written = max(tmp_path.glob("*.py"), key=lambda path: path.stat().st_size).read_text()
    assert max(map(len, written.splitlines())) <= 120
    exact = dict(exact)
    obstacle = getattr(hhr, exact.pop("kind"))("BAR_TOP", **exact)
    reference = replace(
        scene, contacts=(obstacle,), parameters=hhr.ParameterSpace(("down",), (0.0,), (0.02,))
    )
    answer = solved(scene)[1]
    known = hhr.FullOrderModel(reference).solve([0.01])
    assert known.forces().sum() > 0.01
    near = 1.7e-2 if name == "pin" else 2e-3  # 1.7e-4 over the depth of 0.01
    assert answer.forces().sum() == pytest.approx(known.forces().sum(), rel=near)
    assert answer.active.sum() == known.active.sum()


UNSORTED = """*NODE
1, 0., 0., 0.
2, 0., 1., 0.
3, 0., 1., 1.
4, 0., 0., 1.
5, 1., 0., 1.
6, 1., 0., 0.
7, 1., 1., 0.
8, 1., 1., 1.
*ELEMENT, TYPE=C3D8, ELSET=BOX
1, 1, 6, 7, 2, 4, 5, 8, 3
*NSET, NSET=LEFT, UNSORTED
1, 2, 3, 4
*NSET, NSET=RIGHT, UNSORTED
6, 7, 8, 5
*MATERIAL, NAME=M
*ELASTIC
1000., 0.
*SOLID SECTION, ELSET=BOX, MATERIAL=M
*EQUATION
2
LEFT, 1, 1., RIGHT, 1, -1.
*STEP
*STATIC
*BOUNDARY
1, 1, 3
2, 1
4, 1, 2
*CLOAD
8, 3, 1.
*END STEP
"""


def test_sets_pair_in_their_order_if_they_are_not_sorted(tmp_path):
    """By numbers node 1 would pair with 5, which lies elsewhere on its side: such an equation is
    left.
    """
    for text, lost in ((UNSORTED, False), (UNSORTED.replace(", UNSORTED", ""), True)):
        (tmp_path / "deck.inp").write_text(text)
        code, output = invoke("start", tmp_path / "deck.inp", "--force")
        assert code == 0 and ("paired in another order" in output) == lost, output
        found = scene_of(str(tmp_path / "deck.py")).constraints
        assert len(found) == (0 if lost else 1)


INCLINED = "TYPE=R\n1., .5, 0., -.5, 1., 0.\n"
AXES = {
    "slide": f"*TRANSFORM, NSET=BAR_X0, {INCLINED}*BOUNDARY\nBAR_X0, 1\nBAR_Z0, 3\n6, 1, 2\n",
    "by numbers": "*NSET, NSET=FEW\n1, 6, 11, 16\n"
    f"*TRANSFORM, NSET=FEW, {INCLINED}*BOUNDARY\n1, 1\n6, 1\n"
    "11, 1\n16, 1\nBAR_Z0, 3\n6, 2\n",
    "about an axis": "*TRANSFORM, NSET=BAR_X1, TYPE=C\n0., -3., .2, 0., -3., 1.\n"
    "*BOUNDARY\nBAR_X1, 2, 2, .01\nBAR_X0, 1, 3\n",
}
"""Supports of a bar in local axes: across an inclined plane, and around an axis."""


@needs("constraints")
@pytest.mark.skipif(shutil.which("ccx") is None, reason="ccx, CalculiX, is not installed")
@pytest.mark.parametrize("name", AXES)
def test_supports_in_local_axes(name, tmp_path):
    """Displacements of CalculiX to its seven digits."""
    text = bar("*CLOAD\nBAR_X1, 1, 1.\nBAR_X1, 3, .2\n*NODE PRINT, NSET=ALL, GLOBAL=YES\nU")
    held = "*BOUNDARY\nBAR_X0, 1\nBAR_Y0, 2\nbar_z0, 3\n"
    assert held in text
    text = text.replace(held, AXES[name])
    if name == "about an axis":
        text = text.replace("BAR_X1, 1, 1.\n", "")
    (tmp_path / "deck.inp").write_text(text)
    subprocess.run(["ccx", "deck"], cwd=tmp_path, check=True, capture_output=True)
    lines = [line.split() for line in (tmp_path / "deck.dat").read_text().splitlines()]
    printed = np.array([line for line in lines if len(line) == 4], dtype=float)[:, 1:]
    scene, output = started(tmp_path, text)
    assert "TODO" not in output
    assert any(isinstance(one, hhr.DirectedDisplacement) for one in scene.constraints)
    full, answer = solved(scene)
    moved = answer.displacement().reshape(-1, 3)
    places = [(x, y, z) for z in (0.0, 1.0) for y in (0.0, 1.0) for x in range(5)]
    order = [np.abs(full.problem.points - place).sum(axis=1).argmin() for place in places]
    assert moved[order] == pytest.approx(printed, abs=1e-6 * np.abs(printed).max())


@needs("constraints")
@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            "*TRANSFORM, NSET=BAR_X1, TYPE=C\n0., 0., 0., 0., 0., 1.\n*CLOAD\nBAR_X1, 1, 1.\n",
            "radial forces at nodes",
        ),
        (
            "*TRANSFORM, NSET=BAR_Y0, TYPE=R\n1., 1., 0., -1., 1., 0.\n*BOUNDARY\nBAR_X1, 2\n",
            "several systems of axes",
        ),
    ],
)
def test_local_axes_without_a_counterpart(lines, said, tmp_path):
    """Forces around an axis, and sets of which some nodes alone have local axes."""
    _, output = started(tmp_path, bar("*DLOAD\n4, P4, 1.").replace("*STEP", f"{lines}*STEP", 1))
    assert said in output


@needs("obstacles")
def test_a_body_in_a_hole_beside_a_larger_one(tmp_path):
    """The block is in the sphere, though most nodes of the deck are not.

    Friction does not drag it, which is said.
    """
    lines = block_lines("LOWER", 1, (-0.5, -0.5, -4.9), (0.5, 0.5, -4.0), (2, 2, 1))
    lines += block_lines("PLATE", 2001, (20.0, 0.0, 0.0), (21.0, 1.0, 1.0), (5, 5, 5))
    lines += [
        "*MATERIAL, NAME=M",
        "*ELASTIC",
        "1000., .3",
        "*SOLID SECTION, ELSET=LOWER, MATERIAL=M",
    ]
    lines += ["*SOLID SECTION, ELSET=PLATE, MATERIAL=M", "*NODE", "900, 0., 0., 0."]
    lines += [
        "*SURFACE, TYPE=REVOLUTION, NAME=TOOL",
        "0., 0., 0., 0., 0., 1.",
        "START, 0., -5.",
        "CIRCL, 5., 0., 0., 0.",
    ]
    lines += [
        "*RIGID BODY, ANALYTICAL SURFACE=TOOL, REF NODE=900",
        "*SURFACE INTERACTION, NAME=I",
        "*FRICTION",
        ".2",
    ]
    lines += [
        "*CONTACT PAIR, INTERACTION=I",
        "LOWER_BOTTOM, TOOL",
        "*BOUNDARY",
        "LOWER_Z1, 1, 2",
        "PLATE_Z0, 1, 3",
    ]
    lines += [
        "LOWER_Z1, 3, 3, -.12",
        "*STEP",
        "*STATIC",
        "*BOUNDARY",
        "900, 1, 1, 0.01",
        "*END STEP",
    ]
    scene, output = started(tmp_path, "\n".join(lines) + "\n")
    assert scene.contacts[0].inside
    assert output.count("TODO") == 1 and "does not drag it by friction" in output


@needs("rigid_tools", "floating")
def test_a_force_on_a_rigid_surface_is_a_line_to_paste(tmp_path):
    """It names the reference point, and force and moment by component; rows of one add up."""
    deck = bar("*CLOAD\n900, 1, -3.\n900, 1, -1.\n900, 5, 2.").replace(
        "*STEP",
        "*NODE\n900, 10., .5, .5\n*SURFACE, TYPE=CYLINDER, NAME=TOOL\n"
        "10., -1., 0., 10., 2., 0.\n10., -1., 1.\nSTART, 0., 0.\nLINE, 3., 0.\n"
        "*RIGID BODY, ANALYTICAL SURFACE=TOOL, REF NODE=900\n*STEP",
        1,
    )
    _, output = started(tmp_path, deck)
    assert "a force on its reference node drives it" in output
    assert "at=(10.0, 0.5, 0.5), force={0: -4.0, 4: 2.0})" in output


def test_a_rigid_element_without_its_nodes(tmp_path):
    """The node that is missing is named."""
    tool = "*NODE\n900, 0., 0., 3.\n*ELEMENT, TYPE=R3D4, ELSET=TOOL\n800, 900, 901, 902, 903\n"
    tool += "*SURFACE, NAME=T\nTOOL, SPOS\n"
    tool += "*RIGID BODY, ELSET=TOOL, REF NODE=900\n*SURFACE INTERACTION, NAME=I\n"
    tool += "*CONTACT PAIR, INTERACTION=I\nBAR_TOP, T\n"
    (tmp_path / "deck.inp").write_text(
        bar("*CLOAD\nBAR_X1, 1, 1.").replace("*STEP", tool + "*STEP", 1)
    )
    code, output = invoke("start", tmp_path / "deck.inp")
    assert code and "node 901 of an element or a set is not in the deck" in output
