"""Constants of isotropic elasticity."""

from __future__ import annotations

import math

from hhr_dolfinx.errors import SceneError


def lame_parameters(young: float, poisson: float) -> tuple[float, float]:
    """Return (λ, μ) of Young's modulus E and Poisson's ratio ν, in the unit of E.

    Raises:
        SceneError: for constants whose elastic energy is not positive.
    """
    if not (0 < young < math.inf and -1 < poisson < 0.5):
        raise SceneError(f"E = {young} must be positive and finite, and nu = {poisson} in (-1, 0.5)")
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))
