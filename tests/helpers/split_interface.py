"""A flat interface of two blocks that is stated as two contacts, whose surfaces share the node at x
= 1.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from dolfinx import mesh as dmesh

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

TOP, BOTTOM = side(FIRST, 1, upper=True), side(SECOND, 1, upper=False)
UPPER = (61, 62)
LOWER = (51, 52)


def geometry(comm: Any, cells: Sequence[int], split: bool) -> tuple:
    """Two blocks, 2 x 1 each, on each other.

    Both sides of the interface have two tags if they are ``split``.
    """
    below, above = cells
    mesh, bodies, facets = two_blocks(
        comm, first=((0, -1), (2, 0), (below, 3)), second=((0, 0), (2, 1), (above, 4))
    )
    middles = dmesh.compute_midpoints(mesh, 1, facets.indices)
    values = facets.values.copy()
    for tag, (left, right) in ((TOP, LOWER), (BOTTOM, UPPER)):
        values[facets.values == tag] = np.where(
            split & (middles[facets.values == tag, 0] > 1), right, left
        )
    return mesh, bodies, dmesh.meshtags(mesh, 1, facets.indices, values)


def scene(
    contacts: Sequence[Any], cells: Sequence[int] = (8, 8), *, split: bool = True, **changes: Any
) -> hhr.Scene:
    """Patch test: E = 1000, nu = 0, pressed by 10, so that the pressure is 10 at each node and each
    half bears 10.
    """
    outputs = [
        output
        for k in range(len(contacts))
        for output in (
            hhr.LargestPressure(f"pressure {k}", k), hhr.ContactForce(f"force {k}", k, (0.0, 1.0)),
            hhr.ContactWidth(f"width {k}", k), hhr.LostContact(f"lost {k}", k),
            hhr.ContactMoment(f"moment {k}", k, (0.0, 0.0)),
        )
    ]  # fmt: skip
    parts = {
        "name": "split_interface",
        "geometry": lambda comm: geometry(comm, cells, split),
        "hypothesis": "plane_strain",
        "bodies": (
            hhr.Body(FIRST, young=1e3, poisson=0.0),
            hhr.Body(SECOND, young=1e3, poisson=0.0),
        ),
        "contacts": tuple(contacts),
        "displacements": (
            *hhr.Displacement.clamp(side(FIRST, 1, upper=False), 2),
            hhr.Displacement(side(SECOND, 0, upper=False), 0),
            hhr.Displacement(
                side(SECOND, 1, upper=True), 1, hhr.Amplitude(slopes={"press": -2e-3})
            ),
        ),
        "parameters": hhr.ParameterSpace(("press",), (0.0,), (20.0,)),
        "outputs": tuple(outputs),
    }
    return hhr.Scene(**parts | changes)


def half(pressure: float, force: float, arm: float) -> dict[str, float]:
    """Outputs of a contact under a constant pressure whose force has an arm."""
    return {"pressure": pressure, "force": force, "width": 1.0, "lost": 0.0, "moment": force * arm}


HALVES = {
    f"{name} {k}": value
    for k, arm in enumerate((0.5, 1.5))
    for name, value in half(10.0, 10.0, arm).items()
}
"""Outputs of the patch test at ``press`` = 10, in closed form."""
