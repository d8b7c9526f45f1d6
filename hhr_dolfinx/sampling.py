"""Samplings of training points: quasi-random sequences of SciPy that fill a box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.parameters import ParameterSpace, check_count_and_seed


@dataclass(frozen=True)
class _Sampling:
    """Base class of samplings.

    Attributes:
        count: number of points.
        seed: seed of the scrambling; the same points for the same seed.
        corners: add the corners of the box before the ``count`` points; up to ten parameters.
    """

    count: int
    seed: int = 1
    corners: bool = False

    def __post_init__(self) -> None:
        kind = type(self).__name__
        check_count_and_seed(f"{kind}({self.count!r}, seed={self.seed!r})", self.count, self.seed)
        if not isinstance(self.corners, bool):
            raise ParameterError(f"corners = {self.corners!r} of {kind} must be True or False")

    def points(self, space: ParameterSpace) -> np.ndarray:
        """The corners, if requested, followed by the points, (count, P).

        Raises:
            ParameterError: for the corners of a box of more than ten parameters.
        """
        lower, upper = np.array([space.lower, space.upper], dtype=float)
        samples = lower + self._unit(len(space.names)) * (upper - lower)
        if not self.corners:
            return samples
        if len(space.names) > 10:
            raise ParameterError(
                f"a box of {len(space.names)} parameters has too many corners: leave them out"
            )
        bits = np.indices((2,) * len(space.names)).reshape(len(space.names), -1).T
        return np.vstack([np.where(bits, upper, lower), samples])

    def _unit(self, dimension: int) -> np.ndarray:
        raise NotImplementedError


@dataclass(frozen=True)
class Sobol(_Sampling):
    """Scrambled Sobol points: uniform in all projections; counts that are powers of 2 are best.

    Example:
        >>> box = hhr.ParameterSpace(("push", "pull"), lower=(0.0, 0.0), upper=(10.0, 4.0))
        >>> points = hhr.Sobol(8, seed=1, corners=True).points(box)
        >>> points.shape, points[3]
        ((12, 2), array([10.,  4.]))
    """

    def _unit(self, dimension: int) -> np.ndarray:
        from scipy.stats import qmc

        # SciPy warns of counts that are no power of 2, which lose balance; training does not need
        # it
        balanced = 1 << (self.count - 1).bit_length()
        return qmc.Sobol(dimension, seed=self.seed).random(balanced)[: self.count]


@dataclass(frozen=True)
class LatinHypercube(_Sampling):
    """A Latin hypercube: each single parameter is uniform, for any count."""

    def _unit(self, dimension: int) -> np.ndarray:
        from scipy.stats import qmc

        return qmc.LatinHypercube(dimension, seed=self.seed).random(self.count)
