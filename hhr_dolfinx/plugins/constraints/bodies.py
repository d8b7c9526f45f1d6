"""Rigid motions of bodies that constraints join: the tool ``joined_bodies``."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.contact.prolongation import Prolongation
from hhr_dolfinx.full_order.free_bodies import ALMOST_NONE, FreeBody, rigid_motions, vanishing


@dataclass(frozen=True)
class JoinedBody(FreeBody):
    """Several components that constraints join and let move in parts, with all motions of the parts
    in their order.
    """

    parts: tuple[FreeBody, ...]

    def described(self, ways: np.ndarray) -> str:
        """See :class:`FreeBody`."""
        ends = np.cumsum([len(component.motions) for component in self.parts])[:-1]
        texts = []
        for component, motions in zip(self.parts, np.split(ways, ends, axis=1), strict=True):
            _, sizes, rows = np.linalg.svd(motions, full_matrices=False)
            if len(combinations := rows[sizes > ALMOST_NONE]):
                texts.append(f"{component.name} {component.described(combinations)}")
        return f"moves in parts: {'; '.join(texts)}"


def joined_bodies(
    components: list[FreeBody],
    prolongation: Prolongation,
    points: np.ndarray,
    imposed: np.ndarray,
    hypothesis: str | None,
) -> list[FreeBody]:
    """Bodies of components, with the motions that vanish on imposed dofs and break no constraint.

    Args:
        components: connected components of the mesh, with all of their motions.
        prolongation: prolongation of the constraints.
        points: coordinates of the nodes, (nodes, dim).
        imposed: imposed dofs, (nodes, dim) bool.
        hypothesis: hypothesis of the scene; None if motions of a body as a whole are not those of
            its points, so that only those of its components are known.
    """
    assert prolongation.map is not None
    groups = _groups(components, prolongation.map, points)
    return [_joined(group, prolongation, points, imposed, hypothesis) for group in groups]


def _groups(
    components: list[FreeBody], coupling: csr_matrix, points: np.ndarray
) -> list[list[FreeBody]]:
    """Components that constraints join; nodes may belong to none of them."""
    owner = np.full(len(points), -1)
    for number, component in enumerate(components):
        owner[component.nodes] = number
    rows, columns = (owner[dofs // points.shape[1]] for dofs in coupling.nonzero())
    owned = (rows >= 0) & (columns >= 0)
    joins = rows[owned], columns[owned]
    graph = csr_matrix((np.ones(owned.sum()), joins), shape=(len(components),) * 2)
    labels = connected_components(graph, directed=False)[1]
    return [[components[k] for k in np.flatnonzero(labels == label)] for label in np.unique(labels)]


def _joined(
    parts: list[FreeBody],
    prolongation: Prolongation,
    points: np.ndarray,
    imposed: np.ndarray,
    hypothesis: str | None,
) -> FreeBody:
    """One body of several components, whose motions satisfy the constraints.

    They are those of the body as a whole, unless constraints let its parts move in more ways, as a
    hinge does.
    """

    def left(columns: np.ndarray) -> np.ndarray:
        """Combinations of columns that vanish on imposed dofs and break no constraint."""
        return vanishing(np.vstack([columns[imposed.ravel()], prolongation.broken(columns)]))

    nodes = np.sort(np.concatenate([component.nodes for component in parts]))
    name = " with ".join(component.name for component in parts)
    apart = np.hstack([component.columns(len(points)) for component in parts])
    of_parts = left(apart)
    if hypothesis is not None:
        motions = rigid_motions(points[nodes], hypothesis)
        body = FreeBody(name, nodes, motions, np.eye(len(motions)))
        of_whole = left(body.columns(len(points)))
        if len(of_parts) <= len(of_whole):
            return replace(body, left=of_whole)
    if len(parts) == 1:
        return replace(parts[0], left=of_parts)
    return JoinedBody(name, nodes, _at_nodes(apart, points, nodes), of_parts, tuple(parts))


def _at_nodes(columns: np.ndarray, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Motions on all nodes, (nodes dim, k), at some nodes: (k, n, dim)."""
    return columns.T.reshape(-1, *points.shape)[:, nodes]
