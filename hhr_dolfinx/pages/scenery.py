"""What a page draws of a scene beside the numbers of its model: a mesh to look at, places of contact, words.

A model in a file knows no mesh. Its scenery lies beside it, ``scenery.npz``: plain data like the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.files import read_arrays, write_arrays

FORMAT = "hhr scenery"
VERSION = 1
NAME = "scenery.npz"
_ARRAYS = ("points", "nodes", "triangles", "lines", "contact_points", "areas", "pairs", "compliance")


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
        words: ``scene``, ``contacts`` (a name for each), ``bodies`` (a line for each), ``hypothesis``, ``length`` and
            ``stress`` (units, or nothing), ``units`` of parameters by name.
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

    def write(self, path: str | Path) -> None:
        """Keep it in a file.

        Raises:
            FileError: if it cannot be written.
        """
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        write_arrays(path, {"format": FORMAT, "version": VERSION, "words": self.words, "moves": self.moves}, arrays)

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
        found = cls(
            **{name: arrays[name] for name in _ARRAYS}, moves=bool(header.get("moves")), words=header.get("words", {})
        )
        if fault := found._fault():
            raise FileContentError(f"{path} is damaged: {fault}")
        return found

    def _fault(self) -> str:
        """What does not fit; nothing where all does."""
        count = len(self.points)
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
        if not named or not isinstance(self.moves, bool):
            return "it has no words"
        return ""


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
    return replace(
        scenery,
        points=scenery.points[kept],
        nodes=scenery.nodes[kept],
        triangles=_whole(square[scenery.triangles]),
        lines=_whole(square[scenery.lines]),
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
    """Triangles or lines whose corners are still different ones, each once."""
    ordered = np.sort(pieces, axis=1)
    different = (np.diff(ordered, axis=1) > 0).all(axis=1)
    return pieces[different][np.unique(ordered[different], axis=0, return_index=True)[1]]
