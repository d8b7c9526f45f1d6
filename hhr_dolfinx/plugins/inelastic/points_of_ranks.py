"""Inelastic bodies on several ranks: each updates the material, and assembles, in some of the
cells.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from mpi4py import MPI

from hhr_dolfinx.errors import ConvergenceError, class_of
from hhr_dolfinx.group import share
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.plugins.inelastic.law import InternalVariables
from hhr_dolfinx.plugins.inelastic.points import GaussPoints, Result
from hhr_dolfinx.plugins.inelastic.state import GaussState
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of


class PointsOfRanks(GaussPoints):
    """Gauss points of some of all cells on each rank, with neighbours on the same one."""

    def __init__(self, cells: int, per_cell: int, comm: MPI.Comm) -> None:
        shares = [share(cells, rank, comm.size) for rank in range(comm.size)]
        mine = shares[comm.rank]
        self.cells = slice(mine.start, mine.stop)
        self.points = slice(mine.start * per_cell, mine.stop * per_cell)
        self._counts = np.array([len(share) * per_cell for share in shares])
        self._comm = comm

    def largest(self, value: float) -> float:
        """See :class:`GaussPoints`; NaN counts as the largest."""
        values = np.array(self._comm.allgather(float(value)))
        return float(values.max())

    def total(self, value: float) -> float:
        """See :class:`GaussPoints`."""
        return float(sum(self._comm.allgather(float(value))))

    def every(self, true: bool) -> bool:
        """See :class:`GaussPoints`."""
        return all(self._comm.allgather(bool(true)))

    def agreed(self, work: Callable[[], Any]) -> Any:
        """See :class:`GaussPoints`; of different errors on the ranks all raise the same, so
        that none tries again alone.
        """
        value = failure = None
        try:
            value = work()
        except BaseException as error:  # after an interrupt too the other ranks would wait
            failure = error
        failures = self._comm.allgather(
            None if failure is None else (type(failure).__name__, str(failure))
        )
        failed = [(rank, *words) for rank, words in enumerate(failures) if words is not None]
        if not failed:
            return value
        rank, name, text = next(
            (failed_rank for failed_rank in failed if failed_rank[1] != ConvergenceError.__name__),
            failed[0],
        )
        if failure is not None and type(failure).__name__ == name:
            raise failure
        message = (
            f"updating the material failed on rank {rank} of {self._comm.size}, {name}: {text}"
        )
        raise class_of(name)(message) from failure

    def place(self, values: np.ndarray) -> int:
        """See :class:`GaussPoints`."""
        point = int(values.argmax())
        return self.worst(float(values[point]), self.points.start + point)

    def worst(self, size: float, what: Result) -> Result:
        """See :class:`GaussPoints`.

        Args:
            size: size on this rank.
            what: value of this rank.
        """
        return max(self._comm.allgather((float(size), what)), key=lambda pair: pair[0])[1]

    def own(self, answer: Answer) -> Answer:
        """See :class:`GaussPoints`."""
        return _mapped(answer, lambda part: np.asarray(part)[self.points])

    def whole(self, answer: Answer) -> Answer:
        """See :class:`GaussPoints`."""
        return _mapped(answer, self.gathered)

    def summed(self, part: np.ndarray) -> np.ndarray:
        """The sum of an array of all ranks."""
        total = np.empty_like(part)
        self._comm.Allreduce(part, total)
        return total

    def gathered(self, values: np.ndarray) -> np.ndarray:
        """See :class:`GaussPoints`."""
        width = values.shape[1:]
        array = np.empty((int(self._counts.sum()), *width))
        self._comm.Allgatherv(
            np.ascontiguousarray(values), (array, self._counts * int(np.prod(width)))
        )
        return array


def _mapped(answer: Answer, change: Callable[[np.ndarray], np.ndarray]) -> Answer:
    """An answer with other stress and state."""
    gauss = gauss_of(answer)
    return answer.remembering(
        gauss=GaussState(change(gauss.stress), InternalVariables(*map(change, gauss.state)))
    )
