"""Bodies held by contact alone, attacked: stacks, corners, light beside heavy, what tips over or
turns, estimates.
"""

import copy
import dataclasses
import re
import warnings

import numpy as np
import pytest
from bound_checks import check, sizes_of
from mpi4py import MPI
from needs import needs, present
from scenes import block_scene, check_alike, kkt, lying, output_slopes, pair_scene, slope, space

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import NotSolvableError, SceneWarning, StabilityWarning, UndeterminedWarning
from hhr_dolfinx.geometries import block
from hhr_dolfinx.geometries.two_blocks import side, two_blocks
from hhr_dolfinx.plugins.exact_errors.offline import field_response
from hhr_dolfinx.reduction.exact import exact_condensation

FLOOR = hhr.Obstacle(block.side(1, False), (0.0, -1.0), 0.0)
CEILING = hhr.Obstacle(block.side(1, True), (0.0, 1.0), 1.0)
UNDER_ALL = hhr.Obstacle(side(1, 1, False), (0, -1), 0.0)
WALL = hhr.Obstacle(block.side(0, True), (1.0, 0.0), 1.1)
pytestmark = pytest.mark.filterwarnings("ignore:.*no contact resists and no load drives")


def stack(size=1.0, stiffer=1.0, cells=4, lowest=0.0, **changes):
    """A free block on a free block on a floor, pressed by p on the upper and by q on the top of the
    lower one.
    """
    boxes = (
        ((0, 0), (size, size), (cells, cells)),
        ((0.25 * size, size), (0.75 * size, 1.5 * size), (cells // 2, cells // 2)),
    )
    given = {
        "contacts": (UNDER_ALL, hhr.NodeToSurface(side(2, 1, False), side(1, 1, True))),
        "displacements": (),
        "loads": (
            hhr.Pressure(side(2, 1, True), slope("p")),
            hhr.Pressure(side(1, 1, True), slope("q")),
        ),
    }
    box = dict.fromkeys("pq", (lowest, 1.0))
    return pair_scene(
        "stack", box, *boxes, ((1000.0, 0.3), (1000.0 * stiffer, 0.3)), **given | changes
    )


def lone(contacts, loads, names, **changes):
    """A block of edge 1."""
    given = {
        "cells": (6, 6),
        "young": 1000.0,
        "contacts": contacts,
        "displacements": (),
        "loads": loads,
    }
    return block_scene("lone", dict.fromkeys(names, (0.0, 1.0)), **given | changes)


@needs("nonmatching")
@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("stiffer", [1e-6, 1.0, 1e6])
def test_a_light_body_on_a_heavy_one_is_balanced_too(size, stiffer):
    """Loads of the upper block a thousand million times smaller: they are its own, not round-off of
    the other's.
    """
    full = hhr.FullOrderModel(stack(size, stiffer), MPI.COMM_SELF)
    for p, q in ((1.0, 0.0), (1e-9, 1.0), (1.0, 1.0), (0.3, 0.9)):
        forces = kkt(full, (p, q), 1e-7).forces()
        upper = full.problem.contact_pairs == 1
        assert forces[upper].sum() == pytest.approx(0.5 * p * size, rel=1e-5)
        assert forces[~upper].sum() == pytest.approx((0.5 * p + q) * size, rel=1e-9)


def test_a_motion_that_only_round_off_drives_is_the_least():
    """A turned block is pressed between two walls, along which its load is 8e-18."""
    ways = np.array([[np.cos(0.1), np.sin(0.1)], [-np.sin(0.1), np.cos(0.1)]])

    def turned(comm):
        mesh, *tags = block.block(comm, lower=(0.0, 0.0), upper=(2.0, 1.0), cells=(8, 4))
        mesh.geometry.x[:, :2] = mesh.geometry.x[:, :2] @ ways
        return mesh, *tags

    walls = (0, False, -ways[0], 0.0), (0, True, ways[0], 2.0), (1, True, ways[1], 1.01)
    contacts = tuple(
        hhr.Obstacle(block.side(axis, upper), tuple(way), at) for axis, upper, way, at in walls
    )
    scene = lone(contacts, (hhr.Pressure(block.side(0, True), slope("p")),), "p", geometry=turned)
    for model in (hhr.FullOrderModel(scene), hhr.condense(scene)):
        with pytest.warns(UndeterminedWarning):
            assert np.abs(model.solve(0.5).displacement()).max() < 2e-3


@needs("nonmatching")
def test_what_pulls_apart_is_adrift_and_named():
    full = hhr.FullOrderModel(stack(lowest=-1.0), MPI.COMM_SELF)
    kkt(full, (1.0, -0.4))
    for mu in ((1.0, -0.6), (-0.1, 1.0), (1e-3, -1e-3)):
        assert full.solve(mu, raise_on_failure=False).status is Status.ADRIFT
    with pytest.raises(
        NotSolvableError,
        match=r"away.*(body 2 of scene 'stack'.*body 1|body 1 of scene 'stack'.*body 2)",
    ):
        full.solve((-0.1, 1.0))


def test_a_cube_tips_over_when_the_force_leaves_its_base():
    top, left, right = block.side(2, True), block.side(0, False), block.side(0, True)
    floor = hhr.Obstacle(block.side(2, False), (0, 0, -1), 0.0)
    pair = hhr.Traction(right, (0, 0, -1), slope("s")), hhr.Traction(left, (0, 0, 1), slope("s"))
    cube = {"lower": (0, 0, 0), "upper": (1, 1, 1), "cells": (4, 4, 4), "hypothesis": "solid"}
    scene = lone((floor,), (hhr.Traction(top, (0, 0, -1), 1.0), *pair), ("s",), **cube)
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    for s in (0.0, 0.3, 0.4999, 0.499999):
        forces = kkt(full, s).forces()
        assert full.problem.contact_points[:, 0] @ forces == pytest.approx(0.5 + s, abs=1e-8)
    for s in (0.500001, 0.6):
        with pytest.raises(NotSolvableError, match=r"pull it away.*body 1 of scene 'lone'.*turns"):
            full.solve(s)


@needs("nonmatching")
def test_loads_that_only_shear_are_refused_however_small_their_slope():
    top = side(2, 1, True)
    shear, box = hhr.Traction(top, (1e-12, 0), slope("q")), space(p=(0.0, 1.0), q=(0.0, 1e12))
    for changes in (
        {"loads": (shear,)},
        {"loads": (hhr.Pressure(top, slope("p", 1e3)), shear), "parameters": box},
    ):
        with pytest.raises(
            NotSolvableError, match=r"body 2 .* moves along axis 0, which loads drive"
        ):
            hhr.FullOrderModel(stack(**changes), MPI.COMM_SELF)


PRESSED = hhr.Pressure(block.side(1, True), slope("s"))
CASES = {
    "corner": (
        lone((FLOOR, WALL), (PRESSED, hhr.Pressure(block.side(0, False), slope("t"))), ("s", "t")),
        ((1, 1), (1, 1e-6), (1e-6, 1), (1, 0), (0, 1)),
    ),
    "squeezed": (
        lone((FLOOR, CEILING), (), ("s",), openings=(hhr.Opening(1, slope("s", -0.01)),)),
        (0.5, 1.0),
    ),
    "pushed across": (
        lone(
            (FLOOR, CEILING),
            (hhr.Traction(block.side(0, True), (0, 1), slope("s")),),
            ("s",),
            openings=(hhr.Opening(1, 0.1),),
        ),
        (0.5, 1.0),
    ),
    "one component": (
        lone(
            (FLOOR,),
            (PRESSED, hhr.Traction(block.side(0, True), (0, -1), slope("t"))),
            ("s", "t"),
            displacements=(hhr.Displacement(block.side(0, False), 0),),
        ),
        ((1, 1), (1, 0), (0, 1)),
    ),
}
if present("volume_loads"):
    HEATED = hhr.ThermalExpansion(block.SOLID, expansion=1e-3, temperature="T")
    CASES["heated"] = lone((FLOOR,), (HEATED, PRESSED), ("T", "s")), ((1, 1), (0, 1), (1, 1e-9))
    CASES["heated between"] = lone((FLOOR, CEILING), (HEATED,), ("T",)), (0.5, 1.0)


@needs("elasticity")
@pytest.mark.parametrize("name", CASES)
def test_bodies_between_and_in_corners(name):
    scene, points = CASES[name]
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    for mu in points:
        kkt(full, mu)


@needs("nonmatching", "elasticity", "volume_loads")
def test_without_loads_nothing_touches():
    """A free body that is heated grows by its expansion, in plane strain."""
    stacked = hhr.FullOrderModel(stack(), MPI.COMM_SELF).solve((0.0, 0.0))
    assert np.abs(stacked.forces()).max() < 1e-12 and np.abs(stacked.displacement()).max() < 1e-12
    heated = hhr.FullOrderModel(lone((FLOOR,), (HEATED,), ("T",)), MPI.COMM_SELF).solve(1.0)
    assert np.abs(heated.forces()).max() < 1e-9  # of 1000 times 1e-3
    assert np.ptp(heated.displacement().reshape(-1, 2)[:, 0]) == pytest.approx(1e-3 * 1.3, rel=1e-9)


@needs("fallback", "local_models", "nonmatching")
@pytest.mark.parametrize("how", ["node to surface", pytest.param("mortar", marks=needs("mortar"))])
def test_small_models_of_a_stack(how, tmp_path):
    contacts = (
        {"contacts": (UNDER_ALL, hhr.Mortar(side(2, 1, False), side(1, 1, True)))}
        if how == "mortar"
        else {}
    )
    made = stack(cells=8, parameters=space(p=(0.1, 1.0), q=(0.0, 1.0)), **contacts)
    training = hhr.train(made, hhr.Sobol(32), comm=MPI.COMM_SELF)
    full = training.full_order
    models = [training.build(), training.local(hhr.Clusters(2))]
    for number, model in enumerate(tuple(models)):
        hhr.save_model(tmp_path / f"{number}.npz", model)
        models.append(hhr.load_model(tmp_path / f"{number}.npz"))
    assert all(model.solve((0.5, 0.5)).estimate().dual_relative < 1e-8 for model in models)
    safe = hhr.FallbackModel(models[0], full, 0.01)
    assert not safe.fell_back(safe.solve((0.5, 0.5)))
    models.append(exact_condensation(full, training.snapshots.known_statuses()))
    for model in models:
        check_alike(full, model, full.parameters.random(6, seed=5), forces=1e-9, displacement=1e-9)


@needs("nonmatching")
@pytest.mark.filterwarnings("ignore::hhr_dolfinx.errors.PairingWarning")
def test_a_ring_whose_facets_alone_resist_its_turn_is_warned_of():
    """Nodes of a ring beside those of its shaft: turned far, the facets would open every gap."""

    def warp(points, body):
        angle = 2 * np.pi * (points[:, 0] + (0.004 if body == 2 else 0.0))
        return points[:, 1:] * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    # three quarters of a turn: ends that nothing joins
    rings = {"first": ((0, 0.5), (0.75, 1), (40, 4)), "second": ((0, 1), (0.75, 1.5), (40, 4))}
    scene = stack(
        geometry=lambda comm: two_blocks(comm, **rings, warp=warp),
        contacts=(hhr.NodeToSurface(side(2, 1, False), side(1, 1, True)),),
        displacements=hhr.Displacement.clamp(side(1, 1, False), 2),
    )
    with pytest.warns(SceneWarning, match="turns, which contact resists"):
        hhr.FullOrderModel(scene, MPI.COMM_SELF)


@needs("nonmatching")
@pytest.mark.filterwarnings("ignore::hhr_dolfinx.errors.PairingWarning")
@pytest.mark.parametrize("loaded", [True, False])
def test_a_load_along_a_surface_that_is_not_quite_flat_is_warned_of(loaded):
    """As along the axis of a meshed cylinder: only the slopes of a ripple, 0.03, hold the upper
    block.
    """

    def warp(points, body):
        return points + np.stack(
            [0 * points[:, 0], 0.005 * np.cos(2 * np.pi * points[:, 0])], axis=1
        )

    push = hhr.Traction(side(2, 1, True), (1.0, 0.0) if loaded else (0.0, -1.0), slope("q"))
    blocks = {"first": ((0, 0), (3, 1), (30, 4)), "second": ((1, 1), (2, 2), (10, 4))}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        full = hhr.FullOrderModel(
            stack(
                geometry=lambda comm: two_blocks(comm, **blocks, warp=warp),
                contacts=(hhr.NodeToSurface(side(2, 1, False), side(1, 1, True)),),
                displacements=hhr.Displacement.clamp(side(1, 1, False), 2),
                loads=(hhr.Pressure(side(2, 1, True), slope("p")), push),
            ),
            MPI.COMM_SELF,
        )
    said = [str(item.message) for item in caught if "which contact resists" in str(item.message)]
    assert any(re.search(r"moves along \[-?1\.0, -?0\.0\]", text) for text in said) == loaded
    assert full.problem.kernel is not None


@pytest.fixture(scope="module")
def training():
    """A crowned block that a force on its side makes lean to either side."""
    outputs = (hhr.GapAt("gap", 0, (0.0, 1.0)), hhr.ContactForce("force", 0, (0.0, 1.0)))
    box = space(p=(1.0, 10.0), t=(-0.5, 0.5))
    scene = lying(cells=(16, 8), tilt=slope("t"), parameters=box, outputs=outputs)
    return hhr.train(scene, hhr.Sobol(12), held_out=5)


@pytest.fixture(scope="module", params=[1e-13, 1e-4, 1e-2])
def model(request, training):
    return training.build(
        hhr.Recipe(hhr.Pod(request.param, relative=True)).as_it_is(), checked=False
    )


def balanced_sizes(full):
    """S norm of the part of exact forces that balances itself, in the place of that of all: see
    :func:`check`.
    """
    along = np.linalg.qr(full.problem.kernel.contact_of_motions)[0]
    return lambda field, forces: (
        sizes_of(full, field, forces) * [1, 0, 1, 1]
        + sizes_of(full, field, forces - along @ (along.T @ forces)) * [0, 1, 0, 0]
    )


def test_estimates_are_the_differences(training, model):
    """100 points of a poor training: forces off by 25 % at worst by the usual basis."""
    full = training.full_order
    parts = check(full, model, full.parameters.random(100, 5), balanced_sizes(full))
    assert (parts[:, 1:].max(axis=0) > 1e-3).all()


def test_few_columns_leave_part_of_the_displacement(training):
    """Fewer than conditions: what they leave out of what forces make is the error of the
    displacement.
    """
    full = training.full_order
    made = field_response(full, training.snapshots.forces, 4)
    model = training.build(hhr.Recipe().as_it_is(), checked=False)
    how = {"basis": made.columns, "contact_basis": full.problem.contact_rows_times(made.columns)}
    fields = dataclasses.replace(
        model.fields, response=made.response, bound=made.bound, output_bound=None, **how
    )
    parts = check(
        full, model.changed(fields=fields), full.parameters.random(20, 7), balanced_sizes(full)
    )
    assert np.median(parts[:, 0]) > 1e-3


def test_fields_close_the_gaps_and_move_bodies_as_the_full_model_does(training, model):
    """S and K^-1 loads leave an error of round-off, of the rigid motions too, where forces are off
    by 15 %.
    """
    full = training.full_order
    points = full.parameters.random(20, 6)
    check_alike(full, model, points, displacement=1e-8)
    for point in points:
        said = [
            again.solve(point, outside="ignore").estimate()
            for again in (copy.deepcopy(model), model)
        ]
        assert said[0] == said[1]


def test_derivatives_of_what_is_read_of_fields_are_differences(model):
    point = np.array([6.1, 0.21])
    slopes = model.solve(point, outside="ignore", gradient=True).outputs().gradient["gap"]
    assert slopes == pytest.approx(output_slopes(model, point, "gap", step=1e-5)["gap"], abs=1e-9)


def test_the_worst_of_many_points_is_warned_of(training):
    """Five solutions held out show nothing; of 200 points some are off by tens of per cent."""
    recipe = hhr.Recipe(hhr.Pod(1e-13, relative=True))
    with pytest.warns(
        StabilityWarning, match="contact force error.*of [12].. solutions compared; the worst is at"
    ):
        hhr.build(training.full_order, training.snapshots, recipe, training.held_out)


@needs("nonmatching")
def test_a_stack_of_free_blocks():
    """Two bodies with three motions each, one of them left at rest; few points."""
    training = hhr.train(
        stack(cells=8, parameters=space(p=(0.1, 1.0), q=(0.0, 1.0))), hhr.Sobol(6), held_out=0
    )
    full, model = training.full_order, training.build(hhr.Recipe().as_it_is(), checked=False)
    check(full, model, full.parameters.random(60, 1), balanced_sizes(full))
