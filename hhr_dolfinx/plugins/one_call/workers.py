"""Parallel search: ranks solve for the first one, which alone decides, since decisions depend on
its clock.

Each rank has a full model. All ranks solve the queries of the first one in parallel, a part each,
and wait for its next queries until it releases them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py.MPI import Comm

from hhr_dolfinx import errors
from hhr_dolfinx.errors import class_of
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import Answer, History
from hhr_dolfinx.models.answer import Path as AnswerPath
from hhr_dolfinx.plugins.paths.histories import with_fields
from hhr_dolfinx.snapshots.records import NOWHERE, compute_snapshots
from hhr_dolfinx.snapshots.store import SnapshotStore

Found = Answer | History | errors.HHRError


@dataclass(frozen=True)
class Workers:
    """The ranks of a search, the full model of this one, and what keeps answers.

    None keeps them in memory alone.
    """

    comm: Comm
    full: FullOrderModel
    store: SnapshotStore | None

    @property
    def size(self) -> int:
        """Number of queries that are solved at once."""
        return int(self.comm.size)

    def solved(self, questions: Sequence[np.ndarray | AnswerPath]) -> list[Found]:
        """Exact answers, or errors for queries without one.

        Called by the first rank, for which the others wait.
        """
        if self.comm.size > 1:
            self.comm.bcast(list(questions))
        return self._shared(questions)

    def serve(self) -> None:
        """Solve the queries of the first rank until it releases this one."""
        while (questions := self.comm.bcast(None)) is not None:
            self._shared(questions)

    def let_go(self) -> None:
        """Release the other ranks; called by the first rank, also after errors."""
        if self.comm.size > 1:
            self.comm.bcast(None)

    def _shared(self, questions: Sequence[np.ndarray | AnswerPath]) -> list[Found]:
        """Results of all ranks, on the first one."""
        comm = self.comm
        if comm.size == 1:
            return [self._tried(question) for question in questions]
        failure = None
        local_results: list[Any] = []
        try:
            local_results = [
                _sent(self._tried(question)) for question in questions[comm.rank :: comm.size]
            ]
        except BaseException as error:  # the other ranks wait for this part
            failure = error
            local_results = [("", f"{type(error).__name__}: {error}")] * len(
                questions[comm.rank :: comm.size]
            )
        gathered = comm.gather(local_results)
        if failure is not None and gathered is not None:
            raise failure
        if gathered is None:
            return []
        return [self._taken(gathered[k % comm.size][k // comm.size]) for k in range(len(questions))]

    def _tried(self, question: np.ndarray | AnswerPath) -> Found:
        """One exact answer, from the store if it is there, or the reason for its absence."""
        full = self.full
        # memories of laws are stored of histories alone
        store = None if full.law.remembers else self.store
        try:
            if not isinstance(question, np.ndarray):
                return compute_snapshots(full, [question], store=self.store).histories[0]
            stored = None if store is None else store.load(question)
            if stored is not None:
                return stored._replace(fields=full)
            with full.strains.paused():  # the search checks all of them at once
                answer = full.solve(question)
            if store is not None:
                store.save(answer)
            return answer
        except errors.HHRError as error:
            return error

    def _taken(self, item: Answer | History | tuple[str, str]) -> Found:
        """Result of another rank.

        RuntimeError for a failure outside this package, which no other attempt can cure.
        """
        if isinstance(item, Answer):
            return item._replace(fields=self.full)
        if isinstance(item, History):
            return with_fields(item, self.full)
        name, text = item
        if not name:
            raise RuntimeError(f"solving for a full answer failed on another rank: {text}")
        return class_of(name)(text)


def _sent(found: Found) -> Answer | History | tuple[str, str]:
    """An answer without its model, or an error as text: not all of them can be pickled."""
    if isinstance(found, Answer):
        return found._replace(fields=NOWHERE)
    if isinstance(found, History):
        return with_fields(found, NOWHERE)
    return type(found).__name__, str(found)
