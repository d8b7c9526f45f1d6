"""Error against run time of histories: full and reduced ones in turns, on the same paths in the same process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from hhr_dolfinx.certify.accuracy import relative_error, summary
from hhr_dolfinx.certify.compare import floor_of, largest_errors, residuals_of
from hhr_dolfinx.errors import ConvergenceError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import History, Model, Path
from hhr_dolfinx.models.path import SEARCHES, MarchSettings
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.study.measure import Errors, Measurement, Row, answer_errors, conditions_inside
from hhr_dolfinx.study.training import Progress, Training
from hhr_dolfinx.timing import timed


def measure_histories(
    training: Training, model: ReducedModel, settings: Any, tests: Mapping[Any, Path], progress: Progress
) -> Measurement:
    """Errors of the reduced model along test paths, and its time beside that of the full order.

    Args:
        training: of the model.
        model: the model under study.
        settings: a :class:`~hhr_dolfinx.study.study.StudySettings`.
        tests: paths by label.
        progress: for progress bars.

    Raises:
        ConvergenceError: if a history, full or reduced, does not converge.
    """
    full, floor = training.full_order, floor_of(training.full_order, training.snapshots)
    exact, found, rows, full_seconds, seconds = [], [], [], [], []
    for label, path in progress("tests")(list(tests.items())):
        history, taken = timed(partial(full.march, path, settings.march))
        exact.append(history)
        full_seconds.append(taken)
        history, taken = _repeated(model, path, settings)
        found.append(history)
        seconds.append(taken)
        counts = {"cuts": history.cuts, "iterations": history.iterations, "full_iterations": exact[-1].iterations}
        rows.append({"value": label, **history_errors(full, model, history, exact[-1], floor), **counts})

    def beside(method: str, setting: str, other: Model) -> Row:
        runs = [_repeated(other, path, settings) for path in tests.values()]
        errors = [
            history_errors(full, other, run, history, floor) for (run, _), history in zip(runs, exact, strict=True)
        ]
        return Row(method, setting, np.array([taken for _, taken in runs]), _errors(errors))

    report, skipped = _times(full, model, (exact[-1], found[-1]), (full_seconds, seconds), settings.march)
    own = Row("HHR", "this model", np.array(seconds), _errors(rows))
    nothing = Errors({name: np.zeros(len(rows)) for name in own.errors.values}, own.errors.answered, {})
    best = Row("fom_best", settings.march.search, np.array(full_seconds), nothing)
    return Measurement(own, [best], beside, {"histories": rows, **report}, skipped, (exact[-1], found[-1]))


def _times(
    full: FullOrderModel,
    model: ReducedModel,
    last: tuple[History, History],
    seconds: tuple[list[float], list[float]],
    march: MarchSettings,
) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """The ``times`` and ``ratios`` of a report, and what was left out.

    Args:
        full, model: full and reduced.
        last: histories of both at the last test.
        seconds: of both at each test.
        march: how histories are solved.
    """
    searches, skipped = _time_searches(full, last[0].path, march)
    medians = [float(np.median(taken)) for taken in seconds]
    searches[march.search] = medians[0]
    parts = {
        "fom": seconds_of_parts(full.equilibrium, last[0]),
        "online": seconds_of_parts(model.equilibrium, last[1]),
    }
    times = {
        "fom_best": summary(seconds[0]),
        "fom_searches": searches,
        "condensed": None,
        "online": summary(seconds[1]),
        "parts": parts,
    }
    ratios = {"fom_best/online": medians[0] / medians[1], "laws": parts["fom"]["laws"] / parts["online"]["laws"]}
    skipped.append({"stage": "condensed", "why": "the stiffness changes with the flow"})
    return {"times": times, "ratios": ratios}, skipped


def history_errors(
    full: FullOrderModel, model: Model, history: History, exact: History, floor: float = 0.0
) -> dict[str, Any]:
    """Relative errors at the last step as in thesis table 6.1, and the largest ones of the history.

    Args:
        full: the full model.
        model: any other; what is compared in the RID too is left out of one that has none.
        history, exact: their histories.
        floor: force norm below which a relative error means nothing.
    """
    here, there = history.answers[-1], exact.answers[-1]
    found, known = ((answer.displacement(), answer.forces()) for answer in (here, there))
    errors = answer_errors(full.problem, found, known, floor, conditions_inside(model))
    stress, flowed = there.stress(), there.plastic_strain()
    if isinstance(model, ReducedModel):
        inside = model.fields.flow.points if model.fields.flow is not None else slice(None)
        errors["stress_rr"] = relative_error(here.state().stress[:, 0], stress[inside, 0])
        errors["plastic_strain"] = relative_error(here.state().state.cumulated, flowed[inside])
    errors["plastic_strain_everywhere"] = relative_error(here.plastic_strain(), flowed)
    errors["stress_rr_everywhere"] = relative_error(here.stress()[:, 0], stress[:, 0])
    errors["largest_displacement"], errors["largest_forces"] = largest_errors(full, history, exact, floor)
    return {**errors, "kkt": asdict(residuals_of(full, here))}


def _errors(rows: list[dict[str, Any]]) -> Errors:
    """Errors of some histories, from one row each."""
    names = [name for name, value in rows[0].items() if isinstance(value, float) and name != "value"]
    kkt = {name: max(row["kkt"][name] for row in rows) for name in rows[0]["kkt"]}
    return Errors({name: np.array([row[name] for row in rows]) for name in names}, np.ones(len(rows), dtype=bool), kkt)


def _repeated(model: Model, path: Path, settings: Any) -> tuple[History, float]:
    """A history, and its median seconds over repetitions."""
    runs = [timed(partial(model.march, path, settings.march)) for _ in range(settings.repetitions)]
    return runs[0][0], float(np.median([seconds for _, seconds in runs]))


def _time_searches(
    full: FullOrderModel, path: Path, march: MarchSettings
) -> tuple[dict[str, float], list[dict[str, str]]]:
    """Seconds of a full history by the other search operators, and those by which it does not converge."""
    seconds, skipped = {}, []
    for search in SEARCHES:
        if search != march.search:
            other = replace(march, search=search, iterations=200)
            try:
                seconds[search] = timed(partial(full.march, path, other))[1]
            except ConvergenceError as error:
                skipped.append({"stage": f"fom_searches, {search}", "why": str(error)})
    return seconds, skipped


def seconds_of_parts(model: Any, history: History, repetitions: int = 20) -> dict[str, float]:
    """Seconds of each part of an iteration of an equilibrium in the last step of a history, and of a new tangent."""
    answer, before = history.answers[-1], history.path[-2][0]
    theta, step = model.amplitudes(answer.parameter), answer.time - before
    strain = model.strain(answer.unknown, theta)
    update = model.material.update(strain, answer.state().state, step, tangent=True)
    residual, _ = model.residual(update.stress, theta)
    operator = model.linearised(update.tangents)
    parts = {
        "strain": lambda: model.strain(answer.unknown, theta),
        "laws": lambda: model.material.update(strain, answer.state().state, step, tangent=False),
        "residual": lambda: model.residual(update.stress, theta),
        "tangent": lambda: model.linearised(update.tangents),
        "contact": lambda: operator.correct(residual, answer.unknown, theta, answer.active),
    }
    return {name: timed(part, repetitions)[1] for name, part in parts.items()}
