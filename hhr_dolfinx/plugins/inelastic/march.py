"""Quasi-static histories of contact between inelastic bodies, thesis Alg. 6.1 and 6.2: one loop for
all models.

The stepper of a model solves its steps: by linearisation
(:mod:`plugins.inelastic.linearised_step`), or in one compiled loop
(:mod:`plugins.inelastic.condensed_flow`). A step that does not converge is halved; only converged
steps are kept. If requested, the error of the steps in time is estimated, and with a tolerance
steps are cut by it (:mod:`plugins.inelastic.time_error`). Loads, imposed displacements, gaps, and
constants of laws that are formulas have their values at the end of a step or of a part of it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import (
    ConvergenceError,
    NotOfferedError,
    NotSolvableError,
    ParameterError,
    SceneError,
)
from hhr_dolfinx.memory import NO_MEMORY, Memory
from hhr_dolfinx.models.answer import Answer, History, Path
from hhr_dolfinx.models.histories.equilibrium import (
    DEFAULT_MARCH,
    MarchSettings,
    warn_of_time_error,
)
from hhr_dolfinx.models.histories.path import check_settings, left_with, walked
from hhr_dolfinx.models.histories.steps import steps_of
from hhr_dolfinx.models.model import warn_undetermined
from hhr_dolfinx.one_thread import one_thread
from hhr_dolfinx.parameters import PointLike
from hhr_dolfinx.plugins.inelastic.equilibrium import Diverged, Goal, MaterialEquilibrium, Stepper
from hhr_dolfinx.plugins.inelastic.law import InternalVariables
from hhr_dolfinx.plugins.inelastic.state import GaussState
from hhr_dolfinx.plugins.inelastic.time_error import CONTROLLED, SecondSolution, in_parts, tightened
from hhr_dolfinx.plugins.inelastic.trained import Watch

_log = logging.getLogger(__name__)


class MarchingEquilibrium(MaterialEquilibrium):
    """Equilibrium that answers paths, see
    :class:`hhr_dolfinx.models.histories.equilibrium.Equilibrium`.
    """

    reader: ClassVar[str] = "inelastic"

    def march(
        self,
        model: object,
        path: Path,
        settings: MarchSettings = DEFAULT_MARCH,
        *,
        known: Sequence[Answer] = (),
        keep: Callable[[Answer], None] = lambda answer: None,
    ) -> History:
        """History along a checked path, see :func:`march`.

        Args:
            model: not read: the equilibrium answers.
            path: checked path.
            settings: settings of the history.
            known: answers of its first steps.
            keep: called with each answer.
        """
        return march(self._marching(settings), path, settings, known=known, keep=keep)

    def known_error(self, known: str) -> str:
        """As it is."""
        return known

    def _marching(self, settings: MarchSettings) -> MaterialEquilibrium:
        """Equilibrium that solves histories with some settings."""
        return self

    def one_step(
        self,
        model: object,
        point: np.ndarray,
        raise_on_failure: bool,
        outside: str,
        gradient: bool,
        **step: Any,
    ) -> Answer:
        """One step from rest to a point, see :func:`one_step`.

        Args:
            model: the model that answers.
            point: parameter, (P,).
            raise_on_failure: raise instead of returning NaN and a status.
            outside: policy outside the training range.
            gradient: compute the derivatives along the parameters.
            **step: ``duration`` of the step.

        Raises:
            NotOfferedError: for a gradient and other keywords.
        """
        if step.keys() - {"duration"}:
            raise NotOfferedError(
                f"solve knows no {', '.join(step)} here: only bodies that flow take a duration"
            )
        if gradient:
            raise NotOfferedError(
                "a single step of bodies that flow has no gradient: how they flow depends on the "
                "path, along which there is one: march(path, MarchSettings(gradient=True))"
            )
        return one_step(model, point, raise_on_failure, outside, **step)


# threads of BLAS slow small blocks down: a projected tangent of 70 modes took 7.8 ms on two of
# them, 3.1 ms on one
@one_thread
def march(
    model: MaterialEquilibrium,
    path: Path,
    settings: MarchSettings = DEFAULT_MARCH,
    *,
    known: Sequence[Answer] = (),
    keep: Callable[[Answer], None] = lambda answer: None,
) -> History:
    """Solve a history from rest.

    Args:
        model: of a full or a reduced model.
        path: times and parameters, as :func:`checked_path` returns them; parameters are linear
            between them.
        settings: of the history.
        known: answers to the first steps, solved before; the history continues after them.
        keep: called with each answer as soon as it is solved.

    Raises:
        ParameterError: for invalid settings, or a path along which elasticity changes.
        OutsideTrainingError: if a step is outside the training range, and ``settings`` refuse that.
        ConvergenceError: with the step, the time and the worst point.
        Anything that ends a history, a keyboard interrupt too, has an attribute ``history`` with
        the steps before.

    Warns:
        OutsideTrainingWarning: if a step is outside the training range, and ``settings`` do not say
        otherwise. TimeStepWarning: if the error of the time steps was to be estimated and is large,
        and no tolerance was given.
    """
    check_settings(settings)
    check_elasticity(model.moduli, model.parameters.names, path)
    if settings.gradient:
        from hhr_dolfinx.plugins.inelastic.contact_slopes import slopes_of_contacts

        slopes_of_contacts(model, 0)  # refuses laws of contacts without derivatives
        if settings.limit and model.law.remembers:
            raise NotOfferedError(
                "derivatives of the limit of small increments are not built in where bodies flow: "
                "those of the increments are exact, MarchSettings(gradient=True)"
            )
    history = History(*path[0], time_tolerance=settings.time_tolerance)
    with model.lock, left_with(history):
        walked(
            _MarchedSteps(model.at(path[0][1]), path, settings, history), path, history, known, keep
        )
    if settings.time_error:
        warn_of_time_error(float(history.time_error.max(initial=0.0)), settings.time_tolerance)
    if settings.gradient:
        from hhr_dolfinx.plugins.inelastic.history_gradient import with_gradients

        with_gradients(model, history)
    return history


class _MarchedSteps:
    """Steps of one history along a checked path; its signs go into the history as they are
    solved.
    """

    def __init__(
        self, model: MaterialEquilibrium, path: Path, settings: MarchSettings, history: History
    ):
        self.model = model
        self.path = path
        self.history = history
        self.trail: tuple[Answer, ...] = (_at_rest(model, *path[0]),)
        self.stepper = model.stepper(tightened(settings))
        self.check = steps_of(model.law).watch(model)
        self.watch = Watch(model.trained, settings.outside)
        timed = settings.time_error or settings.time_tolerance is not None
        self.second = SecondSolution(model, settings, self.trail[0]) if timed else None

    def _begun(self, number: int, time: float, point: np.ndarray) -> bool:
        """Check the start of a step; True if the path turns there."""
        present = self.trail[-1]
        self.watch.before(number, present.time, time, present.parameter, point)
        turned = _turns(self.model, self.trail, point)
        if turned:
            # the inelastic bodies of the last step respond elastically now: an extrapolation would
            # mislead
            self.trail = self.trail[-1:]
        return turned

    def known(self, number: int, answer: Answer) -> Answer:
        """Take in a step that the full model solved before.

        Args:
            number: number of the step in the path, from 1 on.
            answer: its answer.
        """
        turned = self._begun(number, *self.path[number])
        after = self.model.together.own(answer)
        self.stepper.learn(after)
        if self.second is not None:
            self.second.follow(self.trail[-1], after, turned)
        return self._ended(number, after, answer)

    def solved(self, number: int, time: float, point: np.ndarray) -> Answer:
        """Solve a step, cut as often as necessary.

        Args:
            number: number of the step in the path, from 1 on.
            time: its time in seconds.
            point: parameter at its end, (P,).

        Raises:
            ConvergenceError: if the smallest parts do not converge.
        """
        turned = self._begun(number, time, point)
        try:
            after = _stepped(
                self.stepper, self.trail, Goal(time, point), self.second, number, turned
            )
        except Diverged as failure:
            raise self._lost(number, time, failure) from None
        return self._ended(number, after, None)

    def _lost(self, number: int, time: float, failure: Diverged) -> ConvergenceError:
        location = ""
        if failure.worst is not None:
            point = int(self.model.points[failure.worst])
            location = f"; worst at Gauss point {point}, in cell {point // self.model.per_cell}"
        return ConvergenceError(
            f"step {number} to t = {time:g} s did not converge: {failure}{location}. "
            f"Take smaller steps; the {number - 1} steps before are kept"
        )

    def _ended(self, number: int, after: Answer, gathered: Answer | None) -> Answer:
        """Check the end of a step, and return it as one answer of all ranks."""
        self.check(after)
        signs = self.model.signs(after)
        self.watch.after(number, after.time, signs)  # a refused step is not kept
        gathered = self.model.together.whole(after) if gathered is None else gathered
        if after.undetermined is not None and all(
            answer.undetermined is None for answer in self.history.answers
        ):
            warn_undetermined(self.model.parameters, gathered)  # once for a path
        self.history.signs.append(signs)
        report = number, len(self.path) - 1, after.time, after.iterations, after.parts
        _log.info("step %d of %d, t = %g s: %d iterations in %d parts", *report)
        self.trail = (*self.trail[-2:], after)
        return gathered


def _stepped(
    stepper: Stepper,
    trail: tuple[Answer, ...],
    goal: Goal,
    second: SecondSolution | None,
    number: int,
    turned: bool,
) -> Answer:
    """A step of a path, cut by the time tolerance if there is one, with its time errors if they
    were requested.
    """
    controlled = stepper.settings.time_tolerance is not None
    if second is not None and controlled:
        answers, spent = in_parts(stepper, trail, goal, second, number, turned)
    else:
        answers = stepper.advance(trail, goal)
        spent = sum(solved.iterations for solved in answers)
    answer = answers[-1]._replace(
        iterations=spent, ends=tuple(solved.time for solved in answers[:-1])
    )
    if second is None:
        return answer
    if not controlled:
        second.follow(trail[-1], answer, turned)
    errors = second.errors()
    return answer._replace(time_error=max(errors[:CONTROLLED])).remembering(time_errors=errors)


def _turns(model: MaterialEquilibrium, trail: tuple[Answer, ...], target: np.ndarray) -> bool:
    """True if the path reverses its last step, as when a load is removed."""
    if len(trail) < 2:
        return False
    sides = np.subtract(model.parameters.upper, model.parameters.lower)
    present = trail[-1].parameter
    before = (present - trail[-2].parameter) / sides
    after = (target - present) / sides
    return bool(before @ after < 0)


def _at_rest(model: MaterialEquilibrium, time: float, parameter: np.ndarray) -> Answer:
    return _uniform(
        model, parameter, 0.0, Status.CONVERGED, time, steps_of(model.law).at_rest(model)
    )


def _uniform(
    model: MaterialEquilibrium,
    parameter: np.ndarray,
    value: float,
    status: Status,
    time: float,
    rest: Memory,
) -> Answer:
    """Answer of which all arrays have one value, such as NaN without a solution."""
    stress = np.full((model.material.gauss_points, model.material.components), value)
    gauss = GaussState(
        stress,
        InternalVariables(
            *(np.full_like(variable, value) for variable in model.material.at_rest())
        ),
    )
    arrays = (
        np.full(model.size, value),
        np.full(model.conditions, value),
        np.zeros(model.conditions, dtype=bool),
    )
    return Answer(
        parameter, *arrays, 0, status, False, model.fields, time, memory=Memory(gauss=gauss) | rest
    )


def elastic_axes(moduli: Sequence[str], names: Sequence[str]) -> dict[int, list[str]]:
    """Formulas of the elasticity by the index of each parameter on which they depend.

    Args:
        moduli: formulas of the elasticity of all bodies.
        names: names of the parameters.
    """
    if not moduli:
        return {}
    # imported here: most moduli are numbers, and then formulas need not be loaded
    from hhr_dolfinx.formulas import formula_of

    variables = {text: formula_of(text, "a modulus").variables for text in sorted(set(moduli))}
    by_index = {
        index: [text for text, names_of in variables.items() if name in names_of]
        for index, name in enumerate(names)
    }
    return {index: texts for index, texts in by_index.items() if texts}


def check_elasticity(moduli: Sequence[str], names: Sequence[str], path: Path) -> None:
    """Refuse a path along which a modulus of elasticity changes.

    Args:
        moduli: formulas of the elasticity of all bodies.
        names: names of the parameters.
        path: checked path.

    Raises:
        ParameterError: for such a path.
    """
    for index, texts in elastic_axes(moduli, names).items():
        values = np.array([point[index] for _, point in path])
        if np.ptp(values) > 0:
            name = names[index]
            step = int(np.flatnonzero(values != values[0])[0])
            raise ParameterError(
                f"{name} changes from {values[0]:g} to {values[step]:g} in step {step} of the "
                f"path, and the elasticity or a shape depends on it ({', '.join(texts)}): they "
                f"must be the same along a history. Keep {name} as it is along the path, or state "
                "the modulus in the law hhr.ChangingStiffness"
            )


def one_step(
    model: Any,
    mu: PointLike,
    raise_on_failure: bool = True,
    outside: str = "warn",
    duration: float = 1.0,
) -> Answer:
    """Answer of a model of inelastic bodies: one step from rest, with the elasticity of the point.

    Rest is where the box is nearest to zero.

    Args:
        model: model of inelastic bodies.
        mu: parameter: number, sequence or mapping by name.
        raise_on_failure: raise instead of returning NaN and a status.
        outside: policy outside the training range.
        duration: duration of the step in seconds, for laws with rates.
    """
    space = model.parameters
    target = space.point(mu)
    start = np.clip(0.0, space.lower, space.upper)
    axes = list(elastic_axes(model.equilibrium.moduli, space.names))
    start[axes] = target[axes]  # elasticity is constant along a history
    start[model.law.fixed] = target[
        model.law.fixed
    ]  # in parts of a step that is cut they would be too small
    try:
        return model.march(
            [(0.0, start), (duration, target)], MarchSettings(outside=outside)
        ).answers[-1]
    except (
        ConvergenceError,
        NotSolvableError,
        SceneError,
    ):  # of a modulus or a constant that is impossible there
        if raise_on_failure:
            raise
        return _uniform(model.equilibrium, target, np.nan, Status.DIVERGED, np.nan, NO_MEMORY)
