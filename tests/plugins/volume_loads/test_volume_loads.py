"""Loads on whole bodies and amplitudes as formulas, against closed forms, in the full order and
reduced.
"""

import dataclasses
from functools import partial

import numpy as np
import pytest
from kept_values import put, rewrite_model
from local_models_by_hand import by_lapack
from mpirun import launch
from needs import needs
from processes import folders_of
from scenes import block_scene, check_alike, largest_difference, pair_scene, slope, slope_errors

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ModelFileError, SceneError, SceneWarning
from hhr_dolfinx.geometries import block, two_blocks

HEIGHT, FIRST, SECOND = 2.0, two_blocks.FIRST, two_blocks.SECOND
BOX = {"E": (1.0, 3.0), "nu": (0.1, 0.43), "T": (0.0, 2.0)}
MU = {"E": 2.0, "nu": 0.27, "T": 1.5}
SERIES = (0.4, 0.6)
"""Heights of two blocks on each other."""


def alone(hypothesis, loads, *, poisson="nu", held=(), cells=3, lower=None, upper=None, **body):
    """A block of height 2 that stands on its lower sides, far from a wall, under loads."""
    dim = 3 if hypothesis == "solid" else 2
    return block_scene(
        "alone",
        {name: BOX[name] for name in BOX if isinstance(poisson, str) or name != "nu"},
        lower=lower or (0.0,) * dim,
        upper=upper or (1.5,) * (dim - 1) + (HEIGHT,),
        cells=np.broadcast_to(cells, dim).tolist(),
        hypothesis=hypothesis,
        bodies=(hhr.Body(block.SOLID, "E", poisson, **body),),
        contacts=(
            hhr.Obstacle(block.side(0, True), tuple(float(axis == 0) for axis in range(dim)), 10.0),
        ),
        displacements=(
            *(hhr.Displacement(block.side(axis, False), axis) for axis in range(dim)),
            *held,
        ),
        loads=loads,
    )


def solved(scene):
    """Coordinates, displacements of nodes and stresses of cells at MU."""
    full = hhr.FullOrderModel(scene)
    answer = full.solve({name: MU[name] for name in scene.parameters.names})
    points = full.problem.points
    return points, answer.displacement().reshape(points.shape), answer.stress()


HEAT = hhr.ThermalExpansion(block.SOLID, "1e-2 * (1 + T)", "T")
STRAIN = 1e-2 * (1 + MU["T"]) * MU["T"]
HYPOTHESES = ("plane_strain", "plane_stress", "axisymmetric", "solid")


@pytest.mark.parametrize("poisson", ["nu", "0.05 + nu", 0.3, 0.49])
@pytest.mark.parametrize("hypothesis", HYPOTHESES)
def test_free_expansion(hypothesis, poisson):
    """No stress but that of what plane strain holds; "0.05 + nu" and 0.49 take the mean dilatation.

    Clamped between its ends, the stress along a bar is -E alpha T, and along both axes that plane
    strain holds -E alpha T / (1 - nu).
    """
    ratio = {"nu": MU["nu"], "0.05 + nu": 0.05 + MU["nu"]}.get(poisson, poisson)
    plane, up = hypothesis == "plane_strain", 2 if hypothesis == "solid" else 1
    points, displacement, stress = solved(alone(hypothesis, (HEAT,), poisson=poisson))
    assert displacement == pytest.approx((1 + ratio if plane else 1.0) * STRAIN * points, abs=1e-13)
    expected = np.zeros_like(stress)
    expected[:, 2] = -MU["E"] * STRAIN if plane else 0.0
    assert stress == pytest.approx(expected, abs=1e-13)
    held = (hhr.Displacement(block.side(up, True), up),)
    _, _, stress = solved(alone(hypothesis, (HEAT,), poisson=poisson, held=held))
    expected[:, up] = -MU["E"] * STRAIN / (1 - ratio if plane else 1.0)
    expected[:, 2] = expected[:, up] if plane or up == 2 else 0.0
    assert stress == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize("poisson", ["nu", 0.49])
def test_a_graded_body_expands_without_stress(poisson):
    """What multiplies its modulus multiplies the forces of its strain."""
    scene = alone("axisymmetric", (HEAT,), poisson=poisson, grading=lambda x: 1 + x[0] * x[1])
    points, displacement, stress = solved(scene)
    assert displacement == pytest.approx(STRAIN * points, abs=1e-13)
    assert stress == pytest.approx(0 * stress, abs=1e-13)


def test_strains_add_up_and_have_directions():
    """Swelling along axes and heat leave no stress, and shear leaves none of a block that only
    stands.
    """
    swelling = hhr.Eigenstrain(
        block.SOLID, hhr.Amplitude(0.1, {"T": 0.2}), ((1, 0, 0), (0, 2, 0), (0, 0, -1.0))
    )
    points, displacement, stress = solved(alone("plane_stress", (swelling, HEAT)))
    expected = (0.1 + 0.2 * MU["T"]) * np.array([1.0, 2.0]) + STRAIN
    assert displacement == pytest.approx(expected * points, abs=1e-13)
    assert stress == pytest.approx(0 * stress, abs=1e-13)
    shear = hhr.Eigenstrain(
        block.SOLID, "T**2", ((0, 0.1, 0), (0.1, 0, 0), (0, 0, 0)), lambda x: 2.0
    )
    clamped = tuple(hhr.Displacement(block.side(1, False), axis) for axis in (0, 1))
    scene = dataclasses.replace(alone("plane_strain", (shear,)), displacements=clamped)
    points, displacement, stress = solved(scene)
    assert displacement[:, 0] == pytest.approx(2 * 0.2 * MU["T"] ** 2 * points[:, 1], abs=1e-13)
    assert stress == pytest.approx(0 * stress, abs=1e-13)


@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric", "solid"])
def test_a_column_under_its_weight(hypothesis):
    """Nodal values are exact: u = rho g (H y - y^2 / 2) / E."""
    dim = 3 if hypothesis == "solid" else 2
    weight = hhr.BodyForce(block.SOLID, (0.0,) * (dim - 1) + (-1.0,), "0.1 * T**2")
    points, displacement, _ = solved(alone(hypothesis, (weight,), poisson=0.0))
    y = points[:, -1]
    assert displacement[:, -1] == pytest.approx(
        -0.1 * MU["T"] ** 2 * (HEIGHT * y - y**2 / 2) / MU["E"], abs=1e-12
    )


def test_a_ring_that_turns():
    """Held in height, so in plane strain, it meets Lame's closed form with the square of the size
    of the cells.

    Of rho omega^2 = 0.3 T^2 the radial displacement of a free ring is a particular one, C1 r and C2
    / r.
    """
    (young, nu, heat), ends = MU.values(), np.array([1.0, 2.0])
    lam, mu = young * nu / (1 + nu) / (1 - 2 * nu), young / 2 / (1 + nu)
    factor = -0.3 * heat**2 / (8 * (lam + 2 * mu))
    rows = np.stack([np.full(2, 2 * (lam + mu)), -2 * mu / ends**2], axis=1)
    c1, c2 = np.linalg.solve(rows, -factor * (3 * (lam + 2 * mu) + lam) * ends**2)
    load, held, errors = (
        hhr.Centrifugal(block.SOLID, "0.3 * T**2"),
        (hhr.Displacement(block.side(1, True), 1),),
        [],
    )
    for cells in (8, 16, 32):
        corners = {"lower": (1.0, 0.0), "upper": (2.0, 0.25), "cells": (cells, 2)}
        scene = alone("axisymmetric", (load,), held=held, **corners)
        points, displacement, _ = solved(
            dataclasses.replace(scene, displacements=scene.displacements[1:])
        )
        r = points[:, 0]
        radial = factor * r**3 + c1 * r + c2 / r
        errors.append(np.abs(displacement[:, 0] - radial).max() / np.abs(radial).max())
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 1e-3 and (rates > 1.9).all()


@pytest.mark.parametrize(
    ("hypothesis", "place", "distance"),
    [
        ("plane_stress", {"axis_point": (0.5, -1.0)}, (0.25, 2.0)),
        (
            "solid",
            {"axis_point": (0.5, 0.0, 0.0), "axis_direction": (0.0, 3.0, 4.0)},
            (0.25, 0.0, 0.0),
        ),
        ("solid", {"axis_direction": (0.0, 0.0, 4.0)}, (0.75, 0.75, 0.0)),
    ],
)
def test_axes_of_what_turns(hypothesis, place, distance):
    """The force is the volume times the distance of the centre, (0.75, 0.75, 1), from the axis."""
    load = hhr.Centrifugal(block.SOLID, "2 * T", **place)
    discretisation = hhr.FullOrderModel(alone(hypothesis, (load,))).discretisation
    (term,) = load.terms(discretisation.assembler(load))
    # forces of the amplitude 1 on all nodes, held or not
    forces = term.columns.reshape(-1, len(distance))
    assert forces.sum(axis=0) == pytest.approx(
        1.5 ** (len(distance) - 1) * HEIGHT * np.array(distance), abs=1e-12
    )


def layers(*, young="E1", poisson="nu1", clamped=False, loads=None):
    """Two blocks on each other that grow into a gap, in plane stress; clamped, they do so
    unevenly.
    """
    low, high = SERIES
    boxes = ((0.0, 0.0), (1.0, low), (6, 4)), ((0.0, low), (1.0, low + high), (6, 4))
    ends = (two_blocks.side(FIRST, 1, False), two_blocks.side(SECOND, 1, True))
    sides = tuple(hhr.Displacement(two_blocks.side(body, 0, False), 0) for body in (FIRST, SECOND))
    held = tuple(
        hhr.Displacement(end, axis) for end in ends for axis in ((0, 1) if clamped else (1,))
    )
    moduli = {"E1": (1.0, 3.0), "nu1": (0.1, 0.4)}
    box = {name: moduli[name] for name in moduli if name in (young, poisson)} | {
        "T": (0.5, 2.0),
        "gap": (0.0, 0.02),
    }
    heat = (
        hhr.ThermalExpansion(FIRST, "0.02 * (1 + 0.1 * T)", "T"),
        hhr.Eigenstrain(SECOND, "0.01 * T"),
    )
    return pair_scene(
        "layers",
        box,
        *boxes,
        ((young, poisson), (2.0, 0.3)),
        hypothesis="plane_stress",
        contacts=(
            hhr.NodeToNode(
                two_blocks.side(FIRST, 1, True), two_blocks.side(SECOND, 1, False), (0.0, 1.0)
            ),
        ),
        displacements=held if clamped else (*held, *sides),
        loads=heat if loads is None else loads,
        openings=(hhr.Opening(0, slope("gap")),),
    )


UNEVEN = (
    hhr.ThermalExpansion(
        FIRST, "table(T, 0, 0.02, 1, 0.025, 2, 0.027)", "T", lambda x: 1 + 2 * x[0] ** 2
    ),
    hhr.Eigenstrain(SECOND, slope("T", 0.01), ((1.0, 0, 0), (0, 2.0, 0), (0, 0, 0))),
    hhr.BodyForce(SECOND, (0.0, -1.0), "0.01 * T**2"),
    hhr.Pressure(two_blocks.side(FIRST, 0, True), "0.02 * sqrt(T)"),
    hhr.Traction(two_blocks.side(SECOND, 0, True), (1.0, 0.5), "0.01 * T"),
)


def test_two_layers_that_grow_into_a_gap():
    """The pressure closes what is left of the gap over both compliances."""
    full = hhr.FullOrderModel(layers())
    for point in full.parameters.random(5, seed=1):
        young, _, temperature, gap = point
        grown = (
            0.02 * (1 + 0.1 * temperature) * temperature * SERIES[0]
            + 0.01 * temperature * SERIES[1]
            - gap
        )
        pressure = max(grown, 0.0) / (SERIES[0] / young + SERIES[1] / 2.0)
        answer = full.solve(point)
        assert answer.forces().sum() == pytest.approx(pressure, abs=1e-12)
        expected = np.zeros((len(full.problem.cell_nodes), 4))
        expected[:, 1] = -pressure
        assert answer.stress() == pytest.approx(expected, abs=1e-12)


def test_moduli_as_formulas_and_as_numbers():
    """Nodal forces and stresses follow the moduli, bit for bit but round-off."""
    full = hhr.FullOrderModel(layers(clamped=True, loads=UNEVEN))
    for point in full.parameters.random(3, seed=2):
        numbers = layers(young=point[0], poisson=point[1], clamped=True, loads=UNEVEN)
        expected, answer = hhr.FullOrderModel(numbers).solve(point[2:]), full.solve(point)
        for name in ("displacement", "forces", "stress"):
            assert largest_difference(getattr(answer, name)(), getattr(expected, name)()) < 1e-10


@pytest.fixture(scope="module")
def training():
    return hhr.train(layers(clamped=True, loads=UNEVEN), hhr.Sobol(64), held_out=20)


@needs("moduli")
@pytest.mark.parametrize("how", ["build", "condense"])
def test_reduced_and_condensed(training, how):
    """They agree with the full model, in stresses too."""
    full, model = training.full_order, getattr(training, how)()
    points = full.parameters.random(10, seed=3)
    check_alike(full, model, points, displacement=1e-4, forces=1e-3)
    for point in points:
        stress = full.solve(point).stress()
        assert np.linalg.norm(model.solve(point).stress() - stress) < 1e-3 * np.linalg.norm(stress)


@needs("moduli")
@pytest.mark.parametrize("how", ["full_order", "build", "condense"])
def test_gradients(training, how):
    model = training.full_order if how == "full_order" else getattr(training, how)()
    for point in model.parameters.random(2, seed=4):
        assert slope_errors(model, point).max() < 1e-8


def test_files(tmp_path):
    """Formulas are kept as text; a file that names other parameters, or functions that are unknown,
    is refused.
    """
    scene = layers(young=1.5, poisson=0.2, clamped=True, loads=UNEVEN)
    model = hhr.train(scene, [4, 4], held_out=0, folder=tmp_path / "snapshots").build()
    path = tmp_path / "model.npz"
    hhr.save_model(path, model)
    for point in scene.parameters.random(5, seed=5):
        assert np.array_equal(
            hhr.load_model(path).solve(point).forces(), by_lapack(model).solve(point).forces()
        )
    for numbers, message in (
        (
            {"text": "gap", "names": ["gap", "T"]},
            r"a formula is one of other parameters than \('T', 'gap'\)",
        ),
        ({"text": "exit(gap)", "names": ["T", "gap"]}, "calls 'exit'"),
        ({"text": "other", "names": ["T", "gap"]}, "names \\['other'\\]"),
    ):
        hhr.save_model(path, model)
        scalar = {"kind": "Scalar", "fields": numbers}
        rewrite_model(path, put("fields.amplitudes.nonaffine.0", scalar))
        with pytest.raises(ModelFileError, match=message):
            hhr.load_model(path)


def test_names_and_numbers_stay_affine():
    """Answers of affine scenes are tabulated, so that a bare name is made a slope, and a bare
    number a constant.
    """
    pressure = partial(hhr.Pressure, two_blocks.side(FIRST, 0, True))
    loads = pressure(" T "), pressure("2e-3 * 5"), hhr.ThermalExpansion(SECOND, 1e-2, 3.0)
    amplitudes = hhr.FullOrderModel(layers(young=1.0, poisson=0.2, loads=loads)).problem.amplitudes
    assert amplitudes.nonaffine == ()
    assert amplitudes.constant[2:].tolist() == [0.0, 0.01, 0.03] and amplitudes.slopes[
        2
    ].tolist() == [1.0, 0.0]


def test_idle_parameters():
    scene = layers(young=1.0, poisson=0.2, loads=(hhr.BodyForce(FIRST, (1.0, 0.0), "T - T + 1"),))
    with pytest.warns(SceneWarning, match=r"parameters \('T',\) of scene"):
        hhr.FullOrderModel(scene)


def test_on_two_ranks():
    """Means over cells and formulas on meshes that are spread."""
    program = (
        f"import sys; sys.path[:0] = {folders_of(__file__)!r}\n"
        "import test_volume_loads as t\n"
        "t.test_free_expansion('axisymmetric', 0.49); t.test_two_layers_that_grow_into_a_gap()\n"
        "print('all is well')\n"
    )
    assert launch(2, ["-c", program]).count("all is well") == 2


def turning_about(hypothesis, *axis):
    return hhr.FullOrderModel(alone(hypothesis, (hhr.Centrifugal(block.SOLID, "T", *axis),)))


SKEW = ((0, 1, 0), (0, 0, 0), (0, 0, 0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: hhr.BodyForce(1, (0.0, 0.0), 1.0),
            "the direction .* of the body force on tag 1 must not be zero",
        ),
        (lambda: hhr.BodyForce(1, (0.0, "1"), 1.0), "must hold finite numbers"),
        (
            lambda: hhr.BodyForce(1.0, (0.0, 1.0), 1.0),
            r"the tag 1\.0 of a body force must be an integer",
        ),
        (
            lambda: hhr.BodyForce(1, (0.0, 1.0), None),
            "the amplitude None of the body force on tag 1",
        ),
        (
            lambda: hhr.BodyForce(1, (0.0, 1.0), "2 *"),
            "the amplitude of the body force on tag 1.*cannot be read",
        ),
        (
            lambda: hhr.Centrifugal(1, 1.0, axis_direction=(0, 0, 0)),
            "axis_direction .* must not be zero",
        ),
        (lambda: hhr.Eigenstrain(1, 1.0, SKEW), "must be a symmetric 3x3 tensor"),
        (lambda: hhr.Eigenstrain(1, 1.0, 0.0), "must be a symmetric 3x3 tensor"),
        (lambda: hhr.Eigenstrain(1, 1.0, ((1, 0), (0, 1))), "must be a symmetric 3x3 tensor"),
        (
            lambda: hhr.Eigenstrain(1, 1.0, field=3.0),
            r"the field 3\.0 of the eigenstrain of body 1 must be a function",
        ),
        (
            lambda: hhr.ThermalExpansion(1, None, 3.0),
            "expansion of the thermal expansion of body 1 = None",
        ),
        (
            lambda: hhr.ThermalExpansion(1, 1.0, "exit()"),
            "temperature of the thermal expansion of body 1.*'exit'",
        ),
        (lambda: hhr.PartialPressure(1, "2 * p", "h"), "must be a finite number or an Amplitude"),
        (lambda: turning_about("solid"), "needs an axis_direction of 3 components"),
        (
            lambda: turning_about("axisymmetric", (1.0, 0.0)),
            "the axis of an axisymmetric scene is at r = 0",
        ),
    ],
)
def test_loads_that_are_none(make, message):
    with pytest.raises(SceneError, match=message):
        make()


@pytest.mark.parametrize(
    ("load", "message"),
    [
        (
            hhr.Pressure(221, "2 * p"),
            r"the amplitude of Pressure.*names \['p'\], the parameters are",
        ),
        (hhr.Pressure(221, "log(T - 1)"), "is nan at .*finite everywhere in the box"),
        (
            hhr.ThermalExpansion(FIRST, "table(T, 0, 1, 1, 2)", "T"),
            "outside the table from 0 to 1.*further points",
        ),
        (hhr.BodyForce(FIRST, (1.0, 0.0, 0.0), "T"), "must have 2 components"),
        (hhr.BodyForce(7, (1.0, 0.0), "T"), "cell tag.*7"),
        (hhr.Eigenstrain(7, "T"), "cell tag.*7"),
        (hhr.Centrifugal(FIRST, "T", axis_point=(0.0,)), "must have 2 components"),
        (
            hhr.Centrifugal(FIRST, "T", axis_direction=(0, 0, 1)),
            "the axis of a scene in plane_stress is known",
        ),
        (hhr.Eigenstrain(FIRST, "T", ((0, 0, 1), (0, 0, 0), (1, 0, 0))), "shears out of the plane"),
        (
            hhr.Eigenstrain(FIRST, "T", field=lambda x: x),
            "must map UFL coordinates to a UFL scalar",
        ),
        (
            hhr.Eigenstrain(FIRST, "T", field=lambda x: "hot"),
            "must map UFL coordinates to a UFL scalar",
        ),
        (hhr.Eigenstrain(FIRST, "T", field=lambda x: 1 / (x[0] - x[0])), "not finite"),
    ],
)
def test_loads_that_do_not_fit_the_scene(load, message):
    with pytest.raises(SceneError, match=message):
        hhr.FullOrderModel(layers(loads=(load,)))


def test_amplitudes_whose_names_are_no_words():
    """An affine amplitude may have any names, but those that are multiplied by a modulus become
    formulas.
    """
    scene = layers()
    names = ("E1", "nu1", "T - 1", "gap")
    space = dataclasses.replace(scene.parameters, names=names)
    load = hhr.Eigenstrain(FIRST, slope("T - 1"))
    scene = dataclasses.replace(scene, parameters=space, loads=(load,))
    with pytest.raises(SceneError, match="names of parameters are words"):
        hhr.FullOrderModel(scene)
