"""Surfaces that mislead a search for partners, for ``extreme_cases.py``: thin bodies, facets off a
curve.
"""

from collections.abc import Iterator

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py.MPI import Comm
from verify import Case, Known

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import two_blocks

THICKNESS, GAP, INNER, FIT, OUTER = 0.02, 0.01, 0.5, 1.0, 1.6


def surface_cases() -> Iterator[Case]:
    """Strips whose back sides are nearer than their ends, rings that overlap by less than their
    facets sag.
    """
    nothing = Known("no force without a load", force_at_rest, 1e-12)
    yield Case("strips .02 thick, mortar without normal", strips(), counts=(41,), known=nothing)
    sag = (np.pi / 2 / 12) ** 2 / 8
    for part, word in ((1.0, "of the"), (0.1, "ten times the")):
        # what facets off a curve and small displacements leave at a tenth; below it a third is lost
        lame = Known("pressure of Lamé", lambda full, size=sag / part: off_lame(full, size), 0.07)
        yield Case(
            f"overlap {word} sag of facets", rings((12, 17), sag / part), counts=(11,), known=lame
        )


def strips() -> hhr.Scene:
    """Two strips above each other, held at their ends.

    Both long sides of each are one surface, no normal is given.
    """
    boxes = [
        ((0.0, low), (1.0, low + THICKNESS), (cells, 1))
        for low, cells in ((0.0, 20), (THICKNESS + GAP, 23))
    ]

    def geometry(comm: Comm) -> tuple:
        mesh, bodies, sides = two_blocks.two_blocks(comm, first=boxes[0], second=boxes[1])
        values = sides.values.copy()
        for body in (1, 2):
            values[
                np.isin(values, [two_blocks.side(body, 1, upper) for upper in (False, True)])
            ] = body
        return mesh, bodies, dmesh.meshtags(mesh, 1, sides.indices, values)

    ends = [two_blocks.side(body, 0, upper) for body in (1, 2) for upper in (False, True)]
    return hhr.Scene(
        name="strips",
        geometry=geometry,
        hypothesis="plane_strain",
        bodies=(hhr.Body(1, 1e5, 0.3), hhr.Body(2, 1e5, 0.3)),
        contacts=(hhr.Mortar(2, 1),),
        parameters=hhr.ParameterSpace(("q",), (0.0,), (5.0,)),
        displacements=tuple(hhr.Displacement(tag, axis) for tag in ends for axis in (0, 1)),
        loads=(hhr.Traction(1, (0.0, 1.0), hhr.Amplitude(slopes={"q": 1.0})),),
    )


def force_at_rest(full: hhr.FullOrderModel) -> float:
    """Largest contact force without a load over the largest with it."""
    rest, loaded = (np.abs(full.solve(load).forces()).max() for load in (0.0, 5.0))
    return float(rest / loaded) if loaded > 0 else np.inf


def rings(counts: tuple[int, int], overlap: float) -> hhr.Scene:
    """Quarter rings that overlap, with ``counts`` cells along the arc, and hardly a load."""

    def bend(points: np.ndarray, _: int) -> np.ndarray:
        angle, radius = points.T
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])

    first = ((0.0, INNER), (np.pi / 2, FIT), (counts[0], 6))
    second = ((0.0, FIT - overlap), (np.pi / 2, OUTER), (counts[1], 6))
    ends = [(body, upper) for body in (1, 2) for upper in (False, True)]
    return hhr.Scene(
        name="rings",
        geometry=lambda comm: two_blocks.two_blocks(comm, first=first, second=second, warp=bend),
        hypothesis="plane_strain",
        bodies=(hhr.Body(1, 1.0, 0.3), hhr.Body(2, 1.0, 0.3)),
        contacts=(hhr.Mortar(two_blocks.side(2, 1, False), two_blocks.side(1, 1, True)),),
        parameters=hhr.ParameterSpace(("p",), (0.0,), (1e-3,)),
        displacements=tuple(
            hhr.Displacement(two_blocks.side(body, 0, upper), int(not upper))
            for body, upper in ends
        ),
        loads=(hhr.Pressure(two_blocks.side(2, 1, True), hhr.Amplitude(slopes={"p": 1.0})),),
    )


def off_lame(full: hhr.FullOrderModel, overlap: float) -> float:
    """Relative error of the mean pressure between rings of one material, E = 1 and nu = 0.3, in
    plane strain.
    """
    found = full.solve(0.0).forces().sum() / full.problem.contact_areas.sum()
    inner = (FIT**2 + INNER**2) / (FIT**2 - INNER**2)
    outer = (OUTER**2 + FIT**2) / (OUTER**2 - FIT**2)
    return float(abs(found / (overlap / FIT / (1 - 0.3**2) / (inner + outer)) - 1))
