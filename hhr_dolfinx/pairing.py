"""Pairing of contact surfaces: from tagged surfaces to the rows of B and D, thesis section 1.2.4.

Works on gathered coordinates, so that every MPI rank builds the same rows in the same order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, vstack
from scipy.spatial import cKDTree

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.problem import ContactRows


@dataclass(frozen=True)
class Surface:
    """Nodes of a tagged surface.

    Attributes:
        tag: facet tag, for messages.
        nodes: node numbers, (n,).
        points: coordinates, (n, dim).
        areas: tributary areas, (n,).
        facing: mean outer normal along the contact normal times area, (n,).
    """

    tag: int
    nodes: np.ndarray
    points: np.ndarray
    areas: np.ndarray
    facing: np.ndarray


def node_to_node(first: Surface, second: Surface, normal: np.ndarray, dofs: int) -> ContactRows:
    """Pair nodes that face each other along ``normal``: (u_1 - u_2)·n <= (x_2 - x_1)·n, thesis (1.25).

    Args:
        first: surface whose outer normal looks along ``normal``.
        second: facing surface.
        normal: unit vector, (dim,).
        dofs: N, number of columns of B.

    Raises:
        SceneError: if a surface looks the wrong way, or a node has no partner or several.
    """
    _check_facing(first, normal, along=True)
    _check_facing(second, normal, along=False)
    along = np.eye(normal.size) - np.outer(normal, normal)
    tangential_first, tangential_second = first.points @ along, second.points @ along
    spacing = _spacing(tangential_first)
    distance, partner = cKDTree(tangential_second).query(tangential_first)
    lonely = distance > 1e-4 * spacing
    if len(first.nodes) != len(second.nodes) or lonely.any() or np.unique(partner).size != partner.size:
        lost = first.points[lonely] if lonely.any() else second.points
        raise SceneError(
            f"surfaces {first.tag} ({len(first.nodes)} nodes) and {second.tag} ({len(second.nodes)} nodes) do not "
            f"face each other node to node along {normal.tolist()}: {int(lonely.sum())} nodes have no partner, "
            f"e.g. at {lost[0].tolist()}. Mesh both surfaces alike or use a pairing for non-matching meshes"
        )
    gap = (second.points[partner] - first.points) @ normal
    order = _order(first.points, normal)
    rows = _rows(first.nodes[order], normal, dofs) - _rows(second.nodes[partner][order], normal, dofs)
    return ContactRows(rows, gap[order], first.nodes[order], first.points[order], first.areas[order])


def obstacle(surface: Surface, normal: np.ndarray, offset: float, dofs: int) -> ContactRows:
    """Contact of a surface with the rigid plane x·n = offset: u·n <= offset - x·n, thesis (1.26).

    Args:
        surface: surface of the body.
        normal: unit vector towards the obstacle, (dim,).
        offset: position of the plane along the normal.
        dofs: N, number of columns of B.

    Raises:
        SceneError: if the surface looks away from the obstacle.
    """
    _check_facing(surface, normal, along=True)
    order = _order(surface.points, normal)
    gap = offset - surface.points[order] @ normal
    nodes = surface.nodes[order]
    return ContactRows(_rows(nodes, normal, dofs), gap, nodes, surface.points[order], surface.areas[order])


def stack(rows: list[ContactRows], free: np.ndarray) -> tuple[ContactRows, np.ndarray]:
    """Join the rows of all pairs; rows without a free dof hold no unknown and are left out.

    Returns:
        The rows, and for each the number of its pair.

    Raises:
        SceneError: if no row is left.
    """
    joined = ContactRows(
        csr_matrix(vstack([r.matrix for r in rows])),
        *(np.concatenate([getattr(r, name) for r in rows]) for name in ("gap", "slaves", "points", "areas")),
    )
    kept = np.flatnonzero(abs(joined.matrix) @ free.astype(float))
    if kept.size == 0:
        raise SceneError("the contact pairs are empty: all of their nodes have imposed displacements")
    pairs = np.repeat(np.arange(len(rows)), [r.gap.size for r in rows])[kept]
    return ContactRows(*(getattr(joined, name)[kept] for name in ("matrix", "gap", "slaves", "points", "areas"))), pairs


def unit(normal, dim: int) -> np.ndarray:
    """Check a normal given by the user and normalise it.

    Raises:
        SceneError: for a wrong length or a zero or non-finite vector.
    """
    normal = np.asarray(normal, dtype=float)
    length = np.linalg.norm(normal)
    if normal.shape != (dim,) or not np.isfinite(length) or length == 0:
        raise SceneError(f"contact normal {normal.tolist()} must be a non-zero vector of length {dim}")
    return normal / length


def _check_facing(surface, normal, along):
    """Check that a surface looks along the contact normal, or against it."""
    if len(surface.nodes) == 0:
        raise SceneError(f"contact surface {surface.tag} has no nodes: the contact pair is empty")
    away = (surface.facing if along else -surface.facing) < -1e-9 * surface.areas
    if away.any():
        raise SceneError(
            f"surface {surface.tag} should look {'along' if along else 'against'} the contact normal "
            f"{normal.tolist()} and does not at {int(away.sum())} of {away.size} nodes, e.g. at "
            f"{surface.points[away][0].tolist()}: the surfaces do not face each other. "
            "Swap the surfaces or the sign of the normal, which points away from the first surface"
        )


def _spacing(points):
    """Median distance of neighbours, the measure of what 'facing' means."""
    if len(points) < 2:
        return 1.0
    return float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))


def _order(points, normal):
    """Order of the rows that does not depend on node numbers: along the tangent, axis by axis."""
    tangential = points - np.outer(points @ normal, normal)
    size = np.ptp(points, axis=0).max(initial=0.0) or 1.0
    return np.lexsort(np.round(tangential / size, 9).T[::-1])


def _rows(nodes, normal, dofs):
    """Rows n·u at the given nodes, (len(nodes), N)."""
    dim = normal.size
    indices = (nodes[:, None] * dim + np.arange(dim)).ravel()
    data = np.tile(normal, nodes.size)
    rows = csr_matrix((data, indices, np.arange(0, data.size + 1, dim)), shape=(nodes.size, dofs))
    rows.eliminate_zeros()
    return rows
