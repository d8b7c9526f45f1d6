"""Scenes of pages, each with the plug-ins that it needs; tours of those that rub; formulas."""

import dataclasses
from functools import cache, partial

import contract
import held_by_contact
import numpy as np
import pellet_cladding
import press_fit
import pytest
import sphere_on_block
import split_interface
from mpi4py import MPI
from needs import needs, present
from scenes import block_scene
from sheared_blocks import driven, leaning, lifted, round_block, rubbing

import hhr_dolfinx as hhr
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.geometries import block
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side


def made(scene, **how):
    """The full model of a scene, its condensed model, and a page."""
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    model = hhr.condense(full, **how)
    return full, model, hhr.scenery_of(full)


@cache
def known(name):
    """The same of one of the scenes below, with displacements."""
    return made((SCENES | MORE)[name](), fields=True)


def held():
    """A ring in its groove under a lid, and what is read of both."""
    pressed = hhr.LargestPressure("peak", 0), hhr.ContactForce("push", 1, (0.0, 1.0))
    moved = (
        hhr.DisplacementAt("sinks", (20.0, 5.5), 1, "lid"),
        hhr.DisplacementAt("widens", (22.0, 2.0), 0, "ring"),
    )
    return dataclasses.replace(held_by_contact.o_ring(0.15), outputs=(*pressed, *moved))


def halves():
    """Two contacts share a node in the middle, off the middle of the pressure."""
    pairs = [
        hhr.NodeToNode(*tags, (0, -1))
        for tags in zip(split_interface.UPPER, split_interface.LOWER, strict=True)
    ]
    bodies = (
        hhr.Body(split_interface.FIRST, young=1e3, poisson=0.1),
        hhr.Body(split_interface.SECOND, young=1e3, poisson=0.4),
    )
    scene = split_interface.scene(
        pairs, bodies=bodies, parameters=hhr.ParameterSpace(("press",), (1.0,), (20.0,))
    )
    return dataclasses.replace(scene, outputs=(*scene.outputs, *ENERGY))


def bedded():
    """The same on a bed, whose energy is left out."""
    bed = hhr.Springs(side(split_interface.FIRST, 1, upper=False), 1, 300.0, bedding=True)
    scene = halves()
    return dataclasses.replace(
        scene, displacements=scene.displacements[:1] + scene.displacements[2:], loads=(bed,)
    )


def indented():
    """A block under a round tool that moves aside and down, and grows.

    Normals of the nodes at its ends miss it.
    """
    top = block.side(1, upper=True)
    sides = (block.side(0, upper=False), block.side(0, upper=True))
    return block_scene(
        "indented",
        {"down": (0.0, 0.05), "aside": (-0.06, 0.06), "grown": (0.0, 0.2)},
        lower=(-2.0, 0.0),
        upper=(2.0, 1.0),
        cells=(16, 4),
        contacts=(
            hhr.Circle(
                top, center=("aside", "1.79 + 0.5 * grown - down"), radius="0.8 + 0.5 * grown"
            ),
        ),
        displacements=(
            *(hhr.Displacement(side, 0) for side in sides),
            *hhr.Displacement.clamp(block.side(1, upper=False), 2),
        ),
        outputs=(hhr.LargestPressure("peak", 0), hhr.ContactForce("push", 0, (0.0, 1.0))),
    )


def stressed(hypothesis):
    """Two blocks that are heated as the load grows, whose stress is read in all ways."""
    middle = (1.4, 0.6)
    components = {
        "axisymmetric": ("rr", "tt", "rz"),
        "plane_stress": ("xx", "xy"),
        "plane_strain": ("yy", "zz"),
    }[hypothesis]
    read = (*components, "principal_1", "principal_2", "principal_3")
    outputs = (
        hhr.VonMises("largest", FIRST),
        hhr.VonMises("mean", FIRST, kind="mean"),
        hhr.VonMises("of the cold one", SECOND),
        *(hhr.StressAt(name, middle, name, tag=FIRST) for name in read),
    )
    return dataclasses.replace(heated(hypothesis, 0.05, load=10.0), outputs=outputs)


def stressed_cubes():
    """Blocks in space under pressure and shear: all components of a tensor are there."""
    read = ("xz", "yz", "principal_1", "principal_2", "principal_3")
    outputs = [hhr.StressAt(name, (0.3, 0.6, 1.7), name, tag=SECOND) for name in read]
    smooth = rubbing(None, 4, dimension=3, box={"push": (0.01, 0.05), "aside": (-0.1, 0.1)})
    return dataclasses.replace(smooth, outputs=(hhr.VonMises("most", SECOND), *outputs))


ENERGY = (hhr.ElasticEnergy("energy"),) if present("stress") else ()
OF_PELLET = (
    hhr.LargestPressure("peak", 0),
    hhr.ContactForce("push", 0, (1.0, 0.0)),
    hhr.ContactWidth("width", 0),
    hhr.DisplacementAt("bulge", (4.1, 0.0), 0, 1),
    hhr.VonMises("stress", 1),
)
SCENES = {
    "partial pressure": lambda: dataclasses.replace(
        pellet_cladding.scene(**pellet_cladding.QUICK_MESH), outputs=OF_PELLET
    ),
    "moduli": lambda: contract.blocks(("E1", "nu"), box=contract.MODULI | {"nu": (0.1, 0.4)}),
    "formula": lambda: contract.blocks(
        ("E1 * (1 + exp(-2 * E1) / 3) ** 2 - min(0.1, -E1)", 0.3), box=contract.MODULI
    ),
    "shape": lambda: contract.blocks(box=contract.SHAPE, shapes=(contract.crowned(),)),
    "space": lambda: press_fit.scene(around=4, hub_cells=(2, 4), shaft_cells=(2, 4)),
}
STRESSED = ("axisymmetric", "plane_stress", "plane_strain")
MORE = {
    "held by contact": held,
    "moving tool": indented,
    "halves": halves,
    "bed": bedded,
    "sphere": lambda: sphere_on_block.scene(sphere_cells=(6, 3), block_cells=(5, 3)),
    "plane stress": lambda: dataclasses.replace(SCENES["moduli"](), hypothesis="plane_stress"),
    "heat": lambda: heated("axisymmetric", 0.05, load=10.0),
    **{f"stress, {name}": partial(stressed, name) for name in STRESSED},
    "stress in space": stressed_cubes,
}
STRESSES = tuple(name for name in MORE if name.startswith("stress"))
OF_MODULI = ("moduli", "formula", "space", "plane stress", "shape")


def marked(*names):
    """Cases of tests, of which some need a plug-in."""
    marks = {name: [needs("moduli")] for name in OF_MODULI}
    marks["space"].append(needs("mortar", "shapes", "volume_loads"))
    marks["shape"].append(needs("shapes"))
    marks["moving tool"] = [needs("obstacles")]
    marks["bed"] = [needs("nodal_loads", "shared_nodes", "elasticity")]
    marks |= {
        "sphere": [needs("mortar")],
        "heat": [needs("volume_loads", "elasticity")],
        **{name: [needs("elasticity", "volume_loads")] for name in STRESSES},
        "held by contact": [needs("nonmatching")],
    }
    return [pytest.param(name, marks=marks.get(name, ())) for name in names]


def heated(hypothesis, expansion=1e-3, **slopes):
    warm = hhr.ThermalExpansion(
        FIRST, expansion, hhr.Amplitude(constant=0.0 if slopes else 2.0, slopes=slopes)
    )
    return dataclasses.replace(
        contract.blocks(), hypothesis=hypothesis, loads=(*contract.blocks().loads, warm)
    )


FORMULAS = [
    Scalar(text, ("a", "b"))
    for text in (
        "a + b - a * b / 3",
        "-a ** 2 + (-b) ** 2",
        "sqrt(a) + exp(-b) + log(a) + pi",
        "a ** b",
        "sin(a) * cos(b) - tan(a) + tanh(b)",
        "min(a, b) + 2 * max(a, 0.3) - abs(b - a)",
        "min(1, sqrt(a - 1))",
        "table(a, 0, 1, 0.5, 3, 2, -1) + table(b, 0, -1, 2, 5)",
    )
]


def values_of_formulas():
    """Points, and what Python says there of each."""
    points = np.random.default_rng(0).uniform(0.1, 1.9, (20, 2))
    with np.errstate(invalid="ignore"):
        return points, np.array([[scalar.value(point) for scalar in FORMULAS] for point in points])


def in_space(friction, cells=4):
    """The same blocks in space, of which the upper one moves along both tangents and touches with a
    round side.
    """

    def bulge(x, y, z):
        return 0.2 * ((x - 0.5) ** 2 + (y - 0.5) ** 2) * (2 - z)

    blocks = partial(lifted, lift=bulge, cells=(cells,) * 3)
    return rubbing(friction, dimension=3, geometry=blocks, box={"aside": (-0.1, 0.1)})


RUBBING = {
    "in space": lambda: in_space(0.3),
    "in space with a limit": lambda: in_space(hhr.Coulomb(0.5, limit=0.05)),
    "in space, Tresca": lambda: in_space(hhr.Tresca(0.02)),
    "Coulomb": lambda: rubbing(geometry=round_block, pairing=None),
    "formula and limit": lambda: rubbing(
        hhr.Coulomb("f * (1 + f)", limit=0.02), geometry=round_block, box={"f": (0.0, 0.8)}
    ),
    "Tresca": lambda: rubbing(hhr.Tresca(0.01), geometry=round_block),
    "both sides imposed": lambda: driven(geometry=leaning),
    "moduli": lambda: rubbing(
        geometry=round_block,
        bodies=(hhr.Body(FIRST, "E1", 0.3), hhr.Body(SECOND, "2 * E2", "nu")),
        box={"E1": (2.0, 6.0), "E2": (2.0, 4.0), "nu": (0.2, 0.3)},
    ),
    "slave nodes": lambda: rubbing(
        pairing=hhr.NodeToSurface(
            side(SECOND, 1, False), side(FIRST, 1, True), (0.0, -1.0), friction=0.4
        ),
        geometry=round_block,
    ),
}
PUSHED = 0.0, 0.03, 0.03, 0.04, 0.02, 0.002, 0.05, 0.05, 0.01
SHEARED = 0.0, 0.0, 0.02, 0.06, 0.0, -0.06, -0.02, 0.1, 0.1
TOUR = list(zip(PUSHED, SHEARED, strict=True))
"""Pressed, sheared, turned round, let go, and pressed again."""


def rubbed(name):
    """One of these scenes, with outputs of forces, and energy where K is constant."""
    scene = RUBBING[name]()
    along = (1.0, 0.0, 0.0)[: 3 if scene.hypothesis == "solid" else 2]
    outputs = (hhr.LargestPressure("peak", 0), hhr.ContactForce("pull", 0, along))
    energy = (hhr.ElasticEnergy("energy"),) if name != "moduli" and present("stress") else ()
    return dataclasses.replace(scene, outputs=outputs + energy)


def tour_of(model):
    """The tour; in space to and fro aside too, elsewhere in the middle of what laws and moduli ask
    for.
    """
    if model.dimension == 3:
        return [np.array([*point, 0.05 * np.sin(k)]) for k, point in enumerate(TOUR)]
    return [np.array([*point, *model.parameters.middle[2:]]) for point in TOUR]


NEEDED_BY = {"moduli": ("moduli",), "slave nodes": ("nonmatching",)}
OF_FRICTION = [pytest.param(name, marks=needs(*NEEDED_BY.get(name, ()))) for name in RUBBING]
