"""Several ranks: gathers and sums, and failures on which no rank waits for one that has failed.

A rank that raises leaves the section in which the others wait for it. If each rank works independently, the failures
are exchanged after the section, and all ranks raise. If the section is collective, the other ranks may already be
blocked in MPI; then the reason is printed and the whole run is aborted.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_matrix, vstack

from hhr_dolfinx.errors import class_of
from hhr_dolfinx.group import Group, share
from hhr_dolfinx.plugins.ranks.rows import RowsOfRanks
from hhr_dolfinx.plugins.ranks.shared import SharedCholesky

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.linear.sparse import FreeCholesky
    from hhr_dolfinx.scene import Scene

PATIENCE = 3.0
"""Seconds for which a rank that failed in a collective section waits for the others to fail as well."""

_POLL = 0.02
_FORWARDED = 1.0


class Ranks(Group):
    """The ranks of a communicator, the tool ``group``: see :class:`~hhr_dolfinx.group.Group`."""

    def __init__(self, comm: Comm):
        super().__init__(comm)
        self.size = comm.size
        self.number = comm.rank

    def gathered(self, value: Any) -> list[Any]:
        """See :class:`~hhr_dolfinx.group.Group`."""
        found: list[Any] = self.comm.allgather(value)
        return found

    def joined(self, values: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.group.Group`."""
        return np.concatenate(self.comm.allgather(values))

    def stacked(self, rows: csr_matrix) -> csr_matrix:
        """See :class:`~hhr_dolfinx.group.Group`."""
        return csr_matrix(vstack(self.comm.allgather(rows)))

    def total(self, value: Any) -> Any:
        """See :class:`~hhr_dolfinx.group.Group`."""
        return self.comm.allreduce(value)

    def from_first(self, value: Any) -> Any:
        """See :class:`~hhr_dolfinx.group.Group`."""
        return self.comm.bcast(value)

    @contextmanager
    def each(self, task: str) -> Iterator[None]:
        """See :class:`~hhr_dolfinx.group.Group`.

        The rank that failed raises its exception. The others raise one of the same class if it belongs to this package,
        else :class:`~hhr_dolfinx.errors.RankError`. Exceptions are exchanged as text: not all of them can be pickled.
        """
        failure = None
        try:
            yield
        except BaseException as error:  # SystemExit too would leave the others waiting
            failure = error
        failures = self.comm.allgather(None if failure is None else (type(failure).__name__, _text(failure)))
        failed = [(rank, *words) for rank, words in enumerate(failures) if words is not None]
        if failure is not None:
            raise failure
        if failed:
            rank, name, text = failed[0]
            raise class_of(name)(f"{task} failed on rank {rank} of {self.size}, {name}: {text}")

    @contextmanager
    def together(self, task: str) -> Iterator[None]:
        """See :class:`~hhr_dolfinx.group.Group`; an error on every rank is raised on every rank."""
        # a separate communicator, so that votes do not mix with messages of the block
        votes = self.comm.Dup()
        try:
            yield
        except BaseException as error:
            if not _all_arrive(votes):
                reason = (
                    f"{task} failed on rank {self.number} of {self.size}, and the others wait for it: the run is ended "
                    f"on all ranks. {type(error).__name__}: {_text(error)}"
                )
                print(f"{reason}\n{traceback.format_exc()}{reason}", file=sys.stderr, flush=True)
                # a launcher forwards output with a delay, and drops it when the run is aborted
                Event().wait(_FORWARDED)
                self.comm.Abort(1)
            votes.Free()
            raise
        votes.Free()

    def shared_out(self, count: int, work: Callable[[int], Any], task: str) -> list[Any]:
        """See :class:`~hhr_dolfinx.group.Group`."""
        with self.each(task):
            own = [work(number) for number in share(count, self.number, self.size)]
        return [item for part in self.comm.allgather(own) for item in part]

    def no_room_side_by_side(self, scene: Scene) -> str:
        """See :class:`~hhr_dolfinx.group.Group`."""
        from hhr_dolfinx.plugins.ranks.sharing import no_room_side_by_side

        return no_room_side_by_side(scene, self)

    def shared_factors(self, factors: FreeCholesky, rows: slice, own: csr_matrix, whole: csr_matrix) -> SharedCholesky:
        """See :class:`~hhr_dolfinx.group.Group`."""
        return SharedCholesky(factors, rows, own, whole, self.comm)

    def factors(
        self, matrix: csr_matrix, free: np.ndarray, scene: str, *, low_rank: float | None, last: np.ndarray | None,
        rows: slice | None = None,
    ) -> SharedCholesky:  # fmt: skip
        """See :class:`~hhr_dolfinx.group.Group`."""
        return SharedCholesky.of(matrix, free, scene, self.comm, low_rank=low_rank, last=last, rows=rows)

    def rows(self, own: slice, count: int) -> RowsOfRanks:
        """See :class:`~hhr_dolfinx.group.Group`."""
        return RowsOfRanks(own, count, self.comm)


def _all_arrive(votes: Comm) -> bool:
    """True if every rank arrives within :data:`PATIENCE`."""
    arrival = votes.Ibarrier()
    pause = Event()
    for _ in range(int(PATIENCE / _POLL)):
        if arrival.Test():
            return True
        pause.wait(_POLL)
    return False


def _text(error: BaseException) -> str:
    try:
        return str(error)
    except Exception:
        return "(its message could not be made)"
