"""One step of inelastic bodies from rest, and the check that elasticity is constant along a path."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import ConvergenceError, NotOfferedError, NotSolvableError, ParameterError, SceneError
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer, Path
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.parameters import PointLike
from hhr_dolfinx.plugins.inelastic.equilibrium import Marching
from hhr_dolfinx.plugins.inelastic.state import GaussState


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
    start[model.law.fixed] = target[model.law.fixed]  # in parts of a step that is cut they would be too small
    try:
        return model.march([(0.0, start), (duration, target)], MarchSettings(outside=outside)).answers[-1]
    except (ConvergenceError, NotSolvableError, SceneError):  # of a modulus or a constant that is impossible there
        if raise_on_failure:
            raise
        return _unanswered(model.equilibrium, target)


def _unanswered(model: Marching, parameter: np.ndarray) -> Answer:
    """An empty answer."""
    nothing = np.full(model.size, np.nan), np.full(model.conditions, np.nan), np.zeros(model.conditions, dtype=bool)
    stress = np.full((model.material.gauss_points, model.material.components), np.nan)
    rest = model.material.at_rest()
    unknown = rest._replace(plastic=np.full_like(rest.plastic, np.nan), cumulated=np.full_like(rest.cumulated, np.nan))
    gauss = GaussState(stress, unknown)
    return Answer(parameter, *nothing, 0, Status.DIVERGED, False, model.fields, memory=Memory(gauss=gauss))
