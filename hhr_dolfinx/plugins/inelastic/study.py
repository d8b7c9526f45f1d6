"""Error against run time of histories: full and small models in turns, on the same paths in the
same process.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hhr_dolfinx.certify.accuracy import force_floor, relative_error, summary
from hhr_dolfinx.errors import HHRError, ReductionError, StudyError, UnstableModelError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import Answer, History, Model
from hhr_dolfinx.models.answer import Path as HistoryPath
from hhr_dolfinx.models.histories.equilibrium import SEARCHES, MarchSettings, told_once
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.plugins.inelastic.reduced_flow import ReducedFlow
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.plugins.paths.compared import largest_errors
from hhr_dolfinx.plugins.studies.advice import TRAINING_STAGES, Advice, by_favour, in_words
from hhr_dolfinx.plugins.studies.measure import (
    MeasuredErrors,
    Measurement,
    Report,
    Row,
    answer_errors,
    conditions_inside,
)
from hhr_dolfinx.plugins.studies.report import errors_and_times, model_report
from hhr_dolfinx.reduction.kinds import kind_of
from hhr_dolfinx.snapshots.records import Lost
from hhr_dolfinx.study.training.train import Progress, Training
from hhr_dolfinx.timing import timed

if TYPE_CHECKING:
    from hhr_dolfinx.models.model import KeptModel
    from hhr_dolfinx.plugins.inelastic.condensed_flow import CondensedFlowModel
    from hhr_dolfinx.plugins.studies.settings import StudySettings, View


class Run(NamedTuple):
    """A history with its median seconds over repetitions, or the error that ended it and the
    seconds spent.
    """

    history: History | None
    seconds: float
    failure: HHRError | None = None

    @classmethod
    def of(cls, model: Model, path: HistoryPath, settings: MarchSettings) -> Run:
        """A history, timed once.

        Args:
            model: small model.
            path: load path.
            settings: settings of the history.
        """

        def march() -> History | HHRError:
            try:
                return model.march(path, settings)
            except HHRError as error:
                return error

        outcome, seconds = timed(march)
        return (
            cls(None, seconds, outcome) if isinstance(outcome, HHRError) else cls(outcome, seconds)
        )


def runs_beside(
    models: Mapping[str, Model], path: HistoryPath, settings: StudySettings, exact: History
) -> dict[str, Run]:
    """Histories of several models, by name: all once, then all again, in turns.

    They are timed as a user runs them, and answered in the parts of the steps of the full one: with
    a time tolerance each model has different parts, whose time errors would count as model errors.

    Args:
        models: models by name.
        path: load path.
        settings: settings of the study.
        exact: history of the full model.
    """
    march = settings.march
    rounds = [
        {name: Run.of(model, path, march) for name, model in models.items()}
        for _ in range(settings.repetitions)
    ]
    runs = {
        name: rounds[0][name]._replace(
            seconds=float(np.median([turn[name].seconds for turn in rounds]))
        )
        for name in models
    }
    if march.time_tolerance is None:
        return runs
    plain = replace(march, time_tolerance=None)
    times = [answer.time for answer in exact.answers]
    for name, run in runs.items():
        if run.history is not None:
            same = Run.of(models[name], exact.solved_path, plain)
            thin = None if same.history is None else same.history.thinned(times)
            runs[name] = Run(thin, run.seconds, same.failure)
    return runs


def run_in_full(full: FullOrderModel, path: HistoryPath, ways: Sequence[MarchSettings]) -> Run:
    """A full history by the first of some settings that solves it.

    Args:
        full: full model of inelastic bodies.
        path: load path.
        ways: settings, in the order of their trial.

    Raises:
        ConvergenceError: that of the last settings, if none does.
    """
    for settings in ways:
        run = Run.of(full, path, settings)
        if run.failure is None:
            return run
    assert run.failure is not None
    raise run.failure


def timed_searches(
    full: FullOrderModel, path: HistoryPath, march: MarchSettings
) -> tuple[list[MarchSettings], dict[str, float], list[dict[str, str]]]:
    """Settings for full histories, the fastest search operator first, with the seconds of each.

    Args:
        full: full model of inelastic bodies.
        path: load path.
        march: settings of the study.

    Returns:
        Settings, seconds by search operator, and searches that failed.

    Raises:
        ConvergenceError: if none converges.
    """
    ways = {
        search: march if search == march.search else replace(march, search=search, iterations=200)
        for search in (march.search, *SEARCHES)
    }
    # compilation and reading at the first step belong to none of them
    Run.of(full, path[:2], march)
    runs = {search: Run.of(full, path, settings) for search, settings in ways.items()}
    seconds = {search: run.seconds for search, run in runs.items() if run.failure is None}
    failed = {search: run.failure for search, run in runs.items() if run.failure is not None}
    if not seconds:
        raise failed[march.search]
    skipped = [
        {"stage": f"fom_searches, {search}", "why": str(error)} for search, error in failed.items()
    ]
    return [ways[search] for search in sorted(seconds, key=seconds.__getitem__)], seconds, skipped


def history_errors(
    full: FullOrderModel, model: Model, history: History, exact: History, floor: float = 0.0
) -> Report:
    """Relative errors at the last step as in thesis table 6.1, and the largest ones of the history.

    ``resultant`` is the error of the sum of all contact forces at the last step over the largest
    sum in the history. Errors in the RID are those of a model with one.

    Args:
        full: full model.
        model: small model.
        history: history of the model.
        exact: history of the full model.
        floor: force norm below which a relative error has no meaning.
    """
    last = history.answers[-1]
    reference = exact.answers[-1]
    answered, expected = ((answer.displacement(), answer.forces()) for answer in (last, reference))
    theta = full.problem.amplitudes(reference.parameter)
    errors = answer_errors(full.problem, answered, expected, theta, floor, conditions_inside(model))
    stress = reference.stress()
    flowed = reference.plastic_strain()
    if (
        isinstance(model, ReducedModel)
        and isinstance(model.flow, ReducedFlow)
        and "gauss" in last.memory
    ):
        points = model.flow.points
        errors["stress_rr"] = relative_error(last.gauss.stress[:, 0], stress[points, 0])
        errors["plastic_strain"] = relative_error(last.gauss.state.cumulated, flowed[points])
    errors["plastic_strain_everywhere"] = relative_error(last.plastic_strain(), flowed)
    errors["stress_rr_everywhere"] = relative_error(last.stress()[:, 0], stress[:, 0])
    largest = max(float(np.abs(answer.forces().sum())) for answer in exact.answers)
    wrong = float(np.abs(answered[1].sum() - expected[1].sum()))
    errors["resultant"] = wrong / max(largest, floor) if wrong > 0 else 0.0
    errors["largest_displacement"], errors["largest_forces"] = largest_errors(
        full, history, exact, floor
    )
    return {**errors, "kkt": asdict(kind_of(full).residuals(last))}


def row_of_runs(method: str, setting: str, runs: Sequence[Run], errors: Sequence[Report]) -> Row:
    """Row of a method, from its histories and the errors of each.

    Args:
        method: name of the method.
        setting: its setting, in words.
        runs: its histories.
        errors: errors of each.
    """
    values = {name: np.array([row[name] for row in errors]) for name in errors[0] if name != "kkt"}
    residuals = [row["kkt"] for row in errors if row["kkt"]]
    kkt = {name: max(row[name] for row in residuals) for name in residuals[0]} if residuals else {}
    answered = np.array([run.history is not None for run in runs])
    return Row(
        method,
        setting,
        np.array([run.seconds for run in runs]),
        MeasuredErrors(values, answered, kkt),
    )


@dataclass(frozen=True)
class Measured:
    """A small model, its histories, and the errors of each, infinite for one without result."""

    model: Any
    runs: list[Run]
    errors: list[Report]
    row: Row

    @classmethod
    def of(
        cls,
        name: tuple[str, str],
        full: FullOrderModel,
        model: Model,
        runs: list[Run],
        exact: list[History],
        floor: float,
    ) -> Measured:
        """Compare histories of a model with those of the full one.

        Without any it raises the error that ended the first one.

        Args:
            name: method and setting of the model.
            full: full model.
            model: small model.
            runs: its histories.
            exact: histories of the full model along the same paths.
            floor: force norm below which a relative error has no meaning.
        """
        rows = [
            None
            if run.history is None
            else history_errors(full, model, run.history, reference, floor)
            for run, reference in zip(runs, exact, strict=True)
        ]
        answered = next((row for row in rows if row is not None), None)
        if answered is None:
            assert runs[0].failure is not None
            raise runs[0].failure
        missing: Report = dict.fromkeys(answered, np.inf) | {"kkt": {}}
        errors = [missing if row is None else row for row in rows]
        return cls(model, runs, errors, row_of_runs(*name, runs, errors))

    def history(self, k: int) -> Report:
        """One history: errors, seconds, iterations, or the reason why there are none."""
        run = self.runs[k]
        row = {**self.errors[k], "seconds": run.seconds}
        if run.history is None:
            return row | {"cuts": None, "iterations": None, "failed": str(run.failure)}
        return row | {"cuts": run.history.cuts, "iterations": run.history.iterations}


def seconds_of_parts(
    full_or_reduced: FullOrderModel | ReducedModel, history: History
) -> dict[str, float]:
    """Seconds of each part of an iteration in the last step of a history, and of a new tangent.

    Args:
        full_or_reduced: full or hyper-reduced model.
        history: its history.
    """
    model: Any = full_or_reduced.equilibrium
    (before, _), (time, _), answer = *history.path[-2:], history.answers[-1]
    theta = model.amplitudes(answer.parameter)
    step = time - before
    gauss = gauss_of(answer)
    material = model.material.at(answer.parameter)
    strain = model.strain(answer.unknown, theta)
    update = material.update(strain, gauss.state, step, tangent=True)
    residual, _ = model.residual(answer.unknown, update, theta)
    operator = model.at(answer.parameter).linearised(update.tangents)
    calls = {
        "strain": lambda: model.strain(answer.unknown, theta),
        "laws": lambda: material.update(strain, gauss.state, step, tangent=False),
        "residual": lambda: model.residual(answer.unknown, update, theta),
        "tangent": lambda: model.at(answer.parameter).linearised(update.tangents),
        "contact": lambda: operator.correct(residual, answer.unknown, theta, answer.active),
    }
    return {name: timed(call, 20)[1] for name, call in calls.items()}


class _Method(NamedTuple):
    """Names of a method in the parts of a report."""

    key: str  #: in ``models``
    setting: str  #: in rows of the work-precision table, if it was refused
    times: str  #: in ``times`` and ``ratios``
    offline: str  #: stages in ``times``
    even: str  #: in ``break_even``
    text: str  #: in the advice


STUDY_METHODS = {
    "HHR": _Method("hhr", "this model", "online", "offline", "fields", "the hyper-reduced model"),
    "condensed": _Method(
        "condensed",
        "plastic correction",
        "condensed",
        "offline_condensed",
        "fields, condensed",
        "condensed flow",
    ),
}
"""Methods that a report compares, by their names there."""


@told_once()
def _setting_of(name: str, model: ReducedModel | CondensedFlowModel) -> str:
    """Setting of a small model for the table of the report."""
    if name == "HHR":
        return STUDY_METHODS[name].setting
    facts = model.offline
    return f"{facts.modes} modes, {facts.points} points"


def measure_histories(
    training: Training,
    settings: StudySettings,
    tests: Mapping[str, HistoryPath],
    progress: Progress,
) -> tuple[ReducedModel | CondensedFlowModel, Measurement]:
    """The model under study, and errors and times of both kinds of small models compared with the
    full model.

    Under study is the hyper-reduced model, or the condensed inelastic one if that is refused. A
    path that one of them does not solve counts with infinite errors and the time that it took. The
    full model is no more accurate than its time steps, which is reported without a warning.

    Args:
        training: full model with training answers.
        settings: settings of the study.
        tests: test paths by label.
        progress: shows the progress over the paths.

    Raises:
        ReductionError, UnstableModelError: if both are refused.
        ConvergenceError: if the full model does not solve the first path, or no small model solves
            any.

    Warns:
        TrainingWarning: for paths that the full model does not solve, which are left out.
    """
    full = training.full_order
    models, refused = _built(training, settings)
    floor = force_floor(full.problem, training.snapshots)
    ways, searches, skipped = timed_searches(full, next(iter(tests.values())), settings.march)
    tests, exact, runs_by_name = _runs(full, models, tests, ways, settings, progress)
    references = [run.history for run in exact if run.history is not None]

    def beside(method: str, setting: str, other: Model) -> Row:
        """Row of ``other``, a model by a method with a setting, on the same tests."""
        pairs = zip(tests.values(), references, strict=True)
        runs = [
            runs_beside({"": other}, path, settings, reference)[""] for path, reference in pairs
        ]
        return Measured.of((method, setting), full, other, runs, references, floor).row

    measured = {}
    for name, model in models.items():
        setting = _setting_of(name, model)
        try:
            measured[name] = Measured.of(
                (name, setting), full, model, runs_by_name[name], references, floor
            )
        except HHRError as error:
            refused[name] = error
    if not measured:
        raise next(iter(refused.values()))
    name, studied = next(iter(measured.items()))
    nothing: Report = dict.fromkeys(studied.row.errors.values, 0.0) | {"kkt": {}}
    best = row_of_runs("fom_best", ways[0].search, exact, [nothing] * len(exact))
    drawn = [
        (reference, run.history)
        for reference, run in zip(references, studied.runs, strict=True)
        if run.history is not None
    ][-1]
    report = _report(measured, refused, best, searches, list(tests), references)
    if name == "HHR":
        seconds = {
            "fom": seconds_of_parts(full, drawn[0]),
            "online": seconds_of_parts(studied.model, drawn[1]),
        }
        report["times"]["parts"] = seconds
        report["ratios"]["laws"] = seconds["fom"]["laws"] / seconds["online"]["laws"]
    skipped += [{"stage": method, "why": str(error)} for method, error in refused.items()]
    baselines = [*(entry.row for entry in measured.values() if entry is not studied), best]
    rows = [
        {"method": name, "setting": STUDY_METHODS[name].setting, "refused": str(reason)}
        for name, reason in refused.items()
    ]
    by_key = {STUDY_METHODS[method].key: entry.model for method, entry in measured.items()}
    return studied.model, Measurement(
        studied.row, baselines, beside, report, skipped, drawn, rows, by_key
    )


def _runs(
    full: FullOrderModel,
    models: Mapping[str, Model],
    tests: Mapping[str, HistoryPath],
    ways: Sequence[MarchSettings],
    settings: StudySettings,
    progress: Progress,
) -> tuple[dict[str, HistoryPath], list[Run], dict[str, list[Run]]]:
    """Paths that the full model solves, by label, and histories along them: of the full model, and
    of each model.
    """
    exact: list[Run] = []
    runs_by_name: dict[str, list[Run]] = {name: [] for name in models}
    lost = Lost()
    solved = {}
    for label, path in progress("tests")(list(tests.items())):
        with lost.recorded(str(label)):
            exact.append(run_in_full(full, path, ways))
            solved[label] = path
        if label not in solved:
            continue
        reference = exact[-1].history
        assert reference is not None
        for name, run in runs_beside(models, path, settings, reference).items():
            runs_by_name[name].append(run)
    lost.warn(len(tests), 1, "test paths")
    return solved, exact, runs_by_name


def _built(training: Training, settings: StudySettings) -> tuple[Report, dict[str, HHRError]]:
    """Small models by method, HHR first, and the errors of refused ones."""
    makers: dict[str, Callable[[], KeptModel]] = {
        "HHR": partial(training.build, settings.recipe),
        "condensed": partial(training.condense, settings.correction),
    }
    models: Report = {}
    refused: dict[str, HHRError] = {}
    for name, make in makers.items():
        try:
            models[name] = make()
        except (ReductionError, UnstableModelError) as error:
            refused[name] = error
    if not models:
        raise refused["HHR"]
    return models, refused


def _report(
    measured: dict[str, Measured],
    refused: dict[str, HHRError],
    best: Row,
    searches: dict[str, float],
    labels: list[str],
    exact: list[History],
) -> Report:
    """Parts of a report for histories only."""
    makers: Any = {"condensed": condensed_report, "HHR": model_report}
    models: Report = {}
    seconds = {name: entry.row.seconds for name, entry in measured.items()}
    times: Report = {"fom_best": summary(best.seconds), "fom_searches": searches}
    for name in reversed(STUDY_METHODS):
        times[STUDY_METHODS[name].times] = summary(seconds[name]) if name in seconds else None
    slow = np.median(best.seconds)
    ratios: Report = {}
    for name, method in STUDY_METHODS.items():
        entry = measured.get(name)
        models[method.key] = (
            {"refused": str(refused[name])}
            if entry is None
            else makers[name](entry.model, entry.row)
        )
        ratios[f"fom_best/{method.times}"] = (
            float(slow / np.median(seconds[name])) if name in seconds else None
        )
    if "condensed" in measured:
        times["offline_condensed"] = dict(measured["condensed"].model.offline.log.times)
    studied = next(iter(measured.values()))
    errors = [time_error_of(history, studied.model) for history in exact]
    rows: list[Report] = []
    for k, (label, reference) in enumerate(zip(labels, exact, strict=True)):
        steps = {"parts": sum(reference.parts), "time_error": errors[k]}
        rows.append(
            {
                "value": label,
                **studied.history(k),
                "full_iterations": reference.iterations,
                "full": steps,
            }
        )
        if "condensed" in measured:
            rows[k]["condensed"] = measured["condensed"].history(k)
    return {
        "histories": rows,
        "time_error": {**summary(np.array(errors)), "tolerance": exact[0].time_tolerance},
        "times": times,
        "ratios": ratios,
        "models": models,
    }


def time_error_of(exact: History, model: Model) -> float:
    """Largest time error of a full history.

    Without a tolerance, by a small model in the same steps, which is cheap.

    Args:
        exact: history of the full model.
        model: small model, for a history without a tolerance.
    """
    if exact.time_tolerance is None:
        try:
            exact = model.march(exact.solved_path, MarchSettings(outside="ignore", time_error=True))
        except HHRError:
            return np.nan
    return float(exact.time_error.max(initial=0.0))


def condensed_report(model: CondensedFlowModel, row: Row) -> Report:
    """The ``condensed`` one of the ``models`` of a report on an inelastic scene.

    ``check`` holds misfit and largest energy of the cubature, and the largest errors along known
    histories.

    Args:
        model: condensed inelastic model.
        row: its errors and times.
    """
    record = model.offline
    comparison = model.offline.comparison
    columns = (
        ()
        if comparison is None
        else (comparison.labels, comparison.primal.tolist(), comparison.dual.tolist())
    )
    compared = [
        {"history": label, "displacement": primal, "forces": dual}
        for label, primal, dual in zip(*columns, strict=True)
    ]
    return {
        "sizes": {"modes": record.modes, "points": record.points, "candidates": record.candidates},
        "check": {"misfit": record.misfit, "energy": record.energy, "compared": compared},
        "refused_before": list(record.log.refused),
        **errors_and_times(model, row),
    }


def advice_flowing(report: Report) -> Advice:
    """Method for an inelastic scene: the most accurate one within a factor of three of the fastest.

    Both are far faster than the full model; a refused one is listed with its reason.
    """
    times = report["times"]
    models = report["models"]
    kinds = {method.key: method for method in reversed(STUDY_METHODS.values())}
    measured = {key: models[key] for key in kinds if "refused" not in models[key]}
    seconds = {key: times[kinds[key].times]["median"] for key in measured}

    def figures(key: str) -> str:
        errors = measured[key]["errors"]
        count = report["break_even"].get(kinds[key].even)
        paid = "never pays" if count is None else f"pays after {count:.1f} histories"
        training_seconds = sum(
            value
            for stage, value in times[kinds[key].offline].items()
            if stage not in TRAINING_STAGES
        )
        ratio = times["fom_best"]["median"] / seconds[key]
        missed = measured[key]["unconverged"]
        return (
            f"{kinds[key].text}: {in_words(seconds[key])} for a history, {ratio:.0f} times the "
            f"best full order, errors {errors['largest_displacement']['max']:.1e} of displacement "
            f"and {errors['largest_forces']['max']:.1e} of contact forces at most, made in "
            f"{in_words(training_seconds)} from the training answers, and {paid}"
            + (f"; {missed} of the test paths have no answer" if missed else "")
        )

    worst = {
        key: {"dual_full_floored_max": entry["errors"]["largest_forces"]["max"]}
        for key, entry in measured.items()
    }
    favoured, *runners_up = by_favour(worst, seconds)
    sentence = f"Use {figures(favoured)}."
    for runner_up in runners_up:
        text = figures(runner_up)
        sentence += f" {text[0].upper()}{text[1:]}."
    for key, method in kinds.items():
        if key not in measured:
            name = method.text
            sentence += (
                f" {name[0].upper()}{name[1:]} is refused here: "
                f"{models[key]['refused'].rstrip('.')}."
            )
    sentence += (
        " The hyper-reduced model is the one for contact conditions by the thousand, and where "
        "connected parts have moduli that are separate parameters."
    )
    return Advice(favoured, sentence)


def draw_over_time(histories: dict[str, History], contacts: np.ndarray, folder: Path) -> None:
    """Draw force of each contact, largest plastic strain and iterations of the steps, by method.

    Args:
        histories: histories by method.
        contacts: pair of each condition, (m,).
        folder: folder of the picture.
    """
    from hhr_dolfinx.plugins.studies.plots import (
        plot_curves,
    )  # imported here: it needs packages for pictures

    times = [answer.time for answer in next(iter(histories.values())).answers]
    pairs = np.unique(contacts)
    lines = {}
    for label, history in histories.items():
        forces = np.array([answer.forces() for answer in history.answers])
        for pair in pairs:
            name = f"{label}, contact {pair}" if pairs.size > 1 else label
            lines[name] = times, forces[:, contacts == pair].sum(axis=1)
    plot_curves(lines, folder / "contact_force.png", ("time [s]", "contact force"))
    quantities = {
        "largest plastic strain": lambda history: [
            answer.gauss.state.cumulated.max() for answer in history.answers
        ],
        "iterations of a step": lambda history: history.iterations,
    }
    for name, quantity in quantities.items():
        lines = {label: (times, quantity(history)) for label, history in histories.items()}
        plot_curves(lines, folder / f"{name.replace(' ', '_')}.png", ("time [s]", name))


class _Study:
    """Facet ``study``, see :class:`hhr_dolfinx.plugins.studies.of_laws.StudiedLaws`."""

    measure = staticmethod(measure_histories)
    advice = staticmethod(advice_flowing)
    draw = staticmethod(draw_over_time)

    def check(self, settings: StudySettings) -> None:
        """Raise StudyError for an invalid correction."""
        from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

        correction = settings.correction
        if correction is not None and not isinstance(correction, CorrectionSettings):
            raise StudyError(
                f"correction = {correction!r} of a study must be CorrectionSettings, or None for "
                "the usual way"
            )

    def fields(
        self, full: FullOrderModel, answers: dict[str, Answer], view: View
    ) -> dict[str, dict[str, np.ndarray]]:
        """Plastic strain, and the first normal stress.

        Args:
            full: full model of inelastic bodies.
            answers: answers by the name of their method.
            view: units and scales of the pictures.
        """

        def mean(values: np.ndarray) -> np.ndarray:
            return values.reshape(len(full.problem.cell_nodes), -1).mean(axis=1)

        stress = f"first normal stress [{view.stress}]"
        return {
            "plastic strain": {
                name: mean(answer.plastic_strain()) for name, answer in answers.items()
            },
            stress: {name: mean(answer.stress()[:, 0]) for name, answer in answers.items()},
        }

    def cells(self, model: ReducedModel | CondensedFlowModel) -> np.ndarray:
        """Cells of the RID, or of the points where laws are evaluated."""
        if isinstance(model, ReducedModel):
            return model.offline.sets.cells
        return np.unique(model.flow.points // model.flow.per_cell)


STUDY = _Study()
