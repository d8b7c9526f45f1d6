"""Von Mises' stress of inelastic bodies on a page: means of cells, in few modes.

With the arrays of :class:`hhr_dolfinx.plugins.inelastic.condensed_fields.PlasticFields` the
deviator of a cell is

    dev σ = D (K^-1 F θ - K^-1 B^T λ) + (D (u_L θ + u_p s) - M (ε_0 θ + ε_p s)) / c,

D and M are means over the points of a cell, s coefficients of the modes of the plastic strain, and
c the compliance of its body over that at the middle of the box.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix, csr_matrix

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.plugins.inelastic.condensed_flow import CondensedFlowModel
from hhr_dolfinx.plugins.pages.packing import (
    BASE64,
    Json,
    Packed,
    kept_levels,
    modes_of,
    packed_levels,
)
from hhr_dolfinx.plugins.pages.scenery import Scenery
from hhr_dolfinx.plugins.pages.stress import (
    FALSE,
    HELD_OUT_STRIDE,
    STRESS_LEVELS,
    STRESS_MODES_ERROR,
    far_off,
    mises_of,
)

MOST_CELLS = 20_000
"""Most drawn cells for which the stress is shown, as for elastic bodies."""


def cells_of(model: CondensedFlowModel, scenery: Scenery) -> np.ndarray:
    """Cell of each drawn triangle, (t,), that has all of its nodes.

    Args:
        model: condensed model of inelastic bodies.
        scenery: drawn mesh and contact of the scene.

    Raises:
        NotOfferedError: for a scenery of another mesh.
    """
    cells = model.fields.flow.strain.dofs[:, :: model.dimension] // model.dimension
    count = len(model.fields.basis) // model.dimension
    corners = scenery.nodes[scenery.triangles]
    of_triangles, of_cells = (
        csr_matrix(
            (np.ones(nodes.size), nodes.ravel(), np.arange(len(nodes) + 1) * nodes.shape[1]),
            (len(nodes), count),
        )
        for nodes in (corners, cells)
    )
    shared = (of_triangles @ of_cells.T).tocsr()
    if (shared.max(axis=1).toarray() < corners.shape[1]).any():
        raise NotOfferedError(
            "the scenery is of another mesh than the model: its triangles are none of its cells'"
        )
    return np.asarray(shared.argmax(axis=1)).ravel()


class CellMeans:
    """Stresses of cells, (c,), as sparse matrices: (c k, N) of displacements, (c k, points) of
    strains.

    They are deviators, except in plane stress. The third component is left out: it follows from the
    others, or is 0.
    """

    def __init__(self, model: CondensedFlowModel, cells: np.ndarray):
        flow = model.fields.flow
        operator = flow.strain
        shares = operator.weights[cells] / operator.weights[cells].sum(axis=1, keepdims=True)
        points = operator.points_of(cells).reshape(len(cells), -1)
        self._shares = shares
        self._points = points
        projection = np.eye(operator.components)
        self.plane_stress = any(
            group.law is not None and group.law.plane_stress for group in model.flow.groups
        )
        if not self.plane_stress:
            projection[:3, :3] -= 1 / 3
        self._part = np.delete(projection, 2, axis=0)
        graded = shares * flow.grading[points] if flow.grading.size else shares
        scaled = graded[:, :, None, None] * (self._part @ flow.elastic)[flow.kinds[points]]
        gradients = np.einsum("cpkj,cpjd->ckd", scaled, operator.gradients[cells], optimize=True)
        self.of_displacements = _sparse(gradients, operator.dofs[cells], operator.size)
        strains = scaled.swapaxes(1, 2).reshape(len(cells), len(self._part), -1)
        columns = points[:, :, None] * operator.components + np.arange(operator.components)
        self.of_strains = _sparse(
            strains, columns.reshape(len(cells), -1), flow.places * operator.components
        )

    def stressed(self, stress: np.ndarray) -> np.ndarray:
        """The same for a stress at all Gauss points, (Gauss points, components): (c k,)."""
        return np.einsum(
            "cp,kj,cpj->ck", self._shares, self._part, stress[self._points], optimize=True
        ).ravel()


def _sparse(blocks: np.ndarray, columns: np.ndarray, size: int) -> csc_matrix:
    """Matrix with consecutive rows of cells, from blocks (c, k, d) on columns (c, d)."""
    count = blocks.shape[0] * blocks.shape[1]
    indices = (
        np.repeat(np.arange(count), blocks.shape[2]),
        np.broadcast_to(columns[:, None], blocks.shape).ravel(),
    )
    return csc_matrix(coo_matrix((blocks.ravel(), indices), (count, size)))


def flow_stress(
    model: CondensedFlowModel,
    scenery: Scenery,
    histories: Sequence[Sequence[Answer]],
    arrays: Packed,
    room: int,
) -> dict[str, Json] | None:
    """Stress of drawn cells in modes of some histories, and its error along others.

    None if there are too many cells, if the error of the largest stress is too large, or if there
    is no room.

    Args:
        model: condensed model of inelastic bodies.
        scenery: drawn mesh and contact of the scene. It has the cell of each triangle.
        histories: answers along each path.
        arrays: packed arrays, to which those of the tree are added.
        room: bytes for all arrays, as text.
    """
    assert scenery.owners is not None
    cells, positions = np.unique(scenery.owners, return_inverse=True)
    if not 0 < len(cells) <= MOST_CELLS or len(histories) < HELD_OUT_STRIDE:
        return None
    means = CellMeans(model, cells)
    seen = np.array(
        [means.stressed(model.fields.stress(answer)) for along in histories for answer in along]
    ).T
    number = np.repeat(np.arange(len(histories)), [len(along) for along in histories])
    apart = np.flatnonzero(number % HELD_OUT_STRIDE == HELD_OUT_STRIDE - 1)
    ways = modes_of(
        np.delete(seen, apart, axis=1), STRESS_MODES_ERROR, int((room - arrays.size) / BASE64)
    )
    if ways is None:
        return None
    tried = Packed()
    tree = {"kind": "stressed"} | packed_levels("stress_modes", ways.T, tried, STRESS_LEVELS)
    tree |= _maps(model, means, cells, ways, tried)
    approximated = kept_levels(tree, tried).T @ (ways.T @ seen[:, apart])
    exact, drawn = (
        np.array(
            [
                mises_of(stress.reshape(len(cells), -1), plane_stress=means.plane_stress)
                for stress in values.T
            ]
        )
        for values in (seen[:, apart], approximated)
    )
    # after unloading the residual stress is small compared with the stress of its history
    scales = np.array([exact[number[apart] == history].max() for history in number[apart]])
    off = far_off(exact, drawn, scales)
    tree |= {
        "cells": tried.put("stress_cells", positions.ravel(), "<i4"),
        "off": off,
        # deviators of stress, passed as strains of one body with 2 μ' = 1
        "bodies": tried.put("stress_bodies", np.zeros(len(cells)), "<u1"),
        "components": len(seen) // len(cells),
        "plane_stress": means.plane_stress,
        "moduli": [[[0.0], [0.5]]],
        "middle": [1.0],
    }
    if off["largest"] > FALSE or arrays.size + tried.size > room:
        return None
    arrays.take(tried)
    return tree


def _maps(
    model: CondensedFlowModel, means: CellMeans, cells: np.ndarray, ways: np.ndarray, arrays: Packed
) -> dict[str, str]:
    """Maps to coefficients of modes: from forces and loads, and by part from imposed and plastic
    strains.
    """
    fields = model.fields
    flow = fields.flow
    components = flow.strain.components
    flowed = (flow.flowed[:, None] * components + np.arange(components)).ravel()
    by_loads = (
        means.of_displacements @ fields.given - (means.of_strains @ flow.unstressed).toarray()
    )
    plastic = means.of_displacements @ flow.moved - means.of_strains[:, flowed] @ flow.plastic.modes
    components_of_rows = np.repeat(
        fields.parts[flow.strain.dofs[cells, 0]], len(ways) // len(cells)
    )
    ways_by_component = [
        (ways * (components_of_rows == number)[:, None]).T
        for number in range(fields.factors.middle.size)
    ]
    maps = {
        "pushed": -(ways.T @ (means.of_displacements @ fields.per_force)),
        "forced": ways.T @ (means.of_displacements @ fields.forced),
        "given": np.array([rows @ by_loads for rows in ways_by_component]),
        "plastic": np.array([rows @ plastic for rows in ways_by_component]),
        "fit": flow.plastic.fit,
    }
    return {name: arrays.put(f"stress_{name}", values, "<f4") for name, values in maps.items()}
