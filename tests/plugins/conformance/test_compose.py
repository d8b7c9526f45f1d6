"""Composition: capabilities of all plug-ins have switches, and answer alone and in pairs."""

import gc
import itertools
import random
import re
import sys
from dataclasses import replace
from pathlib import Path

import compose
import compose_exports
import compose_reasons
import compose_table
import compose_toys
import compose_verbs
import numpy as np
import pytest
from compose_verbs import Case, Row
from needs import OURS, needs, present

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.conformance.draft import (
    ChosenSwitch,
    Excluded,
    Kind,
    SceneDraft,
    composed,
    has_neutral,
    switches,
)

WITHOUT = {
    "decks": "its loads are those of the plug-in places, its meshes are those of files",
    "mfront": "its law is a library that MFront compiled",
}
"""Plug-ins that add parts of scenes and have no switch, and why."""
OF_SCENES = ("geometries", "laws", "loads", "outputs", "pairings")
"""Kinds of parts that change answers."""
PAIRS = 12
SEED = 1


@pytest.fixture(scope="module", autouse=True)
def toys():
    with compose_toys.registered():
        yield


OF_OTHERS = {
    "bolt_force": ("nodal_loads",),
    "own_system": ("systems",),
    "serendipity": ("second_order",),
}
"""Plug-ins that a capability needs besides that of its switch."""
NAMES = [name for name in compose.capabilities() if present(*OF_OTHERS.get(name, ()))]
ANY = [name for name in ("friction", "opening", "thermal", "young") if name in NAMES]


def test_every_plug_in_that_adds_parts_of_scenes_has_a_switch():
    for name, plugin in registry.installed().items():
        adds = plugin.parts.keys() & set(OF_SCENES) or plugin.pair_laws
        adds = adds or plugin.tools.keys() & {"kernel", "shapes", "second_order"}
        if adds and name not in {*WITHOUT, *("my_law", "my_contact_law")}:
            assert plugin.switches, f"{name} adds {adds}: name a switch of it in its manifest"
    assert not [name for name in WITHOUT if present(name) and registry.installed()[name].switches]


def test_a_switch_adds_a_capability_to_any_draft():
    """Whatever comes first: a cone makes the scene solid, which a traction before it must know."""
    known = {name: switch for name, switch in switches().items() if name in NAMES}
    three = [name for name in ("cone", "traction", "obstacle") if name in known]
    for pair in itertools.permutations(three):
        draft = composed(ChosenSwitch(name, known[name]) for name in pair)
        assert draft.dimension == (3 if "cone" in pair else 2)
        assert all(len(load.direction) == draft.dimension for load in draft.loads)
    for name, switch in known.items():
        assert isinstance(ChosenSwitch(name, switch, True).applied(SceneDraft()), SceneDraft), name


def test_contact_opens_and_closes_along_the_path():
    case = Case(())
    closed = [int((forces > 0).sum()) for forces in case.reference.forces]
    assert all(0 < count < case.reference.forces[0].size for count in closed)
    assert len(set(closed)) >= 3 and closed[-1] < max(closed)


@pytest.mark.parametrize("name", NAMES)
def test_each_capability_answers_and_its_neutral_value_changes_nothing(name):
    rows = {row.verb: row for row in compose_verbs.tried((name,), ("full", "neutral"))}
    assert rows["full"].outcome == "works", rows["full"]
    assert rows["neutral"].outcome == ("works" if has_neutral(switches()[name]) else "none"), rows


def pairs(count, seed):
    """Pairs of capabilities, chosen at random."""
    every = list(itertools.combinations(NAMES, 2))
    return random.Random(seed).sample(every, min(count, len(every)))


def check(names, verbs):
    """Each verb answers rightly or refuses in words."""
    rows = list(compose_verbs.tried(names, verbs))
    assert [row.verb for row in rows] == list(verbs)
    assert [row for row in rows if row.outcome in compose_table.FAULTS] == []
    assert all(row.reason and row.place for row in rows if row.outcome == "refused")


@pytest.mark.parametrize("names", pairs(PAIRS, SEED), ids="+".join)
def test_pairs_answer_or_refuse(names):
    check(names, ("full", "condense"))


def pairs_of(name):
    """About half of the pairs of a capability, as many for each one; together all pairs, each
    once.
    """
    count, place = len(NAMES), NAMES.index(name)
    ahead = [step for step in range(1, count // 2 + 1) if 2 * step < count or 2 * place < count]
    return [tuple(sorted((name, NAMES[(place + step) % count]))) for step in ahead]


ROOT = Path(__file__).parents[3]
ALL_HERE = needs(*OURS)  # pairs are those of all plug-ins


@pytest.fixture(scope="module")
def communicators():
    """Room for 1,600 full models in one process: MPI gives it 2,048 communicators, of which models
    that the caches of other files keep have some each.
    """
    folders = tuple(str(ROOT / name) for name in ("tests", "benchmarks", "demos"))
    for module in list(sys.modules.values()):
        if (getattr(module, "__file__", None) or "").startswith(folders):
            for value in list(vars(module).values()):
                if hasattr(value, "cache_clear"):
                    value.cache_clear()
    gc.collect()


@ALL_HERE
def test_few_pairs_are_refused():
    """At most 2 % of those that have a meaning.

    Each refusal has a place and a reason, and is a pair of the list.
    """
    every = [frozenset(pair) for name in NAMES for pair in pairs_of(name)]
    assert sorted(map(sorted, every)) == sorted(map(list, itertools.combinations(NAMES, 2)))
    refused = compose_reasons.refused_pairs()
    assert set(refused) <= set(every) and set(refused.values()) == set(
        compose_reasons.REASONS["full"]
    )
    known = switches()
    stated = {name: {*ChosenSwitch(name, known[name]).applied(SceneDraft()).law} for name in NAMES}
    excluded = set()
    for pair in every:
        try:
            composed(ChosenSwitch(name, known[name]) for name in pair)
        except Excluded:
            excluded.add(pair)
    of_laws = {
        frozenset((one, other))
        for one, other in itertools.combinations(NAMES, 2)
        if stated[one] & stated[other]
    }
    assert of_laws <= excluded  # a pair has one law of its pressures, and one of friction
    assert 20 <= len(excluded - of_laws) <= 24
    assert len(refused) <= 0.02 * (len(every) - len(excluded))


@ALL_HERE
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.usefixtures("communicators")
def test_all_pairs_have_a_full_model_or_are_refused_as_the_list_says(name):
    """Nothing else is refused, nothing crashes, and what has been mended is taken out of the
    list.
    """
    refused = compose_reasons.refused_pairs()
    for pair in pairs_of(name):
        row = compose_verbs.ended(pair, "full", lambda pair=pair: float(Case(pair).full.conditions))
        expected = refused.get(frozenset(pair), "")
        assert (row.outcome, row.place) == ("refused" if expected else row.outcome, expected), row
        assert row.outcome in ("works", "refused", "excluded"), row
    gc.collect()


def test_reasons_are_of_functions_that_are_there():
    """A sentence for each; one without a mathematical reason says so."""
    places = {
        place: why for verb in compose_reasons.REASONS.values() for place, why in verb.items()
    }
    for place, why in places.items():
        file, _, function = place.partition(":")
        source = Path(hhr.__file__).parent / file
        assert why.endswith(".") and len(why) > 60
        if place != "benchmarks" and source.exists():  # or its plug-in was deleted
            assert f"def {function}(" in source.read_text(encoding="utf-8"), place
    assert set(compose_reasons.REASONS) <= set(compose_verbs.VERBS)
    assert (
        compose_reasons.reason("page", "scene.py:_check_system") == places["scene.py:_check_system"]
    )
    assert compose_reasons.reason("page", "scene.py:elsewhere") == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["", *NAMES])
def test_each_capability_in_all_verbs(name):
    check((name,) if name else (), tuple(compose_verbs.VERBS))


@pytest.mark.slow
@pytest.mark.parametrize("names", pairs(PAIRS, SEED + 1), ids="+".join)
def test_pairs_in_all_verbs(names):
    check(names, tuple(compose_verbs.VERBS))


def lying(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A neutral value that changes the answer."""
    return draft.with_body(1, lambda body: replace(body, young=3.0 * (1.0 + 1e-4 * neutral)))


def test_a_neutral_value_that_changes_answers_is_found(monkeypatch):
    known = {**switches(), "lying": lying}
    monkeypatch.setattr(compose_verbs, "switches", lambda: known)
    (row,) = compose_verbs.tried(("lying",), ("neutral",))
    assert row.outcome == "wrong" and "neutral lying changes the answer by" in row.reason


@pytest.mark.parametrize(
    "names",
    [
        ("norton", "own_body_law"),
        ("external_law", "own_body_law"),
        ("circle", "shape"),
        ("graded", "shape"),
        ("own_system", "poisson"),
        ("own_system", "young"),
        ("axisymmetric", "own_body_law"),
    ],
    ids="+".join,
)
@pytest.mark.slow
def test_what_pairs_found(names):
    """A law at another body, other rules on distorted cells, and a system that left out moduli: .6,
    2e-6 and .16.
    """
    if set(names) <= set(NAMES):
        check(names, ("neutral", "gradient"))


@pytest.mark.parametrize(
    "names", [("friction", "serendipity"), ("poisson", "second_order")], ids="+".join
)
@pytest.mark.slow
def test_small_models_of_pairs_are_as_exact_as_others(names):
    """Three paths were too few for friction.

    And an output that nearly vanished had errors of its own size.
    """
    if set(names) <= set(NAMES):
        check(names, ("condense", "HHR"))


@needs("elasticity", "inelastic")
@pytest.mark.filterwarnings("ignore::hhr_dolfinx.errors.LockingWarning")
def test_a_law_in_axisymmetry_differs_by_its_rule_alone(monkeypatch):
    """By 3 points on a triangle, for a weight 1/r; with the 6 points of the elastic body by
    1e-9.
    """
    from hhr_dolfinx.plugins.elasticity import gauss_points

    case = Case(("axisymmetric", "norton"))
    error, _ = compose_verbs._changed(case, "norton")
    assert 1e-8 < error <= compose_verbs.NEUTRAL
    monkeypatch.setattr(gauss_points, "gauss_degree", lambda cell, order: 4)
    assert compose_verbs._changed(case, "norton")[0] <= 1e-9


class Softer(Case):
    """A case whose small models are those of another scene."""

    @property
    def condensed(self):
        lower, upper = self.scene.bodies
        softer = replace(self.scene, bodies=(replace(lower, young=2.9), upper))
        return hhr.condense(softer, fields=True)

    reduced = condensed


@pytest.mark.parametrize("verb", ["condense", "HHR", "estimate"])
def test_a_model_that_answers_wrongly_is_found(verb, monkeypatch):
    """As is an error that its estimate denies; the models differ by a modulus of 3 %."""
    monkeypatch.setattr(compose_verbs, "Case", Softer)
    monkeypatch.setattr(compose_verbs, "REDUCED", 1e-3)
    (row,) = compose_verbs.tried((), (verb,))
    assert row.outcome == "wrong" and "off by" in row.reason


@pytest.mark.parametrize(("verb", "name"), [("page", "page"), ("C", "header")])
def test_an_export_that_answers_wrongly_is_found(verb, name, monkeypatch):
    forces = [np.ones(3), np.zeros(3)]
    off = [1.0001 * one for one in forces]
    monkeypatch.setattr(compose_exports, name, lambda *_: (off, forces))
    (row,) = compose_verbs.tried((), (verb,))
    assert row.outcome == "wrong"


def raising(error):
    def full(case):
        raise error

    return full


@pytest.mark.parametrize(
    ("error", "outcome"),
    [(SceneError("no"), "refused"), (Excluded("both"), "excluded"), (KeyError("k"), "crash")],
)
def test_what_a_verb_raises_is_its_outcome(error, outcome, monkeypatch):
    monkeypatch.setitem(compose_verbs.VERBS, "full", raising(error))
    (row,) = compose_verbs.tried((), ("full",))
    assert row.outcome == outcome and str(error) in row.reason


def test_capabilities_that_exclude_each_other_are_no_refusal():
    rows = list(compose_verbs.tried(("axisymmetric", "solid"), ("full", "condense")))
    assert {row.outcome for row in rows} == {"excluded"}
    assert composed([], SceneDraft(kind=Kind("solid"))).dimension == 3


def row(names, verb, outcome, reason="", place="", **measured):
    return compose.as_dict(Row(tuple(names), verb, outcome, reason, place, **measured))


def test_the_page_counts_what_the_report_has():
    """Sentences that differ by names and numbers are one; the full model's are counted once."""
    rows = [
        row("a", "full", "works"),
        row("a", "neutral", "works", neutral=3e-9),
        row("ab", "full", "refused", "scene 'x' has 3 laws", "m.py:f"),
        row("ab", "condense", "refused", "scene 'x' has 3 laws", "m.py:f"),
        row("ac", "full", "refused", "scene 'y' has 4.5 laws", "m.py:f"),
        row("bc", "full", "works"),
        row("bc", "condense", "refused", "not so", "m.py:g"),
        row("bc", "page", "wrong", "off | by 1"),
        row("bd", "full", "excluded", "both"),
    ]
    found = compose_table.refusals(rows)
    assert [(item["pairs"], item["verb"]) for item in found] == [(2, "full"), (1, "condense")]
    assert compose_table.shares(rows)["full"]["pairs"] == {"excluded": 1, "refused": 2, "works": 1}
    lines = compose_table.matrix(rows, list("abcd"))
    cells = [line.split()[2:] for line in lines[2:]]
    assert cells == [["+", "F", "F"], ["F", "!", "x"], ["F", "!"], ["x"]]
    text = compose_table.page(rows, list("abcd"))
    assert "| full | 1 of 1 (100.0 %) | 1 of 3 (33.3 %) |" in text and "by 3e-09 at most" in text
    assert r"off \| by 1" in text


def test_the_page_of_the_docs_names_capabilities_that_are_there():
    text = compose_table.PAGE.read_text(encoding="utf-8")
    block = text.partition("```text\n")[2].partition("```")[0]
    words = [line.split() for line in block.splitlines()]
    named = {row[1] for row in words if len(row) > 1 and row[1].isidentifier()}
    assert len(named) > 40 and (named <= set(NAMES) or not present(*OURS))
    rows = [
        line.split(" | ")
        for line in text.splitlines()
        if re.match(r"\| \d+ \| [A-Za-z]+ \| `", line)
    ]
    assert len(rows) > 10
    for _, verb, place, why, _ in rows:
        assert why == compose_table.in_a_cell(compose_reasons.reason(verb, place.strip("`"))), place


@pytest.mark.slow
@needs("friction", "volume_loads")
def test_compositions_run_in_processes_and_are_not_run_again(tmp_path):
    """One that takes too long is ended; what the report has stays."""
    rows = compose.run(("opening",), ("full", "condense"), 100.0)
    assert [one.outcome for one in rows] == ["works", "works"]
    ended = compose.run(("opening",), ("full", "condense"), 1e-3)
    assert {one.outcome for one in ended} == {"time out"}
    options = compose.cli.argparse.Namespace(out=tmp_path, seed=1)
    compose.write(map(compose.as_dict, rows), NAMES, options)
    known = compose.known_rows(tmp_path / "report.json")
    assert set(known) == {(("opening",), "full"), (("opening",), "condense")}
