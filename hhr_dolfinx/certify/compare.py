"""Comparison of a model with known full-order answers: at single parameters, or along load paths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from hhr_dolfinx.certify.accuracy import Residuals, Solutions, contact_residuals, mass_norm, norm, relative_error
from hhr_dolfinx.errors import FarSlidingWarning, HHRError, SmallStrainWarning
from hhr_dolfinx.models.answer import Answer, History, Model
from hhr_dolfinx.models.histories.equilibrium import MarchSettings, facet_of, told_once
from hhr_dolfinx.warn import ignored

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.models.model import AnsweringModel


ONE_ANSWER = 1e-6
"""Relative difference of forces from two starts above which a parameter has two solutions."""
ON_S = 200
"""Random points at which forces are compared with those of the contact problem on S, at half a millisecond each."""


Row = tuple[str | float, ...]
"""A label, and the errors of displacement and forces, for load paths also those of stress and plastic strain."""


class ComparedLaws(Protocol):
    """Comparison of answers of bodies with laws: the facet ``comparison`` of a plug-in."""

    def errors(self, found: History, exact: History) -> tuple[float, ...]:
        """Largest errors of stress and plastic strain of a history, further entries of its :class:`Comparison`."""

    def residuals(self, full: FullModel, answer: Answer) -> Residuals:
        """Residuals of an answer of any model."""

    def warn_of_training(self, full: FullModel, snapshots: Solutions) -> None:
        """Warn of deficits in training that no check of the model can find."""


def compared_laws(full: FullModel) -> ComparedLaws | None:
    """Comparison of answers of bodies with laws; None if all bodies are elastic."""
    if full.equilibrium is None:
        return None
    found: ComparedLaws = facet_of(full.equilibrium, "comparison", "a comparison with the full model")
    return found


@dataclass(frozen=True)
class Comparison:
    """Errors against the full order, one entry per point or load path."""

    labels: list[str]  # description of the point or path
    primal: np.ndarray  # relative L2 errors of the displacement everywhere
    dual: np.ndarray  # relative errors of the forces on the whole contact surface, with a floor
    # errors of the stress of bodies with laws over its largest norm in a path; None without
    stress: np.ndarray | None = None
    plastic: np.ndarray | None = None  # errors of their plastic strain

    @classmethod
    def of(cls, rows: Sequence[Row]) -> Comparison:
        """Comparison from one row per point or path."""
        labels, *errors = zip(*rows, strict=True)
        return cls(list(labels), *(np.array(column) for column in errors))


def compare_points(full: FullModel, model: Model, solutions: Solutions, floor: float) -> Comparison:
    """Errors of fields and forces everywhere at known solutions.

    A point that fails has infinite errors, and so does the force if two starts lead to two solutions. ``floor`` is
    the force norm below which a relative error is meaningless.
    """
    problem = full.problem
    rows: list[Row] = []
    for point, own, forces in zip(solutions.points, solutions.displacements.T, solutions.forces.T, strict=True):
        label = problem.parameters.described(point)
        theta = problem.amplitudes(point)
        try:
            answer = model.solve(point, outside="ignore")
            displacement = answer.displacement()
            found = answer.forces()
            unaided = model.solve(point, start=None, outside="ignore").multipliers
        except HHRError:
            rows.append((label, math.inf, math.inf))
            continue
        exact = problem.spread.whole(own) + problem.lifts @ theta
        size = mass_norm(problem, exact)
        off = mass_norm(problem, displacement - exact)
        primal = off / size if size > 0 else (math.inf if off > 0 else 0.0)
        one_answer = relative_error(unaided, answer.multipliers, floor=floor) <= ONE_ANSWER
        rows.append((label, primal, relative_error(found, forces, floor=floor) if one_answer else math.inf))
    return Comparison.of(rows)


def compare_on_s(model: AnsweringModel) -> Comparison:
    """Errors at random new points, for a model whose bounds solve the contact problem on S anyway.

    A few points in hundreds have large errors, where a body tilts or a contact has just closed; validation points may
    miss all of them.
    """
    points = model.parameters.random(ON_S, seed=ON_S)
    many = model.solve_many(points, outside="ignore", raise_on_failure=False)
    known = many.estimates()
    rows = list[Row]()
    for k, (point, answered) in enumerate(zip(points, many.converged, strict=True)):
        errors = (math.inf, math.inf)
        if answered and known is not None:
            errors = float(known.primal_relative[k]), float(known.forces_euclid_relative[k])
        rows.append((model.parameters.described(point), *errors))
    return Comparison.of(rows)


def retraced(model: Model, exact: History) -> History:
    """A known load path solved by a model, with answers at the same times.

    The model uses the same increments, so that errors of time steps do not count as errors of the model. Warnings of
    the full order are not repeated.
    """
    with told_once(), ignored(SmallStrainWarning, FarSlidingWarning):
        found = model.march(exact.solved_path, MarchSettings(outside="ignore"))
    return found.thinned([answer.time for answer in exact.answers])


def compare_histories(
    full: FullModel, model: Model, histories: dict[str, History], floor: float
) -> tuple[Comparison, dict[str, list[Any]]]:
    """Errors of known load paths, by label, solved by a model, and the signs of its steps by the same labels.

    The error of a path is the largest of its steps over the largest displacement or force of the path: otherwise the
    first contact, with forces of a twentieth of the last ones, would decide. The same holds for errors of laws.
    A path that fails has infinite errors and no signs.
    """
    laws = compared_laws(full)
    rows: list[Row] = []
    signs = {}
    for label, exact in histories.items():
        try:
            found = retraced(model, exact)
        except HHRError:
            rows.append((label, *[math.inf] * (2 if laws is None else 4)))
            continue
        states = () if laws is None else laws.errors(found, exact)
        rows.append((label, *largest_errors(full, found, exact, floor), *states))
        signs[label] = found.signs
    return Comparison.of(rows), signs


def largest_errors(full: FullModel, found: History, exact: History, floor: float) -> tuple[float, float]:
    """Largest errors of the displacement (L2) and of the forces everywhere over their largest norm in the load path."""
    mass = full.problem.mass
    pairs = list(zip(found.answers, exact.answers, strict=True))
    fields = [there.displacement() for _, there in pairs]
    wrong = [here.displacement() - field for (here, _), field in zip(pairs, fields, strict=True)]
    forces = [np.linalg.norm(here.forces() - there.forces()) for here, there in pairs]
    largest = max(max(float(np.linalg.norm(there.forces())) for _, there in pairs), floor)
    length = max(norm(field, mass) for field in fields)
    return (
        max(norm(field, mass) for field in wrong) / length if length > 0 else 0.0,
        float(max(forces)) / largest if largest > 0 else 0.0,
    )


def residuals_of(full: FullModel, answer: Answer) -> Residuals:
    """Residuals of a returned answer: equilibrium, gaps, signs."""
    if (laws := compared_laws(full)) is not None:
        return laws.residuals(full, answer)
    problem = full.problem
    theta = problem.amplitudes(answer.parameter)
    forces = answer.forces()
    opened = problem.law.opened(answer.memory)
    return contact_residuals(problem.at(answer.parameter), answer.displacement(), forces, theta, opened)
