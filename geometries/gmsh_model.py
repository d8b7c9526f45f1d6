"""Meshes made by gmsh, whose state is global to the process: session and models of the user are
restored.
"""

from __future__ import annotations

import signal
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.compat import extra, gmsh_to_mesh
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries.partition import shares

with extra("mesh", "this geometry"):
    import gmsh

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.compat import TaggedMesh

__all__ = ["gmsh", "mesh_of"]

_OPTIONS = {"General.Terminal": 0.0, "General.AbortOnError": 2.0}  # silent, and errors raise


def mesh_of(
    make: Callable[[], None], comm: Comm, dim: int, options: Mapping[str, float] | None = None
) -> TaggedMesh:
    """Mesh a new gmsh model on the first rank and distribute the mesh.

    Args:
        make: function that fills and meshes the current model of gmsh, on the first rank; the model
            that is current afterwards is distributed.
        comm: MPI communicator.
        dim: dimension of the mesh, and of its points.
        options: options of gmsh during this call.

    Raises:
        SceneError: for facets that do not belong to the cells.
    """
    with _session({**_OPTIONS, **(options or {})}):
        if comm.rank == 0:
            _check_that_it_meshes()
            make()
        if comm.bcast(comm.rank == 0 and _facets_without_cells()):
            raise SceneError(
                "facets that gmsh made have nodes that no cell has, which DOLFINx does not "
                "survive: they do not fit the cells, as with automatic transfinite tetrahedra. "
                "Recombine to hexahedra, or leave that out"
            )
        return gmsh_to_mesh(gmsh.model, comm, dim, shares)


def _check_that_it_meshes() -> None:
    """Mesh a line in the current model as a test, and remove it.

    Raises:
        SceneError: if nothing is meshed: up to 4.13 gmsh stays locked after a mesh that failed.
    """
    line = gmsh.model.geo.addLine(
        gmsh.model.geo.addPoint(0, 0, 0), gmsh.model.geo.addPoint(1, 0, 0)
    )
    gmsh.model.geo.synchronize()
    gmsh.model.mesh.generate(1)
    done = bool(gmsh.model.mesh.getElements(1, line)[0].size)
    gmsh.model.mesh.clear()
    gmsh.model.geo.remove([(1, line)], recursive=True)
    gmsh.model.geo.synchronize()
    if not done:
        raise SceneError(
            f"gmsh {gmsh.GMSH_API_VERSION} meshes nothing in this session any more, since a mesh "
            "in it has failed: call gmsh.finalize(), gmsh.initialize(), and make your models anew"
        )


def knows_med() -> bool:
    """True if this gmsh reads and writes MED; the package of Debian does not."""
    with _session(_OPTIONS):
        return "Med" in gmsh.option.getString("General.BuildOptions").split()


def _facets_without_cells() -> bool:
    """True if facets of physical groups in the current model have nodes that belong to no cell of
    such groups.
    """
    groups = gmsh.model.getPhysicalGroups()
    dim = max((group[0] for group in groups), default=0)

    def nodes_of(wanted: int) -> np.ndarray:
        entities = {
            entity
            for d, tag in groups
            if d == wanted
            for entity in gmsh.model.getEntitiesForPhysicalGroup(d, tag)
        }
        blocks = [
            nodes for entity in entities for nodes in gmsh.model.mesh.getElements(wanted, entity)[2]
        ]
        return np.unique(np.concatenate([np.zeros(0, dtype=np.uint64), *blocks]))

    return bool(np.setdiff1d(nodes_of(dim - 1), nodes_of(dim)).size)


@dataclass(frozen=True, eq=False)
class Entity:
    """Elements of one kind of a geometrical entity.

    Attributes:
        dim: dimension of the elements.
        corners: rows of the nodes of their corners, (n, k).
        nodes: rows of all their nodes, (n, K).
        groups: number and name of the physical groups of the entity; empty if there is no name.
        tag: number of the entity.
    """

    dim: int
    corners: np.ndarray
    nodes: np.ndarray
    groups: tuple[tuple[int, str], ...]
    tag: int


def entities_of(path: Path) -> tuple[np.ndarray, np.ndarray, list[Entity]]:
    """Read a mesh file by gmsh: points, (n, 3), their numbers, (n,), and elements."""
    with _session(_OPTIONS):
        gmsh.merge(str(path))
        numbers, coordinates, _ = gmsh.model.mesh.getNodes()
        row_of = np.full(int(numbers.max(initial=0)) + 1, -1)
        row_of[numbers.astype(np.int64)] = np.arange(numbers.size)
        entities = []
        for dim, tag in gmsh.model.getEntities():
            # a group with reversed orientation has a negative number there
            group_numbers = (
                np.unique(np.abs(gmsh.model.getPhysicalGroupsForEntity(dim, tag)))
                .astype(int)
                .tolist()
            )
            groups = tuple(
                (number, gmsh.model.getPhysicalName(dim, number).strip())
                for number in group_numbers
            )
            kinds, _, nodes = gmsh.model.mesh.getElements(dim, tag)
            for kind, node_numbers in zip(kinds, nodes, strict=True):
                _, _, _, count, _, corners = gmsh.model.mesh.getElementProperties(kind)
                element_nodes = row_of[node_numbers.astype(np.int64).reshape(-1, count)]
                entities.append(Entity(dim, element_nodes[:, :corners], element_nodes, groups, tag))
        return coordinates.reshape(-1, 3), numbers.astype(np.int64), entities


@contextmanager
def _session(options: Mapping[str, float]) -> Iterator[None]:
    """Make a new model current; at the end restore options, models and the current model of other
    users of gmsh.
    """
    if not gmsh.isInitialized():
        _initialised()
        try:
            _set(options)
            yield
        finally:
            gmsh.finalize()
        return
    previous = gmsh.model.list()
    current = gmsh.model.getCurrent()
    with _default_options():
        gmsh.model.add("hhr_dolfinx")
        try:
            _set(options)
            yield
        finally:
            # gmsh appends new models to its list
            for name in gmsh.model.list()[len(previous) :]:
                gmsh.model.setCurrent(name)
                gmsh.model.remove()
            gmsh.model.setCurrent(current)


@contextmanager
def _default_options() -> Iterator[None]:
    """Reset all options to their defaults, as others change meshes.

    Restore those of the user at the end.
    """
    before = {name: gmsh.option.getNumber(name) for name in _OPTIONS}
    with tempfile.TemporaryDirectory() as folder:
        saved = str(Path(folder) / "of_the_user.opt")
        _set(_OPTIONS)
        gmsh.write(saved)  # options that differ from the defaults, a few lines
        gmsh.option.restoreDefaults()
        try:
            yield
        finally:
            gmsh.option.restoreDefaults()
            _set(_OPTIONS)
            gmsh.merge(saved)
            _set(before)


def _initialised() -> None:
    """Start gmsh, and restore the handler of Ctrl-C that it replaces."""
    main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGINT) if main else None
    gmsh.initialize()
    if before is not None:
        signal.signal(signal.SIGINT, before)


def _set(options: Mapping[str, float]) -> None:
    for name, value in options.items():
        gmsh.option.setNumber(name, value)
