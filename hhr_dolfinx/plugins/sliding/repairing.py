"""Histories of bodies that slide past the mesh on which they were paired: each increment pairs the surfaces again.

Strains and rotations are small, sliding is large. The compliance C between all dofs of the surfaces stays: their
displacement is u = free - C f under nodal forces f. With the rows R of a pairing at the present position, contact is
the problem

    slack = gap + R (u_paired - free) + S x,      S = R C R^T,      f = R^T x,

with the gap there. Tangential rows measure the slip since the increment before. An increment is paired first at the
position of the free motion under the forces before, and again at the position of its solution.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.rows import ContactRows, normals_of
from hhr_dolfinx.errors import NeverFacingError, PairingWarning
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.pairings.surface import SlaveAndMaster, Surface, area_vectors
from hhr_dolfinx.plugins.friction.laws import Friction, SlipState
from hhr_dolfinx.plugins.friction.slider import Reached, Slider, Solved, Target
from hhr_dolfinx.plugins.friction.sliding_set import Increment, Sliding, SlidingContact
from hhr_dolfinx.plugins.friction.tangents import tangents_of
from hhr_dolfinx.plugins.mortar.pairing import Mortar
from hhr_dolfinx.plugins.nonmatching.node_to_surface import NodeToSurface
from hhr_dolfinx.warn import ignored

PAIRINGS = 8
"""Most pairings of an increment."""
SETTLED = 1e-3
"""Part of the smallest facet by which surfaces may differ from the position of their pairing."""
EXACTLY = 1e-7
"""The same if increments are cut by their errors: the error of pairing should be negligible."""
FAR = 0.1
"""Part of the smallest facet by which pairings that do not converge may differ: gaps differ by its square."""
APART = 10.0
"""Gap of nodes that face no surface, in sizes of the surfaces."""


@dataclass(frozen=True)
class SurfaceDofs(SlaveAndMaster):
    """Rows of the identity at the nodes of two surfaces, component by component, which span all contact conditions."""

    unilateral: ClassVar[bool] = False  # its rows move under any forces

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """One row for each component of the displacement of each node, in the order of the nodes."""
        nodes, points = nodes_of(surfaces)
        dim = points.shape[1]
        own = (nodes[:, None] * dim + np.arange(dim)).ravel()
        matrix = csr_matrix((np.ones(own.size), (np.arange(own.size), own)), shape=(own.size, dofs))
        nothing = np.zeros(own.size)
        return ContactRows(matrix, nothing, np.repeat(nodes, dim), np.repeat(points, dim, axis=0), nothing)


def nodes_of(surfaces: Sequence[Surface]) -> tuple[np.ndarray, np.ndarray]:
    """Sorted nodes of some surfaces, (n,), each once, and their coordinates, (n, dim)."""
    every = np.concatenate([surface.nodes for surface in surfaces])
    points = np.concatenate([surface.points for surface in surfaces])
    nodes, first = np.unique(every, return_index=True)
    return nodes, points[first]


def renumbered(surface: Surface, nodes: np.ndarray) -> Surface:
    """A surface with node numbers relative to some sorted nodes, (n,)."""
    return replace(surface, nodes=np.searchsorted(nodes, surface.nodes))


def deformed(surface: Surface, displacement: np.ndarray) -> Surface:
    """A surface in its deformed position, from the displacement of all nodes that its numbers refer to, (n, dim)."""
    points = surface.points + displacement[surface.nodes]
    vectors = area_vectors(points[surface.facets])
    sizes = np.linalg.norm(vectors, axis=1)
    outward = vectors / sizes[:, None]
    outward[np.einsum("ij,ij->i", outward, surface.outward) < 0] *= -1
    return replace(surface, points=points, outward=outward, sizes=sizes)


@dataclass(frozen=True, eq=False)
class SlidingPair:
    """Two surfaces that are paired again in each increment."""

    pairing: NodeToSurface | Mortar  # gives each node of the slave at most one row
    slave: Surface
    master: Surface  # as they are meshed, with common node numbers
    first: int  # index of the first dof of the pair among all rows of its model
    nodes: int  # number of nodes of both

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults: surfaces whose nodes are not among those of both."""
        for surface in (self.slave, self.master):
            if not (0 <= surface.nodes.min(initial=0) and surface.nodes.max(initial=0) < self.nodes):
                yield f"nodes of surface {surface.tag} are not among the {self.nodes} of its pair"
            if np.any(np.diff(surface.nodes) <= 0) or not surface.facets.size:
                yield f"nodes of surface {surface.tag} are not in order, or it has no facets"

    def rows(self, displacement: np.ndarray, before: np.ndarray) -> tuple[ContactRows | None, np.ndarray]:
        """Rows at the displaced nodes, (nodes, dim), and the number of the slave node of each.

        None if the surfaces do not face each other. Bodies did not overlap ``before``, (nodes, dim). So any overlap
        is at most the motion since then, however thin the cells are.
        """
        dim = displacement.shape[1]
        ways = np.linalg.norm(displacement - before, axis=1)
        overlap = float(ways[self.slave.nodes].max() + ways[self.master.nodes].max())
        surfaces = deformed(self.slave, displacement), deformed(self.master, displacement)
        with ignored(PairingWarning):  # of nodes that face no surface any more
            try:
                rows = self.pairing.rows_of_deformed(surfaces, self.nodes * dim, overlap)
            except NeverFacingError:  # the surfaces have separated
                return None, np.zeros(0, dtype=np.int64)
        return rows, np.searchsorted(self.slave.nodes, rows.slaves)


class Paired(NamedTuple):
    """All pairs at one position (C slave nodes, T tangential rows, n dofs of surfaces)."""

    matrix: csr_matrix  # R, rows of pressures followed by tangential ones, (C + T, n)
    gap: np.ndarray  # of the slave nodes, (C,)
    at: np.ndarray  # displacement at which they were paired, (n,)


class RepairingSlider(Slider):
    """Solves increments of a model with ``pairs``, whose rows are all dofs of its surfaces.

    ``exactly`` pairs increments until their positions converge.
    """

    def __init__(self, model: Any, *, exactly: bool = False):
        super().__init__(model)
        self.settled = EXACTLY if exactly else SETTLED
        self.pairs: Sequence[SlidingPair] = model.pairs
        self.dim = model.dimension
        places = np.concatenate([surface.points for pair in self.pairs for surface in (pair.slave, pair.master)])
        self.size = float(np.ptp(places, axis=0).max())
        self.facet = min(surface.lengths().min() for pair in self.pairs for surface in (pair.slave, pair.master))

    def at_rest(self, time: float, point: np.ndarray, weights: np.ndarray) -> Reached:
        """Undeformed bodies as meshed, without slip."""
        count = len(self._contact_at(point).free_slack)
        rows = self.friction.normal.size + self.friction.tangential.size
        nothing = np.zeros(count)
        gap = self.paired(nothing, nothing).gap
        slip = SlipState.at_rest(self.friction)
        changes = self._no_changes, self._no_changes
        return Reached(point, time, np.zeros(rows), None, gap, slip, weights, *changes, nothing, nothing)

    def increment(self, before: Reached, target: Target) -> Solved:
        """Solve one increment; it may not converge."""
        point = target.point
        contact = self._contact_at(point)
        free = -contact.free_slack
        assert before.displacement is not None and before.surface_forces is not None
        displacement = free - contact.schur @ before.surface_forces
        last = 1e-300
        for _ in range(PAIRINGS):
            paired = self.paired(displacement, before.displacement)
            found, bound = self._solved_on(contact.schur, free, paired, before, point)
            surface_forces = paired.matrix.T @ found.forces
            displacement = free - contact.schur @ surface_forces
            change = np.abs(displacement - paired.at).max() / self.facet
            # the next change would be smaller by the same factor as this one
            if found.status is not Status.CONVERGED or change * min(change / last, 1.0) <= self.settled:
                break
            last = change
        else:
            if change > FAR:
                found = found._replace(status=Status.UNSETTLED)
        slip = before.slip.after(self.friction, found.forces, found.slack, found.active, bound)
        reached = self._reached(target, found, slip, (before.changes, before.closing), displacement, surface_forces)
        return Solved(found, reached, contact, None)

    def _solved_on(
        self, compliance: np.ndarray, free: np.ndarray, paired: Paired, before: Reached, point: np.ndarray
    ) -> tuple[Sliding, np.ndarray]:
        """Solution of an increment on one pairing, and limits of tangential forces, (C,)."""
        rows = paired.matrix
        count = self.friction.normal.size
        schur = rows @ (rows @ compliance).T
        slack = np.empty(rows.shape[0])
        slack[:count] = paired.gap + rows[:count] @ (paired.at - free)
        slack[count:] = rows[count:] @ (before.displacement - free)
        given = Increment(slack, *self.friction.bounds(point), np.zeros(0))
        found = SlidingContact(schur, self.friction).increment(given, before.forces, before.active)
        return found, given.bounds(self.friction, found.forces)

    def paired(self, displacement: np.ndarray, before: np.ndarray) -> Paired:
        """All pairs at displaced dofs of surfaces, (n,), from their displacement before."""
        count = self.friction.normal.size
        gap = np.full(count, APART * self.size)
        entries = []
        first = 0
        for pair in self.pairs:
            own = slice(pair.first, pair.first + pair.nodes * self.dim)
            rows, slaves = pair.rows(*(values[own].reshape(-1, self.dim) for values in (displacement, before)))
            if rows is not None:
                gap[first + slaves] = rows.gap
                entries += self._entries(rows, first + slaves, pair.first)
            first += pair.slave.nodes.size
        values, places, columns = (np.concatenate(part) for part in zip(*entries, strict=True)) if entries else [[]] * 3
        shape = count + self.friction.tangential.size, displacement.size
        return Paired(csr_matrix((values, (places, columns)), shape=shape), gap, displacement)

    def _entries(self, rows: ContactRows, contacts: np.ndarray, first: int) -> list[tuple[np.ndarray, ...]]:
        """Values, rows and columns of the pressures and tangential rows of some contacts, (c,)."""
        dim = self.dim
        normals = normals_of(rows.matrix, rows.slaves, dim)
        whole = rows.matrix.tocoo()
        weights = np.zeros((len(normals), rows.matrix.shape[1] // dim))
        np.add.at(weights, (whole.row, whole.col // dim), whole.data * normals[whole.row, whole.col % dim])
        row, node = np.nonzero(weights)
        values = weights[row, node][:, None]
        columns = first + node[:, None] * dim + np.arange(dim)
        vectors = np.concatenate([normals[:, None], tangents_of(normals)], axis=1)
        tangential = self.friction.normal.size + contacts * (dim - 1)
        places = np.column_stack([contacts, *(tangential + k for k in range(dim - 1))])
        return [
            ((values * vectors[row, k]).ravel(), np.repeat(places[row, k], dim), columns.ravel()) for k in range(dim)
        ]

    def elastic_energy(self, solved: Solved) -> float:
        """See :class:`Slider`."""
        surface_forces = solved.reached.surface_forces
        return 0.5 * float(surface_forces @ (solved.contact.schur @ surface_forces))

    def answer(self, solved: Solved) -> Answer:
        """Answer of an increment; its forces are those on all dofs of surfaces."""
        found, reached, contact, _ = solved
        surface_forces = reached.surface_forces
        assert surface_forces is not None
        how = found.iterations, found.status, found.sweeps > 0, self.model.fields, reached.time
        unknown = contact.unknown(surface_forces)
        memory = Memory(slip=reached.slip)
        return Answer(reached.point, unknown, surface_forces, surface_forces != 0.0, *how, memory=memory)


def layout(pairs: Sequence[SlidingPair], laws: Sequence[Any], fixed: np.ndarray, dim: int) -> Friction:
    """Friction, by a law of each pair, of all slave nodes, whose tangential rows follow those of pressures.

    ``fixed`` are indices of the parameters that stay while loads grow in proportion.
    """
    counts = [pair.slave.nodes.size for pair in pairs]
    count = sum(counts)
    owner = np.repeat(np.arange(count), dim - 1)
    areas = np.concatenate([pair.slave.areas for pair in pairs])
    law = np.repeat(np.arange(len(pairs)), counts)
    nothing = np.zeros(0, dtype=np.int64)
    return Friction(
        np.arange(count), areas, np.zeros(count), law, count + np.arange(owner.size), owner,
        np.zeros((owner.size, dim)), tuple(laws), fixed, nothing, nothing,
    )  # fmt: skip
