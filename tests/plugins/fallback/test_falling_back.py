"""A model that falls back on the full one: nothing it hands out is off by more than allowed."""

import numpy as np
import pytest
from bare_problem import read_csv
from local_models_by_hand import pellet_training
from needs import needs
from scenes import check_alike

import hhr_dolfinx as hhr
from hhr_dolfinx.command.console import make_console
from hhr_dolfinx.errors import ParameterError

POOR = hhr.Recipe().as_it_is()
OUTPUTS = hhr.LargestPressure("peak", 0, unit="MPa"), hhr.ContactWidth("area", 0)


@pytest.fixture(scope="module")
def pellet():
    return pellet_training((3, 3), OUTPUTS)


@needs("exact_errors")
def test_no_answer_is_off_by_more_than_allowed(pellet):
    """In energy and in the S norm; from nine snapshots of the pellet, 50 random points, of which 60
    % fall back.
    """
    full = pellet.full_order
    model, fell = hhr.FallbackModel(pellet.build(POOR, checked=False), full, 0.01), 0
    for point in full.parameters.random(50, 0):
        answer, exact = model.solve(point), full.solve(point)
        fell += model.fell_back(answer)
        for value, other, product in (
            (answer.displacement(), exact.displacement(), full.problem.stiffness),
            (answer.forces(), exact.forces(), full.schur),
        ):
            off, size = (part @ (product @ part) for part in (value - other, other))
            assert off <= 0.01**2 * size
    assert model.asked == 50 and model.fallen == fell
    assert 0.2 < model.share < 0.9


def test_a_safe_model_of_a_constant_stiffness_is_the_condensed_one(pellet):
    """An estimate solves the exact problem on S, so that no answer need be inexact."""
    safe = pellet.safe_model(0.01, of="pressure")
    assert type(safe) is type(pellet.condense()) and safe.fields.exact
    check_alike(pellet.full_order, safe, pellet.full_order.parameters.random(5, 1), forces=1e-10)
    with pytest.raises(ParameterError, match="must be a positive number"):
        pellet.safe_model(0.0)


@needs("tables", "exact_errors")
def test_batches_report_how_many_fell_back(pellet, tmp_path, capsys):
    model = hhr.FallbackModel(pellet.build(POOR, checked=False), pellet.full_order, 0.05)
    points = pellet.full_order.parameters.random(8, 3)
    table = np.vstack([points, [1e9, 1.0]])
    answers = hhr.answer_points(model, table)
    names = ("displacement", "forces", "pressure", "forces in energy", "peak [MPa]", "area")
    assert list(answers.estimates) == [f"bound of {name}" for name in names]
    column, bounds = (
        answers.columns["fell_back"],
        {name: answers.estimates[f"bound of {name}"][:8] for name in names},
    )
    fell = column[:8] == 1
    assert 0 < fell.sum() == model.fallen < 8 and np.isnan(column[8])
    errors = np.maximum(bounds["displacement"], bounds["forces in energy"])
    assert (errors <= 0.05).all() and (errors[fell] == 0).all()
    assert (bounds["peak [MPa]"][~fell] > 0).all() and (bounds["area"] >= 0).all()
    said = [model.reduced.solve(point, outside="ignore").estimate() for point in points[~fell]]
    assert bounds["displacement"][~fell] == pytest.approx(
        [each.primal_relative for each in said], rel=1e-6
    )
    assert bounds["peak [MPa]"][~fell] == pytest.approx(
        [each.outputs["peak"] for each in said], rel=1e-6
    )
    assert hhr.write_answers(tmp_path / "answers.csv", model.parameters, answers) == 1
    said = [row["fell_back"] for row in read_csv(tmp_path / "answers.csv")]
    assert said == [*(str(int(one)) for one in fell), ""]
    (tmp_path / "points.csv").write_text(
        "P1,h1\n" + "\n".join(f"{a},{b}" for a, b in points.tolist()) + "\n"
    )
    given = hhr.read_points(tmp_path / "points.csv", model.parameters)
    assert hhr.answer_table(model, given, tmp_path / "again.csv", make_console()) == 0
    assert f"8 answers ({fell.sum()} by the full model)" in capsys.readouterr().out
