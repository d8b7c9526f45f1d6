"""Constants of isotropic elasticity."""

from __future__ import annotations

import math

import numpy as np

from hhr_dolfinx.errors import SceneError


def lame_parameters(young: float, poisson: float) -> tuple[float, float]:
    """Return (λ, μ) of Young's modulus E and Poisson's ratio ν, in the unit of E.

    Raises:
        SceneError: for constants whose elastic energy is not positive.
    """
    if not (0 < young < math.inf and -1 < poisson < 0.5):
        raise SceneError(f"E = {young} must be positive and finite, and nu = {poisson} in (-1, 0.5)")
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))


def von_mises(stress: np.ndarray) -> np.ndarray:
    """Von Mises' equivalent stress of stresses in Kelvin's notation, (n, components) -> (n,)."""
    deviator = stress.copy()
    deviator[:, :3] -= stress[:, :3].mean(axis=1, keepdims=True)
    return np.sqrt(1.5 * np.einsum("nk,nk->n", deviator, deviator))
