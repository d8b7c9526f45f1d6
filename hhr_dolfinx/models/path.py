"""The path and the settings of a history, and how models in which nothing flows answer one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import ConvergenceError, NotOfferedError, NotSolvableError, ParameterError
from hhr_dolfinx.models.answer import Answer, GaussState, History, Model, Path
from hhr_dolfinx.models.equilibrium import Equilibrium
from hhr_dolfinx.parameters import ParameterSpace, is_number, is_whole
from hhr_dolfinx.trained import OUTSIDE

if TYPE_CHECKING:
    from hhr_dolfinx.materials.update import Material

SEARCHES = ("tangent", "frozen", "elastic")
LEAST_TOLERANCE = 1e-5
"""Time tolerance below which what a step leaves out of balance counts as much as its length."""


@dataclass(frozen=True)
class MarchSettings:
    """How histories are solved.

    Attributes:
        search: operator of the linearisation: ``tangent``, renewed in each iteration; ``frozen``, the elastic one until
            a step takes many iterations, then the tangent at the start of a step until another one does; ``elastic``.
            The latter two with Anderson's acceleration.
        relative_stress: ε_r of (6.19). In the place of R_σ (6.18), by which a prediction was wrong, stands what the
            next one still moves, H : ε(δ).
        floor_stress: ε_a of (6.19) as a fraction of the largest root mean square of the stress so far, without a unit.
        relative_force: residual over the size of the forces; the stress criterion alone sees only how much
            iterates still change.
        iterations: most iterations of a step before it is cut.
        cuts: how often a step that does not converge may be halved.
        time_tolerance: estimated error of the time steps, relative to the largest stress, that is to be kept where laws
            have rates: steps of the path are solved in as many parts as that takes, and answers handed out at their
            ends. None solves them as they are; ``History.time_error`` says the estimate in any case.
        outside: what happens to a step outside what a reduced model was trained on: ``warn``, ``refuse`` or ``ignore``.
        gradient: whether each answer is to have its derivatives along the parameters, each shifted by the same at all
            times, as a constant of the whole history is; see :mod:`hhr_dolfinx.models.history_gradient`.
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


def check_settings(settings: Any) -> None:
    """Refuse what says nothing of how to solve a history.

    Raises:
        ParameterError: with what was given.
    """
    if not isinstance(settings, MarchSettings):
        raise ParameterError(f"the settings {settings!r} of a history must be MarchSettings, or left out")


def checked_path(parameters: ParameterSpace, path: Iterable[tuple[float, Any]]) -> Path:
    """A whole path, before any of it is solved.

    Raises:
        ParameterError: if it is empty, a parameter is not finite or outside the box, or times do not increase.
    """
    try:
        pairs = [(float(time), target) for time, target in path]
    except (TypeError, ValueError):
        raise ParameterError("a path is a list of pairs: a time in seconds and the parameters there") from None
    checked = [(time, parameters.point(target)) for time, target in pairs]
    if not checked:
        raise ParameterError("the path is empty: its first time and parameter are where the model is at rest")
    times = np.array([time for time, _ in checked])
    if not np.isfinite(times).all():
        raise ParameterError(f"times must be finite, and number {int(np.argmin(np.isfinite(times)))} is not")
    late = np.flatnonzero(np.diff(times) <= 0)
    if late.size:
        before, after = times[late[0] : late[0] + 2]
        raise ParameterError(f"times must increase: {after:g} s comes after {before:g} s")
    return checked


def check_elasticity(material: Material, path: Path) -> None:
    """Refuse a checked path along which a modulus of elasticity changes.

    Raises:
        ParameterError: with the parameter on which it depends.
    """
    for place in material.axes:
        values = np.array([point[place] for _, point in path])
        if np.ptp(values) > 0:
            step = int(np.flatnonzero(values != values[0])[0])
            texts = sorted({group.young for group in material.groups if isinstance(group.young, str)})
            raise ParameterError(
                f"{material.names[place]} changes from {values[0]:g} to {values[step]:g} in step {step} of the path, "
                f"and Young's modulus depends on it ({', '.join(texts)}): elasticity must be the same along a history. "
                f"Keep {material.names[place]} as it is along the path, or let constants of laws alone depend on it"
            )


def solve_along(
    model: Model,
    path: Path,
    settings: MarchSettings,
    *,
    known: Sequence[Answer] = (),
    keep: Callable[[Answer], None] = lambda answer: None,
) -> History:
    """A history of a model in which nothing flows: every point is solved from the statuses of the one before.

    Args:
        model: full, reduced or condensed.
        path: as :func:`checked_path` returns it.
        settings: of which ``outside`` counts.
        known, keep: see :meth:`FullOrderModel.march`.
    """
    check_settings(settings)
    history = History(*path[0])
    start: Any = "nearest"
    try:
        for number, (time, point) in enumerate(path[1:]):
            if number < len(known):
                answer = known[number]
            else:
                # a rival may not know of gradients: it is asked for none unless they are wanted
                wanted = {"gradient": True} if settings.gradient else {}
                answer = model.solve(point, start=start, outside=settings.outside, **wanted)._replace(time=time)
                keep(answer)
            history.answers.append(answer)
            start = answer.active
    except BaseException as stop:
        with suppress(AttributeError):
            stop.history = history  # type: ignore[attr-defined]
        raise
    return history


def refuse_gradient(wanted: bool) -> None:
    """Refuse the gradient of a single step of bodies that flow."""
    if wanted:
        raise NotOfferedError(
            "a single step of bodies that flow has no gradient: how they flow depends on the path, along which there "
            "is one: march(path, MarchSettings(gradient=True))"
        )


def one_step(
    model: Any, mu: Any, raise_on_failure: bool = True, outside: str = "warn", duration: float = 1.0
) -> Answer:
    """Answer of a model of bodies that flow: one step from rest where the box is nearest to zero, with its elasticity.

    How bodies flow depends on the path, for which there is ``march``. The arguments are those of :meth:`Model.solve`,
    and the duration of the step in seconds, which counts for laws with rates.
    """
    space = model.parameters
    target, start = space.point(mu), np.clip(0.0, space.lower, space.upper)
    axes = model.equilibrium.material.axes
    start[axes] = target[axes]  # elasticity is the same along a history
    try:
        return model.march([(0.0, start), (duration, target)], MarchSettings(outside=outside)).answers[-1]
    except (ConvergenceError, NotSolvableError):
        if raise_on_failure:
            raise
        return _unanswered(model.equilibrium, target)


def _unanswered(model: Equilibrium, parameter: np.ndarray) -> Answer:
    """An answer that is none."""
    nothing = np.full(model.size, np.nan), np.full(model.conditions, np.nan), np.zeros(model.conditions, dtype=bool)
    stress = np.full((model.material.gauss_points, model.material.components), np.nan)
    rest = model.material.at_rest()
    unknown = rest._replace(plastic=np.full_like(rest.plastic, np.nan), cumulated=np.full_like(rest.cumulated, np.nan))
    gauss = GaussState(stress, unknown)
    return Answer(parameter, *nothing, 0, Status.DIVERGED, False, model.fields, gauss=gauss)
