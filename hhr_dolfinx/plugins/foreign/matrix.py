"""Stiffness matrix of another code, with the node and the direction of each row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, tril, triu
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.errors import FileContentError, SceneError, SceneWarning
from hhr_dolfinx.warn import warn

ASYMMETRY = 1e-8
"""Largest difference of a matrix from its transpose over its largest entry: eight digits, as DMIG
entries have them.
"""
ZEROS = 0.3
"""Part of exact zeros above which a superelement is not condensed: a condensed block of one body is
full.
"""
FEW = 12
"""Number of dofs up to which exact zeros of a superelement may come from symmetry."""
SHORT = 1 << 12
"""Entries that are whole multiples of 1/SHORT say nothing of their precision."""


@dataclass(frozen=True, eq=False)
class ForeignMatrix:
    """Symmetric stiffness of another code.

    Attributes:
        matrix: K, sparse, (n, n), both halves.
        nodes: label of the node of each row, (n,).
        directions: direction of each row, (n,): 1 to 3 for displacements, 4 to 6 for rotations, 0
            for a dof of the code alone, such as an incompatible mode.
        source: name of the file, for messages.
        sequence: True if a label stands for several nodes, in ascending order: CalculiX expands
            shells and beams to solids, and names all of their rows by the node of the deck.
        superelement: True for a block that was condensed to its retained dofs.
    """

    matrix: csr_matrix
    nodes: np.ndarray
    directions: np.ndarray
    source: str
    sequence: bool = False
    superelement: bool = False

    def dof(self, row: int) -> str:
        """Name of a row, ``node.direction``."""
        return f"{self.nodes[row]}.{self.directions[row]}"


def symmetric_of_half(
    rows: np.ndarray, columns: np.ndarray, entries: np.ndarray, size: int, source: str
) -> csr_matrix:
    """Symmetric matrix from entries of one half, or of both, (n, n).

    Args:
        rows, columns: indices from 0 on, (k,).
        entries: values, (k,).
        size: n.
        source: name of the file, for messages.

    Raises:
        FileContentError: for entries of both halves that differ, for repeated ones, and for indices
            beyond n.
    """
    if rows.size and not (
        0 <= min(rows.min(), columns.min()) and max(rows.max(), columns.max()) < size
    ):
        raise FileContentError(
            f"{source} has an entry in row {int(rows.max()) + 1} and column "
            f"{int(columns.max()) + 1}, and its table of "
            f"dofs has {size} rows: the two files are not of one run, or rows of the table are "
            "missing"
        )
    keys = rows * np.int64(size) + columns
    keys.sort()  # ten times as fast as np.unique
    if (keys[1:] == keys[:-1]).any():
        raise FileContentError(
            f"{source} states an entry twice: it is damaged, or two matrices are in one file"
        )
    stated = coo_matrix((entries, (rows, columns)), shape=(size, size)).tocsr()
    low = tril(stated, -1, format="csr")
    up = triu(stated, 1, format="csr")
    if low.nnz and up.nnz:
        return _averaged(stated, source)
    return csr_matrix(stated + (low if low.nnz else up).T)


def _averaged(matrix: csr_matrix, source: str) -> csr_matrix:
    """The symmetric part of a matrix that is symmetric up to the digits of its file, (n, n)."""
    off = coo_matrix(abs(matrix - matrix.T))
    largest = abs(matrix).max()
    if off.nnz and off.data.max() > ASYMMETRY * largest:
        worst = int(off.data.argmax())
        raise FileContentError(
            f"the stiffness in {source} is not symmetric: rows {off.row[worst] + 1} and "
            f"{off.col[worst] + 1} differ "
            f"by {off.data[worst]:.3g}, {off.data[worst] / largest:.2g} of its largest entry. "
            "Write the K of an "
            "energy; contact, friction and follower loads of the other code make it unsymmetric"
        )
    return csr_matrix((matrix + matrix.T) / 2)


def checked_matrix(found: ForeignMatrix) -> ForeignMatrix:
    """A matrix whose rows have names and stiffness; rows without any entry are left out.

    Args:
        found: matrix as a reader made it.

    Raises:
        FileContentError: for a table of dofs of another length, repeated dofs, entries that are not
            finite, one half instead of the whole, and diagonal entries that are not positive.

    Warns:
        SceneWarning: of single precision.
    """
    source = found.source
    if np.iscomplexobj(found.matrix) and abs(found.matrix.imag).max() > 0:
        raise FileContentError(
            f"the stiffness in {source} is complex: damping has no counterpart, write its real part"
        )
    matrix = csr_matrix(found.matrix.real, dtype=float, copy=True)
    if matrix.shape[0] != matrix.shape[1]:
        raise FileContentError(f"the stiffness in {source} is {matrix.shape}: it must be square")
    if not matrix.shape[0] == len(found.nodes) == len(found.directions):
        raise FileContentError(
            f"the stiffness in {source} has {matrix.shape[0]} rows and its table of dofs "
            f"{len(found.nodes)}: a row is "
            "missing, or the two files are not of one run"
        )
    if not np.isfinite(matrix.data).all():
        raise FileContentError(f"the stiffness in {source} holds numbers that are not finite")
    matrix.eliminate_zeros()
    _check_halves(matrix, source)
    matrix = _averaged(matrix, source)
    checked = ForeignMatrix(
        matrix, found.nodes, found.directions, source, found.sequence, found.superelement
    )
    checked = _without_idle_rows(checked)
    _check_names(checked)
    _check_diagonal(checked)
    _check_condensed(checked)
    _warn_of_single_precision(checked)
    return checked


def _check_halves(matrix: csr_matrix, source: str) -> None:
    """Raise FileContentError for a triangular matrix with entries beside its diagonal."""
    low = tril(matrix, -1).nnz
    up = triu(matrix, 1).nnz
    if max(low, up) and not min(low, up):
        raise FileContentError(
            f"the stiffness in {source} has entries {'below' if low else 'above'} its diagonal "
            "alone, and is stated as "
            "whole: one half of it is stored. Say so in the file (symmetric), or store both halves"
        )


def _without_idle_rows(given: ForeignMatrix) -> ForeignMatrix:
    """The matrix without rows of zeros, such as rotations of nodes of solids."""
    nonzero = np.flatnonzero(np.diff(given.matrix.indptr))
    if nonzero.size == len(given.nodes):
        return given
    matrix = csr_matrix(given.matrix[nonzero][:, nonzero])
    nodes = given.nodes[nonzero]
    directions = given.directions[nonzero]
    return ForeignMatrix(
        matrix, nodes, directions, given.source, given.sequence, given.superelement
    )


def _check_names(given: ForeignMatrix) -> None:
    """Raise FileContentError for dofs that are named twice, and for directions beyond 6."""
    if given.directions.size and not (0 <= given.directions.min() and given.directions.max() <= 6):
        raise FileContentError(
            f"direction {given.directions.max()} of {given.source} is not known: 1 to 3 are "
            "displacements, 4 to 6 "
            "rotations. Temperatures, pressures and warping of beams have no counterpart"
        )
    if given.sequence:
        return
    named = given.directions > 0
    keys = given.nodes[named] * 10 + given.directions[named]
    values, counts = np.unique(keys, return_counts=True)
    if (counts > 1).any():
        key = int(values[counts > 1][0])
        raise FileContentError(
            f"the table of dofs of {given.source} names {key // 10}.{key % 10} twice"
        )


def _check_diagonal(given: ForeignMatrix) -> None:
    """Raise FileContentError for a diagonal that is not positive."""
    diagonal = given.matrix.diagonal()
    wrong = np.flatnonzero(~(diagonal > 0))
    if wrong.size:
        row = int(wrong[0])
        sign = (
            "its sign is reversed"
            if wrong.size == diagonal.size
            else "it is no stiffness of an energy"
        )
        raise FileContentError(
            f"{wrong.size} of {diagonal.size} diagonal entries of the stiffness in {given.source} "
            "are not positive, "
            f"first {diagonal[row]:.4g} of dof {given.dof(row)}: {sign}. Lagrange multipliers of "
            "the other code "
            "(negative or zero) do not travel: take contact, ties and hybrid elements out of the "
            "run that writes K"
        )


def _check_condensed(given: ForeignMatrix) -> None:
    """Raise SceneError for a superelement that is a block of K, which was not condensed."""
    size = len(given.nodes)
    if not given.superelement or size <= FEW:
        return
    _, label = connected_components(given.matrix, directed=False)
    zeros = 1.0 - given.matrix.nnz / float((np.bincount(label) ** 2).sum())
    if zeros > ZEROS:
        raise SceneError(
            f"the superelement in {given.source} has {100 * zeros:.0f} % zeros between dofs of "
            "one part: it is the block of K of its retained "
            "dofs, and was not condensed (CalculiX 2.20 of Debian writes such files). Take the "
            "whole K, or another "
            "version of the code"
        )


def _warn_of_single_precision(given: ForeignMatrix) -> None:
    """Warn if all entries are numbers of single precision."""
    values = given.matrix.data
    if values.size < FEW or not np.array_equal(values, values.astype(np.float32)):
        return
    if np.array_equal(values * SHORT, np.rint(values * SHORT)):
        return
    warn(
        f"the stiffness in {given.source} has single precision, seven digits: answers lose as "
        "many digits as its "
        "condition number has. Write it in double precision",
        SceneWarning,
    )
