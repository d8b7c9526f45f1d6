"""Press fits by every pairing: a hub is pushed off a shaft, elastic or rigid, and slips everywhere.

Left out are Circle and Sphere, along which no hub slides: a ball bears on one line.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from deck_entries import Case, disc
from deck_writer import Writer, at

import hhr_dolfinx as hhr

FRICTION = 0.1
DEGREES = 0.5
"""Between the axis and the side of a conical shaft."""
STEEL = 210e3, 0.3


def _tiles(around: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """A cylinder of radius 1 as quadrilaterals, (points, facets), longer than the hub."""
    turn = np.linspace(0, 2 * np.pi, around, endpoint=False)
    rings = [np.column_stack([np.cos(turn), np.sin(turn), np.full(around, z)]) for z in (0.0, 2.0)]
    first = np.arange(around)
    other = np.roll(first, -1)
    return np.concatenate(rings), np.column_stack([first, other, other + around, first + around])


def _cone(**friction: float) -> Any:
    height = 1 / np.tan(np.radians(DEGREES))
    return hhr.Cone("BORE", tip=(0, 0, 1 + height), axis=(0, 0, -1), angle=DEGREES, **friction)


ELASTIC: Mapping[str, tuple[Any, int]] = {
    "node to node": (partial(hhr.NodeToNode, normal=(-1.0, 0.0)), 8),
    "node to surface": (hhr.NodeToSurface, 10),
    "double pass": (hhr.DoublePass, 10),
    "mortar": (hhr.Mortar, 10),
    "mortar, standard": (partial(hhr.Mortar, multipliers="standard"), 10),
}
"""Pairings of two bodies, and cells along the hub, whose nodes meet those of the shaft if there are
8.
"""
RIGID: Mapping[str, tuple[str, Callable[..., Any]]] = {
    "plane": ("axisymmetric", partial(hhr.Obstacle, "BORE", (-1.0, 0.0), -1.0)),
    "profile": ("axisymmetric", partial(hhr.Profile, "BORE", "1 + 0 * z", (0.0, 2.0))),
    "cylinder": ("solid", partial(hhr.Cylinder, "BORE", (0, 0, 0), (0, 0, 1), 1.0)),
    "cone": ("solid", _cone),
    "triangles": ("solid", partial(hhr.RigidMesh, "BORE", _tiles())),
}
"""Rigid shafts, in axisymmetry or in space."""


def pushed_off(
    path: Path, deck: Writer, hypothesis: str, pairing: Any, held: tuple[Any, ...], bodies: Any
) -> float:
    """Friction along the axis over mu times the sum of normal forces.

    An interference of .001, a push of .02.
    """
    path.write_text(deck.text)
    axis = 1 if hypothesis == "axisymmetric" else 2
    scene = hhr.Scene(
        "push_off",
        hhr.MeshFile(path),
        hypothesis,
        tuple(hhr.Body(name, *STEEL) for name in bodies),
        (pairing,),
        hhr.ParameterSpace(("fit", "push"), (0.0, 0.0), (0.002, 0.02)),
        displacements=(*held, hhr.Displacement("HEAD", axis, "push")),
        openings=(hhr.Opening(0, hhr.Amplitude(slopes={"fit": -1.0})),),
        outputs=(
            hhr.FrictionForce("friction", 0, direction=(0.0,) * axis + (1.0,)),
            hhr.ContactForce("radial", 0, direction=(1.0,) + (0.0,) * axis),
        ),
    )
    full = hhr.FullOrderModel(scene)
    answer = full.solve({"fit": 0.001, "push": 0.02})
    found = answer.outputs()
    # in space, components along x are not the sum of what is borne around the bore
    normal = found["radial"] if axis == 1 else answer.forces()[full.problem.pressing].sum()
    return -found["friction"] / (FRICTION * normal)


def elastic(name: str, folder: Path) -> float:
    """A hub on an elastic shaft, in axisymmetry."""
    pairing, along = ELASTIC[name]
    deck = Writer()
    shaft = deck.box("SHAFT", "CAX4", (4, 16), (0.5, 0), (1, 2))
    hub = deck.box("HUB", "CAX4", (4, along), (1, 0.5), (1.5, 1.5))
    deck.surface(
        "OUTSIDE",
        shaft.faces(
            lambda points: at(0, 1)(points) & (points[:, 1] > 0.49) & (points[:, 1] < 1.51)
        ),
    )
    deck.surface("BORE", hub.faces(at(0, 1)))
    deck.nset("FOOT", shaft.nodes(at(1, 0)))
    deck.nset("HEAD", hub.nodes(at(1, 1.5)))
    path = folder / f"push_off_{name.replace(' ', '_')}.inp"
    contact = pairing("BORE", "OUTSIDE", friction=FRICTION)
    return pushed_off(
        path, deck, "axisymmetric", contact, (hhr.Displacement("FOOT", 1),), ("SHAFT", "HUB")
    )


def rigid(name: str, folder: Path) -> float:
    """A hub on a rigid shaft; in space a quarter of it."""
    hypothesis, pairing = RIGID[name]
    deck = Writer()
    held: tuple[Any, ...] = ()
    if hypothesis == "solid":
        hub = deck.box("HUB", "C3D8", (3, 6, 5), (1, 0, 0.5), (1.5, 90, 1.5), disc()[0])
        deck.surface("Y0", hub.faces(at(1, 0)))
        deck.surface("X0", hub.faces(at(1, 90)))
        deck.nset("HEAD", hub.nodes(at(2, 1.5)))
        held = hhr.Displacement("Y0", 1), hhr.Displacement("X0", 0)
    else:
        hub = deck.box("HUB", "CAX4", (4, 10), (1, 0.5), (1.5, 1.5))
        deck.nset("HEAD", hub.nodes(at(1, 1.5)))
    deck.surface("BORE", hub.faces(at(0, 1)))
    ratio = pushed_off(
        folder / f"push_off_{name}.inp",
        deck,
        hypothesis,
        pairing(friction=FRICTION),
        held,
        ("HUB",),
    )
    return ratio / np.cos(np.radians(DEGREES)) if name == "cone" else ratio


def _case(
    name: str, kind: str, run: Callable[[str, Path], float], reference: float | str = 1.0
) -> Case:
    quantity = "friction along the side over mu N" if name == "cone" else "push-off force over mu N"
    return Case(f"press fit, {name}", kind, partial(run, name), quantity, reference, within=0.005)


CASES = (
    *(
        _case(
            name,
            "CAX4, friction",
            elastic,
            "which needs dual multipliers" if "standard" in name else 1.0,
        )
        for name in ELASTIC
    ),
    *(
        _case(name, "CAX4" if kind == "axisymmetric" else "C3D8", rigid)
        for name, (kind, _) in RIGID.items()
    ),
)
