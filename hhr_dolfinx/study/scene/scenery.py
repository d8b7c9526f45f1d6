"""What a page draws of a scene, from its full model: triangles to look at, places of contact, words."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.geometries.cells import CORNERS, TENSOR, outer_faces
from hhr_dolfinx.pages.scenery import Scenery
from hhr_dolfinx.scene import Scene

PARTS = {3: ((0, 1, 2),), 4: ((0, 1, 2), (0, 2, 3))}
"""Triangles of a triangle, and of a quadrilateral whose corners go round."""


def scenery_of(full: Any) -> Scenery:
    """What a page draws of the scene of a full model, on one rank.

    In the plane all cells, in space faces of cells that no other cell shares. Of cells of second order the corners.
    """
    discretisation = full.discretisation
    problem = full.problem
    kind = discretisation.mesh.topology.cell_name()
    cells = discretisation._cell_nodes()[:, : CORNERS[kind]]
    flat = problem.block_size == 2
    cells = cells[:, TENSOR[kind]] if kind in TENSOR else cells  # corners go round
    outer = outer_faces(kind, cells)
    faces = cells if flat else outer
    triangles = np.concatenate([faces[:, list(corners)] for corners in PARTS[faces.shape[1]]])
    nodes, places = np.unique(triangles, return_inverse=True)
    number = np.full(len(discretisation._points()), -1)
    number[nodes] = np.arange(len(nodes))
    drawn = number[outer] if flat else np.zeros((0, 2))
    return Scenery(
        np.ascontiguousarray(discretisation._points()[nodes]),
        nodes.astype(np.int64),
        places.reshape(triangles.shape).astype(np.int64),
        drawn.astype(np.int64),
        np.ascontiguousarray(problem.contact_points),
        problem.contact_areas.copy(),
        problem.contact_pairs.astype(np.int64),
        problem.contact @ full.pushed_everywhere(np.ones(full.conditions)),
        bool(full.scene.shapes),
        _words(full.scene),
    )


def _words(scene: Scene) -> dict[str, Any]:
    """What a page says of a scene."""
    units = scene.units
    bodies = []
    for body in scene.bodies:
        law = "" if body.law is None else f", {body.law!r}"
        bodies.append(f"{body.tag}: E = {_said(body.young)}, nu = {_said(body.poisson)}{law}")
    return {
        "scene": scene.name,
        "units": dict(scene.parameter_units),
        "hypothesis": scene.hypothesis.replace("_", " "),
        "bodies": bodies,
        "contacts": [" and ".join(map(str, item.tags)) for item in scene.contacts],
        "length": "" if units is None else units.length,
        "stress": "" if units is None else units.stress,
    }


def _said(value: Any) -> str:
    """A number or a formula in words."""
    return f"{value:g}" if isinstance(value, float | int) else str(getattr(value, "text", value))
