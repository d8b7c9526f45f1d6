"""Extreme cases of bodies that flow, for ``extreme_cases.py``: the small pellet of
``pellet_cladding_plastic.py``.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pellet_cladding_plastic as demo
from pellet_cladding import QUICK_MESH
from verify import HistoryCase

import hhr_dolfinx as hhr
from hhr_dolfinx.models.answer import Path

Family = Callable[[float], Path]
"""Times and parameters for a gap in um."""
VALUES, RECIPE = (5.0, 10.0, 15.0), demo.recipe()


def with_laws(pellet: hhr.Law | None = None, cladding: hhr.Law | None = None) -> hhr.Scene:
    """The scene with other laws."""
    base = demo.scene(**QUICK_MESH, cladding_axial_cells=15)
    laws = (pellet or base.bodies[0].law, cladding or base.bodies[1].law)
    bodies = tuple(
        dataclasses.replace(body, law=law) for body, law in zip(base.bodies, laws, strict=True)
    )
    return dataclasses.replace(base, bodies=bodies)


def paced(seconds: float) -> Family:
    """The path at another pace."""
    return lambda gap: [(seconds * time, parameter) for time, parameter in demo.path(gap, 20)]


def shares(
    parts: Sequence[float], top: float = demo.PRESSURE, times: Sequence[float] | None = None
) -> Family:
    """A path of pressures as parts of the largest one, within a second where no times are given."""
    times = np.arange(len(parts)) / (len(parts) - 1) if times is None else times
    return lambda gap: [
        (t, np.array([top * part, demo.HEIGHT, gap * 1e-3]))
        for t, part in zip(times, parts, strict=True)
    ]


def in_gigapascals() -> hhr.Scene:
    """The scene with all stresses in GPa."""
    base, unit = with_laws(hhr.Plasticity(0.08, 1.0), hhr.Norton(1.0, 4.0)), 1e-3
    bodies = tuple(dataclasses.replace(body, young=body.young * unit) for body in base.bodies)
    space = base.parameters
    upper = (space.upper[0] * unit, *space.upper[1:])
    return dataclasses.replace(
        base, bodies=bodies, parameters=hhr.ParameterSpace(space.names, space.lower, upper)
    )


def untrained() -> Iterator[tuple[str, Family]]:
    """Paths outside the family that is trained: one second up, at one height."""
    up = np.linspace(0, 1, 21)
    yield "held for 10 s", shares([*up, *np.ones(10)], times=[*up, *(1 + np.arange(1, 11))])
    yield "unloaded to 0", shares([*up, *up[-2::-1]], times=[*up, *(1 + up[1:])])
    yield "100 times slower", paced(100.0)
    yield "pressed up to 1.4 mm", lambda gap: demo.history(up, up, gap, height=1.4)


def flow_cases() -> Iterator[HistoryCase]:
    """Exponents, resistances, paces, coarse steps, perfect plasticity, softening, unloading, no
    flow at all.
    """
    case = functools.partial(HistoryCase, values=VALUES, recipe=RECIPE)
    plain = paced(1.0)
    yield case("flow, nothing changed", with_laws, plain)
    yield case("Norton exponent 20", lambda: with_laws(cladding=hhr.Norton(1e3, 20.0)), plain)
    for exponent in (-3, 3):
        # six decades of K: below, the cladding is a fluid
        other = functools.partial(with_laws, cladding=hhr.Norton(1e3 * 10.0**exponent, 4.0))
        yield case(f"Norton K times 1e{exponent}", other, plain)
    for pace in (100.0, 0.01):
        yield case(f"time steps times {pace:g}", with_laws, paced(pace))
    yield case("4 steps instead of 20", with_laws, lambda gap: demo.path(gap, 4))
    yield case("H = 0", lambda: with_laws(pellet=hhr.Plasticity(80.0, 0.0)), plain)
    yield case("H < 0", lambda: with_laws(pellet=hhr.Plasticity(80.0, -1.0)), plain)
    weak = shares(np.linspace(0, 1, 11), 200.0)
    yield case("hardly a point yields", lambda: with_laws(cladding=hhr.Norton(1e9, 4.0)), weak)
    up_and_down = shares(
        [*np.linspace(0, 0.8, 13), *np.linspace(0.7, 0.1, 7), *np.linspace(0.2, 1.0, 9)]
    )
    yield case("unloading and reloading", with_laws, up_and_down)
    stiff = hhr.Plasticity(1e9)
    yield case("nothing flows", lambda: with_laws(stiff, stiff), plain)
    yield case("stresses in GPa", in_gigapascals, shares(np.linspace(0, 1, 21), 0.45))
    for name, tried in untrained():
        yield case(f"not trained: {name}", with_laws, plain, tried=tried)
