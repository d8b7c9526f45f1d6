"""A model that falls back on the full one and grows: nothing it hands out is off by more than allowed."""

import csv
import dataclasses
import logging

import numpy as np
import pellet_cladding as demo
import pytest
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import BoundError, ParameterError, ReductionError
from hhr_dolfinx.models.fallback import Growth
from hhr_dolfinx.study.report.console import make_console

POOR = hhr.Recipe().as_it_is()
OUTPUTS = (hhr.LargestPressure("peak", 0, unit="MPa"), hhr.ContactWidth("area", 0))


@pytest.fixture(scope="module")
def pellet():
    scene = dataclasses.replace(demo.scene(**demo.QUICK_MESH), outputs=OUTPUTS)
    return hhr.train(scene, (3, 3), held_out=0, comm=MPI.COMM_SELF)


def worst_error(full, model, points):
    """Largest relative error of displacement in energy and of forces in the S norm, of answers handed out."""
    worst, fallen = 0.0, []
    for point in points:
        answer, exact = model.solve(point), full.solve(point)
        fallen.append(model.fell_back(answer))
        for value, other, product in (
            (answer.displacement(), exact.displacement(), full.problem.stiffness),
            (answer.forces(), exact.forces(), full.schur),
        ):
            off, size = (part @ (product @ part) for part in (value - other, other))
            if size > 0:
                worst = max(worst, off / size)
    return np.sqrt(worst), np.array(fallen)


def test_no_answer_is_off_by_more_than_allowed_and_fewer_fall_back(pellet):
    """From nine snapshots of the pellet, 200 random points. Measured: 60, 2, 0 and 0 % of each 50 fall back."""
    full, model = pellet.full_order, pellet.safe_model(0.01, grow=10, recipe=POOR, checked=False)
    before = len(model.reduced.problem.stiffness)
    worst, fallen = worst_error(full, model, full.parameters.random(200, 0))
    shares = [part.mean() for part in np.array_split(fallen, 4)]
    assert worst <= 0.01 and model.asked == 200 and model.fallen == fallen.sum()
    assert shares[0] > 0.5 and shares[-1] < 0.5 * shares[0]
    assert [step.learned for step in model.growth] == list(range(10, len(model.learned) + 1, 10))
    assert not any(step.refused for step in model.growth)
    assert len(model.reduced.problem.stiffness) > before
    again = pellet.safe_model(0.01, grow=None, recipe=POOR, checked=False)
    worst_error(full, again, full.parameters.random(50, 0))
    assert not again.growth and again.share > 0.5


def test_what_was_learned_stays_where_a_model_cannot_be_built(pellet, caplog):
    attempts = []

    def rebuild(learned):
        attempts.append(len(learned))
        if len(attempts) == 1:
            raise ReductionError("no better model today")
        if len(attempts) == 2:
            return bare
        return hhr.build(full, pellet.snapshots.joined(hhr.SnapshotSet.of_answers(learned)), POOR)

    full, first = pellet.full_order, pellet.build(checked=False)
    bare = first.changed(fields=dataclasses.replace(first.fields, bound=None))
    model, points = hhr.FallbackModel(first, full, 1e-9, rebuild=rebuild, every=3), full.parameters.random(9, 1)
    with caplog.at_level(logging.INFO, logger="hhr_dolfinx"):
        model.solve_many(points[:6])
        assert model.reduced is first and len(model.learned) == 6
        model.solve_many(points[6:])
    assert attempts == [3, 6, 9] and model.reduced is not first
    assert np.array_equal([answer.parameter for answer in model.learned], points)
    assert model.growth[0] == Growth(3, 3, 3, "no better model today")
    assert "have no bound" in model.growth[1].refused and model.growth[2].refused == ""
    assert "no better model today" in caplog.text and "was built again" in caplog.text


def test_faults_of_a_program_are_not_hidden(pellet):
    def rebuild(learned):
        raise ZeroDivisionError

    model = hhr.FallbackModel(pellet.build(checked=False), pellet.full_order, 1e-9, rebuild=rebuild, every=1)
    with pytest.raises(ZeroDivisionError):
        model.solve((100.0, 3.0))
    assert len(model.learned) == 1


def test_a_point_is_learned_once(pellet):
    model = pellet.safe_model(1e-9, grow=3, recipe=POOR, checked=False)
    for _ in range(5):
        answer = model.solve((100.0, 3.0), gradient=True)
        assert model.fell_back(answer) and answer.gradient is not None
    assert model.share == 1 and model.fallen == 5 and len(model.learned) == 1 and not model.growth


def test_snapshots_and_what_was_learned_are_joined(pellet):
    answers = [pellet.full_order.solve(point) for point in pellet.full_order.parameters.random(2, 2)]
    found = pellet.snapshots.joined(hhr.SnapshotSet.of_answers(answers))
    assert len(found.points) == len(pellet.snapshots.points) + 2 and not found.histories
    assert np.array_equal(found.displacements[:, -1], answers[1].unknown)
    assert np.array_equal(found.forces[:, -2], answers[0].multipliers)


@pytest.mark.parametrize("every", [0, -1, 2.5, "ten", None])
def test_numbers_that_are_none(every, pellet):
    with pytest.raises(ParameterError, match="every"):
        hhr.FallbackModel(pellet.build(checked=False), pellet.full_order, every=every)


def test_a_model_without_bounds_cannot_be_safe(pellet):
    with pytest.raises(BoundError, match="have no bound"):
        pellet.safe_model(recipe=dataclasses.replace(POOR, bound=False), checked=False)


# ---------------------------------------------------------------- batches and studies


def test_batches_report_how_many_fell_back(pellet, tmp_path, capsys):
    model, points = (
        pellet.safe_model(0.05, grow=None, recipe=POOR, checked=False),
        pellet.full_order.parameters.random(8, 3),
    )
    table = np.vstack([points, [1e9, 1.0]])
    answers = hhr.answer_points(model, table)
    names = ("displacement", "forces", "pressure", "forces in energy", "peak [MPa]", "area")
    assert list(answers.estimates) == [f"bound of {name}" for name in names]
    assert 0 < answers.fell_back.sum() == model.fallen < 8 and not answers.fell_back[8]
    errors = np.max(
        [answers.estimates[f"bound of {name}"][:8] for name in ("displacement", "forces in energy")], axis=0
    )
    assert (errors <= 0.05).all() and (errors[answers.fell_back[:8]] == 0).all()
    reduced = ~answers.fell_back[:8]
    assert (answers.estimates["bound of peak [MPa]"][:8][reduced] > 0).all()
    assert np.isnan(answers.estimates["bound of area"][:8][reduced]).all()
    assert hhr.write_answers(tmp_path / "answers.csv", model.parameters, answers) == 1
    with open(tmp_path / "answers.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["fell_back"] for row in rows[:8]] == [str(int(fell)) for fell in answers.fell_back[:8]]
    assert rows[8]["fell_back"] == "" and all(row["bound of area"] in ("", "0") for row in rows)
    (tmp_path / "points.csv").write_text("P1,h1\n" + "\n".join(f"{a},{b}" for a, b in points.tolist()) + "\n")
    given = hhr.read_points(tmp_path / "points.csv", model.parameters)
    assert hhr.answer_table(model, given, tmp_path / "again.csv", make_console()) == 0
    assert f"8 answers ({answers.fell_back.sum()} by the full model)" in capsys.readouterr().out


def test_a_batch_of_a_reduced_model_has_its_bounds(pellet):
    model = pellet.build(checked=False)
    answers = hhr.answer_points(model, pellet.full_order.parameters.random(3, 4), outside="ignore")
    for k, point in enumerate(answers.points):
        found = model.solve(point, outside="ignore").estimate()
        assert answers.estimates["bound of displacement"][k] == pytest.approx(found.primal_relative, rel=1e-6)
        assert answers.estimates["bound of peak [MPa]"][k] == pytest.approx(found.outputs["peak"], rel=1e-6)
    assert answers.fell_back is None


def test_a_study_reports_how_many_fall_back(pellet, capsys):
    from hhr_dolfinx.study.report.report import print_report

    study = hhr.run_study(pellet, hhr.StudySettings((3, 3), recipe=POOR, tests=3, queries=10, naive=False))
    row = study.report["fallback"]
    assert row["tolerance"] == 0.01 and 0 < row["share"] <= 1 and 0 < row["full"] and 0 < row["query"]
    print_report(study.report, make_console())
    assert "fall back on the full order" in capsys.readouterr().out
