"""Data of interpolated S on a page."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.plugins.moduli.interpolated import Compliance, Compliances
from hhr_dolfinx.plugins.moduli.interpolation import Interpolant, leja_points
from hhr_dolfinx.plugins.pages.packing import Packed, half, steps_of


def compliances_tree(eliminated: Compliances, arrays: Packed) -> dict[str, Any]:
    """All connected components, and D."""
    parts = [_part(part, number, arrays) for number, part in enumerate(eliminated.parts)]
    reshaped = None if eliminated.reshaped is None else _interpolant(eliminated.reshaped, "gaps", arrays)
    return {
        "schur": None,
        "free_slack": None,
        "parts": parts,
        "gaps": arrays.put("gaps", eliminated.gaps),
        "reshaped": reshaped,
    }


def _part(part: Compliance, number: int, arrays: Packed) -> dict[str, Any]:
    m = part.conditions.size
    modes = part.interpolant.modes.T.reshape(-1, m, m)
    halves = np.array([half(mode) for mode in modes])
    tree = _interpolant(part.interpolant, f"part{number}_", arrays, modes=halves)
    return tree | {
        "conditions": arrays.put(f"part{number}_conditions", part.conditions, "<i4"),
        "terms": arrays.put(f"part{number}_terms", part.terms, "<i4"),
        "forced": int(part.forced.size),
        "factor": steps_of(part.factor),
        "columns": arrays.put(f"part{number}_columns", part.columns),
    }


def _interpolant(found: Interpolant, name: str, arrays: Packed, modes: np.ndarray | None = None) -> dict[str, Any]:
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
