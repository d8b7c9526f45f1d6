"""Picture of a scene before it is solved: bodies, contact surfaces, supports and loads by name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.compat import extra

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hhr_dolfinx.parameters import Tag


with extra("pictures", "pictures of a scene"):
    import matplotlib

    matplotlib.use("Agg")

    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection


AROUND = {3: [0, 1, 2], 4: [0, 1, 3, 2]}
"""Corners of a face in circular order, for triangles and tensor-ordered quadrilaterals."""
ARROWS = ("crimson", "purple", "darkorange", "teal", "olive", "navy")
"""Colours of loads, in turn."""
LENGTH = 0.07
FAINT = 0.02
MOST = 20
"""Length of arrows over the mesh size, part of the largest force below which none is drawn, most arrows of a load."""
HELD = "^sDvp*h"
"""Marks of surfaces with imposed displacements, in turn."""


def draw_scene(found: object, path: Path) -> None:
    """Draw a scene in the plane or in space into a file."""
    figure_of_scene(found).savefig(path, dpi=150)


def figure_of_scene(found: Any) -> Figure:
    """Figure of a scene in the plane or in space."""
    assert found.discretisation is not None
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    flat = found.discretisation.mesh.geometry.dim == 2
    axes: Axes = figure.subplots() if flat else figure.add_subplot(projection="3d")
    (_plane if flat else _space)(found, axes)
    unit = "" if found.scene.units is None else f" [{found.scene.units.length}]"
    axes.set(xlabel=f"x{unit}", ylabel=f"y{unit}", title=found.scene.name)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    return figure


def _plane(found: Any, axes: Axes) -> None:
    from hhr_dolfinx.geometries.cells import CORNERS

    discretisation = found.discretisation
    points = discretisation._points()
    cells = discretisation._cell_nodes()[:, : CORNERS[discretisation.mesh.topology.cell_name()]]
    owner = discretisation.cell_bodies()
    for place, body in enumerate(found.scene.bodies):
        corners = points[cells[owner == place]][:, AROUND[cells.shape[1]]]
        axes.add_collection(
            PolyCollection(
                corners, facecolor=f"C{place}", edgecolor="white", linewidth=0.2, alpha=0.5, label=f"body {body.tag}"
            )
        )
    count = len(found.scene.bodies)
    for place, (surfaces, _) in enumerate(found.pairs):
        lines = [line for surface in surfaces for line in surface.points[surface.facets]]
        label = f"contact {place}: " + " and ".join(str(surface.tag) for surface in surfaces)
        axes.add_collection(LineCollection(lines, colors=f"C{count + place}", linewidth=2.5, label=label))
    _marks(found, axes, 5)
    axes.set_aspect("equal")
    axes.autoscale_view()


def _marks(found: Any, axes: Axes, size: float) -> None:
    """Marks on nodes with imposed displacements, and on those under a load, in the plane or in space."""
    items = found.scene.displacements
    for place, tag in enumerate(dict.fromkeys(item.tag for item in items)):
        which = ", ".join("xyz"[k] for k in sorted({item.component for item in items if item.tag == tag}) if k < 3)
        look: dict[str, Any] = {"marker": HELD[place % len(HELD)], "color": "black", "fillstyle": "none"}
        label = f"displacement {tag}: {which}"
        axes.plot(*_nodes(found, tag).T, linestyle="none", markersize=size, label=label, **look)
    _arrows(found, axes)


def _arrows(found: Any, axes: Axes) -> None:
    """Loads as arrows along their nodal forces at the checked parameter, each in a separate colour."""
    discretisation = found.discretisation
    points = discretisation._points()
    length = LENGTH * float(np.ptp(points, axis=0).max())
    for place, (name, forces) in enumerate(found.forces):
        sizes = np.linalg.norm(forces, axis=1)
        loaded = np.flatnonzero(sizes > FAINT * sizes.max(initial=0.0))
        if not loaded.size:
            continue
        # ordered along the surface, so that the left-out ones are spread evenly
        loaded = loaded[np.lexsort(points[loaded].T)]
        shown = loaded[np.unique(np.linspace(0, loaded.size - 1, MOST).round().astype(int))]
        ways = length * forces[shown] / sizes[shown, None]
        look: dict[str, Any] = {"color": ARROWS[place % len(ARROWS)], "label": f"load {place}: {name}"}
        starts = points[shown] - ways
        if points.shape[1] == 3:
            axes.quiver(*starts.T, *ways.T, arrow_length_ratio=0.3, linewidth=1, **look)
        else:
            axes.quiver(*starts.T, *ways.T, angles="xy", scale_units="xy", scale=1, width=0.0035, zorder=5, **look)
            # arrows outside the bodies count for the limits
            axes.update_datalim(starts)


def _nodes(found: Any, tag: Tag) -> np.ndarray:
    """Coordinates of the nodes of a surface, which may lie inside, (n, dim)."""
    discretisation = found.discretisation
    return discretisation._points()[discretisation._tagged_dofs(tag, 0) // discretisation.mesh.geometry.dim]


def _space(found: Any, axes: Axes) -> None:
    from hhr_dolfinx.geometries.cells import CORNERS, TENSOR, outer_faces

    discretisation = found.discretisation
    points = discretisation._points()
    owner = discretisation.cell_bodies()
    kind = discretisation.mesh.topology.cell_name()
    cells = discretisation._cell_nodes()[:, : CORNERS[kind]]
    for place, body in enumerate(found.scene.bodies):
        own = cells[owner == place]
        own = own[:, TENSOR[kind]] if kind in TENSOR else own
        outer = points[outer_faces(kind, own)]
        axes.add_collection3d(
            Poly3DCollection(
                outer, facecolor=f"C{place}", edgecolor="white", linewidth=0.1, alpha=0.25, label=f"body {body.tag}"
            )
        )
    shift = len(found.scene.bodies)
    for place, (surfaces, _) in enumerate(found.pairs):
        label = f"contact {place}: " + " and ".join(str(surface.tag) for surface in surfaces)
        faces = [face[AROUND[len(face)]] for surface in surfaces for face in surface.points[surface.facets]]
        axes.add_collection3d(Poly3DCollection(faces, facecolor=f"C{shift + place}", alpha=0.9, label=label))
    _marks(found, axes, 4)
    low = points.min(axis=0)
    high = points.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low)
    axes.set_zlabel("z" if found.scene.units is None else f"z [{found.scene.units.length}]")
