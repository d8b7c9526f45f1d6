"""Softening in training histories: a law whose stress falls as strain grows has answers that depend
on the mesh.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from hhr_dolfinx.certify.accuracy import Solutions
from hhr_dolfinx.errors import ConvergenceError, StabilityWarning
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.plugins.inelastic.full_order import equilibrium_of
from hhr_dolfinx.plugins.inelastic.law import InternalVariables
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.plugins.inelastic.update import Group, Material
from hhr_dolfinx.warn import warn

SYMMETRIC_TANGENTS = 1e-9
"""Largest difference of a symmetric tangent from its transpose, over the elasticity."""
SOFTENS = 1e-6
"""Negative eigenvalue of a symmetric tangent, over E, below which it is round-off."""


def warn_of_softening(full: FullModel, snapshots: Solutions) -> None:
    """Warn of the training state with the smallest eigenvalue of a symmetric tangent, if that is
    negative.

    Tangents that are not symmetric, as of flow that is not associated, have negative eigenvalues
    without softening.

    Args:
        full: full model of inelastic bodies.
        snapshots: training histories.

    Warns:
        StabilityWarning: with the law, the point of the parameters and the time.
    """
    least = -SOFTENS
    message = ""
    material = equilibrium_of(full).material
    for history in snapshots.histories:
        for before, answer in pairwise(history.answers):
            for group in material.groups:
                value, points = _least(material, group, before, answer)
                if value < least:
                    named = zip(full.parameters.names, answer.parameter, strict=True)
                    values = ", ".join(f"{name} = {x:.4g}" for name, x in named)
                    law = "" if group.law is None else group.law.name
                    least = value
                    message = (
                        f"{law} softens in training at t = {answer.time:.4g} s, {values}: at "
                        f"{points} Gauss points"
                    )
    if message:
        warn(
            f"{message} its stress falls as strain grows, by up to {-least:.2g} of E. Answers "
            "depend on the mesh, and there may be several: leave softening out of the law, or "
            "train at smaller loads",
            StabilityWarning,
        )


def _least(material: Material, group: Group, before: Answer, answer: Answer) -> tuple[float, int]:
    """Smallest eigenvalue over E of the tangents at points that flow in a step, and the number of
    negative ones.
    """
    stress, new = gauss_of(answer)
    old = gauss_of(before).state
    flows = (new.inelastic[group.indices] != old.inelastic[group.indices]).any(axis=1)
    points = group.indices[flows]
    if group.law is None or not points.size:
        return 0.0, 0
    # before it has numbers: constants that vary in space are those of these points
    local = material.restricted(points).at(answer.parameter)
    numbers = local.given[0]
    strain = numbers.strain(stress[points]) + new.inelastic[points]
    try:
        update = local.update(
            strain,
            InternalVariables(*(variable[points] for variable in old)),
            answer.time - before.time,
            tangent=True,
        )
    except ConvergenceError:  # the step was solved in parts
        return 0.0, 0
    tangents = np.asarray(update.tangents)
    size = np.abs(numbers.elastic).max()
    symmetric = (
        np.abs(tangents - tangents.swapaxes(1, 2)).max(axis=(1, 2)) <= SYMMETRIC_TANGENTS * size
    )
    if not symmetric.any():
        return 0.0, 0
    values = np.linalg.eigvalsh(tangents[symmetric]).min(axis=1) / numbers.constants[0].max()
    return float(values.min()), int((values < -SOFTENS).sum())
