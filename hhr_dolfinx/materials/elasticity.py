"""Constants of isotropic elasticity, and constants of common materials by name, with their
sources.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.errors import SceneError


def lame_parameters(young: float, poisson: float) -> tuple[float, float]:
    """Lamé parameters (λ, μ) from E and ν, in the unit of E.

    Args:
        young: Young's modulus E.
        poisson: Poisson's ratio ν.

    Raises:
        SceneError: if the elastic energy is not positive.
    """
    if not (0 < young < math.inf and -1 < poisson < 0.5):
        raise SceneError(
            f"young = {young} must be positive and finite, and poisson = {poisson} in (-1, 0.5)"
        )
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))


def von_mises(stress: np.ndarray) -> np.ndarray:
    """Von Mises equivalent stress of stresses in Kelvin's notation, (n, components) -> (n,)."""
    deviator = stress.copy()
    deviator[:, :3] -= stress[:, :3].mean(axis=1, keepdims=True)
    return np.sqrt(1.5 * np.einsum("nk,nk->n", deviator, deviator))


@dataclass(frozen=True)
class Elastic:
    """Elastic constants at room temperature."""

    young: float  #: Young's modulus in Pa
    poisson: float  #: Poisson's ratio
    expansion: float  #: thermal expansion in 1/K
    density: float  #: density in kg/m^3
    source: str  #: source of the constants


MATERIALS = {
    "steel": Elastic(
        210e9, 0.3, 12e-6, 7850.0, "EN 1993-1-1:2005, 3.2.6; density EN 1991-1-1, table A.4"
    ),
    "stainless steel": Elastic(
        200e9, 0.3, 16e-6, 7900.0, "EN 1993-1-4:2006, 2.1.3, and EN 10088-1 for 1.4301"
    ),
    "aluminium": Elastic(70e9, 0.3, 23e-6, 2700.0, "EN 1999-1-1:2007, 3.2.5"),
    "titanium Ti-6Al-4V": Elastic(110e9, 0.31, 8.6e-6, 4430.0, "MIL-HDBK-5J, 5.4.1"),
    "concrete C30/37": Elastic(33e9, 0.2, 10e-6, 2400.0, "EN 1992-1-1:2004, table 3.1 and 3.1.3"),
    "float glass": Elastic(70e9, 0.2, 9e-6, 2500.0, "EN 572-1:2012, table 1"),
}
"""Constants by name."""


def elastic(name: str) -> Elastic:
    """Constants of a material by name, in SI units.

    Raises:
        SceneError: for an unknown name, with the nearest known one.
    """
    if name in MATERIALS:
        return MATERIALS[name]
    near = difflib.get_close_matches(str(name).lower(), MATERIALS, n=1, cutoff=0.5)
    hint = f", is '{near[0]}' meant?" if near else ""
    raise SceneError(
        f"no material is called {name!r}{hint} There are {', '.join(MATERIALS)}; for others give "
        "young and poisson as numbers"
    )
