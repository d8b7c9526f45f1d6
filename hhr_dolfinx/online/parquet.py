"""Tables of parameters and answers as Parquet, by pyarrow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.files import replacing


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
