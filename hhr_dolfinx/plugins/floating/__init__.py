"""Bodies that contact alone holds: their rigid motions, the kernel of K, are unknowns of the
contact problem.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.registry import Plugin, Stage

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.reduction.recipe import Recipe

_HERE = "hhr_dolfinx.plugins.floating"


def _wanted(full: FullModel, recipe: Recipe) -> bool:
    return full.problem.held_by_contact and not full.by_paths


PLUGIN = Plugin(
    name="floating",
    optional=("contact_laws",),
    classes={
        f"{_HERE}.elimination": "FloatingElimination",
        f"{_HERE}.interpolated": "MotionsBeside",
    },
    tools={"kernel": f"{_HERE}.kernel:RigidKernel"},
    stages=(Stage(f"{_HERE}.on_s:check_on_s", "hhr_dolfinx.reduction.build:assemble", _wanted),),
    switches={f"{_HERE}.switches": "floating"},
)
