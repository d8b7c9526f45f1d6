"""Figure 2.13 of the thesis: the error of a reduced pellet beside bounds by the chordal distance,
theorem 9.

The pellet is pressed by P1 in [100, 140] MPa up to five heights h1, trained on five pressures at
each, and reduced to five modes by the thesis' recipe. V* spans the five full answers at one
pressure. Right sides are taken with constants of the proof of theorem 6, K = 1 + M_a / alpha' in
the Euclidean norm, and with those that the thesis takes for its figures, the moduli (2.143) and
(2.144), with alpha in the place of alpha'. Neither is proved: the infimum of (2.128) is over all of
the reduced space, and that of the proof over fewer functions (docs/bounds_thesis.md).

What to see: alpha' is near the thesis', 1.7e4 for 1.9e4. With five modes no error exceeds a right
side. In the median the first is 3 times the error with the moduli and 120 times with the constants
of the proof, and the second 600 times the first: sqrt(ell) |gamma*| knows nothing of where the
answer lies. With the ten modes of a POD of 1e-8 the moduli are too small: 28 of 45 errors exceed
the first right side, by up to a factor of 5. With those of the proof none does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pellet_cladding
from mpi4py import MPI
from scipy import linalg

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.plugins.local_models.subspaces import theorem_9
from hhr_dolfinx.plugins.theorems.ellipticity import Ellipticity
from hhr_dolfinx.plugins.theorems.theorems import RIGHT_SIDE_ROUND_OFF, ThesisBounds
from hhr_dolfinx.study.training.train import Training

HEIGHTS = np.array([0.5, 0.75, 1.0, 1.25, 1.5])
"""Heights h1 in mm, as many as V* has functions."""
PRESSURES = np.linspace(100.0, 140.0, 9)
"""Pressures P1 in MPa that are asked for; every second one is trained."""


@dataclass(frozen=True)
class Leading:
    """The leading POD modes, a given number of them.

    Attributes:
        count: ell.
    """

    count: int

    def modes(self, problem: ContactProblem, snapshots: hhr.SnapshotSet) -> np.ndarray:
        """V, (N, ell); see :class:`hhr_dolfinx.reduction.recipe.Basis`."""
        return linalg.svd(snapshots.displacements, full_matrices=False)[0][:, : self.count]


def figure_2_13(folder: Path, quick: bool) -> dict[str, Any]:
    """Both right sides beside the error at nine pressures and five heights.

    Draws ``figure_2_13.png``.

    Args:
        folder: where the picture goes.
        quick: on a coarse mesh.

    Returns:
        ``rows``, each with P1 [MPa], h1 [mm], the error [mm], both bounds, whether they hold, and
        the same with the constants as printed; ``summary`` of them; and ``finer``, the same summary
        of a model of more modes.
    """
    training = _trained(quick)
    thesis = hhr.Recipe.thesis(1e-8)
    models = {"five": training.build(replace(thesis, basis=Leading(HEIGHTS.size)), checked=False),
              "finer": training.build(thesis, checked=False)}  # fmt: skip
    found = {name: _compared(training.full_order, model) for name, model in models.items()}
    _draw(found["five"]["rows"], folder / "figure_2_13.png")
    return found["five"] | {"finer": found["finer"]["summary"]}


def _trained(quick: bool) -> Training:
    """The pellet in the box of the figure, trained on a grid."""
    scene = pellet_cladding.scene(**(pellet_cladding.QUICK_MESH if quick else {}))
    low, high = (PRESSURES[0], HEIGHTS[0]), (PRESSURES[-1], HEIGHTS[-1])
    box = hhr.ParameterSpace(scene.parameters.names, low, high)
    return hhr.train(
        replace(scene, parameters=box), [5, HEIGHTS.size], held_out=0, comm=MPI.COMM_SELF
    )


def _compared(full: Any, model: hhr.ReducedModel) -> dict[str, Any]:
    """Errors and right sides of a model: rows, and a summary."""
    basis, printed = model.offline.basis, Ellipticity.of_materials(full.scene.bodies)
    own = ThesisBounds.of(full, model, "euclidean").constants["6"]
    factors = {"": _factor(own), "printed_": _factor(printed)}
    rows = []
    for pressure in PRESSURES:
        exact = [full.solve((pressure, height)).displacement() for height in HEIGHTS]
        spanned = linalg.svd(np.column_stack(exact), full_matrices=False)[0]
        for height, field in zip(HEIGHTS, exact, strict=True):
            weights = linalg.lstsq(spanned, field)[0]
            error = np.linalg.norm(field - model.solve((pressure, height)).displacement())
            row = {"P1": float(pressure), "h1": float(height), "error": float(error)}
            row["relative"] = float(error / np.linalg.norm(field))
            for name, factor in factors.items():
                sides = theorem_9(spanned, basis, weights, factor)
                holds = error <= sides.angles + RIGHT_SIDE_ROUND_OFF * np.linalg.norm(field)
                row |= {
                    f"{name}bound_129": sides.angles,
                    f"{name}bound_130": sides.distance,
                    f"{name}holds": bool(holds),
                }
            rows.append(row)
    return {
        "rows": rows,
        "summary": _summary(rows, factors)
        | {
            "modes": basis.shape[1],
            "M_a": own.continuity,
            "alpha_prime": own.coercivity,
            "contacts": len(model.problem.gaps),
        },
    }


def _factor(constants: Ellipticity) -> float:
    """1 + M_a / alpha."""
    return 1 + constants.continuity / constants.coercivity


def _summary(rows: list[dict[str, Any]], factors: dict[str, float]) -> dict[str, Any]:
    """How often right sides are exceeded, and right over left side: median, smallest and
    largest.
    """
    error = np.array([row["error"] for row in rows])
    found: dict[str, Any] = {
        "points": len(rows),
        "worst relative error": max(row["relative"] for row in rows),
    }
    for name, factor in factors.items():
        found[f"{name}factor"] = factor
        found[f"{name}exceeded"] = sum(not row[f"{name}holds"] for row in rows)
        for side in ("129", "130"):
            ratio = np.array([row[f"{name}bound_{side}"] for row in rows]) / error
            found[f"{name}effectivity_{side}"] = [
                float(np.median(ratio)),
                float(ratio.min()),
                float(ratio.max()),
            ]
    return found


def _draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Error and right sides over the pressure, a panel for each height."""
    from matplotlib.figure import Figure

    lines = {
        "error": ("error", "k.-"),
        "bound_129": ("(2.129)", "C0-"),
        "bound_130": ("(2.130)", "C1-"),
        "printed_bound_129": ("(2.129), moduli", "C0--"),
        "printed_bound_130": ("(2.130), moduli", "C1--"),
    }
    figure = Figure(figsize=(12, 3.4), layout="constrained")
    axes = figure.subplots(1, HEIGHTS.size, sharey=True)
    for axis, height in zip(axes, HEIGHTS, strict=True):
        own = [row for row in rows if row["h1"] == height]
        for key, (label, style) in lines.items():
            axis.semilogy([row["P1"] for row in own], [row[key] for row in own], style, label=label)
        axis.set(title=f"h1 = {height:g} mm", xlabel="P1 [MPa]")
    axes[0].set_ylabel("|u - u_HR| [mm]")
    axes[0].legend(fontsize=7)
    figure.savefig(path, dpi=150)
