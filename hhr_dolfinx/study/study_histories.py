"""Error against run time of histories: a scene that flows, trained on some values of a parameter, tried at others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from hhr_dolfinx.certify.accuracy import relative_error, summary
from hhr_dolfinx.errors import ConvergenceError, StudyError
from hhr_dolfinx.full_order.plastic import PlasticFullOrder
from hhr_dolfinx.models.march import SEARCHES, History, MarchSettings, march
from hhr_dolfinx.reduction.plastic_offline import PlasticReduction, PlasticSettings, build_plastic_reduction
from hhr_dolfinx.reduction.plastic_trust import force_floor_of, largest_errors, residuals_of
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.study.console import Console, make_console
from hhr_dolfinx.study.report import frame, print_report, write_report
from hhr_dolfinx.study.training import Progress, check_counts, checked_folder, silent
from hhr_dolfinx.study.view import View
from hhr_dolfinx.study.yardstick import answer_errors
from hhr_dolfinx.timing import StageLog, timed


@dataclass(frozen=True)
class HistorySettings:
    """What to train on and what to measure.

    Attributes:
        path: history of a value: times and parameters, the first ones at rest.
        training: values to train on.
        tests: values to compare at.
        held_out: values kept out of training for the trust check.
        reduction: the recipe under study.
        march: how histories are solved.
        repetitions: reduced histories timed at each test value.
        seed: of random test values, for the report.
    """

    path: Callable[[float], Sequence[tuple[float, np.ndarray]]]
    training: Sequence[float]
    tests: Sequence[float]
    held_out: Sequence[float] = ()
    reduction: PlasticSettings = PlasticSettings()
    march: MarchSettings = MarchSettings()
    repetitions: int = 3
    seed: int = 1

    def __post_init__(self):
        """Refuse what cannot be measured, before anything is computed.

        Raises:
            StudyError: with the name and the value.
        """
        check_counts(repetitions=(self.repetitions, 1), seed=(self.seed, 0))
        for name in ("training", "tests"):
            if not len(getattr(self, name)):
                raise StudyError(f"{name} = {list(getattr(self, name))} must hold at least one value")


@dataclass(frozen=True)
class HistoryStudy:
    """Measurements of a scene that flows.

    Attributes:
        full: the full model.
        reduction: the reduced model under study.
        floor: force norm below which a relative error means nothing.
        rows: errors and iterations at each test value.
        exact, history: full and reduced history at the last test value.
        report: all figures under the keys that scenes share; a demo may add its own.
    """

    full: PlasticFullOrder
    reduction: PlasticReduction
    floor: float
    rows: list[dict]
    exact: History
    history: History
    report: dict = field(default_factory=dict)

    def write(self, folder: str | Path, console: Console | None = None, view: View | None = None) -> None:
        """Write and print the report, draw the pictures of a view."""
        console, folder = console or make_console(), checked_folder(folder)
        write_report(self.report, folder)
        print_report(self.report, console)
        if view is not None:
            from hhr_dolfinx.study.plots import draw_histories

            draw_histories(self, view, folder)
        console.print(f"report, pictures and fields are in {folder}")


def study_histories(scene: Scene, settings: HistorySettings, *, progress: Progress = silent) -> HistoryStudy:
    """Train, compare at every test value, time full and reduced in turns, report.

    Raises:
        ConvergenceError: if a history, full or reduced, does not converge.
        HHRError: if the reduced model is refused.
    """
    log, path = StageLog(), settings.path
    with log.stage("full_order"):
        full = PlasticFullOrder(scene)
    with log.stage("snapshots"):
        training = [march(full, path(value), settings.march) for value in progress("training")(settings.training)]
    with log.stage("held_out"):
        held_out = [march(full, path(value), settings.march) for value in progress("held out")(settings.held_out)]
    reduction = build_plastic_reduction(full, training, settings.reduction, held_out)
    rows, full_seconds, online_seconds = [], [], []
    floor = force_floor_of(training)
    for value in progress("tests")(settings.tests):
        exact, seconds = timed(lambda value=value: march(full, path(value), settings.march))
        full_seconds.append(seconds)
        runs = [
            timed(lambda value=value: march(reduction.model, path(value), settings.march))
            for _ in range(settings.repetitions)
        ]
        online_seconds.append(float(np.median([seconds for _, seconds in runs])))
        history = runs[0][0]
        rows.append({"value": float(value), **history_errors(full, reduction, history, exact, floor),
                     "cuts": history.cuts, "iterations": history.iterations,
                     "full_iterations": exact.iterations})  # fmt: skip
    study = HistoryStudy(full, reduction, floor, rows, exact, history)
    searches = _time_searches(full, settings, reduction.log) | {settings.march.search: float(np.median(full_seconds))}
    seconds = {"fom_best": full_seconds, "online": online_seconds, "fom_searches": searches}
    return replace(study, report=_report(study, settings, training, log, seconds))


def _time_searches(full, settings, log) -> dict[str, float]:
    """Seconds of the full history at the first test value by the other search operators."""
    seconds = {}
    for search in SEARCHES:
        if search != settings.march.search:
            other = replace(settings.march, search=search, iterations=200)
            try:
                seconds[search] = timed(lambda other=other: march(full, settings.path(settings.tests[0]), other))[1]
            except ConvergenceError as error:
                log.skip(f"fom_searches, {search}", str(error))
    return seconds


def history_errors(
    full: PlasticFullOrder, reduction: PlasticReduction, history: History, exact: History, floor: float = 0.0
) -> dict:
    """Relative errors at the last step as in thesis table 6.1, and the largest ones of the history.

    Args:
        full: the full model.
        reduction: the reduced one.
        history, exact: their histories.
        floor: force norm below which a relative error means nothing.
    """
    model, here, there = reduction.model, history.points[-1], exact.points[-1]
    answer = reduction.displacement_everywhere(here), reduction.forces_everywhere(here)
    displacement, forces = largest_errors(full, reduction, history, exact, floor)
    return {
        **answer_errors(full.problem, answer, (full.displacement(there), there.forces), floor, model.sets.A_lambda),
        "stress_rr": relative_error(here.stress[:, 0], there.stress[model.points][:, 0]),
        "plastic_strain": relative_error(here.state.cumulated, there.state.cumulated[model.points]),
        "plastic_strain_everywhere": relative_error(reduction.plastic_strain_everywhere(here), there.state.cumulated),
        "stress_rr_everywhere": relative_error(reduction.stress_everywhere(here)[:, 0], there.stress[:, 0]),
        "largest_displacement": displacement,
        "largest_forces": forces,
        "kkt": asdict(residuals_of(full, reduction, here)),
    }


def seconds_of_parts(model, history: History, repetitions: int = 20) -> dict[str, float]:
    """Seconds of each part of an iteration in the last step of a history, and of a new tangent."""
    point, before = history.points[-1], history.points[-2].time if len(history.points) > 1 else history.start
    theta, step = model.amplitudes(point.parameter), point.time - before
    strain = model.strain(point.unknown, theta)
    update = model.material.update(strain, point.state, step, tangent=True)
    residual, _ = model.residual(update.stress, theta)
    operator = model.linearised(update.tangents)
    parts = {
        "strain": lambda: model.strain(point.unknown, theta),
        "laws": lambda: model.material.update(strain, point.state, step, tangent=False),
        "residual": lambda: model.residual(update.stress, theta),
        "tangent": lambda: model.linearised(update.tangents),
        "contact": lambda: operator.correct(residual, point.unknown, theta, point.active),
    }
    return {name: timed(part, repetitions)[1] for name, part in parts.items()}


def _report(study, settings, training, log, seconds) -> dict:
    """The report under the keys that scenes share."""
    full, reduction, model = study.full, study.reduction, study.reduction.model
    parts = {"fom": seconds_of_parts(full, study.exact), "online": seconds_of_parts(model, study.history)}
    online, fom_best = (float(np.median(seconds[name])) for name in ("online", "fom_best"))
    errors = {name: summary([row[name] for row in study.rows]) for name, value in study.rows[0].items()
              if isinstance(value, float) and name != "value"}  # fmt: skip
    steps = sum(len(history.points) for history in training)
    offline = sum({**log.times, **reduction.log.times}.values())
    shown = ("primal_l2", "dual_full_floored")
    report = frame(full, reduction, settings.reduction, settings.seed, steps)
    # cells of the RID that no test function sees cost nothing
    report["sizes"]["rid_cells"] = len(model.cells)
    report["stability"]["tangent"] = reduction.tangent_margin
    report["skipped"].append({"stage": "condensed", "why": "the stiffness changes with the flow"})
    kkt = {name: max(row["kkt"][name] for row in study.rows) for name in study.rows[0]["kkt"]}
    return report | {
        "errors": errors,
        "kkt": kkt,
        "histories": study.rows,
        "times": {
            "offline": {**log.times, **reduction.log.times},
            "fom_best": summary(seconds["fom_best"]),
            "fom_searches": seconds["fom_searches"],
            "condensed": None,
            "online": summary(seconds["online"]),
            "parts": parts,
        },
        "break_even": {"forces": None, "fields": offline / (fom_best - online) if fom_best > online else None},
        "ratios": {"fom_best/online": fom_best / online, "laws": parts["fom"]["laws"] / parts["online"]["laws"]},
        "work_precision": [
            {"method": "HHR", "setting": f"{reduction.layers} layers", "online_s": online,
             **{name: errors[name]["median"] for name in shown}},
            {"method": "fom_best", "setting": settings.march.search, "online_s": fom_best,
             **dict.fromkeys(shown, 0.0)},
        ],
    }  # fmt: skip
