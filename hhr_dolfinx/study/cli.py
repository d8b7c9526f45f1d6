"""What every demo script shares: its options, its console, its progress bars."""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI
from rich.console import Console
from rich.progress import track

from hhr_dolfinx.errors import ParameterError, StudyError
from hhr_dolfinx.online.batch import TableRow, answer_table, read_points
from hhr_dolfinx.online.reconstruct import OnlineModel
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.study.training import checked_folder


def demo_parser(name: str, description: str) -> argparse.ArgumentParser:
    """Parser with ``--out``, ``--quick`` and ``--seed``; the first line of ``description`` is shown."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--out", type=_folder, default=Path("out") / name, help="folder of the results (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="fewer points and queries, for a first look and for tests")
    parser.add_argument("--seed", type=_seed, default=1, help="seed of random test points (%(default)s)")
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


def _folder(text: str) -> Path:
    """A folder to write to."""
    try:
        return checked_folder(text)
    except StudyError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def points_or_exit(parser: argparse.ArgumentParser, table: Path | None, space: ParameterSpace):
    """Rows of a table of parameters, before anything is computed; None where no table was asked for."""
    try:
        return None if table is None else read_points(table, space)
    except ParameterError as error:
        parser.error(str(error))


def answer_and_exit(reduction: OnlineModel, rows: list[TableRow], options: argparse.Namespace) -> None:
    """Answer a table of parameters and end on all ranks, with exit code 1 if a row has no answer."""
    bad = answer_table(reduction, rows, options.out / "answers.csv", options.console, options.progress("answers"))
    raise SystemExit(1 if bad else 0)


def parse_on_first_rank(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """As :func:`parse`, for a demo that is serial: the other ranks end here."""
    options = parse(parser)
    if not options.first_rank:
        raise SystemExit(0)
    return options


def parse(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """The options, with a ``console`` that speaks on the first rank only and its ``progress`` bars by label."""
    options = parser.parse_args()
    options.console = console = Console(quiet=MPI.COMM_WORLD.rank > 0)
    options.first_rank = MPI.COMM_WORLD.rank == 0
    options.progress = lambda label: (
        lambda items: track(items, description=f"{label:10}", console=console, transient=True)
    )
    return options
