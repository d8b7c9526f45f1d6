"""Batches: parameters from a table, spread over the ranks; every row gets an answer or a reason."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from mpi4py import MPI

from hhr_dolfinx import ranks
from hhr_dolfinx.errors import HHRError, ParameterError
from hhr_dolfinx.files import replacing
from hhr_dolfinx.models.reconstruct import OnlineModel
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.timing import timed

if TYPE_CHECKING:
    from rich.console import Console

_ANSWER = ("status", "largest_displacement", "total_force")


class TableRow(NamedTuple):
    """One row of a table of parameters.

    Attributes:
        line: number of its line in the file, from 1; the header counts.
        cells: parameters as text, in the order of the space.
        fault: what is wrong with the row as such, or nothing.
    """

    line: int
    cells: list[str]
    fault: str = ""


def read_points(path: str | Path, space: ParameterSpace) -> list[TableRow]:
    """Rows of a CSV file (UTF-8, commas) whose header names the parameters; empty lines are left out.

    Raises:
        ParameterError: if the file is missing, cannot be read, or its header does not name each parameter once.
    """
    try:
        # with or without the byte-order mark that spreadsheets write
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file, skipinitialspace=True)
            rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if row not in ([], [""])]
    except FileNotFoundError:
        raise ParameterError(f"there is no table of parameters {path}") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ParameterError(f"{path} cannot be read as a table of UTF-8 text ({error})") from error
    header = rows[0][1] if rows else []
    wrong = sorted(name for name in space.names if header.count(name) != 1)
    if wrong:
        raise ParameterError(
            f"{path} has no column {wrong} or has it twice: its header must name {space.names}, separated by commas"
        )
    columns = [header.index(name) for name in space.names]
    return [_row(line, cells, columns, len(header)) for line, cells in rows[1:]]


def answer_table(
    reduction: OnlineModel,
    rows: list[TableRow],
    path: str | Path,
    console: Console,
    progress: Callable[[Iterable], Iterable] = iter,
) -> int:
    """Answer a table on all ranks, write it as CSV on the first one, and print the bad rows with their reasons.

    Returns:
        On all ranks the number of rows without an answer.

    Raises:
        FileError: if the answers cannot be written.
        HHRError: on all ranks, if anything but a row went wrong on another one.
    """
    comm, space = MPI.COMM_WORLD, reduction.model.parameters
    answers, seconds = timed(lambda: answer_rows(reduction, rows, comm, progress))
    bad = 0
    with ranks.each_for_itself(comm, "writing the answers"):
        if answers is not None:
            bad = write_answers(path, space, answers)
    bad = comm.bcast(bad)
    if answers is not None:
        status = len(space.names)
        console.print(f"{len(rows) - bad} answers and {bad} bad rows on {comm.size} ranks in {seconds:.1f} s: {path}")
        for row, answer in zip(rows, answers, strict=True):
            if answer[status] != "ok":
                given = ", ".join(answer[:status])
                console.print(f"line {row.line} ({given}): {answer[status]}", highlight=False, markup=False)
    return bad


def answer_rows(
    reduction: OnlineModel,
    rows: list[TableRow],
    comm: MPI.Comm,
    progress: Callable[[Iterable], Iterable] = iter,
    outside: str = "refuse",
) -> list[list[str]] | None:
    """Answer every row with contact forces on the whole surface; a bad row does not stop the others.

    Args:
        reduction: the reduced model, the same on all ranks.
        rows: parameters as text, the same on all ranks.
        comm: communicator over which the rows are spread.
        progress: wraps the iteration, for a progress bar.
        outside: what happens to parameters outside what was trained, see ``ReducedModel.solve``; a table is read by
            those who see no warnings, so that such rows are refused unless asked for otherwise.

    Returns:
        On rank 0 one row per input: its parameters, status, largest displacement, total force and all
        forces, empty where there is no answer; None elsewhere.

    Raises:
        HHRError: on all ranks, if anything but a row went wrong on another one.
    """
    mine = np.array_split(np.arange(len(rows)), comm.size)[comm.rank]
    with ranks.each_for_itself(comm, "answering the table"):
        answers = [_answer(reduction, rows[k], outside) for k in progress(mine)]
    parts = comm.gather(answers, root=0)
    return None if parts is None else [row for part in parts for row in part]


def write_answers(path: str | Path, space: ParameterSpace, answers: list[list[str]]) -> int:
    """Write the answers as CSV with a header; returns the number of bad rows.

    Raises:
        FileError: if the file cannot be written.
    """
    given = len(space.names)
    forces = max((len(row) for row in answers), default=0) - given - len(_ANSWER)
    with replacing(path, text=True) as file:
        writer = csv.writer(file)
        writer.writerow([*space.names, *_ANSWER, *(f"force_{k}" for k in range(forces))])
        writer.writerows(answers)
    return sum(row[given] != "ok" for row in answers)


def _row(line, cells, columns, width) -> TableRow:
    """A row in the order of the parameters; cells behind the last may be decimal commas, which must not pass."""
    fault = f"{len(cells)} cells where the header has {width}" if any(cells[width:]) else ""
    padded = cells + [""] * width
    return TableRow(line, [padded[column] for column in columns], fault)


def _answer(reduction, row, outside) -> list[str]:
    try:
        point = _point(row, reduction.model.parameters.names)
        displacement, forces = reduction.solve_everywhere(point, outside=outside)
    except HHRError as error:  # what a row may do; anything else is a fault of the program and ends the run
        unanswered = [""] * (len(_ANSWER) - 1 + len(reduction.reconstruction.gaps))
        return [*row.cells, str(error), *unanswered]
    largest = np.linalg.norm(displacement.reshape(-1, reduction.dimension), axis=1).max()
    # 12 digits: what different orders of summation leave alone
    return [*row.cells, "ok", *(f"{value:.12g}" for value in (largest, forces.sum(), *forces))]


def _point(row, names) -> list[float]:
    """Numbers of a row.

    Raises:
        ParameterError: names the column.
    """
    if row.fault:
        raise ParameterError(row.fault)
    point = []
    for name, text in zip(names, row.cells, strict=True):
        try:
            point.append(float(text))
        except ValueError:
            why = "is empty" if not text else f"= '{text}' is no number"
            raise ParameterError(f"{name} {why}") from None
    return point
