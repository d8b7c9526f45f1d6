"""Warnings and reasons of refusals of surfaces whose meshes do not match."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.pairings.surface import GRAZING_NORMAL, Surface, warn

FLAT_MEAN_NORMAL = 0.95
"""Length of the mean of unit normals above which a surface is flat: an arc of 60 degrees has
0.955.
"""
TILT = 30.0
"""Degrees between a given normal and that of a flat surface above which a warning is due."""
LEAST_SAG = 1e-9
LEAST_SAG_OF_CURVES = 1e-4
"""Fractions of the size of a surface below which a sag counts as zero, of chords and of
parabolas.
"""
SAG = 0.13
"""Mean sag of facets over the mean gap above which the mesh makes the gap.

The mean pressure of a press fit of rings was off by 8 to 13 % at 0.14, by 30 to 34 % at 1.9 (by 100
% at single nodes), by 5 % at most below 0.13.
"""


def warn_of_tilt(surface: Surface, normal: np.ndarray) -> None:
    """Warn if a flat surface looks neither along nor against a unit normal.

    One parallel to it is refused later.

    Args:
        surface: the surface.
        normal: unit normal, (dim,).
    """
    mean = surface.sizes @ surface.outward / surface.sizes.sum()
    length = np.linalg.norm(mean)
    cosine = abs(mean @ normal) / length if length > 0 else 1.0
    if length > FLAT_MEAN_NORMAL and GRAZING_NORMAL < cosine < np.cos(np.deg2rad(TILT)):
        warn(
            f"the contact normal {normal.tolist()} is {np.rad2deg(np.arccos(cosine)):.0f} degrees "
            f"off that of the flat surface {surface.tag}, {np.round(mean / length, 3).tolist()}: "
            "gaps and forces are along the normal that is given. Leave it out to take that of the "
            "surface"
        )


def never_facing(slave: Surface, master: Surface, why: str) -> str:
    """Message for surfaces without a common part.

    Args:
        slave: the slave surface.
        master: the master surface.
        why: the reason.
    """
    return (
        f"surfaces {slave.tag} and {master.tag} never face each other: {why}; slave around "
        f"{slave.points.mean(axis=0).tolist()}, master around "
        f"{master.points.mean(axis=0).tolist()}. Check the tags, the normal (from slave to "
        "master) and that outer sides are tagged"
    )


def beyond_overlap(deepest: float) -> str:
    """Reason for :func:`never_facing` if surfaces lie behind each other."""
    return (
        f"one lies behind the other by up to {deepest:.3g}, more than a cell, as back sides do. "
        "Where bodies are meant to overlap so deeply, give the contact a normal, or mesh them "
        "apart and overlap them by an Opening"
    )


def warn_beyond_edge(slave: Surface, master: Surface, lost: np.ndarray, advice: str = "") -> None:
    """Warn of slave nodes that look past the edge of the master and get no condition.

    Args:
        slave: the slave surface.
        master: the master surface.
        lost: these nodes, (n,) bool.
        advice: end of the message.
    """
    if lost.any():
        warn(
            f"{int(lost.sum())} of {lost.size} nodes of slave surface {slave.tag} lie beyond the "
            f"edge of master surface {master.tag} and get no contact condition, e.g. at "
            f"{np.round(slave.points[lost][0], 9).tolist()}{advice}"
        )


def warn_of_sag(slave: Surface, master: Surface, rows: ContactRows, sag: float) -> None:
    """Warn if the gap is one of the mesh.

    Args:
        slave: the slave surface.
        master: the master surface.
        rows: the conditions.
        sag: mean of :meth:`Surface.bulges` over the parts that face each other.
    """
    gap = float(rows.areas @ np.abs(rows.gap) / rows.areas.sum())
    least = LEAST_SAG if slave.quadratic is None else LEAST_SAG_OF_CURVES
    if sag > SAG * gap and sag > least * np.ptp(slave.points):
        warn(
            f"the gap of surfaces {slave.tag} and {master.tag} is {gap:.3g} on average, and their "
            f"flat facets are off the curved surfaces they stand for by {sag:.3g} on average: the "
            "gap is one of the mesh. Mesh both finer, until the sag of a facet, its length times "
            "its angle to the next one over 8, is far below the gap, or mesh both alike, node to "
            "node"
        )
