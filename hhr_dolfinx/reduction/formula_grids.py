"""Moduli are numbers: whether a grid resolves their formulas is asked at thousands of points, for nothing but numbers.

The compliance of a part whose stiffness is sum w_q(μ) K_q is made of functions f_κ(μ) = 1 / sum κ_q w_q(μ), with
shares κ >= 0 of energies: exactly so where there are two parts, see :mod:`hhr_dolfinx.certify.interpolation`. What the
polynomials of a grid leave of these they leave of the compliance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from hhr_dolfinx.formulas import Modulus, Scalar
from hhr_dolfinx.models.interpolation import nodes_of, polynomials_of
from hhr_dolfinx.parameters import ParameterSpace

MIXED = (0.1, 0.5)
"""Shares of one part beside equal ones of all others."""


@dataclass(frozen=True)
class FormulaGrid:
    """Holds polynomials of a grid against the formulas of a part that hangs together.

    Attributes:
        moduli: of the parts of its stiffness.
        factor: what these share and the grid leaves out; None for nothing.
        axes: parameters of the grid, (d,).
        space: the box.
    """

    moduli: Sequence[Modulus]
    factor: Scalar | None
    axes: np.ndarray
    space: ParameterSpace

    def error(self, levels: np.ndarray) -> float:
        """Largest error that polynomials, (n, d), leave, relative to the largest f_κ; infinite where one is none."""
        if not self.moduli or not len(self._points_along):
            return 0.0
        nodes = nodes_of(levels)
        known, exact = self._inverses(self._points(nodes)), self._exact
        if not (np.isfinite(known).all() and np.isfinite(exact).all()):
            return np.inf
        # each polynomial vanishes at the nodes before its own
        surpluses = solve_triangular(polynomials_of(levels, nodes), known, lower=True)
        left = polynomials_of(levels, self._scaled(self._points_along)) @ surpluses - exact
        return float((np.abs(left).max(axis=0) / np.abs(exact).max(axis=0)).max(initial=0.0))

    @cached_property
    def _points_along(self) -> np.ndarray:
        """Points along all parameters of the formulas that are axes, (n, P)."""
        names = {name for modulus in self.moduli for scalar in (modulus.factor_scalar, modulus.rest_scalar)
                 for name in scalar.formula.variables}  # fmt: skip
        return self.space.lines([axis for axis in self.axes.tolist() if self.space.names[axis] in names])

    @cached_property
    def _exact(self) -> np.ndarray:
        """f_κ at these points, (n, k)."""
        return self._inverses(self._points_along)

    @cached_property
    def _shares(self) -> np.ndarray:
        """κ of a few mixtures that stand for all, (Q, k), of parts as large as they become.

        A part may be negative, as the change of volume is for auxetic bodies; a mixture that is does not occur.
        """
        weights, count = self._weights(self._points_along), len(self.moduli)
        shares = [np.ones(count) / count]
        for mixed in MIXED if count > 1 else ():
            shares += list(mixed / (count - 1) * (1 - np.eye(count)) + (1 - mixed) * np.eye(count))
        found = (np.array(shares) / np.abs(weights).max(axis=0)).T
        return found[:, ~(weights @ found <= 0).any(axis=0)]

    def _weights(self, points: np.ndarray) -> np.ndarray:
        """w_q without the factor, at points, (n, P): (n, Q)."""
        weights = np.stack([modulus.values(points) for modulus in self.moduli], axis=1)
        return weights if self.factor is None else weights / self.factor.values(points)[:, None]

    def _inverses(self, points: np.ndarray) -> np.ndarray:
        """f_κ at points, (n, P): (n, k)."""
        return 1 / (self._weights(points) @ self._shares)

    @property
    def _middle(self) -> np.ndarray:
        return np.mean([self.space.lower, self.space.upper], axis=0)

    def _points(self, scaled: np.ndarray) -> np.ndarray:
        """Points of the box, (n, P), at places of the axes in [-1, 1]^d."""
        lower, upper = (np.array(end)[self.axes] for end in (self.space.lower, self.space.upper))
        points = np.repeat(self._middle[None], len(scaled), axis=0)
        points[:, self.axes] = lower + (scaled + 1) / 2 * (upper - lower)
        return points

    def _scaled(self, points: np.ndarray) -> np.ndarray:
        """Places of the axes in [-1, 1]^d, (n, d)."""
        lower, upper = (np.array(end)[self.axes] for end in (self.space.lower, self.space.upper))
        return 2 * (points[:, self.axes] - lower) / (upper - lower) - 1
