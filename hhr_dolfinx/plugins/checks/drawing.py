"""Figures of scenes and of answers, for ``scene.plot()`` and ``answer.plot()``; imported on demand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.geometries.cells import CORNERS
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.shown import point_of
from hhr_dolfinx.plugins.checks.check import check_scene
from hhr_dolfinx.plugins.checks.picture import AROUND, figure_of_scene
from hhr_dolfinx.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes


with extra("pictures", "a figure"):
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

SHIFT = 0.1
"""Limit of drawn displacements, over the extent of the mesh: smaller ones are magnified by a power of ten up to it."""


def figure_of(value: Scene | Answer, path: str | Path | None, full: FullOrderModel | None = None) -> Figure:
    """Figure of a scene, or of an answer on the mesh of a full model; saved if a path is given.

    Raises:
        SceneError: for a scene whose mesh cannot be generated.
    """
    if isinstance(value, Scene):
        figure = _of_scene(value)
    else:
        assert full is not None
        figure = _of_answer(value, full)
    if path is not None:
        figure.savefig(path, dpi=150)
    return figure


def _of_scene(scene: Scene) -> Figure:
    found = check_scene(scene)
    if found.discretisation is None:
        raise SceneError(f"scene '{scene.name}' cannot be drawn: `hhr check` says why")
    return figure_of_scene(found)


def _of_answer(answer: Answer, full: FullOrderModel) -> Figure:
    """Pressure on the contact surface, and in the plane the deformed bodies next to it."""
    flat = full.problem.points.shape[1] == 2
    figure = Figure(figsize=(11, 4.5) if flat else (7, 5.5), layout="constrained")
    figure.suptitle(f"{full.scene.name} at {point_of(answer.parameter, full.parameters.names)}")
    if flat:
        bodies, surface = figure.subplots(1, 2, width_ratios=(1.3, 1))
        _draw_bodies(figure, bodies, answer, full)
        _draw_pressures(surface, answer, full)
    else:
        _draw_surface(figure, figure.add_subplot(projection="3d"), answer, full)
    return figure


def _axes_of(full: FullOrderModel) -> tuple[str, str]:
    return ("r", "z") if full.scene.hypothesis == "axisymmetric" else ("x", "y")


def _unit(full: FullOrderModel, of: str) -> str:
    units = full.scene.units
    return "" if units is None else f" [{getattr(units, of)}]"


def _pressures(answer: Answer, full: FullOrderModel, pair: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and pressures of the conditions of a contact pair that have an area, (k, dim) and (k,)."""
    own = full.problem.pressing_of(pair)
    pressures = answer.pressure(full)[own]
    known = np.isfinite(pressures)
    return full.problem.contact_points[own][known], pressures[known]


def _draw_pressures(axes: Axes, answer: Answer, full: FullOrderModel) -> None:
    """Curves of the pressure over the coordinate along which each contact extends most."""
    labels = set()
    for pair in range(len(full.scene.contacts)):
        places, pressures = _pressures(answer, full, pair)
        along = int(np.ptp(places, axis=0).argmax())
        order = np.argsort(places[:, along], kind="stable")
        axes.plot(places[order, along], pressures[order], ".-", label=f"contact {pair}")
        labels.add(_axes_of(full)[along])
    axes.set(
        xlabel=f"{' or '.join(sorted(labels))}{_unit(full, 'length')}",
        ylabel=f"contact pressure{_unit(full, 'stress')}",
    )
    axes.grid(alpha=0.25)
    axes.legend()


def _draw_bodies(figure: Figure, axes: Axes, answer: Answer, full: FullOrderModel) -> None:
    """Cells at their displaced positions, magnified if displacements are small, coloured by their magnitude."""
    discretisation = full.discretisation
    displacement = answer.displacement().reshape(-1, 2)
    points = discretisation._points()
    factor = _magnified(
        float(np.linalg.norm(displacement, axis=1).max(initial=0.0)), float(np.ptp(points, axis=0).max())
    )
    cells = discretisation._cell_nodes()[:, : CORNERS[discretisation.mesh.topology.cell_name()]]
    corners = (points + factor * displacement)[cells][:, AROUND[cells.shape[1]]]
    drawn = PolyCollection(corners, array=np.linalg.norm(displacement, axis=1)[cells].mean(axis=1), edgecolor="face")
    axes.add_collection(drawn)
    figure.colorbar(drawn, ax=axes, label=f"displacement{_unit(full, 'length')}")
    first, second = _axes_of(full)
    axes.set(
        xlabel=f"{first}{_unit(full, 'length')}",
        ylabel=f"{second}{_unit(full, 'length')}",
        aspect="equal",
        title="" if factor == 1 else f"displacements {factor:g} times as large",
    )
    axes.autoscale_view()


def _magnified(largest: float, extent: float) -> float:
    """Factor of the drawn displacements: a power of ten, at least one."""
    return max(1.0, 10.0 ** np.floor(np.log10(SHIFT * extent / largest))) if largest > 0 else 1.0


def _draw_surface(figure: Figure, axes: Axes, answer: Answer, full: FullOrderModel) -> None:
    """Points of all contact surfaces, coloured by their pressure."""
    found = [_pressures(answer, full, pair) for pair in range(len(full.scene.contacts))]
    places, pressures = (np.concatenate(part) for part in zip(*found, strict=True))
    drawn = axes.scatter(*places.T, c=pressures, s=12)
    figure.colorbar(drawn, ax=axes, label=f"contact pressure{_unit(full, 'stress')}", shrink=0.7)
    names = {f"{axis}label": f"{axis}{_unit(full, 'length')}" for axis in "xyz"}
    axes.set(**names, box_aspect=np.maximum(np.ptp(places, axis=0), 0.1 * np.ptp(places, axis=0).max()))
