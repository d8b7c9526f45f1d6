"""A switch of laws by functions of arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.plugins.external_operator.law import ExternalOperator

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft

Mapped = Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]]


def external(derivatives: tuple[int, ...]) -> Mapped:
    """Von Mises plasticity with linear hardening, by the radial return."""
    return radial_return


def radial_return(
    increment: np.ndarray,
    stress: np.ndarray,
    cumulated: np.ndarray,
    young: np.ndarray,
    poisson: np.ndarray,
    strength: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stress, tangents and increments of the cumulated plastic strain p by radial return.

    Isotropic hardening with slope 0.5; one Gauss point in each of n rows, c components of strain.

    Args:
        increment: increments of strain, (n, 1, c).
        stress: stress before the step, (n, 1, c).
        cumulated: p before the step, (n, 1).
        young: Young's modulus, (n, 1).
        poisson: Poisson's ratio, (n, 1).
        strength: yield stress, (n, 1).

    Returns:
        Tangents, (n, 1, c, c), stress, (n, 1, c), and increments of p, (n, 1).
    """
    size = increment.shape[-1]
    unit = np.array([1.0, 1.0, 1.0] + [0.0] * (size - 3))
    deviator = np.eye(size) - np.outer(unit, unit) / 3
    shear = young / (2 + 2 * poisson)
    bulk = young / (3 - 6 * poisson)
    elastic = bulk[..., None, None] * np.outer(unit, unit)
    elastic = elastic + 2 * shear[..., None, None] * deviator
    trial = stress + np.einsum("...ij,...j->...i", elastic, increment)
    deviatoric = trial @ deviator
    size_of = np.sqrt(1.5 * (deviatoric * deviatoric).sum(-1))
    slope = 0.5
    amount = np.maximum(size_of - strength - slope * cumulated, 0.0) / (3 * shear + slope)
    safe = np.where(size_of > 0, size_of, 1.0)
    normal = deviatoric / safe[..., None]
    ratio = 3 * shear * amount / safe
    along = np.where(amount > 0, 3 * shear * (3 * shear / (3 * shear + slope) - ratio), 0.0)
    tangents = elastic - along[..., None, None] * normal[..., :, None] * normal[..., None, :]
    tangents = tangents - 2 * shear[..., None, None] * ratio[..., None, None] * deviator
    return tangents, trial - ratio[..., None] * deviatoric, amount


def external_law(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Plasticity by a function of arrays.

    Args:
        draft: draft of the scene.
        neutral: add the capability with values that change no answer.
    """
    operands = ("increment", "stress", "cumulated", "young", "poisson", "strength")
    law = ExternalOperator(external, {"strength": 1e6 if neutral else 0.05}, operands=operands)
    return (draft.of_simplices() if neutral else draft).with_body_law(law)
