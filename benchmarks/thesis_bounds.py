"""The thesis' own bounds beside its figures 2.3 to 2.6 and 2.8 to 2.11, for ``certified.py``.

Models are those of section 2.6: the half-discs with DEIM of the displacements (9 functions, 8
contacts, as there), the pellet with DEIM of displacements and forces and an FE function for each
contact (68 and 33; 70 and 34 there). Right sides are evaluated in three ways: as the thesis does
it, with moduli for constants, (2.143) and (2.144), and infima over all of the reduced space, of
which it has no proof; with the sharpest constants of the proofs in the same Euclidean norms; and
with those in energy and L2 norms.

What to see: the last two are never exceeded. As printed the effectivities are those of the thesis
where they depend on displacements of the RID, and theorem 6, with alpha in the place of alpha', is
exceeded.
"""

from argparse import Namespace
from typing import Any, NamedTuple

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.theorems.ellipticity import Ellipticity
from hhr_dolfinx.plugins.theorems.theorems import THEOREMS, ThesisBounds
from hhr_dolfinx.study.training.train import Training


class Printed(NamedTuple):
    """What the thesis says of a scene.

    Attributes:
        recipe: of its model.
        metre: a metre in the unit of length by which the stiffness of its scene differs from a
            modulus: in space and with axial symmetry (2.143) is a number of Pa taken for N/m, so
            that effectivities depend on the unit.
        constants: as printed.
        effectivities: mean, smallest and largest, by theorem; figures by theorem.
    """

    recipe: hhr.Recipe
    metre: float
    constants: dict[str, float]
    effectivities: dict[str, tuple[float, float, float]]
    figures: dict[str, str]


THESIS = {
    "half-discs": Printed(
        hhr.Recipe.thesis(5e-9),
        1.0,
        {
            "M_a": 37.03,
            "alpha": 11.11,
            "alpha_prime": 0.005,
            "beta_HR": 0.54,
            "modes": 9,
            "contacts": 8,
        },
        {
            "3": (71.5, 7.9, 732.7),
            "4": (3.0, 2.8, 3.3),
            "5": (5.0, 3.9, 9.1),
            "6": (3.6, 1.9, 18.2),
            "8": (3.0, 2.6, 3.4),
        },
        {"3": "2.3", "4": "2.4a", "5": "2.4b", "6": "2.5", "8": "2.6"},
    ),
    "pellet": Printed(
        hhr.Recipe.thesis(
            1.8e-7,
            nodes=(hhr.Deim(), hhr.ForceDeim(6e-4), hhr.LoadNodes()),
            enrichment=hhr.Enrich(1.0),
        ),
        1e3,
        {
            "M_a": 3.65e11,
            "alpha": 5.82e10,
            "alpha_prime": 18.6e3,
            "beta_HR": 0.5,
            "modes": 70,
            "contacts": 34,
        },
        {
            "3": (20.6e3, 419.0, 5.9e6),
            "4": (6.0, 4.8, 6.2),
            "5": (6.3, 5.5, 10.0),
            "6": (59.9, 3.3, 497.5),
            "8": (4.8, 4.1, 6.2),
        },
        {"3": "2.8", "4": "2.9a", "5": "2.9b", "6": "2.10", "8": "2.11"},
    ),
}
WAYS = ("as printed", "euclidean", "energy")
EXACT = 1e-8
"""Error over the largest of all points below which it is round-off, and its effectivity means
nothing.
"""


def thesis_bounds(
    name: str, training: Training, points: np.ndarray, options: Namespace
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Both sides of the theorems at some points: rows of effectivities, and the constants.

    Draws ``theorems_<scene>.png``.
    """
    printed, full = THESIS[name], training.full_order
    model = training.build(printed.recipe, checked=False)
    moduli = Ellipticity.of_materials(full.scene.bodies)
    moduli = Ellipticity(printed.metre * moduli.continuity, printed.metre * moduli.coercivity)
    prepared = {
        "as printed": ThesisBounds.of(full, model, "euclidean", moduli, as_printed=True),
        "euclidean": ThesisBounds.of(full, model, "euclidean"),
        "energy": ThesisBounds.of(full, model, "energy"),
    }
    found: dict[str, list[dict[str, Any]]] = {way: [] for way in WAYS}
    for point in options.progress(f"{name}, theorems")(points):
        answer, exact = (
            model.solve(point, outside="ignore", raise_on_failure=False),
            full.solve(point),
        )
        if answer.converged:
            for way, bounds in prepared.items():
                found[way].append({**bounds.sides(answer, exact), "point": point})
    rows = [
        _row(name, theorem, way, found[way], prepared[way]) for theorem in THEOREMS for way in WAYS
    ]
    draw(name, found, options)
    return rows, _constants(full, model, moduli, printed)


def _row(
    scene: str, theorem: str, way: str, found: list[dict[str, Any]], bounds: ThesisBounds
) -> dict[str, Any]:
    """Effectivities of a theorem, beside the thesis' where it evaluates it in this way."""
    left, right = _columns(theorem, found)
    off = left > EXACT * left.max(initial=0.0)
    ratio = right[off] / left[off]
    theirs = THESIS[scene].effectivities.get(theorem) if way == "as printed" else None
    figure = THESIS[scene].figures.get(theorem) if way == "as printed" else None
    shares = {"median": 50, "p95": 95, "min": 0, "max": 100}
    row = {
        "scene": scene,
        "theorem": theorem,
        "way": way,
        "answers": len(left),
        "exceeded": int((left > right).sum()),
    }
    row |= {
        key: float(np.percentile(ratio, share)) if ratio.size else None
        for key, share in shares.items()
    }
    row |= {"mean": float(ratio.mean()) if ratio.size else None, "figure": figure}
    row |= dict(
        zip(("thesis mean", "thesis min", "thesis max"), theirs or (None,) * 3, strict=True)
    )
    return {**row, "no bound": bounds.refused.get(theorem)}


def _columns(theorem: str, found: list[dict[str, Any]]) -> np.ndarray:
    """Left and right sides at all points where they could be evaluated, (2, n)."""
    return np.array([row[theorem] for row in found if theorem in row], dtype=float).reshape(-1, 2).T


def _constants(full: Any, model: Any, moduli: Ellipticity, printed: Printed) -> dict[str, Any]:
    """Constants as printed and as they are; in the unit of length of the scene, moduli too."""
    stability, own = model.offline.stability, Ellipticity.of(full)
    shared = {"M_a": own.continuity, "alpha": own.coercivity, "M_a of moduli": moduli.continuity}
    shared |= {"alpha of moduli": moduli.coercivity, "sigma_min": stability.sigma_min}
    for norm in ("euclidean", "energy"):
        constants = getattr(stability, norm)
        names = ("beta_h", "beta_HR", "beta_HR_2", "alpha_prime")
        shared |= {f"{key}, {norm}": getattr(constants, key) for key in names}
    shared |= {"modes": len(model.problem.stiffness), "contacts": len(model.problem.gaps)}
    return {**shared, "cells": len(model.offline.sets.cells), "thesis": printed.constants}


def shown(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """What a reader looks for: medians of the three ways beside each other and beside the thesis'
    mean.
    """
    table = []
    for scene, theorem in dict.fromkeys((row["scene"], row["theorem"]) for row in rows):
        ways = {
            row["way"]: row for row in rows if (row["scene"], row["theorem"]) == (scene, theorem)
        }
        first = ways["as printed"]
        line = {
            "scene": scene,
            "theorem": theorem,
            "figure": first["figure"],
            "thesis, mean": first["thesis mean"],
        }
        line |= {"as printed, mean": first["mean"]}
        line |= {
            f"{way}, median": None if row["no bound"] and way != "as printed" else row["median"]
            for way, row in ways.items()
        }
        exceeded = {name: row["exceeded"] for name, row in ways.items()}
        line |= {
            "as printed, exceeded": exceeded.pop("as printed"),
            "bounds exceeded": sum(exceeded.values()),
        }
        table.append(line)
    return table


def draw(name: str, found: dict[str, list[dict[str, Any]]], options: Namespace) -> None:
    """Both sides over the parameter, or over each other where there are two."""
    from matplotlib.figure import Figure

    figures = THESIS[name].figures
    figure = Figure(figsize=(3 * len(figures), 6), layout="constrained")
    axes = figure.subplots(2, len(figures))
    for row, way in zip(axes, ("as printed", "energy"), strict=True):
        for axis, (theorem, number) in zip(row, figures.items(), strict=True):
            left, right = _columns(theorem, found[way])
            points = np.array([item["point"] for item in found[way] if theorem in item]).reshape(
                len(left), -1
            )
            _draw_sides(axis, points, left, right)
            axis.set_title(
                f"theorem {theorem}, {'figure ' + number if way == 'as printed' else 'energy'}",
                fontsize=8,
            )
    axes[0, 0].legend(fontsize=7)
    figure.savefig(options.out / f"theorems_{name}.png", dpi=150)


def _draw_sides(axis: Any, points: np.ndarray, left: np.ndarray, right: np.ndarray) -> None:
    if points.shape[1] == 1:
        order = np.argsort(points[:, 0])
        axis.semilogy(points[order, 0], left[order], label="error")
        axis.semilogy(points[order, 0], right[order], label="right side")
        axis.set_xlabel("mu")
        return
    axis.loglog(left, right, ".", markersize=3, label="right side")
    ends = np.array(axis.get_xlim())
    axis.loglog(ends, ends, "k-", linewidth=0.8, label="error")
    axis.set_xlabel("error")
