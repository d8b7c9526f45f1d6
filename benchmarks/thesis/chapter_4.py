"""Chapter 4 of the thesis: local models by clusters of answers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from chapter_3 import SMALL_RID, draw_maps
from items import LOCAL, Cases, Item, Maps, Points, milliseconds, of_map, percent
from mpi4py import MPI
from pellet_cladding_tables import POINTS, thesis

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.local_models.clustered import sizes_of
from hhr_dolfinx.study.training.train import Training

RECIPE = hhr.Recipe.thesis(1e-8, nodes=(hhr.Deim(), hhr.ForceDeim(1e-6), hhr.LoadNodes()))
"""Recipe of the thesis' local models: enrichment by FE alone down to kappa 10."""
ONE = {"EF": (1e-4, None), "POD+EF": (1e-4, 3.5e-7)}
"""DEIM of forces and extended POD of figure 4.7."""
FULL = "full 704 and 4829 ms"
WHY = "answers on the border of two clusters train both; DEIM picks other nodes of another mesh"


def items(cases: Cases) -> Iterator[Item]:
    """Items of the chapter."""
    yield Item("figure 4.1", "how clusters are made", "a drawing")
    yield from regular(cases)
    yield from irregular(cases)


def _clustered(training: Training, kappa_max: float, cases: Cases) -> Any:
    """Three local models, by enrichment down to a condition number."""
    recipe = hhr.Recipe.thesis(1e-8, nodes=RECIPE.nodes, enrichment=hhr.Enrich(kappa_max))
    return training.local(hhr.Clusters(3), recipe=recipe, checked=False, progress=cases.progress)


def _sizes(local: Any) -> tuple[str, str, str]:
    """Training answers, modes and conditions of each model."""
    pairs = [sizes_of(model) for model in local.models]
    own = [str(len(member.snapshots)) for member in local.offline.members]
    modes = [
        model.offline.basis.shape[1] - len(model.offline.enrichment.added) for model in local.models
    ]
    return (
        ", ".join(own),
        ", ".join(map(str, modes)),
        f"N_C = {', '.join(str(pair[1]) for pair in pairs)}; "
        f"ell_bar = {', '.join(str(pair[0]) for pair in pairs)}",
    )


def regular(cases: Cases) -> Iterator[Item]:
    """Figures 4.2 to 4.6 and tables 4.1 and 4.2: clusters of a regular grid."""
    training, points = cases.pellet, cases.pellet_points
    local = _clustered(training, 10.0, cases)
    own, modes, rest = _sizes(local)
    yield Item(
        "figure 4.2",
        "three clusters of 500 answers, by the height h1",
        "170, 194, 170 answers",
        own,
        reason=WHY,
        command=LOCAL,
    )
    yield Item(
        "figures 4.3 and 4.4",
        "modes at 1e-8 and RIDs of the clusters",
        "ell = 31, 39, 36; N_C = 36, 40, 35; ell_bar = 54, 67, 57",
        f"ell = {modes}; {rest}",
        reason=WHY,
        command=LOCAL,
    )
    at = Points.of(training, POINTS, iter)
    whole = at.errors(_clustered(training, 1.0, cases))
    usual = at.errors(cases.pellet_usual)
    yield Item(
        "table 4.1",
        "local models, maximal enrichment, at (170 MPa, 3.2 mm) and (30 MPa, 5.25 mm)",
        "displacement .03 and .02 %, forces in the RID 2.0 and 2.4 %",
        f"displacement {_both(whole.primal)}, forces in the RID {_both(whole.rid)}",
        f"one model: displacement {_both(usual.primal)}, forces in the RID {_both(usual.rid)}",
        WHY,
        LOCAL,
    )
    found = {
        "one model, EF": points.errors(cases.pellet_model(SMALL_RID)),
        "three models": points.errors(local),
        "default": points.errors(cases.pellet_usual),
    }
    draw_maps(cases, points, found, "figure_4_5_and_4_6")
    yield from _maps(found, points, ("figure 4.5", "figure 4.6"), "of a regular grid")
    yield _times(cases, "table 4.2", local, f"352 ms; {FULL}: 2 and 13.7 times")


def _both(errors: np.ndarray) -> str:
    """Errors at two points."""
    return " and ".join(map(percent, errors))


def _maps(
    found: dict[str, Maps], points: Points, numbers: tuple[str, str], what: str
) -> Iterator[Item]:
    """Items of maps in the RID and on the whole surface."""
    texts = {name: [of_map(part, points) for part in errors[:2]] for name, errors in found.items()}
    one, local, usual = texts.values()
    places = "in the RID", "on the whole surface"
    for number, place, *cells in zip(numbers, places, one, local, usual, strict=True):
        if number:
            yield Item(
                number,
                f"forces {place}, local models {what}",
                "a picture: better than one model",
                f"one model: {cells[0]}; three: {cells[1]}",
                cells[2],
                "by default one model with a larger RID and snapshots over their norm",
                LOCAL,
            )


def _times(cases: Cases, number: str, model: Any, printed: str) -> Item:
    """Time of local models beside the full order and the usual model."""
    fresh = cases.pellet.full_order.parameters.random(30 if cases.quick else 105, cases.seed + 4)
    models = {"local": model, "full": cases.pellet.full_order, "default": cases.pellet_usual}
    found = milliseconds(models, fresh)
    return Item(
        number,
        "time of an answer of local models",
        printed,
        f"{found['local']:.2g} ms; full {found['full']:.2g} ms: "
        f"{found['full'] / found['local']:.1f} times",
        f"one model {found['default']:.2g} ms: {found['full'] / found['default']:.1f} times",
        "the full order keeps factors of K, Cast3M factors anew",
        LOCAL,
    )


def irregular(cases: Cases) -> Iterator[Item]:
    """Figures 4.7 to 4.10 and tables 4.3 and 4.4: clusters of 200 answers of a greedy choice."""
    budget = 24 if cases.quick else 200
    greedy = hhr.Greedy(
        budget=budget, tolerance=1e-9, indicator=hhr.Eta(), start=hhr.Sobol(8), together=8
    )
    scene = cases.pellet.full_order.scene
    training = hhr.train(scene, greedy, held_out=0, comm=MPI.COMM_SELF, progress=cases.progress)
    points = cases.pellet_points
    low = float(np.mean(training.snapshots.points[:, 0] < 50))
    one = {
        name: training.build(thesis(extended, dual), checked=False)
        for name, (dual, extended) in ONE.items()
    }
    maps = {name: points.errors(model) for name, model in one.items()}
    texts = [f"{name}: {of_map(errors.rid, points)}" for name, errors in maps.items()]
    modes = [str(len(model.problem.stiffness)) for model in one.values()]
    conditions = len(one["EF"].fields.A_lambda)
    yield Item(
        "figure 4.7",
        f"one model of {budget} chosen answers, forces in the RID",
        "N_C = 57, ell_bar = 60 and 82; better than 500 on a grid, smaller bases",
        f"N_C = {conditions}, ell_bar = {' and '.join(modes)}; {'; '.join(texts)}",
        of_map(points.errors(training.build(checked=False)).rid, points),
        "chosen eight at a time from a low-discrepancy set, not one by one from a grid",
        LOCAL,
    )
    yield _times(cases, "table 4.3", one["EF"], f"913 and 918 ms; {FULL}: .8 and 5.3 times")
    local = _clustered(training, 10.0, cases)
    own, modes_of, rest = _sizes(local)
    yield Item(
        "figures 4.8 and 4.9",
        "three clusters of these answers, and their RIDs",
        "answers gather at small P1; ell = 27, 35, 23; N_C = 36, 56, 35; ell_bar = 52, 77, 48",
        f"{low:.0%} of the answers below 50 MPa (23 % of the box); {own} answers; "
        f"ell = {modes_of}; {rest}",
        reason=WHY,
        command=LOCAL,
    )
    found = {
        "one model, EF": maps["EF"],
        "three models": points.errors(local),
        "default": points.errors(cases.pellet_usual),
    }
    draw_maps(cases, points, found, "figure_4_10")
    yield from _maps(found, points, ("figure 4.10", ""), "of a greedy choice")
    yield _times(cases, "table 4.4", local, f"603 ms; {FULL}: 1.2 and 8 times")
