"""What a reduced model was trained on, kept with it as numbers, and the check of queries against it.

Inside the box of a scene a model may still never have seen a parameter, a pace or a direction. Reduced histories were
up to 200 % wrong on paths that were not trained, without any sign in their convergence; their imbalance tells.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np

from hhr_dolfinx.declared import Floats
from hhr_dolfinx.errors import OutsideTrainingError, OutsideTrainingWarning, ParameterError
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.warn import warn

USUAL = "usual"
"""What a kind of model does outside of what was trained unless a query says otherwise."""
OUTSIDE = ("warn", "refuse", "ignore")
"""What may happen to a query outside what was trained."""

MARGIN = 0.05
"""Part of the spread of a parameter by which a query may lie outside it: slight extrapolation was found harmless."""
PACE = 1.5
"""Factor by which a rate may lie outside the trained ones."""
FACTOR = 3.0
"""Factor over the largest imbalance or depth of the known histories. On the flowing pellet 20 paths inside the training
stayed below 1.2 times its imbalance, and 40 outside, with errors of the displacement from 2 %, were above 3."""
SMALL = 1e-3
"""Part of the forces, or of the gaps and motions, that is small whatever training showed: where a model reproduces its
training to round-off, any other answer would seem far outside."""
EXPLAINED = 0.01
"""Part of the stress of a step that counts as explained by its modes whatever training showed, for the same reason."""
TOLD = 0.05
"""Estimate from which on a step is told, unless training showed nearly as much: an error that nobody wants."""
POOR = 1.2
"""Factor over the estimates of training that passes where that is more: of a poor model, which a build warns of."""
NOTHING = 1e-4
"""Part of the largest stress known below which that of a step is none: steps are solved to 1e-5 of forces, and a body
that moves freely before it touches has a stress of 3e-5 by the round-off of its modes."""
SMALL_STEP = 1e-2
"""Part of the largest stress known below which a trained step sets no limit: relative to itself its stress is wrong,
and as a limit it would let pass all that is wrong at full loads."""


def check_outside(outside: Any) -> None:
    """Refuse a word that says nothing, before it is needed.

    Raises:
        ParameterError: if ``outside`` is none of :data:`OUTSIDE`.
    """
    if outside not in OUTSIDE:
        raise ParameterError(f"outside = {outside!r} is unknown, one of {', '.join(OUTSIDE)}")


def announce(message: str, outside: str) -> None:
    """Warn of a query outside what was trained, refuse it, or let it pass; ``outside`` is one of :data:`OUTSIDE`."""
    check_outside(outside)
    if outside == "refuse":
        raise OutsideTrainingError(message)
    if outside == "warn":
        warn(message, OutsideTrainingWarning, stacklevel=3)


@dataclass(frozen=True)
class TrainedRange:
    """Smallest and largest trained value of each parameter, with a margin.

    Attributes:
        names: of the parameters.
        lower, upper: (P,).
    """

    names: Annotated[tuple[str, ...], "P"]
    lower: Annotated[Floats, "P"]
    upper: Annotated[Floats, "P"]

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """A range that ends below its start."""
        if not (self.lower <= self.upper).all():
            yield "the trained range ends below its start"

    @classmethod
    def of(cls, points: np.ndarray, space: ParameterSpace) -> TrainedRange:
        """The range of training points, (S, P); round-off of the box counts as inside."""
        lower = points.min(axis=0)
        upper = points.max(axis=0)
        margin = MARGIN * (upper - lower) + 1e-9 * (np.array(space.upper) - np.array(space.lower))
        return cls(tuple(space.names), lower - margin, upper + margin)

    def covers(self, space: ParameterSpace) -> bool:
        """Whether no point of the box can lie outside."""
        return bool((self.lower <= space.lower).all() and (self.upper >= space.upper).all())

    def complaint(self, point: np.ndarray) -> str:
        """What of a point, (P,), was never trained, in words; empty if nothing."""
        if ((self.lower <= point) & (point <= self.upper)).all():
            return ""
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


def share_of_stress(misfit: float, stress: float) -> float:
    """A misfit over the stress: 0 of bodies without stress, infinite of stress that is no number."""
    if not math.isfinite(stress):
        return math.inf
    return misfit / stress if stress > 0 else 0.0


class Signs(NamedTuple):
    """What shows at a solved step whether a reduced model still knows what it does.

    Attributes:
        imbalance: norm of the forces left on the reduced domain before they are projected, in the unit of force.
        size: norm of what these forces are made of.
        depth: deepest violation of a gap anywhere on the contact surface, in the unit of length, 0 if none.
        what: which imbalance that is, in words.
        misfit: what no mode of training explains of the stress where laws are evaluated, in the unit of stress.
        stress: norm of this stress.
    """

    imbalance: float
    size: float
    depth: float
    what: str = "the forces on the reduced domain are out of balance"
    misfit: float = 0.0
    stress: float = 0.0

    @property
    def estimate(self) -> float:
        """Misfit over stress, what :meth:`Answer.estimate` says of a step of bodies that flow; 0 without stress."""
        return share_of_stress(self.misfit, self.stress)


class Known(NamedTuple):
    """What a reduced model showed on the histories of its training, each a list of signs, one for each step.

    Attributes:
        signs: along trained histories.
        onsets: along first steps of trained histories in small parts, which any finer path passes through.
        length: largest gap or relative motion of contact surfaces in training.
    """

    signs: Sequence[Sequence[Signs]]
    onsets: Sequence[Sequence[Signs]]
    length: float


@dataclass(frozen=True)
class TrainedPaths:
    """What a reduced model of histories was trained on.

    Attributes:
        parameters: values along all trained paths.
        slowest, fastest: smallest and largest rate of each parameter in any step, per second, (P,). Of laws without
            rates, which know directions only, its change while that which changes most, as a part of its trained
            range, goes through all of it.
        steps: shortest and longest trained step, in seconds; kept to be read, since only rates decide.
        rated: whether any law has rates.
        imbalance: largest imbalance of the known histories, solved by the reduced model, in the unit of force.
        depth: largest depth of the known histories, or what counts as none.
        stress: largest norm of the stress in the known histories.
        estimate: largest estimate of any of their steps, or what counts as none.
        begun: smallest norm of the stress behind the first step of any of them: below, a history has hardly begun.
        onset: largest estimate of small parts of these first steps, at least ``estimate``.
    """

    parameters: TrainedRange
    slowest: Annotated[Floats, "P"]
    fastest: Annotated[Floats, "P"]
    steps: tuple[float, float]
    rated: bool
    imbalance: float
    depth: float
    stress: float
    estimate: float
    begun: float
    onset: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return self.parameters.names

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Rates, steps and signs that are impossible."""
        if not (self.slowest <= self.fastest).all() or not 0 < self.steps[0] <= self.steps[1]:
            yield f"trained steps take {self.steps} s, or rates end below their start, which is no range"
        signs = self.imbalance, self.depth, self.stress, self.estimate, self.begun, self.onset
        if min(signs) < 0:
            yield f"the imbalance, the depth, the stress and the estimates of the training are {signs}"

    @classmethod
    def of(
        cls,
        paths: Sequence[Sequence[tuple[float, np.ndarray]]],
        space: ParameterSpace,
        known: Known,
        rated: bool = True,
    ) -> TrainedPaths:
        """From trained paths and what the reduced model showed on all histories that are known.

        Args:
            paths: of training, each a list of times and parameters with the start first.
            space: the box of the parameters.
            known: signs of known histories.
            rated: whether any law has rates.
        """
        times = [np.array([time for time, _ in path]) for path in paths]
        points = [np.array([point for _, point in path]) for path in paths]
        steps = np.concatenate([np.diff(item) for item in times])
        changes = np.concatenate([np.diff(item, axis=0) for item in points])
        range_ = TrainedRange.of(np.concatenate(points), space)
        rates = changes / steps[:, None] if rated else np.array([_direction(item, range_) for item in changes])
        every = [sign for signs in known.signs for sign in signs]
        largest = max(sign.stress for sign in every)
        # as steps are held against it: of no stress to speak of nothing is explained, which says nothing
        estimate = max([EXPLAINED, *(sign.estimate for sign in every if sign.stress > SMALL_STEP * largest)])
        begun = [next((sign.stress for sign in signs if sign.stress > NOTHING * largest), 0.0) for signs in known.signs]
        return cls(
            range_,
            rates.min(axis=0),
            rates.max(axis=0),
            (float(steps.min()), float(steps.max())),
            rated,
            max(SMALL * max(sign.size for sign in every), max(sign.imbalance for sign in every)),
            max(SMALL * known.length, max(sign.depth for sign in every)),
            largest,
            estimate,
            min(begun),
            max([estimate, *(s.estimate for signs in known.onsets for s in signs if s.stress > NOTHING * largest)]),
        )

    @cached_property
    def _paces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Smallest and largest rates that pass, and changes that are round-off, (P,) each."""
        low = np.where(self.slowest > 0, self.slowest / PACE, self.slowest * PACE)
        high = np.where(self.fastest > 0, self.fastest * PACE, self.fastest / PACE)
        return low, high, 1e-9 * (self.parameters.upper - self.parameters.lower)

    def complaint(self, step: float, before: np.ndarray, after: np.ndarray) -> str:
        """What of a step, in seconds, between two parameters, (P,), was never trained; empty if nothing."""
        place = self.parameters.complaint(before) or self.parameters.complaint(after)
        if place:
            return place
        change = after - before
        low, high, noise = self._paces
        if self.rated:
            rate = change / step
            noise = noise / step
            per = "second"
        else:
            rate = _direction(change, self.parameters)
            per = "whole range of what changes most"
            if not rate.any():  # nothing changes, and nothing flows
                return ""
        wrong = (rate < low - noise) | (rate > high + noise)
        if not wrong.any():
            return ""
        return ", ".join(
            f"{name} changes by {value:g} per {per} (trained {slow:g} to {fast:g})"
            for name, value, slow, fast, bad in zip(
                self.parameters.names, rate, self.slowest, self.fastest, wrong, strict=True
            )
            if bad
        )

    def shown(self, largest: float) -> float:
        """Largest estimate that training showed, for a history with a largest norm of the stress up to then."""
        return self.estimate if largest >= self.begun else self.onset

    def allowed(self, largest: float) -> float:
        """Largest estimate of a step that passes, in such a history."""
        shown = self.shown(largest)
        return max(min(FACTOR * shown, TOLD), POOR * shown)


def _direction(change: np.ndarray, trained: TrainedRange) -> np.ndarray:
    """A change over the largest part of a trained range that it goes through, (P,); 0 for one that is round-off."""
    largest = float(np.abs(change / (trained.upper - trained.lower)).max())
    return change / largest if largest > 1e-9 else np.zeros_like(change)


class Watch:
    """Holds the steps of one history against what was trained; each kind of complaint is given once.

    Args:
        trained: None lets everything pass, as for a full model.
        outside: see :func:`announce`.
    """

    def __init__(self, trained: TrainedPaths | None, outside: str):
        check_outside(outside)
        self._trained = trained
        self._outside = outside
        self._said: set[str] = set()
        self._largest = 0.0

    def before(self, number: int, start: float, end: float, here: np.ndarray, there: np.ndarray) -> None:
        """A step that is about to be solved, from one time and parameter to another."""
        if self._trained is not None:
            complaint = self._trained.complaint(end - start, here, there)
            if complaint:
                self._say("path", f"step {number}, to t = {end:g} s, is outside what was trained: {complaint}")

    def after(self, number: int, time: float, signs: Signs) -> None:
        """A step that was solved, with its signs."""
        trained = self._trained
        if trained is None:
            return
        place = f"step {number}, to t = {time:g} s: "
        if not signs.imbalance <= FACTOR * trained.imbalance:
            self._say(
                "imbalance",
                f"{place}{signs.what} by {signs.imbalance:.2g}, in training by {trained.imbalance:.2g} at most",
            )
        if not signs.depth <= FACTOR * trained.depth:
            self._say(
                "depth",
                f"{place}the bodies overlap by {signs.depth:.2g} where the reduced domain does not look, "
                f"in training by {trained.depth:.2g} at most",
            )
        self._largest = max(self._largest, signs.stress)
        # of its own size: what stays behind a small load is small, and may be wrong as a whole
        if not signs.stress <= NOTHING * trained.stress and not signs.estimate <= trained.allowed(self._largest):
            self._say(
                "misfit",
                f"{place}the stress differs from combinations of trained ones by {signs.estimate:.2g} of its size, "
                f"in training by {trained.shown(self._largest):.2g} at most",
            )

    def _say(self, kind, message):
        if kind not in self._said:
            self._said.add(kind)
            announce(f"{message}. Errors may be large: train on such a path, or take the full model", self._outside)
