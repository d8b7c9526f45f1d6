"""Tables of parameters in files, CSV or Parquet, and of their answers, which are written as they are found.

A long table is answered block by block into a folder beside the target, each block a file that is whole or not there;
whoever is killed goes on with the blocks that are missing. At the end the blocks become one file.
"""

from __future__ import annotations

import csv
import hashlib
import json
import re
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hhr_dolfinx import ranks
from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import FileError, ParameterError
from hhr_dolfinx.files import clear_leftovers, make_folder, replacing
from hhr_dolfinx.models.fallback import FallbackModel
from hhr_dolfinx.models.local import LEAF
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.online.batch import OK, Answers, Query
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.timing import timed

if TYPE_CHECKING:
    from rich.console import Console


Progress = Callable[[Iterable], Iterable]
"""Wraps an iteration, for a progress bar."""

PARQUET = ".parquet"
"""Ending of tables that are no text."""
MARK = "blocks of answers by hhr_dolfinx"
"""What the file ``of.json`` in a folder of blocks holds: a folder without it is somebody else's, and is left alone."""
WORKBOOKS = (".xlsx", ".xls", ".xlsm", ".ods")
"""Endings of tables that spreadsheets alone read."""
SHOWN = 20
"""Bad rows whose reasons are printed; all of them stand in the table."""
_STATUS = "status"


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
    """Rows of a CSV file (UTF-8, commas) whose header names the parameters; empty lines are left out. Or of Parquet.

    Raises:
        ParameterError: if the file is missing, cannot be read, or its header does not name each parameter once.
    """
    if Path(path).suffix.lower() in WORKBOOKS:
        raise ParameterError(f"{path} is a workbook of a spreadsheet: save its table as CSV, in UTF-8 and with commas")
    if Path(path).suffix == PARQUET:
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
        if any(mark in cell for cell in header for mark in ";\t"):
            raise ParameterError(
                f"{path} is separated by semicolons or tabs, as spreadsheets of some languages save it: separate its "
                "columns by commas, and write numbers with a decimal point"
            )
        raise ParameterError(
            f"{path} has no column {wrong} or has it twice: its header must name {space.names}, separated by commas"
        )
    columns = [header.index(name) for name in space.names]
    return [_row(line, cells, columns, len(header)) for line, cells in rows[1:]]


def answer_table(
    model: AnsweringModel,
    rows: Sequence[TableRow],
    path: str | Path,
    console: Console,
    progress: Progress = iter,
    *,
    displacement: bool = False,
    estimates: bool = True,
    forces: bool = True,
    resume: str | None = None,
) -> int:
    """Answer a table on all ranks into a file, CSV or Parquet, and print the bad rows with their reasons.

    Args:
        model: see :func:`~hhr_dolfinx.online.batch.answer_points`.
        rows: of the table, the same on all ranks.
        path: the file of the answers.
        console: of the first rank.
        progress: wraps the iteration over blocks, for a progress bar.
        displacement: whether there is a column of the largest displacement of any node.
        estimates: whether there are columns of what is known of errors.
        forces: whether there is a column of the force of each contact condition.
        resume: a text that is another one for another model, such as a checksum of its file: blocks that an earlier
            run left are kept if it is the same. None begins anew.

    Returns:
        On all ranks the number of rows without an answer.

    Raises:
        FileError: if the answers cannot be written.
        HHRError: on all ranks, if anything but a row went wrong on another one.
    """
    comm = ranks.world()
    rank, size = (0, 1) if comm is None else (comm.rank, comm.size)
    blocks = _Blocks(Query(model, "refuse", displacement, estimates), rows, Path(path), resume, forces)
    with nullcontext() if comm is None else ranks.each_for_itself(comm, "preparing the answers"):
        if rank == 0:
            blocks.prepare()
    with nullcontext() if comm is None else ranks.each_for_itself(comm, "answering the table"):
        _, seconds = timed(lambda: blocks.answer(range(rank, len(blocks), size), progress))
    bad = list[tuple[int, str]]()
    fallen = 0
    with nullcontext() if comm is None else ranks.each_for_itself(comm, "writing the answers"):
        if rank == 0:
            bad, fallen = blocks.join()
    count = len(bad) if comm is None else comm.bcast(len(bad))
    if rank == 0:
        by_full = f" ({fallen} by the full model)" if isinstance(model, FallbackModel) else ""
        good = f"{len(rows) - len(bad)} answers{by_full}"
        console.print(f"{good} and {len(bad)} bad rows on {size} ranks in {seconds:.1f} s: {path}", markup=False)
        _tell_bad(console, rows, bad)
    return count


@dataclass(frozen=True)
class _Blocks:
    """The blocks of a table on their way from rows to one file.

    Attributes:
        query: what answers.
        rows: of the table.
        path: the file of the answers.
        resume, forces: see :func:`answer_table`.
    """

    query: Query
    rows: Sequence[TableRow]
    path: Path
    resume: str | None
    forces: bool = True

    def __len__(self) -> int:
        return max(1, -(-len(self.rows) // self.size))

    @property
    def size(self) -> int:
        """Rows of a block."""
        return self.query.model.rows_at_once

    @property
    def folder(self) -> Path:
        """Of the blocks, beside the target."""
        return self.path.with_name(f"{self.path.name}.parts")

    @property
    def _mark(self) -> Path:
        """The file that says whose blocks these are."""
        return self.folder / "of.json"

    def _digest(self) -> str:
        """Changes where the answers would."""
        columns = self.query.displacement, self.query.estimates, self.forces
        told = hashlib.sha256(repr((self.resume, *columns, self.query.outside, self.size)).encode())
        for row in self.rows:
            told.update(repr(row).encode())
        return told.hexdigest()

    def prepare(self) -> None:
        """Make the folder, and empty it if its blocks are those of another table or model.

        Raises:
            FileError: if the folder is not one of blocks, or cannot be made.
        """
        mark = {MARK: self._digest()}
        found = self._marked()
        if self.resume is None or found != mark:
            if found is None:
                self._refuse_others()
            else:
                self._clear()
            make_folder(self.folder)
            with replacing(self._mark, text=True) as file:
                json.dump(mark, file)

    def _marked(self) -> dict[str, Any] | None:
        """The mark of the folder; None of a folder that is not one of blocks, or is not there."""
        try:
            found = json.loads(self._mark.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return None
        return found if isinstance(found, dict) and found.keys() == {MARK} else None

    def _refuse_others(self) -> None:
        """Refuse a folder with files that are not ours; an empty one is as good as none.

        Raises:
            FileError: for such a folder.
        """
        if not self.folder.is_dir():
            return
        clear_leftovers(self.folder)
        if others := sorted(path.name for path in self.folder.iterdir()):
            raise FileError(
                f"{self.folder} is where blocks of answers are kept on their way to {self.path}, and it holds files "
                f"that are not: {', '.join(others[:3])}{', ...' if others[3:] else ''}. Move the folder, or give the "
                "answers another name"
            )

    def _clear(self) -> None:
        """Remove the blocks, and the folder if there is nothing else in it; the mark last, as a run may be killed."""
        clear_leftovers(self.folder)
        own = re.compile(rf"[0-9]{{6,}}(\.json|{re.escape(self.path.suffix)})")
        for path in self.folder.iterdir():
            if own.fullmatch(path.name):
                path.unlink(missing_ok=True)
        self._mark.unlink(missing_ok=True)
        with suppress(OSError):
            self.folder.rmdir()

    def _file(self, number: int, ending: str) -> Path:
        return self.folder / f"{number:06d}{ending}"

    def _is_whole(self, number: int) -> bool:
        """Whether a block is there as it was written; one that was damaged since is answered again."""
        try:
            return json.loads(self._file(number, ".json").read_text())[2] == checksum(
                self._file(number, self.path.suffix)
            )
        except (OSError, ValueError, LookupError, TypeError):
            return False

    def answer(self, numbers: Iterable[int], progress: Progress) -> None:
        """Answer the blocks of some numbers that are not there yet."""
        space = self.query.model.parameters
        for number in progress([number for number in numbers if not self._is_whole(number)]):
            rows = self.rows[number * self.size : (number + 1) * self.size]
            parsed = [_numbers(row, space) for row in rows]
            points = np.array([point for point, _ in parsed]).reshape(len(rows), len(space.names))
            answers = self.query(points)
            # a cell that is no number has a reason of its own
            status = [fault or found for (_, fault), found in zip(parsed, answers.status, strict=True)]
            answers = answers._replace(status=status)
            given = [row.cells for row in rows]
            write_answers(self._file(number, self.path.suffix), space, answers, given, forces=self.forces)
            bad = [(number * self.size + k, why) for k, why in enumerate(status) if why != OK]
            fallen = 0 if answers.fell_back is None else int(answers.fell_back.sum())
            with replacing(self._file(number, ".json"), text=True) as file:
                json.dump([bad, fallen, checksum(self._file(number, self.path.suffix))], file)

    def join(self) -> tuple[list[tuple[int, str]], int]:
        """Make one file of all blocks and remove the blocks.

        Returns:
            Numbers of the bad rows with their reasons, and how many the full model answered.
        """
        parts = [self._file(number, self.path.suffix) for number in range(len(self))]
        if self.path.suffix == PARQUET:
            join_tables(self.path, parts)
        else:
            with replacing(self.path, text=True) as target:
                for number, part in enumerate(parts):
                    with open(part, newline="", encoding="utf-8") as source:
                        head = source.readline()
                        target.write(head if number == 0 else "")
                        shutil.copyfileobj(source, target)
        told = [json.loads(self._file(number, ".json").read_text()) for number in range(len(self))]
        self._clear()
        return [(row, why) for bad, *_ in told for row, why in bad], sum(fallen for _, fallen, _ in told)


def _tell_bad(console: Console, rows: Sequence[TableRow], bad: list[tuple[int, str]]) -> None:
    """Why the first bad rows have no answer."""
    for number, why in bad[:SHOWN]:
        row = rows[number]
        console.print(f"line {row.line} ({', '.join(row.cells)}): {why}", highlight=False, markup=False)
    if len(bad) > SHOWN:
        console.print(f"and {len(bad) - SHOWN} more, with their reasons in the column '{_STATUS}'", markup=False)


def write_answers(
    path: str | Path,
    space: ParameterSpace,
    answers: Answers,
    cells: Sequence[Sequence[str]] | None = None,
    *,
    forces: bool = True,
) -> int:
    """Write answers as CSV with a header, or as Parquet; returns the number of rows that have none.

    Args:
        path: the file.
        space: whose names head the columns of the parameters.
        answers: those of :func:`~hhr_dolfinx.online.batch.answer_points`.
        cells: the parameters as they were given, as text; None writes the numbers.
        forces: whether there is a column of the force of each contact condition.

    Raises:
        FileError: if the file cannot be written.
    """
    columns = columns_of(answers, forces)
    if Path(path).suffix == PARQUET:
        named = dict(zip(space.names, answers.points.T, strict=True))
        write_columns(Path(path), {**named, _STATUS: answers.status, **columns})
        return sum(status != OK for status in answers.status)
    given = answers.points.tolist() if cells is None else cells
    numbers = np.column_stack(list(columns.values())) if columns else np.zeros((len(given), 0))
    line = ",".join(["%.12g"] * numbers.shape[1])
    with replacing(path, text=True) as file:
        writer = csv.writer(file)
        writer.writerow([*space.names, _STATUS, *columns])
        for row, status, values in zip(given, answers.status, numbers, strict=True):
            writer.writerow([*row, status, *(_texts(line, values) if status == OK else [""] * len(values))])
    return sum(status != OK for status in answers.status)


def columns_of(answers: Answers, forces: bool = True) -> dict[str, np.ndarray]:
    """Numbers of all rows by the heads of their columns, in their order."""
    columns = {} if answers.largest_displacement is None else {"largest_displacement": answers.largest_displacement}
    columns["total_force"] = answers.forces.sum(axis=1) if answers.total_force is None else answers.total_force
    columns |= {**answers.outputs, **answers.estimates}
    if answers.fell_back is not None:
        columns["fell_back"] = answers.fell_back.astype(float)
    if answers.model is not None:
        columns["model"] = np.where(answers.model == LEAF, np.nan, answers.model)
    return columns | {f"force_{k}": force for k, force in enumerate(answers.forces.T) if forces}


def _texts(line: str, values: np.ndarray) -> list[str]:
    """Numbers with 12 digits, which different orders of summation leave alone; nothing for what is not known."""
    texts = (line % tuple(values.tolist())).split(",") if len(values) else []
    return texts if np.isfinite(values).all() else ["" if text == "nan" else text for text in texts]


def _row(line: int, cells: list[str], columns: list[int], width: int) -> TableRow:
    """A row in the order of the parameters; cells behind the last may be decimal commas, which must not pass."""
    count = f"{len(cells)} cells where the header has {width}: numbers have a decimal point, as commas separate columns"
    fault = count if any(cells[width:]) else ""
    padded = cells + [""] * width
    return TableRow(line, [padded[column] for column in columns], fault)


def _numbers(row: TableRow, space: ParameterSpace) -> tuple[list[float], str]:
    """The point of a row, and what is wrong with its text; no point, NaN, where anything is."""
    nothing: list[float] = [np.nan] * len(space.names)
    if row.fault:
        return nothing, row.fault
    point: list[float] = []
    for name, text in zip(space.names, row.cells, strict=True):
        try:
            point.append(float(text))
        except ValueError:
            why = ": write a decimal point, not a comma" if "," in text else ""
            return nothing, f"{name} is empty" if not text else f"{name} = '{text}' is no number{why}"
    return point, ""


def checksum(path: str | Path) -> str:
    """Of a file, by which another one is told."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_columns(path: Path, names: tuple[str, ...]) -> list[list[str]]:
    """Rows of the columns of some names, as text that says each number to the last digit; missing ones are empty.

    Raises:
        ParameterError: if the file cannot be read, or has not these columns.
    """
    with extra("tables", f"the table {path}"):
        from pyarrow import ArrowException, parquet
    try:
        table = parquet.read_table(path)
    except FileNotFoundError:
        raise ParameterError(f"there is no table of parameters {path}") from None
    except (OSError, ArrowException) as error:
        raise ParameterError(f"{path} cannot be read as Parquet ({error})") from error
    wrong = sorted(name for name in names if table.column_names.count(name) != 1)
    if wrong:
        raise ParameterError(
            f"{path} has no column {wrong} or has it twice: its columns must name {names}, and are {table.column_names}"
        )
    columns = [table.column(name).to_pylist() for name in names]
    return [["" if value is None else str(value) for value in row] for row in zip(*columns, strict=True)]


def write_columns(path: Path, columns: Mapping[str, Any]) -> None:
    """Write columns by name; what is not a number is left empty.

    Raises:
        FileError: if the file cannot be written.
    """
    with extra("tables", f"the table {path}"):
        import pyarrow
        from pyarrow import parquet
    arrays = {}
    for name, values in columns.items():
        given = np.asarray(values)
        arrays[name] = pyarrow.array(given, from_pandas=True) if given.dtype.kind in "fiub" else pyarrow.array(values)
    with replacing(path) as file:
        parquet.write_table(pyarrow.table(arrays), file)


def join_tables(path: Path, parts: Sequence[Path]) -> None:
    """One file of several with the same columns, in their order; each is in memory by itself.

    Raises:
        FileError: if the file cannot be written.
    """
    with extra("tables", f"the table {path}"):
        from pyarrow import parquet
    with replacing(path) as file:
        writer = None
        for part in parts:
            table = parquet.read_table(part)
            # a column of a block without a single number has no type of its own
            writer = writer or parquet.ParquetWriter(file, table.schema)
            writer.write_table(table.cast(writer.schema))
        if writer is not None:
            writer.close()
