"""Models that keep the contact conditions alone: the primal unknown is eliminated.

The reduced model, the exact condensation of a full model and the interpolated one have this form.
They differ in the elimination, see :mod:`hhr_dolfinx.models.eliminations.elimination`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Annotated

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs, Status
from hhr_dolfinx.contact.law import UNILATERAL, ContactLaw
from hhr_dolfinx.declared import Integers
from hhr_dolfinx.models.answer import Answer, CheckedStart, ModelFields, SeveralAnswers, outcome
from hhr_dolfinx.models.eliminations.elimination import (
    CondensedContact,
    Elimination,
    answer_of,
    differentiated,
)
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.parameters import ParameterSpace, PointsLike
from hhr_dolfinx.trained import USUAL, TrainedRange

MOST_ROWS = 16_000
"""Most rows of a table that are answered at once.

200,000 rows of the pellet took 26 s by 1000 and 11 s by 16,000, measured once.
"""
ROW_NUMBERS = 8_000_000
"""Most numbers of the answers of these rows, 64 MB."""


class CondensedModel(KeptModel):
    """Model whose primal unknown is eliminated, once or for each parameter.

    Threads may share a model. Copies and pickles of it, for a pool of workers, give the same
    answers.

    Args:
        eliminated: makes the contact problem of a point.
        known: statuses of the training parameters.
        pairs: number of the contact pair of each condition, (m,); None takes all for one pair.
        trained: range of parameters in which answers can be trusted; None for no limit.
        parameters, fields, advice, law: see :class:`AnsweringModel`.
    """

    kept = ("parameters", "eliminated", "known", "fields", "pairs", "trained", "law")
    handed_on = ("advice",)

    def __init__(
        self,
        parameters: ParameterSpace,
        eliminated: Elimination,
        known: KnownStatuses,
        fields: ModelFields,
        pairs: Annotated[Integers, "m"] | None = None,
        trained: TrainedRange | None = None,
        advice: Mapping[Status, str] = MappingProxyType({}),
        law: ContactLaw = UNILATERAL,
    ):
        self.parameters = parameters
        self.eliminated = eliminated
        self.known = known
        self.fields = fields
        self.trained = trained
        self.advice = dict(advice)
        self.pairs = pairs
        self.law = law
        self._pairs = Pairs.of(pairs)
        self._m = known.active.shape[1]
        self._regions = None if law.remembers else eliminated.table_of(known)

    def _answered(
        self, point: np.ndarray, start: CheckedStart, outside: str, gradient: bool
    ) -> Answer:
        """Answer of the critical region of the nearest statuses if it holds there.

        Else by the active set.
        """
        if isinstance(start, str):
            tabulated = None if self._regions is None else self._regions(point, self.fields)
            if tabulated is not None:
                return differentiated(self.eliminated(point), tabulated) if gradient else tabulated
            start = self.known.start(point)
        return answer_of(
            self.eliminated(point), point, start, self._pairs, self.fields, gradient=gradient
        )

    def contacts(self) -> Callable[[np.ndarray], CondensedContact]:
        """See :class:`AnsweringModel`."""
        return self.eliminated.along_path()

    def solve_many(
        self, points: PointsLike, *, raise_on_failure: bool = True, outside: str = USUAL
    ) -> SeveralAnswers:
        """Answer many parameters, (n, P), as :meth:`solve` does, to round-off.

        Faster per point the more there are.

        Args:
            points: parameters, (n, P).
            raise_on_failure: raise at the first point without a solution, or go on with NaN and a
                status.
            outside: see :meth:`Model.solve`.
        """
        if self.by_paths:
            return super().solve_many(points, raise_on_failure=raise_on_failure, outside=outside)
        checked = self.parameters.points(points)
        outside = self._checked_outside(outside)
        if self._limit is not None:
            within = ((checked >= self._limit.lower) & (checked <= self._limit.upper)).all(axis=1)
            for point in checked[~within]:
                self._limit.check(point, outside)
        return self.eliminated.answers(self, checked, raise_on_failure)

    def from_contact(
        self, contact: CondensedContact, point: np.ndarray, raise_on_failure: bool
    ) -> Answer:
        """Answer to a point from its contact problem; starts from the nearest training statuses.

        Args:
            contact: contact problem of the point.
            point: parameter, (P,).
            raise_on_failure: raise instead of returning NaN and a status.
        """
        answer = answer_of(contact, point, self.known.start(point), self._pairs, self.fields)
        return outcome(answer, raise_on_failure, self.advice)

    def without_fields(self) -> CondensedModel:
        """See :class:`~hhr_dolfinx.models.model.KeptModel`, for a constant stiffness: K^-1 B^T of
        39,000 dofs and 720 conditions takes 225 MB.
        """
        fields = self.fields.without_columns()
        if fields is self.fields:
            return self
        return self.changed(fields=fields, eliminated=self.eliminated.without_primal())

    @property
    def conditions(self) -> int:
        """Number of conditions; the model keeps all."""
        return self._m

    @cached_property
    def sizes(self) -> tuple[int, int]:
        """Numbers of unknowns and of conditions of an answer."""
        return self.eliminated(self.known.points[0]).unknown(np.zeros(self._m)).size, self._m

    @property
    def rows_at_once(self) -> int:
        """More if rows with the same statuses share factors, as far as memory allows."""
        if not self.eliminated.shares_factors:
            return super().rows_at_once
        return max(super().rows_at_once, min(MOST_ROWS, ROW_NUMBERS // sum(self.sizes)))

    @property
    def tabulated(self) -> bool:
        """True if critical regions are tabulated.

        Amplitudes are then affine, and the tables not too large.
        """
        return self._regions is not None
