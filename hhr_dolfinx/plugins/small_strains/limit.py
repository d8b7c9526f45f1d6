"""Range of parameters of a model in which its strains are small enough to mean something."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.small_strains.cells import STRAIN_LIMIT
from hhr_dolfinx.trained import TrainedRange, announce

BISECTIONS = 10
"""Bisections of the part of the box that is kept."""
Box = np.ndarray
"""Lower and upper ends of parameters, (2, P)."""


@dataclass(frozen=True)
class StrainRange(TrainedRange):
    """Range beyond which strains are larger than :data:`STRAIN_LIMIT`.

    A model refuses there as outside its training range.
    """

    def check(self, point: np.ndarray, outside: str) -> None:
        """Check a point against the range; see :func:`~hhr_dolfinx.trained.announce`.

        Args:
            point: parameters, (P,).
            outside: policy for a point outside, see :func:`~hhr_dolfinx.trained.announce`.
        """
        if self.complaint(point):
            announce(
                f"strains or rotations above {STRAIN_LIMIT:g}, which mean nothing in a "
                f"theory of small "
                f"ones, come beyond {self.described()}: lower the load, or take a program for "
                "large ones",
                outside,
            )

    def described(self) -> str:
        """The range in words."""
        ends = zip(self.names, self.lower, self.upper, strict=True)
        return ", ".join(f"{name} = {low:g} to {high:g}" for name, low, high in ends)


def narrowed(
    space: ParameterSpace, worst: Callable[[Box], float], given: TrainedRange | None
) -> StrainRange | None:
    """Largest part of the box with strains of at most :data:`STRAIN_LIMIT` in its corners.

    None without one.

    One parameter is narrowed, or all are alike, towards an end, the middle or zero, by the smallest
    strains.

    Args:
        space: the box.
        worst: largest strain in corners of a box.
        given: range of the model before, which stays a limit.
    """
    box = np.array([space.lower, space.upper], dtype=float)
    choices = [np.eye(len(space.names), dtype=bool)[k] for k in range(len(space.names))]
    candidates = []
    for choice in (*choices, np.ones(len(space.names), dtype=bool)):
        ends = (*box, box.mean(axis=0), np.clip(0.0, *box))
        target = min((np.where(choice, end, box) for end in ends), key=worst)
        if worst(target) > STRAIN_LIMIT:
            continue
        within = 0.0
        beyond = 1.0
        for _ in range(BISECTIONS):
            middle = (within + beyond) / 2
            if worst(target + middle * (box - target)) > STRAIN_LIMIT:
                beyond = middle
            else:
                within = middle
        candidates.append(
            (within ** int(choice.sum()), (target + within * (box - target)).tolist())
        )
    if not candidates:
        return None
    lower, upper = np.array(max(candidates)[1])
    if given is not None:
        lower = np.maximum(lower, given.lower)
        upper = np.minimum(upper, given.upper)
    return StrainRange(tuple(space.names), np.minimum(lower, upper), upper)
