"""``report.html``: one file that holds all of a report, whatever the report has not."""

import base64
import copy
import json
import math
import re
from functools import reduce
from html.parser import HTMLParser
from operator import getitem
from pathlib import Path

import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.plugins.studies.page import page_of, write_page

PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGA"
    "WjR9awAAAABJRU5ErkJggg=="
)
SUMMARY = {"median": 1e-3, "p95": 2e-3, "max": 0.5, "n": 20}
ELASTIC = {
    "scene": "two blocks",
    "seed": 3,
    "versions": {"numpy": "2.0"},
    "machine": {"cpu": "some", "threads": 1},
    "sizes": {
        "N": 2026,
        "N_lambda": 66,
        "ell_bar": 20,
        "N_lambda_C": 16,
        "rid_cells": 273,
        "snapshots": 64,
    },
    "stability": {"kappa_B": 2.19, "enrichment": [{"added": 3, "kappa": 1.5}]},
    "errors": {"primal_l2": SUMMARY, "dual_full_floored": SUMMARY, "unconverged": 0},
    "kkt": {"equilibrium": 1e-12, "penetration": 1e-15, "sign": 0.0},
    "times": {
        "offline": {"full_order": 0.2, "snapshots": 0.15},
        "fom_best": {"median": 5e-4, "p95": 7e-4, "n": 200},
        "condensed": {"median": 2e-5, "p95": 3e-5, "n": 200},
        "online": {"median": 2e-5, "p95": 3e-5, "n": 200},
    },
    "break_even": {"forces": 1585.0, "fields": None},
    "outputs": {"force on the roller": {"unit": "N", "largest": 129.0, **SUMMARY}},
    "work_precision": [
        {
            "method": "HHR",
            "setting": "8",
            "online_s": 2e-5,
            "dual_full_floored": 0.1,
            "dual_full_floored_max": 0.2,
        },
        {"method": "NNMF", "setting": "40", "refused": "no cone of it"},
    ],
    "skipped": [{"stage": "tangents", "why": "nothing flows"}],
    "advice": "Use exact condensation.",
}
HISTORIES = {
    "scene": "pellet",
    "sizes": {"N": 674},
    "errors": {"stress_rr": SUMMARY, "plastic_strain": SUMMARY},
    "histories": [
        {"path": "10 um", "steps": 40, "worst": 0.03},
        {"path": "20 um", "steps": 41, "refused": "no step"},
    ],
    "times": {
        "offline": {"snapshots": 12.0, "condensed": {"basis": 1.5}},
        "fom_best": {"median": 2.0, "p95": 3.0},
        "condensed": None,
        "online": None,
        "parts": {"laws": 0.4},
    },
    "paths": {"inside": {"forces": SUMMARY}, "outside": {"n": 4, "warned": 4, "silent_worst": {}}},
    "models": {
        "condensed": {
            "sizes": {"modes": 12},
            "refused_before": [{"attempt": 1, "why": "too few modes"}],
        }
    },
}


class Seen(HTMLParser):
    """What a browser would make of a page: texts, tags, addresses.

    And whether tags are closed in their order.
    """

    OPEN = frozenset({"meta", "img"})

    def __init__(self, page):
        super().__init__()
        self.tags, self.addresses, self.texts, self.stack = [], [], [], []
        self.feed(page)
        self.close()
        assert self.stack == []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.addresses += [
            value for name, value in attributes if name in ("src", "href", "action", "data")
        ]
        if tag not in self.OPEN:
            self.stack.append(tag)

    def handle_endtag(self, tag):
        assert self.stack.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


def leaves(value, path=()):
    """Places of all values within a report, inner and outer."""
    items = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for key, item in items:
        yield (*path, key)
        yield from leaves(item, (*path, key))


@pytest.mark.parametrize(
    ("report", "shown"),
    [
        (
            ELASTIC,
            "two blocks; 2026 unknowns; 0.1 %; 50 %; 20.00 us; 25.0; 1585 queries; 129; 2.19",
        ),
        (HISTORIES, "stress rr; 2.00 s; 40; laws; 0.4; modes; 12; 12.00 s"),
    ],
    ids=["elastic", "histories"],
)
def test_every_value_of_a_report_is_on_its_page(report, shown, tmp_path):
    text = " ".join(Seen(page_of(report, tmp_path)).texts)
    for path in leaves(report):
        value = reduce(getitem, path, report)
        if isinstance(value, str):
            assert value in text, path
    for item in shown.split("; "):
        assert item in text, item


def test_pictures_are_inside_and_nothing_is_asked_of_a_network(tmp_path):
    (tmp_path / "report.json").write_text(json.dumps(ELASTIC))
    for name in ("fields.png", "pressures.png", "my own <b>.png"):
        (tmp_path / name).write_bytes(PNG)
    (tmp_path / "a folder.png").mkdir()
    path = write_page(tmp_path)
    page = path.read_text(encoding="utf-8")
    found = Seen(page)
    assert path == tmp_path / "report.html" and found.tags.count("img") == 3
    assert {base64.b64decode(address.partition(",")[2]) for address in found.addresses} == {PNG}
    assert not re.search(
        r"http(?!-equiv)|<script|<link|@import|url\(|onload|onerror", page, re.IGNORECASE
    )
    assert not {"script", "link", "iframe", "a", "b"} & set(found.tags)
    # the first is the one that a reader looks for first
    assert (
        page.index("Contact pressures:")
        < page.index("The cells on which")
        < page.index("my own &lt;b&gt;")
    )
    assert write_page(tmp_path / "report.json") == path and path.read_text(encoding="utf-8") == page


@pytest.mark.parametrize("report", [ELASTIC, HISTORIES], ids=["elastic", "histories"])
@pytest.mark.parametrize(
    "value", [None, math.inf, -math.inf, math.nan, 0, -1, True, "<b>&\"'", [], {}, [None, 3], [{}]]
)
def test_whatever_stands_at_any_place_the_page_is_whole(report, value, tmp_path):
    for path in leaves(report):
        changed = copy.deepcopy(report)
        reduce(getitem, path[:-1], changed)[path[-1]] = value
        assert "b" not in Seen(page_of(changed, tmp_path)).tags, path


@pytest.mark.parametrize("report", [ELASTIC, HISTORIES], ids=["elastic", "histories"])
def test_whatever_is_missing_the_page_is_whole(report, tmp_path):
    for path in leaves(report):
        less = copy.deepcopy(report)
        del reduce(getitem, path[:-1], less)[path[-1]]
        Seen(page_of({"scene": "x", **less}, tmp_path))


def test_a_report_may_run_and_load_nothing():
    """By its policy, before anything of it is read: pictures inside and its style are all that it
    has.
    """
    page = page_of(ELASTIC, Path("nowhere"))
    head = page.partition("<title>")[0]
    (policy,) = re.findall(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)">', head)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules == {
        "default-src": "'none'",
        "img-src": "data:",
        "style-src": "'unsafe-inline'",
        "base-uri": "'none'",
        "form-action": "'none'",
    }


def test_keys_and_names_are_text_and_no_html(tmp_path):
    name = "<b onload='x'>&amp;"
    report = {
        "scene": name,
        name: {name: name, "deep": {name: [name]}},
        "outputs": {name: {"unit": name, "largest": 1.0}},
        "errors": {name: SUMMARY},
        "times": {name: SUMMARY, "offline": {name: 1.0}},
        "kkt": {name: 1.0},
        "break_even": {name: 3},
        "machine": {name: name},
        "work_precision": [{"method": name, "setting": name}],
    }
    found = Seen(page_of(report, tmp_path))
    assert "b" not in found.tags and " ".join(found.texts).count(name) >= 12


def test_reports_without_a_scene_have_the_name_of_their_folder(tmp_path):
    (tmp_path / "report.json").write_text('{"rows": [{"recipe": "\\ud800", "error": 1e400}]}')
    page = write_page(tmp_path).read_text(encoding="utf-8")
    assert f"<h1>{tmp_path.name}</h1>" in page and "<td>inf</td>" in page


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "there is no report"),
        ("{", "is no report"),
        ("[1]", "names no figures"),
        ("{}", "names no figures"),
        ("[" * 100000, "is no report"),
        ("\xff", "is no report"),
    ],
)
def test_what_is_no_report_is_refused(text, said, tmp_path):
    if text is not None:
        (tmp_path / "report.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(FileContentError, match=said):
        write_page(tmp_path)
    assert not (tmp_path / "report.html").exists()
    with pytest.raises(FileContentError, match="is no folder"):
        write_page(Path(__file__))


def test_a_study_writes_its_page(tmp_path):
    from scenes import pressed_block

    settings = hhr.StudySettings([8], tests=6, held_out=0, queries=6, naive=False)
    study = hhr.study_scene(pressed_block("plane_strain"), settings, tmp_path)
    study.write(tmp_path, view=hhr.View(points=(tuple(study.tests[0]),)))
    found = Seen((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert found.tags.count("img") == len(list(tmp_path.glob("*.png"))) >= 3
    assert 'name="viewport"' in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert {"push", "Parameters and materials", "Poisson's ratio"} <= set(found.texts)
    assert any("UTC" in text and f"hhr_dolfinx {hhr.__version__}" in text for text in found.texts)
    assert found.tags.count("div") == found.tags.count(
        "table"
    )  # a narrow screen scrolls tables, not the page
    assert "pressed_plane_strain" in found.texts and study.report["advice"] in found.texts
