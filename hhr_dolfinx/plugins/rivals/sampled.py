"""Energies of few weighted cells instead of the stiffness of all of them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem
from scipy import linalg
from scipy.optimize import nnls

from hhr_dolfinx import compat
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.full_order.elasticity import field_of
from hhr_dolfinx.plugins.rivals.cones import touching
from hhr_dolfinx.plugins.rivals.factors import nonnegative_factors
from hhr_dolfinx.plugins.rivals.projection import (
    ConeModel,
    check_elastic,
    displacement_modes,
    with_supremizers,
)
from hhr_dolfinx.plugins.studies.study import Rival

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.study.training.train import Training

MODES_EACH = 20
"""Modes of displacements, and functions of the cone."""
WORKS_LEFT_OUT = 1e-4, 1e-6
"""Size of works of training, over the largest, up to which weights do not count them."""
MOST_ANSWERS = 40
"""Most training answers whose works weights are fitted to."""


def weighted_cells(training: Training) -> Iterator[Rival]:
    """Works of training by energies of few cells, ECSW (C. Farhat, P. Avery, T. Chapman and J.
    Cortial, IJNME 98, 2014), and forces by non-negative factors.

    Made for bodies with laws, where only these cells are integrated. The stiffness of elastic
    bodies is reduced before the first question, so that they gain nothing here, and lose what the
    weights leave out.
    """
    for tolerance in WORKS_LEFT_OUT:
        made = partial(_made, training, tolerance)
        yield Rival("ECSW and NNMF", f"works to {tolerance:g}", made)


def _made(training: Training, tolerance: float) -> ConeModel:
    full = training.full_order
    snapshots = training.snapshots
    check_elastic(full, "ECSW")
    if full.scene.system is not None:
        raise NotOfferedError("ECSW weighs cells, and a system states a stiffness without them")
    cone = nonnegative_factors(touching(snapshots), MODES_EACH)
    basis = with_supremizers(full, displacement_modes(snapshots, MODES_EACH), cone)
    works = works_of_cells(full, basis)
    step = -(-len(snapshots.points) // MOST_ANSWERS)
    weights = fitted(works, basis.T @ snapshots.displacements[:, ::step], tolerance)
    # what is no cell's, such as springs, is kept as it is
    others = basis.T @ (full.problem.own_stiffness @ basis) - works.sum(axis=2)
    return ConeModel(full, basis, cone, stiffness=works @ weights + others)


def works_of_cells(full: FullOrderModel, basis: np.ndarray) -> np.ndarray:
    """Work of the stress of a mode along another one in each cell, (ell, ell, cells).

    Args:
        full: the full model, on one rank.
        basis: V, (N, ell).
    """
    space = full.discretisation
    scene = full.scene
    fields = [field_of(space, column) for column in basis.T]
    stressed = fem.Function(space.space)
    strained = fem.Function(space.space)
    cells = ufl.TestFunction(fem.functionspace(space.mesh, ("Discontinuous Lagrange", 0)))
    weight = elasticity.volume_weight(space.mesh, scene.hypothesis)
    strain = elasticity.strain(strained, scene.hypothesis)
    form = compat.jitted(
        fem.form,
        sum(
            weight
            * ufl.inner(
                space.elasticity.stress(space, place, stressed, full.problem.middle), strain
            )
            * cells
            * space.cells(body.tag)
            for place, body in enumerate(scene.bodies)
        ),
    )
    count = len(fields)
    found = None
    for row in range(count):
        stressed.x.array[:] = fields[row].x.array
        for column in range(row, count):
            strained.x.array[:] = fields[column].x.array
            values = fem.assemble_vector(form).array
            if found is None:
                found = np.empty((count, count, len(values)))
            found[row, column] = found[column, row] = values
    assert found is not None
    return found


def fitted(works: np.ndarray, answers: np.ndarray, tolerance: float) -> np.ndarray:
    """Weights >= 0 of cells whose works are those of all cells in training.

    Args:
        works: works of modes in each cell, (ell, ell, cells).
        answers: coefficients of training answers, (ell, S).
        tolerance: singular values over the largest below which works are left out.

    Returns:
        Weights, (cells,), mostly zero.
    """
    count = works.shape[-1]
    known = np.einsum("kle,ls->kse", works, answers).reshape(-1, count)
    scale = np.abs(known.sum(axis=1)).reshape(len(works), -1).max(axis=0)
    known = (
        known / np.where(np.tile(scale, len(works)) > 0, np.tile(scale, len(works)), 1.0)[:, None]
    )
    _, values, right = linalg.svd(known, full_matrices=False)
    rows = right[values > tolerance * values[0]]
    weights: np.ndarray = nnls(rows, rows.sum(axis=1), maxiter=30 * count)[0]
    return weights
