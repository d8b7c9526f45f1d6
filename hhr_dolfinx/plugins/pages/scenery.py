"""What a page draws of a scene beside the numbers of its model: a mesh to look at, places of contact, words.

A model in a file knows no mesh. Its scenery lies beside it, ``scenery.npz``: plain data like the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.files import read_arrays, write_arrays

FORMAT = "hhr scenery"
VERSION = 2
NAME = "scenery.npz"
_ROWS = ("data", "indices", "indptr")
_ARRAYS = ("points", "nodes", "triangles", "lines", "contact_points", "areas", "pairs", "compliance")


@dataclass(frozen=True, eq=False)
class Strains:
    """What makes von Mises' stress of cells out of a displacement.

    Attributes:
        cells: of each triangle that is drawn its place among the cells, (t,).
        bodies: of each cell its body, (c,).
        rows: strain in the middles of the cells times the grading of their moduli, Kelvin's notation, cell by cell,
            (4 c, N), in space (6 c, N); that across the plane is zero where its stress is.
        moduli: λ' and μ' of each body as formulas of the parameters.
        plane_stress: whether the stress across the plane vanishes.
    """

    cells: np.ndarray
    bodies: np.ndarray
    rows: csr_matrix
    moduli: tuple[tuple[str, str], ...]
    plane_stress: bool

    @property
    def components(self) -> int:
        """Of a strain."""
        return self.rows.shape[0] // max(len(self.bodies), 1)

    def taken(self, triangles: np.ndarray) -> Strains:
        """Those of some triangles alone."""
        kept, cells = np.unique(self.cells[triangles], return_inverse=True)
        rows = (kept[:, None] * self.components + np.arange(self.components)).ravel()
        return replace(self, cells=cells, bodies=self.bodies[kept], rows=csr_matrix(self.rows[rows]))

    @property
    def dofs(self) -> int:
        """Of the displacement."""
        return int(self.rows.shape[1])

    def fault(self, triangles: int, bodies: int) -> str:
        """What does not fit; nothing where all does."""
        count = len(self.bodies)
        kinds = self.cells.dtype.kind + self.bodies.dtype.kind
        if set(kinds) - set("iu") or self.bodies.ndim != 1 or not count:
            return "cells and bodies of strains are no whole numbers"
        whole = self.cells.shape == (triangles,) and self.rows.shape[0] == count * self.components > 0
        inside = whole and 0 <= self.cells.min() <= self.cells.max() < count
        if not inside or self.components not in (4, 6) or not 0 <= self.bodies.min() <= self.bodies.max() < bodies:
            return "strains do not fit the triangles"
        return "" if np.isfinite(self.rows.data).all() else "strains are not finite"


@dataclass(frozen=True)
class Scenery:
    """What is drawn of a scene.

    Attributes:
        points: coordinates of the nodes that are drawn, (n, dim).
        nodes: their numbers among all nodes of the model, (n,).
        triangles: of these nodes, counted among those drawn, (t, 3).
        lines: edges of the surface, likewise, (l, 2); none in space.
        contact_points: places of the contact conditions, (m, dim).
        areas: of the conditions, (m,).
        pairs: contact of each condition, (m,).
        compliance: S times ones in the middle of the box, (m,), by which a page tells whose model it draws.
        moves: whether shapes are parameters: areas are then those of the middle of the box alone.
        strains: of the cells that are drawn; None where their stress is not that of a displacement alone.
        owners: cell of each triangle in a model that flows, (t,), which alone knows them; None elsewhere.
        words: ``scene``, ``contacts`` (a name for each), ``bodies`` (a line for each), ``hypothesis``, ``length``,
            ``stress``, ``force`` and ``work`` (units, or nothing), ``units`` of parameters by name.
    """

    points: np.ndarray
    nodes: np.ndarray
    triangles: np.ndarray
    lines: np.ndarray
    contact_points: np.ndarray
    areas: np.ndarray
    pairs: np.ndarray
    compliance: np.ndarray
    moves: bool
    words: dict[str, Any]
    strains: Strains | None = None
    owners: np.ndarray | None = None

    def write(self, path: str | Path) -> None:
        """Keep it in a file.

        Raises:
            FileError: if it cannot be written.
        """
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        header = {"format": FORMAT, "version": VERSION, "words": self.words, "moves": self.moves}
        if self.strains is not None:
            own = self.strains
            header |= {"moduli": own.moduli, "plane_stress": own.plane_stress, "dofs": own.rows.shape[1]}
            arrays |= {"cells": own.cells, "bodies": own.bodies}
            arrays |= {name: getattr(own.rows, name) for name in _ROWS}
        write_arrays(path, header, arrays)

    @classmethod
    def read(cls, path: str | Path) -> Scenery:
        """That of a file.

        Raises:
            FileNotFoundError: if there is none.
            FileContentError: if it is damaged, or no scenery.
        """
        header, arrays = read_arrays(path, FORMAT, VERSION)
        if missing := set(_ARRAYS) - set(arrays):
            raise FileContentError(f"{path} is damaged: {', '.join(sorted(missing))} are missing")
        own = {name: arrays[name] for name in _ARRAYS}
        try:
            strains = _strains(header, arrays) if "moduli" in header else None
        except (KeyError, TypeError, ValueError) as error:
            raise FileContentError(f"{path} is damaged: its strains are not whole ({error})") from error
        found = cls(**own, moves=bool(header.get("moves")), words=header.get("words", {}), strains=strains)
        if fault := found._fault():
            raise FileContentError(f"{path} is damaged: {fault}")
        return found

    def _fault(self) -> str:
        """What does not fit; nothing where all does."""
        count = len(self.points)
        wholes = [self.nodes, self.triangles, self.lines, self.pairs]
        if any(array.dtype.kind not in "iu" for array in wholes) or (count and self.nodes.min(initial=0) < 0):
            return "numbers of nodes or contacts are no whole numbers"
        if self.points.ndim != 2 or self.points.shape[1] not in (2, 3) or self.nodes.shape != (count,):
            return "points and nodes do not fit"
        for name, width in (("triangles", 3), ("lines", 2)):
            array = getattr(self, name)
            if (
                array.ndim != 2
                or array.shape[1] != width
                or (array.size and not 0 <= array.min() <= array.max() < count)
            ):
                return f"{name} name nodes that are not there"
        m = len(self.areas)
        shapes = self.contact_points.shape, self.pairs.shape, self.compliance.shape
        if shapes != ((m, self.points.shape[1]), (m,), (m,)):
            return "places of contact do not fit"
        named = isinstance(self.words, dict) and isinstance(self.words.get("scene"), str)
        named = named and len(self.words.get("contacts", ())) > self.pairs.max(initial=-1)
        if not named or not isinstance(self.moves, bool):
            return "it has no words"
        own = self.strains
        return "" if own is None else own.fault(len(self.triangles), len(own.moduli))


def _strains(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> Strains:
    """Those of a file; what is wrong with them SciPy says, or :meth:`Strains.fault`."""
    shape = arrays["indptr"].size - 1, int(header["dofs"])
    rows = csr_matrix(tuple(arrays[name] for name in _ROWS), shape=shape)
    rows.check_format()
    moduli = tuple((str(volume), str(shape)) for volume, shape in header["moduli"])
    if not isinstance(header["plane_stress"], bool):
        raise ValueError("plane_stress is neither true nor false")
    return Strains(arrays["cells"], arrays["bodies"], rows, moduli, bool(header["plane_stress"]))


def thinned(scenery: Scenery, most: int) -> Scenery:
    """The same with some of its nodes in the place of all, no more than ``most``: finer meshes than a screen shows.

    Nodes of one body that lie in the same square (cube) become one of them, on the outline if any is.
    """
    if len(scenery.points) <= most:
        return scenery
    bodies = _bodies(scenery)
    low = scenery.points.min(axis=0)
    size = float(np.ptp(scenery.points, axis=0).max())
    count = int(4 * most**0.5)  # squares across, fewer of them until few enough hold a node
    while True:
        places = np.floor((scenery.points - low) / size * count).astype(np.int64)
        _, square = np.unique(np.column_stack([bodies, places]), axis=0, return_inverse=True)
        if square.max() < most:
            break
        count = int(0.9 * count)
    inner = np.ones(len(square), dtype=bool)
    inner[scenery.lines.ravel()] = False
    first = np.lexsort([inner, square])
    kept = first[np.unique(square[first], return_index=True)[1]]
    triangles = square[scenery.triangles]
    lines = square[scenery.lines]
    whole = _whole(triangles)
    return replace(
        scenery,
        points=scenery.points[kept],
        nodes=scenery.nodes[kept],
        triangles=triangles[whole],
        lines=lines[_whole(lines)],
        strains=None if scenery.strains is None else scenery.strains.taken(whole),
        owners=None if scenery.owners is None else scenery.owners[whole],
    )


def _bodies(scenery: Scenery) -> np.ndarray:
    """Number of the connected part of each node, (n,)."""
    count = len(scenery.points)
    begin, middle, end = scenery.triangles.T
    rows = np.concatenate([begin, middle])
    columns = np.concatenate([middle, end])
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def _whole(pieces: np.ndarray) -> np.ndarray:
    """Places of triangles or lines whose corners are still different ones, each once."""
    ordered = np.sort(pieces, axis=1)
    different = np.flatnonzero((np.diff(ordered, axis=1) > 0).all(axis=1))
    return different[np.unique(ordered[different], axis=0, return_index=True)[1]]
