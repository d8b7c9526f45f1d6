"""Matrices of Nastran's OUTPUT4, of text or binary, full or sparse columns, with BIGMAT or without.

A matrix has a header with its numbers of columns and rows (negative with BIGMAT), form, type (1
single, 2 double) and name, then a record for each column: its number, the first row of a full one
or 0, and the number of words. Sparse columns have strings of rows, each with a word ``row + 65536
(words + 1)``, or with BIGMAT two, ``words + 1`` and ``row``.
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


class Header(NamedTuple):
    """Header of a matrix."""

    columns: int
    rows: int
    kind: int
    name: str
    big: bool


def read_matrices(path: Path) -> dict[str, coo_matrix]:
    """Real matrices of an OUTPUT4 file by their names.

    Raises:
        FileContentError: for a damaged file, or complex matrices.
    """
    data = path.read_bytes()
    try:
        for order in "<>":
            if len(data) > 32 and struct.unpack(f"{order}i", data[:4])[0] == 24:
                return _of_binary(data, order)
        return _of_text(data.decode("ascii"))
    except (ValueError, IndexError, struct.error) as error:
        raise FileContentError(
            f"{path} is no OUTPUT4 file of text or binary, or it is damaged: {error}"
        ) from None


def _real(header: Header) -> Header:
    if header.kind not in (1, 2):
        raise ValueError(
            f"matrix {header.name} has the type {header.kind}: real ones, 1 and 2, are read"
        )
    return header


def _of_text(text: str) -> dict[str, coo_matrix]:
    """Matrices of a file of text: lines of whole numbers are headers, others are values."""
    matrices: dict[str, coo_matrix] = {}
    lines = text.splitlines()
    at = 0
    while at < len(lines):
        line = lines[at]
        columns, rows, _, kind = (int(line[k : k + 8]) for k in (0, 8, 16, 24))
        header = _real(Header(columns, abs(rows), kind, line[32:40].strip(), rows < 0))
        wide = re.search(r"[DE](\d+)\.", line[40:].upper())
        at, matrices[header.name] = _columns_of_text(
            lines, at + 1, header, int(wide[1]) if wide else 16
        )
    return matrices


def _columns_of_text(
    lines: list[str], at: int, header: Header, width: int
) -> tuple[int, coo_matrix]:
    """Line after a matrix, and its entries."""
    entries: list[tuple[int, int, list[float]]] = []
    while True:
        column, first, _ = (int(word) for word in lines[at].split()[:3])
        at += 1
        if column > header.columns:
            while at < len(lines) and "." in lines[at]:
                at += 1
            return at, _matrix(entries, header)
        if first > 0:
            at, values = _values(lines, at, width)
            entries.append((column, first, values))
            continue
        while at < len(lines) and len(words := lines[at].split()) <= 2 and "." not in lines[at]:
            row = int(words[1]) if len(words) == 2 else int(words[0]) % STRING
            at, values = _values(lines, at + 1, width)
            entries.append((column, row, values))


def _values(lines: list[str], at: int, width: int) -> tuple[int, list[float]]:
    """Line after values, and these: numbers of a width, with a point."""
    values: list[float] = []
    while at < len(lines) and "." in lines[at]:
        line = lines[at].rstrip()
        values += [float(line[k : k + width].replace("D", "E")) for k in range(0, len(line), width)]
        at += 1
    return at, values


def _of_binary(data: bytes, order: str) -> dict[str, coo_matrix]:
    """Matrices of a file of Fortran records."""
    records = _records(data, order)
    matrices: dict[str, coo_matrix] = {}
    while records:
        head = records.pop(0)
        columns, rows, _, kind = struct.unpack(f"{order}4i", head[:16])
        header = _real(
            Header(columns, abs(rows), kind, head[16:24].decode("ascii").strip(), rows < 0)
        )
        entries: list[tuple[int, int, list[float]]] = []
        while records:
            record = records.pop(0)
            column, first, words = struct.unpack(f"{order}3i", record[:12])
            if column > columns:
                break
            entries += _strings(record[12 : 12 + 4 * words], column, first, header, order)
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
    body: bytes, column: int, first: int, header: Header, order: str
) -> list[tuple[int, int, list[float]]]:
    """Column, first row and values of each string of a column."""
    kind = np.dtype(f"{order}f{4 * header.kind}")
    if first > 0:
        return [(column, first, np.frombuffer(body, kind).tolist())]
    strings = []
    at = 0
    while at < len(body):
        if header.big:
            length, row = struct.unpack(f"{order}2i", body[at : at + 8])
            at += 8
            words = length - 1
        else:
            (word,) = struct.unpack(f"{order}i", body[at : at + 4])
            at += 4
            words = word // STRING - 1
            row = word % STRING
        strings.append((column, row, np.frombuffer(body[at : at + 4 * words], kind).tolist()))
        at += 4 * words
    return strings


def _matrix(entries: list[tuple[int, int, list[float]]], header: Header) -> coo_matrix:
    """Sparse matrix of strings of columns."""
    rows = [row - 1 + k for _, row, values in entries for k in range(len(values))]
    columns = [column - 1 for column, _, values in entries for _ in values]
    values = [value for _, _, numbers in entries for value in numbers]
    matrix = coo_matrix((values, (rows, columns)), shape=(header.rows, header.columns))
    matrix.eliminate_zeros()
    return matrix
