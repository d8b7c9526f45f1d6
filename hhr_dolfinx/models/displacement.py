"""Displacements that are linear in few coordinates, u = C x + X θ, in any kind of model.

A model provides C and X, its coordinates x at an answer, and the derivatives of forces and
coordinates along the parameters. Outputs and their derivatives follow from these in one place.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer import Answer

if TYPE_CHECKING:
    from hhr_dolfinx.amplitudes import Amplitudes


class LinearDisplacement(ABC):
    """Fields whose displacement is linear in coordinates."""

    #: stress of a displacement, (N,), at a parameter, (P,); None without a mesh
    stress_of: Callable[[np.ndarray, np.ndarray], np.ndarray] | None
    amplitudes: Amplitudes  #: θ as a function of the parameters
    functionals: Any  #: outputs of the scene; None if it has none

    @abstractmethod
    def displacement(self, answer: Answer) -> np.ndarray:
        """Displacement, lift included, (N,)."""

    @abstractmethod
    def _per_coordinate(self, rows: csr_matrix) -> csr_matrix | np.ndarray:
        """Rows of the outputs, (K, N), times C: (K, c)."""

    @abstractmethod
    def _terms(self, rows: csr_matrix) -> np.ndarray:
        """Rows of the outputs times X: (K, 1 + T)."""

    @abstractmethod
    def _coordinates(self, answer: Answer) -> np.ndarray:
        """x at an answer, (c,)."""

    @abstractmethod
    def _coordinate_changes(self, answer: Answer, changes: np.ndarray) -> np.ndarray:
        """Derivatives of x, (c, P)."""

    def _all_force_changes(self, answer: Answer, changes: np.ndarray) -> np.ndarray:
        """Derivatives of all contact forces, (N_lambda, P).

        ``changes`` are the derivatives of θ, (1 + T, P).
        """
        assert answer.gradient is not None
        return answer.gradient.multipliers

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress at the midpoint of each cell, Kelvin's notation.

        Raises:
            NotOfferedError: by a copy, or a model from a file.
        """
        if self.stress_of is None:
            raise NotOfferedError(
                "a model that was copied or read from a file has no mesh, and stress needs one: "
                "full.stress_of(displacement, mu)"
            )
        return self.stress_of(self.displacement(answer), answer.parameter)

    @cached_property
    def _measures(self) -> tuple[csr_matrix | np.ndarray, np.ndarray]:
        rows = self.functionals.rows
        return self._per_coordinate(rows), self._terms(rows)

    def measured(self, answer: Answer, theta: np.ndarray) -> np.ndarray:
        """Rows of the outputs times the displacement, (K,), for amplitudes (1 + T,).

        Args:
            answer: the answer.
            theta: amplitudes at its parameter, (1 + T,).
        """
        per_coordinate, per_term = self._measures
        return per_coordinate @ self._coordinates(answer) + per_term @ theta

    def measured_changes(
        self, answer: Answer, changes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all contact forces, (N_lambda, P), and of these products, (K, P).

        If no output depends on forces, their derivatives are left out.

        Args:
            answer: the answer, with a gradient.
            changes: derivatives of the amplitudes, (1 + T, P).
        """
        per_coordinate, per_term = self._measures
        forces = (
            self._all_force_changes(answer, changes)
            if self.functionals.uses_forces
            else np.zeros((0, 0))
        )
        if not per_coordinate.shape[0]:
            return forces, np.zeros((0, answer.parameter.size))
        return forces, per_coordinate @ self._coordinate_changes(
            answer, changes
        ) + per_term @ changes

    def coordinates(self, answer: Answer, theta: np.ndarray) -> np.ndarray:
        """x and the amplitudes of imposed displacements.

        Rows of outputs act on these if shapes are parameters.

        Args:
            answer: the answer.
            theta: amplitudes at its parameter, (1 + T,).
        """
        return np.concatenate([self._coordinates(answer), theta[self.functionals.lifted]])

    def coordinate_changes(
        self, answer: Answer, changes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all forces and of these coordinates.

        Args:
            answer: the answer, with a gradient.
            changes: derivatives of the amplitudes, (1 + T, P).
        """
        forces = self._all_force_changes(answer, changes)
        if not any(functional.count for functional in self.functionals.items):
            return forces, np.zeros((0, answer.parameter.size))
        return forces, np.vstack(
            [self._coordinate_changes(answer, changes), changes[self.functionals.lifted]]
        )


def dense(matrix: csr_matrix | np.ndarray) -> np.ndarray:
    """Dense array of a product with few rows."""
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
