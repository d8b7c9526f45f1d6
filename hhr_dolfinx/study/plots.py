"""Pictures of a study, and fields for ParaView. Imported only where a picture is made."""

from __future__ import annotations

import os
import sys
from pathlib import Path

# files only: without a display VTK would first look for an X server and complain
if sys.platform == "linux" and "DISPLAY" not in os.environ:
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pyvista
from matplotlib.colors import LogNorm

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.reduction.offline import HyperReduction

_VTK_CELLS = {(2, 3): "TRIANGLE", (2, 4): "QUAD", (3, 4): "TETRA", (3, 8): "HEXAHEDRON"}
_TENSOR_TO_VTK = {"QUAD": [0, 1, 3, 2], "HEXAHEDRON": [0, 1, 3, 2, 4, 5, 7, 6]}


def field_grid(problem: ContactProblem, hyper: HyperReduction, **displacements: np.ndarray) -> pyvista.UnstructuredGrid:
    """Mesh with displacement fields by name, (N,) each, and the RID as the cell field ``rid``."""
    dim = problem.points.shape[1]
    kind = _VTK_CELLS[dim, problem.cell_nodes.shape[1]]
    cells = problem.cell_nodes[:, _TENSOR_TO_VTK.get(kind, slice(None))]
    grid = pyvista.UnstructuredGrid({pyvista.CellType[kind]: cells}, _in_space(problem.points))
    for name, field in displacements.items():
        grid.point_data[name] = _in_space(field.reshape(-1, dim))
    grid.cell_data["rid"] = np.isin(np.arange(len(cells)), hyper.sets.cells).astype(np.uint8)
    return grid


def plot_deformed(grid: pyvista.UnstructuredGrid, names: list[str], path: Path) -> None:
    """Deformed meshes side by side, the cells of the RID in colour."""
    plotter = pyvista.Plotter(off_screen=True, shape=(1, len(names)), window_size=(700 * len(names), 800), border=False)
    for k, name in enumerate(names):
        plotter.subplot(0, k)
        deformed = grid.warp_by_vector(name)
        plotter.add_mesh(deformed, color="white", show_edges=True, edge_color="grey", lighting=False)
        plotter.add_mesh(deformed.threshold(0.5, scalars="rid"), color="tab:orange", show_edges=True, lighting=False)
        plotter.add_text(name, font_size=12, color="black")
        if np.ptp(grid.points[:, 2]) == 0:
            plotter.view_xy()
            plotter.camera.tight(padding=0.05, adjust_render_window=False)
    plotter.screenshot(path)
    plotter.close()


def plot_fields(grid: pyvista.UnstructuredGrid, names: list[str], path: Path, *, enlarge=(1.0, 1.0)) -> None:
    """Scalar fields of points or cells side by side on the mesh, which may be stretched to be seen."""
    shown = grid.scale((*enlarge, 1.0), inplace=False)
    plotter = pyvista.Plotter(off_screen=True, shape=(1, len(names)), window_size=(420 * len(names), 700), border=False)
    for k, name in enumerate(names):
        plotter.subplot(0, k)
        bar = {
            "title": name,
            "vertical": False,
            "title_font_size": 16,
            "label_font_size": 13,
            "n_labels": 3,
            "color": "k",
        }
        flat = np.ptp(grid.points[:, 2]) == 0
        plotter.add_mesh(shown.copy(), scalars=name, cmap="viridis", scalar_bar_args=bar, lighting=not flat)
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


def plot_multipliers(
    positions,
    references,
    answers,
    labels,
    path: Path,
    xlabel="position along the surface",
    ylabel="contact force per node",
):
    """Contact forces of the full model (lines) and of HHR on the RID (marks), thesis figure 3.2b.

    Args:
        positions: coordinate of each condition, (N_lambda,).
        references: forces of the full model, (N_lambda,) each.
        answers: pairs of positions and forces of HHR.
        labels: one label per curve.
        path: picture file.
        xlabel, ylabel: meaning of ``positions`` and of the forces.
    """
    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for reference, (where, forces), label in zip(references, answers, labels, strict=True):
        (line,) = axes.plot(positions, reference, label=f"full order, {label}" if len(where) else label)
        axes.plot(where, forces, "o", color=line.get_color(), label="HHR" if label == labels[0] else None)
    axes.set(xlabel=xlabel, ylabel=ylabel)
    axes.legend()
    _save(figure, path)


def plot_curves(curves: dict[str, tuple[np.ndarray, np.ndarray]], xlabel: str, ylabel: str, path: Path) -> None:
    """Curves by name, each a pair of positions and values, in the order of the positions."""
    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for name, (where, values) in curves.items():
        order = np.argsort(where)
        axes.plot(where[order], values[order], ".-", label=name)
    axes.set(xlabel=xlabel, ylabel=ylabel)
    axes.legend()
    _save(figure, path)


def plot_errors(parameter, errors: dict[str, np.ndarray], xlabel: str, path: Path) -> None:
    """Errors over one parameter on a logarithmic axis, thesis figure 3.3."""
    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    order = np.argsort(parameter)
    for name, values in errors.items():
        axes.semilogy(parameter[order], np.maximum(values[order], 1e-17), ".-", label=name)
    axes.set(xlabel=xlabel, ylabel="error")
    axes.legend()
    _save(figure, path)


def plot_work_precision(rows: list[dict], path: Path) -> None:
    """Error against run time of every method; exact methods stand as lines at their time."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
    for axis, error in zip(axes, ("primal_l2", "dual_full_floored"), strict=True):
        measured = [row for row in rows if "online_s" in row]
        for method in dict.fromkeys(row["method"] for row in measured):
            points = sorted(
                (row["online_s"] * 1e6, row[error], row["setting"]) for row in measured if row["method"] == method
            )
            if all(value == 0 for _, value, _ in points):
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
