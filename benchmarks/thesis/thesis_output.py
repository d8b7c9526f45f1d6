"""Maps of errors as in thesis figure 3.9, and tables beside those of the thesis."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from hhr_dolfinx.command.console import Column, Console, Table

matplotlib.use("Agg")


def plot_maps(
    points: np.ndarray,
    maps: dict[str, np.ndarray],
    labels: tuple[str, str],
    path: Path,
    rows: int = 1,
) -> None:
    """Relative errors over two parameters, one map per model on one logarithmic scale, thesis
    figure 3.9.

    ``points`` form a regular grid, (n, 2), with errors by model, (n,) each; the maps stand in
    ``rows`` rows.
    """
    columns = len(maps) // rows
    figure = Figure(figsize=(4.6 * columns, 4 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    first, second = (np.unique(points[:, k]) for k in (0, 1))
    norm = LogNorm(1e-4, 1.0)
    for axis, (name, errors) in zip(axes.flat, maps.items(), strict=True):
        table = np.clip(np.nan_to_num(errors, nan=1.0, posinf=1.0), 1e-4, 1.0).reshape(
            first.size, second.size
        )
        image = axis.pcolormesh(
            first, second, table.T, norm=norm, cmap="magma_r", shading="nearest"
        )
        axis.set(title=name, xlabel=labels[0], ylabel=labels[1])
    figure.colorbar(image, ax=axes, label="relative error of the contact forces")
    figure.savefig(path, dpi=160)


def print_beside(
    title: str, ours: dict[str, dict], theirs: dict[str, dict], console: Console
) -> None:
    """Print relative errors by label and name in per cent, those of another source in brackets if
    it has any.
    """
    table = Table(Column("", no_wrap=True), *ours, title=f"{title}, in % (in brackets: thesis)")
    for name in next(iter(ours.values())):
        pairs = ((row[name], theirs.get(label, {}).get(name)) for label, row in ours.items())
        cells = (
            f"{100 * here:.2g}" + ("" if there is None else f" ({100 * there:.2g})")
            for here, there in pairs
        )
        table.add_row(name, *cells)
    console.print(table)
