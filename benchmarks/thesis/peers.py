"""Reduced models of other authors as baselines.

They project the stiffness on POD modes over the whole domain and look for the contact forces in a
cone spanned by few non-negative vectors: snapshots picked greedily (A. Benaceur, A. Ern and V.
Ehrlacher, "A reduced basis method for parametrized variational inequalities applied to contact
mechanics", IJNME 121, 2020) or factors of a non-negative factorisation (M. Balajewicz, D. Amsallem
and C. Farhat, "Projection-based model reduction for contact problems", IJNME 106, 2016).
Supremizers K^-1 B^T phi make them solvable.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.optimize import nnls

from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.linear.dense import PetscLU
from hhr_dolfinx.models.answer import Answer, ElasticFields
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.eliminations.constant import ConstantElimination
from hhr_dolfinx.models.eliminations.elimination import Responses
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.reduction.modes import pod
from hhr_dolfinx.snapshots.records import SnapshotSet


class DualBasisModel:
    """POD-Galerkin model whose contact forces lie in a cone, lambda = Phi c with c >= 0.

    Args:
        full: the full model, on one rank.
        snapshots: training solutions.
        dual_basis: Phi >= 0, (N_lambda, r).
        modes: number of POD modes of the displacement.

    Raises:
        SceneError: where bodies flow.
    """

    def __init__(
        self, full: FullOrderModel, snapshots: SnapshotSet, dual_basis: np.ndarray, modes: int
    ):
        if full.equilibrium is not None:
            raise SceneError(
                f"bodies of scene '{full.scene.name}' flow, and this model projects their "
                "stiffness once"
            )
        problem = full.problem
        basis, _ = pod(snapshots.displacements, 1e-15)
        supremizers = full.per_force @ dual_basis
        supremizers /= np.linalg.norm(supremizers, axis=0)
        basis, _ = linalg.qr(np.hstack([basis[:, :modes], supremizers]), mode="economic")
        contact = dual_basis.T @ (problem.contact @ basis)
        factor, loads = PetscLU(basis.T @ (problem.stiffness @ basis)), problem.loads.T @ basis
        responses = Responses.eliminate(
            factor, loads.T, dual_basis.T @ problem.gaps, contact, contact
        )
        fields = _ConeFields(full, basis, dual_basis)
        given = problem.parameters, ConstantElimination(responses, problem.amplitudes)
        unknown = KnownStatuses(
            snapshots.points[:1], np.zeros((1, dual_basis.shape[1]), dtype=bool)
        )
        cold = CondensedModel(*given, unknown, fields)
        # its own answers at the training points, to start from like every other model
        answers = [
            cold.solve(point, start=None, raise_on_failure=False) for point in snapshots.points
        ]
        known = KnownStatuses(snapshots.points, np.stack([answer.active for answer in answers]))
        online = CondensedModel(*given, known, fields)
        self.solve, self.march = online.solve, online.march


@dataclass(frozen=True)
class _ConeFields(ElasticFields):
    """Fields of a basis and of a cone, see :class:`hhr_dolfinx.models.answer.ModelFields`."""

    order: FullOrderModel
    basis: np.ndarray
    cone: np.ndarray

    def displacement(self, answer: Answer) -> np.ndarray:
        """V gamma + lift, (N,)."""
        problem = self.order.problem
        return self.basis @ answer.unknown + problem.lifts @ problem.amplitudes(answer.parameter)

    def forces(self, answer: Answer) -> np.ndarray:
        """Phi c, (N_lambda,)."""
        return self.cone @ answer.multipliers

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress in the middle of each cell, Kelvin's notation."""
        return self.order.stress_of(self.displacement(answer), answer.parameter)


def cone_projected_greedy(forces: np.ndarray, count: int) -> np.ndarray:
    """At most ``count`` snapshots of forces, (N_lambda, S), each where the cone of those before
    approximates worst.

    They are normalised, (N_lambda, r).
    """
    sizes = np.linalg.norm(forces, axis=0)
    touching = sizes > 1e-9 * sizes.max()
    # relative distances, so that grazing contact counts; a cone does not care for the length of its
    # vectors
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
    """Left factor of a non-negative matrix factorisation of the forces, normalised, (N_lambda,
    r).
    """
    with extra("peers", "a basis of non-negative factors"):
        from sklearn.decomposition import NMF

    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # that it stopped at max_iter: the factors are used as they are
        factors = NMF(count, init="nndsvda", max_iter=2000, tol=1e-7, random_state=0).fit_transform(
            np.maximum(forces, 0.0)
        )
    factors = factors[:, np.linalg.norm(factors, axis=0) > 0]
    return factors / np.linalg.norm(factors, axis=0)
