"""Comparison of a model with known full-order answers at single parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.certify.accuracy import Solutions, mass_norm, relative_error
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.models.answer import Model

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel


ONE_ANSWER = 1e-6
"""Relative difference of forces from two starts above which a parameter has two solutions."""


Row = tuple[str | float, ...]
"""A label, the errors of displacement and forces, and further ones."""
NOTHING_ELSE: Mapping[str, np.ndarray] = MappingProxyType({})
"""Errors beside those of displacement and forces, of which points have none."""


@dataclass(frozen=True)
class Comparison:
    """Errors against the full order, one entry per point or load path."""

    labels: list[str]  #: description of the point or path
    primal: np.ndarray  #: relative L2 errors of the displacement everywhere
    dual: np.ndarray  #: relative errors of the forces on the whole contact surface, with a floor
    further: Mapping[str, np.ndarray] = (
        NOTHING_ELSE  # errors of what else a kind of answers has, by its name
    )

    @classmethod
    def of(cls, rows: Sequence[Row], names: Sequence[str] = ()) -> Comparison:
        """Comparison from one row per point or path.

        Args:
            rows: label, errors of displacement and forces, and further errors of each.
            names: names of the further errors.
        """
        labels, primal, dual, *errors = zip(*rows, strict=True)
        further = {name: np.array(column) for name, column in zip(names, errors, strict=True)}
        return cls(list(labels), np.array(primal), np.array(dual), further)


def compare_points(full: FullModel, model: Model, solutions: Solutions, floor: float) -> Comparison:
    """Errors of fields and forces everywhere at known solutions.

    A point that fails has infinite errors, and so does the force if two starts lead to two
    solutions.

    Args:
        full: the full model.
        model: the model that is compared.
        solutions: answers of the full model.
        floor: force norm below which a relative error is meaningless.
    """
    problem = full.problem
    rows: list[Row] = []
    for point, homogeneous, forces in zip(
        solutions.points, solutions.displacements.T, solutions.forces.T, strict=True
    ):
        label = problem.parameters.described(point)
        theta = problem.amplitudes(point)
        try:
            answer = model.solve(point, outside="ignore")
            displacement = answer.displacement()
            forces_of_model = answer.forces()
            unaided = model.solve(point, start=None, outside="ignore").multipliers
        except HHRError:
            rows.append((label, math.inf, math.inf))
            continue
        exact = problem.spread.whole(homogeneous) + problem.lifts @ theta
        size = mass_norm(problem, exact)
        difference = mass_norm(problem, displacement - exact)
        primal = difference / size if size > 0 else (math.inf if difference > 0 else 0.0)
        one_answer = relative_error(unaided, answer.multipliers, floor=floor) <= ONE_ANSWER
        rows.append(
            (
                label,
                primal,
                relative_error(forces_of_model, forces, floor=floor) if one_answer else math.inf,
            )
        )
    return Comparison.of(rows)
