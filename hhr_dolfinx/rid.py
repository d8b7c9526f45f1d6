"""Reduced integration domain (RID) and its index sets, thesis section 1.4.3."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.problem import ContactProblem


@dataclass(frozen=True)
class IndexSets:
    """Index sets of a RID, named as in the thesis.

    Attributes:
        cells: cells of Omega_A, (1.55).
        A: free dofs not connected to the rest of the domain, (1.35).
        A_lambda: contact conditions whose nodes all lie in A, (1.36).
        A_c: dofs of A connected to A_lambda through B, (1.58).
        I: dofs of the interface, connected to A through K but not in A, (1.59).
    """

    cells: np.ndarray
    A: np.ndarray
    A_lambda: np.ndarray
    A_c: np.ndarray
    I: np.ndarray


def reduced_domain(problem: ContactProblem, nodes: np.ndarray, layers: int = 0) -> IndexSets:
    """Union of the supports of the given nodes and of the nodes they face, thesis (1.55).

    A node of a contact surface brings in the nodes it is paired with, so that its gap can be
    computed inside the RID (figure 1.13b).

    Args:
        problem: the full problem; only its connectivity is used.
        nodes: nodes picked by DEIM and by zones of interest.
        layers: layers of cells added around the union.

    Raises:
        ReductionError: if no contact condition lies inside the RID.
    """
    incidence = _incidence(problem)
    inside = np.zeros(problem.points.shape[0], dtype=bool)
    inside[nodes] = True
    inside = _with_facing_nodes(problem, inside)
    cells = incidence @ inside > 0
    for _ in range(layers):
        cells = incidence @ (incidence.T @ cells) > 0
    return _index_sets(problem, incidence, cells)


def whole_domain(problem: ContactProblem) -> IndexSets:
    """The RID that is the whole domain: plain Galerkin projection with all contact conditions."""
    return _index_sets(problem, _incidence(problem), np.ones(len(problem.cell_nodes), dtype=bool))


def _incidence(problem):
    """Cells by nodes, 1 where the node belongs to the cell."""
    cells, per_cell = problem.cell_nodes.shape
    indptr = np.arange(0, cells * per_cell + 1, per_cell)
    data = np.ones(cells * per_cell)
    return csr_matrix((data, problem.cell_nodes.ravel(), indptr), shape=(cells, len(problem.points)))


def _rows_by_nodes(problem):
    """Contact conditions by nodes, non-zero where the condition touches the node."""
    coo = problem.contact.tocoo()
    shape = (problem.contact.shape[0], len(problem.points))
    return csr_matrix((np.ones(coo.nnz), (coo.row, coo.col // problem.block_size)), shape=shape)


def _with_facing_nodes(problem, inside):
    rows = _rows_by_nodes(problem)
    while True:
        grown = inside | (rows.T @ (rows @ inside > 0) > 0)
        if (grown == inside).all():
            return inside
        inside = grown


def _index_sets(problem, incidence, cells) -> IndexSets:
    touched_outside = incidence.T @ ~cells > 0
    in_A = np.repeat(~touched_outside, problem.block_size) & problem.free
    rows = _rows_by_nodes(problem)
    in_A_lambda = rows @ touched_outside == 0
    if not in_A_lambda.any():
        raise ReductionError(
            "no contact condition lies inside the reduced integration domain: "
            "add contact nodes as a zone of interest, or layers"
        )
    in_A_c = in_A & (abs(problem.contact[in_A_lambda]).T @ np.ones(in_A_lambda.sum()) > 0)
    in_I = ~in_A & (abs(problem.stiffness[in_A]).T @ np.ones(in_A.sum()) > 0)
    return IndexSets(*(np.flatnonzero(mask) for mask in (cells, in_A, in_A_lambda, in_A_c, in_I)))
