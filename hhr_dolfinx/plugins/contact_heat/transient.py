"""Condensed models with transient heat through contacts."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple, NoReturn, cast

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from hhr_dolfinx.errors import (
    ConvergenceError,
    NotOfferedError,
    OutsideTrainingWarning,
    ParameterError,
)
from hhr_dolfinx.models.functionals.functional import Outputs
from hhr_dolfinx.parameters import PointLike, Tag, is_number
from hhr_dolfinx.plugins.contact_heat.by_sets import SetResponses, solved
from hhr_dolfinx.plugins.contact_heat.heated import HeatAnswer, HeatedModel, continued
from hhr_dolfinx.plugins.contact_heat.newton import (
    CoupledContact,
    CoupledSolution,
    by_conducting_gaps,
    changes_of,
)
from hhr_dolfinx.plugins.contact_heat.parts import TransientParts
from hhr_dolfinx.plugins.contact_heat.sliding import PerHeat
from hhr_dolfinx.warn import warn

Points = PointLike | Sequence[PointLike]
"""Parameters of all steps, (P,), or of each, (n, P), or values by name of one or each."""
Times = Sequence[float] | np.ndarray
"""Ends of steps, (n,)."""
Start = float | np.ndarray | Mapping[Tag, float]
"""Temperature of all nodes, of each, (nodes,), or of each body by its tag."""
LOST_START = 0.01
"""Part of the temperatures at the start that modes may lose without a word."""
STEADY_STEP = 1e6
"""Length of a step over the slowest decay from which steady heat is what is meant."""
UNIFORM_START = 1e-10
"""Part of the temperatures at the start that is no deviation from those of warm bodies."""
SAME_LENGTH = 1e-6
"""Part by which a step may be shorter than the shortest one without a word."""
KEPT_STEPS = 8
"""Most lengths of steps whose matrices are kept."""


class _HeatStep(NamedTuple):
    """Matrices of one length of steps: amplitudes are weights * (..) + per_flow @ flows."""

    weights: np.ndarray  #: amplitude after the step over that before, (r,)
    per_flow: np.ndarray  #: amplitudes per heat flow and heat of conditions that slide, (r, m + g)
    compliance: np.ndarray  #: jump of the temperature that a heat flow takes away, (m, m)
    per_heat: np.ndarray  #: slack per heat flow, (m, m)
    per_sliding: PerHeat
    responses: SetResponses


class TransientHeatModel(HeatedModel):
    """Condensed model of contact and transient heat, without training.

    Steps are implicit (backward Euler); with all modes they are those of the full order model.
    Made by :func:`~hhr_dolfinx.plugins.contact_heat.making.condense_transient_heat`.

    Args:
        parts: its data.

    Attributes:
        rates: of the decay of modes, 1 / time, (r,).
        step_error: largest error of what one step changes, over that change, where the steady
            temperatures of a supply, a heat flow or a warm body vanish, by the heat that they store
            in that body, at lengths that were left for it; 0 with all modes.
    """

    def __init__(self, parts: TransientParts):
        super().__init__(parts.heated)
        self.transient = parts
        self.rates = parts.rates
        self.step_error = parts.step_error
        shapes = self.conduction.levels
        stored = parts.capacity @ shapes
        self._reading = stored.T / np.einsum("nr,nr->r", shapes, stored)[:, None]
        self._given = self._reading @ self.conduction.temperatures
        self._flowing = self._reading @ self.conduction.per_heat
        self._steps: OrderedDict[float, _HeatStep] = OrderedDict()

    def __reduce__(self) -> tuple[type[TransientHeatModel], tuple[TransientParts]]:
        """Copy and pickle by the data, without caches; stress needs the mesh, and stays out."""
        return type(self), (self.transient,)

    def __repr__(self) -> str:
        return (
            f"<condensed model with transient heat: {self.conditions} contact conditions, "
            f"{self.rates.size} modes, {len(self.parameters.names)} parameters>"
        )

    def on_page(self) -> NoReturn:
        """Pages have steady heat.

        Raises:
            NotOfferedError: always.
        """
        raise NotOfferedError(
            "a page has steady heat, hhr.condense_heat, and this model has heat in time: write a "
            "unit that steps in time, hhr embed"
        )

    @property
    def coupling(self) -> dict[str, np.ndarray]:
        """Matrices of contact, heat flows and modes by name, for other languages."""
        m = self.conditions
        return super().coupling | {
            "levels": np.zeros((m, 0)),
            "supplied": np.zeros((0, self._jumps.shape[1])),
            "supplied_by_friction": np.zeros((0, 0)),
            "per_heat": self._per_heat[:, :m],
            "rates": self.rates,
            "grown": self.transient.grown,
            "drained": self.transient.drained,
            "given": self._given,
            "flowing": self._flowing,
            "slack_by_mode": self._per_heat[:, m:],
            "jump_by_mode": self._levels,
            "uniform": self._reading.sum(axis=1),
        }

    def march(
        self, points: Points, times: Times, start: Start, *, raise_on_failure: bool = True
    ) -> list[HeatAnswer]:
        """Answers at the ends of time steps; the history starts at time 0.

        Args:
            points: parameters during each step, (n, P), or one of all steps, (P,); or values by
                name, of each or all.
            times: ends of the steps, positive and rising, (n,).
            start: temperature at time 0: a number, one of each body by its tag, or those of the
                nodes, (nodes,), such as ``answer.temperature()`` of the steady model.
            raise_on_failure: raise where a step finds no balance; else its answer and all later
                ones are NaN.

        Raises:
            ParameterError: for points outside the box, times that do not rise, or temperatures that
                are not those of the nodes.
            ConvergenceError: where a step finds no balance, with its time.
            SceneError: where a conductance is negative.

        Warns:
            OutsideTrainingWarning: for temperatures at the start that few modes do not have.
        """
        steps = self._marched(points, times, start, raise_on_failure)
        return [answer for answer, _ in steps]

    def outputs(
        self, points: Points, times: Times, start: Start, *, gradient: bool = False
    ) -> list[Outputs]:
        """Outputs at the ends of time steps, see :meth:`HeatAnswer.outputs`.

        Args:
            points, times, start: see :meth:`march`.
            gradient: add derivatives along a change of the parameters that is the same in all
                steps, at the statuses of the answers; times and start stay.

        Raises:
            ConvergenceError, ParameterError, SceneError: see :meth:`march`.

        Warns:
            OutsideTrainingWarning: see :meth:`march`.
        """
        count = len(self.parameters.names)
        stored = np.zeros((self.rates.size, count))  # derivatives of the amplitudes, (r, P)
        found: list[Outputs] = []
        for answer, length in self._marched(points, times, start, raise_on_failure=True):
            if not gradient:
                found.append(answer.outputs())
                continue
            changes, stored = self._changed(answer, length, stored)
            found.append(replace(answer.outputs(), gradient=self._gradient(answer, changes)))
        return found

    def _marched(
        self, points: Points, times: Times, start: Start, raise_on_failure: bool
    ) -> Iterator[tuple[HeatAnswer, float]]:
        """Answer and length of each step."""
        ends = _times(times)
        checked = self._points(points, ends.size)
        self._warn_of_short(np.diff(ends, prepend=0.0))
        amplitudes = self._starting(start)
        before: tuple[HeatAnswer, ...] = ()
        lengths = np.diff(ends, prepend=0.0)
        for number, (point, length) in enumerate(zip(checked, lengths, strict=True)):
            last = self._stepped(point, float(length), amplitudes, before)
            before = (*before[-1:], last)
            if raise_on_failure and not last.converged:
                raise ConvergenceError(
                    f"contact and heat find no balance at time {ends[number]:g}, at "
                    f"{self.parameters.described(point)}, after {number} steps that do: "
                    f"{self._advice(length)}; raise_on_failure=False keeps the answers before"
                )
            supplies = self.conduction.supplies(point)
            amplitudes = last.levels + self._given @ supplies - self._flowing @ last.flows
            yield last, float(length)

    def _warn_of_short(self, lengths: np.ndarray) -> None:
        """Warn of steps that are shorter than those that modes were made for."""
        shortest = self.transient.shortest
        if lengths.min() < (1 - SAME_LENGTH) * shortest:
            warn(
                f"a step of {lengths.min():g} is shorter than {shortest:g}, the shortest that the "
                "modes of this model were made for, and its error is not known: make them with "
                "condense_transient_heat(..., shortest=...)",
                OutsideTrainingWarning,
            )

    def _advice(self, length: float) -> str:
        """Advice where a step of this length finds no balance."""
        decaying = self.rates[self.rates > 0]
        if decaying.size and length * decaying.min() > STEADY_STEP:
            return "so long a step ends in steady heat, and loses digits: condense_heat has that"
        return "take shorter steps, or a smoother conductance"

    def _changed(
        self, answer: HeatAnswer, length: float, before: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of heat flows and levels, (m + r, P), and of the amplitudes of temperatures
        after a step, (r, P), by those before it.
        """
        step = self._step(length)
        supplies = self._supply_slopes(answer.parameter)
        kept = step.weights[:, None] * (before + self._warming(length) @ supplies)
        along = self._along(answer, step.per_sliding)
        m = self.conditions
        of_step = along._replace(
            slack=along.slack + self._per_heat[:, m:] @ kept,
            jump=along.jump + self._levels @ kept,
            supplied=np.zeros((0, kept.shape[1])),
        )
        without_flows = answer.levels - step.per_flow @ answer.flows
        still = self._still_contact(answer.parameter)
        contact = self._of_step(still, answer.parameter, step, without_flows)
        solution = answer.solution
        alone = CoupledSolution(
            solution.forces, solution.slack, solution.heat, np.zeros(0), 0, converged=True
        )
        forces, changes = changes_of(contact, alone, of_step)
        made = self._made_changes(answer, forces)
        flows = np.vstack([changes, made])
        levels = kept + step.per_flow @ flows
        after = levels + self._given @ supplies - self._flowing @ flows
        return np.vstack([flows, levels]), after

    def _points(self, points: Points, count: int) -> np.ndarray:
        one = isinstance(points, Mapping) or is_number(points)
        rows: list[Any] = [points] if one else list(cast("Sequence[Any]", points))
        if one or all(is_number(row) for row in rows):
            return np.tile(self.parameters.point(cast("PointLike", points)), (count, 1))
        checked = [self.parameters.point(row) for row in rows]
        if len(checked) != count:
            raise ParameterError(f"{len(checked)} points and {count} times: one for each step")
        return np.array(checked)

    def _starting(self, start: Start) -> np.ndarray:
        """Amplitudes of temperatures, (r,)."""
        nodes = self._reading.shape[1]
        if is_number(start):  # bodies that are warm all over are in the modes
            return float(start) * self._reading.sum(axis=1)
        given = self._by_node(start) if isinstance(start, Mapping) else start
        try:
            field = np.asarray(given, dtype=float)
        except (TypeError, ValueError):
            field = np.array(np.nan)
        if field.shape != (nodes,) or not np.isfinite(field).all():
            raise ParameterError(
                f"the start must be a finite temperature, or one of each of the {nodes} nodes, and "
                + (f"not an array of shape {field.shape}" if field.ndim else f"not {start!r}")
            )
        self._warn_of_lost(field)
        return self._reading @ field

    def _by_node(self, start: Mapping[Tag, float]) -> list[float]:
        """Temperatures of the nodes by those of the bodies, (nodes,)."""
        tags = self.transient.tags
        if set(start) != set(tags) or self.transient.owners is None:
            raise ParameterError(
                f"the start names bodies {sorted(map(str, start))}, and those of the scene are "
                f"{sorted(map(str, tags))}: give each a temperature"
            )
        return [start[tags[number]] for number in self.transient.owners.tolist()]

    @cached_property
    def _parts(self) -> np.ndarray:
        """1 in each body, (n, bodies)."""
        count, owner = connected_components(self.transient.capacity, directed=False)
        return (owner[:, None] == np.arange(count)).astype(float)

    @cached_property
    def _free(self) -> np.ndarray:
        """Nodes without a fixed temperature."""
        return np.flatnonzero(self.conduction.levels.any(axis=1))

    @cached_property
    def _capacity(self) -> csc_matrix:
        return csc_matrix(self.transient.capacity[self._free][:, self._free])

    @cached_property
    def _factor(self) -> Any:
        return splu(self._capacity)

    def _warn_of_lost(self, field: np.ndarray) -> None:
        """Warn of temperatures at the start that modes do not have."""
        if self.step_error == 0:
            return
        deviation = field - self._parts @ ((self._parts.T @ field) / self._parts.sum(axis=0))
        stored = (self.transient.capacity @ deviation)[self._free]
        near = self._factor.solve(stored)
        shapes = self.conduction.levels[self._free]
        rest = near - shapes @ (self._reading @ deviation)
        lost = 0.0
        for part in self._parts[self._free].T > 0:
            size = near[part] @ stored[part]
            left = rest[part] @ (self._capacity @ rest)[part]
            if size > (UNIFORM_START * np.abs(field).max()) ** 2 * self._capacity.sum():
                lost = max(lost, float(np.sqrt(max(left, 0.0) / size)))
        if lost > LOST_START:
            warn(
                f"the start has {lost:.1%} of its size beside all temperatures that the modes of "
                "this model have, and loses them: condense_transient_heat(..., tolerance=0) has "
                "all modes",
                OutsideTrainingWarning,
            )

    def _stepped(
        self,
        point: np.ndarray,
        length: float,
        amplitudes: np.ndarray,
        before: Sequence[HeatAnswer],
    ) -> HeatAnswer:
        """Answer after a step from the amplitudes of temperatures before, (r,), and the last two
        answers, or fewer.
        """
        step = self._step(length)
        supplies = self.conduction.supplies(point)
        kept = step.weights * (amplitudes + self._warming(length) @ supplies)
        still = self._still_contact(point)
        found = self._found(self._of_step(still, point, step, kept), step, before)
        if not found.converged:
            found = _lost(self.conditions)
        made = self._sliding.factors(point) * found.forces[self._sliding.conditions]
        levels = kept + step.per_flow @ np.concatenate([found.heat, made])
        solution = CoupledSolution(
            found.forces, found.slack, found.heat, levels, found.steps, found.converged
        )
        whole = self._sliding.added(still, self._per_sliding, point)
        return self._answer(point, whole, solution, several=False)

    def _warming(self, length: float) -> np.ndarray:
        """Amplitudes that supplies add in a step, before they decay, (r, t)."""
        warming: np.ndarray = length * self.transient.grown - self._given
        return warming

    def _of_step(
        self, contact: CoupledContact, point: np.ndarray, step: _HeatStep, kept: np.ndarray
    ) -> CoupledContact:
        """The problem of a step, of heat flows alone; ``contact`` is that without the heat of
        surfaces that slide, and ``kept`` are the amplitudes without flows.
        """
        m = self.conditions
        still = contact._replace(
            slack=contact.slack + self._per_heat[:, m:] @ kept,
            per_heat=step.per_heat,
            jump=contact.jump + self._levels @ kept,
            compliance=step.compliance,
            levels=np.zeros((m, 0)),
            supplied=np.zeros(0),
        )
        return self._sliding.added(still, step.per_sliding, point)

    def _found(
        self, contact: CoupledContact, step: _HeatStep, before: Sequence[HeatAnswer]
    ) -> CoupledSolution:
        """Balance from those of the steps before, or else from contact without heat, or else by
        gaps that conduct less and less.
        """
        nothing = np.zeros(self.conditions)
        if before:
            last = before[-1]
            if not last.converged:
                return _lost(self.conditions)
            flows = continued(before, levels=False)
            found = solved(contact, last.forces(), flows, step.responses)
            if found.converged:
                return found
        forces = self._without_heat(contact.slack)
        found = solved(contact, forces, nothing, step.responses)
        return found if found.converged else by_conducting_gaps(contact, forces, nothing)

    def _step(self, length: float) -> _HeatStep:
        length = float(f"{length:.12e}")  # those of np.arange differ by round-off
        found = self._steps.get(length)
        if found is not None:
            self._steps.move_to_end(length)
        else:
            weights = 1.0 / (1.0 + length * self.rates)
            drained = length * self.transient.drained
            per_flow = weights[:, None] * (self._flowing - drained)
            m = self.conditions
            slack = self._per_heat[:, m:] @ per_flow
            jump = self._levels @ per_flow
            per_heat = self._per_heat[:, :m] + slack[:, :m]
            steady = self._per_sliding
            found = self._steps[length] = _HeatStep(
                weights,
                per_flow,
                self._compliance - jump[:, :m],
                per_heat,
                PerHeat(
                    steady.slack + slack[:, m:],
                    steady.jump + jump[:, m:],
                    np.zeros((0, steady.slack.shape[1])),
                ),
                SetResponses(self._schur, per_heat),
            )
            while len(self._steps) > KEPT_STEPS:
                self._steps.popitem(last=False)
        return found


def _lost(conditions: int) -> CoupledSolution:
    """No solution, (m,) NaN."""
    forces, slack, flows = np.full((3, conditions), np.nan)
    return CoupledSolution(forces, slack, flows, np.zeros(0), 0, converged=False)


def _times(times: Times) -> np.ndarray:
    try:
        ends = np.atleast_1d(np.asarray(times, dtype=float))
    except (TypeError, ValueError):
        raise ParameterError(f"the times {times!r} of a history must be numbers") from None
    if not ends.size:
        raise ParameterError("a history of no times has no steps")
    if ends.ndim != 1 or not np.isfinite(ends).all() or (np.diff(ends, prepend=0.0) <= 0).any():
        raise ParameterError(
            "the times of a history must be finite, positive and rising: ends of its steps, which "
            "start at 0"
        )
    return ends
