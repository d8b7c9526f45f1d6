"""Load paths: families of them, and training, comparison and commands of answers that depend on their path."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.registry import Plugin, Stage

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.reduction.recipe import Recipe

_HERE = "hhr_dolfinx.plugins.paths"


def _wanted(full: FullModel, recipe: Recipe) -> bool:
    return bool(full.law.plugin)


PLUGIN = Plugin(
    name="paths",
    public={f"{_HERE}.path_families": "Leg NamedPath PathFamily"},
    commands={"march": f"{_HERE}.commands:march"},
    recipes={"of_paths": f"{_HERE}.kinds:of_paths"},
    stages=(Stage(f"{_HERE}.kinds:complete_contacts", "hhr_dolfinx.reduction.build:reconstruct", _wanted),),
    tools={
        "histories": f"{_HERE}.histories:Paths",
        "queries": f"{_HERE}.queries:training_queries",
        "reduction": f"{_HERE}.kinds:kind_of_contacts",
    },
)
