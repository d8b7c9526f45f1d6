"""Pages of all kinds of models in Chromium, moved by their sliders: what they compute is what
Python answers, to 1e-12 of the largest value.

Kinds are the capabilities that plug-ins add to scenes, alone and where two change the kernel of a
page. Each is written as a page or refused in words.
"""

import compose
import compose_toys
import numpy as np
import pytest
from chromium import CHROMIUM, Browser
from compose_verbs import Case
from libraries import ZIG
from needs import needs, present

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError

pytestmark = pytest.mark.filterwarnings("ignore")  # of scenes that are small and coarse
EXACT = 1e-12
"""Largest error over the largest value of a quantity: 7e-13 seen, of a law of an orthotropic
body."""
OF_RESTING = 1e-10
"""The same of inelastic bodies that friction alone holds, 2e-11 seen: round-off of Python's systems
with motions as unknowns lets its steps end no nearer than at RESTS."""
RESTS = 1e-11
"""Residual of such a step, relative, that is asked for; a lower one is met on some processors, and
cuts steps on others."""
PROJECTED = 1e-14
"""Tolerance of increments with friction in Python, in this file: at its usual one, 1e-11, answers
in space are as far off."""
PAIRS = (
    "floating+own_contact_law floating+voce foreign+floating foreign+friction friction+floating "
    "friction+floating+voce friction+norton friction+own_contact_law friction+shape "
    "friction+solid friction+voce+solid friction+young friction_by_formula+voce graded+voce "
    "moving_circle+friction norton+thermal orthotropic+voce shape+young tresca+solid voce+young"
).split()
"""Capabilities whose kernels, or ways through them, differ from those of each alone."""
QUICK = ("blocks", "floating", "friction")
"""Cases that take about a second."""
REFUSED = {
    "external_law": "external is code outside of UFL, and files, pages, C and FMUs hold none",
    "floating+young": "a page solves for the motions of bodies that contact alone holds on one S",
    "own_contact_law+voce": (
        "a page solves inelastic bodies with one contact problem for each correction, by an active "
        "set or by friction, and not with wear"
    ),
    "sliding": "cannot write a page of a SlidingModel: only condensed models",
}
"""Kinds of which no page is written, and what says so."""
with compose_toys.registered():
    NAMES = ["blocks", *compose.capabilities()]


def marked(*kinds):
    """Cases whose capabilities are there; laws of users in C need a compiler."""
    compiled = pytest.mark.skipif(not ZIG, reason="ziglang is not there")
    cases = []
    for kind in kinds:
        parts = kind.split("+")
        if set(parts) <= set(NAMES):
            marks = [] if kind in QUICK else [pytest.mark.slow]
            marks += [compiled] if "own_contact_law" in parts else []
            cases.append(pytest.param(kind, marks=marks))
    return cases


@pytest.fixture(scope="module", autouse=True)
def toys():
    with compose_toys.registered():
        yield


@pytest.fixture(scope="module")
def browser():
    with Browser() as opened:
        yield opened


def case_of(kind):
    """A composition of capabilities."""
    return Case(name for name in kind.split("+") if name != "blocks")


def answers_of(model, runs, residual):
    """Answers of Python to all that a page was asked, beside those of the page."""
    pairs = []
    for found in runs:
        assert all(answer.get("converged", k == 0) for k, answer in enumerate(found))
        if "block" not in found[0]:
            pairs += [(one, model.solve(one["point"], outside="ignore")) for one in found]
            continue
        times = [one.get("time", float(k)) for k, one in enumerate(found)]
        path = [(time, np.array(one["point"])) for time, one in zip(times, found, strict=True)]
        near = {"relative_force": residual, "iterations": 200}
        near = near if model.equilibrium is not None else {}
        history = model.march(path, hhr.MarchSettings(outside="ignore", **near))
        assert history.cuts == 0
        pairs += zip(found[1:], history.answers, strict=True)
    return pairs


def values_of(pairs, names):
    """Each quantity of a page and of Python, (T, ...): forces, outputs, memory."""
    found, answers = zip(*pairs, strict=True)
    yield "forces", [one["forces"] for one in found], [one.multipliers for one in answers]
    for k, name in enumerate(names):
        known = [one.outputs()[name] for one in answers]
        yield name, [one["outputs"][k] for one in found], known
    if "position" in found[0]:
        for name in ("position", "path", "work", "wear"):
            known = [getattr(one.slip, name) for one in answers]
            yield name, [one[name] for one in found], known
    if "cumulated" in found[0]:
        known = [one.state().state.cumulated for one in answers]
        yield "cumulated", [one["cumulated"] for one in found], known


@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not there")
@pytest.mark.parametrize("kind", marked(*(one for one in NAMES if one not in REFUSED), *PAIRS))
def test_a_page_in_chromium_computes_what_python_does(kind, browser, tmp_path, monkeypatch):
    """Along a path, at the ends of all ranges, and back; the table shows six digits of it."""
    if present("friction"):
        from hhr_dolfinx.plugins.friction import sliding_set

        monkeypatch.setattr(sliding_set, "PROJECTION_TOLERANCE", PROJECTED)
    case = case_of(kind)
    model = case.condensed
    space = model.parameters
    target = hhr.write_model_page(tmp_path / "page.html", model, hhr.scenery_of(case.full))
    points = [*(point for _, point in case.path), space.upper, space.lower]
    told = browser.played(target, points)
    assert not told["wrong"]
    asked = np.array([one["point"] for found in told["runs"] for one in found])
    np.testing.assert_allclose(asked.min(axis=0), space.lower, atol=1e-14)
    np.testing.assert_allclose(asked.max(axis=0), space.upper, atol=1e-14)
    rests = kind == "friction+floating+voce"
    tolerance = OF_RESTING if rests else EXACT
    pairs = answers_of(model, told["runs"], RESTS if rests else EXACT / 100)
    assert any(np.any(answer.multipliers) for _, answer in pairs)
    for name, found, known in values_of(pairs, told["names"]):
        most = tolerance * (np.abs(known).max(initial=0.0) or 1.0)
        np.testing.assert_allclose(found, known, rtol=0, atol=most, err_msg=name)
    shown = {row[0]: row[1] for row in told["numbers"] if len(row) > 1}
    for name, value in zip(told["names"], pairs[-1][0]["outputs"], strict=True):
        assert float(shown[name]) == float(f"{value:.6g}")


@pytest.mark.parametrize("kind", marked(*REFUSED))
def test_kinds_without_a_page_are_refused_in_words(kind, tmp_path):
    with pytest.raises(NotOfferedError, match=REFUSED[kind]):
        hhr.write_model_page(tmp_path / "never.html", case_of(kind).condensed, None)
    assert not list(tmp_path.iterdir())


@needs("sliding")
def test_a_mesh_to_draw_is_that_of_a_full_model():
    """Of bodies that slide there is none: their pages are refused too."""
    with pytest.raises(NotOfferedError, match=r"is of a full model, .* a SlidingModel"):
        hhr.scenery_of(case_of("sliding").full)
