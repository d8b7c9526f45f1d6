"""The contact problem of a RID alone: its equations, with imposed values on its interface.

An indicator (1.73) solves it: the difference between the answer of a reduced model and the solution of the full
equations inside the RID for the same values on the interface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.contact.problem import ContactProblem, IndexSets, masked


@dataclass(frozen=True)
class Restriction:
    """The problem of a RID, whose free dofs are A; dofs of its other nodes are imposed, including the interface I."""

    problem: ContactProblem  # with U0 = 0 on imposed dofs; loads are those of A, conditions those of A_lambda, (1.21)
    dofs: np.ndarray  # number in the whole problem of each of its dofs, (n,)
    gap_of: csr_matrix  # closure of each gap by unit values on imposed dofs, -B, sparse, (N_lambda_C, n)


def restricted(problem: ContactProblem, sets: IndexSets) -> Restriction:
    """Cut the problem of a RID out of the whole one; for a RID of the whole domain return the whole problem.

    The RID is closed: no condition outside A_lambda acts on A.
    """
    problem.require_whole()
    size = problem.block_size
    nodes = np.union1d(problem.cell_nodes[sets.cells].ravel(), sets.A_c_tilde // size)
    dofs = (nodes[:, None] * size + np.arange(size)).ravel()
    free = np.isin(dofs, sets.A)
    number = np.full(len(problem.points), -1)
    number[nodes] = np.arange(nodes.size)
    rows = problem.contact[sets.A_lambda][:, dofs]
    part = replace(
        problem,
        stiffness_terms=tuple(term[dofs][:, dofs] for term in problem.stiffness_terms),
        node_mass=problem.node_mass[nodes][:, nodes],
        free=free,
        loads=masked(problem.loads[dofs], free),
        lifts=csc_matrix(problem.lifts[dofs]),
        contact=csr_matrix(masked(rows.T, free).T),
        gaps=np.asfortranarray(problem.gaps[sets.A_lambda]),
        contact_slaves=number[problem.contact_slaves[sets.A_lambda]],
        contact_pairs=problem.contact_pairs[sets.A_lambda],
        contact_points=problem.contact_points[sets.A_lambda],
        contact_areas=problem.contact_areas[sets.A_lambda],
        cell_nodes=number[problem.cell_nodes[sets.cells]],
        points=problem.points[nodes],
    )
    return Restriction(part, dofs, -csr_matrix(rows))
