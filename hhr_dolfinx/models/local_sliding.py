"""Local models of elastic bodies with friction: several hyper-reduced models that take turns along a path.

Bodies that come into contact, stick, slip and turn round press in different places, and each takes fewer modes and
contacts than all of them. What friction remembers is of the whole contact surface, so that any model goes on where
another one ended. The one at work goes on while its modes explain its forces as well as they did; else all of them try
the increment, and the one whose indicator is least takes over.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hhr_dolfinx.errors import NotOfferedError, ReductionError
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.fallback import ALIKE
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.histories.sliding import Reached, Slider, Solved, Target, Turn
from hhr_dolfinx.models.local import SeveralModels
from hhr_dolfinx.models.reduced import ADVICE, ReducedModel
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.trained import TrainedRange

GROWN = 2.0
"""Factor over the least indicator since all models were asked last, above which they are asked again."""
EXPLAINED = 5e-3
"""Indicator, a relative error of forces, that asks for nothing better."""


class LocalSliding(SeveralModels):
    """Hyper-reduced models of one scene with friction in which nothing flows, each for some increments; used like one.

    Args:
        models: the models, of the same scene.
        trained: range of what they were trained on together; None lets everything pass.
        offline: how they were made; None where that is not known.

    Attributes:
        models, trained, offline: see above.
        parameters: the box.

    Raises:
        ReductionError: for models of several scenes, without friction, or whose bodies flow.
    """

    kept = ("models", "trained")
    advice = ADVICE

    def __init__(self, models: Sequence[ReducedModel], trained: TrainedRange | None = None, offline: Any = None):
        self.models = tuple(models)
        self.trained = trained
        self.offline = offline
        _check_alike(self.models)
        self.parameters: ParameterSpace = self.models[0].parameters
        self.friction = self.models[0].fields.frictional.friction
        self._range = trained

    @property
    def sizes(self) -> tuple[int, int]:
        """Those of answers of the first model."""
        return self.models[0].sizes

    @property
    def own_conditions(self) -> int:
        """Number of conditions of the first model; others may have more, or fewer."""
        return self.models[0].own_conditions

    def coupling(self, mu: Any) -> float:
        """See :class:`AnsweringModel`: the largest of its models, any of which may answer."""
        return float(np.max([model.coupling(mu) for model in self.models]))

    def slider(self, settings: MarchSettings) -> Any:
        """What solves increments with friction.

        Raises:
            NotOfferedError: for derivatives.
        """
        if settings.gradient:
            raise NotOfferedError(
                "local models with friction hand on what has slipped, and no derivatives of it: ask one model for the "
                "gradient, build() or condense()"
            )
        return LocalSlider(self)


class LocalSlider:
    """Solves increments by models that take turns; what it offers is that of :class:`Slider`.

    Args:
        model: the models.

    Attributes:
        surface: the whole contact surface, of which slip is remembered.
        energy: elastic energy of contact so far.
    """

    def __init__(self, model: LocalSliding):
        self.model = model
        self.energy = 0.0
        self._sliders = [Slider(part) for part in model.models]
        self.surface = self._sliders[0].surface

    @property
    def largest(self) -> float:
        """Largest norm of forces of any model so far."""
        return max(slider.largest for slider in self._sliders)

    def at_rest(self, time: float, point: np.ndarray, weights: np.ndarray) -> Reached:
        """Undeformed bodies, of which nothing has slipped."""
        return self._sliders[0].at_rest(time, point, weights)

    def increment(self, before: Reached, target: Target) -> Solved:
        """One increment by the model at work, or by the best of all where this one knows too little; settled or not."""
        tried: list[tuple[float, int, Solved]] = []
        if before.turn is not None:
            said, number, solved = self._tried(before.turn.number, before, target)
            if solved.settled and np.isfinite(said) and said <= GROWN * max(before.turn.least, EXPLAINED):
                return _turned(solved, Turn(number, min(before.turn.least, said)))
            tried.append((said, number, solved))
        asked = {number for _, number, _ in tried}
        tried += [self._tried(k, before, target) for k in range(len(self._sliders)) if k not in asked]
        said, number, solved = min(tried, key=lambda one: (not one[2].settled, one[0]))
        found = solved.found._replace(iterations=sum(one.found.iterations for _, _, one in tried))
        return _turned(solved._replace(found=found), Turn(number, said))

    def _tried(self, number: int, before: Reached, target: Target) -> tuple[float, int, Solved]:
        """An increment by one model, behind what it says of its error, and its number."""
        slider = self._sliders[number]
        solved = slider.increment(self._carried(before, number), target)
        estimate = slider.answer(solved).estimate() if solved.settled else None
        return np.inf if estimate is None else estimate.forces_euclid_relative, number, solved

    def _carried(self, before: Reached, number: int) -> Reached:
        """Where a history has come to as a model goes on from it: where its search starts, and which contacts are open.

        What has slipped is that of the whole surface as it is.
        """
        if before.turn is None:
            return self._sliders[number].at_rest(before.time, before.point, before.weights)
        if before.turn.number == number:
            return before
        assert before.active is not None
        source, own = (self.model.models[k].fields.frictional for k in (before.turn.number, number))
        forces = source.forces(before.forces, before.point)
        active = source.active(before.active, forces, before.slip.bound)
        gap = (forces[own.within][own.inside.normal] <= 0).astype(float)
        return before._replace(forces=forces[own.within], active=active[own.within], gap=gap)

    def held(self, before: Reached, after: Reached) -> float:
        """See :meth:`Slider.held`, by the model that solved the increment."""
        assert after.turn is not None
        return self._sliders[after.turn.number].held(self._carried(before, after.turn.number), after)

    def forces(self, solved: Solved) -> np.ndarray:
        """Forces on the whole surface, which those of other models are compared with, (N_lambda,)."""
        assert solved.reached.turn is not None
        frictional = self.model.models[solved.reached.turn.number].fields.frictional
        return frictional.forces(solved.found.forces, solved.reached.point)

    def elastic_energy(self, solved: Solved) -> float:
        """Elastic energy of contact forces."""
        return self._sliders[0].elastic_energy(solved)

    def answer(self, solved: Solved) -> Answer:
        """What is handed out of an increment."""
        assert solved.reached.turn is not None
        return self._sliders[solved.reached.turn.number].answer(solved)


def _turned(solved: Solved, turn: Turn) -> Solved:
    """An increment that says which model has solved it."""
    return solved._replace(reached=solved.reached._replace(turn=turn))


def _check_alike(models: Sequence[ReducedModel]) -> None:
    """Raise ReductionError for models that are not of one scene, without friction, or whose bodies flow."""
    if not models or not all(isinstance(model, ReducedModel) for model in models):
        raise ReductionError("local models with friction are a list of reduced models, at least one")
    if any(model.flow is not None or model.friction is None for model in models):
        raise ReductionError("these local models flow, or have no friction: take LocalHistories, or LocalModels")
    first = models[0]
    for number, model in enumerate(models):
        mine, theirs = (
            [*item.parameters.names, *item.parameters.lower, *item.parameters.upper, len(item.fields.basis)]
            for item in (model, first)
        )
        one = model.fields.frictional.friction
        other = first.fields.frictional.friction
        same = np.array_equal(one.tangential, other.tangential) and one.laws == other.laws
        same &= np.allclose(model.fields.frictional.mark, first.fields.frictional.mark, rtol=ALIKE)
        if mine != theirs or not same or not np.array_equal(model.fields.gaps, first.fields.gaps):
            raise ReductionError(f"local model {number} is of another scene or mesh than the first one")
