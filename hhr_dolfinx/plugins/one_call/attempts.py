"""Ways to a model of a scene, in the order in which a search tries them: what needs fewest full answers first."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from hhr_dolfinx.models.estimates import ASKED
from hhr_dolfinx.plugins.one_call.bench import BudgetSpentError

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.one_call.bench import Bench
    from hhr_dolfinx.reduction.condense_flow import CorrectionSettings

MANY = 1000
"""Contact conditions from which on a hyper-reduced model is tried beside a condensed one that is exact enough: a
choice, since which one is quicker is timed."""
FEWEST = 32
MOST = 512
"""Training points of the first and of the last hyper-reduced model; each has twice as many as the one before."""
FEWEST_PATHS = 8
MOST_PATHS = 32
"""The same of training paths."""
GRID_PART = 1e-3
"""Wished error of interpolated S, as a part of the error that is wished: forces are off by ten times as much and more,
where a contact has just closed by more still."""
GRID_BUDGETS = (200, 800, 800, 800, 800)
"""Solutions for each component in rounds of interpolation; displacements of checks are what makes later ones better."""

OF_FIELDS = ("fields", "bound")
"""Stages that a model does without if no wish reads displacements: it is then compared with more full answers."""


@dataclass(frozen=True)
class Attempt:
    """A way to a model.

    Attributes:
        method: ``condensed``, ``hhr`` or ``local``.
        setting: how far it goes, in words.
        make: builds the model.
    """

    method: str
    setting: str
    make: Callable[[], Any]


def attempts(bench: Bench) -> Iterator[Attempt]:
    """Ways to a model of a scene, whether it is elastic, rubs or flows."""
    if bench.full.equilibrium is not None:
        yield from _flowing(bench)
        return
    yield from _condensed(bench)
    if bench.full.problem.reshaped is not None:  # condensation is what shapes have
        return
    if bench.full.friction is None:
        yield from _reduced(bench)
    elif bench.family is not None:
        yield from _by_histories(bench)


def _condensed(bench: Bench) -> Iterator[Attempt]:
    """Condensation, exact where the stiffness is constant, else interpolated more and more finely."""
    full = bench.full
    if not full.problem.varies:
        yield Attempt("condensed", "exact", partial(_exact, bench))
        return
    from hhr_dolfinx.reduction.components import solvers_of
    from hhr_dolfinx.reduction.condense import condense as interpolated
    from hhr_dolfinx.reduction.interpolate import GridSettings

    solvers = solvers_of(full, bench.store)

    tolerance = GRID_PART * bench.wish.error
    for budget in GRID_BUDGETS:
        settings = GridSettings(tolerance, budget)

        def make(settings: GridSettings = settings) -> Any:
            # without fields nothing bounds an error; without a bound they serve displacements alone
            spare = not _reads_displacement(bench)
            how: dict[str, Any] = {"along": True, "finer": True, "spare": spare, "announce": bench.announce}
            try:
                return interpolated(full, bench.checked, settings, solvers=solvers, **how)
            except BudgetSpentError as error:
                if not spare or error.stage not in OF_FIELDS:
                    raise
            # all that takes long is known by now, and so nothing stops the rest
            return interpolated(full, None, settings, fields=False, solvers=solvers, announce=bench.progress)

        found = len(bench.held_out)
        spanned = f", fields of {found} checks too" if found else ""
        yield Attempt("condensed", f"interpolated to {tolerance:.0e}{spanned}", make)
        if bench.forces_off:
            tolerance /= 100


def _reads_displacement(bench: Bench) -> bool:
    """Whether the wish, or an output of the scene, reads displacements."""
    functionals = bench.full.functionals
    return bench.wish.needs_fields or (functionals is not None and any(item.count for item in functionals.items))


def _reduced(bench: Bench) -> Iterator[Attempt]:
    """Hyper-reduced models of more and more answers; of the last ones local models too."""
    for count in _doubled(FEWEST, MOST):
        yield Attempt("hhr", f"{count} training points", partial(_built, bench, count))
    yield Attempt("local", f"{MOST} training points", lambda: bench.training(MOST).local())


def _by_histories(bench: Bench) -> Iterator[Attempt]:
    """Hyper-reduced models of more and more histories."""
    for count in _doubled(FEWEST_PATHS, MOST_PATHS):
        yield Attempt("hhr", f"{count} training paths", partial(_built, bench, count))


def _flowing(bench: Bench) -> Iterator[Attempt]:
    """Condensed flow of more and more histories, then hyper-reduced models of these."""
    from hhr_dolfinx.reduction.condense_flow import CorrectionSettings

    usual = CorrectionSettings()
    wished = bench.wish.error / 2  # what is known of is met with room for what is not
    settings = replace(usual, primal=min(usual.primal, wished), dual=min(usual.dual, wished), attempts=6)
    if set(bench.wish.of) <= set(ASKED):  # no output may read the stress, which would go on being made finer
        settings = replace(settings, stress=math.inf, plastic=math.inf)
    for count in _doubled(FEWEST_PATHS, MOST_PATHS):
        yield Attempt("condensed", f"{count} training paths", partial(_condensed_flow, bench, count, settings))
    yield from _by_histories(bench)


def _exact(bench: Bench) -> Any:
    from hhr_dolfinx.study.condensing import condensed

    bench.announce("exact condensation", 0.0)
    return condensed(bench.full, fields=bench.wish.needs_fields)


def _built(bench: Bench, count: int) -> Any:
    return bench.training(count).build(announce=bench.announce)


def _condensed_flow(bench: Bench, count: int, settings: CorrectionSettings) -> Any:
    return bench.training(count).condense(settings, bench.announce)


def _doubled(first: int, last: int) -> Iterator[int]:
    while first <= last:
        yield first
        first *= 2
