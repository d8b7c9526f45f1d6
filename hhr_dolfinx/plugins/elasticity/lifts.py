"""Rigid motions of whole bodies as lifts.

A body whose imposed displacements are those of a rigid motion is lifted as a whole, so that its
lift has no strain. The lift of the thesis is nonzero on the imposed dofs alone (section 2.6), and K
lift is a load. If K depends on parameters so does that load, and it is far larger than any force on
the body: interpolated between parameters its terms cancel, and so do the energies in bounds. If the
imposed values are those of a rigid motion, as for a block that is pressed down by its top, that
motion of the whole body has these values too, and K is zero along it for any moduli.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_matrix, hstack

from hhr_dolfinx.full_order.free_bodies import components_of_nodes, rigid_motions

RIGID_VALUES = 1e-10
"""Relative difference from imposed values up to which a rigid motion has the same values."""


def rigid_lifts(
    hypothesis: str, lifts: csc_matrix, free: np.ndarray, points: np.ndarray, cell_nodes: np.ndarray
) -> csc_matrix:
    """Replace lifts by rigid motions of whole bodies if these have the imposed values.

    Each term is checked separately: in a body that it moves, the other imposed dofs stay zero.

    Args:
        hypothesis: hypothesis of the scene.
        lifts: lifts that are nonzero on imposed dofs alone, (N, 1 + T).
        free: False for imposed dofs, (N,) bool.
        points: coordinates of the nodes, (nodes, dim).
        cell_nodes: nodes of each cell, (cells, n).

    Returns:
        Lifts, (N, 1 + T).
    """
    label = components_of_nodes(len(points), cell_nodes)
    terms = [lifts[:, [term]] for term in range(lifts.shape[1])]
    imposed = ~free.reshape(points.shape)
    for term in np.flatnonzero(np.diff(lifts.indptr)):
        values = terms[term].toarray().reshape(points.shape)
        moving = values.copy()
        for number in np.unique(label[np.any(values, axis=1)]):
            nodes = np.flatnonzero(label == number)
            motions = rigid_motions(points[nodes], hypothesis)
            held = imposed[nodes]
            wanted = values[nodes]
            ways = np.linalg.lstsq(motions[:, held].T, wanted[held], rcond=RIGID_VALUES)[0]
            rigid = np.tensordot(ways, motions, 1)
            if np.abs(rigid - wanted)[held].max() > RIGID_VALUES * np.abs(wanted).max():
                continue
            rigid[held] = wanted[held]
            moving[nodes] = np.where(np.abs(rigid) > RIGID_VALUES * np.abs(rigid).max(), rigid, 0.0)
        terms[term] = csc_matrix(moving.reshape(-1, 1))
    return csc_matrix(hstack(terms))
