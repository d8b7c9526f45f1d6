"""Lifts that do not strain: a body whose imposed motions are those of a rigid one is lifted as a whole.

The lift of the thesis lives on the imposed dofs alone (section 2.6), and K lift is a load. Where K depends on
parameters so does that load, and it is far larger than any force that the body bears: what is interpolated of it
between parameters cancels, and so do the energies that bounds are made of. Where the imposed values are those of a
rigid motion, as of a block that is pressed down by its top, that motion of the whole body fits them too, and K is zero
along it whatever the moduli are.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.full_order.motions import hanging_together, rigid_motions
from hhr_dolfinx.scene import Scene

ALIKE = 1e-10
"""Part of imposed values up to which a rigid motion has the same."""


def rigid_lifts(
    scene: Scene, lifts: csc_matrix, free: np.ndarray, points: np.ndarray, cell_nodes: np.ndarray
) -> csc_matrix:
    """Lifts, (N, 1 + T), that are rigid motions of whole bodies where their imposed values are those of such motions.

    Each term is looked at by itself: of what it moves in a body, the rest that is imposed there stays. Bodies that flow
    or change their shape keep their lifts.

    Args:
        scene: the scene.
        lifts: carried by the imposed dofs alone, (N, 1 + T).
        free: dofs that are not imposed, (N,) bool.
        points: coordinates of the nodes, (nodes, dim).
        cell_nodes: nodes of each cell, (cells, n).
    """
    if scene.shapes or any(body.law is not None for body in scene.bodies):
        return lifts
    part, found = hanging_together(len(points), cell_nodes), lifts.tolil()
    imposed, dim = ~free.reshape(points.shape), points.shape[1]
    for term in np.flatnonzero(np.diff(lifts.indptr)):
        values = lifts[:, [term]].toarray().reshape(points.shape)
        for number in np.unique(part[np.any(values, axis=1)]):
            nodes = np.flatnonzero(part == number)
            motions, held, wanted = rigid_motions(points[nodes], scene.hypothesis), imposed[nodes], values[nodes]
            ways = np.linalg.lstsq(motions[:, held].T, wanted[held], rcond=ALIKE)[0]
            moved = np.tensordot(ways, motions, 1)
            if np.abs(moved - wanted)[held].max() > ALIKE * np.abs(wanted).max():
                continue
            moved[held] = wanted[held]
            dofs = (nodes[:, None] * dim + np.arange(dim)).ravel()
            found[dofs, term] = np.where(np.abs(moved) > ALIKE * np.abs(moved).max(), moved, 0.0).reshape(-1, 1)
    return csc_matrix(found)
