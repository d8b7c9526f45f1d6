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
from hhr_dolfinx.models.choice import LEAF
from hhr_dolfinx.models.estimates import Estimate, columns
from hhr_dolfinx.models.fallback import FallbackModel
from hhr_dolfinx.models.local import LocalModels
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.timing import timed
from hhr_dolfinx.trained import check_outside

if TYPE_CHECKING:
    from mpi4py.MPI import Comm
    from rich.console import Console


Progress = Callable[[Iterable], Iterable]
"""Wraps an iteration, for a progress bar."""

Answering = ReducedModel | LocalModels | FallbackModel
"""What answers tables."""

PARQUET = ".parquet"
"""Ending of tables that are no text."""
OK = "ok"
"""Status of a row that has an answer."""
_STATUS = "status"


class Answers(NamedTuple):
    """Answers to many parameters, one row each; NaN where there is none.

    Attributes:
        points: parameters, (S, P).
        status: ``ok``, or why there is no answer.
        largest_displacement: of any node, (S,).
        forces: nodal contact forces on the whole surface, (S, N_lambda).
        outputs: those of the scene by the head of their column, ``name [unit]``, (S,) each.
        estimates: what is known of the errors, by the head of their column, (S,) each, see
            :func:`~hhr_dolfinx.models.estimates.columns`: relative to the exact ones, but for bounds of outputs, which
            are in their units; NaN where nothing is known. None of a model that estimates nothing.
        fell_back: whether the full model answered, (S,) bool; None of a model that cannot fall back.
        model: number of the local model that answered, (S,) int; -1 where none of them did. None of a single model.
    """

    points: np.ndarray
    status: list[str]
    largest_displacement: np.ndarray
    forces: np.ndarray
    outputs: Mapping[str, np.ndarray] = MappingProxyType({})
    estimates: Mapping[str, np.ndarray] = MappingProxyType({})
    fell_back: np.ndarray | None = None
    model: np.ndarray | None = None


class _Row(NamedTuple):
    """Answer to one point: as in :class:`Answers`, with the values of outputs and estimates."""

    status: str
    largest: float
    forces: np.ndarray
    outputs: list[float]
    estimates: list[float]
    fell_back: bool
    model: int


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
    model: Answering,
    points: np.ndarray,
    comm: Comm | None = None,
    progress: Progress = iter,
    outside: str = "refuse",
) -> Answers | None:
    """Answer every point, (S, P), with contact forces on the whole surface; None on all ranks but the first.

    Each rank takes a block of them: queries take about the same time, so that nothing is gained by handing them out
    one by one.

    Args:
        model: the reduced model, or several local ones, the same on all ranks, as the points; or one that falls back
            on a full model of its rank, and grows there by what its rank asks.
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
        heads = _heads_of(model), _estimate_heads(model)
        rows = [_answer(model, points[k], outside, *heads) for k in progress(mine)]
    parts = [rows] if comm is None else comm.gather(rows, root=0)
    if parts is None:
        return None
    every = [row for part in parts for row in part]
    status, largest, forces, *others, fallen, numbers = zip(*every, strict=True) if every else ((),) * len(_Row._fields)
    count = len(points)
    outputs, estimates = (
        dict(zip(names, np.array(values).reshape(count, len(names)).T, strict=True))
        for names, values in zip(heads, others, strict=True)
    )
    fell_back = np.array(fallen, dtype=bool) if isinstance(model, FallbackModel) else None
    local = np.array(numbers, dtype=np.int64) if isinstance(_reduced(model), LocalModels) else None
    table = np.array(forces).reshape(count, _forces_of(model))
    return Answers(points, list(status), np.array(largest), table, outputs, estimates, fell_back, local)


def read_points(path: str | Path, space: ParameterSpace) -> list[TableRow]:
    """Rows of a CSV file (UTF-8, commas) whose header names the parameters; empty lines are left out. Or of Parquet.

    Raises:
        ParameterError: if the file is missing, cannot be read, or its header does not name each parameter once.
    """
    if Path(path).suffix == PARQUET:
        from hhr_dolfinx.online.parquet import read_columns

        return [TableRow(k, row) for k, row in enumerate(read_columns(Path(path), space.names), start=2)]
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
    model: Answering,
    rows: Sequence[TableRow],
    path: str | Path,
    console: Console,
    progress: Progress = iter,
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
        fallen = "" if answers.fell_back is None else f" ({answers.fell_back.sum()} by the full model)"
        done = f"{len(rows) - bad} answers{fallen} and {bad} bad rows on {comm.size} ranks in {seconds:.1f} s: {path}"
        console.print(done, markup=False)
        for row, why in zip(rows, status, strict=True):
            if why != OK:
                given = ", ".join(row.cells)
                console.print(f"line {row.line} ({given}): {why}", highlight=False, markup=False)
    return bad


def write_answers(
    path: str | Path, space: ParameterSpace, answers: Answers, cells: Sequence[Sequence[str]] | None = None
) -> int:
    """Write answers as CSV with a header, or as Parquet; returns the number of rows that have none.

    Args:
        path: the file.
        space: whose names head the columns of the parameters.
        answers: what :func:`answer_points` returned.
        cells: the parameters as they were given, as text; None writes the numbers.

    Raises:
        FileError: if the file cannot be written.
    """
    columns = _columns_of(answers)
    if Path(path).suffix == PARQUET:
        from hhr_dolfinx.online.parquet import write_columns

        named = dict(zip(space.names, answers.points.T, strict=True))
        write_columns(Path(path), {**named, _STATUS: answers.status, **columns})
        return sum(status != OK for status in answers.status)
    given = answers.points.tolist() if cells is None else cells
    with replacing(path, text=True) as file:
        writer = csv.writer(file)
        writer.writerow([*space.names, _STATUS, *columns])
        for k, (row, status) in enumerate(zip(given, answers.status, strict=True)):
            texts = (_text(column[k]) if status == OK else "" for column in columns.values())
            writer.writerow([*row, status, *texts])
    return sum(status != OK for status in answers.status)


def _columns_of(answers: Answers) -> dict[str, np.ndarray]:
    """Numbers of all rows by the heads of their columns, in their order."""
    found = {"largest_displacement": answers.largest_displacement, "total_force": answers.forces.sum(axis=1)}
    found |= {**answers.outputs, **answers.estimates}
    if answers.fell_back is not None:
        found["fell_back"] = answers.fell_back.astype(float)
    if answers.model is not None:
        found["model"] = np.where(answers.model == LEAF, np.nan, answers.model)
    return found | {f"force_{k}": force for k, force in enumerate(answers.forces.T)}


def _text(value: float) -> str:
    """A number with 12 digits, what different orders of summation leave alone; nothing for what is not known."""
    return "" if np.isnan(value) else f"{value:.12g}"


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


def _answer(model: Answering, point: np.ndarray, outside: str, heads: list[str], estimated: list[str]) -> _Row:
    """Answer one point, with columns of outputs and of estimates."""
    try:
        answer = model.solve(point, outside=outside)
        displacement, forces = answer.displacement(), answer.forces()
        outputs = list(answer.outputs().values.values()) if heads else []
        estimates = _estimates(model, answer.estimate() if estimated else None, len(estimated))
    except HHRError as error:  # what a row may do; anything else is a fault of the program and ends the run
        nothing = np.full(_forces_of(model), np.nan), [np.nan] * len(heads), [np.nan] * len(estimated)
        return _Row(str(error), np.nan, *nothing, fell_back=False, model=LEAF)
    reduced = _reduced(model)
    largest = np.linalg.norm(displacement.reshape(-1, reduced.dimension), axis=1).max()
    fell_back = isinstance(model, FallbackModel) and model.fell_back(answer)
    number = reduced.model_of(answer) if isinstance(reduced, LocalModels) and not fell_back else LEAF
    return _Row(OK, largest, forces, outputs, estimates, fell_back, number)


def _reduced(model: Answering) -> ReducedModel | LocalModels:
    """The reduced model or models, of one that falls back too."""
    return model.reduced if isinstance(model, FallbackModel) else model


def _outputs_of(model: Answering) -> dict[str, str]:
    """Heads of the columns of the outputs, by name."""
    functionals = _reduced(model).fields.functionals
    items = () if functionals is None else functionals.items
    return {item.name: f"{item.name} [{item.unit}]" if item.unit else item.name for item in items}


def _heads_of(model: Answering) -> list[str]:
    """Heads of the columns of the outputs."""
    return list(_outputs_of(model).values())


def _estimate_heads(model: Answering) -> list[str]:
    """Heads of the columns of estimates; none where nothing is estimated, or nothing but steps of histories."""
    fields = _reduced(model).fields
    # fields of models that keep all contact conditions, or of a rival, know of no estimates
    bound, of_outputs, indicator = (getattr(fields, name, None) for name in ("bound", "output_bound", "indicator"))
    if bound is not None:
        return columns(bound.kind, _outputs_of(model) if of_outputs else {})
    return [] if indicator is None else columns("indicator", {})


def _estimates(model: Answering, estimate: Estimate | None, count: int) -> list[float]:
    """Values of the columns of estimates; NaN of outputs without a bound."""
    if estimate is None:
        return [np.nan] * count
    # answers of the full model are exact, whatever the reduced one knows
    return list(estimate.shown(_outputs_of(model)).values())[:count]


def _forces_of(model: Answering) -> int:
    """Number of conditions on the whole contact surface."""
    return len(_reduced(model).fields.gaps)
