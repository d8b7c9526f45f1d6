"""Anderson's acceleration of a fixed-point iteration."""

from __future__ import annotations

import numpy as np

MEMORY = 6
"""Differences of iterates that are kept."""


class Anderson:
    """Anderson's acceleration of a fixed-point iteration x -> x + change(x) (D. G. Anderson, J. ACM 12, 1965)."""

    def __init__(self):
        self._points: list[np.ndarray] = []
        self._changes: list[np.ndarray] = []

    def __call__(self, x: np.ndarray, change: np.ndarray) -> np.ndarray:
        """The next iterate."""
        self._points.append(x)
        self._changes.append(change)
        self._points, self._changes = self._points[-MEMORY - 1 :], self._changes[-MEMORY - 1 :]
        if len(self._points) == 1:
            return x + change
        steps = np.diff(np.stack(self._points, axis=1), axis=1)
        differences = np.diff(np.stack(self._changes, axis=1), axis=1)
        weights, *_ = np.linalg.lstsq(differences, change, rcond=1e-10)
        return x + change - (steps + differences) @ weights
