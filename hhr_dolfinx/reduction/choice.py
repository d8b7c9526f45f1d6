"""What a recipe chooses before anything is projected: modes, and the nodes that make the RID."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.reduction.enrichment import check_basis
from hhr_dolfinx.reduction.projection import holding
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.reduction.rid import checked_nodes
from hhr_dolfinx.snapshots.records import SnapshotSet


def basis_of(step: Any, problem: ContactProblem, snapshots: SnapshotSet) -> np.ndarray:
    """The basis of a step, of a user's own maybe, as the equations are written for it; rigid motions come first."""
    if problem.rigid is not None:
        rigid, moved = problem.rigid, snapshots.displacements
        snapshots = replace(snapshots, displacements=moved - rigid @ (rigid.T @ moved))
    basis, rows = np.asarray(step.modes(problem, snapshots)), len(problem.free)
    if basis.ndim != 2 or len(basis) != rows or not 0 < basis.shape[1] <= rows or not np.isfinite(basis).all():
        raise ReductionError(f"modes of {step!r} have the shape {basis.shape}: finite ones ({rows}, ell) are needed")
    check_basis(problem, basis, f"the basis of {step!r}")
    if problem.rigid is not None:
        basis = np.linalg.qr(np.hstack([rigid, basis - rigid @ (rigid.T @ basis)]))[0]
    return np.where(problem.free[:, None], basis, 0.0)  # without the round-off that was let pass


def chosen_nodes(problem: ContactProblem, snapshots: SnapshotSet, recipe: Recipe, basis: np.ndarray) -> np.ndarray:
    """Numbers of the nodes around which the RID of a recipe is built, those of a user's own choices too."""
    found = [np.asarray(step.nodes(problem, snapshots, basis)) for step in recipe.nodes]
    known = [checked_nodes(one, len(problem.points), repr(step)) for one, step in zip(found, recipe.nodes, strict=True)]
    return np.unique(np.concatenate([*known, problem.contact_slaves[holding(problem)]]))
