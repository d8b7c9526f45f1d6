"""Derivatives of histories along their parameters, step by step, without another nonlinear solve.

A converged step satisfies R(x, s, μ) = B^T λ and B_A x = d_A(μ) on its active conditions A, with
the residual R of the laws that started from the state s before the step. Along a direction of the
path its derivative solves

    K_T dx + B^T dλ = dR,      B_A dx = dd_A,      dλ = 0 elsewhere,

with the consistent tangent K_T at the step. dR is the derivative of R at fixed x along (ds, dμ),
and the state after the step changes along (dx, ds, dμ). Both are exact: laws are differentiated as
programs, on the side of their kinks that each point is on in the step, see
:mod:`plugins.inelastic.law_slopes`, and amplitudes and constants as formulas. Only laws that are
code have differences.

Contacts whose law remembers have derivatives by their law, see
:mod:`plugins.inelastic.contact_slopes`. Statuses are those of the history. A derivative is
one-sided where a condition is about to change its status, or where a point comes to a kink of its
law, such as yield, within :data:`NEAR_KINK` of the box; so it is in later steps, whose state
follows from it. In a hold of constant load points stay on their yield surface, and no kink is near.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.errors import ConvergenceError, NotOfferedError, ParameterError
from hhr_dolfinx.models.answer import Answer, History
from hhr_dolfinx.models.gradient import CHANGING_STATUS, Gradient
from hhr_dolfinx.plugins.inelastic.contact_slopes import ContactSlopes, slopes_of_contacts
from hhr_dolfinx.plugins.inelastic.equilibrium import MaterialEquilibrium, ParameterDirection
from hhr_dolfinx.plugins.inelastic.law import InternalVariables, Update
from hhr_dolfinx.plugins.inelastic.law_slopes import CODE_STEP, Along, Inputs, slopes_of
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of

SAME_STRESS = 1e-8
"""Part of the stress by which a step may differ from a single step to its end.

Above it, the step was cut.
"""
SKEW = 1e-6
"""Asymmetry of tangents, as a part of the largest, from which their symmetric part gives no
derivatives.
"""
NEAR_KINK = CHANGING_STATUS
"""Part of the box of the parameters within which a kink of a law makes a derivative one-sided."""


class StepGradient(NamedTuple):
    """Derivatives at the end of a step along K directions: of its unknown without the lift, and of
    its forces.
    """

    unknown: np.ndarray  #: (n, K)
    multipliers: np.ndarray  #: (m, K)
    slack: np.ndarray  #: (m, K)
    grazing: np.ndarray  #: conditions about to change their status, (m,) bool
    kinks: int  #: see :class:`~hhr_dolfinx.models.gradient.Gradient`


def history_gradient(
    model: MaterialEquilibrium, history: History, directions: np.ndarray | None = None
) -> list[StepGradient]:
    """Derivatives of all answers of a history, solved by a model in steps that were not cut, with
    tight settings.

    ``directions`` are derivatives of the path, (steps + 1, P, K): changes of the parameters at each
    of its times along each of K directions. None shifts each parameter, K = P, by the same at all
    times, as a constant of the whole history such as a yield stress or a gap.

    Raises:
        ParameterError: for directions of another shape, or not finite.
        ConvergenceError: for a step whose end is not that of a single step, such as a step that was
            cut.
        NotOfferedError: for a full model with a law whose tangents are not symmetric, for a law
            that is code at points that are about to yield, and for laws of contacts that have no
            derivatives.
        SingularError: if the tangent or the active conditions of a step are singular.
    """
    path = history.path
    count = len(model.parameters.names)
    along = (
        np.broadcast_to(np.eye(count), (len(path), count, count))
        if directions is None
        else np.array(directions)
    )
    if along.shape[:2] != (len(path), count) or along.ndim != 3 or not np.isfinite(along).all():
        raise ParameterError(
            f"directions of the shape {along.shape} must be finite and of the shape ({len(path)}, "
            f"{count}, K): one row for each time of the path, the start too, and one for each of "
            f"{model.parameters.names}"
        )
    state = model.material.at_rest()
    time = history.start
    # at rest they are zero too
    changes = InternalVariables(
        *(np.repeat(variable[..., None], along.shape[2], axis=-1) for variable in state)
    )
    contacts = slopes_of_contacts(model, along.shape[2])
    gradients = []
    scale = 0.0
    before = 0
    with model.lock:
        for number, answer in enumerate(history.answers, start=1):
            step = _SolvedStep(model, answer, state, answer.time - time, number)
            scale = max(scale, step.strain_size)
            step_gradient, changes = step.along(along[number], changes, scale, contacts)
            step_gradient = step_gradient._replace(kinks=step_gradient.kinks + before)
            gradients.append(step_gradient)
            before = step_gradient.kinks
            if contacts.remembers or any(
                variable.any() for variable in changes
            ):  # by a state without derivatives contact hands nothing on
                before += int(step_gradient.grazing.sum())
            state = gauss_of(answer).state
            time = answer.time
    return gradients


def with_gradients(model: MaterialEquilibrium, history: History) -> None:
    """Give each answer of a history its derivatives along the parameters.

    See :func:`history_gradient`.

    Args:
        model: equilibrium that solved the history.
        history: its history, whose answers get them.
    """
    for index, step_gradient in enumerate(history_gradient(model, history)):
        unknown, multipliers, slack, near, kinks = step_gradient
        gradient = Gradient(unknown, multipliers, near, slack, kinks)
        history.answers[index] = history.answers[index]._replace(gradient=gradient)


class _SolvedStep:
    """A solved step: its consistent linearisation, and its derivatives along directions."""

    def __init__(
        self,
        model: MaterialEquilibrium,
        answer: Answer,
        before: InternalVariables,
        dt: float,
        number: int,
    ):
        self._model = model
        self._answer = answer
        self._there = model.at(answer.parameter)
        self._theta = model.amplitudes(answer.parameter)
        strain = self._there.strain(answer.unknown, self._theta)
        self.strain_size = _largest(strain)
        self._inputs = Inputs(strain, before, dt)
        self._material = model.material.at(answer.parameter)
        try:
            update = self._material.update(strain, before, dt, tangent=True)
        except ConvergenceError as error:
            raise _in_parts(number, str(error)) from error
        stored = gauss_of(answer).stress
        apart = _largest(update.stress - stored)
        if not apart <= SAME_STRESS * _largest(stored):
            raise _in_parts(number, f"its stress differs by {apart:.2g} from that of a single step")
        assert update.tangents is not None  # requested
        skew = _largest(update.tangents - update.tangents.swapaxes(1, 2))
        if model.symmetric and skew > SKEW * _largest(update.tangents):
            raise NotOfferedError(
                "derivatives of full histories need symmetric tangents, and a law has others, as "
                "of back stresses that recover or of dilatancy: take a small model"
            )
        self._linear = self._there.linearised(update.tangents)

    def along(
        self,
        directions: np.ndarray,
        before: InternalVariables,
        scale: float,
        contacts: ContactSlopes,
    ) -> tuple[StepGradient, InternalVariables]:
        """Derivatives of the step, and of the state after it, along directions.

        Args:
            directions: directions of the parameter, (P, K).
            before: derivatives of the state before the step, K last.
            scale: largest strain so far.
            contacts: derivatives of the contacts.
        """
        local = self._there
        answer = self._answer
        x = answer.unknown
        acting, by_parameter = local.amplitudes.slopes_at(answer.parameter)
        ways = [
            ParameterDirection(
                answer.parameter, direction, self._theta, Theta(acting, by_parameter @ direction)
            )
            for direction in directions.T
        ]
        strain = np.stack([local.strain_along(x, way) for way in ways], axis=-1)
        constants = self._model.material.constants_along(answer.parameter, directions)
        of_box = self._parts_of_box(directions)

        def along(strain: np.ndarray) -> Along:
            sizes = [
                np.abs(array).max(axis=(0, 1), initial=0.0) for array in (strain, before.inelastic)
            ]
            rates = np.max([of_box, *(size / (scale or 1.0) for size in sizes)], axis=0)
            return Along(strain, before, constants, CODE_STEP / np.where(rates > 0, rates, 1.0))

        first = slopes_of(self._material, self._inputs, along(strain))
        residuals = []
        for k, way in enumerate(ways):
            change = Update(
                first.stress[..., k],
                InternalVariables(*(variable[..., k] for variable in first.state)),
                None,
            )
            residuals.append(local.residual_along(x, change, way))
        right = (
            np.stack(residuals, axis=1),
            np.stack([local.gaps_along(x, way) for way in ways], axis=1),
        )
        linear = self._linear
        slacks = linear.slack_of(local.gaps(self._theta), x)
        unknown, multipliers, slack, near = contacts.step(
            linear, answer, slacks, right, directions, self._inputs.dt
        )
        strain_slopes = np.stack([local.strain_of(dx) for dx in unknown.T], axis=-1)
        after = slopes_of(self._material, self._inputs, along(strain + strain_slopes))
        at_kinks = (after.reach * of_box <= NEAR_KINK).any(axis=1)
        return StepGradient(unknown, multipliers, slack, near, int(at_kinks.sum())), after.state

    def _parts_of_box(self, directions: np.ndarray) -> np.ndarray:
        """Length of each direction as a part of the box, (K,)."""
        space = self._model.parameters
        sides = np.subtract(space.upper, space.lower)
        return np.abs(directions / sides[:, None]).max(axis=0)


def _in_parts(number: int, why: str) -> ConvergenceError:
    return ConvergenceError(
        f"step {number} of the history was solved in parts, or by another model ({why}): march "
        "along the path in more steps, and ask for the derivatives of that history"
    )


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values).max(initial=0.0))
