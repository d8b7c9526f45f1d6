"""Training points that share coordinates: drawn from a regular grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.parameters import ParameterSpace, check_count_and_seed, is_whole
from hhr_dolfinx.sampling import Sobol


@dataclass(frozen=True)
class Lattice:
    """Points drawn uniformly from a regular grid.

    They share coordinates, and many lie on the sides of the box.

    Many answers then have the field of a load in common and differ by contact only. On the pellet
    150 answers on a grid span a space that takes 500 answers elsewhere, so that greedy trainings
    choose from such points.

    Attributes:
        count: number of points, or all of the grid if it has fewer.
        levels: number of values of each parameter, including the bounds: one number for all, or one
            for each.
        seed: seed of the drawing.
    """

    count: int
    levels: int | tuple[int, ...] = 20
    seed: int = 1

    def __post_init__(self) -> None:
        levels = self.levels if isinstance(self.levels, tuple) else (self.levels,)
        call = f"Lattice({self.count!r}, levels={self.levels!r}, seed={self.seed!r})"
        check_count_and_seed(call, self.count, self.seed)
        if not all(is_whole(level, 2) for level in levels):
            raise ParameterError(f"{call}: each of the levels must be an integer from 2")

    def points(self, space: ParameterSpace) -> np.ndarray:
        """The points, (n, P), with the corners of the box first if all of them fit.

        Args:
            space: the box.

        Raises:
            ParameterError: if ``levels`` has another number of parameters.
        """
        size = len(space.names)
        levels = np.array(self.levels if isinstance(self.levels, tuple) else (self.levels,) * size)
        if levels.size != size:
            raise ParameterError(
                f"levels = {self.levels} of a Lattice must be one for each of {space.names}"
            )
        levels_of_points = self._places(levels)
        lower, upper = np.array([space.lower, space.upper], dtype=float)
        return lower + levels_of_points / (levels - 1) * (upper - lower)

    def _places(self, levels: np.ndarray) -> np.ndarray:
        if np.prod(levels.astype(float)) <= self.count:
            return np.indices(tuple(levels)).reshape(levels.size, -1).T
        corners = np.zeros((0, levels.size), dtype=np.int64)
        if 2.0**levels.size <= self.count / 4:
            corners = np.indices((2,) * levels.size).reshape(levels.size, -1).T * (levels - 1)
        # more than needed, since some fall on the same point of the grid
        unit = Sobol(4 * self.count, seed=self.seed)._unit(levels.size)
        drawn = np.vstack([corners, np.minimum((unit * levels).astype(np.int64), levels - 1)])
        _, first = np.unique(drawn, axis=0, return_index=True)
        return drawn[np.sort(first)][: self.count]
