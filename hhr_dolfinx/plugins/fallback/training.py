"""Models that fall back on the full one, and their cost in a study."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.models.estimates import ASKED, SHOWN, Estimates, check_of_friction, check_word
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.plugins.fallback.model import FallbackModel, check_allowance
from hhr_dolfinx.timing import timed

if TYPE_CHECKING:
    from hhr_dolfinx.reduction.recipe import Recipe

ALLOWED = 0.01
"""Relative error up to which a study accepts reduced answers."""


def safe_model(
    training: Any,
    tolerance: float = 0.01,
    *,
    of: str | None = None,
    recipe: Recipe | None = None,
    checked: bool = True,
) -> FallbackModel:
    """Build a reduced model that calls the full one if its error may exceed a tolerance.

    Args:
        training: the full model with its answers.
        tolerance: largest relative error of any answer.
        of: quantity of the error: ``forces``, nodal contact forces in the Euclidean norm; ``pressure``, the largest
            error of a nodal pressure over the peak pressure; ``displacement``, in energy; or an output, by its name.
            None takes displacement and forces, both in energy: errors of nodal forces and pressures are then ten or
            more times larger.
        recipe, checked: see :meth:`hhr_dolfinx.study.training.train.Training.build`.

    Raises:
        BoundError: if answers of the reduced model have no bound.
        ParameterError: for an invalid tolerance, an unknown quantity, or an output without a bound.
    """
    training = training.everywhere
    # before a model is built, which takes long
    check_allowance(tolerance)
    functionals = training.full_order.functionals
    check_word([] if functionals is None else [item.name for item in functionals.items], of)
    if training.full_order.friction is not None:
        check_of_friction(of)
    model = training.build(recipe, checked=checked)
    return FallbackModel(model, training.full_order, tolerance, of=of)


def fallback_report(model: ReducedModel, full: Any, points: np.ndarray, alone: float) -> dict[str, Any]:
    """Share of points, (n, P), at which a model falls back on the full one, and the cost of its answers.

    ``alone`` is the time of a full answer in seconds.

    Returns:
        The ``fallback`` part of a report, none of a model without a bound: ``kind`` of the error estimates;
        ``tolerance``, the relative error allowed; ``share`` of the queries that the full model answered, and
        ``shares`` by the one error that is limited; mean seconds of a ``query`` with all forces and their bound, and
        of the ``full`` model alone.
    """
    if model.fields.bound is None:
        return {}
    safe = FallbackModel(model, full, ALLOWED)
    count = len(points)
    # one by one, as in single queries: a table is faster
    spent = timed(lambda: [safe.solve(point, raise_on_failure=False) for point in points])[1]
    own = {"share": safe.share, "shares": _shares(model, points), "query": spent / count, "full": alone}
    return {"fallback": {"kind": model.fields.bound.kind, "tolerance": ALLOWED, **own}}


def _shares(model: ReducedModel, points: np.ndarray) -> dict[str, float]:
    """Part of some points, (n, P), at which an error may be larger than allowed, by its name."""
    answers = [model.solve(point, raise_on_failure=False, outside="ignore") for point in points]
    found = Estimates.of([answer.estimate() for answer in answers])
    if found is None:
        return {}
    # NaN marks a point without an answer
    return {name: float(np.mean(~(getattr(found, SHOWN[name]) <= ALLOWED))) for name in ASKED}
