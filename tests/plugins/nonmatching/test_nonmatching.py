"""The hyper-reduced model of non-matching contact: closed RID, generalised saddle point, both rank
conditions.
"""

import dataclasses

import contact_patch_test as patch
import numpy as np
import pellet_cladding_nonmatching as demo
import pytest
from mpi4py import MPI
from needs import needs
from scenes import largest_difference, node_dofs, references_at, slope, whole_domain
from scipy import linalg

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import force_floor, relative_error
from hhr_dolfinx.certify.compare import compare_points
from hhr_dolfinx.certify.constants import assess
from hhr_dolfinx.errors import ReductionError, UnstableModelError
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.reduction.completion import ReconstructionData
from hhr_dolfinx.reduction.enrichment import enrich
from hhr_dolfinx.reduction.modes import pod
from hhr_dolfinx.reduction.projection import load_nodes, open_conditions, project, reduced_domain

MESH = {
    "radial_cells": 12,
    "axial_cells": 20,
    "cladding_radial_cells": 3,
    "cladding_axial_cells": 15,
}


@pytest.fixture(scope="module")
def pellet():
    """The demo's scene on a coarse mesh with its snapshots."""
    return hhr.train(demo.scene(**MESH), [12, 10], held_out=10, comm=MPI.COMM_SELF)


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
    """Equilibrium of the exact solution in the equations tested on A with the forces of A_lambda
    alone.
    """
    loads = problem.loads @ problem.amplitudes(problem.parameters.point(point))
    inside = problem.contact[sets.A_lambda].T @ solution.forces()[sets.A_lambda]
    return (
        np.abs((problem.stiffness @ solution.unknown + inside - loads)[sets.A]).max()
        / np.abs(loads).max()
    )


def test_a_closed_rid_is_consistent_and_an_open_one_is_refused(pellet):
    """The exact solution satisfies the equations of a closed RID to round-off.

    Not those of an open one.
    """
    problem = pellet.full_order.problem
    sets, twin = some_rid(problem)
    solution = pellet.full_order.solve([150.0, 5.0])
    assert residual(problem, sets, solution, [150.0, 5.0]) < 1e-10
    assert residual(problem, twin, solution, [150.0, 5.0]) > 1e-2
    basis = np.linalg.qr(pellet.snapshots.displacements[:, :5])[0]
    with pytest.raises(ReductionError, match="not closed"):
        project(problem, basis, twin)


def test_the_reduced_model_finds_the_exact_solution_of_a_saddle_point_with_two_matrices(pellet):
    """The exact displacement lies in the basis, so the exact forces are the answer.

    Only with B~1 and B~2 in place.
    """
    full_order, point = pellet.full_order, np.array([150.0, 5.0])
    problem = full_order.problem
    sets = reduced_domain(
        problem, np.array([*problem.contact_slaves[3:7], *load_nodes(problem)]), layers=1
    )
    assert len(sets.A_c) < len(sets.A_c_tilde)
    solution = full_order.solve(point)
    modes = pod(pellet.snapshots.displacements, 1e-5)[0][:, :4]
    basis = enrich(
        problem, np.linalg.qr(np.column_stack([solution.unknown, modes]))[0], sets, 3.0
    ).basis
    known = KnownStatuses(point[None], solution.active[sets.A_lambda][None])
    fields = ReconstructionData.of(problem, pellet.snapshots).reconstruction(problem, basis, sets)
    model = ReducedModel(project(problem, basis, sets), problem.parameters, fields, known=known)
    exact = solution.forces()[sets.A_lambda]
    assert exact.any()
    # measured 7e-14; 0.13 and 1.0 with one matrix in the place of the other
    assert model.solve(point).multipliers == pytest.approx(exact, abs=1e-10 * exact.max())
    assert largest_difference(basis @ model.solve(point).unknown, solution.unknown) < 1e-10


def test_constants_are_those_of_their_definitions(pellet):
    """(2.46), kappa, beta and the definiteness of S, with B~1 and B~2 apart: trial functions in the
    kernel of B~2.
    """
    problem = pellet.full_order.problem
    sets = reduced_domain(
        problem, np.array([*problem.contact_slaves[3:7], *load_nodes(problem)]), layers=1
    )
    basis = enrich(problem, pod(pellet.snapshots.displacements, 1e-5)[0][:, :4], sets, 3.0).basis
    reduced = project(problem, basis, sets)
    stability = assess(problem, basis, sets, reduced)
    assert np.abs(reduced.contact_test - reduced.contact_trial).max() > 1e-3
    one, two = (linalg.svdvals(table) for table in (reduced.contact_test, reduced.contact_trial))
    assert stability.kappa_B == pytest.approx(one[0] / one[-1])
    assert stability.kappa_B_2 == pytest.approx(two[0] / two[-1])
    assert stability.euclidean.beta_HR_2 == pytest.approx(two[-1])  # V is orthonormal
    S = reduced.contact_trial @ np.linalg.solve(reduced.stiffness, reduced.contact_test.T)
    lowest = np.linalg.eigvalsh((S + S.T) / 2)[0] / np.linalg.norm(S, 2)
    assert stability.contact_definite == pytest.approx(lowest, rel=1e-6)
    test, trial = linalg.null_space(reduced.contact_test), linalg.null_space(reduced.contact_trial)
    cut = linalg.orth(np.where(np.isin(np.arange(len(basis)), sets.A)[:, None], basis, 0.0) @ test)
    # in orthonormal bases of the test and trial functions themselves
    a = cut.T @ (problem.stiffness @ linalg.orth(basis @ trial))
    assert stability.euclidean.alpha_prime == pytest.approx(linalg.svdvals(a)[-1], rel=1e-6)
    gram = linalg.sqrtm(np.linalg.inv(basis[sets.A].T @ basis[sets.A])).real
    assert stability.euclidean.beta_HR == pytest.approx(
        linalg.svdvals(gram @ reduced.contact_test.T)[-1], rel=1e-6
    )


def test_two_answers_to_one_parameter_are_caught(pellet):
    """The thesis' recipe without layers: started from elsewhere, it answers otherwise.

    held-out points tell.
    """
    recipe = hhr.Recipe.thesis(
        1e-6, nodes=(hhr.Deim(), hhr.ForceDeim(1e-3), hhr.LoadNodes()), enrichment=hhr.Enrich(1.0)
    )
    reduction = pellet.build(recipe, checked=False)
    assert reduction.offline.stability.contact_definite < -0.5
    problem = pellet.full_order.problem
    held_out = hhr.compute_snapshots(pellet.full_order, problem.parameters.random(60, seed=9))
    comparison = compare_points(
        pellet.full_order, reduction, held_out, force_floor(problem, pellet.snapshots)
    )
    answered = np.isfinite(comparison.primal)
    assert np.isinf(comparison.dual[answered]).any(), "two answers"
    with pytest.raises(UnstableModelError):
        hhr.build(pellet.full_order, pellet.snapshots, recipe, held_out)


def test_an_imposed_slave_surface_keeps_only_conditions_that_act_inside():
    """A rigid die driven through its contact side: where its masters lie outside the RID a row
    would be zero.
    """
    scene = patch.scene(hhr.NodeToSurface, (16, 4), (8, 4), poisson=0.3, bulge=0.05)
    contact_side = two_blocks.side(two_blocks.SECOND, 1, False)
    driven = tuple(
        hhr.Displacement(contact_side, k, slope("push", -1.0 if k else 0.0)) for k in (0, 1)
    )
    scene = dataclasses.replace(scene, displacements=(*scene.displacements, *driven))
    problem = hhr.FullOrderModel(scene, MPI.COMM_SELF).problem
    sets = reduced_domain(problem, problem.contact_slaves[[4]], layers=1)
    rows = problem.contact[sets.A_lambda][:, sets.A_c]
    assert (np.abs(rows.toarray()).sum(axis=1) > 0).all()
    assert open_conditions(problem, sets).size == 0


@pytest.mark.parametrize(
    "pairing", ["node_to_surface", pytest.param("mortar", marks=needs("mortar")), "double_pass"]
)
def test_whole_basis_on_the_whole_domain_is_the_full_order(pairing):
    """All FE functions and all cells: the reduced system is the full one."""
    problem = hhr.FullOrderModel(demo.scene(pairing, **MESH), MPI.COMM_SELF).problem
    free = np.flatnonzero(problem.free)
    basis = np.zeros((problem.free.size, free.size))
    basis[free, np.arange(free.size)] = 1.0
    reduced = project(problem, basis, whole_domain(problem))
    assert np.array_equal(reduced.contact_test, reduced.contact_trial)
    assert reduced.contact_test == pytest.approx(problem.contact[:, free].toarray(), abs=0)
    assert reduced.stiffness == pytest.approx(
        problem.stiffness[free][:, free].toarray(), rel=1e-12, abs=1e-9
    )


def test_enrichment_gives_both_matrices_full_rank(pellet):
    """A basis that vanishes on A leaves B~1 without rank, one that opens no gap leaves B~2
    without.
    """
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
        ranks = [
            np.linalg.matrix_rank(table) for table in (reduced.contact_test, reduced.contact_trial)
        ]
        assert np.isinf(enriched.kappas[0])
        assert ranks == [len(sets.A_lambda)] * 2, kind
        assert np.linalg.cond(reduced.contact_test) == pytest.approx(enriched.kappas[-1], rel=1e-8)
        slave_dofs = node_dofs(problem, problem.contact_slaves)
        added = enriched.basis - basis @ (basis.T @ enriched.basis)
        added = added - basis @ (basis.T @ added)
        moved = np.flatnonzero(np.abs(problem.free * 1.0) * np.abs(added).max(axis=1) > 1e-8)
        support = np.union1d(slave_dofs, np.flatnonzero(np.abs(basis).max(axis=1) > 0))
        assert np.isin(moved, support).all()


def test_a_turned_scene_has_the_same_reduced_model():
    """With basis and RID carried along, K~, B~1, B~2 and gaps do not change.

    Only what DEIM picks may.
    """
    reduced, errors = {}, {}
    points = [[0.03, 0.0], [0.05, 0.02], [0.07, 0.01], [0.1, 0.05]]
    for angle in (0.0, np.sqrt(2)):
        turned = patch.scene(
            hhr.NodeToSurface, (8, 4), (11, 4), poisson=0.3, angle=angle, bulge=0.02
        )
        full_order = hhr.FullOrderModel(turned, MPI.COMM_SELF)
        problem = full_order.problem
        place = problem.points @ patch.geometry.rotation(2, angle)
        middle = problem.contact_slaves[np.argsort(place[problem.contact_slaves, 0])[3:7]]
        sets = reduced_domain(problem, middle, layers=1)
        fields = np.column_stack([full_order.solve(point).unknown for point in points])
        basis, triangle = np.linalg.qr(fields)
        reduced[angle] = project(problem, basis * np.sign(np.diag(triangle)), sets)
        training = hhr.compute_snapshots(full_order, problem.parameters.grid([12, 6]))
        model = hhr.build(full_order, training)
        displacement, exact = (
            one.solve([0.083, 0.021]).displacement() for one in (model, full_order)
        )
        errors[angle] = np.linalg.norm(displacement - exact) / np.linalg.norm(exact)
    for name in ("stiffness", "loads"):
        ours, turned = (getattr(item, name) for item in reduced.values())
        assert turned == pytest.approx(ours, abs=1e-9 * np.abs(ours).max())
    for name in ("contact_test", "contact_trial", "gaps"):
        ours, turned = (linalg.svdvals(getattr(item, name)) for item in reduced.values())
        assert turned == pytest.approx(ours, abs=1e-9)
    assert max(errors.values()) < 2e-3


@needs("studies")
@pytest.mark.parametrize(
    "pairing", ["node_to_surface", pytest.param("mortar", marks=needs("mortar"))]
)
def test_errors_of_the_demo_on_a_coarse_mesh(pellet, pairing):
    """The default recipe on 20 random points: what the demo shows on the fine mesh holds on a
    coarse one.
    """
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
    found, exact = (
        model.solve(demo.POINT).displacement() for model in (reduction, pellet.full_order)
    )
    assert relative_error(found, exact, problem.mass) < 0.01
