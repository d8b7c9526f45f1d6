"""The flowing pellet of the thesis with friction on its side: condensed flow and HHR along unseen
histories.

Pressed in 40 steps, let go to 30 % and pressed again in 40 more; trained on four gaps, compared on
three others.

    python benchmarks/friction_flow.py [--out DIR] [--quick] [--seed N]
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import numpy as np
import pellet_cladding_plastic as plastic
from mpi4py import MPI
from parts import cli

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.timing import timed

COEFFICIENT = 0.3
TRAINED, HELD_OUT, UNSEEN = (5.0, 8.0, 11.0, 15.0), (6.5,), (6.0, 9.5, 13.0)
"""Gaps in um."""
QUICK = {**plastic.QUICK_MESH, "cladding_axial_cells": 15, "cladding_radial_cells": 3}


def scene(**mesh_options: Any) -> hhr.Scene:
    """The scene of the demo with friction."""
    smooth = plastic.scene(**mesh_options)
    contacts = (dataclasses.replace(smooth.contacts[0], friction=COEFFICIENT),)
    return dataclasses.replace(smooth, name="friction_flow", contacts=contacts)


def path(gap: float, steps: int) -> Any:
    """Pressed, let go in part, and pressed again."""
    corners, numbers = (0.0, 1.0, 0.3, 0.9), (0, steps, steps + steps // 2, 2 * steps)
    shares = np.interp(np.arange(2 * steps + 1), numbers, corners)
    return plastic.history(np.arange(shares.size) / steps, shares, gap)


def errors(full: Any, found: hhr.History, exact: hhr.History) -> dict[str, float]:
    """Largest error of all and of tangential forces over the largest of the history, and of the
    work at its end.
    """
    rows = full.law.tangential
    forces = np.array(
        [[answer.forces() for answer in history.answers] for history in (exact, found)]
    )
    work = [history.answers[-1].slip.work.sum() for history in (exact, found)]
    off = {"forces": forces, "tangential": forces[:, :, rows]}
    told = {
        name: np.linalg.norm(item[1] - item[0], axis=1).max()
        / np.linalg.norm(item[0], axis=1).max()
        for name, item in off.items()
    }
    return {name: float(value) for name, value in told.items()} | {
        "work": float(abs(work[1] / work[0] - 1))
    }


def main() -> None:
    """Train, compare, report."""
    options = cli.parse_on_first_rank(cli.demo_parser("friction_flow", __doc__))
    steps = 10 if options.quick else 40
    made = scene(**(QUICK if options.quick else {}))
    paths, apart = ([path(gap, steps) for gap in gaps] for gaps in (TRAINED, HELD_OUT))
    training = hhr.train(made, paths, held_out=apart, comm=MPI.COMM_SELF)
    full, found = training.full_order, {}
    models = {"condensed": training.condense(), "hhr": training.build()}
    for gap in UNSEEN:
        exact, slow = timed(partial(full.march, path(gap, steps)))
        for kind, model in models.items():
            ours, fast = timed(partial(model.march, path(gap, steps)))
            found[f"{kind}, gap {gap:g} um"] = errors(full, ours, exact) | {
                "seconds": fast,
                "full": slow,
            }
    report.write_report(
        {"scene": "friction_flow", "friction": found, **report.environment()}, options.out
    )
    rows = [
        {"of": name, **{key: f"{value:.2g}" for key, value in item.items()}}
        for name, item in found.items()
    ]
    cli.print_rows("largest errors along unseen histories", rows, options.console)


if __name__ == "__main__":
    main()
