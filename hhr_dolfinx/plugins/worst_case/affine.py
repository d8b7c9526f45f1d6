"""A condensed contact problem as numbers: all that a proof over the box needs of a model.

With parameters t in the unit cube, forces and slacks solve

    s = f(t) + S λ - R α,  λ >= 0,  s >= 0,  λ^T s = 0,  R^T λ = d(t),  f(t) = f_0 + G t,

where α are the motions of bodies that contact alone holds, if there are any. Each candidate for the
value of an output is affine in t, λ and α. A largest pressure is the largest of several candidates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np

from hhr_dolfinx.errors import NotOfferedError, ParameterError
from hhr_dolfinx.models.functionals.kinds import Largest, Linear

if TYPE_CHECKING:
    from hhr_dolfinx.amplitudes import Amplitudes
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.models.condensed import CondensedModel
    from hhr_dolfinx.models.eliminations.elimination import CondensedContact, Responses
    from hhr_dolfinx.models.functionals.functional import Functional
    from hhr_dolfinx.models.model import AnsweringModel
    from hhr_dolfinx.parameters import ParameterSpace

HELD = 1e-6
"""Least singular value of the motions of closed conditions over the largest, above which these hold
all bodies: bounds by an elimination of the motions lose as many digits.
"""
ASYMMETRY = 1e-9
"""Largest difference of S and S^T over the largest entry of S, round-off of the elimination: the
proof needs the energy of a symmetric S.
"""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Affine functions of parameters, forces and motions; the output is the largest of them.

    Attributes:
        constant: values without parameters and forces, (K,).
        slopes: along the parameters of the unit cube, (K, P).
        weights: of forces and motions, (K, m + r).
    """

    constant: np.ndarray
    slopes: np.ndarray
    weights: np.ndarray

    def values(self, t: np.ndarray, solution: np.ndarray) -> np.ndarray:
        """Values at a point, (K,).

        Args:
            t: parameters in the unit cube, (P,).
            solution: contact forces and motions there, (m + r,).
        """
        return self.constant + self.slopes @ t + self.weights @ solution

    def negative(self) -> Candidates:
        """The same with the other sign."""
        return Candidates(-self.constant, -self.slopes, -self.weights)


@dataclass(frozen=True, eq=False)
class AffineContact:
    """A contact problem over the unit cube of its parameters.

    Attributes:
        schur: S, symmetric, (m, m).
        free: f_0, (m,).
        slopes: G, (m, P).
        space: the box of the parameters, which the unit cube stands for.
        motions: R, in units that make the largest entry of each column 1, (m, r).
        driving: d_0 and its slopes, (r, 1 + P).
    """

    schur: np.ndarray
    free: np.ndarray
    slopes: np.ndarray
    space: ParameterSpace
    motions: np.ndarray
    driving: np.ndarray

    @cached_property
    def width(self) -> np.ndarray:
        """Lengths of the box, (P,)."""
        return np.asarray(self.space.upper, dtype=float) - np.asarray(self.space.lower)

    @cached_property
    def whole(self) -> np.ndarray:
        """[[S, -R], [R^T, 0]] of forces and motions, (m + r, m + r)."""
        count = self.motions.shape[1]
        rest = np.zeros((count, count))
        return np.block([[self.schur, -self.motions], [self.motions.T, rest]])

    @cached_property
    def terms(self) -> np.ndarray:
        """[f_0, G] and -[d_0, D] by its rows, (m + r, 1 + P)."""
        return np.vstack([np.column_stack([self.free, self.slopes]), -self.driving])

    def held_by(self, closed: np.ndarray) -> bool:
        """Whether conditions that are closed hold all bodies.

        Args:
            closed: their numbers, (c,).
        """
        values = np.linalg.svd(self.motions[closed], compute_uv=False)
        count = self.motions.shape[1]
        return len(values) == count and bool((values > HELD * values.max(initial=0.0)).all())

    def point(self, t: np.ndarray) -> np.ndarray:
        """Parameters in the box at a point of the unit cube, (P,)."""
        return np.asarray(self.space.lower) + self.width * t

    def free_slack(self, t: np.ndarray) -> np.ndarray:
        """Slack without contact forces, (m,), at a point of the unit cube, (P,)."""
        return self.free + self.slopes @ t


class Eliminated(Protocol):
    """Elimination of one stiffness."""

    responses: Responses
    amplitudes: Amplitudes

    def __call__(self, point: np.ndarray) -> CondensedContact:
        """The contact problem at a point, (P,)."""


def elimination_of(model: AnsweringModel) -> Eliminated:
    """The elimination of a model that a proof can be made for.

    Raises:
        NotOfferedError: for another one, with the reason.
    """
    reason = _refused(model)
    if reason:
        raise NotOfferedError(f"the worst case is proven for {reason}")
    return cast("Eliminated", cast("CondensedModel", model).eliminated)


def _refused(model: AnsweringModel) -> str:
    """What a proof needs and the model lacks; empty if it has all."""
    eliminated: Any = getattr(model, "eliminated", None)
    law = getattr(model, "law", None)
    if law is not None and law.path_dependent:
        return (
            "answers that depend on the parameters alone; friction and other laws with memory "
            "depend on the path"
        )
    if law is None or not hasattr(eliminated, "responses"):
        return (
            f"condensed models of one stiffness, hhr.condense(scene), and not for this "
            f"{type(model).__name__}"
        )
    if law.plugin:
        return "pairs without a law of their own"
    if eliminated.amplitudes.nonaffine:
        return (
            "loads and gaps by amplitudes that are affine in the parameters, and not by formulas: "
            "write hhr.Amplitude(constant, slopes)"
        )
    return ""


def contact_of(model: AnsweringModel) -> AffineContact:
    """The contact problem of a condensed model over its box.

    Raises:
        NotOfferedError: for a model that no proof can be made for.
    """
    eliminated = elimination_of(model)
    schur = eliminated.responses.schur
    if np.abs(schur - schur.T).max() > ASYMMETRY * np.abs(schur).max():
        raise NotOfferedError(
            "the worst case is proven for a symmetric S; this one is that of a reduced model whose "
            "rows and columns differ: condense the scene instead"
        )
    space = model.parameters
    lower = np.asarray(space.lower, dtype=float)
    start = eliminated(lower)
    ends = [eliminated(lower + way) for way in np.diag(np.asarray(space.upper) - lower)]
    slopes = [end.free_slack - start.free_slack for end in ends]
    motions, units = _motions_of(start, len(schur))
    driving = np.zeros((motions.shape[1], 1 + len(lower)))
    if start.kernel is not None:
        loads = [there.kernel.driving for there in (start, *ends) if there.kernel is not None]
        driving = np.column_stack([loads[0], *(load - loads[0] for load in loads[1:])])
        driving /= units[:, None]
    symmetric = 0.5 * (schur + schur.T)
    return AffineContact(
        symmetric, start.free_slack, np.column_stack(slopes), space, motions / units, driving
    )


def _motions_of(there: CondensedContact, conditions: int) -> tuple[np.ndarray, np.ndarray]:
    """B R of a contact problem, (m, r), and the largest entry of each column, (r,)."""
    motions = np.zeros((conditions, 0))
    if there.kernel is not None:
        motions = there.kernel.equalities.contact_of_motions
    return motions, np.abs(motions).max(axis=0, initial=0.0)


def candidates_of(model: AnsweringModel, name: str, contact: AffineContact) -> Candidates:
    """The output of a name as the largest of affine functions.

    Args:
        model: the condensed model.
        name: name of the output.
        contact: its contact problem.

    Raises:
        ParameterError: for a name that no output has.
        NotOfferedError: for an output that is no largest of affine functions.
    """
    functionals = model.fields.functionals
    items = () if functionals is None else functionals.at(contact.space.middle).items
    names = [item.name for item in items]
    if name not in names:
        raise ParameterError(
            f"there is no output {name!r}: there are {', '.join(names) or 'none in the scene'}"
        )
    number = names.index(name)
    item = items[number]
    if isinstance(item, Largest):
        weights = np.zeros((len(item.conditions), sum(contact.motions.shape)))
        weights[np.arange(len(item.conditions)), item.conditions] = 1 / item.areas
        count = len(weights)
        return Candidates(np.zeros(count), np.zeros((count, len(contact.width))), weights)
    if not isinstance(item, Linear):
        raise NotOfferedError(
            f"output '{name}' is no largest of affine functions of forces and displacements, so "
            "that its worst case is not proven"
        )
    return _linear(model, item, functionals.at(contact.space.middle).places[number], contact)


def _linear(
    model: AnsweringModel, item: Functional, rows: slice, contact: AffineContact
) -> Candidates:
    """A linear output: its affine function, read at forces of one and parameters at the ends."""
    item = cast("Linear", item)
    eliminated = elimination_of(model)
    m = len(contact.free)
    any_answer = model.solve(contact.space.lower, outside="ignore")

    def value(t: np.ndarray, solution: np.ndarray) -> float:
        point = contact.point(t)
        theta = eliminated.amplitudes.dense(point)
        forces = solution[:m]
        unknown = _unknown(eliminated(point), solution)
        answer = any_answer._replace(parameter=point, unknown=unknown, multipliers=forces)
        measured = model.fields.measured(answer, theta)[rows]
        own = forces[item.conditions] @ item.weights if item.conditions.size else 0.0
        return float(measured @ item.along + theta[item.terms] @ item.coefficients + own)

    rest = np.zeros(len(contact.width))
    nothing = np.zeros(sum(contact.motions.shape))
    constant = value(rest, nothing)
    slopes = np.array([value(t, nothing) - constant for t in np.eye(rest.size)])
    # forces and motions of the size of the problem: what a force of one adds may be lost in the
    # digits of the constant
    size = float(np.abs(contact.terms[:m]).sum(axis=1).max()) or 1.0
    steps = np.append(size / np.diag(contact.schur), np.full(nothing.size - m, size))
    weights = np.array([value(rest, one) - constant for one in np.diag(steps)]) / steps
    return Candidates(np.array([constant]), slopes[None], weights[None])


def _unknown(there: CondensedContact, solution: np.ndarray) -> np.ndarray:
    """The primal unknown of forces and motions, (n,)."""
    m = len(there.free_slack)
    unknown = there.unknown(solution[:m])
    if there.kernel is None:
        return unknown
    _, units = _motions_of(there, m)
    return unknown + there.kernel.modes @ (solution[m:] / units)


def solution_of(answer: Answer, eliminated: Eliminated, contact: AffineContact) -> np.ndarray:
    """Forces and motions of an answer, (m + r,), the latter in the units of the contact problem.

    Args:
        answer: the answer.
        eliminated: elimination of its model.
        contact: its contact problem.
    """
    if not contact.motions.size:
        return answer.multipliers
    there = eliminated(answer.parameter)
    assert there.kernel is not None
    rest = answer.unknown - there.unknown(answer.multipliers)
    motions = np.linalg.lstsq(there.kernel.modes, rest, rcond=None)[0]
    _, units = _motions_of(there, len(there.free_slack))
    return np.concatenate([answer.multipliers, motions * units])
