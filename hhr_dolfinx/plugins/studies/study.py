"""Error against run time of one scene: all models on the same queries in the same process."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from hhr_dolfinx import registry
from hhr_dolfinx.command.console import Console, make_console
from hhr_dolfinx.errors import HHRError, NotOfferedError, StabilityWarning, StudyError
from hhr_dolfinx.models.answer import Model
from hhr_dolfinx.models.answer import Path as HistoryPath
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.parameters import PointsLike
from hhr_dolfinx.plugins.studies.measure import Measurement, Report
from hhr_dolfinx.plugins.studies.of_laws import study_of
from hhr_dolfinx.plugins.studies.report import (
    errors_and_times,
    make_report,
    model_report,
    print_report,
    write_report,
)
from hhr_dolfinx.plugins.studies.settings import StudySettings, View
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.study.training.train import Progress, Training, checked_folder, train
from hhr_dolfinx.timing import lines_of
from hhr_dolfinx.warn import collected


@dataclass(frozen=True)
class Rival:
    """Another approximation to compare with, a baseline.

    Attributes:
        method, setting: its name, and what distinguishes it from others of the same method.
        model: any object with ``solve(mu)``, or ``march(path, settings)`` for bodies with laws,
            whose answers have ``displacement()`` (N,) and ``forces()`` (N_lambda,). The call is
            timed, the fields are compared. Or a function without arguments that makes one: its
            refusal is a row of the table.
    """

    method: str
    setting: str
    model: Model | Callable[[], Model]

    def made(self) -> Model:
        """The model."""
        given: Any = self.model
        made: Model = given if hasattr(given, "solve") or hasattr(given, "march") else given()
        return made


@dataclass(frozen=True)
class Study:
    """Measurements of a scene."""

    training: Training  #: full model and training answers
    #: the reduced model under study; the condensed one if hyper-reduction is refused
    model: KeptModel
    tests: np.ndarray | dict[Hashable, HistoryPath]  #: test points, (n, P), or paths by label
    measured: Measurement  #: errors and times of the model and of those compared with it
    settings: StudySettings  #: of the study
    report: Report  #: all figures under the keys that scenes share; a demo may add others

    def write(
        self, folder: str | Path, console: Console | None = None, view: View | None = None
    ) -> None:
        """Write report, model, pictures of a view and ``report.html``, and print the report.

        If the report advises condensation, that model is kept too, as ``condensed.npz``.

        Args:
            folder: folder of the files.
            console: console to print to; None makes one.
            view: points, units and components to draw; None draws nothing.
        """
        from hhr_dolfinx.online.model_file import save_model
        from hhr_dolfinx.plugins.studies.page import write_page

        console = console or make_console()
        folder = checked_folder(folder)
        write_report(self.report, folder)
        print_report(self.report, console)
        model = self.model
        save_model(folder / "study.npz", model)
        advised: Any = self.measured.models.get(self.report["advised"])
        if advised is not None and advised is not model:
            save_model(folder / "condensed.npz", advised)
        if view is not None:
            from hhr_dolfinx.plugins.studies.plots import draw_study

            try:
                draw_study(self, view, folder)
            except NotOfferedError as error:  # of a K without elements
                console.print(f"left out: pictures: {error}", markup=False)
        write_page(folder)
        console.print(f"report, pictures, fields and model are in {folder}", markup=False)


def study_scene(
    scene: Scene,
    settings: StudySettings,
    folder: str | Path,
    *,
    points: PointsLike | None = None,
    rivals: Callable[[Training], Iterable[Rival]] = lambda training: (),
    progress: Progress = lines_of,
) -> Study | None:
    """Train on all ranks, then build, measure and report on the first; None on the others.

    Args:
        scene, settings: the scene, and what to measure.
        folder: keeps training answers for later runs.
        points: test points, (n, P); None takes those of the settings.
        rivals: builds other approximations for the work-precision table.
        progress: for progress bars.

    Raises:
        StudyError: for a folder that is a file, or a training or tests that do not suit the scene.
        ParameterError: for invalid test points.
        HHRError: if the reduced model under study is refused, and the condensed one too.
    """
    folder = checked_folder(folder)
    _tests_of(scene, settings, points)
    training = train(
        scene,
        settings.training,
        held_out=settings.held_out,
        seed=settings.seed,
        folder=folder / "snapshots",
        march=settings.march,
        progress=progress,
    )
    if MPI.COMM_WORLD.rank > 0:
        return None
    return run_study(training, settings, points, rivals=list(rivals(training)), progress=progress)


def run_study(
    training: Training,
    settings: StudySettings,
    points: PointsLike | None = None,
    *,
    rivals: Sequence[Rival] = (),
    progress: Progress = lines_of,
) -> Study:
    """Build the reduced model, measure its errors and time it against all other models.

    See :func:`study_scene`.

    Args:
        training: training of the scene.
        settings: settings of the study.
        points: test points, (n, P); None takes those of the settings.
        rivals: other approximations for the work-precision table.
        progress: makes progress bars.

    Raises:
        ValueError: if the full model is distributed over ranks: the models compared with it are
            serial.
        ConvergenceError: if a full history does not converge, or no reduced one does.
    """
    full = training.full_order
    if full.comm.size > 1:
        raise ValueError(
            "a study runs on one rank: give it a full model on MPI.COMM_SELF, as train does"
        )
    tests = _tests_of(full.scene, settings, points)
    laws = study_of(full.scene)
    model: Any
    if isinstance(tests, dict):
        assert laws is not None
        model, measured = laws.measure(training, settings, tests, progress)
    else:
        from hhr_dolfinx.plugins.studies.points import (
            measure_points,
            model_of,
        )  # not needed for histories

        model, refused = model_of(training, settings.recipe)
        measured = measure_points(training, model, settings, tests, refused, progress)
    rows = [measured.own.as_report()]
    for label, recipe in progress("variants")(settings.variants):
        rows.append(_row(measured, "HHR", label, partial(training.build, recipe)))
    for rival in progress("rivals")(rivals):
        rows.append(_row(measured, rival.method, rival.setting, rival.made))
    rows += [*(row.as_report() for row in measured.others), *measured.refused]
    report = make_report(training, model, measured, rows, settings.seed)
    if measured.own.method == "condensed" and "models" not in report:
        report["models"] = {"condensed": errors_and_times(model, measured.own)}
    if (
        settings.models and "models" not in report
    ):  # a study of histories has its two models already
        report["models"] = {"default": model_report(model, measured.own)}
    for name, recipe in settings.models.items():
        built = training.build(recipe, checked=False)
        report["models"][name] = model_report(built, measured.beside("HHR", name, built))
    return Study(training, model, tests, measured, settings, report)


def rivals_of(names: Sequence[str]) -> Callable[[Training], Iterator[Rival]]:
    """Rivals of plug-ins by name, of a training.

    Args:
        names: their names; ``all`` takes all.

    Raises:
        StudyError: for a name that no installed plug-in has.
    """
    known = {name: place for name, (place, _) in registry.parts("rivals").items()}
    chosen = list(known) if "all" in names else list(names)
    if unknown := sorted(set(chosen) - set(known)):
        there = ", ".join(known) or "none, as no installed plug-in has any"
        raise StudyError(f"rivals {', '.join(unknown)} are unknown: all, or of {there}")

    def rivals(training: Training) -> Iterator[Rival]:
        for name in chosen:
            yield from registry.load(known[name])(training)

    return rivals


def _tests_of(
    scene: Scene, settings: StudySettings, points: PointsLike | None
) -> np.ndarray | dict[Hashable, HistoryPath]:
    """Test points, (n, P), or checked paths by label for bodies with laws.

    StudyError for the wrong kind.
    """
    tests: Any = settings.tests
    if scene.remembers:
        raise NotOfferedError(
            f"a study of scene '{scene.name}' is not built in, as its contacts remember their "
            "path: train or condense it, and march along your own paths"
        )
    if (laws := study_of(scene)) is not None:
        laws.check(settings)
        if points is None and isinstance(tests, Mapping):
            from hhr_dolfinx.plugins.paths.queries import training_paths

            return dict(zip(tests, training_paths(scene, tests.values()), strict=True))
        subject = f"tests = {tests!r}" if points is None else "points"
        raise StudyError(
            f"bodies of scene '{scene.name}' have laws: {subject} must be paths, tests={{label: "
            "path, ...}"
        )
    if settings.correction is not None:
        raise StudyError(
            f"bodies of scene '{scene.name}' are elastic: leave out the correction, which is for "
            "laws of bodies"
        )
    if points is not None:
        return scene.parameters.points(points)
    if isinstance(tests, Mapping):
        raise StudyError(
            f"bodies of scene '{scene.name}' are elastic: tests must be a number of random "
            "points, not paths"
        )
    return scene.parameters.random(tests, settings.seed)


def _row(measured: Measurement, method: str, setting: str, make: Callable[[], Model]) -> Report:
    """Row of another model; a refused one has the reason instead, an unreliable one a warning."""
    try:
        with collected(StabilityWarning) as caught:
            model = make()
        if isinstance(model, ReducedModel):
            setting = f"{setting} ({len(model.problem.stiffness)}+{len(model.problem.gaps)})"
        row = measured.beside(method, setting, model).as_report()
    except HHRError as error:
        return {"method": method, "setting": setting, "refused": str(error)}
    return row | ({"warning": caught[0].message} if caught else {})
