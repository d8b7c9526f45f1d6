"""A hub on a hollow shaft, one quarter and the upper half of both: meshes that differ along the
axis only.

Structured hexahedra in polar coordinates. Both bodies have the same cells around the axis, so that
their flat facets lie on each other and the mesh adds nothing to the gap.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.compat import TaggedMesh

HUB = FIRST
SHAFT = SECOND
"""Cell tags of the two bodies."""
HUB_BORE = side(HUB, 0, False)
SHAFT_OUTSIDE = side(SHAFT, 0, True)
"""Facet tags of the surfaces in contact."""
PLANES = {
    axis: (side(HUB, place, upper), side(SHAFT, place, upper))
    for axis, (place, upper) in {0: (1, True), 1: (1, False), 2: (2, False)}.items()
}
"""Facet tags of the planes of symmetry x = 0, y = 0 and z = 0."""


def press_fit(
    comm: Comm,
    *,
    radius: float = 20.0,
    wall: float = 10.0,
    bore: float = 8.0,
    half_length: float = 15.0,
    overhang: float = 5.0,
    around: int = 12,
    hub_cells: tuple[int, int] = (8, 30),
    shaft_cells: tuple[int, int] = (8, 34),
) -> TaggedMesh:
    """Build the mesh of both bodies on all ranks of ``comm``.

    Args:
        comm: MPI communicator.
        radius: radius of the surfaces in contact, in the unit of length of the scene.
        wall: thickness of the hub.
        bore: radius of the hole in the shaft.
        half_length: half the length of the hub.
        overhang: length by which each end of the shaft extends beyond the hub.
        around: cells of both bodies in a quarter of a turn.
        hub_cells, shaft_cells: cells along the radius and along half the axis.

    Raises:
        ValueError: for lengths that are not positive, or a bore as wide as the shaft.
    """
    if not 0 < bore < radius or min(wall, half_length, overhang) <= 0:
        raise ValueError(
            f"bore = {bore} must lie in (0, {radius}), and wall, half_length and overhang be "
            "positive"
        )

    def warp(points: np.ndarray, tag: int) -> np.ndarray:
        """Coordinates, (n, 3), of ``points`` in polar coordinates, for both bodies, ``tag``."""
        r = points[:, 0]
        angle = points[:, 1] * np.pi / 2
        return np.column_stack([r * np.cos(angle), r * np.sin(angle), points[:, 2]])

    hub = (
        (radius, 0.0, 0.0),
        (radius + wall, 1.0, half_length),
        (hub_cells[0], around, hub_cells[1]),
    )
    shaft = (
        (bore, 0.0, 0.0),
        (radius, 1.0, half_length + overhang),
        (shaft_cells[0], around, shaft_cells[1]),
    )
    return two_blocks(comm, first=hub, second=shaft, warp=warp)
