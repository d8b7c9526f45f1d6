"""Displacements that are linear in few coordinates, u = C x + X θ, in any kind of model.

A model provides the columns C and X, its coordinates x at an answer, and the derivatives of forces and coordinates
along the parameters. Outputs and their derivatives follow from these in one place.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import issparse

from hhr_dolfinx.models.answer import Answer


class LinearDisplacement(ABC):
    """Fields whose displacement is linear in coordinates, see :class:`models.functionals.functional.MeasuredFields`.

    Attributes:
        functionals: outputs of the scene; None if it has none.
    """

    functionals: Any

    @abstractmethod
    def _columns(self) -> Any:
        """C, (N, c); None if the coordinates are the displacement without its lift."""

    @abstractmethod
    def _terms(self, rows: object) -> np.ndarray:
        """Rows of the outputs, (K, N), times X: (K, 1 + T)."""

    @abstractmethod
    def _coordinates(self, answer: Answer) -> np.ndarray:
        """x at an answer, (c,)."""

    @abstractmethod
    def _all_force_changes(self, answer: Answer, changes: np.ndarray) -> np.ndarray:
        """Derivatives of all contact forces, (N_lambda, P), for derivatives of θ, ``changes``, (1 + T, P)."""

    @abstractmethod
    def _coordinate_changes(self, answer: Answer, changes: np.ndarray) -> np.ndarray:
        """Derivatives of x, (c, P)."""

    @cached_property
    def _measures(self) -> tuple[Any, np.ndarray]:
        """Rows of the outputs times C and times X."""
        rows = self.functionals.rows
        columns = self._columns()
        return rows if columns is None else rows @ columns, self._terms(rows)

    def measured(self, answer: Answer, theta: np.ndarray) -> np.ndarray:
        """Rows of the outputs times the displacement, (K,)."""
        per_column, per_term = self._measures
        return per_column @ self._coordinates(answer) + per_term @ theta

    def measured_changes(self, answer: Answer, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all forces and of these products: :class:`~models.functionals.functional.MeasuredFields`."""
        per_column, per_term = self._measures
        forces = self._all_force_changes(answer, changes) if self.functionals.uses_forces else np.zeros((0, 0))
        if not per_column.shape[0]:
            return forces, np.zeros((0, answer.parameter.size))
        return forces, per_column @ self._coordinate_changes(answer, changes) + per_term @ changes

    def coordinates(self, answer: Answer, theta: np.ndarray) -> np.ndarray:
        """x and amplitudes of imposed displacements, on which rows of outputs act where shapes are parameters."""
        return np.concatenate([self._coordinates(answer), theta[self.functionals.lifted]])

    def coordinate_changes(self, answer: Answer, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all forces and of these coordinates."""
        forces = self._all_force_changes(answer, changes)
        if not any(item.count for item in self.functionals.items):
            return forces, np.zeros((0, answer.parameter.size))
        return forces, np.vstack([self._coordinate_changes(answer, changes), changes[self.functionals.lifted]])


def dense(matrix: Any) -> np.ndarray:
    """Dense array of a product with few rows."""
    return matrix.toarray() if issparse(matrix) else np.asarray(matrix)
