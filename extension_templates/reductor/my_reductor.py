"""A way to reduce of your own, and the manifest by which scenes find it."""

from dataclasses import dataclass

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.reduction.exact import exact_condensation
from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(name="my_reductor", public={"my_reductor": "MyReductor"})


@dataclass(frozen=True)
class MyReductor:
    """All contact conditions, exact; `training.build(MyReductor())` makes the model."""

    def reduced(self, full, snapshots, held_out):
        """A model of the scene; see hhr_dolfinx.reduction.build.Reductor."""
        # TODO: refuse what you do not treat: a model that answers as if it were not there is wrong
        if full.equilibrium is not None or full.problem.friction is not None or full.problem.varies:
            raise NotOfferedError("MyReductor is for elastic bodies of constant stiffness without friction")
        # TODO: your model, made of full.problem and the snapshots
        return exact_condensation(full, snapshots.known_statuses())
