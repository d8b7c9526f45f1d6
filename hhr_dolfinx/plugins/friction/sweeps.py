"""Sweeps over single contacts with friction, each projected on its cone: slow, but nearly always an
improvement.

Compiled if numba is installed; without it they take a hundred times as long, for the few increments
that need sweeps.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx import registry

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.friction.laws import Friction


def swept(
    schur: np.ndarray,
    friction: Friction,
    pressures: np.ndarray,
    stiffness: np.ndarray,
    given: Any,
    forces: np.ndarray,
    count: int,
) -> np.ndarray:
    """Forces after some sweeps over single contacts, (M,).

    Args:
        schur: S, (M, M).
        friction: friction of the rows.
        pressures: rows of pressures, (n,).
        stiffness: force that changes the slack of a row by one, (M,).
        given: loads and friction bounds of the increment.
        forces: forces to start from, (M,).
        count: number of sweeps.
    """
    contact = np.full(len(schur), -1)
    contact[friction.normal] = np.arange(friction.normal.size)
    starts = np.searchsorted(friction.owner, np.arange(friction.normal.size + 1))
    improved = forces.copy()
    layout = pressures, contact[pressures], starts, friction.tangential
    _kernel()(
        np.ascontiguousarray(schur),
        *layout,
        stiffness,
        given.slack,
        given.coefficient,
        given.limit,
        improved,
        count,
    )
    return improved


@lru_cache(maxsize=1)
def _kernel() -> Callable[..., None]:
    compiled = registry.offered("compiled")
    kernel: Callable[..., None] = _sweep if compiled is None else compiled()(_sweep)
    return kernel


def _sweep(
    schur: np.ndarray,
    pressures: np.ndarray,
    contact: np.ndarray,
    starts: np.ndarray,
    tangential: np.ndarray,
    stiffness: np.ndarray,
    slack: np.ndarray,
    coefficient: np.ndarray,
    limit: np.ndarray,
    forces: np.ndarray,
    count: int,
) -> None:
    """Run the sweeps in place."""
    y = np.zeros(2)
    for _ in range(count):
        for k in range(pressures.size):
            row = pressures[k]
            force = max(
                0.0, forces[row] - stiffness[row] * (slack[row] + np.dot(schur[row], forces))
            )
            forces[row] = force
            number = contact[k]
            if number < 0:
                continue
            first = starts[number]
            size = 0.0
            for j in range(first, starts[number + 1]):
                row = tangential[j]
                y[j - first] = forces[row] - stiffness[row] * (
                    slack[row] + np.dot(schur[row], forces)
                )
                size += y[j - first] ** 2
            size = np.sqrt(size)
            bound = limit[number]
            if coefficient[number] < np.inf:
                bound = min(bound, coefficient[number] * force)
            share = bound / size if size > bound else 1.0
            for j in range(first, starts[number + 1]):
                forces[tangential[j]] = y[j - first] * share
