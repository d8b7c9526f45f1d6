"""Connected components of a scene, each eliminated by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, hstack

from hhr_dolfinx.contact.problem import ContactProblem, dependence, moduli_of
from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.linear.sparse import FreeCholesky
from hhr_dolfinx.models.eliminations.interpolated import Compliances
from hhr_dolfinx.models.eliminations.interpolation import GrownGrid
from hhr_dolfinx.reduction.interpolate import GridSettings, Part, compliance_of, grown


@dataclass(frozen=True)
class Component:
    """A connected component of a scene.

    Attributes:
        dofs: its dofs that are free, as a mask, (N,).
        body: numbers of all of its dofs.
        part: what acts on it.
        moduli: of the parts of its stiffness, where these depend on parameters.
    """

    dofs: np.ndarray
    body: np.ndarray
    part: Part
    moduli: list[Modulus]


def components_of(problem: ContactProblem) -> list[Component]:
    """Connected components of a scene, as far as they touch anything."""
    found = []
    shape_axes = () if problem.reshaped is None else problem.reshaped.axes
    lifts = sum(abs(term) for term in problem.lift_terms)
    if problem.reshaped is not None:  # at another shape other dofs may be pulled
        lifts = lifts + abs(problem.stiffness) @ abs(problem.lifts)
    for body in problem.bodies:
        dofs = np.zeros(problem.free.size, dtype=bool)
        dofs[body] = problem.free[body]
        conditions = np.flatnonzero(np.diff(problem.contact[:, dofs].indptr))
        if not conditions.size:
            continue
        moduli = moduli_of(problem, body)
        factor, axes = dependence(moduli, shape_axes, problem.parameters.names)
        forced, lifted = (_acting(columns, dofs) for columns in (problem.external, lifts))
        found.append(Component(dofs, body, Part(conditions, forced, lifted, factor, axes, tuple(moduli)), moduli))
    return found


def _acting(columns: csc_matrix, dofs: np.ndarray) -> np.ndarray:
    """Columns with entries on some dofs."""
    return np.flatnonzero(np.diff(csc_matrix(columns[dofs]).indptr))


def interpolated_compliances(
    problem: ContactProblem, solvers: Sequence[Solver], settings: GridSettings, own: Sequence[GridSettings] = ()
) -> tuple[Compliances, list[GrownGrid], list[dict[str, np.ndarray]]]:
    """Solve for and interpolate all that contact needs of a full model, on one rank, and the modes of each part.

    ``settings`` hold for all, unless each part has its ``own``.
    """
    parts = []
    grids = []
    others = []
    for solver, how in zip(solvers, own or [settings] * len(solvers), strict=True):
        part = solver.component.part
        grid, modes = grown(solver, problem.parameters, part.axes, how, part)
        parts.append(compliance_of(part, grid, modes, None))
        grids.append(grid)
        others.append(modes)
    reshaped = None
    if problem.reshaped is not None:
        axes = np.array(problem.reshaped.axes, dtype=np.int64)
        grid, _ = grown(lambda point: {"gaps": problem.at(point).gaps}, problem.parameters, axes, settings)
        grids.append(grid)
        reshaped = grid.interpolant
    return Compliances(tuple(parts), problem.amplitudes, problem.gaps, reshaped), grids, others


class Solver:
    """Solves for what one component leaves of itself; its factors take the values of each point.

    Args:
        full: the full model, on one rank.
        component: of its scene.
    """

    def __init__(self, full: Any, component: Component):
        self.problem = full.problem
        self.component = component
        self._full = full
        self._factors: FreeCholesky | None = None

    def __call__(self, point: np.ndarray) -> dict[str, np.ndarray]:
        """S_c, (m_c, m_c), and B K^-1 F above B K^-1 K lift, (T, m_c), for the factor 1."""
        problem, factors = self.factored(point)
        part = self.component.part
        rows = csr_matrix(problem.contact[part.conditions])
        factor = part.factor_at(point)
        per_force = factors.solve_columns(rows.T)
        schur = rows @ per_force
        # K^-1 is symmetric: no solve for the loads, of which there may be more than conditions
        forced = problem.external[:, part.forced].T @ per_force
        lifted = (problem.own_stiffness @ problem.lifts[:, part.lifted]).T @ per_force
        return {"schur": factor * (schur + schur.T) / 2, "columns": np.vstack([factor * forced, lifted])}

    def fields_at(self, point: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Displacements under contact forces, (m, k), and under each load, (N, k + T)."""
        problem, factors = self.factored(point)
        part = self.component.part
        pushed = csc_matrix(problem.contact[part.conditions].T @ forces[part.conditions])
        loads = problem.loads[:, np.union1d(part.forced, part.lifted)]
        return factors.solve_columns(hstack([pushed, loads], format="csc"))

    def fields_under(self, point: np.ndarray, points: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Displacements under the loads at some points, (k, P), and contact forces, (k, m), and lifts: (N, k + T)."""
        problem, factors = self.factored(point)
        loaded = np.stack([problem.external @ problem.amplitudes(one) for one in points], axis=1)
        drawn = problem.own_stiffness @ problem.lifts[:, self.component.part.lifted]
        return factors.solve_columns(csc_matrix(hstack([csc_matrix(loaded - problem.contact.T @ forces.T), drawn])))

    def factored(self, point: np.ndarray) -> tuple[ContactProblem, FreeCholesky]:
        """The problem at a point, and its factors."""
        problem = self.problem.at(point)
        if self._factors is None:
            full = self._full
            how = slice(0, problem.free.size), full.scene.name, full.block_ordering, full.comm
            self._factors = FreeCholesky(problem.own_stiffness, self.component.dofs, *how)
        else:
            self._factors.refactor(problem.own_stiffness)
        return problem, self._factors
