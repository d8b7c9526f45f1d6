"""Bounds of errors: no error exceeds them, they are near, and they are refused where nothing is proved."""

import dataclasses

import hertz_half_discs as demo
import numpy as np
import pytest
from kept_values import array, rewrite_model
from scenes import pressed_block, pressed_pair
from test_plastic import tube

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.bounds import energy_directions, error_bound
from hhr_dolfinx.errors import BoundError, ModelFileError, ParameterError, ReductionError


def errors_of(full, model, points):
    """Estimates and true errors: primal in energy, dual in the S norm, relative to the exact answer too."""
    stiffness, schur = full.problem.stiffness, full.schur
    rows = []
    for point in points:
        exact, answer = full.solve(point), model.solve(point, outside="ignore")
        field, forces = exact.displacement(), exact.forces()
        moved, pushed = answer.displacement() - field, answer.forces() - forces
        true = [np.sqrt(moved @ (stiffness @ moved)), np.sqrt(max(pushed @ schur @ pushed, 0.0))]
        sizes = [np.sqrt(field @ (stiffness @ field)), np.sqrt(max(forces @ schur @ forces, 0.0))]
        rows.append([*answer.estimate()[1:5], *true, *sizes])
    return np.array(rows).T


def check(full, model, points):
    """No error exceeds its bound; effectivities where an error is more than round-off."""
    primal, dual, primal_relative, dual_relative, moved, pushed, field, forces = errors_of(full, model, points)
    assert (moved <= primal).all() and (pushed <= dual).all()
    assert (moved <= primal_relative * field * (1 + 1e-9)).all()
    assert (pushed <= dual_relative * forces * (1 + 1e-9) + 1e-14).all()
    off, away = moved > 1e-6 * field, pushed > 1e-6 * forces
    return primal[off] / moved[off], dual[away] / pushed[away]


def test_bounds_of_the_half_discs(hertz, hertz_reduction):
    """Measured: 1.000 in the median, 1.15 at 95 %."""
    primal, dual = check(hertz, hertz_reduction, hertz.parameters.random(100, 0))
    assert np.median(primal) < 1.1 > np.median(dual) and np.percentile([primal, dual], 95, axis=1).max() < 2


@pytest.mark.parametrize("cone", [False, True])
def test_bounds_of_poor_models_and_of_any_forces(hertz, hertz_snapshots, cone):
    """Three snapshots: errors of a tenth and more, and bounds as near as ever."""
    poor = hhr.build(hertz, hertz_snapshots.take([3, 15, 28]), hhr.Recipe(cone=cone).as_it_is())
    primal, dual = check(hertz, poor, hertz.parameters.random(100, 1))
    assert len(primal) > 50 < len(dual) and np.median(primal) < 1.1 and np.median(dual) < 1.1


def test_a_bound_of_any_field_and_forces(hertz):
    """The proof asks for nothing but forces that do not pull: random ones, and random fields."""
    rng, problem = np.random.default_rng(0), hertz.problem
    basis = np.linalg.qr(rng.standard_normal((problem.free.size, 6)) * problem.free[:, None])[0]
    bound = error_bound(hertz, basis)
    for point in hertz.parameters.random(30, 2):
        exact, theta = hertz.solve(point), problem.theta(point)
        forces = np.maximum(exact.forces() * rng.uniform(0.5, 1.5), rng.uniform(-1, 0.2, exact.forces().size))
        unknown = 1e-3 * rng.standard_normal(6)
        slack = problem.gaps @ theta - problem.contact @ (basis @ unknown)
        found = bound.at(point[None], theta).of(unknown[None], forces[None], lambda slack=slack: slack[None])[0]
        moved, pushed = basis @ unknown - exact.unknown, forces - exact.forces()
        assert np.sqrt(moved @ (problem.stiffness @ moved)) <= found.primal
        assert np.sqrt(pushed @ hertz.schur @ pushed) <= found.dual


def test_coordinates_are_those_of_the_energy(hertz):
    """Dependent columns too, to round-off of the columns and not of its root."""
    rng, stiffness = np.random.default_rng(0), hertz.problem.stiffness
    columns = rng.standard_normal((stiffness.shape[0], 5)) * hertz.problem.free[:, None]
    columns = np.hstack([columns, columns @ rng.standard_normal((5, 4))])
    lengths = np.sqrt(np.einsum("nk,nk->k", columns, stiffness @ columns))
    found = energy_directions(hertz.problem, columns, 1e-13 * lengths)[1]
    assert found.shape == (5, 9)
    for way in (*rng.standard_normal((5, 9)), np.append(np.linalg.pinv(columns[:, :5]) @ columns[:, 5], [-1, 0, 0, 0])):
        expected = columns @ way
        size = np.abs(way) @ lengths
        assert np.linalg.norm(found @ way) == pytest.approx(
            np.sqrt(expected @ (stiffness @ expected)), abs=1e-12 * size
        )


def test_pairs_of_blocks_in_all_hypotheses():
    """Imposed motions, sliding, loads and gaps as parameters; trained on so few points that errors are large."""
    for hypothesis in ("plane_strain", "axisymmetric", "solid"):
        full = hhr.FullOrderModel(pressed_pair(hypothesis, ((2.0, 0.3), (1.0, 0.2)), cells=3))
        snapshots = hhr.compute_snapshots(full, hhr.Sobol(4).points(full.parameters))
        for cone in (False, True):
            model = hhr.build(full, snapshots, hhr.Recipe(cone=cone).as_it_is())
            primal, dual = check(full, model, full.parameters.random(40, 3))
            assert len(dual) > 20 and np.median(dual) < 1.5, (hypothesis, cone)
            assert not len(primal) or np.median(primal) < 1.5, (hypothesis, cone)


def test_the_full_model_is_exact(hertz, hertz_reduction):
    assert hertz.solve(0.3).estimate() == ("bound", 0.0, 0.0, 0.0, 0.0, {}, 0.0, 0.0, 0.0, 0.0)
    first = hertz_reduction.solve(0.3).estimate()
    assert first.kind == "bound" and 0 < first.dual_relative < 0.2


def test_bounds_are_kept_in_files(hertz_reduction, tmp_path):
    hhr.save_model(tmp_path / "model.npz", hertz_reduction)
    stored = hhr.load_model(tmp_path / "model.npz")
    for mu in (0.16, 0.3, 0.44):
        mine, theirs = (model.solve(mu).estimate().shown() for model in (stored, hertz_reduction))
        # bounds of round-off are made of last digits, which are those of LAPACK here and of PETSc there
        assert mine == pytest.approx(theirs, rel=1e-6, abs=1e-12)


def test_what_is_not_proved_is_refused(hertz):
    """Bodies that flow, a stiffness of parameters, dependent rows, a K that is not symmetric."""
    flowing = hhr.FullOrderModel(tube(hhr.Plasticity(1.0, 1.0), 1.0, 4))
    bodies = ("E1", 0.3), (2.0, 0.3)
    varying = hhr.FullOrderModel(pressed_pair("plane_strain", bodies, {"E1": (1.0, 2.0)}, cells=2))
    dependent = type(hertz).__new__(type(hertz))
    dependent.__dict__.update(vars(hertz))
    dependent._schur = np.ones_like(hertz.schur)
    skew = type(hertz).__new__(type(hertz))
    skew.__dict__.update(vars(hertz))
    stiffness = hertz.problem.stiffness.copy()
    stiffness.data[1] *= 2
    skew.problem = dataclasses.replace(hertz.problem, stiffness_terms=(stiffness,))
    cases = {"bodies flow": flowing, "depends on parameters": varying, "dependent": dependent, "not symmetric": skew}
    for why, full in cases.items():
        with pytest.raises(BoundError, match=why):
            error_bound(full, np.zeros((full.problem.free.size, 1)))


def test_the_log_says_why_there_is_none(hertz, hertz_snapshots):
    left_out = dataclasses.replace(hhr.Recipe().as_it_is(), bound=False)
    assert hhr.build(hertz, hertz_snapshots, left_out).solve(0.3).estimate() is None


# ---------------------------------------------------------------- the way back to the full model


def test_no_answer_is_off_by_more_than_is_allowed(hertz, hertz_snapshots):
    """Three snapshots are too few for much of the box; the full model answers there and nowhere else."""
    poor = hhr.build(hertz, hertz_snapshots.take([3, 15, 28]), hhr.Recipe().as_it_is())
    model, points = hhr.FallbackModel(poor, hertz, 0.01), hertz.parameters.random(60, 4)
    primal, dual = [], []
    for point in points:
        found, exact = model.solve(point), hertz.solve(point)
        moved, pushed = found.displacement() - exact.displacement(), found.forces() - exact.forces()
        field, forces = exact.displacement(), exact.forces()
        primal.append(moved @ (hertz.problem.stiffness @ moved) / (field @ (hertz.problem.stiffness @ field)))
        dual.append(pushed @ hertz.schur @ pushed / (forces @ hertz.schur @ forces))
    assert np.sqrt(max(primal)) <= 0.01 and np.sqrt(max(dual)) <= 0.01
    assert model.asked == 60 and 0.1 < model.share < 0.9
    off = [max(poor.solve(point, outside="ignore").estimate()[3:5]) > 0.01 for point in points]
    assert model.fallen == sum(off)


def test_outside_the_training_and_other_mistakes(hertz, hertz_snapshots, hertz_reduction):
    half = hhr.build(hertz, hertz_snapshots.take(slice(0, 12)), hhr.Recipe().as_it_is())
    model = hhr.FallbackModel(half, hertz, 1e6)
    model.solve(0.44)
    assert model.share == 0, "the bound is what counts"
    model.solve(0.44, outside="refuse")
    assert model.share == 0.5
    bare = hertz_reduction.changed(fields=dataclasses.replace(hertz_reduction.fields, bound=None))
    with pytest.raises(BoundError, match="have no bound"):
        hhr.FallbackModel(bare, hertz)
    for tolerance in (0.0, -1.0, np.nan, "1 %", None):
        with pytest.raises(ParameterError, match="must be a positive number"):
            hhr.FallbackModel(hertz_reduction, hertz, tolerance)
    asked = model.asked
    with pytest.raises(ParameterError, match="outside"):
        model.solve(0.7)
    assert model.asked == asked


def test_the_full_model_must_be_that_of_the_scene(hertz, hertz_reduction):
    """Of another mesh, stiffness or box, or no full model at all."""
    softer = dataclasses.replace(
        demo.scene(), bodies=tuple(dataclasses.replace(b, young=14.0) for b in demo.scene().bodies)
    )
    wider = dataclasses.replace(demo.scene(), parameters=hhr.ParameterSpace(("mu",), (0.1,), (0.45,)))
    others = {"another scene": softer, "has the parameters": wider}
    for why, scene in others.items():
        with pytest.raises(ReductionError, match=why):
            hhr.FallbackModel(hertz_reduction, hhr.FullOrderModel(scene))
    for full in (None, hertz_reduction, hhr.FallbackModel(hertz_reduction, hertz)):
        with pytest.raises(ReductionError, match="is no full model"):
            hhr.FallbackModel(hertz_reduction, full)
    with pytest.raises(BoundError, match="have no bound"):
        hhr.FallbackModel(None, hertz)


def test_bodies_that_move_far_and_deform_little():
    """The relative bound is over the energy of the deformation, of which a rigid motion has none."""
    bodies, box = ((2.0, 0.3), (1.0, 0.2)), {"push": (1.0, 1.0 + 1e-6), "gap": (1.0, 1.0 + 1e-9)}
    full = hhr.FullOrderModel(pressed_pair("plane_strain", bodies, {**box, "slide": (0.0, 1e-7), "load": (0.0, 1e-7)}))
    snapshots = hhr.compute_snapshots(full, hhr.Sobol(3).points(full.parameters))
    model, stiffness = hhr.build(full, snapshots, hhr.Recipe().as_it_is()), full.problem.stiffness
    far = np.zeros(full.problem.free.size)
    far[full.problem.block_size - 1 :: full.problem.block_size] = np.where(full.problem.points[:, -1] > 1, -1.0, 0.0)
    for point in full.parameters.random(20, 6):
        exact, answer = full.solve(point), model.solve(point, outside="ignore")
        moved, field = answer.displacement() - exact.displacement(), exact.displacement() - far
        error, size = (np.sqrt(value @ (stiffness @ value)) for value in (moved, field))
        assert error <= answer.estimate().primal_relative * size * (1 + 1e-6) + 1e-14


def test_round_off_of_a_motion_that_strains_nothing():
    """Before contact an imposed motion moves a block rigidly: the field that cancels its lift has the round-off."""
    scene = pressed_block("plane_strain", cells=6)
    full = hhr.FullOrderModel(scene)
    snapshots = hhr.compute_snapshots(full, np.linspace(0.001, 0.1, 12)[:, None])
    model, stiffness = hhr.build(full, snapshots, hhr.Recipe().as_it_is()), full.problem.stiffness
    for push in np.linspace(0.001, 0.0099, 100):
        answer = model.solve(push)
        moved = answer.displacement() - full.solve(push).displacement()
        assert np.sqrt(max(moved @ (stiffness @ moved), 0.0)) <= answer.estimate().primal


@pytest.mark.parametrize("name", ["lower", "loads", "schur"])
def test_arrays_of_a_bound_that_cannot_be(name, hertz_reduction, tmp_path):
    """Signed anew after a change: a factor that is none, or coordinates of fewer conditions."""
    hhr.save_model(tmp_path / "model.npz", hertz_reduction)
    changes = {"lower": lambda a: 2 * a, "loads": lambda a: a[:3], "schur": lambda a: 0 * a}
    rewrite_model(tmp_path / "model.npz", array(f"fields.bound.{name}", changes[name]))
    with pytest.raises(ModelFileError, match="bound"):
        hhr.load_model(tmp_path / "model.npz")
