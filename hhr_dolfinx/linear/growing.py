"""Matrices that gain columns."""

from __future__ import annotations

import numpy as np


class GrowingColumns:
    """A matrix in Fortran order, (N, k), that gains columns at its end without a copy each time."""

    def __init__(self, matrix: np.ndarray) -> None:
        self._held = np.asfortranarray(matrix)
        self._count = matrix.shape[1]

    @property
    def all(self) -> np.ndarray:
        """The matrix."""
        return self._held[:, : self._count]

    def append(self, column: np.ndarray) -> None:
        """Append a column, (N,)."""
        if self._count == self._held.shape[1]:
            larger = np.empty((len(self._held), 2 * self._count + 16), order="F")
            larger[:, : self._count] = self._held
            self._held = larger
        self._held[:, self._count] = column
        self._count += 1
