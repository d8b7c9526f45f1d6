"""Inf-sup constants of the full model, and those of reduced ones in norms that do not depend on the
mesh.

These are the energy norm (v^T K v)^1/2 with the L2 norm of the contact pressure, see
:mod:`hhr_dolfinx.certify.constants`. Large sparse B takes SLEPc. They are reported, and no answer
depends on them.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from scipy import linalg
from scipy.sparse import csr_matrix

from hhr_dolfinx.certify.constants import Constants, Stability, constants_of
from hhr_dolfinx.contact.problem import DEPENDENT_ROWS, ContactProblem
from hhr_dolfinx.reduction.build import Draft, independent

if TYPE_CHECKING:
    from slepc4py import SLEPc

    from hhr_dolfinx.models.full import FullModel


logger = logging.getLogger(__name__)

DENSE = 1000
"""Rows up to which LAPACK finds all eigenvalues, in half a second: SLEPc may take as long for a
single one.
"""
SUBSPACE = 64
"""Vectors of the subspace.

Of 216 rows of mortar on tetrahedra 16 vectors needed 475 restarts, and 64 vectors 4.
"""
TOLERANCES = (1e-10, 1e-5, 1e-3)
"""Relative residuals, tried in this order: some eigenvalue is as near as the residual."""
RESTARTS = 50
"""Restarts for each tolerance."""


@dataclass(frozen=True)
class WholeConstants(Constants):
    """Constants of a reduced model and of its full one.

    Attributes:
        beta_h: constant of the full model, (1.20); NaN if it is unknown, which affects no answer
            and no bound.
    """

    beta_h: float


@dataclass(frozen=True)
class WholeStability(Stability):
    """Stability constants of a reduced model beside those of its full one.

    Attributes:
        energy: constants in the energy and L2 norms.
    """

    energy: WholeConstants


@dataclass(frozen=True)
class FullConstants:
    """Inf-sup constants beta_h of the full model, computed once for all reduced models of it."""

    euclidean: float  #: smallest singular value of B; NaN if it is unknown
    energy: float  #: in the energy norm of displacements and the L2 norm of pressures

    @classmethod
    def of(cls, full: FullModel) -> FullConstants:
        """Constants of a full model, computed once and cached with it.

        They are only reported: if one is not found it is NaN, and the model is built.
        """
        if full not in _KNOWN:
            problem = full.problem
            rows = problem.distinct
            root = np.sqrt(problem.contact_areas[rows])
            scaled_schur = root[:, None] * full.schur[np.ix_(rows, rows)] * root
            energy = math.sqrt(max(float(linalg.eigvalsh(scaled_schur)[0]), 0.0))
            _KNOWN[full] = cls(smallest_singular_value(problem.contact[rows]), energy)
        return _KNOWN[full]


_KNOWN: WeakKeyDictionary[FullModel, FullConstants] = WeakKeyDictionary()


def smallest_singular_value(rows: csr_matrix) -> float:
    """Smallest singular value of a sparse matrix with fewer rows than columns.

    0 if rows are dependent, NaN if unknown.

    The root of the smallest eigenvalue of B B^T: by LAPACK, or of many rows by SLEPc with shift and
    invert.
    """
    square = csr_matrix(rows @ rows.T)
    scale = float(abs(square.diagonal()).max())
    if square.shape[0] <= DENSE:
        value = float(linalg.eigvalsh(square.toarray() / scale)[0])
    else:
        value = _smallest_by_inversion(square / scale)
    if math.isnan(value):
        logger.warning(
            "SLEPc separates no eigenvalue of B B^T: the inf-sup constant beta_h of the report is "
            "unknown"
        )
        return math.nan
    return math.sqrt(scale * value) if value > DEPENDENT_ROWS else 0.0


def extreme_eigenvalue(prepared: Callable[[], SLEPc.EPS]) -> tuple[float, float] | None:
    """The eigenvalue for which SLEPc solvers are set up, and its relative residual.

    None if they find none.

    On free meshes the smallest eigenvalues of B B^T lie within 1e-5 of each other: a small subspace
    does not separate them. Only the value is needed: the subspace is wide, and the tolerance looser
    if the strict one is not reached. ``prepared`` returns a new solver: one that has failed keeps
    its count of restarts, and would stop at once.
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
    """Smallest eigenvalue of a positive semi-definite sparse matrix, by SLEPc.

    NaN if it finds none.
    """
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
        solver.setTarget(-DEPENDENT_ROWS)
        solver.getST().setType(SLEPc.ST.Type.SINVERT)
        return solver

    eigenvalue = extreme_eigenvalue(prepared)
    return math.nan if eigenvalue is None else eigenvalue[0]


def measure(draft: Draft) -> None:
    """Stage of the hyper-reduction: these constants beside those of the projection."""
    shared = draft.shared
    problem = shared.full.problem
    with shared.log.stage("full_constants", shared.task.announce):
        full = FullConstants.of(shared.full)
    with shared.log.stage("stability", shared.task.announce):
        sets, reduced = independent(problem, draft.sets, draft.reduced)
        rows = problem.spread
        basis = draft.basis[:, reduced.motions :]
        rows_of_rid = rows.mine(sets.A)
        test_gram = rows.sum(basis[rows_of_rid].T @ _tested(problem, basis, rows_of_rid))
        trial_gram = rows.sum(basis.T @ (problem.stiffness_of_rows @ basis))
        pressure = 1.0 / problem.contact_areas[sets.A_lambda]
        energy = constants_of(reduced.held, test_gram, trial_gram, pressure)
        fields = {name: getattr(draft.stability, name) for name in Stability.__dataclass_fields__}
        fields["euclidean"] = WholeConstants(**asdict(fields["euclidean"]), beta_h=full.euclidean)
        draft.stability = WholeStability(
            **fields, energy=WholeConstants(**asdict(energy), beta_h=full.energy)
        )


def _tested(problem: ContactProblem, basis: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """K times modes truncated outside of some dofs, given by their local indices.

    Local rows of the products.
    """
    if problem.spread.all_here:
        return problem.stiffness[inside][:, inside] @ basis[inside]
    cut = np.zeros_like(basis)
    cut[inside] = basis[inside]
    return (problem.stiffness_of_rows @ cut)[inside]
