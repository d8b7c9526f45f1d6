"""Batches: many parameters answered as arrays, spread over the ranks; and tables of text at the edge of that.

A parameter that has no answer gets a reason and does not stop the others.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hhr_dolfinx import ranks
from hhr_dolfinx.errors import HHRError, ParameterError
from hhr_dolfinx.files import replacing
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.timing import timed
from hhr_dolfinx.trained import check_outside

if TYPE_CHECKING:
    from mpi4py.MPI import Comm
    from rich.console import Console

Progress = Callable[[Iterable], Iterable]
"""Wraps an iteration, for a progress bar."""

OK = "ok"
"""Status of a row that has an answer."""
_COLUMNS = ("status", "largest_displacement", "total_force")


class Answers(NamedTuple):
    """Answers to many parameters, one row each; NaN where there is none.

    Attributes:
        points: parameters, (S, P).
        status: ``ok``, or why there is no answer.
        largest_displacement: of any node, (S,).
        forces: nodal contact forces on the whole surface, (S, N_lambda).
        outputs: those of the scene by the head of their column, ``name [unit]``, (S,) each.
    """

    points: np.ndarray
    status: list[str]
    largest_displacement: np.ndarray
    forces: np.ndarray
    outputs: Mapping[str, np.ndarray] = MappingProxyType({})


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


def answer_points(
    model: ReducedModel,
    points: np.ndarray,
    comm: Comm | None = None,
    progress: Progress = iter,
    outside: str = "refuse",
) -> Answers | None:
    """Answer every point, (S, P), with contact forces on the whole surface; None on all ranks but the first.

    Each rank takes a block of them: queries take about the same time, so that nothing is gained by handing them out
    one by one.

    Args:
        model: the reduced model, the same on all ranks, as the points.
        points: (S, P).
        comm: communicator over which they are spread; None for this process alone, which needs no MPI.
        progress: wraps the iteration, for a progress bar.
        outside: see :meth:`Model.solve`; batches are read by those who see no warnings, so that rows outside what was
            trained are refused unless asked for otherwise.

    Raises:
        ParameterError: for what is no table of points, or an unknown ``outside``.
        HHRError: on all ranks, if anything but a row went wrong on another one.
    """
    rank, size = (0, 1) if comm is None else (comm.rank, comm.size)
    with nullcontext() if comm is None else ranks.each_for_itself(comm, "answering the table"):
        check_outside(outside)
        points = _table(points, model.parameters)
        mine = np.array_split(np.arange(len(points)), size)[rank]
        rows = [_answer(model, points[k], outside) for k in progress(mine)]
    parts = [rows] if comm is None else comm.gather(rows, root=0)
    if parts is None:
        return None
    every = [row for part in parts for row in part]
    status, largest, forces, outputs = zip(*every, strict=True) if every else ((),) * 4
    heads, count = _heads_of(model), len(points)
    columns = dict(zip(heads, np.array(outputs).reshape(count, len(heads)).T, strict=True))
    return Answers(points, list(status), np.array(largest), np.array(forces).reshape(count, _forces_of(model)), columns)


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
    except (OSError, ValueError, csv.Error) as error:
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
    model: ReducedModel, rows: Sequence[TableRow], path: str | Path, console: Console, progress: Progress = iter
) -> int:
    """Answer a table on all ranks, write it as CSV on the first one, and print the bad rows with their reasons.

    Returns:
        On all ranks the number of rows without an answer.

    Raises:
        FileError: if the answers cannot be written.
        HHRError: on all ranks, if anything but a row went wrong on another one.
    """
    from mpi4py import MPI

    comm, space = MPI.COMM_WORLD, model.parameters
    numbers = [_numbers(row, space) for row in rows]
    points = np.array([point for point, _ in numbers]).reshape(len(rows), len(space.names))
    answers, seconds = timed(lambda: answer_points(model, points, comm, progress))
    bad = 0
    with ranks.each_for_itself(comm, "writing the answers"):
        if answers is not None:
            # a cell that is no number has a reason of its own
            status = [fault or found for (_, fault), found in zip(numbers, answers.status, strict=True)]
            bad = write_answers(path, space, answers._replace(status=status), [row.cells for row in rows])
    bad = comm.bcast(bad)
    if answers is not None:
        done = f"{len(rows) - bad} answers and {bad} bad rows on {comm.size} ranks in {seconds:.1f} s: {path}"
        console.print(done, markup=False)
        for row, why in zip(rows, status, strict=True):
            if why != OK:
                given = ", ".join(row.cells)
                console.print(f"line {row.line} ({given}): {why}", highlight=False, markup=False)
    return bad


def write_answers(
    path: str | Path, space: ParameterSpace, answers: Answers, cells: Sequence[Sequence[str]] | None = None
) -> int:
    """Write answers as CSV with a header; returns the number of rows that have none.

    Args:
        path: the file.
        space: whose names head the columns of the parameters.
        answers: what :func:`answer_points` returned.
        cells: the parameters as they were given, as text; None writes the numbers.

    Raises:
        FileError: if the file cannot be written.
    """
    given = answers.points.tolist() if cells is None else cells
    count = answers.forces.shape[1]
    with replacing(path, text=True) as file:
        writer = csv.writer(file)
        writer.writerow([*space.names, *_COLUMNS, *answers.outputs, *(f"force_{k}" for k in range(count))])
        for k, (row, status) in enumerate(zip(given, answers.status, strict=True)):
            forces, outputs = answers.forces[k], [column[k] for column in answers.outputs.values()]
            values = [answers.largest_displacement[k], forces.sum(), *outputs, *forces]
            # 12 digits: what different orders of summation leave alone
            writer.writerow([*row, status, *(f"{value:.12g}" if status == OK else "" for value in values)])
    return sum(status != OK for status in answers.status)


def _table(points: Any, space: ParameterSpace) -> np.ndarray:
    """Points as a table of numbers."""
    try:
        table = np.array(points, dtype=float)
    except (TypeError, ValueError) as error:
        raise ParameterError(f"points are no table of numbers, a row per point ({error})") from None
    if table.ndim != 2 or table.shape[1] != len(space.names):
        raise ParameterError(
            f"points have the shape {table.shape}: give one row per point, a column for each of {space.names}"
        )
    return table


def _row(line: int, cells: list[str], columns: list[int], width: int) -> TableRow:
    """A row in the order of the parameters; cells behind the last may be decimal commas, which must not pass."""
    fault = f"{len(cells)} cells where the header has {width}" if any(cells[width:]) else ""
    padded = cells + [""] * width
    return TableRow(line, [padded[column] for column in columns], fault)


def _numbers(row: TableRow, space: ParameterSpace) -> tuple[list[float], str]:
    """The point of a row, and what is wrong with its text; no point, NaN, where anything is."""
    nothing = [np.nan] * len(space.names)
    if row.fault:
        return nothing, row.fault
    point = []
    for name, text in zip(space.names, row.cells, strict=True):
        try:
            point.append(float(text))
        except ValueError:
            return nothing, f"{name} is empty" if not text else f"{name} = '{text}' is no number"
    return point, ""


def _answer(model: ReducedModel, point: np.ndarray, outside: str) -> tuple[str, float, np.ndarray, list[float]]:
    """Status, largest displacement, forces and outputs at one point."""
    heads = _heads_of(model)
    try:
        answer = model.solve(point, outside=outside)
        displacement, forces = answer.displacement(), answer.forces()
        outputs = list(answer.outputs().values.values()) if heads else []
    except HHRError as error:  # what a row may do; anything else is a fault of the program and ends the run
        return str(error), np.nan, np.full(_forces_of(model), np.nan), [np.nan] * len(heads)
    return OK, np.linalg.norm(displacement.reshape(-1, model.dimension), axis=1).max(), forces, outputs


def _heads_of(model: ReducedModel) -> list[str]:
    """Heads of the columns of the outputs."""
    items = () if model.fields.functionals is None else model.fields.functionals.items
    return [f"{item.name} [{item.unit}]" if item.unit else item.name for item in items]


def _forces_of(model: ReducedModel) -> int:
    """Number of conditions on the whole contact surface."""
    return len(model.fields.gaps)
