"""Estimates of a constant stiffness are differences to the exact answer, in each norm.

Displacements of forces.
"""

import dataclasses

import dolfinx
import hertz_half_discs as demo
import numpy as np
import pytest
from bound_checks import ERRORS, NEAR, check, sizes_of
from needs import needs, present
from pellet_outputs import small_pellet
from scenes import THESIS, block_scene, pressed_pair, slope, space
from tubes import tube

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import contact_residuals
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import BoundError, ParameterError, ReductionError
from hhr_dolfinx.geometries import block, two_blocks
from hhr_dolfinx.plugins.exact_errors import contact_response
from hhr_dolfinx.plugins.exact_errors.offline import energy_coordinates, exact_difference, leading

AS_IT_IS = hhr.Recipe().as_it_is()
FLANK = two_blocks.side(two_blocks.SECOND, 0, True)


def check_norms(parts, columns=(0, 1, 2, 3)):
    """Errors are large enough, and far enough from those of other norms, that each of them was
    looked at.
    """
    medians = np.median(parts, axis=0)[list(columns)]
    assert (medians > 1e-5).all()
    assert (np.abs(np.diff(np.sort(medians))) > 0.02 * medians.max()).all()


@pytest.mark.parametrize(
    ("some", "recipe"),
    [
        ([3, 15, 28], AS_IT_IS),
        ([3, 15, 28], hhr.Recipe(cone=True).as_it_is()),
        (slice(None), AS_IT_IS),
        (slice(None), THESIS.as_it_is()),
    ],
    ids=["few", "few, cone", "usual", "thesis"],
)
def test_half_discs(hertz, hertz_snapshots, some, recipe):
    """Of three snapshots errors of a tenth and more.

    Forces outside the RID by S, and by the cone of training.
    """
    model = hhr.build(hertz, hertz_snapshots.take(some), recipe)
    parts = check(hertz, model, hertz.parameters.random(50, 1))
    assert model.fields.A_lambda.size < model.conditions
    if some != slice(None):
        check_norms(parts)


def blocks(hypothesis="plane_strain", box=None, **others):
    """A full model of a pair of blocks."""
    return hhr.FullOrderModel(
        pressed_pair(hypothesis, ((2.0, 0.3), (1.0, 0.2)), box, **{"cells": 3} | others)
    )


def few(full, sampling, **recipe):
    """A model of few answers."""
    snapshots = hhr.compute_snapshots(full, sampling.points(full.parameters))
    return hhr.build(full, snapshots, hhr.Recipe(**recipe).as_it_is())


@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric", "solid"])
def test_pairs_of_blocks(hypothesis):
    """Imposed motions, sliding, loads and gaps as parameters.

    Trained on so few points that errors are large.
    """
    full = blocks(hypothesis)
    for cone in (False, True):
        model = few(full, hhr.Sobol(4), cone=cone)
        parts = check(full, model, full.parameters.random(30, 3))
        assert (np.median(parts, axis=0)[0 if cone else 1 :] > 1e-3).all()


def test_any_field_and_any_forces(hertz):
    """Statuses are found from whatever forces are handed out: random ones, and random fields."""
    rng, problem = np.random.default_rng(0), hertz.problem
    basis = np.linalg.qr(rng.standard_normal((problem.free.size, 6)) * problem.free[:, None])[0]
    difference = exact_difference(hertz, basis)
    for point in hertz.parameters.random(30, 2):
        exact, theta = hertz.solve(point), problem.theta(point)
        forces = np.maximum(
            exact.forces() * rng.uniform(0.5, 1.5), rng.uniform(-1, 0.2, exact.forces().size)
        )
        unknown = 1e-3 * rng.standard_normal(6)
        found = difference.at(point[None], theta).of(unknown[None], forces[None], lambda: None)[0]
        true = sizes_of(hertz, basis @ unknown - exact.unknown, forces - exact.forces())
        sizes = sizes_of(hertz, exact.unknown, exact.forces())
        assert (
            np.abs([getattr(found, name) for name in ERRORS] - true) <= NEAR * (true + sizes)
        ).all()


def test_without_an_exact_answer_an_error_is_infinite(hertz, hertz_reduction, monkeypatch):
    """That of the full model is zero."""
    assert hertz.solve(0.3).estimate() == ("bound", 0.0, 0.0, 0.0, 0.0, {}, 0.0, 0.0, 0.0, 0.0)
    plain = contact_response.active_set

    def cycling(*given, **how):
        return plain(*given, **how)._replace(status=Status.CYCLING)

    monkeypatch.setattr(contact_response, "active_set", cycling)
    found = hertz_reduction.solve(0.3).estimate()
    assert [getattr(found, name) for name in ERRORS] == [
        np.inf
    ] * 4 and found.dual_relative == np.inf


def test_coordinates_are_those_of_the_energy(hertz):
    """Dependent columns too, to round-off of the columns and not of its root."""
    rng, stiffness = np.random.default_rng(0), hertz.problem.stiffness
    columns = rng.standard_normal((stiffness.shape[0], 5)) * hertz.problem.free[:, None]
    columns = np.hstack([columns, columns @ rng.standard_normal((5, 4))])
    lengths = np.sqrt(np.einsum("nk,nk->k", columns, stiffness @ columns))
    found = energy_coordinates(hertz.problem, columns, 1e-13 * lengths)
    assert found.shape == (5, 9)
    for way in (
        *rng.standard_normal((5, 9)),
        np.append(np.linalg.pinv(columns[:, :5]) @ columns[:, 5], [-1, 0, 0, 0]),
    ):
        expected, size = columns @ way, np.abs(way) @ lengths
        energy = np.sqrt(expected @ (stiffness @ expected))
        assert np.linalg.norm(found @ way) == pytest.approx(energy, abs=1e-12 * size)


@needs("elasticity")
def test_what_is_not_proved_is_refused(hertz):
    """Bodies that flow, a stiffness of parameters, dependent rows, a K that is not symmetric."""
    bodies = ("E1", 0.3), (2.0, 0.3)
    varying = hhr.FullOrderModel(pressed_pair("plane_strain", bodies, {"E1": (1.0, 2.0)}, cells=2))
    dependent, skew = (type(hertz).__new__(type(hertz)) for _ in range(2))
    dependent.__dict__.update(vars(hertz) | {"schur": np.ones_like(hertz.schur)})
    stiffness = hertz.problem.stiffness.copy()
    stiffness.data[1] *= 2
    skew.__dict__.update(
        vars(hertz) | {"problem": dataclasses.replace(hertz.problem, stiffness_terms=(stiffness,))}
    )
    cases = {"depends on parameters": varying, "dependent": dependent, "not symmetric": skew}
    if present("inelastic"):
        cases["bodies have laws"] = hhr.FullOrderModel(tube(hhr.Plasticity(1.0, 1.0), 1.0, 4))
    for why, full in cases.items():
        with pytest.raises(BoundError, match=why):
            exact_difference(full, np.zeros((full.problem.free.size, 1)))


@needs("fallback")
def test_outside_the_training_and_other_mistakes(hertz, hertz_snapshots, hertz_reduction):
    half = hhr.build(hertz, hertz_snapshots.take(slice(0, 12)), AS_IT_IS)
    model = hhr.FallbackModel(half, hertz, 1e6)
    for outside, share in (("usual", 0.0), ("refuse", 0.5)):  # usually the bound is what counts
        model.solve(0.44, outside=outside)
        assert model.share == share
    bare = hertz_reduction.changed(fields=dataclasses.replace(hertz_reduction.fields, bound=None))
    for without in (bare, None):
        with pytest.raises(BoundError, match="have no bound"):
            hhr.FallbackModel(without, hertz)
    for tolerance in (0.0, -1.0, np.nan, "1 %", None):
        with pytest.raises(ParameterError, match="must be a positive number"):
            hhr.FallbackModel(hertz_reduction, hertz, tolerance)
    asked = model.asked
    with pytest.raises(ParameterError, match="outside"):
        model.solve(0.7)
    assert model.asked == asked


@needs("fallback")
def test_the_full_model_must_be_that_of_the_scene(hertz, hertz_reduction):
    """Of another stiffness, box or load, or no full model at all."""
    scene = demo.scene()
    softer = tuple(dataclasses.replace(body, young=14.0) for body in scene.bodies)
    others = {
        "another scene": {"bodies": softer},
        "has the parameters": {"parameters": space(mu=(0.1, 0.45))},
    }
    for why, changes in others.items():
        with pytest.raises(ReductionError, match=why):
            hhr.FallbackModel(
                hertz_reduction, hhr.FullOrderModel(dataclasses.replace(scene, **changes))
            )
    for full in (None, hertz_reduction, hhr.FallbackModel(hertz_reduction, hertz)):
        with pytest.raises(ReductionError, match="is no full model"):
            hhr.FallbackModel(hertz_reduction, full)
    one, other = (blocks(loads=(hhr.Pressure(FLANK, slope("load", size)),)) for size in (1.0, 5.0))
    with pytest.raises(ReductionError, match="another scene"):
        hhr.FallbackModel(few(one, hhr.Sobol(8)), other, 0.01)


def test_bodies_that_move_far_and_deform_little():
    """The relative bound is over the energy of the deformation, of which a rigid motion has
    none.
    """
    box = {
        "push": (1.0, 1.0 + 1e-6),
        "gap": (1.0, 1.0 + 1e-9),
        "slide": (0.0, 1e-7),
        "load": (0.0, 1e-7),
    }
    full = blocks(box=box, cells=4)
    model, stiffness = few(full, hhr.Sobol(3)), full.problem.stiffness
    far = np.zeros(full.problem.free.size)
    far[full.problem.block_size - 1 :: full.problem.block_size] = np.where(
        full.problem.points[:, -1] > 1, -1.0, 0.0
    )
    for point in full.parameters.random(20, 6):
        exact, answer = full.solve(point), model.solve(point, outside="ignore")
        moved, field = answer.displacement() - exact.displacement(), exact.displacement() - far
        error, size = (np.sqrt(value @ (stiffness @ value)) for value in (moved, field))
        assert error <= answer.estimate().primal_relative * size * (1 + 1e-6) + 1e-14


@pytest.fixture(scope="module")
def pellet():
    return hhr.train(small_pellet(), (8, 6), held_out=5)


@pytest.fixture(scope="module", params=[1e-5, 1e-13])
def model(request, pellet):
    """As many modes as contact conditions, 34, of which the poorer one takes more for its RID, and
    31.
    """
    found = pellet.build(
        hhr.Recipe(hhr.Pod(request.param, relative=True)).as_it_is(), checked=False
    )
    assert (found.fields.response.onto is None) == (request.param == 1e-5)
    return found


def test_pellet(pellet, model):
    """Displacements on fewer columns than conditions, and on all of them: these are exact."""
    parts = check(pellet.full_order, model, pellet.full_order.parameters.random(40, 4))
    whole = model.fields.response.onto is None
    check_norms(parts, (1, 2, 3) if whole else (0, 1, 2, 3))
    assert (np.median(parts[:, 0]) < 1e-9) == whole
    # a pressure up to a height has more terms than there are nodes below it
    loaded = model.fields.response.loaded
    assert loaded.shape[1] < np.count_nonzero(pellet.full_order.per_load.any(axis=0))


def test_what_is_handed_out_penetrates_nothing(pellet, model):
    """Gaps that the answer says are closed are closed, to what the projection leaves open: 0.8 % in
    the median.
    """
    problem = pellet.full_order.problem
    deepest = [
        contact_residuals(
            problem, answer.displacement(), answer.forces(), problem.theta(point)
        ).penetration
        for point in problem.parameters.random(40, 5)
        for answer in [model.solve(point, outside="ignore")]
    ]
    assert np.median(deepest) < (1e-9 if model.fields.response.onto is None else 0.05)


def test_directions_without_a_training_are_those_along_which_forces_move_most():
    lower = np.diag([1.0, 4.0, 2.0])
    assert np.abs(leading(np.zeros((3, 2)), lower, 2)) == pytest.approx(np.eye(3)[:, [1, 2]])


def layers(young, box):
    """A block of two layers that hang together, of which the upper one has a modulus of
    parameters.
    """

    def geometry(comm):
        mesh, _, facets = block.block(comm, lower=(0.0, 0.0), upper=(1.0, 1.0), cells=(4, 4))
        cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        above = (dolfinx.mesh.compute_midpoints(mesh, 2, cells)[:, 1] > 0.5).astype(np.int32)
        return mesh, dolfinx.mesh.meshtags(mesh, 2, cells, above + 1), facets

    return block_scene(
        "layers",
        {"gap": (-0.02, 0.005)} | box,
        geometry=geometry,
        bodies=(hhr.Body(1, 1.0, 0.3), hhr.Body(2, young, 0.3)),
        contacts=(hhr.Obstacle(block.side(1, upper=True), (0.0, 1.0), 1.0),),
        displacements=hhr.Displacement.clamp(block.side(1, upper=False), 2),
        openings=(hhr.Opening(0, slope("gap")),),
    )


SQUARE = {"a": (-1.0, 1.0), "b": (-1.0, 1.0)}
SCENES = {
    "five decades": (layers("E2", {"E2": (1e-2, 1e3)}), 24),
    "product in a layer": (layers("1 + 0.9 * a * b", SQUARE), 24),
    "product": (
        pressed_pair("plane_strain", ((2.0, 0.3), (1.0, "0.3 + 0.15 * a * b")), SQUARE, cells=3),
        64,
    ),
    "wave": (
        pressed_pair(
            "plane_strain", ((2.0, 0.3), (1.0, "0.3 + 0.15 * a * sin(pi * b)")), SQUARE, cells=3
        ),
        64,
    ),
}


@needs("moduli")
@pytest.mark.parametrize("name", SCENES)
def test_a_bound_is_as_good_as_its_interpolation_or_left_out(name):
    """Products of parameters are constant along each axis through the middle of the box, where
    grids look first.
    """
    scene, count = SCENES[name]
    training = hhr.train(scene, hhr.Sobol(count), held_out=0)
    full, model = training.full_order, training.build(checked=False)
    for point in full.parameters.random(20, 5):
        stiffness = full.problem.at(point).stiffness
        exact, answer = (
            full.solve(point),
            model.solve(point, outside="ignore", raise_on_failure=False),
        )
        off, estimate = answer.displacement() - exact.displacement(), answer.estimate()
        assert estimate is None or np.sqrt(off @ (stiffness @ off)) <= estimate.primal


@needs("moduli")
@pytest.mark.parametrize("poisson", ["0.001 + 0.399 * T", "0.3 + 0.15 * sin(2000 * pi * T)"])
def test_what_is_resolved_of_poisson_s_ratio_is_known(poisson):
    """Shares of the change of volume above 3/5 do not occur: at a ratio near 0 they would be all
    that counts.

    A formula that repeats itself between the nodes is found out.
    """
    scene = pressed_pair("plane_strain", ((2.0, poisson), (1.0, 0.2)), {"T": (0.0, 1.0)}, cells=3)
    bound = hhr.train(scene, hhr.Sobol(16), held_out=0).build(checked=False).fields.bound
    known = "sin" not in poisson
    assert (bound is not None) == known and (not known or (bound.proved and bound.inexact < 1e-8))


def test_an_answer_completes_its_forces_and_finds_the_exact_ones_once(monkeypatch):
    """Fields, estimate and outputs need both, in any order, and another answer its own."""
    scene = dataclasses.replace(
        demo.scene(arc_segments=24, flat_segments=6), outputs=(hhr.LargestPressure("peak", 0),)
    )
    model = hhr.train(scene, hhr.Sobol(8), held_out=2).build(recipe=AS_IT_IS)
    calls = []
    for owner, name in (
        (contact_response.Outside, "completed"),
        (contact_response.ContactResponse, "settled"),
    ):
        real = getattr(owner, name)
        monkeypatch.setattr(
            owner,
            name,
            lambda *given, real=real, name=name: (calls.append(name), real(*given))[1],
        )
    first, second = (model.solve([push]) for push in (0.2, 0.4))
    forces = first.forces()
    forces[:] = 0.0  # a copy: the answer does not see it
    found = first.estimate(), first.outputs(), first.displacement(), first.forces()
    assert calls.count("completed") == 1 and calls.count("settled") == 1
    assert first.forces().sum() > 0 and found[3].sum() == first.forces().sum()
    assert second.forces().sum() > 1.5 * first.forces().sum()
    assert first.estimate() == found[0]
