"""Error against run time at single parameters: all methods on the same points in the same
process.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.certify.accuracy import summary
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import (
    ConvergenceError,
    HHRError,
    NotOfferedError,
    NotSolvableError,
    StudyError,
)
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.linear.dense import Factorise, LapackLU, PetscLU
from hhr_dolfinx.models.answer import Answer, Model
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.estimates import Estimates
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.one_thread import one_thread
from hhr_dolfinx.plugins.studies.measure import MeasuredErrors, Measurement, References, Report, Row
from hhr_dolfinx.plugins.studies.settings import StudySettings
from hhr_dolfinx.reduction.exact import exact_condensation
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.study.training.train import Progress, Training
from hhr_dolfinx.timing import now

COMPARED = ("fom_naive", "fom_best", "condensed")
TIMED_METHODS = (
    *COMPARED,
    "condensed_full",
    "online",
    "online_forces",
    "online_lapack",
    "online_full",
)
COLD = (*COMPARED, "online", "online_lapack")

SAMPLED = {"displacement": "primal_energy", "forces": "dual_full_floored"}
"""Errors that a report keeps point by point, under their names in estimates."""

Query = Callable[[np.ndarray], object]
Queries = dict[str, Query]
"""Queries of a parameter by name."""
Times = dict[str, np.ndarray]
"""Seconds per query by name."""


WARM_UP = 5
"""Queries before the measurement."""


def time_queries(models: Mapping[str, Query], points: np.ndarray) -> dict[str, np.ndarray]:
    """Seconds per query of each model at every point, on one thread.

    No point is repeated, so that caches help no more than in use. The models alternate in blocks,
    so that a disturbance of the machine affects all of them. A query without an answer counts with
    its time.

    Args:
        models: solvers of one point by name.
        points: parameters, (n, P); the first ones are a warm-up.

    Returns:
        Times by name, (n - warm-up,).

    Raises:
        StudyError: for fewer points than the warm-up and one more.
    """
    if len(points) <= WARM_UP:
        raise StudyError(
            f"{len(points)} points cannot be timed: {WARM_UP} are a warm-up, give more"
        )
    measured = points[WARM_UP:]
    times: dict[str, list[float]] = {name: [] for name in models}
    with one_thread, _settled_memory():
        for solve in models.values():
            for point in points[:WARM_UP]:
                _query(solve, point)
        for block in np.array_split(measured, min(5, len(measured))):
            for name, solve in models.items():
                gc.collect()
                gc.disable()
                try:
                    for point in block:
                        start = now()
                        _query(solve, point)
                        times[name].append(now() - start)
                finally:
                    gc.enable()
    return {name: np.array(values) for name, values in times.items()}


def _query(solve: Query, point: np.ndarray) -> None:
    with suppress(ConvergenceError, NotSolvableError):
        solve(point)


@contextmanager
def _settled_memory() -> Iterator[None]:
    """Exclude existing objects from garbage collection in a block, which would take 0.1 s for each
    measurement.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def model_of(training: Training, recipe: Recipe | None) -> tuple[KeptModel, list[dict[str, str]]]:
    """Model under study: the hyper-reduced one, or the condensed one if that is refused.

    Args:
        training: training of the scene.
        recipe: recipe of the reduction; None takes the default.

    Returns:
        The model, and the reasons of a refusal.
    """
    try:
        return training.build(recipe), []
    except NotOfferedError as error:
        return training.condense(), [{"stage": "hyper-reduction", "why": str(error)}]


def measure_points(
    training: Training,
    model: KeptModel,
    settings: StudySettings,
    points: np.ndarray,
    refused: list[dict[str, str]],
    progress: Progress,
) -> Measurement:
    """Errors and times of the model under study, compared with all other models.

    Args:
        training: training of the scene.
        model: model under study.
        settings: settings of the study.
        points: test points, (n, P).
        refused: the reason if hyper-reduction, the usual model under study, was refused.
        progress: makes progress bars.
    """
    full = training.full_order
    space = training.full_order.parameters
    statuses = training.snapshots.known_statuses()
    references = References.at(points, full, training.snapshots, progress("references"))
    points = references.solutions.points
    answers = [model.solve(point, raise_on_failure=False, outside="ignore") for point in points]
    models, queries = _queries_of(full, model)
    skipped = list(refused)
    errors = {"fom_best": references.errors(full), "online": references.errors(model)}
    offline = {}
    compared = () if refused else _compared(training, statuses, skipped)
    if compared:
        forces_only, condensed = compared
        models["condensed"] = forces_only
        queries["condensed_full"] = _everywhere(condensed)
        errors["condensed"] = references.errors(condensed)
        if forces_only.offline is not None:
            offline = {"offline_condensed": dict(forces_only.offline.log.times)}
    baselines = _baselines(full, skipped) if settings.naive else {}
    models |= baselines
    # timed points belong neither to training nor to tests
    fresh, later = (space.random(settings.queries + 5, settings.seed + k) for k in (1000, 4000))
    warm = time_queries(_warm(models, statuses) | queries, fresh)
    cold = time_queries(
        {name: partial(solver.solve, start=None) for name, solver in models.items()}, later
    )

    def beside(method: str, setting: str, other: Model) -> Row:
        """Row of the model ``other`` by its method and setting."""
        errors = references.errors(other)
        return Row(method, setting, time_queries({"online": other.solve}, fresh)["online"], errors)

    errors |= {name: references.errors(solver) for name, solver in baselines.items()}
    if not baselines and not settings.naive:
        skipped.append({"stage": "fom_naive", "why": NOT_REQUESTED})
    report = _searches(answers) | {"samples": _samples(points, answers, errors["online"])}
    report |= _times(warm, cold, baselines, offline)
    report |= _mesh_error(full, skipped) | _outputs(full, references.solutions, answers)
    studied = Row("condensed" if refused else "HHR", "this model", warm["online"], errors["online"])
    kind = dict.fromkeys(baselines, "baseline") | ({"condensed": "interpolated"} if offline else {})
    order = [name for name in ("condensed", "fom_best", *baselines) if name in errors]
    rows = [Row(name, kind.get(name, "exact"), warm[name], errors[name]) for name in order]
    small: dict[str, Model] = {"condensed": model} if refused else {}
    small |= {name: models[name] for name in ("condensed",) if name in models}
    return Measurement(studied, rows, beside, report, skipped, models=small)


def _queries_of(full: FullOrderModel, model: KeptModel) -> tuple[dict[str, Model], Queries]:
    """The full model and that under study, and its queries of all forces, and of fields and forces,
    by name.
    """
    models: dict[str, Model] = {"fom_best": full, "online": model}
    if isinstance(model, ReducedModel):
        models["online_lapack"] = _twin(model, LapackLU)
    alone = _twin(model, PetscLU)
    queries: Queries = {
        "online_forces": lambda point: alone.solve(point).forces(),
        "online_full": _everywhere(_twin(model, PetscLU)),
    }
    return models, queries


def _searches(answers: list[Answer]) -> Report:
    """The ``active_set`` part of a report: iterations, and cycles of statuses."""
    iterations = [answer.iterations for answer in answers]
    searches = {
        "iterations_median": float(np.median(iterations)),
        "iterations_max": max(iterations),
        "cycles": sum(answer.cycled for answer in answers),
    }
    return {"active_set": searches}


def _samples(points: np.ndarray, answers: list[Answer], errors: MeasuredErrors) -> Report:
    """The ``samples`` part of a report: test points, errors there, and their estimates,
    relative.
    """
    samples: Report = {
        "points": points.tolist(),
        "errors": {name: errors.values[key].tolist() for name, key in SAMPLED.items()},
    }
    estimates = Estimates.of([answer.estimate() for answer in answers])
    if estimates is not None:
        bounds = {
            "displacement": estimates.primal_relative,
            "forces": estimates.forces_euclid_relative,
        }
        samples |= {
            "kind": estimates.kind,
            "bounds": {name: values.tolist() for name, values in bounds.items()},
        }
    return samples


def _mesh_error(full: FullOrderModel, skipped: list[dict[str, str]]) -> Report:
    """The ``discretisation`` part of a report; empty, with the reason, if it cannot be
    estimated.
    """
    try:
        mesh_error = registry.tool("mesh_error", "the error of the mesh")
        return {"discretisation": mesh_error(full, full.solve(full.parameters.middle))._asdict()}
    except HHRError as error:
        skipped.append({"stage": "discretisation", "why": str(error)})
        return {}


NOT_REQUESTED = "not requested: one query takes too long to measure a hundred"


def _baselines(full: FullOrderModel, skipped: list[dict[str, str]]) -> dict[str, Model]:
    """Baselines of plug-ins by name; those that are not for a scene have their reason."""
    if full.problem.kernel is not None:
        reason = "nothing but contact holds a body: without it K is singular"
        skipped.append({"stage": "fom_naive", "why": reason})
        return {}
    known = registry.parts("baselines")
    if not known:
        skipped.append({"stage": "fom_naive", "why": "no plug-in of baselines is installed"})
    made: dict[str, Model] = {}
    for name, (import_path, _) in known.items():
        try:
            made[name] = registry.load(import_path)(full)
        except HHRError as error:
            skipped.append({"stage": name, "why": str(error)})
    return made


def _compared(
    training: Training, known: KnownStatuses, skipped: list[dict[str, str]]
) -> tuple[CondensedModel, ...]:
    """Condensation with forces alone and with fields: exact, or interpolated if the stiffness
    varies.

    Empty, with the reason in ``skipped``, if the scene has none.
    """
    full = training.full_order
    if full.problem.varies:
        try:
            model: Any = training.condense()
        except NotOfferedError as error:
            skipped.append({"stage": "condensed", "why": str(error)})
            return ()
        return model, model
    return exact_condensation(full, known, field=False), exact_condensation(full, known, field=True)


def _warm(models: dict[str, Model], known: KnownStatuses) -> Queries:
    """Queries that start from the nearest training statuses, which full models need as an
    argument.
    """

    def near(solve: Callable[..., Answer]) -> Query:
        return lambda point: solve(point, start=known.active[known.nearest(point)])

    return {
        name: near(model.solve) if name.startswith("fom") else model.solve
        for name, model in models.items()
    }


def _everywhere(model: Model) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    def query(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        answer = model.solve(point)
        return answer.displacement(), answer.forces()

    return query


def _outputs(full: FullOrderModel, solutions: SnapshotSet, answers: list[Answer]) -> Report:
    """The ``outputs`` part of a report: errors relative to the largest absolute value.

    Infinite without an answer.
    """
    if full.functionals is None:
        return {}
    exact = []
    for point, unknown, forces in zip(
        solutions.points, solutions.displacements.T, solutions.forces.T, strict=True
    ):
        exact.append(
            Answer(point, unknown, forces, forces > 0, 0, Status.CONVERGED, False, full).outputs()
        )
    reduced = [answer.outputs() for answer in answers]
    report = {}
    for name, unit in exact[0].units.items():
        values, reduced_values = (
            np.array([outputs[name] for outputs in group]) for group in (exact, reduced)
        )
        largest = float(np.abs(values).max())
        errors = np.abs(reduced_values - values) / (largest or 1.0)
        report[name] = {
            "unit": unit,
            "largest": largest,
            **summary(np.where(np.isfinite(errors), errors, np.inf)),
        }
    return {"outputs": report}


def _twin(model: KeptModel, factorise: Factorise) -> KeptModel:
    """A model without results kept from earlier queries, of which a condensed one keeps none."""
    if not isinstance(model, ReducedModel):
        return model
    return model.changed(trained=None, factorise=factorise)


def _times(warm: Times, cold: Times, baselines: Iterable[str], offline: Report) -> Report:
    """The ``times`` and ``ratios`` parts of a report, from the usual and from no initial statuses.

    ``offline`` has the stages of models that were made for the comparison.
    """
    return {
        "times": {
            **_summaries(warm, (*TIMED_METHODS, *baselines)),
            "cold_start": _summaries(cold, (*COLD, *baselines)),
            **offline,
        },
        "ratios": {**_ratios(warm, baselines), "cold_start": _ratios(cold, baselines)},
    }


def _summaries(times: Times, names: tuple[str, ...]) -> Report:
    """Summaries by name; null for a model that was not run."""
    return {name: summary(times[name]) if name in times else None for name in names}


def _ratios(times: Times, baselines: Iterable[str]) -> dict[str, float | None]:
    """Median times over that of the reduced model; null for a model that was not run."""
    online = np.median(times["online"])
    names = (*COMPARED, *baselines)
    return {
        f"{name}/online": float(np.median(times[name]) / online) if name in times else None
        for name in names
    }
