"""Size: seconds and memory from nothing to a model, and of a query, of a sphere on a block from 1e4 dofs on.

Each size is a process of its own, for its peak of memory. A model is exact condensation: S, and K^-1 B^T where it has
room (a gigabyte); without it a displacement takes one more solution of the full order.

    python benchmarks/scale.py [--out DIR] [--quick] [--up-to N]
"""

from __future__ import annotations

import multiprocessing
import resource
import time
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import numpy as np
import sphere_on_block as demo
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.linear.sparse import FreeCholesky
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.study import cli
from hhr_dolfinx.study.report import report
from hhr_dolfinx.timing import timed

CELLS = (6, 8, 12, 16, 20, 26, 34, 44, 60)
"""Cells of the sphere along its sides; half as many through its depth, and three quarters as many of the block."""
QUERIES = 20
COLUMNS = ("N", "N_lambda", "factor_s", "compliance_s", "train_s", "peak_gb", "query_s", "fields_s", "full_s")


def mesh(cells: int) -> dict[str, Any]:
    """Sizes of the meshes of both bodies."""
    block = 3 * cells // 4
    return {"sphere_cells": (cells, max(cells // 2, 2)), "block_cells": (block, max(block // 2, 2))}


def measured(cells: int) -> dict[str, float]:
    """One row of the report, of a process that does nothing else."""
    spent = {"factor_s": 0.0, "compliance_s": 0.0}
    _watch(FreeCholesky, "__init__", "factor_s", spent)
    _watch(FullOrderModel, "_condensed", "compliance_s", spent)
    start = time.perf_counter()
    full = hhr.FullOrderModel(demo.scene(**mesh(cells)), MPI.COMM_SELF)
    points = full.parameters.random(QUERIES, 0)
    statuses = KnownStatuses(points[:1], full.solve(points[0]).active[None])
    model = hhr.exact_condensation(full, statuses, field=False)
    made = time.perf_counter() - start
    answers, forces = timed(lambda: [model.solve(point) for point in points])
    _, fields = timed(lambda: [answer.displacement() for answer in answers[:3]])
    _, whole = timed(lambda: [full.solve(point) for point in points[:3]])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    sizes = {"N": len(full.problem.free), "N_lambda": full.conditions, "ranks": 1}
    kept = {"columns_kept": full.keeps_columns}
    times = {"train_s": made, "peak_gb": peak, "query_s": forces / QUERIES, "fields_s": fields / 3, "full_s": whole / 3}
    return sizes | kept | spent | times


def _watch(owner: type, name: str, stage: str, spent: dict[str, float]) -> None:
    """Add up what a method takes."""
    plain = getattr(owner, name)

    def watched(*given: Any, **how: Any) -> Any:
        found, seconds = timed(lambda: plain(*given, **how))
        spent[stage] += seconds
        return found

    setattr(owner, name, watched)


def slopes(rows: list[dict[str, float]]) -> dict[str, float]:
    """Powers of N by which the larger half of the sizes grow, by least squares of logarithms."""
    later = rows[len(rows) // 2 :] if len(rows) > 3 else rows
    sizes = np.log([row["N"] for row in later])
    named = COLUMNS[2:]
    return {name: float(np.polyfit(sizes, np.log([row[name] for row in later]), 1)[0]) for name in named}


def main() -> None:
    """Measure sizes up to a number of dofs, and report."""
    parser = cli.demo_parser("scale", __doc__)
    parser.add_argument("--up-to", type=float, default=1e5, metavar="N", help="largest number of dofs [1e5]")
    options = cli.parse_on_first_rank(parser)
    rows: list[dict[str, float]] = []
    for cells in CELLS[:2] if options.quick else CELLS:
        expected = 3 * ((cells + 1) ** 2 * (cells // 2 + 1) + (3 * cells // 4 + 1) ** 2 * (3 * cells // 8 + 1))
        if expected > options.up_to:
            break
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as alone:
            rows.append(alone.submit(measured, cells).result())
        told = ", ".join(f"{name} {rows[-1][name]:.3g}" for name in COLUMNS)
        options.console.print(told + ("" if rows[-1]["columns_kept"] else ", columns dropped"))
    found = {"scene": "scale", "scale": rows, "slopes": slopes(rows) if len(rows) > 1 else {}}
    if found["slopes"]:
        grown = ", ".join(f"{name} {value:.2g}" for name, value in found["slopes"].items())
        options.console.print(f"powers of N: {grown}")
    report.write_report(found | report.environment(), options.out)


if __name__ == "__main__":
    main()
