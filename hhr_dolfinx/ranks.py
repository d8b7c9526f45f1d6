"""Failures on several ranks: no rank waits for one that has failed.

If each rank works independently, failures are exchanged after the section, and all ranks raise. If the section is
collective, other ranks may already be blocked in MPI; then the reason is printed and the whole run is aborted.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event
from typing import TYPE_CHECKING, Any

from hhr_dolfinx import errors

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

PATIENCE = 3.0
"""Seconds for which a rank that failed in a collective section waits for the others to fail as well."""

_POLL = 0.02
_FORWARDED = 1.0


_LAUNCHERS = ("PMI_SIZE", "PMIX_RANK", "OMPI_COMM_WORLD_SIZE", "MPI_LOCALNRANKS", "SLURM_STEP_NUM_TASKS")
"""Environment variables that launchers set for their processes."""


def world() -> Comm | None:
    """Communicator of all ranks that a launcher started; None for a single process, which does not load MPI."""
    if "mpi4py.MPI" not in sys.modules and not any(name in os.environ for name in _LAUNCHERS):
        return None
    try:
        from mpi4py import MPI
    except ImportError:
        return None
    return MPI.COMM_WORLD


def share(count: int, number: int, parts: int) -> range:
    """Contiguous share of ``count`` indices for one of ``parts`` workers, with numbers from 0."""
    each, more = divmod(count, parts)
    first = number * each + min(number, more)
    return range(first, first + each + (number < more))


@contextmanager
def each_for_itself(comm: Comm, task: str) -> Iterator[None]:
    """Run a block that each rank executes independently; if it fails on any rank, all ranks raise.

    The others raise an exception of the same class if it belongs to this package, else :class:`errors.RankError`.
    Exceptions are exchanged as text, since not all of them can be pickled.
    """
    failure = None
    try:
        yield
    except BaseException as error:  # SystemExit too would leave the others waiting
        failure = error
    if comm.size > 1:
        failures = comm.allgather(None if failure is None else (type(failure).__name__, _text(failure)))
        failed = [(rank, *words) for rank, words in enumerate(failures) if words is not None]
    if failure is not None:
        raise failure
    if comm.size > 1 and failed:
        rank, name, text = failed[0]
        raise class_of(name)(f"{task} failed on rank {rank} of {comm.size}, {name}: {text}")


def shared_out(comm: Comm, count: int, work: Callable[[int], Any], task: str) -> list[Any]:
    """Results of ``count`` tasks that the ranks share, on all of them; see :func:`each_for_itself`. Collective."""
    if comm.size == 1:
        return [work(number) for number in range(count)]
    with each_for_itself(comm, task):
        own = [work(number) for number in share(count, comm.rank, comm.size)]
    return [item for part in comm.allgather(own) for item in part]


@contextmanager
def together(comm: Comm, task: str) -> Iterator[None]:
    """Run a collective block; an error on every rank is raised on every rank, one on some ranks aborts the run."""
    if comm.size == 1:
        yield
        return
    # a separate communicator, so that votes do not mix with messages of the block
    votes = comm.Dup()
    try:
        yield
    except BaseException as error:
        if not _all_arrive(votes):
            reason = (
                f"{task} failed on rank {comm.rank} of {comm.size}, and the others wait for it: the run is ended "
                f"on all ranks. {type(error).__name__}: {_text(error)}"
            )
            print(f"{reason}\n{traceback.format_exc()}{reason}", file=sys.stderr, flush=True)
            # a launcher forwards output with a delay, and drops it when the run is aborted
            Event().wait(_FORWARDED)
            comm.Abort(1)
        votes.Free()
        raise
    votes.Free()


def _all_arrive(votes: Comm) -> bool:
    """True if every rank arrives within :data:`PATIENCE`."""
    arrival = votes.Ibarrier()
    pause = Event()
    for _ in range(int(PATIENCE / _POLL)):
        if arrival.Test():
            return True
        pause.wait(_POLL)
    return False


def class_of(name: str) -> type[errors.HHRError]:
    """Error class of this package with a name, or :class:`errors.RankError`."""
    kind = getattr(errors, name, None)
    return kind if isinstance(kind, type) and issubclass(kind, errors.HHRError) else errors.RankError


def _text(error: BaseException) -> str:
    try:
        return str(error)
    except Exception:
        return "(its message could not be made)"
