"""Bodies that a stiffness leaves free to move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.full_order.free_bodies import FreeBody

ROUND_OFF_OF_ENERGY = 1e-13
"""Part of the sum of all terms of the energy of a motion up to which it is round-off."""


def unresisted(
    bodies: list[FreeBody], problem: ContactProblem, stiffness: csr_matrix
) -> list[FreeBody]:
    """Bodies with the motions along which a stiffness does no work.

    Args:
        bodies: bodies with rigid motions.
        problem: the contact problem.
        stiffness: local rows of the stiffness, (own, N).
    """
    remaining = []
    for body in bodies:
        columns = body.columns(len(problem.points))
        local_columns = columns[problem.rows]
        sizes = problem.spread.sum(abs(local_columns).T @ (abs(stiffness) @ abs(columns)))
        energies = problem.spread.sum(local_columns.T @ (stiffness @ columns))
        values, ways = np.linalg.eigh((energies + energies.T) / 2)
        ways = ways[:, np.abs(values) <= ROUND_OFF_OF_ENERGY * sizes.max()]
        remaining.append(replace(body, left=ways.T @ body.left))
    return [body for body in remaining if len(body.left)]
