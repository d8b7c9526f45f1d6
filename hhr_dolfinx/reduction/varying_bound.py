"""Bounds of errors where the stiffness or the shape depends on parameters, offline."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from scipy.linalg import eigvalsh
from scipy.sparse import csc_matrix, csr_matrix, hstack

from hhr_dolfinx.certify.accuracy import least_sizes
from hhr_dolfinx.certify.bounds import check_hypotheses
from hhr_dolfinx.certify.interpolation import PartStiffness
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import BoundError
from hhr_dolfinx.models.bounds.varying_bound import ROUND_OFF, PartEnergy, VaryingBound
from hhr_dolfinx.models.eliminations.interpolated import Compliance, Compliances
from hhr_dolfinx.models.eliminations.interpolation import Interpolant
from hhr_dolfinx.models.eliminations.projected import ReducedProblem
from hhr_dolfinx.models.eliminations.shaped import InterpolatedProblem
from hhr_dolfinx.reduction.components import Component, Solver, components_of, interpolated_compliances
from hhr_dolfinx.reduction.interpolate import GridSettings, grown
from hhr_dolfinx.reduction.interpolate_reduced import SHAPE_GRID, interpolated_problem
from hhr_dolfinx.reduction.projection import project

GRID = GridSettings(1e-9, 150)
"""How far S and its energies are interpolated: displacements are resolved up to the root of it."""
PROVED = 1e-5
"""ε up to which a proof is worth its name; what interpolates worse is far better than what is proved of it."""
NOISE = 1e-9
"""Part of S, and of energies, that is round-off of soft directions."""
OBSERVED = 10.0
PLACES = 3
LARGEST = 1e-3
"""Errors over the largest seen at so many random places, where nothing is proved; and where there is no bound."""


class Between(NamedTuple):
    """What bounds of all models of one full model need between parameters, see :class:`VaryingBound`."""

    compliances: Compliances
    energies: tuple[PartEnergy, ...]
    inexact: float
    proved: bool
    areas: Interpolant | None


_KNOWN: WeakKeyDictionary[Any, Between] = WeakKeyDictionary()


def varying_bound(full: Any, basis: np.ndarray, forces: np.ndarray | None = None) -> VaryingBound:
    """Bounds for answers with a basis, (N, ell), of a full model on one rank whose stiffness depends on parameters.

    What does not depend on the basis is solved for once, and kept as long as the full model lives. Of forces of
    training, (N_lambda, S), a thousandth is what relative errors are taken over at least.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    check_hypotheses(full)
    problem: ContactProblem = full.problem
    if full not in _KNOWN:
        _KNOWN[full] = _between(full)
    known = _KNOWN[full]
    sizes = (problem.contact_areas, least_sizes(full, forces))
    return VaryingBound(
        *known[:2], _whole(problem, basis), known.inexact, known.proved, problem.middle, *sizes, known.areas
    )


def _between(full: Any) -> Between:
    """Solve for it."""
    problem: ContactProblem = full.problem
    components = components_of(problem)
    held = sum(int(component.dofs.sum()) for component in components)
    if held < int(np.count_nonzero(problem.free)):
        raise BoundError("a body that nothing can touch has no part in S: leave it out of the scene")
    kinds = [_stiffness_of(component, problem) for component in components]
    proofs = [None if kind is None else kind.levels(GRID.tolerance) for kind in kinds]
    proofs = [proof if proof is not None and proof[1] <= PROVED else None for proof in proofs]
    own = [GRID if proof is None else replace(GRID, compressed=False, least=proof[0]) for proof in proofs]
    solvers = [EnergySolver(full, component) for component in components]
    compliances, grids, modes = interpolated_compliances(problem, solvers, GRID, own)
    energies = tuple(
        PartEnergy(*(np.ascontiguousarray(np.moveaxis(part[name], 2, 0)) for name in ("work", "lifted")))
        for part in modes
    )
    errors = [ROUND_OFF]
    proved = problem.reshaped is None
    for solver, part, energy, kind in zip(solvers, compliances.parts, energies, kinds, strict=True):
        seen = _seen(solver, part, energy)
        if not part.interpolant.axes.size:  # nothing but an exact factor changes it, and what is seen is round-off
            errors.append(OBSERVED * seen if seen > NOISE else 0.0)
            proved &= errors[-1] <= PROVED
            continue
        sure = _proved(part, kind)
        proved &= sure is not None and seen <= sure + NOISE
        errors += [OBSERVED * seen if sure is None or seen > sure + NOISE else sure]
    errors += [grid.unresolved for grid in grids]
    if problem.reshaped is not None:
        errors.append(OBSERVED * grids[-1].surplus)
    _check_resolved(max(errors))
    return Between(compliances, energies, max(errors), proved, _areas(problem))


def _areas(problem: ContactProblem) -> Interpolant | None:
    """Tributary areas between shapes; None where they do not change."""
    if problem.reshaped is None:
        return None
    axes = np.array(problem.reshaped.axes, dtype=np.int64)

    def there(point: np.ndarray) -> dict[str, np.ndarray]:
        return {"areas": problem.reshaped(point).contact_areas}

    return grown(there, problem.parameters, axes, SHAPE_GRID)[0].interpolant


def _check_resolved(error: float) -> None:
    """Raise BoundError where what is interpolated is too far off for a bound; of itself, in the order of energies."""
    if error <= LARGEST:
        return
    off = f"{error:.2g} of itself" if error < 1 else "more than itself"
    raise BoundError(
        f"S, the compliance of the contact surface, is known at few parameters, and what is interpolated between them "
        f"may be off by {off}; a bound allows {LARGEST:g}. Narrow the box, leave out values at which a modulus bends, "
        "jumps or nearly vanishes (a Poisson's ratio at .5), or write Young's modulus of a whole body as one formula"
    )


def _stiffness_of(component: Component, problem: ContactProblem) -> PartStiffness | None:
    """How the stiffness of a part depends on its only parameter; None where nothing is proved.

    A lift moves with K, not with K^-1.
    """
    part = component.part
    moduli = component.moduli
    if problem.reshaped is not None or part.axes.size != 1 or part.lifted.size or not 0 < len(moduli) < 3:
        return None
    axis = int(part.axes[0])
    space = problem.parameters
    of_volume = len(moduli) == 2 and all(modulus.rest != "1" for modulus in moduli)
    ends = float(space.lower[axis]), float(space.upper[axis])
    return PartStiffness(moduli, part.factor, axis, *ends, problem.middle, of_volume)


def _proved(part: Compliance, kind: PartStiffness | None) -> float | None:
    """ε of a part, None where it is not proved, or too large to be worth it."""
    if kind is None:
        return None
    error = kind.error(len(part.interpolant.levels))
    return error if error <= PROVED else None


def _seen(solver: EnergySolver, part: Compliance, energy: PartEnergy) -> float:
    """Largest error of a part at random places, in the order of energies."""
    space = solver.problem.parameters
    worst = 0.0
    for point in space.random(PLACES if part.interpolant.axes.size else 1, seed=PLACES):
        exact = solver(point)
        along = part.interpolant.along_modes(point)
        scale = exact["schur"].diagonal().mean()
        schur = part.schur(along)
        shift = NOISE * scale * np.eye(len(exact["schur"]))
        worst = max(worst, np.abs(eigvalsh(schur - exact["schur"], exact["schur"] + shift)).max())
        sizes = _sizes(exact["work"])
        conditions = _sizes(exact["schur"])
        work = np.tensordot(along, energy.work, 1) - exact["work"]
        columns = part.columns @ along - exact["columns"]
        for off, first, second in ((work, sizes, sizes), (columns, sizes, conditions)):
            worst = max(worst, float((np.abs(off) / np.outer(first, second)).max(initial=0.0)))
    return float(worst)


def _sizes(energies: np.ndarray) -> np.ndarray:
    """Square roots of the diagonal; what has hardly any energy counts with a part of the largest."""
    own = np.maximum(energies.diagonal(), 0.0)
    return np.sqrt(own + NOISE * own.max(initial=0.0) + np.finfo(float).tiny)


def _whole(problem: ContactProblem, basis: np.ndarray) -> ReducedProblem | InterpolatedProblem:
    """Galerkin's projection on the whole mesh, all conditions among its rows."""
    every = np.flatnonzero(problem.free)
    conditions = np.arange(len(problem.gaps))
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
        part = self.component.part
        body = self.component.body
        rows = csr_matrix(problem.contact[part.conditions])
        factor = part.factor_at(point)
        lifts = csc_matrix(problem.lifts[:, part.lifted])
        pulls = csc_matrix(problem.own_stiffness @ lifts)
        loads = csc_matrix(hstack([problem.external[:, part.forced], pulls]))
        solved = factors.solve_columns(csc_matrix(hstack([rows.T, loads])))
        per_force = solved[:, : len(part.conditions)]
        per_load = solved[:, len(part.conditions) :]
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
