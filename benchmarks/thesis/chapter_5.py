"""Chapter 5 of the thesis: contact meshes that do not match."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from chapter_3 import draw_maps
from items import NONMATCHING, Cases, Item, milliseconds, of_map, percent, sizes
from pellet_cladding_nonmatching import POINT, THESIS

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.plugins.theorems.ellipticity import Ellipticity
from hhr_dolfinx.plugins.theorems.theorems import ThesisBounds

NODES = hhr.Deim(), hhr.ForceDeim(1e-3), hhr.LoadNodes()
LAYERS = 0, 1, 2, 4
"""Layers of cells around the RID of the thesis' recipe, the first of which is the thesis' own."""
METRE = 1e3
"""A metre in mm, see ``thesis_bounds.Printed``."""
EFFECTIVITIES = {
    "5": ("figure 5.14a", "displacement on the RID, (2.80)", "a picture: holds, ratio constant"),
    "6": ("figure 5.14b", "displacement on the whole mesh, (2.87)", "a picture: holds"),
    "8": ("figure 5.15", "a posteriori, (2.116)", "a picture: holds, though (H2) does not"),
}


def items(cases: Cases) -> Iterator[Item]:
    """Items of the chapter."""
    yield Item("figures 5.1 to 5.3", "node to surface, and closed RIDs", "a drawing")
    models = _models(cases)
    printed = models[min(models)]
    yield _sizes(cases, models)
    yield from at_the_point(cases, printed, min(models))
    yield times(cases, printed)
    yield the_map(cases, printed, min(models))
    yield from bounds(cases, printed)


def _models(cases: Cases) -> dict[int, Any]:
    """Models by the thesis' recipe that have an answer at its point, by layers of the RID."""
    found = {}
    for layers in LAYERS:
        recipe = hhr.Recipe.thesis(
            1e-6, domain=hhr.Rid(layers, layers), nodes=NODES, enrichment=hhr.Enrich(1.0)
        )
        try:
            model = cases.nonmatching.build(recipe, checked=False)
        except HHRError:
            continue
        if model.solve(POINT, raise_on_failure=False).converged:
            found[layers] = model
    return found


def _usual(cases: Cases) -> Any:
    """Model by default."""
    if "nonmatching" not in cases.built:
        cases.built["nonmatching"] = cases.nonmatching.build(checked=False)
    return cases.built["nonmatching"]


def _sizes(cases: Cases, models: dict[int, Any]) -> Item:
    problem = cases.nonmatching.full_order.problem
    layers = min(models)
    return Item(
        "figure 5.4",
        "mesh and RID",
        "N = 13708, N_lambda = 101, ell = 35, N_C = 53, ell_bar = 88",
        f"N = {problem.free.size}, {problem.pressing_of(0).size} conditions on the side, "
        f"{sizes(models[layers])}, {_layers(layers)}",
        sizes(_usual(cases)),
        "without layers cond(K~) is 1e9 and there is no answer" if layers else "another mesh",
        NONMATCHING,
    )


def _layers(count: int) -> str:
    """Layers of cells more, in words."""
    return "one layer of cells more" if count == 1 else f"{count} layers of cells more"


def _errors(answer: Answer, exact: Answer, mass: Any, inside: np.ndarray) -> dict[str, float]:
    """Errors of section 5.3.2 by name."""
    return {
        "primal_l2": relative_error(answer.displacement(), exact.displacement(), mass),
        "dual_rid": relative_error(answer.multipliers, exact.forces()[inside]),
        "von_mises": relative_error(von_mises(answer.stress()), von_mises(exact.stress())),
        "sigma_rr": relative_error(answer.stress()[:, 0], exact.stress()[:, 0]),
    }


def at_the_point(cases: Cases, printed: Any, layers: int) -> Iterator[Item]:
    """Figures 5.5 to 5.12: fields and forces at (190 MPa, 5.2 mm)."""
    full = cases.nonmatching.full_order
    exact = full.solve(POINT)
    answers = {"as_printed": printed.solve(POINT), "ours": _usual(cases).solve(POINT)}
    texts = {}
    for name, answer in answers.items():
        found = _errors(answer, exact, full.problem.mass, answer.fields.A_lambda)
        texts[name] = ", ".join(map(percent, found.values()))
    reason = f"{_layers(layers)}, without which there is no answer" if layers else ""
    yield Item(
        "figures 5.5, 5.6, 5.8, 5.9, 5.11, 5.12 and table 5.1",
        "displacement, forces in the RID, von Mises, sigma_rr at (190 MPa, 5.2 mm)",
        ", ".join(map(percent, THESIS.values())),
        **texts,
        reason=reason,
        command=NONMATCHING,
    )
    largest = {
        name: np.abs(answer.displacement() - exact.displacement()).reshape(-1, 2).max(axis=0)
        for name, answer in answers.items()
    }
    stresses = {
        name: np.abs(von_mises(answer.stress()) - von_mises(exact.stress())).max()
        for name, answer in answers.items()
    }
    yield Item(
        "figures 5.7 and 5.10",
        "largest absolute errors there: u_r, u_z, von Mises",
        "0.3 um, 0.09 um, 35.5 MPa",
        *(
            f"{1e3 * largest[name][0]:.1e} um, {1e3 * largest[name][1]:.1e} um, "
            f"{stresses[name]:.2g} MPa"
            for name in answers
        ),
        reason="the largest error is where contact ends, as there",
        command=NONMATCHING,
    )


def times(cases: Cases, printed: Any) -> Item:
    """Table 5.1: times."""
    full = cases.nonmatching.full_order
    fresh = full.parameters.random(30 if cases.quick else 105, cases.seed + 4)
    models = {"printed": printed, "default": _usual(cases), "full": full}
    found = milliseconds(models, fresh)
    texts = {
        name: f"{found[name]:.2g} ms: {found['full'] / found[name]:.1f} times"
        for name in ("printed", "default")
    }
    return Item(
        "table 5.1",
        "time of an answer",
        "508 ms, full 1836 ms: 3.6 times",
        f"{texts['printed']}, full {found['full']:.2g} ms",
        texts["default"],
        "the full order keeps factors of K, Cast3M factors anew",
        NONMATCHING,
    )


def the_map(cases: Cases, printed: Any, layers: int) -> Item:
    """Figure 5.13: a map of the errors of forces."""
    points = cases.nonmatching_points
    found = {"thesis": points.errors(printed), "default": points.errors(_usual(cases))}
    draw_maps(cases, points, found, "figure_5_13")
    return Item(
        "figure 5.13",
        f"forces in the RID at {len(points.points)} points",
        "a picture, as figure 3.9",
        of_map(found["thesis"].rid, points),
        of_map(found["default"].rid, points),
        f"{_layers(layers)} than in the thesis",
        NONMATCHING,
    )


def bounds(cases: Cases, printed: Any) -> Iterator[Item]:
    """Figures 5.14 and 5.15: theorems 5, 6 and 8 on meshes that do not match."""
    full = cases.nonmatching.full_order
    moduli = Ellipticity.of_materials(full.scene.bodies)
    moduli = Ellipticity(METRE * moduli.continuity, METRE * moduli.coercivity)
    ways = {
        "as printed": ThesisBounds.of(full, printed, "euclidean", moduli, as_printed=True),
        "energy": ThesisBounds.of(full, printed, "energy"),
    }
    points = full.parameters.random(12 if cases.quick else 100, cases.seed + 3)
    sides: dict[str, list[Any]] = {way: [] for way in ways}
    for point in cases.progress("figures 5.14 and 5.15")(points):
        answer = printed.solve(point, outside="ignore", raise_on_failure=False)
        if answer.converged:
            exact = full.solve(point)
            for way, theorems in ways.items():
                sides[way].append(theorems.sides(answer, exact))
    for theorem, (number, what, said) in EFFECTIVITIES.items():
        texts = {way: _effectivity(theorem, found) for way, found in sides.items()}
        refused = ways["energy"].refused.get(theorem)
        yield Item(
            number,
            f"theorem {theorem} on meshes that do not match: {what}",
            said,
            texts["as printed"],
            f"refused: {refused}" if refused else texts["energy"],
            "as printed it is no bound" if refused else "energy norms and constants of the proofs",
            "python benchmarks/certified.py",
        )


def _effectivity(theorem: str, found: list[Any]) -> str:
    """Right over left side of a theorem: mean, smallest, largest, and how often exceeded."""
    pairs = np.array([row[theorem] for row in found if theorem in row], dtype=float).reshape(-1, 2)
    if not len(pairs):
        return "not evaluated"
    left, right = pairs[pairs[:, 0] > 1e-8 * pairs[:, 0].max()].T
    ratio = right / left
    exceeded = int((ratio < 1).sum())
    return (
        f"right over left side {ratio.mean():.3g} ({ratio.min():.3g} to {ratio.max():.3g}), "
        f"exceeded at {exceeded} of {len(ratio)} points"
    )
