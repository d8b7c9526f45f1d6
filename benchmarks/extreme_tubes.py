"""Tubes that flow, whose limit load and creep are known, for ``extreme_cases.py``."""

from collections.abc import Iterator
from functools import partial

import numpy as np
from verify import HistoryCase, Known

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block
from hhr_dolfinx.models.answer import History, Path

LIMIT = 2 / np.sqrt(3) * np.log(2)
"""Limit load of a tube 1 <= r <= 2 that yields at 1 without hardening, in plane strain."""
SHARES = (0.0, 0.4, 0.7, 0.9, 0.95, 0.98, 0.99, 1.01)
RESISTANCE, EXPONENT = 2.0, 4.0


def tube_cases() -> Iterator[HistoryCase]:
    """A load beyond the limit, steady creep, and the same on cells that lock."""
    limit = Known("limit load", lambda history: abs(history.path[-1][1][0] / LIMIT - 1), 0.02)
    perfect = partial(tube, hhr.Plasticity(1.0))
    yield HistoryCase("tube beyond its limit load", perfect, beyond, (1.2, 1.4, 1.5), known=limit)
    creep = Known("speed of steady creep", off_creep, 0.01)
    law = hhr.Norton(RESISTANCE, EXPONENT)
    for cells, simplices in (("", False), (" of triangles", True)):
        scene = partial(tube, law, simplices)
        yield HistoryCase(f"Norton tube{cells}", scene, held, (0.4, 0.5, 0.6), known=creep)


def tube(law: hhr.Law, simplices: bool = False) -> hhr.Scene:
    """Tube 1 <= r <= 2 held axially, with inner pressure, and a wall that it never touches."""
    return hhr.Scene(
        name="tube",
        geometry=lambda comm: block.block(
            comm, lower=(1, 0), upper=(2, 0.2), cells=(16, 1), simplices=simplices
        ),
        hypothesis="axisymmetric",
        bodies=(hhr.Body(block.SOLID, 200.0, 0.3, law),),
        contacts=(hhr.Obstacle(block.side(0, upper=True), (1.0, 0.0), 1e6),),
        parameters=hhr.ParameterSpace(("p",), (0.0,), (2.0,)),
        displacements=tuple(
            hhr.Displacement(block.side(1, upper=upper), 1) for upper in (False, True)
        ),
        loads=(hhr.Pressure(block.side(0, upper=False), hhr.Amplitude(slopes={"p": 1.0})),),
    )


def beyond(share: float) -> Path:
    """Pressures up to beyond the limit load, in steps of a hundredth around it."""
    return [(float(time), np.array([part * LIMIT])) for time, part in enumerate((*SHARES, share))]


def held(pressure: float) -> Path:
    """A pressure that stays until creep is steady."""
    times = np.concatenate([[0.0, 1e-3], np.geomspace(1e-2, 17.0, 30)])
    return [(time, np.array([pressure if time else 0.0])) for time in times]


def off_creep(history: History) -> float:
    """Relative error of the radial speed, C / r with p = m K / sqrt(3) (2 C / sqrt(3))^(1/m) (1 -
    2^(-2/m)).
    """
    before, last = history.answers[-2:]
    pressure = last.parameter[0]
    power = pressure * np.sqrt(3) / (EXPONENT * RESISTANCE * (1 - 2 ** (-2 / EXPONENT)))
    rate = np.sqrt(3) / 2 * power**EXPONENT
    speed = (last.unknown - before.unknown)[::2].max() / (last.time - before.time)
    return float(abs(speed / rate - 1))
