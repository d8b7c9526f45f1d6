"""Settings of a study and of its pictures, which a scene's file may hold: ``SETTINGS``, ``VIEW``,
or such functions.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.errors import StudyError
from hhr_dolfinx.models.histories.equilibrium import DEFAULT_MARCH, MarchSettings
from hhr_dolfinx.parameters import check_counts
from hhr_dolfinx.reduction.recipe import Recipe

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from hhr_dolfinx.models.answer import Path
    from hhr_dolfinx.plugins.paths.path_families import NamedPath


@dataclass(frozen=True)
class View:
    """Settings of the pictures of a scene.

    Attributes:
        points: parameters whose contact pressures are drawn; fields are those of the last.
        position: maps the points of contact conditions, (m, dim), to positions along the surface,
            (m,), for the pair drawn, or the first. None, and on other pairs, is the coordinate
            along which a surface is longest.
        label: name of that position, with its unit; None for the coordinate, in the unit of the
            scene.
        component: displacement component drawn, and its name with unit; None for no component.
        stress: unit of stress; None for that of the scene.
        pair: contact pair drawn, counted from 0; None for all of them, side by side.
        closed_form: maps these positions and the total force of the pair to pressures drawn for
            comparison, for elastic scenes; None for none.
        deformed: draw fields on the deformed mesh.
    """

    points: tuple[Sequence[float], ...] = ()
    position: Callable[[np.ndarray], np.ndarray] | None = None
    label: str | None = None
    component: tuple[int, str] | None = None
    stress: str | None = None
    pair: int | None = None
    closed_form: Callable[[np.ndarray, float], np.ndarray] | None = None
    deformed: bool = False


@dataclass(frozen=True)
class StudySettings:
    """Training and measurements of a study.

    Attributes:
        training: training points along each parameter, or points (S, P); for bodies with laws a
            list of paths, user-defined or drawn, ``family.paths(Sobol(12))``.
        recipe: the recipe under study; None for the default of the scene.
        variants: further recipes by label, for the work-precision table.
        models: recipes that the report shows in full next to the one under study, built without
            checks, by name.
        tests: random test points; for bodies with laws paths by label, such as the value of a
            parameter, or a list of paths with names, as families draw them.
        held_out: for the trust check, random solutions or paths; None for the default number of
            solutions, or no path.
        seed: of test points; timed points belong neither to training nor to tests.
        queries: timed queries per model, at least 100 for a figure to quote; for elastic scenes.
        naive: whether to time the naive full model too, for elastic scenes; in space one query
            takes many seconds.
        march: settings of histories.
        repetitions: histories timed for each test path.
        correction: settings of the condensation of bodies with laws, see :meth:`Training.condense`;
            None for the defaults.
    """

    training: Any
    recipe: Recipe | None = None
    variants: Sequence[tuple[str, Recipe]] = ()
    models: Mapping[str, Recipe] = field(default_factory=dict)
    tests: int | Mapping[Hashable, Path] | Sequence[NamedPath] = 200
    held_out: int | Sequence[Path] | None = None
    seed: int = 1
    queries: int = 200
    naive: bool = True
    march: MarchSettings = DEFAULT_MARCH
    repetitions: int = 3
    correction: DataclassInstance | None = None

    def __post_init__(self) -> None:
        check_counts(
            queries=(self.queries, 1), repetitions=(self.repetitions, 1), seed=(self.seed, 0)
        )
        if not isinstance(self.held_out, Sequence | None):
            check_counts(held_out=(self.held_out, 0))
        if isinstance(self.tests, Sequence) and len(self.tests):
            object.__setattr__(self, "tests", _labelled(self.tests))
        if not isinstance(self.tests, Mapping):
            check_counts(tests=(self.tests, 1))
        for name in ("training", "tests"):
            value = getattr(self, name)
            if hasattr(value, "__len__") and not len(value):
                raise StudyError(f"{name} = {value!r} must hold at least one entry")
        if not isinstance(self.naive, bool):
            raise StudyError(f"naive = {self.naive!r} of a study must be True or False")
        if not isinstance(self.march, MarchSettings):
            raise StudyError(f"march = {self.march!r} of a study must be MarchSettings(...)")
        recipes = {f"variant {label!r}": recipe for label, recipe in self.variants}
        recipes |= {f"model {label!r}": recipe for label, recipe in self.models.items()}
        recipes |= {} if self.recipe is None else {"recipe": self.recipe}
        for name, recipe in recipes.items():
            if not isinstance(recipe, Recipe):
                raise StudyError(f"{name} = {recipe!r} of a study must be a Recipe")

    def adapted(self, *, seed: int, quick: bool) -> StudySettings:
        """These settings with another seed, and few points if ``quick``."""
        if not quick:
            return replace(self, seed=seed)
        return replace(
            self, seed=seed, queries=15, tests=self.tests if isinstance(self.tests, Mapping) else 20
        )


def _labelled(paths: Sequence[Path]) -> dict[str, Path]:
    """Paths by their names; StudyError for paths without a name, and for two of the same name."""
    labelled: dict[str, Path] = {}
    for number, path in enumerate(paths):
        name = getattr(path, "name", None)
        if not isinstance(name, str):
            raise StudyError(
                f"tests[{number}] has no name to label it by: give tests={{label: path, ...}}, or "
                "paths drawn from a PathFamily; where nothing flows a number of random points"
            )
        if name in labelled:
            raise StudyError(
                f"two tests are called {name!r}: leave one out, or give tests={{label: path, ...}}"
            )
        labelled[name] = path
    return labelled
