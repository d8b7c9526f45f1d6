"""Interpolated condensation, offline: solve for S and the free slack at few parameters, and interpolate between them.

Each part of a scene that hangs together is solved for by itself, at parameters that its own sparse grid asks for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.certify.accuracy import force_floor
from hhr_dolfinx.certify.compare import Comparison, compare_points
from hhr_dolfinx.certify.trust import TrustLimits, check_comparison
from hhr_dolfinx.contact.active_set import Pairs
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.formulas import Modulus, Scalar
from hhr_dolfinx.linear.sparse import FreeCholesky
from hhr_dolfinx.models.block_elimination import BlockElimination
from hhr_dolfinx.models.interpolated import Compliance, Compliances, InterpolatedFields
from hhr_dolfinx.models.interpolation import GrownGrid, Interpolant, grow
from hhr_dolfinx.models.starts import LinearStarts
from hhr_dolfinx.models.varying import VaryingModel, answer_of
from hhr_dolfinx.reduction.projection import project
from hhr_dolfinx.reduction.recipe import Pod
from hhr_dolfinx.sampling import Sobol
from hhr_dolfinx.snapshots.records import SnapshotSet, check_of_problem
from hhr_dolfinx.timing import StageLog

Progress = Callable[[Iterable], Iterable]

STARTS = 256
"""Points at which statuses are known beforehand: four times as many save a tenth of the iterations on the pellet."""
FIELD_TOLERANCE = 1e-13
"""Part of the squared sum of displacements that the basis of the fields may leave out."""
NO_FIELDS: Any = None
"""Fields of answers that nobody asks for any."""


@dataclass(frozen=True)
class GridSettings:
    """How far a sparse grid grows.

    Attributes:
        tolerance: wished error of S and of the free slack, relative to their size.
        budget: most solutions for each part of a scene that hangs together.
    """

    tolerance: float = 1e-5
    budget: int = 200

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < 1 or self.budget < 1:
            raise ReductionError(
                f"tolerance = {self.tolerance} of an interpolation must lie in (0, 1), and its budget = {self.budget} "
                "must be positive"
            )


@dataclass(frozen=True)
class Component:
    """What of a scene hangs together.

    Attributes:
        dofs: its dofs that are free, as a mask, (N,).
        conditions: contact conditions that act on it.
        forced, lifted: terms of θ whose loads or imposed displacements act on it.
        factor: the modulus that all of it shares; None for none.
        axes: parameters on which the rest depends.
    """

    dofs: np.ndarray
    conditions: np.ndarray
    forced: np.ndarray
    lifted: np.ndarray
    factor: Scalar | None
    axes: np.ndarray


@dataclass(frozen=True)
class CondensedRecord:
    """How interpolated condensation was made.

    Attributes:
        settings: how far its grids were to grow.
        evaluations: solutions of the parts of the scene, one number for each grid.
        surpluses: what the terms tried last would have changed, relative.
        comparison: what users get beside answers that are known; None where there were none.
        log: seconds of the stages.
    """

    settings: GridSettings
    evaluations: list[int]
    surpluses: list[float]
    comparison: Comparison | None
    log: StageLog


def condense(
    full: Any,
    snapshots: SnapshotSet,
    settings: GridSettings = GridSettings(),
    held_out: SnapshotSet | None = None,
) -> VaryingModel:
    """Build a model that keeps all contact conditions and interpolates what is behind them.

    Args:
        full: the full model, on one rank, whose stiffness depends on parameters.
        snapshots: answers whose displacements span the fields; the contact forces do not need them.
        settings: how far the sparse grids grow.
        held_out: answers the model is compared with.

    Raises:
        ReductionError: for a scene whose stiffness is constant, or that flows.
    """
    problem: ContactProblem = full.problem
    if full.equilibrium is not None or not problem.varies:
        raise ReductionError(
            f"the stiffness of scene '{full.scene.name}' does not depend on parameters, or its bodies flow: interpolated "
            "condensation is for elastic bodies that vary; take exact_condensation"
        )
    problem.require_whole()
    check_of_problem("snapshots", snapshots, problem)
    log = StageLog()
    with log.stage("compliances"):
        compliances, grids = interpolated_compliances(full, settings)
    with log.stage("fields"):
        fields = _fields(full, snapshots)
    with log.stage("starts"):
        points = Sobol(STARTS).points(problem.parameters)
        known = _starts(compliances, points, problem.contact_pairs)
    model = VaryingModel(full.parameters, compliances, known, fields, problem.contact_pairs)
    comparison = None
    if held_out is not None:
        with log.stage("validation"):
            comparison = compare_points(full, model, held_out, force_floor(problem, snapshots))
            check_comparison(comparison, TrustLimits())
    numbers = [grid.evaluations for grid in grids], [grid.surplus for grid in grids]
    model.offline = CondensedRecord(settings, *numbers, comparison, log)
    return model


def _fields(full: Any, snapshots: SnapshotSet) -> InterpolatedFields:
    """Galerkin's method on what snapshots span, body by body."""
    problem: ContactProblem = full.problem
    basis = Pod(FIELD_TOLERANCE, relative=True, by_body=True).modes(problem, snapshots)
    every = np.flatnonzero(problem.free)
    conditions = np.arange(len(problem.gaps))
    sets = IndexSets(np.arange(len(problem.cell_nodes)), every, conditions, every, every, np.zeros(0, dtype=np.int64))
    galerkin = BlockElimination(project(problem, basis, sets), problem.amplitudes)
    rest = galerkin, problem.block_size, full.stress_of, full.functionals
    return InterpolatedFields(problem.amplitudes, basis, problem.lifts, *rest)


def _starts(compliances: Compliances, points: np.ndarray, pairs: np.ndarray) -> LinearStarts:
    """Statuses at some points and how they change, by the model itself."""
    found = []
    for point in points:
        elimination = compliances(point)
        answer = answer_of(elimination, point, None, Pairs.of(pairs), NO_FIELDS, gradient=True)
        if answer.gradient is not None:
            slack = elimination.free_slack + elimination.schur @ answer.multipliers
            margins = np.where(answer.active, answer.multipliers, -slack)
            changes = np.where(answer.active[:, None], answer.gradient.multipliers, -answer.gradient.slack)
            found.append((point, answer.active, margins, changes))
    if not found:
        raise ReductionError("no point of the box has an answer: contact rows are dependent, or the box is empty")
    return LinearStarts(*(np.array(part) for part in zip(*found, strict=True)))


def components_of(problem: ContactProblem) -> list[Component]:
    """What hangs together in a scene, as far as it touches anything."""
    names = problem.parameters.names
    found = []
    shape_axes = () if problem.reshaped is None else problem.reshaped.axes
    for body in problem.bodies:
        dofs = np.zeros(problem.free.size, dtype=bool)
        dofs[body] = problem.free[body]
        conditions = np.flatnonzero(np.diff(problem.contact[:, dofs].indptr))
        if not conditions.size:
            continue
        own = [k for k, term in enumerate(problem.stiffness_terms) if term[np.flatnonzero(dofs)].count_nonzero()]
        moduli = [problem.moduli[k] for k in own] if problem.moduli else []
        factor, rests = _common_factor(moduli)
        named = {name for scalar in rests for name in scalar.formula.variables}
        axes = sorted({names.index(name) for name in named} | set(shape_axes))
        forced = _acting(problem.external, dofs)
        lifted = _acting(sum((abs(term) for term in problem.lift_terms), csc_matrix(problem.loads.shape)), dofs)
        given = dofs, conditions, forced, lifted, factor, np.array(axes, dtype=np.int64)
        found.append(Component(*given))
    return found


def _acting(columns: csc_matrix, dofs: np.ndarray) -> np.ndarray:
    """Columns with entries on some dofs."""
    return np.flatnonzero(np.diff(csc_matrix(columns[dofs]).indptr))


def _common_factor(moduli: list[Modulus]) -> tuple[Scalar | None, list[Scalar]]:
    """The factor that all parts share, if it is one that varies, and what is left of each."""
    factors = {modulus.factor for modulus in moduli}
    if len(factors) == 1:
        factor = moduli[0].factor_scalar
        return factor if factor.formula.variables else None, [modulus.rest_scalar for modulus in moduli]
    return None, [scalar for modulus in moduli for scalar in (modulus.factor_scalar, modulus.rest_scalar)]


def interpolated_compliances(
    full: Any, settings: GridSettings, progress: Progress = iter
) -> tuple[Compliances, list[GrownGrid]]:
    """Solve for and interpolate all that contact needs of a full model; on one rank."""
    problem: ContactProblem = full.problem
    parts, grids = [], []
    for component in progress(components_of(problem)):
        grid = _grown(full, component, settings)
        given = component.conditions, component.forced, component.lifted, component.factor
        parts.append(Compliance(*given, *_cut(grid.interpolant, component.conditions.size)))
        grids.append(grid)
    reshaped = None
    if problem.reshaped is not None:
        axes = np.array(problem.reshaped.axes, dtype=np.int64)
        grid = grow(_gaps_at(full, axes), _scaled_by({"gaps": problem.gaps.shape}), _box(problem, axes),
                    settings.tolerance, settings.budget)  # fmt: skip
        grids.append(grid)
        reshaped = grid.interpolant
    return Compliances(tuple(parts), problem.amplitudes, problem.gaps, reshaped), grids


def _cut(interpolant: Interpolant, size: int) -> tuple[Interpolant, np.ndarray]:
    """The interpolant of S_c, (m_c^2, r), and the modes of the columns behind it, (terms, m_c, r)."""
    schur, rest = interpolant.modes[: size**2], interpolant.modes[size**2 :]
    columns = np.ascontiguousarray(rest.reshape(-1, size, rest.shape[1]))
    return replace(interpolant, modes=np.asfortranarray(schur)), columns


def _box(problem: ContactProblem, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    space = problem.parameters
    return axes, np.array(space.lower, dtype=float)[axes], np.array(space.upper, dtype=float)[axes]


def _gaps_at(full: Any, axes: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    def gaps(values: np.ndarray) -> np.ndarray:
        point = full.problem.middle
        point[axes] = values
        return full.problem.at(point).gaps.ravel()

    return gaps


def _grown(full: Any, component: Component, settings: GridSettings) -> GrownGrid:
    """Interpolate what one component leaves of itself."""
    problem: ContactProblem = full.problem
    m = component.conditions.size
    shapes = {"schur": (m, m), "forced": (component.forced.size, m), "lifted": (component.lifted.size, m)}
    solver: list[FreeCholesky] = []

    def solved(values: np.ndarray) -> np.ndarray:
        point = problem.middle
        point[component.axes] = values
        there = problem.at(point)
        if solver:
            solver[0].refactor(there.own_stiffness)
        else:
            rows, scene = slice(0, problem.free.size), full.scene.name
            solver.append(
                FreeCholesky(there.own_stiffness, component.dofs, rows, scene, full.block_ordering, full.comm)
            )
        factor = 1.0 if component.factor is None else component.factor.value(point)
        return _left_of(there, component, solver[0], factor)

    return grow(solved, _scaled_by(shapes), _box(problem, component.axes), settings.tolerance, settings.budget)


def _left_of(problem: ContactProblem, component: Component, solver: FreeCholesky, factor: float) -> np.ndarray:
    """S_c, B K^-1 F and B K^-1 K lift beside each other, for the factor 1."""
    rows = csr_matrix(problem.contact[component.conditions])
    per_force = solver.solve_columns(rows.T)
    schur = rows @ per_force
    # K^-1 is symmetric: no solve for the loads, of which there may be more than conditions
    forced = problem.external[:, component.forced].T @ per_force
    lifted = (problem.stiffness @ problem.lifts[:, component.lifted]).T @ per_force
    parts = (factor * (schur + schur.T) / 2, factor * forced, lifted)
    return np.concatenate([np.asarray(part).ravel() for part in parts])


def _scaled_by(shapes: dict[str, tuple[int, ...]]) -> Callable[[np.ndarray], float]:
    """Size of a surplus: the largest of its parts relative to the first, that of the values."""
    firsts = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes.values())])
    sizes: list[float] = []

    def scale(values: np.ndarray) -> float:
        norms = [float(np.linalg.norm(values[a:b])) for a, b in zip(firsts[:-1], firsts[1:], strict=True)]
        if not sizes:
            sizes.extend(norms)
        return max((norm / size for norm, size in zip(norms, sizes, strict=True) if size > 0), default=0.0)

    return scale
