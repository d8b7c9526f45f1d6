"""What ``pellet_cladding.py`` is compared with: recipes, peers, coarser meshes, the thesis' own
size.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from coarser import CoarserMesh
from mpi4py import MPI
from pellet_cladding_tables import POINTS, thesis

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.plugins.rivals.cones import greedy_cone, nonnegative_factors, touching
from hhr_dolfinx.plugins.rivals.projection import (
    ConeModel,
    displacement_modes,
    with_supremizers,
)
from hhr_dolfinx.plugins.studies.measure import References
from hhr_dolfinx.plugins.studies.points import time_queries
from hhr_dolfinx.plugins.studies.study import Study
from hhr_dolfinx.study.training.train import Training

THESIS_SIZE = thesis(3e-7, 1e-3, 3.0)
"""POD + FE enrichment on a small RID: 60 functions and 26 contacts."""
PLAIN = hhr.Deim(), hhr.ForceDeim(1e-6), hhr.LoadNodes()
VARIANTS = [
    ("thesis size", THESIS_SIZE),
    ("plain 1e-8", hhr.Recipe(hhr.Pod(1e-8), PLAIN)),
    ("plain 1e-10", hhr.Recipe(hhr.Pod(1e-10), PLAIN)),
    ("relative 1e-9", hhr.Recipe(hhr.Pod(1e-9, relative=True))),
    ("relative 1e-10", hhr.Recipe(hhr.Pod(1e-10, relative=True))),
    ("all functions", hhr.Recipe(enrichment=hhr.Enrich(1.0))),
]


def rivals(training: Training, scene: Callable[..., hhr.Scene], quick: bool) -> Iterator[hhr.Rival]:
    """Peers with 30 primal modes, and coarser meshes of the same scene."""
    full_order, snapshots = training.full_order, training.snapshots
    modes = displacement_modes(snapshots, 30)

    def of(cone: np.ndarray) -> ConeModel:
        return ConeModel(full_order, with_supremizers(full_order, modes, cone), cone)

    for count in (10,) if quick else (20, 40):
        cone = greedy_cone(touching(snapshots), count, relative=True)
        yield hhr.Rival("cone-projected greedy", f"{count}", of(cone))
    factors = nonnegative_factors(snapshots.forces, 10 if quick else 40)
    yield hhr.Rival("NNMF", f"{factors.shape[1]}", of(factors))
    cells = (12, 20, 4) if quick else (60, 100, 8)
    for part in (2,) if quick else (4, 2):
        mesh = dict(
            zip(
                ("radial_cells", "axial_cells", "cladding_radial_cells"),
                np.array(cells) // part,
                strict=True,
            )
        )
        coarse = hhr.FullOrderModel(
            scene(**{name: int(count) for name, count in mesh.items()}), MPI.COMM_SELF
        )
        points = scene().parameters.grid([12, 10])
        yield hhr.Rival(
            "coarser mesh", f"1/{part}", CoarserMesh(coarse, full_order.problem, points)
        )


def thesis_size(study: Study) -> dict[str, float]:
    """Errors of the thesis-size recipe at the points of table 3.1, and its time beside the full
    order's.
    """
    training, settings = study.training, study.settings
    model = training.build(THESIS_SIZE, checked=False)
    points = training.full_order.problem.parameters.random(
        2 * settings.queries + 5, settings.seed + 3000
    )
    seconds = float(np.median(time_queries({"online": model.solve}, points)["online"]))
    inside, errors = model.fields.A_lambda, {}
    for point in POINTS:
        exact = training.full_order.solve(point).forces()[inside]
        errors[f"dual_rid at {point.tolist()}"] = relative_error(
            model.solve(point).multipliers, exact
        )
    times = {
        f"{name}/online": study.report["times"][name]["median"] / seconds
        for name in ("fom_best", "fom_naive")
    }
    return {
        "ell_bar": len(model.problem.stiffness),
        "N_lambda_C": len(inside),
        **errors,
        "online_s": seconds,
        **times,
    }


def draw_maps(study: Study, folder: Path, quick: bool) -> None:
    """Errors of three recipes over both parameters, thesis figure 3.9."""
    from thesis_output import plot_maps

    training = study.training
    points = training.full_order.problem.parameters.grid([12, 10] if quick else [40, 30])
    references = References.at(points, training.full_order, training.snapshots)
    recipes = {"thesis, EF": thesis(None, 4e-4), "thesis size, POD+EF": THESIS_SIZE}
    models = {name: training.build(recipe, checked=False) for name, recipe in recipes.items()}
    models["default"] = study.model
    maps = {name: references.errors(model).values for name, model in models.items()}
    for error in ("dual_rid_floored", "dual_full_floored"):
        shown = {name: values[error] for name, values in maps.items()}
        plot_maps(
            references.solutions.points, shown, ("P1 [MPa]", "h1 [mm]"), folder / f"map_{error}.png"
        )
