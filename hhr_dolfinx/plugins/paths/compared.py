"""Comparison of a model with known histories of the full order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from hhr_dolfinx.certify.accuracy import Solutions, force_floor, norm
from hhr_dolfinx.certify.compare import Comparison, Row
from hhr_dolfinx.certify.trust import OF_A_RID, TrustLimits, check_comparison
from hhr_dolfinx.errors import FarSlidingWarning, HHRError, SmallStrainWarning
from hhr_dolfinx.models.answer import History, Model
from hhr_dolfinx.models.histories.equilibrium import MarchSettings, told_once
from hhr_dolfinx.warn import ignored

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel

TRAINED = "trained history"
"""Begin of the labels of training histories."""


class ErrorsOfLaws(Protocol):
    """Largest errors of what laws remember."""

    @property
    def names(self) -> Sequence[str]:
        """Of the errors."""

    def __call__(self, found: History, exact: History) -> tuple[float, ...]:
        """Errors of a history, one for each name."""


class _NoErrors:
    names: Sequence[str] = ()

    def __call__(self, found: History, exact: History) -> tuple[float, ...]:
        return ()


NO_ERRORS = _NoErrors()
"""Elastic bodies have no other fields."""


def retraced(model: Model, exact: History) -> History:
    """A known load path solved by a model, with answers at the same times.

    The model uses the same increments, so that errors of time steps do not count as errors of the
    model. Warnings of the full order are not repeated.

    Args:
        model: the model.
        exact: history of the full order.
    """
    with told_once(), ignored(SmallStrainWarning, FarSlidingWarning):
        history = model.march(exact.solved_path, MarchSettings(outside="ignore"))
    return history.thinned([answer.time for answer in exact.answers])


def compare_histories(
    full: FullModel,
    model: Model,
    histories: dict[str, History],
    floor: float,
    errors_of_laws: ErrorsOfLaws,
) -> tuple[Comparison, dict[str, list[Any]]]:
    """Errors of known load paths, solved by a model, and the signs of its steps, by label.

    The error of a path is the largest of its steps over the largest displacement or force of the
    path: otherwise the first contact, with forces of a twentieth of the last ones, would decide.
    The same holds for errors of laws. A path that fails has infinite errors and no signs.

    Args:
        full: the full model.
        model: the model.
        histories: exact histories by label.
        floor: smallest denominator of errors of forces.
        errors_of_laws: errors of the laws of bodies along a path.
    """
    rows: list[Row] = []
    signs = {}
    for label, exact in histories.items():
        try:
            history = retraced(model, exact)
        except HHRError:
            rows.append((label, *[math.inf] * (2 + len(errors_of_laws.names))))
            continue
        states = errors_of_laws(history, exact)
        rows.append((label, *largest_errors(full, history, exact, floor), *states))
        signs[label] = history.signs
    return Comparison.of(rows, errors_of_laws.names), signs


def largest_errors(
    full: FullModel, found: History, exact: History, floor: float
) -> tuple[float, float]:
    """Largest errors of displacement (L2) and forces over their largest norm in the load path.

    Args:
        full: the full model.
        found: history of the model.
        exact: exact history, with the same times.
        floor: smallest denominator of the error of forces.
    """
    mass = full.problem.mass
    pairs = list(zip(found.answers, exact.answers, strict=True))
    fields = [reference.displacement() for _, reference in pairs]
    wrong = [
        answer.displacement() - field for (answer, _), field in zip(pairs, fields, strict=True)
    ]
    forces = [np.linalg.norm(answer.forces() - reference.forces()) for answer, reference in pairs]
    largest = max(max(float(np.linalg.norm(reference.forces())) for _, reference in pairs), floor)
    length = max(norm(field, mass) for field in fields)
    return (
        max(norm(field, mass) for field in wrong) / length if length > 0 else 0.0,
        float(max(forces)) / largest if largest > 0 else 0.0,
    )


def compared_histories(
    full: FullModel,
    model: Model,
    snapshots: Solutions,
    held_out: Solutions | None,
    limits: TrustLimits | None,
    remedy: str | Mapping[str, str] = OF_A_RID,
    errors_of_laws: ErrorsOfLaws = NO_ERRORS,
) -> tuple[Comparison | None, dict[str, list[Any]]]:
    """Errors against known load paths, and the signs of their steps by label.

    Raises and warns as :func:`~hhr_dolfinx.certify.trust.check_comparison`.

    Args:
        full: the full model.
        model: the model.
        snapshots: training histories.
        held_out: validation histories; None without any.
        limits: limits of the errors; None for no comparison.
        remedy: advice for a model that is refused.
        errors_of_laws: errors of the laws of bodies along a path.

    Returns:
        The errors, None without limits, and the signs.
    """
    validation = () if held_out is None else held_out.histories
    histories = {f"{TRAINED} {k}": history for k, history in enumerate(snapshots.histories)}
    histories |= {f"held-out history {k}": history for k, history in enumerate(validation)}
    floor = force_floor(full.problem, snapshots)
    comparison, shown = compare_histories(full, model, histories, floor, errors_of_laws)
    if limits is None:
        return None, shown
    check_comparison(comparison, limits, remedy)
    return comparison, shown
