"""Step of a condensed inelastic model in Python, for laws that are code and for contacts with laws:
Newton's method.

It solves what :mod:`plugins.inelastic.condensed_step` solves in one compiled loop of programs,

    R(g) = sum of w (G V)^T C ε_p(ε) - Q g - P (λ(g) - λ_e),      ε = ε_0 - E_X^T λ(g) + E_p g,

by whatever evaluates ε_p at the points, and with the forces λ(g) under the slack s - B V g + S λ by
the law of the contacts. λ(g) is piecewise smooth, and its derivative is that at its statuses. With
a law that remembers the correction of the cubature leaves out forces, P = 0: it assumes forces of
elastic bodies, which depend on the path then.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hhr_dolfinx.contact.active_set import Status, Statuses
from hhr_dolfinx.contact.law import StepContact
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.histories.steps import steps_of
from hhr_dolfinx.plugins.inelastic.condensed_step import (
    DECREASE,
    LEAST_NEWTON_SHARE,
    TERMS_ROUND_OFF,
)
from hhr_dolfinx.plugins.inelastic.equilibrium import Diverged, Goal, Stepper, extrapolated
from hhr_dolfinx.plugins.inelastic.law import InternalVariables, Update
from hhr_dolfinx.plugins.inelastic.small_strains import SmallStrains
from hhr_dolfinx.plugins.inelastic.state import GaussState
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.plugins.inelastic.update import Material


class CorrectionStepper(Stepper):
    """Solves steps from corrections that are near.

    Of the settings ``relative_force`` and ``iterations`` count.
    """

    def __init__(self, model: Any, settings: MarchSettings):
        super().__init__(model, settings)
        self._strains = SmallStrains()

    def learn(self, answer: Answer) -> None:
        """Take in the correction of a solved step."""
        self._grow(float(np.linalg.norm(answer.unknown[: self.model.modes])))

    @abstractmethod
    def _grow(self, size: float) -> None:
        """Take in the size of a correction."""

    def step(self, trail: tuple[Answer, ...], goal: Goal) -> Answer:
        """Solve from the extrapolation of the corrections before, then from the last one.

        Args:
            trail: last answers, at most three, the present one last.
            goal: time and parameter at the end of the step.
        """
        modes = self.model.modes
        starts = [extrapolated(trail, goal.time, modes)] if len(trail) > 1 else []
        return self._step_from([*starts, trail[-1].unknown[:modes]], trail[-1], goal)

    @abstractmethod
    def _step_from(self, starts: Sequence[np.ndarray], here: Answer, goal: Goal) -> Answer:
        """Answer from the first of some corrections that leads to one."""


class Trial(NamedTuple):
    """A correction and all that follows from it."""

    correction: np.ndarray
    found: Statuses
    motions: np.ndarray  #: of bodies that contact alone holds, (r,)
    update: Update
    strain: np.ndarray
    residual: np.ndarray

    @property
    def merit(self) -> float:
        """|R|."""
        return float(np.linalg.norm(self.residual))


class StepInput(NamedTuple):
    """Input of a step."""

    slack: np.ndarray  #: without correction and contact forces, (m,)
    strain: np.ndarray  #: strain without these by component, (c n,)
    forces: np.ndarray  #: λ_e, (m,)
    driving: np.ndarray  #: loads along motions of bodies that contact alone holds, (r,)
    contact: StepContact
    material: Material
    before: InternalVariables
    dt: float


class NewtonStepper(CorrectionStepper):
    """Solves the steps of a condensed inelastic model with any laws, with numbers as moduli."""

    def __init__(self, model: Any, settings: MarchSettings):
        super().__init__(model, settings)
        self._size = 0.0
        self._contact: StepContact | None = None

    def _grow(self, size: float) -> None:
        self._size = max(self._size, size)

    def _step_from(self, starts: Sequence[np.ndarray], here: Answer, goal: Goal) -> Answer:
        spent = 0
        failure = Diverged("nothing was tried")
        for start in starts:
            load = self.load(here, goal)
            try:
                trial, count = self._solved(load, start, here)
            except Diverged as error:
                failure = error
                spent += self.settings.iterations
                continue
            return self._answer(trial, load, goal, spent + count)
        raise failure

    def load(self, here: Answer, goal: Goal) -> StepInput:
        """Input of the step from an answer to a goal.

        Args:
            here: answer at the start of the step.
            goal: time and parameter at the end of the step.

        Raises:
            Diverged: if elastic bodies have no contact forces there.
        """
        model = self.model
        theta = model.amplitudes(goal.parameter)
        self._contact = contact = steps_of(model.law).step_contact(
            model, here, goal.parameter, goal.time, self._contact
        )
        forces = np.zeros(model.conditions)
        if not model.law.remembers:
            try:
                forces = model.elastic_forces(theta)
            except NotSolvableError as error:
                raise Diverged(str(error)) from error
        further = (
            model.driving(theta),
            contact,
            model.material.at(goal.parameter),
            gauss_of(here).state,
            goal.time - here.time,
        )
        return StepInput(model.gaps(theta), model.free_strain @ theta, forces, *further)

    def _solved(self, load: StepInput, start: np.ndarray, here: Answer) -> tuple[Trial, int]:
        """Try once from a correction; returns the result and its number of iterations."""
        at = self.tried(load, start, here.active)
        noise = TERMS_ROUND_OFF * float(
            np.linalg.norm(self.model.flow.tested) * np.linalg.norm(at.strain)
        )
        for iteration in range(1, self.settings.iterations + 1):
            size = max(float(np.linalg.norm(at.correction)), self._size)
            if at.merit <= max(self.settings.relative_force * size, noise):
                return at, iteration
            at = self._nearer(load, at)
        raise Diverged(f"the {self.settings.iterations} iterations allowed are spent")

    def _nearer(self, load: StepInput, at: Trial) -> Trial:
        """The next iterate, by a line search along Newton's direction."""
        try:
            direction = np.linalg.solve(self.slope(load, at), at.residual)
        except (np.linalg.LinAlgError, NotSolvableError) as error:
            raise Diverged(f"{error}, a singular tangent") from error
        share = 1.0
        while share >= LEAST_NEWTON_SHARE:
            try:
                tried = self.tried(load, at.correction + share * direction, at.found.active)
                if tried.merit <= (1 - DECREASE * share) * at.merit:
                    return tried
            except Diverged:
                if share == LEAST_NEWTON_SHARE:
                    raise
            share *= 0.5
        raise Diverged(
            f"no part of Newton's step down to 1/{round(1 / LEAST_NEWTON_SHARE)} lowers "
            f"the residual"
        )

    def tried(self, load: StepInput, correction: np.ndarray, active: np.ndarray) -> Trial:
        """Contact, laws and R at a correction.

        Args:
            load: input of the step.
            correction: correction g, (ell,).
            active: statuses to start from, (m,) bool.

        Raises:
            Diverged: if contact forces, an answer of a law or R are missing.
        """
        model = self.model
        slack = load.slack - model.flow.moved @ correction
        statuses, motions = model.touched(load.contact, slack, load.driving, active)
        if statuses.status is not Status.CONVERGED:
            raise Diverged(f"of the contact problem, {statuses.status.value}")
        strain = model.strain_under(load.strain, correction, statuses.forces)
        try:
            update = load.material.update(strain, load.before, load.dt, tangent=True)
        except ConvergenceError as error:
            raise Diverged(str(error)) from error
        residual = (
            model.flow.tested @ update.state.inelastic.T.ravel() - model.flow.modal @ correction
        )
        residual -= model.coupled @ (statuses.forces - load.forces)
        if not np.isfinite(residual).all():
            raise Diverged("a law found no flow, or one that is impossible")
        return Trial(correction, statuses, motions, update, strain, residual)

    def slope(self, load: StepInput, at: Trial) -> np.ndarray:
        """-dR/dg, (ell, ell), at the trial that was solved last.

        Args:
            load: input of the step.
            at: the trial that was solved last.
        """
        model = self.model
        forces = model.force_slopes(load.contact, at.found, -model.flow.moved)
        flowing = model.flowing(at.update.tangents)
        pressed = ((flowing * model.scale) @ model.flow.per_force.T + model.coupled) @ forces
        slope: np.ndarray = model.flow.modal - flowing @ model.flow.per_mode.T + pressed
        return slope

    def _answer(self, at: Trial, load: StepInput, goal: Goal, iterations: int) -> Answer:
        self._strains.check(at.strain)
        statuses = at.found
        unknown = np.concatenate([at.correction, statuses.forces, at.motions])
        memory = Memory(gauss=GaussState(at.update.stress, at.update.state)) | load.contact.memory(
            unknown
        )
        status_of_step = (
            statuses.active,
            iterations,
            Status.CONVERGED,
            statuses.cycled,
            self.model.fields,
        )
        answer = Answer(
            goal.parameter, unknown, statuses.forces, *status_of_step, goal.time, memory=memory
        )
        open_ = self.model.undetermined(statuses, unknown, self.model.amplitudes(goal.parameter))
        answer = answer._replace(undetermined=open_)
        self.learn(answer)
        return answer
