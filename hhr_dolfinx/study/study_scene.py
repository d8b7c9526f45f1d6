"""Error against run time of one scene: every model on the same points in the same process."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from hhr_dolfinx.baselines.condensation import exact_condensation
from hhr_dolfinx.baselines.naive import NaiveFullOrder
from hhr_dolfinx.certify.accuracy import summary
from hhr_dolfinx.errors import HHRError, StabilityWarning, StudyError
from hhr_dolfinx.full_order.elastic import FullOrderModel
from hhr_dolfinx.linear.dense import LapackLU, PetscLU
from hhr_dolfinx.models.condensed import CondensedContact
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.online.model_file import save_model
from hhr_dolfinx.reduction.offline import HyperReduction, ReductionSettings
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.study.console import Console, make_console
from hhr_dolfinx.study.report import make_report, model_report, print_report, write_report
from hhr_dolfinx.study.training import Progress, Training, check_counts, checked_folder, silent, train
from hhr_dolfinx.study.view import View
from hhr_dolfinx.study.yardstick import PointErrors, Yardstick
from hhr_dolfinx.timing import time_queries


@dataclass(frozen=True)
class Rival:
    """Another approximation to compare with.

    Attributes:
        method: its name.
        setting: what distinguishes it from others of the same method.
        model: object with ``solve(mu)``, which is timed, and ``solve_everywhere(mu)``, whose displacement (N,)
            and forces (N_lambda,) are compared.
    """

    method: str
    setting: str
    model: Any


@dataclass(frozen=True)
class StudySettings:
    """What to train on and what to measure.

    Attributes:
        training: training points along each parameter.
        reduction: the recipe under study.
        variants: further recipes by label, for the work-precision table.
        models: recipes that the report shows in full beside the one under study, built as they are, by name.
        tests: random test points.
        queries: timed queries per model, at least 100 for a figure to quote.
        held_out: random solutions for the trust check.
        seed: of test points; those that are timed are neither trained nor tested on.
        naive: whether to time the naive full order too; in space one of its queries takes many seconds.

    Raises:
        StudyError: for a count that is not positive, a negative seed, or what is no recipe.
    """

    training: Sequence[int]
    reduction: ReductionSettings = ReductionSettings()
    variants: Sequence[tuple[str, ReductionSettings]] = ()
    models: Mapping[str, ReductionSettings] = field(default_factory=dict)
    tests: int = 200
    queries: int = 200
    held_out: int = 100
    seed: int = 1
    naive: bool = True

    def __post_init__(self):
        """Refuse what cannot be measured, before anything is computed."""
        least = {"tests": 1, "queries": 1, "held_out": 0, "seed": 0}
        check_counts(**{name: (getattr(self, name), low) for name, low in least.items()})
        recipes = {"reduction": self.reduction, **{f"variant {label!r}": recipe for label, recipe in self.variants}}
        recipes |= {f"model {label!r}": recipe for label, recipe in self.models.items()}
        for name, recipe in recipes.items():
            if not isinstance(recipe, ReductionSettings):
                raise StudyError(f"{name} = {recipe!r} of a study must be ReductionSettings, the recipe of a model")

    def asked(self, *, seed: int, quick: bool) -> StudySettings:
        """These settings with another seed, and few points if it has to be quick."""
        few = {"tests": 20, "queries": 15} if quick else {}
        return replace(self, seed=seed, **few)


@dataclass(frozen=True)
class SceneStudy:
    """Measurements of a scene.

    Attributes:
        training: full model and training solutions.
        hyper: the reduced model under study.
        points: test points, (n, P).
        errors: errors of the reduced model at the test points.
        answers: what the active set did at each of them: ``(iterations, cycled)``.
        times: seconds per query of each model, started warm and cold.
        work_precision: rows of the error-against-time table.
        settings: what was asked for.
        report: all figures under the keys that scenes share; a demo may add its own.
    """

    training: Training
    hyper: HyperReduction
    points: np.ndarray
    errors: PointErrors
    answers: list[tuple[int, bool]]
    times: dict[str, dict[str, np.ndarray]]
    work_precision: list[dict]
    settings: StudySettings
    report: dict = field(default_factory=dict)

    def write(self, folder: str | Path, console: Console | None = None, view: View | None = None) -> None:
        """Write and print the report, keep the model, draw the pictures of a view."""
        console, folder = console or make_console(), checked_folder(folder)
        write_report(self.report, folder)
        print_report(self.report, console)
        save_model(folder / "model.npz", self.hyper)
        if view is not None:
            from hhr_dolfinx.study.plots import draw_study

            draw_study(self, view, folder)
        console.print(f"report, pictures, fields and model are in {folder}")


def study_scene(
    scene: Scene,
    settings: StudySettings,
    folder: str | Path,
    *,
    points: np.ndarray | None = None,
    rivals: Callable[[Training], Iterable[Rival]] = lambda training: (),
    progress: Progress = silent,
) -> SceneStudy | None:
    """Train on all ranks, then build, measure and report on the first; None on the others.

    Args:
        scene: the scene.
        settings: what to measure.
        folder: where snapshots are kept and found again.
        points: test points, (n, P); None takes random ones.
        rivals: makes other approximations for the work-precision table.
        progress: for progress bars.

    Raises:
        StudyError: for a folder that is a file, or counts that do not suit the scene.
        ParameterError: for test points that are none.
        HHRError: if the reduced model under study is refused.
    """
    folder = checked_folder(folder)
    if points is not None:
        points = scene.parameters.points(points)
    training = train(
        scene,
        settings.training,
        held_out=settings.held_out,
        seed=settings.seed,
        folder=folder / "snapshots",
        progress=progress,
    )
    if MPI.COMM_WORLD.rank > 0:
        return None
    return run_study(training, settings, points, rivals=list(rivals(training)), progress=progress)


def run_study(
    training: Training,
    settings: StudySettings,
    points: np.ndarray | None = None,
    *,
    rivals: Sequence[Rival] = (),
    progress: Progress = silent,
) -> SceneStudy:
    """Build the reduced model, measure its errors and time it against all other models; see :func:`study_scene`.

    Raises:
        ValueError: if the full model is spread over ranks: what it is compared with is serial.
    """
    if training.full_order.comm.size > 1:
        raise ValueError("a study runs on one rank: give it a full model on MPI.COMM_SELF, as train does")
    space = training.full_order.problem.parameters
    points = space.random(settings.tests, settings.seed) if points is None else space.points(points)
    hyper = training.build(settings.reduction)
    yardstick = Yardstick.at(points, training.full_order, training.snapshots, progress("references"))
    errors = yardstick.errors(hyper, hyper.sets.A_lambda)
    solutions = (hyper.model.solve(point, raise_on_failure=False) for point in points)
    answers = [(solution.iterations, solution.cycled) for solution in solutions]
    fresh, others = (space.random(settings.queries + 5, settings.seed + k) for k in (1000, 4000))
    warm, cold = _models(training, hyper, settings.naive)
    times = {"warm": time_queries(warm, fresh), "cold": time_queries(cold, others)}
    rows = [_row("HHR", "this model", times["warm"]["online"], errors)]
    rows += [_variant(training, yardstick, fresh, *variant) for variant in progress("variants")(settings.variants)]
    for rival in progress("rivals")(rivals):
        seconds = time_queries({"rival": rival.model.solve}, fresh)["rival"]
        rows.append(_row(rival.method, rival.setting, seconds, yardstick.errors(rival.model)))
    rows += _exact_rows(training, yardstick, times["warm"])
    study = SceneStudy(training, hyper, points, errors, answers, times, rows, settings)
    report = make_report(study)
    if settings.models:
        models = {"default": model_report(hyper, errors, times["warm"]["online"])}
        for name, recipe in settings.models.items():
            other = training.build(recipe, checked=False)
            seconds = time_queries({"online": other.model.solve}, fresh)["online"]
            models[name] = model_report(other, yardstick.errors(other, other.sets.A_lambda), seconds)
        report["models"] = models
    return replace(study, report=report)


@dataclass(frozen=True)
class _FullOrderAnswers:
    """The full model as a rival: what it answers beside references that were solved from other statuses."""

    full_order: FullOrderModel

    def solve_everywhere(self, mu):
        """Displacement and forces, started cold."""
        solution = self.full_order.solve(mu)
        return solution.primal, solution.forces


@dataclass(frozen=True)
class _CondensedAnswers:
    """Exact condensation as a rival."""

    full_order: FullOrderModel
    model: CondensedContact

    def solve_everywhere(self, mu):
        """Displacement with its lift, and forces."""
        solution = self.model.solve(mu)
        return solution.primal + self.full_order.problem.lift(mu), solution.forces


def _exact_rows(training, yardstick, times) -> list[dict]:
    """Rows of the methods without reduction error: measured like the others, they show round-off."""
    full_order, known = training.full_order, training.snapshots.known_statuses()
    condensed = _CondensedAnswers(full_order, exact_condensation(full_order, known))
    answers = {"condensed": condensed, "fom_best": _FullOrderAnswers(full_order)}
    rows = [_row(name, "exact", times[name], yardstick.errors(model)) for name, model in answers.items()]
    if "fom_naive" in times:
        # the same statuses by another solver: what differs is round-off, which tests of the full order measure
        rows.append(_row("fom_naive", "exact", times["fom_naive"], yardstick.errors(answers["fom_best"])))
    return rows


def _models(training, hyper, with_naive) -> tuple[dict[str, Callable], dict[str, Callable]]:
    """All models by name, each started from the nearest known statuses and from none."""
    full_order, model, known = training.full_order, hyper.model, training.snapshots.known_statuses()

    def near(solve):
        return lambda point: solve(point, start=known.active[known.nearest(point)])

    def unaided(solve):
        return lambda point: solve(point, warm=False)

    def twin(factorise=PetscLU):
        """The model under study without what it kept from earlier queries."""
        return ReducedModel(model.problem, model.parameters, model.amplitudes, model.known, factorise)

    lapack = twin(LapackLU)
    forces_only, condensed = (exact_condensation(full_order, known, field=field) for field in (False, True))
    warm = {
        "fom_best": near(full_order.solve),
        "online": model.solve,
        "online_lapack": lapack.solve,
        "online_full": replace(hyper, model=twin()).solve_everywhere,
        "condensed": forces_only.solve,
        "condensed_full": condensed.solve,
    }
    cold = {
        "fom_best": full_order.solve,
        "online": unaided(model.solve),
        "online_lapack": unaided(lapack.solve),
        "condensed": unaided(forces_only.solve),
    }
    if with_naive:
        naive = NaiveFullOrder(full_order)
        warm["fom_naive"], cold["fom_naive"] = near(naive.solve), naive.solve
    else:
        hyper.log.skip("fom_naive", "not asked for: one query takes too long to measure a hundred")
    return warm, cold


def _variant(training, yardstick, fresh, label, recipe) -> dict:
    """Row of another recipe; a refused model is a row with its reason, a doubtful one has a warning."""
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", StabilityWarning)
            hyper = training.build(recipe)
    except HHRError as error:
        return {"method": "HHR", "setting": label, "refused": str(error)}
    errors = yardstick.errors(hyper, hyper.sets.A_lambda)
    seconds = time_queries({"online": hyper.model.solve}, fresh)["online"]
    size = f"{label} ({hyper.basis.shape[1]}+{len(hyper.sets.A_lambda)})"
    return _row("HHR", size, seconds, errors) | ({"warning": str(caught[0].message)} if caught else {})


def _row(method, setting, seconds, errors) -> dict:
    """Medians as in every scene, and the tails beside them."""
    row = {
        "method": method,
        "setting": setting,
        "online_s": float(np.median(seconds)),
        "unconverged": errors.unanswered,
    }
    for name in ("primal_l2", "dual_full_floored"):
        figures = summary(errors.values[name])
        row |= {name: figures["median"], f"{name}_p95": figures["p95"], f"{name}_max": figures["max"]}
    return row
