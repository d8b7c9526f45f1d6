"""What is left of the primal unknown once it is eliminated: one contact problem at one point, and what makes it.

With K factored, the primal unknown of thesis (1.21) or (1.61) is

    primal(mu, lambda) = free_primal - primal_per_force lambda,

and the contact conditions become slack = free_slack + S lambda with S = B K^-1 B^T, thesis (5.23). An elimination makes
that :class:`CondensedContact` of a point: constant, by factors of K~(mu), interpolated, on another shape, or beside the
rigid motions of bodies that contact alone holds. The active set, gradients and models see nothing else of a scene.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Status, active_set
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.linear.dense import Factor, Factorise, LapackLU, dense_factors, solve_columns
from hhr_dolfinx.models.answer import Answer, Fields, SeveralAnswers, found_as, one_by_one
from hhr_dolfinx.plain import CODE, Rebuilt

if TYPE_CHECKING:
    from hhr_dolfinx.contact.floating import FloatingEqualities
    from hhr_dolfinx.models.condensed import CondensedModel, KnownStatuses
    from hhr_dolfinx.models.regions import CriticalRegions


@dataclass(frozen=True, eq=False)
class Floating:
    """Rigid motions of bodies that nothing but contact holds, beside what elimination leaves (r motions).

    Attributes:
        equalities: on S with the motions.
        driving: loads along the motions, (r,).
        modes: the motions as primal unknowns, (n, r).
        drift: maps forces and unknown to d(residual along the motions)/dμ while both stay, (r, P).
    """

    equalities: FloatingEqualities
    driving: np.ndarray
    modes: np.ndarray
    drift: Callable[[np.ndarray, np.ndarray], np.ndarray]


class CondensedContact(ABC):
    """The contact problem at one parameter without its primal unknown (n unknowns, m conditions).

    Attributes:
        schur: S, (m, m).
        free_slack: slack without contact forces, (m,).
        symmetric: whether S is.
        floating: rigid motions that contact alone holds; None without any.
    """

    if TYPE_CHECKING:  # to be read: some are fields, others are made when somebody asks

        @property
        def schur(self) -> np.ndarray: ...  # noqa: D102

        @property
        def free_slack(self) -> np.ndarray: ...  # noqa: D102

        @property
        def symmetric(self) -> bool: ...  # noqa: D102

        @property
        def floating(self) -> Floating | None: ...  # noqa: D102

    else:
        symmetric = False
        floating = None

    @abstractmethod
    def unknown(self, forces: np.ndarray) -> np.ndarray:
        """The primal unknown under contact forces, (n,)."""

    @abstractmethod
    def at_fixed_forces(self, forces: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives along the parameters, while the forces stay, of the slack, (m, P), and the unknown, (n, P)."""

    @abstractmethod
    def pushed(self, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T times forces, (m, k): (n, k)."""

    @cached_property
    def equalities(self) -> SchurEqualities:
        """Equality problems on S."""
        if self.symmetric:
            return SchurEqualities.symmetric(self.schur)
        return SchurEqualities.of(self.schur, LapackLU)


class Elimination(ABC):
    """Makes the contact problem of any parameter; what can be shared between parameters is its own business."""

    @abstractmethod
    def __call__(self, point: np.ndarray) -> CondensedContact:
        """Eliminate at a point, (P,).

        Raises:
            NotSolvableError, ParameterError: where there is nothing to factor, or surfaces slide off what is known.
        """

    def tabulated(self, known: KnownStatuses) -> CriticalRegions | None:
        """Answers of known statuses as maps of the parameters; None where these are not affine."""
        return None

    def answers(self, model: CondensedModel, points: np.ndarray, raise_on_failure: bool) -> SeveralAnswers:
        """Answers of a model to checked points, (n, P)."""
        return one_by_one(model, points, {"raise_on_failure": raise_on_failure, "outside": "ignore"})


def answer_of(
    contact: CondensedContact,
    point: np.ndarray,
    start: np.ndarray | None,
    pairs: Pairs | None,
    fields: Fields,
    *,
    gradient: bool = False,
) -> Answer:
    """Solve the contact problem that is left, from some statuses or, with None, those of the free slack."""
    free_slack = contact.free_slack
    start = free_slack < 0 if start is None else start
    if contact.floating is not None:
        return _floating_answer(contact, contact.floating, point, start, pairs, fields, gradient)
    found = active_set(contact.equalities, free_slack, start, pairs=pairs)
    answer = found_as(found, point, contact.unknown(found.forces), fields)
    return differentiated(contact, answer) if gradient else answer


def differentiated(contact: CondensedContact, answer: Answer) -> Answer:
    """An answer with its derivatives on its statuses; as it is where it is none."""
    if not answer.converged:
        return answer
    from hhr_dolfinx.models.gradient import gradient_of

    forces = answer.multipliers
    slack = contact.free_slack + contact.schur @ forces
    fixed = contact.at_fixed_forces(forces, answer.unknown)
    return answer._replace(
        gradient=gradient_of(contact.equalities, answer.active, forces, slack, fixed, contact.pushed)
    )


def _floating_answer(
    contact: CondensedContact,
    floating: Floating,
    point: np.ndarray,
    start: np.ndarray,
    pairs: Pairs | None,
    fields: Fields,
    gradient: bool,
) -> Answer:
    """The same where rigid motions are unknowns too."""
    from hhr_dolfinx.contact.floating import floating_set

    equalities, free_slack = floating.equalities, contact.free_slack
    found, motions = floating_set(equalities, free_slack, floating.driving, start, pairs)
    unknown = contact.unknown(found.forces) + floating.modes @ motions
    answer = found_as(found, point, unknown, fields)
    if not gradient or found.status is not Status.CONVERGED:
        return answer
    from hhr_dolfinx.models.gradient import Gradient, grazing

    slack = free_slack + contact.schur @ found.forces - equalities.taken @ motions
    of_slack, of_unknown = contact.at_fixed_forces(found.forces, unknown)
    driven = floating.drift(found.forces, unknown)
    changes, opened, moved = equalities.several(found.active, of_slack, driven)
    of_unknown = of_unknown - contact.pushed(changes) + floating.modes @ moved
    return answer._replace(gradient=Gradient(of_unknown, changes, grazing(found.active, found.forces, slack), opened))


@dataclass(frozen=True)
class Responses:
    """All that is left of the primal unknown once it is eliminated (n unknowns, m conditions, 1 + T terms).

    Attributes:
        free_primal: primal unknown without contact forces, (n, 1 + T).
        primal_per_force: K^-1 B^T, (n, m).
        free_slack: slack without contact forces, (m, 1 + T).
        schur: S = B K^-1 B^T, (m, m).
    """

    free_primal: Annotated[Floats, "unknowns", "terms"]
    primal_per_force: Annotated[Floats, "unknowns", "m"]
    free_slack: Annotated[Floats, "m", "terms"]
    schur: Annotated[Floats, "m", "m"]

    @classmethod
    def eliminate(
        cls, factor: Factor, loads: np.ndarray, gaps: np.ndarray, test: np.ndarray, trial: np.ndarray
    ) -> Responses:
        """Eliminate the unknown of K x + test^T lambda = loads θ, trial x <= gaps θ.

        Args:
            factor: of K.
            loads: (n, 1 + T).
            gaps: (m, 1 + T).
            test: rows by which forces act, (m, n).
            trial: rows by which gaps are read, (m, n).
        """
        free, per_force = solve_columns(factor, loads), solve_columns(factor, test.T)
        return cls(free, per_force, gaps - trial @ free, trial @ per_force)


@dataclass(frozen=True, eq=False)
class ConstantElimination(Rebuilt, Elimination):
    """Eliminates once for all where the stiffness is constant.

    Attributes:
        responses: what the primal unknown leaves behind.
        amplitudes: θ as a function of the parameters.
        factorise: what factors a dense block; a file does not keep it.
    """

    responses: Responses
    amplitudes: Amplitudes
    factorise: Factorise = field(default=dense_factors, metadata=CODE)

    def __post_init__(self) -> None:
        """One array for slack and unknown, so that one product makes both; ``responses`` look into it."""
        given = self.responses
        response = np.asfortranarray(np.vstack([given.free_slack, given.free_primal]))
        free_slack, free_primal = np.split(response, [len(given.schur)])
        per_force = np.ascontiguousarray(given.primal_per_force)
        object.__setattr__(self, "response", response)
        object.__setattr__(self, "responses", Responses(free_primal, per_force, free_slack, given.schur))

    response: np.ndarray = field(init=False, repr=False)
    """Free slack and, behind it, free primal unknown, (m + n, 1 + T)."""

    @classmethod
    def from_file(cls, **parts: Any) -> ConstantElimination:
        """What a file keeps; LAPACK factors, so that answers are the same on all machines."""
        return cls(**parts, factorise=LapackLU)

    @cached_property
    def equalities(self) -> SchurEqualities:
        """Equality problems on S, for all points."""
        return SchurEqualities.of(self.responses.schur, self.factorise)

    def __call__(self, point: np.ndarray) -> ConstantContact:
        """What is left at a point, (P,)."""
        return ConstantContact(self, point, self.response @ self.amplitudes(point))

    def tabulated(self, known: KnownStatuses) -> CriticalRegions | None:
        """The critical regions of known statuses; else factors of these are made ready."""
        from hhr_dolfinx.models.regions import CriticalRegions

        return CriticalRegions.of(self, known)

    def answers(self, model: CondensedModel, points: np.ndarray, raise_on_failure: bool) -> SeveralAnswers:
        """Those with the same statuses share factors."""
        from hhr_dolfinx.models.many import condensed_answers

        return condensed_answers(model, self, points, raise_on_failure=raise_on_failure, outside="ignore")


@dataclass(frozen=True, eq=False)
class ConstantContact(CondensedContact):
    """What is left at a point where the stiffness is constant.

    Attributes:
        owner: what eliminated.
        point: the parameter, (P,).
        response: free slack and free unknown there, (m + n,).
    """

    owner: ConstantElimination
    point: np.ndarray
    response: np.ndarray

    @property
    def schur(self) -> np.ndarray:
        """S, (m, m)."""
        return self.owner.responses.schur

    @property
    def free_slack(self) -> np.ndarray:
        """Slack without contact forces, (m,)."""
        return self.response[: len(self.schur)]

    @property
    def equalities(self) -> Any:
        """Those of all points."""
        return self.owner.equalities

    def unknown(self, forces: np.ndarray) -> np.ndarray:
        """The primal unknown under contact forces, (n,)."""
        return self.response[len(self.schur) :] - self.owner.responses.primal_per_force @ forces

    def pushed(self, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T times forces, (m, k)."""
        return self.owner.responses.primal_per_force @ forces

    def at_fixed_forces(self, forces: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of slack and unknown, which loads and gaps alone have."""
        acting, slopes = self.owner.amplitudes.slopes_at(self.point)
        changes = self.owner.response[:, acting] @ slopes
        return changes[: len(self.schur)], changes[len(self.schur) :]
