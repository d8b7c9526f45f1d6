"""What answers paths: the law of the contact conditions, by its facet ``steps``, or bodies with
laws.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.contact.law import UNILATERAL_STEP, ContactLaw, StepContact
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.memory import NO_MEMORY, Memory
from hhr_dolfinx.models.histories.path import solve_along

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer, History, Model, Path
    from hhr_dolfinx.models.histories.equilibrium import MarchSettings


class Steps:
    """Base of the facet: what a law does not override is refused, never answered as if the law were
    not there.
    """

    #: whether it completes the memory of hyper-reduced models on the whole surface; else facet
    #: ``range`` solves these
    completes: ClassVar[bool] = False

    def march(self, model: Any, path: Path, settings: MarchSettings, **how: Any) -> History:
        """See :class:`~hhr_dolfinx.models.histories.equilibrium.Histories`."""
        raise NotOfferedError(f"histories are not built in with {model.law.name}")

    def one_step(
        self,
        model: Any,
        point: np.ndarray,
        raise_on_failure: bool,
        outside: str,
        gradient: bool,
        **step: Any,
    ) -> Answer:
        """See :class:`~hhr_dolfinx.models.histories.equilibrium.Histories`."""
        raise NotOfferedError(f"answers to single points are not built in with {model.law.name}")

    def increments(self, model: Any, settings: MarchSettings) -> Any:
        """Solver of the increments of a history of elastic bodies, for a model whose law
        remembers.
        """
        raise NotOfferedError(
            f"increments of elastic bodies are not built in with {model.law.name}"
        )

    def step_contact(
        self, model: Any, before: Answer, point: np.ndarray, time: float, last: Any = None
    ) -> StepContact:
        """Solver of contact problems of a step of bodies with laws, from an answer to a point,
        (P,), at a time.

        Factors of ``last``, that of another step on the same S, may serve again.
        """
        raise NotOfferedError(f"steps by linearisation are not built in with {model.law.name}")

    def at_rest(self, model: object) -> Memory:
        """Memory of undeformed bodies."""
        return NO_MEMORY

    def watch(self, model: object) -> Callable[[Answer], None]:
        """Check of the ends of the steps of one history."""
        return lambda answer: None

    def coupling(self, model: object, point: np.ndarray) -> float:
        """Strength of the coupling of the rows at a point, (P,), see
        :meth:`AnsweringModel.coupling`; here unknown.
        """
        return math.nan

    def known_error(self, known: str) -> str:
        """See :class:`~hhr_dolfinx.models.histories.equilibrium.Histories`."""
        return known


class UnilateralSteps(Steps):
    """Unilateral contact remembers nothing: each point of a path has its answer."""

    def march(self, model: Model, path: Path, settings: MarchSettings, **how: Any) -> History:
        """Point by point."""
        return solve_along(model, path, settings, **how)

    def step_contact(
        self, model: Any, before: Answer, point: np.ndarray, time: float, last: Any = None
    ) -> StepContact:
        """By the active set."""
        return UNILATERAL_STEP

    def coupling(self, model: object, point: np.ndarray) -> float:
        """None."""
        return 0.0


_UNILATERAL = UnilateralSteps()


def steps_of(law: ContactLaw) -> Steps:
    """The facet of a law; NotOfferedError if its plug-in does not have it."""
    if not law.plugin:
        return _UNILATERAL
    found: Steps = registry.facet(
        law.plugin, "steps", f"what contacts with {law.name} do along a path"
    )
    return found
