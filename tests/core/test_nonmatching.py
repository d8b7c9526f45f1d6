"""The hyper-reduced model of non-matching contact: closed RID, generalised saddle point, both rank conditions."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import contact_patch_test as patch
import numpy as np
import pellet_cladding_nonmatching as demo
import pytest
from bare import SCENE_FOLDERS, WAIT
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI
from needs import needs
from referenced import references_at
from scenes import node_dofs, whole_domain
from scipy import linalg

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import force_floor, relative_error
from hhr_dolfinx.certify.compare import compare_points
from hhr_dolfinx.certify.constants import FullConstants, assess
from hhr_dolfinx.certify.trust import TrustLimits, check_solvable, check_stability
from hhr_dolfinx.contact.active_set import SchurEqualities, Status, active_set
from hhr_dolfinx.errors import NotSolvableError, ReductionError, StabilityWarning, UnstableModelError
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.reduction.completion import Completion
from hhr_dolfinx.reduction.enrichment import enrich
from hhr_dolfinx.reduction.modes import pod
from hhr_dolfinx.reduction.projection import load_nodes, open_conditions, project, reduced_domain

MESH = {"radial_cells": 12, "axial_cells": 20, "cladding_radial_cells": 3, "cladding_axial_cells": 15}


@pytest.fixture(scope="module")
def pellet():
    """The demo's scene on a coarse mesh with its snapshots."""
    return hhr.train(demo.scene(**MESH), [12, 10], held_out=10, comm=MPI.COMM_SELF)


@pytest.fixture(
    scope="module", params=["node_to_surface", pytest.param("mortar", marks=needs("mortar")), "double_pass"]
)
def problem(request):
    """Problems of all pairings whose rows interpolate."""
    return hhr.FullOrderModel(demo.scene(request.param, **MESH), MPI.COMM_SELF).problem


@pytest.fixture(scope="module")
def standard():
    """Standard mortar multipliers, each row of which touches its neighbours' slaves."""
    return hhr.FullOrderModel(patch.scene(patch.PAIRINGS["mortar, standard"], (12, 4), (16, 4)), MPI.COMM_SELF).problem


def check_closed(problem, asked, sets):
    """By the definitions of (5.5), (5.6), (5.20) and section 5.2.3, by brute force."""
    contact, dim = problem.contact.toarray(), problem.block_size
    in_A = np.zeros(problem.free.size, dtype=bool)
    in_A[sets.A] = True
    outside = np.setdiff1d(np.arange(len(problem.cell_nodes)), sets.cells)
    assert not np.isin(sets.A // dim, problem.cell_nodes[outside]).any()
    touching = {j for j, row in enumerate(contact) if in_A[np.flatnonzero(row)].any()}
    assert touching <= set(sets.A_lambda), "a force outside the RID acts on it"
    assert open_conditions(problem, sets).size == 0
    columns = np.flatnonzero(contact[sets.A_lambda].any(axis=0))
    assert sets.A_c_tilde.tolist() == columns.tolist()
    assert sets.A_c.tolist() == columns[in_A[columns]].tolist()
    # every node asked for keeps its free dofs
    dofs = node_dofs(problem, asked)
    assert in_A[dofs[problem.free[dofs]]].all()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 12), layers=st.integers(0, 2))
def test_every_rid_is_closed_and_keeps_its_nodes(problem, seed, count, layers):
    rng = np.random.default_rng(seed)
    on_surface = np.unique(problem.contact.indices // problem.block_size)
    asked = np.concatenate([rng.choice(len(problem.points), count), rng.choice(on_surface, count)])
    check_closed(problem, asked, reduced_domain(problem, asked, layers))


@needs("mortar")
def test_overlapping_rows_grow_to_the_whole_surface(standard):
    """Standard multipliers leave no place to cut; dual ones do."""
    asked = standard.contact_slaves[[8]]
    sets = reduced_domain(standard, asked)
    check_closed(standard, asked, sets)
    assert len(sets.A_lambda) == standard.contact.shape[0]
    dual = hhr.FullOrderModel(patch.scene(hhr.Mortar, (12, 4), (16, 4)), MPI.COMM_SELF).problem
    assert 1 <= len(reduced_domain(dual, dual.contact_slaves[[8]]).A_lambda) < 6


def test_a_master_node_brings_in_its_slaves(pellet):
    """A node of the cladding keeps its place in A together with all pellet nodes that lean on it."""
    problem = pellet.full_order.problem
    inner = np.setdiff1d(problem.contact.indices // 2, problem.contact_slaves)
    for node in inner[[3, 8]]:
        sets = reduced_domain(problem, np.array([node]))
        leaning = np.flatnonzero(np.abs(problem.contact[:, 2 * node : 2 * node + 2]).sum(axis=1))
        assert leaning.size and np.isin(leaning, sets.A_lambda).all() and 2 * node in sets.A


def opened(problem, sets):
    """The same RID without its closure: all nodes of its inside, whatever acts on them."""
    outside = np.setdiff1d(np.arange(len(problem.cell_nodes)), sets.cells)
    inside = np.ones(len(problem.points), dtype=bool)
    inside[problem.cell_nodes[outside]] = False
    A = np.flatnonzero(np.repeat(inside, problem.block_size) & problem.free)
    touched = np.unique(problem.contact[sets.A_lambda].nonzero()[1])
    return dataclasses.replace(sets, A=A, A_c=np.intersect1d(touched, A))


def some_rid(problem):
    """A RID that ends in the middle of the contact surface, and its opened twin."""
    sets = reduced_domain(problem, problem.contact_slaves[5:9], layers=1)
    assert len(sets.A_c) < len(sets.A_c_tilde), "B~1 and B~2 differ"
    twin = opened(problem, sets)
    assert len(twin.A) > len(sets.A)
    return sets, twin


def residual(problem, sets, solution, point):
    """Equilibrium of the exact solution in the equations tested on A with the forces of A_lambda alone."""
    theta = problem.amplitudes(problem.parameters.point(point))
    homogeneous = solution.unknown
    forces = np.zeros(problem.contact.shape[0])
    forces[sets.A_lambda] = solution.forces()[sets.A_lambda]
    rest = problem.stiffness @ homogeneous + problem.contact.T @ forces - problem.loads @ theta
    return np.abs(rest[sets.A]).max() / np.abs(problem.loads @ theta).max()


def test_a_closed_rid_is_consistent_and_an_open_one_is_refused(pellet):
    """The exact solution satisfies the equations of a closed RID to round-off; not those of an open one."""
    problem = pellet.full_order.problem
    sets, twin = some_rid(problem)
    solution = pellet.full_order.solve([150.0, 5.0])
    assert residual(problem, sets, solution, [150.0, 5.0]) < 1e-10
    assert residual(problem, twin, solution, [150.0, 5.0]) > 1e-2
    basis = np.linalg.qr(pellet.snapshots.displacements[:, :5])[0]
    with pytest.raises(ReductionError, match="not closed"):
        project(problem, basis, twin)


def test_the_exact_solution_solves_the_generalised_saddle_point(pellet):
    """(5.23): with the exact displacement in the basis, gamma and the exact forces satisfy it, B~1 and B~2 apart."""
    problem, point = pellet.full_order.problem, np.array([150.0, 5.0])
    sets, _ = some_rid(problem)
    theta, solution = problem.amplitudes(point), pellet.full_order.solve(point)
    homogeneous = solution.unknown
    basis = np.linalg.qr(np.column_stack([homogeneous, pellet.snapshots.displacements[:, ::20]]))[0]
    gamma, forces = basis.T @ homogeneous, solution.forces()[sets.A_lambda]
    reduced = project(problem, basis, sets)
    # no load acts on this RID: what balances are forces at its interface and contact forces
    pushed = reduced.contact_test.T @ forces
    rest = reduced.stiffness @ gamma + pushed - reduced.loads @ theta
    assert np.abs(rest).max() < 1e-10 * np.abs(pushed).max()
    slack = reduced.gaps @ theta - reduced.contact_trial @ gamma
    assert slack == pytest.approx((problem.gaps @ theta - problem.contact @ homogeneous)[sets.A_lambda], abs=1e-15)
    wrong = reduced.gaps @ theta - reduced.contact_test @ gamma
    assert np.abs(wrong - slack).max() > 1e-5, "B~1 would read wrong gaps at the edge of the RID"


def test_the_reduced_model_finds_the_exact_solution_of_a_saddle_point_with_two_matrices(pellet):
    """The exact displacement lies in the basis, so the exact forces are the answer; only with B~1 and B~2 in place."""
    full_order, point = pellet.full_order, np.array([150.0, 5.0])
    problem = full_order.problem
    sets = reduced_domain(problem, np.array([*problem.contact_slaves[3:7], *load_nodes(problem)]), layers=1)
    assert len(sets.A_c) < len(sets.A_c_tilde)
    solution = full_order.solve(point)
    homogeneous = solution.unknown
    modes = pod(pellet.snapshots.displacements, 1e-5)[0][:, :4]
    basis = enrich(problem, np.linalg.qr(np.column_stack([homogeneous, modes]))[0], sets, 3.0).basis
    known = KnownStatuses(point[None], solution.active[sets.A_lambda][None])
    fields = Completion.of(problem, pellet.snapshots).reconstruction(problem, basis, sets)
    model = ReducedModel(project(problem, basis, sets), problem.parameters, fields, known=known)
    exact = solution.forces()[sets.A_lambda]
    assert exact.any()
    # measured 7e-14; 0.13 and 1.0 with one matrix in the place of the other
    assert model.solve(point).multipliers == pytest.approx(exact, abs=1e-10 * exact.max())
    assert basis @ model.solve(point).unknown == pytest.approx(homogeneous, abs=1e-10 * np.abs(homogeneous).max())


def test_alpha_prime_on_two_kernels(pellet):
    """(2.46) by its definition: trial functions in the kernel of B~2, test functions in that of B~1."""
    problem = pellet.full_order.problem
    sets = reduced_domain(problem, np.array([*problem.contact_slaves[3:7], *load_nodes(problem)]), layers=1)
    basis = enrich(problem, pod(pellet.snapshots.displacements, 1e-5)[0][:, :4], sets, 3.0).basis
    reduced = project(problem, basis, sets)
    stability = assess(problem, FullConstants.of(pellet.full_order), basis, sets, reduced)
    one, two = linalg.null_space(reduced.contact_test), linalg.null_space(reduced.contact_trial)
    assert np.abs(reduced.contact_test - reduced.contact_trial).max() > 1e-3
    cut = linalg.orth(np.where(np.isin(np.arange(len(basis)), sets.A)[:, None], basis, 0.0) @ one)
    # in orthonormal bases of the test and trial functions themselves
    a = cut.T @ (problem.stiffness @ linalg.orth(basis @ two))
    assert stability.euclidean.alpha_prime == pytest.approx(linalg.svdvals(a)[-1], rel=1e-6)
    gram = linalg.sqrtm(np.linalg.inv(basis[sets.A].T @ basis[sets.A])).real
    assert stability.euclidean.beta_HR == pytest.approx(linalg.svdvals(gram @ reduced.contact_test.T)[-1], rel=1e-6)


def test_every_constant_can_refuse_a_model(pellet):
    reduction = pellet.build()
    good, limits = reduction.offline.stability, TrustLimits()
    check_stability(good, limits)
    for error, broken in (
        (NotSolvableError, {"kappa_B": np.inf}),
        (NotSolvableError, {"kappa_B_2": np.inf}),
        (UnstableModelError, {"cond_K": 1e9}),
        (UnstableModelError, {"euclidean": dataclasses.replace(good.euclidean, beta_HR=0.0)}),
        (UnstableModelError, {"euclidean": dataclasses.replace(good.euclidean, beta_HR_2=0.0)}),
        (UnstableModelError, {"euclidean": dataclasses.replace(good.euclidean, alpha_prime=0.0)}),
    ):
        with pytest.raises(error):
            spoiled = dataclasses.replace(good, **broken)
            check_solvable(spoiled)
            check_stability(spoiled, limits)
    with pytest.warns(StabilityWarning, match="may have two answers"):
        check_stability(dataclasses.replace(good, contact_definite=-0.5), limits)


def test_two_answers_to_one_parameter_are_caught(pellet):
    """The thesis' recipe without layers: started from elsewhere, it answers otherwise; held-out points tell."""
    recipe = hhr.Recipe.thesis(
        1e-6, nodes=(hhr.Deim(), hhr.ForceDeim(1e-3), hhr.LoadNodes()), enrichment=hhr.Enrich(1.0)
    )
    reduction = pellet.build(recipe, checked=False)
    assert reduction.offline.stability.contact_definite < -0.5
    problem = pellet.full_order.problem
    held_out = hhr.compute_snapshots(pellet.full_order, problem.parameters.random(60, seed=9))
    comparison = compare_points(pellet.full_order, reduction, held_out, force_floor(problem, pellet.snapshots))
    answered = np.isfinite(comparison.primal)
    assert np.isinf(comparison.dual[answered]).any(), "two answers"
    with pytest.raises(UnstableModelError):
        hhr.build(pellet.full_order, pellet.snapshots, recipe, held_out)


def test_an_imposed_slave_surface_keeps_only_conditions_that_act_inside():
    """A rigid die driven through its contact side: where its masters lie outside the RID a row would be zero."""
    scene = patch.scene(hhr.NodeToSurface, (16, 4), (8, 4), poisson=0.3, bulge=0.05)
    contact_side = two_blocks.side(two_blocks.SECOND, 1, False)
    driven = tuple(
        hhr.Displacement(contact_side, k, hhr.Amplitude(slopes={"push": -1.0 if k else 0.0})) for k in (0, 1)
    )
    scene = dataclasses.replace(scene, displacements=(*scene.displacements, *driven))
    problem = hhr.FullOrderModel(scene, MPI.COMM_SELF).problem
    sets = reduced_domain(problem, problem.contact_slaves[[4]], layers=1)
    rows = problem.contact[sets.A_lambda][:, sets.A_c]
    assert (np.abs(rows.toarray()).sum(axis=1) > 0).all()
    assert open_conditions(problem, sets).size == 0


def test_training_keeps_and_finds_its_solutions(tmp_path, monkeypatch):
    """A second training with the folder of the first solves nothing; held-out points are not those of the grid."""
    scene = patch.scene(hhr.NodeToSurface, (4, 3), (5, 3), poisson=0.3, bulge=0.02)
    first = hhr.train(scene, [4, 3], held_out=5, folder=tmp_path, comm=MPI.COMM_SELF)
    assert not {tuple(p) for p in first.held_out.points} & {tuple(p) for p in first.snapshots.points}
    monkeypatch.setattr(hhr.FullOrderModel, "solve", lambda *_, **__: pytest.fail("solved again"))
    second = hhr.train(scene, [4, 3], held_out=5, folder=tmp_path, comm=MPI.COMM_SELF)
    assert np.array_equal(first.snapshots.displacements, second.snapshots.displacements)
    bad = dataclasses.replace(second, held_out=dataclasses.replace(second.held_out, forces=-second.held_out.forces))
    with pytest.raises(UnstableModelError):
        bad.build()


def test_stress_uses_the_constants_of_each_body():
    """A linear field on both bodies: sigma = lambda tr(e) 1 + 2 mu e with their own E and nu."""
    scene = patch.scene(hhr.NodeToSurface, (3, 3), (4, 3))
    bodies = (hhr.Body(1, 3.0, 0.3), hhr.Body(2, 7.0, 0.1))
    full_order = hhr.FullOrderModel(dataclasses.replace(scene, bodies=bodies), MPI.COMM_SELF)
    points = full_order.problem.points
    field = np.column_stack([0.1 * points[:, 0], 0.2 * points[:, 1]]).ravel()
    stress = full_order.stress_of(field)
    middles = points[full_order.problem.cell_nodes].mean(axis=1)
    for body, inside in zip(bodies, (middles[:, 1] < 1, middles[:, 1] > 1), strict=True):
        lam = body.young * body.poisson / ((1 + body.poisson) * (1 - 2 * body.poisson))
        mu = body.young / (2 * (1 + body.poisson))
        exact = np.array([lam * 0.3 + 2 * mu * 0.1, lam * 0.3 + 2 * mu * 0.2, lam * 0.3, 0.0])
        assert stress[inside] == pytest.approx(np.tile(exact, (inside.sum(), 1)), abs=1e-12)


def test_whole_basis_on_the_whole_domain_is_the_full_order(problem):
    """All FE functions and all cells: the reduced system is the full one."""
    sets = whole_domain(problem)
    free = np.flatnonzero(problem.free)
    basis = np.zeros((problem.free.size, free.size))
    basis[free, np.arange(free.size)] = 1.0
    reduced = project(problem, basis, sets)
    assert np.array_equal(reduced.contact_test, reduced.contact_trial)
    assert reduced.contact_test == pytest.approx(problem.contact[:, free].toarray(), abs=0)
    assert reduced.stiffness == pytest.approx(problem.stiffness[free][:, free].toarray(), rel=1e-12, abs=1e-9)


def test_enrichment_gives_both_matrices_full_rank(pellet):
    """A basis that vanishes on A leaves B~1 without rank, one that opens no gap leaves B~2 without."""
    problem = pellet.full_order.problem
    sets, _ = some_rid(problem)
    for kind in ("zero on A", "no gap"):
        basis = pellet.snapshots.displacements[:, [30, 60, 90]].copy()
        if kind == "zero on A":
            basis[sets.A] = 0.0
        else:
            rows = problem.contact[sets.A_lambda].toarray()
            basis -= np.linalg.pinv(rows) @ (rows @ basis)
        basis = np.linalg.qr(basis)[0]
        enriched = enrich(problem, basis, sets, kappa_max=5.0)
        reduced = project(problem, enriched.basis, sets)
        ranks = [np.linalg.matrix_rank(table) for table in (reduced.contact_test, reduced.contact_trial)]
        assert np.isinf(enriched.kappas[0])
        assert ranks == [len(sets.A_lambda)] * 2, kind
        assert np.linalg.cond(reduced.contact_test) == pytest.approx(enriched.kappas[-1], rel=1e-8)
        slave_dofs = node_dofs(problem, problem.contact_slaves)
        added = enriched.basis - basis @ (basis.T @ enriched.basis)
        added = added - basis @ (basis.T @ added)
        moved = np.flatnonzero(np.abs(problem.free * 1.0) * np.abs(added).max(axis=1) > 1e-8)
        support = np.union1d(slave_dofs, np.flatnonzero(np.abs(basis).max(axis=1) > 0))
        assert np.isin(moved, support).all()


def test_both_constants_and_both_conditions_are_reported(pellet):
    """kappa, beta and the definiteness of S against their definitions, with B~1 and B~2 apart."""
    problem = pellet.full_order.problem
    sets, _ = some_rid(problem)
    basis = pod(pellet.snapshots.displacements[:, ::6], 1e-12)[0]
    basis = enrich(problem, basis, sets, 2.0).basis
    reduced = project(problem, basis, sets)
    stability = assess(problem, FullConstants.of(pellet.full_order), basis, sets, reduced)
    one, two = (np.linalg.svd(t, compute_uv=False) for t in (reduced.contact_test, reduced.contact_trial))
    assert stability.kappa_B == pytest.approx(one[0] / one[-1])
    assert stability.kappa_B_2 == pytest.approx(two[0] / two[-1])
    assert stability.euclidean.beta_HR_2 == pytest.approx(two[-1])  # V is orthonormal
    S = reduced.contact_trial @ np.linalg.solve(reduced.stiffness, reduced.contact_test.T)
    lowest = np.linalg.eigvalsh((S + S.T) / 2)[0] / np.linalg.norm(S, 2)
    assert stability.contact_definite == pytest.approx(lowest, rel=1e-6)


def brute_force(schur, free_slack):
    """All solutions of forces >= 0, slack = free_slack + S forces >= 0, complementary, by trying all statuses."""
    m, found = free_slack.size, []
    for bits in range(2**m):
        active = np.array([bits >> k & 1 for k in range(m)], dtype=bool)
        forces = np.zeros(m)
        forces[active] = np.linalg.solve(schur[np.ix_(active, active)], -free_slack[active])
        slack = free_slack + schur @ forces
        slack[active] = 0.0
        if forces.min() >= 0 and slack.min() >= 0:
            found.append(forces)
    return found


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 10**6), m=st.integers(1, 7), skew=st.floats(0, 3))
def test_the_active_set_ends_where_the_symmetric_part_is_positive(seed, m, skew):
    """What is promised for S = B~2 K~^-1 B~1^T: one solution, found from any start."""
    rng = np.random.default_rng(seed)
    root, turn = rng.standard_normal((m, m)), rng.standard_normal((m, m))
    schur = root @ root.T + 0.1 * np.eye(m) + skew * (turn - turn.T)
    free_slack = rng.standard_normal(m)
    (exact,) = brute_force(schur, free_slack)
    found = active_set(SchurEqualities.of(schur), free_slack, rng.random(m) < 0.5)
    assert found.status is Status.CONVERGED
    assert found.forces == pytest.approx(exact, abs=1e-9 * (1 + np.abs(exact).max()))


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 10**6), m=st.integers(2, 6))
def test_without_it_an_answer_is_still_a_solution(seed, m):
    """No promise that one is found; but what is handed out satisfies all contact conditions."""
    rng = np.random.default_rng(seed)
    schur, free_slack = rng.standard_normal((m, m)), rng.standard_normal(m)
    found = active_set(SchurEqualities.of(schur), free_slack, free_slack < 0)
    if found.status is Status.CONVERGED:
        slack = free_slack + schur @ found.forces
        size = 1 + np.abs(schur).max() * np.abs(found.forces).max()
        assert found.forces.min() >= -1e-9 * size and slack.min() >= -1e-9 * size
        assert np.abs(found.forces * slack).max() <= 1e-8 * size**2


def test_a_turned_scene_has_the_same_reduced_model():
    """With basis and RID carried along, K~, B~1, B~2 and gaps do not change; only what DEIM picks may."""
    built = {}
    for angle in (0.0, np.sqrt(2)):
        turned = patch.scene(hhr.NodeToSurface, (8, 4), (11, 4), poisson=0.3, angle=angle, bulge=0.02)
        built[angle] = hhr.FullOrderModel(turned, MPI.COMM_SELF)
    reduced, errors = {}, {}
    points = [[0.03, 0.0], [0.05, 0.02], [0.07, 0.01], [0.1, 0.05]]
    for angle, full_order in built.items():
        problem = full_order.problem
        place = problem.points @ patch.geometry.rotation(2, angle)
        middle = problem.contact_slaves[np.argsort(place[problem.contact_slaves, 0])[3:7]]
        sets = reduced_domain(problem, middle, layers=1)
        fields = np.column_stack([full_order.solve(point).unknown for point in points])
        basis, triangle = np.linalg.qr(fields)
        reduced[angle] = project(problem, basis * np.sign(np.diag(triangle)), sets)
        training = hhr.compute_snapshots(full_order, problem.parameters.grid([12, 6]))
        model = hhr.build(full_order, training)
        displacement, exact = (one.solve([0.083, 0.021]).displacement() for one in (model, full_order))
        errors[angle] = np.linalg.norm(displacement - exact) / np.linalg.norm(exact)
    for name in ("stiffness", "loads"):
        ours, turned = (getattr(item, name) for item in reduced.values())
        assert turned == pytest.approx(ours, abs=1e-9 * np.abs(ours).max())
    for name in ("contact_test", "contact_trial", "gaps"):
        ours, turned = (getattr(item, name) for item in reduced.values())
        assert np.linalg.svd(turned, compute_uv=False) == pytest.approx(np.linalg.svd(ours, compute_uv=False), abs=1e-9)
    assert max(errors.values()) < 2e-3


@needs("studies")
@pytest.mark.parametrize("pairing", ["node_to_surface", pytest.param("mortar", marks=needs("mortar"))])
def test_errors_of_the_demo_on_a_coarse_mesh(pellet, pairing):
    """The default recipe on 20 random points: what the demo shows on the fine mesh holds on a coarse one."""
    if pairing == "mortar":
        pellet = hhr.train(demo.scene(pairing, **MESH), [12, 10], held_out=10, comm=MPI.COMM_SELF)
    reduction = pellet.build()
    problem = pellet.full_order.problem
    assert open_conditions(problem, reduction.offline.sets).size == 0
    points = problem.parameters.random(20, seed=3)
    errors = references_at(points, pellet.full_order, pellet.snapshots).errors(reduction)
    assert errors.unanswered == 0 and not any(reduction.solve(point).cycled for point in points)
    assert np.median(errors.values["dual_full_floored"]) < 0.02
    assert np.percentile(errors.values["primal_l2"], 95) < 0.01
    found, exact = (model.solve(demo.POINT).displacement() for model in (reduction, pellet.full_order))
    assert relative_error(found, exact, problem.mass) < 0.01


def run_quick(name, out, *arguments):
    (script,) = (path for folder in SCENE_FOLDERS if (path := Path(folder, f"{name}.py")).exists())
    command = [sys.executable, str(script), "--quick", "--out", str(out), *arguments]
    run = subprocess.run(command, capture_output=True, text=True, cwd=out, timeout=WAIT)
    assert run.returncode == 0, run.stderr[-3000:]


@pytest.mark.parametrize(
    "pairing", ["node_to_surface", pytest.param("mortar", marks=[needs("mortar"), pytest.mark.slow])]
)
def test_quick_pellet(tmp_path, pairing):
    run_quick("pellet_cladding_nonmatching", tmp_path, "--pairing", pairing)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["errors"]["unconverged"] == 0
    assert report["point"]["here"]["primal_l2"] < 0.01
    for name in ("fields.vtu", "fields.png", "pressures.png", "work_precision.png", "study.npz"):
        assert (tmp_path / name).stat().st_size > 5000


@needs("mortar")
def test_quick_sphere(tmp_path):
    run_quick("sphere_on_block", tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["errors"]["dual_full_floored"]["median"] < 0.02
    assert report["ratios"]["fom_best/online"] > 10
    assert abs(report["hertz"][2]["peak"]) < 0.1
    assert (tmp_path / "fields.vtu").stat().st_size > 5000


@needs("mortar")
def test_quick_patch_test(tmp_path):
    run_quick("contact_patch_test", tmp_path)
    rows = json.loads((tmp_path / "contact_patch_test.json").read_text())
    assert max(row["stress"] for row in rows if row["pairing"].startswith("mortar")) < 1e-10
    assert max(row["stress"] for row in rows if row["pairing"] == "node_to_surface") > 0.1
