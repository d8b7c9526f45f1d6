"""Pictures of a study, and fields for ParaView. Imported only where a picture is made."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

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
from hhr_dolfinx.study.field_pictures import draw_fields
from hhr_dolfinx.study.method_pictures import plot_work_precision
from hhr_dolfinx.study.view import View

with extra("pictures", "pictures and fields for ParaView"):
    import matplotlib

    matplotlib.use("Agg")

    import pyvista
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed_flow import CondensedFlowModel
    from hhr_dolfinx.study.study import Study

Curves = dict[str, tuple[Any, Any]]
"""Positions and values of curves by name."""


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
        _draw_over_time({"full order": exact, method: found}, full.problem.contact_pairs, folder)
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
    problem, units = full.problem, full.scene.units
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
    if model.flow is None:
        cells[f"von Mises [{view.stress}]"] = {name: von_mises(answer.stress()) for name, answer in answers.items()}
    else:
        mean = lambda values: values.reshape(len(problem.cell_nodes), -1).mean(axis=1)  # noqa: E731
        cells["plastic strain"] = {name: mean(answer.plastic_strain()) for name, answer in answers.items()}
        stress = f"first normal stress [{view.stress}]"
        cells[stress] = {name: mean(answer.stress()[:, 0]) for name, answer in answers.items()}
    draw_fields(field_grid(full, _cells(model), fields), view, fields, cells, folder)


class Panel(NamedTuple):
    """One of several drawings beside each other: its title, labels, lines and marks."""

    title: str
    labels: tuple[str, str]
    lines: Curves
    marks: Curves


def _pressures_of(
    full: FullOrderModel, pair: int, pairs: dict[str, tuple[Answer, Answer]], view: View, method: str
) -> Panel:
    """Pressures of one contact: lines of the full order, marks of a reduced model, a closed form where there is one."""
    problem = full.problem
    own = problem.contact_pairs == pair
    where, label = view.along(problem.contact_points[own], pair, full.scene.units)
    lines, marks, closed_forms = {}, {}, {}
    for name, (exact, found) in pairs.items():
        lines[f"full order{name}"] = where, pressures(problem, pair, exact.forces())
        marks[f"{method}{name}"] = where, pressures(problem, pair, found.forces())
        if view.closed_form is not None and pair == (view.pair or 0):
            closed_forms[f"closed form{name}"] = where, view.closed_form(where, exact.forces()[own].sum())
    tags = " and ".join(str(tag) for tag in full.scene.contacts[pair].tags)
    title = f"contact {pair}: {tags}"
    return Panel(title, (label, f"contact pressure [{view.stress}]"), lines | closed_forms, marks)


def _cells(model: ReducedModel | CondensedFlowModel) -> np.ndarray:
    """Cells where a model integrates: those of its RID, or of the points where it evaluates its laws."""
    if isinstance(model, ReducedModel):
        return model.offline.sets.cells
    return np.unique(model.flow.points // model.flow.per_cell)


def _draw_over_time(histories: dict[str, History], contacts: np.ndarray, folder: Path) -> None:
    """Force of each contact, largest plastic strain and iterations of the steps of histories, by method."""
    times = [answer.time for answer in next(iter(histories.values())).answers]
    pairs, lines = np.unique(contacts), {}
    for label, history in histories.items():
        forces = np.array([answer.forces() for answer in history.answers])
        for pair in pairs:
            name = f"{label}, contact {pair}" if pairs.size > 1 else label
            lines[name] = times, forces[:, contacts == pair].sum(axis=1)
    plot_curves(lines, folder / "contact_force.png", ("time [s]", "contact force"))
    quantities = {
        "largest plastic strain": lambda history: [answer.gauss.state.cumulated.max() for answer in history.answers],
        "iterations of a step": lambda history: history.iterations,
    }
    for name, quantity in quantities.items():
        lines = {label: (times, quantity(history)) for label, history in histories.items()}
        plot_curves(lines, folder / f"{name.replace(' ', '_')}.png", ("time [s]", name))


def pressures(problem: ContactProblem, pair: int, forces: np.ndarray) -> np.ndarray:
    """Pressures of the contact conditions of a pair: nodal forces over tributary areas."""
    own = problem.contact_pairs == pair
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
    """Curves by name, joined in the order of positions, and marks in the colours of the curves at the same places."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    _curves(axes, lines, marks or {}, logarithmic)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    axes.legend()
    _save(figure, path)


def plot_panels(panels: Sequence[Panel], path: Path) -> None:
    """Drawings beside each other, three in a row, with one legend for all of them."""
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


def _curves(axes: Any, lines: Curves, marks: Curves, logarithmic: bool) -> None:
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
