"""Facet ``steps``: histories of laws of contacts by increments, those of several laws in one scene
too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Unpack, cast

import numpy as np

from hhr_dolfinx.contact.law import StepContact
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.memory import NO_MEMORY, Memory
from hhr_dolfinx.models.answer import Answer, HasLaw, History, Path
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.histories.steps import Steps
from hhr_dolfinx.plugins.contact_laws.increments import Increments, follow, proportional, single
from hhr_dolfinx.plugins.contact_laws.interface import ranged
from hhr_dolfinx.plugins.contact_laws.range_increments import RangesIncrements, RangesStep

if TYPE_CHECKING:
    from hhr_dolfinx.models.histories.equilibrium import Following
    from hhr_dolfinx.models.model import AnsweringModel
    from hhr_dolfinx.plugins.contact_laws.interface import Interface


class LawSteps(Steps["AnsweringModel"]):
    """Base of the facet of a law whose increments are solved one after another, see
    :mod:`.increments`.
    """

    def march(
        self, model: AnsweringModel, path: Path, settings: MarchSettings, **how: Unpack[Following]
    ) -> History:
        """History along a path, see :func:`follow`.

        Args:
            model: model with the law.
            path: checked path.
            settings: settings of the history.
            **how: further arguments of :func:`follow`.
        """
        return follow(model, path, settings, **how)

    def one_step(
        self,
        model: AnsweringModel,
        point: np.ndarray,
        raise_on_failure: bool,
        outside: str,
        gradient: bool,
        **step: Any,
    ) -> Answer:
        """Answer to a point: one proportional load from rest, or one increment without memory.

        Args:
            model: model with the law.
            point: parameter, (P,).
            raise_on_failure: raise instead of returning NaN and a status.
            outside: policy outside the training range.
            gradient: compute the derivatives along the parameters.
            **step: ``converged``, see :func:`proportional`.

        Raises:
            NotOfferedError: for other keywords.
        """
        if step.keys() - {"converged"}:
            raise NotOfferedError(f"solve knows no {', '.join(step)} here: all bodies are elastic")
        if not model.law.path_dependent:
            return single(model, point, raise_on_failure, outside, gradient)
        return proportional(model, point, raise_on_failure, outside, gradient, **step)

    def step_contact(
        self,
        model: Any,
        before: Answer,
        point: np.ndarray,
        time: float,
        last: Any = None,
    ) -> StepContact:
        """All laws on the S of each linearisation, by their facet ``range``.

        Args:
            model: model with the law.
            before: answer at the start of the step.
            point: parameter, (P,).
            time: time at the end of the step in seconds.
            last: contact problems of another step, whose factors can serve; None for none.
        """
        return RangesStep(ranged(model.law, model.conditions), before, point, time, last)

    def at_rest(self, model: HasLaw, gaps: np.ndarray, point: np.ndarray) -> Memory:
        """Of all laws.

        Args:
            model: model with the laws.
            gaps: gaps of its rows, (M,).
            point: parameter at rest, (P,).
        """
        memory = NO_MEMORY
        for law_range in ranged(model.law, model.conditions).ranges:
            rows = gaps[law_range.rows]
            memory = memory | law_range.solver().memory_at_rest(rows, point)
        return memory

    def watch(self, model: HasLaw) -> Callable[[Answer], None]:
        """Of all laws."""
        solvers = [law_range.solver() for law_range in ranged(model.law, model.conditions).ranges]

        def check(answer: Answer) -> None:
            for solver in solvers:
                solver.check(answer.memory, model.parameters.described(answer.parameter))

        return check


class InterfaceSteps(LawSteps):
    """Laws of several plug-ins, or without memory.

    Their increments are in :mod:`.range_increments`.
    """

    completes = True

    def increments(self, model: AnsweringModel, settings: MarchSettings) -> Increments:
        """Increments of all laws together.

        Args:
            model: model with the law.
            settings: settings of the history.

        Raises:
            NotOfferedError: for derivatives of the limit of small increments.
        """
        if settings.limit:
            raise NotOfferedError(
                "derivatives of the limit of small increments are not built in with "
                f"{model.law.name}: take those of the increments, MarchSettings(gradient=True)"
            )
        return RangesIncrements(model, settings.gradient)

    def coupling(self, model: AnsweringModel, point: np.ndarray) -> float:
        """Sum over the laws of their part in the difference of two solutions.

        |e|_S^2 of the difference e is at most this sum.

        Args:
            model: model with the law.
            point: parameter, (P,).
        """
        if model.equilibrium is not None or (contact := model.contacts()(point)).kernel is not None:
            return math.nan
        return sum(
            law_range.solver().coupling(contact.schur, law_range.rows, point)
            for law_range in cast("Interface", model.law).ranges
        )

    def known_error(self, known: str) -> str:
        """With several answers the error refers to one of them."""
        return f"{known}; of one answer, of several unless uniqueness(mu) says 'one answer'"


INTERFACE_STEPS = InterfaceSteps()
"""The facet, without state."""
