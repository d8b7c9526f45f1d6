"""Contact pairs of decks that neither open nor slide, beside CalculiX."""

import numpy as np
import pytest
from deck_runs import by_calculix, solved, started
from deck_texts import block_lines
from needs import needs

pytestmark = [needs("decks"), needs("constraints")]
STIFF = "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=TIED\n1e9\n*FRICTION\n.1, 1e9"


def deck(behaviour="", option=""):
    """Two blocks whose upper one is pulled up and aside."""
    lines = block_lines("LOWER", 1, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (3, 3, 2))
    lines += block_lines("UPPER", 1001, (0.0, 0.0, 1.0), (1.0, 1.0, 2.0), (3, 3, 2))
    lines += ["*MATERIAL, NAME=STEEL\n*ELASTIC\n1000., .3"]
    lines += [f"*SOLID SECTION, ELSET={name}, MATERIAL=STEEL" for name in ("LOWER", "UPPER")]
    lines += [f"*SURFACE INTERACTION, NAME=TOUCH\n{behaviour}".rstrip()]
    kind = "SURFACE TO SURFACE" if behaviour else "NODE TO SURFACE"
    lines += [f"*CONTACT PAIR, INTERACTION=TOUCH, TYPE={kind}{option}\nUPPER_BOTTOM, LOWER_TOP"]
    lines += ["*BOUNDARY\nLOWER_Z0, 1, 3\nUPPER_Z1, 2, 2\n*STEP\n*STATIC"]
    lines += ["*BOUNDARY\nUPPER_Z1, 3, 3, .01\nUPPER_Z1, 1, 1, .005\n*END STEP\n"]
    return "\n".join(lines)


@pytest.mark.parametrize(("behaviour", "option"), [(STIFF, ""), ("", ", TIED")])
def test_tied_pairs_are_ties(behaviour, option, tmp_path):
    """The reactions of CalculiX' tied contact, whose springs are a million times as stiff as the
    blocks; *CONTACT PAIR, TIED, which it does not have, is the same.
    """
    scene, output = started(tmp_path, deck(behaviour, option))
    assert "TODO" not in output
    assert [type(item).__name__ for item in scene.constraints] == ["Tie"]
    full, answer = solved(scene)
    problem = full.problem
    foot = np.flatnonzero(problem.points[:, 2] < 1e-9)
    inner = problem.stiffness_of_rows @ answer.displacement()
    found = inner.reshape(-1, 3)[foot].sum(axis=0)
    expected = by_calculix(tmp_path, deck(STIFF), "LOWER_Z0")
    assert np.abs(expected[[0, 2]]).min() > 0.4
    assert found == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())
