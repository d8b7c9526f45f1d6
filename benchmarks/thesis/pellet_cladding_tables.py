"""Tables 3.1, 3.2 and 3.3 of the thesis beside ours, for ``pellet_cladding.py --study thesis``."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.table import Table

import hhr_dolfinx as hhr
from hhr_dolfinx.command.console import Console
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.plugins.studies.measure import References
from hhr_dolfinx.plugins.studies.points import time_queries
from hhr_dolfinx.plugins.studies.report import write_report
from hhr_dolfinx.study.training.train import Training

POINTS = np.array([[170.0, 3.2], [30.0, 5.25]])
"""The two points of table 3.1."""
ERRORS = [  # table 3.1: epsilon 2, final size, errors in %: primal and dual at both points
    (None, 70, 1.0, 2.5, 2.9, 21),
    (7.5e-7, 73, 2.5, 1.8, 0.5, 26),
    (5e-7, 76, 0.5, 1.6, 1.6, 16),
    (3.5e-7, 79, 0.1, 1.3, 3.5, 5.6),
    (2.7e-7, 82, 1.4, 1.7, 2.5, 6.7),
    (2.2e-7, 85, 1.9, 1.7, 1.3, 5.8),
    (1.7e-7, 88, 1.1, 1.4, 0.2, 5.3),
    (1.3e-7, 91, 7.8, 1.8, 13.4, 9.3),
    (1.1e-7, 93, 0.8, 1.3, 16, 9.9),
    (0.9e-7, 96, 12, 1.3, 1.5, 9.5),
]
TIMES = [  # tables 3.2 and 3.3: label, dual epsilon, epsilon 2, size, milliseconds; full order 704
    ("3.2", "EF", 4e-4, None, 55, 220),
    ("3.2", "POD+EF", 4e-4, 3.5e-7, 62, 270),
    ("3.3", "EF", 1e-4, None, 83, 919),
    ("3.3", "POD+EF", 1e-4, 3.5e-7, 91, 1092),
]


def thesis(extended: float | None, dual: float, kappa_max: float = 10.0) -> hhr.Recipe:
    """The thesis' recipe at epsilon 1e-6 with DEIM of the forces.

    POD + FE enrichment with an extended POD.
    """
    nodes = (hhr.Deim(hhr.Pod(1e-6)), hhr.ForceDeim(dual), hhr.LoadNodes())
    return hhr.Recipe.thesis(extended or 1e-6, nodes=nodes, enrichment=hhr.Enrich(kappa_max))


def thesis_tables(training: Training, folder: Path, console: Console) -> None:
    """Print the tables and write their rows to a file."""
    rows = [*_errors(training, console), *_times(training, console)]
    write_report(rows, folder, "thesis_tables")


def _errors(training: Training, console: Console) -> Iterator[dict]:
    table = Table(
        "eps 2", "size", "errors % at (170, 3.2)", "at (30, 5.25)", title="table 3.1: thesis | here"
    )
    references = References.at(POINTS, training.full_order, training.snapshots)
    for epsilon, size, *theirs in ERRORS:
        try:
            model = training.build(thesis(epsilon, 4e-4, 1.0), checked=False)
            values = references.errors(model).values
            ours = [100 * values[name][k] for k in (0, 1) for name in ("primal_euclid", "dual_rid")]
            mine = str(len(model.problem.stiffness))
        except HHRError as error:
            ours, mine = [float("inf")] * 4, f"refused: {error}"
        cells = [
            f"{theirs[k]:g}, {theirs[k + 1]:g} | {ours[k]:.2g}, {ours[k + 1]:.2g}" for k in (0, 2)
        ]
        table.add_row("-" if epsilon is None else f"{epsilon:.1e}", f"{size} | {mine}", *cells)
        yield {
            "epsilon": epsilon,
            "thesis_size": size,
            "size": mine,
            "thesis": theirs,
            "here": ours,
        }
    console.print(table)


def _times(training: Training, console: Console) -> Iterator[dict]:
    table = Table(
        "table",
        "recipe",
        "size: thesis | here",
        "time: thesis | here",
        "x full order: thesis | here",
    )
    fresh = training.full_order.problem.parameters.random(105, 5)
    full = float(np.median(time_queries({"full": training.full_order.solve}, fresh)["full"]))
    for number, label, dual, epsilon, size, milliseconds in TIMES:
        model = training.build(thesis(epsilon, dual), checked=False)
        online, ours = (
            float(np.median(time_queries({"online": model.solve}, fresh)["online"])),
            len(model.problem.loads),
        )
        table.add_row(
            number,
            label,
            f"{size} | {ours}",
            f"{milliseconds} ms | {online * 1e6:.0f} us",
            f"{704 / milliseconds:.1f} | {full / online:.0f} (best)",
        )
        yield {"table": number, "recipe": label, "size": ours, "online_s": online}
    console.print(table)
