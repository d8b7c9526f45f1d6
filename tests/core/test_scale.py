"""Without the columns of K^-1 B^T: the same answers, by one more solution where a displacement is
asked for.
"""

from __future__ import annotations

import dataclasses
import re

import contract
import numpy as np
import pytest
import sphere_on_block
from mpi4py import MPI
from needs import OURS, mortar, needs, node_to_surface, present
from petsc4py import PETSc
from scenes import check_like, largest_difference
from scipy.sparse import csc_matrix

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, NotSolvableError
from hhr_dolfinx.linear import schur, sparse
from hhr_dolfinx.models import full as full_order
from hhr_dolfinx.models.exact import SolvedFields
from hhr_dolfinx.models.starts import KnownStatuses

SCENES = {
    "constant": (contract.blocks, contract.MIDDLE),
    "moduli of whole bodies": (
        lambda: contract.blocks(("E1", 0.3), box=contract.MODULI),
        contract.VARIED,
    ),
    "Poisson's ratios": (
        lambda: contract.blocks((3.0, "n"), box={"n": (0.1, 0.4)}),
        {**contract.MIDDLE, "n": 0.25},
    ),
    "floating": (lambda: contract.blocks(free=True), contract.PRESSED),
    "friction": (lambda: contract.blocks(friction=0.2), contract.MIDDLE),
    "second_order": (lambda: dataclasses.replace(contract.blocks(), order=2), contract.MIDDLE),
}


def both(make, monkeypatch):
    """A full model that keeps its columns, and one that has no room for them."""
    kept = hhr.FullOrderModel(make(), MPI.COMM_SELF)
    monkeypatch.setattr(full_order, "RESPONSE_BYTES", 0)
    return kept, hhr.FullOrderModel(make(), MPI.COMM_SELF)


VARYING = ("moduli of whole bodies", "Poisson's ratios")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name, marks=needs(*({"elasticity"} if name in VARYING else {name} & set(OURS)))
        )
        for name in SCENES
    ],
)
def test_answers_are_the_same(name, monkeypatch):
    make, mu = SCENES[name]
    kept, lean = both(make, monkeypatch)
    # bodies that contact alone holds rest on what resists no motion of theirs
    assert kept.keeps_columns and lean.keeps_columns == (lean.problem.kernel is not None)
    exact, found = kept.solve(mu, gradient=True), lean.solve(mu, gradient=True)
    check_like(found, exact, forces=1e-10, displacement=1e-10)
    for name in ("unknown", "multipliers"):
        assert (
            largest_difference(getattr(found.gradient, name), getattr(exact.gradient, name)) < 1e-10
        )
    assert (
        largest_difference(*([*answer.outputs().values.values()] for answer in (found, exact)))
        < 1e-10
    )
    assert lean.keeps_columns or not lean.stiffness.has_response


@needs("stress")
def test_exact_condensation_keeps_rows_of_outputs_only(monkeypatch, tmp_path):
    """Forces and outputs from a file too; a displacement where the factors are."""
    scene = contract.blocks()
    outputs = (*scene.outputs, hhr.DisplacementAt("u", (2.0, 2.0), 0), hhr.VonMises("stress", 1))
    kept, lean = both(lambda: dataclasses.replace(scene, outputs=outputs), monkeypatch)
    monkeypatch.undo()  # rows of outputs have room
    statuses = hhr.compute_snapshots(kept, kept.parameters.random(8, 0)).known_statuses()
    whole = hhr.exact_condensation(kept, statuses)
    model = hhr.exact_condensation(lean, statuses)
    assert isinstance(model.fields, SolvedFields) and not lean.stiffness.has_response
    for point in kept.parameters.random(4, 1):
        exact, found = whole.solve(point, gradient=True), model.solve(point, gradient=True)
        check_like(found, exact, displacement=1e-11, stress=1e-10)
        one, other = found.outputs(), exact.outputs()
        np.testing.assert_allclose(
            list(one.values.values()), list(other.values.values()), rtol=1e-9
        )
        for key, slopes in other.gradient.items():
            np.testing.assert_allclose(
                one.gradient[key], slopes, rtol=1e-8, atol=1e-9 * np.abs(slopes).max()
            )
    hhr.save_model(tmp_path / "model.npz", model)
    again = hhr.load_model(tmp_path / "model.npz").solve(point)
    np.testing.assert_allclose(again.forces(), exact.forces(), rtol=1e-9, atol=1e-12)
    assert again.outputs()["u"] == pytest.approx(exact.outputs()["u"], rel=1e-9)
    with pytest.raises(NotOfferedError, match="has no factors"):
        again.displacement()


PAIRING = mortar if present("mortar") else node_to_surface
"""What is tested here does not depend on it."""


def pressed_sphere(*outputs, cells=8, moduli=False):
    """A scene in space of some hundred conditions."""
    made = sphere_on_block.scene(
        PAIRING, sphere_cells=(cells, cells // 2), block_cells=(cells - 2, cells // 2)
    )
    scene = dataclasses.replace(made, outputs=outputs)
    if not moduli:
        return scene
    bodies = tuple(dataclasses.replace(body, young=f"E{k}") for k, body in enumerate(scene.bodies))
    box = scene.parameters
    space = hhr.ParameterSpace(
        (*box.names, "E0", "E1"), (*box.lower, 1e5, 5e4), (*box.upper, 3e5, 9e4)
    )
    return dataclasses.replace(scene, bodies=bodies, parameters=space)


@needs("nonmatching", "stress")
def test_reduced_models_and_estimates_need_no_columns(monkeypatch):
    """Hyper-reduction and its estimates take a solution for each mode in the place of one for each
    row.
    """
    tag = sphere_on_block.geometry.SPHERE
    outputs = (hhr.DisplacementAt("u", (0.0, 0.0, 0.0), 2, tag), hhr.VonMises("stress", tag))
    kept, lean = both(lambda: pressed_sphere(*outputs, cells=12), monkeypatch)
    point = kept.parameters.middle
    snapshots = hhr.compute_snapshots(kept, kept.parameters.random(12, 0))
    one, other = (
        hhr.build(full, snapshots, contract.AS_IT_IS).solve(point) for full in (kept, lean)
    )
    np.testing.assert_allclose(other.forces(), one.forces(), atol=1e-9 * one.forces().max())
    mine, theirs = one.estimate(), other.estimate()
    for name in ("primal", "dual", "forces_euclid", "pressure"):
        assert getattr(theirs, name) == pytest.approx(getattr(mine, name), rel=1e-4)
    assert theirs.outputs == pytest.approx(dict(mine.outputs), rel=1e-4)
    assert not lean.stiffness.has_response


@needs("nonmatching", "stress")
def test_outputs_with_many_rows_are_read_at_displacements(monkeypatch):
    """A largest stress has six rows for each cell: values and derivatives by one more solution
    each.
    """
    kept, lean = both(
        lambda: pressed_sphere(hhr.VonMises("stress", sphere_on_block.geometry.SPHERE)), monkeypatch
    )
    nothing = KnownStatuses(kept.problem.middle[None], np.zeros((1, kept.conditions), dtype=bool))
    one, other = (hhr.exact_condensation(full, nothing) for full in (kept, lean))
    assert not other.fields.measured_per_force.size
    for point in kept.parameters.random(3, 0):
        exact, found = (model.outputs(point, gradient=True) for model in (one, other))
        assert found["stress"] == pytest.approx(exact["stress"], rel=1e-9)
        assert largest_difference(found.gradient["stress"], exact.gradient["stress"]) < 1e-7


@needs("moduli")
def test_a_model_of_forces_alone_is_read_from_a_file(tmp_path):
    """In a scene whose outputs need displacements: forces are there, and what is not is refused by
    name.
    """
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


@pytest.fixture
def counted(monkeypatch):
    """Columns that factors were asked for, and inverses between dofs that were eliminated last."""
    columns, inverses = [], []
    plain, between = sparse.FreeCholesky.solved_blocks, sparse.FreeCholesky.between_last

    def solved_blocks(factors, asked, *given, **how):
        columns.append(asked.shape[1])
        return plain(factors, asked, *given, **how)

    def between_last(factors, rows):
        found = between(factors, rows)
        inverses.append(found is not None)
        return found

    monkeypatch.setattr(sparse.FreeCholesky, "solved_blocks", solved_blocks)
    monkeypatch.setattr(sparse.FreeCholesky, "between_last", between_last)
    return lambda: (sum(columns), sum(inverses))


@needs("moduli", "nonmatching")
@pytest.mark.parametrize("by_columns", [True, False])
def test_s_is_made_once(monkeypatch, by_columns, counted):
    """When it is first asked for; by a model with moduli, its bound and the full order together."""
    from hhr_dolfinx.plugins.moduli import condense

    if by_columns:
        monkeypatch.setattr(schur, "_library", lambda: None)
    kept, _ = both(lambda: pressed_sphere(moduli=True), monkeypatch)
    begun = counted()
    lean = hhr.FullOrderModel(pressed_sphere(moduli=True), MPI.COMM_SELF)
    mu = lean.parameters.middle
    assert counted() == begun
    forces = hhr.condense(lean, fields=False).solve(mu).forces()
    least, (before, inverses) = lean.conditions if by_columns else 0, counted()
    assert least <= before - begun[0] <= least + 2 * lean.problem.loads.shape[1]
    assert inverses - begun[1] == (0 if by_columns else len(lean.problem.bodies))
    answer = hhr.condense(lean, fields=True).solve(mu)
    assert answer.estimate().kind == "bound" and answer.estimate().forces_euclid_relative < 1e-8
    np.testing.assert_array_equal(forces, answer.forces())
    lean.solve(mu)
    # fields, a solution for each start and body, and random forces; not S once more
    assert counted()[0] - before < 2 * condense.MOST_STARTS + 50 and not lean.stiffness.has_response
    assert counted()[1] == inverses
    exact = kept.solve(mu).forces()
    assert np.linalg.norm(forces - exact) < 1e-10 * np.linalg.norm(exact)


@needs("moduli")
def test_factors_that_are_let_go_are_made_anew(monkeypatch):
    """Of large components, between the stages of a model, which is the same one."""
    from hhr_dolfinx.plugins.moduli import components

    scene = contract.blocks((3.0, "n"), box={"n": (0.1, 0.4)})
    kept = hhr.condense(scene, fields=True)
    monkeypatch.setattr(components, "LARGE_COMPONENT", 0)
    destroyed = []
    plain = sparse.FreeCholesky.release
    monkeypatch.setattr(
        sparse.FreeCholesky, "release", lambda factors: destroyed.append(plain(factors))
    )
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    exact = [full.solve(point) for point in full.parameters.random(4, 1)]
    model = hhr.condense(full, fields=True)
    assert (
        len(destroyed) >= 5
    )  # of two components, where S is made, and its fields, and of the full model
    for before in exact:
        again = full.solve(before.parameter)
        np.testing.assert_allclose(again.displacement(), before.displacement(), rtol=0, atol=1e-14)
        answer, known = model.solve(before.parameter), kept.solve(before.parameter)
        np.testing.assert_allclose(
            answer.forces(), known.forces(), rtol=0, atol=1e-12 * known.forces().max()
        )
        np.testing.assert_allclose(answer.displacement(), known.displacement(), rtol=0, atol=1e-10)
        assert answer.estimate().forces_euclid == pytest.approx(
            known.estimate().forces_euclid, rel=1e-3
        )


@needs("plots", "nonmatching", "ranks")
def test_a_check_says_what_a_large_scene_takes(tmp_path):
    """Measured on one core: 96,288 dofs and 1089 conditions .64 GB and 9 s for factors, .010 s a
    column.
    """
    from hhr_dolfinx.plugins.scene_checks.check import check_scene

    def told(cells):
        scene = sphere_on_block.scene(
            PAIRING, sphere_cells=(cells, cells // 2), block_cells=(cells, cells // 2)
        )
        texts = [finding.text for finding in check_scene(scene).findings]
        return next(text for text in texts if "conditions of contact" in text)

    assert "a full model takes" not in told(8)
    large = told(22)
    assert re.search(
        r"\d+ dofs and 529 conditions of contact: a full model takes about 0\.\d+ GB and \d", large
    ), large


@pytest.fixture
def told_to_compress(monkeypatch):
    """A full model whose factors MUMPS compresses, of which nothing is left out of so small a
    problem.
    """
    monkeypatch.setattr(sparse, "LOW_RANK", ((0, 1e-10),))
    full = hhr.FullOrderModel(pressed_sphere(), MPI.COMM_SELF)
    factors = full.store.first._factors._ksp.getPC().getFactorMatrix()
    assert factors.getMumpsIcntl(35) == 2 and factors.getMumpsCntl(7) == 1e-10
    return full


def put_off(solver, stiffness, part):
    """Make the factors those of a matrix some part of which is another one.

    Returns that which is solved with.
    """
    changed = stiffness.copy()
    changed.data = changed.data * (1 + part)
    solver._factors._ksp.getPC().setReusePreconditioner(True)
    solver._factors.replace(changed.data, lambda: solver._pattern_of(changed))
    return changed


@needs("nonmatching")
def test_solutions_by_inexact_factors_are_refined(told_to_compress):
    """Factors a thousandth off: vectors and columns to round-off, blocks of S as the factors
    are.
    """
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
    """Random forces probe S: the bound of a condensed model is larger than its error, and goes with
    it.

    MUMPS compresses nothing of so small a problem: in its place S, by blocks that are not refined
    or by what is eliminated last, is too soft by a part.
    """
    from hhr_dolfinx.plugins.moduli import least_response

    plain, between = sparse.FreeCholesky.solved_blocks, sparse.FreeCholesky.between_last

    def softer(factors, columns, *given, refined=False, **how):
        for place, block in plain(factors, columns, *given, refined=refined, **how):
            yield place, block if refined else block * (1 + part)

    whole, lean = both(lambda: pressed_sphere(cells=12, moduli=True), monkeypatch)
    exact_forces = [whole.solve(point).forces() for point in whole.parameters.random(4, 0)]
    monkeypatch.setattr(sparse.FreeCholesky, "solved_blocks", softer)
    monkeypatch.setattr(
        sparse.FreeCholesky, "between_last", lambda *given: between(*given) * (1 + part)
    )
    model = hhr.condense(lean, fields=True)
    for point, exact in zip(whole.parameters.random(4, 0), exact_forces, strict=True):
        answer = model.solve(point)
        error = np.linalg.norm(answer.forces() - exact) / np.linalg.norm(exact)
        known = answer.estimate().forces_euclid_relative
        assert 0.1 * part < error < known < 1e4 * part, (error, known)
        # by the factor of the middle, as of large S: pressures are bounded by more than by that of
        # weights next to those of the point, which is wider by the root of a step at most, and by
        # the root of the ratio of the moduli
        with monkeypatch.context() as large:
            large.setattr(least_response, "FACTORED", 0)
            coarse = answer.estimate()
        assert error < coarse.forces_euclid_relative
        fine = answer.estimate().pressure_relative
        assert (
            fine * np.exp(-least_response.LOG_WEIGHT_STEP / 2)
            <= coarse.pressure_relative
            < 3**0.5 * fine
        )


@needs("nonmatching")
def test_options_count_more_than_the_usual_compression(monkeypatch):
    """PETSc options take the prefix of the scene, as documented, for whole and for compressed
    factors.
    """
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
