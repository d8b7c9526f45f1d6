"""Facet ``steps`` of a law of interfaces: what it does in the histories of models."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.contact.interface import Interface
from hhr_dolfinx.contact.law import UNILATERAL_STEP, ContactLaw, StepContact
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.memory import NO_MEMORY, Memory

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.models.histories.equilibrium import MarchSettings
    from hhr_dolfinx.models.histories.increments import Increments


class Steps:
    """Base of the facet: what a law does not override is refused, never answered as if the law were not there."""

    # whether it completes the memory of hyper-reduced models on the whole surface; else facet ``range`` solves these
    completes: ClassVar[bool] = False

    def increments(self, model: Any, settings: MarchSettings) -> Increments:
        """Solver of the increments of a history of elastic bodies, for a model whose law remembers."""
        raise NotOfferedError(f"increments of elastic bodies are not built in with {model.law.name}")

    def step_contact(self, model: Any, before: Answer, point: np.ndarray, time: float) -> StepContact:
        """Solver of the contact problems of a step by linearisation, from an answer to a point, (P,), at a time."""
        raise NotOfferedError(f"steps by linearisation are not built in with {model.law.name}")

    def condensed_stepper(self, model: Any, settings: MarchSettings) -> Any:
        """Solver of the steps of a condensed model of bodies with laws; None for the usual one."""
        raise NotOfferedError(f"condensed bodies with laws are not built in with {model.law.name}")

    def at_rest(self, model: object) -> Memory:
        """Memory of undeformed bodies."""
        return NO_MEMORY

    def watch(self, model: object) -> Callable[[Answer], None]:
        """Check of the ends of the steps of one history."""
        return lambda answer: None

    def coupling(self, model: object, point: np.ndarray) -> float:
        """Strength of the coupling of the rows at a point, (P,), see :meth:`AnsweringModel.coupling`; here unknown."""
        return math.nan

    def known_error(self, known: str) -> str:
        """Line on the errors of answers of elastic bodies, from that of unilateral contact."""
        return known


class UnilateralSteps(Steps):
    """Unilateral contact remembers nothing."""

    def step_contact(self, model: object, before: Answer, point: np.ndarray, time: float) -> StepContact:
        """By the active set."""
        return UNILATERAL_STEP

    def condensed_stepper(self, model: object, settings: MarchSettings) -> Any:
        """The usual one."""
        return None

    def coupling(self, model: object, point: np.ndarray) -> float:
        """None."""
        return 0.0


class InterfaceSteps(Steps):
    """Laws of several plug-ins, or without memory; their increments are in :mod:`.ranges`."""

    completes = True

    def increments(self, model: Any, settings: MarchSettings) -> Increments:
        """All laws together."""
        from hhr_dolfinx.models.histories.ranges import RangesIncrements

        if settings.limit:
            raise NotOfferedError(
                f"derivatives of the limit of small increments are not built in with {model.law.name}: take those of "
                "the increments, MarchSettings(gradient=True)"
            )
        return RangesIncrements(model, settings.gradient)

    def step_contact(self, model: Any, before: Answer, point: np.ndarray, time: float) -> StepContact:
        """All laws on the S of each linearisation."""
        from hhr_dolfinx.models.histories.ranges import RangesStep

        return RangesStep(model.law, before, point, time)

    def at_rest(self, model: Any) -> Memory:
        """Of all laws."""
        memory = NO_MEMORY
        for part in model.law.ranges:
            memory = memory | part.solver().at_rest()
        return memory

    def watch(self, model: Any) -> Callable[[Answer], None]:
        """Of all laws."""
        solvers = [part.solver() for part in model.law.ranges]

        def check(answer: Answer) -> None:
            for solver in solvers:
                solver.check(answer.memory, model.parameters.described(answer.parameter))

        return check

    def coupling(self, model: Any, point: np.ndarray) -> float:
        """Sum over the laws: |e|_S^2 of the difference e of two solutions is at most the sum of their parts in it."""
        if model.equilibrium is not None or (contact := model.contacts()(point)).kernel is not None:
            return math.nan
        return sum(part.solver().coupling(contact.schur, part.rows, point) for part in model.law.ranges)

    def known_error(self, known: str) -> str:
        """With several answers the error refers to one of them."""
        return f"{known}; of one answer, of several unless uniqueness(mu) says 'one answer'"


_UNILATERAL = UnilateralSteps()
_INTERFACE = InterfaceSteps()


def steps_of(law: ContactLaw) -> Steps:
    """The facet of a law; NotOfferedError if its plug-in does not have it."""
    if not law.plugin:
        return _UNILATERAL
    if isinstance(law, Interface):
        return _INTERFACE
    found: Steps = registry.facet(law.plugin, "steps", f"what contacts with {law.name} do along a path")
    return found
