"""Check that strains and rotations in answers of elastic bodies are small."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hhr_dolfinx.certify.accuracy import Solutions
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import NotOfferedError, ReductionError, SmallStrainWarning
from hhr_dolfinx.models.histories.small_strains import LARGE, MOST, spread_strain
from hhr_dolfinx.models.strains import StrainOperators
from hhr_dolfinx.warn import ignored, warn

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.models.model import AnsweringModel


CORNERS = 16
"""Largest number of corners of the box in which strains of a model are checked."""
TOGETHER = 50
"""Answers whose strains are computed at once; distributed ones need all values of one on each rank meanwhile."""


def check_small_strains(full: FullModel, *sets: Solutions | None) -> None:
    """Check strains and rotations of answers of a full model at single parameters.

    Strains of load paths are checked step by step; their rotations are not.

    Raises:
        ReductionError: if any has strains or rotations beyond any theory of small strains.

    Warns:
        SmallStrainWarning: if they are large in any, with the parameter.
    """
    given = [item for item in sets if item is not None]
    if full.equilibrium is None and given:
        _check(full, given)


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
    """Check strains and rotations of a model's answers in corners of the parameter range, where loads are largest.

    Raises, warns: see :func:`check_small_strains`.
    """
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
        _check(full, [_Answers(points, problem.spread.of(whole - lifts))])


class _Answers(NamedTuple):
    """Answers of a model: parameters, (S, P), and local rows of displacements without lifts, (own, S)."""

    points: np.ndarray
    displacements: np.ndarray


def _check(full: FullModel, given: Sequence[Any]) -> None:
    """See :func:`check_small_strains`."""
    problem = full.problem
    points = np.concatenate([item.points for item in given])
    operators = full.strains.operators
    sizes = np.array([size for item in given for size in _spreads(problem, operators, item)])
    for kind, size in zip(operators.kinds, sizes.T, strict=True):
        worst = int(size.argmax())
        if size[worst] <= LARGE:
            continue
        message = f"at {problem.parameters.described(points[worst])}: {kind.in_words(size[worst])}"
        if size[worst] > MOST:
            raise ReductionError(message)
        warn(message, SmallStrainWarning, stacklevel=3)


def _spreads(
    problem: ContactProblem, operators: StrainOperators, solutions: Solutions | _Answers
) -> Iterator[list[float]]:
    """The strain and the rotation that few cells exceed, for each answer."""
    each = TOGETHER if problem.spread.all_here else 1
    for first in range(0, len(solutions.points), each):
        part = slice(first, first + each)
        lifts = problem.amplitudes.sum_columns(problem.lifts, solutions.points[part])
        whole = problem.spread.whole(solutions.displacements[:, part]) + lifts
        found = [kind.sizes(whole) for kind in operators.kinds]
        for column in range(whole.shape[1]):
            yield [spread_strain(sizes[:, column]) for sizes in found]
