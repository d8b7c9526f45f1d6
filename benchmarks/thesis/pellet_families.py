"""Families of paths of the flowing pellet: loading, a hold, unloading, loading again, at other
paces, in any mixture.

family = families()["combined"]
train, test = family.paths(hhr.Sobol(12)), family.paths(hhr.Sobol(20, seed=2))
"""

from __future__ import (
    annotations,
)  # else the names of types would load families where none is asked for

import hhr_dolfinx as hhr

PRESSURE = 450.0
"""The largest one, in MPa."""
SPACE = hhr.ParameterSpace(("P1", "h1", "gap"), (0.0, 0.5, 4e-3), (PRESSURE, 1.5, 16e-3))
"""Parameters of the flowing pellet: pressure in MPa, its height and the initial gap in mm."""
OWN = {
    "gap": (5.0, 15.0),
    "height": (0.5, 1.5),
    "hold": (0.0, 10.0),
    "back": (0.0, 1.0),
    "again": (0.0, 1.0),
    "log_pace": (-1.0, 1.0),
}
"""Smallest and largest of what families vary.

Initial gap in um; height of the pressure in mm; seconds at the largest pressure; the share of the
pressure that is taken off, and the share of that which is put on again; the pace in decades, 0 for
the largest pressure in a second.
"""
LOADED, UNLOADED = PRESSURE, f"{PRESSURE} * (1 - back)"
LOADED_AGAIN = f"{PRESSURE} * (1 - back * (1 - again))"


def families(steps: int = 40) -> dict[str, hhr.PathFamily]:
    """Families by name: ``loading``, ``held``, ``reloaded``, ``paced``, and ``combined``, which
    holds all of them.

    Args:
        steps: in which the largest pressure is put on; unloading and loading again take steps of
            the same pressure, a hold takes a quarter as many.
    """
    hold = hhr.Leg({}, "hold", max(steps // 4, 1))
    up, paced_up = (hhr.Leg({"P1": LOADED}, seconds, steps) for seconds in (1.0, "10**-log_pace"))
    back, again = _unloading_and_loading("1", steps)
    paced_back, paced_again = _unloading_and_loading("10**-log_pace", steps)
    legs = {
        "loading": (up,),
        "held": (up, hold),
        "reloaded": (up, back, again),
        "paced": (paced_up,),
        "combined": (paced_up, hold, paced_back, paced_again),
    }
    own = {
        "loading": ("gap", "height"),
        "held": ("gap", "height", "hold"),
        "reloaded": ("gap", "height", "back", "again"),
        "paced": ("gap", "height", "log_pace"),
        "combined": tuple(OWN),
    }
    start = {"P1": 0.0, "h1": "height", "gap": "gap * 1e-3"}
    return {name: hhr.PathFamily(name, SPACE, _box(own[name]), start, legs[name]) for name in legs}


def _unloading_and_loading(seconds: str, steps: int) -> tuple[hhr.Leg, hhr.Leg]:
    """Both legs at a pace: the largest pressure would take ``seconds``, a formula, and as many
    steps.
    """
    back = hhr.Leg({"P1": UNLOADED}, f"back * {seconds}", f"{steps} * back")
    again = hhr.Leg({"P1": LOADED_AGAIN}, f"back * again * {seconds}", f"{steps} * back * again")
    return back, again


def _box(names: tuple[str, ...]) -> hhr.ParameterSpace:
    """The box of some own parameters."""
    lower, upper = zip(*(OWN[name] for name in names), strict=True)
    return hhr.ParameterSpace(names, lower, upper)
