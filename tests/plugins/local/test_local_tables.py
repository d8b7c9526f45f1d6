"""Local models in tables, on ranks, and where the full model answers in their place."""

import numpy as np
import pytest
from bare import read_csv
from launched import launch
from needs import needs
from parted import pellet_training, three_models
from scenes import largest_difference

import hhr_dolfinx as hhr


@pytest.fixture(scope="module")
def training():
    return pellet_training()


@pytest.fixture(scope="module")
def local(training):
    return three_models(training)


def points_of(model, count=40):
    """Random points and some by the first border."""
    points = model.parameters.random(2 * count, seed=9)
    axis = int(model.choice.axis[0])
    points[count:, axis] = model.choice.cut[0] + np.linspace(-1, 1, count) * model.choice.reach[axis]
    return points


@needs("tables")
def test_tables_say_which_model_answered(local, tmp_path):
    points = np.vstack([points_of(local, 10), [[1e9, 1.0]]])
    answers = hhr.answer_points(local, points)
    alone = hhr.answer_points(local.models[0], points, outside="ignore")
    assert list(answers.outputs) == list(alone.outputs) and list(answers.estimates) == list(alone.estimates)
    assert not alone.columns and list(answers.columns) == ["model"]
    numbers = answers.columns["model"]
    assert np.isnan(numbers[-1]) and answers.status[-1] != "ok"
    for k, point in enumerate(points[:-1]):
        answer = local.solve(point)
        assert numbers[k] == local.model_of(answer)
        # many at once share products of matrices, whose last digits differ from those of one
        assert largest_difference(answers.forces[k], answer.forces()) < 1e-12
        assert answers.outputs["peak [MPa]"][k] == pytest.approx(answer.outputs()["peak"], rel=1e-12)
        bound = answer.estimate().outputs["peak"]
        # a difference of two peaks, each to the same digits
        least = 1e-13 * answer.outputs()["peak"]
        assert answers.estimates["bound of peak [MPa]"][k] == pytest.approx(bound, rel=1e-6, abs=least)
    assert hhr.write_answers(tmp_path / "answers.csv", local.parameters, answers) == 1
    rows = read_csv(tmp_path / "answers.csv")
    assert [row["model"] for row in rows] == [*(f"{number:.0f}" for number in numbers[:-1]), ""]
    assert list(rows[0]).index("model") == list(rows[0]).index("force_0") - 1
    assert hhr.answer_points(local, np.zeros((0, 2))).columns["model"].shape == (0,)


ON_RANKS = """
import sys
import hhr_dolfinx as hhr
from hhr_dolfinx.command.console import make_console
model = hhr.load_model(sys.argv[1])
hhr.answer_table(model, hhr.read_points(sys.argv[2], model.parameters), sys.argv[3], make_console())
"""


@needs("tables")
def test_on_two_ranks_a_table_is_the_same(local, tmp_path):
    hhr.save_model(tmp_path / "local.npz", local)
    np.savetxt(tmp_path / "points.csv", points_of(local, 15), delimiter=",", header="P1,h1", comments="")
    texts = []
    for ranks in (1, 2):
        out = tmp_path / f"answers{ranks}.csv"
        launch(ranks, ["-c", ON_RANKS, str(tmp_path / "local.npz"), str(tmp_path / "points.csv"), str(out)])
        texts.append(out.read_text())
    assert texts[0] == texts[1]
    assert {row["model"] for row in read_csv(tmp_path / "answers2.csv")} == {"0", "1", "2"}


@needs("tables")
def test_local_models_fall_back_on_the_full_one(local, training):
    model, points = hhr.FallbackModel(local, training.full_order, 1e-3), np.vstack([points_of(local, 20), [[1e9, 1.0]]])
    answers = hhr.answer_points(model, points)
    fell, numbers = answers.columns["fell_back"] == 1, answers.columns["model"]
    assert 0 < fell.sum() == model.fallen < 40
    assert np.isnan(numbers[fell]).all() and (numbers[:40][~fell[:40]] >= 0).all()
    for k in np.flatnonzero(~fell[:40]):
        estimate = local.solve(points[k]).estimate()
        assert max(estimate.primal_relative, estimate.dual_relative) <= 1e-3
    alone = hhr.answer_points(hhr.FallbackModel(local.models[0], training.full_order), points[:2])
    assert list(alone.columns) == ["fell_back"]
