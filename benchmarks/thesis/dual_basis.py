"""Theorem 1 of the thesis, (2.52) and (2.53), on a model with a dual basis, see the plug-in rivals.

Norms are those in which the constants are sharp: the energy norm of displacements, in which M_a =
alpha_Ker = 1, and |q|_S of forces with S = B K^-1 B^T, in which M_b = 1 and, with the supremizers
of the model, beta_RB = 1. The infimum of (2.52) is that of its proof, over v for which v - u_RB
lies in the kernel of b on the reduced spaces, as for theorems 4 to 6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import linalg
from scipy.optimize import nnls

from hhr_dolfinx.certify.constants import inf_sup
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.plugins.rivals.projection import ConeModel


class Theorem1(NamedTuple):
    """Both sides at points, (n, 2) each: left and right; and the inf-sup constant."""

    displacements: np.ndarray  #: (2.52), in energy
    forces: np.ndarray  #: (2.53), in the S norm
    beta_RB: float


def theorem_1(full: FullOrderModel, model: ConeModel, points: np.ndarray) -> Theorem1:
    """Both sides of (2.52) and (2.53) at points, (n, P).

    Args:
        full: the full model.
        model: a model with a dual basis of it.
        points: points of the box, (n, P).
    """
    problem = full.problem
    stiffness, root = problem.stiffness, linalg.cholesky(full.schur)
    cone, basis = model.fields.cone, model.fields.basis
    rows = cone.T @ (problem.contact @ basis)
    gram = basis.T @ (stiffness @ basis)
    kernel = basis @ linalg.null_space(rows)
    moved = stiffness @ kernel
    factor = linalg.cho_factor(kernel.T @ moved)
    weighted = root @ cone
    displacements, forces = [], []
    for point in points:
        answer, exact = model.solve(point, outside="ignore"), full.solve(point)
        error = exact.displacement() - answer.displacement()
        size = float(np.sqrt(error @ (stiffness @ error)))
        seen = moved.T @ error
        nearest = np.sqrt(max(size**2 - seen @ linalg.cho_solve(factor, seen), 0.0))
        outside = nnls(weighted, root @ exact.forces())[1]
        displacements.append((size, 2 * nearest + outside))
        off = float(np.linalg.norm(root @ (exact.forces() - answer.forces())))
        forces.append((off, 2 * outside + size))
    beta = inf_sup(rows, gram, weighted.T @ weighted)
    return Theorem1(np.array(displacements), np.array(forces), beta)
