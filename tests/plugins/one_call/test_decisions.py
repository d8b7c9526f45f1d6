"""Decisions of a search, of an advice and of a report, held on made-up models and made-up figures:
no full order.

Each of these rules decides which model a user gets, or what he reads of it. Real scenes pass
through few of their branches, so that a wrong rule would pass tests that solve them.
"""

import math
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.one_call import context as contexts
from hhr_dolfinx.plugins.one_call import search
from hhr_dolfinx.plugins.one_call.search import Tried
from hhr_dolfinx.plugins.one_call.target import Budget, Target
from hhr_dolfinx.timing import unannounced

ERROR = 0.01
BOX = hhr.ParameterSpace(("a", "b"), (0.0, 0.0), (1.0, 1.0))


class FakeContext:
    """Exact answers are points; the error of a model at one is what the model says."""

    announce = check_claim = Mock()

    def __init__(self, of=("forces",), family=None, before=()):
        self.target = Target(ERROR, of)
        self.full = SimpleNamespace(parameters=BOX)
        self.family, self.seed, self.checks = family, 3, 0
        self.held_out = list(before)
        self.asked = []

    def fresh(self, count, suspects=None):
        self.checks += 1
        self.asked.append((count, suspects))
        points = BOX.random(count, 99)
        return list(points if suspects is None else np.concatenate([points, suspects]))

    def errors_of(self, model, exact):
        return np.array(
            [np.broadcast_to(model.error(point), len(self.target.of)) for point in exact],
            dtype=float,
        )


def judged(error=0.0, said=None, known=None, **context):
    """What is found of a model with errors by points, or one error, and the context in which it was
    looked for.

    Args:
        error: of an answer.
        said: what the model says of it, where it says anything.
        known: bounds of outputs at a point, of an exact model.
        context: see :class:`FakeContext`.
    """
    made = FakeContext(**context)
    model = SimpleNamespace(
        error=error if callable(error) else lambda point: error, said=said, offline=None
    )
    model.fields = SimpleNamespace(exact=known is not None, bound=said, estimated="bound")
    model.solve = lambda point, **how: SimpleNamespace(
        estimate=lambda: SimpleNamespace(outputs=known(point))
    )
    return search._judged(made, model), made


@pytest.fixture(autouse=True)
def said_by_the_model(monkeypatch):
    monkeypatch.setattr(
        search,
        "_said",
        lambda model, points, target: (
            {} if model.said is None else {target.of[0]: model.said(points)}
        ),
    )


def first(points):
    return np.atleast_2d(points)[:, 0]


def rising(points):
    """Above the target everywhere, so that the model does not vouch for itself, and largest at the
    right.
    """
    return 2 * ERROR * np.exp(first(points))


@pytest.mark.parametrize("family", [None, "paths"])
def test_an_error_that_was_seen_counts_twice(family):
    """Of 200 points the worst is worse than that of 40, of 6 histories all the more."""
    (errors, *_), _ = judged(0.6 * ERROR, family=family)
    assert errors == pytest.approx([1.2 * ERROR], rel=1e-14)


def test_half_of_a_check_is_where_the_model_expects_its_worst():
    """What is wrong there alone is found."""
    assert not (
        first(BOX.random(search.FRESH // 2, 99)) > 0.97
    ).any()  # no random point of this check sees it
    (errors, *_), context = judged(lambda point: 5 * ERROR if point[0] > 0.97 else 0.0, rising)
    ((count, suspects),) = context.asked
    assert (count, len(suspects)) == (search.FRESH // 2, search.FRESH // 2)
    # the twenty largest of several hundred uniform numbers are above all but a few per cent
    assert first(suspects).min() > 0.9
    assert errors.max() == pytest.approx(10 * ERROR)


def test_earlier_checks_are_looked_at_again():
    """One of many attempts passes a check by luck.

    Fields alone are made of earlier checks, which then say nothing.
    """
    earlier, of = np.array([2.0, 2.0]), ("forces", "displacement")
    error = lambda point: [5 * ERROR, 7 * ERROR] if point is earlier else [0.0, 0.0]  # noqa: E731
    (errors, known, _), _ = judged(error, of=of, before=[earlier])
    assert errors == pytest.approx([5 * ERROR, 0.0])
    assert "1 of before" in known


def test_a_bound_is_looked_at_in_hundreds_of_points():
    """What it exceeds at a few of 500 is not vouched for, however good it is in the middle."""
    seen = []

    def said(points, top):
        seen.append(np.array(points))
        return np.where(first(points) > top, 5 * ERROR, 0.5 * ERROR)

    (errors, known, _), _ = judged(0.1 * ERROR, lambda points: said(points, 2.0))
    looked_at = np.concatenate(seen)
    assert len(np.unique(looked_at, axis=0)) == 500
    assert errors == pytest.approx([0.5 * ERROR]) and "500 points" in known
    top = np.sort(first(looked_at))[-3]  # two of 500 lie beyond it
    (_, known, _), context = judged(0.1 * ERROR, lambda points: said(points, top))
    assert context.asked[0][0] == search.FRESH // 2 and "500 points" not in known


def test_a_bound_that_is_exceeded_by_what_was_seen_is_not_believed():
    (errors, *_), context = judged(3 * ERROR, lambda points: np.full(len(points), 0.5 * ERROR))
    assert context.asked == [(search.BOUND_CHECKS, None)] and errors == pytest.approx([3 * ERROR])


def test_an_interpolation_that_has_not_settled_counts_as_far_off(monkeypatch):
    monkeypatch.setattr(search, "_unresolved", lambda model: 4 * ERROR)
    (errors, known, _), _ = judged()
    assert errors == pytest.approx([4 * ERROR]) and "S is off" in known


def test_what_was_seen_of_an_exact_model_counts_for_outputs_too():
    """A body that contact leaves free to turn has several answers: an output that reads it may be
    off by anything.
    """
    (errors, *_), context = judged(
        [0.0, 6.2], known=lambda point: {"turns": 0.0}, of=("forces", "turns")
    )
    assert errors == pytest.approx([0.0, 6.2]) and context.asked == [(search.BOUND_CHECKS, None)]


def test_an_exact_model_is_checked_where_it_does_not_vouch_for_an_output():
    """At 4 % of the box nothing bounds the output: four random answers would meet it in one search
    of seven.
    """
    known = lambda point: {} if point[0] > 0.96 else {"turns": 0.0}  # noqa: E731
    (errors, *_), context = judged(
        lambda point: 6.2 if point[0] > 0.96 else 0.0, known=known, of=("turns",)
    )
    assert errors == pytest.approx([6.2])
    ((count, suspects),) = context.asked
    assert (
        count == search.BOUND_CHECKS
        and first(suspects).min() > 0.96
        and 10 < len(suspects) <= search.FRESH // 2
    )


def test_how_much_of_the_box_may_be_beyond_is_said_with_its_confidence():
    """None of n random points is beyond: with 90 % confidence at most p of the box is, (1 - p)^n =
    0.1.
    """
    assert search.share_beyond(40) == pytest.approx(0.0559, abs=5e-5)
    for count in (6, 20, 40, 400):
        assert (1 - search.share_beyond(count)) ** count == pytest.approx(0.1, rel=1e-12)
    # suspected points are no random ones: half as many of a check that has some
    for given, count in (({}, 40), ({"said": rising}, 20), ({"family": "paths"}, 6)):
        (*_, beyond), _ = judged(**given)
        assert beyond == search.share_beyond(count)
    # a bound says more of each answer
    (*_, beyond), _ = judged(said=lambda points: 0 * first(points))
    assert math.isnan(beyond)


def test_the_verdict_says_the_confidence():
    row = Tried(
        "hhr",
        "",
        72,
        1.0,
        1e-3,
        {"forces": 1e-3},
        "40 fresh answers, times 2",
        0,
        search.MET,
        0.0559,
    )
    found = search.Reduction("any", Target(ERROR, ("forces",)), (row,), 0, 72, 2.0)
    said = (
        "is met, 40 fresh answers, times 2; at 90 % confidence at most 5.6 % of the box exceeds it"
    )
    assert said in found.verdict
    bounded = search.Reduction("any", Target(ERROR, ("forces",)), (tried(1e-3, 1e-3),), 0, 4, 2.0)
    assert bounded.met and "confidence" not in bounded.verdict


# ---------------------------------------------------------------- which of several models


def tried(query, worst, outcome=search.MET):
    return Tried("condensed", "", 4, 1.0, query, {"forces": worst}, "", 0, outcome)


@pytest.mark.parametrize(
    ("rows", "chosen"),
    [
        # the first that meets, the quickest, and one that is nearly as quick and far more exact:
        # that one
        ([tried(3.5e-3, 1e-9), tried(1e-3, 9e-3), tried(2.9e-3, 1e-6)], 2),
        # more than three times as slow: not, however exact
        ([tried(3.1e-3, 1e-9), tried(1e-3, 9e-3)], 1),
        # what does not meet the target is not taken, and makes no other one slow, however quick
        ([tried(1e-6, 0.02, "not exact enough"), tried(1.0, 9e-3), tried(2.0, 1e-3)], 2),
        # nothing meets it: the most exact, whatever it takes
        ([tried(1e-6, 0.05, "not exact enough"), tried(1.0, 0.02, "not exact enough")], 1),
    ],
)
def test_the_most_exact_of_the_quick_models_is_handed_out(rows, chosen):
    """Another one, if it was not made."""
    made, target = [object()] * len(rows), Target(ERROR, ("forces",))
    assert search._chosen(rows, made, target) == chosen
    made[chosen] = None
    assert search._chosen(rows, made, target) != chosen


# ---------------------------------------------------------------- what a check is made of


@pytest.fixture
def real_context(monkeypatch):
    """Its workers solve for nothing."""
    monkeypatch.setattr(
        contexts, "TargetErrors", lambda target, full: SimpleNamespace(know=lambda found: None)
    )
    full, workers = SimpleNamespace(parameters=BOX), Mock(size=1)
    workers.solved = Mock(
        wraps=lambda some: [SimpleNamespace(parameter=at, forces=lambda: np.ones(1)) for at in some]
    )
    made = contexts.SearchContext(
        full, workers, Target(ERROR, ("forces",)), Budget(), None, 3, unannounced
    )
    made.looked = True
    return made


def test_a_check_asks_for_what_no_model_was_made_from(real_context):
    """Neither training points, nor those at which models are looked at or timed, nor those of
    another check.
    """
    seed = real_context.seed
    others = [BOX.random(search.ERROR_POINTS, seed + number) for number in range(4)]
    others += [
        hhr.Sobol(512, seed, corners=True).points(BOX),
        BOX.random(search.TIMED_QUERIES, seed),
    ]
    asked = [item.parameter for _ in range(3) for item in real_context.fresh(search.FRESH)]
    different = {tuple(point) for point in asked}
    assert not different & {tuple(point) for part in others for point in part}
    solved = sum(len(call.args[0]) for call in real_context.workers.solved.call_args_list)
    assert len(different) == len(asked) == 3 * search.FRESH == solved


def test_paths_of_a_check_are_none_of_the_training(real_context):
    seeds = []
    sampled = lambda sampling: seeds.append(sampling) or []  # noqa: E731
    real_context.family = SimpleNamespace(paths=sampled)
    for _ in range(2):
        real_context.fresh(6)
    samplings = *seeds, hhr.Sobol(32, real_context.seed)
    points = [tuple(point) for sampling in samplings for point in sampling.points(BOX)]
    assert len(set(points)) == len(points)
