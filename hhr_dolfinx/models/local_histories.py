"""Local models of histories: several reduced models, each trained on some steps, that take turns along a path.

How bodies move while they touch, flow, are unloaded and loaded again are different things, and each takes fewer modes
than all of them. The model that is at work goes on while its modes explain its stress as well as they did; else the
others try the step from the same state, and the one that explains its stress best takes over. Plastic strains are
handed on: as they are where both models evaluate their laws at the same points, else by fields on the whole mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.errors import ParameterError, ReductionError
from hhr_dolfinx.materials.update import Material, State
from hhr_dolfinx.models.answer import Answer, GaussState, History, Path
from hhr_dolfinx.models.histories.equilibrium import DEFAULT_MARCH, Diverged, Goal, MarchSettings, Stepper
from hhr_dolfinx.models.local import SeveralModels
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.trained import Signs, TrainedPaths

if TYPE_CHECKING:
    from hhr_dolfinx.models.histories.reduced_flow import CubatureEquilibrium, ReducedEquilibrium

    Part = ReducedEquilibrium | CubatureEquilibrium

GROWN = 2.0
"""Factor over the smallest misfit of the stress since the models were asked last, above which they are asked again.
Largest misfits of training say little: those of first steps, small and badly explained, are ten times those of others.
On the flowing pellet a model that goes on beyond its steps has three times its misfit two steps later, and ten times
four later. What the modes of others explain of its stress says nothing: the stress of a wrong answer is like none."""
EXPLAINED = 1e-3
"""Misfit of the stress that asks for nothing better."""


class LocalHistories(SeveralModels):
    """Reduced models of one scene whose bodies flow, each for some steps of histories; used like one of them.

    Args:
        models: the models, of the same scene.
        trained: what they were trained on together; None lets everything pass.
        offline: how they were made; None where that is not known.

    Attributes:
        models, trained, offline: see above.
        parameters: the box.
        equilibrium: what the loop over time steps asks.

    Raises:
        ReductionError: for models of several scenes, or in which nothing flows.
    """

    kept = ("models", "trained")

    def __init__(self, models: Sequence[ReducedModel], trained: TrainedPaths | None = None, offline: Any = None):
        self.models = tuple(models)
        self.trained = trained
        self.offline = offline
        _check_alike(self.models)
        self.parameters: ParameterSpace = self.models[0].parameters
        parts: Any = [model.equilibrium for model in self.models]
        self.equilibrium = LocalEquilibrium(parts, trained)

    def model_of(self, answer: Answer) -> int:
        """Number of the model that gave an answer.

        Raises:
            ReductionError: if it is an answer of none of them.
        """
        return self.equilibrium.number_of(answer)

    def models_of(self, history: History) -> np.ndarray:
        """Numbers of the models that gave the answers of a history, (steps,); of a cut step that of its last part."""
        return np.array([self.model_of(answer) for answer in history.answers], dtype=np.int64)

    @property
    def own_conditions(self) -> int:
        """Number of conditions of an answer."""
        return self.equilibrium.conditions

    def march(self, path: Path, settings: MarchSettings = DEFAULT_MARCH) -> History:
        """Solve a history from rest, see :meth:`Model.march`."""
        if settings.gradient and not self.equilibrium.shares_points:
            raise ParameterError(
                "local models with points of their own complete the state that they hand on, which has no derivative: "
                "build them without a cubature, or ask one model for the gradient"
            )
        return super().march(path, settings)


class LocalEquilibrium:
    """Steps of models that take turns, see :class:`models.histories.equilibrium.Stepping`.

    Args:
        parts: equilibria of the models.
        trained: what they were trained on together.
    """

    def __init__(self, parts: Sequence[Part], trained: TrainedPaths | None):
        self.parts = tuple(parts)
        self.trained = trained
        first = self.parts[0]
        self.parameters = first.parameters
        self.amplitudes = first.amplitudes
        self.fields = first.fields
        self.material = first.material
        self.young = first.young
        self.points = first.points
        self.together = first.together
        self.per_cell = first.per_cell
        self.size = first.size
        self.conditions = first.conditions
        self.friction = first.friction
        self.lock = nullcontext()
        self._products: dict[tuple[int, int], np.ndarray] = {}

    def at(self, point: np.ndarray) -> LocalEquilibrium:
        """The models whose elasticity is that of a point, (P,): themselves where elasticity is constant."""
        found = copy(self)
        # fields, and so what is kept of them, are the same
        found.parts = tuple(part.at(point) for part in self.parts)
        return found

    def number_of(self, answer: Answer) -> int:
        """Number of the model that gave an answer."""
        for number, part in enumerate(self.parts):
            if part.fields is answer.fields:
                return number
        raise ReductionError("this answer is not of these local models")

    def answering(self, answer: Answer) -> Part:
        """The equilibrium in which an answer was found."""
        return self.parts[self.number_of(answer)]

    def stepper(self, settings: MarchSettings) -> LocalStepper:
        """What solves the steps of a history."""
        return LocalStepper(self, settings)

    @cached_property
    def shares_points(self) -> bool:
        """Whether all models evaluate their laws at the same points."""
        return all(np.array_equal(part.points, self.points) for part in self.parts)

    def moved(self, answer: Answer, number: int) -> Answer:
        """An answer with the unknown of another model that is nearest to its own."""
        source = self.number_of(answer)
        if source == number:
            return answer
        here = self.parts[source].fields
        there = self.parts[number].fields
        if (source, number) not in self._products:
            self._products[source, number] = there.basis.T @ here.basis
        found = answer._replace(unknown=self._products[source, number] @ answer.unknown, fields=there)
        if np.array_equal(here.A_lambda, there.A_lambda):
            return found
        # the search starts from none of them
        nothing = np.zeros(len(there.A_lambda))
        return found._replace(multipliers=nothing, active=nothing > 0)

    def carried(self, answer: Answer, number: int) -> Answer:
        """An answer as another model goes on from it: with its state at the points of that model."""
        source = self.number_of(answer)
        found = self.moved(answer, number)
        if source == number or self.shares_points:
            return found
        here = self.parts[source]
        there = self.parts[number]
        strain = there.strain(found.unknown, there.amplitudes(answer.parameter))
        return found._replace(gauss=_completed(answer, here.points, there.points, there.material, strain))


def _completed(
    answer: Answer, known: np.ndarray, points: np.ndarray, material: Material, strain: np.ndarray
) -> GaussState:
    """The state of an answer, known at some points, at others where the strain is known too, (points, components).

    Stress and cumulated strain are those on the whole mesh; what of the strain is no elastic one is plastic.
    """
    stress = answer.stress()[points]
    cumulated = answer.plastic_strain()[points]
    elastic = material.moduli_at(answer.parameter).elastic
    plastic = strain - np.linalg.solve(elastic, stress[:, :, None])[:, :, 0]
    # flow keeps the volume
    plastic[:, :3] -= plastic[:, :3].mean(axis=1, keepdims=True)
    plastic[cumulated == 0] = 0.0
    _, own, theirs = np.intersect1d(points, known, return_indices=True)
    plastic[own] = answer.state().state.plastic[theirs]
    return GaussState(stress, State(plastic, cumulated))


@dataclass(frozen=True)
class _Try:
    """A step by one model: what it found, with its signs, and the stepper that goes on from there."""

    number: int
    answer: Answer
    signs: Signs
    stepper: Stepper

    @property
    def unexplained(self) -> float:
        """What no mode of the model explains of its stress, from 0 to 1."""
        return self.signs.estimate


class LocalStepper:
    """Solves the steps of one history by models that take turns; see :class:`models.histories.equilibrium.Stepper`.

    Args:
        model: the models.
        settings: how.
    """

    def __init__(self, model: LocalEquilibrium, settings: MarchSettings):
        self._model = model
        self._settings = settings
        self._last: _Try | None = None
        self._hardest: _Try | None = None
        self._least = EXPLAINED

    def learn(self, answer: Answer) -> None:
        """Take in a step that was solved before."""
        number = self._model.number_of(answer)
        stepper = self._model.parts[number].stepper(self._settings)
        stepper.learn(answer)
        self._keep(_Try(number, answer, stepper.signs(answer), stepper))

    def signs(self, answer: Answer) -> Signs:
        """Signs of a solved step in its own model."""
        if self._last is not None and self._last.answer.gauss is answer.gauss:
            return self._last.signs
        return self._model.answering(answer).signs(answer)

    def step(self, trail: tuple[Answer, ...], goal: Goal) -> Answer:
        """A step by the model at work; by that which explains its stress best, where this one's misfit has grown.

        Raises:
            Diverged: if no model solves it: what the one that was asked first said.
        """
        own = None
        failure = None
        if self._last is not None:
            own, failure = self._tried(self._last.number, trail, goal, self._last.stepper)
        if own is not None and own.unexplained <= GROWN * self._least:
            self._least = max(EXPLAINED, min(self._least, own.unexplained))
            return self._keep(own)
        # the first step of a history is tried by all: nothing tells yet which of them knows it
        asked = [own] if own is not None else []
        for number in range(len(self._model.parts)):
            if self._last is None or number != self._last.number:
                found, why = self._tried(number, trail, goal, self._fresh(number))
                asked += [found] if found is not None else []
                failure = failure or why
        if not asked:
            assert failure is not None
            raise failure
        best = min(asked, key=lambda found: found.unexplained)
        self._least = max(EXPLAINED, best.unexplained)
        return self._keep(best)._replace(iterations=sum(found.answer.iterations for found in asked))

    def _tried(
        self, number: int, trail: tuple[Answer, ...], goal: Goal, stepper: Stepper
    ) -> tuple[_Try | None, Diverged | None]:
        """The step by one model, or why there is none."""
        try:
            before = [self._model.moved(answer, number) for answer in trail[:-1]]
            answer = stepper.step((*before, self._model.carried(trail[-1], number)), goal)
        except Diverged as error:
            return None, error
        return _Try(number, answer, stepper.signs(answer), stepper), None

    def _fresh(self, number: int) -> Stepper:
        """A stepper of another model, which knows how large forces and stress have been."""
        stepper = self._model.parts[number].stepper(self._settings)
        if self._hardest is not None:
            stepper.learn(self._model.carried(self._hardest.answer, number))
        return stepper

    def _keep(self, found: _Try) -> Answer:
        """Take a step."""
        if self._hardest is None or found.signs.stress >= self._hardest.signs.stress:
            self._hardest = found
        self._last = found
        return found.answer


def _check_alike(models: Sequence[ReducedModel]) -> None:
    """Raise ReductionError for models that are not of one scene, or in which nothing flows."""
    if not models or not all(isinstance(model, ReducedModel) for model in models):
        raise ReductionError("local models of histories are a list of reduced models, at least one")
    if any(model.flow is None for model in models):
        raise ReductionError("nothing flows in these local models: take LocalModels, which needs no state")
    first = models[0]
    for number, model in enumerate(models):
        mine, theirs = (
            [*item.parameters.names, *item.parameters.lower, *item.parameters.upper, len(item.fields.basis)]
            for item in (model, first)
        )
        if mine != theirs or not np.array_equal(model.fields.gaps, first.fields.gaps):
            raise ReductionError(f"local model {number} is of another scene or mesh than the first one")
