"""Outputs of gaskets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from hhr_dolfinx.declared import Integers
from hhr_dolfinx.models.functionals.functional import Functional, State
from hhr_dolfinx.outputs import OfContact, no_rows
from hhr_dolfinx.plugins.contact_laws.readings import places_in_memory
from hhr_dolfinx.plugins.gaskets.laws import LARGEST_CLOSURE

if TYPE_CHECKING:
    from hhr_dolfinx.outputs import ModelProbe


@dataclass(frozen=True, eq=False)
class Closed(Functional):
    """Largest closure of some conditions so far."""

    differentiable: ClassVar[bool] = False

    conditions: Annotated[Integers, "conditions"]  #: places in the memory of gaskets, (c,)

    def value(self, state: State) -> float:
        """Value up to the time of the answer."""
        if LARGEST_CLOSURE not in state.memory:
            return 0.0
        return float(state.memory[LARGEST_CLOSURE][self.conditions].max(initial=0.0))

    def indices(self) -> dict[str, np.ndarray]:
        """Conditions."""
        return {"conditions": self.conditions}


@dataclass(frozen=True)
class LargestClosure(OfContact):
    """Largest closure of a :class:`~hhr_dolfinx.GasketLayer` so far, a length."""

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`~hhr_dolfinx.outputs.Output`.

        Args:
            probe: interface of the model.
        """
        remedy = "has no gasket: give its pair law=hhr.GasketLayer(loading)"
        _, places = places_in_memory(probe, self, "gaskets", remedy)
        return Closed(self.name, self.unit, *no_rows(), places)
