"""Rules of what a report advises and shows, tested like numbers."""

import importlib
import math
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from needs import needs

from hhr_dolfinx.plugins.studies import advice, measure, page
from hhr_dolfinx.plugins.studies import report as figures


def exact_report(condensed, reduced):
    return {
        "times": {"condensed_full": {"median": condensed}, "online_full": {"median": reduced}},
        "work_precision": [{"method": "HHR"}],
        "errors": {"dual_full_floored": {"median": 1e-3, "p95": 2e-3, "max": 3e-3}},
    }


@pytest.mark.parametrize(
    ("times_slower", "method"), [(0.1, "condensed"), (2.9, "condensed"), (3.1, "hhr"), (300, "hhr")]
)
def test_exact_condensation_is_advised_unless_it_is_much_slower(times_slower, method):
    found = advice.advice(exact_report(times_slower * 1e-3, 1e-3))
    assert found.method == method
    opening = (
        "Use exact condensation while" if method == "condensed" else "Use the hyper-reduced model: "
    )
    assert found.text.startswith(opening)
    assert "0.1 % median, 0.2 % at 95 %, 0.3 % at most" in found.text


@pytest.mark.parametrize(
    ("seconds", "errors", "favoured"),
    [
        (
            {"a": 1e-3, "b": 2.9e-3},
            {"a": 1e-2, "b": 1e-5},
            "b",
        ),  # more exact, and within three times as long
        ({"a": 1e-3, "b": 3.1e-3}, {"a": 1e-2, "b": 1e-5}, "a"),  # too slow
        ({"a": 1e-3, "b": 2e-3}, {"a": 1e-4, "b": 1e-3}, "a"),
        (
            {"a": 2e-3, "b": 1e-3},
            {"a": 1e-13, "b": 1e-12},
            "b",
        ),  # both are round-off: the quicker one
        ({"a": 1e-3, "b": 1.0}, {"a": math.inf, "b": 1e-2}, "b"),  # an answer is missing
        ({"a": 1e-3, "b": 2e-3}, {"a": math.inf, "b": math.inf}, "a"),
    ],
)
def test_the_most_exact_of_the_quick_methods_is_advised(seconds, errors, favoured):
    rows = {name: {"dual_full_floored_max": error} for name, error in errors.items()}
    order = advice.by_favour(rows, seconds)
    assert order[0] == favoured and sorted(order) == ["a", "b"]


@pytest.mark.parametrize(
    ("reduced", "method", "opening"),
    [(1e-3, "hhr", "Use the hyper"), (3e-3, "fom_best", "Use the full order")],
)
def test_a_reduced_model_alone_is_advised_where_it_is_quicker(reduced, method, opening):
    times = {
        "condensed_full": None,
        "online_forces": {"median": reduced},
        "fom_best": {"median": 2e-3},
    }
    found = advice.advice(exact_report(1.0, 1.0) | {"times": times})
    assert found.method == method and found.text.startswith(opening)


def test_break_even_counts_what_an_answer_of_the_small_model_takes():
    """10 s of training against 5 ms of the full order: 2500 queries of 1 ms each, not 2000.

    Never if it is slower.
    """
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
    assert figures._read_from_files(training, {"median": 0.2}) == {
        figures.FROM_FILES: pytest.approx(3.0)
    }


HUNDRED = np.arange(1.0, 101.0) / 100
"""The next number above the middle is 0.51, that above 95 % of them 0.96."""


def test_a_row_of_a_report_names_its_figures_rightly():
    errors = measure.MeasuredErrors(
        {"primal_l2": HUNDRED, "dual_full_floored": 2 * HUNDRED}, np.ones(100, dtype=bool), {}
    )
    row = measure.Row("HHR", "this model", np.array([1.0, 2.0, 9.0]), errors).as_report()
    assert row["online_s"] == 2.0
    for name, factor in (("primal_l2", 1), ("dual_full_floored", 2)):
        found = [row[name], row[f"{name}_p95"], row[f"{name}_max"]]
        assert found == pytest.approx([0.51 * factor, 0.96 * factor, factor], rel=1e-12)


def cells_below(html, head):
    """Cells of the first table with a head, row by row, by the names of its columns."""
    table = next(part for part in html.split("<table>") if head in part)
    rows = [
        re.findall(r"<t[hd][^>]*>([^<]*)</t[hd]>", line)
        for line in table.split("</table>")[0].split("<tr>")[1:]
    ]
    return [dict(zip(rows[0], row, strict=True)) for row in rows[1:]]


def test_columns_of_the_page_hold_what_their_heads_say(tmp_path):
    errors = {"median": 0.01, "p95": 0.02, "max": 0.03}
    report = {
        "scene": "made up",
        "errors": {"dual_full_floored": errors},
        "outputs": {"peak": errors | {"largest": 7.0, "unit": "MPa"}},
        "times": {
            "online": {"median": 1e-3, "p95": 2e-3},
            "fom_best": {"median": 5e-3, "p95": 6e-3},
        },
        "work_precision": [
            {
                "method": "HHR",
                "setting": "this model",
                "online_s": 1e-3,
                "primal_l2": 0.04,
                "dual_full_floored": 0.05,
                "dual_full_floored_max": 0.06,
            }
        ],
    }
    html = page.page_of(report, tmp_path)
    own = {"median": "1.00 ms", "95 %": "2.00 ms", "times the reduced model": "1.0"}
    full = {"median": "5.00 ms", "95 %": "6.00 ms", "times the reduced model": "5.0"}
    for head, *rows in (
        (
            "worst seen",
            {"half of the answers below": "1 %", "95 % below": "2 %", "worst seen": "3 %"},
        ),
        (
            "median error",
            {
                "output": "peak [MPa]",
                "largest": "7",
                "median error": "1 %",
                "95 %": "2 %",
                "worst": "3 %",
            },
        ),
        ("way to answer", own, full),
        (
            "forces, worst",
            {
                "time": "1.00 ms",
                "displacement": "4 %",
                "forces, median": "5 %",
                "forces, worst": "6 %",
            },
        ),
    ):
        for found, known in zip(cells_below(html, head), rows, strict=True):
            assert found.items() >= known.items()


@needs("one_call")
def test_the_mutation_run_still_finds_these_rules(monkeypatch):
    """``make mutants`` changes lines of the code by their text: each is there once, and what comes
    out is Python.
    """
    monkeypatch.syspath_prepend(str(Path(__file__).parents[3] / "scripts"))
    mutants = importlib.import_module("mutants")
    made = list(mutants.decisions())
    assert len(made) == 13
    for mutant in made:
        compile(mutant.text, mutant.path, "exec")
        assert any(
            "test_decisions.py" in test or "test_advice.py" in test
            for test in mutants.tests_of(mutant.path)
        )
