"""Step of a condensed inelastic model with friction: plastic correction g and all forces λ, by Newton's method.

It solves in Python, with an increment of friction instead of the active set, what
:mod:`plugins.inelastic.condensed_step` solves in one compiled loop:

    R(g) = sum of w (G V)^T 2 μ ε_p(ε) - Q g,      ε = ε_0 - E_X^T λ(g) + E_p g,      slack s - B V g + S λ,

where λ(g) is the increment under that slack. The correction of the cubature leaves out forces, P = 0: P assumes forces
of elastic bodies, which depend on the path here. λ(g) is piecewise smooth, and its derivative is that of the increment
at its statuses.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import ConvergenceError, SingularError
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.plugins.friction.sliding_set import Increment, Sliding, SlidingContact
from hhr_dolfinx.plugins.friction.surfaces import Surface
from hhr_dolfinx.plugins.inelastic.condensed_flow import CorrectionStepper
from hhr_dolfinx.plugins.inelastic.condensed_step import DECREASE, LEAST_SHARE, ROUND_OFF
from hhr_dolfinx.plugins.inelastic.equilibrium import Diverged, Goal
from hhr_dolfinx.plugins.inelastic.law import State, Update
from hhr_dolfinx.plugins.inelastic.state import GaussState
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.plugins.inelastic.update import Material

NOTHING = np.zeros(0)


class _Trial(NamedTuple):
    """A correction and all that follows from it."""

    correction: np.ndarray
    found: Sliding
    update: Update
    strain: np.ndarray
    residual: np.ndarray

    @property
    def merit(self) -> float:
        """|R|."""
        return float(np.linalg.norm(self.residual))


class _Load(NamedTuple):
    """Input of a step."""

    slack: np.ndarray
    """Free slack without correction, tangential rows minus their position, (m,)."""
    strain: np.ndarray
    """Free strain without correction, by component, (c n,)."""
    coefficient: np.ndarray
    limit: np.ndarray
    before: State
    dt: float

    def under(self, opening: np.ndarray) -> Increment:
        """The increment with the slack reduced by that of a correction, (m,)."""
        return Increment(self.slack - opening, self.coefficient, self.limit, NOTHING)


class RubbingFlowStepper(CorrectionStepper):
    """Solves the steps of a condensed inelastic model with friction, with numbers as moduli."""

    def __init__(self, model: Any, settings: MarchSettings):
        super().__init__(model, settings)
        self._friction = model.law
        self._surface = Surface(model.law)
        self._contact = SlidingContact(model.schur, model.law)
        self._size = 0.0

    def _grow(self, size: float) -> None:
        self._size = max(self._size, size)

    def _step_from(self, starts: Sequence[np.ndarray], here: Answer, goal: Goal) -> Answer:
        model = self.model
        material = model.material.at(goal.parameter)
        theta = model.amplitudes(goal.parameter)
        slack = model.gaps(theta).copy()
        slack[self._friction.tangential] -= here.slip.position
        coefficient, limit = self._friction.bounds(goal.parameter)
        rest = coefficient, limit, gauss_of(here).state, goal.time - here.time
        load = _Load(slack, model.free_strain @ theta, *rest)
        spent = 0
        failure = Diverged("nothing was tried")
        for start in starts:
            try:
                found, count = self._solved(load, material, start, here)
            except Diverged as error:
                failure = error
                spent += self.settings.iterations
                continue
            return self._answer(found, load, here, goal, spent + count)
        raise failure

    def _solved(self, load: _Load, material: Material, start: np.ndarray, here: Answer) -> tuple[_Trial, int]:
        """Try once from a correction; returns the result and its number of iterations."""
        at = self._tried(load, material, start, here.multipliers, here.active)
        noise = ROUND_OFF * float(np.linalg.norm(self.model.flow.tested) * np.linalg.norm(at.strain))
        for iteration in range(1, self.settings.iterations + 1):
            size = max(float(np.linalg.norm(at.correction)), self._size)
            if at.merit <= max(self.settings.relative_force * size, noise):
                return at, iteration
            at = self._nearer(load, material, at)
        raise Diverged(f"the {self.settings.iterations} iterations allowed are spent")

    def _nearer(self, load: _Load, material: Material, at: _Trial) -> _Trial:
        """The next iterate, by a line search along Newton's direction."""
        try:
            direction = np.linalg.solve(self._slope(load, at), at.residual)
        except (np.linalg.LinAlgError, SingularError) as error:
            raise Diverged(f"{error}, a singular tangent") from error
        share = 1.0
        while share >= LEAST_SHARE:
            try:
                tried = self._tried(load, material, at.correction + share * direction, at.found.forces, at.found.active)
                if tried.merit <= (1 - DECREASE * share) * at.merit:
                    return tried
            except Diverged:
                if share == LEAST_SHARE:
                    raise
            share *= 0.5
        raise Diverged(f"no part of Newton's step down to 1/{round(1 / LEAST_SHARE)} lowers the residual")

    def _tried(
        self, load: _Load, material: Material, correction: np.ndarray, forces: np.ndarray, active: np.ndarray
    ) -> _Trial:
        """Contact, laws and R at a correction."""
        model = self.model
        found = self._contact.increment(load.under(model.flow.moved @ correction), forces, active)
        if found.status is not Status.CONVERGED:
            raise Diverged(f"of the contact problem, {found.status.value}")
        strain = model.strain_under(load.strain, correction, found.forces)
        try:
            update = material.update(strain, load.before, load.dt, tangent=True)
        except ConvergenceError as error:
            raise Diverged(str(error)) from error
        residual = model.flow.tested @ update.state.inelastic.T.ravel() - model.flow.modal @ correction
        if not np.isfinite(residual).all():
            raise Diverged("a law found no flow, or one that is impossible")
        return _Trial(correction, found, update, strain, residual)

    def _slope(self, load: _Load, at: _Trial) -> np.ndarray:
        """-dR/dg, (ell, ell)."""
        model = self.model
        rows = model.flow.moved
        nothing = np.zeros((self._friction.normal.size, model.modes))
        forces, _ = self._contact.changes(
            load.under(rows @ at.correction), at.found, -rows, (nothing, nothing), np.zeros((0, model.modes))
        )
        flowing = model.flowing(at.update.tangents)
        pressed = (flowing * model.scale) @ (model.flow.per_force.T @ forces)
        return model.flow.modal - flowing @ model.flow.per_mode.T + pressed

    def _answer(self, at: _Trial, load: _Load, here: Answer, goal: Goal, iterations: int) -> Answer:
        self._strains.check(at.strain)
        found = at.found
        given = load.under(self.model.flow.moved @ at.correction)
        unknown = np.concatenate([at.correction, found.forces])
        slip = self._surface.after(here.slip, given, found, lambda: unknown, goal.parameter)
        gauss = GaussState(at.update.stress, at.update.state)
        how = found.active, iterations, Status.CONVERGED, found.sweeps > 0, self.model.fields
        answer = Answer(goal.parameter, unknown, found.forces, *how, goal.time, memory=Memory(gauss=gauss, slip=slip))
        self.learn(answer)
        return answer
