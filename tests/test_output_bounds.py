"""Bounds of outputs: no error exceeds them, they are near where they are sharp, and what jumps has none."""

import dataclasses
import pickle

import hertz_half_discs as hertz_demo
import numpy as np
import pytest
from kept_values import array, put, rewrite_model
from scenes import pressed_pair
from test_outputs import small_pellet

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ModelFileError
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.models.bounds import output_bound
from hhr_dolfinx.models.functionals.functional import Functional

POOR = hhr.Recipe(cone=True).as_it_is()
"""Forces and displacements of training alone, so that errors are large."""
JUMPS = {"area", "lost"}
"""Outputs of the pellet without a bound."""


def with_outputs(scene, lower, upper, dim):
    """A scene of two bodies, tagged ``lower`` and ``upper``, with outputs of every kind."""
    outputs = (
        hhr.LargestPressure("peak", 0),
        hhr.ContactForce("force", 0, tuple(np.eye(dim)[dim - 1])),
        hhr.ContactWidth("area", 0),
        hhr.VonMises("largest", lower),
        hhr.VonMises("mean", upper, "mean"),
        hhr.ElasticEnergy("energy"),
        hhr.LinearForm("moved", lambda a: a.test[0] * a.dx(lower)),
    )
    return dataclasses.replace(scene, outputs=outputs)


def check(full, model, points):
    """No error exceeds its bound; effectivities by name where an error is more than round-off."""
    found = {}
    for point in points:
        exact, answer = full.solve(point).outputs(), model.solve(point, outside="ignore")
        values, bounds = answer.outputs(), answer.estimate().outputs
        for name, bound in bounds.items():
            found.setdefault(name, []).append([abs(values[name] - exact[name]), bound, abs(exact[name])])
    ratios = {}
    for name, rows in found.items():
        error, bound, size = np.array(rows).T
        assert np.isfinite(bound).all() and (error <= bound).all(), (name, (error / bound).max())
        off = error > 1e-7 * size.max()
        ratios[name] = bound[off] / error[off]
    return ratios


@pytest.fixture(scope="module")
def pellet():
    return hhr.train(small_pellet(), (8, 6), held_out=5)


@pytest.fixture(scope="module")
def poor(pellet):
    """Of a seventh of the training."""
    return hhr.build(pellet.full_order, pellet.snapshots.take(slice(None, None, 7)), POOR)


def test_outputs_of_the_pellet(pellet, poor):
    """Measured: 1.000 in the median, 1.000 at 95 %, 1.006 at most, of a usual and of a poor model."""
    full = pellet.full_order
    for model in (pellet.build(checked=False), poor):
        ratios = check(full, model, full.parameters.random(60, 0))
        assert set(ratios) == {output.name for output in full.scene.outputs} - JUMPS
        for name, row in ratios.items():
            assert model is not poor or len(row) > 50, name  # most errors of the other one are round-off
            assert not len(row) or (np.median(row) < 1.01 and np.percentile(row, 95) < 2), name


def test_outputs_read_at_the_nearer_field_or_bounded_by_energies(pellet, poor, monkeypatch):
    """Von Mises' stress of a large body has too many rows. Measured medians: 14 and 5, and 122 of a part of a body."""
    full, points = pellet.full_order, pellet.full_order.parameters.random(20, 1)
    ways = {}
    for most in (0, 10**12):
        monkeypatch.setattr(output_bound, "MOST_ENTRIES", most)
        model = hhr.build(full, pellet.snapshots.take(slice(None, None, 7)), POOR)
        ways[most] = check(full, model, points)
    for name in ("largest", "mean", "below", "peak"):
        assert np.median(ways[10**12][name]) < 1.01 and np.median(ways[0][name]) >= np.median(ways[10**12][name]), name


def test_outputs_of_the_half_discs():
    """Of three snapshots; all 31 leave errors of round-off, which are bounded too."""
    scene = hertz_demo.scene(arc_segments=28, flat_segments=7)
    lower, upper = (body.tag for body in scene.bodies)
    full = hhr.FullOrderModel(with_outputs(scene, lower, upper, 2))
    snapshots = hhr.compute_snapshots(full, full.parameters.grid([31]))
    for some in ([3, 15, 28], slice(None)):
        model = hhr.build(full, snapshots.take(some), POOR)
        ratios = check(full, model, full.parameters.random(60, 2))
        assert set(ratios) == {"peak", "force", "largest", "mean", "energy", "moved"}


@pytest.mark.parametrize("hypothesis", ["plane_stress", "axisymmetric", "solid"])
def test_outputs_of_pairs_of_blocks(hypothesis):
    """Imposed motions, loads and gaps as parameters; few points of training, so that errors are large."""
    bodies, dim = ((2.0, 0.3), (1.0, 0.2)), 3 if hypothesis == "solid" else 2
    scene = with_outputs(pressed_pair(hypothesis, bodies, cells=3), two_blocks.FIRST, two_blocks.SECOND, dim)
    full = hhr.FullOrderModel(scene)
    model = hhr.build(full, hhr.compute_snapshots(full, hhr.Sobol(4).points(full.parameters)), POOR)
    ratios = check(full, model, full.parameters.random(40, 3))
    for name in ("force", "energy", "moved", "peak"):
        assert len(ratios[name]) > 20 and np.percentile(ratios[name], 95) < 1.1, name


def test_constants_are_those_of_directions_that_attain_them(pellet):
    """Lipschitz constants are neither too small nor far too large: beside random directions, and the best of them."""
    rng, items = np.random.default_rng(0), {item.name: item for item in pellet.full_order.functionals.items}
    size = pellet.full_order.problem.free.size
    for name in ("below", "peak", "largest", "mean"):
        item = items[name]
        moves, pushes = rng.standard_normal((size, 3)), rng.standard_normal((len(pellet.full_order.schur), 3))
        rows = item.matrix(size) @ moves
        constant = item.steepness(rows.__getitem__, pushes)
        zero = np.zeros_like
        best = 0.0
        for weights in rng.standard_normal((200, 3)):
            weights /= np.linalg.norm(weights)
            # from nothing, and about another state
            for start in (zero(weights), 5 * rng.standard_normal(3)):
                ends = [
                    item.value(state_of(pellet.full_order, pushes @ way, rows @ way))
                    for way in (start, start + weights)
                ]
                best = max(best, abs(ends[1] - ends[0]))
        assert best <= constant * (1 + 1e-12) and constant < 1.7 * best, name


def state_of(full, forces, measured):
    """What an output is a function of."""
    from hhr_dolfinx.models.functionals.functional import State

    point = full.problem.middle
    return State(forces, measured, point, np.zeros(full.problem.gaps.shape[1]), lambda: np.zeros((0, 4)))


def test_the_full_model_has_exact_outputs(pellet):
    found = pellet.full_order.solve((100.0, 3.0)).estimate().outputs
    assert found == {output.name: 0.0 for output in pellet.full_order.scene.outputs}


def test_outputs_are_evaluated_when_they_are_read(pellet, poor, monkeypatch):
    asked = []
    monkeypatch.setattr(
        type(poor.fields), "measured", lambda *given: asked.append(1) or pytest.fail("nobody reads an output")
    )
    assert poor.solve((100.0, 3.0), outside="ignore").estimate().dual > 0 and not asked


def test_bounds_are_kept_in_files_and_pickles(poor, tmp_path):
    hhr.save_model(tmp_path / "model.npz", poor)
    stored = hhr.load_model(tmp_path / "model.npz")
    for point in poor.parameters.random(3, 5):
        found = poor.solve(point, outside="ignore").estimate()
        again = stored.solve(point, outside="ignore").estimate()
        # LAPACK in the place of PETSc: last digits
        assert len(found.outputs) == 11 and again.outputs == pytest.approx(found.outputs, rel=1e-6)
        assert again.shown() == pytest.approx(found.shown(), rel=1e-6, abs=1e-12)
        assert pickle.loads(pickle.dumps(found)) == found and "radial" in repr(found)
        assert pickle.loads(pickle.dumps(poor)).solve(point, outside="ignore").estimate() == found


@pytest.mark.parametrize("change", [
    *(array(f"fields.output_bound.{name}", lambda a: a[:-1]) for name in ("steepness", "free", "pressed")),
    array("fields.output_bound.steepness", lambda a: -0.5 * np.abs(a)), put("fields.functionals", None),
])  # fmt: skip
def test_arrays_that_cannot_be(change, poor, tmp_path):
    """Signed anew after a change: of fewer outputs or rows, a negative constant, bounds of outputs without outputs."""
    hhr.save_model(tmp_path / "model.npz", poor)
    rewrite_model(tmp_path / "model.npz", change)
    with pytest.raises(ModelFileError, match="output"):
        hhr.load_model(tmp_path / "model.npz")


@dataclasses.dataclass(frozen=True, eq=False)
class Squared(Functional):
    """A functional of a user's own, of which no constant is known."""

    def value(self, state):
        return float(state.measured @ state.measured)


@dataclasses.dataclass(frozen=True)
class SquareAt:
    name: str
    unit: str = ""

    def prepared(self, probe):
        one = np.ones(1, dtype=np.int64)
        return Squared(self.name, self.unit, 1, 0 * one, 7 * one, np.ones(1))


def test_outputs_of_a_users_own_are_left_out_unless_they_know_a_constant():
    scene = pressed_pair("plane_strain", ((2.0, 0.3), (1.0, 0.2)), cells=3)
    full = hhr.FullOrderModel(dataclasses.replace(scene, outputs=(SquareAt("square"), hhr.LargestPressure("peak", 0))))
    model = hhr.build(full, hhr.compute_snapshots(full, hhr.Sobol(4).points(full.parameters)), POOR)
    assert set(model.solve(full.problem.middle).estimate().outputs) == {"peak"}
