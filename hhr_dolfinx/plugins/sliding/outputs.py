"""Outputs of pressures on surfaces that slide, whose forces no condition of the model has."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.functionals.kinds import Largest, Loaded, OfPressures
from hhr_dolfinx.outputs import (
    ContactWidth,
    LargestPressure,
    LostContact,
    NamedOutput,
    OfContact,
    no_rows,
)
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.plugins.friction.laws import SLIP
from hhr_dolfinx.plugins.sliding.pressures import FACING

if TYPE_CHECKING:
    from hhr_dolfinx.models.functionals.functional import Functional, State
    from hhr_dolfinx.outputs import ModelProbe

KINDS = (LargestPressure, ContactWidth, LostContact)
"""Outputs of pressures that surfaces have wherever they are."""


@dataclass(frozen=True, eq=False)
class _OfSlaves(OfPressures):
    """Output of the pressures of some slave nodes, whose numbers are ``conditions``."""

    uses_forces: ClassVar[bool] = False
    differentiable: ClassVar[bool] = False

    def facing(self, state: State) -> np.ndarray:
        """Area of each slave node that faces the master, (c,)."""
        if FACING not in state.memory:
            return self.areas
        areas: np.ndarray = self.areas * state.memory[FACING][self.conditions]
        return areas

    def pressures(self, state: State) -> np.ndarray:
        """Pressure of each slave node, (c,); zero at rest."""
        if SLIP not in state.memory:
            return np.zeros(self.areas.size)
        pressures: np.ndarray = state.memory[SLIP].pressure[self.conditions] / self.facing(state)
        return pressures


@dataclass(frozen=True, eq=False)
class LargestOfSlaves(_OfSlaves, Largest):
    """Largest pressure of slave nodes."""


@dataclass(frozen=True, eq=False)
class LoadedOfSlaves(_OfSlaves, Loaded):
    """Area of slave nodes under load times a factor and an offset."""

    def value(self, state: State) -> float:
        """Area of the parts that face the master, where the pressure exceeds a part of the
        largest.
        """
        return float(self.offset + self.factor * self.facing(state)[self._loaded(state)].sum())


@dataclass(frozen=True)
class OfSlaves(NamedOutput):
    """An output of the pressures of a pair that slides, one of :data:`KINDS`."""

    given: OfContact
    before: tuple[Tag, ...]  #: tags of the slaves of the pairs that slide, before its own

    @classmethod
    def of(cls, output: OfContact, slaves: dict[int, Tag]) -> OfSlaves:
        """The output that reads slave nodes.

        Args:
            output: output of a pair that slides.
            slaves: tag of the slave of each pair that slides, by its number.
        """
        before = tuple(tag for number, tag in slaves.items() if number < output.contact)
        return cls(output.name, output, before, unit=output.unit)

    def prepared(self, probe: ModelProbe) -> Functional:
        """Functional of this output, see :class:`~hhr_dolfinx.outputs.Output`.

        Args:
            probe: interface of the model.

        Raises:
            SceneError: for a surface without area.
        """
        surface = probe.discretisation.surface
        first = sum(surface(tag).nodes.size for tag in self.before)
        areas = surface(probe.scene.contacts[self.given.contact].tags[0]).areas
        loaded = np.flatnonzero(areas > 0)
        if not loaded.size:
            raise SceneError(f"output '{self.name}': its contact has no area")
        known = self.name, self.unit, *no_rows(), first + loaded, areas[loaded]
        if isinstance(self.given, LargestPressure):
            return LargestOfSlaves(*known)
        area = LoadedOfSlaves(*known, 0.0, 1.0)
        if isinstance(self.given, LostContact):
            return replace(area, offset=1.0, factor=-1.0 / float(areas.sum()))
        return area
