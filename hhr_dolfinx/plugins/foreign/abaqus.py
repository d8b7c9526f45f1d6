"""Stiffness of Abaqus: ``.mtx`` of ``*MATRIX OUTPUT`` in its three formats.

- MATRIX INPUT and LABELS: ``row node, direction, column node, direction, entry``, one half of a
symmetric matrix or
  both. Rows have their names.
- COORDINATE: ``row column entry``, both halves. A table of dofs has the names.

Abaqus keeps the rows of imposed dofs; with ``*MATRIX GENERATE, ... `` in a step with ``*BOUNDARY``
their diagonal is 1e36 (a penalty), which is read as imposed at zero.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.plugins.foreign.calculix import read_superelement
from hhr_dolfinx.plugins.foreign.dof_table import read_dofs
from hhr_dolfinx.plugins.foreign.matrix import ForeignMatrix, symmetric_of_half
from hhr_dolfinx.plugins.foreign.plain import read_matrix_market, table_beside

LEAST_PENALTY = 1e30
"""Diagonal entries above this are penalties of imposed dofs: their rows and columns are left
out.
"""


def read_mtx(path: Path, dofs: Path | None = None) -> ForeignMatrix:
    """Stiffness of a ``.mtx`` file: MatrixMarket, a superelement, or ``*MATRIX OUTPUT`` of Abaqus.

    Args:
        path: file of text.
        dofs: table of dofs, for MatrixMarket and the format COORDINATE.

    Raises:
        FileContentError: for a damaged file.
    """
    with path.open(encoding="utf-8", errors="replace") as file:
        start = file.read(4096)
    if start.startswith("%%MatrixMarket"):
        return read_matrix_market(path, dofs)
    if "*USER ELEMENT" in start.upper() or ("*MATRIX" in start.upper() and "TYPE" in start.upper()):
        return read_superelement(path)
    try:
        text = (
            line.replace(",", " ")
            for line in path.read_text().splitlines()
            if line[:1] not in "*#" and line
        )
        table = np.loadtxt(text, ndmin=2)
    except ValueError as error:
        raise FileContentError(
            f"{path} is no matrix of Abaqus, a table of numbers: {error}"
        ) from None
    if table.shape[1] == 5:
        return _without_penalties(_named(table, path))
    if table.shape[1] == 3:
        return _without_penalties(_counted(table, path, dofs))
    raise FileContentError(
        f"{path.name} has {table.shape[1]} columns: 5 (MATRIX INPUT, LABELS) or 3 (COORDINATE) "
        "are known"
    )


def _named(table: np.ndarray, path: Path) -> ForeignMatrix:
    """Matrix of entries with the names of row and column."""
    integers = table[:, :4].astype(np.int64)
    keys = integers[:, [0, 2]] * 16 + integers[:, [1, 3]]
    names, inverse = np.unique(keys, return_inverse=True)
    rows, columns = inverse.reshape(keys.shape).T
    matrix = symmetric_of_half(rows, columns, table[:, 4], names.size, path.name)
    nodes, directions = np.divmod(names, 16)
    # negative labels are internal nodes of elements
    return ForeignMatrix(matrix, nodes, np.where(nodes < 0, 0, directions), path.name)


def _counted(table: np.ndarray, path: Path, dofs: Path | None) -> ForeignMatrix:
    """Matrix of entries with the numbers of row and column."""
    nodes, directions = read_dofs(dofs or table_beside(path))
    rows, columns = (table[:, k].astype(np.int64) - 1 for k in (0, 1))
    matrix = symmetric_of_half(rows, columns, table[:, 2], len(nodes), path.name)
    return ForeignMatrix(matrix, nodes, directions, path.name)


def _without_penalties(found: ForeignMatrix) -> ForeignMatrix:
    """The matrix without rows of imposed dofs."""
    free = np.flatnonzero(found.matrix.diagonal() < LEAST_PENALTY)
    if free.size == len(found.nodes):
        return found
    matrix = csr_matrix(found.matrix[free][:, free])
    return ForeignMatrix(matrix, found.nodes[free], found.directions[free], found.source)
