"""Contact surfaces as arrays, and the operations on them that all pairings need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Annotated, Protocol

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx import registry
from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.declared import Booleans, Floats, Integers, KnownArguments
from hhr_dolfinx.errors import PairingWarning, SceneError, rounded
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.warn import warn as report

CREASE = np.cos(np.deg2rad(40.0))
"""Facets that meet at more than 40 degrees form an edge; normals are not averaged across it."""

GRAZING_NORMAL = 1e-3
"""Cosine to a normal given by the user below which a side does not look along it: a half-disc may
be tagged up to where the normal is tangential.
"""


class QuadraticFacets(Protocol):
    """Facets of second order of a surface whose facets are the flat parts of these.

    A plug-in makes them.
    """

    nodes: np.ndarray  #: nodes of each facet, counted within the surface, (F, K)
    corners: np.ndarray  #: corners of each facet, (F, k)

    def functions(self, flat: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Quadratic facets, (q,), and their shape functions, (q, K), at points of flat parts.

        Args:
            flat: flat part of each point, (q,).
            values: its shape functions there, (q, k).
        """

    def averaged(self, surface: Surface, rows: ContactRows) -> ContactRows:
        """Conditions of single nodes of the surface, averaged.

        Args:
            surface: the surface.
            rows: conditions of single nodes.
        """

    def shared(self, surface: Surface, normals: np.ndarray, nodes: np.ndarray) -> csr_matrix:
        """Matrix, (n, n), that shares the functions of nodes with imposed displacements among
        neighbours.

        Args:
            surface: the surface.
            normals: unit normals of the conditions, (n, dim).
            nodes: nodes with conditions, (n,).
        """

    def sag_shares(self, outward: np.ndarray) -> np.ndarray:
        """Deviation of flat parts with normals (f, dim) over that of flat facets with these,
        (f,).
        """

    def warn_of_straight_sides(self, surfaces: Sequence[Surface]) -> None:
        """Warn of a curved surface with straight sides."""


@dataclass(frozen=True)
class Surface:
    """A tagged surface of n nodes and f facets of k nodes each: 2 in the plane, 3 or 4 in space."""

    tag: Tag  #: facet tag, for messages
    nodes: Annotated[Integers, "surface nodes"]  #: node numbers in the mesh, (n,)
    points: Annotated[Floats, "surface nodes", "dimension"]  #: coordinates of the nodes, (n, dim)
    #: nodes of each facet, counted within the surface, (f, k); quadrilaterals in tensor order
    facets: Annotated[Integers, "facets", "corners", "< surface nodes"]
    #: outward, sizes: unit outer normal of each facet, (f, dim), and its length or area without
    #: weight, (f,)
    outward: Annotated[Floats, "facets", "dimension"]
    sizes: Annotated[Floats, "facets"]
    weights: Annotated[
        Floats, "surface nodes"
    ]  #: weight of the surface measure at each node, 1 or 2 pi r, (n,)
    areas: Annotated[Floats, "surface nodes"]  #: tributary area of each node, (n,)
    depths: Annotated[
        Floats, "facets"
    ]  #: depth of the cell of each facet, (f,): no body is thinner
    #: facets of second order, of which ``facets`` are the flat parts; None for cells of first order
    quadratic: QuadraticFacets | None = None
    #: components of the displacement of the nodes that are not imposed, (n, dim) bool; None if all
    #: are free
    free: Annotated[Booleans, "surface nodes", "dimension"] | None = None

    @property
    def corners(self) -> np.ndarray:
        """Coordinates of the nodes of each facet, (f, k, dim)."""
        return self.points[self.facets]

    @cached_property
    def corner_normals(self) -> np.ndarray:
        """Unit outer normals at the corners of each facet, (f, k, dim), averaged up to edges of the
        surface.
        """
        count, k = self.facets.shape
        pairs = np.repeat(np.arange(count), k), self.facets.ravel()
        at_node = csr_matrix((np.ones(count * k), pairs), shape=(count, len(self.nodes))).tocsc()
        normals = np.empty((count, k, self.points.shape[1]))
        for j in range(k):
            corner_facets, neighbours = touches_of(at_node, self.facets[:, j])
            smooth = (
                np.einsum("ij,ij->i", self.outward[corner_facets], self.outward[neighbours])
                >= CREASE
            )
            corner_facets = corner_facets[smooth]
            neighbours = neighbours[smooth]
            sums = np.zeros_like(self.outward)
            np.add.at(sums, corner_facets, self.outward[neighbours] * self.sizes[neighbours, None])
            normals[:, j] = normalised(sums)
        return normals

    def bulges(self, facets: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Height of the smooth surface above points of flat facets, (m,).

        The smooth surface has the averaged normals at the corners. With corners x and normals n it
        lies (sum w n·x - (sum w n)·(sum w x)) / 2 above the point sum w x, exactly so if its
        curvature is constant. In the middle of an edge of length h whose normals differ by an
        angle, this is h times the angle over 8.

        Args:
            facets: facet of each point, (m,).
            weights: its shape functions there, (m, k).
        """
        corners = self.corners
        normals = self.corner_normals
        heights = normals @ (corners - corners[:, :1]).transpose(0, 2, 1)
        sagittas = np.zeros(len(facets))
        # weights sum to one, so that the linear term is a quadratic form too, without squares
        for i, j in combinations(range(corners.shape[1]), 2):
            form = heights[:, i, i] + heights[:, j, j] - heights[:, i, j] - heights[:, j, i]
            sagittas += form[facets] * weights[:, i] * weights[:, j] / 2
        return sagittas * self.sag_shares()[facets]

    def sag_shares(self) -> np.ndarray:
        """Deviation of facets from the smooth surface over that of flat facets with their normals,
        (f,).
        """
        return (
            np.ones(len(self.facets))
            if self.quadratic is None
            else self.quadratic.sag_shares(self.outward)
        )

    def averaged(self, rows: ContactRows) -> ContactRows:
        """Conditions of single nodes of this slave surface, averaged on facets of second order."""
        return rows if self.quadratic is None else self.quadratic.averaged(self, rows)

    def lengths(self) -> np.ndarray:
        """Length of each facet; in space, the root of its area, (f,)."""
        return self.sizes ** (1 / (self.points.shape[1] - 1))

    def cell_sizes(self) -> np.ndarray:
        """Length of the largest facet at each node, (n,), the scale of distances there."""
        largest = np.zeros(len(self.nodes))
        np.maximum.at(largest, self.facets, self.lengths()[:, None])
        return largest


@dataclass(frozen=True)
class SlaveAndMaster(KnownArguments):
    """Base of pairings of a slave surface with a master surface, by their facet tags."""

    slave: Tag
    master: Tag

    @property
    def tags(self) -> tuple[Tag, ...]:
        """Slave and master."""
        return (self.slave, self.master)


def looking(surface: Surface, normals: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes with a side that looks along a normal, (n,) bool, and the tributary area of that side,
    (n,).

    Sides are groups of facets at a node that meet smoothly: at an edge of a body the mean normal
    looks along none.

    Args:
        surface: the surface of n nodes.
        normals: unit normals, (n, dim), or one for all, (dim,).
        least: cosine above which a side looks along the normal.
    """
    k = surface.facets.shape[1]
    along = np.broadcast_to(normals, surface.points.shape)[surface.facets]
    sides = np.einsum("fkd,fkd->fk", surface.corner_normals, along) > least
    # integrals of the linear functions of a facet over it; the weight of the measure is linear, too
    weights = surface.weights[surface.facets]
    shares = surface.sizes[:, None] * (weights + weights.sum(axis=1, keepdims=True)) / (k + 1)
    nodes = surface.facets.ravel()
    of_nodes = np.bincount(nodes, shares.ravel(), len(surface.nodes))
    of_sides = np.bincount(nodes, (shares * sides).ravel(), len(surface.nodes))
    looks = np.bincount(nodes, sides.ravel(), len(surface.nodes)) > 0
    return looks, surface.areas * np.divide(
        of_sides, of_nodes, out=np.zeros_like(of_nodes), where=of_nodes > 0
    )


def along_normal(surface: Surface, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes with a side that looks along a normal, (m,), and areas of all nodes, (n,).

    Args:
        surface: the surface of n nodes.
        normal: unit normal, (dim,).

    Returns:
        All nodes of a surface that is parallel to the normal.
    """
    looks, areas = looking(surface, normal, GRAZING_NORMAL)
    if not looks.any():
        return np.arange(len(surface.nodes)), surface.areas
    return np.flatnonzero(looks), areas


def touches_of(at_node: csc_matrix, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (position in ``nodes``, facet) for all facets at each node.

    Args:
        at_node: facets by nodes, CSC.
        nodes: the nodes, (m,).
    """
    starts = at_node.indptr[nodes]
    stops = at_node.indptr[nodes + 1]
    counts = stops - starts
    positions = np.repeat(np.arange(len(nodes)), counts)
    offsets = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return positions, at_node.indices[np.repeat(starts, counts) + offsets]


def make_surface(
    tag: Tag,
    facet_nodes: np.ndarray,
    inner_points: np.ndarray,
    points: np.ndarray,
    weights: np.ndarray,
    areas: np.ndarray,
) -> Surface:
    """Make a surface from the nodes of its facets.

    Args:
        tag: facet tag of the surface.
        facet_nodes: nodes of the facets, (f, k), or (f, K) of second order.
        inner_points: middles of the far sides of the cells of the facets, (f, dim), from which
            outer sides and depths follow.
        points: coordinates of all nodes, (nodes, dim).
        weights: weights of the measure at all nodes, (nodes,), such as 2πr.
        areas: tributary areas of all nodes, (nodes,).

    Raises:
        SceneError: for a surface without facets, with facets of no area, or with facets inside the
            mesh.
    """
    if len(facet_nodes) == 0:
        raise SceneError(f"contact surface {tag} has no facets: the contact pair is empty")
    facet_nodes, inner_points, quadratic = _parted(tag, facet_nodes, inner_points, points)
    middles = points[facet_nodes].mean(axis=1)
    nodes, local = np.unique(facet_nodes, return_inverse=True)
    corners = points[facet_nodes]
    vectors = area_vectors(corners)
    sizes = np.linalg.norm(vectors, axis=1)
    # degenerate facets, and those of the size of round-off in the coordinates; NaN counts as no
    # area
    spans = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    power = corners.shape[2] - 1
    flat = ~(sizes > np.maximum(1e-10 * spans**power, (1e-12 * np.nanmax(spans)) ** power))
    if flat.any():
        raise SceneError(
            f"{int(flat.sum())} facets of contact surface {tag} have no area, e.g. at "
            f"{rounded(middles[flat][0])}: mend the mesh there"
        )
    # areas are integrated over outer facets only; of a warped facet ``sizes`` is a little too small
    if (
        areas[np.unique(facet_nodes)].sum()
        < 0.999 * (sizes * weights[facet_nodes].mean(axis=1)).sum()
    ):
        raise SceneError(
            f"contact surface {tag} has facets inside the mesh, around "
            f"{rounded(middles.mean(axis=0))}: tag outer sides only, and give bodies in contact "
            "separate nodes"
        )
    outward = vectors / sizes[:, None]
    heights = np.einsum("ij,ij->i", outward, middles - inner_points)
    outward[heights < 0] *= -1
    if quadratic is not None:  # areas of shape functions of second order are zero at some nodes
        shares = sizes[:, None] * weights[facet_nodes] / facet_nodes.shape[1]
        areas = np.bincount(facet_nodes.ravel(), shares.ravel(), len(points))
    local = local.reshape(facet_nodes.shape)
    measures = outward, sizes, weights[nodes], areas[nodes], np.abs(heights)
    return Surface(tag, nodes, points[nodes], local, *measures, quadratic)


def _parted(
    tag: Tag, facet_nodes: np.ndarray, inner_points: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, QuadraticFacets | None]:
    """Flat facets and an inner point of each, in an order independent of ranks.

    Facets of second order that they form.
    """
    middles = points[facet_nodes].mean(axis=1)
    order = np.lexsort(np.round(middles / (np.ptp(middles, axis=0).max() or 1.0), 9).T[::-1])
    facet_nodes = facet_nodes[order]
    inner_points = inner_points[order]
    if facet_nodes.shape[1] <= 2 * (points.shape[1] - 1):
        return facet_nodes, inner_points, None
    return registry.tool("second_order", f"surface {tag} of cells of second order")(
        facet_nodes, inner_points
    )


def area_vectors(corners: np.ndarray) -> np.ndarray:
    """Normal of each facet times its area, of either sign.

    For a warped quadrilateral the normal of its diagonals.
    """
    if corners.shape[1] == 2:
        along = corners[:, 1] - corners[:, 0]
        return np.column_stack([along[:, 1], -along[:, 0]])
    if corners.shape[1] == 3:
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    return np.cross(corners[:, 3] - corners[:, 0], corners[:, 2] - corners[:, 1]) / 2


def unit(normal: Sequence[float], dim: int) -> np.ndarray:
    """A normal of the user as a unit vector, (dim,).

    Args:
        normal: the normal, of any length.
        dim: number of its components.

    Raises:
        SceneError: for a wrong number of components, zero, or values that are not finite.
    """
    try:
        vector = np.asarray(normal, dtype=float)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    length = np.linalg.norm(vector)
    if vector.shape != (dim,) or not np.isfinite(length) or length == 0:
        raise SceneError(
            f"contact normal {normal!r} must have {dim} numbers, which are not all zero"
        )
    return vector / length


def check_facing(
    surface: Surface, normal: np.ndarray, along: bool, *, upright: bool = False
) -> None:
    """Check that a surface looks along or against the contact normal.

    Args:
        surface: the surface.
        normal: unit normal, (dim,).
        along: True if it must look along the normal, False for against it.
        upright: accept a surface parallel to the normal, as the side of a block on an obstacle.

    Raises:
        SceneError: if no part of the surface looks so.
    """
    towards = surface.outward @ (normal if along else -normal)
    if towards.max() <= GRAZING_NORMAL and (towards.min() < -1e-9 or not upright):
        middle = surface.points.mean(axis=0).tolist()
        raise SceneError(
            f"surface {surface.tag} around {middle} should look {'along' if along else 'against'} "
            f"the contact normal {rounded(normal)} and none of its {towards.size} facets does: "
            "the surfaces do not face each other. Swap the surfaces or the sign of the normal, "
            "which points away from the first surface"
        )


def mean_normal(surface: Surface) -> np.ndarray:
    """Mean outer normal, zero for a closed surface, (dim,)."""
    mean = surface.sizes @ surface.outward
    length = np.linalg.norm(mean)
    return mean / length if length > 1e-9 * surface.sizes.sum() else np.zeros_like(mean)


def warn_of_overlap(surface: Surface, rows: ContactRows) -> None:
    """Warn if conditions of a slave surface overlap by more than a cell: more often a mistake than
    a press fit.

    Args:
        surface: the slave surface.
        rows: its conditions.
    """
    sizes = np.zeros(surface.nodes.max() + 1)
    sizes[surface.nodes] = surface.cell_sizes()
    deep = rows.gap < -sizes[rows.slaves]
    if deep.any():
        worst = int(rows.gap.argmin())
        warn(
            f"the initial overlap at surface {surface.tag} exceeds a cell at {int(deep.sum())} "
            f"places, most ({-rows.gap[worst]:.3g}) at {rounded(rows.points[worst])}: check the "
            "positions and the normal"
        )


def warn(message: str) -> None:
    """Warn of a doubtful pairing."""
    report(message, PairingWarning)


def tangential_order(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Order of rows that does not depend on node numbers: along the tangent, axis by axis.

    Args:
        points: points of the rows, (m, dim).
        normal: unit normal, (dim,).

    Returns:
        Permutation of the rows, (m,).
    """
    tangential = points - np.outer(points @ normal, normal)
    size = np.ptp(points, axis=0).max(initial=0.0) or 1.0
    return np.lexsort(np.round(tangential / size, 9).T[::-1])


def nodal_rows(
    nodes: np.ndarray, normals: np.ndarray, weights: np.ndarray, dofs: int
) -> csr_matrix:
    """Rows sum_k weights_k n·u(nodes_k), (m, N).

    Args:
        nodes: nodes of each row, (m, k).
        normals: unit normal of each row, (m, dim).
        weights: weights of the nodes, (m, k).
        dofs: number of dofs N.
    """
    m, dim = normals.shape
    columns = nodes[:, :, None] * dim + np.arange(dim)
    values = weights[:, :, None] * normals[:, None, :]
    row = np.broadcast_to(np.arange(m)[:, None, None], columns.shape)
    rows = csr_matrix((values.ravel(), (row.ravel(), columns.ravel())), shape=(m, dofs))
    # weights of the size of round-off would tie a row to unrelated nodes
    rows.data[np.abs(rows.data) < 1e-12] = 0.0
    rows.eliminate_zeros()
    return rows


def normalised(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors along the last axis; zero stays zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(lengths > 0, lengths, 1.0)


def shape_functions(local: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Shape functions, (m, k), and slopes, (m, k, 2), of the unit triangle or square.

    Args:
        local: reference coordinates, (m, 2).
        k: 3 for the triangle, 4 for the square in tensor order.
    """
    x, y = local.T
    ones = np.ones_like(x)
    if k == 3:
        values = np.stack([ones - x - y, x, y], axis=1)
        slopes = np.broadcast_to([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]], (len(x), 3, 2))
    else:
        values = np.stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y], axis=1)
        along_x = np.stack([y - 1, 1 - y, -y, y], axis=1)
        along_y = np.stack([x - 1, -x, 1 - x, x], axis=1)
        slopes = np.stack([along_x, along_y], axis=2)
    return values, slopes
