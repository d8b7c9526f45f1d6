"""Error against run time of histories: full and small ones in turns, on the same paths in the same process."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.certify.accuracy import force_floor, summary
from hhr_dolfinx.errors import HHRError, ReductionError, UnstableModelError
from hhr_dolfinx.models.answer import History, Model, Path
from hhr_dolfinx.models.equilibrium import told_once
from hhr_dolfinx.snapshots.lost import Lost
from hhr_dolfinx.study.history_runs import (
    Run,
    errors_of_runs,
    row_of_runs,
    run_beside,
    run_in_full,
    seconds_of_parts,
    timed_searches,
)
from hhr_dolfinx.study.measure import Measurement, Row
from hhr_dolfinx.study.report import condensed_report, model_report
from hhr_dolfinx.study.training import Progress, Training

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed_flow import CondensedFlowModel
    from hhr_dolfinx.models.reduced import ReducedModel

KEYS = {"HHR": "hhr", "condensed": "condensed"}
"""What the ``models`` of a report call the methods."""
SETTINGS = {"HHR": "this model", "condensed": "plastic correction"}
"""What rows of the work-precision table say of a method that was refused."""


@told_once()
def measure_histories(
    training: Training, settings: Any, tests: Mapping[Any, Path], progress: Progress
) -> tuple[ReducedModel | CondensedFlowModel, Measurement]:
    """The model under study, and errors and times of both kinds of small models beside the full order.

    Under study is the hyper-reduced model; where that is refused, condensed flow. A path that one of them does not
    solve counts with infinite errors and the time that it took. The full order is no more exact than its time steps,
    which is reported, and not warned of.

    Raises:
        ReductionError, UnstableModelError: if both are refused.
        ConvergenceError: if the full order does not solve the first path, or no small model solves any.

    Warns:
        TrainingWarning: for paths that the full order does not solve, which are left out.
    """
    full = training.full_order
    models, refused = _built(training, settings)
    floor = force_floor(full.problem, training.snapshots)
    ways, searches, skipped = timed_searches(full, next(iter(tests.values())), settings.march)
    tests, exact, found = _runs(full, models, tests, ways, settings, progress)
    paths = list(tests.values())
    known = [run.history for run in exact if run.history is not None]

    def beside(method: str, setting: str, other: Model) -> Row:
        how, pairs = (settings.march, settings.repetitions), zip(paths, known, strict=True)
        runs = [run_beside({"": other}, path, *how, there)[""] for path, there in pairs]
        return row_of_runs(method, setting, runs, errors_of_runs(full, other, runs, known, floor))

    measured = {}
    for name, model in models.items():
        try:
            errors = errors_of_runs(full, model, found[name], known, floor)
        except HHRError as error:
            refused[name] = error
            continue
        row = row_of_runs(name, _setting(name, model), found[name], errors)
        measured[name] = _Measured(model, found[name], errors, row)
    if not measured:
        raise next(iter(refused.values()))
    name, own = next(iter(measured.items()))
    nothing: dict[str, Any] = dict.fromkeys(own.row.errors.values, 0.0) | {"kkt": {}}
    best = row_of_runs("fom_best", ways[0].search, exact, [nothing] * len(exact))
    drawn = [(there, run.history) for there, run in zip(known, own.runs, strict=True) if run.history is not None][-1]
    report = _report(measured, refused, best, searches, tests, exact)
    if name == "HHR":
        parts = {"fom": seconds_of_parts(full, drawn[0]), "online": seconds_of_parts(own.model, drawn[1])}
        report["times"]["parts"] = parts
        report["ratios"]["laws"] = parts["fom"]["laws"] / parts["online"]["laws"]
    skipped += [{"stage": method, "why": str(error)} for method, error in refused.items()]
    others = [*(item.row for item in measured.values() if item is not own), best]
    rows = [{"method": method, "setting": SETTINGS[method], "refused": str(why)} for method, why in refused.items()]
    by_key = {KEYS[method]: item.model for method, item in measured.items()}
    return own.model, Measurement(own.row, others, beside, report, skipped, drawn, rows, by_key)


def _runs(
    full: Any, models: Mapping[str, Any], tests: Mapping[Any, Path], ways: Any, settings: Any, progress: Progress
) -> tuple[dict[Any, Path], list[Run], dict[str, list[Run]]]:
    """Paths that the full order solves, by label, and histories along them: of the full order, and of each model."""
    exact: list[Run] = []
    found: dict[str, list[Run]] = {name: [] for name in models}
    lost, solved = Lost(), {}
    for label, path in progress("tests")(list(tests.items())):
        with lost.taken_in(str(label)):
            exact.append(run_in_full(full, path, ways))
            solved[label] = path
        if label not in solved:
            continue
        there = exact[-1].history
        assert there is not None
        for name, run in run_beside(models, path, settings.march, settings.repetitions, there).items():
            found[name].append(run)
    lost.warn(len(tests), 1, "test paths")
    return solved, exact, found


@dataclass(frozen=True)
class _Measured:
    """A small model, its histories, and the errors of each."""

    model: Any
    runs: list[Run]
    errors: list[dict[str, Any]]
    row: Row


def _built(training: Training, settings: Any) -> tuple[dict[str, Any], dict[str, HHRError]]:
    """Small models by method, HHR first, and why others were refused."""
    makers: dict[str, Callable[[], Any]] = {
        "HHR": partial(training.build, settings.recipe),
        "condensed": partial(training.condense, settings.correction),
    }
    models: dict[str, Any] = {}
    refused: dict[str, HHRError] = {}
    for name, make in makers.items():
        try:
            models[name] = make()
        except (ReductionError, UnstableModelError) as error:
            refused[name] = error
    if not models:
        raise refused["HHR"]
    return models, refused


def _setting(method: str, model: Any) -> str:
    """What a row says of a model."""
    if method == "HHR":
        return SETTINGS[method]
    return f"{model.offline.modes} modes, {model.offline.points} points"


def _report(
    measured: dict[str, _Measured],
    refused: dict[str, HHRError],
    best: Row,
    searches: dict[str, float],
    tests: Mapping[Any, Path],
    exact: list[Run],
) -> dict[str, Any]:
    """Parts of a report that only histories have."""
    seconds = {name: measured[name].row.seconds if name in measured else None for name in KEYS}
    models: dict[str, Any] = {KEYS[name]: {"refused": str(error)} for name, error in refused.items()}
    if "HHR" in measured:
        models["hhr"] = model_report(measured["HHR"].model, measured["HHR"].row)
    times: dict[str, Any] = {
        "fom_best": summary(best.seconds),
        "fom_searches": searches,
        "condensed": None if seconds["condensed"] is None else summary(seconds["condensed"]),
        "online": None if seconds["HHR"] is None else summary(seconds["HHR"]),
    }
    if "condensed" in measured:
        models["condensed"] = condensed_report(measured["condensed"].model, measured["condensed"].row)
        times["offline_condensed"] = dict(measured["condensed"].model.offline.log.times)
    names = {"HHR": "fom_best/online", "condensed": "fom_best/condensed"}
    return {
        "histories": _described(tests, measured, exact),
        "time_error": _time_error(exact),
        "times": times,
        "ratios": {names[name]: _ratio(best.seconds, values) for name, values in seconds.items()},
        "models": {name: models[name] for name in KEYS.values()},
    }


def _time_error(exact: list[Run]) -> dict[str, Any]:
    """Largest estimated error of the time steps of each history of the full order, over all of them; the tolerance."""
    histories = [run.history for run in exact if run.history is not None]
    largest = [float(history.time_error.max(initial=0.0)) for history in histories]
    return {**summary(np.array(largest)), "tolerance": histories[0].time_tolerance}


def _ratio(slow: np.ndarray, fast: np.ndarray | None) -> float | None:
    return None if fast is None else float(np.median(slow) / np.median(fast))


def _described(tests: Mapping[Any, Path], measured: dict[str, _Measured], exact: list[Run]) -> list[dict[str, Any]]:
    """The ``histories`` part of a report: errors of the model under study, and those of condensed flow beside it."""
    rows = []
    own = next(iter(measured.values()))
    for k, (label, known) in enumerate(zip(tests, exact, strict=True)):
        assert known.history is not None
        steps = {"parts": sum(known.history.parts), "time_error": float(known.history.time_error.max(initial=0.0))}
        row = {"value": label, **_told(own, k), "full_iterations": known.history.iterations, "full": steps}
        rows.append(row | ({"condensed": _told(measured["condensed"], k)} if "condensed" in measured else {}))
    return rows


def _told(item: _Measured, k: int) -> dict[str, Any]:
    """One history of a model: errors, seconds, iterations, or why there are none."""
    run, row = item.runs[k], {**item.errors[k], "seconds": item.runs[k].seconds}
    if run.history is None:
        return row | {"cuts": None, "iterations": None, "failed": str(run.failure)}
    history: History = run.history
    return row | {"cuts": history.cuts, "iterations": history.iterations}
