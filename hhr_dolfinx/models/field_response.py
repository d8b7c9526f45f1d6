"""What loads and contact forces make of the displacement, where the stiffness is constant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.declared import Floats


@dataclass(frozen=True, eq=False)
class FieldResponse:
    """Coordinates of the displacement in columns C, X_F θ besides (N dofs, 1 + T terms, m conditions, c columns).

    Forces are those of the contact problem on S from the statuses of an answer. Where contact alone holds bodies the
    last columns of the displacement are their rigid motions R, whose coordinates are how far these are moved.

    Attributes:
        loaded: K^-1 of some loads, (N, k), of which all are combinations.
        loading: how much of each of these loads a term is, so that X_F is the product of both, sparse, (k, 1 + T).
        onto: G, (c, m); None where the columns are those of K^-1 B^T.
    """

    loaded: Annotated[Floats, "N", "loads"]
    loading: Annotated[csc_matrix, "loads", "terms"]
    onto: Annotated[Floats, "kept columns", "N_lambda"] | None = None

    def coordinates(self, there: Any, forces: np.ndarray) -> np.ndarray:
        """Coordinates in the columns, (c,), of an answer whose forces are handed out, (m,).

        Args:
            there: the estimate at the answer.
            forces: see above.
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
