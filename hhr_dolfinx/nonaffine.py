"""Amplitudes that are not affine in the parameters: the one that is built in, and the check of a user's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.parameters import ParameterSpace, is_number, is_whole


@dataclass(frozen=True)
class Coverage:
    """Amplitudes of a pressure on the part of a straight line up to a parameter, exact for linear elements.

    A line of n nodes at increasing positions has n - 1 columns for whole edges from its start (column e is the
    load on all edges before edge e) and n columns for its nodes. With the end of the pressure in edge e, at
    the fraction s of its length L, the load is column e, plus L (s - s^2/2) on its first and L s^2/2 on its
    second node.

    Attributes:
        positions: coordinates of the nodes along the line, increasing, (n,).
        extent: index of the parameter up to which the pressure acts.
        constant: amplitude at mu = 0.
        slopes: slopes of the amplitude, (P,).

    Raises:
        SceneError: for no line that goes up, or an extent that is no parameter.
    """

    positions: np.ndarray
    extent: int
    constant: float
    slopes: np.ndarray

    def __post_init__(self) -> None:
        """Refuse what would be looked up elsewhere."""
        line, slopes = self.positions, self.slopes
        if line.ndim != 1 or line.size < 2 or not (line[:-1] < line[1:]).all():
            raise SceneError("positions of a partial pressure must be at least two and increase")
        if slopes.ndim != 1 or not 0 <= self.extent < slopes.size:
            raise SceneError(
                f"a partial pressure extends up to parameter {self.extent}, and has slopes along {slopes.size} of them"
            )

    @property
    def count(self) -> int:
        """Number of columns."""
        return 2 * len(self.positions) - 1

    def __call__(self, point: np.ndarray) -> tuple[list[int], list[float]]:
        """Numbers and amplitudes of the three columns that act at a point."""
        positions, edges = self.positions, len(self.positions) - 1
        edge = min(max(int(positions.searchsorted(point[self.extent])) - 1, 0), edges - 1)
        length = positions[edge + 1] - positions[edge]
        s = min(max((point[self.extent] - positions[edge]) / length, 0.0), 1.0)
        amplitude = self.constant + self.slopes @ point
        weights = [amplitude, amplitude * length * (s - s * s / 2), amplitude * length * s * s / 2]
        return [edge, edges + edge, edges + edge + 1], weights


def checked_count(amplitude: Any, space: ParameterSpace, owner: object) -> int:
    """Number of columns of an amplitude that is not affine, tried in the middle of the box.

    Args:
        amplitude: a :class:`NonAffine`, or what is given for one.
        space: the box of the parameters.
        owner: whose amplitude it is, for messages.

    Raises:
        SceneError: for what is none.
    """
    if isinstance(amplitude, type) or not callable(amplitude) or not hasattr(amplitude, "__dataclass_fields__"):
        raise SceneError(
            f"the amplitude {amplitude!r} of {owner!r} must be an Amplitude, or a frozen dataclass with a count that "
            "returns (columns, values) for a point"
        )
    count: Any = getattr(amplitude, "count", None)
    if not is_whole(count, 1):
        raise SceneError(f"the count {count!r} of {amplitude!r} of {owner!r} must be its number of columns")
    try:
        columns, values = amplitude(np.mean([space.lower, space.upper], axis=0))
        fits = len(columns) == len(values) == len(set(columns)) and all(is_number(value) for value in values)
    except (TypeError, ValueError):
        fits, columns = False, ()
    if not fits or not all(is_whole(column, 0) and column < count for column in columns):
        raise SceneError(
            f"{amplitude!r} of {owner!r} must return columns, each once and below its count {count}, and as many values"
        )
    return count
