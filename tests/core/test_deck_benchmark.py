"""Decks of the benchmark: outcomes are those that its report gives, and wrong numbers are not
called right.
"""

import deck_cases
import deck_fits
import decks
import pytest
from deck_entries import ENTRIES, Entry
from needs import needs

NAMED = {entry.source: entry for entry in ENTRIES}


@needs("decks", "scene_checks", "mortar")
@pytest.mark.parametrize("name", ["testmortar", "contact13"])
def test_a_deck_is_right_or_refused(name, tmp_path):
    found = decks.run(NAMED[name], tmp_path, False)
    assert found["outcome"] == "right" or found["outcome"].startswith("refused: TODO")
    assert (found["ours"] is None) == (name == "contact13")


@needs("nonmatching", "mortar", "friction", "obstacles")
@pytest.mark.parametrize(
    "case",
    [case for case in deck_fits.CASES if case.reference == 1.0],
    ids=lambda case: case.source,
)
def test_a_press_fit_is_pushed_off_by_mu_times_its_normal_force(case, tmp_path):
    """All contacts slip: round-off.

    Friction points along the line to rest, which a rounded shaft turns by 1e-4.
    """
    exact = 1e-7 if "triangles" in case.source else 1e-9
    assert case.run(tmp_path) == pytest.approx(1, abs=exact)


@needs("constraints", "nonmatching", "stress")
def test_a_leaf_spring_has_the_force_of_calculix_for_small_displacements(tmp_path):
    """CalculiX 2.20 has 2.180454 N at 0.1 mm, with a penalty and a tension of 1e-5 across gaps."""
    assert deck_cases.leaf_spring_of_20_nodes(tmp_path, 0.1) == pytest.approx(2.180454, rel=1e-3)


def test_outcomes():
    entry = Entry("a", "", str, "", lambda answer: 0.0, 2.0)
    assert decks.judged(entry, 2.01, "") == "right"
    assert decks.judged(entry, 2.1, "") == "off by 5 %"
    assert decks.judged(entry, 2.1, "TODO a.inp:3 *TIE: by hand").startswith("by hand: TODO")
    assert decks.judged(entry, None, "FOREIGN Traceback").startswith("foreign")
    refused = Entry("a", "", str, "", lambda answer: 0.0, "DYNAMIC")
    assert decks.judged(refused, None, "TODO a.inp:3 *DYNAMIC: at rest").startswith("refused")
    assert decks.judged(refused, 1.0, "a.py is written").startswith("silent")
    assert decks.judged(refused, 1.0, "warning: no DYNAMIC").startswith("warned")
    assert decks.judged(refused, 1.0, "warning: no DYNAMIC\nerror: DYNAMIC").startswith(
        "refused: error"
    )
