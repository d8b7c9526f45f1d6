"""Steps of a history of condensed flow: from the path to the compiled loop and back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import LinAlgError

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import ConvergenceError
from hhr_dolfinx.materials.update import Material, State, check_flow, flow_of, kernel_of
from hhr_dolfinx.models import condensed_arrays as codes
from hhr_dolfinx.models import condensed_step as compiled_step
from hhr_dolfinx.models.answer import Answer, GaussState
from hhr_dolfinx.models.condensed_arrays import StepLoad, Work
from hhr_dolfinx.models.condensed_contact import touch
from hhr_dolfinx.models.equilibrium import Diverged, Goal, extrapolated
from hhr_dolfinx.models.path import MarchSettings
from hhr_dolfinx.models.small_strains import SmallStrains
from hhr_dolfinx.trained import Signs

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed_flow import CondensedEquilibrium

_WHY = {
    codes.STALLED: "no part of Newton's step down to 1/256 lowers the residual",
    codes.LIMIT: "the iterations allowed are spent",
    codes.NOT_FINITE: "a law found no flow, or one that is impossible",
    codes.CONTACT: "the contact forces were not found",
}
"""What ended a step, in words."""


class CondensedStepper:
    """Solves the steps of one history with arrays of its own.

    Args:
        model: whose moduli are numbers.
        settings: how, of which ``relative_force`` and ``iterations`` count.
    """

    def __init__(self, model: CondensedEquilibrium, settings: MarchSettings):
        self._model, self._settings, self._arrays = model, settings, model.step_model
        flow = model.flow
        sizes = model.modes, model.conditions, flow.points.size, flow.components
        self._work, self._elastic = Work.of(*sizes), Work.of(*sizes)
        self._said, self._strains = "", SmallStrains()

    def learn(self, answer: Answer) -> None:
        """Take in a step that was solved before."""
        size, numbers = float(np.linalg.norm(answer.unknown[: self._model.modes])), self._work.numbers
        numbers[codes.SIZE] = max(numbers[codes.SIZE], size)

    def signs(self, answer: Answer) -> Signs:
        """See :class:`hhr_dolfinx.models.equilibrium.Stepper`."""
        return self._model.signs(answer)

    def step(self, trail: tuple[Answer, ...], goal: Goal) -> Answer:
        """A step from the extrapolation of the corrections before, else from the last one.

        Raises:
            Diverged: with what was tried last.
        """
        here, model = trail[-1], self._model
        material = model.material.at(goal.parameter)
        theta, before = model.amplitudes(goal.parameter), here.state().state
        rest = np.ascontiguousarray(before.plastic.T), before.cumulated, goal.time - here.time
        # without a correction, so that these are the forces of the elastic bodies
        load = StepLoad(model.free_strain @ theta, self._elastic.forces, model.gaps(theta), *rest)
        if not touch(self._arrays, load, self._elastic):
            raise Diverged("the elastic contact problem has no solution")
        starts = [extrapolated(trail, goal.time, model.modes)] if len(trail) > 1 else []
        spent = 0
        for start in [*starts, here.unknown[: model.modes]]:
            self._work.there[:] = start
            code = self._solve(load, material)
            spent += int(self._work.numbers[codes.ITERATION])
            if code == codes.CONVERGED:
                return self._answer(goal, load, spent)
        left = self._work.numbers[codes.MERIT] / max(float(np.linalg.norm(self._work.here)), 1e-300)
        why = self._complaint(material) if code == codes.NOT_FINITE else _WHY[code]
        left_over = f", with a residual of {left:.2g} of the correction" if np.isfinite(left) else ""
        raise Diverged(f"{why}{left_over} after {spent} iterations")

    def _solve(self, load: StepLoad, material: Material) -> int:
        """One attempt from the correction in the work arrays; why it ended."""
        settings, work = self._settings, self._work
        self._said = ""
        kernels = [kernel for group in material.groups if (kernel := kernel_of(group.law)) is not None]
        limits = settings.relative_force, settings.iterations
        try:
            if len(kernels) == len(material.groups):
                kinds = np.array([kind for kind, _ in kernels])
                constants = np.array([values for _, values in kernels])
                return int(compiled_step.solve(self._arrays, load, work, kinds, constants, *limits))
            compiled_step.begin(work)
            code = compiled_step.prepare(self._arrays, load, work)
            while code == codes.EVALUATE:
                self._evaluate(load, material)
                code = compiled_step.judge(self._arrays, load, work, *limits)
                if code == codes.EVALUATE:
                    code = compiled_step.prepare(self._arrays, load, work)
        except LinAlgError:
            return codes.STALLED
        except ConvergenceError as error:
            self._said = str(error)
            return codes.NOT_FINITE
        return int(code)

    def _complaint(self, material: Material) -> str:
        """What is wrong with the flow that was tried last, in words."""
        if self._said:
            return self._said
        work = self._work
        for group, shear in zip(material.groups, self._arrays.shear, strict=True):
            if group.law is not None:
                own = group.indices
                try:
                    check_flow(group.law, work.amount[own], work.slope[own], work.trial[own], float(shear))
                except ConvergenceError as error:
                    return str(error)
        return _WHY[codes.NOT_FINITE]

    def _evaluate(self, load: StepLoad, material: Material) -> None:
        """Flow by laws of which some are a user's own, in Python."""
        work = self._work
        for group, shear in zip(material.groups, self._arrays.shear, strict=True):
            own = slice(int(group.indices[0]), int(group.indices[-1]) + 1)
            if group.law is None:
                work.amount[own] = work.slope[own] = 0.0
                continue
            trial, cumulated = work.trial[own].copy(), load.cumulated[own].copy()
            # a law that wrote there would spoil the return, or a step before
            trial.setflags(write=False)
            cumulated.setflags(write=False)
            amount, slope = flow_of(group.law, trial, cumulated, float(shear), load.dt)
            if not amount.shape == slope.shape == trial.shape:
                check_flow(group.law, amount, slope, trial, float(shear))
            work.amount[own], work.slope[own] = amount, slope

    def _answer(self, goal: Goal, load: StepLoad, iterations: int) -> Answer:
        """What was found."""
        model, work = self._model, self._work
        self._work.numbers[codes.SIZE] = max(work.numbers[codes.SIZE], np.linalg.norm(work.here))
        plastic, strain = work.plastic.T.copy(), work.strain.reshape(work.plastic.shape).T
        self._strains.check(strain)
        stress = np.einsum("nij,nj->ni", model.material.elastic, strain - plastic)
        gauss = GaussState(stress, State(plastic, load.cumulated + work.amount))
        forces = work.forces.copy()
        unknown = np.concatenate([work.here, forces])
        how = work.active.copy(), iterations, Status.CONVERGED, False, model.fields
        return Answer(goal.parameter, unknown, forces, *how, goal.time, gauss)
