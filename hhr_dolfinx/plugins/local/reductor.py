"""Local models as a reductor. How a training is divided is no matter of the driver: splitting and clusters use it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

from hhr_dolfinx.plugins.local.models import LocalModels
from hhr_dolfinx.plugins.local.splitting import Splitting
from hhr_dolfinx.reduction.build import usual_recipe
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.reduction.reductor import POINTS, Proposal, Reductor, Search, Task
from hhr_dolfinx.study.training.train import Training


@dataclass(frozen=True)
class Local(Reductor[Task]):
    """Local models. Each part has a check of its own, so that they are not compared again.

    Attributes:
        how: :class:`~hhr_dolfinx.plugins.local.splitting.Splitting`, or another object with ``models``.
        recipe: of each model; None takes the default of the scene.
        progress: for progress bars.
    """

    how: Any = Splitting()
    recipe: Recipe | None = None
    progress: Callable[[Iterable], Iterable] = iter
    method: ClassVar[str] = "local"
    own_range: ClassVar[bool] = True

    def attempt(self, prepared: Task, level: int) -> tuple[LocalModels, None]:
        """All models; their record is that of ``how``."""
        full = prepared.full
        training = Training(full, prepared.snapshots, prepared.held_out, prepared.log)  # type: ignore[arg-type]
        recipe = usual_recipe(full) if self.recipe is None else self.recipe
        return self.how.models(training, recipe, self.progress), None

    def compare(self, task: Task, model: LocalModels) -> tuple[None, Any]:
        """Nothing."""
        return None, model.trained

    def proposals(self, search: Search) -> Iterator[Proposal]:
        """Of the largest training alone."""
        yield Proposal(self.method, f"{POINTS[-1]} training points", partial(search.reduced, self, POINTS[-1]))
