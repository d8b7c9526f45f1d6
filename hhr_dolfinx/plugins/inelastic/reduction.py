"""Reduction of inelastic bodies: the facet ``reduction``, see :mod:`hhr_dolfinx.reduction.laws`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.certify.compare import Comparison
from hhr_dolfinx.certify.trust import TrustLimits
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.plugins.inelastic.comparison import checked_histories
from hhr_dolfinx.plugins.inelastic.completion import FlowFields, GappyField
from hhr_dolfinx.plugins.inelastic.full_order import equilibrium_of
from hhr_dolfinx.plugins.inelastic.recipe import flowing
from hhr_dolfinx.plugins.inelastic.state import flowed, rows_of, states_of
from hhr_dolfinx.reduction.modes import state_modes
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.trained import Trained

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel

STRESS = 1e-9
PLASTIC_STRAIN = 1e-6
"""Part of the squared training fields that the modes for stress and for cumulated plastic strain leave out."""


@dataclass(frozen=True)
class FittedFlow:
    """POD modes of the fields of Gauss points in training; None if they are zero."""

    stress: np.ndarray | None = None  # of the stress, (Gauss points * components, modes)
    plastic_strain: np.ndarray | None = None  # of the cumulated plastic strain, (Gauss points, modes)

    @classmethod
    def of(cls, snapshots: SnapshotSet) -> FittedFlow:
        """Modes of training answers."""
        known = states_of(snapshots)
        if not known:
            return cls()
        stress = state_modes([item.stress.ravel() for item in known], STRESS)
        if not flowed(snapshots):
            return cls(stress)
        return cls(stress, state_modes([item.state.cumulated for item in known], PLASTIC_STRAIN))

    def completion(self, flow: Any) -> FlowFields:
        """Reconstruction of stress and cumulated plastic strain from the Gauss points of the RID (section 6.2.3)."""
        if self.stress is None:
            raise ReductionError("these snapshots hold no stress: give histories of a scene whose bodies flow")
        components = flow.material.components
        points = flow.points
        stress = GappyField.fitted(self.stress, rows_of(points, components))
        flowed = None if self.plastic_strain is None else GappyField.fitted(self.plastic_strain, points)
        return FlowFields(points, stress, flowed, len(self.stress) // components)


class _Reduction:
    """See :class:`hhr_dolfinx.reduction.laws.ReducedBodies`."""

    def recipes(self) -> tuple[Recipe, ...]:
        """The usual recipe."""
        return (flowing(),)

    def check_given(self, full: FullModel, name: str, solutions: SnapshotSet) -> None:
        """Raise ReductionError for solutions that are no histories, or those of elastic bodies or another mesh."""
        if not solutions.histories:
            raise ReductionError(f"{name} of a scene whose bodies flow must be histories: SnapshotSet.of_histories")
        if not solutions.states:
            raise ReductionError(f"bodies of the model flow, and none of {name} do: they belong to another scene")
        size = equilibrium_of(full).material.gauss_points
        if (given := len(states_of(solutions)[0].state.cumulated)) != size:
            raise ReductionError(f"{name} have {given} Gauss points, the model {size}: they belong to another mesh")

    def fitted(self, snapshots: SnapshotSet) -> FittedFlow:
        """Modes of stress and plastic strain."""
        return FittedFlow.of(snapshots)

    def checked(
        self,
        full: FullModel,
        model: Any,
        snapshots: SnapshotSet,
        held_out: SnapshotSet | None,
        limits: TrustLimits | None,
        remedy: str | Mapping[str, str],
    ) -> tuple[Comparison | None, Trained | None]:
        """Errors against known histories, and the training range."""
        return checked_histories(full, model, snapshots, held_out, limits, remedy)


REDUCTION = _Reduction()
