"""Small models of condensed flow: a tube in a wall, a pellet in its cladding, made once, and how
histories compare.
"""

from functools import cache

import flowing
import numpy as np
import pellet_cladding_plastic as demo
import scenes
from tubes import YOUNG, tube

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block
from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

TIGHT = hhr.MarchSettings(
    relative_stress=1e-8, relative_force=1e-8, floor_stress=1e-6, iterations=300, outside="ignore"
)
QUIET = hhr.MarchSettings(outside="ignore")
FINE = hhr.MarchSettings(outside="ignore", relative_force=1e-11)
WHOLE = {"modes": 1e-9, "cubature": 1e-9, "attempts": 1}
"""Settings that leave nothing out."""


def condensed(full, histories, **settings):
    return hhr.build(full, hhr.SnapshotSet.of_histories(histories), CorrectionSettings(**settings))


EVERY = "displacement", "forces", "stress"


def apart(one, other, names=("displacement", "forces")):
    """Largest distances of what answers hand out, each over the largest of the history."""
    pairs = list(zip(one.answers, other.answers, strict=True))
    found = []
    for name in names:
        fields = [(getattr(a, name)(), getattr(b, name)()) for a, b in pairs]
        size = max(np.linalg.norm(b) for _, b in fields)
        found.append(max(np.linalg.norm(a - b) for a, b in fields) / size if size else 0.0)
    return found


def walled_tube(law, wall=2.003, cells=6, **space):
    """The thick tube with its pressure in a wall that it reaches."""
    bodies = (hhr.Body(block.SOLID, YOUNG, 0.3, law),)
    contacts = (hhr.Obstacle(block.side(0, upper=True), (1, 0), wall),)
    given = {
        "parameters": scenes.space(**{"p": (0.0, 1.0)} | space),
        "bodies": bodies,
        "contacts": contacts,
    }
    return tube(law, 1.0, cells, **given)


def up(pressure, steps=8, dt=0.1, constants=()):
    return [(dt * k, np.array([pressure * k / steps, *constants])) for k in range(steps + 1)]


def cycle(pressure, dt=0.1):
    """Loaded, unloaded and loaded again."""
    shares = np.concatenate(
        [np.linspace(0, 1, 9), np.linspace(0.75, 0, 4), np.linspace(0.25, 1, 4)]
    )
    return [(dt * k, np.array([pressure * share])) for k, share in enumerate(shares)]


@cache
def tubes():
    """Plasticity with hardening against a wall: full model, training and condensed model."""
    full = hhr.FullOrderModel(walled_tube(hhr.Plasticity(1.0, 5.0)))
    histories = [full.march(up(0.9), TIGHT), full.march(cycle(0.8), TIGHT)]
    return full, histories, condensed(full, histories)


def pressures(shares, seconds, gap, height=0.9):
    """A path of the pellet: shares of its largest pressure, seconds of each step."""
    return demo.history(np.cumsum([0.0, *seconds]), shares, gap, height)


def loaded(gap, top=1.0, seconds=1.0, steps=flowing.STEPS, height=0.9):
    return pressures(np.arange(steps + 1) / steps * top, [seconds / steps] * steps, gap, height)


INSIDE = (
    (5.0, 0.6, 0.7),
    (15.0, 1.0, 0.7),
    (5.0, 1.0, 1.3),
    (15.0, 0.6, 1.3),
    (10.0, 0.8, 1.0),
    (8.0, 0.95, 1.1),
)
"""Gaps, largest loads and seconds of the training."""


@cache
def pellet():
    """Plasticity against creep: full model, training and condensed model, with two histories held
    out.
    """
    full = flowing.flowing_full()
    histories = [full.march(loaded(*item), TIGHT) for item in INSIDE]
    held = [full.march(loaded(7.0 + 4 * k, 0.9 - 0.1 * k, 0.9 + 0.2 * k), TIGHT) for k in range(3)]
    sets = [hhr.SnapshotSet.of_histories(item) for item in (histories, held)]
    return full, histories, hhr.build(full, sets[0], CorrectionSettings(), sets[1])
