"""A law of flow of a user's own, Bingham's; a file keeps it, ``load_model(path, known=[Bingham])``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Bingham:
    """Linear viscoplasticity with a threshold: rate of p = max(σ_eq - σ0, 0) / η, implicit Euler.

    η is in stress times seconds; 0 is perfect plasticity.
    """

    yield_stress: float
    viscosity: float

    def __post_init__(self) -> None:
        """Refuse what is no threshold or would flow backwards."""
        if not (0 <= self.yield_stress < np.inf and 0 <= self.viscosity < np.inf):
            raise ValueError(f"yield stress {self.yield_stress} and viscosity {self.viscosity} must not be negative")

    def flow(
        self, trial: np.ndarray, plastic_strain: np.ndarray, shear: float, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Closed form of η Δp = dt (q_tr - 3 mu Δp - σ0); see :class:`hhr_dolfinx.plugins.inelastic.laws.Flow`."""
        slope = dt / (self.viscosity + 3 * shear * dt)
        over = trial - self.yield_stress
        return np.maximum(over, 0.0) * slope, np.where(over > 0, slope, 0.0)
