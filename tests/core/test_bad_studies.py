"""Trainings and studies refuse what they cannot do before they compute, and name what has no
answer.
"""

import dataclasses
import warnings
from argparse import Namespace
from unittest.mock import Mock

import hertz_half_discs as demo
import numpy as np
import pytest
from needs import needs
from scenes import pressed_block

import hhr_dolfinx as hhr
from hhr_dolfinx import compat
from hhr_dolfinx.errors import (
    ConvergenceError,
    ParameterError,
    ReductionError,
    StudyError,
    TrainingWarning,
)


def unbuilt():
    """The scene of the demo, whose mesh must not be asked for."""
    return dataclasses.replace(
        demo.scene(), geometry=Mock(side_effect=AssertionError("the full model was built"))
    )


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (
            {"training": [31, 2]},
            r"of scene 'hertz_half_discs': counts \[31, 2\] .* must be 1 positive integers",
        ),
        ({"training": [0]}, r"counts \[0\] of a grid"),
        ({"training": [1]}, r"on \[1\] points: a reduced model needs at least 2"),
        ({"seed": -1}, "seed = -1 must be an integer of at least 0"),
        ({"seed": 1.5}, r"seed = 1\.5 must be an integer"),
        ({"held_out": -1}, "held_out = -1 must be an integer of at least 0"),
        ({"folder": 7}, "the folder 7 must be a path"),
        ({"folder": "a\0b"}, "cannot be made: embedded null byte. Choose another name"),
    ],
)
def test_trainings_that_cannot_be_run(asked, message):
    with pytest.raises(StudyError, match=message):
        hhr.train(unbuilt(), **{"training": [3]} | asked)


@needs("inelastic")
def test_paths_held_out_may_be_an_array():
    """Times and the one parameter, (paths, steps, 2), as for training."""
    scene = pressed_block("plane_strain", cells=2)
    body = dataclasses.replace(scene.bodies[0], law=hhr.Plasticity(0.06, 0.3))
    paths = np.array([[[0.0, 0.0], [0.5, 0.05], [1.0, 0.1]]])
    training = hhr.train(
        dataclasses.replace(scene, bodies=(body,)), paths, held_out=paths * [1.0, 0.8]
    )
    assert training.held_out.points.ravel() == pytest.approx([0.04, 0.08])
    with pytest.raises(ReductionError, match="is no recipe"):
        training.build({}, checked=False)


@needs("studies")
@pytest.mark.parametrize("below", ["", "snapshots"])
def test_a_folder_that_is_a_file(tmp_path, below):
    (tmp_path / "file").write_text("")
    folder, settings = str(tmp_path / "file" / below), hhr.StudySettings([3])
    for call in (
        lambda: hhr.train(unbuilt(), [3], folder=folder),
        lambda: hhr.study_scene(unbuilt(), settings, folder),
    ):
        with pytest.raises(StudyError, match=r"cannot be made: .*/file is a file\. Choose another"):
            call()


@needs("studies")
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"tests": 0}, "tests = 0 must be an integer of at least 1"),
        ({"queries": 0}, "queries = 0 must be an integer of at least 1"),
        ({"queries": 10.0}, r"queries = 10\.0 must be an integer"),
        ({"repetitions": 0}, "repetitions = 0 must be an integer of at least 1"),
        ({"tests": {}}, r"tests = \{\} must hold at least one entry"),
        ({"tests": ()}, r"tests = \(\) must be an integer of at least 1"),
        ({"training": []}, r"training = \[\] must hold at least one entry"),
        ({"recipe": "thesis"}, "recipe = 'thesis' of a study must be a Recipe"),
        ({"variants": [("few", 0.1)]}, r"variant 'few' = 0\.1 of a study must be a Recipe"),
        ({"models": {"few": None}}, "model 'few' = None of a study must be a Recipe"),
        ({"held_out": -1}, "held_out = -1 must be an integer of at least 0"),
        ({"seed": -1}, "seed = -1 must be an integer of at least 0"),
    ],
)
def test_studies_that_measure_nothing(settings, message):
    with pytest.raises(StudyError, match=message):
        hhr.StudySettings(**{"training": [3]} | settings)
    if "seed" in settings:
        with pytest.raises(StudyError, match=message):
            demo.SETTINGS().adapted(seed=-1, quick=True)


@needs("studies")
@pytest.mark.parametrize("points", [[[0.2, 0.3]], [], ["text"]])
def test_test_points_that_are_none(tmp_path, points):
    with pytest.raises(ParameterError, match=r"\('mu',\)"):
        hhr.study_scene(unbuilt(), hhr.StudySettings([3]), tmp_path, points=points)


@needs("studies")
@pytest.mark.parametrize(("seed", "message"), [("-1", " that is not negative"), ("one", "")])
def test_options_of_demos(capsys, seed, message):
    from parts.cli import demo_parser

    with pytest.raises(SystemExit):
        demo_parser("demo", "A demo.").parse_args(["--seed", seed])
    assert f"argument --seed: {seed} must be an integer{message}" in capsys.readouterr().err


@needs("studies")
def test_a_study_in_a_folder_given_as_text(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    settings = hhr.StudySettings(
        [8], recipe=demo.THESIS.as_it_is(), tests=2, queries=2, held_out=0, naive=False
    )
    scene = demo.scene(arc_segments=28, flat_segments=7)
    study = hhr.study_scene(scene, settings, "out/x", points=[0.2, 0.3])
    study.write("out/x")
    assert study.tests.shape == (2, 1) and len(list((tmp_path / "out/x/snapshots").iterdir())) == 8
    assert (tmp_path / "out/x/report.json").exists() and (tmp_path / "out/x/study.npz").exists()


@pytest.mark.parametrize("kind", [np.complex64, np.complex128])
def test_a_petsc_of_complex_numbers(monkeypatch, kind):
    import petsc4py

    monkeypatch.setattr(petsc4py, "PETSc", Namespace(ScalarType=kind))
    with pytest.raises(
        ImportError, match=r"PETSc was built with complex numbers.*install a real build"
    ):
        compat.require_dolfinx()
    with pytest.raises(ImportError, match="complex"):
        hhr.FullOrderModel(unbuilt())


@pytest.fixture(scope="module")
def yielding():
    """A tube without hardening, in a wall that it does not reach before it yields as a whole, at 2
    / √3 ln 2 = 0.8.
    """
    import condensing

    return condensing.walled_tube(hhr.Plasticity(1.0), wall=50.0, cells=4, p=(0.0, 2.0))


def family(scene):
    own = hhr.ParameterSpace(("to",), (0.1,), (2.0,))
    return hhr.PathFamily(
        "load", scene.parameters, own, {"p": 0.0}, (hhr.Leg({"p": "to"}, 1.0, 4),)
    )


@needs("inelastic", "paths")
def test_histories_without_an_answer_are_named_and_left_out(yielding):
    from hhr_dolfinx.plugins.inelastic.state import flowed

    paths = family(yielding).paths(np.array([[0.4], [0.6], [1.6], [0.7]]))
    with pytest.warns(
        TrainingWarning,
        match=r"1 of 4 training queries have no answer .*: load \(to = 1\.6\): step \d",
    ):
        training = hhr.train(yielding, paths, held_out=[])
    ends = [history.answers[-1].parameter[0] for history in training.snapshots.histories]
    assert ends == pytest.approx([0.4, 0.6, 0.7]) and flowed(training.snapshots)
    # asked for by itself it is an error as before
    with pytest.raises(ConvergenceError):
        hhr.compute_snapshots(training.full_order, paths)


@needs("inelastic", "paths")
def test_too_few_left_are_no_training(yielding):
    for ends, words in (
        ((0.4, 1.6, 1.7), "2 of 3 .* Fewer than 2 are left"),
        ((1.6, 1.7), "none of 2 queries"),
    ):
        with pytest.raises(ConvergenceError, match=words):
            hhr.train(yielding, family(yielding).paths(np.array(ends)[:, None]), held_out=[])


def test_points_without_an_answer(monkeypatch):
    solve = hhr.FullOrderModel.solve

    def failing(self, mu, **how):
        if mu[0] == 0.05:
            raise ConvergenceError("it cycled")
        return solve(self, mu, **how)

    monkeypatch.setattr(hhr.FullOrderModel, "solve", failing)
    scene = pressed_block("plane_strain")
    with pytest.warns(
        TrainingWarning, match=r"1 of 3 training queries have no answer .*: push = 0\.05: it cycled"
    ):
        training = hhr.train(scene, 3, held_out=0)
    assert (
        training.snapshots.points.ravel() == pytest.approx([0.0, 0.1])
        and training.snapshots.forces.shape[1] == 2
    )


@needs("inelastic", "studies", "paths")
def test_a_study_leaves_out_tests_without_an_answer(yielding, tmp_path):
    paths = family(yielding).paths(np.array([[0.4], [0.6], [0.7]]))
    tests = dict(zip("ab", family(yielding).paths(np.array([[0.5], [1.7]])), strict=True))
    settings = hhr.StudySettings(paths, tests=tests, held_out=[], repetitions=1)
    with warnings.catch_warnings(record=True, action="always") as caught:
        study = hhr.study_scene(yielding, settings, tmp_path)
    assert any("1 of 2 test paths have no answer" in str(item.message) for item in caught)
    assert [row["value"] for row in study.report["histories"]] == ["a"]
