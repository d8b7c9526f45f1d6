"""Chapter 3 of the thesis: enrichment led by the condition number of the contact rows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from items import (
    DISCS,
    PELLET,
    Cases,
    Item,
    Maps,
    Points,
    milliseconds,
    of_map,
    percent,
    sizes,
)
from matplotlib.figure import Figure
from pellet_cladding_tables import ERRORS, POINTS, thesis
from thesis_output import plot_maps

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.plugins.studies.measure import References

KAPPAS = 1e12, 1e4, 1e3, 300.0, 100.0, 30.0, 10.0, 5.0, 3.0, 2.0, 1.5, 1.0
"""Condition numbers down to which enrichment goes in figures 3.1 and 3.5."""
TABLE_3_1 = (170.0, 3.2), (30.0, 5.25)
SMALL_RID, LARGE_RID = 4e-4, 1e-4
"""Tolerances of DEIM of forces: 34 and 60 conditions in the thesis."""
EXTENDED = 3.5e-7
"""Tolerance of the extended POD: nine modes more."""
LABELS = "P1 [MPa]", "h1 [mm]"


def items(cases: Cases) -> Iterator[Item]:
    """Items of the chapter."""
    yield from kappa(cases)
    yield from discs(cases)
    yield domain(cases)
    yield table_3_1(cases)
    yield from at_a_point(cases)
    yield from maps(cases)
    yield times(cases, "table 3.2", SMALL_RID, "220 and 270 ms; full 4829 ms: 21.9 and 17.8 times")
    yield large_domain(cases)
    yield times(cases, "table 3.3", LARGE_RID, "919 and 1092 ms; full 4829 ms: 5.3 and 4.4 times")
    yield maximal(cases)


class Enriched(NamedTuple):
    """A model at one kappa_max: kappa(B~), modes, median errors, and the error at a point."""

    kappa: float
    modes: int
    forces: float
    displacement: float
    at_point: float


def kappa(cases: Cases) -> Iterator[Item]:
    """Figures 3.1 and 3.5: errors beside the condition number of the contact rows."""
    training = cases.pellet
    points = training.full_order.parameters.random(20 if cases.quick else 60, cases.seed + 2)
    points = np.vstack([POINTS[:1], points])
    exact = Points.of(training, points, cases.progress("figures 3.1 and 3.5"))
    found: dict[str, list[Enriched]] = {"FE": [], "POD + FE": []}
    for name, extended in (("FE", None), ("POD + FE", EXTENDED)):
        for most in KAPPAS:
            try:
                model: Any = cases.pellet_model(SMALL_RID, extended, most)
            except HHRError:  # before the rows are independent there is no model
                continue
            errors = exact.errors(model)
            stability = model.offline.stability
            row = stability.kappa_B, model.offline.basis.shape[1]
            there = np.isfinite(errors.rid[1:])
            if not there.any():
                continue
            medians = (float(np.median(part[1:][there])) for part in (errors.rid, errors.primal))
            found[name].append(Enriched(*row, *medians, float(errors.rid[0])))
    _draw_kappa(found, cases)
    rows = np.array([row[:4] for row in found["FE"] if np.isfinite(row[:4]).all()])
    logs = np.log(rows)
    dual, primal = (np.corrcoef(logs[:, 0], logs[:, k])[0, 1] for k in (2, 3))
    yield Item(
        "figure 3.1",
        "condition number of the contact rows beside errors",
        "a picture: forces improve as kappa goes to 1, displacements hardly",
        f"{len(rows)} enrichments, log-log correlation with kappa: forces {dual:.2f}, "
        f"displacement {primal:.2f}",
        "kappa_max 3 by default",
        command="make thesis",
    )
    first, last = found["FE"][0], found["FE"][-1]
    ten = next(row for row in found["FE"] if row.kappa <= 10)
    more = next((row for row in found["POD + FE"] if row.kappa <= 10), last)
    yield Item(
        "figure 3.5",
        "enrichment by FE and by POD + FE, at (170 MPa, 3.2 mm)",
        "solvable at 40 modes, kappa > 1000, forces > 70 %; kappa 10: 55 modes, 6.3 %; "
        "maximal: 2 %",
        f"solvable at {first.modes} modes, kappa {first.kappa:.2g}, forces "
        f"{percent(first.at_point)}; kappa 10: {ten.modes} modes, {percent(ten.at_point)}; "
        f"maximal: {percent(last.at_point)}; POD + FE at kappa 10: {more.modes} modes, "
        f"{percent(more.at_point)}",
        reason=_other_nodes(cases),
    )


def _other_nodes(cases: Cases) -> str:
    """Why figures of the pellet's RID differ."""
    inside = len(cases.pellet_model(SMALL_RID).fields.A_lambda)
    return (
        f"DEIM picks other nodes of another mesh: {inside} conditions in the place of 34"
        if inside != 34
        else "DEIM picks other nodes of another mesh"
    )


def _draw_kappa(found: dict[str, list[Enriched]], cases: Cases) -> None:
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    by_kappa, by_modes = figure.subplots(1, 2)
    for color, (name, rows) in zip(("C0", "C1"), found.items(), strict=True):
        kappas = [row.kappa for row in rows]
        by_kappa.loglog(kappas, [row.forces for row in rows], f"{color}.-", label=f"{name}, forces")
        by_kappa.loglog(kappas, [row.displacement for row in rows], f"{color}.--",
                        label=f"{name}, displacement")  # fmt: skip
        by_modes.semilogy([row.modes for row in rows], [row.at_point for row in rows],
                          f"{color}.-", label=name)  # fmt: skip
    by_kappa.set(xlabel="kappa(B~)", ylabel="median relative error", title="figure 3.1")
    by_modes.set(xlabel="modes", ylabel="error of forces", title="figure 3.5a, (170 MPa, 3.2 mm)")
    for axis in (by_kappa, by_modes):
        axis.legend(fontsize=8)
    figure.savefig(cases.folder / "figure_3_1_and_3_5.png", dpi=180)


def discs(cases: Cases) -> Iterator[Item]:
    """Figures 3.2 and 3.3: the half-discs at 101 points."""
    training = cases.discs
    points = training.full_order.parameters.grid([11 if cases.quick else 101])
    references = References.at(points, training.full_order, training.snapshots)
    models = {
        "as_printed": training.build(hhr.Recipe.thesis(1e-8), checked=False),
        "ours": training.build(checked=False),
    }
    texts = {}
    for name, model in models.items():
        values = references.errors(model).values
        worst = {key: float(values[key].max()) for key in ("primal_euclid", "dual_rid")}
        texts[name] = (
            f"displacement {percent(worst['primal_euclid'])}, forces in the RID "
            f"{percent(worst['dual_rid'])}, energy {values['energy_minimum'].max():.1e}"
        )
    stability = models["as_printed"].offline.stability
    yield Item(
        "figure 3.2",
        "RID of the half-discs",
        "ell = 9, N_C = 8, kappa = 3.4",
        f"{sizes(models['as_printed'])}, kappa = {stability.kappa_B:.2g}",
        sizes(models["ours"]),
        "eight modes at 1e-8 here, nine at 5e-9: another mesh; two layers of cells more by default",
        DISCS,
    )
    yield Item(
        "figure 3.3",
        "largest errors of the half-discs at 101 points",
        "displacement .05 %, forces in the RID .1 to .8 %, energy 1e-4",
        **texts,
        reason="with a larger RID all of the surface is in it",
        command=DISCS,
    )


def domain(cases: Cases) -> Item:
    """Figure 3.4: RIDs of the pellet by DEIM of displacements, and of forces too."""
    recipe = hhr.Recipe.thesis(1e-6, enrichment=hhr.Enrich(1.0))
    try:
        alone = sizes(cases.pellet.build(recipe, checked=False))
    except HHRError as error:
        alone = f"refused: {error}"
    return Item(
        "figure 3.4",
        "RID of the pellet by DEIM of displacements (a), and of forces too (b)",
        "ell = 36; N_C = 12 (a), 34 (b)",
        f"(a) {alone}; (b) {sizes(cases.pellet_model(SMALL_RID))}",
        sizes(cases.pellet_usual),
        _other_nodes(cases),
        PELLET,
    )


def table_3_1(cases: Cases) -> Item:
    """Table 3.1: maximal enrichment with more and more POD modes, at two points."""
    exact = Points.of(cases.pellet, POINTS, iter)
    rows = []
    for epsilon, size, *theirs in ERRORS[:: 3 if cases.quick else 1]:
        try:
            model: Any = cases.pellet_model(SMALL_RID, epsilon, 1.0)
        except HHRError:
            continue
        errors = exact.errors(model)
        ours = [part[k] for k in (0, 1) for part in (errors.primal, errors.rid)]
        rows.append((size, theirs, model.offline.basis.shape[1], ours))
    theirs_best = min(theirs[3] for _, theirs, _, _ in rows)
    best = min(ours[3] for _, _, _, ours in rows)
    usual = exact.errors(cases.pellet_usual)
    first, last = rows[0], rows[-1]
    return Item(
        "table 3.1",
        "POD + FE at (170 MPa, 3.2 mm) and (30 MPa, 5.25 mm): forces in the RID",
        f"{first[0]} to {last[0]} modes: FE alone {first[1][1]:g} and {first[1][3]:g} %, best at "
        f"the second point {theirs_best:.2g} %",
        f"{first[2]} to {last[2]} modes: FE alone {percent(first[3][1])} and "
        f"{percent(first[3][3])}, best at the second point {percent(best)}",
        f"{percent(usual.rid[0])} and {percent(usual.rid[1])}",
        "snapshots over their norm by default; " + _other_nodes(cases),
        PELLET,
    )


def at_a_point(cases: Cases) -> Iterator[Item]:
    """Figures 3.6 to 3.8: displacement, stress and forces at a point."""
    full = cases.pellet.full_order
    exact = full.solve(POINTS[0])
    texts = {}
    models = {
        "FE": cases.pellet_model(SMALL_RID),
        "POD + FE": cases.pellet_model(SMALL_RID, EXTENDED),
        "ours": cases.pellet_usual,
    }
    for name, model in models.items():
        answer = model.solve(POINTS[0], raise_on_failure=False)
        inside = answer.fields.A_lambda
        radial = exact.displacement()[::2]
        off = (
            np.linalg.norm(answer.displacement()[::2] - radial) / np.linalg.norm(radial),
            _off(von_mises(answer.stress()), von_mises(exact.stress())),
            _off(answer.multipliers, exact.forces()[inside]),
        )
        texts[name] = "u_r {}, von Mises {}, forces {}".format(*map(percent, off))
    yield Item(
        "figures 3.6 to 3.8",
        "u_r, von Mises' stress, forces in the RID at (170 MPa, 3.2 mm)",
        "forces 6.3 % (FE), 2.1 % (POD + FE); u_r and stress not told apart by eye",
        f"FE: {texts['FE']}; POD + FE: {texts['POD + FE']}",
        texts["ours"],
        _other_nodes(cases),
        PELLET,
    )


def _off(answer: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(answer - exact) / np.linalg.norm(exact))


def maps(cases: Cases) -> Iterator[Item]:
    """Figures 3.9 to 3.11: maps of errors in the RID and on the whole surface."""
    points = cases.pellet_points
    found = {
        "FE": points.errors(cases.pellet_model(SMALL_RID)),
        "POD + FE": points.errors(cases.pellet_model(SMALL_RID, EXTENDED)),
        "default": points.errors(cases.pellet_usual),
    }
    draw_maps(cases, points, found, "figure_3_9_and_3_10")
    rid = {name: of_map(errors.rid, points) for name, errors in found.items()}
    whole = {name: of_map(errors.whole, points) for name, errors in found.items()}
    yield Item(
        "figure 3.9",
        f"forces in the RID at {len(points.points)} points",
        "pictures: POD + FE better than FE; large errors at small P1",
        f"FE: {rid['FE']}; POD + FE: {rid['POD + FE']}",
        rid["default"],
        _other_nodes(cases),
        PELLET,
    )
    yield Item(
        "figure 3.10",
        "forces on the whole surface, by the cone (1.70)",
        "pictures: as in the RID, and large errors for h1 from .6 to 1.5 mm",
        f"FE: {whole['FE']}; POD + FE: {whole['POD + FE']}",
        whole["default"],
        "by default forces outside the RID close their gaps by S, and the RID is larger",
        PELLET,
    )
    low = cases.pellet.full_order.solve((50.0, 0.8)).forces()
    models = cases.pellet_model(SMALL_RID), cases.pellet_usual
    errors = [
        _off(model.solve((50.0, 0.8), raise_on_failure=False).forces(), low) for model in models
    ]
    sides = [_heights(model, cases.pellet.full_order.problem) for model in models]
    below = [np.count_nonzero(heights < 0.8) for heights in sides]
    yield Item(
        "figure 3.11",
        "forces at (50 MPa, .8 mm), where the RID has no node",
        "a picture: forces zero where the RID is not",
        f"{percent(errors[0])} off on the whole surface",
        percent(errors[1]),
        f"{below[0]} contact nodes of the side below h1 are in the RID, by default {below[1]}",
        PELLET,
    )


def _heights(model: Any, problem: Any) -> np.ndarray:
    """Heights in mm of the conditions on the side of the pellet in the RID of a model, (k,)."""
    inside = np.intersect1d(model.fields.A_lambda, problem.pressing_of(0))
    return np.asarray(problem.contact_points[inside, 1])


def draw_maps(cases: Cases, points: Points, found: dict[str, Maps], name: str) -> None:
    """Maps of errors of models in the RID, and on the whole surface below."""
    shown = {f"{label}, RID": errors.rid for label, errors in found.items()}
    shown |= {f"{label}, whole": errors.whole for label, errors in found.items()}
    plot_maps(points.points, shown, LABELS, cases.folder / f"{name}.png", rows=2)


def times(cases: Cases, number: str, dual: float, printed: str) -> Item:
    """Tables 3.2 and 3.3: times of answers."""
    fresh = cases.pellet.full_order.parameters.random(30 if cases.quick else 105, cases.seed + 4)
    models: dict[str, Any] = {
        "FE": cases.pellet_model(dual),
        "POD + FE": cases.pellet_model(dual, EXTENDED),
        "default": cases.pellet_usual,
        "full": cases.pellet.full_order,
        "condensed": cases.pellet.condense(),
    }
    found = milliseconds(models, fresh)
    ratios = {name: found["full"] / value for name, value in found.items()}

    def text(name: str) -> str:
        return f"{name} {found[name]:.2g} ms, {ratios[name]:.1f} times"

    return Item(
        number,
        f"time of an answer, {sizes(models['FE'])}",
        printed,
        f"{text('FE')}; {text('POD + FE')}; full order {found['full']:.2g} ms",
        f"{text('default')}; {text('condensed')}",
        "the full order keeps factors of K and starts from known statuses, Cast3M factors anew",
        PELLET,
    )


def large_domain(cases: Cases) -> Item:
    """Figures 3.12 and 3.13: a larger RID."""
    points = cases.pellet_points
    models = {
        "FE": cases.pellet_model(LARGE_RID),
        "POD + FE": cases.pellet_model(LARGE_RID, EXTENDED),
    }
    found = {name: points.errors(model) for name, model in models.items()}
    draw_maps(cases, points, found, "figure_3_13")
    texts = [f"{name}: {of_map(errors.rid, points)}" for name, errors in found.items()]
    return Item(
        "figures 3.12 and 3.13",
        "larger RID, forces in the RID",
        "N_C = 60, ell_bar = 83 and 91; not better by FE alone, better by POD + FE",
        f"{sizes(models['FE'])}; " + "; ".join(texts),
        of_map(points.errors(cases.pellet_usual).rid, points),
        _other_nodes(cases),
        PELLET,
    )


def maximal(cases: Cases) -> Item:
    """Figure 3.14: maximal enrichment on both RIDs."""
    exact = Points.of(cases.pellet, POINTS[:1], iter)
    texts = []
    for dual in (LARGE_RID, SMALL_RID):
        model: Any = cases.pellet.build(thesis(None, dual, 1.0), checked=False)
        conditions = len(model.fields.A_lambda)
        texts.append(f"{percent(exact.errors(model).rid[0])} for N_C = {conditions}")
    return Item(
        "figure 3.14",
        "forces in the RID at (170 MPa, 3.2 mm), maximal enrichment",
        "2.6 % for N_C = 60, 2.5 % for 34",
        ", ".join(texts),
        percent(exact.errors(cases.pellet_usual).rid[0]),
        _other_nodes(cases),
    )
