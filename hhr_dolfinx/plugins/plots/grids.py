"""Answers as data of PyVista: ``answer.to_pyvista()``, for notebooks and for pictures in space."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.models.answer import Answer, Meshed
from hhr_dolfinx.models.answer_mesh import AnswerMesh
from hhr_dolfinx.plugins.plots.contact_fields import gaps, is_full, statuses
from hhr_dolfinx.plugins.plots.facets import contact_facets
from hhr_dolfinx.plugins.plots.picture import contact_names, mesh_at
from hhr_dolfinx.plugins.plots.recovery import stress_samples
from hhr_dolfinx.plugins.plots.surface_fields import displacement_seen

# pictures only: without a display VTK would first look for an X server and print an error
if sys.platform == "linux" and "DISPLAY" not in os.environ:
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")

with extra("pictures", "answers in space"):
    import pyvista


def to_pyvista(answer: Answer, full: Meshed | None = None) -> pyvista.MultiBlock:
    """Bodies and contact surfaces of an answer as data of PyVista.

    Each body is a block named ``body <tag>`` with the arrays ``displacement``, and, where stress is
    known, ``von_mises`` and ``stress_kelvin`` at its nodes: xx, yy, zz, then sqrt(2) times xy, in
    space xy, xz, yz. Each contact is a block named by its surfaces, the slave surface with the
    arrays ``displacement``, ``contact_pressure``, ``gap`` and ``status`` (0 open, 1 closed, 2
    sliding). Nodes are undeformed; ``block.warp_by_vector("displacement", factor=10)`` moves them.

    In a notebook ``answer.to_pyvista().plot(scalars="von_mises", jupyter_backend="trame")`` can be
    turned with the mouse.

    Args:
        answer: answer of any model.
        full: the full model; not needed in the process that built the model, nor by a model from a
            file if the commands left the mesh beside it, ``scenery.npz``.

    Returns:
        A :class:`pyvista.MultiBlock`; lengths and stresses have the units of the scene.

    Raises:
        NotOfferedError: without a mesh, or for bodies that slide past their mesh.
        MissingPackageError: without PyVista.
    """
    meshed = answer._meshed(full, "data of PyVista need the mesh")
    mesh = mesh_at(meshed, answer.parameter)
    blocks = pyvista.MultiBlock()
    field = in_space(mesh.nodal(displacement_seen(answer)))
    mesh = with_values(mesh, field)
    samples = stress_samples(meshed, answer)
    for body, name in enumerate(_body_names(meshed, mesh)):
        grid = body_grid(mesh, body, mesh.points)
        nodes = grid.point_data["node"]
        grid.point_data["displacement"] = field[nodes]
        if samples is not None:
            stress = samples.at_nodes(body, len(mesh.points))[nodes]
            grid.point_data["von_mises"] = von_mises(stress)
            if not samples.deviators:
                grid.point_data["stress_kelvin"] = stress
        blocks.append(grid, name)
    values = {
        "contact_pressure": answer.pressure(meshed),
        "gap": gaps(answer, meshed),
        "status": statuses(answer, meshed).astype(float),
    }
    for contact, name in enumerate(contact_names(meshed)):
        surface = contact_surface(mesh, contact, mesh.points)
        nodes = surface.point_data["node"]
        surface.point_data["displacement"] = field[nodes]
        for key, of_conditions in values.items():
            surface.point_data[key] = at_slaves(mesh, contact, of_conditions)[nodes]
        blocks.append(surface, name)
    return blocks


def _body_names(meshed: Meshed, mesh: AnswerMesh) -> Iterator[str]:
    """Name of each body: its tag, of a file its index."""
    for body in range(int(mesh.bodies.max()) + 1):
        yield f"body {meshed.scene.bodies[body].tag if is_full(meshed) else body}"


def in_space(vectors: np.ndarray) -> np.ndarray:
    """Vectors of the plane or of space with three components, (n, 3)."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))


def with_values(mesh: AnswerMesh, field: np.ndarray) -> AnswerMesh:
    """The mesh without cells in which a field, (n, 3), is not known."""
    known = np.isfinite(field).all(axis=1)[mesh.cells].all(axis=1)
    return replace(mesh, cells=mesh.cells[known], bodies=mesh.bodies[known])


def at_slaves(mesh: AnswerMesh, contact: int, values: np.ndarray) -> np.ndarray:
    """Values of the conditions of a contact at their slave nodes.

    Args:
        mesh: the mesh.
        contact: index of the contact in the scene.
        values: of all conditions, (m,).

    Returns:
        Values of all nodes, (n,); NaN at other nodes.
    """
    of_nodes = np.full(len(mesh.points), np.nan)
    conditions = mesh.contacts[contact]
    of_nodes[mesh.slaves[conditions]] = values[conditions]
    return of_nodes


def body_grid(mesh: AnswerMesh, body: int, points: np.ndarray) -> pyvista.UnstructuredGrid:
    """Cells of a body at some positions of all nodes, (n, dim); ``node`` numbers its points.

    Args:
        mesh: the mesh.
        body: index of the body in the scene.
        points: positions of all nodes, (n, dim).
    """
    nodes, index = np.unique(mesh.cells[mesh.bodies == body], return_inverse=True)
    cells = index.reshape(-1, mesh.cells.shape[1])
    kinds = np.full(len(cells), mesh.kind, dtype=np.uint8)
    connected = np.insert(cells, 0, cells.shape[1], axis=1).ravel()
    grid = pyvista.UnstructuredGrid(connected, kinds, in_space(points[nodes]))
    grid.point_data["node"] = nodes
    return grid


def surface_of(points: np.ndarray, facets: np.ndarray) -> pyvista.PolyData:
    """Facets, (f, k), lines in the plane, at positions of all nodes, (n, dim).

    Args:
        points: positions of all nodes, (n, dim).
        facets: node numbers of the facets, (f, k).

    Returns:
        The surface; its point data ``node`` are node numbers of the mesh.
    """
    nodes, index = np.unique(facets, return_inverse=True)
    width = facets.shape[1]
    connected = np.insert(index.reshape(-1, width), 0, width, axis=1).ravel()
    positions = in_space(points[nodes])
    kind = {"lines": connected} if width == 2 else {"faces": connected}
    surface = pyvista.PolyData(positions, **kind)
    surface.point_data["node"] = nodes
    return surface


def contact_surface(mesh: AnswerMesh, contact: int, points: np.ndarray) -> pyvista.PolyData:
    """Slave surface of a contact at positions of all nodes, (n, dim); ``node`` numbers its points.

    Conditions at single nodes are points.

    Args:
        mesh: the mesh.
        contact: index of the contact in the scene.
        points: positions of all nodes, (n, dim).
    """
    facets = contact_facets(mesh, contact)
    if len(facets):
        return surface_of(points, facets)
    single = np.unique(mesh.slaves[mesh.contacts[contact]])
    cloud = pyvista.PolyData(in_space(points[single]))
    cloud.point_data["node"] = single
    return cloud
