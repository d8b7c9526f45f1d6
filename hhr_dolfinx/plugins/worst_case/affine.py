"""A condensed contact problem as numbers: all that a proof over the box needs of a model.

With parameters t in the unit cube, forces and slacks solve

    s = f(t) + S λ,  λ >= 0,  s >= 0,  λ^T s = 0,  f(t) = f_0 + G t,

and each candidate for the value of an output is affine in t and λ. A largest pressure is the
largest of several candidates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, cast

import numpy as np

from hhr_dolfinx.errors import NotOfferedError, ParameterError
from hhr_dolfinx.models.eliminations.constant import ConstantElimination
from hhr_dolfinx.models.functionals.kinds import Largest, Linear

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed import CondensedModel
    from hhr_dolfinx.models.functionals.functional import Functional
    from hhr_dolfinx.models.model import AnsweringModel
    from hhr_dolfinx.parameters import ParameterSpace

ASYMMETRY = 1e-9
"""Largest difference of S and S^T over the largest entry of S, round-off of the elimination: the
proof needs the energy of a symmetric S.
"""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Affine functions of parameters and forces; the output is the largest of them.

    Attributes:
        constant: values without parameters and forces, (K,).
        slopes: along the parameters of the unit cube, (K, P).
        weights: of the forces, (K, m).
        labels: what each is, for the report, (K,).
    """

    constant: np.ndarray
    slopes: np.ndarray
    weights: np.ndarray
    labels: tuple[str, ...]

    def values(self, t: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Values at a point, (K,).

        Args:
            t: parameters in the unit cube, (P,).
            forces: contact forces there, (m,).
        """
        return self.constant + self.slopes @ t + self.weights @ forces

    def negative(self) -> Candidates:
        """The same with the other sign."""
        return Candidates(-self.constant, -self.slopes, -self.weights, self.labels)


@dataclass(frozen=True, eq=False)
class AffineContact:
    """A contact problem over the unit cube of its parameters.

    Attributes:
        schur: S, symmetric, (m, m).
        free: f_0, (m,).
        slopes: G, (m, P).
        space: the box of the parameters, which the unit cube stands for.
    """

    schur: np.ndarray
    free: np.ndarray
    slopes: np.ndarray
    space: ParameterSpace

    @cached_property
    def width(self) -> np.ndarray:
        """Lengths of the box, (P,)."""
        return np.asarray(self.space.upper, dtype=float) - np.asarray(self.space.lower)

    def point(self, t: np.ndarray) -> np.ndarray:
        """Parameters in the box at a point of the unit cube, (P,)."""
        return np.asarray(self.space.lower) + self.width * t

    def free_slack(self, t: np.ndarray) -> np.ndarray:
        """Slack without contact forces, (m,), at a point of the unit cube, (P,)."""
        return self.free + self.slopes @ t


def elimination_of(model: AnsweringModel) -> ConstantElimination:
    """The elimination of a model that a proof can be made for.

    Raises:
        NotOfferedError: for another one, with the reason.
    """
    reason = _refused(model)
    if reason:
        raise NotOfferedError(f"the worst case is proven for {reason}")
    return cast("ConstantElimination", cast("CondensedModel", model).eliminated)


def _refused(model: AnsweringModel) -> str:
    """What a proof needs and the model lacks; empty if it has all."""
    eliminated = getattr(model, "eliminated", None)
    law = model.law
    if law.remembers:
        return (
            "answers that depend on the parameters alone; friction and other laws with memory "
            "depend on the path"
        )
    if not isinstance(eliminated, ConstantElimination):
        return (
            "condensed models of one stiffness, whose bodies are held by supports: "
            "hhr.condense(scene); "
            f"this is a {type(model).__name__}"
        )
    if law.plugin:
        return "pairs without a law of their own"
    if eliminated.amplitudes.nonaffine:
        return "loads and gaps that are affine in the parameters, and a formula here is not"
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
    theta = eliminated.amplitudes
    space = model.parameters
    lower = np.asarray(space.lower, dtype=float)
    width = np.asarray(space.upper) - lower
    terms = eliminated.responses.free_slack
    free = terms @ (theta.constant + theta.slopes @ lower)
    return AffineContact(0.5 * (schur + schur.T), free, (terms @ theta.slopes) * width, space)


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
        weights = np.zeros((len(item.conditions), len(contact.free)))
        weights[np.arange(len(item.conditions)), item.conditions] = 1 / item.areas
        nothing = np.zeros(len(weights))
        labels = tuple(f"pressure of condition {k}" for k in item.conditions)
        return Candidates(nothing, np.outer(nothing, contact.width), weights, labels)
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

    def value(t: np.ndarray, forces: np.ndarray) -> float:
        point = contact.point(t)
        theta = eliminated.amplitudes.dense(point)
        unknown = eliminated(point).unknown(forces)
        answer = model.solve(point, outside="ignore")._replace(unknown=unknown, multipliers=forces)
        measured = model.fields.measured(answer, theta)[rows]
        own = forces[item.conditions] @ item.weights if item.conditions.size else 0.0
        return float(measured @ item.along + theta[item.terms] @ item.coefficients + own)

    rest = np.zeros(len(contact.width))
    nothing = np.zeros(m)
    constant = value(rest, nothing)
    slopes = np.array([value(t, nothing) - constant for t in np.eye(rest.size)])
    weights = np.array([value(rest, forces) - constant for forces in np.eye(m)])
    return Candidates(np.array([constant]), slopes[None], weights[None], (item.name,))
