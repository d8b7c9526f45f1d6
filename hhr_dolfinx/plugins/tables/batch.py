"""Batches: answers to many parameters as arrays, block by block, distributed over the ranks.

A parameter without an answer gets a reason and does not stop the others. Tables of text are in
``tables``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.group import ALONE, group_of
from hhr_dolfinx.models.answer import ListedAnswers, SeveralAnswers
from hhr_dolfinx.models.estimates import columns, shown_of
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.models.shown import counted, line, table
from hhr_dolfinx.one_thread import one_thread
from hhr_dolfinx.parameters import PointsLike
from hhr_dolfinx.trained import TrainedRange, check_outside

if TYPE_CHECKING:
    from mpi4py.MPI import Comm
    from numpy.typing import ArrayLike

Progress = Callable[[Iterable], Iterable]
"""Wrapper of an iteration, for a progress bar."""

OK = "ok"
"""Status of a row that has an answer."""


class Answers(NamedTuple):
    """Answers to many parameters, one row each, with NaN in rows without an answer.

    Attributes:
        points: parameters, (S, P).
        status: ``ok``, or the reason why there is no answer.
        forces: nodal contact forces on the whole surface, (S, N_lambda).
        outputs: outputs of the scene by the head of their column, ``name [unit]``, (S,) each.
        estimates: estimates of the errors by the head of their column, (S,) each, see
            :func:`~hhr_dolfinx.models.estimates.columns`: relative errors, but bounds of outputs in
            their units; NaN without an estimate. Empty for a model without estimates.
        largest_displacement: largest displacement of any node, (S,); None unless requested: it
            needs the whole field.
        columns: further columns of the kind of model by head, (S,) each, such as the number of the
            local model that answered; see :meth:`~hhr_dolfinx.models.model.AnsweringModel.columns`.
        total_force: sum of the normal forces, (S,), if the law of the contacts has other forces
            too; else None.
    """

    points: np.ndarray
    status: list[str]
    forces: np.ndarray
    outputs: Mapping[str, np.ndarray] = MappingProxyType({})
    estimates: Mapping[str, np.ndarray] = MappingProxyType({})
    largest_displacement: np.ndarray | None = None
    columns: Mapping[str, np.ndarray] = MappingProxyType({})
    total_force: np.ndarray | None = None

    def facts(self) -> dict[str, str]:
        """Facts to show, see :class:`~hhr_dolfinx.models.shown.Shown`."""
        return {
            "rows": counted(len(self.points), "row"),
            "answers": f"{self.status.count(OK)} ok",
            "parameters": counted(self.points.shape[1], "parameter"),
            "outputs": f"outputs: {', '.join(self.outputs) or 'none'}",
        }

    def __repr__(self) -> str:
        return line("Answers", self.facts())

    def _repr_html_(self) -> str:
        return table("Answers", self.facts())

    @classmethod
    def joined(cls, parts: list[Answers]) -> Answers:
        """Join the answers of one or more blocks in their order."""

        def whole(name: str) -> Any:
            values = [getattr(answers, name) for answers in parts]
            if values[0] is None:
                return None
            if isinstance(values[0], Mapping):
                return {key: np.concatenate([block[key] for block in values]) for key in values[0]}
            return (
                [text for block in values for text in block]
                if name == "status"
                else np.concatenate(values)
            )

        return cls(*(whole(name) for name in cls._fields))


def answer_points(
    model: AnsweringModel,
    points: PointsLike,
    comm: Comm | None = None,
    progress: Progress = iter,
    outside: str = "refuse",
    *,
    displacement: bool = False,
    estimates: bool = True,
) -> Answers | None:
    """Answer every point, (S, P), with contact forces on the whole surface.

    None on all ranks but the first.

    Each rank takes an equal part of the points. Queries take about the same time, so that a dynamic
    distribution would gain nothing.

    Args:
        model: any model that answers points. Model and points are the same on all ranks; a model
            that falls back has a full model on each rank, and learns there from the queries of that
            rank.
        points: (S, P), or columns or rows with names.
        comm: communicator over which the points are distributed; None for this process alone,
            without MPI.
        progress: wrapper of the iteration over blocks, for a progress bar.
        outside: see :meth:`Model.solve`. The default refuses rows outside the training range, as
            readers of a table see no warnings.
        displacement: include the largest displacement of any node, which needs the field of each
            row.
        estimates: include estimates of errors, which take several times as long as the answers.

    Raises:
        ParameterError: if ``points`` is no table of points, or ``outside`` is unknown.
        HHRError: on all ranks, if anything but a row failed on another rank.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> answers = hhr.answer_points(hhr.condense(scene), [[10.0], [50.0]])
        >>> answers.status, answers.forces.shape
        (['ok', 'ok'], (2, 8))
        >>> answers.outputs["peak [MPa]"].round(1)
        array([15. , 56.5])
    """
    group = ALONE if comm is None else group_of(comm)
    with group.each("answering the table"):
        check_outside(outside)
        points = model.parameters.table(points)
    group.agreed("answering the table", lambda: [repr(model), points])
    with group.each("answering the table"):
        query = Query(model, outside, displacement, estimates)
        mine = np.array_split(points, group.size)[group.number]
        count = model.rows_at_once
        blocks = [mine[first : first + count] for first in range(0, max(len(mine), 1), count)]
        answers = Answers.joined([query(block) for block in progress(blocks)])
    gathered = [answers] if comm is None else comm.gather(answers, root=0)
    return None if gathered is None else Answers.joined(gathered)


@dataclass(frozen=True)
class Query:
    """Evaluation of blocks of points with all columns of a table, see :func:`answer_points`."""

    model: AnsweringModel
    outside: str
    displacement: bool = False
    estimates: bool = True

    @property
    def outputs(self) -> dict[str, str]:
        """Heads of the columns of the outputs of the scene, by their names."""
        functionals = self.model.fields.functionals
        functionals_of = () if functionals is None else functionals.items
        return {
            functional.name: f"{functional.name} [{functional.unit}]"
            if functional.unit
            else functional.name
            for functional in functionals_of
        }

    @property
    def bounded_outputs(self) -> dict[str, str]:
        """Outputs with columns of estimates: heads of their columns, by their names."""
        return self.outputs if self.model.fields.output_bound is not None else {}

    @property
    def estimate_heads(self) -> list[str]:
        """Heads of the columns of estimates; empty if the model has none or none are requested."""
        if not self.estimates:
            return []
        kind = self.model.fields.estimated
        return columns(kind, self.bounded_outputs) if kind else []

    # threads of BLAS slow small blocks down, a hundredfold if other processes keep the cores busy
    @one_thread
    def __call__(self, points: np.ndarray) -> Answers:
        """Answer a block of points, (n, P), any of which may fail."""
        status = self._faults(points)
        table = self._blank(len(points))
        columns = {head: np.full(len(points), np.nan) for head in self.model.columns(())}
        remaining = np.flatnonzero([text == OK for text in status])
        try:
            many = self.model.solve_many(
                points[remaining], raise_on_failure=False, outside=self.outside
            )
            solved = many.converged
            self._fill(table, columns, remaining[solved], many.take(solved))
            remaining = remaining[~solved]
        except HHRError:  # one row was refused: the loop below finds which one, and the reason
            pass
        for k in remaining:
            try:
                answer = self.model.solve(points[k], outside=self.outside)
                self._fill(table, columns, np.array([k]), ListedAnswers((answer,)))
            # a failure of this row; any other error is one of the program and ends the run
            except HHRError as error:
                status[k] = str(error)
        outputs = {head: table.pop(head) for head in self.outputs.values()}
        estimates = {head: table.pop(head) for head in self.estimate_heads}
        return Answers(
            points, status, outputs=outputs, estimates=estimates, columns=columns, **table
        )

    def _faults(self, points: np.ndarray) -> list[str]:
        """Faults of points before any is solved; ``ok`` for none."""
        space = self.model.parameters
        trained = getattr(self.model, "trained", None)
        bad = ~((points >= space.lower) & (points <= space.upper)).all(axis=1)
        if self.outside == "refuse" and isinstance(trained, TrainedRange):
            bad |= ~((points >= trained.lower) & (points <= trained.upper)).all(axis=1)
        status = [OK] * len(points)
        for k in np.flatnonzero(bad):
            try:
                point = space.point(points[k])
                if isinstance(trained, TrainedRange):
                    trained.check(point, self.outside)
            except HHRError as error:
                status[k] = str(error)
        return status

    @property
    def _other_forces(self) -> bool:
        """True if contacts have other forces than pressures; user-defined models have none."""
        return isinstance(self.model, AnsweringModel) and self.model.law.remembers

    def _blank(self, count: int) -> dict[str, np.ndarray]:
        """Columns by name, without values."""
        names = [*self.outputs.values(), *self.estimate_heads]
        names += ["largest_displacement"] if self.displacement else []
        names += ["total_force"] if self._other_forces else []
        table = {name: np.full(count, np.nan) for name in names}
        return table | {"forces": np.full((count, self.model.conditions), np.nan)}

    def _fill(
        self,
        table: dict[str, np.ndarray],
        columns: dict[str, np.ndarray],
        rows: np.ndarray,
        many: SeveralAnswers,
    ) -> None:
        """Put answers into some rows of the table and of further columns.

        If one is refused, none are filled in.
        """
        if not rows.size:
            return
        filled: dict[str, ArrayLike] = {"forces": many.forces()}
        if self._other_forces:
            filled["total_force"] = [self.model.pressures(answer).sum() for answer in many]
        if heads := self.outputs.values():
            filled |= dict(zip(heads, many.outputs().values(), strict=True))
        if self.estimate_heads:
            filled |= dict(zip(self.estimate_heads, self._estimates(many), strict=True))
        if self.displacement:
            fields = (answer.displacement().reshape(-1, self.model.dimension) for answer in many)
            filled["largest_displacement"] = [
                np.linalg.norm(field, axis=1).max() for field in fields
            ]
        for target, values in ((table, filled), (columns, self.model.columns(many))):
            for name, value in values.items():
                target[name][rows] = value

    def _estimates(self, many: SeveralAnswers) -> np.ndarray:
        """Values of the columns of estimates, (columns, n).

        NaN without an estimate, as of exact answers.
        """
        count = len(self.estimate_heads)
        if self.bounded_outputs:
            estimates = [answer.estimate() for answer in many]
            shown = [
                None if estimate is None else list(estimate.shown(self.bounded_outputs).values())
                for estimate in estimates
            ]
            return np.array(
                [[np.nan] * count if values is None else values[:count] for values in shown]
            ).T
        estimates_of = many.estimates()
        if estimates_of is None:
            return np.full((count, len(many)), np.nan)
        # answers of a full model are exact, whatever kind of estimate the reduced model has
        return np.array(
            [
                getattr(estimates_of, name)
                for name in shown_of(self.model.estimating.fields.estimated).values()
            ]
        )
