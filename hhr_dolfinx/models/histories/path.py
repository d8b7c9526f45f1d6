"""The path of a history, and its solution by elastic models."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import ConvergenceError, NotOfferedError, NotSolvableError, ParameterError, SceneError
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer, GaussState, History, Model, Path
from hhr_dolfinx.models.histories.equilibrium import Equilibrium, MarchSettings
from hhr_dolfinx.parameters import ParameterSpace, PointLike


def check_settings(settings: Any) -> None:
    """Refuse invalid settings of a history.

    Raises:
        ParameterError: with the value given.
    """
    if not isinstance(settings, MarchSettings):
        raise ParameterError(f"the settings {settings!r} of a history must be MarchSettings, or left out")


def checked_path(parameters: ParameterSpace, path: Iterable[tuple[float, Any]]) -> Path:
    """Check a whole path before any of it is solved.

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


def elastic_axes(young: Sequence[str], names: Sequence[str]) -> dict[int, list[str]]:
    """Formulas of Young's moduli by the index of each parameter on which they depend."""
    if not young:
        return {}
    # imported here: most moduli are numbers, and then formulas need not be loaded
    from hhr_dolfinx.formulas import formula_of

    variables = {text: formula_of(text, "young").variables for text in sorted(set(young))}
    found = {place: [text for text, own in variables.items() if name in own] for place, name in enumerate(names)}
    return {place: texts for place, texts in found.items() if texts}


def check_elasticity(young: Sequence[str], names: Sequence[str], path: Path) -> None:
    """Refuse a checked path along which a modulus of elasticity changes, by its formulas and the parameters' names.

    Raises:
        ParameterError: with the parameter on which it depends.
    """
    for place, texts in elastic_axes(young, names).items():
        values = np.array([point[place] for _, point in path])
        if np.ptp(values) > 0:
            name = names[place]
            step = int(np.flatnonzero(values != values[0])[0])
            raise ParameterError(
                f"{name} changes from {values[0]:g} to {values[step]:g} in step {step} of the path, "
                f"and Young's modulus depends on it ({', '.join(texts)}): elasticity must be the same along a history. "
                f"Keep {name} as it is along the path, or let constants of laws alone depend on it"
            )


def solve_along(
    model: Model,
    path: Path,
    settings: MarchSettings,
    *,
    known: Sequence[Answer] = (),
    keep: Callable[[Answer], None] = lambda answer: None,
) -> History:
    """History of an elastic model: every point is solved from the statuses of the one before.

    Args:
        model: full, reduced or condensed.
        path: as :func:`checked_path` returns it.
        settings: ``outside`` counts.
        known, keep: see :meth:`FullOrderModel.march`.
    """
    check_settings(settings)
    history = History(*path[0])
    start: str | np.ndarray = "nearest"
    try:
        for number, (time, point) in enumerate(path[1:]):
            if number < len(known):
                answer = known[number]
            else:
                # baselines may lack gradients: pass the argument only if it is set
                wanted = {"gradient": True} if settings.gradient else {}
                answer = model.solve(point, start=start, outside=settings.outside, **wanted)
                answer = answer._replace(time=time, time_error=0.0)
                keep(answer)
            history.answers.append(answer)
            start = answer.active
    except BaseException as stop:
        with suppress(AttributeError):
            stop.history = history  # type: ignore[attr-defined]
        raise
    return history


def refuse_gradient(wanted: bool) -> None:
    """Refuse the gradient of a single step of inelastic bodies."""
    if wanted:
        raise NotOfferedError(
            "a single step of bodies that flow has no gradient: how they flow depends on the path, along which there "
            "is one: march(path, MarchSettings(gradient=True))"
        )


def one_step(
    model: Any, mu: PointLike, raise_on_failure: bool = True, outside: str = "warn", duration: float = 1.0
) -> Answer:
    """Answer of a model of inelastic bodies: one step from rest, where the box is nearest to zero, with its elasticity.

    Plastic strain depends on the path, which ``march`` follows. The arguments are those of :meth:`Model.solve`, and the
    duration of the step in seconds, which counts for laws with rates.
    """
    space = model.parameters
    target = space.point(mu)
    start = np.clip(0.0, space.lower, space.upper)
    axes = list(elastic_axes(model.equilibrium.young, space.names))
    start[axes] = target[axes]  # elasticity is constant along a history
    if model.friction is not None:  # friction too: in parts of a step that is cut it would be too small
        start[model.friction.fixed] = target[model.friction.fixed]
    try:
        return model.march([(0.0, start), (duration, target)], MarchSettings(outside=outside)).answers[-1]
    except (ConvergenceError, NotSolvableError, SceneError):  # of a modulus or a constant that is impossible there
        if raise_on_failure:
            raise
        return _unanswered(model.equilibrium, target)


def _unanswered(model: Equilibrium, parameter: np.ndarray) -> Answer:
    """An empty answer."""
    nothing = np.full(model.size, np.nan), np.full(model.conditions, np.nan), np.zeros(model.conditions, dtype=bool)
    stress = np.full((model.material.gauss_points, model.material.components), np.nan)
    rest = model.material.at_rest()
    unknown = rest._replace(plastic=np.full_like(rest.plastic, np.nan), cumulated=np.full_like(rest.cumulated, np.nan))
    gauss = GaussState(stress, unknown)
    return Answer(parameter, *nothing, 0, Status.DIVERGED, False, model.fields, memory=Memory(gauss=gauss))
