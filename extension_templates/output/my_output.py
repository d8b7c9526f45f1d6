"""An output of your own, and the manifest by which scenes find it."""

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.models.functionals.kinds import Linear
from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(name="my_output", parts={"outputs": {"MyOutput": "my_output:MyOutput"}})


@dataclass(frozen=True)
class MyOutput:
    """Mean pressure of a contact.

    Attributes:
        name: by which models return it.
        contact: index of the contact in the scene.
        unit: for labels.
    """

    name: str
    contact: int
    unit: str = ""

    def prepared(self, probe):
        """Plain data that has `value` and `slopes`.

        See hhr_dolfinx.models.functionals.functional.Functional.
        """
        conditions, areas = probe.loaded(self)
        # TODO: your weights of the contact forces, or a Functional of your own
        return Linear.of(
            self.name, self.unit, conditions, np.full(conditions.size, 1 / areas.sum())
        )
