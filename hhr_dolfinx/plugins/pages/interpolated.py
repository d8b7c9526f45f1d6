"""Data of interpolated S on a page, and of the error bound at the point shown.

Forces of a page solve the contact problem with the S of its bound, so the interpolation is the only
error: the part ``inexact`` of energies, see :mod:`hhr_dolfinx.plugins.moduli.varying_bound`.
Energies of fields need the modes of P^T K^-1 P. The largest forces of a given energy follow from S
at the point.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.models.bound import BOUND_ROUND_OFF
from hhr_dolfinx.plugins.moduli.interpolated import Compliance, Compliances
from hhr_dolfinx.plugins.moduli.interpolation import Interpolant, leja_points
from hhr_dolfinx.plugins.moduli.varying_bound import VaryingBound
from hhr_dolfinx.plugins.pages.packing import BASE64, Json, Packed, half, steps_of

MOST_ENERGY_BYTES = 500_000
"""Most bytes for energies; without them a page shows the largest error at random points only."""


def compliances_tree(eliminated: Compliances, arrays: Packed) -> dict[str, Json]:
    """All connected components, and D.

    Args:
        eliminated: interpolated compliances.
        arrays: packed arrays, to which those of the tree are added.
    """
    return {
        "schur": None,
        "free_slack": None,
        "parts": [
            _part(compliance, number, arrays) for number, compliance in enumerate(eliminated.parts)
        ],
        "gaps": arrays.put("gaps", eliminated.gaps),
        "reshaped": None
        if eliminated.reshaped is None
        else _interpolant(eliminated.reshaped, "gaps", arrays),
    }


def _part(part: Compliance, number: int, arrays: Packed) -> dict[str, Json]:
    m = part.conditions.size
    halves = np.array([half(mode) for mode in part.interpolant.modes.T.reshape(-1, m, m)])
    return _interpolant(part.interpolant, f"part{number}_", arrays, modes=halves) | {
        "conditions": arrays.put(f"part{number}_conditions", part.conditions, "<i4"),
        "terms": arrays.put(f"part{number}_terms", part.terms, "<i4"),
        "forced": int(part.forced.size),
        "factor": steps_of(part.factor),
        "columns": arrays.put(f"part{number}_columns", part.columns),
    }


def _interpolant(
    found: Interpolant, name: str, arrays: Packed, modes: np.ndarray | None = None
) -> dict[str, Json]:
    """Polynomial on a sparse grid, with concatenated modes."""
    top = int(found.levels.max(initial=0))
    return {
        "axes": found.axes.tolist(),
        "lower": found.lower.tolist(),
        "upper": found.upper.tolist(),
        "nodes": list(leja_points()[: top + 1]),
        "levels": arrays.put(f"{name}levels", found.levels, "<i4"),
        "weights": arrays.put(f"{name}weights", found.weights),
        "modes": arrays.put(f"{name}modes", found.modes.T if modes is None else modes),
    }


def alike(one: Compliances, other: Compliances) -> bool:
    """True if two compliances of one scene have the same interpolation.

    In a file both are one object.

    Args:
        one: compliances.
        other: compliances of as many components.
    """
    pairs = [(a.interpolant, b.interpolant) for a, b in zip(one.parts, other.parts, strict=True)]
    return all(
        np.array_equal(a.weights, b.weights) and np.array_equal(a.modes, b.modes) for a, b in pairs
    )


def bound_tree(model: Any, arrays: Packed) -> dict[str, Json] | None:
    """Bound of an elastic model as plain values.

    None without a bound, or if its data are too large.

    Args:
        model: condensed model.
        arrays: packed arrays, to which those of the tree are added.
    """
    bound = getattr(model.fields, "bound", None)
    if not isinstance(bound, VaryingBound) or not alike(bound.compliances, model.eliminated):
        return None
    halves = [np.array([half(mode) for mode in energy.work]) for energy in bound.energies]
    if BASE64 * sum(modes.nbytes for modes in halves) > MOST_ENERGY_BYTES:
        return None
    return {
        "inexact": max(bound.inexact, BOUND_ROUND_OFF),
        "least": bound.least.tolist(),
        "areas": None
        if bound.reshaped_areas is not None
        else arrays.put("bound_areas", bound.areas),
        "work": [arrays.put(f"bound_work{number}", modes) for number, modes in enumerate(halves)],
    }
