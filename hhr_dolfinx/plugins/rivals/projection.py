"""Galerkin projection on whole bodies, with contact forces in a cone: what many authors share.

    u = V γ + lift,  λ = Φ c,  c >= 0:    K~ γ + B~^T c = f~,    B~ γ <= Φ^T g,    B~ = Φ^T B V
    (1.31)

A small quadratic program, min γ^T K~ γ / 2 - f~^T γ, which Lawson and Hanson's least-distance
programming solves by non-negative least squares, also where there are more conditions than modes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import linalg
from scipy.optimize import nnls

from hhr_dolfinx.contact.active_set import Status, Statuses
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import NotOfferedError, ReductionError
from hhr_dolfinx.models.answer import Answer, ElasticFields, Meshed, found_as
from hhr_dolfinx.models.eliminations.projected import ReducedProblem
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.reduction.modes import pod
from hhr_dolfinx.reduction.projection import project

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.models.answer import CheckedStart
    from hhr_dolfinx.snapshots.records import SnapshotSet

COMPLIANCE = 1e-10
"""Compliance of each contact condition over the mean one of the model, where all are kept: rows
that modes cannot tell apart share their force then.
"""
MOST_KEPT = 1000
"""Most contact conditions of a model that keeps all of them."""
INFEASIBLE = 1e-12
"""Length of the residual of unit non-negative least squares below which nothing fits between the
gaps.
"""


class RivalModel(AnsweringModel):
    """Base of models of other authors, which have no gradients, and start from nothing."""

    def answered(self, point: np.ndarray) -> Answer:
        """Answer to a point, (P,).

        Raises:
            NotImplementedError: a model must state it.
        """
        raise NotImplementedError

    def _answered(
        self, point: np.ndarray, start: CheckedStart, outside: str, gradient: bool
    ) -> Answer:
        if gradient:
            raise NotOfferedError("rivals have no gradients: ask the full model")
        return self.answered(point)


def check_elastic(full: FullOrderModel, what: str, *, one_stiffness: bool = False) -> None:
    """Check that a scene is one of rivals: elastic bodies, contacts without memory, one mesh.

    Args:
        full: full model of the scene.
        what: name of the rival, for messages.
        one_stiffness: True for a rival that is not there with moduli as parameters.

    Raises:
        NotOfferedError: with the reason.
    """
    problem = full.problem
    if full.equilibrium is not None:
        raise NotOfferedError(f"{what} projects K: bodies of scene '{full.scene.name}' have laws")
    problem.require_no_memory(what)
    reasons = {
        "shapes of bodies are parameters": problem.reshaped is not None,
        "contact alone holds bodies": problem.kernel is not None,
        "a contact has another law": problem.law.plugins != (),
        "moduli are parameters, and it has one K": one_stiffness and problem.varies,
    }
    for reason, holds in reasons.items():
        if holds:
            raise NotOfferedError(f"{what} is for elastic bodies in contact without more: {reason}")


def whole(problem: ContactProblem) -> IndexSets:
    """Index sets of a domain that is all of the mesh."""
    free = np.flatnonzero(problem.free)
    read = np.flatnonzero(abs(problem.contact).T @ np.ones(len(problem.gaps)) > 0)
    nothing = np.zeros(0, dtype=np.int64)
    cells = np.arange(len(problem.cell_nodes))
    conditions = np.arange(len(problem.gaps))
    return IndexSets(cells, free, conditions, np.intersect1d(read, free), read, nothing)


def displacement_modes(snapshots: SnapshotSet, count: int) -> np.ndarray:
    """The leading POD modes of training displacements, at most ``count``, (N, ell)."""
    return pod(snapshots.displacements, 1e-15)[0][:, :count]


def with_supremizers(full: FullOrderModel, basis: np.ndarray, cone: np.ndarray) -> np.ndarray:
    """A basis and K^-1 B^T phi of each function of a cone, orthonormal, (N, ell + r).

    Args:
        full: the full model.
        basis: modes, (N, ell).
        cone: dual basis, (N_lambda, r).

    Raises:
        NotOfferedError: if the stiffness depends on parameters: a supremizer belongs to one.
    """
    check_elastic(full, "a basis with supremizers", one_stiffness=True)
    supremizers = full.per_force @ cone
    supremizers /= np.linalg.norm(supremizers, axis=0)
    joined: np.ndarray = linalg.qr(np.hstack([basis, supremizers]), mode="economic")[0]
    return joined


class ConeModel(RivalModel):
    """Galerkin model whose contact forces lie in a cone.

    Args:
        full: the full model, on one rank.
        basis: V, orthonormal, (N, ell).
        cone: Phi >= 0, (N_lambda, r); None for all contact conditions.
        stiffness: an approximation of V^T K V, (ell, ell), of a constant stiffness; None for this
            itself.

    Raises:
        NotOfferedError: see :func:`check_elastic`.
        ReductionError: for a cone that is not of this scene, and a stiffness that is not positive
            definite.
    """

    def __init__(
        self,
        full: FullOrderModel,
        basis: np.ndarray,
        cone: np.ndarray | None = None,
        stiffness: np.ndarray | None = None,
    ):
        check_elastic(full, "a projection")
        problem = full.problem
        if cone is None and len(problem.gaps) > MOST_KEPT:
            raise NotOfferedError(
                f"non-negative least squares with all of {len(problem.gaps)} conditions take "
                f"minutes: {MOST_KEPT} are the most"
            )
        self.parameters = full.parameters
        self.cone = np.eye(len(problem.gaps)) if cone is None else cone
        if self.cone.shape[:1] != problem.gaps.shape[:1] or (self.cone < 0).any():
            raise ReductionError(
                f"a cone of shape {self.cone.shape} must have a row >= 0 for each of "
                f"{len(problem.gaps)} conditions"
            )
        self.fields = ConeFields(full, basis, self.cone)
        self._problem = problem
        self._reduced = project(problem, basis, whole(problem))
        if stiffness is not None:
            self._reduced = replace(self._reduced, stiffness=stiffness)
        self._rows = self.cone.T @ self._reduced.contact_trial
        self._gaps = self.cone.T @ self._reduced.gaps
        self._shared = COMPLIANCE if cone is None else 0.0
        try:
            self._constant = None if problem.varies else self._whitened(self._reduced)
        except linalg.LinAlgError as error:
            raise ReductionError(
                "the reduced stiffness is not positive definite: take more modes, or more cells"
            ) from error
        self.advice = {Status.UNDEFINED: "no displacement of the basis fits between the gaps"}

    @property
    def sizes(self) -> tuple[int, int]:
        """Modes, and functions of the cone."""
        return self._rows.shape[1], self._rows.shape[0]

    def answered(self, point: np.ndarray) -> Answer:
        """See :class:`RivalModel`."""
        whitened = self._constant
        if whitened is None:
            whitened = self._whitened(self._reduced.weighted(self._problem.weights(point)))
        theta = self._problem.amplitudes(point)
        free = whitened.loads @ theta
        slack = self._gaps @ theta - whitened.rows @ free
        forces, count = least_distance(whitened.constraints, slack)
        solved = forces is not None
        status = Status.CONVERGED if solved else Status.UNDEFINED
        kept = np.full(len(self._rows), np.nan) if forces is None else forces
        unknown = whitened.back @ (free - whitened.rows.T @ kept)
        multipliers = self.cone @ kept
        return found_as(
            Statuses(multipliers, multipliers > 0, count, status, False),
            point,
            unknown,
            self.fields,
        )

    def _whitened(self, reduced: ReducedProblem) -> _Whitened:
        """Factor K~, which is symmetric on the whole domain."""
        stiffness = (reduced.stiffness + reduced.stiffness.T) / 2
        inverse = linalg.solve_triangular(
            linalg.cholesky(stiffness, lower=True), np.eye(len(stiffness)), lower=True
        )
        rows = constraints = self._rows @ inverse.T
        if self._shared:
            size = np.sqrt(self._shared * np.mean(np.sum(rows**2, axis=1)))
            constraints = np.hstack([rows, size * np.eye(len(rows))])
        return _Whitened(rows, constraints, inverse @ reduced.loads, inverse.T)


class _Whitened(NamedTuple):
    """A reduced problem in coordinates in which K~ = L L^T is the identity."""

    rows: np.ndarray  #: B~ L^-T, (r, ell)
    constraints: np.ndarray  #: these, and compliances of conditions, (r, ell or ell + r)
    loads: np.ndarray  #: L^-1 f~ of each term, (ell, 1 + T)
    back: np.ndarray  #: L^-T, (ell, ell)


def least_distance(rows: np.ndarray, slack: np.ndarray) -> tuple[np.ndarray | None, int]:
    """Multipliers of the shortest x with A x <= s, by non-negative least squares.

    C. L. Lawson and R. J. Hanson, Solving Least Squares Problems, 1974, chapter 23.

    Args:
        rows: A, (r, ell).
        slack: s, (r,).

    Returns:
        c >= 0 with x = -A^T c, and the number of positive ones; None if no x fits.
    """
    deepest = max(-slack.min(initial=0.0), 0.0)
    if deepest == 0.0:
        return np.zeros(len(slack)), 0
    system = np.vstack([-rows.T, -slack / deepest])
    right = np.zeros(len(system))
    right[-1] = 1.0
    weights, length = nnls(system, right, maxiter=30 * len(slack))
    if length < INFEASIBLE:
        return None, 0
    last = system[-1] @ weights - 1.0
    forces = -weights * deepest / last
    return forces, int(np.count_nonzero(forces))


@dataclass(frozen=True)
class RivalFields(ElasticFields):
    """Fields on the mesh of a full model, by displacements that a rival derives."""

    order: FullOrderModel

    @property
    def full(self) -> Meshed:
        """The full model."""
        return self.order

    @property
    def conditions(self) -> int:
        """Number of contact conditions, N_lambda."""
        return self.order.conditions

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress in the middle of each cell, Kelvin's notation, (cells, components)."""
        return self.order.stress_of(self.displacement(answer), answer.parameter)


@dataclass(frozen=True)
class ConeFields(RivalFields):
    """Fields of a basis on the whole mesh, see :class:`~hhr_dolfinx.models.answer.ModelFields`."""

    basis: np.ndarray
    cone: np.ndarray

    def displacement(self, answer: Answer) -> np.ndarray:
        """V gamma + lift, (N,)."""
        problem = self.order.problem
        lift: np.ndarray = problem.lifts @ problem.amplitudes(answer.parameter)
        return self.basis @ answer.unknown + lift
