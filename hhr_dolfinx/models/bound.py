"""Norms of errors, and the interface of bounds, which plug-ins provide."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.models.estimates import Estimates

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from hhr_dolfinx.models.answer import Answer, ModelFields
    from hhr_dolfinx.models.functionals.functional import Functional, Functionals
    from hhr_dolfinx.models.gradient import Gradient

BOUND_ROUND_OFF = 1e-10
"""Part of an answer that is round-off of the exact one too: smaller errors are unknown."""


@dataclass(frozen=True)
class ForceScale:
    """Scales of contact forces (m conditions)."""

    #: tributary area of each condition, which turns a nodal force into a pressure, (m,); a
    #: condition without an area has zero pressure; for answers on different shapes (n, m)
    areas: np.ndarray
    #: S norm, Euclidean norm and peak pressure that relative errors use at least to divide by, (3,)
    least: np.ndarray

    @cached_property
    def per_area(self) -> np.ndarray:
        """One over the areas, (m,)."""
        return np.divide(1.0, self.areas, out=np.zeros(self.areas.shape), where=self.areas > 0)

    def peak(self, forces: np.ndarray) -> np.ndarray:
        """Largest pressure of non-negative forces, (..., m): (...,)."""
        return np.maximum.reduce(forces * self.per_area, axis=-1, initial=0.0)


def estimates_of(kind: str, errors: np.ndarray, least: np.ndarray) -> Estimates:
    """Estimates of n answers.

    A relative error is infinite if the exact answer may be zero and the error is not.

    Args:
        kind: kind of the estimates, see :class:`~hhr_dolfinx.models.estimates.Estimate`.
        errors: errors of displacement and forces in energy, of forces in the Euclidean norm, and of
            pressures, (4, n).
        least: denominators of the relative errors, in the same order, (4, n).
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(errors == 0, 0.0, errors / np.maximum(least, 0.0))
    return Estimates(kind, *errors[:2], *shares[:2], *errors[2:], *shares[2:])


def lengths(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Square roots of products of rows, (..., m): (...,).

    Args:
        first: rows, (..., m).
        second: rows, (..., m), such as a Gram matrix times the first ones.
    """
    # products of matrices have a fifth of the overhead of sums by indices
    return np.sqrt(np.maximum((first[..., None, :] @ second[..., None])[..., 0, 0], 0.0))


Thetas: TypeAlias = "Theta | np.ndarray | csr_matrix"
"""θ of n answers, (n, 1 + T), sparse or not; or one Theta for one answer."""


def driven(matrix: np.ndarray, theta: Thetas) -> np.ndarray:
    """Columns of a matrix, (k, 1 + T), times θ of each answer, (n, 1 + T) or one Theta: (n, k).

    Args:
        matrix: columns of each term, (k, 1 + T).
        theta: θ of each answer, (n, 1 + T), or one Theta.
    """
    return (matrix @ theta)[None] if isinstance(theta, Theta) else np.asarray(theta @ matrix.T)


Outside = TypeVar("Outside")
"""Data that complete forces, see :meth:`Bound.prepared`."""
Reader = TypeVar("Reader", contravariant=True)
Fields = TypeVar("Fields", bound="ModelFields", contravariant=True)
There = TypeVar("There", bound="BoundThere", contravariant=True)


class BoundThere(Protocol[Reader]):
    """A bound at the parameters of n answers (m conditions, ell modes)."""

    def slack(self, forces: np.ndarray) -> np.ndarray:
        """Slack of the fields in equilibrium with forces, (n, m)."""

    def completed(self, own: np.ndarray, outside: Reader) -> np.ndarray:
        """Forces on all conditions, (n, m): those outside close their gaps.

        Args:
            own: forces on the conditions inside, (n, k).
            outside: result of :meth:`Bound.prepared`.
        """

    def force_changes(
        self, forces: np.ndarray, outside: Reader, gradient: Gradient, changes: np.ndarray
    ) -> np.ndarray:
        """Derivatives of the completed forces of one answer at constant statuses, (m, P).

        Args:
            forces: completed forces, (m,).
            outside: result of :meth:`Bound.prepared`.
            gradient: derivatives of the forces inside.
            changes: derivatives of θ, (1 + T, P).
        """

    def of(
        self, unknown: np.ndarray, forces: np.ndarray, slack: Callable[[], np.ndarray]
    ) -> Estimates:
        """Errors of fields and forces of n answers.

        Args:
            unknown: γ, (n, ell).
            forces: returned forces, (n, m).
            slack: returns the slack of the fields, (n, m).
        """


class Bound(Protocol[Outside]):
    """Bound of the errors of a model's answers."""

    @property
    def together(self) -> int:
        """Number of answers per evaluation, so that intermediate arrays stay small."""

    @property
    def kind(self) -> str:
        """See :class:`Estimate`."""

    @property
    def schur(self) -> np.ndarray:
        """S, in the middle of the box if it varies, (m, m)."""

    @property
    def free_slack(self) -> np.ndarray:
        """Slack without contact forces, as terms of θ, (m, 1 + T).

        In the middle of the box if S varies, (m,).
        """

    def prepared(self, inside: np.ndarray) -> Outside:
        """Data that complete forces from those of the conditions ``inside``."""

    def at(self, points: np.ndarray, theta: Thetas) -> BoundThere[Outside]:
        """Bound at the parameters of n answers.

        Args:
            points: parameters, (n, P).
            theta: θ of each, (n, 1 + T), sparse or not, or one Theta for one answer.
        """


class Response(Protocol[Fields]):
    """Displacement as a function of loads and contact forces.

    A bound that knows the exact forces uses it.
    """

    @property
    def loaded(self) -> np.ndarray:
        """Displacement under some loads, (N, k), which span all loads."""

    @property
    def loading(self) -> np.ndarray:
        """Coefficients of each term in these loads, (k, 1 + T)."""

    def within(self, fields: Fields) -> ResponseWithin:
        """The response in the columns of a model."""


class ResponseWithin(Protocol[There]):
    """Coordinates of forces in the columns of a displacement, (c,)."""

    def coordinates(self, answer: Answer, there: There, forces: np.ndarray) -> np.ndarray:
        """Coordinates of an answer, (c,).

        Args:
            answer: the answer.
            there: the bound at its point, see :class:`BoundThere`.
            forces: forces on all conditions, (m,).
        """

    def changes(
        self,
        there: There,
        forces: np.ndarray,
        of_forces: Callable[[], np.ndarray],
        of_theta: np.ndarray,
    ) -> np.ndarray:
        """Derivatives of the coordinates, (c, P).

        Args:
            there: the bound at the point, see :class:`BoundThere`.
            forces: forces on all conditions, (m,).
            of_forces: returns the derivatives of the forces, (m, P).
            of_theta: derivatives of θ, (1 + T, P).
        """


class OutputBound(Protocol[Fields]):
    """Errors of outputs, for a bound that knows the exact forces."""

    def knows(self, item: Functional) -> bool:
        """True if an output has an estimate."""

    def least_of(self, functionals: Functionals, name: str) -> float:
        """Smallest denominator of the relative error of an output.

        Args:
            functionals: outputs of the scene.
            name: name of the output.
        """

    def fits(self, functionals: Functionals) -> bool:
        """True if these can be estimates of some outputs."""

    def errors(
        self, fields: Fields, answer: Answer, forces: np.ndarray, exact: np.ndarray
    ) -> dict[str, float]:
        """Errors of the outputs of an answer, by name.

        Args:
            fields: fields of the model.
            answer: the answer.
            forces: its forces on all conditions, (m,).
            exact: exact forces, (m,).
        """


class Bounding(NamedTuple):
    """A bound of errors, and the displacement to which it applies."""

    bound: Bound | None
    columns: np.ndarray  #: columns of the displacement, (own, c)
    response: Response | None = None  #: maps forces to their coordinates; None if these are gamma
    unbounded: str = ""  #: reason for a missing bound; empty with a bound
