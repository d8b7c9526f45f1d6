"""Stiffness in formats of no code: MatrixMarket and Harwell-Boeing with a table of dofs, and NPZ.

Ansys writes MatrixMarket (``*EXPORT, MatK, MMF``) and Harwell-Boeing with a mapping file
(``HBMAT``); a command file of code_aster writes NPZ by a few lines of Python, see docs/foreign.md.
"""

from __future__ import annotations

from collections.abc import Callable
from inspect import signature
from io import StringIO
from pathlib import Path

import numpy as np
from scipy.io import hb_read, mmread
from scipy.sparse import coo_matrix, csr_matrix, spmatrix

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.plugins.foreign.dof_table import read_dofs
from hhr_dolfinx.plugins.foreign.matrix import ForeignMatrix, symmetric_of_half

SPARSE_MATRIX = {"spmatrix": True} if "spmatrix" in signature(mmread).parameters else {}
"""Option of releases of SciPy that also make sparse arrays."""
SYMMETRIC = ("RSA", "PSA")
"""Types of Harwell-Boeing files that store one half."""


def read_matrix_market(path: Path, dofs: Path | None = None) -> ForeignMatrix:
    """Stiffness of a MatrixMarket file, ``coordinate`` or ``array``; symmetric ones store one half.

    Args:
        path: file.
        dofs: table of dofs; None for a file of the same name with the ending ``.dof`` or
            ``.mapping``.
    """
    nodes, directions = read_dofs(dofs or table_beside(path))
    return ForeignMatrix(
        csr_matrix(_read(lambda _: mmread(path, **SPARSE_MATRIX), path)),
        nodes,
        directions,
        path.name,
    )


def read_harwell_boeing(path: Path, dofs: Path | None = None) -> ForeignMatrix:
    """Stiffness of a Harwell-Boeing file, RSA (one half) or RUA (whole).

    Args:
        path: file.
        dofs: table of dofs, such as the mapping file of ``HBMAT``; None for a file of the same name
            beside it.
    """
    nodes, directions = read_dofs(dofs or table_beside(path))
    lines = path.read_text(encoding="ascii", errors="replace").splitlines(keepends=True)
    kind = lines[2][:3].upper() if len(lines) > 2 else ""
    if kind in SYMMETRIC:  # SciPy reads whole matrices alone
        lines[2] = f"RUA{lines[2][3:]}"
    entries = coo_matrix(_read(lambda _: hb_read(StringIO("".join(lines)), **SPARSE_MATRIX), path))
    matrix = csr_matrix(entries)
    if kind in SYMMETRIC and min(entries.shape) == len(nodes):
        rows = entries.row.astype(np.int64)
        columns = entries.col.astype(np.int64)
        matrix = symmetric_of_half(rows, columns, entries.data, len(nodes), path.name)
    return ForeignMatrix(matrix, nodes, directions, path.name)


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
            entries = coo_matrix((file["data"], (file["row"], file["col"])), shape=(size, size))
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


def _read(reader: Callable[[Path], spmatrix], path: Path) -> spmatrix:
    """What a reader of SciPy makes of a file; FileContentError for a damaged one."""
    try:
        return reader(path)
    except Exception as error:  # readers of SciPy raise many kinds
        raise FileContentError(f"{path} cannot be read: {type(error).__name__}: {error}") from None
