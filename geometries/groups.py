"""Groups that gmsh does not read: those of .unv files of I-DEAS in all data sets, and groups of nodes of MED."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hhr_dolfinx.compat import netcdf4

UNV_GROUPS = {"2429": 4, "2430": 4, "2432": 4, "2435": 2, "2452": 2, "2467": 2, "2477": 2}
"""Data sets of groups, with the number of values for a member: older ones lack two of them."""
_NODES = 7
_ELEMENTS = 8
"""Codes of the types of members."""


@dataclass(frozen=True, eq=False)
class Group:
    """A group of a .unv file: numbers of its elements and of its nodes."""

    elements: np.ndarray
    nodes: np.ndarray


def groups_of_unv(path: Path) -> dict[str, Group]:
    """Groups of a file by name; empty without any."""
    found: dict[str, Group] = {}
    lines = iter(path.read_text(errors="replace").splitlines())
    for line in lines:
        if line.strip() != "-1":
            continue
        kind = next(lines, "").strip()
        rows = _data_set(lines)
        if kind in UNV_GROUPS:
            found |= dict(_groups(rows, UNV_GROUPS[kind]))
    return found


def _data_set(lines: Iterator[str]) -> list[str]:
    """Lines up to the end of a data set."""
    found = []
    for line in lines:
        if line.strip() == "-1":
            break
        found.append(line)
    return found


def _groups(rows: list[str], width: int) -> Iterator[tuple[str, Group]]:
    """Names and members in a data set of groups, each with a head that ends in the count, a name, and members."""
    place = 0
    while place + 1 < len(rows):
        head = rows[place].split()
        count = int(head[-1])
        name = rows[place + 1].strip() or head[0]
        last = place + 2 + -(-count // width)
        words = [int(word) for line in rows[place + 2 : last] for word in line.split()]
        members = np.array(words, dtype=np.int64).reshape(count, -1)[:, :2]
        yield name, Group(*(members[members[:, 0] == code, 1] for code in (_ELEMENTS, _NODES)))
        place = last


def groups_of_nodes(path: Path, points: np.ndarray, numbers: np.ndarray) -> dict[str, np.ndarray]:
    """Nodes of the groups of nodes of a MED file, by name.

    netCDF4 does not read the names of groups. Salome names a family of nodes after its group if there is only one,
    ``FAM_3_name``; other groups have the name of the family.

    Args:
        path: path of the file.
        points: points as read by gmsh, (n, 3).
        numbers: numbers of the points in gmsh, (n,), in the order of the file.
    """
    netcdf = netcdf4(f"groups of nodes of {path}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            data = netcdf.Dataset(path)
        except OSError:
            return {}
        with data:
            data.set_auto_mask(False)
            order = np.argsort(numbers)
            found = _families_of_nodes(data, points[order])
            return {name: order[rows] for name, rows in found.items()}


def _families_of_nodes(data: Any, points: np.ndarray) -> dict[str, np.ndarray]:
    meshes = data["ENS_MAA"].groups if "ENS_MAA" in data.groups else {}
    for name, mesh in meshes.items():
        # a mesh without or with time steps
        step = mesh if "NOE" in mesh.groups else next(iter(mesh.groups.values()), mesh)
        nodes = step.groups.get("NOE")
        families = data["FAS"].groups.get(name) if "FAS" in data.groups else None
        if nodes is None or families is None or "NOEUD" not in families.groups or "FAM" not in nodes.variables:
            continue
        places = np.asarray(nodes["COO"][:]).reshape(-1, len(nodes["FAM"])).T
        if places.shape[0] != len(points) or not np.allclose(places, points[:, : places.shape[1]]):
            continue
        of = np.asarray(nodes["FAM"][:])
        return {_name_of(family): np.flatnonzero(of == group.NUM) for family, group in families["NOEUD"].groups.items()}
    return {}


def _name_of(family: str) -> str:
    """Name of the group after which a family is named."""
    head, _, rest = family.partition("_")
    number, _, name = rest.partition("_")
    return name if head == "FAM" and number.lstrip("-").isdigit() and name else family
