"""Histories of several models on the same paths: solved in turns, timed, and their errors beside the full order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np

from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.certify.compare import largest_errors, residuals_of
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import History, Model, Path
from hhr_dolfinx.models.path import SEARCHES, MarchSettings
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.study.measure import Errors, Row, answer_errors, conditions_inside
from hhr_dolfinx.timing import timed


class Run(NamedTuple):
    """A history with its median seconds over repetitions, or why there is none and the seconds spent."""

    history: History | None
    seconds: float
    failure: HHRError | None = None


def run_in_turns(
    models: Mapping[str, Model], path: Path, settings: MarchSettings, repetitions: int = 1
) -> dict[str, Run]:
    """Histories of several models, by name: all once, then all again, so that a busy machine slows each of them."""
    runs: dict[str, list[Run]] = {name: [] for name in models}
    for _ in range(repetitions):
        for name, model in models.items():
            runs[name].append(timed_run(model, path, settings))
    return {name: own[0]._replace(seconds=float(np.median([run.seconds for run in own]))) for name, own in runs.items()}


def run_beside(
    models: Mapping[str, Model], path: Path, settings: MarchSettings, repetitions: int, exact: History
) -> dict[str, Run]:
    """The same beside a full history: timed as a user asks, with answers found in the parts of the full history.

    Where steps are cut by a tolerance each model has parts of its own, whose time errors would pass for its own.
    """
    runs = run_in_turns(models, path, settings, repetitions)
    if settings.time_tolerance is None:
        return runs
    plain, times = replace(settings, time_tolerance=None), [answer.time for answer in exact.answers]
    for name, run in runs.items():
        if run.history is not None:
            same = timed_run(models[name], exact.solved_path, plain)
            thin = None if same.history is None else same.history.thinned(times)
            runs[name] = Run(thin, run.seconds, same.failure)
    return runs


def timed_run(model: Model, path: Path, settings: MarchSettings) -> Run:
    """A history, timed once; one that does not converge counts with the time it took."""

    def march() -> History | HHRError:
        try:
            return model.march(path, settings)
        except HHRError as error:
            return error

    found, seconds = timed(march)
    return Run(None, seconds, found) if isinstance(found, HHRError) else Run(found, seconds)


def run_in_full(full: FullOrderModel, path: Path, ways: Sequence[MarchSettings]) -> Run:
    """A full history by the first of some settings that solves it; ConvergenceError of the last one."""
    for settings in ways:
        run = timed_run(full, path, settings)
        if run.failure is None:
            return run
    assert run.failure is not None
    raise run.failure


def timed_searches(
    full: FullOrderModel, path: Path, march: MarchSettings
) -> tuple[list[MarchSettings], dict[str, float], list[dict[str, str]]]:
    """Settings for full histories, the fastest search operator first; seconds of each on a path; what did not converge.

    Raises:
        ConvergenceError: if none converges.
    """
    ways = {search: march if search == march.search else replace(march, search=search, iterations=200)
            for search in (march.search, *SEARCHES)}  # fmt: skip
    # what is compiled or read at the first step is no part of any of them
    timed_run(full, path[:2], march)
    runs = {search: timed_run(full, path, settings) for search, settings in ways.items()}
    seconds = {search: run.seconds for search, run in runs.items() if run.failure is None}
    failed = {search: run.failure for search, run in runs.items() if run.failure is not None}
    if not seconds:
        raise failed[march.search]
    skipped = [{"stage": f"fom_searches, {search}", "why": str(error)} for search, error in failed.items()]
    return [ways[search] for search in sorted(seconds, key=seconds.__getitem__)], seconds, skipped


def history_errors(
    full: FullOrderModel, model: Model, history: History, exact: History, floor: float = 0.0
) -> dict[str, Any]:
    """Relative errors at the last step as in thesis table 6.1, and the largest ones of the history.

    ``resultant`` is the error of the sum of all contact forces at the last step over the largest sum in the history.
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
    largest = max(float(np.abs(answer.forces().sum())) for answer in exact.answers)
    wrong = float(np.abs(found[1].sum() - known[1].sum()))
    errors["resultant"] = wrong / max(largest, floor) if wrong > 0 else 0.0
    errors["largest_displacement"], errors["largest_forces"] = largest_errors(full, history, exact, floor)
    return {**errors, "kkt": asdict(residuals_of(full, here))}


def errors_of_runs(
    full: FullOrderModel, model: Model, runs: Sequence[Run], exact: Sequence[History], floor: float
) -> list[dict[str, Any]]:
    """Errors of each history, infinite where there is none.

    Raises:
        HHRError: if there is none at all: what ended the first one.
    """
    rows = [
        None if run.history is None else history_errors(full, model, run.history, known, floor)
        for run, known in zip(runs, exact, strict=True)
    ]
    answered = next((row for row in rows if row is not None), None)
    if answered is None:
        assert runs[0].failure is not None
        raise runs[0].failure
    missing: dict[str, Any] = dict.fromkeys(answered, np.inf) | {"kkt": {}}
    return [missing if row is None else row for row in rows]


def row_of_runs(method: str, setting: str, runs: Sequence[Run], errors: Sequence[dict[str, Any]]) -> Row:
    """Row of a method, from its histories and the errors of each."""
    values = {name: np.array([row[name] for row in errors]) for name in errors[0] if name != "kkt"}
    residuals = [row["kkt"] for row in errors if row["kkt"]]
    kkt = {name: max(row[name] for row in residuals) for name in residuals[0]} if residuals else {}
    answered = np.array([run.history is not None for run in runs])
    return Row(method, setting, np.array([run.seconds for run in runs]), Errors(values, answered, kkt))


def seconds_of_parts(full_or_reduced: FullOrderModel | ReducedModel, history: History) -> dict[str, float]:
    """Seconds of each part of an iteration in the last step of a history, and of a new tangent."""
    model: Any = full_or_reduced.equilibrium
    (before, _), (time, _), answer = *history.path[-2:], history.answers[-1]
    theta, step = model.amplitudes(answer.parameter), time - before
    gauss, material = answer.state(), model.material.at(answer.parameter)
    strain = model.strain(answer.unknown, theta)
    update = material.update(strain, gauss.state, step, tangent=True)
    residual, _ = model.residual(answer.unknown, update, theta)
    operator = model.at(answer.parameter).linearised(update.tangents)
    parts = {
        "strain": lambda: model.strain(answer.unknown, theta),
        "laws": lambda: material.update(strain, gauss.state, step, tangent=False),
        "residual": lambda: model.residual(answer.unknown, update, theta),
        "tangent": lambda: model.at(answer.parameter).linearised(update.tangents),
        "contact": lambda: operator.correct(residual, answer.unknown, theta, answer.active),
    }
    return {name: timed(part, 20)[1] for name, part in parts.items()}
