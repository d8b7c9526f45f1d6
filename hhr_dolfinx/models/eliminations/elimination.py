"""Elimination of the primal unknown: the contact problem at one point without it.

With K factored, the primal unknown of thesis (1.21) or (1.61) is

    primal(mu, lambda) = free_primal - primal_per_force lambda,

and the contact conditions become slack = free_slack + S lambda with S = B K^-1 B^T, thesis (5.23).
Eliminations return this :class:`CondensedContact` for a point. K may be constant, factored at each
point, interpolated or of another shape; the kernel of K stays an unknown. Active set, gradients and
models need nothing else.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, ClassVar, Protocol

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, active_set
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.linear.dense import Factor, LapackLU, solve_columns
from hhr_dolfinx.models.answer import (
    Answer,
    Model,
    ModelFields,
    SeveralAnswers,
    found_as,
    one_by_one,
)

if TYPE_CHECKING:
    from hhr_dolfinx.contact.kernel import CondensedKernel
    from hhr_dolfinx.models.starts import KnownStatuses


class HasEqualities(Protocol):
    """A value with equality problems on S."""

    @property
    def equalities(self) -> SchurEqualities:
        """Equality problems on S."""


@dataclass(eq=False)  # one for each query: a frozen one takes a microsecond more to make
class CondensedContact:
    """The contact problem at one parameter without its primal unknown.

    It has n unknowns and m conditions.
    """

    schur: np.ndarray  #: S, (m, m)
    free_slack: np.ndarray  #: slack without contact forces, (m,)
    free: (
        np.ndarray
    )  #: the unknown without contact forces, (n,); empty if fields are computed on request
    #: response of the unknown to contact forces, K^-1 B^T forces: (m,) or (m, k) to (n,) or (n, k)
    response_to_forces: Callable[[np.ndarray], np.ndarray]
    #: maps forces and unknown to derivatives along the parameters at fixed forces: of the slack,
    #: (m, P), and of the unknown, (n, P)
    at_fixed_forces: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
    symmetric: bool = False
    #: motions of bodies that contact alone holds, which stay unknowns; None without any
    kernel: CondensedKernel | None = None
    #: stiffness that shares its equality problems on S with other points; None creates them on
    #: demand
    factored: HasEqualities | None = None

    def unknown(self, forces: np.ndarray) -> np.ndarray:
        """The primal unknown under contact forces, (n,)."""
        return self.free - self.response_to_forces(forces)

    @cached_property
    def equalities(self) -> SchurEqualities:
        """Equality problems on S."""
        if self.factored is not None:
            return self.factored.equalities
        if self.symmetric:
            return SchurEqualities.symmetric(self.schur)
        return SchurEqualities.of(self.schur, LapackLU)


AnswerTable = Callable[[np.ndarray, ModelFields], Answer | None]
"""Answer to a point, (P,), with these fields; None if the table has none."""


class Elimination(ABC):
    """Elimination of the primal unknown at any parameter.

    Subclasses share work between parameters.
    """

    shares_factors: ClassVar[bool] = (
        False  # whether points with the same statuses share all factors
    )
    keeps_kernel: ClassVar[bool] = (
        False  # whether motions of bodies that contact alone holds stay unknowns
    )

    def without_primal(self) -> Elimination:
        """Elimination whose answers have no primal unknown; the same if it cannot be left out."""
        return self

    @abstractmethod
    def __call__(self, point: np.ndarray) -> CondensedContact:
        """Eliminate at a point, (P,).

        Raises:
            NotSolvableError, ParameterError: if nothing can be factored, or surfaces slide off the
                known ones.
        """

    def along_path(self) -> Callable[[np.ndarray], CondensedContact]:
        """Elimination at the points of one path; it may keep what neighbours share."""
        return self.__call__

    def table_of(self, known: KnownStatuses) -> AnswerTable | None:
        """Answers of training statuses as maps of the parameters; None if these are not affine."""
        return None

    def answers(self, model: Model, points: np.ndarray, raise_on_failure: bool) -> SeveralAnswers:
        """Answers of a model to checked points, (n, P).

        Args:
            model: a model of this elimination.
            points: checked parameters, (n, P).
            raise_on_failure: raise at the first point without a solution.
        """
        return one_by_one(model, points, raise_on_failure, "ignore")


def answer_of(
    contact: CondensedContact,
    point: np.ndarray,
    start: np.ndarray | None,
    pairs: Pairs | None,
    fields: ModelFields,
    *,
    gradient: bool = False,
) -> Answer:
    """Solve the condensed contact problem.

    Args:
        contact: contact problem of the point.
        point: parameter, (P,).
        start: statuses from which the search starts, (m,) bool; None for the signs of the free
            slack.
        pairs: conditions by contact pair; None takes all for one pair.
        fields: fields of the model.
        gradient: compute the derivatives along the parameters.
    """
    free_slack = contact.free_slack
    start = free_slack < 0 if start is None else start
    if contact.kernel is not None:
        return contact.kernel.answer(contact, point, start, pairs, fields, gradient)
    statuses = active_set(contact.equalities, free_slack, start, pairs=pairs)
    answer = found_as(statuses, point, contact.unknown(statuses.forces), fields)
    return differentiated(contact, answer) if gradient else answer


def differentiated(contact: CondensedContact, answer: Answer) -> Answer:
    """An answer with its derivatives at its statuses; unchanged if it has no solution.

    Slack(mu, lambda) = 0 is differentiated on the active set: one more right-hand side for each
    parameter.

    Args:
        contact: contact problem of the point.
        answer: its answer.
    """
    if not answer.converged:
        return answer
    from hhr_dolfinx.models.gradient import Gradient, grazing

    active = answer.active
    forces = answer.multipliers
    slack = contact.free_slack + contact.schur @ forces
    of_slack, of_unknown = contact.at_fixed_forces(forces, answer.unknown)
    changes, opened = contact.equalities.several(active, of_slack)
    gradient = Gradient(
        of_unknown - contact.response_to_forces(changes),
        changes,
        grazing(active, forces, slack),
        opened,
    )
    return answer._replace(gradient=gradient)


@dataclass(frozen=True)
class Responses:
    """Responses of the eliminated unknown (n unknowns, m conditions, 1 + T terms)."""

    free_primal: Annotated[
        Floats, "unknowns", "terms"
    ]  #: primal unknown without contact forces, (n, 1 + T)
    primal_per_force: Annotated[Floats, "unknowns", "m"]  #: K^-1 B^T, (n, m)
    free_slack: Annotated[Floats, "m", "terms"]  #: slack without contact forces, (m, 1 + T)
    schur: Annotated[Floats, "m", "m"]  #: S = B K^-1 B^T, (m, m)

    @classmethod
    def eliminate(
        cls,
        factor: Factor,
        loads: np.ndarray,
        gaps: np.ndarray,
        test: np.ndarray,
        trial: np.ndarray,
    ) -> Responses:
        """Eliminate the unknown of K x + test^T lambda = loads θ, trial x <= gaps θ.

        Args:
            factor: factor of K.
            loads: loads of each term, (n, 1 + T).
            gaps: gaps of each term, (m, 1 + T).
            test: rows B~1, (m, n).
            trial: rows B~2, (m, n).
        """
        free = solve_columns(factor, loads)
        per_force = solve_columns(factor, test.T)
        return cls(free, per_force, gaps - trial @ free, trial @ per_force)
