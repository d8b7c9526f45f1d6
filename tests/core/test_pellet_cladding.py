"""Pellet and cladding: geometry, the pressure on a part of a line, the recipes, the demo."""

import csv
import dataclasses
import json
import subprocess
import sys
from copy import copy
from io import StringIO
from pathlib import Path

import numpy as np
import pellet_cladding as demo
import pytest
from bare import WAIT
from hertz_half_discs import scene as hertz_scene
from rich.console import Console
from scenes import check_contact_conditions, largest_difference
from scipy.sparse import csc_matrix, issparse

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.trust import TrustLimits
from hhr_dolfinx.errors import (
    ParameterError,
    SceneError,
    SceneWarning,
    SnapshotFileWarning,
    StabilityWarning,
    UnstableModelError,
)
from hhr_dolfinx.geometries import pellet_cladding as geometry
from hhr_dolfinx.study.measure import References

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def small():
    """The scene on 280 cells."""
    return hhr.FullOrderModel(demo.scene(**demo.QUICK_MESH))


@pytest.fixture(scope="module")
def small_snapshots(small):
    return hhr.compute_snapshots(small, small.problem.parameters.grid([25, 20]))


@pytest.fixture(scope="module")
def small_reduction(small, small_snapshots):
    held_out = hhr.compute_snapshots(small, small.problem.parameters.random(20, 9))
    return hhr.build(small, small_snapshots, held_out=held_out)


def test_sizes_of_the_thesis():
    """Section 1.5.2: 6161 + 909 nodes, 101 pairs; and 61 conditions below the pellet."""
    problem = hhr.FullOrderModel(demo.scene()).problem
    assert problem.free.size == 14140 and len(problem.cell_nodes) == 6800
    assert np.bincount(problem.contact_pairs).tolist() == [101, 61]


@pytest.mark.parametrize("h1", [0.6, 0.7, 1.4, 2.234, 3.15, 5.99, 6.0])
def test_partial_pressure_is_exact(small, h1):
    """Against nodal forces integrated by hand: total 2 pi R P h1, and moment 2 pi R P h1^2 / 2 about z = 0."""
    problem = small.problem
    force = problem.loads @ problem.amplitudes(np.array([100.0, h1]))
    radial = force.reshape(-1, 2)[:, 0]
    outer = 4.1 + 2e-3 + 0.57
    z = problem.points[:, 1]
    assert radial.sum() == pytest.approx(-2 * np.pi * outer * 100 * h1, rel=1e-12)
    assert (radial * z).sum() == pytest.approx(-2 * np.pi * outer * 100 * h1**2 / 2, rel=1e-12)
    assert np.abs(force.reshape(-1, 2)[:, 1]).max() == 0
    # nothing acts above the edge that h1 lies in
    assert np.all(radial[z > h1 + 7 / 20] == 0)


def test_whole_coverage_is_the_plain_pressure(small):
    scene = demo.scene(**demo.QUICK_MESH)
    plain = hhr.Pressure(geometry.CLADDING_OUTER, hhr.Amplitude(slopes={"P1": 1.0}))
    tall = hhr.ParameterSpace(("P1", "h1"), (5.0, 0.6), (200.0, 7.0))
    with pytest.warns(SceneWarning, match=r"parameters \('h1',\) .* have no effect"):
        problem = hhr.FullOrderModel(dataclasses.replace(scene, loads=(plain,), parameters=tall)).problem
    reference = problem.loads @ problem.amplitudes(np.array([100.0, 7.0]))
    partial = small.problem.loads @ small.problem.amplitudes(np.array([100.0, 7.0]))
    assert partial == pytest.approx(reference, abs=1e-9 * np.abs(reference).max())


def test_partial_pressures_up_to_what_is_no_parameter():
    load = hhr.PartialPressure(geometry.CLADDING_OUTER, hhr.Amplitude(1.0), extent="height")
    with pytest.raises(SceneError, match="height"):
        hhr.FullOrderModel(dataclasses.replace(demo.scene(**demo.QUICK_MESH), loads=(load,)))


def test_partial_pressure_on_an_arc_is_refused():
    load = hhr.PartialPressure(11, hhr.Amplitude(1.0), extent="mu", axis=0)
    with pytest.raises(SceneError, match="not straight"):
        hhr.FullOrderModel(dataclasses.replace(hertz_scene(), loads=(load,)))


def test_pellet_may_lift_off_or_not(small):
    """The pellet is squeezed and stands on its support, so both bottoms give the same side forces."""
    held = hhr.FullOrderModel(demo.scene("held", **demo.QUICK_MESH))
    point = (170.0, 3.2)
    lifting, fixed = small.solve(point), held.solve(point)
    above, below = np.split(lifting.forces(), [21])
    assert above == pytest.approx(fixed.forces(), rel=1e-8, abs=1e-8 * fixed.forces().max())
    assert below.min() > 0
    check_contact_conditions(small.problem, lifting.displacement(), lifting.forces(), point)


def test_default_recipe(small, small_snapshots, small_reduction):
    """Measured on 280 cells: 1e-6 median, 4e-4 at worst; the full mesh is checked by the demo."""
    points = small.problem.parameters.random(40, 3)
    errors = References.at(points, small, small_snapshots).errors(small_reduction)
    assert errors.values["dual_full_floored"].max() < 0.01
    assert errors.values["primal_l2"].max() < 0.005
    assert errors.unanswered == 0 and not any(small_reduction.solve(point).cycled for point in points)


def test_dual_deim_and_layers_extend_the_rid(small, small_snapshots):
    plain = hhr.Recipe.thesis(1e-4, domain=hhr.Rid(0, 1), trust=None)
    more = {"nodes": (hhr.Deim(), hhr.ForceDeim(1e-4), hhr.LoadNodes())}
    sizes = []
    for changes in ({}, more, {**more, "domain": hhr.Rid(1, 1)}):
        reduction = hhr.build(small, small_snapshots, dataclasses.replace(plain, **changes)).offline
        sizes.append((len(reduction.sets.A_lambda), len(reduction.sets.cells)))
    assert sizes[0] < sizes[1] < sizes[2]


def test_extended_pod_keeps_the_rid(small, small_snapshots):
    nodes = (hhr.Deim(hhr.Pod(1e-5)), hhr.ForceDeim(1e-3), hhr.LoadNodes())
    recipe = hhr.Recipe.thesis(1e-5, nodes=nodes, trust=None)
    first = hhr.build(small, small_snapshots, recipe).offline
    second = hhr.build(small, small_snapshots, dataclasses.replace(recipe, basis=hhr.Pod(1e-6))).offline
    assert np.array_equal(first.sets.cells, second.sets.cells)
    modes = [r.basis.shape[1] - len(r.enrichment.added) for r in (first, second)]
    assert modes[0] < modes[1]


def test_trust_check_grows_the_rid_or_refuses(small, small_snapshots):
    """A limit that only a larger RID meets: the model grows and says what was refused on the way."""
    base = hhr.Recipe.thesis(1e-8, nodes=(hhr.Deim(), hhr.ForceDeim(1e-4), hhr.LoadNodes()))
    conditions = []
    for layers in (0, 3):
        recipe = dataclasses.replace(base, domain=hhr.Rid(layers, layers), trust=None)
        conditions.append(hhr.build(small, small_snapshots, recipe).offline.stability.cond_K)
    assert conditions[1] < conditions[0]
    limit = np.sqrt(conditions[0] * conditions[1])
    loose = dict.fromkeys(("refuse_primal", "refuse_dual", "warn_primal", "warn_dual", "warn_worst"), np.inf)
    quiet = {"warn_cond_K": np.inf, "warn_definite": -np.inf, **loose}
    between = TrustLimits(refuse_cond_K=limit, refuse_distortion=0.0, **quiet)
    grown = hhr.build(small, small_snapshots, dataclasses.replace(base, trust=between, domain=hhr.Rid(0, 3))).offline
    assert grown.log.refused and grown.log.refused[0]["layers"] == 0 < grown.layers
    assert "cond(K~)" in grown.log.refused[0]["why"]
    with pytest.raises(UnstableModelError, match="add RID layers"):
        hhr.build(small, small_snapshots, dataclasses.replace(base, trust=between))


def test_held_out_solutions_refuse_what_constants_let_pass(small, small_snapshots):
    """Two snapshots give a small, well-conditioned model with errors of hundreds of per cent."""
    poor = small_snapshots.take([0, -1])
    hhr.build(small, poor)
    held_out = hhr.compute_snapshots(small, small.problem.parameters.random(20, 9))
    with pytest.raises(UnstableModelError, match="solutions compared"):
        hhr.build(small, poor, held_out=held_out)
    wide = TrustLimits(refuse_primal=1e9, refuse_dual=1e9)
    with pytest.warns(StabilityWarning, match="solutions compared"):
        hhr.build(small, poor, hhr.Recipe(trust=wide), held_out)


def test_model_file_with_partial_pressure(small_reduction, tmp_path):
    hhr.save_model(tmp_path / "model.npz", small_reduction)
    stored = hhr.load_model(tmp_path / "model.npz")
    for point in ((170.0, 3.2), (30.0, 5.25)):
        assert largest_difference(stored.solve(point).forces(), small_reduction.solve(point).forces()) < 1e-12


def with_problem(full, **changes):
    """The full model with another problem, as a store sees it."""
    other = copy(full)
    other.problem = dataclasses.replace(full.problem, **changes)
    return other


@pytest.fixture
def store(small, tmp_path):
    return hhr.SnapshotStore(tmp_path, small)


def test_snapshots_are_not_solved_twice(small, store, tmp_path, monkeypatch):
    points = small.problem.parameters.grid([3, 2])
    first = hhr.compute_snapshots(small, points, store=store)
    assert len(list(tmp_path.glob("*.npz"))) == 6 and not list(tmp_path.glob("*.part"))
    monkeypatch.setattr(small, "solve", lambda *_, **__: pytest.fail("solved again"))
    again = hhr.compute_snapshots(small, points, store=hhr.SnapshotStore(tmp_path, small))
    for name in ("displacements", "forces", "active"):
        assert np.array_equal(getattr(first, name), getattr(again, name))


def test_a_killed_run_goes_on(small, store, tmp_path, monkeypatch):
    points = small.problem.parameters.grid([3, 2])
    solve, calls = small.solve, []

    def dies(point, **options):
        calls.append(point)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return solve(point, **options)

    monkeypatch.setattr(small, "solve", dies)
    with pytest.raises(KeyboardInterrupt):
        hhr.compute_snapshots(small, points, store=store)
    hhr.compute_snapshots(small, points, store=store)
    assert len(calls) == 4 + 3


def test_damaged_and_foreign_snapshots_are_not_used(small, store, tmp_path):
    points = small.problem.parameters.grid([2, 1])
    exact = hhr.compute_snapshots(small, points, store=store)
    for file in tmp_path.glob("*.npz"):
        file.write_bytes(file.read_bytes()[:-100])
    with pytest.warns(SnapshotFileWarning, match="solved anew"):
        again = hhr.compute_snapshots(small, points, store=store)
    assert np.array_equal(exact.forces, again.forces)
    softer = with_problem(small, stiffness_terms=(0.5 * small.problem.stiffness,))
    assert hhr.SnapshotStore(tmp_path, softer).load(points[0]) is None


def test_batch_answers_good_rows_and_names_bad_ones(small, small_reduction, tmp_path):
    table = tmp_path / "points.csv"
    table.write_text("h1,P1\n3.2,170\n3.2,nan\nnine,100\n3.2,500\n,100\n5.25,30\n")
    rows, console = hhr.read_points(table, small.parameters), Console(file=StringIO(), width=200)
    assert hhr.answer_table(small_reduction, rows, tmp_path / "answers.csv", console) == 4
    said = console.file.getvalue()
    assert "4 bad rows" in said and "line 5 (500, 3.2): P1 = 500 is outside" in said
    header, *answers = csv.reader((tmp_path / "answers.csv").read_text().splitlines())
    bounds = [f"bound of {name}" for name in ("displacement", "forces", "pressure", "forces in energy")]
    assert header[:9] == ["P1", "h1", "status", "total_force", *bounds, "force_0"]
    assert len(answers) == 6
    status = [row[2] for row in answers]
    assert [text == "ok" for text in status] == [True, False, False, False, False, True]
    assert "P1 = 500 is outside [5, 200]" in status[3] and "nine" in status[2]
    forces = small_reduction.solve((170.0, 3.2)).forces()
    assert [float(value) for value in answers[0][8:]] == pytest.approx(forces, rel=1e-11)


def test_batch_without_a_column_or_file(small, tmp_path):
    (tmp_path / "points.csv").write_text("P1\n1\n")
    with pytest.raises(ParameterError, match="h1"):
        hhr.read_points(tmp_path / "points.csv", small.problem.parameters)
    with pytest.raises(ParameterError, match="no table"):
        hhr.read_points(tmp_path / "none.csv", small.problem.parameters)


def run_demo(*arguments, cwd, ranks=1):
    from test_mpi import launch

    return launch(ranks, [str(ROOT / "benchmarks/thesis/pellet_cladding.py"), "--quick", *arguments], cwd)


def test_batch_on_two_ranks_gives_the_same_numbers(tmp_path):
    points = np.random.default_rng(0).uniform((5, 0.6), (200, 6), (40, 2))
    np.savetxt(tmp_path / "points.csv", points, delimiter=",", header="P1,h1", comments="")
    texts = []
    for ranks in (1, 2):
        out = tmp_path / f"out{ranks}"
        output = run_demo("--batch", "points.csv", "--out", str(out), cwd=tmp_path, ranks=ranks)
        assert f"40 answers and 0 bad rows on {ranks} ranks" in output
        texts.append((out / "answers.csv").read_text())
    assert texts[0] == texts[1]


def test_quick_demo(tmp_path):
    run_demo("--out", "out", cwd=tmp_path)
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["errors"]["dual_full_floored"]["max"] < 0.05
    assert report["errors"]["unconverged"] == 0
    methods = {row["method"] for row in report["work_precision"]}
    assert {"HHR", "condensed", "cone-projected greedy", "NNMF", "coarser mesh", "fom_best", "fom_naive"} <= methods
    assert report["thesis_size"]["ell_bar"] <= 60 and report["thesis_size"]["N_lambda_C"] <= 40
    for name in ("fields.png", "map_dual_full_floored.png", "map_dual_rid_floored.png", "pressures.png"):
        assert (tmp_path / "out" / name).stat().st_size > 5000, name


def test_extreme_cases(tmp_path):
    """No silent wrong answer: the demo ends with 1 if there is one."""
    command = [sys.executable, str(ROOT / "benchmarks/extreme_cases.py"), "--quick", "--out", str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=WAIT)
    rows = json.loads((tmp_path / "extreme_cases.json").read_text())
    assert not [row for row in rows if row["outcome"] == "WRONG"]
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-2000:]
    assert {row["outcome"] for row in rows} <= {"right", "warned", "refused"}
    assert all(row["why"] for row in rows)
    full = {row["case"]: row["outcome"] for row in rows if row["model"] == "full"}
    assert full.pop("pellet held by contact only") == "refused"
    assert full.pop("H < 0") == "refused"
    # a fluid: locked, it seemed to bear the pressure
    assert full.pop("Norton K times 1e-3") == "refused"
    assert full.pop("tube beyond its limit load") == "refused"
    assert set(full.values()) == {"right"}
    assert outcomes(rows, "known answer") == {
        "forces 1e11 apart": "right",
        "strips .02 thick, mortar without normal": "right",
        "overlap of the sag of facets": "warned",
        "overlap ten times the sag of facets": "right",
        "tube beyond its limit load": "right",
        "Norton tube": "right",
        "Norton tube of triangles": "warned",
    }
    reduced = outcomes(rows, "reduced")
    for name in ("press fit, contact never opens", "three shrink-fitted rings", "far obstacle at 1e8",
                 "pellet 1e-6 times as stiff", "pellet 1e6 times as stiff", "stresses in GPa"):  # fmt: skip
        assert reduced[name] == "right", name
    untrained = [name for name in reduced if name.startswith("not trained: ")]
    assert len(untrained) == 4
    for name in (*untrained, "half-discs, thesis recipe"):
        assert reduced[name] == "warned", name
    assert any("no training solution has contact" in row["why"] for row in rows if row["model"] == "reduced")
    cases = json.loads((tmp_path / "report.json").read_text())["cases"]
    assert [(row["case"], row["outcome"]) for row in cases] == [(row["case"], row["outcome"]) for row in rows]


def outcomes(rows, model):
    """Outcome by case of one kind of row."""
    return {row["case"]: row["outcome"] for row in rows if row["model"] == model}


def test_every_change_of_the_problem_gives_other_snapshots(small, store, tmp_path):
    """Small numbers beside large ones count too: a force of 0.1 beside 1e11, a gap beside a unit lift."""
    point = np.array([100.0, 3.0])
    store.save(small.solve(point))
    for name in ("loads", "gaps", "lifts"):
        value = getattr(small.problem, name)
        change = csc_matrix(([1e-9], ([value.shape[0] - 1], [value.shape[1] - 1])), shape=value.shape)
        changed = value + (change if issparse(value) else change.toarray())
        other = hhr.SnapshotStore(tmp_path, with_problem(small, **{name: changed}))
        assert other.load(point) is None
    assert store.load(point) is not None
