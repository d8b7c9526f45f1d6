"""``report.html``: the report and the pictures of a study in one file that needs no network and no other file."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.files import replacing
from hhr_dolfinx.study.advice import in_words

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; }
h1 { margin-bottom: 0; } h2 { margin-top: 2.5rem; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; margin: 1rem 0; } th, td { padding: .25rem .8rem; text-align: right; }
th:first-child, td:first-child { text-align: left; } tr:nth-child(even) { background: #f4f4f4; }
th { border-bottom: 2px solid #888; } .advice { background: #eef6ee; border-left: 4px solid #3a7; padding: .8rem 1rem; }
figure { margin: 1.5rem 0; } img { max-width: 100%; border: 1px solid #ddd; } figcaption { color: #555; }
.small { color: #555; font-size: 90%; }
"""

ERRORS = {
    "primal_l2": "displacement, mean square", "primal_energy": "displacement, in energy",
    "primal_euclid": "displacement, node by node", "dual_rid_floored": "contact forces inside the reduced domain",
    "dual_full_floored": "contact forces on the whole surface", "resultant": "resultant of the contact forces",
    "stress": "stress", "sigma_rr": "first normal stress", "plastic_strain": "plastic strain",
}  # fmt: skip
"""What errors are called for readers who do not know the code."""
TIMES = {
    "fom_naive": "a first program: everything assembled and factored for each query",
    "fom_best": "the full order at its best: the stiffness factored once", "condensed": "condensation, contact forces",
    "condensed_full": "condensation, fields and forces", "online": "the reduced model, contact forces",
    "online_full": "the reduced model, fields and forces",
}  # fmt: skip
PICTURES = {
    "work_precision.png": "Error against time of one query. What lies on the black line is beaten by nothing in both.",
    "pressures.png": "Contact pressures: lines of the full order, marks of the reduced model.",
    "fields.png": "The cells on which the reduced model integrates (RID), and fields beside each other.",
    "errors.png": "Errors over the parameter.", "contact_force.png": "Contact force over time.",
    "largest_plastic_strain.png": "Largest plastic strain over time.",
    "iterations_of_a_step.png": "Iterations of the steps of a history.",
}  # fmt: skip


def write_page(folder: str | Path) -> Path:
    """Write ``report.html`` beside ``report.json``, with the pictures of the folder inside.

    Raises:
        FileContentError: if there is no report, or it is none.
    """
    folder = Path(folder)
    source = folder if folder.suffix == ".json" else folder / "report.json"
    try:
        report = json.loads(source.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileContentError(
            f"there is no report {source}: run a study first, hhr study SCENE --out {folder}"
        ) from None
    except (OSError, ValueError) as error:
        raise FileContentError(f"{source} is no report ({error})") from error
    if not isinstance(report, dict) or "scene" not in report:
        raise FileContentError(f"{source} is no report: it names no scene")
    path = source.with_suffix(".html")
    with replacing(path, text=True) as file:
        file.write(page_of(report, source.parent))
    return path


def page_of(report: Mapping[str, Any], folder: Path) -> str:
    """The page of a report and the pictures in a folder."""
    name = escape(str(report["scene"]))
    parts = [f"<h1>{name}</h1>", _sizes(report), _advice(report)]
    if "errors" in report:
        parts += ["<h2>How large are the errors?</h2>", _errors(report)]
    if "times" in report:
        parts += ["<h2>How long does an answer take?</h2>", _times(report)]
    parts += [
        _outputs(report),
        _methods(report),
        _pictures(folder),
        _checks(report),
        _left_out(report),
        _machine(report),
    ]
    body = "\n".join(part for part in parts if part)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{name}</title>'
        f"<style>{STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of texts, which are escaped here."""
    return "<table>" + _line(head, "th") + "".join(_line(row, "td") for row in rows) + "</table>"


def _line(cells: Sequence[str], tag: str) -> str:
    return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"


def _percent(value: Any) -> str:
    if not isinstance(value, int | float) or math.isnan(value):
        return "-"
    if math.isinf(value):
        return "no answer"
    return "round-off" if value < 1e-10 else f"{100 * value:.2g} %"


def _sizes(report: Mapping[str, Any]) -> str:
    sizes = report.get("sizes", {})
    told = {"N": "unknowns", "N_lambda": "contact conditions", "ell_bar": "modes", 
            "N_lambda_C": "kept contact conditions",
            "rid_cells": "cells of the reduced domain", "snapshots": "training answers"}  # fmt: skip
    found = [f"{sizes[key]} {what}" for key, what in told.items() if key in sizes]
    return f'<p class="small">{escape(", ".join(found))}</p>' if found else ""


def _advice(report: Mapping[str, Any]) -> str:
    text = report.get("advice")
    return f'<p class="advice">{escape(str(text))}</p>' if text else ""


def _errors(report: Mapping[str, Any]) -> str:
    rows = []
    for key, figures in report["errors"].items():
        if isinstance(figures, Mapping) and "median" in figures and key in ERRORS:
            rows.append([ERRORS[key], *(_percent(figures.get(name)) for name in ("median", "p95", "max"))])
    note = "<p class='small'>Relative to the full order, at parameters that no model was trained on.</p>"
    return _table(["error of", "half of the answers below", "95 % below", "worst"], rows) + note


def _times(report: Mapping[str, Any]) -> str:
    times = report["times"]
    base = (times.get("online") or times.get("condensed") or {}).get("median")
    rows = []
    for key, what in TIMES.items():
        figures = times.get(key)
        if isinstance(figures, Mapping) and "median" in figures:
            rows.append(
                [what, in_words(figures["median"]), in_words(figures["p95"]), f"{figures['median'] / base:.1f}"]
            )
    text = _table(["way to answer", "median", "95 %", "times the reduced model"], rows)
    offline = times.get("offline")
    if offline:
        text += f"<p>Before the first answer: {escape(in_words(sum(offline.values())))} of training and building.</p>"
    even = report.get("break_even") or {}
    told = [f"{count:.0f} queries ({what})" for what, count in even.items() if isinstance(count, int | float)]
    return text + (f"<p>It pays after {escape(', '.join(told))}.</p>" if told else "")


def _outputs(report: Mapping[str, Any]) -> str:
    outputs = report.get("outputs")
    if not outputs:
        return ""
    rows = []
    for name, item in outputs.items():
        errors = [_percent(item.get(key)) for key in ("median", "p95", "max")]
        rows.append([f"{name} [{item.get('unit') or '-'}]", f"{item['largest']:.4g}", *errors])
    return "<h2>Outputs</h2>" + _table(["output", "largest", "median error", "95 %", "worst"], rows)


def _methods(report: Mapping[str, Any]) -> str:
    rows = []
    for row in report.get("work_precision", []):
        if "refused" in row:
            rows.append([row["method"], row["setting"], "refused", "", row["refused"]])
        else:
            errors = [_percent(row.get(key)) for key in ("dual_full_floored", "dual_full_floored_max")]
            rows.append([row["method"], row["setting"], in_words(row["online_s"]), *errors])
    if not rows:
        return ""
    head = ["method", "setting", "time", "forces, median", "forces, worst"]
    return "<h2>All methods that were measured</h2>" + _table(head, rows)


def _pictures(folder: Path) -> str:
    found = [path for path in sorted(folder.glob("*.png"))]
    order = {name: place for place, name in enumerate(PICTURES)}
    found.sort(key=lambda path: (order.get(path.name, len(order)), path.name))
    figures = []
    for path in found:
        data = base64.b64encode(path.read_bytes()).decode()
        caption = PICTURES.get(path.name, path.stem.replace("_", " "))
        figures.append(
            f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,{data}">'
            f"<figcaption>{escape(caption)}</figcaption></figure>"
        )
    return "<h2>Pictures</h2>" + "".join(figures) if figures else ""


def _checks(report: Mapping[str, Any]) -> str:
    kkt = report.get("kkt")
    if not isinstance(kkt, Mapping):
        return ""
    rows = [[name.replace("_", " "), f"{value:.2g}"] for name, value in kkt.items() if isinstance(value, int | float)]
    return "<h2>What is left of the equations</h2>" + _table(["residual of what is handed out", "largest"], rows)


def _left_out(report: Mapping[str, Any]) -> str:
    rows = [[str(item.get("stage", "")), str(item.get("why", ""))] for item in report.get("skipped", [])]
    return "<h2>What was left out, and why</h2>" + _table(["what", "why"], rows) if rows else ""


def _machine(report: Mapping[str, Any]) -> str:
    parts = {**(report.get("machine") or {}), **(report.get("versions") or {})}
    told = ", ".join(f"{name} {value}" for name, value in parts.items() if isinstance(value, str | int | float))
    return f'<p class="small">{escape(told)}</p>' if told else ""
