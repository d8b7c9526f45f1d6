"""Derivatives of histories along their parameters, step by step, without another nonlinear solve.

A converged step satisfies R(x, s, μ) = B^T λ and B_A x = d_A(μ) on its active conditions A, with the residual R of the
laws that started from the state s before the step. Along a direction of the path its derivative solves

    K_T dx + B^T dλ = dR,      B_A dx = dd_A,      dλ = 0 elsewhere,

with the consistent tangent K_T at the step. dR is the difference of R at fixed x along (ds, dμ). The state after the
step changes by the difference of its update along (dx, ds, dμ). These differences evaluate the laws as they are, with
all their dependencies. Statuses are those of the history, so the result is the derivative away from kinks: where a
condition is about to change its status, or points are about to yield, the two sides differ.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.errors import ConvergenceError, NotOfferedError, ParameterError
from hhr_dolfinx.models.answer import Answer, History
from hhr_dolfinx.models.gradient import GRAZING, Gradient
from hhr_dolfinx.plugins.inelastic.equilibrium import Equilibrium
from hhr_dolfinx.plugins.inelastic.law import State, Update
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of

STEP = 1e-5
"""Length of a difference, as a part of the box of the parameters and of the strain so far: curvature costs its square,
cancellation round-off over it. For the plastic pellet differences of whole histories agree to 1e-8."""
SAME_STRESS = 1e-8
"""Part of the stress by which a step may differ from a single step to its end; above it, the step was cut."""
ROUND_OFF = 1e-8
"""Part of the terms of a residual below which its second difference is round-off."""
BENT = 0.05
"""Second difference of a residual over its first one, above which the law has a kink there and no curvature."""
SKEW = 1e-6
"""Asymmetry of tangents, as a part of the largest, from which their symmetric part gives no derivatives."""
_CENTRAL = ((-1.0, -0.5), (1.0, 0.5))
_FORWARD = ((0.0, -1.5), (1.0, 2.0), (2.0, -0.5))
_BACKWARD = tuple((-place, -weight) for place, weight in _FORWARD)
"""Places and weights of differences of second order."""


class StepGradient(NamedTuple):
    """Derivatives at the end of a step along K directions: of its unknown without the lift, and of its forces."""

    unknown: np.ndarray  # (n, K)
    multipliers: np.ndarray  # (m, K)


def history_gradient(model: Equilibrium, history: History, directions: np.ndarray | None = None) -> list[StepGradient]:
    """Derivatives of all answers of a history, solved by a model in steps that were not cut, with tight settings.

    ``directions`` are derivatives of the path, (steps + 1, P, K): changes of the parameters at each of its times along
    each of K directions. None shifts each parameter, K = P, by the same at all times, as a constant of the whole
    history such as a yield stress or a gap.

    Raises:
        ParameterError: for directions of another shape, or not finite.
        ConvergenceError: for a step whose end is not that of a single step, such as a step that was cut.
        NotOfferedError: for a full model with a law whose tangents are not symmetric.
        SingularError: if the tangent or the active conditions of a step are singular.
    """
    path = history.path
    count = len(model.parameters.names)
    along = np.broadcast_to(np.eye(count), (len(path), count, count)) if directions is None else np.array(directions)
    if along.shape[:2] != (len(path), count) or along.ndim != 3 or not np.isfinite(along).all():
        raise ParameterError(
            f"directions of the shape {along.shape} must be finite and of the shape ({len(path)}, {count}, K): one row "
            f"for each time of the path, the start too, and one for each of {model.parameters.names}"
        )
    state = model.material.at_rest()
    time = history.start
    changes = [state] * along.shape[2]  # at rest they are zero too
    gradients = []
    scale = 0.0
    with model.lock:
        for number, answer in enumerate(history.answers, start=1):
            step = _Step(model, answer, state, answer.time - time, number)
            scale = max(scale, step.strain_size)
            found = [step.along(along[number, :, k], change, scale) for k, change in enumerate(changes)]
            unknowns, forces, changes = map(list, zip(*found, strict=True))
            gradients.append(StepGradient(np.stack(unknowns, axis=1), np.stack(forces, axis=1)))
            state = gauss_of(answer).state
            time = answer.time
    return gradients


def with_gradients(model: Equilibrium, history: History) -> None:
    """Give each answer of a history its derivatives along the parameters; see :func:`history_gradient`."""
    for place, found in enumerate(history_gradient(model, history)):
        answer = history.answers[place]
        near = GRAZING * np.abs(answer.multipliers).max(initial=0.0)
        slack = np.full_like(found.multipliers, np.nan)  # histories keep no slack
        gradient = Gradient(found.unknown, found.multipliers, answer.active & (answer.multipliers <= near), slack)
        history.answers[place] = answer._replace(gradient=gradient)


class _Step:
    """A solved step: its consistent linearisation, and its derivatives along directions."""

    def __init__(self, model: Equilibrium, answer: Answer, before: State, dt: float, number: int):
        self._model = model
        self._answer = answer
        self._before = before
        self._dt = dt
        self._number = number
        theta = model.amplitudes(answer.parameter)
        there = model.responding_at(answer.parameter)
        strain = there.strain(answer.unknown, theta)
        self.strain_size = float(np.abs(strain).max(initial=0.0))
        try:
            update = model.material.at(answer.parameter).update(strain, before, dt, tangent=True)
        except ConvergenceError as error:
            raise _in_parts(number, str(error)) from error
        kept = gauss_of(answer).stress
        apart = _largest(update.stress - kept)
        if not apart <= SAME_STRESS * _largest(kept):
            raise _in_parts(number, f"its stress differs by {apart:.2g} from that of a single step")
        self._residual, sizes = there.residual(answer.unknown, update, theta)
        self._size = float(np.linalg.norm(sizes))
        assert update.tangents is not None  # asked for
        skew = _largest(update.tangents - update.tangents.swapaxes(1, 2))
        if model.symmetric and skew > SKEW * _largest(update.tangents):
            raise NotOfferedError(
                "derivatives of full histories need symmetric tangents, and a law has others, as of back stresses that "
                "recover or of dilatancy: take a small model"
            )
        self._linear = model.at(answer.parameter).linearised(update.tangents)

    def along(self, direction: np.ndarray, change: State, scale: float) -> tuple[np.ndarray, np.ndarray, State]:
        """Derivatives of unknown, forces and state, from those of the parameter, (P,), and of the state before.

        ``scale`` is the largest strain so far.
        """
        model = self._model
        length = self._length(direction, _largest(change.inelastic), scale)

        def loaded(place: float) -> tuple[np.ndarray, ...]:
            """Residual and gaps at a shifted parameter and state, at the unknown of the step."""
            point, before = self._beside(place, direction, change)
            there = model.responding_at(point)
            theta = model.amplitudes(point)
            x = self._answer.unknown
            update = self._updated(x, point, before)
            return there.residual(x, update, theta)[0], there.gaps_at(x, theta)

        residual, gaps = self._difference(loaded, direction, length, self._residual)
        dx, forces = self._linear.changed(residual, gaps, self._answer.active)
        # the unknown changes too: a shorter difference if it strains more
        length = min(length, self._length(direction, _largest(model.strain_of(dx)), scale))

        def updated(place: float) -> tuple[np.ndarray, ...]:
            """State after the step, shifted."""
            return self._updated(self._answer.unknown + place * dx, *self._beside(place, direction, change)).state

        return dx, forces, State(*self._difference(updated, direction, length))

    def _beside(self, place: float, direction: np.ndarray, change: State) -> tuple[np.ndarray, State]:
        """Parameter and state before the step, shifted along the direction."""
        before = State(*(old + place * slope for old, slope in zip(self._before, change, strict=True)))
        return self._answer.parameter + place * direction, before

    def _updated(self, x: np.ndarray, point: np.ndarray, before: State) -> Update:
        """The material at an unknown, a parameter and a state before the step."""
        strain = self._model.responding_at(point).strain(x, self._model.amplitudes(point))
        return self._model.material.at(point).update(strain, before, self._dt, tangent=False)

    def _length(self, direction: np.ndarray, strain: float, scale: float) -> float:
        """Length of a difference that changes parameters and strains by a small part of their size."""
        space = self._model.parameters
        sides = np.subtract(space.upper, space.lower)
        rates = [_largest(direction / sides), strain / scale if scale > 0 else 0.0]
        return STEP / max(rates) if max(rates) > 0 else STEP

    def _difference(
        self,
        function: Callable[[float], tuple[np.ndarray, ...]],
        direction: np.ndarray,
        length: float,
        residual: np.ndarray | None = None,
    ) -> list[np.ndarray]:
        """Derivatives of arrays along a direction, of which the first one is a ``residual`` that must be smooth."""
        samples = [(weight / length, function(place * length)) for place, weight in self._stencil(direction, length)]
        if residual is not None and len(samples) == len(_CENTRAL):
            less, more = (parts[0] for _, parts in samples)
            self._check_smooth(less, more, residual)
        return [np.sum([weight * parts[k] for weight, parts in samples], axis=0) for k in range(len(samples[0][1]))]

    def _check_smooth(self, less: np.ndarray, more: np.ndarray, here: np.ndarray) -> None:
        """Raise NotOfferedError where a central difference is the mean of two slopes: all yield that a hold keeps."""
        bend = np.linalg.norm(less + more - 2 * here)
        if bend > max(BENT * np.linalg.norm(more - less), ROUND_OFF * self._size):
            raise NotOfferedError(
                f"step {self._number} has no derivatives by its equations alone: points are about to yield, as in a "
                "hold of constant load. Leave the hold out, or take differences of histories"
            )

    def _stencil(self, direction: np.ndarray, length: float) -> tuple[tuple[float, float], ...]:
        """Central difference, or one-sided inwards at an end of the box, beyond which a law may be undefined."""
        if self._inside(length * direction) and self._inside(-length * direction):
            return _CENTRAL
        if self._inside(2 * length * direction):
            return _FORWARD
        # along a direction that leaves the box both ways there is no better one
        return _BACKWARD if self._inside(-2 * length * direction) else _CENTRAL

    def _inside(self, change: np.ndarray) -> bool:
        """True if the box contains the shifted parameter of the step."""
        space = self._model.parameters
        point = self._answer.parameter + change
        return bool((point >= space.lower).all() and (point <= space.upper).all())


def _in_parts(number: int, why: str) -> ConvergenceError:
    return ConvergenceError(
        f"step {number} of the history was solved in parts, or by another model ({why}): march along the path in more "
        "steps, and ask for the derivatives of that history"
    )


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values).max(initial=0.0))
