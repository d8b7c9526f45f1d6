"""Strains that are not small: a theory of small strains says little of them, and beyond a limit load they run away."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.errors import SmallStrainWarning
from hhr_dolfinx.models.histories.equilibrium import Diverged
from hhr_dolfinx.models.histories.points import ALL_HERE, Points
from hhr_dolfinx.warn import warn

LARGE = 0.1
"""A strain worth a word: squares that are left out, e^2 / 2, are a twentieth of it."""
MOST = 1.0
"""A strain at which there is no answer of small strains, and no balance but round-off beyond a limit load."""
ALONE = 0.01
"""Part of the points where strains may be larger: at the corner of a punch they are what the mesh makes of it."""
RUNAWAY = 100.0
"""A strain that not even a single point may have."""


def spread_strain(sizes: np.ndarray) -> float:
    """The strain that is exceeded at a hundredth of some points only, of the sizes at each, (points,)."""
    count = max(int(ALONE * sizes.size), 1)
    return float(np.partition(sizes, -count)[-count])


def large_strain(strain: float) -> str:
    """What a large strain means, in words."""
    return (
        f"a strain of {strain:.2g} at more than {ALONE:.0%} of the points is no small strain, and answers are those of "
        f"small strains, which are a few per cent off at {LARGE:g} and mean nothing at {MOST:g}: lower the load, check "
        "units and moduli, or take a program for finite strains"
    )


def large_rotation(rotation: float) -> str:
    """What a large rotation means, in words."""
    return (
        f"a rotation of {rotation:.2g} rad in more than {ALONE:.0%} of the cells is not small, and answers are those "
        f"of small displacements, to which a rotation of w is a strain of w^2 / 2 = {rotation**2 / 2:.2g} that is not "
        "there: lower the load, or take a program for large displacements"
    )


class SmallStrains:
    """Looks at the strains of the steps of one history; what is large is said once."""

    def __init__(self) -> None:
        self._said = False

    def check(self, strain: np.ndarray, together: Points = ALL_HERE) -> None:
        """Warn of strains, (points, components), that are large, on ranks that have some points each ``together``.

        Raises:
            Diverged: if they are no small strains at all.

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
