"""Mortar contact on non-matching meshes: weighted gaps integrated over the common parts of both
meshes.

The thesis has conditions of nodes only (chapter 5). Mortar contact transfers a constant pressure
between any pair of meshes, the patch test that node-to-surface fails. Sources: B. Wohlmuth, "A
mortar finite element method using dual spaces for the Lagrange multiplier" (SIAM J. Numer. Anal.
38, 2000), and T. Cichosz and M. Bischoff, "Consistent treatment of boundaries with mortar contact
formulations using dual Lagrange multipliers" (CMAME 200, 2011).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, identity
from scipy.spatial import cKDTree

from hhr_dolfinx.contact.law import LAW, PairLaw
from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.errors import NeverFacingError, SceneError
from hhr_dolfinx.pairings.surface import (
    GRAZING_NORMAL,
    SlaveAndMaster,
    Surface,
    check_facing,
    looking,
    mean_normal,
    normalised,
    tangential_order,
    unit,
    warn_of_overlap,
)
from hhr_dolfinx.plugins.mortar.segments import Segments, common_parts
from hhr_dolfinx.plugins.nonmatching.facing import FACING_DIRECTIONS, opposed
from hhr_dolfinx.plugins.nonmatching.messages import (
    beyond_overlap,
    never_facing,
    warn_beyond_edge,
    warn_of_sag,
    warn_of_tilt,
)
from hhr_dolfinx.plugins.nonmatching.projection import BOX_ENLARGEMENT, pairs_within

COVERED_AREA = 0.1
"""Covered fraction of a node's area below which it has no condition: its gap would be extrapolated
too far.
"""
MULTIPLIERS = ("dual", "standard")


@dataclass(frozen=True)
class Mortar(SlaveAndMaster):
    """Weighted non-penetration of two surfaces.

    ``∫ psi_j (u_s - u_m)·n ds <= ∫ psi_j g ds``, divided by ``∫ psi_j ds``.

    With this scale B has the size of nodal rows, and multipliers are nodal forces. Dual functions
    psi_j are biorthogonal to the shape functions of the slave and tie each row to one slave node;
    standard ones are the shape functions themselves. On cells of second order both are the linear
    functions of their flat parts, see the plug-in ``second_order``.

    Attributes:
        slave: facet tag of the surface that carries the multipliers.
        master: facet tag of the facing surface.
        normal: n from slave to master, along which points are projected; None takes the averaged
            outer normal of the slave at each of its nodes, and projects along the normal of each
            slave facet.
        multipliers: ``dual`` or ``standard``.
        friction: coefficient of Coulomb's law, a number or a formula, or its law; None without. A
            plug-in reads it.
        law: any law of a plug-in in addition to unilateral contact, such as ``Coulomb(0.3)``; None
            without.

    Example:
        >>> pair = hhr.Mortar(slave="shoe", master="disc", friction=hhr.Coulomb(0.3, limit=50.0))
        >>> pair.tags, pair.multipliers
        (('shoe', 'disc'), 'dual')
    """

    normal: tuple[float, ...] | None = None
    multipliers: str = "dual"
    friction: PairLaw | str | float | None = field(default=None, metadata=LAW)
    law: PairLaw | None = field(default=None, metadata=LAW)

    def __post_init__(self) -> None:
        if self.multipliers not in MULTIPLIERS:
            raise SceneError(
                f"multipliers '{self.multipliers}' are unknown, one of {', '.join(MULTIPLIERS)}"
            )
        if not (self.friction is None and self.law is None) and self.multipliers != "dual":
            raise SceneError(
                "a law such as friction is one of each contact for itself, which needs dual "
                "multipliers"
            )

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """One row for each slave node whose surroundings face the master surface.

        Args:
            surfaces: slave and master.
            dofs: number of columns of the rows.
        """
        slave, master = surfaces
        segments, seen = self._faced(slave, master, 0.0)
        rows = self._rows(slave, master, seen, dofs)
        idle = ~np.isin(slave.nodes, rows.slaves)
        if idle.any():
            if self.normal is None:
                count = len(slave.facets)
                area, seen_area = (
                    np.bincount(selection.slave, selection.measures, count)
                    for selection in (segments, seen)
                )
                hidden = np.zeros(len(slave.nodes), dtype=bool)  # in part, by a body between
                hidden[slave.facets[seen_area < area * (1 - BOX_ENLARGEMENT)]] = True
                looks = opposed(slave, master, 0.0).overhanging & ~hidden
            else:
                looks = looking(slave, unit(self.normal, slave.points.shape[1]), GRAZING_NORMAL)[0]
            warn_beyond_edge(slave, master, idle & looks)
        return rows

    def rows_of_deformed(
        self, surfaces: Sequence[Surface], dofs: int, overlap: float
    ) -> ContactRows:
        """Rows of deformed surfaces, as :meth:`rows`.

        Args:
            surfaces: slave and master in their deformed position.
            dofs: number of columns of the rows.
            overlap: length by which the surfaces may overlap beyond a cell.
        """
        slave, master = surfaces
        return self._rows(slave, master, self._faced(slave, master, overlap)[1], dofs)

    def _faced(self, slave: Surface, master: Surface, overlap: float) -> tuple[Segments, Segments]:
        """Common parts of opposite facets, and the ones among them that can touch.

        No body lies between these.
        """
        dim = slave.points.shape[1]
        if self.normal is None:
            directions = slave.outward
            cosine = FACING_DIRECTIONS
            reach = 3.0 * cKDTree(master.points).query(slave.points)[0].max()
            pairs = _near_pairs(slave.corners, master.corners, reach)
        else:
            normal = unit(self.normal, dim)
            cosine = GRAZING_NORMAL
            check_facing(slave, normal, along=True)
            for surface in (slave, master):
                warn_of_tilt(surface, normal)
            directions = np.tile(normal, (len(slave.facets), 1))
            # projected along the normal the surfaces are flat, and facets that face each other
            # overlap
            flat = np.eye(dim) - np.outer(normal, normal)
            pairs = _near_pairs(slave.corners @ flat, master.corners @ flat, 0.0)
        slave_facets, master_facets = pairs
        # the slave looks along its direction of projection, and the master against it
        opposite = (
            np.einsum("pd,pd->p", directions[slave_facets], master.outward[master_facets]) < -cosine
        )
        opposite &= (
            np.einsum("pd,pd->p", directions[slave_facets], slave.outward[slave_facets]) > cosine
        )
        pairs = _overlapping(
            slave, master, directions, slave_facets[opposite], master_facets[opposite]
        )
        segments = common_parts(slave, master, directions, *pairs)
        if not segments.measures.size:
            raise NeverFacingError(
                never_facing(slave, master, "no facet of one lies in front of a facet of the other")
            )
        seen = (
            segments
            if self.normal is not None
            else _meeting(slave, master, segments, reach, overlap)
        )
        _check_one_layer(slave, master, seen)
        return segments, seen

    def _rows(self, slave: Surface, master: Surface, segments: Segments, dofs: int) -> ContactRows:
        """Integrate over the segments and divide by the weight of each multiplier function."""
        dual = self.multipliers == "dual" and slave.quadratic is None
        n = len(slave.nodes)
        tests = _Side(slave.facets, segments.slave, segments.slave_values)
        on_slave = _displaced(slave, tests)
        on_master = _displaced(
            master, _Side(master.facets, segments.master, segments.master_values)
        )
        functions = _dual_functions(slave, segments) if dual else tests.values
        tested = functions * segments.measures[:, None]
        by_facet = _summed(tested, segments.slave, len(slave.facets))
        area = np.bincount(slave.facets.ravel(), by_facet.ravel(), n)
        if self.normal is None:
            # averaged over the parts that face the master: at a corner only one side does
            normals = np.zeros_like(slave.points)
            np.add.at(normals, slave.facets, by_facet[:, :, None] * slave.outward[:, None, :])
            normals = normalised(normals)
            least = FACING_DIRECTIONS
        else:
            normals = np.tile(unit(self.normal, slave.points.shape[1]), (n, 1))
            least = GRAZING_NORMAL
        # of a node on an edge only the side that looks at the master can be covered
        covered = area > COVERED_AREA * looking(slave, normals, least)[1]
        shared = None
        if slave.quadratic is not None and covered.any():
            shared = slave.quadratic.shared(slave, normals, np.flatnonzero(covered))
            area = shared @ np.where(covered, area, 0.0)
            covered = area > 0
        if not covered.any():
            raise NeverFacingError(
                never_facing(slave, master, "no slave node is covered by the master")
            )
        scale = diags(1 / np.where(covered, area, 1.0))
        # dual functions are biorthogonal to the shape functions of the slave
        onto_slave = (
            identity(n)
            if dual
            else scale @ _shared(shared, _assemble(tests, tested, on_slave, (n, n)))
        )
        onto_master = scale @ _shared(
            shared, _assemble(tests, tested, on_master, (n, len(master.nodes)))
        )
        gap = np.einsum(
            "md,md->m", onto_master @ master.points - onto_slave @ slave.points, normals
        )
        matrix = _along_normals(onto_slave, slave.nodes, normals, dofs)
        matrix = matrix - _along_normals(onto_master, master.nodes, normals, dofs)
        conditions = np.flatnonzero(covered)
        conditions = conditions[tangential_order(slave.points[conditions], mean_normal(slave))]
        rows = ContactRows(csr_matrix(matrix), gap, slave.nodes, slave.points, area).take(
            conditions
        )
        warn_of_overlap(slave, rows)
        bulges = slave.bulges(segments.slave, segments.slave_values)
        bulges = bulges + master.bulges(segments.master, segments.master_values)
        warn_of_sag(
            slave, master, rows, float(np.abs(bulges) @ segments.measures / segments.measures.sum())
        )
        return rows


def _check_one_layer(slave: Surface, master: Surface, segments: Segments) -> None:
    """Raise SceneError for slave facets that are covered more than once."""
    covered = np.bincount(segments.slave, segments.measures, len(slave.facets))
    areas = slave.sizes * slave.weights[slave.facets].mean(axis=1)
    # a facet on the axis of symmetry has no area
    times = np.divide(covered, areas, out=np.zeros(len(areas)), where=areas > 0)
    if times.max() > 1.05:
        centre = slave.corners[times.argmax()].mean(axis=0).tolist()
        raise SceneError(
            f"several layers of master surface {master.tag} face slave surface {slave.tag} at "
            f"{centre}: give each layer its own tag and contact pair"
        )


def _overlapping(
    slave: Surface, master: Surface, directions: np.ndarray, here: np.ndarray, there: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs whose enclosing circles overlap along the direction of the slave facet."""
    middles = [surface.corners.mean(axis=1) for surface in (slave, master)]
    radii = [
        np.linalg.norm(surface.corners - middle[:, None], axis=2).max(axis=1)
        for surface, middle in zip((slave, master), middles, strict=True)
    ]
    between = middles[1][there] - middles[0][here]
    along = np.einsum("pd,pd->p", between, directions[here])
    across = np.linalg.norm(between - along[:, None] * directions[here], axis=1)
    close = across <= (radii[0][here] + radii[1][there]) * (1 + 1e-9)
    return here[close], there[close]


def _meeting(
    slave: Surface, master: Surface, segments: Segments, reach: float, overlap: float
) -> Segments:
    """Drop segments of opposite facets that cannot touch, because a body lies between.

    A back side lies behind its partner by the thickness of both bodies, and a body is no thinner
    than a cell of it. A facet in front is hidden if another part of the slave's body lies before
    it. Deformed bodies may overlap by the length ``overlap`` more than a cell.
    """
    distance = _distances(slave, master, segments)
    # sides of equal blocks of one cell lie a cell behind each other, to round-off
    deepest = np.maximum(slave.depths[segments.slave], master.depths[segments.master]) * (
        1 - BOX_ENLARGEMENT
    )
    back_sides = distance < -deepest - overlap
    if back_sides.all():
        raise NeverFacingError(never_facing(slave, master, beyond_overlap(-distance.min())))
    # a body can only lie between if there is room for it
    roomy = np.unique(segments.slave[distance > slave.depths[segments.slave]])
    seen = ~back_sides & (distance <= _own_body(slave, roomy, reach)[segments.slave])
    return Segments(*(array[seen] for array in segments))


def _own_body(slave: Surface, facets: np.ndarray, reach: float) -> np.ndarray:
    """Distance of some slave facets to the next part of the same body, else infinite, (f,).

    It is that along the normals.
    """
    nearest = np.full(len(slave.facets), np.inf)
    if facets.size:
        facet, opposite = _near_pairs(slave.corners[facets], slave.corners, reach)
        facet, opposite = _overlapping(slave, slave, slave.outward, facets[facet], opposite)
        alike = (
            np.einsum("pd,pd->p", slave.outward[facet], slave.outward[opposite]) > FACING_DIRECTIONS
        )
        along = np.einsum(
            "pd,pd->p",
            (slave.corners[opposite] - slave.corners[facet]).mean(axis=1),
            slave.outward[facet],
        )
        way = alike & (along > slave.depths[facet])
        segments = common_parts(slave, slave, slave.outward, facet[way], opposite[way])
        np.minimum.at(nearest, segments.slave, _distances(slave, slave, segments))
    return nearest


def _distances(slave: Surface, master: Surface, segments: Segments) -> np.ndarray:
    """Distance from slave to master along the normal of the slave facet, (q,).

    There is one for each quadrature point.
    """
    pairs, of_point = _pairs(len(master.facets), segments.slave, segments.master)
    slave_facets, master_facets = np.divmod(pairs, len(master.facets))
    normals = slave.outward[slave_facets][:, :, None]
    lows = (slave.corners[slave_facets] @ normals)[:, :, 0]
    highs = (master.corners[master_facets] @ normals)[:, :, 0]
    return (segments.master_values * highs[of_point] - segments.slave_values * lows[of_point]).sum(
        axis=1
    )


class _Side(NamedTuple):
    """Functions of one surface at quadrature points.

    Nodes of its facets, (f, k), facet, (q,), and values, (q, k).
    """

    facets: np.ndarray
    facet: np.ndarray
    values: np.ndarray


def _displaced(surface: Surface, flat: _Side) -> _Side:
    """Functions of the displacement at the points of flat functions.

    They are these, or those of second order.
    """
    if surface.quadratic is None:
        return flat
    return _Side(surface.quadratic.nodes, *surface.quadratic.functions(flat.facet, flat.values))


def _pairs(facets: int, here: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of facets as one number each, and the pair of each point, (q,).

    The number is ``here * facets of the other surface + there``.

    Points of one pair follow each other in few runs; each run counts as a pair.
    """
    keys = here * facets + there
    begins = np.flatnonzero(np.diff(keys, prepend=-1))
    return keys[begins], np.repeat(np.arange(begins.size), np.diff(begins, append=keys.size))


def _dual_functions(slave: Surface, segments: Segments) -> np.ndarray:
    """Functions biorthogonal to the shape functions on the covered part of facets, (q, k)."""
    count, k = slave.facets.shape
    values = segments.slave_values
    weighted = values * segments.measures[:, None]
    mass = _summed(
        (weighted[:, :, None] * values[:, None, :]).reshape(-1, k * k), segments.slave, count
    )
    diagonal = _summed(weighted, segments.slave, count)
    # facets that are hardly covered have a nearly singular mass matrix
    inverse = np.linalg.pinv(mass.reshape(count, k, k), rcond=1e-12, hermitian=True)
    coefficients = diagonal[:, :, None] * inverse
    functions = np.zeros_like(values)
    for column, value in zip(coefficients.transpose(2, 0, 1), values.T, strict=True):
        functions += np.ascontiguousarray(column)[segments.slave] * value[:, None]
    return functions


def _assemble(tests: _Side, tested: np.ndarray, other: _Side, shape: tuple[int, int]) -> csr_matrix:
    """Sums of tested_j values_k over all quadrature points, (nodes, nodes of the other surface)."""
    pairs, of_point = _pairs(len(other.facets), tests.facet, other.facet)
    k = tested.shape[1]
    l = other.values.shape[1]
    entries = _summed(
        (tested[:, :, None] * other.values[:, None, :]).reshape(-1, k * l), of_point, len(pairs)
    )
    rows = np.repeat(tests.facets[pairs // len(other.facets)], l, axis=1)
    columns = np.tile(other.facets[pairs % len(other.facets)], k)
    return csr_matrix((entries.ravel(), (rows.ravel(), columns.ravel())), shape=shape)


def _shared(shared: csr_matrix | None, assembled: csr_matrix) -> csr_matrix:
    """Integrals with the multiplier functions of :meth:`QuadraticFacets.shared`.

    Unchanged if none are shared out.
    """
    return assembled if shared is None else csr_matrix(shared @ assembled)


def _summed(values: np.ndarray, places: np.ndarray, count: int) -> np.ndarray:
    """Sums of the rows of ``values``, (q, r), with the same index, (count, r).

    The indices are ``places``, (q,).
    """
    ones = np.ones(len(places))
    starts = np.arange(len(places) + 1)
    return csc_matrix((ones, places, starts), shape=(count, len(places))) @ values


def _along_normals(
    weights: csr_matrix, nodes: np.ndarray, normals: np.ndarray, dofs: int
) -> csr_matrix:
    """Rows sum_k weights_jk n_j·u(nodes_k), (m, N)."""
    coo = weights.tocoo()
    # entries that biorthogonal functions leave by round-off would tie a row to more than one slave
    # node
    keep = np.abs(coo.data) > 1e-12
    row = coo.row[keep]
    node = nodes[coo.col[keep]]
    value = coo.data[keep]
    dim = normals.shape[1]
    columns = node[:, None] * dim + np.arange(dim)
    entries = value[:, None] * normals[row]
    rows = csr_matrix(
        (entries.ravel(), (np.repeat(row, dim), columns.ravel())), shape=(weights.shape[0], dofs)
    )
    rows.data[np.abs(rows.data) < 1e-14] = 0.0
    rows.eliminate_zeros()
    return rows


def _near_pairs(
    first: np.ndarray, second: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of facets, (p,) each, whose bounding boxes meet.

    Those of the first are enlarged by the length ``reach``.

    Facets are given by their corners, (f, k, dim) and (g, l, dim).
    """
    boxes = [(corners.min(axis=1), corners.max(axis=1)) for corners in (first, second)]
    (middle, half), (other_middle, other_half) = (
        ((low + high) / 2, (high - low) / 2) for low, high in boxes
    )
    half = (
        half
        + reach
        + BOX_ENLARGEMENT * max(np.ptp(first, axis=(0, 1)).max(), np.ptp(second, axis=(0, 1)).max())
    )
    index_first, index_second = pairs_within(
        cKDTree(other_middle), middle, (half + other_half.max(axis=0)).max(axis=1), np.inf
    )
    meet = (
        np.abs(middle[index_first] - other_middle[index_second])
        <= half[index_first] + other_half[index_second]
    ).all(axis=1)
    return index_first[meet], index_second[meet]
