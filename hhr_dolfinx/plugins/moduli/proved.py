"""Error of an inverse stiffness that is interpolated between parameters, as far as it can be proved.

Let K(ν) = a(ν) K_a + b(ν) K_b with K_a, K_b positive semi-definite and a, b positive. Both are diagonal in the same
basis, so that K^-1 is a sum of functions f_κ(ν) = 1 / (κ a(ν) + (1 - κ) b(ν)), 0 <= κ <= 1, of dyads that do not depend
on ν. Interpolation is linear: that of K^-1 is off by -ε K^-1 <= Δ <= ε K^-1, in the order of energies, where ε is the
largest relative error of the interpolation of any f_κ: a problem in one variable, for any mesh.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hhr_dolfinx.formulas import Modulus, Scalar
from hhr_dolfinx.plugins.moduli.interpolation import MOST_LEVELS, leja_points

SMALLEST = 1e-9
SHARES = 81
PLACES = 1001
"""Smallest κ, and numbers of κ and of ν, at which the error is evaluated: it oscillates once between nodes."""


BETWEEN = 1.2
"""Factor by which the error may be larger between these."""


OF_VOLUME = 0.6
"""Largest κ if K_a is λ tr(ε)^2 and K_b is 2 μ ε:ε of one body: ε:ε is at least a third of tr(ε)^2."""


def lagrange(nodes: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Lagrange polynomials of nodes, (n,), at places, (m,): (m, n), by the second barycentric formula.

    J.-P. Berrut and L. N. Trefethen, SIAM Review 46, 2004, (4.2). SciPy's order of the nodes differs from run to run,
    and so do the last bits of a bound. Factors are scaled by the capacity of the interval, so that products of many
    neither overflow nor underflow.
    """
    apart = 4 / np.ptp(nodes) * (nodes[:, None] - nodes)
    np.fill_diagonal(apart, 1.0)
    off = places[:, None] - nodes
    at_node = off == 0
    terms = 1 / (np.where(at_node, 1.0, off) * apart.prod(axis=1))
    terms = np.where(at_node.any(axis=1)[:, None], at_node, terms)
    return terms / terms.sum(axis=1)[:, None]


@dataclass(frozen=True)
class PartStiffness:
    """Dependence of the stiffness of a part of a scene on one parameter."""

    moduli: Sequence[Modulus]  # of its parts, one or two
    factor: Scalar | None  # common factor, which an interpolation leaves out; None without one
    axis: int  # index of the parameter
    lower: float  # its limits, as the next
    upper: float
    middle: np.ndarray  # a point of the box, (P,), whose other parameters have no effect
    of_volume: bool  # the two parts are the changes of volume and of shape of one body

    def error(self, levels: int) -> float:
        """ε of the interpolation on so many of the Leja points; infinite for an invalid interpolation."""
        places, exact = self._everywhere
        nodes, known = self._at_nodes
        if not (np.isfinite(exact).all() and (exact > 0).all()):
            return math.inf
        # the polynomials are the same for all κ
        weights = lagrange(nodes[:levels], places)
        return float(BETWEEN * np.abs(weights @ known[:levels] / exact - 1).max())

    def levels(self, wished: float) -> tuple[int, float]:
        """Number of nodes for a given ε, or the largest number, and its ε."""
        low = 2
        high = MOST_LEVELS
        while low < high:
            middle = (low + high) // 2
            low, high = (low, middle) if self.error(middle) <= wished else (middle + 1, high)
        return high, self.error(high)

    @cached_property
    def _everywhere(self) -> tuple[np.ndarray, np.ndarray]:
        """Points at which the error is evaluated, and f_κ there; some are irregular: expressions may be periodic."""
        places = np.linspace(self.lower, self.upper, PLACES)
        places = np.append(places, np.random.default_rng(0).uniform(self.lower, self.upper, PLACES // 4))
        return places, self._inverses(places)

    @cached_property
    def _at_nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes, and f_κ there."""
        nodes = self.lower + (np.array(leja_points()) + 1) / 2 * (self.upper - self.lower)
        return nodes, self._inverses(nodes)

    def _inverses(self, places: np.ndarray) -> np.ndarray:
        """f_κ at values of the parameter, (n, κ)."""
        points = np.repeat(self.middle[None], len(places), axis=0)
        points[:, self.axis] = places
        weights = np.array([[modulus.value(point) for modulus in self.moduli] for point in points])
        if self.factor is not None:
            weights /= np.array([[self.factor.value(point)] for point in points])
        if len(self.moduli) == 1:
            return 1 / weights
        # the maximum may be at a small κ, for a stiff K_a, or near 1, for a stiff K_b
        small = np.geomspace(SMALLEST, 0.5, SHARES)
        part = np.concatenate([[0.0], small, 1 - small[::-1], [1.0]])
        if self.of_volume:
            part = np.append(part[part <= OF_VOLUME], OF_VOLUME)
        return 1 / (weights[:, :1] * part + weights[:, 1:] * (1 - part))
