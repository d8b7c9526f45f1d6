"""Readers of stiffness files by their endings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hhr_dolfinx.errors import FileError
from hhr_dolfinx.plugins.foreign.abaqus import read_mtx
from hhr_dolfinx.plugins.foreign.calculix import read_sti
from hhr_dolfinx.plugins.foreign.matrix import ForeignMatrix, checked_matrix
from hhr_dolfinx.plugins.foreign.nastran import read_dmig, read_op4
from hhr_dolfinx.plugins.foreign.plain import read_harwell_boeing, read_matrix_market, read_npz

READERS: dict[str, tuple[str, Callable[..., ForeignMatrix]]] = {
    ".sti": ("CalculiX", read_sti),
    ".mtx": ("Abaqus", read_mtx),
    ".mmf": ("Ansys", read_matrix_market),
    ".mm": ("MatrixMarket", read_matrix_market),
    ".txt": ("Ansys", read_matrix_market),
    ".hb": ("Harwell-Boeing", read_harwell_boeing),
    ".rsa": ("Harwell-Boeing", read_harwell_boeing),
    ".rua": ("Harwell-Boeing", read_harwell_boeing),
    ".matrix": ("Ansys", read_harwell_boeing),
    ".op4": ("Nastran", read_op4),
    ".pch": ("Nastran", read_dmig),
    ".dmig": ("Nastran", read_dmig),
    ".bdf": ("Nastran", read_dmig),
    ".dat": ("Nastran", read_dmig),
    ".npz": ("NPZ", read_npz),
}
"""Code and reader of each ending."""
OF_NAMED_ROWS = (read_dmig,)
"""Readers of files that name their rows, which take no table."""


def read_stiffness(
    path: str | Path, dofs: str | Path | None = None, matrix: str = ""
) -> ForeignMatrix:
    """Stiffness of another code with the names of its rows, checked.

    Args:
        path: file of CalculiX (``.sti``), Abaqus (``.mtx``), Ansys (``.mmf``, ``.matrix``), Nastran
            (``.op4``, ``.pch``), or MatrixMarket (``.mm``, ``.mtx``), Harwell-Boeing (``.hb``), NPZ
            (``.npz``).
        dofs: table of dofs, for formats that do not name their rows; None for a file of the same
            name beside it.
        matrix: name of the matrix in a file of Nastran with several.

    Returns:
        The matrix with both halves, without rows of zeros.

    Raises:
        FileError: without the file, or for an unknown ending.
        FileContentError: for a damaged file, or one that is no stiffness.

    Warns:
        SceneWarning: of single precision.
    """
    path = Path(path)
    if not path.is_file():
        raise FileError(f"there is no stiffness {path}")
    if path.suffix.lower() not in READERS:
        raise FileError(f"the ending of {path.name} is not known: {', '.join(READERS)} are")
    reader = READERS[path.suffix.lower()][1]
    if reader in OF_NAMED_ROWS:
        return checked_matrix(reader(path, matrix))
    arguments = [None if dofs is None else Path(dofs), *([matrix] if reader is read_op4 else [])]
    return checked_matrix(reader(path, *arguments))
