"""Outputs of stress of elastic bodies on pages, in C headers and units: stress per force and load.

Where stiffness and shape are constant a stress is a linear map of forces and amplitudes. Von Mises'
stress of a cell is the norm of its deviator, the largest one and the mean follow in C, and so do
the eigenvalues of a tensor.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.models.displacement import dense
from hhr_dolfinx.models.exact import ExactFields
from hhr_dolfinx.models.functionals.functional import Functional, State
from hhr_dolfinx.plugins.pages.packing import Json, Packed
from hhr_dolfinx.plugins.stress.kinds import (
    PRINCIPAL,
    Mises,
    StrainedMises,
    StressValue,
    component_of,
)

STRESS_NUMBERS = 2**16
"""Most numbers of an output of stress: half a megabyte, a fifth of the largest page."""
ROUND_OFF_OF_AMPLITUDES = 1e-12
"""Relative residual up to which an amplitude is a combination of those of loads: round-off."""
_DEVIATORS = np.array([[0.5**0.5, -(0.5**0.5), 0.0], [*[6**-0.5] * 2, -2 * 6**-0.5]])
"""Orthonormal normal strains without a change of volume, (2, 3)."""


def stress_tree(
    model: Any, item: Functional, number: int, arrays: Packed
) -> dict[str, Json] | None:
    """Output of stress as its tree, with stresses per unit force and amplitude among the arrays.

    None for other outputs; for variable stiffness or shape and for bodies with laws, which have no
    such stresses; for strains that cause no stress by an amplitude that no load has; and for more
    than :data:`STRESS_NUMBERS` numbers.

    Args:
        model: condensed model.
        item: the output.
        number: its number, for names of arrays.
        arrays: arrays of the page.
    """
    if not isinstance(item, Mises) or not isinstance(model.fields, ExactFields):
        return None
    assert model.fields.functionals is not None  # the output is one of them
    if np.size(model.fields.functionals.axes) or _numbers(model, item) > STRESS_NUMBERS:
        return None
    stresses = _per_unit(model, item)
    if stresses is None:
        return None
    if isinstance(item, StressValue):
        tensor = np.einsum("c,cin->in", item.shares, stresses)
        return _of_tensor(tensor, item.component, model.conditions, number, arrays)
    deviators = np.concatenate([np.einsum("di,cin->cdn", _DEVIATORS, stresses[:, :3]),
                                stresses[:, 3:]], axis=1)  # fmt: skip
    tree: dict[str, Json] = {
        "kind": "stress",
        "count": len(deviators),
        "components": deviators.shape[1],
        "stressed": arrays.put(f"output{number}_stressed", 1.5**0.5 * deviators),
    }
    if item.shares.size:
        tree["shares"] = arrays.put(f"output{number}_shares", item.shares)
    return tree


def _numbers(model: Any, item: Mises) -> int:
    """Count of the numbers of the output; a deviator has one less than a stress."""
    columns = model.conditions + model.fields.per_term.shape[1]
    if isinstance(item, StressValue):
        return columns * item.count // item.grading.size
    return columns * (item.count - item.grading.size)


def _of_tensor(
    tensor: np.ndarray, component: int, conditions: int, number: int, arrays: Packed
) -> dict[str, Json]:
    """Component or principal value of a tensor per force and amplitude, (components, m + 1 + T)."""
    if component >= PRINCIPAL:
        return {
            "kind": "stress",
            "count": 1,
            "components": len(tensor),
            "principal": component - PRINCIPAL + 1,
            "stressed": arrays.put(f"output{number}_stressed", tensor),
        }
    _, along, _ = component_of(tensor[:, 0], component)
    weights = along @ tensor
    return {
        "kind": "linear",
        "forces": arrays.put(f"output{number}_forces", weights[:conditions]),
        "terms": arrays.put(f"output{number}_terms", weights[conditions:]),
    }


def _per_unit(model: Any, item: Mises) -> np.ndarray | None:
    """Stress of cells per unit force and amplitude, (cells, components, m + 1 + T).

    None if strains that cause no stress follow no load.
    """
    fields = model.fields
    rows = item.matrix(fields.functionals.size)
    read = np.hstack(
        [-(rows @ fields.per_force), rows @ fields.per_term + dense(rows @ fields.lifts)]
    )
    nothing = np.zeros((0, 1))
    point = model.parameters.middle

    def stress(measured: np.ndarray) -> np.ndarray:
        state = State(nothing[:, 0], measured, point, nothing[:, 0], nothing.copy)
        return item.tensors(state)

    free = stress(np.zeros(item.count))
    stresses = np.stack([stress(column) - free for column in read.T], axis=-1)
    if isinstance(item, StrainedMises):
        for strain, amplitude in zip(item.rest.T, item.strain_amplitudes, strict=True):
            weights = _combination(model, amplitude)
            if weights is None:
                return None
            stresses[..., model.conditions :] -= (stress(strain) - free)[..., None] * weights
    return stresses


def _combination(model: Any, amplitude: Any) -> np.ndarray | None:
    """Weights of the amplitudes of all loads that sum up to one of strains; None without any."""
    terms = model.fields.per_term.shape[1]
    points = model.parameters.random(4 * terms + 8, seed=1)
    loads = np.array([np.eye(terms) @ model.fields.amplitudes(point) for point in points])
    values = np.array([amplitude.value(point) for point in points])
    half = len(points) // 2
    weights = np.linalg.lstsq(loads[:half], values[:half], rcond=1e-10)[0]
    size = (np.abs(loads) @ np.abs(weights)).max(initial=0.0)
    exact = np.abs(loads @ weights - values).max() <= ROUND_OFF_OF_AMPLITUDES * size
    return weights if exact or not values.any() else None
