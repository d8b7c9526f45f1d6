"""Bounds of errors if the stiffness or the shape depends on parameters, offline."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from scipy.linalg import cholesky, eigvalsh, solve_triangular
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.certify.accuracy import least_sizes
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import BoundError
from hhr_dolfinx.full_order.free_bodies import components_of_nodes
from hhr_dolfinx.models.bound import Bounding
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.plugins.exact_errors.offline import check_hypotheses
from hhr_dolfinx.plugins.moduli.components import (
    Component,
    ComponentSolver,
    interpolated_compliances,
    solvers_of,
)
from hhr_dolfinx.plugins.moduli.interpolate import GridSettings, grown
from hhr_dolfinx.plugins.moduli.interpolate_reduced import SHAPE_GRID, whole_problem
from hhr_dolfinx.plugins.moduli.interpolated import Compliance, Compliances
from hhr_dolfinx.plugins.moduli.interpolation import Interpolant
from hhr_dolfinx.plugins.moduli.proved import PartStiffness
from hhr_dolfinx.plugins.moduli.varying_bound import OF_ENERGY, PartEnergy, VaryingBound
from hhr_dolfinx.timing import Announce, unannounced

GRID = GridSettings(1e-9, 150)
"""Interpolation of S and its energies: displacements are resolved up to the root of its
tolerance.
"""
PROVED = 1e-5
"""ε up to which a proof is useful; interpolations with a larger ε are far better than their
proof.
"""
NOISE = 1e-9
"""Part of S, and of energies, that is round-off of soft directions."""
RANDOM_VECTORS = 6
"""Random forces for the comparison of S with solutions, see :func:`probed`."""
POWERS = 3
"""Powers of the error of S that these are multiplied with."""
CERTAIN = 10 * math.sqrt(2 / math.pi)
"""Factor on the largest image of these forces, which bounds a norm but for a probability of
10^-6: Halko et al., lemma 4.1."""
PLACES_OF_FACTORS = 256
"""Points at which factors of the parts of S are compared."""
MEASURED = 16
"""Number of loads, the largest ones, whose energies determine round-off."""
OBSERVED = 10.0
"""Factor on the largest error at :data:`COMPARED_POINTS` random points, without a proof."""
COMPARED_POINTS = 3
"""Random points of the box at which S is compared with solutions."""
LARGEST_BOUND_ERROR = 1e-3
"""Relative error of S above which there is no bound."""


class InterpolatedBound(NamedTuple):
    """Interpolated arrays that all bounds of a full model share, see :class:`VaryingBound`."""

    compliances: Compliances
    energies: tuple[PartEnergy, ...]
    inexact: float
    proved: bool
    areas: Interpolant | None


_KNOWN: WeakKeyDictionary[FullModel, InterpolatedBound | BoundError] = WeakKeyDictionary()


def between(
    full: FullModel,
    solvers: Sequence[ComponentSolver] | None = None,
    announce: Announce = unannounced,
) -> InterpolatedBound:
    """Arrays that all bounds of a full model share, computed once.

    Args:
        full: the full model.
        solvers: solvers of its components, which may have some points already; None to make them.
        announce: reports progress.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    check_hypotheses(full)
    if full not in _KNOWN:
        # K^-1 of each component needs all rows; the results are as large as the surface
        gathered = full if full.spread.all_here else full.gathered()
        try:
            _KNOWN[full] = _between(gathered, solvers or solvers_of(gathered), announce)
        except BoundError as error:
            _KNOWN[full] = error
    arrays = _KNOWN[full]
    if isinstance(arrays, BoundError):
        raise BoundError(str(arrays))
    return arrays


def bounding(
    full: FullModel, basis: np.ndarray, forces: np.ndarray, *, cone: bool, announce: Announce
) -> Bounding:
    """Bounds for a basis, see :func:`varying_bound`; forces outside the RID do not matter.

    Args:
        full: the full model.
        basis: columns of the displacement, (own, ell).
        forces: training forces, (N_lambda, S).
        cone: not used: S completes the forces.
        announce: reports progress.

    Raises:
        BoundError: if shapes are parameters, or with the hypothesis that fails.
    """
    if full.problem.reshaped is not None:
        raise BoundError(
            "the bound takes S of all contact conditions at each shape, which is the condensed "
            "model: hhr.condense(scene) has the bound, if it offers the scene"
        )
    return Bounding(varying_bound(full, basis, forces, announce=announce), basis)


def varying_bound(
    full: FullModel,
    basis: np.ndarray,
    forces: np.ndarray | None = None,
    solvers: Sequence[ComponentSolver] | None = None,
    announce: Announce = unannounced,
) -> VaryingBound:
    """Bounds for answers of a full model whose stiffness depends on parameters.

    Arrays that do not depend on the basis are those of :func:`between`.

    Args:
        full: the full model.
        basis: columns of the displacement, (own, ell).
        forces: training forces, (N_lambda, S); relative errors use at least a thousandth of the
            largest one as the denominator.
        solvers: solvers of the components that have some points already; None to make them.
        announce: reports progress.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    problem: ContactProblem = full.problem
    arrays = between(full, solvers, announce)
    least = least_sizes(problem, arrays.compliances(problem.middle).schur, forces)
    error = arrays.inexact, arrays.proved
    projected = whole_problem(problem, basis, GRID)
    return VaryingBound(
        *arrays[:2], projected, *error, problem.middle, problem.contact_areas, least, arrays.areas
    )


def _between(
    full: FullModel, solvers: Sequence[ComponentSolver], announce: Announce
) -> InterpolatedBound:
    """Compute the shared arrays."""
    problem: ContactProblem = full.problem
    components = [solver.component for solver in solvers]
    held = sum(int(component.dofs.sum()) for component in components)
    if held < int(np.count_nonzero(problem.free)):
        raise BoundError(
            "a body that nothing can touch has no part in S: leave it out of the scene"
        )
    kinds = [_stiffness_of(component, problem) for component in components]
    proofs = [None if kind is None else kind.levels(GRID.tolerance) for kind in kinds]
    proofs = [proof if proof is not None and proof[1] <= PROVED else None for proof in proofs]
    grid_settings = [
        GRID if proof is None else replace(GRID, compressed=False, least=proof[0])
        for proof in proofs
    ]
    grid_options = grid_settings, announce, "bound", with_energies
    compliances, grids, modes = interpolated_compliances(problem, solvers, GRID, *grid_options)
    energies = tuple(
        PartEnergy(
            *(np.ascontiguousarray(np.moveaxis(arrays[name], 2, 0)) for name in ("work", "lifted"))
        )
        for arrays in modes
    )
    errors = [OF_ENERGY, *(_round_off(solver) for solver in solvers)]
    proved = problem.reshaped is None
    for solver, compliance, energy, kind in zip(
        solvers, compliances.parts, energies, kinds, strict=True
    ):
        if not compliance.interpolant.axes.size:  # only an exact factor changes it
            continue
        seen = _seen(solver, compliance, energy)
        sure = math.inf if kind is None else kind.error(len(compliance.interpolant.levels))
        holds = sure <= PROVED and seen <= sure + NOISE
        proved &= holds
        errors.append(sure if holds else OBSERVED * seen)
    seen = probed(solvers, compliances, problem)
    errors.append(seen if seen > NOISE else 0.0)
    proved &= errors[-1] <= PROVED
    errors += [grid.unresolved for grid in grids]
    if problem.reshaped is not None:
        errors.append(OBSERVED * grids[-1].surplus)
    _check_resolved(max(errors))
    return InterpolatedBound(compliances, energies, max(errors), proved, _areas(problem))


def _round_off(solver: ComponentSolver) -> float:
    """Part of the energy of loads on a component that is round-off, largest for slender bodies.

    It is the error of products with K: |K x| of a bent body is far below |K| |x|. Errors of rows
    are independent, so that their squares are added (N. J. Higham, Accuracy and Stability of
    Numerical Algorithms, 2002, section 2.8).
    """
    middle = solver.problem.middle
    problem = solver.with_stiffness(middle)
    loads = csc_matrix(solver.acting(problem))
    largest = np.argsort(-np.asarray(abs(loads).sum(axis=0)).ravel(), kind="stable")[:MEASURED]
    fields = solver.solved_columns(problem, middle, csc_matrix(loads[:, largest]))
    stiffness = problem.own_stiffness
    energies = np.asarray(loads[:, largest].multiply(fields).sum(axis=0)).ravel()
    lost = np.finfo(float).eps * np.linalg.norm(
        np.abs(fields) * (abs(stiffness) @ np.abs(fields)), axis=0
    )
    loaded = energies > 0
    return float((lost[loaded] / energies[loaded]).max(initial=0.0))


def _areas(problem: ContactProblem) -> Interpolant | None:
    """Tributary areas between shapes; None if they are constant."""
    reshaped = problem.reshaped
    if reshaped is None:
        return None
    space = problem.parameters
    grid, _ = grown(
        lambda point: {"areas": reshaped(point).contact_areas}, space, reshaped.axes, SHAPE_GRID
    )
    return grid.interpolant


def _check_resolved(error: float) -> None:
    """Raise BoundError if the interpolation is too inaccurate for a bound.

    Relative, in the order of energies.
    """
    if error <= LARGEST_BOUND_ERROR:
        return
    off = f"{error:.2g} of itself" if error < 1 else "more than itself"
    raise BoundError(
        "S, the compliance of the contact surface, is known at few parameters, and what is "
        f"interpolated between them may be off by {off}; a bound allows "
        f"{LARGEST_BOUND_ERROR:g}. Narrow the "
        "box, leave out values at which a modulus bends, jumps or nearly vanishes (a Poisson's "
        "ratio at .5), or write Young's modulus of a whole body as one formula"
    )


def _stiffness_of(component: Component, problem: ContactProblem) -> PartStiffness | None:
    """Dependence of K of a part on its only parameter.

    None if nothing is proved: a lift scales with K, not K^-1.
    """
    scene_part = component.part
    moduli = scene_part.moduli
    if (
        problem.reshaped is not None
        or scene_part.axes.size != 1
        or scene_part.lifted.size
        or not 0 < len(moduli) < 3
    ):
        return None
    of_volume = len(moduli) == 2 and all(modulus.rest != "1" for modulus in moduli)
    return PartStiffness(scene_part, problem.parameters, of_volume)


def _seen(solver: ComponentSolver, part: Compliance, energy: PartEnergy) -> float:
    """Largest error of a part at random points, in the order of energies."""
    worst = 0.0
    for point in solver.problem.parameters.random(COMPARED_POINTS, seed=COMPARED_POINTS):
        exact = with_energies(solver, point)
        along = part.interpolant.along_modes(point)
        schur = exact["schur"]
        shift = NOISE * schur.diagonal().mean() * np.eye(len(schur))
        worst = max(worst, np.abs(eigvalsh(part.schur(along) - schur, schur + shift)).max())
        sizes = _sizes(exact["work"])
        conditions = _sizes(schur)
        work = np.tensordot(along, energy.work, 1) - exact["work"]
        columns = part.columns @ along - exact["columns"]
        for off, first, second in ((work, sizes, sizes), (columns, sizes, conditions)):
            worst = max(worst, float((np.abs(off) / np.outer(first, second)).max(initial=0.0)))
    return float(worst)


def _largest_images(
    pairs: Sequence[tuple[ComponentSolver, Compliance]], lower: np.ndarray, problem: ContactProblem
) -> float:
    """Sum of the norm estimates of each, by powers of A; several components share a solution."""
    middle = problem.middle
    rows = [
        csr_matrix(problem.contact[compliance.conditions].multiply(solver.component.dofs))
        for solver, compliance in pairs
    ]
    images = [
        np.random.default_rng(RANDOM_VECTORS).standard_normal((len(lower), RANDOM_VECTORS))
        for _ in pairs
    ]
    for _ in range(POWERS):
        forces = [
            solve_triangular(lower, image, lower=True, trans="T")[compliance.conditions]
            for (_, compliance), image in zip(pairs, images, strict=True)
        ]
        loads = csc_matrix(
            sum(
                rows_of_part.T @ forces_of_part
                for rows_of_part, forces_of_part in zip(rows, forces, strict=True)
            )
        )
        responses = pairs[0][0].solved_together(problem, middle, loads)
        for index, (_, compliance) in enumerate(pairs):
            # S_c is the only mode of a part without axes, which may take a tenth of all memory:
            # there is no other copy
            mode = compliance.interpolant.modes.reshape(compliance.conditions.size, -1)
            off = np.zeros(images[index].shape)
            off[compliance.conditions] = (
                compliance.compliance(middle) * (mode @ forces[index]) - rows[index] @ responses
            )
            images[index] = solve_triangular(lower, off, lower=True)
    return sum(
        (CERTAIN * float(np.linalg.norm(image, axis=0).max())) ** (1 / POWERS) for image in images
    )


def probed(
    solvers: Sequence[ComponentSolver], compliances: Compliances, problem: ContactProblem
) -> float:
    """Error of S against solutions with random forces, at the worst point of the box.

    For parts that only have a variable factor: it is round-off, or due to compressed factors. The
    error E_c of each is measured relative to S = L L^T in the middle of the box, A = L^-1 E_c L^-T,
    by a few powers of A times random vectors: with a probability of 1 - 10^-RANDOM_VECTORS the norm
    of a matrix is at most the largest of their images times 10 (2/π)^1/2 (N. Halko, P.-G.
    Martinsson and J. Tropp, SIAM Review 53, 2011, lemma 4.1), and that of A at most the root of it.
    As S is the sum of its parts, the error is multiplied by the ratio of the softest part to the
    stiffest.

    Args:
        solvers: solver of each component.
        compliances: interpolated compliances of these components.
        problem: the contact problem.

    Returns:
        The error relative to S, in the order of energies.
    """
    middle = problem.middle
    schur = compliances.stiffness(middle).schur.T  # symmetric; LAPACK uses Fortran order
    schur[np.diag_indices(len(schur))] += NOISE * schur.diagonal().mean()
    lower = cholesky(
        schur, lower=True, overwrite_a=True
    )  # S may be as large as a tenth of all memory
    del schur
    pairs = [
        pair
        for pair in zip(solvers, compliances.parts, strict=True)
        if not pair[1].interpolant.axes.size
    ]
    together = bool(pairs) and solvers[0].serves_all
    groups = [pairs] if together else [[solver_and_part] for solver_and_part in pairs]
    error = sum(_largest_images(group, lower, problem) for group in groups)
    points = problem.parameters.random(PLACES_OF_FACTORS, seed=COMPARED_POINTS)
    softer = [
        compliance.compliances(points) / compliance.compliance(middle)
        for compliance in compliances.parts
    ]
    return error * float((np.max(softer, axis=0) / np.min(softer, axis=0)).max(initial=1.0))


def _sizes(energies: np.ndarray) -> np.ndarray:
    """Square roots of the diagonal; very small energies are replaced by a part of the largest."""
    diagonal = np.maximum(energies.diagonal(), 0.0)
    return np.sqrt(diagonal + NOISE * diagonal.max(initial=0.0) + np.finfo(float).tiny)


def with_energies(solver: ComponentSolver, point: np.ndarray) -> dict[str, np.ndarray]:
    """Arrays of a component at a point, with those of :class:`PartEnergy`.

    Args:
        solver: solver of the component.
        point: parameters, (P,).
    """
    arrays = solver(point)
    problem = solver.with_stiffness(point)
    component = solver.component.part
    body = solver.component.body
    factor = component.factor_at(point)
    # load terms scale with the root of the compliance, lift terms with that of the stiffness
    scales = np.append(
        np.full(component.forced.size, factor**0.5), np.full(component.lifted.size, factor**-0.5)
    )
    work = scales[:, None] * solver.work(point) * scales
    # dependent dofs of the component too, which have no rows in K
    label = np.repeat(
        components_of_nodes(len(problem.points), problem.cell_nodes), problem.block_size
    )
    body = np.flatnonzero(np.isin(label, label[body]))
    lifts = csc_matrix(problem.lifts[:, component.lifted])[body]
    pulls = problem.pulled[:, component.lifted]
    return arrays | {
        "work": (work + work.T) / 2,
        "lifted": (lifts.T @ pulls[body]).toarray() / factor,
    }
