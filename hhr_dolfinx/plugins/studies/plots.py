"""Pictures of a study, and fields for ParaView; imported on demand.

Fields of several models with their difference, undeformed bodies, contact pressures, and errors
over one parameter.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from dolfinx.plot import vtk_mesh

from hhr_dolfinx import registry
from hhr_dolfinx.compat import extra
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.plugins.studies.of_laws import study_of
from hhr_dolfinx.plugins.studies.settings import View
from hhr_dolfinx.units import Units

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# files only: without a display VTK would first look for an X server and print an error
if sys.platform == "linux" and "DISPLAY" not in os.environ:
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")

with extra("pictures", "pictures and fields for ParaView"):
    import pyvista
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Curves = Mapping[str, tuple["ArrayLike", "ArrayLike"]]
"""Positions and values of curves by name."""
RESOLUTION = 200
"""Dots per inch of curves."""
COLOUR_PERCENTILE = 99.0
"""Percentiles of the values that bound the colours: else an infinite stress at a corner would take
them all.
"""
PEAK_IN_TITLE = 1.3
"""Largest value, over the end of the colours, above which the title states it."""
BAR = {
    "vertical": False,
    "label_font_size": 15,
    "n_labels": 3,
    "color": "k",
    "position_y": 0.02,
    "fmt": "%.3g",
    "width": 0.6,
    "position_x": 0.2,
}
"""Bar of colours below a picture."""


class _Field(NamedTuple):
    """One picture: a grid with a scalar field, its title, its colours and their ends."""

    grid: pyvista.UnstructuredGrid
    name: str
    title: str
    colours: str
    ends: tuple[float, float]


def _row(
    quantity: str, models: dict[str, np.ndarray], warped: dict[str, pyvista.UnstructuredGrid]
) -> Iterator[_Field]:
    """Pictures of a quantity: one of each model in the same colours, and their difference."""
    all_values = np.concatenate([np.ravel(values) for values in models.values()])
    low, high = np.percentile(all_values, [100 - COLOUR_PERCENTILE, COLOUR_PERCENTILE])
    for model, values in models.items():
        largest = float(np.max(values))
        peak = f", up to {largest:.3g}" if largest > PEAK_IN_TITLE * high else ""
        yield _Field(
            warped[model],
            f"{quantity}, {model}",
            f"{quantity}, {model}{peak}",
            "viridis",
            (low, high),
        )
    first, *_, last = models
    size = float(np.percentile(np.abs(models[last] - models[first]), COLOUR_PERCENTILE)) or 1.0
    title = f"{last} less {first}"
    yield _Field(warped[last], f"{quantity}, difference", title, "coolwarm", (-size, size))


def _plot(
    still: pyvista.UnstructuredGrid,
    deformed: pyvista.UnstructuredGrid,
    rows: list[list[_Field]],
    path: Path,
) -> None:
    """The RID in two colours, and next to it a row for each quantity, all with the outline of
    undeformed bodies.
    """
    width, height, depth = np.ptp(still.points, axis=0)
    flat = depth == 0
    columns = 1 + max(len(row) for row in rows)
    # a flat mesh has space for its name and a bar
    pixels = int(np.clip(560 * height / max(width, 1e-300) + 170, 300, 800)) if flat else 560
    plotter = pyvista.Plotter(
        off_screen=True,
        shape=(len(rows), columns),
        window_size=(560 * columns, pixels * len(rows)),
        border=False,
    )
    outline = still.extract_feature_edges(
        feature_angle=40,
        boundary_edges=True,
        feature_edges=not flat,
        manifold_edges=False,
        non_manifold_edges=False,
    )
    plotter.subplot(0, 0)
    plotter.add_mesh(
        deformed.copy(),
        scalars="rid",
        cmap=["#d9d9d9", "#c0392b"],
        show_scalar_bar=False,
        lighting=not flat,
    )
    _finish(
        plotter, f"RID: {int(still.cell_data['rid'].sum())} of {still.n_cells} cells", outline, flat
    )
    for index, row in enumerate(rows):
        for number, field in enumerate(row, start=1):
            plotter.subplot(index, number)
            plotter.add_mesh(
                field.grid.copy(),
                scalars=field.name,
                cmap=field.colours,
                clim=field.ends,
                scalar_bar_args=BAR | {"title": field.name},
                lighting=not flat,
            )
            # the name stands above the picture, where it covers nothing
            plotter.scalar_bars[field.name].SetTitle("")
            _finish(plotter, field.title, outline, flat)
    plotter.screenshot(path)
    plotter.close()


def _finish(plotter: pyvista.Plotter, title: str, outline: pyvista.PolyData, flat: bool) -> None:
    """Outline, title and camera of one picture."""
    if outline.n_cells:
        plotter.add_mesh(outline.copy(), color="k", line_width=1, opacity=0.6)
    plotter.add_text(title, position="upper_edge", font_size=9, color="k")
    if flat:
        plotter.view_xy()
        plotter.camera.tight(padding=0.35, adjust_render_window=False)
    else:
        # from the side of the planes of symmetry, which shows the inside of a quarter model
        plotter.view_vector((-1.0, -1.4, 0.6))


def draw_study(study: Any, view: View, folder: Path) -> None:
    """Draw the pictures of a study.

    They show contact pressures at the points of the view, and fields at the last of them or at the
    last step of the last test history: RID, displacement, stress and fields of laws, also for
    ParaView. Others show errors over the parameter if there is only one, or a history over time.

    Args:
        study: the study.
        view: points, units and components to draw.
        folder: folder of the pictures.
    """
    full = study.training.full_order
    model = study.model
    if "drawing" in registry.named("tools"):
        full.scene.plot(folder / "scene.png")
    if study.measured.drawn:
        exact, reduced = study.measured.drawn
        method = study.measured.own.method
        _draw_answers(
            full, model, {"": (exact.answers[-1], reduced.answers[-1])}, view, folder, method
        )
        laws = study_of(full.scene)
        if laws is not None:
            laws.draw({"full order": exact, method: reduced}, full.problem.contact_pairs, folder)
        return
    names = full.parameters.names
    if len(names) == 1 and isinstance(study.tests, np.ndarray):
        values = study.measured.own.errors.values
        # a condensed model has no domain whose forces are apart
        shown = [
            name
            for name in ("primal_euclid", "primal_energy", "dual_rid", "energy_minimum")
            if name in values
        ]
        where = np.ravel(np.asarray(study.tests))
        # zero has no logarithm
        curves: Curves = {name: (where, np.maximum(values[name], 1e-17)) for name in shown}
        plot_curves(curves, folder / "errors.png", (names[0], "error"), logarithmic=True)
    labels = (
        "".join(f", {name} = {x:g}" for name, x in zip(names, mu, strict=True))
        for mu in view.points
    )
    pairs = {
        label: (full.solve(mu), model.solve(mu))
        for label, mu in zip(labels, view.points, strict=True)
    }
    if pairs:
        _draw_answers(full, model, pairs, view, folder, study.measured.own.method)


def _draw_answers(
    full: FullOrderModel,
    model: KeptModel,
    pairs: dict[str, tuple[Answer, Answer]],
    view: View,
    folder: Path,
    method: str = "HHR",
) -> None:
    """Pressures of all contacts, then ``fields.vtu`` and a picture of the RID, fields, and their
    difference.
    """
    problem = full.problem
    view = in_units(view, full.scene.units)
    panels = [
        _pressures_of(full, pair, pairs, view, method)
        for pair in np.unique(problem.contact_pairs)
        if view.pair in (None, pair)
    ]
    plot_panels(panels, folder / "pressures.png")
    answers = dict(zip(("full order", method), list(pairs.values())[-1], strict=True))
    fields = {name: answer.displacement() for name, answer in answers.items()}
    cells: dict[str, dict[str, np.ndarray]] = {}
    laws = study_of(full.scene)
    if laws is None:
        cells[f"von Mises [{view.stress}]"] = {
            name: von_mises(answer.stress()) for name, answer in answers.items()
        }
    else:
        cells |= laws.fields(full, answers, view)
    where = _cells_of(model) if laws is None else laws.cells(model)
    grid = field_grid(full, where, fields)
    points: dict[str, dict[str, np.ndarray]] = {}
    if view.component is not None:
        component, label = view.component
        points[label] = {name: grid.point_data[name][:, component] for name in fields}
    for data, quantities in ((grid.point_data, points), (grid.cell_data, cells)):
        for quantity, models in quantities.items():
            for name, values in models.items():
                data[f"{quantity}, {name}"] = values
            first, *_, last = models
            data[f"{quantity}, difference"] = models[last] - models[first]
    grid.save(folder / "fields.vtu")
    warped = {name: grid.warp_by_vector(name) if view.deformed else grid for name in fields}
    rows = [list(_row(quantity, models, warped)) for quantity, models in (points | cells).items()]
    # the RID is drawn on the deformed mesh of the last model, every field on that of its model
    _plot(grid, list(warped.values())[-1], rows, folder / "fields.png")


def _cells_of(model: KeptModel) -> np.ndarray:
    """Cells of the RID, (n,); none of a condensed model, which integrates on no cell."""
    return model.offline.sets.cells if isinstance(model, ReducedModel) else np.zeros(0, int)


def in_units(view: View, units: Units | None) -> View:
    """The view with the unit of stress of a scene, if it has none.

    Args:
        view: the view.
        units: units of the scene; None without.
    """
    return (
        view
        if view.stress is not None
        else replace(view, stress="Pa" if units is None else units.stress)
    )


def along(view: View, places: np.ndarray, pair: int, units: Units | None) -> tuple[np.ndarray, str]:
    """Positions of the conditions of one contact along its surface, (m,), and their label.

    Args:
        view: view of the study.
        places: coordinates of the conditions, (m, dim).
        pair: index of the contact.
        units: units of the scene; None without.
    """
    unit = "" if units is None else f" [{units.length}]"
    meant = pair == (view.pair or 0)
    if meant and view.position is not None:
        return view.position(places), view.label or f"position along the surface{unit}"
    axis = int(np.ptp(places, axis=0).argmax())
    named = f"{'xyz'[axis]}{unit}"
    return places[:, axis], (view.label or named) if meant else named


class Panel(NamedTuple):
    """One of several drawings in a row: its title, labels, lines and marks."""

    title: str
    labels: tuple[str, str]
    lines: Curves
    marks: Curves


def _pressures_of(
    full: FullOrderModel,
    pair: int,
    pairs: dict[str, tuple[Answer, Answer]],
    view: View,
    method: str,
) -> Panel:
    """Pressures of one contact: lines of the full model, marks of a reduced model, a closed form if
    there is one.
    """
    conditions = full.problem.pressing_of(pair)
    where, label = along(view, full.problem.contact_points[conditions], pair, full.scene.units)
    lines = {}
    marks = {}
    closed_forms = {}
    for name, (exact, reduced) in pairs.items():
        lines[f"full order{name}"] = where, exact.pressure(full)[conditions]
        marks[f"{method}{name}"] = where, reduced.pressure(full)[conditions]
        if view.closed_form is not None and pair == (view.pair or 0):
            closed_forms[f"closed form{name}"] = (
                where,
                view.closed_form(where, exact.forces()[conditions].sum()),
            )
    tags = " and ".join(str(tag) for tag in full.scene.contacts[pair].tags)
    title = f"contact {pair}: {tags}"
    return Panel(title, (label, f"contact pressure [{view.stress}]"), lines | closed_forms, marks)


def field_grid(
    full: FullOrderModel, rid_cells: np.ndarray, fields: dict[str, np.ndarray]
) -> pyvista.UnstructuredGrid:
    """Mesh with displacement fields by name, and the RID as the cell field ``rid``.

    Args:
        full: the full model.
        rid_cells: cells of the RID.
        fields: displacements by name, (N,) each.
    """
    # points are the nodes of the space, in the order of its dofs
    grid = pyvista.UnstructuredGrid(*vtk_mesh(full.discretisation.space))
    for name, field in fields.items():
        vectors = field.reshape(grid.n_points, -1)
        grid.point_data[name] = np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
    grid.cell_data["rid"] = np.isin(np.arange(grid.n_cells), rid_cells).astype(np.uint8)
    return grid


def plot_curves(
    lines: Curves, path: Path, labels: tuple[str, str], *, logarithmic: bool = False
) -> None:
    """Plot curves by name, joined in the order of positions.

    Args:
        lines: positions and values by name.
        path: file of the picture.
        labels: labels of both axes.
        logarithmic: scale the second axis by logarithms.
    """
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    _draw_lines(axes, lines, ".-")
    axes.set(xlabel=labels[0], ylabel=labels[1], yscale="log" if logarithmic else "linear")
    axes.legend()
    figure.savefig(path, dpi=RESOLUTION)


def plot_panels(panels: Sequence[Panel], path: Path) -> None:
    """Plot panels, three in a row, with one legend for all of them.

    Args:
        panels: the panels.
        path: file of the picture.
    """
    columns = min(len(panels), 3)
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(1.5 + 5.5 * columns, 4.2 * rows + 0.6), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, panel in zip(axes, panels, strict=False):
        _draw_lines(axis, panel.lines, "-")
        for k, (name, (where, values)) in enumerate(panel.marks.items()):
            axis.plot(where, values, "o", markersize=4, color=f"C{k}", label=name)
        axis.set(title=panel.title, xlabel=panel.labels[0], ylabel=panel.labels[1])
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8
    )
    figure.savefig(path, dpi=RESOLUTION)


def _draw_lines(axes: Axes, lines: Curves, style: str) -> None:
    for k, (name, (where, values)) in enumerate(lines.items()):
        order = np.argsort(where)
        axes.plot(
            np.asarray(where)[order], np.asarray(values)[order], style, color=f"C{k}", label=name
        )
