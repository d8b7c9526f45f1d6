"""Histories of bodies that slide past the mesh on which they were paired: each increment pairs the
surfaces again.

Strains and rotations are small, sliding is large. The compliance C between all dofs of the surfaces
stays: their displacement is u = free - C f under nodal forces f. With the rows R of a pairing at
the present position, contact is the problem

    slack = gap + R (u_paired - free) + S x,      S = R C R^T,      f = R^T x,

with the gap there. Tangential rows measure the slip since the increment before. An increment is
paired first at the position of the free motion under the forces before, and again at the position
of its solution.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.rows import ContactRows, normals_of
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.errors import NeverFacingError, PairingWarning, SceneWarning
from hhr_dolfinx.memory import NO_MEMORY, Memory
from hhr_dolfinx.pairings.surface import Surface, area_vectors
from hhr_dolfinx.plugins.friction.laws import Friction, SlipState
from hhr_dolfinx.plugins.friction.slider import IncrementEnd, SlidingState
from hhr_dolfinx.plugins.friction.sliding_set import Sliding, SlidingContact, SlidingIncrement
from hhr_dolfinx.plugins.friction.tangents import tangents_of
from hhr_dolfinx.plugins.mortar.pairing import Mortar
from hhr_dolfinx.plugins.nonmatching.node_to_surface import NodeToSurface
from hhr_dolfinx.plugins.sliding.pressures import (
    FACING,
    FrictionBesideLaws,
    PressureLaws,
    SlidingFriction,
)
from hhr_dolfinx.warn import ignored, warn

if TYPE_CHECKING:
    from hhr_dolfinx.parameters import ParameterSpace
    from hhr_dolfinx.plugins.friction.laws import FrictionLaw

PAIRINGS = 8
"""Most pairings of an increment."""
SETTLED = 1e-3
"""Part of the smallest facet by which surfaces may differ from the position of their pairing."""
EXACTLY = 1e-7
"""The same if increments are cut by their errors: the error of pairing should be negligible."""
FAR = 0.1
"""Part of the smallest facet by which pairings that do not converge may differ: gaps differ by its
square.
"""
NO_EFFECT = 1e-9
"""Part of the compliance of a contact below which that of its slip, or of its difference to another
one, counts as zero.
"""
IMPOSED = 1e-14
"""Part of the largest compliance below which that of a contact counts as zero: of a stiff body it
may be as small as 1e-9.
"""
TOUCHING_SURFACES = 1e-9
"""Part of the size of surfaces up to which they touch."""
UNPAIRED_GAP = 10.0
"""Gap of nodes that face no surface, in sizes of the surfaces."""


def nodes_of(surfaces: Sequence[Surface]) -> tuple[np.ndarray, np.ndarray]:
    """Sorted nodes of some surfaces, (n,), each once, and their coordinates, (n, dim)."""
    all_nodes = np.concatenate([surface.nodes for surface in surfaces])
    points = np.concatenate([surface.points for surface in surfaces])
    nodes, first = np.unique(all_nodes, return_index=True)
    return nodes, points[first]


def renumbered(surface: Surface, nodes: np.ndarray) -> Surface:
    """A surface with node numbers relative to some nodes.

    Args:
        surface: the surface.
        nodes: sorted numbers of the nodes, (n,).
    """
    return replace(surface, nodes=np.searchsorted(nodes, surface.nodes))


def deformed(surface: Surface, displacement: np.ndarray) -> Surface:
    """A surface in its deformed position.

    Args:
        surface: the surface.
        displacement: displacement of all nodes that its numbers refer to, (n, dim).
    """
    points = surface.points + displacement[surface.nodes]
    vectors = area_vectors(points[surface.facets])
    sizes = np.linalg.norm(vectors, axis=1)
    outward = vectors / sizes[:, None]
    outward[np.einsum("ij,ij->i", outward, surface.outward) < 0] *= -1
    return replace(surface, points=points, outward=outward, sizes=sizes)


def grown(surface: Surface, now: Surface) -> Surface:
    """A deformed surface, with the areas of its nodes.

    Args:
        surface: the surface as it is meshed.
        now: the surface in its deformed position.
    """
    before, after = (_integrals(one) for one in (surface, now))
    growth = np.divide(after, before, out=np.ones(before.size), where=before > 0)
    return replace(now, areas=surface.areas * growth)


def _integrals(surface: Surface) -> np.ndarray:
    """Integral of the linear function of each node over a surface, (n,)."""
    weights = surface.weights[surface.facets]
    shares = weights + weights.sum(axis=1, keepdims=True)
    values = surface.sizes[:, None] * shares / (surface.facets.shape[1] + 1)
    return np.bincount(surface.facets.ravel(), values.ravel(), len(surface.nodes))


@dataclass(frozen=True, eq=False)
class SlidingPair:
    """Two surfaces that are paired again in each increment.

    The gap at a slave node is that of its position, less its ``clearance``, plus ``opening[0] +
    opening[1:]·mu``.
    """

    pairing: NodeToSurface | Mortar  #: gives each node of the slave at most one row
    slave: Surface
    master: Surface  #: as they are meshed, with common node numbers
    first: int  #: index of the first dof of the pair among all rows of its model
    nodes: int  #: number of nodes of both
    clearance: Annotated[
        Floats, "slave nodes"
    ]  #: gap as meshed if an opening overwrites it, else zeros
    opening: Annotated[
        Floats, "opening"
    ]  #: sum of the openings, a constant and a slope for each parameter, (1 + P,)

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults: surfaces whose nodes are not among those of both."""
        for surface in (self.slave, self.master):
            if not (
                0 <= surface.nodes.min(initial=0) and surface.nodes.max(initial=0) < self.nodes
            ):
                yield f"nodes of surface {surface.tag} are not among the {self.nodes} of its pair"
            if np.any(np.diff(surface.nodes) <= 0) or not surface.facets.size:
                yield f"nodes of surface {surface.tag} are not in order, or it has no facets"
        slopes = self.opening.size - 1
        if self.clearance.size != self.slave.nodes.size or slopes != sizes.get("P", slopes):
            yield "its openings are not those of its slave nodes and parameters"

    def opened(self, point: np.ndarray) -> np.ndarray:
        """Gap that openings add at each slave node at a point, (P,)."""
        return self.opening[0] + self.opening[1:] @ point - self.clearance

    def rows(
        self, displacement: np.ndarray, before: np.ndarray, opened: np.ndarray
    ) -> PairedNodes | None:
        """Rows at the displaced nodes; None if the surfaces do not face each other.

        Any overlap is at most the motion since the last pairing and the opening, however thin the
        cells are.

        Args:
            displacement: displacement of the nodes, (nodes, dim).
            before: displacement at the last pairing, (nodes, dim).
            opened: opening of each slave node, by which the bodies may have overlapped before.
        """
        dim = displacement.shape[1]
        ways = np.linalg.norm(displacement - before, axis=1)
        overlap = float(ways[self.slave.nodes].max() + ways[self.master.nodes].max()) + max(
            float(opened.max()), 0.0
        )
        slave = grown(self.slave, deformed(self.slave, displacement))
        surfaces = slave, deformed(self.master, displacement)
        with ignored(PairingWarning):  # of nodes that face no surface any more
            try:
                rows = self.pairing.rows_of_deformed(surfaces, self.nodes * dim, overlap)
            except NeverFacingError:  # the surfaces have separated
                return None
        slaves = np.searchsorted(self.slave.nodes, rows.slaves)
        area = slave.areas[slaves]
        share = np.divide(rows.areas, area, out=np.ones(slaves.size), where=area > 0)
        return PairedNodes(replace(rows, gap=rows.gap + opened[slaves]), slaves, share)


class PairedNodes(NamedTuple):
    """Rows of one pair."""

    rows: ContactRows
    slaves: np.ndarray  #: index of the slave node of each row, (c,)
    share: np.ndarray  #: part of its area that faces the master, (c,)


class Paired(NamedTuple):
    """All pairs at one position.

    m rows of other pairs, C slave nodes, T tangential rows, n dofs of surfaces.
    """

    #: R: the identity of the m rows, rows of pressures followed by tangential ones, (m + C + T, m +
    #: n)
    matrix: csr_matrix
    gap: np.ndarray  #: of the slave nodes, (C,)
    share: np.ndarray  #: part of the area of each contact that faces its master, (C + others,)
    at: np.ndarray  #: displacement at which they were paired, after m other numbers, (m + n,)


class PairedSolution(NamedTuple):
    """An increment on its last pairing."""

    found: Sliding
    slip: SlipState
    laws: Memory  #: memory of laws of pressures, and the shares of areas that face
    displacement: np.ndarray  #: of all dofs of surfaces, after m other numbers, (m + n,)
    surface_forces: np.ndarray  #: on them, after those of the pairs that do not slide, (m + n,)

    def kept_in(self, state: SlidingState) -> SlidingState:
        """The state at the end of an increment, with that of the surfaces."""
        return state._replace(
            displacement=self.displacement, surface_forces=self.surface_forces, laws=self.laws
        )


class PairedSurfaces:
    """Solves increments on a compliance of all dofs of surfaces.

    Its first m rows are those of the pairs that do not slide: conditions, with a slack in the place
    of a displacement with the opposite sign. Its last rows are motions along curved tools.

    Args:
        pairs: the pairs that slide.
        friction: friction of all contacts, and laws of pressures.
        parameters: the parameters, for messages.
        exactly: pair increments until their positions converge.
    """

    def __init__(
        self,
        pairs: Sequence[SlidingPair],
        friction: Friction,
        parameters: ParameterSpace,
        exactly: bool = False,
    ):
        self.settled = EXACTLY if exactly else SETTLED
        self.pairs = pairs
        self.friction = friction
        self.parameters = parameters
        self.dim = pairs[0].slave.points.shape[1]
        self.kept = self.pairs[0].first
        self.count = sum(pair.slave.nodes.size for pair in self.pairs)
        points = np.concatenate(
            [surface.points for pair in self.pairs for surface in (pair.slave, pair.master)]
        )
        self.size = float(np.ptp(points, axis=0).max())
        self.facet = min(
            surface.lengths().min() for pair in self.pairs for surface in (pair.slave, pair.master)
        )
        self.rows = self.kept + self.count * self.dim
        self.dofs = slice(self.kept, self.kept + self.dim * sum(pair.nodes for pair in self.pairs))
        self._warned = False
        self._laws = PressureLaws(friction) if isinstance(friction, FrictionBesideLaws) else None

    def at_rest(
        self, time: float, point: np.ndarray, weights: np.ndarray, free_slack: np.ndarray
    ) -> SlidingState:
        """Undeformed bodies as meshed, without slip.

        Args:
            time: start of the path, in s.
            point: parameters, (P,).
            weights: weights of the state.
            free_slack: slacks of the pairs that do not slide, then minus imposed displacements of
                the dofs of surfaces.
        """
        nothing = np.zeros(len(free_slack))
        slack_of_fixed = free_slack[self.friction.normal[self.count :]]
        of_slaves = self.paired(nothing, nothing, point).gap
        gap = np.concatenate([of_slaves, slack_of_fixed])
        slip = SlipState.at_rest(self.friction, gap, point)
        gaps = np.concatenate([free_slack[: self.kept], of_slaves])
        laws = NO_MEMORY if self._laws is None else self._laws.at_rest(gaps, point)
        forces = np.zeros(self.rows)
        changes = np.zeros((self.friction.tangential.size, point.size))
        rest = SlidingState(point, time, forces, None, gap, slip, weights, changes, changes)
        return rest._replace(displacement=nothing, surface_forces=nothing, laws=laws)

    def solved(
        self,
        compliance: np.ndarray,
        free_slack: np.ndarray,
        before: SlidingState,
        target: IncrementEnd,
    ) -> PairedSolution:
        """Solve an increment on one pairing after another; it may not converge.

        Args:
            compliance: S of all rows, (M, M).
            free_slack: their slacks without contact forces, (M,).
            before: state at the start.
            target: end of the increment.
        """
        point = target.point
        free = -free_slack
        assert before.displacement is not None and before.surface_forces is not None
        displacement = free - compliance @ before.surface_forces
        last = 0.0
        for _ in range(PAIRINGS):
            paired = self.paired(displacement, before.displacement, point)
            solution, bound, laws = self._solved_on(compliance, free, paired, before, target)
            surface_forces = paired.matrix.T @ solution.forces
            displacement = free - compliance @ surface_forces
            change = np.abs(displacement - paired.at)[self.dofs].max() / self.facet
            # the next change would be smaller by the same factor as this one
            factor = min(change / last, 1.0) if last else 1.0
            if solution.status is not Status.CONVERGED or change * factor <= self.settled:
                break
            last = change
        else:
            if change > FAR:
                solution = solution._replace(status=Status.UNSETTLED)
        facing = replace(self.friction, area=self.friction.area * paired.share)
        slip = before.slip.after(facing, solution.forces, solution.slack, solution.active, bound)
        laws = laws | {FACING: paired.share}
        return PairedSolution(solution, slip, laws, displacement, surface_forces)

    def active(self, found: Sliding, surface_forces: np.ndarray) -> np.ndarray:
        """Rows with a force, and those of the pairs that do not slide that touch, (M,) bool.

        Args:
            found: solution of an increment.
            surface_forces: forces of all rows, (M,).
        """
        return np.concatenate([found.active[: self.kept], surface_forces[self.kept :] != 0.0])

    def _solved_on(
        self,
        compliance: np.ndarray,
        free: np.ndarray,
        paired: Paired,
        before: SlidingState,
        target: IncrementEnd,
    ) -> tuple[Sliding, np.ndarray, Memory]:
        """Solution of an increment on one pairing, limits of tangential forces, (C,), and what laws
        of pressures remember.
        """
        point = target.point
        rows = paired.matrix
        schur = rows @ (rows @ compliance).T
        pressures = slice(self.kept, self.kept + self.count)
        sliding = self.count * (self.dim - 1)
        slack = np.empty(rows.shape[0])
        slack[: self.kept] = -free[: self.kept]
        slack[self.friction.tangential[sliding:]] -= before.slip.position[sliding:]
        slack[pressures] = paired.gap + rows[pressures] @ (paired.at - free)
        slack[pressures.stop :] = rows[pressures.stop :] @ (before.displacement - free)
        idle = np.zeros(self.friction.normal.size, dtype=bool)
        idle[: self.count] = idle_contacts(schur[pressures, pressures])
        self._check_imposed(paired.gap, np.diag(schur)[pressures], point)
        slack[self.friction.normal[idle]] = UNPAIRED_GAP * self.size
        coefficient, limit = self.friction.bounds(point)
        limit = np.where(
            idle & np.isinf(coefficient), 0.0, limit
        )  # Tresca's law holds at no pressure too
        increment = SlidingIncrement(slack, coefficient, limit * paired.share, np.zeros(0))
        friction = self._with_held(np.diag(schur), idle)
        if self._laws is None:
            contact = SlidingContact(schur, friction)
            solution = contact.increment(increment, before.forces, before.active)
            memory = NO_MEMORY
        else:
            solution, memory = self._laws.solved(
                schur, friction, increment, paired.share, before, target
            )
        return solution, increment.bounds(self.friction, solution.forces), memory

    def _check_imposed(self, gap: np.ndarray, diagonal: np.ndarray, point: np.ndarray) -> None:
        """Warn once of contacts, (C,), that penetrate while all of their nodes are imposed."""
        deep = (diagonal <= IMPOSED * diagonal.max(initial=0.0)) & (
            gap < -TOUCHING_SURFACES * self.size
        )
        if deep.any() and not self._warned:
            self._warned = True
            warn(
                f"at {self.parameters.described(point)}: at {int(deep.sum())} slave nodes "
                "all nodes of the contact have imposed displacements and penetrate, most by "
                f"{-gap[deep].min():.3g}: no force acts there. Change these displacements, or the "
                "gap",
                SceneWarning,
            )

    def _with_held(self, diagonal: np.ndarray, idle: np.ndarray) -> Friction:
        """The law on one pairing.

        Imposed displacements hold some tangential rows, whose friction is undetermined.
        """
        friction = self.friction
        held = (
            diagonal[friction.tangential] <= NO_EFFECT * diagonal[friction.normal[friction.owner]]
        )
        held &= ~idle[friction.owner]
        if not held.any():
            return friction
        return replace(friction, twice=np.union1d(friction.twice, friction.tangential[held]))

    def paired(self, displacement: np.ndarray, before: np.ndarray, point: np.ndarray) -> Paired:
        """All pairs at displaced dofs of surfaces.

        Args:
            displacement: displacement of these dofs, (m + n,).
            before: displacement at the last pairing, (m + n,).
            point: parameters, (P,).
        """
        gap = np.full(self.count, UNPAIRED_GAP * self.size)
        share = np.ones(self.friction.normal.size)
        row_indices = np.arange(self.kept)
        entries: list[tuple[np.ndarray, ...]] = [
            (np.ones(row_indices.size), row_indices, row_indices)
        ]
        first = 0
        for pair in self.pairs:
            span = slice(pair.first, pair.first + pair.nodes * self.dim)
            displaced, displaced_before = (
                values[span].reshape(-1, self.dim) for values in (displacement, before)
            )
            found = pair.rows(displaced, displaced_before, pair.opened(point))
            if found is not None:
                contacts = first + found.slaves
                gap[contacts] = found.rows.gap
                share[contacts] = found.share
                entries += self._entries(found.rows, contacts, pair.first)
            first += pair.slave.nodes.size
        values, indices, columns = (np.concatenate(arrays) for arrays in zip(*entries, strict=True))
        return Paired(
            csr_matrix((values, (indices, columns)), shape=(self.rows, displacement.size)),
            gap,
            share,
            displacement,
        )

    def _entries(
        self, rows: ContactRows, contacts: np.ndarray, first: int
    ) -> list[tuple[np.ndarray, ...]]:
        """Values, rows and columns of the pressures and tangential rows of some contacts, (c,)."""
        dim = self.dim
        normals = normals_of(rows.matrix, rows.slaves, dim)
        entries = rows.matrix.tocoo()
        weights = np.zeros((len(normals), rows.matrix.shape[1] // dim))
        np.add.at(
            weights,
            (entries.row, entries.col // dim),
            entries.data * normals[entries.row, entries.col % dim],
        )
        row, node = np.nonzero(weights)
        values = weights[row, node][:, None]
        columns = first + node[:, None] * dim + np.arange(dim)
        vectors = np.concatenate([normals[:, None], tangents_of(normals)], axis=1)
        tangential = self.kept + self.count + contacts * (dim - 1)
        row_indices = np.column_stack(
            [self.kept + contacts, *(tangential + k for k in range(dim - 1))]
        )
        return [
            (
                (values * vectors[row, k]).ravel(),
                np.repeat(row_indices[row, k], dim),
                columns.ravel(),
            )
            for k in range(dim)
        ]


def idle_contacts(schur: np.ndarray) -> np.ndarray:
    """Contacts of a pairing whose pressures change nothing new, (C,) bool.

    Imposed displacements move all of their nodes, or constraints make their nodes those of a
    contact before.

    Args:
        schur: compliance S of the pressures, (C, C).
    """
    diagonal = np.diag(schur)
    idle = diagonal <= IMPOSED * diagonal.max(initial=0.0)
    sums = diagonal[:, None] + diagonal
    # |r_i - r_j|^2 in the norm of the compliance
    same = np.triu(sums - 2.0 * schur <= NO_EFFECT * sums, 1) & ~idle[:, None] & ~idle
    return idle | same.any(axis=0)


def layout(
    pairs: Sequence[SlidingPair],
    laws: Sequence[FrictionLaw],
    fixed: np.ndarray,
    dim: int,
    others: Friction,
) -> Friction:
    """Friction, by a law of each pair, of all slave nodes.

    Tangential rows follow those of pressures. The rows of the pairs that do not slide come first,
    but their contacts follow.

    Args:
        pairs: the pairs that slide.
        laws: law of each.
        fixed: indices of the parameters that stay while loads grow in proportion.
        dim: dimension of the mesh.
        others: friction of the pairs that do not slide.
    """
    counts = [pair.slave.nodes.size for pair in pairs]
    count = sum(counts)
    first = pairs[0].first
    owner = np.repeat(np.arange(count), dim - 1)
    areas = np.concatenate([pair.slave.areas for pair in pairs])
    law = np.repeat(np.arange(len(pairs)), counts)
    nothing = np.zeros(0, dtype=np.int64)
    friction = SlidingFriction(
        first + np.arange(count),
        areas,
        np.zeros(count),
        law,
        first + count + np.arange(owner.size),
        owner,
        np.zeros((owner.size, dim)),
        tuple(laws),
        fixed,
        nothing,
        nothing,
    )
    return followed(friction, others)


def no_friction(dim: int) -> Friction:
    """Friction of no contact."""
    nothing = np.zeros(0, dtype=np.int64)
    reals = np.zeros(0)
    return Friction(
        nothing,
        reals,
        reals,
        nothing,
        nothing,
        nothing,
        np.zeros((0, dim)),
        (),
        nothing,
        nothing,
        nothing,
    )


def followed(one: Friction, other: Friction) -> Friction:
    """Friction of the contacts of two laws, with rows of one problem.

    Args:
        one: friction of the first contacts.
        other: friction of the contacts that follow.
    """
    both = {name: np.concatenate([getattr(one, name), getattr(other, name)]) for name in
            ("normal", "area", "spacing", "tangential", "tangents", "twice")}  # fmt: skip
    law = np.concatenate([one.law, len(one.laws) + other.law])
    owner = np.concatenate([one.owner, one.normal.size + other.owner])
    fixed = np.union1d(one.fixed, other.fixed)
    return replace(one, **both, law=law, owner=owner, laws=(*one.laws, *other.laws), fixed=fixed)
