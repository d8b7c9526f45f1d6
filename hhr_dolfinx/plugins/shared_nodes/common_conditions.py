"""Conditions that several contacts state together: one row with the sum of their areas.

Two contacts whose surfaces share a node each state its condition, on the part of its area that is
theirs. The contact force of the node is one unknown, so the condition is one too: a multiplier
function is the sum of its parts on both surfaces, as if they had one tag (B. Wohlmuth, SIAM J.
Numer. Anal. 38, 2000, for mortar contact). Conditions are one

* if their rows of B T are the same, as of nodes that face each other in two contacts, or that a tie
  makes one;
* if their slave nodes are one, their normals too, and they touch the same body, which a mortar row
  of each part averages in another way.

Conditions on two bodies stay two, and so do those on planes with different normals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.prolongation import Prolongation
from hhr_dolfinx.contact.rows import ContactRows, normals_of
from hhr_dolfinx.contact.shares import Shares
from hhr_dolfinx.errors import SceneError, rounded
from hhr_dolfinx.full_order.free_bodies import components_of_nodes
from hhr_dolfinx.pairings.surface import CREASE, GRAZING_NORMAL, Surface, looking
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.scene import Scene

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.discretisation import Discretisation

COMMON_CONDITION = 1e-6
"""Distance of gaps over the size of the mesh, and of rows of B T over theirs, up to which
conditions are the same.
"""
GROUND = -1
"""Number that stands for obstacles, which are no body."""
OPENING_SAMPLES = 8
"""Random points of the box at which openings of two contacts are compared."""


@dataclass(frozen=True)
class Conditions:
    """Conditions of all contacts of a scene, before contacts share any."""

    scene: Scene
    rows: ContactRows
    pairs: np.ndarray  #: contact of each condition, (m,)
    opened: np.ndarray  #: gaps that openings and moving obstacles add, by term, (m, 1 + T)


def joined(
    discretisation: Discretisation,
    stated: tuple[ContactRows, np.ndarray, np.ndarray],
    prolongation: Prolongation,
    amplitudes: Amplitudes,
    nodes: np.ndarray,
) -> tuple[ContactRows, np.ndarray, np.ndarray, Shares | None]:
    """Join conditions of several contacts on the same nodes: the tool ``shared_nodes``.

    Args:
        discretisation: the discretisation.
        stated: the rows, the contact of each, (m,), and the gaps that openings add, (m, 1 + T).
        prolongation: displacement of all dofs from that of the free ones.
        amplitudes: θ as a function of the parameters.
        nodes: nodes on which several contacts act, (n,).

    Returns:
        The joined rows, contacts and gaps, and the shares of contacts; None if no condition belongs
        to several.

    Raises:
        SceneError: for contacts whose laws or openings differ on a common condition.
    """
    conditions = Conditions(discretisation.scene, *stated)
    cells = discretisation._cell_nodes()
    common = CommonConditions(
        conditions, prolongation, nodes, cells, amplitudes, discretisation.surface
    )
    joined_conditions, shares = common.joined()
    return joined_conditions.rows, joined_conditions.pairs, joined_conditions.opened, shares


@dataclass(frozen=True)
class CommonConditions:
    """Finds the conditions that several contacts state, and makes one of each."""

    given: Conditions
    prolongation: Prolongation
    nodes: np.ndarray  #: nodes on which conditions of several contacts act
    cells: np.ndarray  #: nodes of each cell
    amplitudes: Amplitudes
    surface: Callable[[Tag], Surface]

    def joined(self) -> tuple[Conditions, Shares | None]:
        """The conditions, with one of those that several contacts state.

        No shares if there are none.

        Raises:
            SceneError: for contacts whose laws or openings differ on a common condition.
        """
        first_condition, second_condition = self._alike(*self._beside())
        if not first_condition.size:
            return self.given, None
        conditions = self.given
        m = conditions.pairs.size
        count, label = connected_components(
            csr_matrix(
                (np.ones(first_condition.size), (first_condition, second_condition)), shape=(m, m)
            ),
            directed=False,
        )
        _, first, label = np.unique(label, return_index=True, return_inverse=True)
        areas = self._areas(label)
        sums = np.bincount(label, areas)
        # a node on the axis of symmetry has no area
        shares_in_condition = np.where(sums[label] > 0, areas, 1.0)
        shares_in_condition = shares_in_condition / np.bincount(label, shares_in_condition)[label]
        mean = csr_matrix((shares_in_condition, (label, np.arange(m))), shape=(count, m))
        # the slave of a row has the weight 1 along the mean of its normals
        directions = mean @ self._aligned(first[label])
        lengths = np.where(np.bincount(label) > 1, np.linalg.norm(directions, axis=1), 1.0)
        normals = directions / lengths[:, None]
        mean = csr_matrix(diags(1 / lengths) @ mean)
        matrix = _along(
            csr_matrix(mean @ conditions.rows.matrix), normals, lengths < 1.0 - COMMON_CONDITION**2
        )
        rows = replace(
            conditions.rows.take(first), matrix=matrix, gap=mean @ conditions.rows.gap, areas=sums
        )
        common = np.flatnonzero(np.bincount(label)[label] > 1)
        nodes = self._shares_of_nodes(common, label, shares_in_condition, normals)
        shares = Shares(label[common], conditions.pairs[common], shares_in_condition[common], nodes)
        return Conditions(
            conditions.scene, rows, conditions.pairs[first], mean @ conditions.opened
        ), shares

    @cached_property
    def _dim(self) -> int:
        return self.given.rows.points.shape[1]

    @cached_property
    def _acting(self) -> csr_matrix:
        """B T, (m, N)."""
        return csr_matrix(self.prolongation.rows(self.given.rows.matrix))

    @cached_property
    def _normals(self) -> np.ndarray:
        """Unit normal of each row at its slave, (m, dim)."""
        return normals_of(self.given.rows.matrix, self.given.rows.slaves, self._dim)

    def _aligned(self, first: np.ndarray) -> np.ndarray:
        """Normals of all conditions.

        That of the ``first``, (m,), where slave and master change their roles.
        """
        normals = self._normals
        turned = np.einsum("md,md->m", normals, normals[first]) < 0.0
        return np.where(turned[:, None], normals[first], normals)

    def _beside(self) -> tuple[np.ndarray, np.ndarray]:
        """Conditions of two contacts that act on a common node, (k,) each."""
        pairs = self.given.pairs
        entries = self._acting.tocoo()
        shape = pairs.size, self._acting.shape[1] // self._dim
        nodes = csr_matrix(
            (np.ones(entries.nnz), (entries.row, entries.col // self._dim)), shape=shape
        )
        nodes.data[:] = 1.0
        nodes = csr_matrix(nodes[:, self.nodes])
        touched = np.flatnonzero(np.diff(nodes.indptr))
        beside = csr_matrix(nodes[touched] @ nodes[touched].T).tocoo()
        first = touched[beside.row]
        second = touched[beside.col]
        apart = (first < second) & (pairs[first] != pairs[second])
        return first[apart], second[apart]

    def _alike(self, one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Conditions that are the same among pairs of them, (k,) each."""
        if not one.size:
            return one, other
        rows = self.given.rows
        acting = csr_matrix(self._acting @ diags(self.prolongation.free.astype(float)))
        size = np.asarray(acting.multiply(acting).sum(axis=1)).ravel()
        off = acting[one] - acting[other]
        same = np.asarray(off.multiply(off).sum(axis=1)).ravel() <= COMMON_CONDITION**2 * size[one]
        alike = same | self._of_one_slave(one, other)
        length = max(
            np.ptp(rows.points, axis=0).max(initial=0.0), np.abs(rows.gap).max(initial=0.0)
        )
        step = np.abs(rows.gap[one] - rows.gap[other]) > COMMON_CONDITION * length
        for k in np.flatnonzero(alike).tolist():
            bodies = [self._touched(row) for row in (one[k], other[k])]
            # of one row with two gaps the smaller one holds, as on a step of the ground
            alike[k] = (
                not step[k] if same[k] or GROUND in bodies[0] else bool(bodies[0] & bodies[1])
            )
            alike[k] &= self._agree(one[k], other[k], length)
        return one[alike], other[alike]

    def _of_one_slave(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Pairs of conditions, (k,), whose slave nodes and normals are one, (k,) bool."""
        # nodes that constraints make one have the same rows of T
        random_field = self.prolongation.prolong(
            np.random.default_rng(0).standard_normal(self._acting.shape[1])
        )
        at_slaves = random_field.reshape(-1, self._dim)[self.given.rows.slaves]
        node = np.abs(at_slaves[one] - at_slaves[other]).max(axis=1) <= COMMON_CONDITION * np.abs(
            at_slaves[one]
        ).max(axis=1)
        cosines = np.einsum("kd,kd->k", self._normals[one], self._normals[other])
        averages = np.array(
            [getattr(contact, "normal", ()) is None for contact in self.given.scene.contacts]
        )
        averages = averages[self.given.pairs]
        return node & (
            cosines >= np.where(averages[one] & averages[other], CREASE, 1.0 - COMMON_CONDITION**2)
        )

    @cached_property
    def _body(self) -> np.ndarray:
        """Number of the connected component of each node, by cells and constraints, (nodes,)."""
        count = self._acting.shape[1] // self._dim
        label = components_of_nodes(count, self.cells)
        coupling = self.prolongation.map
        if coupling is None:
            return label
        entries = coupling.tocoo()
        ends = label[entries.row // self._dim], label[entries.col // self._dim]
        graph = csr_matrix((np.ones(entries.nnz), ends), shape=(count, count))
        return connected_components(graph, directed=False)[1][label]

    def _touched(self, condition: int) -> set[int]:
        """Bodies on the other side of a condition."""
        row = self.given.rows.matrix[condition].tocoo()
        weights = row.data * self._normals[condition][row.col % self._dim]
        bodies, index = np.unique(self._body[row.col // self._dim], return_inverse=True)
        # a surface in contact with another one of its body has weights of both signs
        opposite = np.bincount(index, np.minimum(weights, 0.0)) < -0.5
        return set(bodies[opposite].tolist()) or {GROUND}

    def _agree(self, one: int, other: int, length: float) -> bool:
        """True if laws and openings of two contacts are the same on a condition of both.

        Openings of two obstacles for one surface may differ: these are two conditions.
        """
        conditions = self.given
        samples = conditions.scene.parameters.random(OPENING_SAMPLES, seed=0)
        opened = self.amplitudes.sum_columns(conditions.opened[[one, other]], samples)
        first, second = (conditions.scene.contacts[conditions.pairs[row]] for row in (one, other))
        differ = "laws"
        if np.abs(opened[0] - opened[1]).max() > COMMON_CONDITION * length:
            if first.tags[0] == second.tags[0]:
                return False
            differ = "openings"
        elif (
            conditions.scene.laws[conditions.pairs[one]]
            == conditions.scene.laws[conditions.pairs[other]]
        ):
            return True
        raise SceneError(
            f"{self._named(one)} and {self._named(other)} share the node at "
            f"{rounded(conditions.rows.points[one])}, whose condition is one, and their {differ} "
            "differ: give both the same, or let one surface end before that node"
        )

    def _named(self, condition: int) -> str:
        number = int(self.given.pairs[condition])
        return f"contact {number} of {', '.join(map(str, self.given.scene.contacts[number].tags))}"

    def _areas(self, label: np.ndarray) -> np.ndarray:
        """Area of each condition, (m,).

        Conditions of one slave surface have no more than its area together.
        """
        conditions = self.given
        areas = conditions.rows.areas.copy()
        first_tags = [contact.tags[0] for contact in conditions.scene.contacts]
        tags = np.array([first_tags.index(tag) for tag in first_tags])[conditions.pairs]
        _, group, sizes = np.unique(
            label * len(first_tags) + tags, return_inverse=True, return_counts=True
        )
        for tag in np.unique(tags[sizes[group] > 1]).tolist():
            surface = self.surface(first_tags[tag])
            for number in np.unique(group[(sizes[group] > 1) & (tags == tag)]).tolist():
                members = np.flatnonzero(group == number)
                _, sides = looking(surface, self._normals[members[0]], GRAZING_NORMAL)
                area = sides[surface.nodes == conditions.rows.slaves[members[0]]].sum()
                areas[members] *= min(1.0, area / areas[members].sum()) if area else 1.0
        return areas

    def _shares_of_nodes(
        self, common: np.ndarray, label: np.ndarray, parts: np.ndarray, normals: np.ndarray
    ) -> csr_matrix:
        """Share of common conditions in the entries of the joined rows at each node, (s, nodes)."""
        entries = self.given.rows.matrix[common].tocoo()
        row = common[entries.row]
        weights = parts[row] * entries.data * normals[label[row], entries.col % self._dim]
        indices = entries.row, entries.col // self._dim
        node_weights = csr_matrix(
            (weights, indices), shape=(common.size, self._acting.shape[1] // self._dim)
        )
        node_weights.eliminate_zeros()
        _, group = np.unique(label[common], return_inverse=True)
        sums_of_groups = (
            csr_matrix((np.ones(common.size), (group, np.arange(common.size)))) @ node_weights
        )
        shares = node_weights.tocoo()
        sums = np.asarray(sums_of_groups[group[shares.row], shares.col]).ravel()
        data = np.divide(shares.data, sums, out=np.zeros(sums.size), where=sums != 0)
        return csr_matrix((data, (shares.row, shares.col)), shape=node_weights.shape)


def _along(matrix: csr_matrix, normals: np.ndarray, turned: np.ndarray) -> csr_matrix:
    """Rows, (m, N), of which some are projected on their normal, (m, dim)."""
    if not turned.any():
        return matrix
    dim = normals.shape[1]
    entries = matrix.tocoo()
    weights = entries.data * normals[entries.row, entries.col % dim]
    shape = matrix.shape[0], matrix.shape[1] // dim
    nodes = csr_matrix((weights, (entries.row, entries.col // dim)), shape=shape).tocoo()
    columns = nodes.col[:, None] * dim + np.arange(dim)
    values = nodes.data[:, None] * normals[nodes.row]
    straight = csr_matrix(
        (values.ravel(), (np.repeat(nodes.row, dim), columns.ravel())), shape=matrix.shape
    )
    return csr_matrix(
        diags((~turned).astype(float)) @ matrix + diags(turned.astype(float)) @ straight
    )
