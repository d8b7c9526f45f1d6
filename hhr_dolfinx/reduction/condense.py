"""Interpolated condensation, offline: solve for S and the free slack at few parameters, and interpolate between them.

Each part of a scene that hangs together is solved for by itself, at parameters that its own sparse grid asks for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.formulas import Modulus, Scalar
from hhr_dolfinx.linear.sparse import FreeCholesky
from hhr_dolfinx.models.interpolated import Compliance, Compliances
from hhr_dolfinx.models.interpolation import GrownGrid, Interpolant, grow

Progress = Callable[[Iterable], Iterable]


@dataclass(frozen=True)
class GridSettings:
    """How far a sparse grid grows.

    Attributes:
        tolerance: wished error of S and of the free slack, relative to their size.
        budget: most solutions for each part of a scene that hangs together.
    """

    tolerance: float = 1e-6
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


def components_of(problem: ContactProblem) -> list[Component]:
    """What hangs together in a scene, as far as it touches anything."""
    names = problem.parameters.names
    _, label = connected_components(problem.stiffness, directed=False)
    found = []
    shape_axes = () if problem.reshaped is None else problem.reshaped.axes
    for number in np.unique(label[problem.free]):
        dofs = (label == number) & problem.free
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
        parts.append(Compliance(*given, grid.interpolant))
        grids.append(grid)
    gaps: np.ndarray | Interpolant = problem.gaps
    if problem.reshaped is not None:
        axes = np.array(problem.reshaped.axes, dtype=np.int64)
        grid = grow(_gaps_at(full, axes), _scaled_by({"gaps": problem.gaps.shape}), _box(problem, axes),
                    settings.tolerance, settings.budget)  # fmt: skip
        grids.append(grid)
        gaps = grid.interpolant
    sizes = problem.gaps.shape[1], problem.gaps.shape[0], len(problem.parameters.names)
    return Compliances(tuple(parts), problem.amplitudes, gaps, *sizes), grids


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
    shapes = {"schur": (m, m), "forced": (m, component.forced.size), "lifted": (m, component.lifted.size)}
    solver: list[FreeCholesky] = []

    def solved(values: np.ndarray) -> np.ndarray:
        point = problem.middle
        point[component.axes] = values
        there = problem.at(point)
        if solver:
            solver[0].refactor(there.own_stiffness)
        else:
            rows, scene = slice(0, problem.free.size), full.scene.name
            solver.append(FreeCholesky(there.own_stiffness, component.dofs, rows, scene, full.block_ordering, full.comm))
        factor = 1.0 if component.factor is None else component.factor.value(point)
        return _left_of(there, component, solver[0], factor)

    return grow(solved, _scaled_by(shapes), _box(problem, component.axes), settings.tolerance, settings.budget)


def _left_of(problem: ContactProblem, component: Component, solver: FreeCholesky, factor: float) -> np.ndarray:
    """S_c, B K^-1 F and B K^-1 K lift beside each other, for the factor 1."""
    rows = csr_matrix(problem.contact[component.conditions])
    per_force = solver.solve_columns(rows.T)
    schur = rows @ per_force
    # K^-1 is symmetric: no solve for the loads, of which there may be more than conditions
    forced = (problem.external[:, component.forced].T @ per_force).T
    lifts = problem.stiffness @ problem.lifts[:, component.lifted]
    lifted = (lifts.T @ per_force).T
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
