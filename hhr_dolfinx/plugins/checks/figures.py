"""Figures for ``scene.plot()`` and ``answer.plot()``; those of answers need no DOLFINx.

Imported on demand.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.models.answer import Answer, Meshed
from hhr_dolfinx.models.answer_mesh import AnswerMesh
from hhr_dolfinx.models.shown import point_of

with extra("pictures", "pictures of scenes and answers"):
    from matplotlib.axes import Axes
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

if TYPE_CHECKING:
    from hhr_dolfinx.scene import Scene

VTK_CORNERS = {5: 3, 69: 3, 9: 4, 70: 4}
"""Corners of plane cells by VTK's numbers, of linear and Lagrange triangles and quadrilaterals."""
SHIFT = 0.1
"""Limit of drawn displacements, over the extent of the mesh: smaller ones are magnified by a power
of ten up to it.
"""


def figure_of(value: Scene | Answer, path: str | Path | None, full: Meshed | None = None) -> Figure:
    """Figure of a scene, or of an answer on the mesh of a full model or a file.

    Saved if a path is given.

    Raises:
        SceneError: for a scene whose mesh cannot be generated.
    """
    if isinstance(value, Answer):
        assert full is not None
        figure = _figure_of_answer(value, full)
    else:
        from hhr_dolfinx.plugins.checks.check import check_scene
        from hhr_dolfinx.plugins.checks.drawing import figure_of_scene

        found = check_scene(value)
        if found.discretisation is None:
            raise SceneError(f"scene '{value.name}' cannot be drawn: `hhr check` says why")
        figure = figure_of_scene(found)
    if path is not None:
        figure.savefig(path, dpi=150)
    return figure


def _in(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _figure_of_answer(answer: Answer, full: Meshed) -> Figure:
    """Pressure on the contact surface, and in the plane the deformed bodies next to it."""
    mesh = full.answer_mesh()
    pressures = answer.pressure(full)
    flat = mesh.points.shape[1] == 2
    figure = Figure(figsize=(11, 4.5) if flat else (7, 5.5), layout="constrained")
    figure.suptitle(f"{mesh.name} at {point_of(answer.parameter, mesh.parameters)}")
    if flat:
        names = ("r", "z") if mesh.axisymmetric else ("x", "y")
        bodies, surface = figure.subplots(1, 2, width_ratios=(1.3, 1))
        _draw_bodies(figure, bodies, answer, mesh, names)
        _draw_pressures(surface, pressures, mesh, names)
    else:
        _draw_surface(figure, figure.add_subplot(projection="3d"), pressures, mesh)
    return figure


def _with_area(mesh: AnswerMesh, pressures: np.ndarray) -> list[np.ndarray]:
    """Numbers of the conditions of pressures of each contact that have an area."""
    return [conditions[np.isfinite(pressures[conditions])] for conditions in mesh.contacts]


def _draw_pressures(
    axes: Axes, pressures: np.ndarray, mesh: AnswerMesh, names: tuple[str, str]
) -> None:
    """Curves of the pressure over the coordinate along which each contact extends most."""
    labels = set()
    for contact, conditions in enumerate(_with_area(mesh, pressures)):
        points = mesh.contact_points[conditions]
        along = int(np.ptp(points, axis=0).argmax())
        order = np.argsort(points[:, along], kind="stable")
        axes.plot(
            points[order, along], pressures[conditions][order], ".-", label=f"contact {contact}"
        )
        labels.add(names[along])
    axes.set(
        xlabel=f"{' or '.join(sorted(labels))}{_in(mesh.length)}",
        ylabel=f"contact pressure{_in(mesh.stress)}",
    )
    axes.grid(alpha=0.25)
    axes.legend()


def _draw_bodies(
    figure: Figure, axes: Axes, answer: Answer, mesh: AnswerMesh, names: tuple[str, str]
) -> None:
    """Cells at their displaced positions, magnified if displacements are small, coloured by their
    magnitude.
    """
    displacement = mesh.nodal(answer.displacement())
    lengths = np.linalg.norm(displacement, axis=1)
    limit = SHIFT * float(np.ptp(mesh.points, axis=0).max())
    largest = float(lengths.max(initial=0.0))
    factor = max(1.0, 10.0 ** np.floor(np.log10(limit / largest))) if largest > 0 else 1.0
    cells = mesh.cells[:, : VTK_CORNERS[mesh.kind]]
    drawn = PolyCollection(
        (mesh.points + factor * displacement)[cells],
        array=lengths[cells].mean(axis=1),
        edgecolor="face",
    )
    axes.add_collection(drawn)
    unit = _in(mesh.length)
    figure.colorbar(drawn, ax=axes, label=f"displacement{unit}")
    title = "" if factor == 1 else f"displacements {factor:g} times as large"
    axes.set(xlabel=f"{names[0]}{unit}", ylabel=f"{names[1]}{unit}", aspect="equal", title=title)
    axes.autoscale_view()


def _draw_surface(figure: Figure, axes: Axes, pressures: np.ndarray, mesh: AnswerMesh) -> None:
    """Points of all contact surfaces, coloured by their pressure."""
    conditions = np.concatenate(_with_area(mesh, pressures))
    points = mesh.contact_points[conditions]
    drawn = axes.scatter(*points.T, c=pressures[conditions], s=12)
    figure.colorbar(drawn, ax=axes, label=f"contact pressure{_in(mesh.stress)}", shrink=0.7)
    names = {f"{axis}label": f"{axis}{_in(mesh.length)}" for axis in "xyz"}
    extent = np.ptp(points, axis=0)
    axes.set(**names, box_aspect=np.maximum(extent, 0.1 * extent.max()))
