"""Stiffness of Nastran: DMIG in bulk data and punch files, and OUTPUT4.

DMIG names its rows (grid point and component, 0 for scalar points). Matrices of OUTPUT4 (KGG, KAA)
need a table of
dofs: six for each grid point of the g-set in the order of their numbers. Rows of zeros, rotations
    of solids, are left
out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.plugins.foreign.dof_table import read_dofs
from hhr_dolfinx.plugins.foreign.matrix import ForeignMatrix, symmetric_of_half
from hhr_dolfinx.plugins.foreign.op4 import read_matrices
from hhr_dolfinx.plugins.foreign.plain import table_beside

STIFFNESSES = ("KAAX", "KAA", "KXX", "KGG", "K2GG", "KJJ", "KFF", "KLL")
"""Names that stiffness matrices usually have."""


def read_op4(path: Path, dofs: Path | None = None, name: str = "") -> ForeignMatrix:
    """Stiffness of an OUTPUT4 file, of text or binary.

    Args:
        path: file.
        dofs: table of dofs; None for the file of the same name with the ending ``.dof``.
        name: name of the matrix; empty for the only one, or for a usual name of a stiffness.

    Raises:
        FileContentError: for a damaged file, or one without such a matrix.
    """
    matrices = read_matrices(path)
    chosen = _chosen(list(matrices), name, path)
    matrix = matrices[chosen]
    if np.iscomplexobj(matrix):
        raise FileContentError(f"{path}: matrix {chosen} is complex: a real one is needed")
    nodes, directions = read_dofs(dofs or table_beside(path))
    return ForeignMatrix(csr_matrix(matrix), nodes, directions, path.name)


def read_dmig(path: Path, name: str = "") -> ForeignMatrix:
    """Stiffness of DMIG entries of a bulk data or punch file.

    Args:
        path: file of text, with entries in free, small or large fields.
        name: name of the matrix; empty for the only one, or for a usual name of a stiffness.

    Raises:
        FileContentError: for a file without DMIG, a complex matrix, or a damaged entry.
    """
    headers: dict[str, list[str]] = {}
    columns: dict[str, list[list[str]]] = {}
    for words in _entries(path):
        if words[1] == "0":
            headers[words[0]] = words
        elif len(words) > 1:
            columns.setdefault(words[0], []).append(words)
    chosen = _chosen(list(columns), name, path)
    form = _header(headers.get(chosen), chosen, path)
    try:
        entries = np.array([entry for words in columns[chosen] for entry in _column(words)])
    except (ValueError, IndexError) as error:
        raise FileContentError(
            f"{path}: DMIG {chosen} has an entry that is not understood: {error}"
        ) from None
    keys = entries[:, [0, 2]].astype(np.int64) * 16 + entries[:, [1, 3]].astype(np.int64)
    names, inverse = np.unique(keys, return_inverse=True)
    rows, cols = inverse.reshape(keys.shape).T
    half = form == 6
    if half:
        matrix = symmetric_of_half(rows, cols, entries[:, 4], names.size, path.name)
    else:
        matrix = csr_matrix((entries[:, 4], (rows, cols)), shape=(names.size,) * 2)
    nodes, directions = np.divmod(names, 16)
    return ForeignMatrix(matrix, nodes, directions, path.name)


def _header(words: list[str] | None, name: str, path: Path) -> int:
    """Form of a matrix, 6 for symmetric and 1 for square, from ``DMIG name 0 form type-in
    type-out``.
    """
    if words is None:
        raise FileContentError(f"{path}: DMIG {name} has no header, DMIG, {name}, 0, form, type")
    form = int(words[2] or 0)
    kind = int(words[3] or 0)
    if form not in (1, 6) or kind not in (1, 2):
        raise FileContentError(
            f"{path}: DMIG {name} has the form {form} and the type {kind}: a real matrix is "
            "needed, square (1) or "
            "symmetric (6)"
        )
    return form


def _entries(path: Path) -> list[list[str]]:
    """Words of all DMIG entries after the first field, continuations joined."""
    entries: list[list[str]] = []
    open_entry = False
    for line in path.read_text(encoding="ascii", errors="replace").splitlines():
        text = line.partition("$")[0].rstrip()
        if not text:
            continue
        first, words = _fields(text)
        if first.startswith("DMIG"):
            entries.append(words)
            open_entry = True
        elif open_entry and (not first or first[0] in "+*"):
            entries[-1] += words
        else:
            open_entry = False
    if not entries:
        raise FileContentError(f"{path} has no DMIG")
    return entries


def _fields(text: str) -> tuple[str, list[str]]:
    """First field of a line of bulk data, and its data fields: free, of 16 or of 8 characters."""
    if "," in text:
        first, *words = [word.strip() for word in text.split(",")]
        return first.upper().rstrip("*"), words[: 4 if first.endswith("*") else 8]
    first = text[:8].strip().upper()
    width = 16 if "*" in first else 8
    data = text[8:72].ljust(64)
    return first.rstrip("*") or first, [data[k : k + width].strip() for k in range(0, 64, width)]


def _column(words: list[str]) -> list[tuple[float, ...]]:
    """Entries (row node, direction, column node, direction, value) of a column, GJ CJ blank then G
    C A blank.
    """
    node = int(words[1])
    direction = int(words[2] or 0)
    entries: list[tuple[float, ...]] = []
    fields = words[4:] if len(words) > 3 and not words[3] else words[3:]
    for start in range(0, len(fields), 4):
        group = fields[start : start + 4]
        if len(group) >= 3 and group[0]:
            entries.append((int(group[0]), int(group[1] or 0), node, direction, _real(group[2])))
    return entries


def _real(word: str) -> float:
    """Number of Nastran, such as 1.5D+3 or 1.5+3."""
    text = word.upper().replace("D", "E")
    mantissa = text[0]
    sign = ""
    exponent = ""
    for index, letter in enumerate(text[1:], start=1):
        if letter in "+-" and text[index - 1] != "E":
            sign = letter
            exponent = text[index + 1 :]
            break
        mantissa += letter
    return float(f"{mantissa}E{sign}{exponent}" if exponent else text)


def _chosen(names: list[str], name: str, path: Path) -> str:
    """Name of the stiffness among those of a file."""
    if name:
        if name not in names:
            raise FileContentError(f"{path} has no matrix {name}, but {', '.join(names)}")
        return name
    usual = [candidate for candidate in STIFFNESSES if candidate in names]
    if len(names) == 1 or usual:
        return usual[0] if usual else names[0]
    raise FileContentError(
        f"{path} has the matrices {', '.join(names)}: say which one is the stiffness, matrix=..."
    )
