"""An output of a user's own: the mean pressure of a contact."""

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.models.functionals.kinds import Linear
from hhr_dolfinx.outputs import ModelProbe


@dataclass(frozen=True)
class MeanPressure:
    """Sum of the forces of a contact over the sum of its areas."""

    name: str
    contact: int
    unit: str = ""

    def prepared(self, probe: ModelProbe) -> Linear:
        """Weights of the forces; no rows of the displacement, and nothing that depends on the amplitudes."""
        conditions, areas = probe.loaded(self)
        weights = np.full(conditions.size, 1 / areas.sum())
        return Linear.of(self.name, self.unit, conditions, weights)
