"""Local models as a reductor, and the method ``local`` of a training.

Splitting or clusters divide the training.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar, Protocol

from hhr_dolfinx.errors import NotOfferedError, StudyError
from hhr_dolfinx.plugins.local_models.models import LocalModels
from hhr_dolfinx.plugins.local_models.splitting import Splitting
from hhr_dolfinx.reduction.build import usual_recipe
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.reduction.reductor import Reductor, Task, made
from hhr_dolfinx.study.training.train import Progress, Training
from hhr_dolfinx.timing import lines_of

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.one_call.context import SearchContext
    from hhr_dolfinx.plugins.one_call.proposals import Proposal
    from hhr_dolfinx.trained import Trained


class TrainingSplit(Protocol):
    """Way to divide a training among local models: ``Splitting``, ``Clusters``, or another one."""

    def models(
        self, training: Training, recipe: Recipe, progress: Callable[[Iterable], Iterable]
    ) -> LocalModels:
        """Local models of a training.

        Args:
            training: the full model with its answers.
            recipe: recipe of each model.
            progress: wraps the iteration over the models.
        """


@dataclass(frozen=True)
class Local(Reductor[Task]):
    """Local models. Each part is checked by itself, so that they are not compared again.

    ``how`` is :class:`~hhr_dolfinx.plugins.local_models.splitting.Splitting`, or another object
    with ``models``; a recipe of None is the default of the scene.
    """

    how: TrainingSplit = Splitting()
    recipe: Recipe | None = None
    progress: Callable[[Iterable], Iterable] = iter
    method: ClassVar[str] = "local"
    own_range: ClassVar[bool] = True

    def attempt(self, prepared: Task, level: int) -> tuple[LocalModels, None]:
        """All models; their record is that of ``how``.

        Args:
            prepared: the task.
            level: unused; there is one level.
        """
        full = prepared.full
        arguments = (full, prepared.snapshots, prepared.held_out, prepared.log)
        training = Training(*arguments)  # type: ignore[arg-type]
        recipe = usual_recipe(full) if self.recipe is None else self.recipe
        return self.how.models(training, recipe, self.progress), None

    def compare(self, task: Task, model: LocalModels) -> tuple[None, Trained | None]:
        """Skip the comparison: local models check themselves.

        Args:
            task: the full model and its answers.
            model: the local models.

        Returns:
            None, and the training range.
        """
        return None, model.trained

    def proposals(self, search: SearchContext) -> Iterator[Proposal]:
        """Of the largest training alone."""
        from hhr_dolfinx.plugins.one_call.proposals import POINT_COUNTS, Proposal

        yield Proposal(
            self.method,
            f"{POINT_COUNTS[-1]} training points",
            partial(search.reduced, self, POINT_COUNTS[-1]),
        )


def local(
    training: Training,
    how: TrainingSplit | None = None,
    *,
    recipe: Recipe | None = None,
    checked: bool = True,
    progress: Progress = lines_of,
) -> LocalModels:
    """Build several small models instead of one, each for a part of the box, used like one.

    Thesis chapter 4.

    Args:
        training: the full model with its answers.
        how: :class:`~hhr_dolfinx.plugins.local_models.splitting.Splitting`, which determines the
            number of models, or :class:`~hhr_dolfinx.plugins.local_models.clustered.Clusters` of a
            given number; None takes the first.
        recipe, checked: of each model, see :meth:`hhr_dolfinx.study.training.train.Training.build`.
        progress: for progress bars.

    Raises:
        StudyError: for an invalid ``how``.
        NotOfferedError: with friction, and for inelastic bodies.
    """
    if training.full_order.law.remembers or training.full_order.equilibrium is not None:
        raise NotOfferedError(
            "local models are of elastic bodies without friction: take one model of these "
            "histories, build() or condense(), which were found as exact and quicker"
        )
    how = Splitting() if how is None else how
    if not callable(getattr(how, "models", None)) or isinstance(how, type):
        raise StudyError(
            f"{how!r} is no way to share a training out: give Splitting(modes=90) or Clusters(3)"
        )
    if recipe is None and training.choice is not None:
        recipe = training.choice.recipe
    chosen_recipe = usual_recipe(training.full_order) if recipe is None else recipe
    if not isinstance(chosen_recipe, Recipe):
        raise StudyError(f"{chosen_recipe!r} is no recipe: give a Recipe")
    task = Task(training.full_order, training.snapshots, training.held_out)
    models: LocalModels = made(
        Local(
            how, chosen_recipe if checked else chosen_recipe.as_it_is(), progress("local models")
        ),
        task,
    )
    return models
