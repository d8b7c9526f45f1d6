"""Error against run time of histories: full and reduced ones in turns, on the same paths in the same process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hhr_dolfinx.certify.accuracy import force_floor, relative_error, summary
from hhr_dolfinx.certify.compare import largest_errors, residuals_of
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
    """Errors of the reduced model along test paths, and its time beside that of the full order."""
    full = training.full_order
    floor = force_floor(full.problem, training.snapshots)
    exact, found = [], []
    for path in progress("tests")(list(tests.values())):
        exact.append(_run(full, path, settings.march, 1))
        found.append(_run(model, path, settings.march, settings.repetitions))

    def errors_of(other: Model, runs: list[_Run]) -> list[dict[str, Any]]:
        pairs = zip(runs, exact, strict=True)
        return [history_errors(full, other, run.history, known.history, floor) for run, known in pairs]

    def beside(method: str, setting: str, other: Model) -> Row:
        runs = [_run(other, path, settings.march, settings.repetitions) for path in tests.values()]
        return _row(method, setting, runs, errors_of(other, runs))

    errors = errors_of(model, found)
    own = _row("HHR", "this model", found, errors)
    nothing: dict[str, Any] = dict.fromkeys(own.errors.values, 0.0)
    best = _row("fom_best", settings.march.search, exact, [nothing | {"kkt": {}}] * len(exact))
    searches, skipped = _time_searches(full, next(iter(tests.values())), settings.march)
    searches[settings.march.search] = float(np.median(best.seconds))
    parts = {"fom": seconds_of_parts(full, exact[-1].history), "online": seconds_of_parts(model, found[-1].history)}
    report = {
        "histories": _described(tests, errors, found, exact),
        "times": {
            "fom_best": summary(best.seconds),
            "fom_searches": searches,
            "condensed": None,
            "online": summary(own.seconds),
            "parts": parts,
        },
        "ratios": {
            "fom_best/online": float(np.median(best.seconds) / np.median(own.seconds)),
            "laws": parts["fom"]["laws"] / parts["online"]["laws"],
        },
    }
    skipped.append({"stage": "condensed", "why": "the stiffness changes with the flow"})
    return Measurement(own, [best], beside, report, skipped, (exact[-1].history, found[-1].history))


def history_errors(
    full: FullOrderModel, model: Model, history: History, exact: History, floor: float = 0.0
) -> dict[str, Any]:
    """Relative errors at the last step as in thesis table 6.1, and the largest ones of the history.

    What is compared in the RID too is left out of a model that has none; ``floor`` is the force norm below which a
    relative error means nothing.
    """
    here, there = history.answers[-1], exact.answers[-1]
    found, known = ((answer.displacement(), answer.forces()) for answer in (here, there))
    errors = answer_errors(full.problem, found, known, floor, conditions_inside(model))
    stress, flowed = there.stress(), there.plastic_strain()
    if isinstance(model, ReducedModel) and model.flow is not None and here.gauss is not None:
        inside = model.flow.points
        errors["stress_rr"] = relative_error(here.gauss.stress[:, 0], stress[inside, 0])
        errors["plastic_strain"] = relative_error(here.gauss.state.cumulated, flowed[inside])
    errors["plastic_strain_everywhere"] = relative_error(here.plastic_strain(), flowed)
    errors["stress_rr_everywhere"] = relative_error(here.stress()[:, 0], stress[:, 0])
    errors["largest_displacement"], errors["largest_forces"] = largest_errors(full, history, exact, floor)
    return {**errors, "kkt": asdict(residuals_of(full, here))}


class _Run(NamedTuple):
    """A history, and its median seconds over repetitions."""

    history: History
    seconds: float


def _run(model: Model, path: Path, march: MarchSettings, repetitions: int) -> _Run:
    runs = [timed(partial(model.march, path, march)) for _ in range(repetitions)]
    return _Run(runs[0][0], float(np.median([seconds for _, seconds in runs])))


def _row(method: str, setting: str, runs: list[_Run], errors: list[dict[str, Any]]) -> Row:
    """Row of a method, from its histories and the errors of each."""
    values = {name: np.array([row[name] for row in errors]) for name in errors[0] if name != "kkt"}
    kkt = {name: max(row["kkt"][name] for row in errors) for name in errors[0]["kkt"]}
    found = Errors(values, np.ones(len(errors), dtype=bool), kkt)
    return Row(method, setting, np.array([run.seconds for run in runs]), found)


def _described(
    tests: Mapping[Any, Path], errors: list[dict[str, Any]], found: list[_Run], exact: list[_Run]
) -> list[dict[str, Any]]:
    """The ``histories`` part of a report."""
    return [
        {
            "value": label,
            **row,
            "cuts": run.history.cuts,
            "iterations": run.history.iterations,
            "full_iterations": known.history.iterations,
        }
        for label, row, run, known in zip(tests, errors, found, exact, strict=True)
    ]


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


def seconds_of_parts(full_or_reduced: FullOrderModel | ReducedModel, history: History) -> dict[str, float]:
    """Seconds of each part of an iteration in the last step of a history, and of a new tangent."""
    model: Any = full_or_reduced.equilibrium
    (before, _), (time, _), answer = *history.path[-2:], history.answers[-1]
    theta, step = model.amplitudes(answer.parameter), time - before
    gauss, material = answer.state(), model.material.at(answer.parameter)
    strain = model.strain(answer.unknown, theta)
    update = material.update(strain, gauss.state, step, tangent=True)
    residual, _ = model.residual(update.stress, theta)
    operator = model.linearised(update.tangents)
    parts = {
        "strain": lambda: model.strain(answer.unknown, theta),
        "laws": lambda: material.update(strain, gauss.state, step, tangent=False),
        "residual": lambda: model.residual(update.stress, theta),
        "tangent": lambda: model.linearised(update.tangents),
        "contact": lambda: operator.correct(residual, answer.unknown, theta, answer.active),
    }
    return {name: timed(part, 20)[1] for name, part in parts.items()}
