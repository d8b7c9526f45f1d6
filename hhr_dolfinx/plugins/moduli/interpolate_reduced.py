"""HHR models whose stiffness depends on parameters, with the elimination of K~(mu) interpolated
between few of them.

The contact of a reduced model needs S~ = B~2 K~^-1 B~1^T and the unknown under forces, which are as
smooth in the parameters as K~. A sparse grid of a dozen factorisations of K~ replaces one for each
query.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets, dependence
from hhr_dolfinx.errors import SingularError
from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.models.eliminations.block import ModeBlock, blocks_of
from hhr_dolfinx.models.eliminations.projected import ReducedProblem, ReducedTerms
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.moduli.interpolate import (
    GridSettings,
    ProblemComponent,
    compliance_of,
    grown,
    round_off_of_gaps,
    size_in_box,
    typical,
)
from hhr_dolfinx.plugins.moduli.interpolated import Compliances
from hhr_dolfinx.plugins.moduli.shaped import InterpolatedProblem
from hhr_dolfinx.reduction.build import Draft
from hhr_dolfinx.reduction.projection import project
from hhr_dolfinx.reduction.starts import linear_starts

REDUCED_GRID = GridSettings(1e-5, 300)
"""Tolerance far below the error of the reduction: a factorisation of K~ costs milliseconds."""
SHAPE_GRID = GridSettings(2e-5, 200)
"""Tolerance below the error of the reduction: a shape of the RID costs a tenth of a second."""


def interpolated_reduction(
    problem: ReducedProblem, amplitudes: Amplitudes, space: ParameterSpace
) -> Compliances | None:
    """Interpolate the elimination of γ.

    None if it is not smooth and K~ should be factored for each query.

    Args:
        problem: the reduced problem.
        amplitudes: θ as a function of the parameters.
        space: the box of the parameters.
    """
    compliances = []
    for block in blocks_of(problem):
        assert problem.terms is not None
        component = _part(problem.terms, block, space)
        grid, modes = grown(
            partial(_solved, problem.terms, block, component),
            space,
            component.axes,
            REDUCED_GRID,
            component,
        )
        if grid.surplus > REDUCED_GRID.tolerance:
            return None
        compliances.append(compliance_of(component, grid, modes, block.modes))
    size = len(problem.stiffness)
    return Compliances(tuple(compliances), amplitudes, problem.gaps, None, size, symmetric=False)


def _part(terms: ReducedTerms, block: ModeBlock, space: ParameterSpace) -> ProblemComponent:
    """Conditions and terms that act on a block."""
    conditions = np.flatnonzero(block.test.any(axis=0) | block.trial.any(axis=1))
    forced = np.flatnonzero(terms.forces[block.modes].any(axis=0))
    lifted = np.flatnonzero(terms.lifts[:, block.modes].any(axis=(0, 1)))
    moduli = [terms.moduli[k] for k in block.parts]
    factor, axes = dependence(moduli, (), space.names)
    return ProblemComponent(conditions, forced, lifted, factor, axes, tuple(moduli))


def _solved(
    terms: ReducedTerms, block: ModeBlock, part: ProblemComponent, point: np.ndarray
) -> dict[str, np.ndarray]:
    """Arrays of an eliminated block for the factor 1, see :func:`compliance_of`."""
    weights = np.array([modulus.value(point) for modulus in terms.moduli])
    size = block.modes.size
    factor = part.factor_at(point)
    lu, pivots, info = dgetrf((weights[block.parts] @ block.entries).reshape(size, size).T)
    if info:
        raise SingularError(f"K~ of {size} modes is singular at {point.tolist()}")
    forces = terms.forces[np.ix_(block.modes, part.forced)]
    lifts = np.tensordot(weights, terms.lifts[:, block.modes][:, :, part.lifted], 1)
    per_force = factor * dgetrs(lu, pivots, block.test[:, part.conditions])[0]
    free = np.column_stack([factor * dgetrs(lu, pivots, forces)[0], dgetrs(lu, pivots, lifts)[0]])
    trial = block.trial[part.conditions]
    return {
        "schur": trial @ per_force,
        "columns": (trial @ free).T,
        "per_force": per_force,
        "free": free.T,
    }


def interpolated_problem(
    problem: ContactProblem,
    basis: np.ndarray,
    sets_at: Callable[[ContactProblem], IndexSets],
    settings: GridSettings,
) -> tuple[InterpolatedProblem, float]:
    """Interpolate a projected problem over the parameters of a shape.

    Args:
        problem: the contact problem, reshaped by parameters.
        basis: V, (N, ell).
        sets_at: index sets for the problem of a shape, whose surfaces may face each other
            elsewhere.
        settings: targets of the grid.

    Returns:
        The interpolated problem, and the surplus of the terms tried last.
    """
    reshaped = problem.reshaped
    assert reshaped is not None

    def terms_of(there: ContactProblem) -> tuple[ReducedProblem, ReducedTerms]:
        # the basis has no motions
        reduced = project(replace(there, kernel=None), basis, sets_at(there))
        if reduced.terms is not None:
            return reduced, reduced.terms
        unit_modulus = Modulus("1", "1", problem.parameters.names)
        lifts = np.zeros((1, *reduced.loads.shape))
        return reduced, ReducedTerms(reduced.stiffness[None], lifts, reduced.loads, (unit_modulus,))

    def solved(point: np.ndarray) -> dict[str, np.ndarray]:
        reduced, terms = terms_of(reshaped(point))
        # parts are scaled by their size: else the error of a large one would dominate
        return {
            "stiffness": sizes[:, None, None] * terms.stiffness,
            "lifts": sizes[:, None, None] * terms.lifts,
            "forces": terms.forces,
            "test": reduced.contact_test,
            "trial": reduced.contact_trial,
            "gaps": reduced.gaps,
        }

    base, terms = terms_of(problem)
    space = problem.parameters
    points = typical(space, np.arange(len(space.names)))
    # Lamé's first constant is zero in the middle of a box about Poisson's ratio 0
    sizes = np.array(
        [size_in_box([modulus.value(point) for point in points]) for modulus in terms.moduli]
    )
    closed = {"gaps": round_off_of_gaps(problem)}
    grid, modes = grown(solved, problem.parameters, reshaped.axes, settings, round_off=closed)
    shapes = tuple(array.shape[:-1] for array in modes.values())
    return InterpolatedProblem(
        base.pairs, terms.moduli, sizes, grid.interpolant, shapes
    ), grid.surplus


def whole_problem(
    problem: ContactProblem, basis: np.ndarray, settings: GridSettings
) -> ReducedProblem | InterpolatedProblem:
    """Galerkin projection on the whole mesh, with all conditions among its rows.

    Interpolated between shapes.

    Args:
        problem: the contact problem.
        basis: V, (N, ell).
        settings: targets of the grid between shapes.
    """
    dofs = np.flatnonzero(problem.free)
    conditions = np.arange(len(problem.gaps))
    cells = np.arange(len(problem.cell_nodes))
    sets = IndexSets(cells, dofs, conditions, dofs, dofs, np.zeros(0, dtype=np.int64))
    if problem.reshaped is None:
        return project(problem, basis, sets)
    return interpolated_problem(problem, basis, lambda there: sets, settings)[0]


def interpolate(draft: Draft) -> None:
    """Stage of the hyper-reduction: K~^-1, interpolated between few parameters.

    Statuses start along derivatives.
    """
    model = draft.model
    log = draft.shared.log
    with log.stage("online_arrays", draft.shared.task.announce):
        if model.problem.motions:
            log.skip("interpolation", "contact alone holds bodies: K~ is factored for each query")
            return
        if model.law.remembers:
            reason = (
                f"contact with {model.law.name}: K~ is factored once for all increments of a path"
            )
            log.skip("interpolation", reason)
            return
        compliances = interpolated_reduction(
            model.problem, model.fields.amplitudes, model.parameters
        )
        if compliances is None:
            log.skip(
                "interpolation",
                "K~^-1 is no smooth function of the parameters: it is factored for each query",
            )
            return
        assert model.known is not None  # true for elastic bodies
        starts = linear_starts(compliances, model.known.points, model.problem.pairs)
        draft.model = model.changed(compliances=compliances, known=starts)
