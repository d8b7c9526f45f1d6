"""Pictures of a study, and fields for ParaView. Imported only where a picture is made."""

from __future__ import annotations

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
    """Scalar fields of points or cells side by side, each on its mesh."""
    flat = np.ptp(grids[0].points[:, 2]) == 0
    plotter = pyvista.Plotter(off_screen=True, shape=(1, len(names)), window_size=(420 * len(names), 700), border=False)
    bar = {"vertical": False, "title_font_size": 16, "label_font_size": 13, "n_labels": 3, "color": "k"}
    for k, (grid, name) in enumerate(zip(grids, names, strict=True)):
        plotter.subplot(0, k)
        plotter.add_mesh(
            grid.copy(), scalars=name, cmap="viridis", scalar_bar_args={"title": name, **bar}, lighting=not flat
        )
        if flat:
            plotter.view_xy()
            plotter.camera.tight(padding=0.15, adjust_render_window=False)
        else:
            # from the side of the planes of symmetry, where the inside of a quarter model shows
            plotter.view_vector((-1.0, -1.4, 0.6))
    plotter.screenshot(path)
    plotter.close()


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
    """Error against run time of every method; those exact to round-off stand as lines at their time."""
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    axes = figure.subplots(1, 2)
    for axis, error in zip(axes, ("primal_l2", "dual_full_floored"), strict=True):
        measured = [row for row in rows if "online_s" in row]
        for method in dict.fromkeys(row["method"] for row in measured):
            points = sorted(
                (row["online_s"] * 1e6, row[error], row["setting"]) for row in measured if row["method"] == method
            )
            if all(value < ROUND_OFF for _, value, _ in points):
                axis.axvline(points[0][0], linestyle="--", color="grey")
                upright = {"rotation": 90, "va": "top", "transform": axis.get_xaxis_transform()}
                axis.text(points[0][0], 0.98, f" {method}", **upright)
                continue
            axis.loglog([p[0] for p in points], [p[1] for p in points], "o", label=method)
            for x, y, setting in points:
                axis.annotate(setting, (x, y), textcoords="offset points", xytext=(6, 3), fontsize=8)
        axis.set(xscale="log", yscale="log", xlabel="time per query [us]", ylabel=f"median {error}")
        axis.legend()
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=150)
