"""Training range of a reduced model of histories, stored with it as numbers, and the check of steps
against it.

Even inside the box of a scene a rate or a direction of loading may be outside the training. On such
paths reduced histories had errors of up to 200 %, which convergence does not show; their imbalance
does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np

from hhr_dolfinx.declared import Floats
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.trained import TrainedRange, announce, check_outside

PACE = 1.5
"""Factor by which a rate may lie outside the trained ones."""
FACTOR = 3.0
"""Factor over the largest imbalance or depth of the training histories.

On the inelastic pellet 20 paths inside the training stayed below 1.2 times its imbalance, and 40
outside, with errors of displacements from 2 %, were above 3.
"""
SMALL_IN_TRAINING = 1e-3
"""Fraction of the forces, or of the gaps and motions, that counts as small for any training: if a
model reproduces its training to round-off, any other answer would exceed the factor.
"""
EXPLAINED_STRESS = 0.01
"""Fraction of the stress of a step that counts as explained by modes for any training, for the same
reason.
"""
UNACCEPTABLE = 0.05
"""Estimate from which on a step is reported, unless the training had nearly as much: an
unacceptable error.
"""
POOR_FACTOR = 1.2
"""Factor over the estimates of the training that is always allowed, even above UNACCEPTABLE: such a
model is poor, and the build warns of it.
"""
STRESS_ROUND_OFF = 1e-4
"""Fraction of the largest training stress below which the stress of a step counts as zero: steps
are solved to 1e-5 of forces, and a body that moves freely before it touches has a stress of 3e-5 by
the round-off of its modes.
"""
SMALL_STEP = 1e-2
"""Fraction of the largest training stress below which a training step sets no limit: its relative
error is large, and as a limit it would accept all errors at full loads.
"""


def share_of_stress(misfit: float, stress: float) -> float:
    """Misfit over stress: 0 for zero stress, infinite for non-finite stress.

    Args:
        misfit: norm of the part that training does not explain.
        stress: norm of the stress.
    """
    if not math.isfinite(stress):
        return math.inf
    return misfit / stress if stress > 0 else 0.0


class Signs(NamedTuple):
    """Error indicators of a reduced model at a solved step."""

    #: norm of the residual forces on the reduced domain before projection, in the unit of force
    imbalance: float
    size: float  #: norm of the contributions to these forces
    #: largest violation of a gap on the whole contact surface, in the unit of length, 0 if none
    depth: float
    #: description of the imbalance, for messages
    what: str = "the forces on the reduced domain are out of balance"
    misfit: float = (
        0.0  # norm of the stress that no mode of the training explains, where laws are evaluated
    )
    stress: float = 0.0  #: norm of this stress

    @property
    def estimate(self) -> float:
        """Misfit over stress, the estimate of :meth:`Answer.estimate` for inelastic bodies.

        0 without stress.
        """
        return share_of_stress(self.misfit, self.stress)


class Known(NamedTuple):
    """Error indicators of a reduced model on its training histories, for each step of each."""

    signs: Sequence[Sequence[Signs]]
    onsets: Sequence[
        Sequence[Signs]
    ]  #: along small parts of their first steps, which a path with finer steps passes
    length: float  #: largest gap or relative motion of contact surfaces in training


@dataclass(frozen=True)
class TrainedPaths:
    """Training range of a reduced model of histories."""

    parameters: TrainedRange  #: range of values along all training paths
    #: smallest and largest rate of each parameter in any step, per second; of laws without rates
    #: only directions matter: the change while the parameter that changes most, relative to its
    #: trained range, goes through its whole range
    slowest: Annotated[Floats, "P"]
    fastest: Annotated[Floats, "P"]
    steps: tuple[float, float]  #: shortest and longest training step, in seconds, for information
    rated: bool  #: True if any law depends on rates
    #: largest imbalance of the training histories, solved by the reduced model, in the unit of
    #: force
    imbalance: float
    depth: float  #: largest depth of the training histories, or the value that counts as zero
    stress: float  #: largest norm of the stress in the training histories
    estimate: float  #: largest estimate at any of their steps, or the value that counts as zero
    #: smallest norm of the stress after a first step; below it a history is in its first step
    begun: float
    onset: float  #: largest estimate of small parts of these first steps, at least ``estimate``

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.parameters.names

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults of rates, steps and indicators."""
        if not (self.slowest <= self.fastest).all() or not 0 < self.steps[0] <= self.steps[1]:
            yield (
                f"trained steps take {self.steps} s, or rates end below their start, which is no "
                "range"
            )
        signs = self.imbalance, self.depth, self.stress, self.estimate, self.begun, self.onset
        if min(signs) < 0:
            yield (
                "the imbalance, the depth, the stress and the estimates of the training are "
                f"{signs}"
            )

    @classmethod
    def of(
        cls,
        paths: Sequence[Sequence[tuple[float, np.ndarray]]],
        space: ParameterSpace,
        known: Known,
        rated: bool = True,
    ) -> TrainedPaths:
        """Training range from paths and indicators.

        Args:
            paths: training paths, the start first.
            space: box of the parameters.
            known: indicators along them.
            rated: True if some law depends on rates.
        """
        times = [np.array([time for time, _ in path]) for path in paths]
        points = [np.array([point for _, point in path]) for path in paths]
        steps = np.concatenate([np.diff(values) for values in times])
        changes = np.concatenate([np.diff(values, axis=0) for values in points])
        range_ = TrainedRange.of(np.concatenate(points), space)
        rates = (
            changes / steps[:, None]
            if rated
            else np.array([_direction(values, range_) for values in changes])
        )
        all_signs = [sign for signs in known.signs for sign in signs]
        largest = max(sign.stress for sign in all_signs)
        # steps of little stress are left out, as in the check: their relative misfit has no meaning
        estimate = max(
            [
                EXPLAINED_STRESS,
                *(sign.estimate for sign in all_signs if sign.stress > SMALL_STEP * largest),
            ]
        )
        begun = [
            next((sign.stress for sign in signs if sign.stress > STRESS_ROUND_OFF * largest), 0.0)
            for signs in known.signs
        ]
        return cls(
            range_,
            rates.min(axis=0),
            rates.max(axis=0),
            (float(steps.min()), float(steps.max())),
            rated,
            max(
                SMALL_IN_TRAINING * max(sign.size for sign in all_signs),
                max(sign.imbalance for sign in all_signs),
            ),
            max(SMALL_IN_TRAINING * known.length, max(sign.depth for sign in all_signs)),
            largest,
            estimate,
            min(begun),
            max(
                [
                    estimate,
                    *(
                        s.estimate
                        for signs in known.onsets
                        for s in signs
                        if s.stress > STRESS_ROUND_OFF * largest
                    ),
                ]
            ),
        )

    @cached_property
    def _paces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Smallest and largest rates allowed, and changes of the size of round-off, (P,) each."""
        low = np.where(self.slowest > 0, self.slowest / PACE, self.slowest * PACE)
        high = np.where(self.fastest > 0, self.fastest * PACE, self.fastest / PACE)
        return low, high, 1e-9 * (self.parameters.upper - self.parameters.lower)

    def complaint(self, step: float, before: np.ndarray, after: np.ndarray) -> str:
        """Report of a step outside the training; empty if it is inside.

        Args:
            step: duration of the step in seconds.
            before: parameter at its start, (P,).
            after: parameter at its end, (P,).
        """
        outside_box = self.parameters.complaint(before) or self.parameters.complaint(after)
        if outside_box:
            return outside_box
        change = after - before
        low, high, noise = self._paces
        if self.rated:
            rate = change / step
            noise = noise / step
            per = "second"
        else:
            rate = _direction(change, self.parameters)
            per = "whole range of what changes most"
            if not rate.any():  # no change of the load, and no plastic strain
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
        """Largest estimate in training, for a history with a given largest norm of the stress so
        far.
        """
        return self.estimate if largest >= self.begun else self.onset

    def allowed(self, largest: float) -> float:
        """Largest estimate allowed for a step of such a history."""
        shown = self.shown(largest)
        return max(min(FACTOR * shown, UNACCEPTABLE), POOR_FACTOR * shown)


def _direction(change: np.ndarray, trained: TrainedRange) -> np.ndarray:
    """A change over its largest fraction of a trained range, (P,); 0 for round-off."""
    largest = float(np.abs(change / (trained.upper - trained.lower)).max())
    return change / largest if largest > 1e-9 else np.zeros_like(change)


class Watch:
    """Check of the steps of one history against a training range, if any.

    Each kind of report is given once.
    """

    def __init__(self, trained: TrainedPaths | None, outside: str):
        check_outside(outside)
        self._trained = trained
        self._outside = outside
        self._said: set[str] = set()
        self._largest = 0.0

    def before(
        self, number: int, start: float, end: float, here: np.ndarray, there: np.ndarray
    ) -> None:
        """Check a step before its solution.

        Args:
            number: number of the step in the path, from 1 on.
            start: time at its start in seconds.
            end: time at its end in seconds.
            here: parameter at its start, (P,).
            there: parameter at its end, (P,).
        """
        if self._trained is not None:
            complaint = self._trained.complaint(end - start, here, there)
            if complaint:
                self._say(
                    "path",
                    f"step {number}, to t = {end:g} s, is outside what was trained: {complaint}",
                )

    def after(self, number: int, time: float, signs: Signs) -> None:
        """Check a solved step by its indicators.

        Args:
            number: number of the step in the path, from 1 on.
            time: its time in seconds.
            signs: its error indicators.
        """
        trained = self._trained
        if trained is None:
            return
        prefix = f"step {number}, to t = {time:g} s: "
        if not signs.imbalance <= FACTOR * trained.imbalance:
            self._say(
                "imbalance",
                (
                    f"{prefix}{signs.what} by {signs.imbalance:.2g}, in training by "
                    f"{trained.imbalance:.2g} at most"
                ),
            )
        if not signs.depth <= FACTOR * trained.depth:
            self._say(
                "depth",
                f"{prefix}the bodies overlap by {signs.depth:.2g} where the reduced domain does "
                f"not look, in training by {trained.depth:.2g} at most",
            )
        self._largest = max(self._largest, signs.stress)
        # relative to the stress of this step: residual stress after a small load is small, and may
        # be totally wrong
        if (
            not signs.stress <= STRESS_ROUND_OFF * trained.stress
            and not signs.estimate <= trained.allowed(self._largest)
        ):
            self._say(
                "misfit",
                f"{prefix}the stress differs from combinations of trained ones by "
                f"{signs.estimate:.2g} of its size, in training by "
                f"{trained.shown(self._largest):.2g} at most",
            )

    def _say(self, kind: str, message: str):
        if kind not in self._said:
            self._said.add(kind)
            announce(
                f"{message}. Errors may be large: train on such a path, or take the full model",
                self._outside,
            )
