"""Common parts of all demo scripts: options, console, progress bars, a writable folder."""

from __future__ import annotations

import argparse
import logging
import os
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from mpi4py import MPI

from hhr_dolfinx.command.console import Console, Table, make_console, progress_on
from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.parameters import ParameterSpace

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.tables.tables import TableRow


def demo_parser(name: str, description: str) -> argparse.ArgumentParser:
    """Parser with ``--out``, ``--quick`` and ``--seed``.

    The first line of ``description`` is shown.
    """
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument(
        "--out", type=Path, default=Path("out") / name, help="folder of the results (%(default)s)"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="fewer points and queries, for a first look and for tests",
    )
    parser.add_argument(
        "--seed", type=_seed, default=1, help="seed of random test points (%(default)s)"
    )
    return parser


def _seed(text: str) -> int:
    """An integer that is not negative, as random numbers need."""
    try:
        value = int(text)
    except ValueError:
        value = -1
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} must be an integer that is not negative")
    return value


def points_or_exit(
    parser: argparse.ArgumentParser, table: Path | None, space: ParameterSpace
) -> list[TableRow] | None:
    """Rows of a table of parameters, read before anything is computed; None without a table."""
    from hhr_dolfinx.plugins.tables.tables import read_points

    try:
        return None if table is None else read_points(table, space)
    except ParameterError as error:
        parser.error(str(error))


def answer_and_exit(
    model: AnsweringModel, rows: list[TableRow], options: argparse.Namespace
) -> NoReturn:
    """Answer a table of parameters and exit on all ranks, with exit code 1 if a row has no
    answer.
    """
    from hhr_dolfinx.plugins.tables.tables import answer_table

    bad = answer_table(
        model, rows, options.out / "answers.csv", options.console, options.progress("answers")
    )
    raise SystemExit(1 if bad else 0)


def parse_on_first_rank(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Parse as :func:`parse`, for a serial demo: the other ranks exit here."""
    options = parse(parser)
    if not options.first_rank:
        raise SystemExit(0)
    return options


def parse(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """The options, with a ``console`` that prints on the first rank only, and its ``progress`` bars
    by label.

    The folder ``out`` is created here: one that cannot be written to ends the program before
    anything is computed.
    """
    # the words of a notebook's process are those of its kernel
    options = parser.parse_args([] if "ipykernel" in sys.modules else None)
    options.first_rank = MPI.COMM_WORLD.rank == 0
    fault = MPI.COMM_WORLD.bcast(_why_not_writable(options.out) if options.first_rank else None)
    if fault and options.first_rank:
        parser.error(fault)
    if fault:
        raise SystemExit(2)
    options.console = make_console(quiet=not options.first_rank)
    options.progress = progress_on(options.console)
    # log long waits, such as the first compilation of a function
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    return options


def _why_not_writable(folder: Path) -> str:
    """Reason why no files can be written to a folder, and the remedy; empty if they can.

    The folder is created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # trying is more reliable than checking: rights, read-only mounts and full disks all show
        with tempfile.NamedTemporaryFile(dir=folder) as probe:
            probe.write(b"results")
            probe.flush()
    except OSError as error:
        why = f"--out {folder}: results cannot be written, {(error.strerror or str(error)).lower()}"
        if not isinstance(error, PermissionError):
            return f"{why}. Name another folder"
        return (
            f"{why}: {_owner(folder)}. Name a folder of yours by --out. For a folder mounted in a "
            "container: on the host, make it first (mkdir -p out) or make it yours "
            '(sudo chown "$(id -u)" out), and start the container as its owner '
            '(--user "$(id -u):$(id -g)")'
        )
    return ""


def _owner(folder: Path) -> str:
    """Owner of the folder, or of its parent, and the user, by number: names may be unknown on this
    machine.
    """
    there = next(
        place for place in (folder.absolute(), *folder.absolute().parents) if os.path.exists(place)
    )
    asks = f", this is user {os.geteuid()}" if hasattr(os, "geteuid") else ""
    return f"{there} belongs to user {there.stat().st_uid}{asks}"


def print_rows(title: str, rows: list[dict[str, Any]], console: Console) -> None:
    """Print rows with common keys as a table; long texts are shortened, the file has them whole."""
    table = Table(*rows[0], title=title)
    for row in rows:
        cells = (
            f"{value:.1e}"
            if isinstance(value, float)
            else ""
            if value is None
            else f"{value}"[:160]
            for value in row.values()
        )
        table.add_row(*cells)
    console.print(table)


def write_drawn(scene: str, counts: dict[str, int], options: argparse.Namespace) -> None:
    """Print what a script has drawn, and write it as the ``sizes`` of ``report.json``."""
    from hhr_dolfinx.plugins.studies import report

    written = {"scene": scene, "seed": options.seed, "sizes": counts}
    report.write_report({**written, **report.environment()}, options.out)
    listed = ", ".join(f"{count} {name}" for name, count in counts.items())
    options.console.print(f"{listed} in {options.out}", highlight=False)


def report_of_histories(
    scene: str, title: str, rows: dict[str, Any], condensing: float, options: Any
) -> None:
    """Print and write what a demo found of histories, by name, with the seconds of the
    condensation.
    """
    from hhr_dolfinx.plugins.studies import report

    shown = [
        {"what": name, "found": item if isinstance(item, str) else f"{item:.4g}"}
        for name, item in rows.items()
    ]
    print_rows(title, shown, options.console)
    found = {"scene": scene, "seed": options.seed, title: rows, "times": {"condense": condensing}}
    report.write_report({**found, **report.environment()}, options.out)
    options.console.print(f"model, picture and report are in {options.out}")
