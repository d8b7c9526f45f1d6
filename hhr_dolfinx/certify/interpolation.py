"""What interpolation of an inverse stiffness between parameters leaves, as far as it can be proved.

Let K(ν) = a(ν) K_a + b(ν) K_b with K_a, K_b positive semi-definite and a, b positive. Both are diagonal in the same
basis, so that K^-1 is a sum of functions f_κ(ν) = 1 / (κ a(ν) + (1 - κ) b(ν)), 0 <= κ <= 1, of dyads that do not depend
on ν. Interpolation is linear: that of K^-1 is off by -ε K^-1 <= Δ <= ε K^-1, in the order of energies, where ε is the
largest relative error of the interpolation of any f_κ: a question of one variable, whatever the mesh.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from hhr_dolfinx.formulas import Modulus, Scalar
from hhr_dolfinx.models.interpolation import Interpolant

SHARES, PLACES = 201, 2001
"""Numbers of κ and of ν at which the error is looked at: it is smooth in κ, and oscillates once between nodes in ν."""
BETWEEN = 1.1
"""By how much the error may be larger between these."""


def proved_error(
    interpolant: Interpolant, moduli: list[Modulus], factor: Scalar | None, middle: np.ndarray
) -> float | None:
    """ε of a part of a scene whose stiffness is a sum of two parts that depend on one parameter; None for others.

    Args:
        interpolant: of the part, of which only nodes count.
        moduli: of its parts.
        factor: what these share and the interpolation leaves out; None for nothing.
        middle: a point of the box, (P,), whose other parameters do not count.
    """
    if interpolant.axes.size == 0:
        return 0.0
    if interpolant.axes.size > 1 or not 0 < len(moduli) < 3:
        return None
    axis = int(interpolant.axes[0])

    def shares(places: np.ndarray) -> np.ndarray:
        """f_κ at values of the parameter, (n, κ)."""
        points = np.repeat(middle[None], len(places), axis=0)
        points[:, axis] = places
        weights = np.array([[modulus.value(point) for modulus in moduli] for point in points])
        if factor is not None:
            weights /= np.array([[factor.value(point)] for point in points])
        if len(moduli) == 1:
            return 1 / weights
        part = np.linspace(0, 1, SHARES)
        return 1 / (weights[:, :1] * part + weights[:, 1:] * (1 - part))

    nodes = interpolant.nodes[:, 0]
    places = np.linspace(interpolant.lower[0], interpolant.upper[0], PLACES)
    exact = shares(places)
    if not (np.isfinite(exact).all() and (exact > 0).all()):
        return None
    found = BarycentricInterpolator(nodes, shares(nodes))(places)
    return float(BETWEEN * np.abs(found / exact - 1).max())
