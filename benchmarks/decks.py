"""Decks of strangers: `hhr start`, `check`, `solve` or `march` as they are, and how far the first
number is right.

    python benchmarks/decks.py [--out DIR] [--quick] [--seed N] [--only WORDS] [--again]

Small decks of the makes of CalculiX' own tests and examples, with closed forms or figures of
CalculiX 2.20 beside them. An outcome is "right" within 1 % (or within what the entry allows),
"refused: SENTENCE" where a keyword has no counterpart, "by hand: SENTENCE" where `hhr start` names
a keyword that it leaves to its user, "warned: SENTENCE" of a case whose number is off and says so,
or "off by x %". Minutes are those of the machine for the three commands, each a process; reading
and typing are not in them.
"""

from __future__ import annotations

import os
import re
import statistics
import subprocess
import time
from pathlib import Path
from typing import Any

import _demos  # noqa: F401
import deck_cases
import deck_examples
import deck_faults
import deck_fits
import meshio
import numpy as np
from deck_commands import command
from deck_entries import ENTRIES, Answer, Case, Entry
from parts import cli
from rich.table import Table

from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.warn import collected

QUICK = ("contact4", "plate", "ring1, two sets")


def rows_of(said: str) -> dict[str, float]:
    """Rows ``name: number`` of what a command printed, or the last row of a table of steps."""
    found = re.findall(
        r"^([^:\n]+(?:: [^:\n]*)?): (-?[0-9.]+(?:e[+-]?[0-9]+)?)$", said, re.MULTILINE
    )
    table = [
        re.split(r"\s{2,}", line.strip()) for line in said.splitlines() if line.startswith("  ")
    ]
    heads = next((k for k, row in enumerate(table) if row[0].startswith("time")), None)
    if heads is not None:
        found = list(zip(table[heads], table[-1], strict=True))
    return {name: float(value) for name, value in found}


def displacements(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Places and displacements of nodes, (n, 3), of a field file."""
    text = file.read_text().replace(
        'version="2.3"', 'version="1.0"'
    )  # meshio knows no later one, which is alike
    file.write_text(text)
    read = meshio.read(file)
    moved = next(
        values for name, values in read.point_data.items() if name.startswith("displacement")
    )
    return read.points, np.hstack([moved, np.zeros((len(moved), 3 - moved.shape[1]))])


def again(deck: Path, entry: Entry) -> float | None:
    """The quantity by CalculiX; None where it ends early, or has none."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    subprocess.run(
        ["ccx", deck.stem], cwd=deck.parent, capture_output=True, timeout=300, env=environment
    )
    nodes = re.findall(
        r"^(\d+), ([-+.e\d]+), ([-+.e\d]+), ([-+.e\d]+)$", deck.read_text(), re.MULTILINE
    )
    count = max(int(words[0]) for words in nodes)
    points, moved = np.full((count, 3), 1e9), np.full((count, 3), np.nan)
    for number, *place in nodes:
        points[int(number) - 1] = [float(word) for word in place]
    for line in deck.with_suffix(".dat").read_text().splitlines():
        words = line.split()
        if len(words) == 4 and words[0].isdigit() and int(words[0]) <= count:
            moved[int(words[0]) - 1] = [float(word) for word in words[1:]]
    try:
        return entry.read(Answer(deck, {}, points, moved))
    except (StopIteration, AssertionError, np.linalg.LinAlgError):
        return None


def judged(entry: Any, ours: float | None, said: str) -> str:
    """The outcome of an entry: ours is None where a command failed."""
    if "FOREIGN" in said:
        return "foreign: " + said.strip().splitlines()[-1]
    expected = entry.reference if isinstance(entry.reference, str) else ""
    lines = said.replace("\n  ", " ").splitlines()
    sentence = next(
        (line for line in lines if line.lower().startswith("error") or "Error:" in line), ""
    )
    left = [
        line
        for line in lines
        if line.startswith("TODO") and "NLGEOM" not in line and "OVERCLOSURE" not in line
    ]
    if expected:
        found = next((line for line in (*left, sentence) if expected in line), "")
        warned = next(
            (line for line in lines if line.startswith("warning") and expected in line), ""
        )
        if warned and not found:
            return f"warned: {warned}"
        return f"refused: {found}" if found else f"silent: nothing says {expected}"
    if ours is None:
        return f"by hand: {left[0]}" if left else f"refused: {sentence}"
    off = abs(ours / entry.reference - 1) if entry.reference else float("inf")
    if off <= entry.within:
        return "right"
    return f"by hand: {left[0]}" if left else f"off by {100 * off:.2g} %"


def run(entry: Entry, folder: Path, with_calculix: bool) -> dict[str, Any]:
    """The row of a deck: written, then started, checked and solved as it is."""
    stem = re.sub(r"[^A-Za-z0-9]+", "_", entry.source.removesuffix(".inp")).strip("_").lower()
    deck = folder / f"{stem}.inp"
    deck.write_text(entry.write())
    scene, fields = deck.with_suffix(".py"), deck.with_suffix(".vtu")
    begin = time.perf_counter()
    well, said = command(folder, "start", deck.name, "--force")
    ours = None
    if well:
        said += command(folder, "check", scene.name)[1]
        steps = "\nPATHS = " in scene.read_text()  # answers depend on the path
        well, solved = command(
            folder, "march" if steps else "solve", scene.name, "--out", fields.name
        )
        said += solved
        fields = sorted(folder.glob(f"{fields.stem}_[0-9]*.vtu"))[-1] if well and steps else fields
    minutes = (time.perf_counter() - begin) / 60
    if well and not isinstance(entry.reference, str):
        ours = entry.read(Answer(scene, rows_of(solved), *displacements(fields)))
    found = {
        "source": entry.source,
        "kind": entry.kind,
        "minutes": minutes,
        "outcome": judged(entry, ours, said),
    }
    found |= {
        "quantity": entry.quantity,
        "reference": entry.reference,
        "by": entry.by,
        "ours": ours,
        "started": well,
    }
    return found | ({"calculix": again(deck, entry)} if with_calculix else {})


def run_case(case: Case, folder: Path) -> dict[str, Any]:
    """The row of a scene in Python."""
    begin, ours, said = time.perf_counter(), None, ""
    with collected(Warning) as warned:
        try:
            ours = case.run(folder)
        except HHRError as error:
            said = f"error: {error}".replace("\n", " ")
        except Exception as error:  # what else comes is the finding
            said = f"FOREIGN {type(error).__name__}: {error}"
    said = "\n".join([said, *(f"warning: {item.message}".replace("\n", " ") for item in warned)])
    minutes = (time.perf_counter() - begin) / 60
    found = {
        "source": case.source,
        "kind": case.kind,
        "minutes": minutes,
        "outcome": judged(case, ours, said),
    }
    return found | {
        "quantity": case.quantity,
        "reference": case.reference,
        "by": case.by,
        "ours": ours,
    }


def counted(rows: list[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """Numbers of outcomes of decks, press fits and cases of faults."""
    found: dict[str, dict[str, int]] = {}
    for row in rows:
        sort = (
            "decks"
            if "started" in row
            else "press fits"
            if row["source"].startswith("press")
            else "cases"
        )
        outcome = re.split(r": | by ", row["outcome"])[0]
        own = found.setdefault(sort, {})
        own[outcome] = own.get(outcome, 0) + 1
    return found


def main() -> None:
    """Run all, print a table, write the report."""
    parser = cli.demo_parser("decks", __doc__)
    parser.add_argument("--only", default="", help="words of sources, apart by commas [all]")
    parser.add_argument("--again", action="store_true", help="run CalculiX on the decks too")
    options = cli.parse_on_first_rank(parser)
    words = [word.strip() for word in options.only.split(",") if word.strip()]
    options.out.mkdir(parents=True, exist_ok=True)
    folder = (options.out / "decks").resolve()
    folder.mkdir(exist_ok=True)
    rows = []
    for entry in (
        *ENTRIES,
        *deck_examples.ENTRIES,
        *deck_fits.CASES,
        *deck_cases.CASES,
        *deck_faults.CASES,
    ):
        if (options.quick and entry.source not in QUICK) or (
            words and not any(one in entry.source for one in words)
        ):
            continue
        deck = isinstance(entry, Entry)
        rows.append(run(entry, folder, options.again) if deck else run_case(entry, folder))
        options.console.print(
            *(rows[-1].get(name, "") for name in ("source", "ours", "calculix", "outcome")),
            markup=False,
        )
    table = Table("source", "kind", "minutes", "quantity", "reference", "ours", "outcome")
    for row in rows:
        shown = [
            f"{row[name]:.4g}" if isinstance(row[name], float) else ""
            for name in ("minutes", "reference", "ours")
        ]
        table.add_row(
            row["source"], row["kind"], shown[0], row["quantity"], *shown[1:], row["outcome"]
        )
    options.console.print(table)
    first = [row["minutes"] for row in rows if row.get("started") and row["outcome"] == "right"]
    found = {
        "decks": rows,
        "started_and_solved": len(first),
        "median_minutes": statistics.median(first or [0.0]),
    }
    found["foreign"] = sum(row["outcome"].startswith(("foreign", "silent")) for row in rows)
    found["outcomes"] = counted(rows)
    options.console.print({name: value for name, value in found.items() if name != "decks"})
    report.write_report({"scene": "decks", **found, **report.environment()}, options.out)


if __name__ == "__main__":
    main()
