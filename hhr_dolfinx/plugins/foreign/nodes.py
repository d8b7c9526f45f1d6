"""Nodes of a block beside its K: labels, coordinates, surfaces and sets, from decks, meshes or
arrays.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.errors import FileContentError, FileError, SceneError, SceneWarning
from hhr_dolfinx.geometries.abaqus_blocks import DeckContents
from hhr_dolfinx.geometries.abaqus_deck import flat_deck
from hhr_dolfinx.plugins.foreign.faces import (
    CORNERS_BY_NODES,
    Faces,
    joined_faces,
    outer_faces,
    solid_faces,
)
from hhr_dolfinx.plugins.foreign.frd import Results, read_frd
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    import meshio

EXPANDED = {
    ("S", 3): [0, 1, 2] * 2,
    ("S", 4): [0, 1, 2, 3] * 2,
    ("S", 6): [0, 1, 2, 0, 1, 2, 3, 4, 5, 3, 4, 5, 0, 1, 2],
    ("S", 8): [0, 1, 2, 3, 0, 1, 2, 3, 4, 5, 6, 7, 4, 5, 6, 7, 0, 1, 2, 3],
    ("B", 2): [0, 1, 1, 0, 0, 1, 1, 0],
    ("B", 3): [0, 2, 2, 0, 0, 2, 2, 0, 1, 2, 1, 0, 1, 2, 1, 0, 0, 2, 2, 0],
}
"""Node of a shell (S) or beam (B) of CalculiX that each node of its solid stands for, by their
number of nodes.
"""
SIDES = {"SNEG": 1, "SPOS": 2, "NEG": 1, "POS": 2}
"""Faces of solids by the sides of shells."""
MATCH_TOLERANCE = 1e-6
"""Part of the size of a block up to which two places are one."""


@dataclass(frozen=True, eq=False)
class ForeignNodes:
    """Nodes of a block of another code.

    Attributes:
        labels: label of each node, (n,).
        points: coordinates, (n, 3).
        surfaces: faces by name.
        sets: indices of nodes by name.
        original: label in the deck of the node that each stands for, (n,); None for its own label.
        carries: nodes that carry the node that they stand for, (n,) bool; None for all.
        outer: faces to draw; None for those of the surfaces.
    """

    labels: np.ndarray
    points: np.ndarray
    surfaces: Mapping[str, Faces] = field(default_factory=dict)
    sets: Mapping[str, np.ndarray] = field(default_factory=dict)
    original: np.ndarray | None = None
    carries: np.ndarray | None = None
    outer: Faces | None = None

    def __post_init__(self) -> None:
        points = np.asarray(self.points, dtype=float)
        labels = np.asarray(self.labels)
        if points.ndim != 2 or points.shape[1] != 3 or labels.shape != (len(points),):
            raise SceneError(
                f"labels {labels.shape} and points {points.shape} of nodes must be (n,) and (n, "
                "3): each node has a "
                "label of the other code and three coordinates"
            )
        if not np.isfinite(points).all() or np.unique(labels).size < labels.size:
            raise SceneError("nodes of another code need finite coordinates, and a label each")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "labels", labels.astype(np.int64))

    @property
    def decks(self) -> np.ndarray:
        """Label in the deck of the node that each stands for, (n,)."""
        return self.labels if self.original is None else self.original

    @property
    def carriers(self) -> np.ndarray:
        """Nodes that carry the node that they stand for, (n,) bool."""
        return np.ones(len(self.labels), dtype=bool) if self.carries is None else self.carries

    def moved(self, shift: Sequence[float]) -> ForeignNodes:
        """The same nodes at places that are shifted, (3,)."""
        by = np.asarray(shift, dtype=float)

        def shifted(faces: Faces) -> Faces:
            return Faces(faces.nodes, tuple(inner_points + by for inner_points in faces.inner))

        surfaces = {name: shifted(surface) for name, surface in self.surfaces.items()}
        outer = None if self.outer is None else shifted(self.outer)
        return replace(self, points=self.points + by, surfaces=surfaces, outer=outer)

    def with_surfaces(self, files: Mapping[str, str | Path]) -> ForeignNodes:
        """The same nodes with surfaces of mesh files (STL, VTK, ...), whose points are matched by
        their places.

        Args:
            files: file of each surface by name.

        Raises:
            SceneError: for points where no node is.
        """
        surfaces = {name: _matched(self, name, Path(path)) for name, path in files.items()}
        return replace(self, surfaces={**self.surfaces, **surfaces})


def read_nodes(path: str | Path, results: str | Path | None = None) -> ForeignNodes:
    """Nodes, surfaces and sets of a file.

    Args:
        path: deck of CalculiX or Abaqus (``.inp``); a table ``label x y z`` (``.csv``, ``.txt``,
            ``.nod``); or any mesh that meshio reads, whose nodes have the labels of the file, or
            count from 1.
        results: ``.frd`` of a run of CalculiX with OUTPUT=3D, for a deck with shells or beams; None
            for the file of the same name beside the deck.

    Raises:
        FileError: without the file.
        FileContentError: for a damaged one.
    """
    path = Path(path)
    if not path.is_file():
        raise FileError(f"there is no file of nodes {path}")
    if path.suffix.lower() == ".inp":
        return nodes_of_deck(path, None if results is None else Path(results))
    if path.suffix.lower() in (".csv", ".txt", ".nod"):
        return _of_table(path)
    return _of_mesh(path)


def _of_table(path: Path) -> ForeignNodes:
    """Nodes of a table ``label x y z`` with blanks or commas; a first line of words is its
    title.
    """
    lines = [
        line.replace(",", " ").replace(";", " ")
        for line in path.read_text().splitlines()
        if line.strip()
    ]
    lines = lines[1:] if lines and any(word[0].isalpha() for word in lines[0].split()) else lines
    try:
        table = np.loadtxt(lines, ndmin=2)
    except ValueError as error:
        raise FileContentError(f"{path} is no table of nodes, label x y z: {error}") from None
    if table.shape[1] != 4:
        raise FileContentError(
            f"{path} has {table.shape[1]} columns: a table of nodes has four, label x y z"
        )
    return ForeignNodes(table[:, 0].astype(np.int64), table[:, 1:])


def thin_elements(deck: DeckContents) -> list[str]:
    """Types of shells and beams of a deck."""
    return sorted(
        {
            name
            for name in deck.types.values()
            if name[0] in "SB" and not name.startswith(("SPRING", "SC"))
        }
    )


def nodes_of_deck(path: Path, results: Path | None = None) -> ForeignNodes:
    """Nodes, surfaces and sets of a deck, those of the solids of CalculiX instead of shells and
    beams.

    Args:
        path: deck.
        results: see :func:`read_nodes`.

    Raises:
        FileContentError: for shells or beams without the results of CalculiX.
    """
    deck = flat_deck(path)
    if not deck.nodes:
        raise FileContentError(f"{path.name} has no *NODE: give the deck of the mesh of K")
    _check_labels(deck, path)
    if not (thin := thin_elements(deck)):
        return solids_of_deck(deck)
    beside = results or path.with_suffix(".frd")
    if not beside.is_file():
        raise FileContentError(
            f"{path.name} has elements {', '.join(thin)}, which CalculiX expands to solids, and "
            f"{beside.name} is not "
            "there: run a step with *NODE FILE, OUTPUT=3D, whose result has the nodes of K"
        )
    return _expanded(deck, read_frd(beside), path)


def _check_labels(deck: DeckContents, path: Path) -> None:
    """Raise FileContentError for surfaces of elements that are not there; warn of such nodes."""
    for name, sides in deck.faces.items():
        for word, _ in sides:
            known = word.isdigit() or word.upper() in deck.element_sets
            numbers = [int(word)] if word.isdigit() else deck.element_sets.get(word.upper(), [])
            lost = [number for number in numbers if number not in deck.whole]
            if not known or lost:
                raise FileContentError(
                    f"{path.name}: surface {deck.spelling.get(('surface', name), name)} has "
                    + (f"element {lost[0]}" if lost else f"the set {word}")
                    + ", which the deck does not have"
                )
    for name, numbers in deck.node_sets.items():
        if missing := [number for number in numbers if number not in deck.nodes]:
            warn(
                f"{path.name}: set {deck.spelling.get(('nset', name), name)} has "
                f"{len(missing)} nodes that the deck does not have, first {missing[0]}: they are "
                "left out",
                SceneWarning,
            )


def solids_of_deck(deck: DeckContents) -> ForeignNodes:
    """Nodes of a deck as they are, with the surfaces that its solids have."""
    names = ("C3D", "SC", "F3D")
    solids = {
        n: nodes
        for n, nodes in deck.whole.items()
        if len(nodes) in CORNERS_BY_NODES and deck.types[n].startswith(names)
    }
    return _of_solids(
        deck, solids, {label: tuple(coordinates) for label, coordinates in deck.nodes.items()}, {}
    )


def _expanded(deck: DeckContents, results: Results, path: Path) -> ForeignNodes:
    """Nodes of the solids that stand for the elements of a deck."""
    original: dict[int, int] = {}
    idle: set[int] = set()
    for number, expanded in results.elements.items():
        nodes = deck.whole.get(number)
        if nodes is None or (len(expanded) == len(nodes) and deck.types[number].startswith("C3D")):
            continue
        key = deck.types[number][0], len(nodes)
        if key not in EXPANDED or len(EXPANDED[key]) != len(expanded):
            raise FileContentError(
                f"element {number} of type {deck.types[number]} has {len(expanded)} nodes in "
                f"{path.stem}.frd, which is not "
                "understood: write it with *NODE FILE, OUTPUT=3D"
            )
        for position, (label, at) in enumerate(zip(expanded, EXPANDED[key], strict=True)):
            original[label] = nodes[at]
            if _is_between(key, position):
                idle.add(label)
    return _of_solids(deck, results.elements, results.nodes, original, idle)


def _is_between(key: tuple[str, int], place: int) -> bool:
    """True for a node between the lower and the upper side of a shell, or the corners of the
    section of a beam.
    """
    if key[0] == "S":
        return place >= {6: 12, 8: 16}.get(key[1], 99)
    return key[1] == 3 and place >= 8 and place not in (8, 10, 12, 14)


def _of_solids(
    deck: DeckContents,
    elements: Mapping[int, Sequence[int]],
    places: Mapping[int, tuple[float, ...]],
    original: Mapping[int, int],
    idle: set[int] | frozenset[int] = frozenset(),
) -> ForeignNodes:
    """Nodes with the surfaces and sets of a deck on solids, by their numbers."""
    labels = sorted(places)
    index = {label: k for k, label in enumerate(labels)}
    points = np.array([places[label] for label in labels], dtype=float).reshape(-1, 3)
    rows = {
        n: [index[label] for label in nodes]
        for n, nodes in elements.items()
        if all(label in index for label in nodes)
    }
    stands = np.array([original.get(label, label) for label in labels], dtype=np.int64)
    surfaces = {}
    for name, sides in deck.faces.items():
        if (faces := _faces(deck, sides, rows, points)) is not None:
            surfaces[deck.spelling["surface", name]] = faces
    for name, members in deck.unions.items():
        candidates = [
            surfaces.get(deck.spelling.get(("surface", member), "")) for member in members
        ]
        if present := [faces for faces in candidates if faces is not None]:
            surfaces[deck.spelling["surface", name]] = joined_faces(present)
    by_deck: dict[int, list[int]] = {}
    for k, label in enumerate(stands.tolist()):
        by_deck.setdefault(label, []).append(k)
    sets = {
        deck.spelling["nset", name]: np.unique(
            [k for n in numbers for k in by_deck.get(n, ())]
        ).astype(np.int64)
        for name, numbers in deck.node_sets.items()
    }
    carries = np.array([label not in idle for label in labels])
    outer = outer_faces(list(rows.values()), points) if rows else None
    return ForeignNodes(
        np.array(labels), points, surfaces, sets, stands if original else None, carries, outer
    )


def _faces(
    deck: DeckContents,
    given: Sequence[tuple[str, str]],
    rows: Mapping[int, list[int]],
    points: np.ndarray,
) -> Faces | None:
    """Faces of a surface of a deck; None if no solid has them."""
    selected: list[list[int]] = []
    inner: list[np.ndarray] = []
    for name, face in given:
        numbers = [int(name)] if name.isdigit() else deck.element_sets.get(name.upper(), [])
        solids = [rows[number] for number in numbers if number in rows]
        if not face and solids:
            outer = outer_faces(list(rows.values()), points)
            members = [set(row) for row in solids]
            for group, inner_points in zip(outer.nodes, outer.inner, strict=True):
                on_solids = [
                    k
                    for k, row in enumerate(group.tolist())
                    if any(set(row) <= member for member in members)
                ]
                selected += group[on_solids].tolist()
                inner += list(inner_points[on_solids])
            continue
        side = SIDES.get(face) or (int(face[1:]) if face[1:].isdigit() else 0)
        for row in solids:
            faces = solid_faces(row)
            if not 1 <= side <= len(faces):
                raise FileContentError(
                    f"'{name}, {face}' is no face of a solid with {len(row)} nodes"
                )
            selected.append(faces[side - 1])
            inner.append(points[row[: CORNERS_BY_NODES[len(row)]]].mean(axis=0))
    return Faces.of(selected, inner) if selected else None


def _of_mesh(path: Path) -> ForeignNodes:
    """Nodes of a mesh that meshio reads; cells are surfaces (triangles, quadrilaterals) or
    solids.
    """
    mesh = _by_meshio(path)
    points = _in_space(mesh.points)
    labels = np.asarray(getattr(mesh, "points_id", np.arange(1, len(points) + 1)))
    solids = [
        row
        for block in mesh.cells
        if block.dim == 3
        for row in block.data.tolist()
        if len(row) in CORNERS_BY_NODES
    ]
    flat = (
        Faces.of(*_of_facets(mesh, points)) if any(block.dim == 2 for block in mesh.cells) else None
    )
    outer = outer_faces(solids, points) if solids else flat
    sets = {name: np.asarray(numbers, dtype=np.int64) for name, numbers in mesh.point_sets.items()}
    surfaces = {} if outer is None else {"outside": outer}
    return ForeignNodes(
        labels, points, surfaces | dict(_named_surfaces(mesh, points)), sets, outer=outer
    )


def _named_surfaces(mesh: meshio.Mesh, points: np.ndarray) -> Iterator[tuple[str, Faces]]:
    """Surfaces of the sets of a mesh of meshio."""
    for name, chosen in mesh.cell_sets.items():
        rows, inner = _of_facets(mesh, points, chosen)
        if rows:
            yield name, Faces.of(rows, inner)


def _of_facets(
    mesh: meshio.Mesh, points: np.ndarray, chosen: Sequence[np.ndarray | None] | None = None
) -> tuple[list[list[int]], list[np.ndarray]]:
    """Nodes of flat cells of a mesh, and an inner point of each, by the order of its corners."""
    facets: list[list[int]] = []
    inner: list[np.ndarray] = []
    for number, block in enumerate(mesh.cells):
        cells = np.arange(len(block.data)) if chosen is None else chosen[number]
        if block.dim != 2 or cells is None or not len(cells):
            continue
        for row in block.data[np.asarray(cells, dtype=int)].tolist():
            a = points[row[0]]
            b = points[row[1]]
            c = points[row[2]]
            normal = np.cross(b - a, c - a)
            facets.append(row)
            inner.append((a + b + c) / 3 - normal / (np.linalg.norm(normal) ** 0.5 or 1.0))
    return facets, inner


def _matched(nodes: ForeignNodes, name: str, path: Path) -> Faces:
    """Faces of a mesh file on nodes at the same places."""
    from scipy.spatial import cKDTree

    mesh = _by_meshio(path)
    points = _in_space(mesh.points)
    away, nearest = cKDTree(nodes.points).query(points)
    reach = MATCH_TOLERANCE * np.ptp(nodes.points, axis=0).max() + 1e-7 * np.abs(points).max()
    used = np.unique(np.concatenate([block.data.ravel() for block in mesh.cells]))
    if (lost := used[away[used] > reach]).size:
        where = [float(f"{value:.6g}") for value in points[lost[0]]]
        raise SceneError(
            f"surface '{name}': {lost.size} of {used.size} points of {path.name} have no node of "
            f"K, first {where}, "
            f"{away[lost[0]]:.3g} away: it must be the surface of the mesh of K, in its units"
        )
    rows, inner = _of_facets(mesh, points)
    if not rows:
        raise SceneError(f"surface '{name}': {path.name} has no triangles or quadrilaterals")
    return Faces.of([[int(nearest[k]) for k in row] for row in rows], inner)


def _by_meshio(path: Path) -> meshio.Mesh:
    """Mesh of a file as meshio reads it; FileContentError for a damaged one."""
    from hhr_dolfinx.compat import extra

    with extra("mesh", f"the mesh file {path.name}"):
        import meshio
    try:
        return meshio.read(path)
    except (Exception, SystemExit) as error:  # readers of meshio raise many kinds
        raise FileContentError(
            f"{path} cannot be read by meshio: {type(error).__name__}: {error}"
        ) from None


def _in_space(points: np.ndarray) -> np.ndarray:
    """Points with three coordinates, (n, 3)."""
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
