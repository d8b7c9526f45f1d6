"""Stiffness of CalculiX: ``.sti`` with ``.dof`` of SOLVER=MATRIXSTORAGE, and ``.mtx`` of
substructures.

CalculiX leaves out dofs that ``*BOUNDARY`` imposes and those that MPCs make dependent, and stores
the upper half. It expands shells and beams to solids; the rows of all nodes that stand for one node
of the deck have its label, in ascending order of the nodes of the solids. Rows of incompatible
modes (C3D8I, S4, B31) have labels beyond all nodes.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.plugins.foreign.dof_table import read_dofs
from hhr_dolfinx.plugins.foreign.matrix import ForeignMatrix, symmetric_of_half

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][-+]?\d+)?")


def read_sti(path: Path, dofs: Path | None = None) -> ForeignMatrix:
    """Stiffness of a ``.sti`` file, whose rows the ``.dof`` file beside it names.

    Args:
        path: file with a line ``row column entry`` for each entry of one half.
        dofs: table of dofs; None for the file of the same name with the ending ``.dof``.

    Raises:
        FileContentError: for a damaged file, or a table that is not of it.
    """
    nodes, directions = read_dofs(dofs or path.with_suffix(".dof"))
    try:
        table = np.loadtxt(path, ndmin=2)
        rows = table[:, 0].astype(np.int64) - 1
        columns = table[:, 1].astype(np.int64) - 1
    except (ValueError, IndexError) as error:
        raise FileContentError(f"{path} is no file of lines 'row column entry': {error}") from None
    size = len(nodes)
    if max(rows.max(), columns.max()) + 1 != size:
        raise FileContentError(
            f"{path.name} has {max(rows.max(), columns.max()) + 1} rows and its table of dofs "
            f"{size}: a row is "
            "missing, or the two files are not of one run"
        )
    matrix = symmetric_of_half(rows, columns, table[:, 2], size, path.name)
    return ForeignMatrix(matrix, nodes, directions, path.name, sequence=True)


def read_superelement(path: Path) -> ForeignMatrix:
    """Superelement of ``*SUBSTRUCTURE MATRIX OUTPUT`` of CalculiX or Abaqus, ``.mtx``.

    The file states ``*USER ELEMENT`` with its nodes in comments, then dofs of the first node and of
    each position where they change, and the lower half of K row by row. Nodes of Abaqus that are
    not positive are retained modes: dofs of the code alone.

    Args:
        path: file of text.

    Raises:
        FileContentError: for a file without nodes, dofs or a stiffness, or with another number of
            entries, or with matrices of several elements.
    """
    text = path.read_text(encoding="utf-8", errors="replace")
    head, mark, body = text.partition("*MATRIX")
    heading, _, values = body.partition("\n")
    if not mark or "STIFFNESS" not in heading.upper():
        raise FileContentError(
            f"{path} has no *MATRIX, TYPE=STIFFNESS: write it with STIFFNESS=YES"
        )
    if (elements := text.upper().count("*USER ELEMENT")) > 1:
        raise FileContentError(
            f"{path.name} has matrices of {elements} elements (*ELEMENT MATRIX OUTPUT): write one "
            "superelement (*SUBSTRUCTURE MATRIX OUTPUT), or the assembled matrix (*MATRIX OUTPUT)"
        )
    nodes, directions = _dofs_of_user_element(head, path)
    numbers = np.array(
        [float(word.upper().replace("D", "E")) for word in _NUMBER.findall(values.split("*")[0])]
    )
    size = len(nodes)
    if numbers.size != size * (size + 1) // 2:
        raise FileContentError(
            f"{path.name} has {numbers.size} entries of K, and {size} dofs need "
            f"{size * (size + 1) // 2} in one half: "
            "a row is missing, or the file was cut"
        )
    matrix = np.zeros((size, size))
    matrix[np.tril_indices(size)] = numbers
    matrix += np.tril(matrix, -1).T
    return ForeignMatrix(csr_matrix(matrix), nodes, directions, path.name, superelement=True)


def _dofs_of_user_element(head: str, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and directions of the dofs of a ``*USER ELEMENT`` block, (n,) each."""
    lines = head.splitlines()
    start = next(
        (k for k, line in enumerate(lines) if line.upper().startswith("*USER ELEMENT")), None
    )
    if start is None:
        raise FileContentError(f"{path} has no *USER ELEMENT, which names the dofs of its rows")
    labels: list[int] = []
    changes: dict[int, list[int]] = {}
    for line in lines[start + 1 :]:
        numbers = [int(word) for word in re.findall(r"-?\d+", line)]
        if line.startswith("**"):
            labels += numbers if not re.search(r"[A-Za-z]", line) else []
        elif numbers and not line.startswith("*"):
            position, directions = (numbers[0], numbers[1:]) if changes else (1, numbers)
            changes[position] = directions
    if not labels or 1 not in changes:
        raise FileContentError(f"{path} lists no nodes in comments below *USER ELEMENT, or no dofs")
    dofs = []
    directions = changes[1]
    for position, label in enumerate(labels, start=1):
        directions = changes.get(position, directions)
        dofs += [(label, direction if label > 0 else 0) for direction in directions]
    table = np.array(dofs, dtype=np.int64)
    return table[:, 0], table[:, 1]
