"""Where to train: points of a box that fill it, by scipy's quasi-random sequences."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.parameters import ParameterSpace, is_whole


@dataclass(frozen=True)
class _Sampling:
    """What a sampling is told.

    Attributes:
        count: number of points.
        seed: of the scrambling; the same points for the same seed.
        corners: whether the corners of the box come first, beside ``count``; up to ten parameters.
    """

    count: int
    seed: int = 1
    corners: bool = False

    def __post_init__(self) -> None:
        if not is_whole(self.count, 1) or not is_whole(self.seed, 0):
            raise ParameterError(
                f"{type(self).__name__}({self.count!r}, seed={self.seed!r}): the count must be a positive integer, the "
                "seed one that is not negative"
            )

    def points(self, space: ParameterSpace) -> np.ndarray:
        """The points, (count, P), behind the corners if these were asked for.

        Raises:
            ParameterError: for the corners of a box of more than ten parameters.
        """
        lower, upper = np.array([space.lower, space.upper], dtype=float)
        inside = lower + self._unit(len(space.names)) * (upper - lower)
        if not self.corners:
            return inside
        if len(space.names) > 10:
            raise ParameterError(f"a box of {len(space.names)} parameters has too many corners: leave them out")
        bits = np.indices((2,) * len(space.names)).reshape(len(space.names), -1).T
        return np.vstack([np.where(bits, upper, lower), inside])

    def _unit(self, dimension: int) -> np.ndarray:
        raise NotImplementedError


@dataclass(frozen=True)
class Sobol(_Sampling):
    """Scrambled Sobol points: even in all projections; counts that are powers of 2 are best."""

    def _unit(self, dimension: int) -> np.ndarray:
        from scipy.stats import qmc

        with warnings.catch_warnings():
            # other counts lose balance, which no training needs
            warnings.filterwarnings("ignore", "The balance properties", UserWarning)
            return qmc.Sobol(dimension, seed=self.seed).random(self.count)


@dataclass(frozen=True)
class LatinHypercube(_Sampling):
    """A Latin hypercube: each parameter is even by itself, whatever the count."""

    def _unit(self, dimension: int) -> np.ndarray:
        from scipy.stats import qmc

        return qmc.LatinHypercube(dimension, seed=self.seed).random(self.count)
