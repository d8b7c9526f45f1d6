"""The method ``safe_model`` of a training."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hhr_dolfinx.models.estimates import check_of_forces, check_word
from hhr_dolfinx.plugins.fallback.model import FallbackModel, check_allowance

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed import CondensedModel
    from hhr_dolfinx.reduction.recipe import Recipe


def safe_model(
    training: Any,
    tolerance: float = 0.01,
    *,
    of: str | None = None,
    recipe: Recipe | None = None,
    checked: bool = True,
) -> FallbackModel | CondensedModel:
    """Build a model whose answers all have errors within a tolerance.

    For elastic bodies of constant stiffness without friction it is the condensed model, which is exact. Else it is a
    reduced model that calls the full one if its error may exceed the tolerance.

    Args:
        training: the full model with its answers.
        tolerance: largest relative error of any answer.
        of: quantity of the error: ``forces``, nodal contact forces in the Euclidean norm; ``pressure``, the largest
            error of a nodal pressure over the peak pressure; ``displacement``, in energy; or an output, by its name.
            None takes displacement and forces, both in energy: errors of nodal forces and pressures are then ten or
            more times larger.
        recipe, checked: of the reduced model, see :meth:`hhr_dolfinx.study.training.train.Training.build`.

    Raises:
        BoundError: if answers of the reduced model have no bound.
        ParameterError: for an invalid tolerance, an unknown quantity, or an output without a bound.
    """
    there = training.everywhere
    full = there.full_order
    # before a model is built, which takes long
    check_allowance(tolerance)
    check_word([] if full.functionals is None else [item.name for item in full.functionals.items], of)
    if full.law.remembers:
        check_of_forces(of)
    elif full.equilibrium is None and not full.problem.varies:
        # an estimate solves the exact problem on S: the condensed model answers with it, and is faster
        return training.condense()
    return FallbackModel(there.build(recipe, checked=checked), full, tolerance, of=of)
