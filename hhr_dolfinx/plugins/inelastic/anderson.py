"""Anderson's acceleration of a fixed-point iteration."""

from __future__ import annotations

import numpy as np

MEMORY = 6
"""Differences of iterates that are kept."""


class Anderson:
    """Anderson's acceleration of a fixed-point iteration x -> x + change(x) (D. G. Anderson, J. ACM 12, 1965)."""

    def __init__(self) -> None:
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        self._steps: list[np.ndarray] = []
        self._differences: list[np.ndarray] = []

    def __call__(self, x: np.ndarray, change: np.ndarray) -> np.ndarray:
        """The next iterate."""
        last = self._last
        self._last = (x, change)
        following = x + change
        if last is None:
            return following
        self._steps = [*self._steps, x - last[0]][-MEMORY:]
        self._differences = [*self._differences, change - last[1]][-MEMORY:]
        weights, *_ = np.linalg.lstsq(np.stack(self._differences, axis=1), change, rcond=1e-10)
        # one by one: on large meshes copies of all of them take longer than the least squares
        for weight, step, difference in zip(weights, self._steps, self._differences, strict=True):
            following -= weight * (step + difference)
        return following
