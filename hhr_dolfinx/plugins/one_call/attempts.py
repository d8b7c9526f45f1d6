"""Ways to build a model of a scene, in the order of a search: those with the fewest full answers come first."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from hhr_dolfinx import registry
from hhr_dolfinx.models.estimates import ASKED
from hhr_dolfinx.plugins.one_call.context import BudgetSpentError

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings
    from hhr_dolfinx.plugins.one_call.context import SearchContext

MANY = 1000
"""Number of contact conditions above which a hyper-reduced model is tried after a condensed one of sufficient accuracy;
a heuristic, since the faster one is found by timing."""
FEWEST = 32
MOST = 512
"""Training points of the first and of the last hyper-reduced model; each has twice as many as the one before."""
FEWEST_PATHS = 8
MOST_PATHS = 32
"""The same of training paths."""
GRID_PART = 1e-3
"""Target error of interpolated S, as a part of the target accuracy: errors of forces are ten or more times larger,
just after a contact has closed even more."""
GRID_BUDGETS = (200, 800, 800, 800, 800)
"""Solutions for each component in rounds of interpolation; later rounds benefit from displacements of checks."""

OF_FIELDS = ("fields", "bound")
"""Stages that a model can skip if the target includes no displacements; it is compared with more full answers then."""


@dataclass(frozen=True)
class Attempt:
    """A way to build a model.

    Attributes:
        method: ``condensed``, ``hhr``, or a kind of a plug-in.
        setting: its settings, in words.
        make: builds the model.
    """

    method: str
    setting: str
    make: Callable[[], Any]


def attempts(context: SearchContext) -> Iterator[Attempt]:
    """Ways to build a model of a scene: elastic, frictional or inelastic."""
    if context.full.equilibrium is not None:
        yield from _inelastic(context)
        return
    yield from _condensed(context)
    if context.full.problem.reshaped is not None:  # scenes with shapes are condensed
        return
    if context.full.friction is None:
        yield from _reduced(context)
    elif context.family is not None:
        yield from _by_histories(context)


def _condensed(context: SearchContext) -> Iterator[Attempt]:
    """Condensation: exact for constant stiffness, else interpolated more and more finely."""
    full = context.full
    if not full.problem.varies:
        yield Attempt("condensed", "exact", partial(_exact, context))
        return
    from hhr_dolfinx.reduction.components import solvers_of
    from hhr_dolfinx.reduction.condense import condense as interpolated
    from hhr_dolfinx.reduction.interpolate import GridSettings

    solvers = solvers_of(full, context.store)

    tolerance = GRID_PART * context.target.error
    for budget in GRID_BUDGETS:
        settings = GridSettings(tolerance, budget)

        def make(settings: GridSettings = settings) -> Any:
            # without fields nothing bounds an error; without a bound they serve displacements alone
            spare = not _reads_displacement(context)
            how: dict[str, Any] = {"along": True, "finer": True, "spare": spare, "announce": context.announce}
            try:
                return interpolated(full, context.checked, settings, solvers=solvers, **how)
            except BudgetSpentError as error:
                if not spare or error.stage not in OF_FIELDS:
                    raise
            # all expensive results exist by now, so the budget need not stop the rest
            return interpolated(full, None, settings, fields=False, solvers=solvers, announce=context.progress)

        found = len(context.held_out)
        spanned = f", fields of {found} checks too" if found else ""
        yield Attempt("condensed", f"interpolated to {tolerance:.0e}{spanned}", make)
        if context.forces_off:
            tolerance /= 100


def _reads_displacement(context: SearchContext) -> bool:
    """True if the target, or an output of the scene, needs displacements."""
    functionals = context.full.functionals
    return context.target.needs_fields or (functionals is not None and any(item.count for item in functionals.items))


def _reduced(context: SearchContext) -> Iterator[Attempt]:
    """Hyper-reduced models of more and more answers; of the last ones models of the kinds that plug-ins add."""
    for count in _doubled(FEWEST, MOST):
        yield Attempt("hhr", f"{count} training points", partial(_built, context, count))
    for kind in registry.named("kinds"):
        yield Attempt(kind, f"{MOST} training points", partial(_of_kind, context, kind))


def _by_histories(context: SearchContext) -> Iterator[Attempt]:
    """Hyper-reduced models of more and more histories."""
    for count in _doubled(FEWEST_PATHS, MOST_PATHS):
        yield Attempt("hhr", f"{count} training paths", partial(_built, context, count))


def _inelastic(context: SearchContext) -> Iterator[Attempt]:
    """Condensed inelastic models of more and more histories, then hyper-reduced models of these."""
    from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

    usual = CorrectionSettings()
    tolerance = context.target.error / 2  # a margin for errors that the check does not see
    settings = replace(usual, primal=min(usual.primal, tolerance), dual=min(usual.dual, tolerance), attempts=6)
    if set(context.target.of) <= set(ASKED):  # else an output may need the stress, which must be refined further
        settings = replace(settings, stress=math.inf, plastic=math.inf)
    for count in _doubled(FEWEST_PATHS, MOST_PATHS):
        yield Attempt("condensed", f"{count} training paths", partial(_condensed_flow, context, count, settings))
    yield from _by_histories(context)


def _exact(context: SearchContext) -> Any:
    from hhr_dolfinx.study.condensing import condensed

    context.announce("exact condensation", 0.0)
    return condensed(context.full, fields=context.target.needs_fields)


def _built(context: SearchContext, count: int) -> Any:
    return context.training(count).build(announce=context.announce)


def _of_kind(context: SearchContext, kind: str) -> Any:
    """A model of a kind that a plug-in adds."""
    return getattr(context.training(MOST), kind)()


def _condensed_flow(context: SearchContext, count: int, settings: CorrectionSettings) -> Any:
    return context.training(count).condense(settings, context.announce)


def _doubled(first: int, last: int) -> Iterator[int]:
    while first <= last:
        yield first
        first *= 2
