"""A box beyond a limit load: what has an answer is trained on, what has none is named."""

import warnings

import numpy as np
import pytest
from needs import needs
from scenes import pressed_block

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ConvergenceError, TrainingWarning
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.snapshots.records import compute_snapshots
from hhr_dolfinx.study.training.train import train


@pytest.fixture(scope="module")
def yielding():
    """A tube without hardening, in a wall that it does not reach before it yields as a whole, at 2 / √3 ln 2 = 0.8."""
    import condensing

    return condensing.walled_tube(hhr.Plasticity(1.0), wall=50.0, cells=4, p=(0.0, 2.0))


def family(scene):
    own = hhr.ParameterSpace(("to",), (0.1,), (2.0,))
    return hhr.PathFamily("load", scene.parameters, own, {"p": 0.0}, (hhr.Leg({"p": "to"}, 1.0, 4),))


@needs("inelastic", "paths")
def test_histories_without_an_answer_are_named_and_left_out(yielding):
    from hhr_dolfinx.plugins.inelastic.state import flowed

    paths = family(yielding).paths(np.array([[0.4], [0.6], [1.6], [0.7]]))
    with pytest.warns(TrainingWarning, match=r"1 of 4 training queries have no answer .*: load \(to = 1\.6\): step \d"):
        training = train(yielding, paths, held_out=[])
    ends = [history.answers[-1].parameter[0] for history in training.snapshots.histories]
    assert ends == pytest.approx([0.4, 0.6, 0.7]) and flowed(training.snapshots)
    # asked for by itself it is an error as before
    with pytest.raises(ConvergenceError):
        compute_snapshots(training.full_order, paths)


@needs("inelastic", "paths")
def test_too_few_left_are_no_training(yielding):
    for ends, words in (((0.4, 1.6, 1.7), "2 of 3 .* Fewer than 2 are left"), ((1.6, 1.7), "none of 2 queries")):
        with pytest.raises(ConvergenceError, match=words):
            train(yielding, family(yielding).paths(np.array(ends)[:, None]), held_out=[])


def test_points_without_an_answer(monkeypatch):
    solve = FullOrderModel.solve

    def failing(self, mu, **how):
        if mu[0] == 0.05:
            raise ConvergenceError("it cycled")
        return solve(self, mu, **how)

    monkeypatch.setattr(FullOrderModel, "solve", failing)
    scene = pressed_block("plane_strain")
    with pytest.warns(TrainingWarning, match=r"1 of 3 training queries have no answer .*: push = 0\.05: it cycled"):
        training = train(scene, 3, held_out=0)
    assert training.snapshots.points.ravel() == pytest.approx([0.0, 0.1]) and training.snapshots.forces.shape[1] == 2


@needs("inelastic", "studies", "paths")
def test_a_study_leaves_out_tests_without_an_answer(yielding, tmp_path):
    paths = family(yielding).paths(np.array([[0.4], [0.6], [0.7]]))
    tests = dict(zip("ab", family(yielding).paths(np.array([[0.5], [1.7]])), strict=True))
    settings = hhr.StudySettings(paths, tests=tests, held_out=[], repetitions=1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        study = hhr.study_scene(yielding, settings, tmp_path)
    assert any("1 of 2 test paths have no answer" in str(item.message) for item in caught)
    assert [row["value"] for row in study.report["histories"]] == ["a"]
