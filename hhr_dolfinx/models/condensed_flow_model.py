"""The model of condensed flow: histories with all contact conditions and a reduced plastic correction."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hhr_dolfinx.materials.update import Material
from hhr_dolfinx.models.condensed_fields import CondensedFlowFields
from hhr_dolfinx.models.condensed_flow import CondensedEquilibrium, CondensedFlow
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.trained import TrainedPaths


class CondensedFlowModel(KeptModel):
    """Answers paths of bodies that flow, see :mod:`hhr_dolfinx.models.condensed_flow`.

    Several threads may ask one model; it can be copied and pickled.

    Args:
        flow: arrays of the step.
        parameters: the box of the parameters.
        fields: what completes the answers.
        trained: what it was trained on.
        offline: how it was made, a ``CorrectionRecord``; None for a model from a file.
    """

    kept = ("flow", "parameters", "fields", "trained")

    def __init__(
        self,
        flow: CondensedFlow,
        parameters: ParameterSpace,
        fields: CondensedFlowFields,
        trained: TrainedPaths | None = None,
        *,
        offline: Any = None,
    ):
        self.flow, self.parameters, self.fields, self.trained, self.offline = flow, parameters, fields, trained, offline
        self.equilibrium = CondensedEquilibrium(flow, fields.amplitudes, parameters, fields)
        self.equilibrium.trained = trained

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """See :class:`KeptModel`."""
        yield from super().faults(sizes)
        flow, fields, space = self.flow, self.fields, self.parameters
        if flow.components != (4 if fields.dimension == 2 else 6):
            yield f"{flow.components} components of a strain in dimension {fields.dimension}"
        if not np.array_equal(flow.points, fields.flow.points):
            yield "the points of the step and those from which fields are completed are not the same"
        if fields.factors.moduli != flow.factors.moduli or not np.array_equal(
            fields.factors.middle, flow.factors.middle
        ):
            yield "the moduli of the step and those of the fields are not the same"
        if fields.parts.min() < 0 or fields.parts.max() >= len(flow.schur):
            yield "fields.parts has indices outside the parts of the stiffness"
        yield from flow.factors.faults_for(space)
        yield from Material(flow.groups, flow.components, space.names).faults_for(space, fields.dimension)
        factors = [modulus.factor for modulus in flow.factors.moduli] or ["1"]
        for group in flow.groups:
            own = group.young if isinstance(group.young, str) else "1"
            if {factors[part] for part in np.unique(flow.parts[group.indices])} != {own}:
                yield f"points with young = {group.young} are not on the part of this modulus"
