"""Constitutive update of all Gauss points: radial return by compiled loops, flow by the laws of the scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.compat import compiled
from hhr_dolfinx.errors import ConvergenceError, SceneError
from hhr_dolfinx.materials.elasticity import lame_parameters


class State(NamedTuple):
    """What the material remembers.

    Attributes:
        plastic: plastic strain, Kelvin's notation, (points, components).
        cumulated: cumulated plastic strain p, (points,).
    """

    plastic: np.ndarray
    cumulated: np.ndarray


class Update(NamedTuple):
    """Outcome of a step at all points.

    Attributes:
        stress: (points, components).
        state: at the end of the step.
        tangents: consistent tangents, (points, components, components), or None.
    """

    stress: np.ndarray
    state: State
    tangents: np.ndarray | None


SLOPE = 0.05
"""Relative error of a slope worth a word: differences of the laws here agree to 1e-6, a forgotten factor is far off."""


@dataclass(frozen=True)
class Group:
    """Points of one body.

    Attributes:
        points: their numbers, a slice or indices.
        young, poisson: elastic constants.
        law: flow, or None for an elastic body.
    """

    points: np.ndarray
    young: float
    poisson: float
    law: object | None


class Material:
    """Laws of all Gauss points of a model.

    Args:
        groups: one per body; together they hold every point once.
        components: of a strain, 4 or 6.
    """

    def __init__(self, groups: list[Group], components: int):
        self.groups, self.components = groups, components
        self.size = sum(group.points.size for group in groups)
        self.elastic = np.empty((self.size, components, components))
        unit = np.zeros(components)
        unit[:3] = 1.0
        for group in groups:
            lam, mu = lame_parameters(group.young, group.poisson)
            self.elastic[group.points] = lam * np.outer(unit, unit) + 2 * mu * np.eye(components)

    @property
    def flows(self) -> bool:
        """Whether any body can flow."""
        return any(group.law is not None for group in self.groups)

    def restricted(self, points: np.ndarray) -> Material:
        """The material of some points, renumbered in their order."""
        groups = []
        for group in self.groups:
            kept = np.flatnonzero(np.isin(points, group.points))
            if kept.size:
                groups.append(Group(kept, group.young, group.poisson, group.law))
        return Material(groups, self.components)

    def at_rest(self) -> State:
        """No plastic strain anywhere."""
        return State(np.zeros((self.size, self.components)), np.zeros(self.size))

    def update(self, strain: np.ndarray, old: State, dt: float, *, tangent: bool) -> Update:
        """Stress and state at the end of a step.

        Args:
            strain: total strain at the end of the step, (points, components).
            old: state before the step; not modified.
            dt: length of the step in seconds.
            tangent: whether consistent tangents are wanted.

        Raises:
            SceneError: if a law does not answer with numbers.
            ConvergenceError: if a law finds no flow, or one that is impossible.
        """
        stress, plastic, cumulated = np.empty_like(strain), old.plastic.copy(), old.cumulated.copy()
        tangents = np.empty((*strain.shape, self.components)) if tangent else _NO_TANGENTS
        for group in self.groups:
            lam, mu = lame_parameters(group.young, group.poisson)
            bulk, points = lam + 2 * mu / 3, group.points
            trial = self._trial(group, strain, old, mu)
            if group.law is None:
                flow = _Flow(np.zeros(points.size), np.zeros(points.size))
            else:
                trial.equivalent.setflags(write=False)  # a law that wrote there would spoil the return below
                flow = _flow_of(group.law, trial.equivalent, old.cumulated[points], mu, dt)
                _check_flow(group.law, flow, trial.equivalent, mu)
            _return(points, strain, trial, flow, (bulk, mu), _Out(stress, plastic, cumulated, tangents))
        return Update(stress, State(plastic, cumulated), tangents if tangent else None)

    def wrong_slopes(self, strain: np.ndarray, old: State, dt: float) -> list[str] | None:
        """Laws whose slope is not the derivative of their flow, in words; None where nothing flows enough to tell.

        A wrong slope changes no answer; steps take more iterations, or fail for no visible reason.

        Args:
            strain, old, dt: of a step, see :meth:`update`.
        """
        complaints = []
        for group in self.groups:
            if group.law is not None:
                _, mu = lame_parameters(group.young, group.poisson)
                trial = self._trial(group, strain, old, mu).equivalent
                complaints.append(_slope_complaint(group.law, trial, old.cumulated[group.points], mu, dt))
        told = [complaint for complaint in complaints if complaint is not None]
        return [complaint for complaint in told if complaint] if told else None

    def _trial(self, group, strain, old, mu) -> _Trial:
        """Trial stress of the points of a body."""
        points = group.points
        trial = _Trial(np.empty((points.size, self.components)), np.empty(points.size))
        _set_trial(points, strain, old.plastic, mu, trial)
        return trial


class _Trial(NamedTuple):
    """Deviator (n, components) and equivalent stress (n,) of a step without flow."""

    deviator: np.ndarray
    equivalent: np.ndarray


class _Flow(NamedTuple):
    """Flow of a step and its derivative by the equivalent trial stress, (n,) each."""

    amount: np.ndarray
    slope: np.ndarray


class _Out(NamedTuple):
    """Arrays of all points that a step writes; tangents may be empty, where none are wanted."""

    stress: np.ndarray
    plastic: np.ndarray
    cumulated: np.ndarray
    tangents: np.ndarray


def _flow_of(law, trial, cumulated, mu, dt) -> _Flow:
    """What a law answers, as arrays of numbers.

    Raises:
        SceneError: if it answers with something else.
        ConvergenceError: if it finds no flow.
    """
    try:
        answer = law.flow(trial, cumulated, mu, dt)
    except ArithmeticError as error:
        raise ConvergenceError(f"{law} found no flow in a step of {dt:g} s: {error}") from error
    except Exception as error:  # a law is a user's own code
        raise SceneError(f"the law {law} failed with {type(error).__name__}: {error}") from error
    try:
        amount, slope = answer
        if np.iscomplexobj(amount) or np.iscomplexobj(slope):
            raise TypeError("complex numbers")
        return _Flow(np.asarray(amount, dtype=float), np.asarray(slope, dtype=float))
    except (TypeError, ValueError) as error:
        raise SceneError(
            f"the law {law} answered {_shortened(answer)}: its method flow must return two arrays of numbers, "
            "the flow and its derivative"
        ) from error


def _shortened(answer, most=60):
    """Begin of what was answered, for messages."""
    text = " ".join(repr(answer).split())
    return text if len(text) <= most else text[:most] + "..."


def _check_flow(law, flow, trial, mu):
    """Refuse a flow that is not finite or would turn the stress round."""
    amount = flow.amount
    if not np.shape(amount) == np.shape(flow.slope) == trial.shape:
        raise ConvergenceError(f"{law} must answer with a flow and a slope of shape {trial.shape}")
    right = np.isfinite(flow.slope) & (amount >= 0) & (3 * mu * amount <= trial * (1 + 1e-9))
    if np.isfinite(trial).all() and not right.all():
        worst = int(np.argmin(right))
        if not np.isfinite(flow.slope[worst]):
            raise ConvergenceError(
                f"{law} has the slope {flow.slope[worst]:g} under an equivalent stress of {trial[worst]:g}: the "
                "derivative of its flow must be finite, and 0 where nothing flows"
            )
        raise ConvergenceError(
            f"{law} flows by {amount[worst]:g} under an equivalent stress of {trial[worst]:g}: between 0 and "
            f"{trial[worst] / (3 * mu):g} was expected"
        )


def _slope_complaint(law, trial, cumulated, mu, dt) -> str | None:
    """What is wrong with the slope of a law at some points, by central differences; None where they do not flow."""
    step = 1e-4
    below, here, above = (_flow_of(law, trial * (1 + way * step), cumulated, mu, dt) for way in (-1, 0, 1))
    # at the onset of flow there is no derivative
    smooth = (below.amount > 0) & (trial > 0)
    if not smooth.any():
        return None
    differences = (above.amount - below.amount)[smooth] / (2 * step * trial[smooth])
    wrong = np.abs(here.slope[smooth] - differences) / np.abs(differences).max()
    worst = int(wrong.argmax())
    if not wrong[worst] > SLOPE:
        return ""
    return (
        f"the slope of {law} is {here.slope[smooth][worst]:.3g} under an equivalent trial stress of "
        f"{trial[smooth][worst]:.3g}, differences of its flow give {differences[worst]:.3g}: steps will take more "
        "iterations, or fail. Mend the second value that its flow returns"
    )


_NO_TANGENTS = np.empty((0, 0, 0))


@compiled()
def _set_trial(points, strain, plastic, mu, trial):
    components = strain.shape[1]
    for n in range(points.size):
        i = points[n]
        mean = (strain[i, 0] + strain[i, 1] + strain[i, 2]) / 3
        total = 0.0
        for k in range(components):
            value = 2 * mu * (strain[i, k] - plastic[i, k] - (mean if k < 3 else 0.0))
            trial.deviator[n, k] = value
            total += value * value
        trial.equivalent[n] = np.sqrt(1.5 * total)


@compiled()
def _return(points, strain, trial, flow, moduli, out):
    """Radial return; H = bulk 1⊗1 + 2 mu (θ P - (3 mu dΔp/dq - 1 + θ) n⊗n) with θ = 1 - 3 mu Δp / q_tr."""
    components, (bulk, mu) = strain.shape[1], moduli
    for m in range(points.size):
        i, q, amount = points[m], trial.equivalent[m], flow.amount[m]
        mean = bulk * (strain[i, 0] + strain[i, 1] + strain[i, 2])
        theta = 1.0 - 3 * mu * amount / q if amount > 0 else 1.0
        along = 1.5 * amount / q if amount > 0 else 0.0
        for k in range(components):
            out.stress[i, k] = theta * trial.deviator[m, k] + (mean if k < 3 else 0.0)
            out.plastic[i, k] += along * trial.deviator[m, k]
        out.cumulated[i] += amount
        if out.tangents.size > 0:
            off = 2 * mu * (3 * mu * flow.slope[m] - 1 + theta) * 1.5 / (q * q) if amount > 0 else 0.0
            for k in range(components):
                for j in range(components):
                    value = -off * trial.deviator[m, k] * trial.deviator[m, j]
                    if k == j:
                        value += 2 * mu * theta
                    if k < 3 and j < 3:
                        value += bulk - 2 * mu * theta / 3
                    out.tangents[i, k, j] = value
