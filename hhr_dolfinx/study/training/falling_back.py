"""Models that keep a tolerance, and what falling back costs a study."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.models.estimates import ASKED, SHOWN, Estimates, check_of_friction, check_word
from hhr_dolfinx.models.fallback import FallbackModel, check_allowance
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.timing import timed

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed import CondensedModel
    from hhr_dolfinx.reduction.recipe import Recipe

ALLOWED = 0.01
"""Relative error up to which a study lets reduced answers pass."""


def safe_model(
    training: Any,
    tolerance: float,
    recipe: Recipe | None,
    *,
    of: str | None = None,
    checked: bool,
) -> FallbackModel | CondensedModel:
    """See :meth:`hhr_dolfinx.study.training.train.Training.safe_model`."""
    # before a model is built, which takes long
    check_allowance(tolerance)
    functionals = training.full_order.functionals
    check_word([] if functionals is None else [item.name for item in functionals.items], of)
    if training.full_order.friction is not None:
        check_of_friction(of)
    elif training.full_order.equilibrium is None and not training.full_order.problem.varies:
        # an estimate solves the exact problem on S: the condensed model answers by it, and is quicker
        return training.condense()
    model = training.build(recipe, checked=checked)
    return FallbackModel(model, training.full_order, tolerance, of=of)


def fallback_report(model: ReducedModel, full: Any, points: np.ndarray, alone: float) -> dict[str, Any]:
    """How often a model that falls back asks the full one at some points, (n, P), and what its answers cost.

    ``alone`` are the seconds that the full model takes for one.

    Returns:
        The ``fallback`` part of a report: ``kind`` of what is known of errors; ``tolerance``, the relative error
        allowed; ``share`` of the queries that the full model answered, and ``shares`` by the one error that is asked
        for; mean seconds of a ``query`` with all forces and their bound, and of the ``full`` model alone.
    """
    safe = FallbackModel(model, full, ALLOWED)
    count = len(points)
    # one by one, as a user who asks now and then: a table is quicker
    spent = timed(lambda: [safe.solve(point, raise_on_failure=False) for point in points])[1]
    kind = model.fields.bound.kind if model.fields.bound is not None else ""
    own = {"share": safe.share, "shares": _shares(model, points), "query": spent / count, "full": alone}
    return {"kind": kind, "tolerance": ALLOWED, **own}


def _shares(model: ReducedModel, points: np.ndarray) -> dict[str, float]:
    """Part of some points, (n, P), at which an error may be larger than is allowed, by its name."""
    answers = [model.solve(point, raise_on_failure=False, outside="ignore") for point in points]
    found = Estimates.of([answer.estimate() for answer in answers])
    if found is None:
        return {}
    # a NaN is of a point without an answer
    return {name: float(np.mean(~(getattr(found, SHOWN[name]) <= ALLOWED))) for name in ASKED}
