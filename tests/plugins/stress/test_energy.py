"""Elastic energy beside springs, friction and heat, and of bodies with laws: closed forms, other
meshes, gradients.
"""

import dataclasses

import numpy as np
import pytest
from needs import needs
from scenes import block_scene, output_slopes, pair_scene, slope
from sheared_blocks import PATH, rubbing

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries import block
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side
from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings
from hhr_dolfinx.plugins.inelastic.law import hooke

ENERGY = (hhr.ElasticEnergy("energy"),)
FAR = 9.0
"""Offset of a plane that nothing touches, as a scene has a contact."""


def rods(**others):
    """A rod 1 x 1 x 2 on a bed k, under a lid that sinks by ``down``: E a parameter, no lateral
    strain, ν = 0.
    """
    given = {
        "bodies": (hhr.Body(block.SOLID, "E", 0.0),),
        "contacts": (hhr.Obstacle(block.side(0, upper=True), (1.0, 0.0), FAR),),
        "displacements": (
            hhr.Displacement(block.side(0, upper=False), 0),
            hhr.Displacement(block.side(1, upper=True), 1, slope("down", -1.0)),
        ),
        "loads": (hhr.Springs(block.side(1, upper=False), 1, 20.0, slope("ground"), bedding=True),),
        "outputs": ENERGY,
    }
    box = {"down": (0.0, 0.1), "ground": (0.0, 0.1), "E": (10.0, 100.0)}
    return block_scene("rod", box, upper=(1.0, 2.0), **given | others)


@needs("nodal_loads", "moduli")
def test_a_rod_in_series_with_a_spring():
    """The stress is (down + ground) / (2 / E + 1 / k), and the energy of the rod its square over E.

    Not of the bed.
    """
    full = hhr.FullOrderModel(rods())
    for point in ([0.05, 0.0, 30.0], [0.03, 0.04, 80.0]):
        down, ground, young = point
        stress = (down + ground) / (2 / young + 1 / 20.0)
        found = full.outputs(point, gradient=True)
        assert found["energy"] == pytest.approx(stress**2 / young, rel=1e-9)
        by_push = 2 * stress / young / (2 / young + 1 / 20.0)
        by_young = (
            2 * stress / young * stress * 2 / young**2 / (2 / young + 1 / 20.0)
            - stress**2 / young**2
        )
        assert found.gradient["energy"] == pytest.approx([by_push, by_push, by_young], rel=1e-7)


def sprung(**others):
    """Two blocks, the upper one pressed and sheared on the lower one, whose flank has a bed and a
    spring.
    """
    loads = (
        hhr.Springs(side(FIRST, 0, True), 0, 4.0, bedding=True),
        hhr.Springs(hhr.Nodes.near((0.0, 0.5)), 1, 2.0, slope("push")),
        hhr.Springs(
            side(SECOND, 0, True), 0, 3.0, bedding=True
        ),  # of which the last is on an imposed dof
    )
    return rubbing(None, cells=4, loads=loads, outputs=ENERGY, **others)


def stored(scene, answer):
    """u·K u / 2 with K of the same bodies without springs and laws of contact."""
    bare = rubbing(None, cells=4, bodies=scene.bodies, outputs=())
    field = answer.displacement()
    return field @ (hhr.FullOrderModel(bare).problem.stiffness @ field) / 2


@needs("nodal_loads")
def test_springs_have_no_part_in_it():
    """Beside K of the bodies alone; condensed and hyper-reduced.

    Gradients beside differences, off by their square.
    """
    scene = sprung()
    full = hhr.FullOrderModel(scene)
    model = hhr.condense(full)
    for point in ([0.03, 0.02], [0.045, -0.06]):
        answer = full.solve(point, gradient=True)
        found = answer.outputs()
        assert answer.forces().max() > 0
        assert found["energy"] == pytest.approx(stored(scene, answer), rel=1e-10)
        assert model.outputs(point)["energy"] == pytest.approx(found["energy"], rel=1e-10)
        slopes = output_slopes(full, point, "energy", step=1e-5)["energy"]
        for outputs in (found, model.outputs(point, gradient=True)):
            assert outputs.gradient["energy"] == pytest.approx(slopes, rel=1e-5)


@needs("nodal_loads")
def test_springs_in_a_reduced_model_and_its_file(tmp_path):
    """As good as its forces and displacement, thousandths here, and with the same bits from a
    file.
    """
    scene = sprung()
    training = hhr.train(scene, (6, 6), held_out=3)
    full, model = hhr.FullOrderModel(scene), training.build()
    hhr.save_model(tmp_path / "model.npz", model)
    kept = hhr.load_model(tmp_path / "model.npz")
    for point in ([0.03, 0.02], [0.045, -0.06]):
        exact = full.outputs(point)["energy"]
        assert model.outputs(point)["energy"] == pytest.approx(exact, rel=5e-3)
        assert kept.outputs(point)["energy"] == model.outputs(point)["energy"]


@needs("friction", "floating")
def test_a_block_that_slips_all_over():
    """σ = -p, τ = μ p under a lid that is moved aside: p² / 2E + τ² / 2G, G = E / 2, at each step
    of the slip.
    """
    young, friction, pressure = 50.0, 0.3, 2.0
    flanks = (
        hhr.Traction(
            block.side(0, upper=upper), (0.0, 1.0), slope("p", (1 if upper else -1) * friction)
        )
        for upper in (False, True)
    )
    scene = block_scene(
        "slipping",
        {"p": (0.0, 4.0), "aside": (0.0, 1.0)},
        bodies=(hhr.Body(block.SOLID, young, 0.0),),
        contacts=(hhr.Obstacle(block.side(1, upper=False), (0.0, -1.0), 0.0, friction=friction),),
        displacements=(hhr.Displacement(block.side(1, upper=True), 0, slope("aside")),),
        loads=(hhr.Pressure(block.side(1, upper=True), slope("p")), *flanks),
        outputs=ENERGY,
    )
    closed = pressure**2 / (2 * young) + (friction * pressure) ** 2 / young
    path = [(0.0, (0.0, 0.0)), (1.0, (pressure, 0.2)), (2.0, (pressure, 0.6))]
    full = hhr.FullOrderModel(scene)
    for model in (full, hhr.condense(full)):
        history = model.march(path)
        for answer in history.answers:
            assert answer.slip.path.min() > 0.05
            assert answer.outputs()["energy"] == pytest.approx(closed, rel=1e-8)


@needs("friction")
@pytest.mark.parametrize("law", [0.3, "tresca", "moduli"])
def test_friction_counts_as_any_force(law):
    """Beside K of the bodies, along a path that sticks, slips and turns round; condensed.

    Gradients by differences.
    """
    bodies = (hhr.Body(FIRST, 3.0, 0.3), hhr.Body(SECOND, 5.0, 0.2))
    box = {"push": (-0.01, 0.05)}
    if law == "moduli":
        bodies, box = (hhr.Body(FIRST, "E", 0.3), bodies[1]), box | {"E": (2.0, 4.0)}
    friction = hhr.Tresca(0.02) if law == "tresca" else 0.3
    scene = rubbing(friction, cells=4, bodies=bodies, box=box, outputs=ENERGY)
    path = [(time, (*point, 3.0)[: len(box) + 1]) for time, point in PATH]
    full = hhr.FullOrderModel(scene)
    model = hhr.condense(full)
    fixed = dataclasses.replace(scene, bodies=(hhr.Body(FIRST, 3.0, 0.3), bodies[1]))
    settings = hhr.MarchSettings(gradient=True)
    statuses = set()
    for answer, other in zip(
        full.march(path, settings).answers, model.march(path).answers, strict=True
    ):
        found = answer.outputs()
        assert found["energy"] == pytest.approx(stored(fixed, answer), rel=1e-10)
        assert other.outputs()["energy"] == pytest.approx(
            found["energy"], rel=1e-9 if law == "moduli" else 1e-10
        )
        statuses |= set(answer.slip.statuses.tolist())
    assert statuses == {1, 2}  # sticks, slips
    # of the last step, along the whole history shifted
    step = 1e-6
    for axis in range(len(path[0][1])):
        ends = []
        for sign in (1, -1):
            moved = [
                (time, np.array(point) + sign * step * np.eye(len(point))[axis])
                for time, point in path
            ]
            ends.append(full.march(moved).answers[-1].outputs()["energy"])
        slope_of = (ends[0] - ends[1]) / (2 * step)
        assert found.gradient["energy"][axis] == pytest.approx(slope_of, rel=1e-4, abs=1e-9)


def hot(hypothesis="plane_strain", simplices=True, **others):
    """A block with a graded modulus and two strains without stress, E and ν parameters, between
    walls.
    """
    given = {
        "bodies": (hhr.Body(block.SOLID, "E", "nu"),),
        "contacts": (hhr.Obstacle(block.side(0, upper=True), (1.0, 0.0), 1.01),),
        "displacements": (
            hhr.Displacement(block.side(0, upper=False), 0),
            *(hhr.Displacement(block.side(1, upper=upper), 1) for upper in (False, True)),
        ),
        "loads": (
            hhr.ThermalExpansion(block.SOLID, "1e-3 * (1 + T / 300)", "T"),
            hhr.Eigenstrain(
                block.SOLID, slope("s", 0.02), ((1.0, 0.5, 0.0), (0.5, -0.3, 0.0), (0.0, 0.0, 0.4))
            ),
        ),
        "outputs": ENERGY,
    }
    box = {"T": (0.0, 100.0), "s": (-1.0, 1.0), "E": (1.0, 5.0), "nu": (0.0, 0.4)}
    return block_scene("hot", box, hypothesis=hypothesis, simplices=simplices, **given | others)


@needs("volume_loads", "moduli")
@pytest.mark.parametrize("hypothesis", ["plane_strain", "plane_stress"])
def test_the_energy_of_heated_bodies_is_that_of_their_stress(hypothesis):
    """Stress is constant in triangles: the sum of σ : C^-1 σ / 2 over them is exact. ν = 0 has no
    part λ.
    """
    full = hhr.FullOrderModel(hot(hypothesis))
    areas = np.full(len(full.problem.cell_nodes), 1.0 / len(full.problem.cell_nodes))
    for point in ([80.0, 0.3, 3.0, 0.3], [60.0, -0.5, 2.0, 0.0]):
        answer = full.solve(point, gradient=True)
        stress = answer.stress()
        compliance = hooke(*point[2:], stress.shape[1], plane_stress=hypothesis == "plane_stress")[
            1
        ]
        expected = areas @ np.einsum("pi,ij,pj->p", stress, compliance, stress) / 2
        found = answer.outputs()
        assert found["energy"] == pytest.approx(expected, rel=1e-9)
        if point[3]:
            slopes = output_slopes(full, point, "energy", step=1e-5)["energy"]
            assert found.gradient["energy"] == pytest.approx(slopes, rel=1e-5)


@needs("volume_loads")
@pytest.mark.parametrize("simplices", [False, True])
def test_a_block_that_is_held_and_heated(simplices):
    """3/2 E (α T)² / (1 - 2ν) between walls on all sides, of which one is a contact.

    Nothing where it is free.

    ν = 0.45 has the mean dilatation on quadrilaterals. With ν = 0, a strain along x alone and a
    modulus that grows from 1 to 2 times E across, it is E (1 + y) s² / 2, on the mean 3/4 E s².
    """
    young, strain = 3.0, 1e-3 * 60.0 * 1.2
    sides = [block.side(axis, upper=upper) for axis in (0, 1) for upper in (False, True)]
    held = [hhr.Displacement(tag, axis) for tag, axis in zip(sides, (0, 0, 1, 1), strict=True)]
    walls = [hhr.Obstacle(sides[1], (1.0, 0.0), offset) for offset in (1.0, FAR)]

    def energy(body, load, **others):
        box = hhr.ParameterSpace(("T",), (0.0,), (100.0,))
        parts = {
            "displacements": (held[0], *held[2:]),
            "contacts": walls[:1],
            "loads": (load,),
            "parameters": box,
        }
        scene = hot(simplices=simplices, bodies=(body,), **parts | others)
        return hhr.FullOrderModel(scene).outputs([60.0])["energy"]

    even, heat = hhr.Body(block.SOLID, young, 0.45), hot().loads[0]
    closed = 1.5 * young * strain**2 / (1 - 2 * 0.45)
    assert energy(even, heat) == pytest.approx(closed, rel=1e-10)
    free = {"displacements": held[::2], "contacts": walls[1:], "hypothesis": "plane_stress"}
    assert abs(energy(even, heat, **free)) < 1e-12 * closed
    graded = hhr.Body(block.SOLID, young, 0.0, grading=lambda x: 1 + x[1])
    along = hhr.Eigenstrain(
        block.SOLID, slope("T", 1e-3), ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    )
    assert energy(graded, along) == pytest.approx(0.75 * young * 0.06**2, rel=1e-10)


def pulled(law, hypothesis="axisymmetric", young="E", poisson=0.3, **others):
    """A cylinder of radius 1 and height 2, pulled along its axis, free at its side; E a
    parameter.
    """
    held = (hhr.Displacement(block.side(axis, upper=False), axis) for axis in (0, 1))
    return block_scene(
        "bar",
        {"pull": (0.0, 0.02), "E": (100.0, 300.0)},
        upper=(1, 2),
        cells=(2, 2),
        hypothesis=hypothesis,
        bodies=(hhr.Body(block.SOLID, young, poisson, law, **others),),
        contacts=(hhr.Obstacle(block.side(0, upper=True), (1, 0), FAR),),
        displacements=(*held, hhr.Displacement(block.side(1, upper=True), 1, slope("pull", 2.0))),
        outputs=ENERGY,
    )


TIGHT = hhr.MarchSettings(
    relative_stress=1e-9, relative_force=1e-9, floor_stress=1e-7, outside="ignore"
)


@needs("inelastic", "moduli")
@pytest.mark.filterwarnings("ignore:no training solution has contact")
def test_a_bar_after_yield(tmp_path):
    """σ² / 2E per volume, whose strain is σ / E + (σ - σ0) / H; σ after unloading too.

    Condensed, from a file.
    """
    strength, hardening, volume = 1.0, 10.0, 2 * np.pi
    full = hhr.FullOrderModel(pulled(hhr.Plasticity(strength, hardening)))

    def path(young):
        return [(float(k), (pull, young)) for k, pull in enumerate((0.0, 0.004, 0.012, 0.01))]

    def closed(young):
        yielded = young * (strength + hardening * 0.012) / (young + hardening)
        stresses = np.array([0.004 * young, yielded, yielded - 0.002 * young])
        stresses[0] = min(stresses[0], young * (strength + hardening * 0.004) / (young + hardening))
        return volume * stresses**2 / (2 * young)

    histories = [full.march(path(young), TIGHT) for young in (150.0, 200.0, 250.0)]
    for young, history in zip((150.0, 200.0, 250.0), histories, strict=True):
        energies = [answer.outputs()["energy"] for answer in history.answers]
        assert energies == pytest.approx(closed(young), rel=1e-6)
    model = hhr.build(full, hhr.SnapshotSet.of_histories(histories), CorrectionSettings())
    hhr.save_model(tmp_path / "model.npz", model)
    kept = hhr.load_model(tmp_path / "model.npz")
    found, again = (
        [a.outputs()["energy"] for a in one.march(path(180.0), TIGHT).answers]
        for one in (model, kept)
    )
    assert found == pytest.approx(closed(180.0), rel=1e-3) and again == pytest.approx(
        found, rel=1e-12
    )


@needs("inelastic")
@pytest.mark.parametrize("hypothesis", ["plane_strain", "plane_stress", "axisymmetric"])
def test_a_law_that_does_not_flow_has_the_energy_of_elastic_bodies(hypothesis):
    """By the stress at Gauss points, beside the work of forces; off by the tolerance of the
    steps.
    """
    elastic, lawful = (
        hhr.FullOrderModel(pulled(law, hypothesis)) for law in (None, hhr.Plasticity(1e6, 1.0))
    )
    point = [0.01, 200.0]
    known = elastic.outputs(point)["energy"]
    assert lawful.march([(0.0, (0.0, 200.0)), (1.0, point)], TIGHT).answers[-1].outputs()[
        "energy"
    ] == pytest.approx(known, rel=1e-8)


@needs("conformance", "friction", "shapes")
def test_friction_of_bodies_whose_shape_varies():
    """Beside K and the displacement on the mesh of the shape.

    Condensed, off by its interpolation over shapes.
    """
    from hhr_dolfinx.plugins.conformance.draft import ChosenSwitch, composed, switches

    known = switches()
    draft = composed(ChosenSwitch(name, known[name]) for name in ("friction", "energy", "shape"))
    path = draft.path()
    full = hhr.FullOrderModel(draft.scene())
    for answer, other in zip(
        full.march(path).answers, hhr.condense(full).march(path).answers, strict=True
    ):
        stiffness = full.problem.reshaped(answer.parameter).stiffness
        field = answer.displacement()
        energy = answer.outputs()["energy"]
        assert energy == pytest.approx(field @ (stiffness @ field) / 2, rel=1e-10)
        assert other.outputs()["energy"] == pytest.approx(energy, rel=1e-5)
        assert np.abs(answer.forces()).max() > 0


GROWN = (hhr.Shape(block.SOLID, ("x * (1 + 0.1 * s * y)", "y * (1 + 0.4 * s)")),)
"""A block of the height 1 + 0.4 s and the width 1 + 0.1 s at its top."""


@needs("volume_loads", "moduli", "shapes")
def test_heated_bodies_whose_shape_varies():
    """The sum of σ : C^-1 σ / 2 over triangles on the mesh of the shape."""
    full = hhr.FullOrderModel(hot(shapes=GROWN))
    point = [60.0, -0.5, 2.0, 0.25]
    corners = full.problem.reshaped(np.array(point)).points[full.problem.cell_nodes]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2
    assert areas.sum() == pytest.approx(0.8 * (1 + 0.95) / 2, rel=1e-12)
    answer = full.solve(point)
    stress = answer.stress()
    compliance = hooke(*point[2:], stress.shape[1])[1]
    expected = areas @ np.einsum("pi,ij,pj->p", stress, compliance, stress) / 2
    assert answer.outputs()["energy"] == pytest.approx(expected, rel=1e-9)


@needs("inelastic", "moduli", "shapes")
def test_bodies_with_laws_whose_shape_varies():
    """Length 2 s of the bar: strain and volume of the closed form change by s."""
    scene = pulled(HARDENS, young=200.0)
    scene = dataclasses.replace(
        scene,
        parameters=hhr.ParameterSpace(("pull", "s"), (0.0, 0.8), (0.02, 1.2)),
        shapes=(hhr.Shape(block.SOLID, ("r", "z * s")),),
    )
    for longer in (0.9, 1.1):
        strains = np.array([0.004, 0.012]) / longer
        stress = np.minimum(200.0 * strains, 200.0 * (1.0 + 10.0 * strains) / 210.0)
        assert along(scene, longer)[:2] == pytest.approx(
            2 * np.pi * longer * stress**2 / 400.0, rel=1e-6
        )


def along(scene, young=200.0):
    """Energies of a bar that yields and is unloaded."""
    path = [(float(k), (pull, young)) for k, pull in enumerate((0.0, 0.004, 0.012, 0.01))]
    return [
        answer.outputs()["energy"]
        for answer in hhr.FullOrderModel(scene).march(path, TIGHT).answers
    ]


HARDENS = hhr.Plasticity(1.0, 10.0)
VARIES = {"young": "E + E**2 / 20000", "poisson": "0.05 + E / 1000"}
"""202 and 0.25 at E = 200."""
IDLE = pytest.mark.filterwarnings("ignore:parameters .* have no effect")


def graded(x):
    """A factor of E from 1 to 3 across."""
    return 1 + x[0]


@IDLE
@needs("inelastic", "moduli")
@pytest.mark.parametrize("hypothesis", ["plane_stress", "axisymmetric"])
def test_the_elasticity_of_bodies_with_laws_is_that_of_the_point(hypothesis):
    """Formulas of E and ν beside their numbers, after yield: the same steps, and so the same up to
    their tolerance.
    """
    numbers = {"young": 202.0, "poisson": 0.25}
    found, expected = (
        along(pulled(HARDENS, hypothesis, **constants, grading=graded))
        for constants in (VARIES, numbers)
    )
    assert found == pytest.approx(expected, rel=1e-7)


@IDLE
@needs("inelastic", "moduli")
@pytest.mark.parametrize("hypothesis", ["plane_strain", "plane_stress", "axisymmetric"])
def test_graded_bodies_with_laws(hypothesis):
    """The same factor everywhere is one of E, after yield.

    Without flow, graded bodies beside the work of forces.

    In axisymmetry strains around are u/r, no polynomials, and both differ as their Gauss points do.
    """
    twice = pulled(HARDENS, hypothesis, 100.0, grading=lambda x: 2.0)
    assert along(twice) == pytest.approx(along(pulled(HARDENS, hypothesis, 200.0)), rel=1e-8)
    point = [0.01, 200.0]
    for law in (hhr.Plasticity(1e6, 1.0), hhr.Norton(1e12, 1.0)):
        elastic, lawful = (
            hhr.FullOrderModel(pulled(own, hypothesis, **VARIES, grading=graded))
            for own in (None, law)
        )
        last = lawful.march([(0.0, (0.0, 200.0)), (1.0, point)], TIGHT).answers[-1]
        assert last.outputs()["energy"] == pytest.approx(
            elastic.outputs(point)["energy"], rel=1e-4 if hypothesis == "axisymmetric" else 1e-7
        )


@IDLE
@needs("inelastic")
def test_a_law_that_changes_the_elasticity_is_refused():
    """σ : C^-1 σ / 2 with C of the body would be off by the ratio of the moduli.

    That of the body passes.
    """
    for modulus in ("E", 190.0):
        for hypothesis in ("axisymmetric", "plane_stress"):
            with pytest.raises(SceneError, match="changes the elasticity of its body"):
                hhr.FullOrderModel(
                    pulled(hhr.ChangingStiffness(HARDENS, modulus), hypothesis, young=200.0)
                )
    scene = pulled(hhr.ChangingStiffness(HARDENS, 200.0), young=200.0)
    assert along(scene) == pytest.approx(along(pulled(HARDENS, young=200.0)), rel=1e-6)


@needs("inelastic", "moduli")
def test_heat_in_plane_stress_changes_no_elasticity():
    """A heated law that is cooled to no strain has the energy of the law itself."""
    heated = hhr.Heated(HARDENS, 1e-3, "E - 200", 0.0)
    scene, plain = (
        pulled(law, "plane_stress", 200.0 if law is heated else "E") for law in (heated, HARDENS)
    )
    assert along(scene) == pytest.approx(along(plain), rel=1e-8)


@needs("sliding")
def test_bodies_that_slide_past_their_mesh():
    """Beside u·K u / 2; full and condensed."""
    pair = hhr.NodeToSurface(side(SECOND, 1, False), side(FIRST, 1, True), friction=0.3)
    scene = pair_scene(
        "sliding",
        {"push": (0.0, 0.05), "shear": (-0.6, 0.6)},
        ((0.0, 0.0), (2.0, 1.0), (8, 4)),
        ((0.5, 1.0), (1.0, 1.5), (3, 3)),
        ((3.0, 0.3), (5.0, 0.2)),
        contacts=(pair,),
        displacements=(
            *hhr.Displacement.clamp(side(FIRST, 1, False), 2),
            hhr.Displacement(side(SECOND, 1, True), 0, slope("shear")),
            hhr.Displacement(side(SECOND, 1, True), 1, slope("push", -1.0)),
        ),
        outputs=ENERGY,
    )
    path = [(0.0, (0.0, 0.0)), (1.0, (0.03, 0.0)), (2.0, (0.03, 0.2)), (3.0, (0.03, 0.4))]
    bare = hhr.FullOrderModel(dataclasses.replace(scene, outputs=())).problem.stiffness
    for condensed in (False, True):
        for answer in hhr.slide(scene, condensed=condensed).march(path).answers:
            field = answer.displacement()
            assert answer.outputs()["energy"] == pytest.approx(field @ (bare @ field) / 2, rel=1e-9)


def test_a_grading_that_is_a_number_scales_stress():
    """A bar that is pulled, with twice the modulus, has twice the stress."""
    outputs = (hhr.VonMises("mises", block.SOLID),)
    bars = [pulled(None, grading=given) for given in (lambda x: 2.0 + 0.0 * x[0], None)]
    fulls = [hhr.FullOrderModel(dataclasses.replace(bar, outputs=outputs)) for bar in bars]
    twice, once = (full.outputs((0.01, 200.0))["mises"] for full in fulls)
    assert twice == pytest.approx(2 * once, rel=1e-12) == pytest.approx(2 * 200.0 * 0.01, rel=1e-10)
