"""Outputs of wear."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.models.functionals.functional import Functional, State
from hhr_dolfinx.outputs import OfContact, no_rows
from hhr_dolfinx.plugins.contact_laws.readings import places_in_memory
from hhr_dolfinx.plugins.wear.laws import WORN

if TYPE_CHECKING:
    from hhr_dolfinx.outputs import ModelProbe


@dataclass(frozen=True, eq=False)
class Worn(Functional):
    """Worn depth of some conditions: the largest one, or their sum over the areas."""

    differentiable: ClassVar[bool] = False

    conditions: Annotated[Integers, "conditions"]  #: places in the memory of wear, (c,)
    areas: Annotated[Floats, "conditions"]  #: (c,)
    largest: bool

    def value(self, state: State) -> float:
        """Value up to the time of the answer."""
        if WORN not in state.memory:
            return 0.0
        depth = state.memory[WORN][self.conditions]
        return float(depth.max(initial=0.0) if self.largest else self.areas @ depth)

    def indices(self) -> dict[str, np.ndarray]:
        """Conditions."""
        return {"conditions": self.conditions}


@dataclass(frozen=True)
class WornDepth(OfContact):
    """Largest depth that a contact with :class:`~hhr_dolfinx.ArchardWear` has lost."""

    largest: ClassVar[bool] = True

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`~hhr_dolfinx.outputs.Output`.

        Args:
            probe: interface of the model.

        Raises:
            SceneError: for a contact without wear.
        """
        remedy = "does not wear: give its pair law=hhr.ArchardWear(constant, speed)"
        conditions, places = places_in_memory(probe, self, "wear", remedy)
        areas = probe.problem.contact_areas[conditions]
        areas = areas * probe.problem.shares_of(self.contact)[conditions]
        return Worn(self.name, self.unit, *no_rows(), places, areas, self.largest)


@dataclass(frozen=True)
class WornVolume(WornDepth):
    """Volume that a contact with :class:`~hhr_dolfinx.ArchardWear` has lost: per unit depth in the
    plane, of the whole turn in axisymmetry.
    """

    largest: ClassVar[bool] = False
