"""What corrects contact forces of histories, from the full model."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.models.force_correction import ForceCorrection
from hhr_dolfinx.reduction.elastic_response import elastic_response


def force_correction(full: Any) -> ForceCorrection:
    """The correction of forces of any model of a scene whose bodies flow, see :mod:`models.force_correction`.

    Raises:
        ReductionError: where nothing flows, and where moduli are no factors of what hangs together.
    """
    if full.equilibrium is None:
        raise ReductionError(f"nothing flows in scene '{full.scene.name}': estimates of its answers bound forces")
    problem, equilibrium = full.problem, full.equilibrium
    problem.require_whole()
    elastic = elastic_response(full)
    masks = [(elastic.parts == part)[:, None] for part in range(max(len(elastic.factors.moduli), 1))]
    schur = np.array([problem.contact @ np.where(mask, elastic.per_force, 0.0) for mask in masks])
    return ForceCorrection(
        equilibrium.operator,
        equilibrium.material,
        equilibrium.eigenstrains,
        problem.amplitudes,
        elastic.factors,
        elastic.parts,
        elastic.per_force,
        (schur + schur.transpose(0, 2, 1)) / 2,
        np.array([problem.contact @ np.where(mask, elastic.forced, 0.0) for mask in masks]),
        problem.gaps - problem.contact @ elastic.given,
        problem.contact_pairs,
    )
