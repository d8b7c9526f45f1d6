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
from scipy import linalg, optimize

import hhr_dolfinx as hhr
from hhr_dolfinx.command.main import hhr as hhr_command
from hhr_dolfinx.errors import ConvergenceError, NotOfferedError, ReductionError, StudyError
from hhr_dolfinx.plugins.rivals import cones, informed, ours, primal, regression, sampled
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
    primal.penalty,
    primal.nitsche,
    sampled.weighted_cells,
    informed.informed_network,
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


def complete(full, snapshots):
    """A basis in which the full answers lie, and all unit forces."""
    unit = np.eye(len(full.problem.gaps))
    return with_supremizers(full, displacement_modes(snapshots, 14), unit), unit


def test_the_penalty_is_that_of_springs_in_the_contacts(hertz, hertz_snapshots):
    """Each condition yields by its force over the penalty: S and a diagonal, by non-negative least
    squares of its root.
    """
    model = primal.PrimalModel(hertz, *complete(hertz, hertz_snapshots), nitsche=False)
    theta = hertz.problem.amplitudes(np.array([0.3]))
    soft = hertz.schur + np.diag(hertz.schur.diagonal() / primal.PENALTY_FACTOR)
    free = hertz.stiffness.columns(hertz.problem.loads) @ theta
    slack = hertz.problem.gaps @ theta - hertz.problem.contact @ free
    root = linalg.cholesky(soft)
    known, _ = optimize.nnls(root, linalg.solve_triangular(root, -slack, trans=1))
    found = model.solve(0.3).forces()
    np.testing.assert_allclose(found, known, atol=1e-8 * known.max())
    exact = hertz.solve(0.3).forces()
    assert 1e-5 < np.linalg.norm(found - exact) / np.linalg.norm(exact) < 1e-2


def test_the_method_of_nitsche_is_consistent(hertz, hertz_snapshots):
    """The exact answer solves it, whatever its factor: forces that the displacement leaves over are
    those of the multipliers.
    """
    model = primal.PrimalModel(hertz, *complete(hertz, hertz_snapshots), nitsche=True)
    for mu in (0.168, 0.4321):
        check_like(model.solve(mu), hertz.solve(mu), displacement=1e-8, forces=1e-8)


def test_pressures_that_do_not_settle_are_no_answer(hertz, hertz_snapshots):
    model = primal.PrimalModel(hertz, *complete(hertz, hertz_snapshots), nitsche=False)
    model._push = -model._push  # contacts that pull: each overlap ends as soon as it counts
    with pytest.raises(ConvergenceError, match="do not settle"):
        model.solve(0.3)


def test_cells_share_the_work_of_the_stiffness(hertz, hertz_snapshots):
    basis = displacement_modes(hertz_snapshots, 6)
    works = sampled.works_of_cells(hertz, basis)
    known = basis.T @ (hertz.problem.own_stiffness @ basis)
    np.testing.assert_allclose(works.sum(axis=2), known, atol=1e-12 * np.abs(known).max())
    answers = basis.T @ hertz_snapshots.displacements
    weights = sampled.fitted(works, answers, 1e-9)
    assert weights.min() >= 0 and 0 < np.count_nonzero(weights) <= answers.size < len(weights)
    balanced = works @ weights @ answers
    np.testing.assert_allclose(balanced, known @ answers, atol=1e-5 * np.abs(known @ answers).max())


def test_equations_of_a_network_hold_for_exact_answers(hertz, hertz_snapshots):
    """Equilibrium in energy, and both signs and their product; the gradient by differences."""
    training = hhr.train(hertz.scene, [12], held_out=0, comm=MPI.COMM_SELF)
    exact = training.snapshots
    fields, forces = linalg.orth(exact.displacements), linalg.orth(exact.forces)
    equations = informed.ContactEquations.of(training, fields, forces)
    unknown = np.vstack([fields.T @ exact.displacements, forces.T @ exact.forces]).T
    terms = np.eye(hertz.problem.gaps.shape[1])
    theta = np.stack([terms @ hertz.problem.amplitudes(point) for point in exact.points])
    assert equations.errors(unknown, theta)[0] < 1e-10
    assert equations.errors(1.1 * unknown, theta)[0] > 1e-4
    random = np.random.default_rng(2)
    sizes = [(2, 5), (6, 5), (6, unknown.shape[1])]
    flat = random.normal(size=sum(rows * columns for rows, columns in sizes))
    scale = np.abs(unknown).max(axis=0)
    points = exact.points / 0.3 - 1

    def loss(weights):
        network = informed.Perceptron.of(weights, sizes)
        states = network.passed(points)
        size, along = equations.errors(scale * states[-1], theta)
        return size, network.pulled_back(states, along * scale)

    slope = loss(flat)[1]
    for direction in random.normal(size=(5, len(flat))):
        ahead, behind = (loss(flat + step * direction)[0] for step in (1e-6, -1e-6))
        assert slope @ direction == pytest.approx((ahead - behind) / 2e-6, rel=1e-5)


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
    still = np.zeros((trained.full_order.problem.free.size, 1))
    still[np.flatnonzero(trained.full_order.problem.free)[0]] = 1.0
    model = ConeModel(trained.full_order, still)
    model._gaps = model._gaps - 1.0  # an overlap that this mode does not move
    with pytest.raises(ConvergenceError, match="fits between the gaps"):
        model.solve(trained.snapshots.points[0])


def test_processes_are_those_of_the_library(trained):
    """Means of all coefficients at once against one process each; fine ones have short lengths."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import Matern, WhiteKernel

    space = trained.full_order.parameters
    points = regression.scaled(space, trained.snapshots.points)
    values = np.column_stack([np.sin(points[:, 0]), np.sin(9 * points[:, 0]) + points[:, 1]])
    found = regression._gaussian(points, values)
    queries = regression.scaled(space, space.random(20, 3))
    for k, column in enumerate(values.T):
        kernel = Matern(np.ones(2), (1e-2, 1e2), nu=2.5) + WhiteKernel(1e-6, (1e-10, 1e-1))
        process = GaussianProcessRegressor(kernel, random_state=0).fit(points, column)
        np.testing.assert_allclose(found(queries)[:, k], process.predict(queries), atol=1e-8)
    assert found.lengths[1, 0] < 0.5 * found.lengths[0, 0]


@pytest.mark.parametrize("points", [[[0.1, 0.2], [0.2, 0.2], [0.3, 0.2], [0.4, 0.2]], [[0.1, 0.2]]])
def test_points_on_a_line_are_no_training_of_radial_functions(points):
    with pytest.raises(ReductionError, match="not all on a plane"):
        regression._radial(np.array(points), np.ones((len(points), 2)))


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
        "penalty, DEIM",
        "Nitsche, DEIM",
        "ECSW and NNMF",
        "physics-informed network",
        "neural network",
    } <= methods
    assert all("refused" in row or row["online_s"] > 0 for row in rows)
