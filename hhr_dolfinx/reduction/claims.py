"""Comparison of models with their claims of exactness and of bounds.

A claim is a property of a model, not of its class.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, cast

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.certify.accuracy import mass_norm
from hhr_dolfinx.errors import ClaimError, NotOfferedError
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.reduction.kinds import EXACT_MODEL, OfPoints
from hhr_dolfinx.snapshots.records import SnapshotSet

if TYPE_CHECKING:
    from hhr_dolfinx.contact.stiffness import SparseStiffness

LIGHT = 1e-2
"""Part of the largest answer in a norm below which relative bounds, which use a floor, are not
compared.
"""
BOUND = "bound"
"""Kind of the estimates that no error may exceed, see
:class:`~hhr_dolfinx.models.estimates.Estimate`.
"""
ANSWERED = list[tuple[Answer, Answer | None, str]]
"""Answers of the full model, those of a model or None if it has none, and where."""


def check_claim(name: str, kind: OfPoints, model: AnsweringModel, known: SnapshotSet) -> None:
    """Compare a model that calls itself exact, or has bounds, with some full answers.

    Displacements and loads of the contact forces, B^T λ, are compared with a claim of exactness:
    forces of equivalent conditions, and displacements of bodies with rigid motions, may have
    several values.

    Args:
        name: name of the reductor, for the message.
        kind: kind of the answers.
        model: model that was built.
        known: answers of the full model.

    Raises:
        ClaimError: if they differ by more than round-off, or an error exceeds its bound.
    """
    pairs = list(kind.pairs(model, known))
    if model.fields.exact:
        _check_exact(name, kind.full, kind.round_off(known), pairs)
    else:
        _check_bounds(name, kind.full, pairs)


def _check_exact(name: str, full: FullModel, limit: float, pairs: ANSWERED) -> None:
    problem = full.problem
    loads = [problem.contact.T @ exact.forces() for exact, _, _ in pairs]
    sizes = [mass_norm(problem, exact.displacement()) for exact, _, _ in pairs]
    for number, (exact, answer, label) in enumerate(pairs):
        off = np.inf
        if answer is not None:
            off = _part(np.linalg.norm(problem.contact.T @ answer.forces() - loads[number]), loads)
            if not problem.held_by_contact:
                off = max(
                    off,
                    _part(mass_norm(problem, answer.displacement() - exact.displacement()), sizes),
                )
        if not off <= limit:
            raise ClaimError(
                f"{name}: its model calls itself exact and is off by {off:.3g} at {label}: claim "
                "less, or refuse the scene"
            )


def _check_bounds(name: str, full: FullModel, pairs: ANSWERED) -> None:
    """Compare errors with their bounds.

    Round-off is that of the largest of the answers in each norm.
    """
    errors = [
        (_errors(full, exact, answer), answer.estimate(), label)
        for exact, answer, label in pairs
        if answer is not None
    ]
    largest: dict[str, float] = {}
    for row, _, _ in errors:
        for quantity, (_, size) in row.items():
            largest[quantity] = max(largest.get(quantity, 0.0), size)
    for row, estimate, label in errors:
        if estimate is None or estimate.kind != BOUND:
            continue
        for quantity, (error, size) in row.items():
            bound = (
                estimate.outputs.get(quantity, np.inf)
                if quantity not in BOUNDED
                else getattr(estimate, BOUNDED[quantity])
            )
            compared = [(quantity, error, bound, largest[quantity])]
            if quantity in BOUNDED and size > LIGHT * largest[quantity]:
                relative = getattr(estimate, f"{BOUNDED[quantity]}_relative")
                compared.append((f"{quantity}, relative", error / size, relative, 1.0))
            for title, off, most, scale in compared:
                if not off <= (1 + EXACT_MODEL) * most + EXACT_MODEL * scale:
                    raise ClaimError(
                        f"{name}: its model says a bound of {most:.3g} of the {title}, and the "
                        f"error is {off:.3g} at {label}: say 'estimate' or 'indicator' as the "
                        "kind of the estimate, or bound more"
                    )


BOUNDED = {
    "displacement in energy": "primal",
    "contact forces": "forces_euclid",
    "pressure": "pressure",
}
"""Attributes of estimates, by their names in messages.

Those of relative errors end in ``_relative``.
"""


def _errors(full: FullModel, exact: Answer, answer: Answer) -> dict[str, tuple[float, float]]:
    """Errors of an answer and sizes of the exact one, by name.

    The names are those of :data:`BOUNDED`, and of outputs.
    """
    problem = full.problem.at(exact.parameter)
    rows = problem.spread
    errors: dict[str, tuple[float, float]] = {}
    with suppress(NotOfferedError):  # a model of forces alone
        fields = [answer.displacement() - exact.displacement(), exact.displacement()]
        stiffness = (
            problem.own_stiffness
            if problem.stiffness_terms
            else _user_defined(full, exact.parameter)
        )
        energies = [rows.sum(rows.of(field) @ (stiffness @ field)) for field in fields]
        error, size = np.sqrt(np.maximum(energies, 0.0))
        errors["displacement in energy"] = error, size
    off = answer.forces() - exact.forces()
    # forces of equivalent conditions have several values; sizes of all answers are the scale of
    # round-off
    if np.linalg.norm(problem.contact.T @ off) <= EXACT_MODEL * np.linalg.norm(
        problem.contact.T @ exact.forces()
    ):
        off = np.zeros_like(off)
    errors["contact forces"] = float(np.linalg.norm(off)), float(np.linalg.norm(exact.forces()))
    per_area = np.divide(
        1.0, problem.contact_areas, out=np.zeros(len(off)), where=problem.contact_areas > 0
    )
    errors["pressure"] = (
        float(np.abs(off * per_area).max()),
        float(np.abs(exact.forces() * per_area).max()),
    )
    if full.functionals is not None:
        with suppress(NotOfferedError):
            values = exact.outputs().values
            approximate = answer.outputs().values
            terms = _terms_of(full, exact)
            for key in approximate.keys() & values.keys():
                if not np.isnan(values[key]):  # a centre of pressure without contact is NaN
                    size = max(abs(values[key]), terms.get(key, 0.0))
                    errors[key] = abs(approximate[key] - values[key]), size
    return errors


def _terms_of(full: FullModel, exact: Answer) -> dict[str, float]:
    """Sums of the sizes of the terms of linear outputs, the scale of their round-off."""
    from hhr_dolfinx.models.functionals.kinds import Linear  # scenes without outputs do without it

    assert full.functionals is not None
    here = full.functionals.at(exact.parameter)
    sizes = abs(here.rows) @ abs(exact.displacement())
    pairs = zip(here.items, here.places, strict=True)
    return {item.name: sizes[rows].sum() for item, rows in pairs if isinstance(item, Linear)}


def _user_defined(full: FullModel, point: np.ndarray) -> csr_matrix:
    """Local rows of K of a system without parts at a point, (own, N)."""
    return cast("SparseStiffness", full.system.stiffness(point)).matrix


def _part(off: float, sizes: Sequence[float | np.ndarray]) -> float:
    """Error over the largest of some vectors or norms."""
    largest = max(float(np.linalg.norm(size)) for size in sizes)
    return off / largest if largest > 0 else (0.0 if off == 0 else np.inf)
