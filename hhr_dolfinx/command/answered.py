"""One answer in rows of numbers, with their units where the scene says them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.scene import Scene


def largest_values(answer: Answer, dimension: int, scene: Scene | None, pairs: np.ndarray | None) -> dict[str, float]:
    """The largest displacement, the sum of the forces of each contact, and how many conditions touch.

    Args:
        answer: of any model.
        dimension: of the mesh.
        scene: where it is there, else None: a model in a file does not say its units.
        pairs: contact of each condition, (N_lambda,); None where that is not known: the sum is then that of all.
    """
    units = None if scene is None else scene.units
    per_depth = scene is not None and scene.hypothesis.startswith("plane")
    length, force = ("", "") if units is None else (units.length, units.force + f"/{units.length}" * per_depth)
    displacement, forces = answer.displacement().reshape(-1, dimension), answer.forces()
    rows = {_with("largest displacement", length): float(np.linalg.norm(displacement, axis=1).max())}
    several = pairs is not None and np.unique(pairs).size > 1
    if pairs is None or scene is None:
        rows[_with("sum of the forces of all contacts", force)] = float(forces.sum())
    else:
        for number in np.unique(pairs):
            which = f" {number} of {', '.join(map(str, scene.contacts[number].tags))}" if several else ""
            name = f"sum of the forces of contact{which}" if several else "sum of contact forces"
            rows[_with(name, force)] = float(forces[pairs == number].sum())
    return rows | {"conditions that touch": int((forces > 0).sum())}


def _with(name: str, unit: str) -> str:
    """A name with its unit."""
    return f"{name} [{unit}]" if unit else name
