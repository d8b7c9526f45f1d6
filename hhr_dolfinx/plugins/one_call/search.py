"""Search from a scene and a target accuracy to a model, in the shortest way that meets the target.

Condensation comes first, which needs no full answers, then hyper-reduction from more and more of
them. Each model is checked. If its answers have a bound or an estimate, it is evaluated at hundreds
of random points. Without one, or if it exceeds the target, the model is compared with full answers
that it was not built from, half of them where it expects its largest errors. Then queries are
timed. Of all models that meet the target, the search returns the most accurate one within a factor
of three of the fastest.
"""

from __future__ import annotations

import json
import logging
import math
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from hhr_dolfinx import registry
from hhr_dolfinx.errors import (
    BoundError,
    ConvergenceError,
    HHRError,
    ModelFileWarning,
    NoBoundWarning,
    NotOfferedError,
    NotSolvableError,
    OutsideTrainingError,
    ParameterError,
    SceneError,
    ShapeError,
    StabilityWarning,
    StudyError,
    UncheckedWarning,
)
from hhr_dolfinx.files import make_folder, replacing
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.group import group_of
from hhr_dolfinx.models.answer import History
from hhr_dolfinx.models.answer import Path as AnswerPath
from hhr_dolfinx.models.estimates import check_asked, relative_errors
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.model import AnsweringModel, KeptModel, with_fields
from hhr_dolfinx.one_thread import one_thread
from hhr_dolfinx.online.model_file import save_model
from hhr_dolfinx.parameters import check_counts
from hhr_dolfinx.plain import finite
from hhr_dolfinx.plugins.one_call.array_store import ArrayStore
from hhr_dolfinx.plugins.one_call.context import (
    BOUND_CHECKS,
    FRESH,
    BudgetSpentError,
    FewAnswersError,
    SearchContext,
)
from hhr_dolfinx.plugins.one_call.progress import Stopwatch
from hhr_dolfinx.plugins.one_call.proposals import Proposal, proposals_of
from hhr_dolfinx.plugins.one_call.record import MET, Reduction, Tried, share_beyond
from hhr_dolfinx.plugins.one_call.target import DISPLACEMENT, Budget, Exact, Target
from hhr_dolfinx.plugins.one_call.workers import Workers
from hhr_dolfinx.plugins.paths.path_families import PathFamily
from hhr_dolfinx.reduction.reductor import Outcome, outcomes, ways
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.snapshots.store import SnapshotStore
from hhr_dolfinx.study.training.train import checked_folder
from hhr_dolfinx.timing import Announce, ShareLines, now, timed
from hhr_dolfinx.warn import ignored, repeat, warn

_log = logging.getLogger(__name__)

MANY_CONDITIONS = 1000
"""Number of contact conditions above which a hyper-reduced model is tried after a condensed one of
sufficient accuracy; a heuristic, since the faster one is found by timing.
"""
ERROR_POINTS = 500
"""Random points at which a model estimates its errors."""
FRESH_PATHS = 6
"""Full histories that a model is compared with."""
OBSERVED_ERROR_FACTOR = 2.0
"""Factor on observed errors: the worst of 200 points exceeds that of 40."""
UNRESOLVED = 3.0
"""Error of forces over that of S, for an interpolation that has not converged: kinks lie between
its nodes, and few of them lie near a point of a check. For a modulus with kinks both were 0.0024,
measured once.
"""
SIMILAR_TIME = 3.0
"""Factor of the time of an answer within which the more accurate model is chosen."""
TIMED_QUERIES = 25
"""Timed queries of each model, after a warm-up; of histories those that are compared."""
TIMING = 0.02
"""Seconds beyond which the timed queries of a model end."""
UNTIMED_QUERIES = 5
"""Queries before the measurement, as a warm-up."""
FEWEST_QUERIES = 3
"""Smallest number of long queries for a median."""
NO_BUDGET = Budget()
LEAST_MEDIAN = 1e-300
"""Least median that estimates are divided by: they may be zero."""
OF_FIELDS = ("fields", "bound")
"""Stages that a model can skip if the target includes no displacements.

It is compared with more full answers then.
"""
RECORD_FILE = "reduction.json"
"""Name of the record of a search in its folder."""
NOTHING_SMALL = (
    "strains are above 1 in nearly all of the box, where a theory of small strains means nothing. "
    "Lower the loads, check units and moduli, or narrow the box"
)
"""Reason for which there is no model if each of :data:`ERROR_POINTS` points has such strains."""


def reduce(
    scene: Scene | FullOrderModel,
    error: float = 0.01,
    *,
    of: str | Sequence[str] = "pressure",
    budget: Budget = NO_BUDGET,
    paths: PathFamily | None = None,
    fallback: bool = False,
    fields: bool | str = True,
    folder: str | Path | None = None,
    seed: int = 1,
    progress: Announce | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> AnsweringModel:
    """Build the cheapest model of a scene with the requested accuracy; collective.

    Args:
        scene: any scene, or its full model, one on each rank.
        error: largest relative error, 0.01 for one per cent.
        of: quantity of the error: ``pressure``, ``forces``, ``displacement``, an output by its
            name, or several; see :mod:`hhr_dolfinx.plugins.one_call.target`.
        budget: limits of the search; at a limit it returns the best model so far, with a warning.
        paths: paths of the queries for inelastic bodies. With friction and without paths, points
            are reached from rest.
        fallback: keep the full model as a fallback of the small one, for one norm, and for a model
            with a bound: it answers if the bound exceeds the target, see ``hhr.FallbackModel``.
        fields: False leaves out arrays that only displacements need, of a condensed model of a
            constant stiffness nearly all of its file; its answers have forces and outputs.
            ``surface`` keeps what pictures in space show, see
            :func:`~hhr_dolfinx.plugins.plots.surface_fields.with_surface_fields`.
        folder: keeps full answers as they are found, so that the same call continues from there,
            with the model, ``model.npz``, and the record, ``reduction.json``; None keeps nothing.
        seed: of random draws.
        progress: receives each stage and the share of it that is done. None prints a line on the
            error stream now and then if the search takes longer than two seconds;
            :func:`hhr_dolfinx.timing.unannounced` prints nothing.
        comm: ranks, of which the first one searches; all solve for full answers, each with a full
            model.

    Returns:
        The model, a copy of it on other ranks than the first. Its ``reduction``, a
        :class:`Reduction`, is the record.

    Raises:
        ParameterError: for an invalid target or budget.
        StudyError: for invalid input, and if there is no model: its ``reduction`` then holds the
            record.
        NotOfferedError: for inelastic bodies without paths.

    Warns:
        StabilityWarning: if the target is not met.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> model = hhr.reduce(scene, error=0.01, of="pressure")
        >>> round(model.outputs({"push": 50.0})["peak"], 1)
        56.5
        >>> model.reduction.met, model.reduction.tried[model.reduction.chosen].method
        (True, 'condensed')
    """
    check_counts(seed=(seed, 0))
    if not isinstance(budget, Budget):
        raise StudyError(
            f"budget = {budget!r}: give hhr.Budget(seconds=600), of full_answers or of bytes"
        )
    with group_of(comm).each("preparing a search"):
        full = _full_model(scene)
        _check_paths(full, paths)
        target = Target.checked(error, of, full)
        _check_fallback(fallback, target)
        if fields not in (True, False, "surface"):
            raise StudyError(f"fields = {fields!r} must be True, False or 'surface'")
        if target.needs_fields and fields is not True:
            raise StudyError(f"an error of displacement needs fields: leave out fields={fields!r}")
        checked_out, store, arrays = _opened(folder, full)
    group_of(comm).agreed(
        "a search", lambda: [full.scene.name, repr((full.scene, error, of, budget, fallback, seed))]
    )
    shown = progress or ShareLines(partial(print, file=sys.stderr, flush=True))
    context = SearchContext(
        full, Workers(comm, full, store), target, budget, paths, seed, shown, arrays, fields=fields
    )
    model, reduction = _found(context, checked_out)
    if not reduction.met and not comm.rank:
        warn(reduction.verdict, StabilityWarning)
    chosen = _with_fallback(model, full, target) if fallback and not model.fields.exact else model
    chosen.reduction = reduction
    return chosen


def _found(context: SearchContext, kept: Path | None) -> tuple[KeptModel, Reduction]:
    """Result of the first rank on all ranks, and in a folder.

    The other ranks solve for it meanwhile.
    """
    comm = context.workers.comm
    result: Any = None
    with group_of(comm).each("a search"):
        if comm.rank:
            context.workers.serve()
        else:
            try:
                model, reduction = _searched(context, kept)
                context.progress(
                    "strains in corners of the box", 0.0
                )  # of histories, as long as training answers
                limited = context.full.strains.corners(context.full, model)
                reduction = replace(reduction, seconds=context.clock.seconds)
                limited = with_fields(limited, context.fields)
                if limited is not model:
                    reduction = replace(reduction, answered=_share_answered(context, limited))
                result = model, reduction = limited, reduction
                if not reduction.answered:
                    raise _no_model(kept, replace(reduction, chosen=None, reason=NOTHING_SMALL))
                if kept is not None:
                    save_model(make_folder(kept) / "model.npz", model)
                    registry.write_companions(context.full, kept)
                    _keep_record(kept, reduction)
            finally:
                context.workers.let_go()
    return result if comm.size == 1 else comm.bcast(result)


def _with_fallback(model: KeptModel, full: FullOrderModel, target: Target) -> AnsweringModel:
    """Add the full model as a fallback.

    Returns the small one alone, with a warning, if nothing bounds the error.
    """
    import_path = registry.named("public").get("FallbackModel")
    try:
        if import_path is None:
            raise NotOfferedError("no plug-in adds FallbackModel")
        return registry.load(import_path)(model, full, target.error, of=target.of[0])
    except (BoundError, NotOfferedError, ParameterError) as error:
        warn(f"the full model is not kept as a fallback of the small one: {error}", NoBoundWarning)
        return model


def _keep_record(folder: Path | None, reduction: Reduction) -> None:
    if folder is None:
        return
    with replacing(make_folder(folder) / RECORD_FILE, text=True) as file:
        json.dump(finite(reduction.described()), file, indent=1, allow_nan=False)


def _opened(
    folder: str | Path | None, full: FullOrderModel
) -> tuple[Path | None, SnapshotStore | None, ArrayStore | None]:
    """Folder of the results, with its stores.

    One has full answers, the other solutions of connected components.
    """
    if folder is None:
        return None, None, None
    if not str(folder):
        raise StudyError("folder='' has no name: give one, or None to keep nothing")
    results = checked_folder(folder)
    scene = full.scene.name
    scene_of_record = None
    with suppress(OSError, ValueError, AttributeError):
        scene_of_record = json.loads((results / RECORD_FILE).read_text(encoding="utf-8")).get(
            "scene"
        )
    if scene_of_record not in (None, scene):
        raise StudyError(
            f"the folder {results} holds a model of scene '{scene_of_record}': choose another one "
            f"for '{scene}'"
        )
    store = SnapshotStore(results / "snapshots", full)
    return results, store, ArrayStore(results / "compliances", store.problem_digest)


def _full_model(scene: Scene | FullOrderModel) -> FullOrderModel:
    if not isinstance(scene, FullOrderModel | Scene):
        raise StudyError(f"{scene!r} is no scene: give a Scene")
    full = scene if isinstance(scene, FullOrderModel) else FullOrderModel(scene, MPI.COMM_SELF)
    full.problem.require_parts("a search for a model")
    return full


def _check_fallback(fallback: bool, target: Target) -> None:
    if fallback and len(norms := target.of) > 1:
        raise NotOfferedError(
            f"a model falls back by one error, and not by {', '.join(norms)}: give one as of="
        )


def _check_paths(full: FullOrderModel, paths: PathFamily | None) -> None:
    name = full.scene.name
    if not isinstance(paths, PathFamily | None):
        raise StudyError(
            f"paths = {paths!r} must be a PathFamily, from which paths to train and to check on "
            "are drawn"
        )
    if full.equilibrium is not None and paths is None:
        raise NotOfferedError(
            f"bodies of scene '{name}' flow, so that answers depend on the path that leads to "
            "them: give paths=hhr.PathFamily(...), of those that are to be answered; on the "
            "command line as PATHS beside the scene"
        )
    if paths is not None and full.equilibrium is None and not full.law.remembers:
        raise StudyError(f"answers of scene '{name}' do not depend on paths: leave them out")


def _searched(context: SearchContext, kept: Path | None) -> tuple[KeptModel, Reduction]:
    """The model to return, and its record, which is written whatever ends the search."""
    search = _Found(context)
    try:
        search.search()
    except BaseException:
        _keep_record(kept, replace(search.reduction, reason="the search was interrupted"))
        raise
    reduction = search.reduction
    if reduction.chosen is None:
        raise _no_model(kept, reduction) from search.failure
    return search.models[reduction.chosen], reduction


def _no_model(kept: Path | None, reduction: Reduction) -> StudyError:
    """Error of a search without a model, whose record is kept and is an attribute of the error."""
    _keep_record(kept, reduction)
    error = StudyError("; ".join([reduction.verdict, *reduction.numbered]))
    vars(error)["reduction"] = reduction
    return error


def _share_answered(context: SearchContext, model: KeptModel) -> float:
    """Part of random points of the box at which a model does not refuse to answer."""
    points = context.full.parameters.random(ERROR_POINTS, context.seed)
    answered = 0
    for point in points:
        with suppress(OutsideTrainingError):
            model.check_range(point, "refuse")
            answered += 1
    return answered / len(points)


def attempts(context: SearchContext) -> Iterator[Proposal]:
    """Models of all reductors of a scene: first those that keep all contact conditions."""
    for way in ways(context.full):
        yield from proposals_of(registry.load(way.place)(), context)


class _Found:
    """Models of a search so far, a row for each, and the last error.

    None for a model that was not built.
    """

    def __init__(self, context: SearchContext):
        self._context = context
        self._reason = "nothing more is known to be tried"
        self._ended: set[str] = set()
        self._over = False
        self._trying: Proposal | None = None
        self._clock = Stopwatch()
        self.tried: list[Tried] = []
        self.models: list[Any] = []
        self.failure: HHRError | None = None

    @property
    def reduction(self) -> Reduction:
        context = self._context
        chosen = _chosen(self.tried, self.models, context.target)
        tried = tuple(self.tried)
        return Reduction(
            context.full.scene.name,
            context.target,
            tried,
            chosen,
            context.solved,
            context.clock.seconds,
            self._reason,
        )

    def search(self) -> None:
        try:
            for outcome in outcomes(self._wanted(), partial(_try, self._context), (HHRError,)):
                # those of a refused model too: reductors and the check give warnings of the scene
                # only
                repeat(outcome.warnings)
                self._judge(outcome)
                row = self.tried[-1]
                _log.info(
                    "%s, %s: %s %s (%s)",
                    row.method,
                    row.setting,
                    row.outcome,
                    dict(row.errors),
                    row.known,
                )
        except BaseException:
            if self._trying is not None:
                self._keep(self._row("interrupted"), None)
            raise

    def _wanted(self) -> Iterator[Proposal]:
        """Models that are worth trying, as long as the budget allows one."""
        context = self._context
        for number, attempt in enumerate(attempts(context)):
            # with many contact conditions another kind of model may be faster than one that meets
            # the target
            different_kind = context.full.conditions >= MANY_CONDITIONS and all(
                tried.method != attempt.method for tried in self.tried
            )
            if self._over or (any(tried.met for tried in self.tried) and not different_kind):
                return
            if attempt.method in self._ended:
                continue
            try:
                context.check_budget()
                if not number:
                    context.measure()
            except BudgetSpentError as error:
                self._reason = str(error)
                return
            self._trying = attempt
            self._clock = Stopwatch()
            yield attempt

    def _judge(self, outcome: Outcome) -> None:
        """Keep a model or the reason of its refusal.

        Decide whether similar models are worth trying.
        """
        method = outcome.candidate.method
        error = outcome.error
        if error is None:
            model, row = outcome.made
            self._keep(row, model)
            return
        if isinstance(error, BudgetSpentError):
            self._reason = "what is left to be tried is not affordable"
            self._ended.add(method)  # later attempts of this method take longer
            self._keep(self._row(f"not affordable: {error}"), None)
            return
        self.failure = error
        row = self._row(f"refused: {error}")
        if isinstance(error, FewAnswersError):
            self._reason = "too few points of the box have an answer"
            self._over = True
        elif isinstance(error, ShapeError):
            self._reason = "the scene itself allows no model of all of its box"
            self._over = True
        elif isinstance(error, NotOfferedError | ParameterError | SceneError) or row.outcome in {
            tried.outcome for tried in self.tried if tried.method == method
        }:
            self._ended.add(method)  # later attempts would fail for the same reason
        self._keep(row, None)

    def _row(self, outcome: str) -> Tried:
        attempt = self._trying
        assert attempt is not None
        return Tried(
            attempt.method,
            attempt.setting,
            self._context.solved,
            self._clock.seconds,
            outcome=outcome,
        )

    def _keep(self, row: Tried, model: KeptModel | None) -> None:
        self._trying = None
        self.tried.append(row)
        self.models.append(model)


def _try(context: SearchContext, attempt: Proposal) -> tuple[KeptModel | None, Tried]:
    clock = Stopwatch()
    # the search checks errors in its norms
    with ignored(StabilityWarning, UncheckedWarning, NoBoundWarning):
        context.checking = False
        model = _made(attempt)
    context.checking = True
    seconds = clock.seconds
    limit = context.budget.bytes
    stored = with_fields(model, context.fields)
    size = 0 if limit is None else _size(stored)
    tried = Tried(attempt.method, attempt.setting, context.solved, seconds, bytes=size)
    if limit is not None and size > limit:
        return None, replace(
            tried,
            outcome=f"refused: {size / 1e6:.3g} MB in a file, and {limit / 1e6:.3g} are allowed",
        )
    context.short = ""
    try:
        errors, source, beyond = _judged(context, model, attempt.method)
    except BudgetSpentError as error:
        return model, replace(
            tried, outcome=f"not checked: {error}", known="nothing", full_answers=context.solved
        )
    context.forces_off = context.errors.forces_off(errors)
    worst = dict(zip(context.target.of, errors.tolist(), strict=True))
    met = bool((errors <= context.target.error).all())
    query = _query_time(context, model)
    outcome = (
        "not exact enough"
        if not met
        else f"not checked enough: {context.short}"
        if context.short
        else MET
    )
    tried = replace(
        tried, full_answers=context.solved, query=query, errors=worst, known=source, outcome=outcome
    )
    return model, replace(tried, beyond=beyond) if tried.met else tried


def _made(attempt: Proposal) -> KeptModel:
    """The model of a proposal.

    Without fields if these are not affordable and the target does without.
    """
    try:
        return attempt.make()
    except BudgetSpentError as error:
        if attempt.spared is None or error.stage not in OF_FIELDS:
            raise
    return attempt.spared()


def _judged(
    context: SearchContext, model: KeptModel, method: str = ""
) -> tuple[np.ndarray, str, float]:
    """Largest known errors of a model, their source, and the share that may exceed the target.

    Errors are in the norms of the target.
    """
    if context.family is not None:
        exact = context.fresh(FRESH_PATHS)
        source = f"{len(exact)} fresh histories, times {OBSERVED_ERROR_FACTOR:g}"
        return (
            _compared(context, model, exact, OBSERVED_ERROR_FACTOR),
            source,
            share_beyond(len(exact)),
        )
    points = context.full.parameters.random(ERROR_POINTS, context.seed + context.checks)
    if model.fields.exact:
        exact = context.fresh(BOUND_CHECKS, _silent(context, model, points))
        context.check_claim(method, model, exact)
        errors = _compared(context, model, exact)
        return errors, f"{len(exact)} fresh answers; an exact condensation", math.nan
    estimated = _said(model, points, context.target)
    worst = np.array(
        [estimated[name].max() if name in estimated else math.inf for name in context.target.of]
    )
    if (worst <= context.target.error).all():
        exact = context.fresh(BOUND_CHECKS)
        seen = _compared(context, model, exact)
        source = (
            f"{model.fields.estimated} at {ERROR_POINTS} points (each answer has its own), "
            f"{len(exact)} fresh answers"
        )
        return np.maximum(worst, seen), source, math.nan
    if not estimated:
        return _seen(context, model, None)
    relative = [
        errors / max(float(np.median(errors)), LEAST_MEDIAN) for errors in estimated.values()
    ]
    worst_first = np.argsort(-np.max(relative, axis=0), kind="stable")
    return _seen(context, model, points[worst_first[: FRESH // 2]])


def _seen(
    context: SearchContext, model: KeptModel, suspects: np.ndarray | None
) -> tuple[np.ndarray, str, float]:
    """Errors at fresh answers, at suspected points, and at answers of earlier checks."""
    before = list(context.held_out)
    random = FRESH if suspects is None else FRESH - len(suspects)
    exact = context.fresh(random, suspects)
    suspected = "" if suspects is None else ", half where it may be worst"
    source = f"{len(exact)} fresh answers{suspected}, times {OBSERVED_ERROR_FACTOR:g}"
    errors = _compared(context, model, exact, OBSERVED_ERROR_FACTOR)
    # with many attempts one passes by chance; models are not built from forces of earlier checks
    if before:
        norms = [k for k, name in enumerate(context.target.of) if name != DISPLACEMENT]
        errors[norms] = np.maximum(errors, context.errors_of(model, before).max(axis=0))[norms]
        source += f", {len(before)} of before"
    off = _unresolved(model)
    if off:
        errors = np.maximum(errors, off)
        source += f"; S is off by {off / UNRESOLVED:.1g}"
    # suspected points do not belong to a random sample
    return errors, source, share_beyond(min(random, len(exact)))


def _silent(context: SearchContext, model: KeptModel, points: np.ndarray) -> np.ndarray | None:
    """Some of the points at which an exact model has no answer.

    Or no finite error of an output of the target.
    """
    wanted = set(context.target.outputs)
    unanswered = []
    for number, point in enumerate(points if wanted else points[:0]):
        context.announce("estimates", number / len(points))
        answer = model.solve(point, outside="ignore", raise_on_failure=False)
        estimate = answer.estimate()
        if estimate is None or not all(
            estimate.outputs.get(name, math.inf) < math.inf for name in wanted
        ):
            unanswered.append(point)
        if len(unanswered) == FRESH // 2:
            break
    return np.array(unanswered) if unanswered else None


def _unresolved(model: KeptModel) -> float:
    """Expected error of an interpolation that spent its budget before it converged.

    Zero for any other model, and for one that answers by the interpolation of its bound.
    """
    facts = None if model.offline is None else model.offline.facts
    return UNRESOLVED * float(getattr(facts, "doubt", 0.0))


def _said(model: KeptModel, points: np.ndarray, target: Target) -> dict[str, np.ndarray]:
    """Errors that a model estimates at some points, by the names of a target.

    Empty without a bound.

    Indicators do not count: they follow errors without a scale. A point without an answer has an
    infinite error.
    """
    if model.fields.bound is None:
        return {}
    many = model.solve_many(points, raise_on_failure=False, outside="ignore")
    estimates = many.estimates()
    errors_by_name = {}
    for name in target.of:
        try:
            check_asked(model.fields, name)
        except ParameterError:  # an output without a bound
            continue
        errors = relative_errors(many, name, estimates)
        if errors is not None:
            errors_by_name[name] = np.where(np.isnan(errors), np.inf, errors)
    return errors_by_name


def _compared(
    context: SearchContext, model: KeptModel, exact: Sequence[Exact], room: float = 1.0
) -> np.ndarray:
    """Largest errors against exact answers, times a factor for unseen points.

    The answers are held out from now on.
    """
    context.held_out += exact
    return room * context.errors_of(model, exact).max(axis=0)


def _query_time(context: SearchContext, model: KeptModel) -> float:
    if context.family is not None:

        def march(path: AnswerPath) -> None:
            with suppress(HHRError):
                model.march(path, MarchSettings(outside="ignore"))

        paths = [
            history.path
            for history in context.held_out[-FRESH_PATHS:]
            if isinstance(history, History)
        ]
        return float(np.median([timed(partial(march, path))[1] for path in paths]))
    points = context.full.parameters.random(TIMED_QUERIES + UNTIMED_QUERIES, context.seed)
    return median_time(
        context.target.ask(model), points, TIMING
    )  # accurate enough: models differ by a factor of three


def median_time(query: Callable[[np.ndarray], object], points: np.ndarray, most: float) -> float:
    """Median of the seconds of queries on one thread after a warm-up.

    The warm-up of long queries is shorter. A query without an answer counts with its time.

    Args:
        query: answers one point, (P,).
        points: parameters, (n, P).
        most: seconds after which no further point is queried.
    """
    times: list[float] = []
    warm = 0
    with one_thread:
        for point in points:
            start = now()
            with suppress(ConvergenceError, NotSolvableError):
                query(point)
            times.append(now() - start)
            if not warm:
                warm = len(times) if len(times) >= UNTIMED_QUERIES or sum(times) > most / 2 else 0
            elif len(times) >= warm + FEWEST_QUERIES and sum(times) > most:
                break
    return float(np.median(times[warm:] or times))


def _size(model: KeptModel) -> int:
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "model.npz"
        try:
            with ignored(ModelFileWarning):
                save_model(target, model)
        except NotOfferedError:
            return 0
        return target.stat().st_size


def _chosen(
    tried: Sequence[Tried], models: Sequence[KeptModel | None], target: Target
) -> int | None:
    """Index of the model to return; None without any.

    The most accurate of the models that meet the target within a factor of the fastest; else the
    most accurate of all.

    None without any model.
    """

    def worst(number: int) -> float:
        errors = tried[number].errors
        return max((errors.get(name, math.inf) for name in target.of), default=math.inf)

    built = [number for number, model in enumerate(models) if model is not None]
    met = [number for number in built if tried[number].met]
    if not met:
        return min(built, key=worst, default=None)
    quickest = min(tried[number].query for number in met)
    return min(
        (number for number in met if tried[number].query <= SIMILAR_TIME * quickest), key=worst
    )
