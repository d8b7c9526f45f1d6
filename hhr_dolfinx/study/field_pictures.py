"""Pictures of fields on meshes: models beside each other, their difference, and bodies as they were."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.study.view import View

with extra("pictures", "pictures and fields for ParaView"):
    import pyvista

SHARE = 99.0
"""Per cent of the values that colours tell apart: a corner where stress is infinite has them all otherwise."""
BEYOND = 1.3
"""Largest value, over the end of the colours, from which on it is said."""


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

    On a grid with displacements by model and the RID: values of cells by quantity and model.
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
    # the RID is drawn on the deformed mesh of the last model, every field on that of its own
    _plot(grid, list(warped.values())[-1], rows, folder / "fields.png")


def _difference(quantity: str) -> str:
    return f"{quantity}, difference"


def _row(quantity: str, models: dict[str, np.ndarray], warped: dict[str, pyvista.UnstructuredGrid]) -> Iterator[_Panel]:
    """Pictures of a quantity: one of each model in the same colours, and what they differ by."""
    every = np.concatenate([np.ravel(values) for values in models.values()])
    low, high = np.percentile(every, [100 - SHARE, SHARE])
    for model, values in models.items():
        largest = float(np.max(values))
        told = f", up to {largest:.3g}" if largest > BEYOND * high else ""
        yield _Panel(warped[model], f"{quantity}, {model}", f"{quantity}, {model}{told}", "viridis", (low, high))
    first, *_, last = models
    size = float(np.percentile(np.abs(models[last] - models[first]), SHARE)) or 1.0
    title = f"{last} less {first}"
    yield _Panel(warped[last], _difference(quantity), title, "coolwarm", (-size, size))


def _plot(
    still: pyvista.UnstructuredGrid, moved: pyvista.UnstructuredGrid, rows: list[list[_Panel]], path: Path
) -> None:
    """The RID in two colours, and beside it a row for each quantity, all with the outline of bodies at rest."""
    flat = np.ptp(still.points[:, 2]) == 0
    columns = 1 + max(len(row) for row in rows)
    plotter = pyvista.Plotter(
        off_screen=True, shape=(len(rows), columns), window_size=(560 * columns, _height(still) * len(rows)),
        border=False,
    )  # fmt: skip
    outline = _outline(still, flat)
    count = int(still.cell_data["rid"].sum())
    plotter.subplot(0, 0)
    plotter.add_mesh(moved.copy(), scalars="rid", cmap=["#d9d9d9", "#c0392b"], show_scalar_bar=False, lighting=not flat)
    _finish(plotter, f"RID: {count} of {still.n_cells} cells", outline, flat)
    for place, row in enumerate(rows):
        for number, panel in enumerate(row, start=1):
            plotter.subplot(place, number)
            _draw(plotter, panel, flat)
            _finish(plotter, panel.title, outline, flat)
    plotter.screenshot(path)
    plotter.close()


def _draw(plotter: Any, panel: _Panel, flat: bool) -> None:
    bar = {"title": panel.name, "vertical": False, "label_font_size": 15, "n_labels": 3, "color": "k",
           "position_y": 0.02, "fmt": "%.3g", "width": 0.6, "position_x": 0.2}  # fmt: skip
    plotter.add_mesh(
        panel.grid.copy(), scalars=panel.name, cmap=panel.colours, clim=panel.ends, scalar_bar_args=bar,
        lighting=not flat,
    )  # fmt: skip
    # the name stands above the picture, where it lies on nothing
    plotter.scalar_bars[panel.name].SetTitle("")


def _outline(still: pyvista.UnstructuredGrid, flat: bool) -> pyvista.PolyData:
    """Edges of the bodies where they lie before anything moves."""
    return still.extract_feature_edges(
        feature_angle=40, boundary_edges=True, feature_edges=not flat, manifold_edges=False, non_manifold_edges=False
    )


def _finish(plotter: Any, title: str, outline: pyvista.PolyData, flat: bool) -> None:
    """Outline, title and camera of one picture."""
    if outline.n_cells:
        plotter.add_mesh(outline.copy(), color="k", line_width=1, opacity=0.6)
    plotter.add_text(title, position="upper_edge", font_size=9, color="k")
    if flat:
        plotter.view_xy()
        plotter.camera.tight(padding=0.35, adjust_render_window=False)
    else:
        # from the side of the planes of symmetry, where the inside of a quarter model shows
        plotter.view_vector((-1.0, -1.4, 0.6))


def _height(grid: pyvista.UnstructuredGrid) -> int:
    """Pixels that a flat mesh needs beside 560 across, with room for its name and a bar; of others a square."""
    width, height, depth = np.ptp(grid.points, axis=0)
    return 560 if depth else int(np.clip(560 * height / max(width, 1e-300) + 170, 300, 800))
