"""A step of a history by linearisation, thesis Alg. 6.1 and 6.2, for full and hyper-reduced models.

Each iteration linearises the stress, solves the contact problem of that linearisation to the end,
(6.16) or (6.17), and updates the material. The operator of the linearisation is the consistent
tangent, or the elastic one (6.21) with Anderson's acceleration. A step that does not converge is
tried again with new tangents in each iteration.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer, found_as
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.histories.steps import steps_of
from hhr_dolfinx.plugins.inelastic.equilibrium import (
    Diverged,
    Goal,
    Linearisation,
    Stepper,
    extrapolated,
)
from hhr_dolfinx.plugins.inelastic.law import Update
from hhr_dolfinx.plugins.inelastic.march import MarchingEquilibrium
from hhr_dolfinx.plugins.inelastic.small_strains import SmallStrains
from hhr_dolfinx.plugins.inelastic.state import GaussState
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.plugins.inelastic.strain import StrainOperator

ROUND_OFF_STRAIN = 1e-13
"""Strain that counts as round-off of displacements without strain, as when a gap closes without
stress.
"""
ROUND_OFF_FORCE = 1e-15
"""Imbalance of a body, over the largest forces on any body, that counts as round-off of the contact
forces between them: a body that nothing strains has no other forces.
"""
TANGENT_ITERATIONS = 5
"""Most iterations of a step after which its frozen tangent, or the elastic operator at a start or
turn of a history, is kept for the next one. In the plane the plastic pellet takes the same time
with 5, 8, 10 and 15; its reduced model 1.6 times as long with 15.
"""
PATIENCE_IN_SPACE = 15
"""Iterations if a tangent costs as much as ten of them, as of full models in space: the smallest
indentation of the demo takes 0.46 s, as by the elastic operator alone, and 0.69 s with 5.
"""
EXTRAPOLATED_ITERATIONS = 15
"""Most iterations of Newton's method from an extrapolation: it takes four to eight, or cycles
forever.
"""
TIRED = 30
"""Iterations with an outdated tangent above which a step continues with Newton's method: for a body
that creeps at constant load, they end with a stress accurate to 1e-5 and a displacement that was
off by 2 %.
"""
TIGHT_TOLERANCE = 1e-8
"""Tolerances of these Newton iterations; the method squares the remaining error."""


MEMORY = 6
"""Differences of iterates that are kept."""


class Anderson:
    """Anderson's acceleration of a fixed-point iteration x -> x + change(x) (D.

    G. Anderson, J. ACM 12, 1965).
    """

    def __init__(self) -> None:
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        self._steps: list[np.ndarray] = []
        self._differences: list[np.ndarray] = []

    def __call__(self, x: np.ndarray, change: np.ndarray) -> np.ndarray:
        """The next iterate."""
        last = self._last
        self._last = (x, change)
        following = x + change
        if last is None:
            return following
        self._steps = [*self._steps, x - last[0]][-MEMORY:]
        self._differences = [*self._differences, change - last[1]][-MEMORY:]
        weights, *_ = np.linalg.lstsq(np.stack(self._differences, axis=1), change, rcond=1e-10)
        # one by one: on large meshes copies of all of them take longer than the least squares
        for weight, step, difference in zip(weights, self._steps, self._differences, strict=True):
            following -= weight * (step + difference)
        return following


class MeshEquilibrium(MarchingEquilibrium):
    """Equilibrium of U0 or gamma: displacements of a mesh or a RID, in steps by linearisation."""

    operator: StrainOperator  #: strain at its Gauss points
    eigenstrains: (
        csc_matrix  # strains without stress for each term of θ, (Gauss points * components, 1 + T)
    )
    lifts: csc_matrix  #: imposed displacements as terms of θ
    elastic: Linearisation
    patience = TANGENT_ITERATIONS
    _sizes: csc_matrix  #: absolute entries of the elastic stiffness

    @abstractmethod
    def field(self, x: np.ndarray) -> np.ndarray:
        """Displacement without the lift."""

    @abstractmethod
    def norms(self, residual: np.ndarray) -> np.ndarray:
        """Norm of a residual for each body, (bodies,)."""

    @abstractmethod
    def contact_load(self, forces: np.ndarray) -> np.ndarray:
        """B^T λ in the test space."""

    def _displacement(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Displacement with the lift; without imposed displacements that is 0, and its product is
        not cheap.
        """
        return self.field(x) + self.lifts @ theta if self.lifts.nnz else self.field(x)

    def strain(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """See :class:`Equilibrium`.

        Args:
            x: unknown, (n,).
            theta: amplitudes θ of the loads at the parameter.
        """
        strain = self.operator.strain(self._displacement(x, theta))
        return (
            strain - (self.eigenstrains @ theta).reshape(strain.shape)
            if self.eigenstrains.nnz
            else strain
        )

    def strain_of(self, change: np.ndarray) -> np.ndarray:
        """See :class:`Equilibrium`."""
        return self.operator.strain(self.field(change))

    def round_off(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Size of round-off of the sum of stiffness times displacement for each body, (bodies,).

        Args:
            x: unknown, (n,).
            theta: amplitudes θ of the loads at the parameter.
        """
        return 1e-13 * self.norms(self._sizes @ np.abs(self._displacement(x, theta)))

    def stepper(self, settings: MarchSettings) -> LinearisedStepper:
        """See :class:`Equilibrium`."""
        return LinearisedStepper(self, settings)


class LinearisedStepper(Stepper):
    """See :class:`Stepper`."""

    def __init__(self, model: MeshEquilibrium, settings: MarchSettings):
        super().__init__(model, settings)
        self._linearisation: Linearisation | None = (
            None  # of the last step, if it may be used again
        )
        self._forces: np.ndarray | float = 0.0  # largest size so far
        self._stress = 0.0  # largest root of its mean square so far
        self._strains = SmallStrains()

    def learn(self, answer: Answer) -> None:
        """Take in a step that was solved before, by its results."""
        gauss = gauss_of(answer)
        _, scale = self.model.residual(
            answer.unknown, gauss, self.model.amplitudes(answer.parameter)
        )
        self._grow(scale, self._mean(gauss.stress))

    def _grow(self, forces: np.ndarray, stress: float) -> None:
        """Take in the forces and the stress of one more step."""
        self._forces = np.maximum(forces, self._forces)
        self._stress = max(self._stress, stress)

    def _mean(self, stress: np.ndarray) -> float:
        """Root of the mean square."""
        together = self.model.together
        return float(
            np.sqrt(together.total(float(np.sum(stress**2))) / together.total(stress.size))
        )

    def step(self, trail: tuple[Answer, ...], goal: Goal) -> Answer:
        """Solve from the extrapolation of the answers before.

        If that fails, with new tangents from an elastic start.

        Args:
            trail: last answers, at most three, the present one last.
            goal: time and parameter at the end of the step.

        Raises:
            Diverged: if neither converges.
        """
        settings = self.settings
        careful = replace(settings, search="tangent") if settings.search == "frozen" else settings
        first = settings
        if settings.search == "tangent" and len(trail) > 1:
            first = replace(settings, iterations=min(settings.iterations, EXTRAPOLATED_ITERATIONS))
        if len(trail) == 1:  # at rest, or where a path reverses: the first response is elastic
            self._linearisation = self.model.elastic if settings.search == "frozen" else None
        try:
            return self._finished(self._solved(trail, goal, first), trail, goal)
        except (Diverged, ConvergenceError):
            self._linearisation = None
        try:
            after = self._solved(trail[-1:], goal, careful)
        except ConvergenceError as error:
            raise Diverged(str(error)) from error
        return after._replace(iterations=first.iterations + after.iterations)

    def _finished(self, found: Answer, trail: tuple[Answer, ...], goal: Goal) -> Answer:
        """The answer, or a more accurate one if iterations with an outdated tangent converged
        slowly.
        """
        if self.settings.search != "frozen" or found.iterations <= TIRED:
            return found
        tight: Any = dict.fromkeys(
            ("relative_stress", "floor_stress", "relative_force"), TIGHT_TOLERANCE
        )
        newton = replace(
            self.settings, search="tangent", iterations=EXTRAPOLATED_ITERATIONS, **tight
        )
        try:
            after = self._solved(trail[-1:], goal, newton, found)
        except (Diverged, ConvergenceError):
            return found
        return after._replace(iterations=found.iterations + after.iterations)

    def _solved(
        self,
        trail: tuple[Answer, ...],
        goal: Goal,
        settings: MarchSettings,
        start: Answer | None = None,
    ) -> Answer:
        """One step from the end of ``trail``: from ``start``, the extrapolation of its answers, or
        an elastic start.
        """
        model = self.model
        present = trail[-1]
        dt = goal.time - trail[-1].time
        theta = model.amplitudes(goal.parameter)
        material = model.material.at(goal.parameter)
        x = self._extrapolated(trail, goal, theta) if start is None else start.unknown
        flows = material.flows and settings.search != "elastic"
        mixing = Anderson() if material.flows and settings.search != "tangent" else None
        active = (present if start is None else start).active
        contact = steps_of(model.law).step_contact(model, present, goal.parameter, goal.time)
        linear: Any = self._linearisation if flows else model.elastic
        for iteration in range(1, settings.iterations + 1):
            renew = flows and (linear is None or settings.search == "tangent")
            strain = model.strain(x, theta)
            update = self._finite(
                partial(material.update, strain, gauss_of(present).state, dt, tangent=renew)
            )
            residual, scale = model.residual(x, update, theta)
            flowed = update.state.cumulated - gauss_of(present).state.cumulated
            with self._solvable(flowed):
                linear = model.linearised(update.tangents) if renew else linear
                change, statuses = linear.correct(residual, x, theta, active, contact)
            self._demand_borne(statuses.status, flowed)
            imbalance = model.norms(residual - model.contact_load(statuses.forces))
            # each body by its own forces, or if it is unloaded by its largest forces before
            small = settings.relative_force * np.maximum(scale, self._forces)
            if self._in_balance(imbalance, small, scale, x, theta):
                # the more expensive of the two criteria comes last
                remaining = _stress_change(linear, model.strain_of(change))
                largest = max(self._stress, self._mean(update.stress))
                floor = self._floor(linear, settings, largest)
                small = settings.relative_stress * np.abs(update.stress)
                if model.together.largest((remaining - small).max()) <= floor:
                    self._strains.check(strain, model.together)
                    again = settings.search != "tangent" and iteration <= model.patience
                    self._linearisation = linear if again else None
                    self._grow(scale, largest)
                    memory = Memory(gauss=GaussState(update.stress, update.state)) | contact.memory(
                        x
                    )
                    undetermined = linear.undetermined(statuses, x, theta, model.law)
                    statuses = statuses._replace(iterations=iteration)
                    answer = found_as(statuses, goal.parameter, x, model.fields)
                    return answer._replace(undetermined=undetermined, time=goal.time, memory=memory)
            active = statuses.active
            x = x + change if mixing is None else mixing(x, change)
        remaining = _stress_change(linear, model.strain_of(change)).max(axis=1)
        largest = model.together.largest(remaining.max())
        reason = f"after {settings.iterations} iterations the stress still moves by {largest:.3g}"
        raise Diverged(reason, model.together.place(remaining))

    def _finite(self, updated: Callable[[], Update]) -> Update:
        """The update of the material, which all ranks have with finite stresses."""
        together = self.model.together
        update = together.agreed(updated)
        if not together.every(bool(np.isfinite(update.stress).all())):
            raise Diverged(
                "the stress is not finite",
                together.place(~np.isfinite(update.stress).all(axis=1)),
            )
        return update

    @contextmanager
    def _solvable(self, flowed: np.ndarray) -> Iterator[None]:
        """A linearisation that has no solution diverges where most flowed."""
        try:
            yield
        except (NotSolvableError, np.linalg.LinAlgError) as error:
            place = self.model.together.place(flowed)
            raise Diverged(f"{error}, a singular tangent", place) from None

    def _in_balance(
        self,
        imbalance: np.ndarray,
        small: np.ndarray,
        scale: np.ndarray,
        x: np.ndarray,
        theta: Theta,
    ) -> bool:
        """Whether the imbalance of each body, (bodies,), is small, or no more than round-off."""
        if (imbalance <= small).all():
            return True
        of_contact = ROUND_OFF_FORCE * np.maximum(scale, self._forces).max()
        return bool((imbalance <= small + self.model.round_off(x, theta) + of_contact).all())

    def _demand_borne(self, status: Status, flowed: np.ndarray) -> None:
        """Raise Diverged if the linearised contact problem was not solved."""
        if status is not Status.CONVERGED:
            reason = (
                f"of the linearised contact problem, {status.value}, or the load is "
                "more than is borne"
            )
            raise Diverged(reason, self.model.together.place(flowed))

    def _floor(self, linear: Linearisation, settings: MarchSettings, stress: float) -> float:
        """Largest change of the stress at convergence: a part of it, or round-off of strains."""
        return max(
            settings.floor_stress * stress,
            ROUND_OFF_STRAIN * self.model.together.largest(linear.moduli.max()),
        )

    def _extrapolated(self, trail: tuple[Answer, ...], goal: Goal, theta: Theta) -> np.ndarray:
        """The unknown by the answers before, or if the step were elastic."""
        if len(trail) > 1:
            return extrapolated(trail, goal.time)
        return self._elastic_start(trail[-1], theta, goal)

    def _elastic_start(self, here: Answer, theta: Theta, goal: Goal) -> np.ndarray:
        """The unknown if the step were elastic.

        Imposed displacements move the boundary alone: points inside would strain and flow by all of
        the motion.
        """
        model = self.model
        x = here.unknown
        change = model.strain(x, theta) - model.strain(x, model.amplitudes(here.parameter))
        if model.together.every(not change.any()):
            return x
        stress = gauss_of(here).stress + np.einsum("nij,nj->ni", model.material.elastic, change)
        residual, _ = model.residual(x, GaussState(stress, gauss_of(here).state), theta)
        try:
            contact = steps_of(model.law).step_contact(model, here, goal.parameter, goal.time)
            change, statuses = model.elastic.correct(residual, x, theta, here.active, contact)
        except NotSolvableError:
            return x
        return x + change if statuses.status is Status.CONVERGED else x


def _stress_change(linear: Linearisation, strain: np.ndarray) -> np.ndarray:
    """Change of the stress by the linearisation, |H : ε(δ)|, instead of R_σ in (6.19)."""
    return np.abs(np.einsum("nij,nj->ni", linear.moduli, strain))
