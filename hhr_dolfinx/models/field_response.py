"""Response of the displacement to loads and contact forces for a constant stiffness."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.declared import Floats


@dataclass(frozen=True, eq=False)
class FieldResponse:
    """Coordinates of the displacement in columns C, and X_F θ (N dofs, 1 + T terms, m conditions, c columns).

    Forces solve the contact problem on S from the statuses of an answer. For bodies that only contact holds the
    last columns of the displacement are their rigid motions R, whose coordinates are the amplitudes of these.

    Attributes:
        loaded: K^-1 of some loads, (N, k), which span all loads.
        loading: coefficients of each term in these loads, so that X_F is the product of both, sparse, (k, 1 + T).
        onto: G, (c, m); None if the columns are those of K^-1 B^T.
    """

    loaded: Annotated[Floats, "N", "loads"]
    loading: Annotated[csc_matrix, "loads", "terms"]
    onto: Annotated[Floats, "kept columns", "N_lambda"] | None = None

    def coordinates(self, there: Any, forces: np.ndarray) -> np.ndarray:
        """Coordinates in the columns, (c,), for an answer with returned forces, (m,).

        Args:
            there: the estimate at the answer.
            forces: returned ones, (m,).
        """
        exact = there.exact(forces[None])
        return np.concatenate([self._pressed(exact.forces[0]), exact.motions[0]])

    def changes(
        self, there: Any, forces: np.ndarray, of_forces: Callable[[], np.ndarray], of_theta: np.ndarray
    ) -> np.ndarray:
        """Derivatives of these coordinates, (c, P), see :meth:`DifferenceThere.exact_changes`."""
        pressing, motions = there.exact_changes(forces, of_forces, of_theta)
        return np.vstack([self._pressed(pressing), motions])

    def _pressed(self, forces: np.ndarray) -> np.ndarray:
        """Coordinates of forces, (m, ...): (c, ...)."""
        return -forces if self.onto is None else -(self.onto @ forces)
