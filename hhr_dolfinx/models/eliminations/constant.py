"""Elimination for a constant stiffness: one factorisation serves all points.

With fixed statuses the solution is affine in the parameters. These maps, the critical regions of
multi-parametric programming (Bemporad, Morari, Dua and Pistikopoulos, Automatica 38, 2002), are
tabulated. If the map of the nearest training statuses gives non-negative forces and slacks, it is
the solution, and no problem is solved online.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.active_set import SchurEqualities, Status
from hhr_dolfinx.errors import SingularError
from hhr_dolfinx.linear.dense import Factorise, LapackLU, dense_factors
from hhr_dolfinx.models.answer import Answer, Model, ModelFields, SeveralAnswers
from hhr_dolfinx.models.eliminations.elimination import (
    AnswerTable,
    CondensedContact,
    Elimination,
    Responses,
)
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.plain import CODE, Rebuilt

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed import CondensedModel

Region = tuple[np.ndarray, np.ndarray] | None

ENTRIES = 2_000_000
"""Most numbers (16 MB) in the tabulated critical regions of one model; larger tables are not
kept.
"""
PREPARED_BYTES = 16 * 2**20
"""Memory for factors of training statuses without regions: a query that starts from them factors
nothing.
"""


@dataclass(frozen=True, eq=False)
class ConstantElimination(Rebuilt, Elimination):
    """Elimination of constant stiffness, done once."""

    responses: Responses  #: of the eliminated unknown
    amplitudes: Amplitudes  #: θ as a function of the parameters
    factorise: Factorise = field(
        default=dense_factors, metadata=CODE
    )  #: factors a dense block; files do not keep it

    shares_factors = True

    def __post_init__(self) -> None:
        """Put slack and unknown into one array, so that one product computes both.

        ``responses`` has views of it.
        """
        responses = self.responses
        response = np.asfortranarray(np.vstack([responses.free_slack, responses.free_primal]))
        free_slack, free_primal = np.split(response, [len(responses.schur)])
        per_force = np.ascontiguousarray(responses.primal_per_force)
        object.__setattr__(self, "response", response)
        object.__setattr__(
            self, "responses", Responses(free_primal, per_force, free_slack, responses.schur)
        )

    #: free slack followed by the free primal unknown, (m + n, 1 + T)
    response: np.ndarray = field(init=False, repr=False)

    @classmethod
    def from_file(cls, **parts: Any) -> ConstantElimination:
        """Rebuild from a file, with LAPACK's factors: answers are the same on all machines."""
        return cls(**parts, factorise=LapackLU)

    def without_primal(self) -> ConstantElimination:
        """See :class:`Elimination`."""
        parts = self.responses
        nothing = parts.free_primal[:0], parts.primal_per_force[:0]
        responses = Responses(*nothing, parts.free_slack, parts.schur)
        return ConstantElimination(responses, self.amplitudes, self.factorise)

    @cached_property
    def equalities(self) -> SchurEqualities:
        """Equality problems on S, for all points."""
        return SchurEqualities.of(self.responses.schur, self.factorise)

    def __call__(self, point: np.ndarray) -> CondensedContact:
        """Contact problem at a point, (P,)."""
        schur = self.responses.schur
        response = self.response @ self.amplitudes(point)
        slack = response[: len(schur)]
        free = response[len(schur) :]
        return CondensedContact(
            schur, slack, free, self._compliance_times, partial(self._changes, point), factored=self
        )

    def _compliance_times(self, forces: np.ndarray) -> np.ndarray:
        return self.responses.primal_per_force @ forces

    def _changes(self, point: np.ndarray, *_: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of slack and unknown, from loads and gaps alone."""
        acting, slopes = self.amplitudes.slopes_at(point)
        changes = self.response[:, acting] @ slopes
        return changes[: len(self.responses.schur)], changes[len(self.responses.schur) :]

    def table_of(self, known: KnownStatuses) -> AnswerTable | None:
        """Critical regions of the training statuses.

        If there are none, factor these statuses in advance.
        """
        return CriticalRegions.of(self, known)

    def answers(self, model: Model, points: np.ndarray, raise_on_failure: bool) -> SeveralAnswers:
        """Answers to many points; equal statuses share factors.

        Args:
            model: the condensed model.
            points: checked parameters, (n, P).
            raise_on_failure: raise at the first point without a solution.
        """
        from hhr_dolfinx.models.many import answers_by_statuses

        return answers_by_statuses(
            cast("CondensedModel", model),
            self.amplitudes,
            self.responses,
            self.response,
            points,
            raise_on_failure,
        )


@dataclass(frozen=True, eq=False)
class CriticalRegions:
    """Affine map mu -> (forces, slacks, unknown) of each training status.

    Values at mu = 0 and slopes, or None.
    """

    known: KnownStatuses
    maps: list[Region]

    @classmethod
    def of(cls, eliminated: ConstantElimination, known: KnownStatuses) -> CriticalRegions | None:
        """Regions of a constant stiffness.

        None if amplitudes are not affine, or tables would be too large.

        Args:
            eliminated: the elimination.
            known: training statuses.
        """
        distinct, which = np.unique(known.active, axis=0, return_inverse=True)
        theta = eliminated.amplitudes
        response = eliminated.response
        m = known.active.shape[1]
        if (
            theta.nonaffine
            or len(distinct) * (m + len(response)) * (1 + known.points.shape[1]) > ENTRIES
        ):
            eliminated.equalities.prepare(distinct, PREPARED_BYTES)
            return None
        # columns: the value at mu = 0, then the slope along each parameter
        columns = response @ np.column_stack([theta.constant, theta.slopes])
        regions = [_region(eliminated, active, columns) for active in distinct]
        return cls(known, [regions[k] for k in which.ravel()])

    def __call__(self, point: np.ndarray, fields: ModelFields) -> Answer | None:
        """Answer to a point, (P,); None if the nearest statuses do not hold there."""
        nearest = self.known.nearest(point)
        region = self.maps[nearest]
        if region is None:
            return None
        constant, slopes = region
        active = self.known.active[nearest]
        m = active.size
        values = constant + slopes @ point
        # the ufunc itself: its wrapper takes as long again
        if np.minimum.reduce(values[: 2 * m]) >= 0:
            return Answer(
                point, values[2 * m :], values[:m], active, 1, Status.CONVERGED, False, fields
            )
        return None


def _region(eliminated: ConstantElimination, active: np.ndarray, columns: np.ndarray) -> Region:
    """Affine map of some statuses."""
    m = len(active)
    try:
        solutions = [eliminated.equalities(active, column) for column in columns[:m].T]
    except SingularError:  # the active set may still find a solution
        return None
    forces, slack = (np.stack(vectors, axis=1) for vectors in zip(*solutions, strict=True))
    values = np.vstack(
        [forces, slack, columns[m:] - eliminated.responses.primal_per_force @ forces]
    )
    return (
        (values[:, 0].copy(), np.ascontiguousarray(values[:, 1:]))
        if np.isfinite(values).all()
        else None
    )
