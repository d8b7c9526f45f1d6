"""Rivals of studies: programs by brute force, reproduced answers, and exactness where it holds."""

import dataclasses
import itertools

import numpy as np
import pytest
from click.testing import CliRunner
from contract import blocks
from mpi4py import MPI
from needs import needs
from scenes import check_like, pressed_block
from scipy import linalg

import hhr_dolfinx as hhr
from hhr_dolfinx.command.main import hhr as hhr_command
from hhr_dolfinx.errors import ConvergenceError, NotOfferedError, ReductionError, StudyError
from hhr_dolfinx.plugins.rivals import cones, ours, regression
from hhr_dolfinx.plugins.rivals.projection import (
    ConeModel,
    displacement_modes,
    least_distance,
    with_supremizers,
)
from hhr_dolfinx.plugins.studies.study import rivals_of

WITH_FORCES = (
    cones.nnmf,
    cones.cone_projected_greedy,
    cones.inf_sup_greedy,
    cones.reduced_basis,
    cones.dictionary,
    regression.gaussian_process,
    regression.radial_functions,
    regression.polynomials,
    regression.neural_network,
    ours.thesis,
)


@pytest.fixture(scope="module")
def trained():
    return hhr.train(blocks(), hhr.Sobol(32), held_out=0, comm=MPI.COMM_SELF)


def by_enumeration(rows, slack):
    """Shortest x with A x <= s: of all sets of equalities the one whose multipliers are >= 0."""
    count, best = len(slack), None
    for size in range(count + 1):
        for chosen in map(list, itertools.combinations(range(count), size)):
            point = linalg.pinv(rows[chosen]) @ slack[chosen] if chosen else np.zeros(rows.shape[1])
            fits = (rows @ point <= slack + 1e-9).all()
            if fits and (best is None or np.linalg.norm(point) < np.linalg.norm(best)):
                best = point
    return best


@pytest.mark.parametrize("seed", range(20))
def test_least_distance_is_that_of_all_sets_of_equalities(seed):
    """More rows than unknowns too, which no active set on a Schur complement takes."""
    random = np.random.default_rng(seed)
    rows = random.normal(size=(6, random.integers(2, 8)))
    slack = random.normal(size=6) + 0.5
    forces, _ = least_distance(rows, slack)
    known = by_enumeration(rows, slack)
    if forces is None:
        assert known is None
        return
    assert forces.min() >= 0
    np.testing.assert_allclose(-rows.T @ forces, known, atol=1e-9)


def test_nothing_fits_between_gaps_that_exclude_each_other():
    rows = np.array([[1.0, 0.0], [-1.0, 0.0]])
    assert least_distance(rows, np.array([-1.0, -1.0]))[0] is None
    forces, _ = least_distance(rows, np.array([-1e-9, 1.0]))
    np.testing.assert_allclose(forces, [1e-9, 0.0], rtol=1e-9)


def test_all_unit_vectors_find_the_forces(hertz, hertz_snapshots):
    """With the whole dual space, supremizers make the model exact: condensation in disguise."""
    cone = np.eye(55)
    basis = with_supremizers(hertz, displacement_modes(hertz_snapshots, 14), cone)
    model = ConeModel(hertz, basis, cone)
    for mu in (0.168, 0.4321):
        check_like(model.solve(mu), hertz.solve(mu), displacement=1e-8, forces=1e-8)


@needs("moduli")
def test_moduli_that_vary_are_projected():
    """K of a point, not of the middle of the box: the space of a few points holds their answers."""
    scene = pressed_block("plane_strain", cells=3)
    bodies = tuple(dataclasses.replace(body, young="E") for body in scene.bodies)
    box = hhr.ParameterSpace(
        (*scene.parameters.names, "E"),
        (*scene.parameters.lower, 1.0),
        (*scene.parameters.upper, 9.0),
    )
    varied = dataclasses.replace(scene, parameters=box, bodies=bodies)
    full = hhr.FullOrderModel(varied, MPI.COMM_SELF)
    assert full.problem.varies
    points = box.random(12, 3)
    known = hhr.compute_snapshots(full, points)
    model = ConeModel(full, displacement_modes(known, 99))
    pressed = points[np.linalg.norm(known.forces, axis=0).argmax()]
    exact = full.solve(pressed)
    assert exact.forces().max() > 0
    error = model.solve(pressed).displacement() - exact.displacement()
    assert np.linalg.norm(error) < 1e-7 * np.linalg.norm(exact.displacement())


@pytest.mark.parametrize("rival", [cones.reduced_basis, cones.dictionary])
def test_training_answers_are_reproduced(rival, hertz):
    """Haasdonk, Salomon and Wohlmuth 2012: what spans the bases is found again."""
    scene = hertz.scene
    training = hhr.train(scene, [12], held_out=0, comm=MPI.COMM_SELF)
    model = next(iter(rival(training))).made()
    for point in training.snapshots.points:
        check_like(model.solve(point), hertz.solve(point), displacement=1e-7, forces=1e-6)


def test_a_greedy_cone_by_hand():
    """The largest column, then the one farthest from its cone; a multiple is never picked."""
    forces = np.array([[3.0, 6.0, 0.0, 1.0], [0.0, 0.0, 2.0, 1.0], [0.0, 0.0, 0.0, 0.5]])
    basis = cones.greedy_cone(forces, 10)
    assert basis[:, 0].tolist() == [1, 0, 0] and basis[:, 1].tolist() == [0, 1, 0]
    assert basis.shape[1] == 3
    assert cones.greedy_cone(forces, 2).shape[1] == 2
    # a small column far away counts by its size, or over it
    forces = np.array([[9.0, 9.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.5]])
    assert not cones.greedy_cone(forces, 2)[2].any()
    assert cones.greedy_cone(forces, 2, relative=True)[2, 1] == 1


def test_nonnegative_factors_rebuild_a_factorised_matrix():
    rng = np.random.default_rng(1)
    forces = rng.uniform(size=(8, 2)) @ rng.uniform(size=(2, 30))
    factors = cones.nonnegative_factors(forces, 2)
    assert factors.min() >= 0
    rebuilt = factors @ np.linalg.lstsq(factors, forces, rcond=None)[0]
    assert np.linalg.norm(rebuilt - forces) < 1e-3 * np.linalg.norm(forces)


def test_supremizers_are_added_until_the_model_is_stable(hertz):
    """The inf-sup constant in the norms in which that of the full model is 1."""
    training = hhr.train(hertz.scene, [12], held_out=0, comm=MPI.COMM_SELF)
    fields = next(iter(cones.inf_sup_greedy(training))).made().fields
    problem, cone, basis = hertz.problem, fields.cone, fields.basis
    root = linalg.cholesky(hertz.schur)
    span = linalg.solve_triangular(root, linalg.orth(root @ cone, rcond=2 * cones.DEPENDENT))
    primal = linalg.cholesky(basis.T @ (problem.stiffness @ basis), lower=True)
    rows = linalg.solve_triangular(primal, (span.T @ (problem.contact @ basis)).T, lower=True)
    beta = np.linalg.svd(rows, compute_uv=False)[-1]
    assert cones.STABLE <= beta <= 1 + 1e-9
    modes = displacement_modes(training.snapshots, cones.MOST_MODES).shape[1]
    assert basis.shape[1] < modes + cone.shape[1]  # fewer than one for each dual function


@pytest.mark.parametrize("rival", [regression.polynomials, regression.radial_functions])
def test_what_is_linear_in_parameters_is_found_exactly(rival):
    """A block that touches all over from the first load on: forces are linear in the loads."""
    scene = blocks()
    names = scene.parameters.names
    low = np.array(scene.parameters.lower) + 0.6 * np.subtract(
        scene.parameters.upper, scene.parameters.lower
    )
    box = hhr.ParameterSpace(names, tuple(low), scene.parameters.upper)
    training = hhr.train(
        dataclasses.replace(scene, parameters=box), hhr.Sobol(40), held_out=0, comm=MPI.COMM_SELF
    )
    point = box.random(1, 5)[0]
    exact = training.full_order.solve(point)
    model = next(iter(rival(training))).made()
    assert training.snapshots.active.all() and exact.active.all()
    check_like(model.solve(point), exact, displacement=1e-6, forces=1e-6)


def test_modes_alone_find_displacements_and_no_forces(trained):
    """Contacts that are closed in all of training are closed in all modes, which no force moves:
    the condition of solvability, thesis (3.1), fails without supremizers.
    """
    model = next(iter(cones.galerkin(trained))).made()
    assert model.sizes[0] < model.sizes[1]
    for point in trained.snapshots.points:
        exact, found = trained.full_order.solve(point), model.solve(point)
        error = np.linalg.norm(found.displacement() - exact.displacement())
        assert error < 1e-8 * np.linalg.norm(exact.displacement())


@pytest.mark.parametrize("rival", WITH_FORCES, ids=lambda rival: rival.__name__)
def test_each_rival_answers_near_its_training(rival, trained):
    """Within a third of the largest force at each training point but one, where contact grazes."""
    model = next(iter(rival(trained))).made()
    largest = np.linalg.norm(trained.snapshots.forces, axis=0).max()
    off = []
    for point, forces in zip(trained.snapshots.points, trained.snapshots.forces.T, strict=True):
        answer = model.solve(point, outside="ignore", raise_on_failure=False)
        off.append(np.linalg.norm(answer.forces() - forces) / largest if answer.converged else 1.0)
    assert np.sort(off)[-2] < 1 / 3


@needs("friction", "floating", "shapes")
def test_scenes_that_rivals_are_not_for_are_refused_by_name(trained):
    scene = blocks()
    rubbing = dataclasses.replace(
        scene, contacts=tuple(dataclasses.replace(one, friction=0.3) for one in scene.contacts)
    )
    for given, reason in ((rubbing, "friction"), (blocks(free=True), "contact alone holds")):
        full = hhr.FullOrderModel(given, MPI.COMM_SELF)
        with pytest.raises(NotOfferedError, match=reason):
            ConeModel(full, np.eye(full.problem.free.size, 3))
    with pytest.raises(ReductionError, match="a row >= 0 for each"):
        ConeModel(trained.full_order, displacement_modes(trained.snapshots, 3), np.eye(3))
    with pytest.raises(ConvergenceError, match="fits between the gaps"):
        still = np.zeros((trained.full_order.problem.free.size, 1))
        still[np.flatnonzero(trained.full_order.problem.free)[0]] = 1.0
        ConeModel(trained.full_order, still).solve(trained.snapshots.points[
            np.linalg.norm(trained.snapshots.forces, axis=0).argmax()
        ])  # fmt: skip


def test_names_of_rivals():
    assert list(rivals_of([])(None)) == []
    with pytest.raises(StudyError, match=r"rivals nobody are unknown: all, or of galerkin, nnmf"):
        rivals_of(["nobody"])


@pytest.mark.slow
@needs("local_models", "baselines")
def test_all_rivals_by_command_on_a_scene_of_its_own(tmp_path):
    """Each is a row with errors, or with the reason why there is none."""
    import json

    (tmp_path / "pair.py").write_text("from contract import blocks\nscene = blocks()\n")
    words = ["study", str(tmp_path / "pair.py"), "--sobol", "32", "--tests", "12", "--queries"]
    words += ["12", "--rivals", "all", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(hhr_command, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    rows = json.loads((tmp_path / "out/report.json").read_text())["work_precision"]
    methods = {row["method"] for row in rows if "refused" not in row}
    assert {
        "POD-Galerkin",
        "NNMF",
        "cone-projected greedy",
        "inf-sup greedy",
        "reduced basis",
        "dictionary",
        "Gaussian process",
        "radial functions",
        "polynomials",
        "neural network",
    } <= methods
    assert all("refused" in row or row["online_s"] > 0 for row in rows)
