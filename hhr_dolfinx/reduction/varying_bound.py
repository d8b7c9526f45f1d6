"""Bounds of errors where the stiffness or the shape depends on parameters, offline."""

from __future__ import annotations

from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, hstack

from hhr_dolfinx.certify.bounds import check_hypotheses
from hhr_dolfinx.certify.interpolation import proved_error
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import BoundError
from hhr_dolfinx.models.interpolated import Compliances
from hhr_dolfinx.models.projected import ReducedProblem
from hhr_dolfinx.models.reshaped import InterpolatedProblem
from hhr_dolfinx.models.varying_bound import ROUND_OFF, PartEnergy, VaryingBound
from hhr_dolfinx.reduction.components import Component, Solver, components_of, interpolated_compliances
from hhr_dolfinx.reduction.interpolate import GridSettings
from hhr_dolfinx.reduction.interpolate_reduced import interpolated_problem
from hhr_dolfinx.reduction.projection import project

GRID = GridSettings(1e-9, 300, compressed=False)
"""How far S and its energies are interpolated: displacements are resolved up to the root of it."""
OBSERVED = 2.0
"""Errors in the order of energies over the last surplus, where nothing is proved; a press fit of two shapes has 0.1 to
0.2, and 1e-4 in the energy of its fields."""


class Between(NamedTuple):
    """What bounds of all models of one full model need between parameters, see :class:`VaryingBound`."""

    compliances: Compliances
    energies: tuple[PartEnergy, ...]
    inexact: float
    proved: bool


_KNOWN: WeakKeyDictionary[Any, Between] = WeakKeyDictionary()


def varying_bound(full: Any, basis: np.ndarray) -> VaryingBound:
    """Bounds for answers with a basis, (N, ell), of a full model on one rank whose stiffness depends on parameters.

    What does not depend on the basis is solved for once, and kept as long as the full model lives.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    check_hypotheses(full)
    problem: ContactProblem = full.problem
    if full not in _KNOWN:
        _KNOWN[full] = _between(full)
    return VaryingBound(*_KNOWN[full][:2], _whole(problem, basis), *_KNOWN[full][2:], problem.middle)


def _between(full: Any) -> Between:
    """Solve for it."""
    problem: ContactProblem = full.problem
    components = components_of(problem)
    held = sum(int(component.dofs.sum()) for component in components)
    if held < int(np.count_nonzero(problem.free)):
        raise BoundError("a body that nothing can touch has no part in S: leave it out of the scene")
    compliances, grids, modes = interpolated_compliances(
        problem, [EnergySolver(full, component) for component in components], GRID
    )
    energies = tuple(
        PartEnergy(*(np.ascontiguousarray(np.moveaxis(part[name], 2, 0)) for name in ("work", "lifted")))
        for part in modes
    )
    observed = OBSERVED * max((max(grid.surplus, GRID.tolerance) for grid in grids), default=0.0)
    errors = [
        _proved(component, grid.interpolant, problem.middle) for component, grid in zip(components, grids, strict=False)
    ]
    known = [error for error in errors if error is not None]
    proved = len(known) == len(errors) and problem.reshaped is None
    return Between(compliances, energies, max([ROUND_OFF, *known, *([] if proved else [observed])]), proved)


def _proved(component: Component, interpolant: Any, middle: np.ndarray) -> float | None:
    """What interpolation leaves of a part, None where that is not proved: a lift moves with K, not with K^-1."""
    part = component.part
    if part.lifted.size and part.axes.size:
        return None
    return proved_error(interpolant, component.moduli, part.factor, middle)


def _whole(problem: ContactProblem, basis: np.ndarray) -> ReducedProblem | InterpolatedProblem:
    """Galerkin's projection on the whole mesh, all conditions among its rows."""
    every, conditions = np.flatnonzero(problem.free), np.arange(len(problem.gaps))
    cells = np.arange(len(problem.cell_nodes))
    sets = IndexSets(cells, every, conditions, every, every, np.zeros(0, dtype=np.int64))
    if problem.reshaped is None:
        return project(problem, basis, sets)
    return interpolated_problem(problem, basis, sets, GRID)


class EnergySolver(Solver):
    """Solves for energies beside what one component leaves of itself."""

    def __call__(self, point: np.ndarray) -> dict[str, np.ndarray]:
        """See :class:`Solver`, with the arrays of :class:`PartEnergy`."""
        problem, factors = self.factored(point)
        part, body = self.component.part, self.component.body
        rows, factor = csr_matrix(problem.contact[part.conditions]), part.factor_at(point)
        lifts = csc_matrix(problem.lifts[:, part.lifted])
        pulls = csc_matrix(problem.own_stiffness @ lifts)
        loads = csc_matrix(hstack([problem.external[:, part.forced], pulls]))
        solved = factors.solve_columns(csc_matrix(hstack([rows.T, loads])))
        per_force, per_load = solved[:, : len(part.conditions)], solved[:, len(part.conditions) :]
        schur = rows @ per_force
        # loads move a body the more the softer it is, lifts by themselves
        scales = np.append(np.full(part.forced.size, factor**0.5), np.full(part.lifted.size, factor**-0.5))
        work = scales[:, None] * (loads.T @ per_load) * scales
        own = lifts[body]
        return {
            "schur": factor * (schur + schur.T) / 2,
            "columns": (factor**0.5 * scales)[:, None] * (loads.T @ per_force),
            "work": (work + work.T) / 2,
            "lifted": (own.T @ pulls[body]).toarray() / factor,
        }
