"""Contact surfaces as arrays, and the operations on them that all pairings need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, Annotated

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, identity

from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.declared import Booleans, Floats, Integers
from hhr_dolfinx.errors import PairingWarning, SceneError
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.warn import warn as report

if TYPE_CHECKING:
    from hhr_dolfinx.pairings.second_order import QuadraticFacets

CREASE = np.cos(np.deg2rad(40.0))
"""Facets that meet at more than 40 degrees form an edge; normals are not averaged across it."""

FLAT = 0.95
"""Length of the mean of unit normals above which a surface is flat: an arc of 60 degrees has 0.955."""
TILT = 30.0
"""Degrees between a given normal and that of a flat surface above which a warning is due."""
FACING = 0.1
"""Cosine between two directions found from the meshes below which surfaces do not face each other."""
GRAZING = 1e-3
"""Cosine as FACING, for a normal given by the user: a half-disc may be tagged up to where the normal is tangential."""
LEAST_SAG = 1e-9
LEAST_SAG_OF_CURVES = 1e-4
"""Fractions of the size of a surface below which a sag counts as zero, of chords and of parabolas."""
STRAIGHT = 1e-6
"""Angle between the flat parts of a facet of second order below which its sides are straight."""
CURVED = 1e-4
"""Mean sag of straight sides, in lengths of a flat part, below which a surface is flat: sides meet at 0.1 degrees."""
ALIKE = 0.1
"""Sum of the sags of two surfaces over the larger one, below which they are curved alike."""
SAG = 0.13
"""Mean sag of facets over the mean gap above which the mesh makes the gap. The mean pressure of a press fit of rings
was off by 8 to 13 % at 0.14, by 30 to 34 % at 1.9 (by 100 % at single nodes), by 5 % at most below 0.13."""


@dataclass(frozen=True)
class Surface:
    """A tagged surface of n nodes and f facets of k nodes each: 2 in the plane, 3 or 4 in space."""

    tag: Tag  # facet tag, for messages
    nodes: Annotated[Integers, "surface nodes"]  # node numbers in the mesh, (n,)
    points: Annotated[Floats, "surface nodes", "dimension"]  # coordinates of the nodes, (n, dim)
    # nodes of each facet, counted within the surface, (f, k); quadrilaterals in tensor order
    facets: Annotated[Integers, "facets", "corners", "< surface nodes"]
    # outward, sizes: unit outer normal of each facet, (f, dim), and its length or area without weight, (f,)
    outward: Annotated[Floats, "facets", "dimension"]
    sizes: Annotated[Floats, "facets"]
    weights: Annotated[Floats, "surface nodes"]  # weight of the surface measure at each node, 1 or 2 pi r, (n,)
    areas: Annotated[Floats, "surface nodes"]  # tributary area of each node, (n,)
    depths: Annotated[Floats, "facets"]  # depth of the cell behind each facet, (f,): no body is thinner
    # facets of second order, of which ``facets`` are the flat parts; None for cells of first order
    quadratic: QuadraticFacets | None = None
    # components of the displacement of the nodes that are not imposed, (n, dim) bool; None if all are free
    free: Annotated[Booleans, "surface nodes", "dimension"] | None = None

    @property
    def corners(self) -> np.ndarray:
        """Coordinates of the nodes of each facet, (f, k, dim)."""
        return self.points[self.facets]

    @cached_property
    def corner_normals(self) -> np.ndarray:
        """Unit outer normals at the corners of each facet, (f, k, dim), averaged up to edges of the surface."""
        count, k = self.facets.shape
        pairs = np.repeat(np.arange(count), k), self.facets.ravel()
        at_node = csr_matrix((np.ones(count * k), pairs), shape=(count, len(self.nodes))).tocsc()
        normals = np.empty((count, k, self.points.shape[1]))
        for j in range(k):
            here, other = touches_of(at_node, self.facets[:, j])
            smooth = np.einsum("ij,ij->i", self.outward[here], self.outward[other]) >= CREASE
            here = here[smooth]
            other = other[smooth]
            sums = np.zeros_like(self.outward)
            np.add.at(sums, here, self.outward[other] * self.sizes[other, None])
            normals[:, j] = normalised(sums)
        return normals

    def bulges(self, facets: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Height of the smooth surface above points of flat facets, (m,), by their shape functions, (m, k).

        The smooth surface has the averaged normals at the corners. With corners x and normals n it lies
        (sum w n·x - (sum w n)·(sum w x)) / 2 above the point sum w x, exactly so if its curvature is constant. In the
        middle of an edge of length h whose normals differ by an angle, this is h times the angle over 8.
        """
        corners = self.corners
        normals = self.corner_normals
        heights = normals @ (corners - corners[:, :1]).transpose(0, 2, 1)
        found = np.zeros(len(facets))
        # weights sum to one, so that the linear term is a quadratic form too, without squares
        for i, j in combinations(range(corners.shape[1]), 2):
            form = heights[:, i, i] + heights[:, j, j] - heights[:, i, j] - heights[:, j, i]
            found += form[facets] * weights[:, i] * weights[:, j] / 2
        return found * self.sag_shares()[facets]

    def sag_shares(self) -> np.ndarray:
        """Deviation of facets from the smooth surface over that of flat facets with their normals, (f,); 1 at order 1.

        Flat parts of a facet of second order with straight sides deviate four times as much: each is half of it. Curved
        sides are parabolas, which deviate from an arc by the square of the angle between the parts.
        """
        if self.quadratic is None:
            return np.ones(len(self.facets))
        parts = self.outward.reshape(-1, self.quadratic.parts, self.outward.shape[1])
        cosines = np.einsum("fpd,fqd->fpq", parts, parts).min(axis=(1, 2))
        angles = np.repeat(np.arccos(np.clip(cosines, -1.0, 1.0)), self.quadratic.parts)
        return np.where(angles < STRAIGHT, 4.0, angles**2)

    def displaced(self, facets: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes of the functions of the displacement, and their values, (m, K) each, at points of facets, (m, k).

        On facets of second order these functions are not those of the flat parts on which the points were found.
        """
        if self.quadratic is None:
            return self.facets[facets], weights
        whole, values = self.quadratic.functions(facets, weights)
        return self.quadratic.nodes[whole], values

    def averaged(self, rows: ContactRows) -> ContactRows:
        """Average conditions of single nodes of this slave surface, on facets of second order alone.

        Nodes beyond the edge of a master have no condition. A facet that lies there in part contributes the flat parts
        with conditions at all nodes, as facets of first order. See :mod:`hhr_dolfinx.pairings.second_order`.
        """
        if self.quadratic is None:
            return rows
        place = np.full(len(self.nodes), -1)
        place[np.searchsorted(self.nodes, rows.slaves)] = np.arange(rows.gap.size)
        integrals = self.quadratic.integrals(self.points, self.weights, place >= 0)
        nodes = np.flatnonzero(np.diff(integrals.indptr))
        if not nodes.size:
            raise SceneError(
                f"no part of a facet of slave surface {self.tag} lies in front of its master with all of its nodes: "
                "mesh it finer"
            )
        nodes = nodes[np.argsort(place[nodes])]
        normals = np.zeros_like(self.points)
        own = rows.matrix.tocoo()
        at_slave = own.col // self.points.shape[1] == rows.slaves[own.row]
        slaves = np.searchsorted(self.nodes, rows.slaves)
        normals[slaves[own.row[at_slave]], own.col[at_slave] % self.points.shape[1]] = own.data[at_slave]
        shared = self.shared(normals, nodes)
        tested = csr_matrix(shared @ integrals)
        nodes = nodes[np.diff(csr_matrix(shared).indptr)[nodes] > 0]
        mixed = tested[nodes].tocoo()
        areas = np.bincount(mixed.row, mixed.data, nodes.size)
        shape = nodes.size, rows.gap.size
        means = csr_matrix((mixed.data / areas[mixed.row], (mixed.row, place[mixed.col])), shape=shape)
        matrix = csr_matrix(means @ rows.matrix)
        return ContactRows(matrix, means @ rows.gap, self.nodes[nodes], self.points[nodes], areas)

    def shared(self, normals: np.ndarray, nodes: np.ndarray) -> csr_matrix:
        """Matrix that shares the functions psi_j of nodes with imposed displacements among their neighbours, (n, n).

        With one function for each node conditions would be dependent if some displacements are imposed, as at the end
        of a mortar surface. The matrix is the identity if all ``nodes`` with conditions are free, or none is.
        """
        count = len(self.nodes)
        held = np.zeros(count, dtype=bool)
        if self.free is not None:
            held[nodes] = ~(np.abs(normals) * self.free > 0).any(axis=1)[nodes]
        if not held.any() or held[nodes].all():
            return identity(count, format="csr")
        moving = np.zeros(count)
        moving[nodes] = ~held[nodes]
        k = self.facets.shape[1]
        places = np.repeat(self.facets, k, axis=1).ravel(), np.tile(self.facets, k).ravel()
        beside = csr_matrix((np.ones(self.facets.size * k), places), shape=(count, count))
        beside.data[:] = 1.0
        towards = diags(moving) @ beside @ diags(held.astype(float))
        share = np.asarray(towards.sum(axis=0)).ravel()
        return csr_matrix(diags(moving) + towards @ diags(1 / np.where(share > 0, share, 1.0)))

    def node_depths(self) -> np.ndarray:
        """Smallest depth of the facets at each node, (n,)."""
        smallest = np.full(len(self.nodes), np.inf)
        np.minimum.at(smallest, self.facets, self.depths[:, None])
        return smallest

    def lengths(self) -> np.ndarray:
        """Length of each facet; in space, the root of its area, (f,)."""
        return self.sizes ** (1 / (self.points.shape[1] - 1))

    def cell_sizes(self) -> np.ndarray:
        """Length of the largest facet at each node, (n,), the scale of distances there."""
        largest = np.zeros(len(self.nodes))
        np.maximum.at(largest, self.facets, self.lengths()[:, None])
        return largest


def touches_of(at_node: csc_matrix, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (position in ``nodes``, facet) for all facets at each node; ``at_node`` is facets by nodes, CSC."""
    starts = at_node.indptr[nodes]
    stops = at_node.indptr[nodes + 1]
    counts = stops - starts
    here = np.repeat(np.arange(len(nodes)), counts)
    offsets = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return here, at_node.indices[np.repeat(starts, counts) + offsets]


def make_surface(
    tag: Tag,
    facet_nodes: np.ndarray,
    inner_points: np.ndarray,
    points: np.ndarray,
    weights: np.ndarray,
    areas: np.ndarray,
) -> Surface:
    """Make a surface from the nodes of its facets, (f, k) or (f, K), with points, weights and areas of all nodes.

    ``inner_points`` are the middles of the far sides of the cells behind the facets, (f, dim), from which outer sides
    and depths follow.
    """
    if len(facet_nodes) == 0:
        raise SceneError(f"contact surface {tag} has no facets: the contact pair is empty")
    facet_nodes, inner_points, quadratic = _parted(facet_nodes, inner_points, points)
    middles = points[facet_nodes].mean(axis=1)
    nodes, local = np.unique(facet_nodes, return_inverse=True)
    corners = points[facet_nodes]
    vectors = area_vectors(corners)
    sizes = np.linalg.norm(vectors, axis=1)
    flat = _without_area(corners, sizes)
    if flat.any():
        raise SceneError(
            f"{int(flat.sum())} facets of contact surface {tag} have no area, e.g. at {middles[flat][0].tolist()}: "
            "mend the mesh there"
        )
    # areas are integrated over outer facets only; of a warped facet ``sizes`` is a little too small
    if areas[np.unique(facet_nodes)].sum() < 0.999 * (sizes * weights[facet_nodes].mean(axis=1)).sum():
        raise SceneError(
            f"contact surface {tag} has facets inside the mesh, around {middles.mean(axis=0).tolist()}: tag outer "
            "sides only, and give bodies in contact nodes of their own"
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
    facet_nodes: np.ndarray, inner_points: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, QuadraticFacets | None]:
    """Flat facets and a point behind each, in an order independent of ranks; facets of second order that they form."""
    middles = points[facet_nodes].mean(axis=1)
    order = np.lexsort(np.round(middles / (np.ptp(middles, axis=0).max() or 1.0), 9).T[::-1])
    facet_nodes = facet_nodes[order]
    inner_points = inner_points[order]
    if facet_nodes.shape[1] <= 2 * (points.shape[1] - 1):
        return facet_nodes, inner_points, None
    from hhr_dolfinx.pairings.second_order import QuadraticFacets, flat_parts

    flat = flat_parts(facet_nodes)
    quadratic = QuadraticFacets(np.searchsorted(np.unique(facet_nodes), facet_nodes))
    return flat, np.repeat(inner_points, len(flat) // len(facet_nodes), axis=0), quadratic


def area_vectors(corners: np.ndarray) -> np.ndarray:
    """Normal of each facet times its area, of either sign; for a warped quadrilateral the normal of its diagonals."""
    if corners.shape[1] == 2:
        along = corners[:, 1] - corners[:, 0]
        return np.column_stack([along[:, 1], -along[:, 0]])
    if corners.shape[1] == 3:
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    return np.cross(corners[:, 3] - corners[:, 0], corners[:, 2] - corners[:, 1]) / 2


def _without_area(corners: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Facets of no area: degenerate ones, and those of the size of round-off in the coordinates, (f,) bool."""
    spans = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    power = corners.shape[2] - 1
    # NaN counts as no area
    return ~(sizes > np.maximum(1e-10 * spans**power, (1e-12 * np.nanmax(spans)) ** power))


def unit(normal: Sequence[float], dim: int) -> np.ndarray:
    """A normal given by the user as a unit vector; SceneError for a wrong length, zero, or non-finite values."""
    try:
        vector = np.asarray(normal, dtype=float)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    length = np.linalg.norm(vector)
    if vector.shape != (dim,) or not np.isfinite(length) or length == 0:
        raise SceneError(f"contact normal {normal!r} must be a non-zero vector of length {dim}")
    return vector / length


def check_facing(surface: Surface, normal: np.ndarray, along: bool, *, upright: bool = False) -> None:
    """Raise SceneError if no part of a surface looks along the contact normal, or against it without ``along``.

    A surface parallel to the normal, as the side of a block on an obstacle, passes only if ``upright`` is set.
    """
    towards = surface.outward @ (normal if along else -normal)
    if towards.max() <= GRAZING and (towards.min() < -1e-9 or not upright):
        middle = surface.points.mean(axis=0).tolist()
        raise SceneError(
            f"surface {surface.tag} around {middle} should look {'along' if along else 'against'} the contact normal "
            f"{normal.tolist()} and none of its {towards.size} facets does: the surfaces do not face each other. "
            "Swap the surfaces or the sign of the normal, which points away from the first surface"
        )


def warn_of_tilt(surface: Surface, normal: np.ndarray) -> None:
    """Warn if a flat surface looks neither along nor against a unit normal; one parallel to it is refused later."""
    mean = surface.sizes @ surface.outward / surface.sizes.sum()
    length = np.linalg.norm(mean)
    cosine = abs(mean @ normal) / length if length > 0 else 1.0
    if length > FLAT and GRAZING < cosine < np.cos(np.deg2rad(TILT)):
        warn(
            f"the contact normal {normal.tolist()} is {np.rad2deg(np.arccos(cosine)):.0f} degrees off that of the flat "
            f"surface {surface.tag}, {np.round(mean / length, 3).tolist()}: gaps and forces are along the normal that "
            "is given. Leave it out to take that of the surface"
        )


def mean_normal(surface: Surface) -> np.ndarray:
    """Mean outer normal, zero for a closed surface, (dim,)."""
    mean = surface.sizes @ surface.outward
    length = np.linalg.norm(mean)
    return mean / length if length > 1e-9 * surface.sizes.sum() else np.zeros_like(mean)


def never_facing(slave: Surface, master: Surface, why: str) -> str:
    """Message for surfaces without a common part."""
    return (
        f"surfaces {slave.tag} and {master.tag} never face each other: {why}; slave around "
        f"{slave.points.mean(axis=0).tolist()}, master around {master.points.mean(axis=0).tolist()}. "
        "Check the tags, the normal (from slave to master) and that outer sides are tagged"
    )


def warn_of_overlap(surface: Surface, rows: ContactRows) -> None:
    """Warn if conditions of a slave surface overlap by more than a cell: more often a mistake than a press fit."""
    sizes = np.zeros(surface.nodes.max() + 1)
    sizes[surface.nodes] = surface.cell_sizes()
    deep = rows.gap < -sizes[rows.slaves]
    if deep.any():
        worst = int(rows.gap.argmin())
        warn(
            f"the initial overlap at surface {surface.tag} exceeds a cell at {int(deep.sum())} places, most "
            f"({-rows.gap[worst]:.3g}) at {rows.points[worst].tolist()}: check the positions and the normal"
        )


def warn_of_sag(slave: Surface, master: Surface, rows: ContactRows, sag: float) -> None:
    """Warn if the mesh makes the gap, by the mean of :meth:`Surface.bulges` over the parts that face each other."""
    gap = float(rows.areas @ np.abs(rows.gap) / rows.areas.sum())
    least = LEAST_SAG if slave.quadratic is None else LEAST_SAG_OF_CURVES
    if sag > SAG * gap and sag > least * np.ptp(slave.points):
        warn(
            f"the gap of surfaces {slave.tag} and {master.tag} is {gap:.3g} on average, and their flat facets are off "
            f"the curved surfaces they stand for by {sag:.3g} on average: the gap is one of the mesh. Mesh both finer, "
            "until the sag of a facet, its length times its angle to the next one over 8, is far below the gap, or "
            "mesh both alike, node to node"
        )


def warn_of_straight_sides(surfaces: Sequence[Surface]) -> None:
    """Warn of a curved surface with straight sides at second order; sags of surfaces curved alike cancel in the gap."""
    sags = [_straight_sag(surface) for surface in surfaces]
    place = int(np.abs(sags).argmax())
    worst = surfaces[place]
    largest = abs(sags[place])
    if largest < CURVED * worst.lengths().mean() or abs(sum(sags)) < ALIKE * largest:
        return
    warn(
        f"displacements are of second order and the sides of surface {worst.tag} are straight, though it is curved: "
        f"between corners its gap is that of chords, {largest:.2g} off on average, and pressures alternate from "
        "node to node. Mesh it with cells of second order, whose sides are curved (gmsh: setOrder(2)), or take "
        "displacements of first order, Scene(order=1)"
    )


def _straight_sag(surface: Surface) -> float:
    """Mean height of the curved surface above its flat parts if sides of second order are straight; else 0."""
    if surface.quadratic is None or (surface.sag_shares() != 4.0).any():
        return 0.0
    count, k = surface.facets.shape
    bulges = surface.bulges(np.arange(count), np.full((count, k), 1 / k))
    return float(bulges @ surface.sizes / surface.sizes.sum())


def warn_beyond_edge(slave: Surface, master: Surface, lost: np.ndarray, advice: str = "") -> None:
    """Warn of slave nodes, a mask ``lost``, that look past the edge of the master and get no condition."""
    if lost.any():
        warn(
            f"{int(lost.sum())} of {lost.size} nodes of slave surface {slave.tag} lie beyond the edge of master "
            f"surface {master.tag} and get no contact condition, e.g. at {slave.points[lost][0].tolist()}{advice}"
        )


def beyond_overlap(deepest: float) -> str:
    """Reason for :func:`never_facing` if surfaces lie behind each other."""
    return (
        f"one lies behind the other by up to {deepest:.3g}, more than a cell, as back sides do. Where bodies are meant "
        "to overlap so deeply, give the contact a normal, or mesh them apart and overlap them by an Opening"
    )


def warn(message: str) -> None:
    """Warn of a doubtful pairing."""
    report(message, PairingWarning, stacklevel=2)


def tangential_order(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Order of rows that does not depend on node numbers: along the tangent, axis by axis."""
    tangential = points - np.outer(points @ normal, normal)
    size = np.ptp(points, axis=0).max(initial=0.0) or 1.0
    return np.lexsort(np.round(tangential / size, 9).T[::-1])


def nodal_rows(nodes: np.ndarray, normals: np.ndarray, weights: np.ndarray, dofs: int) -> csr_matrix:
    """Rows sum_k weights_k n·u(nodes_k), (m, N), for nodes and weights, (m, k), and the normal of each, (m, dim)."""
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
