"""``report.html``: the report and the pictures of a study in one file that needs no network and no
other file.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any, TypeAlias, TypeGuard, cast

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.files import replacing
from hhr_dolfinx.plugins.studies import charts
from hhr_dolfinx.plugins.studies.advice import in_words

Json: TypeAlias = "bool | int | float | str | Sequence[Json] | Mapping[str, Json] | None"
"""Value of a report."""
JsonObject = Mapping[str, Json]
"""Report, or a part of it with names, as ``report.json`` has it."""
LONG_CELL = 18
"""Length of the text of a cell above which it may break into several lines."""
MAPPED_PARAMETERS = 3
"""Number of parameters whose neighbours are mapped against each other."""
MAIN_ERRORS = ("primal_l2", "dual_full_floored", "stress_rr", "plastic_strain")
"""Main errors; the same in other norms, or of a part, are folded."""
ERRORS = {
    "primal_l2": "displacement, mean square",
    "primal_energy": "displacement, in energy",
    "primal_euclid": "displacement, node by node",
    "energy_minimum": "energy above its minimum",
    "dual_rid": "contact forces inside the reduced domain, whatever their size",
    "dual_rid_floored": "contact forces inside the reduced domain",
    "dual_full": "contact forces on the whole surface, whatever their size",
    "dual_full_floored": "contact forces, on the whole surface",
    "resultant": "resultant of the contact forces",
}
"""Names of errors for readers; others have the names of their keys."""
CHARTED = {"dual_full_floored": "contact forces", "primal_l2": "displacement"}
"""Errors that are drawn over the time of a query."""
MATERIAL_WORDS = {"young": "Young's modulus", "poisson": "Poisson's ratio"}
"""Names of constants of materials on the page."""
TIMES = {
    "fom_naive": "a first program: everything assembled and factored for each query",
    "fom_best": "the full order at its best: the stiffness factored once",
    "condensed": "condensation, contact forces",
    "condensed_full": "condensation, fields and forces",
    "online": "the reduced model, contact forces",
    "online_lapack": "the reduced model, contact forces, each system factored by LAPACK",
    "online_full": "the reduced model, fields and forces",
    "online_forces": "the reduced model, forces on the whole surface",
}
CAPTIONS = {
    "scene.png": "The scene: bodies, contact surfaces, supports and loads.",
    "pressures.png": "Contact pressures: lines of the full order, marks of the reduced model.",
    "fields.png": (
        "The cells on which the reduced model integrates (RID), and fields beside each other."
    ),
    "errors.png": "Errors over the parameter.",
    "contact_force.png": "Contact force over time.",
    "largest_plastic_strain.png": "Largest plastic strain over time.",
    "iterations_of_a_step.png": "Iterations of the steps of a history.",
}
"""Captions of pictures by their files, in this order."""
SIZES = {
    "N": "unknowns",
    "N_lambda": "contact conditions",
    "ell_bar": "modes",
    "N_lambda_C": "kept contact conditions",
    "rid_cells": "cells of the reduced domain",
    "snapshots": "training answers",
}
TOLD = frozenset(
    (
        "scene seed date parameters materials units advice outputs work_precision kkt break_even "
        "skipped machine versions samples discretisation"
    ).split()
)
"""Parts of a report with a separate place on the page; the others follow in their raw form."""


POLICY = (
    '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data:; '
    "style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'\">"
)
"""Policy of the page: it has pictures and styles inside, and neither runs nor loads anything from a
report.json.
"""


def write_page(folder: str | Path) -> Path:
    """Write ``report.html`` next to ``report.json``, with the pictures of the folder inside.

    Raises:
        FileContentError: if there is no report, or it is damaged.
        FileError: if the page cannot be written.
    """
    folder = Path(folder)
    source = folder if folder.suffix == ".json" else folder / "report.json"
    try:
        report = json.loads(source.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileContentError(
            f"there is no report {source}: run a study first, hhr study SCENE --out {folder}"
        ) from None
    except NotADirectoryError:
        raise FileContentError(
            f"{folder} is no folder: name the one that holds a report.json"
        ) from None
    except (OSError, ValueError, RecursionError) as error:
        raise FileContentError(f"{source} is no report ({error})") from error
    if not isinstance(report, dict) or not report:
        raise FileContentError(f"{source} is no report: it names no figures")
    path = source.with_suffix(".html")
    page = page_of({"scene": source.absolute().parent.name, **report}, source.parent)
    with replacing(path, text=True) as file:
        # UTF-8 has no half characters, which JSON may contain
        file.write(page.encode(errors="replace").decode())
    return path


def page_of(report: JsonObject, folder: Path) -> str:
    """The page of a report and the pictures in a folder; missing parts of the report are left
    out.
    """
    name = escape(str(report["scene"]))
    sizes = _mapping(report.get("sizes"))
    environment = {**_mapping(report.get("machine")), **_mapping(report.get("versions"))}
    left_out = [
        [_text(entry.get(key)) for key in ("stage", "why")]
        for entry in _mappings(report.get("skipped"))
    ]
    environment |= {name: report[name] for name in ("seed", "date") if name in report}
    sections = [
        f"<h1>{name}</h1>",
        _note(
            f"{_text(sizes[key])} {label}"
            for key, label in SIZES.items()
            if sizes.get(key) is not None
        ),
        f'<p class="advice">{escape(str(report["advice"]))}</p>' if report.get("advice") else "",
        _asked(report),
        _figure(folder / "scene.png"),
        _errors(_mapping(report.get("errors")), _mapping(report.get("discretisation"))),
        _charts(report),
        _times(_mapping(report.get("times"))),
        _break_even(_mapping(report.get("break_even"))),
        _section("Outputs", _table(OUTPUT_HEAD, output_rows(_mapping(report.get("outputs"))))),
        _section(
            "All methods that were measured",
            _table(METHOD_HEAD, method_rows(_mappings(report.get("work_precision")))),
        ),
        _pictures(folder),
        _loading(folder),
        _checks(_mapping(report.get("kkt"))),
        _section("What was left out, and why", _table(["what", "why"], left_out)),
        _others(report),
        _note(f"{name} {_text(value)}" for name, value in environment.items()),
    ]
    style = (resources.files(__package__) / "report.css").read_text(encoding="utf-8")
    body = "\n".join(section for section in sections if section)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">{POLICY}'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{name}</title>'
        f"<style>{style}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def _mapping(value: Json) -> JsonObject:
    """A part of a report that is a table by name; empty if it is missing or no table."""
    return value if isinstance(value, Mapping) else {}


def _mappings(value: Json) -> list[JsonObject]:
    return [row for row in value if isinstance(row, Mapping)] if isinstance(value, list) else []


def _is_number(value: Json) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and not math.isnan(value)


def _is_summary(value: Json) -> TypeGuard[JsonObject]:
    return isinstance(value, Mapping) and "median" in value


def _section(title: str, *parts: str) -> str:
    """Parts under a title; empty without any."""
    return f"<h2>{escape(title)}</h2>" + "".join(parts) if any(parts) else ""


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of texts, which are escaped here; empty for no rows."""
    if not rows:
        return ""
    # a narrow screen scrolls a wide table, and not the page
    lines = _line(head, "th") + "".join(_line(row, "td") for row in rows)
    return f'<div class="wide"><table>{lines}</table></div>'


def _line(cells: Sequence[str], tag: str) -> str:
    marks = (f'<{tag} class="long">' if len(cell) > LONG_CELL else f"<{tag}>" for cell in cells)
    return (
        "<tr>"
        + "".join(f"{mark}{escape(cell)}</{tag}>" for mark, cell in zip(marks, cells, strict=True))
        + "</tr>"
    )


def _percent(value: Json) -> str:
    if not _is_number(value):
        return "-"
    if math.isinf(value):
        return "no answer"
    return "round-off" if abs(value) < 1e-10 else f"{100 * value:.2g} %"


def _seconds(value: Json) -> str:
    return in_words(value) if _is_number(value) and math.isfinite(value) else "-"


def _text(value: Json) -> str:
    """Anything of a report as text."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(_text(entry) for entry in value)
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_text(entry)}" for name, entry in value.items())
    return str(value)


def _words(name: str) -> str:
    return str(name).replace("_", " ")


def _note(texts: Iterable[str]) -> str:
    listed = ", ".join(texts)
    return f'<p class="small">{escape(listed)}</p>' if listed else ""


def _asked(report: JsonObject) -> str:
    box = [
        [_named(row), *(_text(row.get(name)) for name in ("from", "to"))]
        for row in _mappings(report.get("parameters"))
    ]
    material_rows = _mappings(report.get("materials"))
    names = list(dict.fromkeys(name for row in material_rows for name in row))
    materials = [[_text(row.get(name, "")) for name in names] for row in material_rows]
    units = _mapping(report.get("units"))
    return _section(
        "Parameters and materials",
        _table(["parameter", "from", "to"], box),
        _table([MATERIAL_WORDS.get(name, _words(name)) for name in names], materials),
        _note(f"{name} in {_text(unit)}" for name, unit in units.items()),
    )


def _named(row: JsonObject) -> str:
    unit = row.get("unit")
    return _text(row.get("name")) + (f" [{_text(unit)}]" if unit else "")


ERROR_HEAD = ("error of", "half of the answers below", "95 % below", "worst seen")
TIME_HEAD = ("way to answer", "median", "95 %", "times the reduced model")
OUTPUT_HEAD = ("output", "largest", "median error", "95 %", "worst")
METHOD_HEAD = (
    "method",
    "setting",
    "time",
    "displacement",
    "forces, median",
    "forces, worst",
    "remark",
)


def error_rows(errors: JsonObject) -> dict[str, list[str]]:
    """Cells of the ``errors`` of a report by key, below :data:`ERROR_HEAD`."""
    return {
        key: [
            ERRORS.get(key, _words(key)),
            *(_percent(figures.get(name)) for name in ("median", "p95", "max")),
        ]
        for key, figures in errors.items()
        if _is_summary(figures)
    }


def time_rows(times: JsonObject) -> list[list[str]]:
    """Cells of the ``times`` of a report, below :data:`TIME_HEAD`."""
    base = _mapping(times.get("online") or times.get("condensed")).get("median")
    rows = []
    for key, figures in times.items():
        if _is_summary(figures):
            median = figures["median"]
            ratio = (
                f"{median / base:.1f}"
                if _is_number(median) and _is_number(base) and base > 0
                else "-"
            )
            rows.append(
                [TIMES.get(key, _words(key)), _seconds(median), _seconds(figures.get("p95")), ratio]
            )
    return rows


def output_rows(outputs: JsonObject) -> list[list[str]]:
    """Cells of the ``outputs`` of a report, below :data:`OUTPUT_HEAD`."""
    rows = []
    for name, entry in outputs.items():
        figures = _mapping(entry)
        errors = [_percent(figures.get(key)) for key in ("median", "p95", "max")]
        rows.append([_named({**figures, "name": name}), _text(figures.get("largest")), *errors])
    return rows


def method_rows(methods: Sequence[JsonObject]) -> list[list[str]]:
    """Cells of the ``work_precision`` of a report, below :data:`METHOD_HEAD`.

    Those with the smallest errors of forces come first, refused ones last.
    """
    rows = []
    for row in sorted(methods, key=_by_forces):
        named = [_text(row.get("method")), _text(row.get("setting"))]
        if "refused" in row:
            rows.append([*named, "refused", "", "", "", _text(row["refused"])])
        else:
            errors = [
                _percent(row.get(key))
                for key in ("primal_l2", "dual_full_floored", "dual_full_floored_max")
            ]
            silent = row.get("unconverged") or 0
            remarks = [f"no answer at {silent} points"] if silent else []
            remarks += [_text(row["warning"])] if row.get("warning") else []
            rows.append([*named, _seconds(row.get("online_s")), *errors, "; ".join(remarks)])
    return rows


def _by_forces(row: JsonObject) -> float:
    """Median error of forces of a method, by which its row is sorted; infinite without one."""
    value = row.get("dual_full_floored")
    return float(value) if isinstance(value, int | float) and "refused" not in row else math.inf


def _errors(errors: JsonObject, mesh: JsonObject) -> str:
    rows = error_rows(errors)
    main = [row for key, row in rows.items() if key in MAIN_ERRORS] or list(rows.values())
    remaining = [row for row in rows.values() if row not in main]
    note = (
        "<p class='small'>Relative to the full order, at parameters that no model was trained "
        "on.</p>"
    )
    table = _table(ERROR_HEAD, main)
    caption = (
        f"<p>Beside these, the mesh: its stress is off by some {_percent(mesh.get('energy'))} in "
        f"energy, its peak pressure by {_percent(mesh.get('peak_pressure'))}, as estimated at one "
        "answer. All models here share it.</p>"
    )
    blocks = [
        table and table + note,
        _folded("in other norms", _table(ERROR_HEAD, remaining)),
        caption if mesh else "",
    ]
    return _section("How large are the errors?", *blocks)


def _times(times: JsonObject) -> str:
    stages = [value for value in _mapping(times.get("offline")).values() if _is_number(value)]
    cost = (
        f"<p>Before the first answer: {escape(_seconds(sum(stages)))} of training and building.</p>"
    )
    table = _table(TIME_HEAD, time_rows(times))
    return _section("How long does an answer take?", table, cost if stages else "")


def _break_even(even: JsonObject) -> str:
    counts = [
        f"{count:.0f} queries ({product})" for product, count in even.items() if _is_number(count)
    ]
    return f"<p>It pays after {escape(', '.join(counts))}.</p>" if counts else ""


def _charts(report: JsonObject) -> str:
    """Errors over times of all methods.

    For elastic scenes distributions of errors and bounds, and their position.
    """
    caption = (
        " over the time of a query: half of the answers are below a mark, 95 % below the tick of "
        "its tail, none is above the end. Nothing beats what lies on the dashed line in both."
    )
    rows = _mappings(report.get("work_precision"))
    captioned = [
        (
            charts.work_precision(_marks(rows, key), f"error of {name}"),
            f"Error of the {name}{caption}",
        )
        for key, name in CHARTED.items()
    ]
    samples = _mapping(report.get("samples"))
    errors = _numbers(_mapping(samples.get("errors")).get("forces"))
    kind = _text(samples.get("kind") or "bound")
    bounds = _numbers(_mapping(samples.get("bounds")).get("forces"))
    caption = (
        f"Bars: errors of contact forces at {len(errors)} points that no model was trained on."
    )
    caption += (
        f" Line: what the model said beforehand of each, without the full answer ({kind})."
        if bounds
        else ""
    )
    captioned.append(
        (
            charts.histogram(errors, bounds, "error of contact forces", f"{kind} of each answer"),
            caption,
        )
    )
    captioned += [
        (chart, "Where errors are large: the redder and larger a point, the larger.")
        for chart in _maps(report, errors)
    ]
    figures = (
        f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>"
        for svg, caption in captioned
        if svg
    )
    body = "".join(figures)
    return f'<section class="charts">{body}</section>' if body else ""


def _marks(rows: Sequence[JsonObject], key: str) -> list[charts.Mark]:
    """Marks of the methods whose error of a key is known."""
    return [
        charts.Mark(
            " ".join(
                dict.fromkeys(_text(row.get(name, "")) for name in ("method", "setting"))
            ).strip(),
            cast("float", row["online_s"]),
            cast("float", row[key]),
            _number(row.get(f"{key}_p95")),
            _number(row.get(f"{key}_max")),
            own=row.get("setting") == "this model",
        )
        for row in rows
        if _is_number(row.get("online_s")) and _is_number(row.get(key))
    ]


def _maps(report: JsonObject, errors: list[float]) -> list[str]:
    """Errors over each of the first parameters and the next one.

    Empty if the points do not have these parameters.
    """
    box = _mappings(report.get("parameters"))
    ends: list[Any] = [(row.get("from"), row.get("to")) for row in box]
    rows = _mapping(report.get("samples")).get("points")
    points = [_numbers(row) for row in rows] if isinstance(rows, list) else []
    fits = len(points) == len(errors) and all(len(point) == len(box) for point in points)
    if not fits or not all(
        _is_number(low) and _is_number(high) and 0 < high - low < math.inf for low, high in ends
    ):
        return []
    return [
        charts.map_of(
            [(point[k], point[k + 1]) for point in points],
            errors,
            (_named(box[k]), _named(box[k + 1])),
            ends[k : k + 2],
        )
        for k in range(min(len(box) - 1, MAPPED_PARAMETERS))
    ]


def _numbers(values: Json) -> list[float]:
    """Numbers of a list, with NaN for other values."""
    return [_number(value) for value in values] if isinstance(values, list) else []


def _number(value: Json) -> float:
    return float(value) if _is_number(value) else math.nan


def _figure(path: Path) -> str:
    """A picture with its caption; empty if it is missing."""
    if not path.is_file():
        return ""
    data = base64.b64encode(path.read_bytes()).decode()
    caption = escape(CAPTIONS.get(path.name, _words(path.stem)))
    image = f'<img alt="{caption}" src="data:image/png;base64,{data}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"


def _pictures(folder: Path) -> str:
    order = {name: index for index, name in enumerate(CAPTIONS)}
    paths = [path for path in folder.glob("*.png") if path.name != "scene.png"]
    paths.sort(key=lambda path: (order.get(path.name, len(order)), path.name))
    return _section("Pictures", *(_figure(path) for path in paths))


def _loading(folder: Path) -> str:
    """Code that loads and queries the models in the folder of a report."""
    models = [
        path.name
        for path in sorted(folder.glob("*.npz"))
        if path.name in ("study.npz", "condensed.npz")
    ]
    if not models:
        return ""
    lines = ["import hhr_dolfinx as hhr", ""]
    lines += [f'model = hhr.load_model("{name}")' for name in models]
    lines += [
        "answer = model.solve(point)  # parameters by name, or in their order; path: "
        "model.march(path)"
    ]
    lines += ["answer.forces(), answer.displacement(), answer.estimate()"]
    hint = (
        "It needs NumPy and SciPy, no DOLFINx. A table is answered by "
        f"<code>hhr answer {models[-1]} questions.csv</code>."
    )
    return _section(
        "How is the model used?", f"<pre>{escape(chr(10).join(lines))}</pre>", f"<p>{hint}</p>"
    )


def _checks(residuals: JsonObject) -> str:
    rows = [
        [_words(name), f"{value:.2g}"] for name, value in residuals.items() if _is_number(value)
    ]
    caption = (
        "<p class='small'>Equilibrium: forces that are out of balance node by node, over the "
        "contact forces, which says little of the error of a displacement; penetration: of the "
        "largest gap or motion; sign: pull, of the largest force.</p>"
    )
    table = _table(["residual of what is handed out, relative", "largest"], rows)
    return _section("What is left of the equations", table and table + caption)


def _others(report: JsonObject) -> str:
    """Parts without a separate place, folded, each as a table."""
    shown = {key: value for key, value in report.items() if key not in TOLD}
    for key in ("errors", "times"):
        shown[key] = {
            name: entry
            for name, entry in _mapping(report.get(key)).items()
            if not _is_summary(entry)
        }
    return _section(
        "Everything else", *(_folded(_words(key), _plain(value)) for key, value in shown.items())
    )


def _folded(title: str, content: str) -> str:
    return f"<details><summary>{escape(title)}</summary>{content}</details>" if content else ""


def _plain(value: Json) -> str:
    """A part of a report as a table: rows that share their keys, or values by name."""
    if rows := _mappings(value):
        head = list(dict.fromkeys(name for row in rows for name in row))
        return _table(
            [_words(name) for name in head],
            [[_text(row.get(name, "")) for name in head] for row in rows],
        )
    if isinstance(value, Mapping):
        nested = {
            name: entry
            for name, entry in value.items()
            if isinstance(entry, Mapping | list) and entry
        }
        table = _table(
            ["", "value"],
            [[_words(name), _text(entry)] for name, entry in value.items() if name not in nested],
        )
        return table + "".join(
            _folded(_words(name), _plain(entry)) for name, entry in nested.items()
        )
    return f"<p>{escape(_text(value))}</p>" if value not in (None, []) else ""
