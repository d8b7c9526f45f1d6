"""Error against run time of one scene: every model on the same points in the same process.

Only this module and ``offline`` hold a clock.
"""

from __future__ import annotations

import gc
import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from threadpoolctl import threadpool_limits

from hhr_dolfinx.accuracy import FORCE_FLOOR, energy_minimum, relative_error, summary
from hhr_dolfinx.baselines import NaiveFullOrder, exact_condensation
from hhr_dolfinx.errors import HHRError, StabilityWarning
from hhr_dolfinx.full_order import FullOrderModel
from hhr_dolfinx.offline import HyperReduction, ReductionSettings, build_reduced_model
from hhr_dolfinx.snapshots import SnapshotSet

Progress = Callable[[Iterable], Iterable]


@dataclass(frozen=True)
class StudySettings:
    """What to measure.

    Attributes:
        reduction: the recipe under study.
        sizes: POD tolerances of the further models in the work-precision table.
        queries: timed queries per model, at least 100 for a figure to quote.
    """

    reduction: ReductionSettings = ReductionSettings()
    sizes: Sequence[float] = (1e-4, 1e-5, 1e-6, 1e-7, 1e-9, 1e-10)
    queries: int = 200


@dataclass(frozen=True)
class PointErrors:
    """Errors at every test point, in the order of the points; each entry (n,)."""

    values: dict[str, np.ndarray]
    iterations: np.ndarray
    cycles: int
    false_contact: int

    def summaries(self) -> dict:
        """The ``errors`` part of a report."""
        return {name: summary(values) for name, values in self.values.items()}


@dataclass(frozen=True)
class StudyResult:
    """Measurements of a study; :mod:`hhr_dolfinx.report` turns them into a file.

    Attributes:
        hyper: the reduced model under study.
        points: test points, (n, P).
        errors: errors of the reduced model at the test points.
        times: seconds per query of each model, started warm and cold.
        work_precision: rows of the error-against-time table.
    """

    hyper: HyperReduction
    points: np.ndarray
    errors: PointErrors
    times: dict[str, dict[str, np.ndarray]]
    work_precision: list[dict] = field(default_factory=list)


def measure_errors(
    full_order: FullOrderModel,
    hyper: HyperReduction,
    snapshots: SnapshotSet,
    points,
    progress: Progress = iter,
) -> PointErrors:
    """Compare the reduced with the full model at every point; no point is dropped.

    ``*_floored`` divides by at least 1e-3 of the largest training force norm, since a relative
    error means nothing near grazing contact. ``*_rid`` looks at A_lambda, ``*_full`` at the whole
    contact surface after reconstruction.
    """
    problem, inside = full_order.problem, hyper.sets.A_lambda
    floor = FORCE_FLOOR * np.linalg.norm(snapshots.forces, axis=0).max()
    rows, iterations, cycles, false_contact = [], [], 0, 0
    for point in progress(points):
        reference = full_order.solve(point)
        theta = problem.amplitudes(problem.parameters.point(point))
        solution = hyper.model.solve(point)
        displacement = hyper.reconstruction.displacement(solution.primal, theta)
        forces = hyper.reconstruction.forces(solution, theta)
        rows.append(
            {
                "primal_l2": relative_error(displacement, reference.primal, problem.mass),
                "primal_energy": relative_error(displacement, reference.primal, problem.stiffness),
                "primal_euclid": relative_error(displacement, reference.primal),
                "energy_minimum": abs(
                    energy_minimum(problem, displacement, theta) - energy_minimum(problem, reference.primal, theta)
                ),
                "dual_rid": relative_error(solution.forces, reference.forces[inside]),
                "dual_rid_floored": relative_error(solution.forces, reference.forces[inside], floor=floor),
                "dual_full": relative_error(forces, reference.forces),
                "dual_full_floored": relative_error(forces, reference.forces, floor=floor),
            }
        )
        iterations.append(solution.iterations)
        cycles += solution.cycled
        false_contact += bool(((forces > floor) & (reference.forces == 0)).any())
    values = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return PointErrors(values, np.array(iterations), cycles, false_contact)


def time_queries(models: dict[str, Callable], points: np.ndarray, queries: int) -> dict[str, np.ndarray]:
    """Seconds per query of each model, (queries,) each, on one thread after a warm-up.

    The models take turns in blocks, so that a disturbance of the machine hits all of them.
    """
    blocks = 5
    per_block = -(-queries // blocks)
    turns = np.resize(np.arange(len(points)), per_block * blocks).reshape(blocks, per_block)
    times: dict[str, list[float]] = {name: [] for name in models}
    with threadpool_limits(1):
        for block in turns:
            for name, solve in models.items():
                for k in block[:3]:
                    solve(points[k])
                gc.collect()
                gc.disable()
                try:
                    for k in block:
                        start = time.perf_counter()
                        solve(points[k])
                        times[name].append(time.perf_counter() - start)
                finally:
                    gc.enable()
    return {name: np.array(values[:queries]) for name, values in times.items()}


def run_study(
    full_order: FullOrderModel,
    snapshots: SnapshotSet,
    points: np.ndarray,
    settings: StudySettings = StudySettings(),
    progress: Callable[[str], Progress] = lambda _: iter,
) -> StudyResult:
    """Build the reduced model, measure its errors and time it against all other models.

    Args:
        full_order: the full model; on several ranks the serial baselines are left out.
        snapshots: training solutions.
        points: test points, (n, P).
        settings: what to measure.
        progress: maps a label to a wrapper of iterations, for progress bars.

    Raises:
        HHRError: if the reduced model under study is refused.
    """
    hyper = build_reduced_model(full_order.problem, full_order.schur, snapshots, settings.reduction)
    errors = measure_errors(full_order, hyper, snapshots, points, progress("errors"))
    warm, cold = _models(full_order, hyper, snapshots)
    times = {
        start: time_queries(models, points, settings.queries) for start, models in (("warm", warm), ("cold", cold))
    }
    result = StudyResult(hyper, points, errors, times)
    return replace(result, work_precision=_work_precision(full_order, snapshots, result, settings, progress))


def _models(full_order, hyper, snapshots) -> tuple[dict[str, Callable], dict[str, Callable]]:
    """All models by name, each started from the nearest known statuses and from none."""
    known = snapshots.known_statuses

    def near(solve):
        return lambda point: solve(point, start=known.active[known.nearest(point)])

    def unaided(solve):
        return lambda point: solve(point, warm=False)

    warm = {
        "fom_best": near(full_order.solve),
        "online": hyper.model.solve,
        "online_full": hyper.solve_everywhere,
    }
    cold = {"fom_best": full_order.solve, "online": unaided(hyper.model.solve)}
    if full_order.comm.size > 1:
        hyper.log.skip("fom_naive, condensed", f"serial baselines, run on {full_order.comm.size} ranks")
        return warm, cold
    naive, condensed = NaiveFullOrder(full_order), exact_condensation(full_order, known)
    warm |= {"fom_naive": near(naive.solve), "condensed": condensed.solve}
    cold |= {"fom_naive": naive.solve, "condensed": unaided(condensed.solve)}
    return warm, cold


def _work_precision(full_order, snapshots, result, settings, progress) -> list[dict]:
    """One row per method and setting; a refused model is a row with its reason."""
    rows = [_row("HHR", settings.reduction.pod_tolerance, result.times["warm"]["online"], result.errors)]
    for tolerance in progress("sizes")(settings.sizes):
        recipe = replace(settings.reduction, pod_tolerance=tolerance)
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", StabilityWarning)
                hyper = build_reduced_model(full_order.problem, full_order.schur, snapshots, recipe)
            errors = measure_errors(full_order, hyper, snapshots, result.points)
        except HHRError as error:
            rows.append({"method": "HHR", "setting": _setting(tolerance), "refused": str(error)})
            continue
        times = time_queries({"online": hyper.model.solve}, result.points, settings.queries)
        row = _row("HHR", tolerance, times["online"], errors)
        rows.append(row | ({"warning": str(caught[0].message)} if caught else {}))
    for name in ("condensed", "fom_best", "fom_naive"):
        if name in result.times["warm"]:
            seconds = float(np.median(result.times["warm"][name]))
            exact = {"setting": "exact", "online_s": seconds, "primal_l2": 0.0, "dual_full_floored": 0.0}
            rows.append({"method": name, **exact})
    return rows


def _row(method, tolerance, times, errors):
    return {
        "method": method,
        "setting": _setting(tolerance),
        "online_s": float(np.median(times)),
        "primal_l2": float(np.median(errors.values["primal_l2"])),
        "dual_full_floored": float(np.median(errors.values["dual_full_floored"])),
    }


def _setting(tolerance):
    return f"eps={tolerance:.0e}"
