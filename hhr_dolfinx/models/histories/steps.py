"""Steps of paths: the facet ``steps`` of the law of the contact conditions."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Unpack

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.contact.law import UNILATERAL_STEP, ContactLaw, StepContact
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.memory import NO_MEMORY, Memory
from hhr_dolfinx.models.histories.equilibrium import Answering
from hhr_dolfinx.models.histories.path import solve_along

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer, HasLaw, History, Model, Path
    from hhr_dolfinx.models.histories.equilibrium import Following, MarchSettings, StepOptions


class Steps(Generic[Answering]):
    """Base of the facet ``steps``.

    A method that a law does not override is refused, never answered as if the law were not there.
    """

    #: whether it completes the memory of hyper-reduced models on the whole surface; else facet
    #: ``range`` solves these
    completes: ClassVar[bool] = False

    def march(
        self, model: Answering, path: Path, settings: MarchSettings, **how: Unpack[Following]
    ) -> History:
        """See :class:`~hhr_dolfinx.models.histories.equilibrium.Histories`.

        Args:
            model: model that answers.
            path: times and parameters.
            settings: settings of the solution.
            **how: ``known`` and ``keep``.

        Raises:
            NotOfferedError: if the law does not override it.
        """
        raise NotOfferedError(f"histories are not built in with {model.law.name}")

    def one_step(
        self,
        model: Answering,
        point: np.ndarray,
        raise_on_failure: bool,
        outside: str,
        gradient: bool,
        **step: Unpack[StepOptions],
    ) -> Answer:
        """See :class:`~hhr_dolfinx.models.histories.equilibrium.Histories`.

        Args:
            model: model that answers.
            point: checked parameter, (P,).
            raise_on_failure: raise instead of returning NaN and a status.
            outside: policy outside the training range.
            gradient: compute the derivatives along the parameters.
            **step: further arguments of ``solve`` of the model.

        Raises:
            NotOfferedError: if the law does not override it.
        """
        raise NotOfferedError(f"answers to single points are not built in with {model.law.name}")

    def increments(self, model: Answering, settings: MarchSettings) -> Any:
        """Solver of the increments of a history of elastic bodies.

        The law of the model remembers.

        Args:
            model: model that answers.
            settings: settings of the solution.

        Raises:
            NotOfferedError: if the law does not override it.
        """
        raise NotOfferedError(
            f"increments of elastic bodies are not built in with {model.law.name}"
        )

    def step_contact(
        self,
        model: Any,
        before: Answer,
        point: np.ndarray,
        time: float,
        last: StepContact | None = None,
    ) -> StepContact:
        """Solver of the contact problems of a step of bodies with laws.

        Args:
            model: model that answers.
            before: answer at the start of the step.
            point: parameter at its end, (P,).
            time: time of its end, in seconds.
            last: solver of another step on the same S, whose factors may serve again; None without
                one.

        Raises:
            NotOfferedError: if the law does not override it.
        """
        raise NotOfferedError(f"steps by linearisation are not built in with {model.law.name}")

    def at_rest(self, model: HasLaw, gaps: np.ndarray, point: np.ndarray) -> Memory:
        """Memory of undeformed bodies.

        Args:
            model: model that answers.
            gaps: gaps of its conditions, (m,).
            point: parameter at rest, (P,).
        """
        return NO_MEMORY

    def watch(self, model: HasLaw) -> Callable[[Answer], None]:
        """Check of the ends of the steps of one history."""
        return lambda answer: None

    def coupling(self, model: Answering, point: np.ndarray) -> float:
        """Strength of the coupling of the rows, see :meth:`AnsweringModel.coupling`; unknown here.

        Args:
            model: model that answers.
            point: parameter, (P,).
        """
        return math.nan

    def known_error(self, known: str) -> str:
        """See :class:`~hhr_dolfinx.models.histories.equilibrium.Histories`."""
        return known


class UnilateralSteps(Steps["Model"]):
    """Unilateral contact remembers nothing: each point of a path has its answer."""

    def march(self, model: Model, path: Path, settings: MarchSettings, **how: Any) -> History:
        """Point by point.

        Args:
            model: model that answers.
            path: times and parameters.
            settings: settings of the solution.
            **how: ``known`` and ``keep``.
        """
        return solve_along(model, path, settings, **how)

    def step_contact(
        self,
        model: HasLaw,
        before: Answer,
        point: np.ndarray,
        time: float,
        last: StepContact | None = None,
    ) -> StepContact:
        """Solver by the active set.

        Args:
            model, before, point, time, last: not used.
        """
        return UNILATERAL_STEP

    def coupling(self, model: Model, point: np.ndarray) -> float:
        """Zero: rows are not coupled by the law.

        Args:
            model, point: not used.
        """
        return 0.0


_UNILATERAL = UnilateralSteps()


def steps_of(law: ContactLaw) -> Steps:
    """The facet of a law.

    Raises:
        NotOfferedError: if its plug-in does not have it.
    """
    if not law.plugin:
        return _UNILATERAL
    steps: Steps = registry.facet(
        law.plugin, "steps", f"what contacts with {law.name} do along a path"
    )
    return steps
