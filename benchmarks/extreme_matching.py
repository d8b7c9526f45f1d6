"""Extreme cases of matching meshes, for ``extreme_cases.py``: stiffness, contact, units, recipes,
training.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np
import pellet_cladding as demo
from verify import Case

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import pellet_cladding as geometry
from hhr_dolfinx.reduction.projection import load_nodes

MESH, SIZES = demo.QUICK_MESH, {"radius": 4.1, "height": 7.0, "thickness": 0.57, "gap": 2e-3}
BOXES = {
    "grazing contact": ((4.0, 5.0), (6.0, 6.0)),
    "contact lost everywhere": ((0.5, 0.6), (1.0, 6.0)),
    "contact lost in half of the box": ((1.0, 0.6), (20.0, 6.0)),
}


def matching_cases() -> Iterator[Case]:
    """One change each."""
    base = demo.scene(**MESH)
    yield Case("nothing changed", base)
    for exponent in (-6, -3, 3, 6):
        pellet, cladding = base.bodies
        bodies = (dataclasses.replace(pellet, young=pellet.young * 10.0**exponent), cladding)
        yield Case(f"pellet 1e{exponent} times as stiff", dataclasses.replace(base, bodies=bodies))
    for poisson in (0.4999, 0.4999999999, -0.9):
        bodies = tuple(dataclasses.replace(body, poisson=poisson) for body in base.bodies)
        yield Case(f"nu = {poisson}", dataclasses.replace(base, bodies=bodies))
    for gap in (0.0, 1e-12, -1e-3):
        yield Case(
            f"gap {gap:g} mm" + (", overlap" if gap < 0 else ""), demo.scene(**MESH, gap=gap)
        )
    for name, box in BOXES.items():
        yield Case(
            name, dataclasses.replace(base, parameters=hhr.ParameterSpace(("P1", "h1"), *box))
        )
    loose = tuple(item for item in base.displacements if item.tag != geometry.PELLET_TOP)
    yield Case("pellet held by contact only", dataclasses.replace(base, displacements=loose))
    for aspect in (1000, 10000):
        tall = demo.scene(**MESH, height=7 * aspect * 20 / 12 / 1.7, thickness=0.57)
        yield Case(f"cells of aspect {aspect}", tall)
    for name, length in (("nm", 1e6), ("m", 1e-3), ("km", 1e-6)):
        yield Case(f"lengths in {name}", in_units(length))
    yield Case("POD tolerance 1e-14", base, hhr.Recipe(hhr.Pod(1e-14, relative=True)))
    yield Case("POD tolerance 1e-14, thesis recipe", base, hhr.Recipe.thesis(1e-14))
    one_contact = lambda problem: [*load_nodes(problem), problem.contact_slaves[10]]  # noqa: E731
    yield Case(
        "RID of one contact",
        base,
        hhr.Recipe.thesis(0.03, nodes=(hhr.Deim(), hhr.Zone(one_contact))),
    )
    yield Case(
        "duplicated snapshots",
        base,
        select=lambda s: s.take(np.repeat(np.arange(len(s.points)), 2)),
    )
    yield Case("collinear snapshots", base, select=collinear)
    yield Case("two snapshots", base, select=lambda s: s.take([0, -1]))


def in_units(length: float) -> hhr.Scene:
    """The scene with all lengths times ``length``, and E and P1 in N per new unit of area."""
    area, scene = (
        length**-2,
        demo.scene(**MESH, **{name: value * length for name, value in SIZES.items()}),
    )
    bodies = tuple(dataclasses.replace(body, young=body.young * area) for body in scene.bodies)
    box = hhr.ParameterSpace(("P1", "h1"), (5.0 * area, 0.6 * length), (200.0 * area, 6.0 * length))
    return dataclasses.replace(scene, bodies=bodies, parameters=box)


def collinear(snapshots: hhr.SnapshotSet) -> hhr.SnapshotSet:
    """Snapshots joined by twice themselves."""
    both, factor = (
        snapshots.take(np.tile(np.arange(len(snapshots.points)), 2)),
        np.repeat([1, 2], len(snapshots.points)),
    )
    return dataclasses.replace(
        both, displacements=both.displacements * factor, forces=both.forces * factor
    )
