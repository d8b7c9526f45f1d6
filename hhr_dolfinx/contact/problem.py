"""The algebraic contact problem (1.21): matrices, index sets and connectivity, no mesh and no
physics.

Modules that reduce and evaluate (basis, RID, reduced model, stability, reconstruction) see only
this.

If only the moduli of whole bodies vary, K(mu) is block diagonal (:class:`ScaledBodies`): bodies
interact only through contact, so that each connected component of K is a block K_c. If the parts of
a block share one factor, K_c(mu) is s_c(mu) times K_c in the middle of the box, K^-1(mu) is K_c^-1
/ s_c, and S(mu) the sum of S_c / s_c: nothing is factored again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter
from typing import TYPE_CHECKING, Protocol

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, identity, kron, vstack
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.amplitudes import Amplitudes, Theta
from hhr_dolfinx.contact.law import UNILATERAL, ContactLaw
from hhr_dolfinx.contact.prolongation import OnRows, Product, Prolongation
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.group import ALONE, ProcessGroup, group_of
from hhr_dolfinx.linear.rows import Rows, rows_of
from hhr_dolfinx.parameters import ParameterSpace, PointLike

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.contact.kernel import Kernel
    from hhr_dolfinx.contact.shares import Shares
    from hhr_dolfinx.formulas import Modulus, Scalar


def dependence(
    moduli: Sequence[Modulus], others: tuple[int, ...], names: tuple[str, ...]
) -> tuple[Scalar | None, np.ndarray]:
    """Dependence of a stiffness on the parameters.

    Args:
        moduli: moduli of its parts.
        others: indices of further parameters on which it depends.
        names: names of all parameters.

    Returns:
        The factor that all parts share if it varies, else None; and the indices of the parameters
        of the rest and of ``others``.
    """
    factor = None
    rests = [
        scalar for modulus in moduli for scalar in (modulus.factor_scalar, modulus.rest_scalar)
    ]
    if len({modulus.factor for modulus in moduli}) == 1:
        rests = [modulus.rest_scalar for modulus in moduli]
        factor = moduli[0].factor_scalar if moduli[0].factor_scalar.formula.variables else None
    named = {name for scalar in rests for name in scalar.formula.variables}
    return factor, np.array(
        sorted({names.index(name) for name in named} | set(others)), dtype=np.int64
    )


def moduli_of(problem: ContactProblem, body: np.ndarray) -> list[Modulus]:
    """Moduli of the parts of K that have entries on some dofs, (n,).

    Args:
        problem: the contact problem.
        body: the dofs, (n,).
    """
    rows = problem.spread.mine(body)
    pairs = zip(problem.moduli, problem.stiffness_terms, strict=False)
    return [
        modulus for modulus, term in pairs if problem.spread.sum(float(term[rows].count_nonzero()))
    ]


@dataclass(frozen=True)
class ScaledBodies:
    """Modulus of each connected component of K, in the order of ``problem.bodies``.

    None for a constant one.
    """

    problem: ContactProblem
    factors: tuple[Scalar | None, ...]

    @classmethod
    def of(cls, problem: ContactProblem) -> ScaledBodies | None:
        """Factors of the components of a problem.

        None if K depends on parameters in another way, or not at all.
        """
        if not problem.moduli or problem.reshaped is not None:
            return None
        factors = []
        for body in problem.bodies:
            factor, axes = dependence(moduli_of(problem, body), (), problem.parameters.names)
            if axes.size:
                return None
            factors.append(factor)
        return cls(problem, tuple(factors))

    def at(self, point: np.ndarray) -> np.ndarray:
        """s_c at a point, (P,), relative to the middle of the box, (C,)."""
        return self._values(point) / self._middle

    def _values(self, point: np.ndarray) -> np.ndarray:
        return np.array([1.0 if factor is None else factor.value(point) for factor in self.factors])

    @cached_property
    def _middle(self) -> np.ndarray:
        return self._values(self.problem.middle)


DEPENDENT_ROWS = 1e-13
"""Singular value of B V over the norm of B below which its rows are dependent to round-off."""

ROUND_OFF_OF_MOTIONS = 1e-13
"""Part of the sum of |K| |lift| below which K times a lift is round-off, as along rigid motions."""


def masked(matrix: csc_matrix, rows: np.ndarray) -> csc_matrix:
    """Sparse matrix in which rows outside a mask are zero, CSC without stored zeros.

    Args:
        matrix: the matrix, (N, k).
        rows: the mask, (N,) bool.
    """
    masked_rows = csc_matrix(diags(rows.astype(float)) @ matrix)
    masked_rows.eliminate_zeros()
    masked_rows.sort_indices()
    return masked_rows


def strained(stiffness: csr_matrix, lifts: csc_matrix) -> csc_matrix:
    """Product of rows of K, or of a part of it, and lifts, without the round-off of rigid motions.

    Args:
        stiffness: rows of K, (n, N).
        lifts: lifts by term, (N, 1 + T).

    Returns:
        The product, (n, 1 + T).
    """
    forces = csr_matrix(stiffness @ lifts)
    sizes = csr_matrix(abs(stiffness) @ abs(lifts))
    return csc_matrix(forces.multiply(abs(forces) > ROUND_OFF_OF_MOTIONS * sizes))


class Reshaping(Protocol):
    """Deforms the mesh of a scene whose shapes depend on parameters, and assembles its problem
    again.
    """

    axes: tuple[int, ...]  #: indices of the parameters of shapes
    described: str  #: all formulas, for fingerprints

    def __call__(self, point: np.ndarray) -> ContactProblem:
        """The problem at a point, (P,): other gaps, rows, areas, loads and K, and as many
        conditions.
        """

    def at(self, point: np.ndarray) -> AbstractContextManager[None]:
        """Context in which the mesh has the shape of a point.

        Elsewhere it has that of the middle of the box.
        """

    def attached(self, problem: ContactProblem) -> ContactProblem:
        """The problem in the middle of the box with this in ``reshaped``."""

    def touching(self) -> ContactProblem:
        """The problem in the middle of the box, whose B has entries wherever it has some at a shape
        of the box.
        """


@dataclass(frozen=True)
class ContactProblem:
    """Find U = U0 + L θ and Λ >= 0 with K U0 + B^T Λ = loads θ, B U0 <= gaps θ, thesis (1.21).

    U0 is the homogeneous part of the displacement: it vanishes on imposed dofs, and dependent dofs
    follow the others (:class:`~hhr_dolfinx.contact.prolongation.Prolongation`), which K, B and
    loads contain already. The amplitudes θ(mu) carry all dependence on the parameters (N dofs,
    N_lambda conditions, 1 + T terms).

    The large matrices are distributed by rows: a rank has the rows of its dofs, one rank all of
    them. Everything else is the same on all ranks; it is sparse, or as large as the contact
    surface.
    """

    #: local rows of the parts of K, T^T K_q T, with those of imposed dofs, (own, N) each; empty if
    #: K is that of a user-defined system without parts
    stiffness_terms: tuple[csr_matrix, ...]
    #: local rows of the Gram matrix of the L2 product of one component, (own nodes, nodes)
    node_mass: csr_matrix
    prolongation: Prolongation  #: U = U0 + L θ by the free dofs
    forces: csc_matrix  #: F on all dofs, sparse, (N, 1 + T)
    #: K_q L of each part of K on all dofs, before dependent ones are eliminated, sparse, (N, 1 + T)
    #: each; empty if K is that of a user-defined system without parts
    pulls: tuple[csc_matrix, ...]
    contact: csr_matrix  #: B T with zero columns at imposed dofs, (N_lambda, N)
    gaps: np.ndarray  #: D - B lift, (N_lambda, 1 + T)
    contact_slaves: np.ndarray  #: node that carries each condition and its multiplier, (N_lambda,)
    #: number of the contact pair of each condition, in the order of the scene, the first of
    #: several, (N_lambda,)
    contact_pairs: np.ndarray
    contact_points: np.ndarray  #: position of each condition, (N_lambda, dim)
    contact_areas: np.ndarray  #: tributary area of each condition, (N_lambda,)
    cell_nodes: np.ndarray  #: nodes of each cell, (cells, n)
    points: np.ndarray  #: coordinates of the nodes, (nodes, dim)
    amplitudes: Amplitudes  #: θ as a function of the parameters
    parameters: ParameterSpace  #: the box of the parameters
    first: int = 0  #: number of the first dof whose row is local
    #: amplitude of each part of K; empty if K is their sum and does not depend on parameters.
    #: Attributes that depend on K without a given parameter refer to the middle of the box
    moduli: tuple[Modulus, ...] = ()
    reshaped: Reshaping | None = (
        None  # makes the problem on the mesh of a point; None if the mesh does not move
    )
    kernel: Kernel | None = (
        None  # motions on which K is singular; None if imposed displacements hold all bodies
    )
    #: B with the columns of imposed dofs, (N_lambda, N), for forces on them; None if it is unknown
    whole_contact: csr_matrix | None = None
    law: ContactLaw = UNILATERAL  #: law of the contact conditions, those of pressures first
    group: ProcessGroup = ALONE  #: processes that have some rows each
    shares: Shares | None = (
        None  # of contact pairs in conditions that several state; None without such conditions
    )

    @property
    def free(self) -> np.ndarray:
        """Dofs with an unknown, neither imposed nor dependent on others, (N,) bool."""
        return self.prolongation.free

    @property
    def lifts(self) -> csc_matrix:
        """Imposed displacements L, sparse, (N, 1 + T), see :class:`Prolongation`."""
        return self.prolongation.lifts

    @cached_property
    def external(self) -> csc_matrix:
        """T^T F on free dofs, sparse, (N, 1 + T)."""
        return masked(self.prolongation.restrict(self.forces), self.free)

    @cached_property
    def lift_terms(self) -> tuple[csc_matrix, ...]:
        """T^T K_q L on free dofs of each part of K, sparse, (N, 1 + T) each."""
        return tuple(masked(self.prolongation.restrict(pull), self.free) for pull in self.pulls)

    @cached_property
    def loads(self) -> csc_matrix:
        """T^T (F - K L) on free dofs in the middle of the box, thesis (1.22), sparse, (N, 1 +
        T).
        """
        return self.external - self._summed(self.lift_terms, self.weights(self.middle))

    @cached_property
    def pulled(self) -> csc_matrix:
        """K L of all dofs in the middle of the box, before dependent ones are eliminated, sparse,
        (N, 1 + T).
        """
        return self._summed(self.pulls, self.weights(self.middle))

    def _summed(self, parts: Sequence[csc_matrix], weights: np.ndarray) -> csc_matrix:
        """Sum of terms of parts of K, (N, 1 + T) each, by their weights, (Q,).

        All are 1 if K is constant.
        """
        weights = weights if self.moduli else np.ones(len(parts))
        terms = (weight * term for weight, term in zip(weights, parts, strict=True))
        return csc_matrix(sum(terms, start=csc_matrix(self.forces.shape)))

    @property
    def held(self) -> np.ndarray:
        """Dofs on which K is definite, (N,) bool: the free dofs without those that fix its
        kernel.
        """
        if self.kernel is None:
            return self.free
        mask = self.free.copy()
        mask[self.kernel.pins] = False
        return mask

    @property
    def held_by_contact(self) -> bool:
        """True if contact alone resists motions of bodies."""
        return self.kernel is not None and bool(self.kernel.motions.shape[1])

    @property
    def varies(self) -> bool:
        """True if more than loads, gaps and lifts depends on parameters."""
        return bool(self.moduli) or self.reshaped is not None or not self.stiffness_terms

    @cached_property
    def pressing(self) -> np.ndarray:
        """Conditions with the force of a pressure, (N_lambda,) bool."""
        return self.law.pressing(len(self.gaps))

    @cached_property
    def distinct(self) -> np.ndarray:
        """Conditions that no other condition repeats, (N_lambda,) bool."""
        return self.law.distinct(len(self.gaps))

    def require_parts(self, what: str = "what reads K") -> None:
        """Refuse a K that is not a sum of known parts.

        Args:
            what: description of the request for the message.

        Raises:
            NotOfferedError: if the parts are unknown.
        """
        if not self.stiffness_terms:
            raise NotOfferedError(
                f"{what} is not offered for a user-defined system without parts: it would leave "
                "out what the system adds to K. Solve with the full model, or return weights and "
                "matrices from parts()"
            )

    def require_no_memory(self, what: str) -> None:
        """Refuse a law that remembers, in functions for pressures alone.

        Args:
            what: description of the request for the message.

        Raises:
            NotOfferedError: if the law remembers.
        """
        if self.law.remembers:
            raise NotOfferedError(
                f"{what} is not built in where contacts have {self.law.name}: march along paths, "
                "or condense elastic bodies, hhr.condense(scene)"
            )

    def shares_of(self, place: int) -> np.ndarray:
        """Share of a contact pair, by its index in the scene, in each condition, (N_lambda,).

        Zero without one.
        """
        if self.shares is None:
            return (self.contact_pairs == place).astype(float)
        return self.shares.of(place, self.contact_pairs)

    def pressing_of(self, place: int) -> np.ndarray:
        """Numbers of the conditions of pressures of a contact pair, by its index in the scene."""
        return np.flatnonzero((self.shares_of(place) > 0) & self.pressing)

    def at(self, mu: PointLike) -> ContactProblem:
        """The problem with the constant stiffness of one parameter.

        The problem itself if nothing varies.
        """
        if not self.varies:
            return self
        point = self.parameters.point(mu)
        problem = self if self.reshaped is None else self.reshaped(point)
        if not problem.moduli:
            return problem
        weights = problem.weights(point)
        stiffness = (problem.stiffness_of(weights),)
        pulls = (problem._summed(problem.pulls, weights),)
        return replace(problem, moduli=(), reshaped=None, stiffness_terms=stiffness, pulls=pulls)

    def stiffness_of(self, weights: np.ndarray) -> csr_matrix:
        """Local rows of K for weights of its parts, (Q,); no copy in the middle of the box."""
        same = np.array_equal(weights, self.weights(self.middle))
        return self.own_stiffness if same else self.combined(weights)

    def loads_at(self, point: np.ndarray, theta: Theta | np.ndarray) -> np.ndarray:
        """Loads T^T (F - K L) θ on free dofs at a point of a scene with a constant shape, (N,).

        Args:
            point: parameters, (P,).
            theta: θ at the point. With its slopes, (1 + T, k), the result is those of the loads at
                constant stiffness, (N, k).
        """
        acting = self.loads @ theta
        if self.moduli:
            changes = self.weights(self.middle) - self.weights(point)
            for change, term in zip(changes, self.lift_terms, strict=True):
                if change and term.nnz:
                    acting = acting + change * (term @ theta)
        return acting

    @property
    def middle(self) -> np.ndarray:
        """The middle of the box, (P,)."""
        return self.parameters.middle

    def weights(self, point: np.ndarray) -> np.ndarray:
        """Weights of the parts of K at a point, (Q,)."""
        return np.array([modulus.value(point) for modulus in self.moduli])

    def combined(self, weights: np.ndarray) -> csr_matrix:
        """Weighted sum of parts of K with one pattern, (own, N)."""
        first = self.stiffness_terms[0]
        entries = weights[0] * first.data
        for weight, term in zip(weights[1:], self.stiffness_terms[1:], strict=True):
            entries += weight * term.data
        return csr_matrix((entries, first.indices, first.indptr), shape=first.shape)

    @property
    def rows(self) -> slice:
        """Range of the dofs whose rows are local."""
        return slice(self.first, self.first + self.block_size * self.node_mass.shape[0])

    @cached_property
    def spread(self) -> Rows:
        """Operations on tables with a row for each dof, of which this rank has the local rows."""
        return rows_of(self.rows, self.free.size, self.group)

    @property
    def whole(self) -> bool:
        """True if all rows are local."""
        return self.node_mass.shape[0] == len(self.points)

    def gathered(self, comm: Comm) -> ContactProblem:
        """The problem with all rows on every process; the problem itself if all rows are local.

        Collective.

        Raises:
            SceneError: if the ranks do not hold all rows.
        """
        group = group_of(comm)
        if all(group.gathered(self.whole)):
            return self
        shares = group.gathered((self.first, self.stiffness_terms, self.node_mass))
        _, terms, masses = zip(*sorted(shares, key=itemgetter(0)), strict=True)
        held = self.block_size * sum(mass.shape[0] for mass in masses)
        if held != self.free.size:
            raise SceneError(
                f"the ranks hold {held} rows of a problem of {self.free.size} dofs: give the "
                "communicator of its model"
            )
        stiffness = tuple(
            csr_matrix(vstack(local_terms)) for local_terms in zip(*terms, strict=True)
        )
        mass = csr_matrix(vstack(masses))
        return replace(self, stiffness_terms=stiffness, node_mass=mass, first=0, group=ALONE)

    def require_whole(self) -> None:
        """Refuse a distributed problem in functions that need all rows.

        Raises:
            SceneError: if this rank does not hold all rows.
        """
        if not self.whole:
            raise SceneError(
                f"rows {self.rows.start} to {self.rows.stop - 1} of {self.free.size} are held "
                "here, and all are needed: solve on one rank (MPI.COMM_SELF), or take "
                "full.gathered(), problem.gathered(comm)"
            )

    @property
    def block_size(self) -> int:
        """Dofs per node; the dofs of node n are ``block_size * n + component``."""
        return self.free.size // self.points.shape[0]

    def theta(self, mu: PointLike) -> Theta:
        """θ at a parameter given as a number, a sequence or a mapping.

        See :meth:`ParameterSpace.point`.
        """
        return self.amplitudes(self.parameters.point(mu))

    @property
    def mass(self) -> csr_matrix:
        """Local rows of the Gram matrix of the L2 product, without coupling of components, (own,
        N).
        """
        return csr_matrix(kron(self.node_mass, identity(self.block_size), format="csr"))

    @cached_property
    def own_stiffness(self) -> csr_matrix:
        """Local rows of K, without boundary conditions, (own, N)."""
        self.require_parts()
        if self.moduli:
            return self.combined(self.weights(self.middle))
        first, *further = self.stiffness_terms
        return sum(further, start=first)

    @property
    def stiffness(self) -> csr_matrix:
        """K of all dofs, without boundary conditions, (N, N)."""
        self.require_whole()
        return self.own_stiffness

    @cached_property
    def stiffness_of_rows(self) -> Product:
        """K for products with tables of which each rank has local rows, (own, k)."""
        return self.spread.matrix(self.own_stiffness)

    @cached_property
    def on_rows(self) -> OnRows | None:
        """T and T^T for products with tables of local rows, (own, k).

        None if no dof depends on others.
        """
        return self.prolongation.on_rows(self.spread, self.group)

    def prolonged(self, fields: np.ndarray) -> np.ndarray:
        """T V of local rows of fields, (own, k): dependent dofs follow the others. Collective."""
        return fields if self.on_rows is None else self.on_rows.prolong @ fields

    def contact_rows_times(self, table: np.ndarray) -> np.ndarray:
        """B V, the product of B and a table V of local rows of fields, (N_lambda, k) on all
        ranks.
        """
        return self.spread.sum(self.contact_of_rows @ table)

    @cached_property
    def contact_of_rows(self) -> csr_matrix:
        """Local columns of B, (N_lambda, own)."""
        return self.spread.columns(self.contact)

    @cached_property
    def bodies(self) -> tuple[np.ndarray, ...]:
        """Dofs of each connected component of K, in their order."""
        label = self._component_of_dofs()
        return tuple(np.flatnonzero(label == number) for number in range(label.max() + 1))

    def _component_of_dofs(self) -> np.ndarray:
        """Number of the connected component of each dof, (N,), by the couplings of all ranks."""
        size = self.free.size
        stiffness = self.own_stiffness
        ends = np.full(size + 1, stiffness.nnz, dtype=stiffness.indptr.dtype)
        ends[: self.rows.stop + 1] = 0
        ends[self.rows.start : self.rows.stop + 1] = stiffness.indptr
        joined = csr_matrix((stiffness.data, stiffness.indices, ends), shape=(size, size))
        joined = self.prolongation.coupled(joined)
        count, label = connected_components(joined, directed=False)
        if self.group.size == 1:
            self.require_whole()
            return label
        counts, labels = zip(*self.group.gathered((count, label)), strict=True)
        # dofs, followed by the components of each process
        firsts = size + np.cumsum([0, *counts])
        components = np.concatenate(
            [
                labels_of_rank + first
                for labels_of_rank, first in zip(labels, firsts[:-1], strict=True)
            ]
        )
        total = int(firsts[-1])
        edges = np.ones(components.size), (np.tile(np.arange(size), len(counts)), components)
        return connected_components(csr_matrix(edges, shape=(total, total)), directed=False)[1][
            :size
        ]

    def doubled_energy(self, unknown: np.ndarray, theta: Theta) -> float:
        """U^T K U of U = U0 + L θ on one rank, with U0, (N,); K of all dofs acts on L.

        Args:
            unknown: U0, (N,).
            theta: θ.
        """
        inner = unknown @ (self.stiffness @ unknown)
        return float(inner + (2 * unknown + self.lifts @ theta) @ (self.pulled @ theta))

    def stacked(self, own: csr_matrix) -> csc_matrix:
        """Assemble a sparse matrix from the rows of each process. Collective."""
        if self.group.size == 1:
            self.require_whole()
        return csc_matrix(self.group.stacked(own))

    @cached_property
    def contact_norm(self) -> float:
        """Largest Euclidean norm of a row of B: the scale for zero entries of B V with an
        orthonormal V.
        """
        return float(np.sqrt(self.contact.multiply(self.contact).sum(axis=1).max()))

    def condition_number(self, smallest: float, largest: float) -> float:
        """Condition number kappa of B V.

        Infinite if rows are dependent to round-off, (1.67).

        Args:
            smallest: smallest singular value of B V.
            largest: largest singular value of B V.
        """
        return (
            largest / smallest
            if smallest > DEPENDENT_ROWS * max(largest, self.contact_norm)
            else math.inf
        )


@dataclass(frozen=True)
class IndexSets:
    """Index sets of a RID, named as in the thesis."""

    cells: np.ndarray  #: cells of Omega_A, (1.55)
    #: free dofs not connected to the rest of the domain, (1.35), except the nodes removed to close
    #: the RID
    A: np.ndarray
    A_lambda: (
        np.ndarray
    )  #: contact conditions whose slave node lies inside and which act on A, (1.36), (5.6)
    A_c: (
        np.ndarray
    )  #: dofs of A connected to A_lambda through B, (1.58), (5.20): where contact forces act
    A_c_tilde: np.ndarray  #: all dofs connected to A_lambda through B, (5.20): where gaps are read
    I: np.ndarray  #: dofs of the interface, connected to A through K but not in A, (1.59)
