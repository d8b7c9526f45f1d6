"""Scenery of a page: the mesh to draw, points of contact, and names.

A model in a file has no mesh. Its scenery is a separate file next to it, ``scenery.npz``: plain
data like the model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.files import read_arrays, write_arrays

SCENERY_FORMAT = "hhr scenery"
"""Content of a file, in its header."""
SCENERY_VERSION = 2
"""Version of this format."""
SCENERY_FILE = "scenery.npz"
"""Name of the file next to a model."""
_ROWS = ("data", "indices", "indptr")
_MESH = ("all_points", "all_cells", "cell_bodies", "slaves", "pressing")
_NAMES_OF_MESH = ("kind", "parameters")
_ARRAYS = (
    "points",
    "nodes",
    "triangles",
    "lines",
    "contact_points",
    "areas",
    "pairs",
    "compliance",
)


@dataclass(frozen=True, eq=False)
class Strains:
    """Data to compute von Mises' stress of cells from a displacement."""

    cells: np.ndarray  #: index of the cell of each drawn triangle, (t,)
    bodies: np.ndarray  #: body of each cell, (c,)
    #: strain at the middles of the cells times the grading of their moduli, Kelvin's notation, cell
    #: by cell, (4 c, N), in space (6 c, N); the out-of-plane strain is zero in plane stress
    rows: csr_matrix
    moduli: tuple[tuple[str, str], ...]  #: λ' and μ' of each body as formulas of the parameters
    plane_stress: bool  #: True if the out-of-plane stress is zero

    @property
    def components(self) -> int:
        """Number of components of a strain."""
        return self.rows.shape[0] // max(len(self.bodies), 1)

    def of_triangles(self, triangles: np.ndarray) -> Strains:
        """Strains of some triangles."""
        selected, cells = np.unique(self.cells[triangles], return_inverse=True)
        rows = (selected[:, None] * self.components + np.arange(self.components)).ravel()
        return replace(
            self, cells=cells, bodies=self.bodies[selected], rows=csr_matrix(self.rows[rows])
        )

    @property
    def dofs(self) -> int:
        """Number of dofs of the displacement."""
        return int(self.rows.shape[1])

    def fault(self, triangles: int, bodies: int) -> str:
        """Description of an inconsistency, or an empty text.

        Args:
            triangles: number of drawn triangles.
            bodies: number of bodies of the scene.
        """
        count = len(self.bodies)
        kinds = self.cells.dtype.kind + self.bodies.dtype.kind
        if set(kinds) - set("iu") or self.bodies.ndim != 1 or not count:
            return "cells and bodies of strains are no whole numbers"
        fits = (
            self.cells.shape == (triangles,) and self.rows.shape[0] == count * self.components > 0
        )
        in_range = fits and 0 <= self.cells.min() <= self.cells.max() < count
        if (
            not in_range
            or self.components not in (4, 6)
            or not 0 <= self.bodies.min() <= self.bodies.max() < bodies
        ):
            return "strains do not fit the triangles"
        return "" if np.isfinite(self.rows.data).all() else "strains are not finite"


@dataclass(frozen=True, eq=False)
class WholeMesh:
    """All nodes and cells of a mesh, for figures and files of fields.

    Its other names and points are the scenery's.
    """

    all_points: np.ndarray  #: coordinates of all nodes, (n, dim)
    all_cells: np.ndarray  #: their nodes in the order of VTK, (c, k)
    cell_bodies: np.ndarray  #: body of each cell, (c,)
    slaves: np.ndarray  #: node that carries each condition, (m,)
    pressing: np.ndarray  #: conditions of pressures, (m,) bool
    kind: int  #: VTK's number of the kind of cell
    parameters: tuple[str, ...]
    contact_rows: csr_matrix | None = None  #: B with imposed dofs, (m, N); None in earlier files
    gap_terms: np.ndarray | None = None  #: gaps of undeformed bodies along θ, (m, 1 + T)

    def fault(self, conditions: int, dim: int) -> str:
        """Description of an inconsistency, or an empty text.

        Args:
            conditions: number of contact conditions.
            dim: dimension of space.
        """
        wholes = [self.all_cells, self.cell_bodies, self.slaves]
        if any(array.dtype.kind not in "iu" for array in wholes) or self.pressing.dtype.kind != "b":
            return "numbers of nodes, bodies or conditions are no whole numbers"
        shapes = (
            self.all_points.shape[1:],
            self.slaves.shape,
            self.pressing.shape,
            self.cell_bodies.shape,
        )
        fits = (
            shapes == ((dim,), (conditions,), (conditions,), (len(self.all_cells),))
            and self.all_cells.ndim == 2
        )
        numbers = np.concatenate([self.all_cells.ravel(), self.slaves])
        fits = fits and 0 <= numbers.min(initial=0) <= numbers.max(initial=0) < len(self.all_points)
        if not fits:
            return "cells or conditions of the whole mesh name nodes that are not there"
        if self.contact_rows is None or self.gap_terms is None:
            return ""
        fits = self.contact_rows.shape == (conditions, self.all_points.size)
        fits = fits and self.gap_terms.ndim == 2 and len(self.gap_terms) == conditions
        fits = fits and bool(np.isfinite(self.contact_rows.data).all())
        fits = fits and bool(np.isfinite(self.gap_terms).all())
        return "" if fits else "gaps do not fit the contact conditions"


class SceneWords(TypedDict):
    """Names, units and descriptions of a scene."""

    scene: str
    units: dict[str, str]
    hypothesis: str
    bodies: list[str]
    contacts: list[str]
    length: str
    stress: str
    force: str
    work: str


@dataclass(frozen=True)
class Scenery:
    """Mesh, contact points and names of a scene, to draw them.

    Attributes:
        points: coordinates of the drawn nodes, (n, dim).
        nodes: their numbers among all nodes of the model, (n,).
        triangles: their nodes, as indices into the drawn nodes, (t, 3).
        lines: edges of the surface, also as indices into the drawn nodes, (l, 2); none in space.
        contact_points: points of the contact conditions, (m, dim).
        areas: of the conditions, (m,).
        pairs: contact of each condition, the first of several, (m,).
        shares: condition, contact and its share, of conditions that several contacts state, (k, 3).
        compliance: S times ones at the middle of the box, (m,), to check that model and scenery are
            of one scene; where contact alone holds bodies with laws, :func:`compliance_of`.
        moves: True if shapes are parameters: areas are then those at the middle of the box.
        strains: of the drawn cells; None if their stress does not follow from displacements alone.
        owners: cell of each triangle in an inelastic model, (t,), set by the model; else None.
        mesh: all nodes and cells; None in files of earlier releases.
        words: ``scene``, ``contacts`` (a name for each), ``bodies`` (a line for each),
            ``hypothesis``, ``length``, ``stress``, ``force`` and ``work`` (units, or nothing),
            ``units`` of parameters by name.
    """

    points: np.ndarray
    nodes: np.ndarray
    triangles: np.ndarray
    lines: np.ndarray
    contact_points: np.ndarray
    areas: np.ndarray
    pairs: np.ndarray
    shares: np.ndarray
    compliance: np.ndarray
    moves: bool
    words: SceneWords
    strains: Strains | None = None
    owners: np.ndarray | None = None
    mesh: WholeMesh | None = None

    def write(self, path: str | Path) -> None:
        """Write it to a file."""
        arrays = {name: getattr(self, name) for name in (*_ARRAYS, "shares")}
        header = {
            "format": SCENERY_FORMAT,
            "version": SCENERY_VERSION,
            "words": self.words,
            "moves": self.moves,
        }
        if self.strains is not None:
            strains = self.strains
            header |= {
                "moduli": strains.moduli,
                "plane_stress": strains.plane_stress,
                "dofs": strains.rows.shape[1],
            }
            arrays |= {"cells": strains.cells, "bodies": strains.bodies}
            arrays |= {name: getattr(strains.rows, name) for name in _ROWS}
        if self.mesh is not None:
            header["mesh"] = {name: getattr(self.mesh, name) for name in _NAMES_OF_MESH}
            arrays |= {name: getattr(self.mesh, name) for name in _MESH}
            if self.mesh.contact_rows is not None and self.mesh.gap_terms is not None:
                rows = self.mesh.contact_rows
                arrays |= {f"contact_{name}": getattr(rows, name) for name in _ROWS}
                arrays |= {"gap_terms": self.mesh.gap_terms}
        write_arrays(path, header, arrays)

    @classmethod
    def read(cls, path: str | Path) -> Scenery:
        """Read a scenery from a file.

        Raises:
            FileNotFoundError: if there is no file.
            FileContentError: if it is damaged, or not a scenery.
        """
        header, arrays = read_arrays(path, SCENERY_FORMAT, SCENERY_VERSION)
        if missing := set(_ARRAYS) - set(arrays):
            raise FileContentError(f"{path} is damaged: {', '.join(sorted(missing))} are missing")
        fields = {name: arrays[name] for name in _ARRAYS} | {
            "shares": arrays.get("shares", np.zeros((0, 3)))
        }
        try:
            strains = _strains(header, arrays) if "moduli" in header else None
            mesh = _mesh(header["mesh"], arrays) if "mesh" in header else None
        except (KeyError, TypeError, ValueError) as error:
            raise FileContentError(
                f"{path} is damaged: its strains or its mesh are not whole ({error})"
            ) from error
        scenery = cls(
            **fields,
            moves=bool(header.get("moves")),
            words=header.get("words", {}),
            strains=strains,
            mesh=mesh,
        )
        if fault := scenery._fault():
            raise FileContentError(f"{path} is damaged: {fault}")
        return scenery

    def _fault(self) -> str:
        """Description of an inconsistency, or an empty text."""
        count = len(self.points)
        wholes = [self.nodes, self.triangles, self.lines, self.pairs]
        if any(array.dtype.kind not in "iu" for array in wholes) or (
            count and self.nodes.min(initial=0) < 0
        ):
            return "numbers of nodes or contacts are no whole numbers"
        if (
            self.points.ndim != 2
            or self.points.shape[1] not in (2, 3)
            or self.nodes.shape != (count,)
        ):
            return "points and nodes do not fit"
        for name, width in (("triangles", 3), ("lines", 2)):
            array = getattr(self, name)
            in_range = not array.size or 0 <= array.min() <= array.max() < count
            if array.ndim != 2 or array.shape[1] != width or not in_range:
                return f"{name} name nodes that are not there"
        m = len(self.areas)
        shapes = (
            self.contact_points.shape,
            self.pairs.shape,
            self.compliance.shape,
            self.shares.shape[1:],
        )
        if shapes != ((m, self.points.shape[1]), (m,), (m,), (3,)):
            return "places of contact do not fit"
        if not np.isin(self.shares[:, 0], np.arange(m)).all():
            return "shares name conditions that are not there"
        named = isinstance(self.words, dict) and isinstance(self.words.get("scene"), str)
        named = named and len(self.words.get("contacts", ())) > self.pairs.max(initial=-1)
        if not named or not isinstance(self.moves, bool):
            return "it has no words"
        if self.mesh is not None and (fault := self.mesh.fault(m, self.points.shape[1])):
            return fault
        strains = self.strains
        return "" if strains is None else strains.fault(len(self.triangles), len(strains.moduli))


def _mesh(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> WholeMesh:
    """Whole mesh of a file; :meth:`WholeMesh.fault` reports an invalid one."""
    names = tuple(str(name) for name in header["parameters"])
    fields = {name: arrays[name] for name in _MESH}
    gaps = arrays.get("gap_terms")
    rows = None
    if gaps is not None:
        entries = tuple(arrays[f"contact_{name}"] for name in _ROWS)
        rows = csr_matrix(entries, shape=(len(fields["slaves"]), fields["all_points"].size))
        rows.check_format()
    kind = int(header["kind"])
    return WholeMesh(**fields, kind=kind, parameters=names, contact_rows=rows, gap_terms=gaps)


def _strains(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> Strains:
    """Strains of a file; SciPy or :meth:`Strains.fault` reports invalid ones."""
    shape = arrays["indptr"].size - 1, int(header["dofs"])
    rows = csr_matrix(tuple(arrays[name] for name in _ROWS), shape=shape)
    rows.check_format()
    moduli = tuple((str(volume), str(shape)) for volume, shape in header["moduli"])
    if not isinstance(header["plane_stress"], bool):
        raise ValueError("plane_stress is neither true nor false")
    return Strains(arrays["cells"], arrays["bodies"], rows, moduli, bool(header["plane_stress"]))


def thinned(scenery: Scenery, most: int) -> Scenery:
    """Scenery with at most ``most`` nodes, for meshes that are finer than a screen shows.

    Nodes of one body in the same square (cube) are merged into one of them, on the outline if
    possible.

    Args:
        scenery: drawn mesh and contact of the scene.
        most: largest number of nodes.
    """
    if len(scenery.points) <= most:
        return scenery
    rows, columns = np.concatenate([scenery.triangles[:, :2], scenery.triangles[:, 1:]]).T
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=2 * (len(scenery.points),))
    bodies = connected_components(graph, directed=False)[1]
    low = scenery.points.min(axis=0)
    size = float(np.ptp(scenery.points, axis=0).max())
    count = int(4 * most**0.5)  # squares across; fewer until few enough contain a node
    while True:
        squares = np.floor((scenery.points - low) / size * count).astype(np.int64)
        _, square = np.unique(np.column_stack([bodies, squares]), axis=0, return_inverse=True)
        if square.max() < most:
            break
        count = int(0.9 * count)
    inner = np.ones(len(square), dtype=bool)
    inner[scenery.lines.ravel()] = False
    first = np.lexsort([inner, square])
    selected = first[np.unique(square[first], return_index=True)[1]]
    triangles = square[scenery.triangles]
    lines = square[scenery.lines]
    distinct = _whole(triangles)
    return replace(
        scenery,
        points=scenery.points[selected],
        nodes=scenery.nodes[selected],
        triangles=triangles[distinct],
        lines=lines[_whole(lines)],
        strains=None if scenery.strains is None else scenery.strains.of_triangles(distinct),
        owners=None if scenery.owners is None else scenery.owners[distinct],
    )


def _whole(pieces: np.ndarray) -> np.ndarray:
    """Indices of triangles or lines with distinct corners, each once."""
    ordered = np.sort(pieces, axis=1)
    different = np.flatnonzero((np.diff(ordered, axis=1) > 0).all(axis=1))
    return different[np.unique(ordered[different], axis=0, return_index=True)[1]]


def compliance_of(
    compliance_times: Callable[[np.ndarray], np.ndarray], contact_of_motions: np.ndarray
) -> np.ndarray:
    """S times some forces that do no work along motions, less the nearest slack of motions, (m,).

    It does not depend on how bodies are pinned in S. Even and linear forces would often be those of
    motions.

    Args:
        compliance_times: S times forces, (m,) to (m,).
        contact_of_motions: B R, (m, r).
    """

    def without(values: np.ndarray) -> np.ndarray:
        return (
            values - contact_of_motions @ np.linalg.lstsq(contact_of_motions, values, rcond=None)[0]
        )

    return without(compliance_times(without(np.cos(np.arange(len(contact_of_motions))))))
