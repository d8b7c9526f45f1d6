"""Figures of scenes and answers; those of answers need no DOLFINx. Imported on demand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.answer import Answer, Meshed
from hhr_dolfinx.models.functionals.kinds import UNDER_LOAD
from hhr_dolfinx.plugins.plots.facets import outer_facets
from hhr_dolfinx.plugins.plots.picture import (
    BAR,
    COLOURS,
    Picture,
    colour_limits,
    in_unit,
    wrapped,
)

with extra("pictures", "pictures of scenes and answers"):
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure
    from matplotlib.tri import Triangulation

if TYPE_CHECKING:
    from hhr_dolfinx.scene import Scene

FIGURE_RESOLUTION = 200
"""Dots per inch of saved figures."""
TRIANGLES_OF_CELLS = {
    (3, 3): ((0, 1, 2),),
    (3, 6): ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
    (4, 4): ((0, 1, 2), (0, 2, 3)),
    (4, 9): (
        (0, 4, 8), (0, 8, 7), (4, 1, 5), (4, 5, 8), (8, 5, 2), (8, 2, 6), (7, 8, 6), (7, 6, 3),
    ),
}  # fmt: skip
"""Triangles of plane cells by their numbers of corners and of nodes, in the order of VTK."""
ROUND_TOLERANCE = 0.01
"""Distance from a circle, over its radius, up to which a surface counts as round."""
WIDE_ANGLE = 200.0
"""Angle in degrees from which pressures of a round surface are drawn over the angle."""
NARROW_SHARE = 0.2
"""Part of the surfaces below which the axis of pressures shows the pressed part alone."""
BODY_HEIGHT = 3.9
BAR_WIDTH = 1.5
CURVE_WIDTH = 4.9
"""Height of bodies, width of their bar of colours with its labels, and width of curves, in
inches.
"""
FLAT_RATIO = 2.2
"""Width over height of bodies from which pressures are drawn below them."""


def figure_of(
    value: Scene | Answer,
    path: str | Path | None,
    full: Meshed | None = None,
    scale: float | None = None,
) -> Figure:
    """Figure of a scene, or of an answer on the mesh of a full model or a file.

    Args:
        value: the scene or answer.
        path: file to save the figure to; None does not save it.
        full: the full model, or the mesh beside a model file, for an answer.
        scale: factor of the displacements of an answer; None chooses a power of ten.

    Raises:
        SceneError: for a scene whose mesh cannot be generated.
    """
    if isinstance(value, Answer):
        assert full is not None
        figure = _figure_of_answer(Picture.of(value, full, scale))
    else:
        from hhr_dolfinx.plugins.scene_checks.check import check_scene
        from hhr_dolfinx.plugins.scene_checks.drawing import figure_of_scene

        checked = check_scene(value)
        if checked.discretisation is None:
            raise SceneError(f"scene '{value.name}' cannot be drawn: `hhr check` says why")
        figure = figure_of_scene(checked)
    if path is not None:
        figure.savefig(path, dpi=FIGURE_RESOLUTION)
    return figure


def _figure_of_answer(picture: Picture) -> Figure:
    """Deformed bodies with their stress, and the pressure on the contact surfaces."""
    mesh = picture.mesh
    title = picture.title
    if mesh.points.shape[1] == 3:
        from hhr_dolfinx.plugins.plots.figures_in_space import figure_in_space

        return figure_in_space(picture, title)
    width, height = np.ptp(picture.deformed.points, axis=0)
    flat = width > FLAT_RATIO * height
    # a column as wide as its bodies are drawn, with their bar
    column = float(np.clip(BODY_HEIGHT * width / height + BAR_WIDTH, 3.6, 6.1))
    size = (8, 4.6 + 7 * height / width) if flat else (column + CURVE_WIDTH, 4.8)
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(wrapped(title, size[0]))
    shape = (2, 1) if flat else (1, 2)
    bodies, surface = figure.subplots(
        *shape, width_ratios=None if flat else (column / CURVE_WIDTH, 1)
    )
    _draw_bodies(figure, bodies, picture, "bottom" if flat else "right")
    _draw_pressures(surface, picture)
    return figure


def _draw_bodies(figure: Figure, axes: Axes, picture: Picture, bar: str) -> None:
    """Bodies at their displaced positions with continuous stress in each, and their outlines."""
    mesh = picture.mesh
    points = picture.deformed.points
    corners = 3 if mesh.kind in (5, 69) else 4
    shape = corners, mesh.cells.shape[1]
    shape = shape if shape in TRIANGLES_OF_CELLS else (corners, corners)
    positions = []
    triangles = []
    values = []
    outlines = []
    first = 0
    for body in range(picture.bodies):
        cells = mesh.cells[mesh.bodies == body]
        nodes, index = np.unique(cells, return_inverse=True)
        local = index.reshape(cells.shape)
        cell_triangles = [local[:, list(triple)] for triple in TRIANGLES_OF_CELLS[shape]]
        triangles.append(first + np.concatenate(cell_triangles))
        positions.append(points[nodes])
        values.append(picture.values[body][nodes])
        outlines.append(points[outer_facets(mesh, body)])
        first += len(nodes)
    all_values = np.concatenate(values)
    low, high, extend = colour_limits(all_values)
    mapped = Triangulation(*np.concatenate(positions).T, triangles=np.concatenate(triangles))
    look = {"shading": "gouraud", "cmap": COLOURS, "rasterized": True}
    drawn = axes.tripcolor(mapped, all_values, vmin=low, vmax=high, **look)
    axes.add_collection(LineCollection(np.concatenate(outlines), colors="#333333", linewidths=0.7))
    label = (
        picture.label if extend == "neither" else f"{picture.label}, up to {all_values.max():.3g}"
    )
    figure.colorbar(drawn, ax=axes, label=label, extend=extend, location=bar, aspect=BAR)
    names = picture.axis_names
    unit = in_unit(mesh.length)
    axes.set(xlabel=f"{names[0]}{unit}", ylabel=f"{names[1]}{unit}", aspect="equal")
    axes.set_title(picture.scale_words, fontsize="medium")
    axes.autoscale_view()


def _draw_pressures(axes: Axes, picture: Picture) -> None:
    """Curves of the pressure of each contact along its surface, from zero on."""
    labels = []
    lowest = 0.0
    highest = 0.0
    span = [np.zeros(0)]
    pressed = [np.zeros(0)]
    for name, conditions in zip(picture.contact_names, picture.with_area, strict=True):
        if not conditions.size:
            continue
        along, label = _along(picture, conditions)
        order = np.argsort(along, kind="stable")
        pressures = picture.pressures[conditions][order]
        axes.plot(along[order], pressures, ".-", markersize=4, label=name)
        labels.append(label)
        span.append(along)
        pressed.append(along[order][pressures > UNDER_LOAD * pressures.max()])
        lowest = min(lowest, float(pressures.min()))
        highest = max(highest, float(pressures.max()))
    axes.set(
        xlabel=" or ".join(dict.fromkeys(labels)),
        ylabel=f"contact pressure{in_unit(picture.mesh.stress)}",
        ylim=(1.08 * lowest, 1.08 * highest or 1.0),
    )
    axes.grid(alpha=0.25)
    if len(axes.lines) == 1:
        axes.set_title(str(axes.lines[0].get_label()), fontsize="medium")
    elif labels:
        axes.legend(fontsize="small")
    _zoom(axes, np.concatenate(span), np.concatenate(pressed))


def _zoom(axes: Axes, along: np.ndarray, pressed: np.ndarray) -> None:
    """Limit the axis to what is pressed if that is a small part of the surfaces."""
    width = float(np.ptp(pressed)) if pressed.size else 0.0
    if 0 < width < NARROW_SHARE * float(np.ptp(along)):
        axes.set_xlim(pressed.min() - width, pressed.max() + width)


def _along(picture: Picture, conditions: np.ndarray) -> tuple[np.ndarray, str]:
    """Positions of conditions along their surface, (c,), and the label of their axis.

    They are angles on a surface that is much of a circle, else the coordinate along which it
    extends most.
    """
    mesh = picture.mesh
    points = mesh.contact_points[conditions]
    names = picture.axis_names
    if len(points) > 4 and not mesh.axisymmetric:
        matrix = np.column_stack([2 * points, np.ones(len(points))])
        solution, *_ = np.linalg.lstsq(matrix, (points**2).sum(axis=1), rcond=None)
        centre = solution[:2]
        radii = np.linalg.norm(points - centre, axis=1)
        angles = np.degrees(np.arctan2(*(points - centre).T[::-1]))
        angles = np.where(angles < -179.999, angles + 360.0, angles)
        apart = np.diff(np.sort(angles))
        covered = float(np.ptp(angles)) if apart.max() < 180 else 360.0 - float(apart.max())
        if np.ptp(radii) < 2 * ROUND_TOLERANCE * radii.mean() and covered > WIDE_ANGLE:
            return angles, f"angle from {names[0]} [°]"
    axis = int(np.ptp(points, axis=0).argmax())
    return points[:, axis], f"{names[axis]}{in_unit(mesh.length)}"
