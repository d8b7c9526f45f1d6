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
    """
    with told_once(), ignored(SmallStrainWarning, FarSlidingWarning):
        found = model.march(exact.solved_path, MarchSettings(outside="ignore"))
    return found.thinned([answer.time for answer in exact.answers])


def compare_histories(
    full: FullModel,
    model: Model,
    histories: dict[str, History],
    floor: float,
    errors_of_laws: ErrorsOfLaws,
) -> tuple[Comparison, dict[str, list[Any]]]:
    """Errors of known load paths, by label, solved by a model, and the signs of its steps by the
    same labels.

    The error of a path is the largest of its steps over the largest displacement or force of the
    path: otherwise the first contact, with forces of a twentieth of the last ones, would decide.
    The same holds for errors of laws. A path that fails has infinite errors and no signs.
    """
    rows: list[Row] = []
    signs = {}
    for label, exact in histories.items():
        try:
            found = retraced(model, exact)
        except HHRError:
            rows.append((label, *[math.inf] * (2 + len(errors_of_laws.names))))
            continue
        states = errors_of_laws(found, exact)
        rows.append((label, *largest_errors(full, found, exact, floor), *states))
        signs[label] = found.signs
    return Comparison.of(rows, errors_of_laws.names), signs


def largest_errors(
    full: FullModel, found: History, exact: History, floor: float
) -> tuple[float, float]:
    """Largest errors of the displacement (L2) and of the forces everywhere over their largest norm
    in the load path.
    """
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


def compared_histories(
    full: FullModel,
    model: Model,
    snapshots: Solutions,
    held_out: Solutions | None,
    limits: TrustLimits | None,
    remedy: str | Mapping[str, str] = OF_A_RID,
    errors_of_laws: ErrorsOfLaws = NO_ERRORS,
) -> tuple[Comparison | None, dict[str, list[Any]]]:
    """Errors against known load paths, None without limits, and the signs of their steps by label.

    Raises and warns as :func:`~hhr_dolfinx.certify.trust.check_comparison`.
    """
    kept = () if held_out is None else held_out.histories
    histories = {f"{TRAINED} {k}": history for k, history in enumerate(snapshots.histories)}
    histories |= {f"held-out history {k}": history for k, history in enumerate(kept)}
    floor = force_floor(full.problem, snapshots)
    comparison, shown = compare_histories(full, model, histories, floor, errors_of_laws)
    if limits is None:
        return None, shown
    check_comparison(comparison, limits, remedy)
    return comparison, shown
