"""A model that falls back on the full one: nothing it hands out is off by more than allowed."""

import dataclasses

import numpy as np
import pellet_cladding as demo
import pytest
from bare import read_csv
from mpi4py import MPI
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.command.console import make_console
from hhr_dolfinx.errors import ParameterError

POOR = hhr.Recipe().as_it_is()
OUTPUTS = (hhr.LargestPressure("peak", 0, unit="MPa"), hhr.ContactWidth("area", 0))


@pytest.fixture(scope="module")
def pellet():
    scene = dataclasses.replace(demo.scene(**demo.QUICK_MESH), outputs=OUTPUTS)
    return hhr.train(scene, (3, 3), held_out=0, comm=MPI.COMM_SELF)


def test_no_answer_is_off_by_more_than_allowed(pellet):
    """In energy and in the S norm; from nine snapshots of the pellet, 50 random points, of which 60 % fall back."""
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


def test_snapshots_and_what_was_learned_are_joined(pellet):
    answers = [pellet.full_order.solve(point) for point in pellet.full_order.parameters.random(2, 2)]
    found = pellet.snapshots.joined(hhr.SnapshotSet.of_answers(answers))
    assert len(found.points) == len(pellet.snapshots.points) + 2 and not found.histories
    assert np.array_equal(found.displacements[:, -1], answers[1].unknown)
    assert np.array_equal(found.forces[:, -2], answers[0].multipliers)


def test_a_safe_model_of_a_constant_stiffness_is_the_condensed_one(pellet):
    """An estimate solves the exact problem on S, so that no answer need be inexact."""
    safe = pellet.safe_model(0.01, of="pressure")
    assert type(safe) is type(pellet.condense()) and safe.fields.exact
    for point in pellet.full_order.parameters.random(5, 1):
        exact = pellet.full_order.solve(point).forces()
        assert np.linalg.norm(safe.solve(point).forces() - exact) <= 1e-10 * np.linalg.norm(exact)
    with pytest.raises(ParameterError, match="is no error"):
        pellet.safe_model(of="energy")
    with pytest.raises(ParameterError, match="must be a positive number"):
        pellet.safe_model(0.0)


# ---------------------------------------------------------------- batches and studies


@needs("tables")
def test_batches_report_how_many_fell_back(pellet, tmp_path, capsys):
    model = hhr.FallbackModel(pellet.build(POOR, checked=False), pellet.full_order, 0.05)
    points = pellet.full_order.parameters.random(8, 3)
    table = np.vstack([points, [1e9, 1.0]])
    answers = hhr.answer_points(model, table)
    names = ("displacement", "forces", "pressure", "forces in energy", "peak [MPa]", "area")
    assert list(answers.estimates) == [f"bound of {name}" for name in names]
    column = answers.columns["fell_back"]
    fell = column[:8] == 1
    assert 0 < fell.sum() == model.fallen < 8 and np.isnan(column[8])
    errors = np.max(
        [answers.estimates[f"bound of {name}"][:8] for name in ("displacement", "forces in energy")], axis=0
    )
    assert (errors <= 0.05).all() and (errors[fell] == 0).all()
    reduced = ~fell
    assert (answers.estimates["bound of peak [MPa]"][:8][reduced] > 0).all()
    assert (answers.estimates["bound of area"][:8] >= 0).all()
    assert hhr.write_answers(tmp_path / "answers.csv", model.parameters, answers) == 1
    rows = read_csv(tmp_path / "answers.csv")
    assert [row["fell_back"] for row in rows[:8]] == [str(int(one)) for one in fell]
    assert rows[8]["fell_back"] == ""
    (tmp_path / "points.csv").write_text("P1,h1\n" + "\n".join(f"{a},{b}" for a, b in points.tolist()) + "\n")
    given = hhr.read_points(tmp_path / "points.csv", model.parameters)
    assert hhr.answer_table(model, given, tmp_path / "again.csv", make_console()) == 0
    assert f"8 answers ({fell.sum()} by the full model)" in capsys.readouterr().out


@needs("tables")
def test_a_batch_of_a_reduced_model_has_its_bounds(pellet):
    model = pellet.build(checked=False)
    answers = hhr.answer_points(model, pellet.full_order.parameters.random(3, 4), outside="ignore")
    for k, point in enumerate(answers.points):
        found = model.solve(point, outside="ignore").estimate()
        assert answers.estimates["bound of displacement"][k] == pytest.approx(found.primal_relative, rel=1e-6)
        assert answers.estimates["bound of peak [MPa]"][k] == pytest.approx(found.outputs["peak"], rel=1e-6)
    assert not answers.columns
