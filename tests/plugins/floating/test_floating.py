"""Bodies that nothing but contact holds: equilibrium, what they rest on, what is free after that,
reduced models.
"""

import warnings

import gmsh
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mpi4py import MPI
from needs import MORTAR, NODE_TO_SURFACE, mortar, needs
from scenes import block_scene, check_alike, kkt, lying, slope, slope_errors, space
from scipy.optimize import minimize

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import NotSolvableError, SceneWarning, UndeterminedWarning
from hhr_dolfinx.geometries import block
from hhr_dolfinx.geometries import stacked_blocks as blocks
from hhr_dolfinx.geometries.gmsh_model import mesh_of
from hhr_dolfinx.plugins.floating.statuses import FloatingEqualities, _nearest, floating_set
from hhr_dolfinx.reduction.exact import exact_condensation

# all of them may slide along the interface
pytestmark = pytest.mark.filterwarnings("ignore:body 2 .* moves along axis 0")


@pytest.mark.parametrize("tilt", [0.0, 0.3, -0.3])
@pytest.mark.parametrize("bulge", [0.0, 0.05, 0.5])
def test_forces_hold_the_body_and_nothing_else_does(bulge, tilt):
    """The force is known from balance alone: p on a width of 1, and tilt on a side that the gap
    makes shorter.

    Along the interface, where nothing drives it, the body stays at rest.
    """
    full = hhr.FullOrderModel(lying(bulge=bulge, tilt=tilt), MPI.COMM_SELF)
    kernel, places = full.problem.kernel, full.problem.contact_points[:, 0]
    assert kernel.idle.shape[1] == 1 and kernel.motions.shape[1] == 2
    for p in (1.0, 4.0, 10.0):
        answer = kkt(full, p)
        forces = answer.forces()
        assert forces.min() >= 0 and forces.sum() == pytest.approx(
            p + tilt * (1 - bulge), rel=1e-10
        )
        assert (
            full.problem.gaps @ full.problem.theta(p) - full.problem.contact @ answer.unknown
        ).min() > -1e-12
        # the resultant stands where the loads do
        assert places @ forces == pytest.approx(0.5 * p, abs=1e-9 * p)
        assert abs(kernel.idle.T @ answer.displacement()).max() < 1e-12


def test_what_nothing_holds_is_named_with_its_motion():
    resists = r"body 2 of scene 'floating', .* moves along axis 0, which no contact resists"
    with pytest.warns(SceneWarning, match=resists):
        hhr.FullOrderModel(lying(), MPI.COMM_SELF)
    lone = lying(contacts=(hhr.Obstacle(blocks.interface(blocks.LOWER_BLOCK, 2), (0.0, 1.0), 2.0),))
    for made, why in (
        (lying(sideways=0.1), r"moves along axis 0, which loads drive and no contact resists"),
        (lone, r"can move freely: it moves along axis 0, .*turns\. Impose"),
    ):
        with pytest.raises(NotSolvableError, match=f"body 2 .* {why}"):
            hhr.FullOrderModel(made, MPI.COMM_SELF)


LEFT, RIGHT, FLOOR, LID = (
    block.side(axis, upper=upper) for axis in (0, 1) for upper in (False, True)
)


def pulled(left, right, young=50.0):
    """A block of 2 by 1 on a floor, pressed by ``q`` and pulled on both sides, which nothing holds
    along the floor.
    """
    return block_scene(
        "pulled",
        {"p": (0.0, 2.0), "q": (1.0, 3.0)},
        upper=(2.0, 1.0),
        young=young,
        contacts=(hhr.Obstacle(FLOOR, (0.0, -1.0), 0.0),),
        loads=(hhr.Pressure(LID, slope("q")), hhr.Pressure(LEFT, left), hhr.Pressure(RIGHT, right)),
    )


@pytest.mark.filterwarnings("ignore:body 1 .* moves along axis 0")
@pytest.mark.parametrize("other", [slope("p", -1.0), "-p", "-p + 0 * q**2"])
def test_loads_that_balance_each_other_are_judged_by_their_sum(other):
    """The strain along the floor is ((1 - nu^2) p + nu (1 + nu) q) / E: uniform, in closed form."""
    full = hhr.FullOrderModel(pulled(slope("p", -1.0), other), MPI.COMM_SELF)
    answer = kkt(full, (1.5, 2.0))
    ends = [np.isclose(full.problem.points[:, 0], x) for x in (0.0, 2.0)]
    left, right = (answer.displacement().reshape(-1, 2)[end, 0] for end in ends)
    strain = ((1 - 0.3**2) * 1.5 + 0.3 * 1.3 * 2.0) / 50.0
    np.testing.assert_allclose(
        right, strain, rtol=1e-9
    )  # at rest in the mean: both ends move by half of the stretch
    np.testing.assert_allclose(left, -strain, rtol=1e-9)
    model = exact_condensation(
        full, hhr.compute_snapshots(full, full.parameters.random(4, 1)).known_statuses()
    )
    np.testing.assert_allclose(
        model.solve((1.5, 2.0)).displacement(), answer.displacement(), atol=1e-12
    )


@pytest.mark.parametrize("other", [slope("p", -1.001), "-p - 1e-6 * q", 0.5])
def test_loads_whose_sum_drives_a_free_body_are_refused(other):
    with pytest.raises(
        NotSolvableError, match="moves along axis 0, which loads drive and no contact resists"
    ):
        hhr.FullOrderModel(pulled(slope("p", -1.0), other), MPI.COMM_SELF)


@pytest.mark.parametrize("young", [1000.0, pytest.param("E", marks=needs("moduli"))])
def test_gradients_are_those_of_differences(young):
    box = {"p": (1.0, 10.0)} | ({"E": (500.0, 2000.0)} if young == "E" else {})
    made = lying(young=young, tilt=0.2, parameters=space(**box))
    full = hhr.FullOrderModel(made, MPI.COMM_SELF)
    reduced = hhr.train(made, full.parameters.grid([4] * len(box)), comm=MPI.COMM_SELF).build()
    at = [5.0, 900.0][: len(box)]
    for model in (full, reduced):
        assert slope_errors(model, at, step=1e-4).max() < 1e-6


@pytest.mark.parametrize(
    "young", [1000.0, pytest.param("1000 * (1 + p / 20)", marks=needs("moduli"))]
)
def test_reduced_models_and_condensation_answer_alike(young, tmp_path):
    made = lying(cells=(16, 8), young=young, tilt=0.2)
    training = hhr.train(made, [16], comm=MPI.COMM_SELF)
    full, model = training.full_order, training.build()
    hhr.save_model(tmp_path / "model.npz", model)
    again, models = hhr.load_model(tmp_path / "model.npz"), [model]
    if young == 1000.0:
        known = training.snapshots.known_statuses()
        models += [exact_condensation(full, known, field=field) for field in (True, False)]
    else:
        models += [training.condense(), hhr.condense(full, fields=True)]
    assert model.problem.motions == 2
    # the default basis leaves out 1e-11 of the squares of a training on 16 points: 3e-6
    points = full.parameters.random(5, seed=3)
    for other in models:
        check_alike(full, other, points, forces=1e-5, displacement=1e-5)
    for point in points:
        assert np.array_equal(again.solve(point).multipliers, model.solve(point).multipliers)


@given(seed=st.integers(0, 10_000), m=st.integers(3, 12), r=st.integers(1, 3))
@settings(max_examples=60, deadline=None)
def test_the_active_set_finds_what_a_quadratic_program_does(seed, m, r):
    """Of random problems, from random statuses: forces are those of min 1/2 λ S λ + g λ with G^T λ
    = e, λ >= 0.

    It is convex: whoever satisfies its conditions has solved it.
    """
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((m, m)) + 0.5 * np.eye(m)
    schur, taken = root @ root.T + 0.1 * np.eye(m), rng.standard_normal((m, r))
    slack, driving = rng.standard_normal(m), taken.T @ np.maximum(rng.standard_normal(m), 0)
    start = rng.random(m) > 0.5
    found, motions = floating_set(FloatingEqualities(schur, taken), slack, driving, start)
    assert found.status is Status.CONVERGED
    left = slack + schur @ found.forces - taken @ motions
    size = 1 + np.abs(found.forces).max() + np.abs(motions).max()
    assert found.forces.min() >= -1e-9 * size and left.min() > -1e-7 * size
    assert abs(found.forces @ left) < 1e-6 * size**2
    np.testing.assert_allclose(taken.T @ found.forces, driving, atol=1e-9 * size)


def ring_on_shaft(pairing):
    """A ring pressed on a shaft by a pressure around it, on meshes whose nodes do not face each
    other.
    """

    def geometry(comm):
        def make():
            parts = []
            for name, inner, outer, count in (("shaft", 0.5, 1.0, 40), ("ring", 1.0, 1.5, 37)):
                around = [gmsh.model.occ.addCircle(0, 0, 0, radius) for radius in (outer, inner)]
                loops = [gmsh.model.occ.addCurveLoop([curve]) for curve in around]
                parts.append((name, around, gmsh.model.occ.addPlaneSurface(loops), count))
            gmsh.model.occ.synchronize()
            for name, around, surface, count in parts:
                gmsh.model.addPhysicalGroup(2, [surface], name=name)
                for place, curve in zip(("out", "in"), around, strict=True):
                    gmsh.model.addPhysicalGroup(1, [curve], name=f"{name}_{place}")
                    gmsh.model.mesh.setTransfiniteCurve(curve, count + 1)
            gmsh.model.mesh.generate(2)

        return mesh_of(make, comm, dim=2, options={"Mesh.MeshSizeMax": 0.15})

    return hhr.Scene(
        name="ring",
        geometry=geometry,
        hypothesis="plane_strain",
        bodies=(hhr.Body("shaft", 1000.0, 0.3), hhr.Body("ring", 2000.0, 0.3)),
        contacts=(pairing("ring_in", "shaft_out"),),
        parameters=space(p=(1.0, 10.0), down=(0.0, 0.5)),
        displacements=hhr.Displacement.clamp("shaft_in", 2),
        loads=(
            hhr.Pressure("ring_out", slope("p")),
            hhr.BodyForce("ring", (0.0, -1.0), slope("down")),
        ),
    )


@needs("volume_loads")
@pytest.mark.parametrize("pairing", [MORTAR, NODE_TO_SURFACE])
@pytest.mark.filterwarnings("ignore::hhr_dolfinx.errors.PairingWarning")
def test_a_ring_on_a_shaft_is_held_and_its_turn_left_at_rest(pairing):
    """Free to turn, it would open every gap between facets.

    Of the pressure of 10 mortar passes 9.7 on.
    """
    with pytest.warns(
        SceneWarning, match="body ring .* turns, which .* no load drives: it is left at rest"
    ):
        full = hhr.FullOrderModel(ring_on_shaft(pairing), MPI.COMM_SELF)
    assert full.problem.kernel.motions.shape[1] == 2 and full.problem.kernel.idle.shape[1] == 1
    answer = full.solve((10.0, 0.0))
    pressure = answer.forces() / full.problem.contact_areas
    assert 7.5 < pressure.mean() < 10.0 and pressure.min() > 0.7 * pressure.mean()
    if pairing is mortar:
        assert np.ptp(pressure) < 0.05 * pressure.mean()
    heavy, effects = full.solve((5.0, 0.5)), full.problem.contact @ full.problem.kernel.motions
    driving = full.problem.kernel.motions.T @ (
        full.problem.loads @ full.problem.amplitudes(heavy.parameter)
    )
    size = (np.abs(effects).T @ heavy.forces()).max()
    assert np.abs(driving - effects.T @ heavy.forces()).max() < 1e-10 * size


def between_walls():
    """A block on a floor, pressed down, between walls that it need not touch.

    The left one may come near.
    """
    left = block.side(0, False)
    return block_scene(
        "between_walls",
        {"press": (1.0, 10.0), "wall": (0.0, 0.3), "side": (0.0, 5.0)},
        upper=(2, 1),
        cells=(8, 4),
        young=1000.0,
        poisson=0.0,
        contacts=(
            hhr.Obstacle(block.side(1, False), (0.0, -1.0), 0.0),
            hhr.Obstacle(left, (-1.0, 0.0), 0.1),
            hhr.Obstacle(block.side(0, True), (1.0, 0.0), 2.5),
        ),
        openings=(hhr.Opening(1, slope("wall", -1.0)),),
        loads=(
            hhr.Pressure(block.side(1, True), slope("press")),
            hhr.Traction(left, (1.0, 0.0), slope("side")),
        ),
        outputs=(
            *(
                hhr.DisplacementAt(name, (1.0, 1.0), axis)
                for axis, name in enumerate(("across", "down"))
            ),
            hhr.ContactForce("weight", contact=0, direction=(0.0, -1.0)),
        ),
    )


@pytest.fixture(scope="module")
def walled():
    training = hhr.train(between_walls(), [2, 3, 2])
    full = training.full_order
    return {
        "full": full,
        "condensed": hhr.condense(full),
        "HHR": training.build(hhr.Recipe().as_it_is()),
    }


KINDS = pytest.mark.parametrize("kind", ["full", "condensed", "HHR"])


@pytest.mark.filterwarnings("ignore:.*kept out:UserWarning")
@KINDS
@pytest.mark.parametrize(("wall", "across"), [(0.0, 0.0), (0.1, 0.0), (0.3, 0.2)])
def test_a_motion_that_contact_leaves_open_is_the_least_one(walled, kind, wall, across):
    """The block stays where it is, or where the wall moves it without a force.

    No model picks a motion of its own.
    """
    said = r"moves along \[-?1.0, .?0.0\] at press = 4, .* least motion"
    with pytest.warns(UndeterminedWarning, match=said):
        answer = walled[kind].solve((4.0, wall, 0.0))
    outputs = answer.outputs()
    # round-off of springs that held the block on the way, 1e9 times as soft as it
    assert outputs["across"] == pytest.approx(across, abs=1e-8)
    assert outputs["down"] == pytest.approx(-4.0 / 1000.0, abs=1e-8)
    assert outputs["weight"] == pytest.approx(-8.0, rel=1e-9)
    assert answer.forces()[walled["full"].problem.contact_pairs != 0] == pytest.approx(
        0.0, abs=1e-8
    )
    estimate = answer.estimate()
    assert "across" not in (estimate.outputs if estimate else {})
    if kind != "HHR":
        assert {"down", "weight"} == set(estimate.outputs)


@KINDS
def test_a_motion_that_contact_holds_is_no_open_one(walled, kind):
    with warnings.catch_warnings(action="error", category=UndeterminedWarning):
        answer = walled[kind].solve((4.0, 0.0, 2.0))
    assert answer.undetermined is None
    # the clearance, and what its right half is compressed by
    assert answer.outputs()["across"] == pytest.approx(0.5 + 2.0 / 1000.0, rel=1e-8)


@given(st.integers(0, 10_000))
@example(142)  # which nnls of scipy 1.15 leaves undone
@example(5440)
@settings(max_examples=60, deadline=None)
def test_the_least_motion_is_that_of_a_quadratic_program(seed):
    """Beside SLSQP, which knows neither normal equations nor non-negative least squares."""
    rng = np.random.default_rng(seed)
    rows, limits, target = rng.normal(size=(6, 2)), rng.uniform(0.0, 1.0, 6), 2 * rng.normal(size=2)
    found = _nearest(rows, limits, target)
    program = minimize(
        lambda w: ((w - target) ** 2).sum(),
        np.zeros(2),
        jac=lambda w: 2 * (w - target),
        method="SLSQP",
        constraints={"type": "ineq", "fun": lambda w: limits - rows @ w, "jac": lambda w: -rows},
        options={"ftol": 1e-14},
    )
    assert (rows @ found <= limits + 1e-10).all()
    assert found == pytest.approx(program.x, abs=1e-5)


def test_the_least_motion_between_opposite_limits():
    """Where least squares within bounds end beyond a limit."""
    rows = np.array([[-2.0, 0.0], [2.0, -2.0], [-3.0, 3.0]])
    found = _nearest(rows, np.array([1.0, 0.0, 0.0]), np.array([-1.0, -3.0]))
    assert found == pytest.approx([-0.5, -0.5])
