"""Stability of reduced models: inf-sup constants and condition numbers, by LAPACK.

An inf-sup constant inf_q sup_v b(v, q) / (|v| |q|) over v = Phi gamma and q is the smallest
singular value of L_q^-1 B~ L_v^-T, where the Gram matrices of the two norms are L_v L_v^T and L_q
L_q^T. Here they are the thesis' Euclidean norms of nodal values (section 2.6.1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.models.eliminations.projected import ReducedProblem


@dataclass(frozen=True)
class Constants:
    """Inf-sup constants of a reduced model in one pair of norms.

    Attributes:
        beta_HR: constant on the test space of modes truncated outside A, (2.38), (5.18).
        beta_HR_2: constant on the trial space of whole modes, (2.47), (5.19).
        alpha_prime: constant of a on the kernels of b, (2.46); None if the kernel is empty.
    """

    beta_HR: float
    beta_HR_2: float
    alpha_prime: float | None


@dataclass(frozen=True)
class Stability:
    """Stability constants of a reduced model."""

    kappa_B: float  #: condition number of B~1, (3.4); infinite if its rows are dependent, (5.24)
    kappa_B_2: float  #: condition number of B~2, (5.25)
    sigma_min: float  #: smallest singular value of B~1, by which the thesis evaluates beta_HR
    sigma_max: float  #: largest singular value of B~1
    #: smallest eigenvalue of the symmetric part of S = B~2 K~^-1 B~1^T over the norm of S. If it is
    #: positive, S is a P-matrix: every parameter has one solution, and the active set finds it.
    #: Otherwise the model may still find a solution, which satisfies all contact conditions, but
    #: this is not guaranteed
    contact_definite: float
    cond_K: float  #: condition number of K~
    cond_whole: float  #: condition number of V^T K V, the Galerkin projection on the whole domain
    norm_K: float  #: largest singular value of K~
    euclidean: Constants  #: constants in the Euclidean norms of the thesis

    @property
    def distortion(self) -> float:
        """Condition number of K~ over that of the stiffness projected on the whole domain."""
        return self.cond_K / self.cond_whole


def singular_range(matrix: np.ndarray) -> tuple[float, float]:
    """Smallest and largest of the min(m, n) singular values of a small dense matrix, by LAPACK."""
    values = np.linalg.svd(matrix, compute_uv=False)
    return float(values[-1]), float(values[0])


def inf_sup(
    rows: np.ndarray, primal_gram: np.ndarray | None = None, dual_gram: np.ndarray | None = None
) -> float:
    """Inf-sup constant of b(v, q) = q^T rows gamma with the given Gram matrices.

    Args:
        rows: matrix of the form, (m, ell), for example B~.
        primal_gram: Gram matrix of v, symmetric and positive definite, (ell, ell); None for the
            identity.
        dual_gram: Gram matrix of q, (m, m), or its diagonal, (m,); None for the identity.

    Returns:
        The constant. It is 0 if there are more rows than columns, since some q is then orthogonal
        to all v. It is NaN if a Gram matrix is not positive definite to round-off, so that double
        precision cannot decide.
    """
    if rows.shape[0] > rows.shape[1]:
        return 0.0
    try:
        whitened = _whiten(_whiten(rows.T, primal_gram).T, dual_gram)
    except linalg.LinAlgError:
        return math.nan
    return singular_range(whitened)[0]


def assess(
    problem: ContactProblem, basis: np.ndarray, sets: IndexSets, reduced: ReducedProblem
) -> Stability:
    """Compute all constants of a reduced model.

    Args:
        problem: the contact problem.
        basis: modes, or the local rows of distributed ones, (own, ell).
        sets: index sets of the RID.
        reduced: the projected arrays.
    """
    smallest, largest = row_range(reduced.contact_test)
    kappas = [
        problem.condition_number(*pair)
        for pair in ((smallest, largest), row_range(reduced.contact_trial))
    ]
    # without rigid motions, along which K~ is zero
    basis = basis[:, reduced.motions :]
    reduced = reduced.held
    low, high = singular_range(reduced.stiffness)
    rows = problem.spread
    galerkin = rows.sum(basis.T @ (problem.stiffness_of_rows @ basis))
    galerkin_low, galerkin_high = singular_range(galerkin)
    test = basis[rows.mine(sets.A)]
    definite = math.nan
    if low > 0:
        schur = reduced.contact_trial @ np.linalg.solve(reduced.stiffness, reduced.contact_test.T)
        if (size := np.linalg.norm(schur, 2)) > 0:
            definite = float(linalg.eigvalsh((schur + schur.T) / 2)[0] / size)
    return Stability(
        kappa_B=kappas[0],
        kappa_B_2=kappas[1],
        sigma_min=smallest,
        sigma_max=largest,
        contact_definite=definite,
        cond_K=high / low if low > 0 else math.inf,
        cond_whole=galerkin_high / galerkin_low if galerkin_low > 0 else math.inf,
        norm_K=high,
        euclidean=constants_of(reduced, *(rows.sum(modes.T @ modes) for modes in (test, basis))),
    )


def row_range(rows: np.ndarray) -> tuple[float, float]:
    """Smallest and largest singular value on the rows.

    The smallest is 0 if there are more rows than columns.
    """
    smallest, largest = singular_range(rows)
    return (0.0 if rows.shape[0] > rows.shape[1] else smallest), largest


def constants_of(
    reduced: ReducedProblem,
    test_gram: np.ndarray,
    trial_gram: np.ndarray,
    dual_gram: np.ndarray | None = None,
) -> Constants:
    """Constants of a reduced model for some Gram matrices.

    Args:
        reduced: the projected arrays.
        test_gram: Gram matrix of the modes truncated outside A, (ell, ell).
        trial_gram: Gram matrix of the whole modes, (ell, ell).
        dual_gram: Gram matrix of forces, (m, m), or its diagonal, (m,); None for the identity.
    """
    return Constants(
        inf_sup(reduced.contact_test, test_gram, dual_gram),
        inf_sup(reduced.contact_trial, trial_gram, dual_gram),
        _alpha_prime(reduced, test_gram, trial_gram),
    )


def _alpha_prime(
    reduced: ReducedProblem, test_gram: np.ndarray, trial_gram: np.ndarray
) -> float | None:
    """Inf-sup constant of a on the kernels of b, thesis (2.46)."""
    test, trial = (
        linalg.null_space(rows) for rows in (reduced.contact_test, reduced.contact_trial)
    )
    if (
        test.shape[1] != trial.shape[1]
    ):  # dependent rows in one of the two: a direction without an equation
        return 0.0
    if test.shape[1] == 0:
        return None
    square = trial.T @ reduced.stiffness.T @ test  # rows: trial functions, columns: test functions
    return inf_sup(square, test.T @ test_gram @ test, trial.T @ trial_gram @ trial)


def _whiten(matrix: np.ndarray, gram: np.ndarray | None) -> np.ndarray:
    """L^-1 matrix for gram = L L^T, given as a matrix or by its diagonal."""
    if gram is None:
        return matrix
    if gram.ndim == 1:
        return matrix / np.sqrt(gram)[:, None]
    return linalg.solve_triangular(linalg.cholesky(gram, lower=True), matrix, lower=True)
