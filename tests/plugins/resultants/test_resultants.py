"""Reactions, contact areas and centres of pressure: equilibrium, closed forms, differences."""

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs, present
from scenes import block_scene, output_slopes, pressed_block, pressed_pair, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries import block, two_blocks

BODIES = (3.0, 0.3), (5.0, 0.2)
BOTTOM = two_blocks.side(two_blocks.FIRST, 1, False)
TOP = two_blocks.side(two_blocks.SECOND, 1, True)
AT = {"push": 0.05, "slide": 0.01, "load": 0.05, "gap": 0.002}


def with_outputs(scene, *outputs):
    return dataclasses.replace(scene, outputs=outputs)


def reactions(*tags, dim=2):
    """Reactions of supports along all axes, and their moments about a point off them."""
    axes = np.eye(dim)
    forces = [hhr.Reaction(f"{tag} {k}", tag, tuple(axes[k])) for tag in tags for k in range(dim)]
    about = (0.3, -0.4, 0.7)[:dim]
    turned = (None,) if dim == 2 else tuple(map(tuple, axes))
    moments = [
        hhr.Reaction(f"{tag} m{k}", tag, about=about, axis=axis, kind="moment")
        for tag in tags
        for k, axis in enumerate(turned)
    ]
    return (*forces, *moments)


def test_reactions_and_loads_balance():
    """Forces and moments: the load p on the flank x = 2, 1 < y < 2, is -p in x at y = 1.5."""
    scene = with_outputs(pressed_pair("plane_strain", BODIES), *reactions(BOTTOM, TOP))
    values = hhr.FullOrderModel(scene).solve(AT).outputs()
    sums = {kind: values[f"{BOTTOM} {kind}"] + values[f"{TOP} {kind}"] for kind in ("0", "1", "m0")}
    size = abs(values[f"{TOP} 1"])
    load = -AT["load"]
    assert size > 0.02
    assert sums["0"] + load == pytest.approx(0.0, abs=1e-12 * size)
    assert sums["1"] == pytest.approx(0.0, abs=1e-12 * size)
    # moment of (load, 0) at (2, 1.5) about (0.3, -0.4)
    assert sums["m0"] - (1.5 + 0.4) * load == pytest.approx(0.0, abs=1e-11 * size)


def test_reactions_balance_in_space():
    """Supports share nodes with none: lower block clamped, upper one driven; contact is inner."""
    bottom, top = (
        two_blocks.side(tag, 2, up)
        for tag, up in ((two_blocks.FIRST, False), (two_blocks.SECOND, True))
    )
    scene = with_outputs(pressed_pair("solid", BODIES, cells=2), *reactions(bottom, top, dim=3))
    values = hhr.FullOrderModel(scene).solve(AT).outputs()
    size = abs(values[f"{top} 2"])
    load = np.array([-AT["load"], 0.0, 0.0])
    arm = np.array([2.0, 0.5, 1.5]) - (0.3, -0.4, 0.7)
    for kind, expected in (("", -load), ("m", -np.cross(arm, load))):
        total = [values[f"{bottom} {kind}{k}"] + values[f"{top} {kind}{k}"] for k in range(3)]
        np.testing.assert_allclose(total, expected, atol=1e-11 * size)


@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric", "solid"])
def test_the_reaction_of_a_uniform_block(hypothesis):
    """E' (push - gap) / 2 times the area: 1.5, in axisymmetry pi 1.5^2, in space 1.5^2."""
    modulus = 3.0 / (1 - 0.3**2) if hypothesis == "plane_strain" else 3.0
    area = {"plane_strain": 1.5, "axisymmetric": np.pi * 1.5**2, "solid": 1.5**2}[hypothesis]
    dim = 3 if hypothesis == "solid" else 2
    up = tuple(np.eye(dim)[dim - 1])
    top = block.side(dim - 1, True)
    outputs = (
        hhr.Reaction("press", top, up),
        hhr.Reaction("work", top, kind="work"),
        hhr.ContactArea("area", 0),
    )
    if present("stress"):
        outputs += (hhr.ElasticEnergy("energy"),)
    full = hhr.FullOrderModel(with_outputs(pressed_block(hypothesis), *outputs))
    values = full.solve(0.05).outputs()
    assert values["press"] == pytest.approx(-modulus * 0.04 / 2 * area, rel=1e-10)
    assert values["work"] == pytest.approx(modulus * 0.04 / 2 * area * 0.05, rel=1e-10)
    assert values["area"] == pytest.approx(area, rel=1e-10)
    if present("stress"):
        # the force grows from the gap on: the energy is (push - gap) / (2 push) of the work
        assert values["work"] == pytest.approx(2 * values["energy"] * 0.05 / 0.04, rel=1e-10)


def test_a_common_dof_counts_for_the_first_support():
    """A body under a pressure is held on two sides that share a corner: the sum is right."""
    sides = block.side(0, False), block.side(1, False)
    held = [hhr.Displacement(tag, axis) for tag in sides for axis in (0, 1)]
    scene = block_scene(
        "corner",
        {"p": (0.0, 0.1)},
        contacts=(hhr.Obstacle(block.side(0, True), (1.0, 0.0), 9.0),),
        displacements=held,
        loads=(hhr.Pressure(block.side(1, True), slope("p")),),
    )
    named = [hhr.Reaction(f"{tag} {k}", tag, tuple(np.eye(2)[k])) for tag in sides for k in (0, 1)]
    values = hhr.FullOrderModel(with_outputs(scene, *named)).solve(0.07).outputs()
    sums = [sum(values[f"{tag} {k}"] for tag in sides) for k in (0, 1)]
    np.testing.assert_allclose(sums, [0.0, 0.07], atol=1e-12)


@needs("elasticity", "moduli")
def test_moduli_that_are_parameters():
    """Balance, and derivatives by differences, of forces and of the work."""
    outputs = *reactions(BOTTOM, TOP), hhr.Reaction("work", TOP, kind="work")
    bodies = hhr.Body(two_blocks.FIRST, "3 * stiff", 0.3), hhr.Body(two_blocks.SECOND, 5.0, 0.2)
    scene = pressed_pair("plane_strain", bodies, {"stiff": (0.5, 2.0)})
    model = hhr.FullOrderModel(with_outputs(scene, *outputs))
    point = [0.05, 0.01, 0.05, 0.002, 1.3]
    values = model.outputs(point, gradient=True)
    size = abs(values[f"{TOP} 1"])
    assert values[f"{BOTTOM} 1"] + values[f"{TOP} 1"] == pytest.approx(0.0, abs=1e-12 * size)
    names = [output.name for output in outputs]
    widths = np.subtract(model.parameters.upper, model.parameters.lower)
    for name, slopes in output_slopes(model, point, *names).items():
        # over the box, beside the force that presses: one reaction vanishes
        off = np.abs(values.gradient[name] - slopes) * widths
        assert off.max() < 1e-5 * max(np.abs(slopes * widths).max(), size), name


@pytest.fixture(scope="module")
def training():
    outputs = (
        *reactions(BOTTOM, TOP),
        hhr.ContactArea("area", 0),
        hhr.CentreOfPressure("centre", 0, 0),
    )
    scene = with_outputs(pressed_pair("plane_strain", BODIES), *outputs)
    return hhr.train(scene, hhr.Sobol(32), held_out=0, comm=MPI.COMM_SELF)


def test_small_models_and_files_have_them(training, tmp_path):
    """Condensed models exactly; a hyper-reduced one with the error of its forces."""
    exact = training.full_order.outputs(AT, gradient=True)
    for model, tolerance in ((training.condense(), 1e-9), (training.build(checked=False), 0.02)):
        hhr.save_model(tmp_path / "model.npz", model)
        for asked in (model, hhr.load_model(tmp_path / "model.npz")):
            values = asked.outputs(AT, outside="ignore", gradient=True)
            size = abs(exact[f"{TOP} 1"])
            for name, value in exact.items():
                assert values[name] == pytest.approx(value, rel=tolerance, abs=tolerance * size), (
                    name
                )
    np.testing.assert_allclose(values["centre"], exact["centre"], rtol=0.02)


def test_a_linear_reaction_is_in_c(training, tmp_path):
    """Of a constant stiffness it is a sum of forces and amplitudes; the centre is a quotient."""
    if not present("exporters"):
        pytest.skip("no C headers")
    from hhr_dolfinx.plugins.exporters.c_header import write_c_header

    with pytest.warns(hhr.errors.ModelFileWarning, match="no output centre: .*centres of pressure"):
        write_c_header(tmp_path / "pair.h", training.condense())
    text = (tmp_path / "pair.h").read_text()
    assert f'"{TOP} 1"' in text and '"area"' in text and '"centre"' not in text


def test_the_centre_is_the_moment_over_the_force(training):
    """About the origin, of forces along y on a flat surface at y = 1: M = x F, exactly."""
    surface = (
        hhr.ContactForce("f", 0, (0.0, 1.0)),
        hhr.ContactMoment("m", 0, about=(0.0, 1.0)),
        hhr.CentreOfPressure("x", 0, 0),
        hhr.CentreOfPressure("y", 0, 1),
    )
    model = hhr.FullOrderModel(with_outputs(pressed_pair("plane_strain", BODIES), *surface))
    values = model.outputs(AT, gradient=True)
    assert values["x"] == pytest.approx(values["m"] / values["f"], rel=1e-12)
    assert values["y"] == pytest.approx(1.0, rel=1e-12)
    slopes = output_slopes(model, list(AT.values()), "x")["x"]
    np.testing.assert_allclose(values.gradient["x"], slopes, rtol=1e-5, atol=1e-6)
    apart = model.solve({**AT, "push": 0.005, "gap": 0.01, "load": 0.0}).outputs()
    assert np.isnan(apart["x"]) or apart["x"] > 1.0


def test_the_contact_area_is_that_of_hertz():
    """Half-discs: half-width a = sqrt(8 P R* / (pi E*)) / sqrt(2); the area is within two segments.

    E* is that of both bodies in plane strain, R* = R / 2; segments at the pole are 2.2 % of R.
    """
    from hhr_dolfinx.geometries import hertz_half_discs as discs

    push = hhr.Displacement(discs.UPPER_FLAT, 1, slope("push", -1.0))
    scene = hhr.Scene(
        name="discs",
        geometry=lambda comm: discs.half_discs(comm, gap=0.0, arc_segments=120, pole_ratio=1.03),
        hypothesis="plane_strain",
        bodies=tuple(hhr.Body(tag, 1000.0, 0.3) for tag in (discs.LOWER, discs.UPPER)),
        contacts=(hhr.NodeToNode(discs.UPPER_ARC, discs.LOWER_ARC, (0.0, -1.0)),),
        parameters=hhr.ParameterSpace(("push",), (0.0,), (0.1,)),
        displacements=(
            *hhr.Displacement.clamp(discs.LOWER_FLAT, 2),
            hhr.Displacement(discs.UPPER_FLAT, 0),
            push,
        ),
        outputs=(hhr.ContactArea("area", 0), hhr.Reaction("press", discs.UPPER_FLAT, (0.0, -1.0))),
    )
    full = hhr.FullOrderModel(scene)
    values = full.solve(0.05).outputs()
    modulus = 1000.0 / (2 * (1 - 0.3**2))
    half = np.sqrt(4 * values["press"] * 0.5 / (np.pi * modulus))
    segment = full.problem.contact_areas.min()
    assert values["area"] == pytest.approx(2 * half, abs=4 * segment)


@pytest.mark.parametrize(
    "made, why",
    [
        (lambda: hhr.Reaction("r", 1), "a force needs direction"),
        (lambda: hhr.Reaction("r", 1, (0, 1), about=(0, 0)), "a force takes no about"),
        (lambda: hhr.Reaction("r", 1, (0, 1), kind="moment"), "takes no direction"),
        (
            lambda: hhr.Reaction("r", 1, (0, 1), kind="power"),
            "must be one of 'force', 'moment', 'work'",
        ),
        (lambda: hhr.Reaction("r", 1, (0, 1), axis=(0, 0, 1)), "an axis is for a moment"),
        (lambda: hhr.CentreOfPressure("c", 0, 3), "must be 0, 1 or 2"),
    ],
)
def test_mistakes_are_named(made, why):
    with pytest.raises(SceneError, match=why):
        made()


@pytest.mark.parametrize(
    "output, why",
    [
        (
            hhr.Reaction("r", "nowhere", (0, 1)),
            "no displacement is imposed on 'nowhere': name one of",
        ),
        (hhr.Reaction("r", BOTTOM, kind="work"), "no motion is imposed on"),
        (
            hhr.Reaction("r", BOTTOM, about=(0, 0), axis=(0, 0, 1), kind="moment"),
            "an axis is for meshes in space",
        ),
        (hhr.CentreOfPressure("c", 0, 2), "the mesh has 2 components"),
    ],
)
def test_what_a_scene_lacks_is_named(output, why):
    with pytest.raises(SceneError, match=why):
        hhr.FullOrderModel(with_outputs(pressed_pair("plane_strain", BODIES), output))


def test_the_radius_of_the_centre_is_refused_in_axisymmetry():
    scene = with_outputs(pressed_block("axisymmetric"), hhr.CentreOfPressure("c", 0, 0))
    with pytest.raises(SceneError, match="their centre lies on it: take component 1"):
        hhr.FullOrderModel(scene)


@needs("inelastic")
def test_bodies_with_laws_are_refused_with_the_reason():
    from tubes import tube

    scene = tube(hhr.Plasticity(0.2), 0.1)
    support = scene.displacements[0].tag
    scene = dataclasses.replace(scene, outputs=(hhr.Reaction("r", support, (0.0, 1.0)),))
    with pytest.raises(SceneError, match="inner forces of bodies with laws are"):
        hhr.FullOrderModel(scene)


@needs("friction")
def test_friction_is_part_of_the_balance():
    from sheared_blocks import PATH, rubbing

    top, bottom = (
        two_blocks.side(tag, 1, up)
        for tag, up in ((two_blocks.SECOND, True), (two_blocks.FIRST, False))
    )
    scene = with_outputs(rubbing(), *reactions(bottom, top), hhr.FrictionForce("f", 0, (1.0, 0.0)))
    history = hhr.FullOrderModel(scene).march(PATH)
    values = history.answers[2].outputs()
    assert abs(values[f"{top} 0"]) > 1e-3
    for kind in ("0", "1", "m0"):
        assert values[f"{top} {kind}"] == pytest.approx(-values[f"{bottom} {kind}"], rel=1e-9)
    # the upper block is held by its top and by the contact alone
    assert abs(values["f"]) == pytest.approx(abs(values[f"{top} 0"]), rel=1e-9)


@needs("constraints", "nodal_loads")
def test_a_driven_node_carries_what_follows_it():
    """A top that follows one corner by equations: the reaction of a top that is held whole."""
    corner = hhr.Nodes.near((0.0, 2.0))
    top, bottom = block.side(1, True), block.side(1, False)
    common = {
        "upper": (1.5, 2.0),
        "young": 3.0,
        "contacts": (hhr.Obstacle(bottom, (0.0, -1.0), 0.01),),
    }
    across = hhr.Displacement(block.side(0, False), 0)
    whole = block_scene(
        "whole",
        {"push": (0.0, 0.1)},
        displacements=(across, hhr.Displacement(top, 1, slope("push", -1.0))),
        outputs=(hhr.Reaction("r", top, (0.0, 1.0)),),
        **common,
    )
    known = hhr.FullOrderModel(whole).solve(0.05).outputs()["r"]
    mesh_points = hhr.FullOrderModel(whole).problem.points
    others = [point for point in mesh_points if np.isclose(point[1], 2.0) and point[0] > 0]
    ties = tuple(
        hhr.Equation(((hhr.Nodes.near(tuple(point)), 1, 1.0), (corner, 1, -1.0)))
        for point in others
    )
    tied = block_scene(
        "tied",
        {"push": (0.0, 0.1)},
        displacements=(across, hhr.Displacement(corner, 1, slope("push", -1.0))),
        constraints=ties,
        outputs=(hhr.Reaction("r", corner, (0.0, 1.0)),),
        **common,
    )
    assert hhr.FullOrderModel(tied).solve(0.05).outputs()["r"] == pytest.approx(known, rel=1e-10)
