"""Error of an inverse stiffness that is interpolated between parameters, as far as it can be
proved.

Let K(ν) = a(ν) K_a + b(ν) K_b with K_a, K_b positive semi-definite and a, b positive. Both are
diagonal in the same basis, so that K^-1 is a sum of functions f_κ(ν) = 1 / (κ a(ν) + (1 - κ) b(ν)),
0 <= κ <= 1, of dyads that do not depend on ν. Interpolation is linear: that of K^-1 is off by -ε
K^-1 <= Δ <= ε K^-1, in the order of energies, where ε is the largest relative error of the
interpolation of any f_κ: a problem in one variable, for any mesh.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.moduli.interpolate import ProblemComponent, points_of
from hhr_dolfinx.plugins.moduli.interpolation import MOST_LEVELS, leja_points, values_between

SMALLEST = 1e-9
SHARES = 81
EVALUATED_POINTS = 1001
"""Smallest κ, and numbers of κ and of ν, at which the error is evaluated: it oscillates once
between nodes.
"""
BETWEEN = 1.2
"""Factor by which the error may be larger between these."""
OF_VOLUME = 0.6
"""Largest κ if K_a and K_b are the forms of tr(ε)^2 and 2 ε:ε of one body, and a and b Lamé's
constants: ε:ε is at least a third of tr(ε)^2.
"""


@dataclass(frozen=True)
class PartStiffness:
    """Dependence of the stiffness of a part of a scene, of one or two moduli, on its only axis."""

    part: ProblemComponent
    space: ParameterSpace  #: the box; its other parameters have no effect
    of_volume: bool  #: the two moduli are those of the changes of volume and of shape of one body

    def error(self, levels: int) -> float:
        """ε of the interpolation on so many of the Leja points.

        Infinite for an invalid interpolation.
        """
        nodes, exact = self._everywhere
        if not (np.isfinite(exact).all() and (exact > 0).all()):
            return math.inf
        along = np.arange(levels)[:, None]
        return float(
            BETWEEN
            * np.abs(values_between(along, self._at_nodes[:levels], nodes) / exact - 1).max()
        )

    def levels(self, wished: float) -> tuple[int, float]:
        """Number of nodes for a given ε, or the largest number, and its ε."""
        count = 2 + bisect_left(
            range(2, MOST_LEVELS), True, key=lambda levels: self.error(levels) <= wished
        )
        return count, self.error(count)

    @cached_property
    def _everywhere(self) -> tuple[np.ndarray, np.ndarray]:
        """Places in [-1, 1], (n, 1), and f_κ there.

        Some are irregular: expressions may be periodic.
        """
        nodes = np.append(
            np.linspace(-1, 1, EVALUATED_POINTS),
            np.random.default_rng(0).uniform(-1, 1, EVALUATED_POINTS // 4),
        )[:, None]
        return nodes, self._inverses(nodes)

    @cached_property
    def _at_nodes(self) -> np.ndarray:
        """f_κ at all Leja points."""
        return self._inverses(np.array(leja_points())[:, None])

    def _inverses(self, places: np.ndarray) -> np.ndarray:
        """f_κ at places in [-1, 1], (n, 1): (n, κ)."""
        weights = self.part.weights(points_of(self.space, self.part.axes, places))
        if weights.shape[1] == 1:
            return 1 / weights
        # the maximum may be at a small κ, for a stiff K_a, or near 1, for a stiff K_b
        small = np.geomspace(SMALLEST, 0.5, SHARES)
        shares = np.concatenate([[0.0], small, 1 - small[::-1], [1.0]])
        if self.of_volume:
            shares = np.append(shares[shares <= OF_VOLUME], OF_VOLUME)
        return 1 / (weights[:, :1] * shares + weights[:, 1:] * (1 - shares))
