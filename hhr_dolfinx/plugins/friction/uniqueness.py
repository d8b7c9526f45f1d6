"""Distance of contact with friction from having several solutions, and of given forces from a unique solution.

Let x and x' solve an increment with slacks w and w' = w + S (x' - x), the second up to a residual r. For monotone
laws (x' - x)·(w' - w) is at most the effect of their different bounds, the sum of coefficient |λ' - λ| |slip' - slip|.
With e = x' - x

    |e|_S^2 <= |r|_{S^-1} |e|_S + sum_c f_c |e_n| |(S e)_t|,        sum_c f_c |e_n| |(S e)_t| <= f κ |e|_S^2,

    (f κ)^2 = λ_max(D f (S^-1)_nn f D) λ_max(D^-1 S_tt D^-1)

for any positive diagonal D of contacts. Below one the solution is unique, and |e|_S <= |r|_{S^-1} / (1 - f κ).
"""

from __future__ import annotations

import math

import numpy as np
from scipy import linalg

from hhr_dolfinx.plugins.friction.laws import Friction
from hhr_dolfinx.plugins.friction.sliding_set import Increment

SYMMETRIC = 1e-8
"""Relative difference between S and its transpose up to which S counts as symmetric."""


def coupling(schur: np.ndarray, friction: Friction, coefficient: np.ndarray) -> float:
    """f κ; below one each increment has a unique solution. Infinite if S is singular, NaN if it is not symmetric.

    Args:
        schur: S, (M, M).
        friction: which of the rows are tangential.
        coefficient: of each contact, (C,); infinite for Tresca's law, whose bound does not depend on pressure.
    """
    if np.abs(schur - schur.T).max() > SYMMETRIC * np.abs(schur).max():
        return np.nan
    frictional = np.isfinite(coefficient) & (coefficient > 0)
    # rows without effect on unknowns do not move anything, and their forces follow from all others
    acts = np.diag(schur) > 0
    kept = frictional[friction.owner] & acts[friction.tangential]
    if not kept.any():
        return 0.0
    rows = friction.tangential[kept]
    owner = friction.owner[kept]
    own, place = np.unique(owner, return_inverse=True)
    try:
        factor = linalg.cho_factor(schur[np.ix_(acts, acts)])
    except linalg.LinAlgError:
        return np.inf
    normal = (np.cumsum(acts) - 1)[friction.normal[own]]
    unit = np.zeros((int(acts.sum()), own.size))
    unit[normal, np.arange(own.size)] = 1.0
    inverse = linalg.cho_solve(factor, unit)[normal] * np.outer(coefficient[own], coefficient[own])
    tangential = schur[np.ix_(rows, rows)]
    largest = np.zeros(own.size)
    np.maximum.at(largest, place, np.diag(tangential))
    weights = (largest / np.diag(inverse)) ** 0.25
    largest_normal = np.linalg.eigvalsh(inverse * np.outer(weights, weights))[-1]
    largest_tangential = np.linalg.eigvalsh(tangential / np.outer(weights[place], weights[place]))[-1]
    return math.sqrt(float(largest_normal) * float(largest_tangential))


def residual(schur: np.ndarray, friction: Friction, given: Increment, forces: np.ndarray) -> np.ndarray:
    """Residual slack of given forces in an increment, (M,), beyond the slip that the law allows.

    The forces must lie in the cones: pressures not negative, tangential forces within their bounds.
    """
    slack = given.slack + schur @ forces
    found = np.where((forces > 0) | (slack < 0), slack, 0.0)
    count = friction.normal.size
    rows = friction.tangential
    owner = friction.owner
    bound = given.bounds(friction, forces)
    size = np.sqrt(np.bincount(owner, forces[rows] ** 2, count))
    # forces at their bound may slip against their direction; all other slack is a residual
    slides = (size >= bound * (1 - 1e-12)) & (bound > 0)
    direction = forces[rows] / np.where(size > 0, size, 1.0)[owner]
    along = np.minimum(np.bincount(owner, slack[rows] * direction, count), 0.0)
    left = slack[rows] - np.where(slides[owner], along[owner] * direction, 0.0)
    found[rows] = np.where(bound[owner] > 0, left, 0.0)
    return found


def error_bound(schur: np.ndarray, friction: Friction, given: Increment, forces: np.ndarray) -> float:
    """Bound of |forces - exact forces| in the norm of S; infinite if several solutions may exist."""
    factor = coupling(schur, friction, given.coefficient)
    if not factor < 1.0:
        return np.inf
    left = residual(schur, friction, given, forces)
    return math.sqrt(max(float(left @ np.linalg.solve(schur, left)), 0.0)) / (1.0 - factor)
