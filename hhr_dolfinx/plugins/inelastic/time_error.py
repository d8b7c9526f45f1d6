"""Error of the time steps for laws with rates: its estimate in each step, and steps controlled by it.

Implicit Euler's rule applies the rate at the end of a step to the whole of it. If rates change evenly over a step h,
its error is h/2 (r_1 - r_0) in the inelastic strain, with r_0 and r_1 the rates at both ends. At a given strain a step
keeps a part D of the error before it, and of the error that it adds: of an excess of stress, the part that the law
does not relax, D = H C^-1 with its tangent H (the same filter as for stiff equations in time: Shampine and
Baca 1984, doi 10.1007/BF02165224). So the error as a stress goes from step to step by

    e_1 = D (e_0 + C h/2 (r_1 - r_0)),

a vector at each point where laws are evaluated, and the estimate is its norm over that of the largest stress so far.
Rates of laws that swell are those of short steps at both ends, as ε - C^-1 σ changes by more than flow.
Measured on a pellet that is pressed and held, a tube pressed against a wall and one that bulges, in 4 to 64 steps for
two to four decades of time, its largest value in a history is 0.9 to 1.8 times the largest error of stress, contact
forces, displacement or cumulated strain, each relative; tests hold that of tubes that swell or soften to a factor of
three. Only the largest value of a history counts: at the end of a long hold it is up to fifteen times too small, since
a body relaxes more slowly than its points.
It costs one evaluation of the laws with rates and 0.07 ms a step: little, except for condensed inelastic models, whose
steps take 0.17 ms. Laws without rates have no such error: their steps are exact for straight paths of strain; their
error on other paths is not estimated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from hhr_dolfinx.errors import ConvergenceError, SceneError
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.plugins.inelastic.equilibrium import Diverged, Equilibrium, Goal, Stepper
from hhr_dolfinx.plugins.inelastic.law import Given, LawProgram, State
from hhr_dolfinx.plugins.inelastic.points import Points
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.plugins.inelastic.update import Material

SAFETY = 0.8
"""Part of the allowed error at which the next part of a step aims."""
SHRUNK = 0.1
GROWN = 4.0
"""Least and largest factor from one part of a step to the next."""
STEPS = 20
"""Steps in which a path without relaxation uses up its tolerance."""
MOST_PARTS = 10_000
"""Parts of one step of a path above which a tolerance is out of reach."""
SUDDEN = 1e-6
"""Part of a step in which the rate of a law at a given stress is computed from its flow."""


@dataclass(frozen=True)
class TimeError:
    """Time error at the end of a step; each step creates another one."""

    bodies: tuple[int, ...]  # bodies whose law has rates, as indices of the groups of the material
    together: Points  # reductions over the points of all ranks
    error: tuple[np.ndarray, ...]  # e at the points of each body, as a stress
    rate: tuple[np.ndarray, ...] | None  # C times the rate of inelastic strain, per second, if it is known
    largest: float = 0.0  # norm of the largest stress so far
    before: float = 0.0  # estimate when a history continued; it does not decay
    added: float = 0.0  # error added by the last step, relative to the largest stress
    left: float = 1.0  # part D of the added error that remains at the end of the step

    @classmethod
    def at_rest(cls, model: Equilibrium, answer: Answer) -> TimeError:
        """Time error at the start of a history, for a model with numbers as moduli."""
        material = model.material.at(answer.parameter)
        groups = material.groups
        bodies = tuple(k for k, group in enumerate(groups) if group.law is not None and group.law.rated)
        nothing = tuple(np.zeros((groups[k].indices.size, material.components)) for k in bodies)
        return cls(bodies, model.together, nothing, nothing)

    @property
    def estimate(self) -> float:
        """Norm of the error over that of the largest stress so far."""
        if self.largest == 0:
            return self.before
        return self.before + self._norm(self.error) / self.largest

    def _norm(self, parts: Sequence[np.ndarray]) -> float:
        """Euclidean norm of values at the points of all ranks."""
        return math.sqrt(self.together.total(sum(float(np.vdot(part, part)) for part in parts)))

    def going_on(self, answer: Answer) -> TimeError:
        """Time error after an answer that was solved before in parts: its estimate is known, its rates are not."""
        nothing = tuple(np.zeros_like(error) for error in self.error)
        largest = max(self.largest, self._norm([gauss_of(answer).stress]))
        return replace(self, error=nothing, rate=None, largest=largest, before=answer.time_error)

    def after(self, model: Equilibrium, before: Answer, answer: Answer) -> TimeError:
        """Time error at the end of a step that was solved in one part by a model with numbers as moduli."""
        if not self.bodies:
            return self
        material = model.material.at(answer.parameter)
        dt = answer.time - before.time
        stress = gauss_of(answer).stress
        try:
            parts = self.together.agreed(
                lambda: [self._body(k, material, before, answer, dt) for k in range(len(self.bodies))]
            )
        except (ConvergenceError, SceneError):  # a law that has an answer in this step alone
            return self
        largest = max(self.largest, self._norm([stress]))
        raw, left = (math.sqrt(self.together.total(sum(part[k] for part in parts))) for k in (2, 3))
        return replace(
            self,
            error=tuple(part[0] for part in parts),
            rate=tuple(part[1] for part in parts),
            largest=largest,
            added=left / largest if largest > 0 else 0.0,
            left=left / raw if raw > 0 else 1.0,
        )

    def through(self, model: Equilibrium, before: Answer, parts: Sequence[Answer]) -> TimeError:
        """Time error at the end of a step in parts, from the answer before it and those at their ends."""
        error = self
        for one, other in pairwise([before, *parts]):
            error = error.after(model, one, other)
        return error

    def _body(
        self, k: int, material: Material, before: Answer, answer: Answer, dt: float
    ) -> tuple[np.ndarray, np.ndarray, float, float]:
        """Error and rate of one body, and the squares of the error that the step adds, before and after D."""
        place = self.bodies[k]
        points = material.groups[place].own
        given = material.given[place]
        old = _there(before, points)
        stress, new = gauss_of(answer)
        inelastic = new.inelastic[points]
        flowed = (inelastic - old.inelastic) @ given.elastic
        strain = stress[points] @ given.compliance + inelastic
        law: Any = material.groups[place].law
        tangents = law.update(strain, old, dt, given, tangent=True).tangents
        rate = _rate(law, answer, points, given, dt) if law.swells else flowed / dt
        rest = self.rate[k] if self.rate is not None else _rate(law, before, points, given, dt)
        added = dt * (rate - rest) / 2
        inverse = law.compliances(given)
        error, kept = ((tangents @ (inverse @ part[..., None]))[..., 0] for part in (self.error[k] + added, added))
        return error, rate, float(np.vdot(added, added)), float(np.vdot(kept, kept))


def _there(answer: Answer, points: slice | np.ndarray) -> State:
    """State of an answer at some points."""
    return State(*(part[points] for part in gauss_of(answer).state))


def _strain(answer: Answer, points: slice | np.ndarray, given: Given) -> np.ndarray:
    """Strain of an answer at some points, from stress and inelastic strain, (n, c)."""
    found: np.ndarray = gauss_of(answer).stress[points] @ given.compliance
    return found + gauss_of(answer).state.inelastic[points]


def _rate(law: LawProgram, answer: Answer, points: slice | np.ndarray, given: Given, dt: float) -> np.ndarray:
    """C times the rate of inelastic strain at a stress: the flow of a law in a short time, (n, c).

    A first moment takes up changes of constants since the answer, which swell at once.
    """
    moment = SUDDEN * dt
    old = _there(answer, points)
    strain = _strain(answer, points, given)
    for _ in range(2 if law.swells else 1):
        begun, old = old, law.update(strain, old, moment, given, tangent=False).state
    return (old.inelastic - begun.inelastic) @ given.elastic / moment


def in_parts(
    stepper: Stepper, trail: tuple[Answer, ...], goal: Goal, error: TimeError, tolerance: float
) -> tuple[list[Answer], TimeError, int]:
    """Solve a step of a path in parts, so that none adds more than the allowed error.

    A part may add tolerance times 1 - D, so that with the decay of the error the estimate stays below the tolerance. If
    D is near 1, it may add the same as if the path had ``STEPS`` steps: later steps are unknown. The allowed error is
    about proportional to the length of a part, and the added error to its square. The length of the next part, or of
    the same one once more, changes by their ratio. The first attempt is the whole step, so that a history that
    continues after stored answers finds the same parts. ``error`` is that at the start of the step. Returns the answers
    at the ends of the parts, the error at the end, and the iterations of all attempts, discarded ones included.

    Raises:
        Diverged: if a part does not converge, or more parts than ``MOST_PARTS`` would be needed.
    """
    start = trail[-1]
    done = 0.0
    spent = 0
    length = 1.0
    largest = 0.0  # stress of all attempts: near rest an error is small beside that of the step
    solved = list[Answer]()
    for _ in range(MOST_PARTS):
        end = min(done + length, 1.0)
        end = 1.0 if 1 - end < 1e-9 else end
        # two equal parts instead of one and a short rest
        end = (1 + done) / 2 if end < 1 < end + 0.5 * length else end
        time = goal.time if end == 1 else start.time + end * (goal.time - start.time)
        part = Goal(time, (1 - end) * start.parameter + end * goal.parameter)
        found = stepper.advance(trail, part)
        spent += sum(answer.iterations for answer in found)
        after = error.through(stepper.model, trail[-1], found)
        duration = end - done
        allowed = tolerance * max(1 - after.left, duration / STEPS)
        if not allowed > 0:
            break
        largest = max(largest, after.largest)
        miss = after.added * after.largest / (largest * allowed) if len(found) == 1 and largest > 0 else 1.0
        factor = float(np.clip(SAFETY / miss, SHRUNK, GROWN)) if miss > 0 else GROWN
        length = duration * factor
        if miss > 1:
            continue
        solved = [*solved, *found]
        error = after
        done = end
        trail = (*trail, *found)[-3:]
        if done == 1:
            return solved, error, spent
    raise Diverged(
        f"a time tolerance of {tolerance:g} takes more than {MOST_PARTS} parts of a step: allow a larger one"
    )
