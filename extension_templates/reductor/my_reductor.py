"""A way to reduce of your own, and the manifest by which scenes find it."""

from dataclasses import dataclass

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.reduction.exact import exact_condensation
from hhr_dolfinx.reduction.reductor import Reductor, Task
from hhr_dolfinx.registry import Plugin, Way


def wanted(full):
    """Scenes of which hhr.reduce tries it; this decides without loading anything."""
    return full.equilibrium is None and not full.law.plugin and not full.problem.varies


PLUGIN = Plugin(
    name="my_reductor",
    public={"my_reductor": "MyReductor"},
    reductors={"my_reductor": Way("my_reductor:MyReductor", wanted)},
)


@dataclass(frozen=True)
class MyReductor(Reductor[Task]):
    """All contact conditions, exact; `training.build(MyReductor())` makes the model."""

    method = "mine"  # TODO: its name in tables

    def check(self, task):
        """Refuse what it is not for."""
        # TODO: refuse what you do not treat: a model that answers as if it were not there is wrong
        if not wanted(task.full):
            raise NotOfferedError(
                "MyReductor is for elastic bodies of constant stiffness in unilateral contact"
            )

    def attempt(self, prepared, level):
        """A model of the scene, and facts for its record.

        See hhr_dolfinx.reduction.reductor.Reductor.
        """
        # TODO: your model, made of the full one and the snapshots
        return exact_condensation(prepared.full, prepared.snapshots.known_statuses()), None
