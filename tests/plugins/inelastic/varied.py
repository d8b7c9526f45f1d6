"""The small flowing pellet with all that may be a parameter: heat, moduli, constants of laws.

Its models, made once.
"""

import dataclasses
from functools import cache

import flowing
import numpy as np
import pellet_cladding_plastic as demo
from condensing import TIGHT, condensed

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import pellet_cladding

SPACE = hhr.ParameterSpace(
    ("P1", "h1", "gap", "T", "E", "w", "H", "K"),
    (0.0, 0.5, 4e-3, 0.0, 150e3, 0.8, 500.0, 800.0),
    (460.0, 1.5, 16e-3, 1000.0, 230e3, 1.2, 2000.0, 1200.0),
)
MODULI = "E", "78e3 * w"
LAWS = hhr.Plasticity("90 - 0.02 * T", "H"), hhr.Norton("K", 4.0)
CORNERS = (
    (5.0, 160e3, 100.0, 0.85, 500.0, 900.0), (15.0, 220e3, 900.0, 1.15, 2000.0, 1100.0),
    (7.0, 220e3, 500.0, 0.85, 600.0, 1200.0), (13.0, 160e3, 800.0, 1.15, 1800.0, 800.0),
    (9.0, 180e3, 900.0, 1.15, 700.0, 1000.0), (11.0, 200e3, 200.0, 0.85, 1500.0, 850.0),
)  # fmt: skip
"""Trained histories, see :func:`path`."""
BETWEEN = (8.0, 190e3, 400.0, 1.0, 1000.0, 1000.0), (12.0, 170e3, 700.0, 1.05, 1300.0, 950.0)


def heat(slope=0.02):
    """The pellet expands, less at its outside."""
    field = lambda x: 1 - slope * x[0] ** 2  # noqa: E731
    return hhr.ThermalExpansion(pellet_cladding.PELLET, 1.2e-5, "T", field=field)


def scene(young=MODULI, laws=LAWS, loads=(), **others):
    base = demo.scene(**flowing.SMALL_MESH)
    given = zip(base.bodies, young, laws, strict=True)
    bodies = tuple(dataclasses.replace(body, young=own, law=law) for body, own, law in given)
    force = hhr.ContactForce("force", 0, direction=(1.0, 0.0))
    given = {
        "bodies": bodies,
        "parameters": SPACE,
        "outputs": (force,),
        "loads": (*base.loads, *(loads or [heat()])),
    }
    return dataclasses.replace(base, **(given | others))


def path(
    gap=10.0, young=200e3, heat=500.0, w=1.1, hardening=1e3, resistance=1e3, steps=flowing.STEPS
):
    """Pressed and heated at once; the gap in um."""
    rest = young, w, hardening, resistance
    return [(time, np.append(point, (heat * time, *rest))) for time, point in demo.path(gap, steps)]


@cache
def full():
    return hhr.FullOrderModel(scene())


@cache
def corners():
    return [full().march(path(*corner), TIGHT) for corner in CORNERS]


@cache
def reduced():
    return hhr.build(
        full(), hhr.SnapshotSet.of_histories(corners()), hhr.Recipe.flowing().as_it_is()
    )


@cache
def condensed_flow():
    return condensed(full(), corners())


MODELS = {"full": full, "reduced": reduced, "condensed": condensed_flow}
