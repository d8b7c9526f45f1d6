"""Tables of parameters in files, CSV or Parquet, and tables of their answers, which are written
block by block.

The blocks of a long table are files in a folder next to the target, each complete or missing. A run
that was killed continues with the missing blocks. At the end the blocks become one file.
"""

from __future__ import annotations

import csv
import hashlib
import json
import logging
import re
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from zipfile import BadZipFile

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import FileError, ParameterError
from hhr_dolfinx.files import clear_leftovers, make_folder, replacing
from hhr_dolfinx.group import ALONE, group_of, world
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.tables.batch import OK, Answers, Progress, Query
from hhr_dolfinx.timing import timed

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from rich.console import Console

PARQUET = ".parquet"
"""Ending of binary tables."""
FOLDER_MARK = "blocks of answers by hhr_dolfinx"
"""Content of the file ``of.json`` in a folder of blocks.

a folder without it has another owner and is not touched.
"""
EXCEL = (".xlsx", ".xlsm")
"""Endings of workbooks whose first sheet is read by openpyxl."""
WORKBOOKS = (".xls", ".ods")
"""Endings of tables that only spreadsheets read."""
MOST_REASONS = 20
"""Largest count of bad rows whose reasons are printed; the table has all of them."""
DELIMITERS = ",;\t"
"""Marks between the columns of a table of text, the usual one first."""
_STATUS = "status"
_UNIT = re.compile(r"\s*\[[^][]*\]$")
_log = logging.getLogger(__name__)


class TableRow(NamedTuple):
    """A row of a table of parameters: number of its line from 1, cells in the order of the space,
    its fault or "".
    """

    line: int
    cells: list[str]
    fault: str = ""


def read_points(
    path: str | Path, space: ParameterSpace, say: Callable[[str], object] = _log.warning
) -> list[TableRow]:
    """Read rows of a CSV file, without empty lines, of Parquet, or of the sheet of a workbook.

    The header names the parameters, in any order.

    A CSV file is UTF-8 text, with or without a byte order mark, whose columns are separated by
    commas, semicolons or tabs. Columns may be named with a unit, ``push [Pa]``. Between semicolons
    numbers may have decimal commas.

    Args:
        path: the file.
        space: the parameters; other columns are left out.
        say: function that prints what is assumed of units and of decimal commas.

    Raises:
        ParameterError: if the file is missing, cannot be read, or its header does not name each
            parameter once.
    """
    if Path(path).suffix.lower() in WORKBOOKS:
        raise ParameterError(
            f"{path} is a workbook of a spreadsheet: save its table as CSV, in UTF-8 and with "
            "commas"
        )
    if Path(path).suffix.lower() in EXCEL:
        lines = read_sheet(Path(path))
        header = lines[0][1] if lines else []
        columns = _columns(path, header, space.names, say)
        return [_row(line, cells, columns, len(header)) for line, cells in lines[1:]]
    if Path(path).suffix == PARQUET:
        return [
            TableRow(k, row)
            for k, row in enumerate(read_columns(Path(path), space.names, say), start=2)
        ]
    try:
        # with or without the byte order mark that spreadsheets write
        with open(path, newline="", encoding="utf-8-sig") as file:
            delimiter = _delimiter(next((line for line in file if line.strip()), ""), space.names)
            file.seek(0)
            reader = csv.reader(file, delimiter=delimiter, skipinitialspace=True)
            rows = [
                (reader.line_num, [cell.strip() for cell in row])
                for row in reader
                if row not in ([], [""])
            ]
    except FileNotFoundError:
        raise ParameterError(f"there is no table of parameters {path}") from None
    except (OSError, ValueError, csv.Error) as error:
        raise ParameterError(f"{path} cannot be read as a table of UTF-8 text ({error})") from error
    header = rows[0][1] if rows else []
    columns = _columns(path, header, space.names, say)
    table = [_row(line, cells, columns, len(header)) for line, cells in rows[1:]]
    texts = [cell for row in table for cell in row.cells]
    if (
        delimiter == ";"
        and any("," in text for text in texts)
        and not any("." in text for text in texts)
    ):
        say(f"{path}: its numbers have decimal commas")
        return [row._replace(cells=[_with_point(cell) for cell in row.cells]) for row in table]
    return table


def read_sheet(path: Path) -> list[tuple[int, list[str]]]:
    """Lines of the first sheet of a workbook that are not empty, with their numbers from 1.

    Args:
        path: file with the ending ``.xlsx`` or ``.xlsm``; formulas count by their last values.

    Returns:
        Number and cells of each line; numbers have all of their digits.

    Raises:
        ParameterError: if there is no file, or it is no workbook.
        MissingPackageError: without openpyxl.
    """
    with extra("tables", f"reading {path}, a workbook (or save it as CSV in UTF-8),"):
        import openpyxl
    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        sheet = book.worksheets[0]
        rows = list(enumerate(sheet.iter_rows(values_only=True), start=1))
        book.close()
    except FileNotFoundError:
        raise ParameterError(f"there is no table of parameters {path}") from None
    except (OSError, ValueError, KeyError, IndexError, BadZipFile) as error:
        raise ParameterError(f"{path} cannot be read as a workbook ({error})") from error
    filled = []
    for line, row in rows:
        cells = ["" if cell is None else str(cell).strip() for cell in row]
        if any(cells):
            filled.append((line, cells))
    if not filled:
        return []
    heads = filled[0][1]
    width = max(k for k, head in enumerate(heads, start=1) if head)
    return [(line, cells[:width]) for line, cells in filled]


def _delimiter(header: str, names: Sequence[str]) -> str:
    """Mark between the columns: the one by which the header names the most parameters."""

    def matches(mark: str) -> int:
        cells = [
            cell.strip()
            for cell in next(csv.reader([header], delimiter=mark, skipinitialspace=True), [])
        ]
        return sum(bool(_places(cells, name)) for name in names)

    return max(DELIMITERS, key=matches)


def _places(header: Sequence[str], name: str) -> list[int]:
    """Indices of the columns of a parameter, which may be named with a unit."""
    return [k for k, head in enumerate(header) if head == name or _UNIT.sub("", head) == name]


def _columns(
    path: str | Path, header: Sequence[str], names: Sequence[str], say: Callable[[str], object]
) -> list[int]:
    """Index of the column of each parameter; ParameterError if the header does not name each
    once.
    """
    columns_of = {name: _places(header, name) for name in names}
    if wrong := sorted(name for name, columns in columns_of.items() if len(columns) != 1):
        raise ParameterError(
            f"{path} has no column {wrong} or has it twice: its header must name each of "
            f"{tuple(names)} once, and is {list(header)}"
        )
    columns = [columns_of[name][0] for name in names]
    if units := [header[k] for k, name in zip(columns, names, strict=True) if header[k] != name]:
        say(f"{path}: units are not converted, numbers are those of the scene: {', '.join(units)}")
    return columns


def _with_point(text: str) -> str:
    """A number with a decimal point in place of one comma."""
    return text.replace(",", ".") if text.count(",") == 1 else text


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
    """Answer a table on all ranks into a file, CSV or Parquet.

    Bad rows are printed with their reasons.

    Args:
        model: see :func:`~hhr_dolfinx.plugins.tables.batch.answer_points`.
        rows: rows of the table, the same on all ranks.
        path: file of the answers.
        console: console of the first rank.
        progress: wrapper of the iteration over blocks, for a progress bar.
        displacement, estimates, forces: include columns of the largest displacement of any node, of
            estimates of errors, and of the force of each contact condition.
        resume: text that identifies the model, such as a checksum of its file: blocks of an earlier
            run with the same text are kept. None starts from the beginning.

    Returns:
        Number of rows without an answer, on all ranks.

    Raises:
        FileError: if the answers cannot be written.
        HHRError: on all ranks, if anything but a row failed on another rank.
    """
    comm = world()
    group = ALONE if comm is None else group_of(comm)
    rank = group.number
    blocks = _Blocks(
        Query(model, "refuse", displacement, estimates), rows, Path(path), resume, forces
    )
    group.agreed("answering the table", lambda: [f"{len(rows)} rows", repr(model), blocks.digest()])
    with group.each("preparing the answers"):
        if rank == 0:
            blocks.prepare()
    with group.each("answering the table"):
        _, seconds = timed(lambda: blocks.answer(range(rank, len(blocks), group.size), progress))
    bad = list[tuple[int, str]]()
    sums: dict[str, float] = {}
    with group.each("writing the answers"):
        if rank == 0:
            bad, sums = blocks.join()
    count = group.from_first(len(bad))
    if rank == 0:
        good = f"{len(rows) - len(bad)} answers{model.summed_up(sums)}"
        console.print(
            f"{good} and {len(bad)} bad rows on {group.size} ranks in {seconds:.1f} s: {path}",
            markup=False,
        )
        for number, reason in bad[:MOST_REASONS]:
            row = rows[number]
            console.print(
                f"line {row.line} ({', '.join(row.cells)}): {reason}", highlight=False, markup=False
            )
        if len(bad) > MOST_REASONS:
            console.print(
                f"and {len(bad) - MOST_REASONS} more, with their reasons in the column '{_STATUS}'",
                markup=False,
            )
    return count


@dataclass(frozen=True)
class _Blocks:
    """Blocks of a table, each answered into a file, and joined to one file at the end.

    See :func:`answer_table`.
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
        return self.query.model.rows_at_once

    @property
    def folder(self) -> Path:
        return self.path.with_name(f"{self.path.name}.parts")

    @property
    def _mark(self) -> Path:
        """File that identifies the table and model of the blocks."""
        return self.folder / "of.json"

    def digest(self) -> str:
        """Digest of everything on which the answers depend."""
        columns = self.query.displacement, self.query.estimates, self.forces
        digest = hashlib.sha256(
            repr((self.resume, *columns, self.query.outside, self.size)).encode()
        )
        for row in self.rows:
            digest.update(repr(row).encode())
        return digest.hexdigest()

    def prepare(self) -> None:
        """Make the folder, empty of blocks of another table or model.

        FileError if it has other files.
        """
        mark = {FOLDER_MARK: self.digest()}
        content = None
        with suppress(OSError, ValueError, RecursionError):
            content = json.loads(self._mark.read_text(encoding="utf-8"))
        if self.resume is not None and content == mark:
            return
        if isinstance(content, dict) and content.keys() == {FOLDER_MARK}:
            self._clear()
        elif self.folder.is_dir():
            self._refuse_others()
        make_folder(self.folder)
        with replacing(self._mark, text=True) as file:
            json.dump(mark, file)

    def _refuse_others(self) -> None:
        """FileError for a folder with other files; an empty one is accepted."""
        clear_leftovers(self.folder)
        if foreign := sorted(path.name for path in self.folder.iterdir()):
            raise FileError(
                f"{self.folder} is where blocks of answers are kept on their way to {self.path}, "
                "and it holds files that are not: "
                f"{', '.join(foreign[:3])}{', ...' if foreign[3:] else ''}. Move the folder, or "
                "give the answers another name"
            )

    def _clear(self) -> None:
        """Remove the blocks, then the mark, as a run may be killed, and the folder if nothing else
        is in it.
        """
        clear_leftovers(self.folder)
        names = re.compile(rf"[0-9]{{6,}}(\.json|{re.escape(self.path.suffix)})")
        for path in self.folder.iterdir():
            if names.fullmatch(path.name):
                path.unlink(missing_ok=True)
        self._mark.unlink(missing_ok=True)
        with suppress(OSError):
            self.folder.rmdir()

    def _answers(self, number: int) -> Path:
        return self.folder / f"{number:06d}{self.path.suffix}"

    def _report(self, number: int) -> Path:
        """File of the bad rows, the sums of further columns, and the checksum of the answers of a
        block.
        """
        return self.folder / f"{number:06d}.json"

    def _is_whole(self, number: int) -> bool:
        """True if a block is complete and undamaged; other blocks are answered again."""
        try:
            return json.loads(self._report(number).read_text())[2] == checksum(
                self._answers(number)
            )
        except (OSError, ValueError, LookupError, TypeError):
            return False

    def answer(self, numbers: Iterable[int], progress: Progress) -> None:
        """Answer the missing ones of some blocks.

        Args:
            numbers: numbers of the blocks.
            progress: wrapper of the iteration over blocks.
        """
        space = self.query.model.parameters
        for number in progress([number for number in numbers if not self._is_whole(number)]):
            rows = self.rows[number * self.size : (number + 1) * self.size]
            parsed = [_numbers(row, space) for row in rows]
            points = np.array([point for point, _ in parsed]).reshape(len(rows), len(space.names))
            answers = self.query(points)
            # the fault of a cell that is no number replaces the status of the model
            status = [
                fault or text for (_, fault), text in zip(parsed, answers.status, strict=True)
            ]
            answers = answers._replace(status=status)
            write_answers(
                self._answers(number),
                space,
                answers,
                [row.cells for row in rows],
                forces=self.forces,
            )
            bad = [
                (number * self.size + k, reason) for k, reason in enumerate(status) if reason != OK
            ]
            sums = {head: float(np.nansum(values)) for head, values in answers.columns.items()}
            with replacing(self._report(number), text=True) as file:
                json.dump([bad, sums, checksum(self._answers(number))], file)

    def join(self) -> tuple[list[tuple[int, str]], dict[str, float]]:
        """Make one file of all blocks.

        Returns:
            The bad rows with their reasons, and sums of further columns by head.
        """
        files = [self._answers(number) for number in range(len(self))]
        if self.path.suffix == PARQUET:
            join_tables(self.path, files)
        else:
            with replacing(self.path, text=True) as target:
                for number, file in enumerate(files):
                    with open(file, newline="", encoding="utf-8") as source:
                        head = source.readline()
                        target.write(head if number == 0 else "")
                        shutil.copyfileobj(source, target)
        reports = [json.loads(self._report(number).read_text()) for number in range(len(self))]
        self._clear()
        sums = {head: sum(sums_of[head] for _, sums_of, _ in reports) for head in reports[0][1]}
        return [(row, reason) for bad, *_ in reports for row, reason in bad], sums


def write_answers(
    path: str | Path,
    space: ParameterSpace,
    answers: Answers,
    cells: Sequence[Sequence[str]] | None = None,
    *,
    forces: bool = True,
) -> int:
    """Write answers as CSV with a header, or as Parquet.

    Return the number of rows without an answer.

    Args:
        path, space: the file, and the parameters, whose names head their columns.
        answers: answers of :func:`~hhr_dolfinx.plugins.tables.batch.answer_points`.
        cells: given text of the parameters; None writes the numbers.
        forces: include a column of the force of each contact condition.

    Raises:
        FileError: if the file cannot be written.
    """
    columns = columns_of(answers, forces)
    if Path(path).suffix == PARQUET:
        named = dict(zip(space.names, answers.points.T, strict=True))
        write_columns(Path(path), {**named, _STATUS: answers.status, **columns})
    else:
        _write_csv(path, [*space.names, _STATUS, *columns], answers, cells, columns)
    return sum(status != OK for status in answers.status)


def _write_csv(
    path: str | Path,
    head: list[str],
    answers: Answers,
    cells: Sequence[Sequence[str]] | None,
    columns: dict[str, np.ndarray],
) -> None:
    rows = answers.points.tolist() if cells is None else cells
    numbers = np.column_stack(list(columns.values()))
    line = ",".join(["%.12g"] * len(columns))
    with replacing(path, text=True) as file:
        writer = csv.writer(file)
        writer.writerow(head)
        for row, status, values in zip(rows, answers.status, numbers, strict=True):
            writer.writerow(
                [*row, status, *(_texts(line, values) if status == OK else [""] * len(values))]
            )


def columns_of(answers: Answers, forces: bool = True) -> dict[str, np.ndarray]:
    """Values of all rows by the heads of their columns, in the order of the columns.

    Args:
        answers: answers of :func:`~hhr_dolfinx.plugins.tables.batch.answer_points`.
        forces: include a column of the force of each contact condition.
    """
    columns = (
        {}
        if answers.largest_displacement is None
        else {"largest_displacement": answers.largest_displacement}
    )
    columns["total_force"] = (
        answers.forces.sum(axis=1) if answers.total_force is None else answers.total_force
    )
    columns |= {**answers.outputs, **answers.estimates}
    columns |= answers.columns
    return columns | {f"force_{k}": force for k, force in enumerate(answers.forces.T) if forces}


def _texts(line: str, values: np.ndarray) -> list[str]:
    """Numbers with 12 digits, which do not depend on the order of summation; empty for NaN."""
    texts = (line % tuple(values.tolist())).split(",")
    return texts if np.isfinite(values).all() else ["" if text == "nan" else text for text in texts]


def _row(line: int, cells: list[str], columns: list[int], width: int) -> TableRow:
    """A row in the order of the parameters.

    Extra cells are a fault, since they may come from decimal commas.
    """
    count = (
        f"{len(cells)} cells where the header has {width}: numbers have a decimal point, as "
        "commas separate columns"
    )
    fault = count if any(cells[width:]) else ""
    padded = cells + [""] * width
    return TableRow(line, [padded[column] for column in columns], fault)


def _numbers(row: TableRow, space: ParameterSpace) -> tuple[list[float], str]:
    """Point of a row, and the fault of its text; a row with a fault has NaN."""
    nothing: list[float] = [np.nan] * len(space.names)
    if row.fault:
        return nothing, row.fault
    point: list[float] = []
    for name, text in zip(space.names, row.cells, strict=True):
        try:
            point.append(float(text))
        except ValueError:
            advice = ": write a decimal point, not a comma" if "," in text else ""
            return (
                nothing,
                f"{name} is empty" if not text else f"{name} = '{text}' is no number{advice}",
            )
    return point, ""


def checksum(path: str | Path) -> str:
    """Checksum of a file, SHA-256."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_columns(
    path: Path, names: tuple[str, ...], say: Callable[[str], object] = _log.warning
) -> list[list[str]]:
    """Rows of some columns of a Parquet file as text with all digits; missing values are empty.

    Args:
        path: the file.
        names: names of the columns.
        say: function that prints what is assumed of units.

    Raises:
        ParameterError: if the file cannot be read, or lacks one of the columns.
    """
    with extra("tables", f"the table {path}"):
        from pyarrow import ArrowException, parquet
    try:
        table = parquet.read_table(path)
    except FileNotFoundError:
        raise ParameterError(f"there is no table of parameters {path}") from None
    except (OSError, ArrowException) as error:
        raise ParameterError(f"{path} cannot be read as Parquet ({error})") from error
    indices = _columns(path, table.column_names, names, say)
    columns = [table.column(index).to_pylist() for index in indices]
    return [
        ["" if value is None else str(value) for value in row] for row in zip(*columns, strict=True)
    ]


def write_columns(path: Path, columns: Mapping[str, ArrayLike]) -> None:
    """Write columns by name to a Parquet file; NaN becomes an empty value.

    Args:
        path: the file.
        columns: values by the head of their column.
    """
    with extra("tables", f"the table {path}"):
        import pyarrow
        from pyarrow import parquet
    arrays = {}
    for name, values in columns.items():
        array = np.asarray(values)
        arrays[name] = (
            pyarrow.array(array, from_pandas=True)
            if array.dtype.kind in "fiub"
            else pyarrow.array(values)
        )
    with replacing(path) as file:
        parquet.write_table(pyarrow.table(arrays), file)


def join_tables(path: Path, parts: Sequence[Path]) -> None:
    """Join Parquet files with the same columns in their order.

    One of them is in memory at a time.

    Args:
        path: the joined file.
        parts: the files, in their order.
    """
    with extra("tables", f"the table {path}"):
        from pyarrow import parquet
    with replacing(path) as file:
        writer = None
        for block in parts:
            table = parquet.read_table(block)
            # a column without any number in a block has no type
            writer = writer or parquet.ParquetWriter(file, table.schema)
            writer.write_table(table.cast(writer.schema))
        if writer is not None:
            writer.close()
