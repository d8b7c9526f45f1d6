"""What a reduced model was trained on, kept with it as numbers, and the door at which a query is held against it.

Inside the box of a scene a model may still never have seen a parameter, a pace or a direction. Reduced histories were
up to 200 % wrong on paths that were not trained, without any sign in their convergence; their imbalance tells.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from hhr_dolfinx.errors import OutsideTrainingError, OutsideTrainingWarning, ParameterError
from hhr_dolfinx.parameters import ParameterSpace

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
EARLY = 0.2
"""Part of the largest stress known below which a history has hardly begun: its steps are badly explained in any."""
UNEXPLAINED = 0.01
"""Part of the stress that counts as explained by its modes whatever training showed: what they leave out of states that
were trained is far less than of any other state, and stress at Gauss points is seldom known better."""


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


class Signs(NamedTuple):
    """What shows at a solved step whether a reduced model still knows what it does.

    Attributes:
        imbalance: norm of the forces left on the reduced domain before they are projected, in the unit of force.
        size: norm of what these forces are made of.
        depth: deepest violation of a gap anywhere on the contact surface, in the unit of length, 0 if none.
        what: which imbalance that is, in words; on a cubature it is one of plastic strains, not of forces.
        misfit: what no mode of training explains of the stress where laws are evaluated, in the unit of stress.
        stress: norm of this stress.
    """

    imbalance: float
    size: float
    depth: float
    what: str = "the forces on the reduced domain are out of balance"
    misfit: float = 0.0
    stress: float = 0.0


@dataclass(frozen=True)
class TrainedPaths:
    """What a reduced model of histories was trained on.

    Attributes:
        parameters: values along all trained paths.
        slowest, fastest: smallest and largest rate of each parameter in any step, per second, (P,).
        steps: shortest and longest trained step, in seconds; kept to be read, since only rates decide.
        imbalance: largest imbalance of the known histories, solved by the reduced model, in the unit of force.
        share: the largest one over the largest size in the history up to then.
        depth: largest depth of the known histories, or what counts as none.
        misfit: largest misfit of the stress to its modes in the known histories, or what counts as none, in its unit.
        stress: largest norm of the stress in the known histories.
        unexplained: largest misfit over the largest stress in the history up to then, or what counts as none: absolute
            numbers of histories at large loads say nothing of one at small loads. See :func:`misfit_shares`.
    """

    parameters: TrainedRange
    slowest: np.ndarray
    fastest: np.ndarray
    steps: tuple[float, float]
    imbalance: float
    share: float
    depth: float
    misfit: float
    stress: float
    unexplained: float

    @classmethod
    def of(
        cls,
        paths: Sequence[Sequence[tuple[float, np.ndarray]]],
        space: ParameterSpace,
        known: Sequence[Sequence[Signs]],
        length: float,
    ) -> TrainedPaths:
        """From trained paths and what the reduced model showed on all histories that are known.

        Args:
            paths: of training, each a list of times and parameters with the start first.
            space: the box of the parameters.
            known: signs along trained and held-out histories.
            length: largest gap or relative motion of contact surfaces in training.
        """
        times = [np.array([time for time, _ in path]) for path in paths]
        points = [np.array([point for _, point in path]) for path in paths]
        steps = np.concatenate([np.diff(item) for item in times])
        rates = np.concatenate([np.diff(item, axis=0) for item in points]) / steps[:, None]
        shares = [imbalance_shares(signs) for signs in known]
        size = max(sign.size for signs in known for sign in signs)
        stress = max(sign.stress for signs in known for sign in signs)
        unexplained = [misfit_shares(signs, stress) for signs in known]
        return cls(
            TrainedRange.of(np.concatenate(points), space),
            rates.min(axis=0),
            rates.max(axis=0),
            (float(steps.min()), float(steps.max())),
            max(SMALL * size, max(sign.imbalance for signs in known for sign in signs)),
            max(SMALL, max(float(share.max()) for share in shares)),
            max(SMALL * length, max(sign.depth for signs in known for sign in signs)),
            max(max(UNEXPLAINED * sign.stress, sign.misfit) for signs in known for sign in signs),
            stress,
            max(UNEXPLAINED, max(float(share.max()) for share in unexplained)),
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
        rate, (low, high, noise) = (after - before) / step, self._paces
        wrong = (rate < low - noise / step) | (rate > high + noise / step)
        if not wrong.any():
            return ""
        return ", ".join(
            f"{name} changes by {value:g} per second (trained {slow:g} to {fast:g})"
            for name, value, slow, fast, bad in zip(
                self.parameters.names, rate, self.slowest, self.fastest, wrong, strict=True
            )
            if bad
        )


def imbalance_shares(signs: Sequence[Signs]) -> np.ndarray:
    """Imbalance of each step over the largest size of the forces up to it, (steps,)."""
    sizes = np.maximum.accumulate([sign.size for sign in signs])
    return np.array([sign.imbalance for sign in signs]) / np.where(sizes > 0, sizes, 1.0)


def misfit_shares(signs: Sequence[Signs], stress: float) -> np.ndarray:
    """Misfit of each step over the largest stress up to it, or a fifth of the largest one known, (steps,).

    First steps are small and badly explained whatever comes later.
    """
    sizes = np.maximum(np.maximum.accumulate([sign.stress for sign in signs]), EARLY * stress)
    return np.array([sign.misfit for sign in signs]) / np.where(sizes > 0, sizes, 1.0)


class Watch:
    """Holds the steps of one history against what was trained; each kind of complaint is given once.

    Args:
        trained: None lets everything pass, as for a full model.
        outside: see :func:`announce`.
    """

    def __init__(self, trained: TrainedPaths | None, outside: str):
        check_outside(outside)
        self._trained, self._outside = trained, outside
        self._said: set[str] = set()
        self._largest = self._stress = 0.0

    def before(self, number: int, start: float, end: float, here: np.ndarray, there: np.ndarray) -> None:
        """A step that is about to be solved, from one time and parameter to another."""
        if self._trained is not None:
            complaint = self._trained.complaint(end - start, here, there)
            if complaint:
                self._say("path", f"step {number}, to t = {end:g} s, is outside what was trained: {complaint}")

    def after(self, number: int, time: float, signs: Signs) -> None:
        """A step that was solved, with its signs."""
        if self._trained is None:
            return
        self._largest = max(self._largest, signs.size)
        share = signs.imbalance / (self._largest or 1.0)
        place = f"step {number}, to t = {time:g} s: "
        if not signs.imbalance <= FACTOR * self._trained.imbalance:
            self._say(
                "imbalance",
                f"{place}{signs.what} by {signs.imbalance:.2g}, in training by {self._trained.imbalance:.2g} at most",
            )
        elif not share <= FACTOR * self._trained.share:
            self._say(
                "imbalance",
                f"{place}{signs.what} by {share:.2g} of their size, in training by {self._trained.share:.2g} at most",
            )
        if not signs.depth <= FACTOR * self._trained.depth:
            self._say(
                "depth",
                f"{place}the bodies overlap by {signs.depth:.2g} where the reduced domain does not look, "
                f"in training by {self._trained.depth:.2g} at most",
            )
        if not signs.misfit <= FACTOR * self._trained.misfit:
            self._say(
                "misfit",
                f"{place}the stress differs from combinations of trained ones by {signs.misfit:.2g}, "
                f"in training by {self._trained.misfit:.2g} at most",
            )
        self._stress = max(self._stress, signs.stress)
        unexplained = signs.misfit / (max(self._stress, EARLY * self._trained.stress) or 1.0)
        if not unexplained <= FACTOR * self._trained.unexplained:
            self._say(
                "misfit",
                f"{place}the stress differs from combinations of trained ones by {unexplained:.2g} of the largest one, "
                f"in training by {self._trained.unexplained:.2g} at most",
            )

    def _say(self, kind, message):
        if kind not in self._said:
            self._said.add(kind)
            announce(f"{message}. Errors may be large: train on such a path, or take the full model", self._outside)
