"""Files of MED by gmsh, with groups of nodes, which gmsh does not read."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.compat import netcdf_read
from hhr_dolfinx.geometries.mesh_file import read_by_gmsh
from hhr_dolfinx.geometries.raw_mesh import RawMesh

if TYPE_CHECKING:
    from netCDF4 import Dataset


def read_med(path: Path) -> RawMesh:
    """Read a file of Salome, code_aster or gmsh.

    Raises:
        FileContentError: for a file without cells of one kind.
    """
    return read_by_gmsh(path, groups_of_nodes)


def groups_of_nodes(path: Path, points: np.ndarray, numbers: np.ndarray) -> dict[str, np.ndarray]:
    """Nodes of the groups of nodes of a MED file, by name.

    netCDF4 does not read the names of groups. Salome names a family of nodes after its group if
    there is only one, ``FAM_3_name``; other groups have the name of the family.

    Args:
        path: path of the file.
        points: points as read by gmsh, (n, 3).
        numbers: numbers of the points in gmsh, (n,), in the order of the file.
    """
    order = np.argsort(numbers)
    with ExitStack() as stack:
        try:
            data = stack.enter_context(netcdf_read(path, f"groups of nodes of {path}"))
        except OSError:
            return {}
        families = _families_of_nodes(data, points[order])
    return {name: order[rows] for name, rows in families.items()}


def _families_of_nodes(data: Dataset, points: np.ndarray) -> dict[str, np.ndarray]:
    meshes = data["ENS_MAA"].groups if "ENS_MAA" in data.groups else {}
    for name, mesh in meshes.items():
        # a mesh without or with time steps
        step = mesh if "NOE" in mesh.groups else next(iter(mesh.groups.values()), mesh)
        nodes = step.groups.get("NOE")
        families = data["FAS"].groups.get(name) if "FAS" in data.groups else None
        if (
            nodes is None
            or families is None
            or "NOEUD" not in families.groups
            or "FAM" not in nodes.variables
        ):
            continue
        coordinates = np.asarray(nodes["COO"][:]).reshape(-1, len(nodes["FAM"])).T
        if coordinates.shape[0] != len(points) or not np.allclose(
            coordinates, points[:, : coordinates.shape[1]]
        ):
            continue
        of = np.asarray(nodes["FAM"][:])
        return {
            _name_of(family): np.flatnonzero(of == group.NUM)
            for family, group in families["NOEUD"].groups.items()
        }
    return {}


def _name_of(family: str) -> str:
    """Name of the group after which a family is named."""
    head, _, numbered = family.partition("_")
    number, _, name = numbered.partition("_")
    return name if head == "FAM" and number.lstrip("-").isdigit() and name else family
