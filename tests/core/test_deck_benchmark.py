"""Decks of the benchmark: outcomes are those that its report gives, and wrong numbers are not called right."""

import deck_cases
import decks
import pytest
from deck_entries import ENTRIES, Entry
from needs import needs

NAMED = {entry.source: entry for entry in ENTRIES}


@needs("decks", "checks", "mortar")
@pytest.mark.parametrize("name", ["testmortar", "contact13"])
def test_a_deck_is_right_or_refused(name, tmp_path):
    found = decks.run(NAMED[name], tmp_path, False)
    assert found["outcome"] == "right" or found["outcome"].startswith("refused: TODO")
    assert (found["ours"] is None) == (name == "contact13")


@needs("nonmatching", "mortar", "friction")
@pytest.mark.parametrize("name", deck_cases.PAIRINGS)
def test_a_press_fit_is_pushed_off_by_mu_times_its_normal_force(name, tmp_path):
    """All contacts slip: round-off."""
    assert deck_cases.push_off(name, tmp_path) == pytest.approx(1, abs=1e-9)


@needs("constraints", "nonmatching")
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
