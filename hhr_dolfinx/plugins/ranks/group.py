"""Several ranks: gathers and sums, and failures on which no rank waits for one that has failed.

A rank that raises leaves the section in which the others wait for it. If each rank works
independently, the failures are exchanged after the section, and all ranks raise. If the section is
collective, the other ranks may already be blocked in MPI; then the reason is printed and the whole
run is aborted.
"""

from __future__ import annotations

import re
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from threading import Event
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_matrix, vstack

from hhr_dolfinx.errors import RankError, class_of
from hhr_dolfinx.group import ProcessGroup, T, share
from hhr_dolfinx.plugins.ranks.rows import RowsOfRanks
from hhr_dolfinx.plugins.ranks.shared import SharedCholesky

if TYPE_CHECKING:
    from mpi4py.MPI import Comm, Request

    from hhr_dolfinx.linear.sparse import FreeCholesky
    from hhr_dolfinx.scene import Scene

FAILURE_SECONDS = 3.0
"""Seconds for which a rank that failed in a collective section waits for the others to fail as
well.
"""

_POLL = 0.02
_FORWARDED = 1.0
EQUAL_ON_RANKS = 1e-12
"""Relative difference of values up to which requests of ranks are the same: machines may differ in
last digits.
"""
_SHOWN = 60
_END: Any = object()


class Ranks(ProcessGroup):
    """The ranks of a communicator, the tool ``group``: see
    :class:`~hhr_dolfinx.group.ProcessGroup`."""

    def __init__(self, comm: Comm):
        super().__init__(comm)
        self.size = comm.size
        self.number = comm.rank

    def gathered(self, value: T) -> list[T]:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`."""
        values: list[T] = self.comm.allgather(value)
        return values

    def joined(self, values: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`."""
        return np.concatenate(self.comm.allgather(values))

    def stacked(self, rows: csr_matrix) -> csr_matrix:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`."""
        return csr_matrix(vstack(self.comm.allgather(rows)))

    def total(self, value: T) -> T:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`."""
        return self.comm.allreduce(value)

    def from_first(self, value: T) -> T:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`."""
        return self.comm.bcast(value)

    @contextmanager
    def each(self, task: str) -> Iterator[None]:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`.

        The rank that failed raises its exception. The others raise one of the same class if it
        belongs to this package, else :class:`~hhr_dolfinx.errors.RankError`. Exceptions are
        exchanged as text: not all of them can be pickled.
        """
        failure = None
        try:
            yield
        except BaseException as error:  # SystemExit too would leave the others waiting
            failure = error
        self._exchanged(task, failure, None)

    def _exchanged(self, task: str, failure: BaseException | None, value: T) -> list[T]:
        """Value of each rank; if one has failed, all raise."""
        words = None if failure is None else (type(failure).__name__, _text(failure))
        reports = self.comm.allgather((words, value))
        if failure is not None:
            raise failure
        for rank, (words, _) in enumerate(reports):
            if words is not None:
                raise class_of(words[0])(
                    f"{task} failed on rank {rank} of {self.size}, {words[0]}: {words[1]}"
                )
        return [value for _, value in reports]

    def agreed(self, task: str, call: Callable[[], list[str | np.ndarray]]) -> None:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`.

        Args:
            task: name of the task, for messages.
            call: function that returns the words and values to compare.

        Raises:
            RankError: on all ranks, if their requests differ.
        """
        failure = None
        request: list[str | np.ndarray] = []
        try:
            request = [
                _without_addresses(entry) if isinstance(entry, str) else entry for entry in call()
            ]
        except BaseException as error:
            failure = error
        requests = self._exchanged(task, failure, request)
        odd = next(
            (rank for rank, request in enumerate(requests) if not _same(request, requests[0])), None
        )
        if odd is not None:
            raise RankError(
                f"{task}: requests of ranks differ: rank 0 requests "
                f"{_shown(requests[0], requests[odd])} and rank {odd} requests "
                f"{_shown(requests[odd], requests[0])}. Ask the same on all ranks that work on it "
                "together, or let each have a separate full model: FullOrderModel(scene, "
                "MPI.COMM_SELF)"
            )

    def in_step(self, items: Callable[[], Iterable[T]], task: str) -> Iterator[T]:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`.

        Args:
            items: function that returns the values to iterate over.
            task: name of the task, for messages.

        Raises:
            RankError: on all ranks, if the iteration ends on some of them only.
        """
        with self.each(task):
            iterator = iter(items())
        while True:
            failure = None
            value = _END
            try:
                value = next(iterator, _END)
            except BaseException as error:
                failure = error
            ended = self._exchanged(task, failure, value is _END)
            if all(ended):
                return
            if any(ended):
                raise RankError(
                    f"{task} ends on rank {ended.index(True)} of {self.size}, and goes on on others"
                )
            yield value

    @contextmanager
    def together(self, task: str) -> Iterator[None]:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`.

        An error on every rank is raised on every rank.
        """
        # a separate communicator, so that votes do not mix with messages of the block
        votes = self.comm.Dup()
        try:
            yield
        except BaseException as error:
            if not _arrives(votes.Ibarrier()):
                reason = (
                    f"{task} failed on rank {self.number} of {self.size}, and the others wait for "
                    f"it: the run is ended on all ranks. {type(error).__name__}: {_text(error)}"
                )
                self._abort(f"{reason}\n{traceback.format_exc()}{reason}", 1)
            votes.Free()
            raise
        votes.Free()

    def ending(self, task: str) -> Callable[[int, str], bool]:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`."""
        votes = self.comm.Dup()

        def end(code: int, words: str) -> bool:
            """End with an exit ``code`` and last ``words``; True on the rank that prints them."""
            codes = np.zeros(self.size, dtype=np.int32)
            arrival = votes.Iallgather(np.array([code], dtype=np.int32), codes)
            if not code:
                arrival.Wait()
            elif not _arrives(arrival):
                reason = (
                    f"{task} failed on rank {self.number} of {self.size}, and the others wait for "
                    "it: it is ended"
                )
                self._abort(f"{words}\n{reason}", code)
            votes.Free()
            return bool(code and not codes[: self.number].any())

        return end

    def _abort(self, words: str, code: int) -> None:
        print(words, file=sys.stderr, flush=True)
        # a launcher forwards output with a delay, and drops it when the run is aborted
        Event().wait(_FORWARDED)
        self.comm.Abort(code)

    def shared_out(self, count: int, work: Callable[[int], T], task: str) -> list[T]:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`.

        Args:
            count: number of tasks.
            work: function that does a task by its number.
            task: name of the task, for messages.
        """
        with self.each(task):
            results = [work(number) for number in share(count, self.number, self.size)]
        return [result for block in self.comm.allgather(results) for result in block]

    def no_room_side_by_side(self, scene: Scene) -> str:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`."""
        from hhr_dolfinx.plugins.ranks.sharing import no_room_side_by_side

        return no_room_side_by_side(scene, self)

    def shared_factors(
        self, factors: FreeCholesky, rows: slice, own: csr_matrix, whole: csr_matrix
    ) -> SharedCholesky:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`.

        Args:
            factors: factors of the local rows.
            rows: range of the local rows.
            own: local rows of the matrix, (own, N).
            whole: the matrix, (N, N).
        """
        return SharedCholesky(factors, rows, own, whole, self.comm)

    def factors(
        self,
        matrix: csr_matrix,
        free: np.ndarray,
        scene: str,
        *,
        low_rank: float | None,
        last: np.ndarray | None,
        rows: slice | None = None,
    ) -> SharedCholesky:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`.

        Args:
            matrix: the matrix, (N, N).
            free: dofs that are not imposed, (N,) bool.
            scene: name of the scene, for messages.
            low_rank: precision of compressed blocks; None for exact factors.
            last: dofs between which the inverse is needed, increasing, (n,); None for none.
            rows: range of the local rows; None for equal shares.
        """
        return SharedCholesky.of(
            matrix, free, scene, self.comm, low_rank=low_rank, last=last, rows=rows
        )

    def rows(self, own: slice, count: int) -> RowsOfRanks:
        """See :class:`~hhr_dolfinx.group.ProcessGroup`.

        Args:
            own: range of the local rows.
            count: number of all rows.
        """
        return RowsOfRanks(own, count, self.comm)


def _arrives(arrival: Request) -> bool:
    """True if every rank takes part within :data:`FAILURE_SECONDS`."""
    pause = Event()
    for _ in range(int(FAILURE_SECONDS / _POLL)):
        if arrival.Test():
            return True
        pause.wait(_POLL)
    return False


def _without_addresses(text: str) -> str:
    """Words of an object without addresses in memory, which differ between ranks."""
    return re.sub(r" at 0x[0-9a-f]+", "", text)


def _same(request: list[str | np.ndarray], expected: list[str | np.ndarray]) -> bool:
    """True for equal words, and values that are equal to :data:`EQUAL_ON_RANKS`."""
    if len(request) != len(expected):
        return False
    for mine, theirs in zip(request, expected, strict=True):
        if isinstance(mine, str) or isinstance(theirs, str):
            if not (isinstance(mine, str) and isinstance(theirs, str) and mine == theirs):
                return False
        elif mine.shape != theirs.shape or not np.allclose(
            mine, theirs, rtol=EQUAL_ON_RANKS, atol=0.0, equal_nan=True
        ):
            return False
    return True


def _shown(request: list[str | np.ndarray], expected: list[str | np.ndarray]) -> str:
    """Words of the request of a rank, and the first other difference if these are equal."""
    words = str(request[0])
    if words != str(expected[0]) or len(request) != len(expected):
        return words
    for mine, theirs in zip(request[1:], expected[1:], strict=True):
        if _same([mine], [theirs]):
            continue
        if isinstance(mine, str) and isinstance(theirs, str):
            first = next(
                (k for k, (a, b) in enumerate(zip(mine, theirs, strict=False)) if a != b), 0
            )
            return f"{words} with '{mine[max(first - _SHOWN, 0) : first + _SHOWN]}'"
        if isinstance(mine, str) or isinstance(theirs, str) or mine.shape != theirs.shape:
            return f"{words} with {np.shape(mine)} values"
        first = int(
            np.flatnonzero(
                ~np.isclose(mine, theirs, rtol=EQUAL_ON_RANKS, atol=0.0, equal_nan=True)
            )[0]
        )
        return f"{words} with {mine.ravel()[first]:.15g} as value {first} of {mine.size}"
    return words


def _text(error: BaseException) -> str:
    try:
        return str(error)
    except Exception:
        return "(its message could not be made)"
