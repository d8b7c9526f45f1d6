"""The laws of :mod:`hhr_dolfinx.plugins.inelastic.laws` at one Gauss point, compiled for all loops over points.

A kernel returns the flow Δp (increment of cumulated plastic strain) and its derivative by the trial stress; NaN if it
finds none. :func:`hhr_dolfinx.plugins.inelastic.update.kernel_of` returns the kernel of a law and its constants.
"""

from __future__ import annotations

import math

import numpy as np

from hhr_dolfinx.compat import compiled

ITERATIONS = 60
"""Limit of iterations of Newton's method for (6.28), which takes 12 at most over forty decades of stress, m to 1e5."""
ELASTIC = 0
PLASTICITY = 1
NORTON = 2


@compiled()
def flow_at(
    kind: int, first: float, second: float, trial: float, cumulated: float, shear: float, dt: float
) -> tuple[float, float]:
    """Flow and slope of a law at a point, by the number of its kernel and its constants."""
    if kind == PLASTICITY:
        return plastic_flow(first, second, trial, cumulated, shear)
    if kind == NORTON:
        return norton_flow(first, second, trial, shear, dt)
    return 0.0, 0.0


@compiled()
def flows_at(
    kind: int,
    constants: tuple[float, float],
    trial: np.ndarray,
    cumulated: np.ndarray,
    shear: float,
    dt: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Flow and slope at many points, (n,) each."""
    amount = np.empty(trial.size)
    slope = np.empty(trial.size)
    for k in range(trial.size):
        amount[k], slope[k] = flow_at(kind, constants[0], constants[1], trial[k], cumulated[k], shear, dt)
    return amount, slope


@compiled()
def plastic_flow(
    yield_stress: float, hardening: float, trial: float, cumulated: float, shear: float
) -> tuple[float, float]:
    """Closed form of σ0 + H (p + Δp) = q_tr - 3 mu Δp, thesis (6.23)-(6.26)."""
    over = trial - yield_stress - hardening * cumulated
    slope = 1 / (3 * shear + hardening)
    if over <= 0:
        return 0.0, 0.0
    # NaN passes through: the caller reports it
    return over * slope, slope


@compiled()
def norton_flow(resistance: float, exponent: float, trial: float, shear: float, dt: float) -> tuple[float, float]:
    """Newton's method for x = σ_eq in x + 3 mu dt (x / K)^m = q_tr, thesis (6.28).

    The left side is convex and increasing, so that iterates from above fall monotonically to the root. They start at
    the smaller of the two roots with one of the terms alone.
    """
    if not trial > 0:
        return 0.0 * trial, 0.0
    factor = 3 * shear * dt
    x = min(trial, resistance * (trial / factor) ** (1 / exponent))
    for _ in range(ITERATIONS):
        rate = power(x / resistance, exponent)
        step = (x + factor * rate - trial) / (1 + factor * exponent * rate / x)
        x -= step
        if not x > 0:
            return 0.0, 0.0
        if abs(step) < 1e-8 * x:  # squared by this step: round-off
            rate = dt * power(x / resistance, exponent)
            slope = exponent * rate / x
            return rate, slope / (1 + 3 * shear * slope)
    return math.nan, math.nan


@compiled()
def power(base: float, exponent: float) -> float:
    """base**exponent, by products if the exponent is a small integer: ten times as fast."""
    if exponent != np.floor(exponent) or exponent > 32:
        return base**exponent
    result = 1.0
    square = base
    rest = int(exponent)
    while rest:
        if rest & 1:
            result *= square
        rest >>= 1
        if rest:
            square *= square
    return result
