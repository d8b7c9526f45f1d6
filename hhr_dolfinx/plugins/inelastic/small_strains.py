"""Check of the strains of histories: beyond a limit load they run away."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.errors import SmallStrainWarning
from hhr_dolfinx.plugins.inelastic.equilibrium import Diverged
from hhr_dolfinx.plugins.inelastic.points import ALL_HERE, GaussPoints
from hhr_dolfinx.plugins.small_strains.cells import (
    LARGE_STRAIN,
    STRAIN_LIMIT,
    large_strain,
    spread_strain,
)
from hhr_dolfinx.warn import warn

RUNAWAY = 100.0
"""Strain that not even a single point may have."""


class SmallStrains:
    """Checks the strains of the steps of one history; warns once."""

    def __init__(self) -> None:
        self._said = False

    def check(self, strain: np.ndarray, together: GaussPoints = ALL_HERE) -> None:
        """Warn once of large strains.

        Args:
            strain: strain, (points, components).
            together: reductions over the points of all ranks.

        Raises:
            Diverged: if they are too large for the theory.
        """
        largest = together.largest(np.abs(strain).max(initial=0.0))
        if largest <= LARGE_STRAIN:
            return
        sizes = np.abs(strain).max(axis=1)
        spread = spread_strain(together.gathered(sizes))
        if spread > STRAIN_LIMIT or not largest <= RUNAWAY:
            raise Diverged(
                (
                    f"a strain of {largest:.3g} is no small strain: the load is more than is "
                    "borne, or strains are finite"
                ),
                together.place(sizes),
            )
        if spread > LARGE_STRAIN and not self._said:
            self._said = True
            warn(large_strain(spread), SmallStrainWarning)
