"""Without the columns of K^-1 B^T: the same answers, by one more solution where a displacement is asked for."""

from __future__ import annotations

import dataclasses
import re

import contract
import numpy as np
import pytest
import sphere_on_block
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.full_order import full as full_order
from hhr_dolfinx.linear import sparse
from hhr_dolfinx.models.exact import SolvedFields

SCENES = {
    "constant": (contract.blocks, contract.MIDDLE),
    "moduli of whole bodies": (
        lambda: contract.blocks(("E1", 0.3), box=contract.MODULI), contract.VARIED,
    ),
    "Poisson's ratios": (lambda: contract.blocks((3.0, "n"), box={"n": (0.1, 0.4)}), {**contract.MIDDLE, "n": 0.25}),
    "bodies held by contact": (lambda: contract.blocks(free=True), contract.PRESSED),
    "friction": (lambda: contract.blocks(friction=0.2), contract.MIDDLE),
    "second order": (lambda: dataclasses.replace(contract.blocks(), order=2), contract.MIDDLE),
}  # fmt: skip


def both(make, monkeypatch):
    """A full model that keeps its columns, and one that has no room for them."""
    kept = hhr.FullOrderModel(make(), MPI.COMM_SELF)
    monkeypatch.setattr(full_order, "KEPT_BYTES", 0)
    return kept, hhr.FullOrderModel(make(), MPI.COMM_SELF)


@pytest.mark.parametrize("name", SCENES)
def test_answers_are_the_same(name, monkeypatch):
    make, mu = SCENES[name]
    kept, lean = both(make, monkeypatch)
    # bodies that contact alone holds rest on what resists no motion of theirs
    assert kept.keeps_columns and lean.keeps_columns == (lean.problem.resting is not None)
    exact, found = kept.solve(mu, gradient=True), lean.solve(mu, gradient=True)
    for pick in (
        lambda answer: answer.forces(), lambda answer: answer.displacement(), lambda answer: answer.gradient.unknown,
        lambda answer: answer.gradient.multipliers, lambda answer: np.array(list(answer.outputs().values.values())),
    ):  # fmt: skip
        np.testing.assert_allclose(pick(found), pick(exact), rtol=0, atol=1e-10 * np.abs(pick(exact)).max())
    assert lean.keeps_columns or lean._columns is None


def test_exact_condensation_keeps_rows_of_outputs_only(monkeypatch, tmp_path):
    """Forces and outputs from a file too; a displacement where the factors are."""

    def make():
        outputs = (*contract.blocks().outputs, hhr.DisplacementAt("u", (2.0, 2.0), 0), hhr.VonMises("stress", 1))
        return dataclasses.replace(contract.blocks(), outputs=outputs)

    kept, lean = both(make, monkeypatch)
    statuses = hhr.compute_snapshots(kept, kept.parameters.random(8, 0)).known_statuses()
    whole = hhr.exact_condensation(kept, statuses)
    model = hhr.exact_condensation(lean, statuses)
    assert isinstance(model.fields, SolvedFields) and lean._columns is None
    for point in kept.parameters.random(4, 1):
        exact, found = whole.solve(point, gradient=True), model.solve(point, gradient=True)
        scale = np.abs(exact.displacement()).max()
        np.testing.assert_allclose(found.displacement(), exact.displacement(), atol=1e-11 * scale)
        np.testing.assert_allclose(found.stress(), exact.stress(), atol=1e-10 * np.abs(exact.stress()).max())
        for one, other in ((found.outputs(), exact.outputs()),):
            np.testing.assert_allclose(list(one.values.values()), list(other.values.values()), rtol=1e-9)
            for key, slopes in other.gradient.items():
                np.testing.assert_allclose(one.gradient[key], slopes, rtol=1e-8, atol=1e-9 * np.abs(slopes).max())
    hhr.save_model(tmp_path / "model.npz", model)
    again = hhr.load_model(tmp_path / "model.npz").solve(point)
    np.testing.assert_allclose(again.forces(), exact.forces(), rtol=1e-9, atol=1e-12)
    assert again.outputs()["u"] == pytest.approx(exact.outputs()["u"], rel=1e-9)
    with pytest.raises(NotOfferedError, match="has no factors"):
        again.displacement()


def test_columns_are_there_for_what_needs_them(monkeypatch):
    """A hyper-reduced model and its bound are built on them."""
    make, mu = SCENES["constant"]
    kept, lean = both(make, monkeypatch)
    snapshots = hhr.compute_snapshots(kept, kept.parameters.random(12, 0))
    one, other = (hhr.build(full, snapshots, contract.AS_IT_IS).solve(mu) for full in (kept, lean))
    np.testing.assert_allclose(other.forces(), one.forces(), rtol=1e-8, atol=1e-12)
    assert other.estimate().dual == pytest.approx(one.estimate().dual, rel=1e-4, abs=1e-9)


def test_a_check_says_what_a_large_scene_takes(tmp_path):
    """Measured on one core: 96,288 dofs and 1089 conditions .64 GB and 9 s for factors, .010 s a column."""
    from hhr_dolfinx.study.scene.check import check_scene

    def told(cells):
        scene = sphere_on_block.scene(sphere_cells=(cells, cells // 2), block_cells=(cells, cells // 2))
        texts = [finding.text for finding in check_scene(scene).findings]
        return next(text for text in texts if "conditions of contact" in text)

    assert "a full model takes" not in told(8)
    large = told(22)
    assert re.search(r"\d+ dofs and 529 conditions of contact: a full model takes about 0\.\d+ GB and \d", large), large


def test_compressed_factors_are_refined(monkeypatch):
    """Blocks of low rank: a solution is that of whole factors to round-off, forces to what blocks leave out."""
    make = lambda: sphere_on_block.scene(sphere_cells=(16, 8), block_cells=(12, 6))  # noqa: E731
    whole = hhr.FullOrderModel(make(), MPI.COMM_SELF)
    monkeypatch.setattr(sparse, "LOW_RANK", ((0, 1e-10),))
    compressed = hhr.FullOrderModel(make(), MPI.COMM_SELF)
    mu = whole.parameters.middle
    problem = whole.problem
    known = np.random.default_rng(0).standard_normal(problem.free.size) * problem.held
    loads = (problem.stiffness @ known) * problem.held
    np.testing.assert_allclose(compressed.solve_stiffness(loads), known, atol=1e-10)
    exact, found = whole.solve(mu).forces(), compressed.solve(mu).forces()
    assert np.linalg.norm(found - exact) < 1e-7 * np.linalg.norm(exact)
    assert 0 < np.abs(compressed.schur - whole.schur).max() < 1e-8 * np.abs(whole.schur).max()
