"""Figures of histories: outputs over time, a parameter or another output. Imported on demand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import HHRError, ParameterError
from hhr_dolfinx.models.answer import History, names_of
from hhr_dolfinx.plugins.plots.picture import in_unit

with extra("pictures", "pictures of histories"):
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CURVE_RESOLUTION = 200
"""Dots per inch of saved figures."""
TIME = "time"
ALIKE = 20.0
"""Largest ratio of quantities in one panel: smaller ones would be flat lines."""


class Quantity(NamedTuple):
    """Values of a history at its steps, (steps,), with their name and unit."""

    name: str
    unit: str
    values: np.ndarray

    @property
    def size(self) -> float:
        """Largest magnitude."""
        return float(np.nanmax(np.abs(self.values), initial=0.0))

    @property
    def label(self) -> str:
        """Label of an axis."""
        return f"{self.name}{in_unit(self.unit)}"


def figure_of_history(
    history: History,
    path: str | Path | None = None,
    y: str | Sequence[str] | None = None,
    x: str = TIME,
) -> Figure:
    """Figure of outputs of a history, one panel for each unit and size.

    Args:
        history: the history, of one step or more.
        path: file to save the figure to; None does not save it.
        y: names of outputs; None for all outputs of the scene.
        x: ``time`` in seconds, or the name of a parameter or output.

    Returns:
        A figure of matplotlib, saved if a path is given.

    Raises:
        ParameterError: for a history without steps, or an unknown name.
        HHRError: if the scene has no outputs.
    """
    by_name = quantities(history)
    wanted = [y] if isinstance(y, str) else y
    if wanted is None:
        wanted = list(_outputs_of(history))
    if not wanted:
        raise HHRError("this history has no outputs: name them in the scene, outputs=(...,)")
    for name in (x, *wanted):
        if name not in by_name:
            raise ParameterError(f"a history has no {name!r}: there are {', '.join(by_name)}")
    groups = _panels([by_name[name] for name in wanted])
    figure = Figure(figsize=(7, 1.2 + 2.6 * len(groups)), layout="constrained")
    panels = np.atleast_1d(figure.subplots(len(groups), 1, sharex=True))
    for axes, group in zip(panels, groups, strict=True):
        _draw(axes, by_name[x], group)
    panels[-1].set_xlabel(by_name[x].label)
    if path is not None:
        figure.savefig(path, dpi=CURVE_RESOLUTION)
    return figure


def quantities(history: History) -> dict[str, Quantity]:
    """Time, parameters and outputs of a history by name.

    Raises:
        ParameterError: for a history without steps.
    """
    if not history.answers:
        raise ParameterError("a history without steps cannot be drawn: march along a path first")
    first = history.answers[0]
    times = np.array([answer.time for answer in history.answers])
    points = np.array([answer.parameter for answer in history.answers])
    names = names_of(first) or [f"parameter {k}" for k in range(points.shape[1])]
    pairs = zip(names, points.T, strict=True)
    parameters = {name: Quantity(name, "", values) for name, values in pairs}
    return {TIME: Quantity(TIME, "s", times)} | parameters | _outputs_of(history)


def _outputs_of(history: History) -> dict[str, Quantity]:
    """Outputs of a history by name; none of a scene without outputs."""
    if history.answers[0].fields.functionals is None:
        return {}
    outputs = [answer.outputs() for answer in history.answers]
    return {
        name: Quantity(name, unit, np.array([values[name] for values in outputs]))
        for name, unit in outputs[0].units.items()
    }


def _panels(chosen: Sequence[Quantity]) -> list[list[Quantity]]:
    """Quantities of one unit and of similar size together."""
    groups: list[list[Quantity]] = []
    for quantity in chosen:
        size = quantity.size
        fitting = [
            group
            for group in groups
            if group[0].unit == quantity.unit
            and all(ALIKE * size >= member.size and ALIKE * member.size >= size for member in group)
        ]
        if fitting:
            fitting[0].append(quantity)
        else:
            groups.append([quantity])
    return groups


def _draw(axes: Axes, over: Quantity, quantities: Sequence[Quantity]) -> None:
    """Curves of quantities of one unit, with a mark at each step."""
    marks = {"marker": ".", "markersize": 4, "linewidth": 1.2}
    for quantity in quantities:
        axes.plot(over.values, quantity.values, label=quantity.name, **marks)
    single = len(quantities) == 1
    axes.set_ylabel(quantities[0].label if single else in_unit(quantities[0].unit).strip())
    axes.grid(alpha=0.25)
    if not single:
        axes.legend(fontsize="small")
