"""A law of inelastic bodies of your own, and the manifest by which scenes find it."""

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="my_law", needs=("inelastic",), parts={"laws": {"MyLaw": "my_law:MyLaw"}}, classes={"my_law": "MyLaw"}
)


@dataclass(frozen=True)
class MyLaw:
    """Linear creep: rate of p = stress / viscosity, implicit Euler.

    Attributes:
        viscosity: in stress times seconds.
    """

    viscosity: float  # TODO: the constants of your law

    def flow(self, trial, plastic_strain, shear, dt):
        """Flow and its derivative by the trial stress; see hhr_dolfinx.plugins.inelastic.laws.Flow."""
        # TODO: solve dp = dt * rate(trial - 3 * shear * dp, plastic_strain + dp) for dp
        slope = dt / (self.viscosity + 3 * shear * dt)
        return trial * slope, np.full_like(trial, slope)
