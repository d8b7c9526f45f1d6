"""Laws of contacts beside the unilateral one: histories by increments, each law on its range, and
their reduction.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.registry import Plugin, Stage

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.reduction.recipe import Recipe

_HERE = "hhr_dolfinx.plugins.contact_laws"


def _wanted(full: FullModel, recipe: Recipe) -> bool:
    return bool(full.law.plugin)


PLUGIN = Plugin(
    name="contact_laws",
    needs=("paths",),
    optional=("inelastic",),
    classes={f"{_HERE}.interface": "Interface Range"},
    recipes={"of_paths": f"{_HERE}.reduction:of_paths"},
    stages=(
        Stage(
            f"{_HERE}.reduction:complete_contacts",
            "hhr_dolfinx.reduction.build:reconstruct",
            _wanted,
        ),
    ),
    facets={
        "steps": f"{_HERE}.steps:INTERFACE_STEPS",
        "flow_slopes": f"{_HERE}.flow_slopes:RangeSlopes",
    },
    tools={
        "laws": f"{_HERE}.interface:joint",
        "reduction": f"{_HERE}.reduction:kind_of_contacts",
    },
)
