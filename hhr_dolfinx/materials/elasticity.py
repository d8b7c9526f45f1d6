"""Constants of isotropic elasticity."""

from __future__ import annotations

import numpy as np


def lame_parameters(young: float, poisson: float) -> tuple[float, float]:
    """Return (λ, μ) of Young's modulus E and Poisson's ratio ν, in the unit of E."""
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))


def von_mises(stress: np.ndarray) -> np.ndarray:
    """Von Mises' equivalent stress of stresses in Kelvin's notation, (n, components) -> (n,)."""
    deviator = stress.copy()
    deviator[:, :3] -= stress[:, :3].mean(axis=1, keepdims=True)
    return np.sqrt(1.5 * np.einsum("nk,nk->n", deviator, deviator))
