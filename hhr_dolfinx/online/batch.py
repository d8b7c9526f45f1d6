"""Batches: parameters from a table, spread over the ranks; every row gets an answer or a reason."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from mpi4py import MPI
from rich.console import Console

from hhr_dolfinx import ranks
from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.online.reconstruct import OnlineModel
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.timing import timed


def read_points(path: str | Path, space: ParameterSpace) -> list[list[str]]:
    """Rows of a CSV file whose header names the parameters, in the order of the space, as text.

    Raises:
        ParameterError: if the file is missing or its header lacks a parameter.
    """
    try:
        with open(path, newline="") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            missing = set(space.names) - set(reader.fieldnames or ())
            if missing:
                raise ParameterError(f"{path} has no column {sorted(missing)}: its header must name {space.names}")
            return [[row[name] or "" for name in space.names] for row in reader]
    except FileNotFoundError:
        raise ParameterError(f"there is no table of parameters {path}") from None


def answer_table(
    reduction: OnlineModel,
    rows: list[list[str]],
    path: Path,
    console: Console,
    progress: Callable[[Iterable], Iterable] = iter,
) -> None:
    """Answer a table on all ranks, write it as CSV on the first one, and print the bad rows with their reasons."""
    comm, space = MPI.COMM_WORLD, reduction.model.parameters
    answers, seconds = timed(lambda: answer_rows(reduction, rows, comm, progress))
    if answers is None:
        return
    bad, width = write_answers(path, space, answers), len(space.names)
    console.print(f"{len(rows) - bad} answers and {bad} bad rows on {comm.size} ranks in {seconds:.1f} s: {path}")
    for number, row in enumerate(answers, start=1):
        if row[width] != "ok":
            console.print(f"row {number} ({', '.join(row[:width])}): {row[width]}", highlight=False)


def answer_rows(
    reduction: OnlineModel,
    rows: list[list[str]],
    comm: MPI.Comm,
    progress: Callable[[Iterable], Iterable] = iter,
) -> list[list[str]] | None:
    """Answer every row with contact forces on the whole surface; a bad row does not stop the others.

    Args:
        reduction: the reduced model, the same on all ranks.
        rows: parameters as text, the same on all ranks.
        comm: communicator over which the rows are spread.
        progress: wraps the iteration, for a progress bar.

    Returns:
        On rank 0 one row per input: its parameters, status, largest displacement, total force and all
        forces; None elsewhere.
    """
    mine = np.array_split(np.arange(len(rows)), comm.size)[comm.rank]
    with ranks.each_for_itself(comm, "answering the table"):
        answers = [_answer(reduction, rows[k]) for k in progress(mine)]
    parts = comm.gather(answers, root=0)
    return None if parts is None else [row for part in parts for row in part]


def write_answers(path: str | Path, space: ParameterSpace, answers: list[list[str]]) -> int:
    """Write the answers as CSV with a header; returns the number of bad rows."""
    width = max((len(row) for row in answers), default=0) - len(space.names) - 3
    names = [*space.names, "status", "largest_displacement", "total_force"]
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".part")
    with open(temporary, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*names, *(f"force_{k}" for k in range(width))])
        writer.writerows(answers)
    os.replace(temporary, path)
    return sum(row[len(space.names)] != "ok" for row in answers)


def _answer(reduction, row) -> list[str]:
    try:
        displacement, forces = reduction.solve_everywhere([float(value) for value in row])
    except Exception as error:  # one row must stop neither the others nor the other ranks
        return [*row, str(error)]
    largest = np.linalg.norm(displacement.reshape(-1, reduction.dimension), axis=1).max()
    # 12 digits: what different orders of summation leave alone
    return [*row, "ok", *(f"{value:.12g}" for value in (largest, forces.sum(), *forces))]
