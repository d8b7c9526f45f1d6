"""Protocols of equilibrium: what a history needs of a full model, one cut to a RID, or one of small arrays.

An elastic scene has a linearisation that never changes. Its models solve with that one and need no other part of the
protocols.

The settings of a history are here too, and warnings of time steps that are too long: one for each history, or one for
a whole training.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from math import prod
from numbers import Real
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.active_set import Statuses
from hhr_dolfinx.errors import ParameterError, TimeStepWarning
from hhr_dolfinx.models.answer import Answer, Fields, GaussState
from hhr_dolfinx.parameters import ParameterSpace, is_number, is_whole
from hhr_dolfinx.trained import OUTSIDE, Signs, TrainedPaths
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.contact.friction import Friction
    from hhr_dolfinx.plugins.inelastic.update import Material, Update
    from hhr_dolfinx.plugins.inelastic.points import Points
    from hhr_dolfinx.models.histories.rubbing_step import RubbingStep


class Correction(NamedTuple):
    """Solution of one linearised contact problem.

    Attributes:
        change: of the unknown.
        found: total contact forces and their statuses.
    """

    change: np.ndarray
    found: Statuses


class Changing(Protocol):
    """A converged step, for its derivatives."""

    def changed(self, residual: np.ndarray, gaps: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve K δ + B^T λ = residual, B δ = gaps where active, λ = 0 elsewhere: (δ, λ) of a small change."""


class Linearisation(Changing, Protocol):
    """Linearisation of a model; exact for elastic models."""

    @property
    def moduli(self) -> np.ndarray:
        """Tangents H at its Gauss points, (points, components, components)."""

    def correct(
        self, residual: np.ndarray, x: np.ndarray, theta: Theta, active: np.ndarray, rubbing: RubbingStep | None = None
    ) -> Correction:
        """Solve K δ + B^T λ = residual, B (x + δ) <= gaps from some statuses, with friction if there is any."""


class Diverged(Exception):
    """A step did not converge: the reason, and the Gauss point with the largest change or flow, if known."""

    def __init__(self, why: str, worst: int | None = None):
        super().__init__(why)
        self.worst = worst


class Goal(NamedTuple):
    """Time and parameter to reach."""

    time: float
    parameter: np.ndarray


class Stepper(Protocol):
    """Solves the steps of one history."""

    def step(self, trail: tuple[Answer, ...], goal: Goal) -> Answer:
        """Answer at a goal from the last answers, at most three; the last of them is the present one.

        Raises:
            Diverged: if it was not found.
        """

    def learn(self, answer: Answer) -> None:
        """Take in a step that was solved before."""

    def signs(self, answer: Answer) -> Signs:
        """Signs at a solved step that the model left its training."""


class Marching(Protocol):
    """Model whose histories are solved step by step and differentiated; ``x`` is the unknown.

    Attributes:
        parameters: the box of the parameters.
        material: elasticity and laws at its Gauss points; ``material.at(parameter)`` has their constants there.
        points: numbers of these points in the full model; of the points of all ranks.
        together: reductions over the Gauss points of all ranks.
        per_cell: Gauss points of a cell of the full model.
        size, conditions: number of unknowns and of contact conditions.
        friction: tangential conditions and their laws; None without friction.
        young: formulas of Young's moduli of all bodies, also of those without Gauss points in the model.
    """

    parameters: ParameterSpace
    material: Material
    young: tuple[str, ...]
    points: np.ndarray
    together: Points
    per_cell: int
    size: int
    conditions: int
    friction: Friction | None

    @property
    def fields(self) -> Fields:
        """Completion of its answers."""

    @property
    def trained(self) -> TrainedPaths | None:
        """Training range of a reduced model; None for a full one."""

    @property
    def lock(self) -> AbstractContextManager:
        """Lock to hold during a history."""

    def amplitudes(self, point: np.ndarray) -> Theta:
        """θ at a parameter."""

    def stepper(self, settings: MarchSettings) -> Stepper:
        """Solver of the steps of a history."""

    def at(self, point: np.ndarray) -> Marching:
        """The model with the elasticity of a point, (P,); itself for constant elasticity.

        The one of the last elasticity is kept. If elasticity varies, the model itself has formulas in its material, and
        the elastic linearisation of the middle of the box.
        """

    def responding_at(self, point: np.ndarray) -> Marching:
        """The model whose strain, gaps and residual at a given unknown have the elasticity of a point, (P,)."""

    def strain(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Strain at all Gauss points, lift included, minus strains without stress: the input of laws."""

    def strain_of(self, change: np.ndarray) -> np.ndarray:
        """Strain of a change of the unknown."""

    def gaps(self, theta: Theta) -> np.ndarray:
        """Gaps minus the known part of the motion, (conditions,): upper bounds of B x."""

    def gaps_at(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Gaps for the unknowns next to a given one: with the motion by its forces, if these are unknowns."""

    def residual(self, x: np.ndarray, gauss: GaussState | Update, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
        """Residual at an unknown with stress and state, in the test space, and the size of its terms."""

    def signs(self, answer: Answer) -> Signs:
        """Signs at a solved step that the model left its training."""

    def linearised(self, tangents: Any) -> Changing:
        """Linearisation for consistent tangents; linearisations of earlier tangents become invalid."""


class Equilibrium(Marching, Protocol):
    """Additional interface for steps by linearisation; ``x`` is U0 or gamma."""

    @property
    def elastic(self) -> Linearisation:
        """The elastic linearisation."""

    def at(self, point: np.ndarray) -> Equilibrium:
        """See :class:`Marching`."""

    def residual(self, x: np.ndarray, gauss: GaussState | Update, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
        """Loads minus internal forces, in the test space, and the size of both for each body, (bodies,)."""

    def norms(self, residual: np.ndarray) -> np.ndarray:
        """Norm of a residual for each body, (bodies,)."""

    def round_off(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Size of round-off in the residual at an unknown, for each body, (bodies,)."""

    def contact_load(self, forces: np.ndarray) -> np.ndarray:
        """B^T λ in the test space."""

    def linearised(self, tangents: Any) -> Linearisation:
        """See :class:`Marching`."""


def extrapolated(trail: Sequence[Answer], time: float, count: int | None = None) -> np.ndarray:
    """Extrapolation of the (first ``count``) unknowns of some answers to a later time, by a polynomial."""
    x = np.zeros_like(trail[0].unknown[:count])
    for answer in trail:
        # Lagrange's polynomials
        others = [other.time for other in trail if other is not answer]
        x += prod((time - other) / (answer.time - other) for other in others) * answer.unknown[:count]
    return x


ACCEPTED = 0.05
"""Estimated time error above which a history without a time tolerance raises a warning."""
_COLLECTED: ContextVar[list[float] | None] = ContextVar("time errors of a training", default=None)


def warn_of_time_error(estimate: float, tolerance: float | None) -> None:
    """Warn of a large time error, unless a tolerance was given, or :func:`told_once` collects the warnings."""
    collected = _COLLECTED.get()
    if collected is not None:
        collected.append(estimate)
    elif tolerance is None and estimate > ACCEPTED:
        warn(f"the time steps of this history {_said(estimate)}", TimeStepWarning, stacklevel=5)


@contextmanager
def told_once(what: str = "") -> Iterator[None]:
    """Collect the time errors of histories in a block and warn once at its end, as ``what``; never without a name."""
    collected = _COLLECTED.get()
    if collected is not None:  # the outermost block warns
        yield
        return
    estimates: list[float] = []
    token = _COLLECTED.set(estimates)
    try:
        yield
    finally:
        _COLLECTED.reset(token)
    large = [item for item in estimates if item > ACCEPTED]
    if what and large:
        text = f"the time steps of {len(large)} of {len(estimates)} {what} {_said(max(large))}"
        warn(text, TimeStepWarning, stacklevel=5)


def _said(estimate: float) -> str:
    return (
        f"make errors of {100 * estimate:.2g} % of the largest stress by estimate, and {100 * ACCEPTED:g} % is much: "
        "take more of them where loads are put on or held, or MarchSettings(time_tolerance=0.01)"
    )


SEARCHES = ("tangent", "frozen", "elastic")


LEAST_TOLERANCE = 1e-5
"""Time tolerance below which the residual left in a step counts as much as its duration."""


@dataclass(frozen=True)
class MarchSettings:
    """Settings of the solution of histories.

    Attributes:
        search: operator of the linearisation. ``tangent`` is renewed in each iteration. ``frozen`` is the elastic one
            until a step takes many iterations, then the tangent at the start of a step until another step does.
            ``elastic`` never changes. The latter two have Anderson's acceleration.
        relative_stress: ε_r of (6.19). Instead of R_σ (6.18), the error of the last prediction, the criterion uses the
            change by the next one, H : ε(δ).
        floor_stress: ε_a of (6.19) as a fraction of the largest root mean square of the stress so far, without a unit.
        relative_force: residual over the size of the forces; the stress criterion alone only measures the change of
            iterates.
        iterations: most iterations of a step before it is cut.
        cuts: how often a step that does not converge may be halved.
        time_tolerance: largest estimated error of the time steps, relative to the largest stress, for laws with rates.
            A step of the path is solved in as many parts as that takes, and answered at its end. None does not cut
            steps; ``History.time_error`` has the estimate in any case.
        outside: policy for a step outside the training range of a reduced model: ``warn``, ``refuse`` or ``ignore``.
        gradient: compute derivatives of each answer along the parameters, each shifted by the same at all times, as a
            constant of the whole history; see :mod:`hhr_dolfinx.plugins.inelastic.history_gradient`.
    """

    search: str = "frozen"
    relative_stress: float = 1e-5
    floor_stress: float = 5e-3
    relative_force: float = 1e-5
    iterations: int = 60
    cuts: int = 6
    outside: str = "warn"
    gradient: bool = False
    time_tolerance: float | None = None

    def __post_init__(self):
        for name, choices in (("search", SEARCHES), ("outside", OUTSIDE)):
            if getattr(self, name) not in choices:
                raise ParameterError(f"{name} '{getattr(self, name)}' is unknown, one of {', '.join(choices)}")
        for name in ("relative_stress", "floor_stress", "relative_force"):
            if not (isinstance(getattr(self, name), Real) and 0 < getattr(self, name) < 1):
                raise ParameterError(f"{name} = {getattr(self, name)} must be a fraction in (0, 1)")
        if not isinstance(self.gradient, bool):
            raise ParameterError(f"gradient = {self.gradient!r} must be True or False")
        if not (is_whole(self.iterations, 1) and is_whole(self.cuts, 0)):
            raise ParameterError(
                f"iterations = {self.iterations} must be a whole number from 1, and cuts = {self.cuts} one from 0"
            )

        tolerance = self.time_tolerance
        if not (tolerance is None or (is_number(tolerance) and LEAST_TOLERANCE <= tolerance < 1)):
            raise ParameterError(
                f"time_tolerance = {tolerance!r} must be a fraction from {LEAST_TOLERANCE:g} to 1, as 0.01 is, or None"
            )
        if self.gradient and tolerance is not None:
            raise ParameterError(
                f"steps cut by a time_tolerance of {tolerance:g} have no gradient: march along the path in more steps, "
                "without a tolerance, until History.time_error is small enough"
            )


DEFAULT_MARCH = MarchSettings()
