"""Stiffness in formats of no code: MatrixMarket and Harwell-Boeing with a table of dofs, and NPZ.

Ansys writes MatrixMarket (``*EXPORT, MatK, MMF``) and Harwell-Boeing with a mapping file
(``HBMAT``); a command file of code_aster writes NPZ by a few lines of Python, see docs/foreign.md.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from inspect import signature
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy.io import mmread
from scipy.sparse import coo_matrix, csc_matrix, csr_matrix

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.plugins.foreign.dof_table import read_dofs
from hhr_dolfinx.plugins.foreign.matrix import ForeignMatrix, symmetric_of_half

SPARSE_MATRIX = {"spmatrix": True} if "spmatrix" in signature(mmread).parameters else {}
"""Option of releases of SciPy that also make sparse arrays."""
HARWELL_BOEING = ("RSA", "RUA", "ISA", "IUA")
"""Types of Harwell-Boeing files: real or integers, one half (S) or the whole (U)."""
_WIDTH = re.compile(r"\((?:\d+P,?)?\d*[IEDFG](\d+)", re.IGNORECASE)
"""Width of the numbers of a format of Fortran."""
_Read = TypeVar("_Read")


def read_matrix_market(path: Path, dofs: Path | None = None) -> ForeignMatrix:
    """Stiffness of a MatrixMarket file, ``coordinate`` or ``array``; symmetric ones store one half.

    Args:
        path: file.
        dofs: table of dofs; None for a file of the same name with the ending ``.dof`` or
            ``.mapping``.
    """
    nodes, directions = read_dofs(dofs or table_beside(path))
    text = path.read_bytes()
    header = _checked_header(path, text)
    if b"symmetric" not in header or b"coordinate" not in header:
        matrix = csr_matrix(_read(lambda _: mmread(io.BytesIO(text), **SPARSE_MATRIX), path))
        return ForeignMatrix(matrix, nodes, directions, path.name)
    # one half, or both by mistake, which SciPy would add up: read as it is stored
    stored = b"%%MatrixMarket matrix coordinate real general\n" + text.partition(b"\n")[2]
    entries = coo_matrix(_read(lambda _: mmread(io.BytesIO(stored), **SPARSE_MATRIX), path))
    if entries.shape != (len(nodes), len(nodes)):
        return ForeignMatrix(csr_matrix(entries), nodes, directions, path.name)
    rows = entries.row.astype(np.int64)
    columns = entries.col.astype(np.int64)
    matrix = symmetric_of_half(rows, columns, entries.data, len(nodes), path.name)
    return ForeignMatrix(matrix, nodes, directions, path.name)


def _checked_header(path: Path, text: bytes) -> list[bytes]:
    """Words of the header of a MatrixMarket file.

    Raises:
        FileContentError: for what SciPy would read as something else: patterns, complex numbers,
            exponents of Fortran, and decimal commas.
    """
    header = text.partition(b"\n")[0]
    words = header.lower().split()
    for kind in (b"pattern", b"complex", b"hermitian", b"skew-symmetric"):
        if kind in words:
            raise FileContentError(
                f"{path.name} is {kind.decode()}, and a stiffness is real and symmetric"
            )
    for pattern, what in ((rb"\d\.?[dD][+-]?\d", "exponents with D"), (rb"\d,", "commas")):
        if found := re.search(pattern, text):
            line = 1 + text.count(b"\n", 0, found.start())
            raise FileContentError(
                f"{path.name}:{line} has numbers with {what}, which MatrixMarket does not have: "
                "write 1.2e+02"
            )
    return words


def read_harwell_boeing(path: Path, dofs: Path | None = None) -> ForeignMatrix:
    """Stiffness of a Harwell-Boeing file, RSA (one half) or RUA (whole).

    Args:
        path: file.
        dofs: table of dofs, such as the mapping file of ``HBMAT``; None for a file of the same name
            beside it.
    """
    nodes, directions = read_dofs(dofs or table_beside(path))
    half, entries = _read(_harwell_boeing, path)
    matrix = csr_matrix(entries)
    if half and min(entries.shape) == len(nodes):
        rows = entries.row.astype(np.int64)
        columns = entries.col.astype(np.int64)
        matrix = symmetric_of_half(rows, columns, entries.data, len(nodes), path.name)
    return ForeignMatrix(matrix, nodes, directions, path.name)


def _harwell_boeing(path: Path) -> tuple[bool, coo_matrix]:
    """True for a file that stores one half, and the entries of a Harwell-Boeing file.

    SciPy reads whole matrices alone, and no header as Ansys writes it: with formats without a
    repeat count, exponents with D, and a fourth format where there is no right-hand side.
    """
    lines = path.read_text(encoding="ascii", errors="replace").splitlines()
    kind = lines[2][:3].upper()
    if kind not in HARWELL_BOEING:
        raise ValueError(f"its type is {kind}: {', '.join(HARWELL_BOEING)} are read")
    counts = [int(lines[1][k : k + 14]) for k in (14, 28, 42)]
    rows, columns, size = (int(lines[2][k : k + 14]) for k in (14, 28, 42))
    expected = columns + 1, size, size
    at = 5 if int(lines[1][56:70].strip() or 0) else 4  # a right-hand side has a line of its own
    numbers: list[np.ndarray] = []
    for count, many, width in zip(counts, expected, _WIDTH.findall(lines[3])[:3], strict=True):
        numbers.append(_of_fields(lines[at : at + count], many, int(width)))
        at += count
    starts, stored = (some.astype(np.int64) - 1 for some in numbers[:2])
    matrix = csc_matrix((numbers[2], stored, starts), shape=(rows, columns))
    return kind[1] == "S", coo_matrix(matrix)


def _of_fields(lines: list[str], expected: int, width: int) -> np.ndarray:
    """Numbers between blanks, or, if they run together, in fields of a width."""
    text = [re.sub("[dD]", "E", line.rstrip()) for line in lines]
    words = " ".join(text).split()
    if len(words) != expected:
        words = [line[k : k + width] for line in text for k in range(0, len(line), width)]
    if len(words) != expected:
        raise ValueError(f"it has {len(words)} numbers of {expected}")
    return np.array([float(word) for word in words])


def read_npz(path: Path, dofs: Path | None = None) -> ForeignMatrix:
    """Stiffness of an NPZ file with ``nodes`` and ``directions`` of its rows, or with a table of
    dofs.

    The matrix is that of scipy's ``save_npz``, or entries ``row``, ``col`` (from 0 on) and
    ``data``; ``half`` says that one half is stored, and ``superelement`` that it is condensed.

    Args:
        path: file.
        dofs: table of dofs, if the file has none.

    Raises:
        FileContentError: for a file without a matrix or without names of its rows.
    """
    return _read(lambda file: _of_npz(file, dofs), path)


def _of_npz(path: Path, dofs: Path | None) -> ForeignMatrix:
    """Stiffness of an NPZ file, see :func:`read_npz`."""
    from scipy.sparse import load_npz

    with np.load(path, allow_pickle=False) as file:
        held = set(file.files)
        if "nodes" in held and "directions" in held:
            nodes = file["nodes"].astype(np.int64)
            directions = file["directions"].astype(np.int64)
        else:
            nodes, directions = read_dofs(dofs or table_beside(path))
        half = "half" in held and bool(file["half"])
        condensed = "superelement" in held and bool(file["superelement"])
        if {"row", "col", "data"} <= held and "format" not in held:
            size = len(nodes)
            rows = file["row"]
            columns = file["col"]
            if rows.size and not (
                min(rows.min(), columns.min()) >= 0 and rows.max() < size > columns.max()
            ):
                raise FileContentError(
                    f"{path} has rows {rows.min()} to {rows.max()} of {size}: rows and columns "
                    "count from 0"
                )
            entries = coo_matrix((file["data"], (rows, columns)), shape=(size, size))
        elif "format" in held:
            entries = coo_matrix(load_npz(path))
        else:
            raise FileContentError(
                f"{path} holds {sorted(held)}: a matrix is needed, of scipy's save_npz"
            )
    matrix = csr_matrix(entries)
    if half:
        size = len(nodes)
        matrix = symmetric_of_half(
            entries.row.astype(np.int64),
            entries.col.astype(np.int64),
            entries.data,
            size,
            path.name,
        )
    return ForeignMatrix(matrix, nodes, directions, path.name, superelement=condensed)


def write_npz(path: Path, found: ForeignMatrix) -> None:
    """Write a stiffness with the names of its rows, as :func:`read_npz` reads it.

    Args:
        path: file, ending in ``.npz``.
        found: matrix.
    """
    low = coo_matrix(found.matrix)
    lower = low.row >= low.col
    np.savez_compressed(
        path,
        data=low.data[lower],
        row=low.row[lower],
        col=low.col[lower],
        nodes=found.nodes,
        directions=found.directions,
        half=np.array(True),
        superelement=np.array(found.superelement),
    )


def table_beside(path: Path) -> Path:
    """Table of dofs of the same name beside a matrix.

    Raises:
        FileContentError: without one.
    """
    for ending in (".dof", ".mapping", ".dofs"):
        if (table := path.with_suffix(ending)).is_file():
            return table
    raise FileContentError(
        f"{path.name} does not name its rows: give a table of dofs, dofs=..., with the node and "
        "the direction of each "
        f"row, or put it beside as {path.with_suffix('.dof').name}"
    )


def _read(reader: Callable[[Path], _Read], path: Path) -> _Read:
    """Contents of a file by a reader; FileContentError for a damaged one."""
    try:
        return reader(path)
    except FileContentError:
        raise
    except Exception as error:  # readers of SciPy raise many kinds
        raise FileContentError(f"{path} cannot be read: {type(error).__name__}: {error}") from None
