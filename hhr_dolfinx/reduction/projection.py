"""The reduced integration domain (RID) and the projection on it.

Index sets of thesis sections 1.4.3 and 5.2.3, and the Petrov-Galerkin projection of the contact
problem, (1.61) and (5.23).

A RID is *closed* if every contact condition that acts on a dof of A belongs to A_lambda. Only then
the equations tested on A include all the forces that the full model has there. One missing
multiplier makes answers useless (errors of 240 % occurred) without any other sign. Nodes bring in
those they face. Master nodes whose slaves still do not all lie in A are removed from A and become
part of the interface (figure 5.3a).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.sparse import csr_matrix, diags, issparse, vstack

from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.models.eliminations.projected import ReducedProblem, ReducedTerms

MODES_AT_ONCE = 16
"""Modes that K of a whole mesh is multiplied with at once."""
COPIED = 20_000_000
"""Most numbers copied of the modes of one body, 160 MB, so that its part of K is not multiplied
with other modes.
"""


def project(problem: ContactProblem, basis: np.ndarray, sets: IndexSets) -> ReducedProblem:
    """Petrov-Galerkin projection of (1.21) on a basis and a closed RID, thesis (1.61), (5.23).

    The test functions are the modes cut off outside A; the trial functions are the whole modes. A
    Galerkin projection of K with restricted multipliers would be inconsistent.

    Args:
        problem: the contact problem.
        basis: V, (own, ell).
        sets: index sets of the RID.

    Raises:
        ReductionError: if the RID is not closed.
    """
    opened = open_conditions(problem, sets)
    if opened.size:
        raise ReductionError(
            f"the RID is not closed: {opened.size} contact conditions outside it act on its inner "
            f"nodes, e.g. the one at {problem.contact_points[opened[0]].tolist()}; build it with "
            "reduced_domain"
        )
    shared = problem.spread
    modes: Modes = _Modes(basis, sets) if shared.all_here else shared.modes(problem, basis, sets)
    loads = modes.tested(problem.loads)
    terms = None
    if problem.moduli:
        weights = problem.weights(problem.middle)
        lifts = np.stack([modes.tested(term) for term in problem.lift_terms])
        matrices = np.stack([modes.projected(term) for term in problem.stiffness_terms])
        terms = ReducedTerms(
            matrices, lifts, loads + np.tensordot(weights, lifts, 1), problem.moduli
        )
        stiffness = np.tensordot(weights, matrices, 1)
    else:
        stiffness = modes.projected(problem.own_stiffness)

    rows = problem.contact[sets.A_lambda]

    def rows_times_modes(dofs: np.ndarray) -> np.ndarray:
        """The rows times the modes on some dofs alone, (m, ell)."""
        local = shared.mine(dofs)
        return shared.sum(rows[:, local + problem.first] @ basis[local])

    reduced = ReducedProblem(
        stiffness=stiffness,
        contact_test=rows_times_modes(sets.A_c),
        contact_trial=rows_times_modes(sets.A_c_tilde),
        loads=loads,
        gaps=problem.gaps[sets.A_lambda] + 0.0,  # files keep zeros with a sign
        pairs=problem.contact_pairs[sets.A_lambda],
        motions=0 if problem.kernel is None else problem.kernel.motions.shape[1],
        terms=terms,
    )
    return (
        problem.kernel.balanced(problem, basis, sets, reduced)
        if reduced.motions and problem.kernel
        else reduced
    )


class Modes(Protocol):
    """Modes as test functions on dofs A, and as trial functions on A and the dofs I around."""

    def projected(self, stiffness: csr_matrix) -> np.ndarray:
        """V^T K V, tested on A, (ell, ell)."""

    def tested(self, columns: np.ndarray | csr_matrix) -> np.ndarray:
        """Columns of dofs, dense or sparse, (N, k), tested by the modes: (ell, k)."""


class _Modes:
    """All rows of such modes, (N, ell)."""

    def __init__(self, basis: np.ndarray, sets: IndexSets):
        self._basis = basis
        self._rows = sets.A
        self._support = np.union1d(sets.A, sets.I)
        few = 2 * sets.A.size <= len(basis)
        self._test = basis[sets.A] if few else None  # modes are not copied for most of the rows

    def projected(self, stiffness: csr_matrix) -> np.ndarray:
        basis = self._basis
        if self._test is not None:
            return self._test.T @ (stiffness[self._rows][:, self._support] @ basis[self._support])
        # rows and columns of K are not copied for most of a mesh
        cut = np.zeros(len(basis), dtype=bool)
        cut[self._support] = True
        moving = self._moved_by(stiffness, cut)
        few = moving.size * 2 <= basis.shape[1] and moving.size * len(basis) <= COPIED
        moving = moving if few else np.arange(basis.shape[1])
        trial = basis[:, moving] if few else basis
        product = np.zeros((basis.shape[1], basis.shape[1]))
        for first in range(0, moving.size, MODES_AT_ONCE):
            block = slice(first, first + MODES_AT_ONCE)
            product[np.ix_(moving, moving[block])] = self._test_by(
                trial, stiffness @ (cut[:, None] * trial[:, block])
            )
        return product

    def _moved_by(self, stiffness: csr_matrix, cut: np.ndarray) -> np.ndarray:
        """Numbers of the modes that are non-zero on the dofs of a matrix.

        Often a part of K is that of one body.
        """
        # a row of zeros times random numbers is zero; any other row gives zero with probability
        # zero
        rows = cut & (stiffness @ np.random.default_rng(0).standard_normal(len(cut)) != 0)
        blocks = [
            slice(first, first + MODES_AT_ONCE)
            for first in range(0, self._basis.shape[1], MODES_AT_ONCE)
        ]
        return np.flatnonzero(
            np.concatenate([(self._basis[:, block] != 0)[rows].any(axis=0) for block in blocks])
        )

    def tested(self, columns: np.ndarray | csr_matrix) -> np.ndarray:
        return (
            self._test.T @ columns[self._rows]
            if self._test is not None
            else self._test_by(self._basis, columns)
        )

    def _test_by(self, modes: np.ndarray, columns: np.ndarray | csr_matrix) -> np.ndarray:
        """Columns of dofs tested by modes on the whole mesh, (N, r): (r, k).

        Used if most rows are in A.
        """
        untested = np.ones(len(modes), dtype=bool)
        untested[self._rows] = False
        if issparse(columns):
            selection = diags((~untested).astype(float))
            return np.ascontiguousarray((csr_matrix((selection @ columns).T) @ modes).T)
        return modes.T @ np.where(untested[:, None], 0.0, columns)


def reduced_domain(problem: ContactProblem, nodes: np.ndarray, layers: int = 0) -> IndexSets:
    """Closed RID around some nodes and the nodes they face, thesis (1.55), section 5.2.3.

    A node of a contact surface brings in the slaves of its conditions and the nodes these face, so
    that gaps can be computed inside the RID (figure 1.13b). The given nodes stay in A: if closing
    the RID would remove one, the RID grows until it does not. If every row overlaps the next
    (double pass, standard mortar multipliers) that ends with the whole contact surface. Of the
    problem only its connectivity is used.

    Args:
        problem: the contact problem.
        nodes: numbers of the nodes, (n,).
        layers: layers of cells added around the union of their supports.

    Raises:
        ReductionError: if no contact condition lies inside.
    """
    nodes_of_cells = problem.cell_nodes
    count = len(problem.points)
    starts = np.arange(0, nodes_of_cells.size + 1, nodes_of_cells.shape[1])
    # cells by nodes, 1 where the node belongs to the cell; conditions by nodes, non-zero where they
    # touch the node
    incidence = csr_matrix(
        (np.ones(nodes_of_cells.size), nodes_of_cells.ravel(), starts),
        shape=(len(nodes_of_cells), count),
    )
    if problem.prolongation.groups is not None:
        incidence = csr_matrix(vstack([incidence, problem.prolongation.groups]))
    coo = problem.contact.tocoo()
    touching = np.ones(coo.nnz), (coo.row, coo.col // problem.block_size)
    rows = csr_matrix(touching, shape=(coo.shape[0], count))
    slaves = problem.contact_slaves
    wanted = np.zeros(count, dtype=bool)
    wanted[nodes] = True
    while True:
        reached = wanted.copy()
        reached[slaves[rows @ wanted > 0]] = True
        reached |= rows.T @ reached[slaves] > 0  # the nodes that these slaves face
        cells = incidence @ reached > 0
        for _ in range(layers):
            cells = incidence @ (incidence.T @ cells) > 0
        inner = incidence.T @ ~cells == 0
        # until no condition whose slave lies outside acts on the others
        while (touched := inner & (rows.T @ ~inner[slaves] > 0)).any():
            inner = inner & ~touched
        lost = wanted & ~inner
        if not lost.any():
            return _index_sets(problem, cells[: len(nodes_of_cells)], inner)
        wanted[slaves[rows @ lost > 0]] = True


def open_conditions(problem: ContactProblem, sets: IndexSets) -> np.ndarray:
    """Contact conditions outside A_lambda that act on A; a closed RID has none (section 5.2.3).

    Args:
        problem: the contact problem.
        sets: index sets of the RID.
    """
    acting = np.unique(problem.contact[:, sets.A].nonzero()[0])
    return np.setdiff1d(acting, sets.A_lambda)


def _index_sets(problem: ContactProblem, cells: np.ndarray, inner: np.ndarray) -> IndexSets:
    in_A = np.repeat(inner, problem.block_size) & problem.free
    # an imposed slave whose masters lie outside would give a row of zeros in B~1
    acts = abs(problem.contact) @ in_A.astype(float) > 0
    in_A_lambda = problem.law.kept_with(inner[problem.contact_slaves] & acts, problem.contact)
    if not in_A_lambda.any():
        raise ReductionError(
            "no contact condition lies inside the reduced integration domain: "
            "add contact nodes as a zone of interest, or layers"
        )
    in_A_c_tilde = abs(problem.contact[in_A_lambda]).T @ np.ones(in_A_lambda.sum()) > 0
    rows = problem.spread
    local = rows.of(in_A)
    in_I = ~in_A & (rows.sum(abs(problem.own_stiffness[local]).T @ np.ones(local.sum())) > 0)
    masks = (cells, in_A, in_A_lambda, in_A & in_A_c_tilde, in_A_c_tilde, in_I)
    return IndexSets(*(np.flatnonzero(mask) for mask in masks))


def load_nodes(problem: ContactProblem) -> np.ndarray:
    """One node for each term of θ that loads the problem.

    A RID without any load would answer zero to every parameter. A partial pressure has terms all
    along its line. The node is the one where the load acts most on free dofs; among equals that
    with the smallest coordinates, so that it does not depend on node numbers.
    """
    loaded = []
    for column in problem.loads.T:
        size = np.abs(column.toarray()).reshape(-1, problem.block_size).max(axis=1)
        if size.max() > 0:
            equals = np.flatnonzero(size > (1 - 1e-6) * size.max())
            loaded.append(equals[np.lexsort(problem.points[equals].T[::-1])[0]])
    return np.array(loaded, dtype=np.int64)


def checked_nodes(nodes: np.ndarray, count: int, what: str = "the zone") -> np.ndarray:
    """Check the nodes that a step has chosen, (n,).

    Args:
        nodes: node numbers, or a mask of all nodes.
        count: number of nodes of the mesh.
        what: name of the step, for the message.

    Raises:
        ReductionError: for a mask of another length, values that are no numbers of nodes, or nodes
            that are not in the mesh.
    """
    if nodes.dtype == bool:
        if nodes.shape != (count,):
            raise ReductionError(
                f"{what} is a mask of shape {nodes.shape}, the mesh has {count} nodes"
            )
        return np.flatnonzero(nodes)
    if nodes.size and not np.issubdtype(nodes.dtype, np.integer):
        raise ReductionError(
            f"{what} holds {nodes.dtype}: it must return node numbers, or a mask of all nodes"
        )
    if nodes.size == count and count > 2 and set(nodes.ravel().tolist()) <= {0, 1}:
        raise ReductionError(
            f"{what} holds a 0 or 1 for each node: make it a mask of bool, or return node numbers"
        )
    unknown = nodes[(nodes < 0) | (nodes >= count)]
    if unknown.size:
        raise ReductionError(
            f"node {unknown[0]} of {what} is not in the mesh, whose nodes are 0 to {count - 1}"
        )
    return nodes.astype(np.int64).ravel()
