"""The displacement as a function of loads and contact forces for a constant stiffness."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, cast

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.declared import Floats

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.models.reconstruct import Reconstruction
    from hhr_dolfinx.plugins.exact_errors.difference import DifferenceThere, ExactDifference


@dataclass(frozen=True, eq=False)
class FieldResponse:
    """Coordinates of the displacement in columns C, and X_F θ.

    N dofs, 1 + T terms, m conditions, c columns.

    Forces solve the contact problem on S from the statuses of an answer. For bodies that only
    contact holds the last columns of the displacement are their rigid motions R, whose coordinates
    are the amplitudes of these.
    """

    loaded: Annotated[Floats, "N", "loads"]  #: K^-1 of some loads, (N, k), which span all loads
    #: coefficients of each term in these loads, so that X_F is the product of both, sparse, (k, 1 +
    #: T)
    loading: Annotated[csc_matrix, "loads", "terms"]
    onto: Annotated[Floats, "kept columns", "N_lambda"] | None = (
        None  # G, (c, m); None for the columns of K^-1 B^T
    )

    def within(self, fields: Reconstruction) -> FieldResponseWithin:
        """See :class:`~hhr_dolfinx.models.bound.Response`."""
        return FieldResponseWithin(self, fields)

    def pressed(self, forces: np.ndarray) -> np.ndarray:
        """Coordinates of forces, (m, ...): (c, ...)."""
        return -forces if self.onto is None else -(self.onto @ forces)


@dataclass(frozen=True, eq=False)
class FieldResponseWithin:
    """See :class:`~hhr_dolfinx.models.bound.ResponseWithin`."""

    response: FieldResponse
    fields: Reconstruction  #: has the columns

    def coordinates(self, answer: Answer, there: DifferenceThere, forces: np.ndarray) -> np.ndarray:
        """Coordinates of the exact forces, with the undetermined motion of the answer.

        Args:
            answer: the answer of the model.
            there: the difference at its parameter.
            forces: its forces on all conditions, (m,).

        Returns:
            The coordinates, (c,).
        """
        exact = there.exact(forces[None])
        coordinates_of_exact = np.concatenate(
            [self.response.pressed(exact.forces[0]), exact.motions[0]]
        )
        if answer.undetermined is None:
            return coordinates_of_exact
        # the first modes of gamma and the last columns of the displacement are the rigid motions,
        # orthonormal
        along_columns, along_loads = self._along_motions
        r = len(along_columns)
        ways = answer.undetermined[:r]
        theta = self.fields.amplitudes(answer.parameter)
        motions = along_columns @ coordinates_of_exact + along_loads @ (
            self.response.loading @ theta
        )
        coordinates_of_exact[-r:] += ways @ (ways.T @ (answer.unknown[:r] - motions))
        return coordinates_of_exact

    def changes(
        self,
        there: DifferenceThere,
        forces: np.ndarray,
        of_forces: Callable[[], np.ndarray],
        of_theta: np.ndarray,
    ) -> np.ndarray:
        """See :meth:`DifferenceThere.exact_changes`.

        Args:
            there: the difference at the parameter.
            forces: the returned forces, (m,).
            of_forces: returns the derivatives of these, (m, P).
            of_theta: derivatives of θ, (1 + T, P).
        """
        pressing, motions = there.exact_changes(forces, of_forces, of_theta)
        return np.vstack([self.response.pressed(pressing), motions])

    @cached_property
    def _along_motions(self) -> tuple[np.ndarray, np.ndarray]:
        """Components of columns and loads along the rigid motions, (r, c) and (r, k)."""
        bound = cast("ExactDifference", self.fields.bound)
        motions = self.fields.basis[:, -bound.rigid_motions :].T
        return motions @ self.fields.basis, motions @ self.response.loaded
