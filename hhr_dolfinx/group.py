"""Processes that work on a problem together: one by itself, or, by the plug-in with the tool
``group``, several.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from hhr_dolfinx import registry

if TYPE_CHECKING:
    from mpi4py.MPI import Comm
    from scipy.sparse import csr_matrix


T = TypeVar("T")

_LAUNCHERS = (
    "PMI_SIZE",
    "PMIX_RANK",
    "OMPI_COMM_WORLD_SIZE",
    "MPI_LOCALNRANKS",
    "SLURM_STEP_NUM_TASKS",
)
"""Environment variables that launchers set for their processes."""


def world() -> Comm | None:
    """Communicator of all processes that a launcher started.

    None for a single process, which does not load MPI.
    """
    if "mpi4py.MPI" not in sys.modules and not any(name in os.environ for name in _LAUNCHERS):
        return None
    try:
        from mpi4py import MPI
    except ImportError:
        return None
    return MPI.COMM_WORLD


def share(count: int, number: int, parts: int) -> range:
    """Contiguous share of indices for one of several workers.

    Args:
        count: number of the indices.
        number: number of the worker, from 0.
        parts: number of workers.
    """
    each, more = divmod(count, parts)
    first = number * each + min(number, more)
    return range(first, first + each + (number < more))


class ProcessGroup:
    """One process, with the communicator that DOLFINx and PETSc get; all methods are collective."""

    size: int = 1  #: number of processes
    number: int = 0  #: number of this process, from 0

    def __init__(self, comm: Comm | None = None):
        self.comm: Comm = comm  # the communicator

    def gathered(self, value: T) -> list[T]:
        """Value of each process, on all of them."""
        return [value]

    def joined(self, values: np.ndarray) -> np.ndarray:
        """Arrays of all processes, concatenated."""
        return values

    def stacked(self, rows: csr_matrix) -> csr_matrix:
        """Rows of a matrix of all processes."""
        return rows

    def total(self, value: T) -> T:
        """Sum over the processes."""
        return value

    def from_first(self, value: T) -> T:
        """Value of the first process, on all of them; the others may give anything."""
        return value

    def each(self, task: str) -> AbstractContextManager[None]:
        """Run a block that each process executes independently; if it fails on one, all raise."""
        return nullcontext()

    def together(self, task: str) -> AbstractContextManager[None]:
        """Run a collective block; if it fails on some processes only, the run is ended on all."""
        return nullcontext()

    def agreed(self, task: str, call: Callable[[], list[str | np.ndarray]]) -> None:
        """Compare the requests of all processes.

        Args:
            task: description of the request for the message.
            call: returns words of the request, then its values, or refuses.

        Raises:
            RankError: on all processes, if their requests differ.
        """

    def in_step(self, items: Callable[[], Iterable[T]], task: str) -> Iterator[T]:
        """Iterate over the same items on all processes.

        If code of the user that wraps them fails on one process, all raise.

        Args:
            items: returns the items.
            task: description of the work for the message.
        """
        return iter(items())

    def ending(self, task: str) -> Callable[[int, str], bool]:
        """Prepare the end of a program, of which each process calls the result with its exit code
        and last words.

        It returns True to the process that says its words, and ends the others if they wait for one
        that has failed.
        """
        return lambda code, words: True

    def shared_out(self, count: int, work: Callable[[int], T], task: str) -> list[T]:
        """Distribute tasks, and gather all results on every process.

        Args:
            count: number of the tasks.
            work: does the task of a number.
            task: description of the work for the message.
        """
        return [work(number) for number in range(count)]

    def no_room_side_by_side(self, scene: Any) -> str:
        """Reason why full models, one for each process, exceed the memory of a machine.

        Empty if they fit.
        """
        return ""

    def shared_factors(self, factors: Any, rows: slice, own: csr_matrix, whole: csr_matrix) -> Any:
        """Factors of a matrix of which each process has all rows.

        Args:
            factors: factors of one process.
            rows: rows of the share of this process.
            own: these rows of the matrix.
            whole: all rows of the matrix.
        """
        return factors

    def factors(
        self,
        matrix: csr_matrix,
        free: np.ndarray,
        scene: str,
        *,
        low_rank: float | None,
        last: np.ndarray | None,
        rows: slice | None = None,
    ) -> Any:
        """``FreeCholesky`` that the processes share, of a matrix of which each has all rows.

        Args:
            matrix: all rows of the matrix, (N, N).
            free: True for dofs with an unknown, (N,) bool.
            scene: name of the scene, for options of PETSc.
            low_rank: tolerance of compressed factors; None for whole ones.
            last: dofs to eliminate last; None for none.
            rows: rows of the share of this process; equal shares by default.

        Raises:
            NotImplementedError: for a single process, which makes its own.
        """
        raise NotImplementedError  # one process makes its own

    def rows(self, own: slice, count: int) -> Any:
        """``Rows`` of tables of which each process has some rows.

        Args:
            own: rows of this process.
            count: number of all rows.

        Raises:
            NotImplementedError: for a single process, which has all rows.
        """
        raise NotImplementedError  # one process has all rows


ALONE = ProcessGroup()


def group_of(comm: Comm | ProcessGroup) -> ProcessGroup:
    """The processes of a communicator, or a group itself.

    NotOfferedError for several that no plug-in serves.
    """
    if isinstance(comm, ProcessGroup):
        return comm
    if comm.size == 1:
        return ProcessGroup(comm)
    several: ProcessGroup = registry.tool("group", f"work on {comm.size} ranks")(comm)
    return several


def launched() -> ProcessGroup:
    """All processes that a launcher started; each is alone if no plug-in serves several."""
    comm = world()
    return (
        ALONE
        if comm is None or (comm.size > 1 and registry.offered("group") is None)
        else group_of(comm)
    )
