"""Facet ``steps`` of friction, see :class:`~hhr_dolfinx.models.histories.steps.Steps`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hhr_dolfinx.contact.law import StepContact
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.histories.increments import Increments
from hhr_dolfinx.models.histories.steps import Steps
from hhr_dolfinx.plugins.friction.laws import SLIP, SlipState
from hhr_dolfinx.plugins.friction.slider import Slider
from hhr_dolfinx.plugins.friction.surfaces import FarSliding, Surface


class _Steps(Steps):
    def increments(self, model: Any, settings: MarchSettings) -> Increments:
        return Slider(model, settings.gradient)

    def step_contact(self, model: Any, before: Answer, point: np.ndarray) -> StepContact:
        from hhr_dolfinx.plugins.friction.rubbing_step import RubbingStep

        return RubbingStep(model, point, before.memory[SLIP], before.multipliers)

    def condensed_stepper(self, model: Any, settings: MarchSettings) -> Any:
        from hhr_dolfinx.plugins.friction.rubbing_flow import RubbingFlowStepper

        return RubbingFlowStepper(model, settings)

    def at_rest(self, model: Any) -> Memory:
        return Memory(slip=SlipState.at_rest(Surface.of(model).whole))

    def watch(self, model: Any) -> Callable[[Answer], None]:
        far = FarSliding()
        friction = Surface.of(model).whole
        return lambda answer: far.check(friction, answer.memory[SLIP], model.parameters.described(answer.parameter))

    def coupling(self, model: Any, point: np.ndarray) -> float:
        if model.equilibrium is not None:  # each linearisation has another S
            return np.nan
        from hhr_dolfinx.plugins.friction.uniqueness import coupling

        contact = model.contacts()(point)
        coefficient, _ = model.law.bounds(point)
        return np.nan if contact.floating is not None else coupling(contact.schur, model.law, coefficient)

    def known_error(self, known: str) -> str:
        return f"{known}; with friction of one answer, of several unless uniqueness(mu) says 'one answer'"


STEPS = _Steps()
