"""Soft contact: closed forms of uniform blocks, contracts, CalculiX' own curves, mistakes."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import lying, pressed_block, space

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, SceneError

pytestmark = [needs("soft_contact")]
BLOCK = 3.0 / (1 - 0.3**2) / 2
"""Pressure of the block of height 2 in plane strain over its shortening."""
TABLE = ((-0.01, 0.0), (0.0, 0.02), (0.01, 0.02), (0.03, 0.12))
LAWS = {
    "linear": hhr.SoftContact(stiffness=2.0),
    "exponential": hhr.SoftContact(exponential=(0.02, 0.03)),
    "table": hhr.SoftContact(table=TABLE),
}


def curve(name, h):
    """Pressure at overlaps, written down here."""
    if name == "linear":
        return 2.0 * np.maximum(h, 0.0)
    if name == "exponential":
        return 0.03 * 100.0 ** (h / 0.02)
    return np.interp(h, *np.transpose((*TABLE, (1.03, 5.12))))


def soft_block(law, **changes):
    """The block whose pressure is uniform, on a soft floor .01 below it."""
    scene = pressed_block("plane_strain")
    floor = replace(scene.contacts[0], law=law)
    outputs = (hhr.LargestPressure("peak", 0), hhr.GapAt("gap", 0, (0.5, 0.0)))
    return replace(scene, contacts=(floor,), outputs=outputs, **changes)


def pressure_by_hand(name, push):
    """The pressure p at which the block, shortened by p / BLOCK, presses as deep as the curve."""
    low, high = 0.0, 1.0
    for _ in range(200):
        p = 0.5 * (low + high)
        low, high = (p, high) if curve(name, push - 0.01 - p / BLOCK) > p else (low, p)
    return low


@pytest.mark.parametrize("name", LAWS)
def test_a_uniform_block_on_a_soft_floor(name, tmp_path):
    """In full order, condensed and from a file; gradients are those of differences."""
    scene = soft_block(LAWS[name])
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    model = hhr.condense(full)
    hhr.save_model(tmp_path / "model.npz", model)
    for each in (full, model, hhr.load_model(tmp_path / "model.npz")):
        for push in (0.0, 0.004, 0.012, 0.05, 0.1):
            expected = pressure_by_hand(name, push)
            found = each.outputs([push])
            # the exponential curve begins where its pressure is 1e-10 of that at touch
            assert found["peak"] == pytest.approx(expected, rel=1e-8, abs=1e-11)
            gap = 0.01 - push + expected / BLOCK
            if expected > 1e-11:
                assert found["gap"] == pytest.approx(gap, rel=1e-7, abs=1e-10)
    slope = model.solve([0.05], gradient=True).gradient.multipliers[:, 0]
    ends = [model.solve([0.05 + step]).multipliers for step in (-1e-6, 1e-6)]
    assert slope == pytest.approx((ends[1] - ends[0]) / 2e-6, rel=1e-6)


@pytest.mark.parametrize("name", LAWS)
def test_a_stiffness_that_is_a_parameter(name):
    """The constant of each curve by a formula; its derivative is that of differences."""
    given = {
        "linear": hhr.SoftContact(stiffness="2 * k"),
        "exponential": hhr.SoftContact(exponential=(0.02, "0.03 * k")),
        "table": hhr.SoftContact(table=TABLE, scale="k"),
    }
    box = space(push=(0.0, 0.1), k=(0.5, 2.0))
    varied = hhr.condense(soft_block(given[name], parameters=box))
    fixed = hhr.condense(soft_block(LAWS[name]))
    assert varied.outputs([0.07, 1.0])["peak"] == pytest.approx(
        fixed.outputs([0.07])["peak"], rel=1e-10
    )
    slope = varied.outputs([0.07, 1.3], gradient=True).gradient["peak"]
    for axis, step in enumerate(1e-6 * np.eye(2)):
        ends = [varied.outputs(np.array([0.07, 1.3]) + sign * step)["peak"] for sign in (-1, 1)]
        assert slope[axis] == pytest.approx((ends[1] - ends[0]) / 2e-6, rel=1e-5)


@needs("conformance")
@pytest.mark.parametrize("name", LAWS)
def test_it_keeps_the_contract_of_contact_laws(name):
    """Full, condensed, files, cuts, hyper-reduced and compiled, on blocks of other sizes."""
    from hhr_dolfinx.testing import check_contact_law

    check_contact_law(LAWS[name])


def test_a_stiff_curve_comes_near_to_hard_contact():
    scene = pressed_block("plane_strain")
    hard = hhr.condense(scene).solve([0.08]).forces()
    far = [
        np.abs(hhr.condense(soft_block(hhr.SoftContact(stiffness=k))).solve([0.08]).forces() - hard)
        for k in (1e6, 1e12)
    ]
    assert far[0].max() < 1e-5 * hard.max() and far[1].max() < 1e-10 * hard.max()


@needs("floating")
@pytest.mark.filterwarnings("ignore:body 2 .* moves along axis 0")
def test_a_block_that_soft_contact_alone_holds():
    """Its forces bear the load."""
    scene = lying(bulge=0.0)
    pair = replace(scene.contacts[0], law=hhr.SoftContact(stiffness=1e4))
    scene = replace(scene, contacts=(pair,))
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    answer = full.solve([5.0])
    width = np.ptp(full.problem.contact_points[:, 0])
    assert answer.forces().sum() == pytest.approx(5.0 * width, rel=1e-9)
    assert hhr.condense(scene).solve([5.0]).forces() == pytest.approx(answer.forces(), rel=1e-8)


@needs("worst_case")
def test_a_worst_case_is_refused_for_its_law_and_not_for_a_memory():
    model = hhr.condense(soft_block(LAWS["linear"]))
    with pytest.raises(NotOfferedError, match="pairs without a law of their own"):
        hhr.worst(model, "peak")


@needs("floating")
@pytest.mark.filterwarnings("ignore:body 2 .* moves along axis 0")
def test_a_free_block_without_contact_has_derivatives_and_a_file(tmp_path):
    """Motions that nothing determines do not move: loads of the middle of the box vanish."""
    scene = lying(cells=(4, 3), parameters=space(p=(-10.0, 10.0)))
    pair = replace(scene.contacts[0], law=hhr.SoftContact(stiffness=1e4))
    model = hhr.condense(replace(scene, contacts=(pair,)))
    assert np.abs(model.solve([0.0], gradient=True).forces()).max() < 1e-12
    hhr.save_model(tmp_path / "model.npz", model)
    again = hhr.load_model(tmp_path / "model.npz")
    assert again.solve([5.0]).forces() == pytest.approx(model.solve([5.0]).forces(), rel=1e-12)


DECK = """*NODE
1,0,0,0
2,1,0,0
3,1,1,0
4,0,1,0
5,0,0,1
6,1,0,1
7,1,1,1
8,0,1,1
11,0,0,1.01
12,1,0,1.01
13,1,1,1.01
14,0,1,1.01
15,0,0,2.01
16,1,0,2.01
17,1,1,2.01
18,0,1,2.01
*ELEMENT,TYPE=C3D8,ELSET=LOW
1,1,2,3,4,5,6,7,8
*ELEMENT,TYPE=C3D8,ELSET=HIGH
2,11,12,13,14,15,16,17,18
*MATERIAL,NAME=M
*ELASTIC
1000,0
*SOLID SECTION,ELSET=LOW,MATERIAL=M
*SOLID SECTION,ELSET=HIGH,MATERIAL=M
*SURFACE,NAME=MASTER
1,S2
*SURFACE,NAME=SLAVE
2,S1
*SURFACE INTERACTION,NAME=I
*SURFACE BEHAVIOR,PRESSURE-OVERCLOSURE={behavior}
*CONTACT PAIR,INTERACTION=I,TYPE={kind}
SLAVE,MASTER
*NSET,NSET=TOP
15,16,17,18
*NSET,NSET=ALL
1,2,3,4,5,6,7,8,11,12,13,14,15,16,17,18
*BOUNDARY
ALL,1,2
1,3,3
2,3,3
3,3,3
4,3,3
*STEP
*STATIC
1.,1.
*BOUNDARY
TOP,3,3,{motion}
*NODE PRINT,NSET=TOP,TOTALS=ONLY
RF
*END STEP
"""
THEIRS = {
    "LINEAR": ("LINEAR\n2000.,0.", hhr.SoftContact(stiffness=2000.0)),
    "EXPONENTIAL": ("EXPONENTIAL\n0.02,30.", hhr.SoftContact(exponential=(0.02, 30.0))),
    "TABULAR": (
        "TABULAR\n0.,0.\n20.,.01\n80.,.02\n400.,.06",
        hhr.SoftContact(table=((0.0, 0.0), (0.01, 20.0), (0.02, 80.0), (0.06, 400.0))),
    ),
}


def by_calculix(name, motion, folder):
    """Force between the cubes by CalculiX' own contact."""
    # between surfaces its exponential curve, which begins by a jump, does not converge here, and
    # its table has no force
    kind = "SURFACE TO SURFACE" if name == "LINEAR" else "NODE TO SURFACE"
    deck = DECK.format(behavior=THEIRS[name][0], motion=motion, kind=kind)
    (folder / "cubes.inp").write_text(deck)
    subprocess.run(["ccx", "cubes"], cwd=folder, capture_output=True, timeout=300, check=True)
    return -float((folder / "cubes.dat").read_text().split()[-1])


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
@pytest.mark.parametrize("motion", [-0.02, -0.05])
@pytest.mark.parametrize("name", THEIRS)
def test_curves_are_those_of_calculix(name, motion, tmp_path):
    """Two cubes without lateral contraction: springs of 1000 in series with the curve, whose
    pressure CalculiX finds with its own contact; it knows the curve by its keyword alone.
    """
    theirs = by_calculix(name, motion, tmp_path)
    assert theirs > 1.0
    assert on_each_other(THEIRS[name][1], motion) == pytest.approx(theirs, rel=2e-3)


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_beyond_its_table_calculix_keeps_the_pressure_and_we_do_not(tmp_path):
    """As the docs say: 400 there; here the last segment goes on, so that nothing sinks in."""
    assert by_calculix("TABULAR", -0.95, tmp_path) == pytest.approx(400.0, rel=1e-6)
    # 400 + 8000 (h - .06) = 500 (.94 - h), springs of 1000 in series over the rest
    expected = 500.0 * (0.94 - (470.0 + 80.0) / 8500.0)
    assert on_each_other(THEIRS["TABULAR"][1], -0.95) == pytest.approx(expected, rel=1e-9)


def on_each_other(law, motion):
    """The force between two cubes of our own, without lateral motion."""
    from hhr_dolfinx.geometries import two_blocks

    lower, upper = two_blocks.FIRST, two_blocks.SECOND
    scene = hhr.Scene(
        name="cubes",
        geometry=lambda comm: two_blocks.two_blocks(
            comm,
            first=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1, 1, 1)),
            second=((0.0, 0.0, 1.01), (1.0, 1.0, 2.01), (1, 1, 1)),
        ),
        hypothesis="solid",
        bodies=(hhr.Body(lower, 1000.0, 0.0), hhr.Body(upper, 1000.0, 0.0)),
        contacts=(
            hhr.NodeToNode(
                two_blocks.side(upper, 2, False),
                two_blocks.side(lower, 2, True),
                (0.0, 0.0, -1.0),
                law=law,
            ),
        ),
        displacements=(
            *hhr.Displacement.clamp(two_blocks.side(lower, 2, False), 3),
            hhr.Displacement(two_blocks.side(upper, 2, True), 0),
            hhr.Displacement(two_blocks.side(upper, 2, True), 1),
            hhr.Displacement(
                two_blocks.side(upper, 2, True), 2, hhr.Amplitude(slopes={"move": 1.0})
            ),
        ),
        parameters=space(move=(-0.95, 0.0)),
    )
    return float(hhr.condense(scene).solve([motion]).forces().sum())


MISTAKES = {
    "no curve": (dict(), "one curve"),
    "two curves": (dict(stiffness=1.0, exponential=(1.0, 1.0)), "stiffness and exponential"),
    "no clearance": (dict(exponential=(0.0, 1.0)), "must be positive"),
    "one number": (dict(exponential=(1.0,)), "clearance, pressure"),
    "one point": (dict(table=((0.0, 0.0),)), "two points"),
    "words": (dict(table=(("a", "b"), (1, 2))), "two points"),
    "not from zero": (dict(table=((0.0, 1.0), (1.0, 2.0))), "first must be 0"),
    "back": (dict(table=((0.0, 0.0), (0.0, 2.0))), "must be finite and grow"),
    "softens": (dict(table=((0.0, 0.0), (1.0, 2.0), (2.0, 1.0))), "softens"),
    "never presses": (dict(table=((0.0, 0.0), (1.0, 0.0))), "no pressure"),
    "scale of none": (dict(stiffness=1.0, scale=2.0), "that of a table"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_named(mistake):
    given, words = MISTAKES[mistake]
    with pytest.raises(SceneError, match=words):
        hhr.SoftContact(**given)


@pytest.mark.parametrize("stiffness", [0.0, -1.0, "k - 1", float("nan")])
def test_a_stiffness_that_does_not_press_is_refused(stiffness):
    box = space(push=(0.0, 0.1), k=(0.5, 2.0))
    with pytest.raises(SceneError):
        hhr.condense(soft_block(hhr.SoftContact(stiffness=stiffness), parameters=box))
