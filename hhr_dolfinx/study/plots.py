"""Pictures of a study, and fields for ParaView. Imported only where a picture is made."""

from __future__ import annotations

import os
import sys
from pathlib import Path

# files only: without a display VTK would first look for an X server and complain
if sys.platform == "linux" and "DISPLAY" not in os.environ:
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.study.view import View

with extra("pictures", "pictures and fields for ParaView"):
    import matplotlib

    matplotlib.use("Agg")

    import matplotlib.pyplot as plt
    import pyvista
    from matplotlib.colors import LogNorm

_VTK_CELLS = {(2, 3): "TRIANGLE", (2, 4): "QUAD", (3, 4): "TETRA", (3, 8): "HEXAHEDRON"}
_TENSOR_TO_VTK = {"QUAD": [0, 1, 3, 2], "HEXAHEDRON": [0, 1, 3, 2, 4, 5, 7, 6]}


ROUND_OFF = 1e-10
"""Errors below need no place on an axis of errors."""


def draw_study(study, view: View, folder: Path) -> None:
    """Pictures of a :class:`~hhr_dolfinx.study.study_scene.SceneStudy`.

    Error against run time; contact pressures at the points of the view; RID, displacement and stress at the last of
    them, also for ParaView; and errors over the parameter where there is only one.
    """
    full_order, hyper = study.training.full_order, study.hyper
    problem, discretisation = full_order.problem, full_order.discretisation
    plot_work_precision(study.report["work_precision"], folder / "work_precision.png")
    if len(problem.parameters.names) == 1:
        names = ("primal_euclid", "primal_energy", "dual_rid", "energy_minimum")
        curves = {name: (np.ravel(study.points), study.errors.values[name]) for name in names}
        plot_curves(curves, folder / "errors.png", (problem.parameters.names[0], "error"), logarithmic=True)
    if not view.points:
        return
    lines, marks, closed_forms = {}, {}, {}
    for mu in view.points:
        exact, (displacement, forces) = full_order.solve(mu), hyper.solve_everywhere(mu)
        label = ", ".join(f"{name} = {value:g}" for name, value in zip(problem.parameters.names, mu, strict=True))
        lines[f"full order, {label}"] = pressures(problem, view, exact.forces)
        marks[f"HHR, {label}"] = pressures(problem, view, forces)
        if view.closed_form is not None:
            where, load = lines[f"full order, {label}"][0], exact.forces[problem.contact_pairs == view.pair].sum()
            closed_forms[f"closed form, {label}"] = where, view.closed_form(where, load)
    labels = view.label, f"contact pressure [{view.stress}]"
    plot_curves(lines | closed_forms, folder / "pressures.png", labels, marks=marks)
    fields = {"full order": exact.primal, "HHR": displacement}
    stresses = {name: discretisation.von_mises(field) for name, field in fields.items()}
    grid = field_grid(problem, hyper.sets.cells, fields)
    draw_fields(grid, view, fields, {f"von Mises [{view.stress}]": stresses}, folder)


def draw_histories(study, view: View, folder: Path) -> None:
    """Pictures of a :class:`~hhr_dolfinx.study.study_histories.HistoryStudy` at its last test value.

    RID, plastic strain and radial stress of the last step, also for ParaView; its contact pressures; and over time
    the contact force, the largest plastic strain and the iterations of each step.
    """
    full, reduction, problem = study.full, study.reduction, study.full.problem
    here, there, per_cell = study.history.points[-1], study.exact.points[-1], full.operator.per_cell
    fields = {"full order": full.displacement(there), "HHR": reduction.displacement_everywhere(here)}
    values = {
        "plastic strain": (there.state.cumulated, reduction.plastic_strain_everywhere(here)),
        f"first normal stress [{view.stress}]": (there.stress[:, 0], reduction.stress_everywhere(here)[:, 0]),
    }
    cells = {
        name: {model: points.reshape(-1, per_cell).mean(axis=1) for model, points in zip(fields, pair, strict=True)}
        for name, pair in values.items()
    }
    draw_fields(field_grid(problem, reduction.model.sets.cells, fields), view, fields, cells, folder)
    lines = {"full order": pressures(problem, view, there.forces)}
    marks = {"HHR": pressures(problem, view, reduction.forces_everywhere(here))}
    plot_curves(lines, folder / "pressures.png", (view.label, f"contact pressure [{view.stress}]"), marks=marks)
    exact, reduced = study.exact.points, study.history.points
    over_time = {
        "contact force": ([p.forces.sum() for p in exact], [reduction.forces_everywhere(p).sum() for p in reduced]),
        "largest plastic strain": (
            [p.state.cumulated.max() for p in exact],
            [p.state.cumulated.max() for p in reduced],
        ),
        "iterations of a step": (study.exact.iterations, study.history.iterations),
    }
    times = [point.time for point in exact]
    for name, (full_values, values) in over_time.items():
        lines = {"full order": (times, full_values), "HHR": (times, values)}
        plot_curves(lines, folder / f"{name.replace(' ', '_')}.png", ("time [s]", name))


def pressures(problem: ContactProblem, view: View, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and pressures of the contact conditions of a view: nodal forces over tributary areas."""
    pair = problem.contact_pairs == view.pair
    return view.position(problem.contact_points[pair]), forces[pair] / problem.contact_areas[pair]


def draw_fields(grid: pyvista.UnstructuredGrid, view: View, fields: dict, cells: dict, folder: Path) -> None:
    """Write ``fields.vtu`` and a picture of the RID and of scalar fields of several models.

    Args:
        grid: what :func:`field_grid` returned.
        view: the displacement component drawn.
        fields: displacements by model, (N,).
        cells: values of cells by quantity and model.
        folder: where to.
    """
    shown, dim = ["rid"], next(iter(fields.values())).size // grid.n_points
    if view.component is not None:
        for model, field in fields.items():
            shown.append(f"{view.component[1]}, {model}")
            grid.point_data[shown[-1]] = field[view.component[0] :: dim]
    for quantity, models in cells.items():
        for model, values in models.items():
            shown.append(f"{quantity}, {model}")
            grid.cell_data[shown[-1]] = values
    grid.save(folder / "fields.vtu")
    # each model on its own deformed mesh; the RID on that of the last
    models = [next((model for model in fields if name.endswith(model)), model) for name in shown]
    grids = [grid.warp_by_vector(model) if view.deformed else grid for model in models]
    plot_fields(grids, shown, folder / "fields.png")


def field_grid(problem: ContactProblem, rid_cells: np.ndarray, fields: dict[str, np.ndarray]):
    """Mesh with displacement fields by name, (N,) each, and the RID as the cell field ``rid``."""
    dim = problem.points.shape[1]
    kind = _VTK_CELLS[dim, problem.cell_nodes.shape[1]]
    cells = problem.cell_nodes[:, _TENSOR_TO_VTK.get(kind, slice(None))]
    grid = pyvista.UnstructuredGrid({pyvista.CellType[kind]: cells}, _in_space(problem.points))
    for name, field in fields.items():
        grid.point_data[name] = _in_space(field.reshape(-1, dim))
    grid.cell_data["rid"] = np.isin(np.arange(len(cells)), rid_cells).astype(np.uint8)
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


def plot_maps(points, maps: dict[str, np.ndarray], labels: tuple[str, str], path: Path, top: float = 1.0) -> None:
    """Relative errors over two parameters, one map per model on one logarithmic scale, thesis figure 3.9.

    Args:
        points: parameters on a regular grid, (n, 2).
        maps: errors by model, (n,) each.
        labels: names of the two parameters.
        path: picture file.
        top: error at the end of the colour scale.
    """
    figure, axes = plt.subplots(1, len(maps), figsize=(4.6 * len(maps), 4), layout="constrained", squeeze=False)
    first, second = (np.unique(points[:, k]) for k in (0, 1))
    norm = LogNorm(1e-4, top)
    for axis, (name, errors) in zip(axes[0], maps.items(), strict=True):
        table = np.clip(np.nan_to_num(errors, nan=top, posinf=top), 1e-4, top).reshape(first.size, second.size)
        image = axis.pcolormesh(first, second, table.T, norm=norm, cmap="magma_r", shading="nearest")
        axis.set(title=name, xlabel=labels[0], ylabel=labels[1])
    figure.colorbar(image, ax=axes, label="relative error of the contact forces")
    _save(figure, path)


def plot_curves(lines: dict, path: Path, labels: tuple[str, str], *, marks=None, logarithmic: bool = False) -> None:
    """Curves by name, and marks in the colours of the curves at the same places of their list.

    Args:
        lines: pairs of positions and values by name, joined in the order of the positions.
        path: picture file.
        labels: of both axes.
        marks: likewise, drawn as points.
        logarithmic: whether the values are.
    """
    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
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


def plot_work_precision(rows: list[dict], path: Path) -> None:
    """Error against run time of every method; those exact to round-off stand as lines at their time."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
    for axis, error in zip(axes, ("primal_l2", "dual_full_floored"), strict=True):
        measured = [row for row in rows if "online_s" in row]
        for method in dict.fromkeys(row["method"] for row in measured):
            points = sorted(
                (row["online_s"] * 1e6, row[error], row["setting"]) for row in measured if row["method"] == method
            )
            if all(value < ROUND_OFF for _, value, _ in points):
                axis.axvline(points[0][0], linestyle="--", color="grey")
                axis.text(
                    points[0][0],
                    0.98,
                    f" {method}",
                    rotation=90,
                    va="top",
                    transform=axis.get_xaxis_transform(),
                )
                continue
            axis.loglog([p[0] for p in points], [p[1] for p in points], "o", label=method)
            for x, y, setting in points:
                axis.annotate(setting, (x, y), textcoords="offset points", xytext=(6, 3), fontsize=8)
        axis.set(xscale="log", yscale="log", xlabel="time per query [us]", ylabel=f"median {error}")
        axis.legend()
    _save(figure, path)


def _in_space(vectors):
    """Pad 2D vectors with a zero third component, as VTK wants them."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))


def _save(figure, path):
    figure.savefig(path, dpi=150)
    plt.close(figure)
