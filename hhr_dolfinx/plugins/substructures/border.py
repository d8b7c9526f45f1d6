"""The border between the rows that each rank eliminates: its rows, and dense factors of its Schur
complement.

Bodies that only contact connects have no entries in common: the border then has several parts. One
rank factors each.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

SENT = 2_000_000
"""Numbers in one message between ranks, 16 MB."""


@dataclass(frozen=True)
class BorderPart:
    """A connected part of the border, which the rank ``owner`` factors.

    Its first ``common`` rows are those that ranks share.
    """

    rows: slice
    common: int
    owner: int

    @property
    def size(self) -> int:
        """Number of rows."""
        return self.rows.stop - self.rows.start


@dataclass(frozen=True)
class Border:
    """Rows that no rank eliminates by itself; all but ``part_of`` is the same on all ranks."""

    numbers: np.ndarray  #: row numbers in the matrix, in the order of the border, (b,)
    place: (
        np.ndarray
    )  #: index in this order of each row of the matrix; -1 outside of the border, (n,)
    parts: tuple[BorderPart, ...]  #: connected components of the border
    inverted: (
        np.ndarray
    )  #: indices in the border of the rows between which K^-1 is needed, by increasing row number
    part_of: (
        np.ndarray
    )  #: part to which each local row outside of the border is connected; -1 for none


def border_of(rows: csr_matrix, first: int, last: np.ndarray, comm: Comm) -> Border:
    """Border of a matrix with distributed rows.

    Collective.

    Args:
        rows: local rows of the matrix, (own, n).
        first: number of the first one.
        last: local rows between which K^-1 is needed, increasing.
        comm: ranks of the matrix.
    """
    common = np.setdiff1d(_coupled(rows, first, comm), last)
    ends = np.concatenate(comm.allgather(first + last))
    numbers = np.concatenate([*comm.allgather(first + common), ends])
    inverted = np.zeros(numbers.size, dtype=bool)
    inverted[numbers.size - ends.size :] = True
    component, component_of_row = _connected(rows, first, numbers, comm)
    names, part_of = np.unique(component, return_inverse=True)
    order = np.lexsort([numbers, inverted, part_of])
    numbers = numbers[order]
    inverted = inverted[order]
    part_of = part_of[order]
    padded_names = np.append(names, -1)
    indices = np.searchsorted(names, component_of_row)
    inside_of = np.where(padded_names[indices] == component_of_row, indices, -1)
    position = np.full(rows.shape[1], -1)
    position[numbers] = np.arange(numbers.size)
    starts = np.searchsorted(part_of, np.arange(part_of.max(initial=-1) + 2))
    spans = [slice(int(start), int(stop)) for start, stop in pairwise(starts)]
    owners = _owners([span.stop - span.start for span in spans], comm.size)
    counts = [int(np.count_nonzero(~inverted[span])) for span in spans]
    components = tuple(BorderPart(*fields) for fields in zip(spans, counts, owners, strict=True))
    return Border(numbers, position, components, position[ends], inside_of)


def _owners(sizes: list[int], ranks: int) -> list[int]:
    """Ranks that factor parts of given sizes, with balanced work."""
    work = np.zeros(ranks)
    owners = [0] * len(sizes)
    for number in np.argsort(sizes)[::-1]:
        owners[number] = int(np.argmin(work))
        work[owners[number]] += float(sizes[number]) ** 3
    return owners


def _connected(
    rows: csr_matrix, first: int, border: np.ndarray, comm: Comm
) -> tuple[np.ndarray, np.ndarray]:
    """Connected component of each row of the border, (b,), and of each local row outside of it.

    Collective.
    """
    count_own, size = rows.shape
    position = np.full(size, -1)
    position[border] = np.arange(border.size)
    on_border = position[first : first + count_own] >= 0
    # own rows of the border are not connected here: their couplings connect them
    inner = rows[~on_border]
    numbers = np.full(size, -1)
    numbers[first + np.flatnonzero(~on_border)] = np.arange(inner.shape[0])
    numbers[border] = inner.shape[0] + np.arange(border.size)
    count = inner.shape[0] + border.size
    starts = np.append(inner.indptr, np.full(border.size, inner.nnz, dtype=inner.indptr.dtype))
    graph = csr_matrix(
        (np.ones(inner.nnz, dtype=bool), numbers[inner.indices], starts), shape=(count, count)
    )
    _, labels = connected_components(graph, directed=False)
    edges = rows[on_border].tocoo()
    between = position[edges.col] >= 0
    pairs = np.stack(
        [
            position[first + np.flatnonzero(on_border)][edges.row[between]],
            position[edges.col[between]],
        ]
    )
    own_labels = int(labels.max(initial=-1)), labels[inner.shape[0] :]
    received = comm.allgather((*own_labels, np.unique(pairs, axis=1)))
    # labels of the same rows are merged by a vertex for each label of each rank
    ends = []
    bases = [border.size]
    for highest, labels_of_border, (edge_start, edge_end) in received:
        ends += [(np.arange(border.size), bases[-1] + labels_of_border), (edge_start, edge_end)]
        bases.append(bases[-1] + highest + 1)
    left_end, right = (np.concatenate(side) for side in zip(*ends, strict=True))
    graph_of_ranks = coo_matrix(
        (np.ones(left_end.size, dtype=bool), (left_end, right)), shape=(bases[-1], bases[-1])
    )
    _, labels_of_all = connected_components(graph_of_ranks, directed=False)
    return labels_of_all[: border.size], labels_of_all[bases[comm.rank] + labels[: inner.shape[0]]]


def _coupled(rows: csr_matrix, first: int, comm: Comm) -> np.ndarray:
    """Local rows of a small set that contains one row of each pair coupled across ranks.

    Collective.
    """
    starts = np.array([*comm.allgather(first), rows.shape[1]])
    after = rows.indices >= first + rows.shape[0]
    of_row = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
    received = comm.gather((first + of_row[after], rows.indices[after]))
    covering = np.zeros(0, dtype=np.int64)
    if received is not None:
        for rank, (local, remote) in enumerate(received):
            for later in range(rank + 1, comm.size):
                uncovered = (remote >= starts[later]) & (remote < starts[later + 1])
                uncovered &= ~np.isin(local, covering) & ~np.isin(remote, covering)
                covering = np.union1d(covering, _cover(local[uncovered], remote[uncovered]))
    covering = comm.bcast(covering)
    return covering[(covering >= first) & (covering < first + rows.shape[0])] - first


def _cover(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Minimum vertex cover of a bipartite graph, by the theorem of Koenig.

    The graph is given by its edges, (k,).
    """
    if not one.size:
        return one
    lefts, left_vertex = np.unique(one, return_inverse=True)
    rights, right = np.unique(other, return_inverse=True)
    edges = csr_matrix(
        (np.ones(left_vertex.size, dtype=bool), (left_vertex, right)),
        shape=(lefts.size, rights.size),
    )
    matched = maximum_bipartite_matching(edges, perm_type="column")  # right vertex of each left one
    partner = np.full(rights.size, -1)
    partner[matched[matched >= 0]] = np.flatnonzero(matched >= 0)
    # reached by alternating paths from left vertices without a partner
    reached = matched < 0
    front = reached.copy()
    met = np.zeros(rights.size, dtype=bool)
    while front.any():
        new = (front @ edges).astype(bool) & ~met
        met |= new
        back = partner[new]
        front = np.zeros(lefts.size, dtype=bool)
        front[back[back >= 0]] = True
        front &= ~reached
        reached |= front
    return np.concatenate([lefts[~reached], rights[met]])


def gathered(
    part: BorderPart, reach: np.ndarray, left: np.ndarray, comm: Comm
) -> np.ndarray | None:
    """Sum of the Schur complements of all ranks on a part, (size, size).

    Collective. Only upper triangles are valid.

    Args:
        part: the part of the border.
        reach: increasing indices in the part, (r,).
        left: Schur complement of this rank at these indices, (r, r).
        comm: ranks of the matrix.

    Returns:
        The sum; None on ranks that do not own the part.
    """
    reaches = comm.gather(reach, part.owner)
    if reaches is None:
        for block in _blocks(reach.size):
            comm.Send(np.ascontiguousarray(left[block, block.start :]), part.owner)
        return None
    total = np.zeros((part.size, part.size))
    for rank, indices in enumerate(reaches):
        for block in _blocks(indices.size):
            if rank == comm.rank:
                block_values = left[block, block.start :]
            else:
                block_values = np.empty((block.stop - block.start, indices.size - block.start))
                comm.Recv(block_values, rank)
            total[np.ix_(indices[block], indices[block.start :])] += block_values
    return total


def _blocks(count: int) -> list[slice]:
    height = max(SENT // max(count, 1), 1)
    return [slice(first, min(first + height, count)) for first in range(0, count, height)]


class DenseFactors:
    """Cholesky factors of the Schur complement on a part of the border.

    They are those of its upper triangle, which is overwritten.

    The inverse is needed after the first ``common`` rows. Unless the matrix is ``definite``, no
    method may be called.
    """

    def __init__(self, upper: np.ndarray, common: int):
        self._factors, failed = dpotrf(upper.T, lower=1, clean=0, overwrite_a=1)
        self.definite = not failed
        self._common = common

    def solve(self, loads: np.ndarray) -> np.ndarray:
        """Solve for some loads, (size, k)."""
        solutions, _ = dpotrs(self._factors, loads, lower=1)
        return solutions

    def inverse(self) -> np.ndarray:
        """K^-1 between the rows after the ``common`` ones, (n, n)."""
        inverse, _ = dpotri(self._factors[self._common :, self._common :], lower=1)
        for row in range(len(inverse)):  # in place, since it may be large
            inverse[row, row + 1 :] = inverse[row + 1 :, row]
        return inverse
