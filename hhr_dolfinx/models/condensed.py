"""Contact problem whose primal unknown is eliminated offline.

With K factored, the primal unknown of thesis (1.21) or (1.61) is

    primal(mu, lambda) = free_primal θ(mu) - primal_per_force lambda,

and the contact conditions become slack = free_slack θ(mu) + S lambda with S = B K^-1 B^T. Both the
reduced model and the exact condensation of a full model are of this form; they differ in their arrays.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Status, active_set
from hhr_dolfinx.errors import ParameterError, SingularError
from hhr_dolfinx.linear.dense import Factor, Factorise, dense_factors, solve_columns
from hhr_dolfinx.models.answer import Answer, Fields, History, Path, WithOutputs, found_as, outcome
from hhr_dolfinx.models.path import DEFAULT_MARCH, MarchSettings, checked_path, solve_along
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.trained import TrainedRange, check_outside

if TYPE_CHECKING:
    from hhr_dolfinx.models.gradient import Gradient
    from hhr_dolfinx.models.many import ManyAnswers


@dataclass(frozen=True)
class Responses:
    """All that is left of the primal unknown once it is eliminated (n unknowns, m conditions, 1 + T terms).

    Attributes:
        free_primal: primal unknown without contact forces, (n, 1 + T).
        primal_per_force: K^-1 B^T, (n, m).
        free_slack: slack without contact forces, (m, 1 + T).
        schur: S = B K^-1 B^T, (m, m).
    """

    free_primal: np.ndarray
    primal_per_force: np.ndarray
    free_slack: np.ndarray
    schur: np.ndarray

    @classmethod
    def eliminate(
        cls, factor: Factor, loads: np.ndarray, gaps: np.ndarray, test: np.ndarray, trial: np.ndarray
    ) -> Responses:
        """Eliminate the unknown of K x + test^T lambda = loads θ, trial x <= gaps θ.

        Args:
            factor: of K.
            loads: (n, 1 + T).
            gaps: (m, 1 + T).
            test: rows by which forces act, (m, n).
            trial: rows by which gaps are read, (m, n).
        """
        free, per_force = solve_columns(factor, loads), solve_columns(factor, test.T)
        return cls(free, per_force, gaps - trial @ free, trial @ per_force)


REGION_ENTRIES = 2_000_000
"""Numbers (16 MB) that the tabulated critical regions of one model may take; beyond, none are kept."""
PREPARED_BYTES = 16 * 2**20
"""Memory for factors of known statuses where there are no regions: a query that starts from them factors nothing."""


@dataclass(frozen=True)
class KnownStatuses:
    """Statuses at solved parameters, to start the active set near its end.

    Attributes:
        points: (S, P).
        active: (S, m) bool.
    """

    points: np.ndarray
    active: np.ndarray

    def __post_init__(self) -> None:
        self.active.setflags(write=False)  # answers share them

    @cached_property
    def distances(self) -> tuple[np.ndarray, np.ndarray]:
        """Offsets and directions of |x - p|^2 / 2 less what does not depend on the candidate x.

        The parameters, whose units differ, are scaled by their spread.
        """
        spread = np.ptp(self.points, axis=0)
        spread[spread == 0] = 1.0
        return 0.5 * np.sum((self.points / spread) ** 2, axis=1), self.points / spread**2

    def __reduce__(self) -> tuple:
        """Copy and pickle by the arrays alone: copies protect their rows too."""
        return KnownStatuses, (self.points, self.active)

    def nearest(self, point: np.ndarray) -> int:
        """Index of the nearest known parameter."""
        offsets, directions = self.distances
        return (offsets - directions @ point).argmin()

    def start(self, point: np.ndarray) -> np.ndarray:
        """Statuses to start from at a point, (m,) bool: those of the nearest known parameter."""
        return self.active[self.nearest(point)]

    def starts(self, points: np.ndarray) -> np.ndarray:
        """Statuses to start from at many points, (n, P): (n, m) bool, for the caller to change."""
        offsets, directions = self.distances
        return self.active[(offsets - points @ directions.T).argmin(axis=1)]


def checked_start(start: Any, conditions: int) -> Any:
    """What a search may start from: ``nearest``, None, or statuses.

    Raises:
        ParameterError: for another word, or statuses that are not bool or not one for each condition.
    """
    if start is None or (isinstance(start, str) and start == "nearest"):
        return start
    statuses = np.asarray(start)
    if statuses.dtype != bool or statuses.shape != (conditions,):
        given = repr(start) if statuses.ndim == 0 else f"{statuses.dtype} of shape {statuses.shape}"
        raise ParameterError(
            f"start = {given} is unknown: 'nearest', None for a cold start, or statuses ({conditions},) bool"
        )
    return statuses


class CondensedModel(WithOutputs):
    """Answers parameters with the primal unknown eliminated.

    With fixed statuses the solution is affine in the parameters. These affine maps, the critical
    regions of multi-parametric programming (Bemporad, Morari, Dua and Pistikopoulos, Automatica 38,
    2002), are tabulated for the known statuses: where the map of the nearest one gives forces and
    slacks that are all non-negative, it is the solution, and no equality problem is solved online.

    Several threads may ask one model; it can be copied and pickled, for a pool of workers, and its copies answer alike.

    Args:
        parameters: the box of the parameters.
        amplitudes: θ as a function of the parameters.
        responses: what the primal unknown leaves behind.
        known: statuses of solved parameters.
        fields: what completes the answers.
        factorise: what factors a dense block.
        pairs: number of the contact pair of each condition, (m,); None takes all for one pair.
        trained: parameters outside of which answers are not to be trusted; None where there are none.
        advice: what helps against a status, for the messages.
    """

    offline: Any = None  # nothing was approximated: there is no record
    file_format = "condensed"
    kept: ClassVar[Mapping[str, str]] = MappingProxyType(
        {name: name for name in ("parameters", "amplitudes", "known", "fields", "pairs")} | {"responses": "eliminated"}
    )
    """Arguments by which a file keeps it, and attributes that hold them."""

    def __init__(
        self,
        parameters: ParameterSpace,
        amplitudes: Amplitudes,
        responses: Responses,
        known: KnownStatuses,
        fields: Fields,
        factorise: Factorise = dense_factors,
        pairs: np.ndarray | None = None,
        trained: TrainedRange | None = None,
        advice: Mapping[Status, str] = MappingProxyType({}),
    ):
        self.parameters, self.amplitudes, self.known, self.trained = parameters, amplitudes, known, trained
        self.fields, self._advice = fields, advice
        # where the whole box was trained, its own check is enough
        self._door = None if trained is None or trained.covers(parameters) else trained
        self._schur, self._factorise, self.pairs = responses.schur, factorise, pairs
        self._pairs = Pairs.of(pairs)
        self._m = responses.schur.shape[0]
        self._response = np.asfortranarray(np.vstack([responses.free_slack, responses.free_primal]))
        self._per_force = np.ascontiguousarray(responses.primal_per_force)
        self._equalities = SchurEqualities.of(responses.schur, factorise)
        self._regions = self._tabulate_regions()

    def __reduce__(self) -> tuple:
        """Copy and pickle by the arrays that it was made of: factors and locks belong to one process."""
        how = self._factorise, self.pairs, self.trained, dict(self._advice)
        return type(self), (self.parameters, self.amplitudes, self.eliminated, self.known, self.fields, *how)

    @property
    def eliminated(self) -> Responses:
        """The arrays that it was made of."""
        free_slack, free_primal = np.split(self._response, [self._m])
        return Responses(free_primal, self._per_force, free_slack, self._schur)

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
        if gradient:
            answer = self.solve(mu, start=start, raise_on_failure=raise_on_failure, outside=outside)
            return answer._replace(gradient=self._gradient(answer)) if answer.converged else answer
        point = self.parameters.point(mu)
        check_outside(outside)
        if self._door is not None:
            self._door.check(point, outside)
        start = checked_start(start, self._m)
        if isinstance(start, str):
            nearest = self.known.nearest(point) if self._regions else 0
            region = self._regions[nearest] if self._regions else None
            start = self.known.start(point) if region is None else self.known.active[nearest]
            if region is not None:
                constant, slopes = region
                m, values = self._m, constant + slopes @ point
                # the ufunc itself: its wrapper takes as long again
                if np.minimum.reduce(values[: 2 * m]) >= 0:
                    return Answer(point, values[2 * m :], values[:m], start, 1, Status.CONVERGED, False, self.fields)
        response = self._response @ self.amplitudes(point)
        free_slack = response[: self._m]
        start = free_slack < 0 if start is None else start
        found = active_set(self._equalities, free_slack, start, pairs=self._pairs)
        unknown = response[self._m :] - self._per_force @ found.forces
        return outcome(found_as(found, point, unknown, self.fields), raise_on_failure, self._advice)

    @property
    def conditions(self) -> int:
        """Number of conditions, all of which are kept."""
        return self._m

    @property
    def tabulated(self) -> bool:
        """Whether answers of known statuses are: where amplitudes are affine, and tables not too large."""
        return bool(self._regions)

    @property
    def responses(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Free slack and, behind it, free primal unknown, (m + n, 1 + T); S, (m, m); K^-1 B^T, (n, m)."""
        return self._response, self._schur, self._per_force

    def solve_many(self, points: Any, *, raise_on_failure: bool = True, outside: str = "warn") -> ManyAnswers:
        """Answer many parameters, (n, P), at once; as :meth:`solve` does, to round-off, and quicker the more there are.

        Args:
            points: one row for each.
            raise_on_failure: raise at the first that has no answer, or go on with NaN and a status.
            outside: see :meth:`Model.solve`.
        """
        from hhr_dolfinx.models.many import checked_points, condensed_answers

        checked = checked_points(self.parameters, points)
        check_outside(outside)
        if self._door is not None:
            inside = ((checked >= self._door.lower) & (checked <= self._door.upper)).all(axis=1)
            for point in checked[~inside]:
                self._door.check(point, outside)
        return condensed_answers(self, checked, raise_on_failure=raise_on_failure, outside="ignore")

    def _gradient(self, answer: Answer) -> Gradient:
        """Derivatives of an answer."""
        from hhr_dolfinx.models.gradient import gradient_of

        acting, slopes = self.amplitudes.slopes_at(answer.parameter)
        changes = self._response[:, acting] @ slopes
        free_slack = self._response[: self._m] @ self.amplitudes(answer.parameter)
        slack = free_slack + self._schur @ answer.multipliers
        fixed = changes[: self._m], changes[self._m :]
        how = answer.active, answer.multipliers, slack, fixed, self._per_force.__matmul__
        return gradient_of(self._equalities, *how)

    def march(self, path: Path, settings: MarchSettings = DEFAULT_MARCH) -> History:
        """Solve along a path; see :func:`solve_along`."""
        return solve_along(self, checked_path(self.parameters, path), settings)

    def completed_by(self, fields: Fields) -> CondensedModel:
        """The same model with other fields: on another mesh, or of another unknown."""
        model = copy(self)
        model.fields = fields
        return model

    def _tabulate_regions(self):
        """For each known status the affine map mu -> (forces, slacks, primal).

        None where there is none: too large, not affine, a singular set, or numbers that are not finite.
        """
        distinct, which = np.unique(self.known.active, axis=0, return_inverse=True)
        size = len(distinct) * (self._m + len(self._response)) * (1 + len(self.parameters.names))
        if self.amplitudes.nonaffine or size > REGION_ENTRIES:
            self._equalities.prepare(distinct, PREPARED_BYTES)
            return []
        # columns: the value at mu = 0, then the slope along each parameter
        response = self._response @ np.column_stack([self.amplitudes.constant, self.amplitudes.slopes])
        regions: list[tuple[np.ndarray, np.ndarray] | None] = []
        for active in distinct:
            try:
                columns = [self._equalities(active, column) for column in response[: self._m].T]
            except SingularError:  # the active set may find a way round
                regions.append(None)
                continue
            forces, slack = (np.stack(item, axis=1) for item in zip(*columns, strict=True))
            values = np.vstack([forces, slack, response[self._m :] - self._per_force @ forces])
            finite = np.isfinite(values).all()
            regions.append((values[:, 0].copy(), np.ascontiguousarray(values[:, 1:])) if finite else None)
        return [regions[k] for k in which.ravel()]
