"""Pictures of a study, and fields for ParaView; imported on demand.

Fields of several models with their difference, undeformed bodies, and error against run time of all methods.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from dolfinx.plot import vtk_mesh

from hhr_dolfinx import registry
from hhr_dolfinx.compat import extra
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.plugins.studies.measure import Report
from hhr_dolfinx.plugins.studies.of_laws import studied_laws
from hhr_dolfinx.study.view import View

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.models.model import KeptModel


with extra("pictures", "pictures and fields for ParaView"):
    import pyvista

SHARE = 99.0
"""Percentiles of the values that bound the colours: else an infinite stress at a corner would take them all."""
BEYOND = 1.3
"""Largest value, over the end of the colours, above which the title states it."""


class _Panel(NamedTuple):
    """One picture: a grid with a scalar field, its title, its colours and their ends."""

    grid: pyvista.UnstructuredGrid
    name: str
    title: str
    colours: str
    ends: tuple[float, float]


def draw_fields(
    grid: pyvista.UnstructuredGrid,
    view: View,
    fields: dict[str, np.ndarray],
    cells: dict[str, dict[str, np.ndarray]],
    folder: Path,
) -> None:
    """Write ``fields.vtu`` and a picture of the RID and of scalar fields of two models, with their difference.

    The grid has displacements by model and the RID; ``cells`` has values of cells by quantity and model.
    """
    quantities = dict(cells)
    points: dict[str, dict[str, np.ndarray]] = {}
    if view.component is not None:
        component, label = view.component
        points[label] = {model: grid.point_data[model][:, component] for model in fields}
    for data, found in ((grid.point_data, points), (grid.cell_data, quantities)):
        for quantity, models in found.items():
            for model, values in models.items():
                data[f"{quantity}, {model}"] = values
            first, *_, last = models
            data[_difference(quantity)] = models[last] - models[first]
    grid.save(folder / "fields.vtu")
    warped = {model: grid.warp_by_vector(model) if view.deformed else grid for model in fields}
    rows = [list(_row(quantity, models, warped)) for quantity, models in (points | quantities).items()]
    # the RID is drawn on the deformed mesh of the last model, every field on that of its model
    _plot(grid, list(warped.values())[-1], rows, folder / "fields.png")


def _difference(quantity: str) -> str:
    return f"{quantity}, difference"


def _row(quantity: str, models: dict[str, np.ndarray], warped: dict[str, pyvista.UnstructuredGrid]) -> Iterator[_Panel]:
    """Pictures of a quantity: one of each model in the same colours, and their difference."""
    every = np.concatenate([np.ravel(values) for values in models.values()])
    low, high = np.percentile(every, [100 - SHARE, SHARE])
    for model, values in models.items():
        largest = float(np.max(values))
        peak = f", up to {largest:.3g}" if largest > BEYOND * high else ""
        yield _Panel(warped[model], f"{quantity}, {model}", f"{quantity}, {model}{peak}", "viridis", (low, high))
    first, *_, last = models
    size = float(np.percentile(np.abs(models[last] - models[first]), SHARE)) or 1.0
    title = f"{last} less {first}"
    yield _Panel(warped[last], _difference(quantity), title, "coolwarm", (-size, size))


def _plot(
    still: pyvista.UnstructuredGrid, deformed: pyvista.UnstructuredGrid, rows: list[list[_Panel]], path: Path
) -> None:
    """The RID in two colours, and next to it a row for each quantity, all with the outline of undeformed bodies."""
    flat = np.ptp(still.points[:, 2]) == 0
    columns = 1 + max(len(row) for row in rows)
    plotter = pyvista.Plotter(
        off_screen=True,
        shape=(len(rows), columns),
        window_size=(560 * columns, _height(still) * len(rows)),
        border=False,
    )
    outline = _outline(still, flat)
    count = int(still.cell_data["rid"].sum())
    plotter.subplot(0, 0)
    plotter.add_mesh(
        deformed.copy(), scalars="rid", cmap=["#d9d9d9", "#c0392b"], show_scalar_bar=False, lighting=not flat
    )
    _finish(plotter, f"RID: {count} of {still.n_cells} cells", outline, flat)
    for place, row in enumerate(rows):
        for number, panel in enumerate(row, start=1):
            plotter.subplot(place, number)
            _draw_panel(plotter, panel, flat)
            _finish(plotter, panel.title, outline, flat)
    plotter.screenshot(path)
    plotter.close()


def _draw_panel(plotter: pyvista.Plotter, panel: _Panel, flat: bool) -> None:
    bar = {
        "title": panel.name,
        "vertical": False,
        "label_font_size": 15,
        "n_labels": 3,
        "color": "k",
        "position_y": 0.02,
        "fmt": "%.3g",
        "width": 0.6,
        "position_x": 0.2,
    }
    plotter.add_mesh(
        panel.grid.copy(),
        scalars=panel.name,
        cmap=panel.colours,
        clim=panel.ends,
        scalar_bar_args=bar,
        lighting=not flat,
    )
    # the name stands above the picture, where it covers nothing
    plotter.scalar_bars[panel.name].SetTitle("")


def _outline(still: pyvista.UnstructuredGrid, flat: bool) -> pyvista.PolyData:
    return still.extract_feature_edges(
        feature_angle=40, boundary_edges=True, feature_edges=not flat, manifold_edges=False, non_manifold_edges=False
    )


def _finish(plotter: pyvista.Plotter, title: str, outline: pyvista.PolyData, flat: bool) -> None:
    if outline.n_cells:
        plotter.add_mesh(outline.copy(), color="k", line_width=1, opacity=0.6)
    plotter.add_text(title, position="upper_edge", font_size=9, color="k")
    if flat:
        plotter.view_xy()
        plotter.camera.tight(padding=0.35, adjust_render_window=False)
    else:
        # from the side of the planes of symmetry, which shows the inside of a quarter model
        plotter.view_vector((-1.0, -1.4, 0.6))


def _height(grid: pyvista.UnstructuredGrid) -> int:
    """Pixels of the height of a flat mesh 560 wide, with space for its name and a bar; a square for others."""
    width, height, depth = np.ptp(grid.points, axis=0)
    return 560 if depth else int(np.clip(560 * height / max(width, 1e-300) + 170, 300, 800))


with extra("pictures", "pictures of a study"):
    from matplotlib.figure import Figure

ROUND_OFF = 1e-10
"""Error below which a method counts as exact: it stands on a line below all others."""
SHOWN = {"primal_l2": "displacement", "dual_full_floored": "contact forces on the whole surface"}
"""Keys of errors that are drawn, and their names."""


class _Point(NamedTuple):
    """A method: seconds of a query, median, 95 % and largest error, and its name."""

    seconds: float
    median: float
    p95: float
    worst: float
    method: str
    setting: str

    @property
    def exact(self) -> bool:
        """True if it is exact to round-off."""
        return self.median < ROUND_OFF


def plot_work_precision(rows: list[Report], path: Path) -> None:
    """Error against run time of every method by name and setting: median, 95 % and largest, with the Pareto front.

    Methods exact to round-off stand on a line at the bottom.
    """
    figure = Figure(figsize=(13, 5.2), layout="constrained")
    for axis, (error, label) in zip(figure.subplots(1, 2), SHOWN.items(), strict=True):
        axis.set(xscale="log", yscale="log", xlabel="time per query [us]", ylabel=f"relative error, {label}")
        axis.margins(x=0.2, y=0.12)
        axis.grid(alpha=0.25)
        points = [_point(row, error) for row in rows if "online_s" in row]
        measured = [point for point in points if not point.exact and math.isfinite(point.median)]
        floor = min((point.median for point in measured), default=1e-6) / 30
        _draw(axis, points, floor)
        front = _front([(point.seconds * 1e6, point.median) for point in measured])
        if len(front) > 1:
            axis.plot(*zip(*front, strict=True), "-", color="black", linewidth=0.8, zorder=0)
        if any(point.exact for point in points):
            axis.axhline(floor, color="grey", linestyle="--", linewidth=0.8, zorder=0)
    figure.suptitle(
        "points: median of the test points; bars: up to 95 % and the worst seen (ticks); "
        "on the dashed line: exact to round-off",
        fontsize=9,
    )
    figure.savefig(path, dpi=150)


def _point(row: Report, error: str) -> _Point:
    """A row of a report in the form of the chart; if only the median is known, bars have no length."""
    median = float(row[error])
    p95, worst = (float(row.get(f"{error}_{part}", median)) for part in ("p95", "max"))
    return _Point(row["online_s"], median, p95, worst, str(row["method"]), str(row.get("setting", "")))


def _draw(axis: Axes, points: list[_Point], floor: float) -> None:
    colours = {method: f"C{k % 10}" for k, method in enumerate(dict.fromkeys(point.method for point in points))}
    for k, point in enumerate(sorted(points, key=lambda point: point.seconds)):
        x = point.seconds * 1e6
        y = max(point.median, floor)
        colour = colours[point.method]
        if point.exact:
            y = floor
        if not math.isfinite(y):
            continue
        ends = [value for value in (point.p95, point.worst) if math.isfinite(value) and value > y]
        if ends:
            axis.plot([x, x], [y, max(ends)], "-", color=colour, linewidth=1)
            axis.plot([x] * len(ends), ends, "_", color=colour, markersize=9)
        axis.plot([x], [y], "o", color=colour)
        name = point.method if point.exact or not point.setting else f"{point.method}: {point.setting}"
        place = {"xytext": (7, 7 if k % 2 else -13), "textcoords": "offset points"}
        axis.annotate(name, (x, y), fontsize=8, color=colour, **place)


def _front(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Points that no other one beats in time and error."""
    found: list[tuple[float, float]] = []
    for point in sorted(points):
        if not found or point[1] < found[-1][1]:
            found.append(point)
    return found


# files only: without a display VTK would first look for an X server and print an error
if sys.platform == "linux" and "DISPLAY" not in os.environ:
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")


with extra("pictures", "pictures and fields for ParaView"):
    import matplotlib

    matplotlib.use("Agg")

    import pyvista
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure


Curves = dict[str, tuple[Any, Any]]
"""Positions and values of curves by name."""


def draw_study(study: Any, view: View, folder: Path) -> None:
    """Draw the pictures of a study.

    They show error against run time, contact pressures at the points of the view, and fields at the last of them or at
    the last step of the last test history: RID, displacement, stress and fields of laws, also for ParaView. Others show
    errors over the parameter if there is only one, or a history over time.
    """
    full = study.training.full_order
    model = study.model
    _draw_scene(full, folder)
    plot_work_precision(study.report["work_precision"], folder / "work_precision.png")
    if study.measured.drawn:
        exact, found = study.measured.drawn
        method = study.measured.own.method
        _draw_answers(full, model, {"": (exact.answers[-1], found.answers[-1])}, view, folder, method)
        laws = studied_laws(full)
        if laws is not None:
            laws.draw({"full order": exact, method: found}, full.problem.contact_pairs, folder)
        return
    names = full.parameters.names
    if len(names) == 1 and isinstance(study.tests, np.ndarray):
        values = study.measured.own.errors.values
        shown = ("primal_euclid", "primal_energy", "dual_rid", "energy_minimum")
        where = np.ravel(np.asarray(study.tests))
        curves: Curves = {name: (where, values[name]) for name in shown}
        plot_curves(curves, folder / "errors.png", (names[0], "error"), logarithmic=True)
    labels = ("".join(f", {name} = {x:g}" for name, x in zip(names, mu, strict=True)) for mu in view.points)
    pairs = {label: (full.solve(mu), model.solve(mu)) for label, mu in zip(labels, view.points, strict=True)}
    if pairs:
        _draw_answers(full, model, pairs, view, folder)


def _draw_scene(full: FullOrderModel, folder: Path) -> None:
    """The scene, if a plug-in draws it."""
    if "drawing" in registry.named("tools"):
        full.scene.plot(folder / "scene.png")


def _draw_answers(
    full: FullOrderModel,
    model: KeptModel,
    pairs: dict[str, tuple[Answer, Answer]],
    view: View,
    folder: Path,
    method: str = "HHR",
) -> None:
    problem = full.problem
    units = full.scene.units
    view = view.of(units)
    panels = [
        _pressures_of(full, pair, pairs, view, method)
        for pair in np.unique(problem.contact_pairs)
        if view.pair in (None, pair)
    ]
    plot_panels(panels, folder / "pressures.png")
    answers = dict(zip(("full order", method), list(pairs.values())[-1], strict=True))
    fields = {name: answer.displacement() for name, answer in answers.items()}
    cells: dict[str, dict[str, np.ndarray]] = {}
    laws = studied_laws(full)
    if laws is None:
        cells[f"von Mises [{view.stress}]"] = {name: von_mises(answer.stress()) for name, answer in answers.items()}
    else:
        cells |= laws.fields(full, answers, view)
    where = model.offline.sets.cells if laws is None else laws.cells(model)
    draw_fields(field_grid(full, where, fields), view, fields, cells, folder)


class Panel(NamedTuple):
    """One of several drawings in a row: its title, labels, lines and marks."""

    title: str
    labels: tuple[str, str]
    lines: Curves
    marks: Curves


def _pressures_of(
    full: FullOrderModel, pair: int, pairs: dict[str, tuple[Answer, Answer]], view: View, method: str
) -> Panel:
    """Pressures of one contact: lines of the full model, marks of a reduced model, a closed form if there is one."""
    own = full.problem.pressing_of(pair)
    where, label = view.along(full.problem.contact_points[own], pair, full.scene.units)
    lines = {}
    marks = {}
    closed_forms = {}
    for name, (exact, found) in pairs.items():
        problem = full.problem.at(exact.parameter)  # areas at the shape of the answer
        lines[f"full order{name}"] = where, pressures(problem, pair, exact.forces())
        marks[f"{method}{name}"] = where, pressures(problem, pair, found.forces())
        if view.closed_form is not None and pair == (view.pair or 0):
            closed_forms[f"closed form{name}"] = where, view.closed_form(where, exact.forces()[own].sum())
    tags = " and ".join(str(tag) for tag in full.scene.contacts[pair].tags)
    title = f"contact {pair}: {tags}"
    return Panel(title, (label, f"contact pressure [{view.stress}]"), lines | closed_forms, marks)


def pressures(problem: ContactProblem, pair: int, forces: np.ndarray) -> np.ndarray:
    """Pressures of the contact conditions of a pair: nodal forces over tributary areas."""
    own = problem.pressing_of(pair)
    return forces[own] / problem.contact_areas[own]


def field_grid(full: FullOrderModel, rid_cells: np.ndarray, fields: dict[str, np.ndarray]) -> pyvista.UnstructuredGrid:
    """Mesh with displacement fields by name, (N,) each, and the RID as the cell field ``rid``."""
    # points are the nodes of the space, in the order of its dofs
    grid = pyvista.UnstructuredGrid(*vtk_mesh(full.discretisation.space))
    for name, field in fields.items():
        vectors = field.reshape(grid.n_points, -1)
        grid.point_data[name] = np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
    grid.cell_data["rid"] = np.isin(np.arange(grid.n_cells), rid_cells).astype(np.uint8)
    return grid


def plot_maps(points: np.ndarray, maps: dict[str, np.ndarray], labels: tuple[str, str], path: Path) -> None:
    """Relative errors over two parameters, one map per model on one logarithmic scale, thesis figure 3.9.

    ``points`` form a regular grid, (n, 2), with errors by model, (n,) each.
    """
    figure = Figure(figsize=(4.6 * len(maps), 4), layout="constrained")
    axes = figure.subplots(1, len(maps), squeeze=False)
    first, second = (np.unique(points[:, k]) for k in (0, 1))
    norm = LogNorm(1e-4, 1.0)
    for axis, (name, errors) in zip(axes[0], maps.items(), strict=True):
        table = np.clip(np.nan_to_num(errors, nan=1.0, posinf=1.0), 1e-4, 1.0).reshape(first.size, second.size)
        image = axis.pcolormesh(first, second, table.T, norm=norm, cmap="magma_r", shading="nearest")
        axis.set(title=name, xlabel=labels[0], ylabel=labels[1])
    figure.colorbar(image, ax=axes, label="relative error of the contact forces")
    _save(figure, path)


def plot_curves(
    lines: Curves, path: Path, labels: tuple[str, str], *, marks: Curves | None = None, logarithmic: bool = False
) -> None:
    """Curves by name, joined in the order of positions, and marks in their colours at the same positions."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    _curves(axes, lines, marks or {}, logarithmic)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    axes.legend()
    _save(figure, path)


def plot_panels(panels: Sequence[Panel], path: Path) -> None:
    """Drawings, three in a row, with one legend for all of them."""
    columns = min(len(panels), 3)
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(1.5 + 5.5 * columns, 4.2 * rows + 0.6), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, panel in zip(axes, panels, strict=False):
        _curves(axis, panel.lines, panel.marks, False)
        axis.set(title=panel.title, xlabel=panel.labels[0], ylabel=panel.labels[1])
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
    _save(figure, path)


def _curves(axes: Axes, lines: Curves, marks: Curves, logarithmic: bool) -> None:
    for k, (name, (where, values)) in enumerate(lines.items()):
        order = np.argsort(where)
        # zero has no logarithm
        drawn = np.maximum(values, 1e-17) if logarithmic else np.asarray(values)
        axes.plot(np.asarray(where)[order], drawn[order], "-" if marks else ".-", color=f"C{k}", label=name)
    for k, (name, (where, values)) in enumerate(marks.items()):
        axes.plot(where, values, "o", markersize=4, color=f"C{k}", label=name)
    axes.set_yscale("log" if logarithmic else "linear")


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=150)
