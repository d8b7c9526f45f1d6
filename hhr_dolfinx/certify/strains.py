"""Check that strains and rotations in answers of elastic bodies are small."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.errors import NotOfferedError, ReductionError, SmallStrainWarning
from hhr_dolfinx.warn import ignored, warn

if TYPE_CHECKING:
    from hhr_dolfinx.certify.accuracy import Solutions
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.models.model import AnsweringModel


CORNERS = 16
"""Largest number of corners of the box in which strains of a model are checked."""


def check_small_strains(full: FullModel, *sets: Solutions | None) -> None:
    """Check answers of a full model at single parameters; raises and warns as :meth:`StrainGuard.check`.

    Strains of load paths are checked step by step; their rotations are not.
    """
    given = [(item.points, item.displacements) for item in sets if item is not None]
    if full.equilibrium is None and given:
        full.strains.check(full.problem, *given)


def look_at_corners(full: FullModel, model: AnsweringModel) -> None:
    """Warn of large strains and rotations of a model in corners of its parameter range.

    A model of contact forces alone has no displacement, and is not checked.
    """
    try:
        check_corners(full, model)
    except ReductionError as error:
        warn(f"{error}. The box reaches that far: narrow it", SmallStrainWarning, stacklevel=4)
    except NotOfferedError:
        return


def check_corners(full: FullModel, model: AnsweringModel) -> None:
    """Check a model's answers in corners of the parameter range, where loads are largest, as above."""
    if full.equilibrium is not None:
        return
    problem = full.problem
    ends = np.array([problem.parameters.lower, problem.parameters.upper], dtype=float)
    count = 2 ** min(ends.shape[1], 10)
    numbers = np.unique(np.linspace(0, count - 1, min(count, CORNERS)).astype(int))
    axes = np.arange(ends.shape[1])
    corners = np.array([ends[(number >> (axes % 10)) & 1, axes] for number in numbers])
    with ignored(Warning):  # the user did not request answers in corners
        many = model.solve_many(corners, raise_on_failure=False, outside="ignore")
    found = [answer for answer in many if answer.converged]
    if found:
        points = np.array([answer.parameter for answer in found])
        lifts = problem.amplitudes.sum_columns(problem.lifts, points)
        whole = np.stack([answer.displacement() for answer in found], axis=1)
        full.strains.check(full.problem, (points, problem.spread.of(whole - lifts)))
