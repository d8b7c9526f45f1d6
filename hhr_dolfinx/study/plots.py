"""Pictures of a study, and fields for ParaView. Imported only where a picture is made."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

# files only: without a display VTK would first look for an X server and complain
if sys.platform == "linux" and "DISPLAY" not in os.environ:
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")

import numpy as np
from dolfinx.plot import vtk_mesh

from hhr_dolfinx.compat import extra
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.models.answer import Answer, History
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.study.view import View

with extra("pictures", "pictures and fields for ParaView"):
    import matplotlib

    matplotlib.use("Agg")

    import pyvista
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed_flow_model import CondensedFlowModel
    from hhr_dolfinx.study.study import Study

Curves = dict[str, tuple[Any, Any]]
"""Positions and values of curves by name."""

SAME_TIME = 1.6
"""Ratio of times below which names beside each other would lie on each other."""
ROUND_OFF = 1e-10
"""Errors below need no place on an axis of errors."""


def draw_study(study: Study, view: View, folder: Path) -> None:
    """Pictures of a study.

    Error against run time; contact pressures; RID, displacement and stress, and plastic strain where bodies flow, also
    for ParaView: at the points of the view, fields at the last of them, or at the last step of the last test history.
    Besides, errors over the parameter where there is only one, or over time what a history did.
    """
    full, model = study.training.full_order, study.model
    plot_work_precision(study.report["work_precision"], folder / "work_precision.png")
    if study.measured.drawn:
        exact, found = study.measured.drawn
        method = study.measured.own.method
        _draw_answers(full, model, {"": (exact.answers[-1], found.answers[-1])}, view, folder, method)
        _draw_over_time({"full order": exact, method: found}, folder)
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


def _draw_answers(
    full: FullOrderModel,
    model: ReducedModel | CondensedFlowModel,
    pairs: dict[str, tuple[Answer, Answer]],
    view: View,
    folder: Path,
    method: str = "HHR",
) -> None:
    """Contact pressures of exact and reduced answers by label, and fields of the last of them."""
    problem = full.problem
    lines, marks, closed_forms = {}, {}, {}
    for label, (exact, found) in pairs.items():
        where, _ = lines[f"full order{label}"] = pressures(problem, view, exact.forces())
        marks[f"{method}{label}"] = pressures(problem, view, found.forces())
        if view.closed_form is not None:
            load = exact.forces()[problem.contact_pairs == view.pair].sum()
            closed_forms[f"closed form{label}"] = where, view.closed_form(where, load)
    labels = view.label, f"contact pressure [{view.stress}]"
    plot_curves(lines | closed_forms, folder / "pressures.png", labels, marks=marks)
    answers = dict(zip(("full order", method), list(pairs.values())[-1], strict=True))
    fields = {name: answer.displacement() for name, answer in answers.items()}
    cells: dict[str, dict[str, np.ndarray]] = {}
    if model.flow is None:
        cells[f"von Mises [{view.stress}]"] = {name: von_mises(answer.stress()) for name, answer in answers.items()}
    else:
        mean = lambda values: values.reshape(len(problem.cell_nodes), -1).mean(axis=1)  # noqa: E731
        cells["plastic strain"] = {name: mean(answer.plastic_strain()) for name, answer in answers.items()}
        stress = f"first normal stress [{view.stress}]"
        cells[stress] = {name: mean(answer.stress()[:, 0]) for name, answer in answers.items()}
    draw_fields(field_grid(full, _cells(model), fields), view, fields, cells, folder)


def _cells(model: ReducedModel | CondensedFlowModel) -> np.ndarray:
    """Cells where a model integrates: those of its RID, or of the points where it evaluates its laws."""
    if isinstance(model, ReducedModel):
        return model.offline.sets.cells
    return np.unique(model.flow.points // model.flow.per_cell)


def _draw_over_time(histories: dict[str, History], folder: Path) -> None:
    """Contact force, largest plastic strain and iterations of each step of a full and a reduced history, by method."""
    quantities = {
        "contact force": lambda history: [answer.forces().sum() for answer in history.answers],
        "largest plastic strain": lambda history: [answer.gauss.state.cumulated.max() for answer in history.answers],
        "iterations of a step": lambda history: history.iterations,
    }
    times = [answer.time for answer in next(iter(histories.values())).answers]
    for name, quantity in quantities.items():
        lines = {label: (times, quantity(history)) for label, history in histories.items()}
        plot_curves(lines, folder / f"{name.replace(' ', '_')}.png", ("time [s]", name))


def pressures(problem: ContactProblem, view: View, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and pressures of the contact conditions of a view: nodal forces over tributary areas."""
    pair = problem.contact_pairs == view.pair
    return view.position(problem.contact_points[pair]), forces[pair] / problem.contact_areas[pair]


def draw_fields(
    grid: pyvista.UnstructuredGrid,
    view: View,
    fields: dict[str, np.ndarray],
    cells: dict[str, dict[str, np.ndarray]],
    folder: Path,
) -> None:
    """Write ``fields.vtu`` and a picture of the RID and of scalar fields of several models.

    On a grid of :func:`field_grid`: displacements by model, (N,), and values of cells by quantity and model.
    """
    # the RID is drawn on the deformed mesh of the last model, every field on that of its own
    shown = {"rid": list(fields)[-1]}
    if view.component is not None:
        component, label = view.component
        for model in fields:
            grid.point_data[f"{label}, {model}"] = grid.point_data[model][:, component]
            shown[f"{label}, {model}"] = model
    for quantity, models in cells.items():
        for model, values in models.items():
            grid.cell_data[f"{quantity}, {model}"] = values
            shown[f"{quantity}, {model}"] = model
    grid.save(folder / "fields.vtu")
    grids = [grid.warp_by_vector(model) if view.deformed else grid for model in shown.values()]
    plot_fields(grids, list(shown), folder / "fields.png")


def field_grid(full: FullOrderModel, rid_cells: np.ndarray, fields: dict[str, np.ndarray]) -> pyvista.UnstructuredGrid:
    """Mesh with displacement fields by name, (N,) each, and the RID as the cell field ``rid``."""
    # points are the nodes of the space, in the order of its dofs
    grid = pyvista.UnstructuredGrid(*vtk_mesh(full.discretisation.space))
    for name, field in fields.items():
        vectors = field.reshape(grid.n_points, -1)
        grid.point_data[name] = np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
    grid.cell_data["rid"] = np.isin(np.arange(grid.n_cells), rid_cells).astype(np.uint8)
    return grid


def plot_fields(grids: list[pyvista.UnstructuredGrid], names: list[str], path: Path) -> None:
    """Scalar fields of points or cells in rows of three, each on its mesh; the RID in two colours."""
    flat = np.ptp(grids[0].points[:, 2]) == 0
    columns = min(len(names), 3)
    rows = -(-len(names) // columns)
    plotter = pyvista.Plotter(
        off_screen=True, shape=(rows, columns), window_size=(620 * columns, _height(grids[0]) * rows), border=False
    )
    bar = {"vertical": False, "label_font_size": 15, "n_labels": 4, "color": "k", "position_y": 0.02, "fmt": "%.3g",
           "width": 0.6, "position_x": 0.2}  # fmt: skip
    for k, (grid, name) in enumerate(zip(grids, names, strict=True)):
        plotter.subplot(*divmod(k, columns))
        drawn, title = grid.copy(), name
        if name == "rid":
            plotter.add_mesh(drawn, scalars=name, cmap=["#d9d9d9", "#c0392b"], show_scalar_bar=False, lighting=not flat)
            title = f"RID: {int(grid.cell_data[name].sum())} of {grid.n_cells} cells"
        else:
            plotter.add_mesh(
                drawn, scalars=name, cmap="viridis", scalar_bar_args={"title": name, **bar}, lighting=not flat
            )
            # the name stands above the picture, where it lies on nothing
            plotter.scalar_bars[name].SetTitle("")
        plotter.add_text(title, position="upper_edge", font_size=10, color="k")
        if flat:
            plotter.view_xy()
            plotter.camera.tight(padding=0.35, adjust_render_window=False)
        else:
            # from the side of the planes of symmetry, where the inside of a quarter model shows
            plotter.view_vector((-1.0, -1.4, 0.6))
    plotter.screenshot(path)
    plotter.close()


def _height(grid: pyvista.UnstructuredGrid) -> int:
    """Pixels that a flat mesh needs beside 620 across, with room for its name and a bar; of others a square."""
    width, height, depth = np.ptp(grid.points, axis=0)
    return 620 if depth else int(np.clip(620 * height / max(width, 1e-300) + 170, 300, 800))


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
    """Curves by name, joined in the order of positions, and marks in the colours of the curves at the same places."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    for k, (name, (where, values)) in enumerate(lines.items()):
        order = np.argsort(where)
        # zero has no logarithm
        drawn = np.maximum(values, 1e-17) if logarithmic else np.asarray(values)
        axes.plot(np.asarray(where)[order], drawn[order], "-" if marks else ".-", color=f"C{k}", label=name)
    for k, (name, (where, values)) in enumerate((marks or {}).items()):
        axes.plot(where, values, "o", markersize=4, color=f"C{k}", label=name)
    axes.set(xlabel=labels[0], ylabel=labels[1], yscale="log" if logarithmic else "linear")
    axes.legend()
    _save(figure, path)


def plot_work_precision(rows: list[dict[str, Any]], path: Path) -> None:
    """Error against run time of every method, with the Pareto front; those exact to round-off stand as lines."""
    measured = [row for row in rows if "online_s" in row]
    shown = {"primal_l2": "displacement, median", "dual_full_floored": "forces on the whole surface, median",
             "dual_full_floored_max": "forces on the whole surface, worst"}  # fmt: skip
    figure = Figure(figsize=(15, 4.8), layout="constrained")
    for axis, (error, label) in zip(figure.subplots(1, 3), shown.items(), strict=True):
        axis.set(xscale="log", yscale="log", xlabel="time per query [us]", ylabel=f"error: {label}")
        axis.margins(0.15)
        _draw_exact(axis, [row for row in measured if row[error] < ROUND_OFF])
        points = [(row["online_s"] * 1e6, row[error], row) for row in measured if row[error] >= ROUND_OFF]
        for method in dict.fromkeys(row["method"] for _, _, row in points):
            own = [(x, y) for x, y, row in points if row["method"] == method]
            axis.plot(*zip(*own, strict=True), "o", label=method)
        front = _front([point for point in points if math.isfinite(point[1])])
        if len(front) > 1:
            axis.plot([x for x, _, _ in front], [y for _, y, _ in front], "-", color="black", linewidth=0.8, zorder=0)
        for k, (x, y, row) in enumerate(front):
            # what is on the front is told apart; all of them are in the table
            place = {"xytext": (6, 8 if k % 2 else -14), "textcoords": "offset points"}
            axis.annotate(row["setting"], (x, y), fontsize=8, **place)
        if points:
            axis.legend(fontsize=8)
        else:
            axis.set_yticks([])
            axis.text(0.5, 0.08, "all are exact to round-off", ha="center", transform=axis.transAxes)
    _save(figure, path)


def _draw_exact(axis: Any, rows: list[dict[str, Any]]) -> None:
    """Lines at the times of methods that are exact to round-off; names of those that are close share a place above."""
    groups: list[list[dict[str, Any]]] = []
    for row in sorted(rows, key=lambda row: row["online_s"]):
        if groups and row["online_s"] < SAME_TIME * groups[-1][0]["online_s"]:
            groups[-1].append(row)
        else:
            groups.append([row])
        axis.axvline(row["online_s"] * 1e6, linestyle="--", color="grey", linewidth=0.8)
    for group in groups:
        place = {"rotation": 30, "va": "bottom", "ha": "left", "transform": axis.get_xaxis_transform()}
        names = ", ".join(dict.fromkeys(row["method"] for row in group))
        axis.text(group[0]["online_s"] * 1e6, 1.01, names, fontsize=8, color="grey", **place)


def _front(points: list[tuple[float, float, Any]]) -> list[tuple[float, float, Any]]:
    """Points that no other one beats in time and error."""
    found: list[tuple[float, float, Any]] = []
    for point in sorted(points, key=lambda point: point[:2]):
        if not found or point[1] < found[-1][1]:
            found.append(point)
    return found


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=150)
