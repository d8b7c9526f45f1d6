"""Check that strains and rotations in answers of elastic bodies are small."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.errors import NotOfferedError, ReductionError, SmallStrainWarning
from hhr_dolfinx.models.full import Checked, FullModel, Guard
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.plugins.small_strains.cells import (
    LARGE_STRAIN,
    STRAIN_LIMIT,
    StrainKind,
    spread_strain,
    strain_kinds,
)
from hhr_dolfinx.plugins.small_strains.limit import StrainRange, narrowed
from hhr_dolfinx.trained import TrainedRange
from hhr_dolfinx.warn import ignored, warn

if TYPE_CHECKING:
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.models.model import AnsweringModel
    from hhr_dolfinx.snapshots.records import SnapshotSet


CHECKED_CORNERS = 16
"""Largest number of corners of the box in which strains of a model are checked."""
CHECKED_GROWTH = 1.5
"""Growth of the squared displacement after which strains of a full model are checked again."""
STRAINS_AT_ONCE = 50
"""Answers whose strains are computed at once.

Distributed ones need all values of one on each rank meanwhile.
"""


class StrainGuard(Guard):
    """Warns of the first answer of a full model with a large strain or rotation.

    It warns again of the first with an absurd one.

    Answers of elastic bodies are checked if their displacement is larger than that of all before,
    so that most cost one scalar product.

    Args:
        axisymmetric: whether strains have a hoop component.
    """

    def __init__(self, problem: ContactProblem, *, axisymmetric: bool):
        self.limit = LARGE_STRAIN
        """The strain or rotation above which the next warning is due."""
        self._problem = problem
        self._axisymmetric = axisymmetric
        self._looked = 0.0
        self._paused = False

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Suspend the check in a block whose caller checks all answers at once."""
        before, self._paused = self._paused, True
        try:
            yield
        finally:
            self._paused = before

    @cached_property
    def _kinds(self) -> tuple[StrainKind, StrainKind]:
        return strain_kinds(self._problem, axisymmetric=self._axisymmetric)

    def look(self, answer: Answer) -> None:
        """Check an answer of the full model.

        Warns:
            SmallStrainWarning: if a strain is above :data:`LARGE_STRAIN`, and once more above
            :data:`STRAIN_LIMIT`.
        """
        unknown = answer.unknown
        size = unknown @ unknown
        if self._paused or not size > CHECKED_GROWTH * self._looked:
            return
        self._looked = size
        displacement = answer.displacement()[:, None]
        for kind in self._kinds:
            size = spread_strain(kind.sizes(displacement)[:, 0])
            if size > self.limit:
                self.limit = STRAIN_LIMIT if size <= STRAIN_LIMIT else np.inf
                where = self._problem.parameters.described(answer.parameter)
                warn(f"at {where}: {kind.in_words(size)}", SmallStrainWarning)
                return

    def check(self, full: FullModel, *sets: SnapshotSet | None) -> None:
        """Check sets of answers at single parameters.

        The problem of the full model is that of the guard, or the same with all rows on each
        process. Strains of load paths are checked step by step; their rotations are not.

        Raises:
            ReductionError: if any has strains or rotations beyond any theory of small strains.

        Warns:
            SmallStrainWarning: if they are large in any, with the parameter.
        """
        snapshot_sets = [
            snapshots for snapshots in sets if snapshots is not None and len(snapshots.points)
        ]
        if full.equilibrium is not None or not snapshot_sets:
            return
        sizes = [
            self._spreads(full.problem, snapshots.points, snapshots.displacements)
            for snapshots in snapshot_sets
        ]
        self._judge(
            full.problem,
            np.concatenate([snapshots.points for snapshots in snapshot_sets]),
            np.concatenate(sizes),
        )

    def corners(self, full: FullModel, model: Checked) -> Checked:
        """Warn of large strains and rotations of a model in corners of its parameter range.

        Args:
            full: the full model.
            model: the model.

        Returns:
            The model, with a limit where strains mean nothing further on. A model of contact forces
            alone has no displacement, and is not checked.
        """
        try:
            self.check_corners(full, model)
        except ReductionError as error:
            limited, limit = self._limited(full, model)
            scope = (
                f"; answers of the model are refused or warned of beyond {limit.described()}"
                if limit
                else ""
            )
            warn(f"{error}. The box reaches that far: narrow it{scope}", SmallStrainWarning)
            return limited
        except NotOfferedError:
            pass
        return model

    def check_corners(self, full: FullModel, model: AnsweringModel) -> None:
        """Check answers of a model in corners of the parameter range, where loads are largest.

        Args:
            full: the full model.
            model: the model.

        Raises:
            ReductionError: see :meth:`check`.
        """
        if full.equilibrium is not None:
            return
        space = full.problem.parameters
        points, sizes = self._of_corners(model, np.array([space.lower, space.upper], dtype=float))
        if len(points):
            self._judge(full.problem, points, sizes)

    def _of_corners(self, model: AnsweringModel, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Corners of a box and its middle, with an answer, (S, P), and strain and rotation, (S, 2).

        Loads that are formulas may be largest in the middle.
        """
        count = 2 ** min(ends.shape[1], 10)
        numbers = np.unique(np.linspace(0, count - 1, min(count, CHECKED_CORNERS)).astype(int))
        axes = np.arange(ends.shape[1])
        corners = np.array(
            [*(ends[(number >> (axes % 10)) & 1, axes] for number in numbers), ends.mean(axis=0)]
        )
        with ignored(Warning):  # the user did not request answers in corners
            many = model.solve_many(corners, raise_on_failure=False, outside="ignore")
        answers = [answer for answer in many if answer.converged]
        if not answers:
            return corners[:0], np.zeros((0, 2))
        displacements = np.stack([answer.displacement() for answer in answers], axis=1)
        return np.array([answer.parameter for answer in answers]), self._sizes(displacements)

    def _limited(self, full: FullModel, model: Checked) -> tuple[Checked, StrainRange | None]:
        """The model with the limit of its strains, and this limit.

        None for a model that keeps none.
        """
        if not (isinstance(model, KeptModel) and "trained" in model.kept):
            return model, None
        trained = model.trained
        if not isinstance(trained, TrainedRange | None):
            return model, None

        def worst(ends: np.ndarray) -> float:
            return float(self._of_corners(model, ends)[1].max(initial=0.0))

        limit = narrowed(full.problem.parameters, worst, trained)
        return (model, None) if limit is None else (model.changed(trained=limit), limit)

    def _judge(self, problem: ContactProblem, points: np.ndarray, sizes: np.ndarray) -> None:
        """Raise and warn by the strains and rotations of answers at points, (S, 2)."""
        for kind, size in zip(self._kinds, sizes.T, strict=True):
            worst = int(size.argmax())
            if size[worst] <= LARGE_STRAIN:
                continue
            message = (
                f"at {problem.parameters.described(points[worst])}: {kind.in_words(size[worst])}"
            )
            if size[worst] > STRAIN_LIMIT:
                raise ReductionError(message)
            warn(message, SmallStrainWarning)

    def _spreads(
        self, problem: ContactProblem, points: np.ndarray, displacements: np.ndarray
    ) -> np.ndarray:
        """The strain and the rotation that few cells exceed, (S, 2).

        Displacements are local rows without lifts, (own, S).
        """
        each = STRAINS_AT_ONCE if problem.spread.all_here else 1
        sizes = []
        for first in range(0, len(points), each):
            batch = slice(first, first + each)
            lifts = problem.amplitudes.sum_columns(problem.lifts, points[batch])
            sizes.append(self._sizes(problem.spread.whole(displacements[:, batch]) + lifts))
        return np.concatenate(sizes)

    def _sizes(self, whole: np.ndarray) -> np.ndarray:
        """Strain and rotation that few cells exceed, (S, 2), of displacements, (N, S)."""
        sizes = [kind.sizes(whole) for kind in self._kinds]
        return np.array(
            [[spread_strain(size[:, column]) for size in sizes] for column in range(whole.shape[1])]
        )
