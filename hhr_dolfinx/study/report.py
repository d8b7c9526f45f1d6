"""The report of a study: ``report.json`` and a short table."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

from hhr_dolfinx.certify.accuracy import summary
from hhr_dolfinx.compat import versions
from hhr_dolfinx.files import replacing
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.study.console import Column, Console, Table
from hhr_dolfinx.study.measure import Measurement, Row

if TYPE_CHECKING:
    from hhr_dolfinx.study.training import Training


def make_report(
    training: Training, model: ReducedModel, measured: Measurement, rows: list[dict[str, Any]], seed: int
) -> dict[str, Any]:
    """All figures of a study under the keys that scenes share; SI units, seconds, fractions."""
    report = {
        **frame(training, model, seed),
        "errors": measured.own.errors.summaries(),
        "kkt": measured.own.errors.residuals,
        **measured.report,
        "work_precision": rows,
    }
    report["times"] = {"offline": {**training.log.times, **model.offline.log.times}, **report["times"]}
    report["skipped"] += measured.skipped
    report["break_even"] = break_even(report["times"])
    if "condensed_full" not in report["times"]:
        return report
    return {
        **report,
        "advice": advice(report) if "offline_condensed" not in report["times"] else advice_varying(report),
    }


def model_report(model: ReducedModel, row: Row) -> dict[str, Any]:
    """One of the ``models`` of a report: a reduced model, its errors and the seconds of its answers."""
    return {
        "sizes": reduced_sizes(model),
        "stability": model.offline.stability.as_report(),
        "errors": row.errors.summaries(),
        "kkt": row.errors.residuals,
        "times": {"offline": dict(model.offline.log.times), "online": summary(row.seconds)},
    }


def reduced_sizes(model: ReducedModel) -> dict[str, int]:
    """Numbers of functions, conditions and cells of a reduced model."""
    offline = model.offline
    functions = offline.basis.shape[1]
    # where bodies flow, cells of the RID that no test function sees cost nothing
    cells = offline.sets.cells if model.flow is None else model.flow.cells
    return {
        "ell": functions - len(offline.enrichment.added),
        "ell_bar": functions,
        "N_lambda_C": len(offline.sets.A_lambda),
        "rid_cells": len(cells),
    }


def break_even(times: dict[str, Any]) -> dict[str, float | None]:
    """Queries after which training and reduced answers are cheaper than the best full order; None if they never are.

    Forces alone by the reduced model, or fields and all forces; of a history always the whole.
    """
    offline = sum(times["offline"].values())
    kinds = {"forces": "online", "fields": "online_full"} if "online_full" in times else {"fields": "online"}
    found: dict[str, float | None] = {"forces": None}
    for name, kind in kinds.items():
        saved = times["fom_best"]["median"] - times[kind]["median"]
        found[name] = offline / saved if saved > 0 else None
    if "offline_condensed" in times:
        # forces need no training answers: fields do, and checks
        stages = times["offline_condensed"]
        saved = times["fom_best"]["median"] - times["condensed"]["median"]
        spent = stages["compliances"] + stages["starts"]
        found["forces, condensed"] = spent / saved if saved > 0 else None
    return found


def frame(training: Training, model: ReducedModel, seed: int) -> dict[str, Any]:
    """The part of a report that needs no measurement."""
    problem, offline = training.full_order.problem, model.offline
    stability = offline.stability.as_report()
    if offline.tangent_margin is not None:
        stability["tangent"] = offline.tangent_margin
    return {
        "scene": training.full_order.scene.name,
        "seed": seed,
        **environment(),
        "sizes": {
            "N": problem.free.size,
            "N_lambda": problem.contact.shape[0],
            **reduced_sizes(model),
            "cells": len(problem.cell_nodes),
            "layers": offline.layers,
            "snapshots": len(training.snapshots.points),
        },
        "stability": {
            **stability,
            # kappa(B~) after each added function; the first row is the basis before any
            "enrichment": [{"added": k, "kappa": kappa} for k, kappa in enumerate(offline.enrichment.kappas)],
        },
        "recipe": offline.recipe.described(),
        "skipped": [*training.log.skipped, *offline.log.skipped],
        "refused_before": list(offline.log.refused),
    }


def environment() -> dict[str, Any]:
    """The ``versions`` and ``machine`` parts of a report."""
    return {"versions": versions(), "machine": {"cpu": _cpu(), "threads": 1, "ranks": MPI.COMM_WORLD.size}}


def advice(report: dict[str, Any]) -> str:
    """Which method an elastic scene should use, and why, in words.

    Exact condensation has no reduction error; it is advised unless it is much slower than the reduced model
    where both give the forces on the whole contact surface.
    """
    times, error = report["times"], report["errors"]["dual_full_floored"]
    reduced = times["online_full"]["median"]
    accuracy = f"force errors {error['median']:.1%} median, {error['p95']:.1%} at 95 %, {error['max']:.1%} at most"
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


def advice_varying(report: dict[str, Any]) -> str:
    """Which method a scene should use whose stiffness or shape depends on parameters, by what was measured.

    The most accurate one within a factor of three of the fastest is advised: beside the full order both are fast.
    """
    times, rows = report["times"], {row["method"]: row for row in report["work_precision"] if row["setting"] in _OWN}
    names = {"condensed": "interpolated condensation", "HHR": "the hyper-reduced model"}
    seconds = {"condensed": times["condensed"]["median"], "HHR": times["online"]["median"]}
    best = min(seconds.values())
    close = [method for method in names if method in rows and seconds[method] <= 3 * best]
    favoured = min(close, key=lambda method: rows[method]["dual_full_floored_max"])
    other = "HHR" if favoured == "condensed" else "condensed"
    even = report["break_even"]
    after = {"condensed": even.get("forces, condensed"), "HHR": even.get("forces")}

    def told(method: str) -> str:
        row, count = rows[method], after[method]
        paid = "never pays" if count is None else f"pays after {count:.0f} queries"
        ratio = times["fom_best"]["median"] / seconds[method]
        return (
            f"{_seconds(seconds[method])} for the forces, {ratio:.0f} times the best full order, errors "
            f"{row['dual_full_floored']:.1e} median and {row['dual_full_floored_max']:.1e} at most, and {paid}"
        )

    sentence = f"Use {names[favoured]}: {told(favoured)}."
    if other in rows:
        sentence += f" {names[other].capitalize()}: {told(other)}."
    return sentence + (
        " The hyper-reduced model is for contact conditions by the thousand, and where operators do not interpolate."
    )


_OWN = ("this model", "interpolated")
"""Settings of the rows of the work-precision table that the advice compares."""


def write_report(report: dict[str, Any] | list[dict[str, Any]], folder: str | Path, name: str = "report") -> Path:
    """Write ``report.json``, or rows under another name; numbers that are not finite become null, as JSON wants it."""
    path = Path(folder) / f"{name}.json"
    text = json.dumps(_finite(report), indent=2, allow_nan=False)
    with replacing(path, text=True) as file:
        file.write(text + "\n")
    return path


def print_rows(title: str, rows: list[dict[str, Any]], console: Console) -> None:
    """Print rows that share their keys as a table; long texts are cut, which the file has whole."""
    table = Table(*rows[0], title=title)
    for row in rows:
        cells = (f"{value:.1e}" if isinstance(value, float) else "" if value is None else f"{value}"[:160]
                 for value in row.values())  # fmt: skip
        table.add_row(*cells)
    console.print(table)


def print_report(report: dict[str, Any], console: Console) -> None:
    """Print the figures a reader looks for first."""
    size, stability, online = report["sizes"], report["stability"], report["times"]["online"]["median"]
    shown = {"kappa_B": "kappa(B~)", "cond_K": "cond(K~)", "tangent": "tangents"}
    constants = ", ".join(f"{name} {stability[key]:.2g}" for key, name in shown.items() if key in stability)
    console.print(
        f"{report['scene']}: {size['N']} dofs, {size['N_lambda']} contacts -> {size['ell_bar']} modes, "
        f"{size['N_lambda_C']} contacts on {size['rid_cells']} of {size['cells']} cells, "
        f"{size['snapshots']} snapshots; {constants}"
    )
    errors = Table("error", "median", "95 %", "max")
    for name, row in report["errors"].items():
        if isinstance(row, dict):
            errors.add_row(name, *(f"{row[key]:.2e}" for key in ("median", "p95", "max")))
    times = Table("time per query", "median", "95 %", "x online")
    for name, row in report["times"].items():
        if row is not None and "median" in row:
            times.add_row(name, _seconds(row["median"]), _seconds(row["p95"]), f"{row['median'] / online:.1f}")
    console.print(errors, times)
    if "outputs" in report:
        outputs = Table("output", "largest", "median error", "95 %", "max")
        for name, row in report["outputs"].items():
            head = f"{name} [{row['unit']}]" if row["unit"] else name
            outputs.add_row(head, *(f"{row[key]:.2e}" for key in ("largest", "median", "p95", "max")))
        console.print(outputs)
    for name, row in report["times"].items():
        for line in _lines(name, row):
            console.print(line)
    counts = {name: count for name, count in report.get("break_even", {}).items() if count is not None}
    if counts:
        told = ", ".join(f"{count:.0f} queries for {name}" for name, count in counts.items())
        console.print(f"cheaper than the best full order, training included, after {told}")
    if "paths" in report:
        for line in _path_lines(report["paths"]):
            console.print(line)
    if "advice" in report:
        console.print(report["advice"])
    for item in report["refused_before"]:
        console.print(f"{item['layers']} layers refused: {item['why']}")
    for item in report["skipped"]:
        console.print(f"left out: {item['stage']}: {item['why']}")


def print_beside(title: str, ours: dict[str, dict], theirs: dict[str, dict], console: Console) -> None:
    """Print relative errors by label and name in per cent, those of another source in brackets where it has any."""
    table = Table(Column("", no_wrap=True), *ours, title=f"{title}, in % (in brackets: thesis)")
    for name in next(iter(ours.values())):
        pairs = ((row[name], theirs.get(label, {}).get(name)) for label, row in ours.items())
        cells = (f"{100 * here:.2g}" + ("" if there is None else f" ({100 * there:.2g})") for here, there in pairs)
        table.add_row(name, *cells)
    console.print(table)


def _lines(name: str, row: dict[str, Any] | None) -> Iterator[str]:
    """Seconds by name in words, of tables within tables too; summaries have a table of their own."""
    if row is None or "median" in row:
        return
    seconds = {key: value for key, value in row.items() if isinstance(value, float)}
    if seconds:
        yield f"{name}: " + ", ".join(f"{key} {_seconds(value)}" for key, value in seconds.items())
    for key, value in row.items():
        if isinstance(value, dict):
            yield from _lines(f"{name}, {key}", value)


def _path_lines(paths: dict[str, Any]) -> Iterator[str]:
    """What a model did on paths inside and outside of its training, in words."""
    inside, outside = paths["inside"], paths["outside"]
    if inside:
        told = ", ".join(f"{name} {row['max']:.1%}" for name, row in inside.items())
        yield f"paths inside what was trained, worst errors: {told}; {paths['false_alarms']} false alarms"
    silent = ", ".join(f"{name} {value:.1%}" for name, value in outside["silent_worst"].items())
    yield f"paths outside: {outside['warned']} of {outside['n']} warned of; worst errors without a warning: {silent}"


def _seconds(value: float) -> str:
    for unit, size in (("us", 1e-6), ("ms", 1e-3)):
        if value < 1000 * size:
            return f"{value / size:.2f} {unit}"
    return f"{value:.2f} s"


def _cpu() -> str:
    """Name of the processor, as far as the system tells."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
