"""Error against run time of one scene: every model on the same points in the same process.

In the package only this module and ``offline`` hold a clock.
"""

from __future__ import annotations

import gc
import math
import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from threadpoolctl import threadpool_limits

from hhr_dolfinx.baselines.condensation import exact_condensation
from hhr_dolfinx.baselines.naive import NaiveFullOrder
from hhr_dolfinx.contact.dense import LapackLU, PetscLU
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ConvergenceError, HHRError, NotSolvableError, StabilityWarning
from hhr_dolfinx.full_order.elastic import FullOrderModel
from hhr_dolfinx.reduction.offline import HyperReduction, ReductionSettings, build_reduced_model
from hhr_dolfinx.reduction.reduced import ReducedModel
from hhr_dolfinx.reduction.trust import TrustLimits
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.snapshots.accuracy import energy_minimum, force_floor, relative_error, summary
from hhr_dolfinx.snapshots.solutions import SnapshotSet, spread_snapshots
from hhr_dolfinx.snapshots.store import SnapshotStore

Progress = Callable[[Iterable], Iterable]

DEFAULT_RECIPE = ReductionSettings()


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
    """What to measure.

    Attributes:
        reduction: the recipe under study.
        variants: further recipes by label, for the work-precision table.
        queries: timed queries per model, at least 100 for a figure to quote.
        seed: seed of the parameters that are timed; they are neither trained nor tested on.
        naive: whether to time the naive full order too; in space one of its queries takes many seconds.
    """

    reduction: ReductionSettings = ReductionSettings()
    variants: Sequence[tuple[str, ReductionSettings]] = ()
    queries: int = 200
    seed: int = 1
    naive: bool = True


@dataclass(frozen=True)
class Training:
    """A full model with the solutions to train and to check reduced models.

    Attributes:
        full_order: the full model, on one rank.
        snapshots: training solutions.
        held_out: solutions for the trust check.
        stages: seconds of each stage.
    """

    full_order: FullOrderModel
    snapshots: SnapshotSet
    held_out: SnapshotSet
    stages: dict[str, float]

    def build(self, recipe: ReductionSettings = DEFAULT_RECIPE, *, checked: bool = True) -> HyperReduction:
        """A reduced model; unchecked it is built as it is, to be measured: no warning, no growth of its RID.

        Only what cannot be solved at all is refused even so: dependent contact rows, a singular K~.
        """
        problem, schur = self.full_order.problem, self.full_order.schur
        if checked:
            return build_reduced_model(problem, schur, self.snapshots, recipe, self.held_out)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StabilityWarning)
            unlimited = TrustLimits(refuse_cond_K=math.inf, refuse_inf_sup=-1.0)
            as_it_is = replace(recipe, limits=unlimited, most_layers=recipe.layers)
            return build_reduced_model(problem, schur, self.snapshots, as_it_is)


def train(
    scene: Scene,
    counts: Sequence[int],
    *,
    held_out: int = 40,
    seed: int = 1,
    folder: Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Callable[[str], Progress] = lambda _: iter,
) -> Training:
    """Build the full model of a scene on each rank and share the training parameters out over the ranks.

    Args:
        scene: the scene.
        counts: training points along each parameter, on a regular grid.
        held_out: random parameters for the trust check.
        seed: seed of these.
        folder: where solutions are kept and found again; None keeps nothing.
        comm: communicator over which the parameters are spread.
        progress: maps a label to a wrapper of iterations, for progress bars.
    """
    stages, start = {}, time.perf_counter()
    full_order = FullOrderModel(scene, MPI.COMM_SELF)
    stages["full_order"] = time.perf_counter() - start
    store = None if folder is None else SnapshotStore(folder, full_order.problem)
    space, sets = scene.parameters, {}
    for name, points in (("snapshots", space.grid(counts)), ("held_out", space.random(held_out, seed + 2000))):
        start = time.perf_counter()
        sets[name] = spread_snapshots(full_order, points, comm, progress(name.replace("_", " ")), store)
        stages[name] = time.perf_counter() - start
    return Training(full_order, sets["snapshots"], sets["held_out"], stages)


@dataclass(frozen=True)
class References:
    """Full-order answers at the test points.

    Attributes:
        points: test points, (n, P).
        displacements: (n, N).
        forces: (n, N_lambda).
        floor: force norm below which a relative error means nothing.
    """

    points: np.ndarray
    displacements: np.ndarray
    forces: np.ndarray
    floor: float


@dataclass(frozen=True)
class PointErrors:
    """Errors at every test point, in the order of the points; each entry (n,)."""

    values: dict[str, np.ndarray]
    iterations: np.ndarray
    cycles: int
    false_contact: int
    unconverged: int

    def summaries(self) -> dict:
        """The ``errors`` part of a report."""
        return {name: summary(values) for name, values in self.values.items()}


@dataclass(frozen=True)
class StudyResult:
    """Measurements of a study; :mod:`hhr_dolfinx.study.report` turns them into a file.

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


def solve_references(
    full_order: FullOrderModel, snapshots: SnapshotSet, points, progress: Progress = iter
) -> References:
    """Solve the full model at the test points.

    Args:
        full_order: the full model.
        snapshots: training solutions, whose largest force sets the floor of relative errors.
        points: test points, (n, P).
        progress: wraps the iteration, for a progress bar.
    """
    solutions = [full_order.solve(point) for point in progress(points)]
    return References(
        np.asarray(points),
        np.stack([solution.primal for solution in solutions]),
        np.stack([solution.forces for solution in solutions]),
        force_floor(full_order.problem, snapshots.points, snapshots.forces),
    )


def measure_errors(problem: ContactProblem, hyper: HyperReduction, references: References) -> PointErrors:
    """Compare the reduced with the full model at every point; no point is dropped.

    ``*_floored`` divides by at least 1e-3 of the largest training force norm, since a relative error means
    nothing near grazing contact. ``*_rid`` looks at A_lambda, ``*_full`` at the whole contact surface after
    reconstruction. A point without an answer has infinite errors.
    """
    rows, solutions, false_contact = [], [], 0
    for point, exact, exact_forces in zip(references.points, references.displacements, references.forces, strict=True):
        theta = problem.amplitudes(problem.parameters.point(point))
        solution = hyper.model.solve(point, raise_on_failure=False)
        solutions.append(solution)
        if not solution.converged:
            rows.append(None)
            continue
        displacement = hyper.reconstruction.displacement(solution.primal, theta)
        try:
            forces = hyper.reconstruction.forces(solution, theta)
        except ConvergenceError:
            rows.append(None)
            continue
        energies = (energy_minimum(problem, field, theta) for field in (displacement, exact))
        inside = exact_forces[hyper.sets.A_lambda]
        rows.append(
            _field_errors(problem, references.floor, displacement, forces, exact, exact_forces)
            | {
                "energy_minimum": abs(next(energies) - next(energies)),
                "dual_rid": relative_error(solution.forces, inside),
                "dual_rid_floored": relative_error(solution.forces, inside, floor=references.floor),
            }
        )
        false_contact += bool(((forces > references.floor) & (exact_forces == 0)).any())
    names = next((row.keys() for row in rows if row is not None), ("primal_l2", "dual_full_floored"))
    values = {name: np.array([np.inf if row is None else row[name] for row in rows]) for name in names}
    return PointErrors(
        values,
        np.array([solution.iterations for solution in solutions]),
        sum(solution.cycled for solution in solutions),
        false_contact,
        sum(row is None for row in rows),
    )


def _field_errors(problem, floor, displacement, forces, exact, exact_forces) -> dict[str, float]:
    return {
        "primal_l2": relative_error(displacement, exact, problem.mass),
        "primal_energy": relative_error(displacement, exact, problem.stiffness),
        "primal_euclid": relative_error(displacement, exact),
        "dual_full": relative_error(forces, exact_forces),
        "dual_full_floored": relative_error(forces, exact_forces, floor=floor),
    }


def time_queries(models: dict[str, Callable], points: np.ndarray) -> dict[str, np.ndarray]:
    """Seconds per query of each model at every point, (len(points) less a warm-up,), on one thread.

    No point is asked twice, so that nothing kept from an earlier query helps more than it would in use. The
    models take turns in blocks, so that a disturbance of the machine hits all of them. A query without an answer
    counts with the time it took.
    """
    warm_up, timed = points[:5], points[5:]
    times: dict[str, list[float]] = {name: [] for name in models}
    with threadpool_limits(1):
        for solve in models.values():
            for point in warm_up:
                with suppress(ConvergenceError, NotSolvableError):
                    solve(point)
        for block in np.array_split(timed, min(5, len(timed))):
            for name, solve in models.items():
                gc.collect()
                gc.disable()
                try:
                    for point in block:
                        start = time.perf_counter()
                        with suppress(ConvergenceError, NotSolvableError):
                            solve(point)
                        times[name].append(time.perf_counter() - start)
                finally:
                    gc.enable()
    return {name: np.array(values) for name, values in times.items()}


def run_study(
    full_order: FullOrderModel,
    snapshots: SnapshotSet,
    points: np.ndarray,
    settings: StudySettings = StudySettings(),
    *,
    held_out: SnapshotSet | None = None,
    rivals: Sequence[Rival] = (),
    progress: Callable[[str], Progress] = lambda _: iter,
) -> StudyResult:
    """Build the reduced model, measure its errors and time it against all other models.

    Args:
        full_order: the full model; on several ranks the serial baselines are left out.
        snapshots: training solutions.
        points: test points, (n, P).
        settings: what to measure.
        held_out: solutions for the trust check of the model under study.
        rivals: other approximations for the work-precision table.
        progress: maps a label to a wrapper of iterations, for progress bars.

    Raises:
        HHRError: if the reduced model under study is refused.
    """
    problem = full_order.problem
    hyper = build_reduced_model(problem, full_order.schur, snapshots, settings.reduction, held_out)
    references = solve_references(full_order, snapshots, points, progress("references"))
    errors = measure_errors(problem, hyper, references)
    fresh, others = (problem.parameters.random(settings.queries + 5, settings.seed + k) for k in (1000, 4000))
    warm, cold = _models(full_order, hyper, snapshots, settings.naive)
    times = {"warm": time_queries(warm, fresh), "cold": time_queries(cold, others)}
    rows = [_row("HHR", "this model", times["warm"]["online"], errors.values)]
    for label, recipe in progress("variants")(settings.variants):
        rows.append(_variant(full_order, snapshots, references, label, recipe, fresh))
    for rival in progress("rivals")(rivals):
        rows.append(_rival(problem, references, rival, fresh))
    for name in ("condensed", "fom_best", "fom_naive"):
        if name in times["warm"]:
            rows.append(_row(name, "exact", times["warm"][name], {"primal_l2": [0.0], "dual_full_floored": [0.0]}))
    return StudyResult(hyper, references.points, errors, times, rows)


def _models(full_order, hyper, snapshots, with_naive) -> tuple[dict[str, Callable], dict[str, Callable]]:
    """All models by name, each started from the nearest known statuses and from none."""
    known, problem, model = snapshots.known_statuses, full_order.problem, hyper.model

    def near(solve):
        return lambda point: solve(point, start=known.active[known.nearest(point)])

    def unaided(solve):
        return lambda point: solve(point, warm=False)

    def twin(factorise=PetscLU):
        """The model under study without what it kept from earlier queries."""
        return ReducedModel(model.problem, problem.parameters, problem.amplitudes, model.known, factorise)

    lapack = twin(LapackLU)
    warm = {
        "fom_best": near(full_order.solve),
        "online": model.solve,
        "online_lapack": lapack.solve,
        "online_full": replace(hyper, model=twin()).solve_everywhere,
    }
    cold = {"fom_best": full_order.solve, "online": unaided(model.solve), "online_lapack": unaided(lapack.solve)}
    if full_order.comm.size > 1:
        hyper.log.skip("fom_naive, condensed", f"serial baselines, run on {full_order.comm.size} ranks")
        return warm, cold
    forces_only = exact_condensation(full_order, known, field=False)
    condensed = exact_condensation(full_order, known)
    warm |= {"condensed": forces_only.solve, "condensed_full": condensed.solve}
    cold |= {"condensed": unaided(forces_only.solve)}
    if with_naive:
        naive = NaiveFullOrder(full_order)
        warm["fom_naive"], cold["fom_naive"] = near(naive.solve), naive.solve
    else:
        hyper.log.skip("fom_naive", "not asked for: one query takes too long to measure a hundred")
    return warm, cold


def _variant(full_order, snapshots, references, label, recipe, fresh) -> dict:
    """Row of another recipe; a refused model is a row with its reason, a doubtful one has a warning."""
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", StabilityWarning)
            hyper = build_reduced_model(full_order.problem, full_order.schur, snapshots, recipe)
        errors = measure_errors(full_order.problem, hyper, references)
        times = time_queries({"online": hyper.model.solve}, fresh)["online"]
    except HHRError as error:
        return {"method": "HHR", "setting": label, "refused": str(error)}
    size = f"{label} ({hyper.basis.shape[1]}+{len(hyper.sets.A_lambda)})"
    row = _row("HHR", size, times, errors.values) | {"unconverged": errors.unconverged}
    return row | ({"warning": str(caught[0].message)} if caught else {})


def _rival(problem, references, rival, fresh) -> dict:
    """Row of another method."""
    rows = []
    for point, exact, exact_forces in zip(references.points, references.displacements, references.forces, strict=True):
        displacement, forces = rival.model.solve_everywhere(point)
        rows.append(_field_errors(problem, references.floor, displacement, forces, exact, exact_forces))
    values = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return _row(rival.method, rival.setting, time_queries({"online": rival.model.solve}, fresh)["online"], values)


def _row(method, setting, times, values) -> dict:
    """Medians as in every scene, and the tails beside them."""
    row = {"method": method, "setting": setting, "online_s": float(np.median(times))}
    for name in ("primal_l2", "dual_full_floored"):
        row[name] = summary(values[name])["median"]
        row[f"{name}_p95"] = summary(values[name])["p95"]
        row[f"{name}_max"] = summary(values[name])["max"]
    return row
