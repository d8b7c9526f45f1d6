"""Differences between DOLFINx distributions and versions, in one place.

The package imports it before other modules.

Nothing heavy is imported at the top, so that :mod:`solver_first` can order imports. Optional
packages are imported inside :func:`extra`.
"""

from __future__ import annotations

import importlib
import logging
import os
import platform
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

from hhr_dolfinx import solver_first
from hhr_dolfinx.errors import FileError, MissingPackageError, SceneError

if TYPE_CHECKING:
    import gmsh
    import numpy as np
    from basix.finite_element import FiniteElement as LagrangeElement
    from dolfinx.cpp.graph import AdjacencyList_int32
    from dolfinx.cpp.mesh import CellType
    from dolfinx.fem import FiniteElement
    from dolfinx.mesh import Mesh, MeshTags
    from mpi4py.MPI import Comm
    from netCDF4 import Dataset
    from ufl import Form
    from ufl.core.expr import Expr

    Shares = Callable[[np.ndarray, np.ndarray, int], np.ndarray]
    TaggedMesh = tuple[Mesh, MeshTags, MeshTags]
    """Result of a geometry: the mesh, the tags of its cells and of its facets.

    a :class:`NamedMesh` is one.
    """
    Partitioner = Callable[[Comm, int, list[CellType], list[np.ndarray]], AdjacencyList_int32]
    """Ranks of cells for DOLFINx, from the number of ranks, kinds and corners of cells."""
    Group = tuple[int, int | tuple[int, ...]]
    Groups = list[tuple[str | int, Group]]

T = TypeVar("T")
_log = logging.getLogger(__name__)
MINIMUM_DOLFINX = (0, 9)


if "dolfinx_solver" not in sys.modules:
    solver_first.install()


class NamedMesh(tuple):
    """Result of a geometry: a mesh, the tags of its cells and of its facets, and their names."""

    #: name, dimension and number or numbers of each group; a body and a surface may have the same
    #: name. Meshes of DOLFINx have them from 0.10 on
    physical_groups: Groups
    summary: Any  #: of the mesh file, a ``geometries.summary.Summary``; None without a file
    nodes: Mapping[
        str, np.ndarray
    ]  #: sets of nodes by name, as numbers of the points that the mesh was made of

    def __new__(
        cls,
        mesh: Mesh,
        cells: MeshTags,
        facets: MeshTags,
        groups: Groups,
        summary: object = None,
        nodes: Mapping[str, np.ndarray] | None = None,
    ) -> NamedMesh:
        """Make the tuple of mesh and tags."""
        named = super().__new__(cls, (mesh, cells, facets))
        named.physical_groups = groups
        named.summary = summary
        named.nodes = nodes or {}
        return named


@contextmanager
def extra(name: str, what: str) -> Iterator[None]:
    """Block of the imports of optional packages.

    Args:
        name: extra of this package that installs them.
        what: description of the request for the message.

    Raises:
        MissingPackageError: if a package is missing; the message names the extra.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingPackageError(
            f"{what} needs the package {error.name}, which is not installed: `pip install "
            f"hhr_dolfinx[{name}]`"
        ) from error


@contextmanager
def netcdf_read(path: Path, what: str) -> Iterator[Dataset]:
    """Open a netCDF or HDF5 file by netCDF4; arrays have no masks.

    Args:
        path: the file.
        what: description of the request for the message.

    Raises:
        OSError: for another file.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # netCDF4 warns of contents that it does not know
        with netcdf4(what).Dataset(path) as data:
            data.set_auto_mask(False)
            yield data


def netcdf4(what: str) -> ModuleType:
    """Import the package netCDF4, for ``what``.

    Its HDF5 differs from that of DOLFINx, whose symbols are global once PETSc is loaded. Unless
    each library resolves its symbols locally first, HDF5 files cannot be opened ("NetCDF: HDF
    error").
    """
    flags = sys.getdlopenflags() if hasattr(sys, "getdlopenflags") else None
    if flags is not None:
        sys.setdlopenflags(flags | getattr(os, "RTLD_DEEPBIND", 0))
    try:
        with extra("mesh", what):
            import netCDF4

            return netCDF4
    finally:
        if flags is not None:
            sys.setdlopenflags(flags)


SOLVER = frozenset({"dolfinx", "ufl", "basix", "petsc4py", "slepc4py", "mpi4py"})
"""Packages that are installed as a set: by conda, by a distribution, or by the wheel of the extra
``solver``.
"""
GET_DOLFINX = (
    "Install it with `pip install hhr_dolfinx[solver]` (x86-64 Linux, Python >= 3.12), or from "
    "conda-forge (`fenics-dolfinx`) or your distribution."
)


def explained(error: ModuleNotFoundError) -> ModuleNotFoundError | MissingPackageError:
    """Explain a failed import if it is one of DOLFINx's packages; models in files do not need
    them.
    """
    if (error.name or "").split(".")[0] not in SOLVER:
        return error
    return MissingPackageError(
        f"DOLFINx is not installed (no module {error.name}), and scenes, trainings and full "
        f"models need it. {GET_DOLFINX} Models that are read from files, load_model(path), answer "
        "without it."
    )


def require_dolfinx() -> None:
    """Check DOLFINx and its PETSc.

    Raises:
        MissingPackageError: without DOLFINx.
        ImportError: if it is too old, or if its PETSc uses complex numbers.
    """
    try:
        import dolfinx
    except ImportError as error:
        raise MissingPackageError(f"DOLFINx is not installed. {GET_DOLFINX}") from error
    version = tuple(int(number) for number in dolfinx.__version__.split(".")[:2])
    if version < MINIMUM_DOLFINX:
        raise ImportError(
            f"DOLFINx {dolfinx.__version__} is older than the required "
            f"{'.'.join(map(str, MINIMUM_DOLFINX))}; see the README for how to get a newer one."
        )
    import numpy as np
    from petsc4py import PETSc

    if np.iscomplexobj(PETSc.ScalarType(0)):
        raise ImportError(
            "this PETSc was built with complex numbers, and contact is a problem in real ones: "
            "install a real build, `petsc=*=real*` with conda or `petsc-real` with apt, or set "
            "PETSC_DIR and PETSC_ARCH to one"
        )
    # if only one rank initialises SLEPc, as in a reduction on one rank, PETSc waits forever for the
    # others at the end
    from slepc4py import SLEPc  # noqa: F401


def versions() -> dict[str, str]:
    """Versions of the packages that affect numbers, by name, for reports."""
    import dolfinx
    import numpy as np
    import petsc4py
    import slepc4py

    packages = {"dolfinx": dolfinx, "petsc": petsc4py, "slepc": slepc4py, "numpy": np}
    return {name: package.__version__ for name, package in packages.items()} | {
        "python": platform.python_version()
    }


def gmsh_to_mesh(
    model: type[gmsh.model], comm: Comm, gdim: int, shares: Shares | None = None
) -> NamedMesh:
    """Convert a gmsh model on rank 0 to a mesh with tags and the names of physical groups.

    Args:
        model: the model of gmsh, on rank 0.
        comm: communicator of the mesh.
        gdim: dimension of the space.
        shares: returns the rank of each cell from points, the corners of cells, and the number of
            ranks; by default DOLFINx partitions the mesh.

    Raises:
        SceneError: if DOLFINx does not take the cells.
    """
    try:
        module = importlib.import_module(
            "dolfinx.io.gmsh"
        )  # its result has more fields than that of gmshio
    except ModuleNotFoundError:  # up to 0.9
        module = importlib.import_module("dolfinx.io.gmshio")
    try:
        kinds = _kinds_of_cells(model) if comm.rank == 0 else set()
        if (
            comm.bcast(len(kinds)) > 1
        ):  # 0.9 accepts mixed kinds silently, and 0.11 makes a mesh without tags
            raise RuntimeError("they are of several kinds")
        points = (
            None if comm.rank > 0 or comm.size == 1 else module.extract_geometry(model)[:, :gdim]
        )
        partitioner = _partitioner(comm, points, shares)
        mesh, cell_tags, facet_tags = module.model_to_mesh(
            model, comm, 0, gdim=gdim, partitioner=partitioner
        )[:3]
    except (AssertionError, KeyError, RuntimeError) as error:
        raise SceneError(
            f"DOLFINx does not take the cells that gmsh made ({error}): mesh all bodies with one "
            "kind of cells, and those of second order with nodes in their middles too, "
            "Mesh.SecondOrderIncomplete = 0"
        ) from error
    named = (
        [(model.getPhysicalName(*group), group) for group in model.getPhysicalGroups()]
        if comm.rank == 0
        else []
    )
    groups: Groups = [(name, group) for name, group in named if name]
    return NamedMesh(mesh, cell_tags, facet_tags, comm.bcast(groups))


def _kinds_of_cells(model: type[gmsh.model]) -> set[int]:
    """Kinds of the elements of the highest dimension in physical groups, by gmsh's numbers."""
    groups = model.getPhysicalGroups()
    dim = max((group[0] for group in groups), default=0)
    entities = {
        entity
        for d, tag in groups
        if d == dim
        for entity in model.getEntitiesForPhysicalGroup(d, tag)
    }
    return {int(kind) for entity in entities for kind in model.mesh.getElements(dim, entity)[0]}


def jitted(compiler: Callable[..., T], *given: Form | Expr | np.ndarray) -> T:
    """Form or expression that FFCx compiles: ``compiler`` is ``fem.form`` or ``fem.Expression``.

    FFCx marks what it compiles by a file. If a run is killed meanwhile the file is left, and later
    runs wait for it.

    Raises:
        FileError: with the files to remove, if FFCx has waited in vain.
    """
    try:
        return compiler(*given)
    except (TimeoutError, RuntimeError) as error:  # on several ranks the latter
        from dolfinx.jit import get_options

        folder = Path(get_options()["cache_dir"])
        files = [
            path
            for path in folder.glob("libffcx_*.c")
            if not path.with_suffix(".c.cached").exists()
        ]
        if "JIT" not in str(error) or not files:
            raise
        raise FileError(
            "a form waits for another run that compiles it, or that was killed meanwhile "
            f"({error}). If no other run compiles now, remove {', '.join(map(str, files))}, and "
            "run again"
        ) from error


def interpolation_points(element: FiniteElement) -> np.ndarray:
    """Points of a DOLFINx element for interpolation: a method up to 0.9, a property from 0.10
    on.
    """
    points = element.interpolation_points
    return points() if callable(points) else points


def linear_mesh(
    comm: Comm,
    points: np.ndarray,
    cells: np.ndarray,
    kind: str,
    degree: int = 1,
    shares: Shares | None = None,
) -> Mesh:
    """Make a mesh in the plane or in space.

    The arguments of ``create_mesh`` changed their order in 0.10. Points and cells are the union of
    those on all ranks.

    Args:
        comm: communicator of the mesh.
        points: coordinates of the nodes, (n, dim).
        cells: nodes of the cells, (cells, k), in tensor order if there is a choice.
        kind: ``interval``, ``triangle``, ``quadrilateral``, ``tetrahedron`` or ``hexahedron``.
        degree: degree of the cells.
        shares: see :func:`gmsh_to_mesh`; for meshes on the first rank only.
    """
    import basix.ufl
    import ufl
    from dolfinx import mesh

    domain = ufl.Mesh(basix.ufl.element("Lagrange", kind, degree, shape=(points.shape[1],)))
    partitioner = _partitioner(comm, points, shares)
    return mesh.create_mesh(
        comm, cells=cells.astype("int64"), x=points, e=domain, partitioner=partitioner
    )


def _partitioner(
    comm: Comm, points: np.ndarray | None, shares: Shares | None
) -> Partitioner | None:
    """Partitioner for DOLFINx of a mesh on the first rank, with points there, (n, dim).

    None without ``shares``.
    """
    if comm.size == 1 or shares is None:
        return None
    import numpy as np
    from dolfinx import cpp, graph

    def partition(
        _: Comm, count: int, kinds: list[CellType], corners: list[np.ndarray]
    ) -> AdjacencyList_int32:
        """Graph of ranks of cells: ``count`` ranks, cells by ``kinds`` and ``corners``."""
        ranks_of_cells = [np.zeros(0, dtype="int32")]
        for kind, corner_table in zip(kinds, corners, strict=True):
            cells = corner_table.reshape(-1, cpp.mesh.cell_num_entities(kind, 0))
            ranks_of_cells.append(
                shares(points, cells, count)
                if points is not None and len(cells)
                else ranks_of_cells[0]
            )
        graph_of_ranks = graph.adjacencylist(np.concatenate(ranks_of_cells)[:, None])
        return getattr(graph_of_ranks, "_cpp_object", graph_of_ranks)

    return partition


def tags_of(mesh: Mesh, dim: int, entities: np.ndarray, values: np.ndarray) -> MeshTags:
    """Tags of entities of a mesh.

    Entities and tags are the union of those on all ranks.

    Args:
        mesh: the mesh.
        dim: dimension of the entities.
        entities: their nodes in the numbering of the input of the mesh, (n, k).
        values: their tags, (n,).
    """
    from dolfinx import graph, io
    from dolfinx.mesh import meshtags_from_entities

    distribute = getattr(io, "distribute_entity_data", None) or io.utils.distribute_entity_data
    local, tags = distribute(mesh, dim, entities.astype("int64"), values.astype("int32"))
    mesh.topology.create_connectivity(dim, mesh.topology.dim)
    return meshtags_from_entities(
        mesh, dim, graph.adjacencylist(local), tags.astype("int32", copy=False)
    )


def geometry_dofmap(mesh: Mesh) -> np.ndarray:
    """Nodes of each cell in ``mesh.geometry.x``; ``dofmap`` is deprecated from 0.11 on."""
    geometry = mesh.geometry
    return geometry.dofmaps[0] if hasattr(geometry, "dofmaps") else geometry.dofmap


def degree_of(mesh: Mesh) -> int:
    """Degree of the cells of a mesh; ``cmap`` is deprecated from 0.11 on."""
    geometry = mesh.geometry
    return (geometry.cmaps[0] if hasattr(geometry, "cmaps") else geometry.cmap).degree


def quadrature(cell: str, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights of DOLFINx's quadrature rule on a reference cell.

    Args:
        cell: name of the cell.
        degree: degree of the rule.
    """
    import basix

    return basix.make_quadrature(basix.CellType[cell], degree)


def shape_functions(
    cell: str, points: np.ndarray, degree: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Lagrange functions of a reference cell, (q, k), and their slopes, (q, k, dim).

    Args:
        cell: name of the cell.
        points: reference coordinates, (q, dim).
        degree: degree of the functions.
    """
    table = _lagrange(cell, degree).tabulate(1, points)[..., 0]
    return table[0], table[1:].transpose(1, 2, 0).copy()


def topology(cell: str) -> tuple[list[list[int]], list[list[int]]]:
    """Corners of the edges and of the faces of a reference cell, in the order of DOLFINx."""
    import basix

    entities = basix.topology(basix.CellType[cell])
    return entities[1], entities[2]


def nodes_of_cell(cell: str, degree: int) -> np.ndarray:
    """Reference coordinates of the nodes of a cell, (k, dim).

    Args:
        cell: name of the cell.
        degree: degree of its functions.
    """
    return _lagrange(cell, degree).points


def _lagrange(cell: str, degree: int) -> LagrangeElement:
    """The default Lagrange element of DOLFINx: up to degree 2 all variants have the same nodes."""
    import basix

    variant = basix.LagrangeVariant.gll_warped
    return basix.create_element(basix.ElementFamily.P, basix.CellType[cell], degree, variant)


def require_numba() -> None:
    """Raise MissingPackageError without numba: loops over whole meshes would take hours as
    Python.
    """
    with extra("flow", "a scene whose bodies have laws or are nearly incompressible"):
        import numba  # noqa: F401
