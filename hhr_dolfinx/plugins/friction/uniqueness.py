"""Distance of contact with friction from having several solutions.

Let e = x' - x be the difference of two solutions of an increment. For monotone laws e·S e is at
most the effect of their different bounds, the sum of coefficient |λ' - λ| |slip' - slip|,

    |e|_S^2 <= sum_c f_c |e_n| |(S e)_t| <= f κ |e|_S^2,
    (f κ)^2 = λ_max(D f (S^-1)_nn f D) λ_max(D^-1 S_tt D^-1)

for any positive diagonal D of contacts. Below one the solution is unique.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import linalg

from hhr_dolfinx.plugins.friction.laws import Friction

SYMMETRIC_COMPLIANCE = 1e-8
"""Relative difference between S and its transpose up to which S counts as symmetric."""


def coupling(schur: np.ndarray, friction: Friction, coefficient: np.ndarray) -> float:
    """f κ; below one each increment has a unique solution.

    Infinite if S is singular, NaN if it is not symmetric.

    Args:
        schur: S, (M, M).
        friction: which of the rows are tangential.
        coefficient: of each contact, (C,); infinite for Tresca's law, whose bound does not depend
            on pressure.
    """
    if np.abs(schur - schur.T).max() > SYMMETRIC_COMPLIANCE * np.abs(schur).max():
        return np.nan
    frictional = np.isfinite(coefficient) & (coefficient > 0)
    # rows without effect on unknowns do not move anything, and their forces follow from all others
    acts = np.diag(schur) > 0
    bounded = frictional[friction.owner] & acts[friction.tangential]
    if not bounded.any():
        return 0.0
    rows = friction.tangential[bounded]
    owner = friction.owner[bounded]
    contacts, index = np.unique(owner, return_inverse=True)
    try:
        factor = linalg.cho_factor(schur[np.ix_(acts, acts)])
    except linalg.LinAlgError:
        return np.inf
    normal = (np.cumsum(acts) - 1)[friction.normal[contacts]]
    unit = np.zeros((int(acts.sum()), contacts.size))
    unit[normal, np.arange(contacts.size)] = 1.0
    inverse = linalg.cho_solve(factor, unit)[normal] * np.outer(
        coefficient[contacts], coefficient[contacts]
    )
    tangential = schur[np.ix_(rows, rows)]
    largest = np.zeros(contacts.size)
    np.maximum.at(largest, index, np.diag(tangential))
    weights = (largest / np.diag(inverse)) ** 0.25
    largest_normal = np.linalg.eigvalsh(inverse * np.outer(weights, weights))[-1]
    largest_tangential = np.linalg.eigvalsh(tangential / np.outer(weights[index], weights[index]))[
        -1
    ]
    return math.sqrt(float(largest_normal) * float(largest_tangential))
