"""The report of a study: ``report.json`` and a short table."""

from __future__ import annotations

import json
import math
import os
import platform
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from hhr_dolfinx.full_order.elastic import FullOrderModel
from hhr_dolfinx.snapshots.accuracy import summary
from hhr_dolfinx.snapshots.solutions import SnapshotSet
from hhr_dolfinx.study.study import StudyResult

_COMPARED = ("fom_naive", "fom_best", "condensed")
_TIMED = (*_COMPARED, "condensed_full", "online", "online_lapack", "online_full")


def make_report(
    full_order: FullOrderModel,
    snapshots: SnapshotSet,
    result: StudyResult,
    *,
    seed: int,
    stages: dict[str, float],
) -> dict:
    """Collect everything measured under the keys all scenes share; SI units, seconds, fractions.

    Args:
        full_order: the full model.
        snapshots: training solutions.
        result: what :func:`hhr_dolfinx.study.study.run_study` returned.
        seed: seed of the test points.
        stages: seconds of the stages before the reduction, by name.
    """
    hyper, errors = result.hyper, result.errors
    report = {
        "scene": full_order.scene.name,
        "seed": seed,
        **environment(full_order.comm.size),
        "sizes": {
            "N": int(full_order.problem.free.size),
            "N_lambda": int(full_order.problem.contact.shape[0]),
            "ell": int(hyper.basis.shape[1]) - len(hyper.enrichment.added),
            "ell_bar": int(hyper.basis.shape[1]),
            "N_lambda_C": len(hyper.sets.A_lambda),
            "cells": len(full_order.problem.cell_nodes),
            "rid_cells": len(hyper.sets.cells),
            "snapshots": len(snapshots.points),
        },
        "stability": {**hyper.stability.as_report(), "enrichment": _enrichment(hyper)},
        "errors": {
            **errors.summaries(),
            "points_with_false_contact": errors.false_contact,
            "unconverged": errors.unconverged,
        },
        "times": {
            "offline": {**stages, **hyper.log.times},
            **_times(result.times["warm"], _TIMED),
            "cold_start": _times(result.times["cold"], (*_COMPARED, "online", "online_lapack")),
        },
        "ratios": {**_ratios(result.times["warm"]), "cold_start": _ratios(result.times["cold"])},
        "work_precision": result.work_precision,
        "active_set": {
            "iterations_median": float(np.median(errors.iterations)),
            "iterations_max": int(errors.iterations.max()),
            "cycles": int(errors.cycles),
        },
        "skipped": hyper.log.skipped,
        "refused_before": hyper.log.refused,
    }
    return {**report, "advice": advice(report)}


def environment(ranks: int = 1) -> dict:
    """The ``versions`` and ``machine`` parts of a report."""
    return {"versions": _versions(), "machine": {"cpu": _cpu(), "threads": 1, "ranks": ranks}}


def advice(report: dict) -> str:
    """Which method this scene should use, and why, in words.

    Exact condensation has no reduction error; it is advised unless it is much slower than the reduced model
    where both give the forces on the whole contact surface, or does not apply.
    """
    times, error = report["times"], report["errors"]["dual_full_floored"]
    reduced = times["online_full"]["median"]
    accuracy = f"force errors {error['median']:.1%} median, {error['p95']:.1%} at 95 %, {error['max']:.1%} at most"
    if times["condensed_full"] is None:
        return f"The hyper-reduced model answers in {_seconds(reduced)} with {accuracy}; condensation was not measured."
    exact = times["condensed_full"]["median"]
    figures = (
        f"displacements and forces everywhere take {_seconds(exact)} by exact condensation and "
        f"{_seconds(reduced)} by the hyper-reduced model ({accuracy})"
    )
    if exact <= 3 * reduced:
        return (
            f"Use exact condensation while the stiffness stays constant: {figures}. "
            "Use the hyper-reduced model where the displacement field is not needed for every query or memory is short."
        )
    return f"Use the hyper-reduced model: {figures}. Use exact condensation where no error can be afforded."


def write_report(report: dict, folder: Path) -> Path:
    """Write ``report.json``; numbers that are not finite become null, which JSON can hold."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "report.json"
    temporary = path.with_suffix(".part")
    temporary.write_text(json.dumps(_finite(report), indent=2, allow_nan=False) + "\n")
    os.replace(temporary, path)
    return path


def print_report(report: dict, console: Console | None = None) -> None:
    """Print the figures a reader looks for first."""
    console = console or Console()
    sizes, stability = report["sizes"], report["stability"]
    console.print(
        f"[bold]{report['scene']}[/bold]: {sizes['N']} dofs, {sizes['N_lambda']} contacts -> {sizes['ell_bar']} modes, "
        f"{sizes['N_lambda_C']} contacts on {sizes['rid_cells']} of {sizes['cells']} cells, "
        f"{sizes['snapshots']} snapshots; kappa(B~) {stability['kappa_B']:.2f}, cond(K~) {stability['cond_K']:.1e}"
    )
    errors = Table("error", "median", "95 %", "max")
    for name, row in report["errors"].items():
        if isinstance(row, dict):
            errors.add_row(name, *(f"{row[key]:.2e}" for key in ("median", "p95", "max")))
    times = Table("time per query", "median", "95 %", "x online")
    online = report["times"]["online"]["median"]
    for name in _TIMED:
        row = report["times"][name]
        if row is None:
            continue
        times.add_row(name, _seconds(row["median"]), _seconds(row["p95"]), f"{row['median'] / online:.1f}")
    console.print(errors, times)
    console.print(report["advice"])
    for item in report["skipped"]:
        console.print(f"left out: {item['stage']}: {item['why']}")


def _enrichment(hyper):
    """kappa(B~) after each added function; the first row is the basis before any."""
    return [{"added": k, "kappa": kappa} for k, kappa in enumerate(hyper.enrichment.kappas)]


def _times(times, names):
    """Summaries by name; null for a model that was not run."""
    return {name: summary(times[name]) if name in times else None for name in names}


def _ratios(times):
    online = np.median(times["online"])
    return {f"{name}/online": float(np.median(times[name]) / online) if name in times else None for name in _COMPARED}


def _seconds(value):
    return f"{value * 1e6:.1f} us" if value < 1e-3 else f"{value * 1e3:.2f} ms"


def _versions():
    import dolfinx
    import petsc4py
    import slepc4py

    return {
        "dolfinx": dolfinx.__version__,
        "petsc": petsc4py.__version__,
        "slepc": slepc4py.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def _cpu():
    """Name of the processor, as far as the system tells."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _finite(value):
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
