"""Checks for strains that are not small: the theory is inaccurate for them, and beyond a limit load they run away."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.errors import SmallStrainWarning
from hhr_dolfinx.models.histories.equilibrium import Diverged
from hhr_dolfinx.plugins.inelastic.points import ALL_HERE, Points
from hhr_dolfinx.warn import warn

LARGE = 0.1
"""Strain that raises a warning: the neglected squares, e^2 / 2, are a twentieth of it."""
MOST = 1.0
"""Strain at which small-strain theory has no solution; beyond a limit load, the only balance is round-off."""
ALONE = 0.01
"""Part of the points that may have larger strains: at the corner of a punch they depend on the mesh."""
RUNAWAY = 100.0
"""Strain that not even a single point may have."""


def spread_strain(sizes: np.ndarray) -> float:
    """Strain that is exceeded at a hundredth of the points, from the sizes at each, (points,)."""
    count = max(int(ALONE * sizes.size), 1)
    return float(np.partition(sizes, -count)[-count])


def large_strain(strain: float) -> str:
    """Message on a large strain."""
    return (
        f"a strain of {strain:.2g} at more than {ALONE:.0%} of the points is no small strain, and answers are those of "
        f"small strains, which are a few per cent off at {LARGE:g} and mean nothing at {MOST:g}: lower the load, check "
        "units and moduli, or take a program for finite strains"
    )


def large_rotation(rotation: float) -> str:
    """Message on a large rotation."""
    return (
        f"a rotation of {rotation:.2g} rad in more than {ALONE:.0%} of the cells is not small, and answers are those "
        f"of small displacements, to which a rotation of w is a strain of w^2 / 2 = {rotation**2 / 2:.2g} that is not "
        "there: lower the load, or take a program for large displacements"
    )


class SmallStrains:
    """Checks the strains of the steps of one history; warns once."""

    def __init__(self) -> None:
        self._said = False

    def check(self, strain: np.ndarray, together: Points = ALL_HERE) -> None:
        """Warn of large strains, (points, components); ``together`` reduces over the points of all ranks.

        Raises:
            Diverged: if they are too large for small-strain theory.

        Warns:
            SmallStrainWarning: once.
        """
        largest = together.largest(np.abs(strain).max(initial=0.0))
        if largest <= LARGE:
            return
        sizes = np.abs(strain).max(axis=1)
        spread = spread_strain(together.gathered(sizes))
        if spread > MOST or not largest <= RUNAWAY:
            raise Diverged(
                f"a strain of {largest:.3g} is no small strain: the load is more than is borne, or strains are finite",
                together.place(sizes),
            )
        if spread > LARGE and not self._said:
            self._said = True
            warn(large_strain(spread), SmallStrainWarning, stacklevel=3)
