"""Their elements, our contact, beside the contact of their own code; formats of files.

Falsified files.

    python benchmarks/foreign.py [--out DIR] [--quick] [--seed N] [--only WORDS] [--large]

With CalculiX (``ccx``): a part of each kind of element, most of which this package lacks, clamped,
pressed on a rigid floor. CalculiX writes its K, solves one load case, and the contact by its
penalty; and a plate of shells on a solid whose K comes from a file in the format of Nastran.
``ours`` and ``theirs`` are forces on the floor in N; an outcome is "right" within 0.2 %. A plate of
shells whose files are stored is compared without CalculiX too. Then our own K through the format of
each code (forces, "right" within 1e-10), a superelement beside the whole K (1e-12), and
falsified files, each "refused" or "named". ``--large`` instead times a K of 109,395 dofs from its
files to the first answer of a condensed model, ``foreign_large``: some minutes, mostly CalculiX'.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import _demos  # noqa: F401
import foreign_decks as decks
import foreign_formats as formats
import numpy as np
from foreign_decks import Case, case_of
from foreign_large import of_large
from foreign_lies import LIES, retained
from parts import cli
from rich.table import Table

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import HHRError, SceneWarning
from hhr_dolfinx.plugins.studies import report

QUICK = ("S4", "C3D6", "B31")
POINT = (10.0, 0.2)


def of_formats() -> Iterator[Case]:
    """Our own block in the formats of all codes, and condensed to the nodes of its surfaces."""
    block = formats.own_block()
    theirs = hhr.FullOrderModel(formats.own_scene()).outputs(POINT)["force"]
    for write in formats.WRITERS:
        with tempfile.TemporaryDirectory() as folder:
            given = replace(block, stiffness=write(block.stiffness, Path(folder)))
            ours = hhr.FullOrderModel(formats.foreign_scene(given)).outputs(POINT)["force"]
        yield case_of(write.__name__.removeprefix("write_"), "ours, hexahedra", ours, theirs, 1e-10)
    loaded = np.flatnonzero(np.isin(block.stiffness.nodes, list(block.case.forces)))
    small = formats.condensed(block.stiffness, np.union1d(retained(block), loaded))
    given = replace(block, stiffness=small)
    ours = hhr.FullOrderModel(formats.foreign_scene(given)).outputs(POINT)["force"]
    yield case_of("superelement", "ours, hexahedra", ours, theirs, 1e-12)


def of_lies() -> Iterator[Case]:
    """Falsified files: refused, or named by a warning."""
    block = formats.own_block()
    for name, made in LIES.items():
        outcome = "wrong: accepted"
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", SceneWarning)
            try:
                _ = made(block).placed
            except HHRError as error:
                outcome = f"refused: {error}"
        if outcome.startswith("wrong") and said:
            outcome = f"named: {said[0].message}"
        yield {
            "code": "falsified",
            "elements": name,
            "outcome": outcome,
            "ours": None,
            "theirs": None,
        }


def _report_large(options: argparse.Namespace) -> None:
    """Time the large K, print its phases, write the report."""
    found = of_large((options.out / "large").resolve())
    table = Table("phase", "wall, s", "CPU, s")
    for row in [*found["phases"], {"phase": "all"} | found]:
        table.add_row(row["phase"], *(f"{row[kind]:.1f}" for kind in ("wall", "cpu")))
    options.console.print(table)
    report.write_report(
        {"scene": "foreign_large", "foreign": {"large": found}, **report.environment()}, options.out
    )


def main() -> None:
    """Run all, print a table, write the report."""
    parser = cli.demo_parser("foreign_codes", __doc__)
    parser.add_argument("--only", default="", help="kinds of elements, apart by commas [all]")
    parser.add_argument("--large", action="store_true", help="time a K of 109,395 dofs alone")
    options = cli.parse_on_first_rank(parser)
    if options.large:
        _report_large(options)
        return
    kinds = [word.strip() for word in options.only.split(",") if word.strip()]
    kinds = kinds or [*(QUICK if options.quick else (*decks.SOLIDS, *decks.SHELLS, *decks.BEAMS))]
    rows = decks.of_stored(options.out / "stored")
    if shutil.which("ccx"):
        rows += [decks.of_calculix(kind, (options.out / kind).resolve()) for kind in kinds]
        rows.append(decks.of_two_codes((options.out / "two codes").resolve()))
    rows += [*of_formats(), *of_lies()]
    table = Table("code", "elements", "ours", "theirs", "outcome")
    for row in rows:
        numbers = ["" if row[name] is None else f"{row[name]:.7g}" for name in ("ours", "theirs")]
        table.add_row(row["code"], row["elements"], *numbers, row["outcome"][:80])
    options.console.print(table)
    report.write_report(
        {"scene": "foreign_codes", "foreign": {"cases": rows}, **report.environment()}, options.out
    )


if __name__ == "__main__":
    main()
