"""A picture of a scene before it is solved: bodies, contact surfaces, supports and loads by name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.compat import extra

with extra("pictures", "pictures of a scene"):
    import matplotlib

    matplotlib.use("Agg")

    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

if TYPE_CHECKING:
    from hhr_dolfinx.study.scene_findings import SceneCheck

AROUND = {3: [0, 1, 2], 4: [0, 1, 3, 2]}
"""Corners of a face in the order in which they go round, of triangles and tensor-ordered quadrilaterals."""


def draw_scene(found: SceneCheck, path: Path) -> None:
    """Draw a scene in the plane or in space."""
    assert found.discretisation is not None
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    flat = found.discretisation.mesh.geometry.dim == 2
    axes: Any = figure.subplots() if flat else figure.add_subplot(projection="3d")
    (_plane if flat else _space)(found, axes)
    unit = "" if found.scene.units is None else f" [{found.scene.units.length}]"
    axes.set(xlabel=f"x{unit}", ylabel=f"y{unit}", title=found.scene.name)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    figure.savefig(path, dpi=150)


def _plane(found: SceneCheck, axes: Any) -> None:
    discretisation: Any = found.discretisation
    points, cells, owner = discretisation._points(), discretisation._cell_nodes(), discretisation.cell_bodies()
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
    for tag in dict.fromkeys(item.tag for item in found.scene.displacements):
        components = sorted({item.component for item in found.scene.displacements if item.tag == tag})
        held = _nodes(found, tag, components[0])
        which = ", ".join("xyz"[k] for k in components)
        axes.plot(
            *held.T[:2], marker="^", linestyle="none", markersize=5, color="black", label=f"displacement {tag}: {which}"
        )
    for load in dict.fromkeys(getattr(load, "tag", None) for load in found.scene.loads):
        if load is not None and load in _facets(found):
            loaded = _nodes(found, load, 0)
            axes.plot(*loaded.T[:2], marker="v", linestyle="none", markersize=5, color="crimson", label=f"load {load}")
    axes.set_aspect("equal")
    axes.autoscale_view()


def _nodes(found: SceneCheck, tag: Any, component: int) -> np.ndarray:
    """Coordinates of the nodes of a surface, which may lie inside."""
    discretisation: Any = found.discretisation
    return discretisation._points()[discretisation._tagged_dofs(tag, component) // discretisation.mesh.geometry.dim]


def _facets(found: SceneCheck) -> set:
    """Tags of facets, by number and by name."""
    discretisation: Any = found.discretisation
    return {*discretisation._facet_tags.values.tolist(), *discretisation.names.facets}


def _space(found: SceneCheck, axes: Any) -> None:
    from hhr_dolfinx.geometries.cells import FACES, TENSOR

    discretisation: Any = found.discretisation
    points, cells, owner = discretisation._points(), discretisation._cell_nodes(), discretisation.cell_bodies()
    kind = discretisation.mesh.topology.cell_name()
    corners = np.array(FACES[kind])
    for place, body in enumerate(found.scene.bodies):
        own = cells[owner == place]
        own = own[:, TENSOR[kind]] if kind in TENSOR else own
        every = own[:, corners].reshape(-1, corners.shape[1])
        _, first, count = np.unique(np.sort(every, axis=1), axis=0, return_index=True, return_counts=True)
        outer = points[every[first[count == 1]]]
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
    for tag in dict.fromkeys(item.tag for item in found.scene.displacements):
        axes.plot(*_nodes(found, tag, 0).T, "^", markersize=3, color="black", label=f"displacement {tag}")
    low, high = points.min(axis=0), points.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low)
