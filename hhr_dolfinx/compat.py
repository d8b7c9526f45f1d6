"""What differs between DOLFINx distributions and versions, in one place.

The wheel ``dolfinx-solver-real`` wants ``import dolfinx_solver`` before dolfinx, mpi4py
or petsc4py; conda and apt have no such module. The package imports this module before any
other, so the rest of it need not know. Nothing heavy is imported at the top.
"""

from __future__ import annotations

import importlib
import importlib.util

MINIMUM_DOLFINX = (0, 9)

if importlib.util.find_spec("dolfinx_solver") is not None:
    importlib.import_module("dolfinx_solver")


def require_dolfinx() -> None:
    """Check that DOLFINx is there and recent enough, and PETSc built with real numbers.

    Raises:
        ImportError: with what to install.
    """
    try:
        import dolfinx
    except ImportError as error:
        raise ImportError(
            "DOLFINx is not installed. Install it with `pip install hhr_dolfinx[solver]` "
            "(x86-64 Linux, Python >= 3.12), or from conda-forge (`fenics-dolfinx`) or your distribution."
        ) from error
    version = tuple(int(part) for part in dolfinx.__version__.split(".")[:2])
    if version < MINIMUM_DOLFINX:
        raise ImportError(
            f"DOLFINx {dolfinx.__version__} is older than the required "
            f"{'.'.join(map(str, MINIMUM_DOLFINX))}; see the README for how to get a newer one."
        )
    import numpy as np
    from petsc4py import PETSc

    if np.iscomplexobj(PETSc.ScalarType(0)):
        raise ImportError(
            "this PETSc was built with complex numbers, and contact is a problem in real ones: install a real build, "
            "`petsc=*=real*` with conda or `petsc-real` with apt, or set PETSC_DIR and PETSC_ARCH to one"
        )
    # where one rank alone starts SLEPc, as when it alone reduces, the run never ends: the end of PETSc waits for all
    from slepc4py import SLEPc  # noqa: F401


def gmsh_to_mesh(model, comm, gdim: int):
    """Turn a gmsh model held by rank 0 into ``(mesh, cell_tags, facet_tags)``.

    The module is ``dolfinx.io.gmshio`` up to 0.9 and ``dolfinx.io.gmsh`` from 0.10 on,
    where the result is a named tuple with more fields.
    """
    try:
        module = importlib.import_module("dolfinx.io.gmsh")
    except ModuleNotFoundError:
        module = importlib.import_module("dolfinx.io.gmshio")
    result = module.model_to_mesh(model, comm, 0, gdim=gdim)
    return tuple(result[:3])


def interpolation_points(element):
    """Points of a DOLFINx element for interpolation: a method up to 0.9, a property from 0.10 on."""
    points = element.interpolation_points
    return points() if callable(points) else points


def linear_mesh(comm, points, cells, kind: str):
    """Linear mesh in the plane or in space; the arguments of ``create_mesh`` changed their order in 0.10.

    Args:
        comm: MPI communicator.
        points: (n, dim), on all ranks together.
        cells: nodes of each cell, tensor-ordered where there is a choice, on all ranks together.
        kind: ``interval``, ``triangle``, ``quadrilateral``, ``tetrahedron`` or ``hexahedron``.
    """
    import basix.ufl
    import ufl
    from dolfinx import mesh

    domain = ufl.Mesh(basix.ufl.element("Lagrange", kind, 1, shape=(points.shape[1],)))
    return mesh.create_mesh(comm, cells=cells.astype("int64"), x=points, e=domain)


def bounding_boxes(mesh, padding: float = 0.0):
    """DOLFINx's bounding-volume tree of the cells of a mesh on one rank, and the numbers of these cells."""
    import numpy as np
    from dolfinx import geometry

    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    return geometry.bb_tree(mesh, mesh.topology.dim, entities=cells, padding=padding), cells


def closest_cells(mesh, points):
    """Index of the cell closest to each point, (m,).

    Args:
        mesh: mesh on one rank.
        points: (m, 3).
    """
    from dolfinx import geometry

    tree, cells = bounding_boxes(mesh)
    middles = geometry.create_midpoint_tree(mesh, mesh.topology.dim, cells)
    return geometry.compute_closest_entity(tree, middles, mesh, points)


def meeting_cells(first, second, padding: float):
    """Pairs of cells of two meshes on one rank whose bounding boxes meet, (p, 2), the first ones enlarged."""
    from dolfinx import geometry

    return geometry.compute_collisions_trees(bounding_boxes(first, padding)[0], bounding_boxes(second)[0])


def geometry_dofmap(mesh):
    """Nodes of each cell in ``mesh.geometry.x``; ``dofmap`` is on its way out from 0.11 on."""
    geometry = mesh.geometry
    return geometry.dofmaps[0] if hasattr(geometry, "dofmaps") else geometry.dofmap


def quadrature(mesh, degree: int):
    """Points and weights of DOLFINx's rule of a degree on the reference cell."""
    import basix

    return basix.make_quadrature(basix.CellType[mesh.topology.cell_name()], degree)


def compiled(**options):
    """numba's ``njit`` with a cache on disk, or without one where no place can be written."""
    from numba import njit

    def decorate(function):
        try:
            return njit(cache=True, **options)(function)
        except RuntimeError:
            return njit(**options)(function)

    return decorate
