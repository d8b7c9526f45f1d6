"""Pictures of local models of two parameters: figures 4.2 to 4.10 of the thesis."""

from pathlib import Path

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.local_models.models import LocalModels
from hhr_dolfinx.study.training.train import Training

LABELS = ("P1 [MPa]", "h1 [mm]")


def draw(
    name: str,
    training: Training,
    local: LocalModels,
    one: hhr.ReducedModel,
    folder: Path,
    quick: bool,
) -> None:
    """Regions with their training, RIDs of up to four models, and maps of errors beside those of
    one model.
    """
    _draw_regions(local, folder / f"{name}_regions.png")
    _draw_domains(training, local, folder / f"{name}_domains.png")
    _draw_maps(training, {"one model": one, f"{len(local)} models": local}, folder, name, quick)


def _draw_regions(local: LocalModels, path: Path) -> None:
    """Which model answers where, and the points that trained it, figures 4.2b and 4.8."""
    from matplotlib.figure import Figure

    space = local.parameters
    axes = [np.linspace(low, high, 241) for low, high in zip(space.lower, space.upper, strict=True)]
    table = np.array(np.meshgrid(*axes, indexing="ij")).reshape(2, -1).T
    regions = local.choice.many(table)[0].reshape(241, 241)
    figure = Figure(figsize=(6, 4.5), layout="constrained")
    axis = figure.subplots()
    axis.pcolormesh(*axes, regions.T, cmap="tab20", vmin=0, vmax=19, alpha=0.5, shading="nearest")
    points = local.offline.points
    own = local.choice.many(points)[0]
    axis.scatter(*points.T, c=own, cmap="tab20", vmin=0, vmax=19, s=5)
    axis.set(
        xlabel=LABELS[0],
        ylabel=LABELS[1],
        title=f"{len(local)} local models, {len(points)} solutions",
    )
    figure.savefig(path, dpi=150)


def _draw_domains(training: Training, local: LocalModels, path: Path) -> None:
    """Reduced domains of flat meshes side by side, figures 4.4 and 4.9."""
    import pyvista

    from hhr_dolfinx.plugins.studies.plots import field_grid

    shown = local.models[:4]
    plotter = pyvista.Plotter(
        off_screen=True, shape=(1, len(shown)), window_size=(400 * len(shown), 600), border=False
    )
    for number, model in enumerate(shown):
        plotter.subplot(0, number)
        grid = field_grid(training.full_order, model.offline.sets.cells, {})
        plotter.add_mesh(
            grid, scalars="rid", cmap=["#d9d9d9", "#c0392b"], show_scalar_bar=False, lighting=False
        )
        plotter.add_text(f"RID of model {number}", position="upper_edge", font_size=9, color="k")
        plotter.view_xy()
        plotter.camera.tight(padding=0.2, adjust_render_window=False)
    plotter.screenshot(path)
    plotter.close()


def _draw_maps(training: Training, models: dict, folder: Path, name: str, quick: bool) -> None:
    """Errors of forces over both parameters, figures 4.5, 4.6 and 4.10."""
    from thesis_output import plot_maps

    from hhr_dolfinx.plugins.studies.measure import References

    points = training.full_order.parameters.grid([12, 10] if quick else [40, 30])
    references = References.at(points, training.full_order, training.snapshots)
    found = {label: references.errors(model).values for label, model in models.items()}
    for error in ("dual_rid_floored", "dual_full_floored"):
        maps = {label: values[error] for label, values in found.items()}
        plot_maps(points, maps, LABELS, folder / f"{name}_{error}.png")
