"""Histories of the full order along training paths, and their steps in files."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.group import ProcessGroup
from hhr_dolfinx.models.answer import Answer, History, Path
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.models.histories.equilibrium import MarchSettings, told_once
from hhr_dolfinx.models.histories.path import checked_path
from hhr_dolfinx.snapshots.records import NOWHERE, SnapshotSet, SnapshotSolver
from hhr_dolfinx.snapshots.store import SnapshotStore
from hhr_dolfinx.warn import first_alone

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import ModelFields

_log = logging.getLogger(__name__)


class KeptSteps:
    """Stored steps of one history along a path, solved with some settings."""

    def __init__(self, store: SnapshotStore, path: Path, settings: MarchSettings):
        self._store = store
        path = checked_path(store.parameters, path)
        self._path = path
        options = [
            getattr(settings, name)
            for name in settings.__dataclass_fields__
            if name not in ("outside", "gradient")
        ]
        query = [
            option if option is None or isinstance(option, str) else float(option)
            for option in options
        ]
        self._queries: list[list] = []
        for time, point in path:
            # each query has the digest of the one before: with the whole path in each, files would
            # grow along it
            query = [store.digest(query), time, *store.query_at(point)]
            self._queries.append(query)
        self._count = 0

    def load(self) -> list[Answer]:
        """Load the answers of the first steps, up to the first one that is missing."""
        answers = []
        forces = 0.0
        laws = self._store.laws
        for (time, point), query in zip(self._path[1:], self._queries[1:], strict=True):
            answer = self._store.load_query(point, query, forces)
            if answer is None:
                break
            answers.append(answer._replace(time=time))
            forces = max(forces, laws.size(answer))
        self._count = len(answers)
        return answers

    def on_disk(self, history: History) -> History:
        """The history, all of whose steps are stored.

        Large ones are mapped from disk, which frees their memory.
        """
        if not history.answers or not self._store.laws.is_large(history.answers[-1]):
            return history
        count = self._store.found
        answers = self.load()
        self._store.found = count
        return (
            replace(history, answers=answers) if len(answers) == len(history.answers) else history
        )

    def save(self, answer: Answer) -> None:
        """Store the next step; FileError if its file cannot be written."""
        self._count += 1
        self._store.save_query(answer, self._queries[self._count])


def with_fields(history: History, fields: ModelFields) -> History:
    """History whose answers refer to other fields.

    Those of an answer cannot be sent to another rank.

    Args:
        history: the history.
        fields: the other fields.
    """
    return replace(history, answers=[answer._replace(fields=fields) for answer in history.answers])


@dataclass(frozen=True)
class Paths:
    """Paths of times and parameters, each with the state at rest first: tool ``histories``."""

    paths: Sequence[Path]

    def __len__(self) -> int:
        return len(self.paths)

    def request(self) -> list[str | np.ndarray]:
        """See :class:`~hhr_dolfinx.snapshots.records.Queries`."""
        values = [value for path in self.paths for pair in path for value in pair]
        numbers = (
            list(value.values()) if isinstance(value, Mapping) else value for value in values
        )
        return [f"{len(self.paths)} paths", *(np.array(value, dtype=float) for value in numbers)]

    def part(self, numbers: Sequence[int]) -> Paths:
        """See :class:`~hhr_dolfinx.snapshots.records.Queries`."""
        return Paths([self.paths[k] for k in numbers])

    def solved(self, solver: SnapshotSolver) -> SnapshotSet | None:
        """See :class:`~hhr_dolfinx.snapshots.records.Queries`."""
        group = solver.full.group
        group.agreed("snapshots", self.request)
        with group.together("solving for snapshots"):
            with told_once("histories"), first_alone():
                histories = list(self._histories(solver))
            return (
                None
                if solver.lost is not None and not histories
                else SnapshotSet.of_histories(histories)
            )

    def _histories(self, solver: SnapshotSolver) -> Iterator[History]:
        parameters = solver.full.parameters
        for number, path in enumerate(solver.in_step(self.paths), start=1):
            _log.info("history %d of %d, %d steps", number, len(self.paths), len(path) - 1)
            end = parameters.described(parameters.point(path[-1][1]))
            history = None
            with solver.recording(getattr(path, "name", "") or f"a path that ends at {end}"):
                history = _history(solver, path)
            if history is not None:
                yield history

    def gathered(
        self, own: SnapshotSet | None, full: FullModel, group: ProcessGroup
    ) -> SnapshotSet:
        """See :class:`~hhr_dolfinx.snapshots.records.Queries`.

        Args:
            own: histories of this rank; None without any.
            full: the full model, to which the answers will refer.
            group: the ranks.
        """
        # an answer refers to its model, which cannot be sent to another rank
        sent: Sequence[History] = (
            () if own is None else [with_fields(history, NOWHERE) for history in own.histories]
        )
        return SnapshotSet.of_histories(
            with_fields(item, full) for histories in group.gathered(sent) for item in histories
        )


def _history(solver: SnapshotSolver, path: Path) -> History:
    """History continued after its stored steps.

    If several ranks solve it, one of them reads and writes these.
    """
    full = solver.full
    if solver.store is None:
        return full.march(path, solver.settings)
    steps = KeptSteps(solver.store, path, solver.settings)
    if full.group.size == 1:
        return steps.on_disk(full.march(path, solver.settings, known=steps.load(), keep=steps.save))
    first = full.group.number == 0
    previous = full.group.from_first(
        [answer._replace(fields=NOWHERE) for answer in steps.load()] if first else []
    )
    keep = steps.save if first else lambda answer: None
    return full.march(
        path,
        solver.settings,
        known=[answer._replace(fields=full) for answer in previous],
        keep=keep,
    )
