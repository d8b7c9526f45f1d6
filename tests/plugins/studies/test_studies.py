"""One study for scenes that are elastic and scenes that flow: rivals, variants, resumption, nothing
needless loaded.
"""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from unittest.mock import Mock

import contact_patch_test as patch
import hertz_half_discs as discs
import numpy as np
import pytest
from needs import needs
from scenes import pressed_block
from toy_rival import NearestAnswer, NearestHistory

import hhr_dolfinx as hhr
from hhr_dolfinx.command.console import make_console
from hhr_dolfinx.errors import ConvergenceError, StudyError, UnstableModelError
from hhr_dolfinx.plugins.studies.report import print_report
from hhr_dolfinx.plugins.studies.study import run_study

ROOT = Path(__file__).parents[3]


def elastic():
    """Two blocks, pushed together and aside."""
    return patch.scene(hhr.NodeToSurface, (3, 2), (4, 3), poisson=0.3)


def flowing():
    """The same blocks, the upper of which yields."""
    base = elastic()
    bodies = tuple(
        replace(body, law=hhr.Plasticity(0.05, 0.5)) if body.tag == 2 else body
        for body in base.bodies
    )
    return replace(base, bodies=bodies)


def pushed(side, steps=4):
    """Ten hundredths down and aside, in a second."""
    return [
        (share, np.array([0.05 * share, side * share])) for share in np.arange(steps + 1) / steps
    ]


@cache
def settings_of_paths():
    return hhr.StudySettings(
        [pushed(0.0), pushed(0.02)],
        hhr.Recipe.flowing(trust=None),
        variants=[("as it is", hhr.Recipe.flowing(trust=None, domain=hhr.Rid(0, 0)))],
        tests={0.01: pushed(0.01), 0.015: pushed(0.015)},
        repetitions=1,
    )


def test_a_rival_of_one_file_is_a_row(tmp_path):
    settings = hhr.StudySettings([8], tests=3, queries=2, held_out=5, naive=False)

    def rivals(training):
        return [hhr.Rival("nearest answer", "8 points", NearestAnswer(training))]

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
    def rivals(training):
        return [hhr.Rival("nearest history", "2 of them", NearestHistory(training))]

    return hhr.study_scene(flowing(), settings_of_paths(), folder, rivals=rivals)


@needs("inelastic")
def test_a_study_of_histories(study):
    """Every way to answer is a row; times, parts and histories stand where those of points do."""
    report, searches = study.report, study.report["times"]["fom_searches"]
    methods = [row["method"] for row in report["work_precision"]]
    assert methods == ["HHR", "HHR", "nearest history", "condensed", "fom_best"]
    ours, _, nearest, condensed, exact = report["work_precision"]
    assert [row["setting"].split(" (")[0] for row in (ours, nearest)] == ["this model", "2 of them"]
    assert nearest["primal_l2"] > 10 * ours["primal_l2"] > exact["primal_l2"] == 0.0
    assert nearest["primal_l2"] > 10 * condensed["primal_l2"] > 0.0
    assert [row["value"] for row in report["histories"]] == [0.01, 0.015]
    names = {
        "offline",
        "offline_condensed",
        "fom_best",
        "fom_searches",
        "condensed",
        "online",
        "parts",
    }
    assert names == set(report["times"])
    # the fastest one is what reduced histories are held against
    assert (
        set(searches) == {"frozen", "tangent", "elastic"}
        and min(searches, key=searches.get) == exact["setting"]
    )
    assert report["stability"]["tangent"] > 0 and "active_set" not in report
    skipped = {item["stage"] for item in report["skipped"]}
    assert "indicator" in skipped and not skipped & {"HHR", "condensed"}
    json.dumps(report["errors"] | report["kkt"], allow_nan=False)


@needs("inelastic")
def test_condensed_flow_beside_the_hyper_reduced_model(study):
    """Its sizes, its own check, its errors, alone and per history, when it pays, and an advice that
    quotes both.
    """
    report, model = study.report, study.measured.models["condensed"]
    told, record = report["models"]["condensed"], model.offline
    assert told["sizes"] == {
        "modes": record.modes,
        "points": record.points,
        "candidates": record.candidates,
    }
    row = next(row for row in report["work_precision"] if row["method"] == "condensed")
    assert row["setting"] == f"{record.modes} modes, {record.points} points"
    assert told["check"]["misfit"] == record.misfit and told["check"]["energy"] == record.energy
    assert [item["history"] for item in told["check"]["compared"]] == record.comparison.labels
    assert len(told["refused_before"]) == len(record.log.refused)
    # it has no RID in which to compare
    missing = set(report["errors"]) - set(told["errors"])
    assert missing == {"dual_rid", "dual_rid_floored", "stress_rr", "plastic_strain"}
    assert report["models"]["hhr"]["errors"] == report["errors"]
    for history, key in (
        (history, key) for history in report["histories"] for key in told["errors"]
    ):
        assert 0 <= history["condensed"][key] <= told["errors"][key]["max"]
    assert report["times"]["offline_condensed"] == record.log.times
    assert report["ratios"]["fom_best/condensed"] > 0 and report["ratios"]["fom_best/online"] > 0
    assert set(report["break_even"]) == {"forces", "fields", "fields, condensed"}
    assert report["break_even"]["forces"] is None
    assert (
        "condensed flow: " in report["advice"].lower()
        and "the hyper-reduced model: " in report["advice"].lower()
    )


@needs("inelastic")
@pytest.mark.parametrize("method", ["HHR", "condensed"])
def test_a_method_that_is_refused_has_its_reason_in_its_place(study, monkeypatch, method):
    """The study goes on with the other one, which then is the model under study."""

    refuse = Mock(side_effect=UnstableModelError("it cannot be trusted"))
    monkeypatch.setattr(type(study.training), "build" if method == "HHR" else "condense", refuse)
    again = run_study(study.training, replace(settings_of_paths(), variants=()))
    report = again.report
    other, time, key = (
        ("condensed", "online", "hhr") if method == "HHR" else ("HHR", "condensed", "condensed")
    )
    rows = {row["method"]: row for row in report["work_precision"]}
    assert (
        list(rows) == [other, "fom_best", method]
        and rows[method]["refused"] == "it cannot be trusted"
    )
    assert {"stage": method, "why": "it cannot be trusted"} in report["skipped"]
    assert report["times"][time] is None and report["ratios"][f"fom_best/{time}"] is None
    assert report["models"][key] == {"refused": "it cannot be trusted"}
    name = "condensed flow" if other == "condensed" else "the hyper-reduced model"
    assert (
        report["advice"].startswith(f"Use {name}: ")
        and "is refused here: it cannot be trusted" in report["advice"]
    )
    print_report(report, make_console(quiet=True))
    monkeypatch.setattr(type(study.training), "build" if method != "HHR" else "condense", refuse)
    with pytest.raises(UnstableModelError, match="cannot be trusted"):
        run_study(study.training, replace(settings_of_paths(), variants=()))


@needs("inelastic")
def test_a_path_without_an_answer_counts(study, monkeypatch):
    """With infinite errors and the time it took; the others are measured."""
    kind = type(study.measured.models["condensed"])
    solve = kind.march

    def march(model, path, settings):
        if path[-1][1][1] == 0.015:
            raise ConvergenceError("step 1 did not converge")
        return solve(model, path, settings)

    monkeypatch.setattr(kind, "march", march)
    monkeypatch.setattr(
        type(study.training),
        "condense",
        lambda training, settings: study.measured.models["condensed"],
    )
    report = run_study(study.training, replace(settings_of_paths(), variants=())).report
    row = next(row for row in report["work_precision"] if row["method"] == "condensed")
    assert row["unconverged"] == 1 and row["primal_l2_max"] == np.inf
    first, second = (history["condensed"] for history in report["histories"])
    assert first["primal_l2"] < 0.1 and second["failed"] == "step 1 did not converge"
    assert report["advice"].startswith("Use the hyper-reduced model: ")
    assert "1 of the test paths have no answer" in report["advice"]


@needs("inelastic")
def test_both_models_on_paths(study):
    """On a path of the family, and on one never trained, of which both warn."""
    full, models = study.training.full_order, study.measured.models
    from paths import PathCase, summarise_paths, try_path

    cases = [PathCase("between", pushed(0.012), True), PathCase("far aside", pushed(0.045), False)]
    rows = [try_path(full, models, case, 0.0, settings_of_paths().march) for case in cases]
    for name in models:
        found = summarise_paths(row[name] for row in rows)
        assert found["inside"]["displacement"]["max"] < 0.01 and found["outside"]["warned"] == 1
        assert rows[1][name]["warned"] and rows[1][name]["estimate"] > 0


@needs("inelastic")
def test_a_study_of_histories_finds_what_was_solved(study, folder):
    """Each step is a file, so that a study that was killed goes on."""
    assert len(list((folder / "snapshots").iterdir())) == 8
    again = hhr.train(flowing(), settings_of_paths().training, folder=folder / "snapshots")
    assert again.log.skipped[0]["why"].startswith("8 of 8 answers were read from")
    assert np.array_equal(again.snapshots.displacements, study.training.snapshots.displacements)


@needs("inelastic")
@pytest.mark.parametrize(
    ("scene", "changes", "message"),
    [
        (
            flowing,
            {"tests": 5},
            r"bodies of scene 'stacked_blocks' have laws: tests = 5 must be paths",
        ),
        (
            flowing,
            {"training": [8, 8]},
            r"answers of scene 'stacked_blocks' depend on the path .* on a list of paths",
        ),
        (flowing, {"correction": 3}, "correction = 3 of a study must be CorrectionSettings"),
        (flowing, {"points": [[0.05, 0.0]]}, "points must be paths"),
        (elastic, {}, r"bodies of scene 'stacked_blocks' are elastic: tests must be"),
        (
            elastic,
            {"training": [8, 8], "tests": 5, "correction": "usual"},
            r"are elastic: leave out the correction",
        ),
    ],
)
def test_what_is_of_the_other_kind(tmp_path, scene, changes, message):
    from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

    points, usual = changes.get("points"), {"correction": CorrectionSettings()}
    changed = {name: value for name, value in changes.items() if name != "points"}
    changed |= usual if changes.get("correction") == "usual" else {}
    with pytest.raises(StudyError, match=message):
        hhr.study_scene(scene(), replace(settings_of_paths(), **changed), tmp_path, points=points)
    assert not (tmp_path / "snapshots").exists()


def test_what_was_read_from_files_is_paid_for_too(tmp_path):
    """A training that is repeated from its folder pays after as many queries, not after few."""
    scene, settings = pressed_block("plane_strain"), hhr.StudySettings([9], tests=3, queries=6)
    first, again = (hhr.study_scene(scene, settings, tmp_path).report for _ in range(2))
    stage = "answers read from files"
    assert stage not in first["times"]["offline"]
    found = again["times"]["offline"][stage]
    read = int(again["skipped"][0]["why"].split()[0])
    assert read >= 9 and found == pytest.approx(read * again["times"]["fom_best"]["median"])
    even, times = again["break_even"], again["times"]
    saved = times["fom_best"]["median"] - times["online_forces"]["median"]
    assert even["forces"] == (
        pytest.approx(sum(times["offline"].values()) / saved) if saved > 0 else None
    )
