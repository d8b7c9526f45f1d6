"""Decisions of a search, of an advice and of a report, held on made-up models and made-up figures: no full order.

Each of these rules decides which model a user gets, or what he reads of it. Real scenes pass through few of their
branches, so that a wrong rule would pass tests that solve them.
"""

import importlib.util
import math
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.study import measure
from hhr_dolfinx.study.one_call import bench as benches
from hhr_dolfinx.study.one_call import search
from hhr_dolfinx.study.one_call.search import Tried
from hhr_dolfinx.study.one_call.wish import Budget, Wish
from hhr_dolfinx.study.report import advice, page
from hhr_dolfinx.study.report import report as figures
from hhr_dolfinx.timing import unannounced

ERROR = 0.01
BOX = hhr.ParameterSpace(("a", "b"), (0.0, 0.0), (1.0, 1.0))


class FakeBench:
    """Exact answers are points; the error of a model at one is what the model says."""

    def __init__(self, of=("forces",), family=None, before=()):
        self.wish = Wish(ERROR, of)
        self.full = SimpleNamespace(parameters=BOX)
        self.family, self.seed, self.checks = family, 3, 0
        self.held_out = list(before)
        self.asked = []

    def announce(self, stage, share):
        """Nothing is shown."""

    def fresh(self, count, suspects=None):
        self.checks += 1
        self.asked.append((count, suspects))
        points = BOX.random(count, 99)
        return list(points if suspects is None else np.concatenate([points, suspects]))

    def errors_of(self, model, exact):
        return np.array([np.broadcast_to(model.error(point), len(self.wish.of)) for point in exact], dtype=float)


def fake_model(error, said=None, exact=False):
    """A model with errors by points, and what it says of them itself, where it says anything."""
    fields = SimpleNamespace(exact=exact, bound=said, estimated="bound")
    return SimpleNamespace(error=error, said=said, fields=fields, offline=None)


@pytest.fixture(autouse=True)
def said_by_the_model(monkeypatch):
    monkeypatch.setattr(
        search, "_said", lambda model, points, wish: {} if model.said is None else {wish.of[0]: model.said(points)}
    )


def first(points):
    return np.atleast_2d(points)[:, 0]


@pytest.mark.parametrize("family", [None, "paths"])
@pytest.mark.parametrize(("seen", "met"), [(0.4, True), (0.6, False)])
def test_an_error_that_was_seen_counts_twice(seen, met, family):
    """Of 200 points the worst is worse than that of 40, of 6 histories all the more."""
    errors, *_ = search._judged(FakeBench(family=family), fake_model(lambda point: seen * ERROR))
    assert errors == pytest.approx([2 * seen * ERROR], rel=1e-14)
    assert (errors.max() <= ERROR) == met


def test_half_of_a_check_is_where_the_model_expects_its_worst():
    bench = FakeBench()
    # above the wish everywhere, so that the model does not vouch for itself, and largest at the right
    search._judged(bench, fake_model(lambda point: 0.0, said=lambda points: 2 * ERROR * np.exp(first(points))))
    ((count, suspects),) = bench.asked
    assert (count, len(suspects)) == (search.FRESH // 2, search.FRESH // 2)
    # the twenty largest of several hundred uniform numbers are above all but a few per cent
    assert first(suspects).min() > 0.9


def test_what_is_wrong_only_where_the_model_expects_it_is_found():
    def error(point):
        return 5 * ERROR if point[0] > 0.97 else 0.0

    model = fake_model(error, said=lambda points: 2 * ERROR * np.exp(first(points)))
    assert not (first(BOX.random(search.FRESH // 2, 99)) > 0.97).any()  # no random point of this check sees it
    errors, *_ = search._judged(FakeBench(), model)
    assert errors.max() == pytest.approx(10 * ERROR)


def test_earlier_checks_are_looked_at_again():
    """One of many attempts passes a check by luck; fields alone are made of earlier checks, which then say nothing."""
    earlier = np.array([2.0, 2.0])
    model = fake_model(lambda point: [5 * ERROR, 7 * ERROR] if point is earlier else [0.0, 0.0])
    bench = FakeBench(of=("forces", "displacement"), before=[earlier])
    errors, known, _ = search._judged(bench, model)
    assert errors == pytest.approx([5 * ERROR, 0.0])
    assert "1 of before" in known


def test_a_bound_is_looked_at_in_hundreds_of_points():
    """What it exceeds at a few of 500 is not vouched for, however good it is in the middle."""
    seen = []

    def said(points, top):
        seen.append(np.array(points))
        return np.where(first(points) > top, 5 * ERROR, 0.5 * ERROR)

    errors, known, _ = search._judged(FakeBench(), fake_model(lambda point: 0.1 * ERROR, said=lambda p: said(p, 2.0)))
    looked_at = np.concatenate(seen)
    assert len(np.unique(looked_at, axis=0)) == 500
    assert errors == pytest.approx([0.5 * ERROR]) and "500 points" in known
    top = np.sort(first(looked_at))[-3]  # two of 500 lie beyond it
    bench = FakeBench()
    _, known, _ = search._judged(bench, fake_model(lambda point: 0.1 * ERROR, said=lambda p: said(p, top)))
    assert bench.asked[0][0] == search.FRESH // 2 and "500 points" not in known


def test_a_bound_that_is_exceeded_by_what_was_seen_is_not_believed():
    model = fake_model(lambda point: 3 * ERROR, said=lambda points: np.full(len(points), 0.5 * ERROR))
    bench = FakeBench()
    errors, *_ = search._judged(bench, model)
    assert bench.asked == [(search.SURE, None)] and errors == pytest.approx([3 * ERROR])


def test_an_interpolation_that_has_not_settled_counts_as_far_off(monkeypatch):
    monkeypatch.setattr(search, "_unresolved", lambda model: 4 * ERROR)
    errors, known, _ = search._judged(FakeBench(), fake_model(lambda point: 0.0))
    assert errors == pytest.approx([4 * ERROR]) and "S is off" in known


def test_what_was_seen_of_an_exact_model_counts_for_outputs_too():
    """A body that contact leaves free to turn has several answers: an output that reads it may be off by anything."""
    model = fake_model(lambda point: [0.0, 6.2], exact=True)
    model.solve = lambda point, **how: SimpleNamespace(estimate=lambda: SimpleNamespace(outputs={"turns": 0.0}))
    bench = FakeBench(of=("forces", "turns"))
    errors, *_ = search._judged(bench, model)
    assert errors == pytest.approx([0.0, 6.2]) and bench.asked == [(search.SURE, None)]


def test_an_exact_model_is_checked_where_it_does_not_vouch_for_an_output():
    """At 4 % of the box nothing bounds the output: four random answers would meet it in one search of seven."""

    def solve(point, **how):
        known = {} if point[0] > 0.96 else {"turns": 0.0}
        return SimpleNamespace(estimate=lambda: SimpleNamespace(outputs=known))

    model = fake_model(lambda point: 6.2 if point[0] > 0.96 else 0.0, exact=True)
    model.solve = solve
    bench = FakeBench(of=("turns",))
    errors, *_ = search._judged(bench, model)
    assert errors == pytest.approx([6.2])
    ((count, suspects),) = bench.asked
    assert count == search.SURE and first(suspects).min() > 0.96 and 10 < len(suspects) <= search.FRESH // 2


def test_how_much_of_the_box_may_be_beyond_is_said_with_its_confidence():
    """None of n random points is beyond: with 90 % confidence at most p of the box is, (1 - p)^n = 0.1."""
    assert search.share_beyond(40) == pytest.approx(0.0559, abs=5e-5)
    for count in (6, 20, 40, 400):
        assert (1 - search.share_beyond(count)) ** count == pytest.approx(0.1, rel=1e-12)
    # suspected points are no random ones: half as many of a check that has some
    *_, beyond = search._judged(FakeBench(), fake_model(lambda point: 0.0))
    assert beyond == search.share_beyond(40)
    said = lambda points: 2 * ERROR * np.exp(first(points))  # noqa: E731
    *_, beyond = search._judged(FakeBench(), fake_model(lambda point: 0.0, said=said))
    assert beyond == search.share_beyond(20)
    *_, beyond = search._judged(FakeBench(family="paths"), fake_model(lambda point: 0.0))
    assert beyond == search.share_beyond(6)
    # a bound says more of each answer
    *_, beyond = search._judged(FakeBench(), fake_model(lambda point: 0.0, said=lambda points: 0 * first(points)))
    assert math.isnan(beyond)


def test_the_verdict_says_the_confidence():
    row = Tried("hhr", "", 72, 1.0, 1e-3, {"forces": 1e-3}, "40 fresh answers, times 2", 0, search.MET, 0.0559)
    found = search.Reduction("any", Wish(ERROR, ("forces",)), (row,), 0, 72, 2.0)
    assert (
        "is met, 40 fresh answers, times 2; at 90 % confidence at most 5.6 % of the box is beyond it" in found.verdict
    )
    bounded = search.Reduction("any", Wish(ERROR, ("forces",)), (tried(1e-3, 1e-3),), 0, 4, 2.0)
    assert bounded.met and "confidence" not in bounded.verdict


# ---------------------------------------------------------------- which of several models


def tried(query, worst, outcome=search.MET):
    return Tried("condensed", "", 4, 1.0, query, {"forces": worst}, "", 0, outcome)


@pytest.mark.parametrize(
    ("rows", "chosen"),
    [
        # the first that meets, the quickest, and one that is nearly as quick and far more exact: that one
        ([tried(3.5e-3, 1e-9), tried(1e-3, 9e-3), tried(2.9e-3, 1e-6)], 2),
        # more than three times as slow: not, however exact
        ([tried(3.1e-3, 1e-9), tried(1e-3, 9e-3)], 1),
        # what does not meet the wish is not taken, however quick
        ([tried(1e-6, 0.02, "not exact enough"), tried(1.0, 9e-3)], 1),
        # a quick one that does not meet it makes no other one slow
        ([tried(1e-6, 0.02, "not exact enough"), tried(1.0, 9e-3), tried(2.0, 1e-3)], 2),
        # nothing meets it: the most exact, whatever it takes
        ([tried(1e-6, 0.05, "not exact enough"), tried(1.0, 0.02, "not exact enough")], 1),
    ],
)
def test_the_most_exact_of_the_quick_models_is_handed_out(rows, chosen):
    assert search._chosen(rows, [object()] * len(rows), Wish(ERROR, ("forces",))) == chosen


def test_a_model_that_was_not_made_is_not_handed_out():
    rows = [tried(1e-3, 1e-9), tried(2e-3, 1e-3)]
    assert search._chosen(rows, [None, object()], Wish(ERROR, ("forces",))) == 1


# ---------------------------------------------------------------- what a check is made of


class Recorded:
    """Solves for nothing: what it was asked for is kept."""

    size = 1

    def __init__(self):
        self.questions = []

    def solved(self, questions):
        self.questions += questions
        return [SimpleNamespace(parameter=point, forces=lambda: np.ones(1)) for point in questions]


@pytest.fixture
def real_bench(monkeypatch):
    monkeypatch.setattr(benches, "Errors", lambda wish, full: SimpleNamespace(know=lambda found: None))
    full = SimpleNamespace(parameters=BOX)
    made = benches.Bench(full, Recorded(), Wish(ERROR, ("forces",)), Budget(), None, 3, unannounced)
    made.looked = True
    return made


def test_a_check_asks_for_what_no_model_was_made_from(real_bench):
    """Neither training points, nor those at which models are looked at or timed, nor those of another check.

    Answers of a check make the next model better: that one must not be looked at where it knows them.
    """
    asked = []
    looked_at = np.concatenate([BOX.random(search.LOOKED_AT, real_bench.seed + number) for number in range(4)])
    for _ in range(3):
        fresh = [item.full.parameter for item in real_bench.fresh(search.FRESH)]
        training = hhr.Sobol(512, real_bench.seed, corners=True).points(BOX)
        timed = BOX.random(search.TIMED, real_bench.seed)
        others = {tuple(point) for part in (looked_at, training, timed, asked) for point in part}
        assert len(fresh) == search.FRESH and not others & {tuple(point) for point in fresh}
        asked += fresh
    assert len({tuple(point) for point in asked}) == len(asked) == len(real_bench.crew.questions)


def test_paths_of_a_check_are_none_of_the_training(real_bench):
    seeds = []
    sampled = lambda sampling: seeds.append(sampling) or []  # noqa: E731
    real_bench.family = SimpleNamespace(paths=sampled)
    for _ in range(2):
        real_bench.fresh(6)
    points = [sampling.points(BOX) for sampling in (*seeds, hhr.Sobol(32, real_bench.seed))]
    found = [{tuple(point) for point in some} for some in points]
    assert not (found[0] & found[1] or found[0] & found[2] or found[1] & found[2])


# ---------------------------------------------------------------- what a report advises


def exact_report(condensed, reduced, error=1e-3):
    return {
        "times": {"condensed_full": {"median": condensed}, "online_full": {"median": reduced}},
        "errors": {"dual_full_floored": {"median": error, "p95": 2 * error, "max": 3 * error}},
    }


@pytest.mark.parametrize(
    ("times_slower", "method"), [(0.1, "condensed"), (2.9, "condensed"), (3.1, "hhr"), (300, "hhr")]
)
def test_exact_condensation_is_advised_unless_it_is_much_slower(times_slower, method):
    found = advice.advice(exact_report(times_slower * 1e-3, 1e-3))
    assert found.method == method
    opening = "Use exact condensation while" if method == "condensed" else "Use the hyper-reduced model: "
    assert found.text.startswith(opening)
    assert "0.1 % median, 0.2 % at 95 %, 0.3 % at most" in found.text


@pytest.mark.parametrize(
    ("seconds", "errors", "favoured"),
    [
        ({"a": 1e-3, "b": 2.9e-3}, {"a": 1e-2, "b": 1e-5}, "b"),  # more exact, and within three times as long
        ({"a": 1e-3, "b": 3.1e-3}, {"a": 1e-2, "b": 1e-5}, "a"),  # too slow
        ({"a": 1e-3, "b": 2e-3}, {"a": 1e-4, "b": 1e-3}, "a"),
        ({"a": 2e-3, "b": 1e-3}, {"a": 1e-13, "b": 1e-12}, "b"),  # both are round-off: the quicker one
        ({"a": 1e-3, "b": 1.0}, {"a": math.inf, "b": 1e-2}, "b"),  # an answer is missing
        ({"a": 1e-3, "b": 2e-3}, {"a": math.inf, "b": math.inf}, "a"),
    ],
)
def test_the_most_exact_of_the_quick_methods_is_advised(seconds, errors, favoured):
    rows = {name: {"dual_full_floored_max": error} for name, error in errors.items()}
    order = advice._by_favour(rows, seconds)
    assert order[0] == favoured and sorted(order) == ["a", "b"]


@pytest.mark.parametrize(("reduced", "method"), [(1e-3, "hhr"), (3e-3, "fom_best")])
def test_a_reduced_model_alone_is_advised_where_it_is_quicker(reduced, method):
    report = exact_report(1.0, 1.0)
    report["times"] = {"condensed_full": None, "online_forces": {"median": reduced}, "fom_best": {"median": 2e-3}}
    found = advice.advice(report)
    assert found.method == method
    assert found.text.startswith("Use the hyper" if method == "hhr" else "Use the full order")


def test_break_even_counts_what_an_answer_of_the_small_model_takes():
    """10 s of training against 5 ms of the full order: 2500 queries of 1 ms each, not 2000; never if it is slower."""
    times = {
        "offline": {"snapshots": 8.0, "basis": 2.0},
        "condensed_full": None,
        "fom_best": {"median": 5e-3},
        "online_forces": {"median": 1e-3},
        "online_full": {"median": 6e-3},
    }
    assert figures.break_even(times) == {"forces": pytest.approx(2500), "fields": None}


def test_answers_that_were_read_from_files_cost_what_they_would_cost_today():
    """Of 20 answers 15 were read: 15 times what the best full order takes."""
    training = SimpleNamespace(read=15, snapshots=SimpleNamespace(histories=[]))
    assert figures._read_from_files(training, {"median": 0.2}) == {figures.FROM_FILES: pytest.approx(3.0)}


# ---------------------------------------------------------------- what a report shows


HUNDRED = np.arange(1.0, 101.0) / 100
"""The next number above the middle is 0.51, that above 95 % of them 0.96."""


def test_a_row_of_a_report_names_its_figures_rightly():
    errors = measure.Errors({"primal_l2": HUNDRED, "dual_full_floored": 2 * HUNDRED}, np.ones(100, dtype=bool), {})
    row = measure.Row("HHR", "this model", np.array([1.0, 2.0, 9.0]), errors).as_report()
    assert row["online_s"] == 2.0
    for name, factor in (("primal_l2", 1), ("dual_full_floored", 2)):
        found = [row[name], row[f"{name}_p95"], row[f"{name}_max"]]
        assert found == pytest.approx([0.51 * factor, 0.96 * factor, factor], rel=1e-12)


def cells_below(html, head):
    """Cells of the first table with a head, row by row, by the names of its columns."""
    table = next(part for part in html.split("<table>") if head in part)
    rows = [re.findall(r"<t[hd][^>]*>([^<]*)</t[hd]>", line) for line in table.split("</table>")[0].split("<tr>")[1:]]
    return [dict(zip(rows[0], row, strict=True)) for row in rows[1:]]


def test_columns_of_the_page_hold_what_their_heads_say(tmp_path):
    errors = {"median": 0.01, "p95": 0.02, "max": 0.03}
    report = {
        "scene": "made up",
        "errors": {"dual_full_floored": errors},
        "outputs": {"peak": errors | {"largest": 7.0, "unit": "MPa"}},
        "times": {"online": {"median": 1e-3, "p95": 2e-3}, "fom_best": {"median": 5e-3, "p95": 6e-3}},
        "work_precision": [
            {"method": "HHR", "setting": "this model", "online_s": 1e-3,
             "primal_l2": 0.04, "dual_full_floored": 0.05, "dual_full_floored_max": 0.06}
        ],
    }  # fmt: skip
    html = page.page_of(report, tmp_path)
    (row,) = cells_below(html, "worst seen")
    assert [row[head] for head in ("half of the answers below", "95 % below", "worst seen")] == ["1 %", "2 %", "3 %"]
    (row,) = cells_below(html, "median error")
    assert [row[head] for head in ("output", "largest", "median error", "95 %", "worst")] == [
        "peak [MPa]", "7", "1 %", "2 %", "3 %",
    ]  # fmt: skip
    own, full = cells_below(html, "way to answer")
    assert [own[head] for head in ("median", "95 %", "times the reduced model")] == ["1.00 ms", "2.00 ms", "1.0"]
    assert [full[head] for head in ("median", "95 %", "times the reduced model")] == ["5.00 ms", "6.00 ms", "5.0"]
    (row,) = cells_below(html, "forces, worst")
    assert [row[head] for head in ("time", "displacement", "forces, median", "forces, worst")] == [
        "1.00 ms", "4 %", "5 %", "6 %",
    ]  # fmt: skip


def test_the_mutation_run_still_finds_these_rules():
    """``make mutants`` changes lines of the code by their text: each is there once, and what comes out is Python."""
    place = Path(__file__).parents[1] / "scripts" / "mutants.py"
    spec = importlib.util.spec_from_file_location("mutants", place)
    mutants = importlib.util.module_from_spec(spec)
    sys.modules["mutants"] = mutants  # dataclasses look their module up
    spec.loader.exec_module(mutants)
    made = list(mutants.decisions())
    assert len(made) == 13
    for mutant in made:
        compile(mutant.text, mutant.path, "exec")
        assert "tests/test_decisions.py" in mutants.tests_of(mutant.path)
