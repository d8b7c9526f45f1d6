"""Errors, times and balance of forces of bodies that nothing but contact holds."""

import warnings
from typing import Any

import numpy as np
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import summary
from hhr_dolfinx.errors import SceneWarning
from hhr_dolfinx.plugins.studies.points import time_queries


def imbalance(model: Any, full: hhr.FullOrderModel, point: np.ndarray) -> float:
    """Largest resultant of forces and loads along the motions that only contact holds, over that of
    the forces.
    """
    problem = full.problem
    acting = (problem.contact @ problem.kernel.motions).T
    forces = model.solve(point).forces()
    left = problem.kernel.motions.T @ (problem.loads @ problem.amplitudes(point)) - acting @ forces
    return float(np.abs(left).max() / (np.abs(acting) @ forces).max())


def measured(scene: hhr.Scene, options: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Train, build, compare at random points: for the report, and a line of the table."""
    from hhr_dolfinx.plugins.studies.measure import References

    with warnings.catch_warnings():
        # a punch without friction may slide, and nothing drives it to
        warnings.filterwarnings("ignore", ".*no contact resists and no load drives", SceneWarning)
        training = hhr.train(
            scene,
            hhr.Sobol(64 if options.quick else 256),
            comm=MPI.COMM_SELF,
            progress=options.progress,
            folder=options.out / f"snapshots_{scene.name}",
        )
        model = training.build()
    full = training.full_order
    points = full.parameters.random(20 if options.quick else 200, options.seed + 7)
    references = References.at(
        points, full, training.snapshots, options.progress(f"{scene.name}, test points")
    )
    errors = references.errors(model).summaries()
    fresh = full.parameters.random(15 if options.quick else 105, options.seed + 1000)
    known = training.snapshots.known_statuses()
    times = time_queries(
        {
            "fom_best": lambda point: full.solve(point, start=known.active[known.nearest(point)]),
            "online": model.solve,
        },
        fresh,
    )
    medians = {name: float(np.median(values)) for name, values in times.items()}
    balance = {name: max(imbalance(one, full, point) for point in points)
               for name, one in (("full", full), ("reduced", model))}  # fmt: skip
    hhr.save_model(options.out / f"{scene.name}.npz", model)
    found = {
        "errors": errors,
        "times": {name: summary(values) for name, values in times.items()},
        "balance": balance,
        "motions": model.problem.motions,
        "ell_bar": len(model.problem.stiffness),
        "N_lambda_C": len(model.fields.A_lambda),
    }
    forces = errors["dual_full_floored"]
    row = {
        "scene": scene.name,
        "unknowns": len(full.problem.free),
        "contacts": len(full.schur),
        "modes": found["ell_bar"],
        "motions": found["motions"],
        "forces p95": forces["p95"],
        "worst": forces["max"],
        "imbalance, full": balance["full"],
        "reduced": balance["reduced"],
        "x full": medians["fom_best"] / medians["online"],
    }
    return found, row
