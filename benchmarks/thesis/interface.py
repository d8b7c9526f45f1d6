"""Figure 1.13a of the thesis: contact nodes of the RID whose partner lies outside become part of
its interface.

Fauque et al. (2018) hold these nodes at the displacement of the basis; the thesis, and this
code, take the partners into the RID instead (figure 1.13b).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.active_set import SchurEqualities, active_set
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.reduction.enrichment import enrich
from hhr_dolfinx.reduction.projection import project
from hhr_dolfinx.reduction.recipe import chosen_nodes
from hhr_dolfinx.study.training.train import Training


def extended(problem: ContactProblem, nodes: np.ndarray) -> IndexSets:
    """Index sets of a RID around nodes alone, closed by an interface through contact.

    Args:
        problem: the contact problem, of node to node.
        nodes: numbers of the nodes, (n,).
    """
    cells = problem.cell_nodes
    chosen = np.isin(cells, nodes).any(axis=1)
    inner = np.zeros(len(problem.points), dtype=bool)
    inner[cells[chosen]] = True
    inner[cells[~chosen]] = False
    coo = problem.contact.tocoo()
    touches = csr_matrix(
        (np.ones(coo.nnz), (coo.row, coo.col // problem.block_size)),
        shape=(len(problem.gaps), len(problem.points)),
    )
    whole = touches @ ~inner == 0
    orphans = touches[~whole].T @ np.ones((~whole).sum()) > 0
    inner &= ~orphans
    in_A = np.repeat(inner, problem.block_size) & problem.free
    A_lambda = np.flatnonzero(whole & (abs(problem.contact) @ in_A.astype(float) > 0))
    read = abs(problem.contact[A_lambda]).T @ np.ones(A_lambda.size) > 0
    around = abs(problem.stiffness[in_A]).T @ np.ones(in_A.sum()) > 0
    masks = in_A & read, read, ~in_A & around
    return IndexSets(
        np.flatnonzero(chosen), np.flatnonzero(in_A), A_lambda, *map(np.flatnonzero, masks)
    )


@dataclass(frozen=True)
class ExtendedInterface:
    """A reduced model on such a RID.

    Attributes:
        problem: the contact problem.
        inside: its conditions, (m,).
        of_closed: number of conditions of the RID that is closed by partners.
        equalities: equality problems on S~; None without a condition.
        free: free slack of each term, (m, 1 + T).
    """

    problem: ContactProblem
    inside: np.ndarray
    of_closed: int
    equalities: SchurEqualities | None
    free: np.ndarray

    @classmethod
    def of(cls, training: Training, model: Any) -> ExtendedInterface:
        """The model with the basis and the nodes of another one, which has partners."""
        problem, recipe = training.full_order.problem, model.offline.recipe
        added = len(model.offline.enrichment.added)
        basis = model.offline.basis[:, : model.offline.basis.shape[1] - added]
        nodes = chosen_nodes(problem, training.snapshots, recipe, basis)
        sets = extended(problem, nodes)
        closed = len(model.fields.A_lambda)
        if not sets.A_lambda.size:
            nothing = np.zeros((0, problem.gaps.shape[1]))
            return cls(problem, sets.A_lambda, closed, None, nothing)
        basis = enrich(problem, basis, sets, recipe.enrichment.kappa_max).basis
        reduced = project(problem, basis, sets)
        compliance = np.linalg.solve(reduced.stiffness, reduced.contact_test.T)
        schur = reduced.contact_trial @ compliance
        free = reduced.gaps - reduced.contact_trial @ np.linalg.solve(
            reduced.stiffness, reduced.loads
        )
        return cls(problem, sets.A_lambda, closed, SchurEqualities.of(schur), free)

    @property
    def conditions(self) -> int:
        """Number of its conditions."""
        return len(self.inside)

    def error(self, point: np.ndarray, exact: np.ndarray) -> float:
        """Relative error of forces on its conditions; infinite without an answer."""
        if self.equalities is None:
            return np.inf
        slack = self.free @ self.problem.amplitudes(point)
        found = active_set(self.equalities, slack, slack < 0)
        if found.status.name != "CONVERGED":
            return np.inf
        exact = exact[self.inside]
        return float(np.linalg.norm(found.forces - exact) / (np.linalg.norm(exact) or 1.0))
