"""One study for scenes that are elastic and scenes that flow: rivals, variants, resumption, nothing needless loaded."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import contact_patch_test as patch
import hertz_half_discs as discs
import numpy as np
import pytest
from toy_rival import NearestAnswer, NearestHistory

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import StudyError

ROOT = Path(__file__).parent.parent


def flowing():
    """Two blocks, the upper of which yields, pushed together and aside."""
    base = patch.scene(hhr.NodeToSurface, (3, 2), (4, 3), poisson=0.3)
    bodies = tuple(replace(body, law=hhr.Plasticity(0.05, 0.5)) if body.tag == 2 else body for body in base.bodies)
    return replace(base, bodies=bodies)


def pushed(side, steps=4):
    """Ten hundredths down and aside, in a second."""
    return [(share, np.array([0.05 * share, side * share])) for share in np.arange(steps + 1) / steps]


SETTINGS = hhr.StudySettings(
    [pushed(0.0), pushed(0.02)],
    hhr.Recipe.flowing(trust=None),
    variants=[("as it is", hhr.Recipe.flowing(trust=None, domain=hhr.Rid(0, 0)))],
    tests={0.01: pushed(0.01), 0.015: pushed(0.015)},
    repetitions=1,
)


def test_a_rival_of_one_file_is_a_row(tmp_path):
    settings = hhr.StudySettings([8], tests=3, queries=2, held_out=5, naive=False)
    rivals = lambda training: [hhr.Rival("nearest answer", "8 points", NearestAnswer(training))]  # noqa: E731
    scene = discs.scene(arc_segments=28, flat_segments=7)
    study = hhr.study_scene(scene, settings, tmp_path, rivals=rivals)
    rows = {row["method"]: row for row in study.report["work_precision"]}
    assert list(rows) == ["HHR", "nearest answer", "condensed", "fom_best"]
    assert rows["nearest answer"]["dual_full_floored"] > 10 * rows["HHR"]["dual_full_floored"] > 0
    assert 0 < rows["nearest answer"]["online_s"] < rows["fom_best"]["online_s"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("flowing")


@pytest.fixture(scope="module")
def study(folder):
    rivals = lambda training: [hhr.Rival("nearest history", "2 of them", NearestHistory(training))]  # noqa: E731
    return hhr.study_scene(flowing(), SETTINGS, folder, rivals=rivals)


def test_a_study_of_histories(study):
    """Every way to answer is a row; times, parts and histories stand where those of points do."""
    report = study.report
    settings = [(row["method"], row["setting"].split(" (")[0]) for row in report["work_precision"]]
    assert settings == [
        ("HHR", "this model"), ("HHR", "as it is"), ("nearest history", "2 of them"), ("fom_best", "frozen")
    ]  # fmt: skip
    ours, _, nearest, exact = report["work_precision"]
    assert nearest["primal_l2"] > 10 * ours["primal_l2"] > exact["primal_l2"] == 0.0
    assert [row["value"] for row in report["histories"]] == [0.01, 0.015]
    assert {"offline", "fom_best", "fom_searches", "condensed", "online", "parts"} == set(report["times"])
    assert set(report["times"]["fom_searches"]) == {"frozen", "tangent", "elastic"}
    assert report["stability"]["tangent"] > 0 and "active_set" not in report and "advice" not in report
    assert report["break_even"]["forces"] is None
    assert {"condensed", "indicator"} <= {item["stage"] for item in report["skipped"]}
    json.dumps(report["errors"] | report["kkt"], allow_nan=False)


def test_a_study_of_histories_finds_what_was_solved(study, folder):
    """Each step is a file, so that a study that was killed goes on."""
    assert len(list((folder / "snapshots").iterdir())) == 8
    again = hhr.train(flowing(), SETTINGS.training, folder=folder / "snapshots")
    assert again.log.skipped[0]["why"].startswith("8 of 8 answers were read from")
    assert np.array_equal(again.snapshots.displacements, study.training.snapshots.displacements)


@pytest.mark.parametrize(
    ("scene", "changes", "message"),
    [
        (flowing, {"tests": 5}, r"bodies of scene 'stacked_blocks' flow: tests = 5 must be paths"),
        (flowing, {"training": [8, 8]}, r"bodies of scene 'stacked_blocks' flow: train on a list of paths"),
        (
            partial(patch.scene, hhr.NodeToSurface),
            {},
            r"nothing flows in scene 'stacked_blocks': tests must be",
        ),
    ],
)
def test_tests_of_the_other_kind(tmp_path, scene, changes, message):
    with pytest.raises(StudyError, match=message):
        hhr.study_scene(scene(), replace(SETTINGS, **changes), tmp_path)
    assert not (tmp_path / "snapshots").exists()


def test_points_where_bodies_flow(tmp_path):
    with pytest.raises(StudyError, match="points must be paths"):
        hhr.study_scene(flowing(), SETTINGS, tmp_path, points=[[0.05, 0.0]])
