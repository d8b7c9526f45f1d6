"""Strains that are not small: the theory is inaccurate for them."""

from __future__ import annotations

import numpy as np

LARGE = 0.1
"""Strain that raises a warning: the neglected squares, e^2 / 2, are a twentieth of it."""
MOST = 1.0
"""Strain at which small-strain theory has no solution; beyond a limit load, the only balance is round-off."""
ALONE = 0.01
"""Part of the points that may have larger strains: at the corner of a punch they depend on the mesh."""


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
