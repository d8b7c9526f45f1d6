"""What a page needs to tell how far off its answer may be at the point shown, where S is interpolated.

Forces of a page solve the contact problem on the S that its bound knows, so that nothing but the interpolation is off:
the part ``inexact`` of energies, see :mod:`hhr_dolfinx.models.bounds.varying_bound`. Energies of fields take the modes
of P^T K^-1 P; what forces of a small energy may be at most follows from S at the point.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.models.bounds.bound import ROUND_OFF
from hhr_dolfinx.models.bounds.varying_bound import VaryingBound
from hhr_dolfinx.models.eliminations.interpolated import Compliances
from hhr_dolfinx.plugins.pages.packing import BASE64, Packed, half

MOST_BYTES = 500_000
"""Of a page for energies; without them it tells the largest error at random points alone."""


def alike(one: Compliances, other: Compliances) -> bool:
    """Whether two of one scene interpolate the same; what a file keeps is the same object for both."""
    pairs = [(a.interpolant, b.interpolant) for a, b in zip(one.parts, other.parts, strict=True)]
    return all(np.array_equal(a.weights, b.weights) and np.array_equal(a.modes, b.modes) for a, b in pairs)


def bound_tree(model: Any, arrays: Packed) -> dict[str, Any] | None:
    """The bound of an elastic model as plain values; None where it has none, or one that is too large."""
    bound = getattr(model.fields, "bound", None)
    if not isinstance(bound, VaryingBound) or not alike(bound.compliances, model.eliminated):
        return None
    halves = [np.array([half(mode) for mode in energy.work]) for energy in bound.energies]
    if BASE64 * sum(modes.nbytes for modes in halves) > MOST_BYTES:
        return None
    return {
        "inexact": max(bound.inexact, ROUND_OFF),
        "least": bound.least.tolist(),
        "areas": None if bound.reshaped_areas is not None else arrays.put("bound_areas", bound.areas),
        "work": [arrays.put(f"bound_work{number}", modes) for number, modes in enumerate(halves)],
    }
