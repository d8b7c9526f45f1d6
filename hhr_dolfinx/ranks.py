"""Failures on several ranks: no rank waits for one that is gone.

A rank that raises leaves the section in which the others wait for it. Where each rank works for itself, the failures
are shared behind the section, and all ranks raise. Where the ranks work together the others may be blocked in MPI
already; then the reason is printed and the whole run ended.
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
"""Seconds for which a rank that failed in common work waits for the others to fail as well."""

_POLL = 0.02
_FORWARDED = 1.0


_LAUNCHERS = ("PMI_SIZE", "PMIX_RANK", "OMPI_COMM_WORLD_SIZE", "MPI_LOCALNRANKS", "SLURM_STEP_NUM_TASKS")
"""Variables of the environment by which launchers tell their processes that there are several."""


def world() -> Comm | None:
    """All ranks that a launcher started; None for a process by itself, which needs no MPI and does not load it."""
    if "mpi4py.MPI" not in sys.modules and not any(name in os.environ for name in _LAUNCHERS):
        return None
    try:
        from mpi4py import MPI
    except ImportError:
        return None
    return MPI.COMM_WORLD


def share(count: int, number: int, parts: int) -> range:
    """Places that one of several workers takes of ``count``, neighbours together; its number counts from 0."""
    each, more = divmod(count, parts)
    first = number * each + min(number, more)
    return range(first, first + each + (number < more))


@contextmanager
def each_for_itself(comm: Comm, task: str) -> Iterator[None]:
    """Run a block that each rank works through alone; if it fails on any rank, all ranks raise.

    The rank that failed raises its own exception. The others raise one of the same class if that is one of this
    package's, and :class:`errors.RankError` if not. Exceptions are told as text: not all of them can be pickled.
    """
    failure = None
    try:
        yield
    except BaseException as error:  # an exit too would leave the others waiting
        failure = error
    if comm.size > 1:
        told = comm.allgather(None if failure is None else (type(failure).__name__, _text(failure)))
        failed = [(rank, *words) for rank, words in enumerate(told) if words is not None]
    if failure is not None:
        raise failure
    if comm.size > 1 and failed:
        rank, name, text = failed[0]
        raise class_of(name)(f"{task} failed on rank {rank} of {comm.size}, {name}: {text}")


def shared_out(comm: Comm, count: int, work: Callable[[int], Any], task: str) -> list[Any]:
    """What the ranks make of so many pieces of work, a part of them each; all of it on every rank. Collective.

    Raises:
        HHRError: on all ranks, if a piece failed on one of them, see :func:`each_for_itself`.
    """
    if comm.size == 1:
        return [work(number) for number in range(count)]
    with each_for_itself(comm, task):
        own = [work(number) for number in share(count, comm.rank, comm.size)]
    return [item for part in comm.allgather(own) for item in part]


@contextmanager
def together(comm: Comm, task: str) -> Iterator[None]:
    """Run a block in which the ranks wait for each other; if it fails on some ranks only, end the run on all.

    What fails on every rank alike, a scene that cannot be built for instance, is raised on every rank.
    """
    if comm.size == 1:
        yield
        return
    # votes must not meet what the block itself sends
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
            # a launcher forwards what is printed a little later, and forgets it once the run is ended
            Event().wait(_FORWARDED)
            comm.Abort(1)
        votes.Free()
        raise
    votes.Free()


def _all_arrive(votes: Comm) -> bool:
    """Whether every rank comes here within :data:`PATIENCE`."""
    arrival = votes.Ibarrier()
    pause = Event()
    for _ in range(int(PATIENCE / _POLL)):
        if arrival.Test():
            return True
        pause.wait(_POLL)
    return False


def class_of(name: str) -> type[errors.HHRError]:
    """The class of this package's errors with a name, or the one for all others."""
    kind = getattr(errors, name, None)
    return kind if isinstance(kind, type) and issubclass(kind, errors.HHRError) else errors.RankError


def _text(error: BaseException) -> str:
    """What an exception says, even if it cannot say it."""
    try:
        return str(error)
    except Exception:
        return "(its message could not be made)"
