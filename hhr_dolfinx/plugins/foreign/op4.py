"""Matrices of Nastran's OUTPUT4, of text or binary, full or sparse columns, with BIGMAT or without.

A matrix has a header with its numbers of columns and rows (negative with BIGMAT), form, type (1
single, 2 double, 3 and 4 complex) and name, then a record for each column: its number, the first
row of a full one or 0, and the number of words. Sparse columns have strings of rows, each with a
word ``row + 65536 (words + 1)``, or with BIGMAT two, ``words + 1`` and ``row``. A record beyond the
last column, with one number, ends a matrix.

Releases with integers of eight bytes write binary files of words of eight bytes: the record of a
header has 48 bytes, each word of a name has four letters, and single precision has eight bytes.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix

from hhr_dolfinx.errors import FileContentError

STRING = 65536
"""Factor of the length of a string beside its first row."""
WORDS = {24: 4, 48: 8}
"""Bytes of a word by those of the record of a header."""


class Header(NamedTuple):
    """Header of a matrix."""

    columns: int
    rows: int
    kind: int
    name: str
    big: bool

    @classmethod
    def of(cls, columns: int, rows: int, kind: int, name: str) -> Header:
        """Header of the numbers of a file.

        Raises:
            ValueError: for a type that is unknown.
        """
        if kind not in (1, 2, 3, 4):
            raise ValueError(f"matrix {name} has the type {kind}: 1 to 4 are known")
        return cls(columns, abs(rows), kind, name, rows < 0)


def read_matrices(path: Path) -> dict[str, coo_matrix]:
    """Matrices of an OUTPUT4 file by their names, real or complex.

    Raises:
        FileContentError: for a damaged file.
    """
    data = path.read_bytes()
    try:
        for order in "<>":
            if len(data) > 32 and struct.unpack(f"{order}i", data[:4])[0] in WORDS:
                return _of_binary(data, order)
        return _of_text(data.decode("ascii"))
    except (ValueError, LookupError, struct.error) as error:
        raise FileContentError(
            f"{path} is no OUTPUT4 file of text or binary, or it is damaged: {error}"
        ) from None


def _of_text(text: str) -> dict[str, coo_matrix]:
    """Matrices of a file of text: lines of whole numbers are headers, others are values."""
    matrices: dict[str, coo_matrix] = {}
    lines = text.splitlines()
    at = 0
    while at < len(lines):
        line = lines[at]
        columns, rows, _, kind = (int(line[k : k + 8]) for k in (0, 8, 16, 24))
        header = Header.of(columns, rows, kind, line[32:40].strip())
        wide = re.search(r"[DE](\d+)\.", line[40:].upper())
        at, matrices[header.name] = _columns_of_text(
            lines, at + 1, header, int(wide[1]) if wide else 16
        )
    return matrices


def _columns_of_text(
    lines: list[str], at: int, header: Header, width: int
) -> tuple[int, coo_matrix]:
    """Line after a matrix, and its entries."""
    entries: list[tuple[int, int, np.ndarray]] = []
    while True:
        column, first, _ = (int(word) for word in lines[at].split()[:3])
        at += 1
        if column > header.columns:
            return at + 1, _matrix(entries, header)  # the next line has one number
        if first > 0:
            at, values = _values(lines, at, width, header)
            entries.append((column, first, values))
            continue
        while at < len(lines) and len(words := lines[at].split()) <= 2 and "." not in lines[at]:
            row = int(words[1]) if len(words) == 2 else int(words[0]) % STRING
            at, values = _values(lines, at + 1, width, header)
            entries.append((column, row, values))


def _values(lines: list[str], at: int, width: int, header: Header) -> tuple[int, np.ndarray]:
    """Line after values, and these: numbers of a width, with a point."""
    values: list[float] = []
    while at < len(lines) and "." in lines[at]:
        line = lines[at].rstrip()
        values += [float(line[k : k + width].replace("D", "E")) for k in range(0, len(line), width)]
        at += 1
    return at, np.array(values).view(float if header.kind < 3 else complex)


def _of_binary(data: bytes, order: str) -> dict[str, coo_matrix]:
    """Matrices of a file of Fortran records."""
    records = _records(data, order)
    matrices: dict[str, coo_matrix] = {}
    while records:
        head = records.pop(0)
        word = WORDS[len(head)]
        integer = np.dtype(f"{order}i{word}")
        columns, rows, _, kind = np.frombuffer(head[: 4 * word], integer).tolist()
        name = head[4 * word :].decode("ascii").replace(" ", "")
        header = Header.of(columns, rows, kind, name)
        entries: list[tuple[int, int, np.ndarray]] = []
        while records:
            record = records.pop(0)
            column, first, words = np.frombuffer(record[: 3 * word], integer).tolist()
            if column > columns:
                break
            body = record[3 * word : (3 + words) * word]
            entries += _strings(body, column, first, header, integer)
        matrices[header.name] = _matrix(entries, header)
    return matrices


def _records(data: bytes, order: str) -> list[bytes]:
    """Fortran records of a file."""
    records = []
    at = 0
    while at < len(data):
        (size,) = struct.unpack(f"{order}i", data[at : at + 4])
        if data[at + 4 + size : at + 8 + size] != data[at : at + 4]:
            raise ValueError(f"a record at byte {at} has no end")
        records.append(data[at + 4 : at + 4 + size])
        at += size + 8
    return records


def _strings(
    body: bytes, column: int, first: int, header: Header, integer: np.dtype
) -> list[tuple[int, int, np.ndarray]]:
    """Column, first row and values of each string of a column."""
    word = integer.itemsize
    size = word if header.kind % 2 else 8
    kind = np.dtype(f"{integer.str[0]}{f'f{size}' if header.kind < 3 else f'c{2 * size}'}")
    if first > 0:
        return [(column, first, np.frombuffer(body, kind))]
    strings = []
    at = 0
    while at < len(body):
        if header.big:
            length, row = np.frombuffer(body[at : at + 2 * word], integer).tolist()
            at += 2 * word
            words = length - 1
        else:
            (joined,) = np.frombuffer(body[at : at + word], integer).tolist()
            at += word
            words = joined // STRING - 1
            row = joined % STRING
        if words < 1:
            raise ValueError(f"column {column} of {header.name} has a string of {words} words")
        strings.append((column, row, np.frombuffer(body[at : at + word * words], kind)))
        at += word * words
    return strings


def _matrix(entries: list[tuple[int, int, np.ndarray]], header: Header) -> coo_matrix:
    """Sparse matrix of strings of columns."""
    lengths = [len(values) for _, _, values in entries]
    rows = [np.arange(row - 1, row - 1 + len(values)) for _, row, values in entries]
    columns = np.repeat([column - 1 for column, _, _ in entries], lengths)
    values = [values for _, _, values in entries]
    shape = header.rows, header.columns
    kind = float if header.kind < 3 else complex
    if not entries:
        return coo_matrix(shape, dtype=kind)
    at = np.concatenate(rows), columns
    matrix = coo_matrix((np.concatenate(values).astype(kind), at), shape=shape)
    matrix.eliminate_zeros()
    return matrix
