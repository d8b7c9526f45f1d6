"""`*SURFACE BEHAVIOR` of decks: curves become soft contact, a linear one stays hard by name."""

import pytest
from deck_runs import by_calculix, solved, started
from deck_texts import blocks
from needs import needs
from scipy.optimize import brentq

from hhr_dolfinx.command.loading import scene_of

pytestmark = needs("floating", "soft_contact")
STIFFNESS = 500.0
"""Of two cubes of modulus 1000 on each other: pressure over the motion that they share."""
MOTION = 0.05
LID = f"*BOUNDARY\nUPPER_Z1, 3, 3, {-MOTION}"
TABLE = "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=TABULAR\n0., 0.\n2., .01\n8., .02\n40., .06"
EXPONENTIAL = "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=EXPONENTIAL\n.02, 3."
LINEAR = "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR\n200."
CURVES = {
    TABLE: lambda h: 8.0 + (h - 0.02) * 800.0 if h > 0.02 else 2.0 + (h - 0.01) * 600.0,
    EXPONENTIAL: lambda h: 3.0 * 100.0 ** (h / 0.02),
}


def pressure(scene):
    return solved(scene)[1].outputs()["largest pressure 0"]


def read(folder, interaction):
    # CalculiX loses nodes that move off the edge of the other surface by a rounding error
    aside = "UPPER_Z0, 1, 2\nLOWER_Z1, 1, 2"
    kind = "NODE TO SURFACE"
    text = blocks(LID, interaction=interaction, kind=kind, upper=(2, 2, 1), before=aside)
    return text, *started(folder, text)


@pytest.mark.parametrize("interaction", CURVES, ids=("table", "exponential"))
def test_curves_are_soft_contact(interaction, tmp_path):
    """The cubes are springs in series with the curve; CalculiX reads the same deck."""
    text, scene, _ = read(tmp_path, interaction)
    curve = CURVES[interaction]
    overlap = brentq(lambda h: curve(h) - STIFFNESS * (MOTION - h), 0.0, MOTION, xtol=1e-15)
    found = pressure(scene)
    assert found == pytest.approx(curve(overlap), rel=1e-9)
    assert by_calculix(tmp_path, text, "LOWER_Z0")[2] == pytest.approx(found, rel=2e-3)


def test_a_linear_curve_stays_hard_and_its_line_is_the_law(tmp_path):
    """In codes without hard contact it is a penalty; whoever means it has the text to paste."""
    _, scene, output = read(tmp_path, LINEAR)
    assert pressure(scene) == pytest.approx(STIFFNESS * MOTION, rel=1e-9)
    assert "contact is hard here" in output and "law=hhr.SoftContact(stiffness=200.0)" in output
    file = tmp_path / "deck.py"
    written = file.read_text()
    axis = '"LOWER_TOP", (0.0, 0.0, -1.0)'
    assert written.count(axis) == 1
    file.write_text(written.replace(axis, f"{axis}, law=hhr.SoftContact(stiffness=200.0)"))
    soft = MOTION / (1 / STIFFNESS + 1 / 200)
    assert pressure(scene_of(str(file))) == pytest.approx(soft, rel=1e-9)


@needs("friction")
@pytest.mark.parametrize(("line", "friction"), [
    ("*FRICTION\n.3, 1e5", "friction=0.3"),
    ("*FRICTION, TAUMAX=5.\n.3, 1e5", "friction=hhr.Coulomb(0.3, 5.0)"),
    ("*FRICTION, ROUGH", "friction=1000000.0"),
])  # fmt: skip
def test_soft_contact_has_its_friction(line, friction, tmp_path):
    """Pressed along the normal the force is that without friction, as the block does not widen."""
    folders = [tmp_path / name for name in ("without", "with")]
    for folder in folders:
        folder.mkdir()
    _, scene, _ = read(folders[0], TABLE)
    _, with_friction, output = read(folders[1], f"{TABLE}\n{line}")
    assert "a pair has" not in output
    assert f"{friction}, law=hhr.SoftContact" in (folders[1] / "deck.py").read_text()
    assert pressure(with_friction) == pytest.approx(pressure(scene), rel=1e-9)


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        ("TABULAR\n1., 0.\n2., 1.", "the first must be 0"),
        ("TABULAR\n0., 0.\n2., 1.\n1., 2.", "falls"),
        ("TABULAR\n0., 0., 2., .01", "a line of a table has"),
        ("EXPONENTIAL\n.02, 0.", "give a positive number"),
        ("LINEAR\n-200.", "give a positive number"),
    ],
)
def test_a_curve_that_is_refused_is_hard_contact(rows, why, tmp_path):
    table = f"*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE={rows}"
    _, scene, output = read(tmp_path, table)
    assert "contact is hard here, as its curve is refused" in output and why in output
    assert pressure(scene) == pytest.approx(STIFFNESS * MOTION, rel=1e-9)


def test_the_last_behavior_of_an_interaction_counts(tmp_path):
    """As in CalculiX; the two numbers of an exponential curve may be on two lines."""
    folders = [tmp_path / name for name in ("hard", "soft", "split")]
    for folder in folders:
        folder.mkdir()
    hard = f"{TABLE}\n*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=HARD"
    assert pressure(read(folders[0], hard)[1]) == pytest.approx(STIFFNESS * MOTION, rel=1e-9)
    assert "SoftContact" not in (folders[0] / "deck.py").read_text()
    soft = pressure(read(folders[1], EXPONENTIAL)[1])
    split = pressure(read(folders[2], EXPONENTIAL.replace(".02, 3.", ".02\n3."))[1])
    assert split == soft < STIFFNESS * MOTION


@needs("no_separation")
def test_surfaces_without_separation(tmp_path):
    """They are pulled as springs of the cubes after they have been pressed."""
    line = "*SURFACE BEHAVIOR, NO SEPARATION, PRESSURE-OVERCLOSURE=HARD"
    _, scene, output = read(tmp_path, line)
    assert "hold from the end of the step in which they have pressed" in output
    assert "law=hhr.NoSeparation()" in (tmp_path / "deck.py").read_text()
    assert pressure(scene) == pytest.approx(STIFFNESS * MOTION, rel=1e-9)


@needs("no_separation", "friction")
@pytest.mark.parametrize(("lines", "law", "said"), [
    ("LINEAR\n200.", "law=hhr.NoSeparation()", "contact is hard here"),
    ("HARD\n*FRICTION, ROUGH", "law=hhr.NoSeparation()", "hhr.Tie(SLAVE, MASTER)"),
    ("TABULAR\n0., 0.\n2., .01", "law=hhr.SoftContact", "may open here"),
])  # fmt: skip
def test_what_holds_beside_another_word(lines, law, said, tmp_path):
    _, _, output = read(tmp_path, f"*SURFACE BEHAVIOR, NO SEPARATION, PRESSURE-OVERCLOSURE={lines}")
    assert law in (tmp_path / "deck.py").read_text() and said in output
