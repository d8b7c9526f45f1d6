"""Reduced models of other authors as baselines, each with the same ``solve(mu)``.

They project the stiffness on POD modes over the whole domain and look for the contact forces in a cone
spanned by few non-negative vectors: snapshots picked greedily (A. Benaceur, A. Ern and V. Ehrlacher,
"A reduced basis method for parametrized variational inequalities applied to contact mechanics", IJNME 121,
2020) or factors of a non-negative factorisation (M. Balajewicz, D. Amsallem and C. Farhat, "Projection-based
model reduction for contact problems", IJNME 106, 2016). Supremizers K^-1 B^T phi make them solvable.
"""

from __future__ import annotations

import warnings

import numpy as np
from scipy import linalg
from scipy.optimize import nnls

from hhr_dolfinx.compat import extra
from hhr_dolfinx.full_order.elastic import FullOrderModel
from hhr_dolfinx.linear.dense import PetscLU
from hhr_dolfinx.models.condensed import CondensedContact, KnownStatuses, Responses
from hhr_dolfinx.reduction.pod import pod
from hhr_dolfinx.snapshots.solutions import SnapshotSet


class DualBasisModel:
    """POD-Galerkin model whose contact forces lie in a cone, lambda = Phi c with c >= 0.

    Args:
        full_order: the full model, on one rank.
        snapshots: training solutions.
        dual_basis: Phi >= 0, (N_lambda, r).
        modes: number of POD modes of the displacement.
    """

    def __init__(self, full_order: FullOrderModel, snapshots: SnapshotSet, dual_basis: np.ndarray, modes: int):
        problem = full_order.problem
        self._problem, self._dual_basis = problem, dual_basis
        basis, _ = pod(snapshots.displacements, 1e-15)
        supremizers = full_order.per_force @ dual_basis
        supremizers /= np.linalg.norm(supremizers, axis=0)
        self._basis, _ = linalg.qr(np.hstack([basis[:, :modes], supremizers]), mode="economic")
        contact = dual_basis.T @ (problem.contact @ self._basis)
        factor, loads = PetscLU(self._basis.T @ (problem.stiffness @ self._basis)), self._basis.T @ problem.loads
        responses = Responses.eliminate(factor, loads, dual_basis.T @ problem.gaps, contact, contact)
        unknown = KnownStatuses(snapshots.points[:1], np.zeros((1, dual_basis.shape[1]), dtype=bool))
        cold = CondensedContact(problem.parameters, problem.amplitudes, responses, unknown)
        # its own answers at the training points, to start from like every other model
        answers = [cold.solve(point, warm=False, raise_on_failure=False) for point in snapshots.points]
        known = KnownStatuses(snapshots.points, np.stack([answer.active for answer in answers]))
        self._online = CondensedContact(problem.parameters, problem.amplitudes, responses, known)
        self.solve = self._online.solve

    def solve_everywhere(self, mu):
        """Displacement (N,) and contact forces (N_lambda,)."""
        solution = self.solve(mu)
        return self._basis @ solution.primal + self._problem.lift(mu), self._dual_basis @ solution.forces


def cone_projected_greedy(forces: np.ndarray, count: int) -> np.ndarray:
    """Snapshots of forces picked one by one where the cone of those before approximates worst.

    Args:
        forces: snapshots, (N_lambda, S), non-negative.
        count: number of vectors wanted.

    Returns:
        Normalised snapshots, (N_lambda, r) with r <= count.
    """
    sizes = np.linalg.norm(forces, axis=0)
    touching = sizes > 1e-9 * sizes.max()
    # relative distances, so that grazing contact counts; a cone does not care for the length of its vectors
    directions = forces[:, touching] / sizes[touching]
    residuals, chosen = np.ones(directions.shape[1]), [int(sizes[touching].argmax())]
    while len(chosen) < count:
        cone = directions[:, chosen]
        for k in np.flatnonzero(residuals > 1e-12):
            residuals[k] = min(residuals[k], nnls(cone, directions[:, k])[1])
        if residuals.max() <= 1e-12:
            break
        chosen.append(int(residuals.argmax()))
    return directions[:, chosen]


def nonnegative_factors(forces: np.ndarray, count: int) -> np.ndarray:
    """Left factor of a non-negative matrix factorisation of the forces, normalised, (N_lambda, r)."""
    with extra("peers", "a basis of non-negative factors"):
        from sklearn.decomposition import NMF

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that it stopped at max_iter: the factors are used as they are
        factors = NMF(count, init="nndsvda", max_iter=2000, tol=1e-7, random_state=0).fit_transform(
            np.maximum(forces, 0.0)
        )
    factors = factors[:, np.linalg.norm(factors, axis=0) > 0]
    return factors / np.linalg.norm(factors, axis=0)
