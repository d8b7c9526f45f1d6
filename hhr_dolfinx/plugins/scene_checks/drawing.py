"""Figures of scenes before they are solved, and of meshes. Imported on demand."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.geometries.cells import DIMENSION, TENSOR_ORDER, outer_faces
from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.scene_checks.findings import SceneCheck
from hhr_dolfinx.plugins.scene_checks.mesh import MeshLook
from hhr_dolfinx.scene import Scene

with extra("pictures", "pictures of scenes and answers"):
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

CIRCULAR_ORDER = {3: [0, 1, 2], 4: [0, 1, 3, 2]}
"""Corners of a face in circular order, for triangles and tensor-ordered quadrilaterals."""
ARROWS = ("crimson", "purple", "darkorange", "teal", "olive", "navy")
"""Colours of loads, in turn."""
LENGTH = 0.07
"""Length of arrows over the size of the mesh."""
LEAST_ARROW = 0.02
"""Part of the largest force below which no arrow is drawn."""
MOST_ARROWS = 20
"""Most arrows of a load."""
MOST_SURFACES = 20
"""Surfaces of a mesh file that are drawn."""
SUPPORT_MARKS = "^sDvp*h"
"""Marks of surfaces with imposed displacements, in turn."""


def _unit(scene: Scene, of: str) -> str:
    return "" if scene.units is None else f" [{getattr(scene.units, of)}]"


def figure_of_scene(check: SceneCheck) -> Figure:
    """Bodies, contact surfaces, supports and loads of a scene by name."""
    look = MeshLook.of(check)
    kind = check.meshed.mesh.topology.cell_name()
    bodies = check.scene.bodies
    figure, axes = _new_figure(look.points)
    for index, body in enumerate(bodies):
        cells = look.cells[look.owner == index, : look.corners]
        cells = cells[:, TENSOR_ORDER[kind]] if kind in TENSOR_ORDER else cells
        _draw_cells(
            axes, look.points, kind, cells, {"facecolor": f"C{index}", "label": f"body {body.tag}"}
        )
    for index, (surfaces, _) in enumerate(check.pairs):
        label = f"contact {index}: " + " and ".join(str(surface.tag) for surface in surfaces)
        facets = [facet for surface in surfaces for facet in surface.points[surface.facets]]
        # facets of a line have two corners
        around = [
            facet[CIRCULAR_ORDER[len(facet)]] if len(facet) > 2 else facet for facet in facets
        ]
        _draw_facets(axes, around, f"C{len(bodies) + index}", label)
    _draw_supports(check, axes, 5 if look.points.shape[1] == 2 else 4)
    _draw_loads(check, axes)
    _frame(figure, axes, look.points, _unit(check.scene, "length"), check.scene.name)
    return figure


def figure_of_mesh(raw: RawMesh, title: str) -> Figure:
    """Bodies and surfaces of a mesh file by name.

    Each cell and each facet is drawn once, in the smallest set.

    Args:
        raw: the mesh.
        title: title of the figure.

    Returns:
        A figure of matplotlib.
    """
    figure, axes = _new_figure(raw.points)
    free = np.ones(len(raw.cells), dtype=bool)
    # sets of all cells come last, and names before their numbers
    bodies = sorted(raw.bodies.items(), key=lambda item: (len(item[1]), isinstance(item[0], int)))
    drawn = 0
    for name, rows in bodies:
        if free[rows].all():
            style = {"facecolor": f"C{drawn}", "label": f"body {name}"}
            _draw_cells(axes, raw.points, raw.kind, raw.cells[rows], style)
            free[rows] = False
            drawn += 1
    if free.any():
        style = {"facecolor": "lightgray", "label": "in no body"}
        _draw_cells(axes, raw.points, raw.kind, raw.cells[free], style)
    shown: set[tuple[int, ...]] = set()
    count = 0
    # large sets, such as the outside of a body, would hide what is in them
    for name, facets in sorted(
        raw.all_surfaces().items(), key=lambda item: (isinstance(item[0], int), len(item[1]))
    ):
        keys = list(map(tuple, np.sort(facets, axis=1).tolist()))
        remaining = [corners for key, corners in zip(keys, facets, strict=True) if key not in shown]
        shown.update(keys)
        if remaining and count < MOST_SURFACES:
            _draw_facets(
                axes, list(raw.points[np.array(remaining)]), f"C{drawn}", f"surface {name}"
            )
            drawn += 1
            count += 1
    _frame(figure, axes, raw.points, "", title)
    return figure


def _new_figure(points: np.ndarray) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    return figure, figure.subplots() if points.shape[1] == 2 else figure.add_subplot(
        projection="3d"
    )


def _draw_cells(
    axes: Axes, points: np.ndarray, kind: str, cells: np.ndarray, style: dict[str, str]
) -> None:
    """Cells of a plane body, or the outside of one in space.

    Their corners are in the order of files.
    """
    if points.shape[1] == 2:
        axes.add_collection(
            PolyCollection(points[cells], linewidth=0.2, alpha=0.5, edgecolor="white", **style)
        )
    else:
        faces = points[cells if DIMENSION[kind] == 2 else outer_faces(kind, cells)]
        axes.add_collection3d(
            Poly3DCollection(faces, linewidth=0.1, alpha=0.25, edgecolor="white", **style)
        )


def _draw_facets(axes: Axes, facets: list[np.ndarray], colour: str, label: str) -> None:
    """Facets of a surface, with their corners in circular order.

    A surface within glued bodies has none.
    """
    if not facets:
        return
    if facets[0].shape[1] == 2:
        axes.add_collection(LineCollection(facets, colors=colour, linewidth=2.5, label=label))
    else:
        axes.add_collection3d(Poly3DCollection(facets, facecolor=colour, alpha=0.9, label=label))


def _frame(figure: Figure, axes: Axes, points: np.ndarray, unit: str, title: str) -> None:
    """Limits, labels and legend."""
    axes.set(xlabel=f"x{unit}", ylabel=f"y{unit}", title=title)
    if points.shape[1] == 2:
        axes.set_aspect("equal")
        axes.autoscale_view()
    else:
        low = points.min(axis=0)
        high = points.max(axis=0)
        axes.set(
            xlim=(low[0], high[0]),
            ylim=(low[1], high[1]),
            zlim=(low[2], high[2]),
            zlabel=f"z{unit}",
        )
        axes.set_box_aspect(high - low)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)


def _draw_supports(check: SceneCheck, axes: Axes, size: float) -> None:
    """Marks on nodes with imposed displacements, of surfaces or of sets that may lie inside."""
    discretisation = check.meshed
    points = discretisation._points()
    displacements = check.scene.displacements
    for index, tag in enumerate(dict.fromkeys(displacement.tag for displacement in displacements)):
        which = ", ".join(
            "xyz"[k]
            for k in sorted(
                {
                    displacement.component
                    for displacement in displacements
                    if displacement.tag == tag
                }
            )
            if k < 3
        )
        nodes = points[discretisation._tagged_dofs(tag, 0) // points.shape[1]]
        look: dict[str, str] = {
            "marker": SUPPORT_MARKS[index % len(SUPPORT_MARKS)],
            "color": "black",
            "fillstyle": "none",
        }
        axes.plot(
            *nodes.T,
            linestyle="none",
            markersize=size,
            label=f"displacement {tag}: {which}",
            **look,
        )


def _draw_loads(check: SceneCheck, axes: Axes) -> None:
    """Arrows along nodal forces at the checked parameter, each load in a separate colour."""
    points = check.meshed._points()
    length = LENGTH * float(np.ptp(points, axis=0).max())
    for index, (name, forces) in enumerate(check.forces):
        sizes = np.linalg.norm(forces, axis=1)
        loaded = np.flatnonzero(sizes > LEAST_ARROW * sizes.max(initial=0.0))
        if not loaded.size:
            continue
        # ordered along the surface, so that the left-out ones are spread evenly
        loaded = loaded[np.lexsort(points[loaded].T)]
        shown = loaded[np.unique(np.linspace(0, loaded.size - 1, MOST_ARROWS).round().astype(int))]
        ways = length * forces[shown] / sizes[shown, None]
        look: dict[str, str] = {
            "color": ARROWS[index % len(ARROWS)],
            "label": f"load {index}: {name}",
        }
        starts = points[shown] - ways
        if points.shape[1] == 3:
            axes.quiver(*starts.T, *ways.T, arrow_length_ratio=0.3, linewidth=1, **look)
        else:
            axes.quiver(
                *starts.T,
                *ways.T,
                angles="xy",
                scale_units="xy",
                scale=1,
                width=0.0035,
                zorder=5,
                **look,
            )
            # arrows outside the bodies count for the limits
            axes.update_datalim(starts)
