"""Meshes made by gmsh, which is one for the whole process: a session and models of the user's stay as they were."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from hhr_dolfinx.compat import extra, gmsh_to_mesh

with extra("mesh", "this geometry"):
    import gmsh

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.compat import TaggedMesh

__all__ = ["gmsh", "mesh_of"]

_OPTIONS = {"General.Terminal": 0.0}


def mesh_of(make: Callable[[], None], comm: Comm, dim: int, options: Mapping[str, float] | None = None) -> TaggedMesh:
    """Let gmsh mesh a model of its own on the first rank and share it out.

    Args:
        make: fills and meshes the current model of gmsh, on the first rank; what model is current then is shared.
        comm: MPI communicator.
        dim: dimension of the mesh, and of its points.
        options: of gmsh, as long as the model lives.
    """
    with _session({**_OPTIONS, **(options or {})}):
        if comm.rank == 0:
            make()
        return gmsh_to_mesh(gmsh.model, comm, gdim=dim)


def converted(path: Path, target: Path) -> Path:
    """A mesh file of another program as gmsh's own, with its groups."""
    with _session(_OPTIONS):
        gmsh.merge(str(path))
        gmsh.write(str(target))
    return target


@contextmanager
def _session(options: Mapping[str, float]) -> Iterator[None]:
    """A new model that is current; whoever uses gmsh already gets back options, models and the current one."""
    if not gmsh.isInitialized():
        gmsh.initialize()
        try:
            _set(options)
            yield
        finally:
            gmsh.finalize()
        return
    before = {name: gmsh.option.getNumber(name) for name in options}
    others, current = gmsh.model.list(), gmsh.model.getCurrent()
    gmsh.model.add("hhr_dolfinx")
    try:
        _set(options)
        yield
    finally:
        # new models are added behind those that are there
        for name in gmsh.model.list()[len(others) :]:
            gmsh.model.setCurrent(name)
            gmsh.model.remove()
        gmsh.model.setCurrent(current)
        _set(before)


def _set(options: Mapping[str, float]) -> None:
    for name, value in options.items():
        gmsh.option.setNumber(name, value)
