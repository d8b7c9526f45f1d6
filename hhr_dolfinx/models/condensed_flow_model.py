"""The model of condensed flow: histories with all contact conditions and a reduced plastic correction."""

from __future__ import annotations

from typing import Any

from hhr_dolfinx.models.condensed_fields import CondensedFlowFields
from hhr_dolfinx.models.condensed_flow import CondensedEquilibrium, CondensedFlow
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.trained import TrainedPaths


class CondensedFlowModel(AnsweringModel):
    """Answers paths of bodies that flow, see :mod:`hhr_dolfinx.models.condensed_flow`.

    Several threads may ask one model; it can be copied and pickled.

    Args:
        flow: arrays of the step.
        parameters: the box of the parameters.
        fields: what completes the answers.
        trained: what it was trained on.
        offline: how it was made, a ``CorrectionRecord``; None for a model from a file.
    """

    file_format = "condensed flow"

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

    def __reduce__(self) -> tuple:
        """Copy and pickle by the arrays; how the model was made stays behind."""
        return CondensedFlowModel, (self.flow, self.parameters, self.fields, self.trained)

    def changed(self, **parts: Any) -> CondensedFlowModel:
        """The same model with some parts in the place of its own, by the names of its arguments."""
        names = ("flow", "parameters", "fields", "trained", "offline")
        return CondensedFlowModel(**{name: getattr(self, name) for name in names} | parts)
