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
    """Bodies with the motions along which a stiffness, local rows (own, N), does no work."""
    left = []
    for body in bodies:
        columns = body.columns(len(problem.points))
        own = columns[problem.rows]
        sizes = problem.spread.sum(abs(own).T @ (abs(stiffness) @ abs(columns)))
        energies = problem.spread.sum(own.T @ (stiffness @ columns))
        values, ways = np.linalg.eigh((energies + energies.T) / 2)
        ways = ways[:, np.abs(values) <= ROUND_OFF_OF_ENERGY * sizes.max()]
        left.append(replace(body, left=ways.T @ body.left))
    return [body for body in left if len(body.left)]
