"""Stability of full and reduced models: inf-sup constants and condition numbers, by LAPACK; of large sparse B by SLEPc.

An inf-sup constant inf_q sup_v b(v, q) / (|v| |q|) over v = Phi gamma and q is the smallest singular
value of L_q^-1 B~ L_v^-T, where the Gram matrices of the two norms are L_v L_v^T and L_q L_q^T. Two pairs
of norms are used: the thesis' Euclidean norms of nodal values (section 2.6.1), and the energy norm
(v^T K v)^1/2 with the L2 norm of the contact pressure, which do not depend on the mesh.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from scipy import linalg
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.problem import DEPENDENT, ContactProblem, IndexSets
from hhr_dolfinx.models.eliminations.projected import ReducedProblem

if TYPE_CHECKING:
    from slepc4py import SLEPc

    from hhr_dolfinx.models.full import FullModel


logger = logging.getLogger(__name__)

DENSE = 1000
"""Rows up to which LAPACK finds all eigenvalues, in half a second: SLEPc may take as long for a single one."""
SUBSPACE = 64
"""Vectors of the subspace. Of 216 rows of mortar on tetrahedra 16 vectors needed 475 restarts, and 64 vectors 4."""
TOLERANCES = (1e-10, 1e-5, 1e-3)
"""Relative residuals, tried in this order: some eigenvalue is as near as the residual."""
RESTARTS = 50
"""Restarts for each tolerance."""


@dataclass(frozen=True)
class Constants:
    """Inf-sup constants in one pair of norms."""

    beta_h: float  # constant of the full model, (1.20); NaN if it is unknown, which affects no answer and no bound
    beta_HR: float  # constant on the test space of modes truncated outside A, (2.38), (5.18)
    beta_HR_2: float  # constant on the trial space of whole modes, (2.47), (5.19)
    alpha_prime: float | None  # constant of a on the kernels of b, (2.46); None if the kernel is empty


@dataclass(frozen=True)
class Stability:
    """Stability constants of a reduced model."""

    kappa_B: float  # condition number of B~1, (3.4); infinite if its rows are dependent, (5.24)
    kappa_B_2: float  # condition number of B~2, (5.25)
    sigma_min: float  # smallest singular value of B~1, by which the thesis evaluates beta_HR
    sigma_max: float  # largest singular value of B~1
    # smallest eigenvalue of the symmetric part of S = B~2 K~^-1 B~1^T over the norm of S. If it is positive, S is a
    # P-matrix: every parameter has one solution, and the active set finds it. Otherwise the model may still find a
    # solution, which satisfies all contact conditions, but this is not guaranteed
    contact_definite: float
    cond_K: float  # condition number of K~
    cond_whole: float  # condition number of V^T K V, the Galerkin projection on the whole domain
    norm_K: float  # largest singular value of K~
    euclidean: Constants  # constants in the Euclidean norms of the thesis
    energy: Constants  # constants in the energy and L2 norms

    @property
    def distortion(self) -> float:
        """Factor by which restricting the domain to the RID increases the condition number of the stiffness."""
        return self.cond_K / self.cond_whole


@dataclass(frozen=True)
class FullConstants:
    """Inf-sup constants beta_h of the full model, computed once for all reduced models of it."""

    euclidean: float  # smallest singular value of B; NaN if it is unknown
    energy: float  # in the energy norm of displacements and the L2 norm of pressures

    @classmethod
    def of(cls, full: FullModel) -> FullConstants:
        """Constants of a full model, computed once and cached with it.

        They are only reported: if one is not found it is NaN, and the model is built.
        """
        if full not in _KNOWN:
            problem = full.problem
            rows = problem.distinct
            root = np.sqrt(problem.contact_areas[rows])
            whole = root[:, None] * full.schur[np.ix_(rows, rows)] * root
            energy = math.sqrt(max(float(linalg.eigvalsh(whole)[0]), 0.0))
            _KNOWN[full] = cls(smallest_singular_value(problem.contact[rows]), energy)
        return _KNOWN[full]


_KNOWN: WeakKeyDictionary[FullModel, FullConstants] = WeakKeyDictionary()


def smallest_singular_value(rows: csr_matrix) -> float:
    """Smallest singular value of a sparse matrix with fewer rows than columns; 0 if rows are dependent, NaN if unknown.

    The root of the smallest eigenvalue of B B^T: by LAPACK, or of many rows by SLEPc with shift and invert.
    """
    square = csr_matrix(rows @ rows.T)
    scale = float(abs(square.diagonal()).max())
    if square.shape[0] <= DENSE:
        value = float(linalg.eigvalsh(square.toarray() / scale)[0])
    else:
        value = _smallest_by_inversion(square / scale)
    if math.isnan(value):
        logger.warning("SLEPc separates no eigenvalue of B B^T: the inf-sup constant beta_h of the report is unknown")
        return math.nan
    return math.sqrt(scale * value) if value > DEPENDENT else 0.0


def extreme_eigenvalue(prepared: Callable[[], SLEPc.EPS]) -> tuple[float, float] | None:
    """The eigenvalue for which SLEPc solvers are set up, and its relative residual; None if they find none.

    On free meshes the smallest eigenvalues of B B^T lie within 1e-5 of each other: a small subspace does not separate
    them. Only the value is needed: the subspace is wide, and the tolerance looser if the strict one is not reached.
    ``prepared`` returns a new solver: one that has failed keeps its count of restarts, and would stop at once.
    """
    from slepc4py import SLEPc

    for tolerance in TOLERANCES:
        solver = prepared()
        solver.setDimensions(1, SUBSPACE)
        solver.setTolerances(tolerance, RESTARTS)
        solver.setFromOptions()
        solver.solve()
        if solver.getConverged():
            residual = solver.computeError(0, SLEPc.EPS.ErrorType.RELATIVE)
            return float(solver.getEigenvalue(0).real), float(residual)
    return None


def _smallest_by_inversion(matrix: csr_matrix) -> float:
    """Smallest eigenvalue of a positive semi-definite sparse matrix, by SLEPc; NaN if it finds none."""
    from petsc4py import PETSc
    from slepc4py import SLEPc

    entries = matrix.indptr, matrix.indices, matrix.data
    operator = PETSc.Mat().createAIJ(matrix.shape, csr=entries, comm=PETSc.COMM_SELF)

    def prepared() -> SLEPc.EPS:
        solver = SLEPc.EPS().create(PETSc.COMM_SELF)
        solver.setOptionsPrefix("hhr_stability_")
        solver.setOperators(operator)
        solver.setProblemType(SLEPc.EPS.ProblemType.HEP)
        solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        # close to zero but not zero: the matrix may be singular
        solver.setTarget(-DEPENDENT)
        solver.getST().setType(SLEPc.ST.Type.SINVERT)
        return solver

    found = extreme_eigenvalue(prepared)
    return math.nan if found is None else found[0]


def singular_range(matrix: np.ndarray) -> tuple[float, float]:
    """Smallest and largest of the min(m, n) singular values of a small dense matrix, by LAPACK."""
    values = np.linalg.svd(matrix, compute_uv=False)
    return float(values[-1]), float(values[0])


def inf_sup(rows: np.ndarray, primal_gram: np.ndarray | None = None, dual_gram: np.ndarray | None = None) -> float:
    """Inf-sup constant of b(v, q) = q^T rows gamma with the given Gram matrices (identity if None).

    The rows are (m, ell), for example B~; the matrices, symmetric and positive definite, (ell, ell) and (m, m), or the
    diagonal of the latter, (m,). It is 0 if there are more rows than columns, since some q is then orthogonal to all v;
    NaN if a Gram matrix is not positive definite to round-off, so that double precision cannot decide.
    """
    if rows.shape[0] > rows.shape[1]:
        return 0.0
    try:
        whitened = _whiten(_whiten(rows.T, primal_gram).T, dual_gram)
    except linalg.LinAlgError:
        return math.nan
    return singular_range(whitened)[0]


def assess(
    problem: ContactProblem, full: FullConstants, basis: np.ndarray, sets: IndexSets, reduced: ReducedProblem
) -> Stability:
    """Compute all constants of a reduced model, with local rows of its modes if they are distributed."""
    smallest, largest = row_range(reduced.contact_test)
    kappas = [problem.condition_number(*pair) for pair in ((smallest, largest), row_range(reduced.contact_trial))]
    # without rigid motions, along which K~ is zero
    basis = basis[:, reduced.motions :]
    reduced = reduced.held
    low, high = singular_range(reduced.stiffness)
    rows = problem.spread
    whole = rows.sum(basis.T @ (problem.stiffness_of_rows @ basis))
    whole_low, whole_high = singular_range(whole)
    inside = rows.mine(sets.A)
    test = basis[inside]
    pressure = 1.0 / problem.contact_areas[sets.A_lambda]
    energies = rows.sum(test.T @ _tested(problem, basis, inside)), whole
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
        cond_whole=whole_high / whole_low if whole_low > 0 else math.inf,
        norm_K=high,
        euclidean=_constants(reduced, tuple(rows.sum(part.T @ part) for part in (test, basis)), None, full.euclidean),
        energy=_constants(reduced, energies, pressure, full.energy),
    )


def _tested(problem: ContactProblem, basis: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """K times modes truncated outside of some dofs, given by their local indices; local rows of the products."""
    if problem.spread.all_here:
        return problem.stiffness[inside][:, inside] @ basis[inside]
    cut = np.zeros_like(basis)
    cut[inside] = basis[inside]
    return (problem.stiffness_of_rows @ cut)[inside]


def row_range(rows: np.ndarray) -> tuple[float, float]:
    """Smallest and largest singular value on the rows; the smallest is 0 if there are more rows than columns."""
    smallest, largest = singular_range(rows)
    return (0.0 if rows.shape[0] > rows.shape[1] else smallest), largest


def _constants(
    reduced: ReducedProblem, grams: tuple[np.ndarray, ...], dual_gram: np.ndarray | None, beta_h: float
) -> Constants:
    """Constants for the Gram matrices of modes truncated outside A and of whole modes, (ell, ell) each."""
    test_gram, trial_gram = grams
    return Constants(
        beta_h,
        inf_sup(reduced.contact_test, test_gram, dual_gram),
        inf_sup(reduced.contact_trial, trial_gram, dual_gram),
        _alpha_prime(reduced, test_gram, trial_gram),
    )


def _alpha_prime(reduced: ReducedProblem, test_gram: np.ndarray, trial_gram: np.ndarray) -> float | None:
    """Inf-sup constant of a on the kernels of b, thesis (2.46)."""
    test, trial = (linalg.null_space(rows) for rows in (reduced.contact_test, reduced.contact_trial))
    if test.shape[1] != trial.shape[1]:  # dependent rows in one of the two: a direction without an equation
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
