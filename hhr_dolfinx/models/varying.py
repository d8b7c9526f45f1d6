"""Models whose stiffness depends on parameters: for each query the primal unknown is eliminated anew.

What is left is the same small contact problem as of a :class:`CondensedModel`, slack = free_slack + S lambda. How S
comes about is the business of an :class:`Elimination`: by factors of K~(mu), or interpolated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Status, active_set
from hhr_dolfinx.contact.floating import FloatingEqualities, floating_set
from hhr_dolfinx.errors import NotSolvableError, ParameterError
from hhr_dolfinx.linear.dense import LapackLU
from hhr_dolfinx.models.answer import (
    Answer,
    Fields,
    History,
    Path,
    SeveralAnswers,
    WithOutputs,
    found_as,
    outcome,
    unanswered,
)
from hhr_dolfinx.models.condensed import KnownStatuses, checked_start
from hhr_dolfinx.models.gradient import Gradient, gradient_of, grazing
from hhr_dolfinx.models.path import DEFAULT_MARCH, MarchSettings, checked_path, solve_along
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.trained import TrainedRange, check_outside


@dataclass(frozen=True, eq=False)
class Floating:
    """Rigid motions of bodies that nothing but contact holds, beside what elimination leaves (r motions).

    Attributes:
        equalities: on S with the motions.
        driving: loads along the motions, (r,).
        modes: the motions as primal unknowns, (n, r).
        drift: maps forces and unknown to the derivatives along the parameters of what is out of balance along the
            motions while both stay, (r, P).
    """

    equalities: FloatingEqualities
    driving: np.ndarray
    modes: np.ndarray
    drift: Callable[[np.ndarray, np.ndarray], np.ndarray]


class Elimination(Protocol):
    """What is left of the primal unknown at one parameter (n unknowns, m conditions).

    One of bodies that only contact holds has an attribute ``floating`` besides, a :class:`Floating`.
    """

    @property
    def schur(self) -> np.ndarray:
        """S, (m, m)."""

    @property
    def free_slack(self) -> np.ndarray:
        """Slack without contact forces, (m,)."""

    @property
    def symmetric(self) -> bool:
        """Whether S is."""

    def unknown(self, forces: np.ndarray) -> np.ndarray:
        """The primal unknown under contact forces, (n,)."""

    def at_fixed_forces(self, forces: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives along the parameters, while the forces stay, of the slack, (m, P), and the unknown, (n, P)."""

    def pushed(self, forces: np.ndarray) -> np.ndarray:
        """What forces, (m, k), take from the unknown, (n, k)."""


def answer_of(
    elimination: Elimination,
    point: np.ndarray,
    start: np.ndarray | None,
    pairs: Pairs | None,
    fields: Fields,
    *,
    gradient: bool,
    equalities: SchurEqualities | None = None,
) -> Answer:
    """Solve the contact problem that is left, from some statuses or, with None, those of the free slack.

    ``equalities`` are those of S, where another point with the same S has made them.
    """
    free_slack, schur = elimination.free_slack, elimination.schur
    if getattr(elimination, "floating", None) is not None:
        return _floating_answer(elimination, point, free_slack < 0 if start is None else start, pairs, fields, gradient)
    equalities = equalities_of(elimination) if equalities is None else equalities
    found = active_set(equalities, free_slack, free_slack < 0 if start is None else start, pairs=pairs)
    unknown = elimination.unknown(found.forces)
    answer = found_as(found, point, unknown, fields)
    if not gradient or found.status is not Status.CONVERGED:
        return answer
    slack = free_slack + schur @ found.forces
    fixed = elimination.at_fixed_forces(found.forces, unknown)
    how = found.active, found.forces, slack, fixed, elimination.pushed
    return answer._replace(gradient=gradient_of(equalities, *how))


def _floating_answer(
    elimination: Any, point: np.ndarray, start: np.ndarray, pairs: Pairs | None, fields: Fields, gradient: bool
) -> Answer:
    """The same where rigid motions are unknowns too."""
    floating: Floating = elimination.floating
    equalities, free_slack = floating.equalities, elimination.free_slack
    found, motions = floating_set(equalities, free_slack, floating.driving, start, pairs)
    unknown = elimination.unknown(found.forces) + floating.modes @ motions
    answer = found_as(found, point, unknown, fields)
    if not gradient or found.status is not Status.CONVERGED:
        return answer
    slack = free_slack + elimination.schur @ found.forces - equalities.taken @ motions
    of_slack, of_unknown = elimination.at_fixed_forces(found.forces, unknown)
    driven = floating.drift(found.forces, unknown)
    changes, opened, moved = equalities.several(found.active, of_slack, driven)
    of_unknown = of_unknown - elimination.pushed(changes) + floating.modes @ moved
    return answer._replace(gradient=Gradient(of_unknown, changes, grazing(found.active, found.forces, slack), opened))


def equalities_of(elimination: Elimination) -> SchurEqualities:
    """Equality problems on S."""
    if elimination.symmetric:
        return SchurEqualities.symmetric(elimination.schur)
    return SchurEqualities.of(elimination.schur, LapackLU)


class VaryingModel(WithOutputs):
    """Answers parameters with the primal unknown eliminated for each of them.

    Several threads may ask one model.

    Args:
        parameters: the box of the parameters.
        eliminated: eliminates the primal unknown at a point, (P,).
        known: statuses of solved parameters.
        fields: what completes the answers.
        pairs: number of the contact pair of each condition, (m,).
        trained: parameters outside of which answers are not to be trusted; None where there are none.
        advice: what helps against a status, for the messages.

    Attributes:
        offline: how it was made, the record of what built it; None for a model from a file.
    """

    file_format = "condensed"
    kept: ClassVar[Mapping[str, str]] = MappingProxyType(
        {name: name for name in ("parameters", "eliminated", "known", "fields", "pairs")}
    )
    """Arguments by which a file keeps it, and attributes that hold them."""

    def __init__(
        self,
        parameters: ParameterSpace,
        eliminated: Callable[[np.ndarray], Elimination],
        known: KnownStatuses,
        fields: Fields,
        pairs: np.ndarray,
        trained: TrainedRange | None = None,
        advice: Mapping[Status, str] = MappingProxyType({}),
    ):
        self.parameters, self.eliminated, self.known, self.fields = parameters, eliminated, known, fields
        self.trained, self._advice, self.pairs = trained, advice, pairs
        self.offline: Any = None
        self._door = None if trained is None or trained.covers(parameters) else trained
        self._pairs, self._m = Pairs.of(pairs), len(pairs)

    def __reduce__(self) -> tuple:
        """Copy and pickle by what it was made of; how it was made stays behind."""
        given = self.parameters, self.eliminated, self.known, self.fields, self.pairs, self.trained, dict(self._advice)
        return type(self), given

    @property
    def conditions(self) -> int:
        """Number of conditions, all of which are kept."""
        return self._m

    @cached_property
    def _sizes(self) -> tuple[int, int]:
        """Numbers of unknowns and of conditions of an answer."""
        return self.eliminated(self.known.points[0]).unknown(np.zeros(self._m)).size, self._m

    def solve(
        self,
        mu: Any,
        *,
        start: Any = "nearest",
        raise_on_failure: bool = True,
        outside: str = "warn",
        gradient: bool = False,
    ) -> Answer:
        """Solve for one parameter, see :meth:`Model.solve`."""
        point = self.parameters.point(mu)
        check_outside(outside)
        if self._door is not None:
            self._door.check(point, outside)
        start = checked_start(start, self._m)
        if isinstance(start, str):
            start = self.known.start(point)
        try:
            eliminated = self.eliminated(point)
        except (NotSolvableError, ParameterError):
            # a singular stiffness, or a shape at which surfaces slide off what the model knows
            if raise_on_failure:
                raise
            return unanswered(point, self._sizes, self.fields)
        answer = answer_of(eliminated, point, start, self._pairs, self.fields, gradient=gradient)
        return outcome(answer, raise_on_failure, self._advice)

    def solve_many(self, points: Any, *, raise_on_failure: bool = True, outside: str = "warn") -> SeveralAnswers:
        """Answer many parameters, (n, P); neighbours that share their stiffness share S and its factors."""
        from hhr_dolfinx.models.many import ManyAnswers

        eliminated: Any = self.eliminated
        if not hasattr(eliminated, "stiffness_axes"):
            return super().solve_many(points, raise_on_failure=raise_on_failure, outside=outside)
        check_outside(outside)
        answers, before, equalities = [], None, None
        for point in self.parameters.points(points):
            if self._door is not None:
                self._door.check(point, outside)
            if before is not None and eliminated.same_stiffness(before.point, point):
                before = eliminated.moved_to(before, point)
            else:
                try:
                    before = eliminated(point)
                except (NotSolvableError, ParameterError):
                    if raise_on_failure:
                        raise
                    before = None
                    answers.append(unanswered(point, self._sizes, self.fields))
                    continue
                equalities = equalities_of(before)
            start, how = self.known.start(point), (self._pairs, self.fields)
            answer = answer_of(before, point, start, *how, gradient=False, equalities=equalities)
            answers.append(outcome(answer, raise_on_failure, self._advice))
        return ManyAnswers.of(answers, self.fields)

    def completed_by(self, fields: Fields) -> VaryingModel:
        """The same model with other fields: on another mesh, or of another unknown."""
        model = copy(self)
        model.fields = fields
        return model

    def march(self, path: Path, settings: MarchSettings = DEFAULT_MARCH) -> History:
        """Solve along a path; see :func:`solve_along`."""
        return solve_along(self, checked_path(self.parameters, path), settings)
