"""What ends a search: budgets, Ctrl-C, and reasons that no refinement changes.

What it leaves then, and how it shows.

Seconds are those of a clock that the tests move themselves: nothing here depends on the machine.
"""

import itertools
import json
from types import SimpleNamespace
from unittest.mock import Mock

import contract
import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import pair_scene
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import (
    BoundError,
    NotSolvableError,
    ParameterError,
    StabilityWarning,
    StudyError,
)
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.plugins.moduli import bounding, condense
from hhr_dolfinx.plugins.moduli.components import ComponentSolver
from hhr_dolfinx.plugins.one_call import context, progress, search
from hhr_dolfinx.plugins.one_call.proposals import Proposal
from hhr_dolfinx.timing import ShareLines, unannounced

VARIES = contract.blocks((3.0, "nu"), box={"nu": (0.1, 0.4)})
"""Its compliance is interpolated along nu: the fewest solutions are three of the lower block, and
one of the upper.
"""


@pytest.fixture
def clocked(monkeypatch):
    """Makes a clock that full answers and compliances move, by the seconds that each takes."""

    def made(answer=1.0, compliance=1.0):
        clock = SimpleNamespace(
            now=0.0, answer=answer, compliance=compliance, answers=0, compliances=0
        )
        plain, solved = hhr.FullOrderModel.solve, ComponentSolver._solved

        def solve(*given, **how):
            clock.answers += 1
            clock.now += clock.answer
            return plain(*given, **how)

        def compliance_of(*given):
            clock.compliances += 1
            clock.now += clock.compliance
            return solved(*given)

        monkeypatch.setattr(hhr.FullOrderModel, "solve", solve)
        monkeypatch.setattr(ComponentSolver, "_solved", compliance_of)
        monkeypatch.setattr(
            progress.Stopwatch, "__init__", lambda self: setattr(self, "_start", clock.now)
        )
        monkeypatch.setattr(
            progress.Stopwatch, "seconds", property(lambda self: clock.now - self._start)
        )
        monkeypatch.setattr(ShareLines, "seconds", property(lambda self: clock.now))
        return clock

    return made


def kept(folder):
    return json.loads((folder / "reduction.json").read_text())


def reduced(scene=VARIES, error=0.01, of="forces", progress=unannounced, **how):
    return hhr.reduce(scene, error, of=of, progress=progress, **how)


def test_what_is_not_affordable_is_not_done(clocked, tmp_path):
    """Compliances of 10 s each in 30 s: the first one shows that four are too many.

    40 answers would be, too.
    """
    clock = clocked(answer=1.0, compliance=10.0)
    with pytest.raises(
        StudyError, match=r"there is no model: .*of the 30 s of the budget are left"
    ) as caught:
        reduced(budget=hhr.Budget(seconds=30), folder=tmp_path)
    assert (clock.answers, clock.compliances) == (1, 1) and clock.now == 11.0
    said = [item["outcome"] for item in kept(tmp_path)["tried"]]
    assert said[0].startswith("not affordable: stage 'compliances' would take about 30 s more")
    assert "a training of 40 would take about 40 s" in said[1]
    assert all(text.startswith("not affordable: ") for text in said)
    assert vars(caught.value)["reduction"].chosen is None


def test_a_budget_holds_the_model_and_its_check(clocked):
    clock, model = clocked(), reduced(budget=hhr.Budget(seconds=100))
    assert model.reduction.met and clock.now <= 100
    assert clock.answers == model.reduction.full_answers == context.BOUND_CHECKS


def test_a_check_that_the_budget_cuts_short_does_not_count_as_met(clocked, monkeypatch):
    """Without a bound forty answers are compared, and 20 s are enough for the first of them."""
    monkeypatch.setattr(search, "_said", lambda *_: {})
    clock = clocked(answer=1.0, compliance=0.1)
    with pytest.warns(StabilityWarning, match="is not met"):
        model = reduced(budget=hhr.Budget(seconds=20))
    row = model.reduction.tried[model.reduction.chosen]
    assert clock.now <= 20 and clock.answers >= 15
    assert row.errors["forces"] <= 0.01 and not row.met
    assert row.outcome.startswith(
        f"not checked enough: {clock.answers} of 40 fresh answers were affordable"
    )


def test_answers_of_a_training_are_not_begun_that_cannot_be_checked(monkeypatch):
    made = search.attempts
    monkeypatch.setattr(
        search,
        "attempts",
        lambda found: (item for item in made(found) if item.method != "condensed"),
    )
    with pytest.raises(
        StudyError, match=r"takes 40 full answers and its check 4 at least, and 35 of the 35"
    ):
        reduced(budget=hhr.Budget(full_answers=35))


@pytest.mark.parametrize("family", [None, "paths"])
def test_time_for_a_check_is_kept_back(clocked, family):
    clock, full = clocked(), hhr.FullOrderModel(VARIES, MPI.COMM_SELF)
    target, budget = search.Target(0.01, ("forces",)), hhr.Budget(seconds=100)
    made = context.SearchContext(
        full, SimpleNamespace(size=2), target, budget, family, 1, unannounced
    )
    assert made.deadline == 100  # nothing is known of answers yet
    made.batches += [2.0, 2.0, 30.0]  # the first one factors
    assert made.deadline == 100 - 2.0 * context.FRESH / 2
    made.batches += [30.0] * 3
    assert made.deadline == 50  # at most half of it
    made.checking = True
    assert made.deadline == 100
    clock.now = 100.0
    with pytest.raises(context.BudgetSpentError, match="the 100 s of the budget are over"):
        made.announce("any", 0.0)
    made.checking = False
    clock.now = 60.0
    with pytest.raises(
        context.BudgetSpentError, match=r"stage 'any' was stopped: 0 of the 100 s .* beside 50 s"
    ):
        made.announce("any", 0.0)


def test_an_interrupted_search_goes_on_where_it_was(clocked, monkeypatch, tmp_path):
    """Ctrl-C in the third compliance: the first two are not solved for again, and the table says
    what was going on.
    """
    clock = clocked()
    solved = ComponentSolver._solved

    def interrupted(*given):
        if clock.compliances == 2:
            raise KeyboardInterrupt
        return solved(*given)

    with monkeypatch.context() as patch:
        patch.setattr(ComponentSolver, "_solved", interrupted)
        with pytest.raises(KeyboardInterrupt):
            reduced(folder=tmp_path)
    table = kept(tmp_path)
    assert [row["outcome"] for row in table["tried"]] == ["interrupted"] and not table["met"]
    assert len(list((tmp_path / "compliances").glob("*.npz"))) == 2
    model = reduced(folder=tmp_path)
    whole, clock.compliances = clock.compliances, 0
    fresh = reduced()
    assert whole == clock.compliances > 2  # those of both runs together are those of one
    point = VARIES.parameters.middle
    np.testing.assert_array_equal(model.solve(point).forces(), fresh.solve(point).forces())
    clock.compliances = 0
    reduced(folder=tmp_path)
    assert clock.compliances == 0 and kept(tmp_path)["met"]


def test_compliances_of_another_stiffness_are_not_taken(clocked, tmp_path):
    reduced(folder=tmp_path)
    stiffer = contract.blocks((6.0, "nu"), box={"nu": (0.1, 0.4)})
    clock, model = clocked(), reduced(stiffer, folder=tmp_path)
    assert clock.compliances > 0
    full = hhr.FullOrderModel(stiffer, MPI.COMM_SELF)
    point = stiffer.parameters.upper
    np.testing.assert_allclose(model.solve(point).forces(), full.solve(point).forces(), rtol=1e-4)


@pytest.mark.parametrize(("of", "made"), [("forces", False), ("displacement", True)])
def test_fields_that_no_wish_reads_are_made_for_a_bound_only(of, made, monkeypatch):
    """Without a bound they serve displacements alone, and take longer than all else of a model in
    space.
    """
    refused = Mock(side_effect=BoundError("S is not resolved"))
    monkeypatch.setattr(condense, "between", refused)
    monkeypatch.setattr(condense, "varying_bound", refused)
    model = reduced(error=0.05, of=of)
    assert model.reduction.met and (model.fields.basis.shape[1] > 0) == made
    assert model.reduction.tried[0].known.startswith("40 fresh answers")


def test_a_bound_that_is_not_affordable_is_left_out(clocked):
    """Time for compliances and for a check of forty answers, and none for what a bound interpolates
    more finely.
    """
    clock = clocked(answer=0.1, compliance=1.0)
    before = []
    reduced(progress=lambda stage, share: before.append(clock.now) if stage == "starts" else None)
    alone, clock.now = before[0], 0.0
    budget = hhr.Budget(seconds=alone + 0.1 * context.FRESH + 1.5)
    model = reduced(budget=budget)
    row = model.reduction.tried[model.reduction.chosen]
    assert model.reduction.met and row.method == "condensed" and clock.now <= budget.seconds
    assert model.fields.bound is None and row.known.startswith("40 fresh answers")


def test_why_there_is_no_bound_is_found_once(monkeypatch):
    """The reason belongs to the full model: the next model of it does not solve for it again."""
    full = hhr.FullOrderModel(VARIES, MPI.COMM_SELF)
    refused = Mock(side_effect=BoundError("S is not resolved"))
    monkeypatch.setattr(bounding, "_between", refused)
    for _ in range(2):
        with pytest.raises(BoundError, match="S is not resolved"):
            bounding.between(full)
    assert refused.call_count == 1


# ---------------------------------------------------------------- reasons


def failing(*reasons):
    """Ways that are refused one after another, each method with its reasons."""

    def made(_):
        for method, given in reasons:
            for number, reason in enumerate(given):
                yield Proposal(method, str(number), Mock(side_effect=reason))

    return made


def test_a_search_without_a_model_leaves_its_table_and_each_reason_once(monkeypatch, tmp_path):
    reasons = (
        "no eigenvalue of B B^T was found",
        "the tangent is indefinite for 64 modes",
        "contact alone holds bodies",
    )
    same, other, alone = (
        NotSolvableError(f"{text}, and so there is no model of this kind") for text in reasons
    )
    monkeypatch.setattr(
        search, "attempts", failing(("condensed", [alone]), ("hhr", [other, same, same, same]))
    )
    with pytest.raises(StudyError) as caught:
        reduced(folder=tmp_path)
    for reason in (same, other, alone):
        assert str(caught.value).count(str(reason)) == 1
    found = vars(caught.value)["reduction"]
    # the fourth of its kind would end like the second and the third
    assert [(item.method, item.setting) for item in found.tried] == [
        ("condensed", "0"), ("hhr", "0"), ("hhr", "1"), ("hhr", "2"),
    ]  # fmt: skip
    assert str(found).count("no eigenvalue") == 1 and "refused (3)" in found.table
    table = kept(tmp_path)
    assert len(table["tried"]) == 4 and table["chosen"] is None and not table["met"]


def test_the_command_leaves_the_table_too(monkeypatch, tmp_path):
    reason = "contact alone holds a body, and nothing else does"
    monkeypatch.setattr(search, "attempts", failing(("hhr", [NotSolvableError(reason)] * 5)))
    source = tmp_path / "blocks.py"
    source.write_text("import contract\n\nscene = contract.blocks()\n")
    code, said = invoke("reduce", source, "--out", tmp_path / "out")
    assert (
        code == 3 and said.count(reason) == 1 and "refused (1)" in said and "reduction.json" in said
    )
    assert len(kept(tmp_path / "out")["tried"]) == 2


@needs("nonmatching", "shapes")
def test_what_geometry_forbids_is_tried_once():
    """A block that a parameter moves along the other one, until some of its nodes have nothing
    below them.
    """
    side = two_blocks.side
    first, second = ((0.0, 0.0), (2.0, 1.0), (4, 2)), ((0.5, 1.0), (1.5, 2.0), (3, 2))
    scene = pair_scene(
        "moved_away",
        {"push": (0.01, 0.05), "away": (0.0, 0.9)},
        first,
        second,
        ((3.0, 0.3), (5.0, 0.3)),
        contacts=(hhr.NodeToSurface(side(2, 1, False), side(1, 1, True), normal=(0.0, -1.0)),),
        displacements=(
            *hhr.Displacement.clamp(side(1, 1, False), 2),
            hhr.Displacement(side(2, 1, True), 0),
            hhr.Displacement(side(2, 1, True), 1, "-push"),
        ),
        shapes=(hhr.Shape(2, ("x + away", "y")),),
    )
    with pytest.raises(
        StudyError, match="other nodes are in contact than in the middle of the box"
    ) as caught:
        reduced(scene)
    found = vars(caught.value)["reduction"]
    assert len(found.tried) == 1 and found.full_answers == 0


@pytest.mark.parametrize("error", [1e-20, 9e-13])
def test_an_error_below_round_off_is_refused(error):
    with pytest.raises(
        ParameterError, match=r"below 1e-12, to which answers of the full model are known"
    ):
        reduced(error=error)
    assert (
        search.Target.checked(1e-12, "forces", hhr.FullOrderModel(VARIES, MPI.COMM_SELF)).error
        == 1e-12
    )


# ---------------------------------------------------------------- progress


def test_stages_are_announced_with_the_share_that_is_done():
    heard = []
    reduced(progress=lambda *stage_and_share: heard.append(stage_and_share))
    begun = [stage for stage, share in heard if share == 0]
    for stage in ("compliances", "starts", "fields", "bound", "4 fresh answers"):
        assert stage in begun
    for stage in ("compliances", "bound", "starts", "fields", "fresh answers"):
        shares = [share for name, share in heard if name == stage and share]
        assert shares == sorted(shares) and 0 < shares[0] <= shares[-1] <= 1
    assert max(share for stage, share in heard if stage == "fresh answers") == 1


def test_long_runs_show_progress_without_being_asked(clocked, capfd):
    """Also from Python, with a share of the answers of a check.

    Runs of less than two seconds are silent.
    """
    clocked(answer=0.01, compliance=0.01)
    hhr.reduce(VARIES, 0.01, of="forces")
    assert capfd.readouterr() == ("", "")
    clocked(answer=3.0, compliance=3.0)
    hhr.reduce(VARIES, 0.01, of="forces")
    out, told = capfd.readouterr()
    assert not out
    assert "s: compliances, " in told and "s: fresh answers, 75% done" in told
    assert "4 fresh answers" in told


def test_lines_of_progress_are_few(monkeypatch):
    lines = []
    times = itertools.chain([0.0], itertools.count(0.0, 0.5))  # the first one is the start
    monkeypatch.setattr("hhr_dolfinx.timing.now", lambda: next(times))
    shown = ShareLines(lines.append, quiet=2.0, every=5.0)
    shown("compliances", 0.0)  # after 0 s: still quiet
    for number in range(1, 30):
        shown("compliances", number / 30)
    assert lines == [
        "2 s: compliances, 13% done",
        "7 s: compliances, 47% done",
        "12 s: compliances, 80% done",
    ]
    shown("starts", 0.0)
    assert lines[-1] == "15 s: starts"
