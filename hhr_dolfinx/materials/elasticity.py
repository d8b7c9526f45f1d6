"""Constants of isotropic elasticity."""

from __future__ import annotations


def lame_parameters(young: float, poisson: float) -> tuple[float, float]:
    """Return (λ, μ) of Young's modulus E and Poisson's ratio ν, in the unit of E."""
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))
