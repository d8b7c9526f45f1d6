"""What a reduced model was trained on, kept with it as numbers, and the door at which a query is held against it.

Inside the box of a scene a model may still never have seen a parameter, a pace or a direction. Reduced histories were
up to 200 % wrong on paths that were not trained, without any sign in their convergence; their imbalance tells.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.errors import OutsideTrainingError, OutsideTrainingWarning, ParameterError
from hhr_dolfinx.parameters import ParameterSpace

OUTSIDE = ("warn", "refuse", "ignore")
"""What may happen to a query outside what was trained."""

MARGIN = 0.05
"""Part of the spread of a parameter by which a query may lie outside it: slight extrapolation was found harmless."""
PACE = 1.5
"""Factor by which a rate may lie outside the trained ones."""
IMBALANCE = 3.0
"""Factor over the largest imbalance of the trained histories. On the flowing pellet unseen gaps stayed below 1.4 times
that, and every path with an error of the displacement above 2.5 % was above 3.4 times, most above 20."""


def announce(message: str, outside: str) -> None:
    """Warn of a query outside what was trained, or refuse it, or let it pass.

    Raises:
        OutsideTrainingError: if ``outside`` is ``refuse``.
        ParameterError: if ``outside`` is none of :data:`OUTSIDE`.

    Warns:
        OutsideTrainingWarning: if it is ``warn``.
    """
    if outside not in OUTSIDE:
        raise ParameterError(f"outside = '{outside}' is unknown, one of {', '.join(OUTSIDE)}")
    if outside == "refuse":
        raise OutsideTrainingError(message)
    if outside == "warn":
        warnings.warn(message, OutsideTrainingWarning, stacklevel=3)


@dataclass(frozen=True)
class TrainedRange:
    """Smallest and largest trained value of each parameter, with a margin.

    Attributes:
        names: of the parameters.
        lower, upper: (P,).
    """

    names: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, space: ParameterSpace) -> TrainedRange:
        """The range of training points, (S, P); round-off of the box counts as inside."""
        lower, upper = points.min(axis=0), points.max(axis=0)
        margin = MARGIN * (upper - lower) + 1e-9 * (np.array(space.upper) - np.array(space.lower))
        return cls(tuple(space.names), lower - margin, upper + margin)

    def covers(self, space: ParameterSpace) -> bool:
        """Whether no point of the box can lie outside."""
        return bool((self.lower <= space.lower).all() and (self.upper >= space.upper).all())

    def complaint(self, point: np.ndarray) -> str:
        """What of a point, (P,), was never trained, in words; empty if nothing."""
        outside = [
            f"{name} = {value:g} (trained {low:g} to {high:g})"
            for name, value, low, high in zip(self.names, point, self.lower, self.upper, strict=True)
            if not low <= value <= high
        ]
        return ", ".join(outside)

    def check(self, point: np.ndarray, outside: str) -> None:
        """Hold a point against the range; see :func:`announce`."""
        complaint = self.complaint(point)
        if complaint:
            announce(f"outside what was trained: {complaint}. Train there, or take the full model", outside)


@dataclass(frozen=True)
class TrainedPaths:
    """What a reduced model of histories was trained on.

    Attributes:
        parameters: values along all trained paths.
        slowest, fastest: smallest and largest rate of each parameter in any step, per second, (P,).
        steps: shortest and longest trained step, in seconds; kept to be read, since only rates decide.
        imbalance: largest imbalance of the trained histories, solved by the reduced model, in the unit of force.
    """

    parameters: TrainedRange
    slowest: np.ndarray
    fastest: np.ndarray
    steps: tuple[float, float]
    imbalance: float

    @classmethod
    def of(
        cls, paths: Sequence[Sequence[tuple[float, np.ndarray]]], space: ParameterSpace, imbalance: float
    ) -> TrainedPaths:
        """From trained paths, each a list of times and parameters with the start first."""
        times = [np.array([time for time, _ in path]) for path in paths]
        points = [np.array([point for _, point in path]) for path in paths]
        steps = np.concatenate([np.diff(item) for item in times])
        rates = np.concatenate([np.diff(item, axis=0) for item in points]) / steps[:, None]
        visited = TrainedRange.of(np.concatenate(points), space)
        return cls(visited, rates.min(axis=0), rates.max(axis=0), (steps.min(), steps.max()), imbalance)

    def complaint(self, step: float, before: np.ndarray, after: np.ndarray) -> str:
        """What of a step, in seconds, between two parameters, (P,), was never trained; empty if nothing."""
        place = self.parameters.complaint(after)
        if place:
            return place
        rate = (after - before) / step
        low = np.where(self.slowest > 0, self.slowest / PACE, self.slowest * PACE)
        high = np.where(self.fastest > 0, self.fastest * PACE, self.fastest / PACE)
        noise = 1e-9 * (self.parameters.upper - self.parameters.lower) / step
        wrong = (rate < low - noise) | (rate > high + noise)
        return ", ".join(
            f"{name} changes by {value:g} per second (trained {slow:g} to {fast:g})"
            for name, value, slow, fast, bad in zip(
                self.parameters.names, rate, self.slowest, self.fastest, wrong, strict=True
            )
            if bad
        )


class Watch:
    """Holds the steps of one history against what was trained; each kind of complaint is said once.

    Args:
        trained: None lets everything pass, as for a full model.
        outside: see :func:`announce`.
    """

    def __init__(self, trained: TrainedPaths | None, outside: str):
        if outside not in OUTSIDE:
            raise ParameterError(f"outside = '{outside}' is unknown, one of {', '.join(OUTSIDE)}")
        self._trained, self._outside = trained, outside
        self._said: set[str] = set()

    def before(self, number: int, start: float, end: float, here: np.ndarray, there: np.ndarray) -> None:
        """A step that is asked for, from one time and parameter to another."""
        if self._trained is not None:
            complaint = self._trained.complaint(end - start, here, there)
            if complaint:
                self._say("path", f"step {number}, to t = {end:g} s, is outside what was trained: {complaint}")

    def after(self, number: int, time: float, imbalance: float) -> None:
        """A step that was solved, with its imbalance."""
        if self._trained is not None and not imbalance <= IMBALANCE * self._trained.imbalance:
            self._say(
                "imbalance",
                f"step {number}, to t = {time:g} s: the forces on the reduced domain are out of balance by "
                f"{imbalance:.2g}, in training by {self._trained.imbalance:.2g} at most",
            )

    def _say(self, kind, message):
        if kind not in self._said:
            self._said.add(kind)
            announce(f"{message}. Errors may be large: train on such a path, or take the full model", self._outside)
