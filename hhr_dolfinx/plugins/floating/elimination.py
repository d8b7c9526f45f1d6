"""Elimination for bodies with rigid motions: the primal unknown is eliminated, rigid motions are
not.

In a reduced model the first modes are rigid motions R, on which K~ has columns of zeros. The
equations tested with them are the balance of whole bodies, see :meth:`RigidKernel.balanced`. The
other modes are eliminated as usual. What remains is G^T lambda = driving, see ``statuses``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.active_set import Pairs, Status
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.linear.dense import LapackLU
from hhr_dolfinx.models.answer import Answer, ModelFields, found_as
from hhr_dolfinx.models.eliminations.elimination import CondensedContact, Elimination, Responses
from hhr_dolfinx.models.eliminations.projected import ReducedProblem
from hhr_dolfinx.models.gradient import Gradient, grazing
from hhr_dolfinx.plain import Rebuilt
from hhr_dolfinx.plugins.floating.statuses import FloatingEqualities, floating_set, open_motions

Changed = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Maps the unknown to derivatives of slack, unknown and balance."""


@dataclass(eq=False)  # one for each query, as CondensedContact
class Floating:
    """Rigid motions of bodies that contact alone holds: a
    :class:`~hhr_dolfinx.contact.kernel.CondensedKernel`.
    """

    equalities: FloatingEqualities
    driving: np.ndarray
    modes: np.ndarray
    drift: Callable[[np.ndarray, np.ndarray], np.ndarray]

    def answer(
        self,
        contact: CondensedContact,
        point: np.ndarray,
        start: np.ndarray,
        pairs: Pairs | None,
        fields: ModelFields,
        gradient: bool,
    ) -> Answer:
        """See :class:`~hhr_dolfinx.contact.kernel.CondensedKernel`.

        Args:
            contact: condensed contact problem.
            point: parameter, (P,).
            start: statuses to start from, (m,) bool.
            pairs: contact pair of each condition; None for one pair.
            fields: fields that complete the answer.
            gradient: compute the derivatives along the parameters.
        """
        equalities = self.equalities
        free_slack = contact.free_slack
        statuses, motions = floating_set(equalities, free_slack, self.driving, start, pairs)
        unknown = contact.unknown(statuses.forces) + self.modes @ motions
        if statuses.status is not Status.CONVERGED:
            return found_as(statuses, point, unknown, fields)
        slack = (
            free_slack + contact.schur @ statuses.forces - equalities.contact_of_motions @ motions
        )
        open_ = open_motions(equalities, statuses.forces, free_slack, slack, self.modes.T @ unknown)
        if open_ is None:
            answer = found_as(statuses, point, unknown, fields)
        else:
            unknown = unknown + self.modes @ open_.shift
            slack = slack - equalities.contact_of_motions @ open_.shift
            statuses = statuses._replace(active=statuses.active & ~open_.opened)
            answer = found_as(statuses, point, unknown, fields)._replace(
                undetermined=self.modes @ open_.ways
            )
        if not gradient:
            return answer
        of_slack, of_unknown = contact.at_fixed_forces(statuses.forces, unknown)
        driven = self.drift(statuses.forces, unknown)
        changes, opened, of_motions = equalities.several(statuses.active, of_slack, driven)
        of_unknown = of_unknown - contact.response_to_forces(changes) + self.modes @ of_motions
        return answer._replace(
            gradient=Gradient(
                of_unknown, changes, grazing(statuses.active, statuses.forces, slack), opened
            )
        )


@dataclass(frozen=True, eq=False)
class FloatingElimination(Rebuilt, Elimination):
    """Eliminated problem at one stiffness (n unknowns, m conditions, r motions, 1 + T terms)."""

    keeps_kernel: ClassVar[bool] = True

    responses: Responses  #: of the pinned unknown
    taken: Annotated[Floats, "m", "motions"]  #: change of the slack by the motions, B R, (m, r)
    driving: Annotated[Floats, "motions", "terms"]  #: loads along the motions, (r, 1 + T)
    modes: Annotated[Floats, "unknowns", "motions"]  #: the motions as unknowns, (n, r)
    amplitudes: Amplitudes  #: θ as a function of the parameters

    @cached_property
    def equalities(self) -> FloatingEqualities:
        """Equality problems on S with the motions."""
        return FloatingEqualities(self.responses.schur, self.taken)

    def __call__(self, point: np.ndarray, changed: Changed | None = None) -> CondensedContact:
        """Contact problem at a point, (P,).

        ``changed``: derivatives at fixed forces and motions, if K varies.
        """
        theta = self.amplitudes(point)
        responses = self.responses
        changes = partial(self._changes, point) if changed is None else changed
        motions = Floating(
            self.equalities,
            self.driving @ theta,
            self.modes,
            lambda _, unknown: changes(unknown)[2],
        )
        slack = responses.free_slack @ theta
        free = responses.free_primal @ theta
        respond = partial(np.matmul, responses.primal_per_force)
        return CondensedContact(
            responses.schur,
            slack,
            free,
            respond,
            lambda _, unknown: changes(unknown)[:2],
            kernel=motions,
        )

    def _changes(
        self, point: np.ndarray, _: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        acting, slopes = self.amplitudes.slopes_at(point)
        terms = self.responses.free_slack, self.responses.free_primal, self.driving
        slack, free, driving = (term[:, acting] @ slopes for term in terms)
        return slack, free, driving


@dataclass(frozen=True)
class ReducedFloatingElimination(Elimination):
    """Eliminates gamma of a reduced problem at any parameter; once if its stiffness is constant."""

    problem: ReducedProblem  #: the projected problem, with its motions
    amplitudes: Amplitudes  #: θ as a function of the parameters

    def __call__(self, point: np.ndarray) -> CondensedContact:
        """Eliminate at a point, (P,)."""
        if self.problem.terms is None:
            return self._constant(point)
        weights = self.problem.terms.weights(point)
        factor, eliminated = self._eliminated(self.problem.weighted(weights))
        return eliminated(point, partial(self._changed, factor, point, weights))

    @cached_property
    def _constant(self) -> FloatingElimination:
        return self._eliminated(self.problem)[1]

    def _eliminated(self, problem: ReducedProblem) -> tuple[LapackLU, FloatingElimination]:
        """Factors of K~ without the motions, and the eliminated problem, for a problem of constant
        stiffness.
        """
        r = problem.motions
        held = problem.held
        factor = LapackLU(held.stiffness)
        eliminated = Responses.eliminate(
            factor, held.loads, held.gaps, held.contact_test, held.contact_trial
        )
        contact_of_motions = np.ascontiguousarray(problem.contact_trial[:, :r])
        free, per_force = (
            _after(r, rows) for rows in (eliminated.free_primal, eliminated.primal_per_force)
        )
        responses = replace(eliminated, free_primal=free, primal_per_force=per_force)
        return factor, FloatingElimination(
            responses, contact_of_motions, problem.loads[:r], np.eye(len(free), r), self.amplitudes
        )

    def _changed(
        self, factor: LapackLU, point: np.ndarray, weights: np.ndarray, unknown: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives from K~ gamma' = f' - K~' gamma, with those of slack and balance."""
        right, slack = self.problem.changes(self.amplitudes, point, weights, unknown)
        r = self.problem.motions
        held = factor.solve(right[r:])
        return slack - self.problem.contact_trial[:, r:] @ held, _after(r, held), right[:r]


def _after(count: int, rows: np.ndarray) -> np.ndarray:
    """Rows below ``count`` rows of zeros."""
    return np.concatenate([np.zeros((count, *rows.shape[1:])), rows])
