"""Shapes in the hyper-reduction: the projected problem at few shapes, and between them.

V^T K(mu) V tested on the RID, loads, rows of contact and gaps are as smooth in the shape as the
coordinates of the nodes are, so that a sparse grid of some tens of shapes gives them everywhere and
a model needs no mesh.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import ReductionError, StabilityWarning
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.plugins.moduli.interpolate import grown, round_off_of_gaps
from hhr_dolfinx.plugins.moduli.interpolate_reduced import SHAPE_GRID, interpolated_problem
from hhr_dolfinx.plugins.moduli.interpolation import unstacked
from hhr_dolfinx.plugins.moduli.shaped import InterpolatedProblem, ReshapedElimination
from hhr_dolfinx.plugins.shapes.interpolated import reshaped_functionals
from hhr_dolfinx.plugins.shapes.outputs import FullShapeFunctionals
from hhr_dolfinx.plugins.shapes.reduced import ReshapedReconstruction
from hhr_dolfinx.reduction.build import Draft
from hhr_dolfinx.reduction.projection import open_conditions
from hhr_dolfinx.warn import warn

SOFTEST = 1e-12
"""Energy of a mode over the largest one below which it is round-off."""


def interpolate(draft: Draft) -> None:
    """Stage of the hyper-reduction: gamma eliminated, fields and outputs at any shape of the box.

    Warns:
        StabilityWarning: if the projected problem is not as smooth in the shape as the tolerance
        asks for.
    """
    shared = draft.shared
    full = shared.full
    problem = full.problem
    assert problem.reshaped is not None
    with shared.log.stage("online_arrays", shared.task.announce):
        projected, surplus = _between_shapes(problem, draft.basis, draft.sets)
        if surplus > SHAPE_GRID.tolerance:
            warn(
                f"the projected problem of scene '{full.scene.name}' was made at "
                f"{SHAPE_GRID.budget} shapes, and between them an error of about {surplus:.1e} is "
                "left: narrow the box of the shapes, or condense, hhr.condense(scene)",
                StabilityWarning,
            )
        draft.parts["compliances"] = ReshapedElimination(
            projected, problem.amplitudes, problem.parameters
        )
        draft.fields = _fields(draft)


def _between_shapes(
    problem: ContactProblem, basis: np.ndarray, sets: IndexSets
) -> tuple[InterpolatedProblem, float]:
    """The projected problem between shapes, and the error left in it.

    Its error is relative to the size of its arrays. In modes that are orthonormal in energy soft
    ones are as exact as stiff ones, such as functions of single nodes.
    """
    stiffness = problem.own_stiffness
    energies, ways = np.linalg.eigh(basis.T @ (stiffness @ basis))
    energies = np.maximum(energies, SOFTEST * energies[-1]) ** 0.5
    energy_modes = basis @ (ways / energies)
    projected, surplus = interpolated_problem(
        problem, energy_modes, lambda item: _sets_at(item, sets), SHAPE_GRID
    )
    back = energies[:, None] * ways.T  # from coordinates in V to those in the other modes
    rank = projected.interpolant.modes.shape[1]
    modes = unstacked(projected.interpolant.modes, projected.shapes)
    stiffness, lifts, forces, test, trial, gaps = (
        array.reshape(*shape, rank) for array, shape in zip(modes, projected.shapes, strict=True)
    )
    transformed = (
        np.einsum("qijr,il,jk->qlkr", stiffness, back, back, optimize=True),
        np.einsum("qitr,il->qltr", lifts, back, optimize=True),
        np.einsum("itr,il->ltr", forces, back, optimize=True),
        np.einsum("mir,il->mlr", test, back, optimize=True),
        np.einsum("mir,il->mlr", trial, back, optimize=True),
        gaps,
    )
    joined = np.asfortranarray(np.concatenate([array.reshape(-1, rank) for array in transformed]))
    return replace(projected, interpolant=replace(projected.interpolant, modes=joined)), surplus


def _sets_at(problem: ContactProblem, sets: IndexSets) -> IndexSets:
    """Index sets for the problem of a shape, whose conditions may touch other nodes.

    ReductionError if conditions outside the RID act on it there.
    """
    if open_conditions(problem, sets).size:
        raise ReductionError(
            "surfaces slide along each other where the shape changes, and contact conditions "
            "outside the RID act on it at some shapes: narrow the box of the shapes, add layers, "
            "or condense, hhr.condense(scene)"
        )
    touched = np.unique(problem.contact[sets.A_lambda].indices).astype(np.int64)
    return replace(sets, A_c=np.intersect1d(touched, sets.A), A_c_tilde=touched)


def _fields(draft: Draft) -> ReshapedReconstruction:
    """The fields of a draft on all shapes."""
    full = draft.shared.full
    problem = full.problem
    reshaped = problem.reshaped
    assert reshaped is not None

    def solved(point: np.ndarray) -> dict[str, np.ndarray]:
        problem_at_point = reshaped(point)
        return {
            "gaps": problem_at_point.gaps,
            "rows": problem_at_point.contact_rows_times(draft.basis),
        }

    closed = {"gaps": round_off_of_gaps(problem)}
    grid, _ = grown(solved, problem.parameters, reshaped.axes, SHAPE_GRID, round_off=closed)
    values = {
        attribute.name: getattr(draft.fields, attribute.name)
        for attribute in fields(Reconstruction)
    }
    outputs = full.functionals
    if isinstance(outputs, FullShapeFunctionals):
        values["functionals"] = reshaped_functionals(outputs, problem, draft.basis, SHAPE_GRID)
    return ReshapedReconstruction(**values, surface=grid.interpolant)
