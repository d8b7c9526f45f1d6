"""Without the columns of K^-1 B^T: the same answers, by one more solution where a displacement is asked for."""

from __future__ import annotations

import dataclasses
import re

import contract
import numpy as np
import pytest
import sphere_on_block
from mpi4py import MPI
from needs import needs, present
from petsc4py import PETSc
from scipy.sparse import csc_matrix

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, NotSolvableError
from hhr_dolfinx.full_order import full as full_order
from hhr_dolfinx.linear import schur, sparse
from hhr_dolfinx.models.exact import SolvedFields
from hhr_dolfinx.models.starts import KnownStatuses

SCENES = {
    "constant": (contract.blocks, contract.MIDDLE),
    "moduli of whole bodies": (
        lambda: contract.blocks(("E1", 0.3), box=contract.MODULI), contract.VARIED,
    ),
    "Poisson's ratios": (lambda: contract.blocks((3.0, "n"), box={"n": (0.1, 0.4)}), {**contract.MIDDLE, "n": 0.25}),
    **(
        {"bodies held by contact": (lambda: contract.blocks(free=True), contract.PRESSED)}
        if present("floating")
        else {}
    ),
    "friction": (lambda: contract.blocks(friction=0.2), contract.MIDDLE),
    "second order": (lambda: dataclasses.replace(contract.blocks(), order=2), contract.MIDDLE),
}  # fmt: skip


def both(make, monkeypatch):
    """A full model that keeps its columns, and one that has no room for them."""
    kept = hhr.FullOrderModel(make(), MPI.COMM_SELF)
    monkeypatch.setattr(full_order, "KEPT_BYTES", 0)
    return kept, hhr.FullOrderModel(make(), MPI.COMM_SELF)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=needs(name.replace(" ", "_")) if name in ("friction", "second order") else ())
        for name in SCENES
    ],
)
def test_answers_are_the_same(name, monkeypatch):
    make, mu = SCENES[name]
    kept, lean = both(make, monkeypatch)
    # bodies that contact alone holds rest on what resists no motion of theirs
    assert kept.keeps_columns and lean.keeps_columns == (lean.problem.kernel is not None)
    exact, found = kept.solve(mu, gradient=True), lean.solve(mu, gradient=True)
    for pick in (
        lambda answer: answer.forces(), lambda answer: answer.displacement(), lambda answer: answer.gradient.unknown,
        lambda answer: answer.gradient.multipliers, lambda answer: np.array(list(answer.outputs().values.values())),
    ):  # fmt: skip
        np.testing.assert_allclose(pick(found), pick(exact), rtol=0, atol=1e-10 * np.abs(pick(exact)).max())
    assert lean.keeps_columns or not lean.stiffness.has_response


@needs("stress")
def test_exact_condensation_keeps_rows_of_outputs_only(monkeypatch, tmp_path):
    """Forces and outputs from a file too; a displacement where the factors are."""

    def make():
        outputs = (*contract.blocks().outputs, hhr.DisplacementAt("u", (2.0, 2.0), 0), hhr.VonMises("stress", 1))
        return dataclasses.replace(contract.blocks(), outputs=outputs)

    kept, lean = both(make, monkeypatch)
    monkeypatch.undo()  # rows of outputs have room
    statuses = hhr.compute_snapshots(kept, kept.parameters.random(8, 0)).known_statuses()
    whole = hhr.exact_condensation(kept, statuses)
    model = hhr.exact_condensation(lean, statuses)
    assert isinstance(model.fields, SolvedFields) and not lean.stiffness.has_response
    for point in kept.parameters.random(4, 1):
        exact, found = whole.solve(point, gradient=True), model.solve(point, gradient=True)
        scale = np.abs(exact.displacement()).max()
        np.testing.assert_allclose(found.displacement(), exact.displacement(), atol=1e-11 * scale)
        np.testing.assert_allclose(found.stress(), exact.stress(), atol=1e-10 * np.abs(exact.stress()).max())
        one, other = found.outputs(), exact.outputs()
        np.testing.assert_allclose(list(one.values.values()), list(other.values.values()), rtol=1e-9)
        for key, slopes in other.gradient.items():
            np.testing.assert_allclose(one.gradient[key], slopes, rtol=1e-8, atol=1e-9 * np.abs(slopes).max())
    hhr.save_model(tmp_path / "model.npz", model)
    again = hhr.load_model(tmp_path / "model.npz").solve(point)
    np.testing.assert_allclose(again.forces(), exact.forces(), rtol=1e-9, atol=1e-12)
    assert again.outputs()["u"] == pytest.approx(exact.outputs()["u"], rel=1e-9)
    with pytest.raises(NotOfferedError, match="has no factors"):
        again.displacement()


def pressed_by_sphere(sphere, block):
    """Of mortar, if there is any; what is tested here does not depend on it."""
    pairing = hhr.Mortar if present("mortar") else hhr.NodeToSurface
    return sphere_on_block.scene(pairing, sphere_cells=sphere, block_cells=block)


def pressed_sphere(*outputs, cells=8, moduli=False):
    """A scene in space of some hundred conditions."""
    plain = pressed_by_sphere((cells, cells // 2), (cells - 2, cells // 2))
    if not moduli:
        return dataclasses.replace(plain, outputs=outputs)
    bodies = tuple(dataclasses.replace(body, young=f"E{k}") for k, body in enumerate(plain.bodies))
    box = plain.parameters
    space = hhr.ParameterSpace((*box.names, "E0", "E1"), (*box.lower, 1e5, 5e4), (*box.upper, 3e5, 9e4))
    return dataclasses.replace(plain, bodies=bodies, parameters=space, outputs=outputs)


@needs("nonmatching", "stress")
def test_reduced_models_and_estimates_need_no_columns(monkeypatch):
    """Hyper-reduction and its estimates take a solution for each mode in the place of one for each row."""
    tag = sphere_on_block.geometry.SPHERE
    outputs = (hhr.DisplacementAt("u", (0.0, 0.0, 0.0), 2, tag), hhr.VonMises("stress", tag))
    kept, lean = both(lambda: pressed_sphere(*outputs, cells=12), monkeypatch)
    point = kept.parameters.middle
    snapshots = hhr.compute_snapshots(kept, kept.parameters.random(12, 0))
    one, other = (hhr.build(full, snapshots, contract.AS_IT_IS).solve(point) for full in (kept, lean))
    np.testing.assert_allclose(other.forces(), one.forces(), atol=1e-9 * one.forces().max())
    mine, theirs = one.estimate(), other.estimate()
    for name in ("primal", "dual", "forces_euclid", "pressure"):
        assert getattr(theirs, name) == pytest.approx(getattr(mine, name), rel=1e-4)
    assert theirs.outputs == pytest.approx(dict(mine.outputs), rel=1e-4)
    assert not lean.stiffness.has_response


@needs("nonmatching", "stress")
def test_outputs_with_many_rows_are_read_at_displacements(monkeypatch):
    """A largest stress has six rows for each cell: values and derivatives by one more solution each."""
    kept, lean = both(lambda: pressed_sphere(hhr.VonMises("stress", sphere_on_block.geometry.SPHERE)), monkeypatch)
    nothing = KnownStatuses(kept.problem.middle[None], np.zeros((1, kept.conditions), dtype=bool))
    one, other = (hhr.exact_condensation(full, nothing) for full in (kept, lean))
    assert not other.fields.measured_per_force.size
    for point in kept.parameters.random(3, 0):
        exact, found = (model.solve(point, gradient=True).outputs() for model in (one, other))
        assert found["stress"] == pytest.approx(exact["stress"], rel=1e-9)
        slopes = exact.gradient["stress"]
        np.testing.assert_allclose(found.gradient["stress"], slopes, atol=1e-7 * np.abs(slopes).max())


@needs("moduli")
def test_a_model_of_forces_alone_is_read_from_a_file(tmp_path):
    """In a scene whose outputs need displacements: forces are there, and what is not is refused by name."""
    outputs = (*contract.blocks().outputs, hhr.DisplacementAt("u", (1.7, 1.6), 0))
    scene = dataclasses.replace(contract.blocks(("E1", 0.3), box=contract.MODULI), outputs=outputs)
    model = hhr.condense(hhr.FullOrderModel(scene, MPI.COMM_SELF), fields=False)
    hhr.save_model(tmp_path / "model.npz", model)
    again = hhr.load_model(tmp_path / "model.npz").solve(contract.VARIED)
    np.testing.assert_array_equal(again.forces(), model.solve(contract.VARIED).forces())
    with pytest.raises(NotOfferedError, match="condensed for contact forces"):
        again.outputs()


def test_columns_that_are_asked_for_are_told_of(monkeypatch, caplog):
    kept, lean = both(contract.blocks, monkeypatch)
    with caplog.at_level("WARNING"):
        np.testing.assert_allclose(lean.per_force, kept.per_force, atol=1e-14)
    assert "solved for and kept" in caplog.text


class Counted:
    """Columns that factors were asked for, and inverses between dofs that were eliminated last."""

    def __init__(self, monkeypatch):
        self.count = 0
        self.inverses = 0
        plain = sparse.FreeCholesky.solved_blocks
        between = sparse.FreeCholesky.between_last

        def counted(factors, columns, *given, **how):
            self.count += columns.shape[1]
            return plain(factors, columns, *given, **how)

        def counted_between(factors, rows):
            found = between(factors, rows)
            self.inverses += found is not None
            return found

        monkeypatch.setattr(sparse.FreeCholesky, "solved_blocks", counted)
        monkeypatch.setattr(sparse.FreeCholesky, "between_last", counted_between)


@needs("moduli", "nonmatching")
@pytest.mark.parametrize("by_columns", [True, False])
def test_s_is_made_once(monkeypatch, by_columns):
    """When it is first asked for; by a model with moduli, its bound and the full order together."""
    from hhr_dolfinx.plugins.moduli import condense

    if by_columns:
        monkeypatch.setattr(schur, "_library", lambda: None)
    kept, lean = both(lambda: pressed_sphere(moduli=True), monkeypatch)
    counted = Counted(monkeypatch)
    lean = hhr.FullOrderModel(pressed_sphere(moduli=True), MPI.COMM_SELF)
    mu = kept.parameters.middle
    assert counted.count == counted.inverses == 0
    forces = hhr.condense(lean, fields=False).solve(mu).forces()
    conditions, loads = lean.conditions, lean.problem.loads.shape[1]
    least = conditions if by_columns else 0
    assert least <= counted.count <= least + 2 * loads
    inverses = 0 if by_columns else len(lean.problem.bodies)
    assert counted.inverses == inverses
    before = counted.count
    model = hhr.condense(lean, fields=True)
    answer = model.solve(mu)
    exact = kept.solve(mu)
    assert answer.estimate().kind == "bound" and answer.estimate().forces_euclid_relative < 1e-8
    assert np.linalg.norm(answer.forces() - exact.forces()) < 1e-10 * np.linalg.norm(exact.forces())
    np.testing.assert_array_equal(forces, answer.forces())
    lean.solve(mu)
    # fields, a solution for each start and body, and random forces; not S once more
    assert counted.count - before < 2 * condense.STARTS + 50 and not lean.stiffness.has_response
    assert counted.inverses == inverses


@needs("moduli")
def test_factors_that_are_let_go_are_made_anew(monkeypatch):
    """Of large components, between the stages of a model, which is the same one."""
    from hhr_dolfinx.plugins.moduli import components

    scene = contract.blocks((3.0, "n"), box={"n": (0.1, 0.4)})
    kept = hhr.condense(scene, fields=True)
    monkeypatch.setattr(components, "LARGE", 0)
    destroyed = []
    plain = sparse.FreeCholesky.release
    monkeypatch.setattr(sparse.FreeCholesky, "release", lambda factors: destroyed.append(plain(factors)))
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    exact = [full.solve(point) for point in full.parameters.random(4, 1)]
    model = hhr.condense(full, fields=True)
    assert len(destroyed) >= 5  # of two components, where S is made, and its fields, and of the full model
    for known in exact:
        again = full.solve(known.parameter)
        np.testing.assert_allclose(again.displacement(), known.displacement(), rtol=0, atol=1e-14)
    for point in model.parameters.random(4, 1):
        answer, known = model.solve(point), kept.solve(point)
        np.testing.assert_allclose(answer.forces(), known.forces(), rtol=0, atol=1e-12 * known.forces().max())
        np.testing.assert_allclose(answer.displacement(), known.displacement(), rtol=0, atol=1e-10)
        assert answer.estimate().forces_euclid == pytest.approx(known.estimate().forces_euclid, rel=1e-3)


@needs("checks", "nonmatching")
def test_a_check_says_what_a_large_scene_takes(tmp_path):
    """Measured on one core: 96,288 dofs and 1089 conditions .64 GB and 9 s for factors, .010 s a column."""
    from hhr_dolfinx.plugins.checks.check import check_scene

    def told(cells):
        scene = pressed_by_sphere((cells, cells // 2), (cells, cells // 2))
        texts = [finding.text for finding in check_scene(scene).findings]
        return next(text for text in texts if "conditions of contact" in text)

    assert "a full model takes" not in told(8)
    large = told(22)
    assert re.search(r"\d+ dofs and 529 conditions of contact: a full model takes about 0\.\d+ GB and \d", large), large


@pytest.fixture
def told_to_compress(monkeypatch):
    """A full model whose factors MUMPS compresses, of which nothing is left out of so small a problem."""
    monkeypatch.setattr(sparse, "LOW_RANK", ((0, 1e-10),))
    full = hhr.FullOrderModel(pressed_sphere(), MPI.COMM_SELF)
    factors = full.store.first._factors._ksp.getPC().getFactorMatrix()
    assert factors.getMumpsIcntl(35) == 2 and factors.getMumpsCntl(7) == 1e-10
    return full


def put_off(solver, stiffness, part):
    """Make the factors those of a matrix some part of which is another one; returns that which is solved with."""
    changed = stiffness.copy()
    changed.data = changed.data * (1 + part)
    solver._factors._ksp.getPC().setReusePreconditioner(True)
    solver._factors.replace(changed.data, lambda: solver._pattern_of(changed))
    return changed


@needs("nonmatching")
def test_solutions_by_inexact_factors_are_refined(told_to_compress):
    """Factors a thousandth off: vectors and columns to round-off, blocks of S as the factors are."""
    full = told_to_compress
    problem = full.problem
    changed = put_off(full.store.first, problem.stiffness, 1e-3)
    known = np.random.default_rng(0).standard_normal((problem.free.size, 3)) * problem.held[:, None]
    loads = (changed @ known) * problem.held[:, None]
    np.testing.assert_allclose(full.stiffness.solve(loads[:, 0]), known[:, 0], atol=1e-9)
    np.testing.assert_allclose(full.stiffness.columns(csc_matrix(loads)), known, atol=1e-9)
    ((_, rough),) = full.store.first.solved_blocks(csc_matrix(loads))
    np.testing.assert_allclose(rough, 1.001 * known, atol=1e-9)


@needs("nonmatching")
def test_refinement_that_gets_nowhere_is_no_answer(told_to_compress):
    full = told_to_compress
    put_off(full.store.first, full.problem.stiffness, 1.5)
    with pytest.raises(NotSolvableError, match=r"by compressed factors .* stay .* off"):
        full.stiffness.solve(np.ones(full.problem.free.size))


@needs("moduli", "nonmatching")
@pytest.mark.parametrize("part", [1e-6, 1e-8])
def test_bounds_know_what_compressed_factors_leave_out(part, monkeypatch):
    """Random forces probe S: the bound of a condensed model is larger than its error, and goes with it.

    MUMPS compresses nothing of so small a problem: in its place S, by blocks that are not refined or by what is
    eliminated last, is too soft by a part.
    """
    from hhr_dolfinx.plugins.moduli import least_response

    make = lambda: pressed_sphere(cells=12, moduli=True)  # noqa: E731
    whole = hhr.FullOrderModel(make(), MPI.COMM_SELF)
    plain = sparse.FreeCholesky.solved_blocks

    def softer(factors, columns, *given, refined=False, **how):
        for place, block in plain(factors, columns, *given, refined=refined, **how):
            yield place, block if refined else block * (1 + part)

    between = sparse.FreeCholesky.between_last
    monkeypatch.setattr(sparse.FreeCholesky, "solved_blocks", softer)
    monkeypatch.setattr(sparse.FreeCholesky, "between_last", lambda *given: between(*given) * (1 + part))
    monkeypatch.setattr(full_order, "KEPT_BYTES", 0)
    model = hhr.condense(hhr.FullOrderModel(make(), MPI.COMM_SELF), fields=True)
    for point in whole.parameters.random(4, 0):
        exact = whole.solve(point).forces()
        answer = model.solve(point)
        error = np.linalg.norm(answer.forces() - exact) / np.linalg.norm(exact)
        known = answer.estimate().forces_euclid_relative
        assert 0.1 * part < error < known < 1e4 * part, (error, known)
        # by the factor of the middle, as of large S: pressures are bounded by more than by that of weights next to
        # those of the point, which is wider by the root of a step at most, and by the root of the ratio of the moduli
        with monkeypatch.context() as large:
            large.setattr(least_response, "FACTORED", 0)
            coarse = answer.estimate()
        assert error < coarse.forces_euclid_relative
        fine = answer.estimate().pressure_relative
        assert fine * np.exp(-least_response.STEP / 2) <= coarse.pressure_relative < 3**0.5 * fine


@needs("nonmatching")
def test_options_count_more_than_the_usual_compression(monkeypatch):
    """PETSc options take the prefix of the scene, as documented, for whole and for compressed factors."""
    scene = dataclasses.replace(pressed_sphere(), name="told_apart")
    told = PETSc.Options("hhr_told_apart_")
    told["mat_mumps_cntl_7"] = 1e-5
    try:
        for limits in (sparse.LOW_RANK, ((0, 1e-10),)):
            monkeypatch.setattr(sparse, "LOW_RANK", limits)
            solver = hhr.FullOrderModel(scene, MPI.COMM_SELF).store.first
            assert solver._factors._ksp.getPC().getFactorMatrix().getMumpsCntl(7) == 1e-5
    finally:
        told.delValue("mat_mumps_cntl_7")
