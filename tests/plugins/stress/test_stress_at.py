"""Stress at a point: uniform stress of patches, the bent beam, differences, bodies with laws."""

import dataclasses

import numpy as np
import pytest
from needs import needs
from scenes import block_scene, output_slopes, pressed_block, pressed_pair, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries import block, two_blocks

NAMES = {
    "plane_strain": ("xx", "yy", "zz", "xy"),
    "plane_stress": ("xx", "yy", "zz", "xy"),
    "axisymmetric": ("rr", "zz", "tt", "rz"),
    "solid": ("xx", "yy", "zz", "xy", "xz", "yz"),
}


def outputs(place, names, tag=block.SOLID):
    every = (*names, "principal_1", "principal_2", "principal_3")
    return tuple(hhr.StressAt(name, place, name, tag) for name in every)


@pytest.mark.parametrize("simplices", [False, True])
@pytest.mark.parametrize("hypothesis", NAMES)
def test_a_patch_of_uniform_stress(hypothesis, simplices):
    """A block with free sides on a floor: E strain along the load, ν times that in plane strain."""
    dim = 3 if hypothesis == "solid" else 2
    names = NAMES[hypothesis]
    scene = pressed_block(hypothesis, simplices=simplices)
    place = (0.6,) * (dim - 1) + (1.1,)
    full = hhr.FullOrderModel(dataclasses.replace(scene, outputs=outputs(place, names)))
    values = full.solve(0.05).outputs()
    flat = hypothesis == "plane_strain"
    along = -3.0 / (1 - 0.3**2) * 0.02 if flat else -3.0 * 0.02
    expected = dict.fromkeys(names, 0.0)
    expected["yy" if dim == 2 and hypothesis != "axisymmetric" else "zz"] = along
    if flat:
        expected["zz"] = 0.3 * along
    for name, value in expected.items():
        assert values[name] == pytest.approx(value, abs=1e-12), name
    principal = np.sort([expected[name] for name in names[:3]])[::-1]
    for number, value in enumerate(principal, start=1):
        assert values[f"principal_{number}"] == pytest.approx(value, abs=1e-12)


def test_shear_has_no_factor_of_kelvin():
    """A sheared block: u = (s y, 0), xy = mu s; principal values are mu s, 0 and -mu s."""
    sides = [block.side(axis, upper) for axis in (0, 1) for upper in (False, True)]
    held = [
        hhr.Displacement(
            tag, axis, slope("s") if axis == 0 else hhr.Amplitude(), "y" if axis == 0 else None
        )
        for tag in sides
        for axis in (0, 1)
    ]
    scene = block_scene(
        "sheared",
        {"s": (0.0, 0.1)},
        young=3.0,
        contacts=(hhr.Obstacle(hhr_free_side(), (0.0, 1.0), 9.0),),
        displacements=[item for item in held if item.tag != hhr_free_side()],
        loads=(hhr.Traction(hhr_free_side(), (1.0, 0.0), hhr.Amplitude(slopes={"s": 3.0 / 2.6})),),
        outputs=outputs((0.4, 0.3), NAMES["plane_strain"]),
    )
    values = hhr.FullOrderModel(scene).solve(0.05).outputs()
    assert values["xy"] == pytest.approx(3.0 / 2.6 * 0.05, rel=1e-10)
    for number, value in ((1, 1.0), (2, 0.0), (3, -1.0)):
        expected = value * 3.0 / 2.6 * 0.05
        assert values[f"principal_{number}"] == pytest.approx(expected, abs=1e-12)


def hhr_free_side():
    """The upper side, on which the traction of the same stress acts."""
    return block.side(1, True)


def test_stress_at_a_node_is_the_mean_around_it():
    """At an inner node of a regular mesh it is the recovered stress."""
    scene = pressed_pair("plane_strain", ((3.0, 0.3), (5.0, 0.2)))
    asked = outputs((1.5, 0.5), NAMES["plane_strain"], two_blocks.FIRST)
    full = hhr.FullOrderModel(dataclasses.replace(scene, outputs=asked))
    answer = full.solve({"push": 0.05, "slide": 0.01, "load": 0.05, "gap": 0.002})
    problem = full.problem
    node = np.flatnonzero(np.isclose(problem.points, (1.5, 0.5)).all(axis=1))
    around = (problem.cell_nodes == node[0]).any(axis=1)
    mean = full.stress(answer)[around].mean(axis=0) / (1.0, 1.0, 1.0, np.sqrt(2))
    for name, value in zip(NAMES["plane_strain"], mean, strict=True):
        assert answer.outputs()[name] == pytest.approx(value, rel=1e-12)


@needs("elasticity", "moduli", "volume_loads")
def test_moduli_heat_and_derivatives():
    """Heated bodies with moduli of parameters: values of the mesh, derivatives by differences."""
    soft = hhr.Body(two_blocks.FIRST, "3 * stiff", 0.3)
    parameters = {"stiff": (0.5, 2.0), "T": (0.0, 1.0)}
    names = NAMES["plane_strain"]
    scene = pressed_pair(
        "plane_strain",
        (soft, hhr.Body(two_blocks.SECOND, 5.0, 0.2)),
        parameters,
        loads=(
            hhr.Pressure(two_blocks.side(two_blocks.SECOND, 0, True), slope("load")),
            hhr.ThermalExpansion(two_blocks.FIRST, "2e-2", "T"),
        ),
        outputs=outputs((1.37, 0.62), names, two_blocks.FIRST),
    )
    model = hhr.FullOrderModel(scene)
    point = [0.05, 0.01, 0.03, 0.002, 1.3, 0.6]
    answer = model.solve(point)
    middles = model.problem.points[model.problem.cell_nodes].mean(axis=1)
    cell = np.linalg.norm(middles - (1.37, 0.62), axis=1).argmin()
    stress = model.stress(answer)[cell] / (1.0, 1.0, 1.0, np.sqrt(2))
    values = model.outputs(point, gradient=True)
    for name, value in zip(names, stress, strict=True):
        assert values[name] == pytest.approx(value, rel=1e-10)
    for name, slopes in output_slopes(model, point, *values.keys()).items():
        size = np.abs(slopes).max()
        np.testing.assert_allclose(values.gradient[name], slopes, atol=2e-5 * size)


@needs("inelastic")
def test_bodies_with_laws():
    """The thick tube under pressure p: rr = A - B / r^2, tt = A + B / r^2 (Lame), meshed."""
    from tubes import tube

    asked = outputs((1.5, 0.1), NAMES["axisymmetric"])
    scene = dataclasses.replace(tube(hhr.Plasticity(10.0), 0.1), outputs=asked)
    history = hhr.FullOrderModel(scene).march([(0.0, [0.0]), (1.0, [0.1])])
    values = history.answers[-1].outputs()
    constant = 0.1 / 3
    assert values["rr"] == pytest.approx(constant * (1 - 4 / 1.5**2), rel=0.01)
    assert values["tt"] == pytest.approx(constant * (1 + 4 / 1.5**2), rel=0.01)
    assert values["principal_1"] == pytest.approx(values["tt"], rel=1e-6)


def test_mistakes_are_named():
    with pytest.raises(SceneError, match="the component 'yx' must be one of"):
        hhr.StressAt("s", (0.0, 0.0), "yx", block.SOLID)
    for output, why in (
        (hhr.StressAt("s", (0.5, 1.0), "rr", block.SOLID), "plane strain has no component 'rr'"),
        (hhr.StressAt("s", (9.0, 1.0), "xx", block.SOLID), "away from the nearest point"),
        (hhr.StressAt("s", (0.5, 1.0), "xx", 77), "the cell tag 77 is not among the bodies"),
    ):
        with pytest.raises(SceneError, match=why):
            hhr.FullOrderModel(
                dataclasses.replace(pressed_block("plane_strain"), outputs=(output,))
            )
