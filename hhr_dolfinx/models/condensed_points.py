"""What a compiled step of condensed flow does at its points, see :mod:`hhr_dolfinx.models.condensed_step`.

Arguments are arrays of :mod:`models.condensed_arrays` by their names there, few of them: each takes time to compile.
"""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.compat import compiled

ANY_ORDER = {"reassoc", "contract"}
"""Sums in any order, so that they run side by side; what is not finite stays so."""


@compiled(inner=True, fastmath=ANY_ORDER)
def set_strain(
    strain: np.ndarray,
    free: np.ndarray,
    forces: np.ndarray,
    order: np.ndarray,
    count: int,
    rows: np.ndarray,
    scale: np.ndarray,
    there: np.ndarray,
    per_mode: np.ndarray,
) -> None:
    """Strain that the laws see."""
    for k in range(strain.size):
        strain[k] = 0.0
    for a in range(count):
        force = forces[order[a]]
        for k in range(strain.size):
            strain[k] -= force * rows[a, k]
    for k in range(scale.size):
        strain[k] *= scale[k]
    for k in range(strain.size):
        strain[k] += free[k]
    for j in range(there.size):
        share = there[j]
        for k in range(strain.size):
            strain[k] += share * per_mode[j, k]


@compiled(inner=True, fastmath=ANY_ORDER)
def set_trial(
    strain: np.ndarray,
    plastic: np.ndarray,
    ends: np.ndarray,
    shear: np.ndarray,
    deviator: np.ndarray,
    trial: np.ndarray,
) -> None:
    """Deviator and equivalent stress of a step without flow."""
    components, points = plastic.shape
    start = 0
    for group in range(ends.size):
        twice = 2 * shear[group]
        end = ends[group]
        for k in range(start, end):
            trial[k] = (strain[k] + strain[points + k] + strain[2 * points + k]) / 3
        for i in range(components):
            for k in range(start, end):
                mean = trial[k] if i < 3 else 0.0
                deviator[i, k] = twice * (strain[i * points + k] - plastic[i, k] - mean)
        start = end
    for k in range(points):
        trial[k] = 0.0
    for i in range(components):
        for k in range(points):
            trial[k] += deviator[i, k] * deviator[i, k]
    for k in range(points):
        trial[k] = np.sqrt(1.5 * trial[k])


@compiled(inner=True)
def possible(ends: np.ndarray, shear: np.ndarray, amount: np.ndarray, slope: np.ndarray, trial: np.ndarray) -> bool:
    """Whether flows are finite and turn no stress round."""
    start = 0
    for group in range(ends.size):
        stiff = 3 * shear[group]
        for k in range(start, ends[group]):
            if not (amount[k] >= 0 and stiff * amount[k] <= trial[k] * (1 + 1e-9) and np.isfinite(slope[k])):
                return False
        start = ends[group]
    return True


@compiled(inner=True)
def set_plastic(
    old: np.ndarray, amount: np.ndarray, trial: np.ndarray, deviator: np.ndarray, plastic: np.ndarray
) -> None:
    """Plastic strain behind the step."""
    components, points = plastic.shape
    for i in range(components):
        for k in range(points):
            along = 1.5 * amount[k] / trial[k] if amount[k] > 0 else 0.0
            plastic[i, k] = old[i, k] + along * deviator[i, k]


@compiled(inner=True, fastmath=ANY_ORDER)
def set_residual(
    tested: np.ndarray,
    plastic: np.ndarray,
    modal: np.ndarray,
    there: np.ndarray,
    coupled: np.ndarray,
    forces: np.ndarray,
    elastic: np.ndarray,
    residual: np.ndarray,
) -> float:
    """R, and the sum of it."""
    components, points = plastic.shape
    total = 0.0
    for j in range(residual.size):
        value = 0.0
        for i in range(components):
            for k in range(points):
                value += tested[j, i * points + k] * plastic[i, k]
        for i in range(there.size):
            value -= modal[j, i] * there[i]
        for i in range(forces.size):
            value -= coupled[j, i] * (forces[i] - elastic[i])
        residual[j] = value
        total += value
    return total


@compiled(inner=True, fastmath=ANY_ORDER)
def flowing_of(
    tested: np.ndarray,
    ends: np.ndarray,
    shear: np.ndarray,
    deviator: np.ndarray,
    trial: np.ndarray,
    amount: np.ndarray,
    slope: np.ndarray,
) -> np.ndarray:
    """w (G V)^T 2 μ dε_p/dε, (ell, c n).

    dε_p/dε = (1 - θ) P + 3/2 (3 μ dΔp/dq - (1 - θ)) s⊗s / q² with 1 - θ = 3 μ Δp / q and the deviatoric projector P.
    """
    components, points = deviator.shape
    turned = np.zeros(points)
    along = np.zeros(points)
    start = 0
    for group in range(ends.size):
        stiff = 3 * shear[group]
        end = ends[group]
        for k in range(start, end):
            if amount[k] > 0:
                q = trial[k]
                turned[k] = stiff * amount[k] / q
                along[k] = 1.5 * (stiff * slope[k] - turned[k]) / (q * q)
        start = end
    found = np.empty(tested.shape, dtype=np.float32)
    onto = np.empty(points)
    for j in range(len(found)):
        for k in range(points):
            onto[k] = 0.0
        for i in range(components):
            for k in range(points):
                onto[k] += tested[j, i * points + k] * deviator[i, k]
        for k in range(points):
            onto[k] *= along[k]
        for i in range(components):
            for k in range(points):
                place = i * points + k
                found[j, place] = tested[j, place] * turned[k] + onto[k] * deviator[i, k]
    return found
