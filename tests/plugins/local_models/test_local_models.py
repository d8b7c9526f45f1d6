"""Local models: the choice by cuts, a set that answers as the model of each part does, its tables,
a fall-back.
"""

import dataclasses
import timeit
import warnings
from unittest.mock import Mock

import numpy as np
import pellet_cladding as pellet
import pytest
from bare_problem import read_csv
from hypothesis import given, settings
from hypothesis import strategies as st
from local_models_by_hand import (
    AS_IT_IS,
    CUT,
    OUTPUTS,
    REACH,
    bits,
    choice,
    one_cut,
    parts_of,
    pellet_models,
    pellet_training,
    random_choice,
    three_models,
    varying_set,
)
from mpirun import launch
from needs import needs
from scenes import largest_difference, output_slopes, pressed_block, slope, slope_errors

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import (
    NotSolvableError,
    OutsideTrainingError,
    OutsideTrainingWarning,
    ParameterError,
    ReductionError,
    SingularError,
)
from hhr_dolfinx.plugins.local_models.models import LEAF

LOW, HIGH, BY_THE_BORDER = (110.0, 1.7), (150.0, 5.1), (90.0, 3.35)
WHOLE = choice([(-1, 0)], (0.0, 0.0))
"""One model for the whole box."""


@pytest.fixture(scope="module")
def training():
    return pellet_training()


@pytest.fixture(scope="module")
def models(training):
    return pellet_models(training)


@pytest.fixture(scope="module")
def local(models):
    return hhr.LocalModels(models, one_cut(1, CUT, REACH))


@pytest.fixture
def broken(models):
    """A set whose second model has no answer anywhere."""
    problem = dataclasses.replace(models[1].problem, gaps=np.nan * models[1].problem.gaps)
    return hhr.LocalModels([models[0], models[1].changed(problem=problem)], one_cut(1, CUT, REACH))


# ---------------------------------------------------------------- the choice


def walked(tree, point):
    """Cuts on the way of a point, (axis, cut) each, and the label at its end."""
    node, cuts = 0, []
    while tree.axis[node] != LEAF:
        axis = int(tree.axis[node])
        cuts.append((axis, float(tree.cut[node])))
        node = int(tree.low[node] if point[axis] <= tree.cut[node] else tree.high[node])
    return cuts, int(tree.label[node])


def by_brute_force(tree, point):
    """Label of a point and, of the nearest cuts of its way, the first other one just behind the
    cut.
    """
    cuts, label = walked(tree, point)
    near = [(abs(point[axis] - cut) / tree.reach[axis], axis, cut) for axis, cut in cuts]
    for off, axis, cut in sorted(near):
        behind = np.array(point)
        behind[axis] = np.nextafter(cut, 2.0) if point[axis] <= cut else cut
        if off <= 1 and (other := walked(tree, behind)[1]) != label:
            return label, other
    return label, LEAF


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), cuts=st.integers(0, 12), reach=st.floats(1e-3, 0.3))
def test_candidates_are_those_of_a_brute_force_walk(seed, cuts, reach):
    dice = np.random.default_rng(seed)
    tree = random_choice(dice, cuts=cuts, reach=reach)
    points = dice.random((20, 3))
    found = [tree.candidates(point.tolist()) for point in points]
    assert found == [by_brute_force(tree, point) for point in points]
    assert np.array_equal(np.array(found).T, tree.many(points))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), cuts=st.integers(1, 12), reach=st.floats(1e-3, 0.3))
def test_both_sides_of_a_border_have_the_same_candidates(seed, cuts, reach):
    """Else the answer would jump there, the stripe of figure 4.6."""
    dice = np.random.default_rng(seed)
    tree = random_choice(dice, cuts=cuts, reach=reach)
    for point in dice.random((20, 3)):
        for axis, cut in walked(tree, point)[0]:
            below, above = point.copy(), point.copy()
            below[axis], above[axis] = cut - 1e-12, cut + 1e-12
            one, two = (walked(tree, side)[1] for side in (below, above))
            # the walk of a point moved to a cut may no longer lead over it
            if one != two:
                assert tree.candidates(below.tolist()) == (one, two)
                assert tree.candidates(above.tolist()) == (two, one)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), cuts=st.integers(0, 12))
def test_boxes_tile_the_box_and_hold_their_points(seed, cuts):
    dice = np.random.default_rng(seed)
    tree = random_choice(dice, cuts=cuts)
    # a box that the cuts do not know: some lie outside of it
    for least, most in ((np.zeros(3), np.ones(3)), (np.full(3, 0.3), np.array([0.5, 0.9, 0.6]))):
        boxes = tree.boxes(least, most)
        assert all((low <= high).all() for _, low, high in boxes)
        volumes = [np.prod(high - low) for _, low, high in boxes]
        assert sum(volumes) == pytest.approx(np.prod(most - least), rel=1e-12)
        for point in dice.uniform(least, most, (20, 3)):
            labels = [
                label for label, low, high in boxes if (low < point).all() and (point <= high).all()
            ]
            assert labels == [tree.candidates(point.tolist())[0]]


def test_a_border_within_one_model_hides_no_other():
    """Cuts of a tree may divide what belongs to one model; the border behind them still counts."""
    tree = choice([(0, 0.5, 1, 2), (1, 0.5, 3, 4), (-1, 1), (-1, 0), (-1, 0)], (0.1, 0.1))
    assert tree.candidates([0.45, 0.49]) == (0, 1)
    assert tree.candidates([0.2, 0.49]) == (0, LEAF)
    assert dataclasses.replace(tree, reach=np.zeros(2)).candidates([0.45, 0.49]) == (0, LEAF)


def test_what_lies_on_a_cut_goes_low():
    tree = one_cut(0, 0.5, (0.0,))
    assert tree.candidates([0.5]) == (0, 1) and tree.candidates([0.5 + 1e-9]) == (1, LEAF)
    assert WHOLE.candidates([0.3, 9.0]) == (0, LEAF)


def test_a_choice_takes_microseconds():
    """Measured: 1.4 us, 2.1 us by a border."""
    tree = one_cut(1, 0.5, (0.0, 0.1))
    for point in ([0.5, 0.1], [0.5, 0.52]):
        assert (
            min(timeit.repeat(lambda: tree.candidates(point), number=2000, repeat=5)) / 2000 < 20e-6
        )


NO_TREES = {
    "as many finite cuts": {"cut": np.zeros(2)},
    "needs as many": {"cut": np.array([np.nan, 0.0, 0.0])},
    "at least one": dict.fromkeys(("axis", "low", "high", "label"), np.zeros(0, int))
    | {"cut": np.zeros(0)},
    "many finite": {"reach": np.array([0.0, np.inf])},
    r"axes \[-1  2\] of 2": {"axis": np.array([2, -1, -1])},
    r"axes \[-2 -1\] of 2": {"axis": np.array([-2, -1, -1])},
    "axes": {"reach": np.array([0.0, -1.0])},
    "no tree": {"high": np.array([1, 0, 0])},
    "are no tree": {"low": np.array([0, 0, 0])},
    "cuts .* are no tree": {"axis": np.array([0, 0, -1])},
    "has no model": {"label": np.array([0, -1, 1])},
}


@pytest.mark.parametrize("why", NO_TREES)
def test_what_is_no_tree_is_refused(why):
    with pytest.raises(ReductionError, match=why):
        dataclasses.replace(one_cut(0, 0.5, (0.1, 0.1)), **NO_TREES[why])


# ---------------------------------------------------------------- the set


def test_answers_are_those_of_the_model_of_the_part(local, models):
    for number, point in ((0, LOW), (1, HIGH)):
        answer = local.solve(point, gradient=True)
        assert local.model_of(answer) == number
        assert bits(answer) == bits(models[number].solve(point)) and answer.gradient is not None
        assert answer.estimate() == models[number].solve(point).estimate()
    assert len(local) == 2 and local.dimension == 2
    with pytest.raises(ReductionError, match="not of these local models"):
        local.model_of(hhr.LocalModels(models[:1], WHOLE).solve(LOW)._replace(fields=None))


def test_by_a_border_the_smaller_estimate_decides(local, models):
    won = []
    for height in np.linspace(CUT - 0.39, CUT + 0.39, 40):
        answer, own = local.solve((90.0, height)), int(height > CUT)
        said = [model.solve((90.0, height), outside="ignore").estimate() for model in models]
        *sizes, found = (
            max(each.primal_relative, each.dual_relative) for each in (*said, answer.estimate())
        )
        assert local.model_of(answer) == (1 - own if sizes[1 - own] < sizes[own] else own)
        assert found == min(sizes)
        won.append(local.model_of(answer) != own)
    assert any(won) and not all(won)


@needs("exact_errors")
def test_the_answer_does_not_jump_at_a_border(local):
    for load in (20.0, 90.0, 180.0):
        one, two = local.solve((load, CUT)), local.solve((load, CUT + 1e-9))
        assert local.model_of(one) == local.model_of(two)
        assert largest_difference(one.displacement(), two.displacement()) < 1e-7


def test_many_are_those_one_by_one(local):
    points = local.parameters.random(150, seed=5)
    many = local.solve_many(points)
    assert len(many) == len(points) and set(many.status) == {Status.CONVERGED}
    columns, estimates = many.outputs(), many.estimates()
    near = local.choice.many(points)[1] != LEAF
    assert near.any() and not near.all()
    for k, (point, answer) in enumerate(zip(points, many, strict=True)):
        alone = local.solve(point)
        assert local.model_of(answer) == local.model_of(alone) == many.model[k]
        assert np.array_equal(answer.parameter, point) and np.array_equal(many.points[k], point)
        assert largest_difference(answer.forces(), alone.forces()) < 1e-9
        assert largest_difference(answer.displacement(), alone.displacement()) < 1e-10
        assert columns["peak"][k] == pytest.approx(alone.outputs()["peak"], rel=1e-8)
        assert estimates[k][1:5] == pytest.approx(alone.estimate()[1:5], rel=1e-4, abs=1e-12)
    assert many[-1].parameter.tolist() == points[-1].tolist()
    with pytest.raises(IndexError):
        many[len(points)]


def test_models_that_nobody_asks(local):
    many = local.solve_many([LOW, (100.0, 1.0)])
    assert (
        many.model.tolist() == [0, 0] and len(many.parts) == 1 and len(many.outputs()["peak"]) == 2
    )
    alone = hhr.LocalModels(local.models[:1], WHOLE)
    assert bits(alone.solve(LOW)) == bits(local.solve(LOW))


def test_a_set_without_outputs_and_bounds(training):
    recipe = dataclasses.replace(AS_IT_IS, bound=False)
    bare = [
        hhr.build(hhr.FullOrderModel(pellet.scene(**pellet.QUICK_MESH)), training.snapshots, recipe)
    ] * 2
    local = hhr.LocalModels(bare, one_cut(1, CUT, REACH))
    many = local.solve_many([LOW, HIGH, BY_THE_BORDER])
    assert many.estimates() is None and many.model.tolist() == [0, 1, 1]
    with pytest.raises(hhr.errors.HHRError, match="has no outputs"):
        many.outputs()


def test_outputs_and_gradients(local):
    for point in (LOW, HIGH, BY_THE_BORDER):
        assert slope_errors(local, point).max() < 1e-5
        outputs = local.outputs(point, gradient=True)
        for name, slopes in output_slopes(local, point, "peak", "force").items():
            assert outputs.gradient[name] == pytest.approx(
                slopes, rel=1e-4, abs=1e-6 * abs(outputs[name])
            )


def test_a_path_over_the_border(local):
    path = [(float(k), (120.0, height)) for k, height in enumerate(np.linspace(1.0, 5.5, 16))]
    history = local.march(path, hhr.MarchSettings(gradient=True))
    numbers = [local.model_of(answer) for answer in history.answers]
    assert numbers[0] == 0 and numbers[-1] == 1
    for (time, point), answer in zip(path[1:], history.answers, strict=True):
        alone = local.solve(point)
        assert answer.time == time and answer.gradient is not None
        assert np.array_equal(answer.active, alone.active)
        assert largest_difference(answer.forces(), alone.forces()) < 1e-9


def test_what_a_search_starts_from(local, models):
    for number, point in ((0, LOW), (1, HIGH)):
        expected = local.solve(point)
        for start in (None, "nearest", expected.active, ~expected.active, local.solve(HIGH).active):
            found = local.solve(point, start=start)
            assert np.array_equal(found.active, expected.active)
            assert largest_difference(found.multipliers, expected.multipliers) < 1e-9
        for start in ("far", 5, np.zeros(3, bool), np.zeros(len(models[number].problem.gaps))):
            with pytest.raises(ParameterError, match=r"start = .* is unknown"):
                local.solve(point, start=start)


@needs("exact_errors")
def test_where_there_is_no_answer(broken, local):
    with pytest.raises(NotSolvableError, match="no solution at"):
        broken.solve(HIGH)
    nothing = broken.solve(HIGH, raise_on_failure=False)
    assert broken.model_of(nothing) == 1 and not nothing.converged and nothing.estimate() is None
    # by the border the other one has an answer
    answer = broken.solve(BY_THE_BORDER)
    assert broken.model_of(answer) == 0 and bits(answer) == bits(
        local.models[0].solve(BY_THE_BORDER)
    )
    table = [LOW, HIGH, BY_THE_BORDER, HIGH]
    with pytest.raises(NotSolvableError):
        broken.solve_many(table)
    many = broken.solve_many(table, raise_on_failure=False)
    assert [status is Status.CONVERGED for status in many.status] == [True, False, True, False]
    assert many.model.tolist() == [0, 1, 0, 1]
    assert (
        np.isnan(many.outputs()["peak"]).tolist()
        == np.isnan(many.estimates().primal).tolist()
        == [
            False,
            True,
            False,
            True,
        ]
    )
    assert np.isnan(many[1].forces()).all() and np.isfinite(many[2].forces()).all()


def test_the_door_of_each_part(models):
    """The first model was trained up to 3.7 mm and is asked at 5.

    The door says so in the words of one model.
    """
    local = hhr.LocalModels(models, one_cut(1, 5.5, (0.0, 0.2)))
    for ask, at in ((local.solve, (100.0, 5.0)), (local.solve_many, [LOW, (100.0, 5.0)])):
        with pytest.warns(OutsideTrainingWarning, match=r"h1 = 5 \(trained 0\.4"):
            ask(at)
        with pytest.raises(OutsideTrainingError, match="h1 = 5"):
            ask(at, outside="refuse", raise_on_failure=False)
        with pytest.raises(ParameterError, match="outside = 'never' is unknown"):
            ask(at, outside="never")
    with warnings.catch_warnings(action="error"):
        local.solve((100.0, 5.0), outside="ignore")
        # by the border the other model was trained there, and is taken
        answer = local.solve((100.0, 5.45))
        assert local.model_of(answer) == 1
        assert local.solve_many([(100.0, 5.45)], outside="refuse").model.tolist() == [1]


@needs("moduli")
def test_stiffness_that_varies():
    training, local = varying_set()
    points = training.full_order.parameters.random(20, seed=2)
    many = local.solve_many(points, outside="ignore")
    assert set(many.model.tolist()) == {0, 1} and (local.choice.many(points)[1] != LEAF).any()
    for k, point in enumerate(points):
        answer = local.solve(point, outside="ignore")
        assert local.model_of(answer) == many.model[k]
        assert bits(answer) == bits(local.models[many.model[k]].solve(point, outside="ignore"))
        assert largest_difference(many[k].displacement(), answer.displacement()) < 1e-10


# ---------------------------------------------------------------- what is no set


@needs("exact_errors")
def test_models_that_do_not_go_together(models, training):
    halves = one_cut(1, CUT, REACH)
    other = hhr.train(pressed_block("plane_strain"), (4,), held_out=0).build(checked=False)
    bounds = {
        "bound": dataclasses.replace(
            models[1].fields.bound, schur=1.1 * models[1].fields.bound.schur
        )
    }
    stiffer = models[1].changed(fields=dataclasses.replace(models[1].fields, **bounds))
    mute, bare = (
        models[1].changed(fields=dataclasses.replace(models[1].fields, **dict.fromkeys(names)))
        for names in (("functionals", "output_bound"), ("bound", "output_bound"))
    )
    wide = dataclasses.replace(training.full_order.parameters, upper=(400.0, 6.0))
    mesh = {**pellet.QUICK_MESH, "radial_cells": 5}
    finer = dataclasses.replace(pellet.scene(**mesh), outputs=OUTPUTS)
    elsewhere = dataclasses.replace(training.full_order.scene.loads[0], amplitude=slope("P1", 0.5))
    loaded = dataclasses.replace(training.full_order.scene, loads=(elsewhere,))
    apart, pulled = (
        parts_of(hhr.train(scene, (4, 4), held_out=0), [(0.0, 6.1)])[0] for scene in (finer, loaded)
    )
    for model in (other, apart, pulled, stiffer, mute, bare, models[1].changed(parameters=wide)):
        with pytest.raises(ReductionError, match="local model 1 is of another scene or mesh"):
            hhr.LocalModels([models[0], model], halves)
    flowing = models[1].changed()
    flowing.flow = "something"
    no_models = "a list of reduced models, at least one"
    for wrong, tree, why in (
        *((items, halves, no_models) for items in ([], [models[0], None], [training.full_order])),
        (models, None, "None is no Choice"),
        (
            models,
            choice([(-1, 0)], (0.0,) * 3),
            r"a choice of 3 parameters does not suit \('P1', 'h1'\)",
        ),
        (models[:1], halves, "not among 1 local ones"),
        ([models[0], flowing], halves, "take one model"),
    ):
        with pytest.raises(ReductionError, match=why):
            hhr.LocalModels(wrong, tree)


@needs("fallback", "exact_errors")
def test_a_fallback_on_a_local_set_marches_past_answers_of_the_full_model(training, local):
    """Statuses of the full model are too many for any of the set; searches begin anew."""
    safe = hhr.FallbackModel(local, training.full_order, 1e-12)
    history = safe.march([(0.0, LOW), (1.0, LOW), (2.0, HIGH)])
    assert len(history.answers) == 2 and all(safe.fell_back(answer) for answer in history.answers)


def test_why_a_model_of_a_set_has_no_answer_is_told(training, models, local, monkeypatch):
    for model in models:
        monkeypatch.setattr(model, "_answered", Mock(side_effect=SingularError("K of a body")))
    with pytest.raises(SingularError, match="K of a body"):
        local.solve(LOW)
    assert not local.solve(LOW, raise_on_failure=False).converged


def test_answers_do_not_share_the_start_that_they_were_given(models):
    known = models[0].solve(LOW)
    start = known.active.copy()
    answer = models[0].solve(LOW, start=start)
    start[:] = ~start
    assert np.array_equal(answer.active, known.active)


@pytest.fixture(scope="module")
def three(training):
    return three_models(training)


def points_of(model, count=40):
    """Random points and some by the first border."""
    points = model.parameters.random(2 * count, seed=9)
    axis = int(model.choice.axis[0])
    points[count:, axis] = (
        model.choice.cut[0] + np.linspace(-1, 1, count) * model.choice.reach[axis]
    )
    return points


@needs("tables", "exact_errors")
def test_tables_say_which_model_answered(three, tmp_path):
    points = np.vstack([points_of(three, 10), [[1e9, 1.0]]])
    answers = hhr.answer_points(three, points)
    alone = hhr.answer_points(three.models[0], points, outside="ignore")
    assert list(answers.outputs) == list(alone.outputs) and list(answers.estimates) == list(
        alone.estimates
    )
    assert not alone.columns and list(answers.columns) == ["model"]
    numbers = answers.columns["model"]
    assert np.isnan(numbers[-1]) and answers.status[-1] != "ok"
    for k, point in enumerate(points[:-1]):
        answer = three.solve(point)
        assert numbers[k] == three.model_of(answer)
        # many at once share products of matrices, whose last digits differ from those of one
        assert largest_difference(answers.forces[k], answer.forces()) < 1e-12
        assert answers.outputs["peak [MPa]"][k] == pytest.approx(
            answer.outputs()["peak"], rel=1e-12
        )
        bound = answer.estimate().outputs["peak"]
        # a difference of two peaks, each to the same digits
        least = 1e-13 * answer.outputs()["peak"]
        assert answers.estimates["bound of peak [MPa]"][k] == pytest.approx(
            bound, rel=1e-6, abs=least
        )
    assert hhr.write_answers(tmp_path / "answers.csv", three.parameters, answers) == 1
    rows = read_csv(tmp_path / "answers.csv")
    assert [row["model"] for row in rows] == [*(f"{number:.0f}" for number in numbers[:-1]), ""]
    assert list(rows[0]).index("model") == list(rows[0]).index("force_0") - 1
    assert hhr.answer_points(three, np.zeros((0, 2))).columns["model"].shape == (0,)


ON_RANKS = """
import sys
import hhr_dolfinx as hhr
from hhr_dolfinx.command.console import make_console
model = hhr.load_model(sys.argv[1])
hhr.answer_table(model, hhr.read_points(sys.argv[2], model.parameters), sys.argv[3], make_console())
"""


@needs("ranks", "tables")
def test_on_two_ranks_a_table_is_the_same(three, tmp_path):
    hhr.save_model(tmp_path / "local.npz", three)
    np.savetxt(
        tmp_path / "points.csv", points_of(three, 15), delimiter=",", header="P1,h1", comments=""
    )
    texts = []
    for ranks in (1, 2):
        out = tmp_path / f"answers{ranks}.csv"
        launch(
            ranks,
            ["-c", ON_RANKS, str(tmp_path / "local.npz"), str(tmp_path / "points.csv"), str(out)],
        )
        texts.append(out.read_text())
    assert texts[0] == texts[1]
    assert {row["model"] for row in read_csv(tmp_path / "answers2.csv")} == {"0", "1", "2"}


@needs("fallback", "tables")
def test_local_models_fall_back_on_the_full_one(three, training):
    model, points = (
        hhr.FallbackModel(three, training.full_order, 1e-3),
        np.vstack([points_of(three, 20), [[1e9, 1.0]]]),
    )
    answers = hhr.answer_points(model, points)
    fell, numbers = answers.columns["fell_back"] == 1, answers.columns["model"]
    assert 0 < fell.sum() == model.fallen < 40
    assert np.isnan(numbers[fell]).all() and (numbers[:40][~fell[:40]] >= 0).all()
    for k in np.flatnonzero(~fell[:40]):
        estimate = three.solve(points[k]).estimate()
        assert max(estimate.primal_relative, estimate.dual_relative) <= 1e-3
    alone = hhr.answer_points(hhr.FallbackModel(three.models[0], training.full_order), points[:2])
    assert list(alone.columns) == ["fell_back"]
