"""All blocks of a foreign stiffness on common nodes, as arrays: no DOLFINx."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np
from scipy.sparse import block_diag, coo_matrix, csr_matrix, identity, kron

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.pairings.surface import Surface, make_surface
from hhr_dolfinx.parameters import Place, Tag
from hhr_dolfinx.plugins.foreign.block import ForeignBlock
from hhr_dolfinx.plugins.foreign.case import carriers_of
from hhr_dolfinx.plugins.foreign.faces import Faces, joined_faces
from hhr_dolfinx.plugins.foreign.placed import Placed

Named = TypeVar("Named")
"""Kind of what a name stands for: numbers of nodes, or faces."""
DIRECTION_WORDS = ("along x", "along y", "along z")
"""Words for directions of dofs."""


class Blocks(Protocol):
    """A foreign stiffness: its blocks, and the names of those without a solved case."""

    @property
    def blocks(self) -> tuple[ForeignBlock, ...]:
        """The blocks."""

    @property
    def unchecked(self) -> tuple[str, ...]:
        """Names of the blocks without a solved case."""


@dataclass(frozen=True, eq=False)
class BareNodes:
    """A set of nodes without facets, as a surface for pairings that need no facets.

    A node of a deck that several nodes of K stand for, as in shells of CalculiX, is one: their
    mean.

    Attributes:
        tag: name of the set.
        nodes: numbers of the nodes of K, (n,).
        points: their coordinates, (n, 3).
        slaves: number of one node of K for each node of the deck, (d,).
        middles: coordinates of the nodes of the deck, (d, 3).
        means: displacement of each node of the deck by those of all nodes, (d, nodes).
    """

    tag: Tag
    nodes: np.ndarray
    points: np.ndarray
    slaves: np.ndarray
    middles: np.ndarray
    means: csr_matrix
    quadratic: None = None

    @property
    def facets(self) -> np.ndarray:
        """No facets, (0, 3)."""
        return np.zeros((0, 3), dtype=np.int64)

    def __getattr__(self, name: str) -> np.ndarray:
        raise SceneError(
            f"'{self.tag}' is a set of nodes without facets, and this pairing needs them: give "
            "NodesToGround with "
            "normals and areas, or a surface of elements or of a mesh file"
        )


@dataclass(frozen=True, eq=False)
class Parts:
    """Blocks side by side, with one numbering of nodes.

    Attributes:
        blocks: the blocks as they are given.
    """

    blocks: tuple[ForeignBlock, ...]

    @cached_property
    def made(self) -> tuple[Placed, ...]:
        """K and nodes of each block."""
        return tuple(block.read[0] for block in self.blocks)

    def compare(self) -> list[float | None]:
        """Difference of each block from its solved case, compared once; None without a case.

        Raises:
            SceneError: for a block whose case differs.
        """
        return [block.difference for block in self.blocks]

    @cached_property
    def firsts(self) -> np.ndarray:
        """Number of the first node of each block, and of all nodes, (b + 1,)."""
        return np.concatenate([[0], np.cumsum([len(placed.points) for placed in self.made])])

    @cached_property
    def points(self) -> np.ndarray:
        """Coordinates of all nodes, (n, 3)."""
        return np.vstack([placed.points for placed in self.made])

    @cached_property
    def known(self) -> np.ndarray:
        """Dofs that a K has, (3 n,) bool."""
        return np.concatenate([placed.known for placed in self.made])

    @cached_property
    def matrices(self) -> tuple[csr_matrix, ...]:
        """K of each block on the dofs of all, with one pattern that has the diagonal, (3 n, 3 n)
        each.
        """
        size = 3 * len(self.points)
        joined = csr_matrix(
            block_diag([abs(placed.matrix) for placed in self.made]) + identity(size)
        )
        pattern = csr_matrix(
            (np.zeros(joined.nnz), joined.indices, joined.indptr), shape=joined.shape
        )
        matrices = []
        for first, placed in zip(self.firsts, self.made, strict=False):
            entries = coo_matrix(placed.matrix)
            indices = entries.row + 3 * first, entries.col + 3 * first
            matrix = csr_matrix((entries.data, indices), shape=(size, size))
            matrices.append(_in_pattern(matrix, pattern))
        return tuple(matrices)

    @cached_property
    def pairs(self) -> np.ndarray:
        """Pairs of nodes that K couples, and lonely nodes with themselves, (p, 2): cells of a
        problem without a mesh.

        Rotations are coupled with the node that turns alone: they are no displacements, whose
        differences are strains.
        """
        count = len(self.points)
        owners = np.arange(count)
        for first, placed in zip(self.firsts, self.made, strict=False):
            turned = np.flatnonzero(placed.turning >= 0)
            owners[first + placed.turning[turned]] = first + turned
        entries = self.matrices[0].tocoo()
        rows = entries.row.astype(np.int64) // 3
        columns = entries.col.astype(np.int64) // 3
        rotations = (owners[rows] != rows) | (owners[columns] != columns)
        rows = np.where(rotations, owners[rows], rows)
        columns = np.where(rotations, owners[columns], columns)
        turning = np.flatnonzero(owners != np.arange(count))
        pairs = np.column_stack(
            [np.concatenate([rows, owners[turning]]), np.concatenate([columns, turning])]
        )
        keys = np.sort(pairs[:, 0] * count + pairs[:, 1])
        keys = keys[np.concatenate([[True], keys[1:] > keys[:-1]])]
        first, second = np.divmod(keys, count)
        selected = first <= second
        coupled = np.zeros(count, dtype=bool)
        coupled[np.concatenate([first[first < second], second[first < second]])] = True
        selected &= (first < second) | ~coupled[first]
        return np.column_stack([first[selected], second[selected]])

    def block_of(self, nodes: np.ndarray) -> np.ndarray:
        """Block of each node, (k,)."""
        return np.searchsorted(self.firsts, nodes, side="right") - 1

    @cached_property
    def surfaces(self) -> dict[str, Faces]:
        """Faces by name; of several blocks ``block.NAME``."""
        return {
            self._name(block, name): faces.shifted(int(first))
            for first, block, placed in zip(self.firsts, self.blocks, self.made, strict=False)
            for name, faces in placed.nodes.surfaces.items()
        }

    @cached_property
    def sets(self) -> dict[str, np.ndarray]:
        """Numbers of nodes by name; of several blocks ``block.NAME``."""
        return {
            self._name(block, name): nodes + first
            for first, block, placed in zip(self.firsts, self.blocks, self.made, strict=False)
            for name, nodes in placed.nodes.sets.items()
        }

    @cached_property
    def outer(self) -> Faces | None:
        """Faces to draw of all blocks; None if there are none."""
        faces_of_blocks = []
        for first, placed in zip(self.firsts, self.made, strict=False):
            faces = placed.nodes.outer
            if faces is None and placed.nodes.surfaces:
                faces = joined_faces(list(placed.nodes.surfaces.values()))
            if faces is not None and faces.nodes:
                faces_of_blocks.append(faces.shifted(int(first)))
        return joined_faces(faces_of_blocks) if faces_of_blocks else None

    def _name(self, block: ForeignBlock, name: str) -> str:
        return name if len(self.blocks) == 1 else f"{block.name}.{name}"

    def _found(self, tag: Tag, known: Mapping[Any, Named], kind: str) -> Named:
        """Item by its name, in any case; SceneError for an unknown one."""
        for name in (
            tag,
            str(tag),
            *(candidate for candidate in known if str(candidate).upper() == str(tag).upper()),
        ):
            if name in known:
                return known[name]
        short = [name for name in known if str(name).partition(".")[2].upper() == str(tag).upper()]
        if len(short) == 1:
            return known[short[0]]
        names = ", ".join(map(str, known)) or "none"
        raise SceneError(f"no {kind} of the blocks is called '{tag}': their names are {names}")

    def nodes(self, tag: Tag | Place) -> np.ndarray:
        """Numbers of the nodes with places of a set, a surface, a place or a label, (k,), in their
        order.

        Raises:
            SceneError: for an unknown name, or a place without nodes.
        """
        if not isinstance(tag, int | str):
            placed = self.with_places
            nodes = placed[np.unique(tag.nodes(self.points[placed]))]
            if not nodes.size:
                raise SceneError(f"{tag!r} holds no node of the blocks: move or widen it")
            return nodes
        members = {**{name: faces.members for name, faces in self.surfaces.items()}, **self.sets}
        if isinstance(tag, int) and not any(
            name.rpartition(".")[2] == str(tag) for name in members
        ):
            return self._labelled(tag)
        return np.asarray(self._found(tag, members, "set of nodes or surface"))

    def _labelled(self, label: int) -> np.ndarray:
        """Nodes of the deck's node with a label, (k,); SceneError if there is none, or in several
        blocks.
        """
        if len(self.blocks) > 1:
            raise SceneError(
                f"node {label} may be of any of {len(self.blocks)} blocks: name a set of nodes, "
                "block.NAME"
            )
        nodes = np.flatnonzero(self.made[0].nodes.decks == label)
        if not nodes.size:
            raise SceneError(f"block '{self.blocks[0].name}' has no node {label}")
        return nodes

    @cached_property
    def with_places(self) -> np.ndarray:
        """Numbers of the nodes that the other codes have."""
        pairs = zip(self.firsts, self.made, strict=False)
        return np.concatenate(
            [first + np.arange(len(placed.nodes.labels)) for first, placed in pairs]
        )

    def turning(self, nodes: np.ndarray) -> np.ndarray:
        """Nodes whose dofs are the rotations of nodes, (k,).

        Raises:
            SceneError: for a node without rotations.
        """
        rotations = []
        for node, number in zip(nodes.tolist(), self.block_of(nodes).tolist(), strict=True):
            first = self.firsts[number]
            placed = self.made[number]
            rotation = placed.turning[node - first] if node - first < len(placed.turning) else -1
            if rotation < 0:
                raise SceneError(
                    f"{self.described(3 * node)[:-8].strip()} has no rotations in K: leave them "
                    "free"
                )
            rotations.append(first + rotation)
        return np.array(rotations, dtype=np.int64)

    def shares(self, nodes: np.ndarray) -> np.ndarray:
        """Part of the force on a node of the deck that each node carries, (k,): 1 unless several
        stand for one.
        """
        shares = np.ones(nodes.size)
        for number, placed in enumerate(self.made):
            if placed.nodes.original is None:
                continue
            for k in np.flatnonzero(self.block_of(nodes) == number):
                local = nodes[k] - self.firsts[number]
                carriers = carriers_of(placed.nodes, int(placed.nodes.decks[local]))
                shares[k] = 1.0 / carriers.size if local in carriers else 0.0
        return shares

    def surface(self, tag: Tag) -> Surface | BareNodes:
        """The surface with a name, or the nodes of a set without facets.

        Raises:
            SceneError: for an unknown name, or facets without area.
        """
        try:
            faces = self.faces(tag)
        except SceneError:
            return self._bare(tag)
        facets, inner = faces.flat()
        areas = tributary(facets, self.points)
        facets = facets[:, _TENSOR] if facets.shape[1] == 4 else facets
        return make_surface(tag, facets, inner, self.points, np.ones(len(areas)), areas)

    def faces(self, tag: Tag) -> Faces:
        """Faces of a surface; SceneError for an unknown name."""
        faces = self._found(tag, self.surfaces, "surface with faces")
        assert isinstance(faces, Faces)
        return faces

    def _bare(self, tag: Tag) -> BareNodes:
        """Nodes of a set: those of the deck."""
        nodes = self.nodes(tag)
        shares = self.shares(nodes)
        carrying = shares > 0
        nodes = nodes[carrying]
        shares = shares[carrying]
        numbers = self.block_of(nodes)
        decks = [
            int(self.made[k].nodes.decks[n - self.firsts[k]])
            for n, k in zip(nodes, numbers, strict=True)
        ]
        keys = np.column_stack([numbers, decks])
        _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        entries = shares, (np.asarray(group).ravel(), nodes)
        means = csr_matrix(entries, shape=(first.size, len(self.points)))
        return BareNodes(tag, nodes, self.points[nodes], nodes[first], means @ self.points, means)

    def described(self, dof: int) -> str:
        """A dof in words: block, node and direction."""
        node, direction = divmod(int(dof), 3)
        number = int(self.block_of(np.array([node]))[0])
        local = node - self.firsts[number]
        labels = self.made[number].nodes.labels
        label = (
            f"node {labels[local]}"
            if local < len(labels)
            else "a rotation, or a dof of the code alone,"
        )
        return f"{label} of block '{self.blocks[number].name}' {DIRECTION_WORDS[direction]}"


_TENSOR = [0, 1, 3, 2]


def tributary(facets: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Area of each node by flat facets, (n,).

    It is a third of triangles, and shares of quadrilaterals by both diagonals.

    Args:
        facets: nodes of each facet, (f, 3) or (f, 4).
        points: coordinates of nodes, (n, 3).
    """
    shares = np.zeros(len(points))
    halves: Sequence[tuple[list[int], float]] = [([0, 1, 2], 1.0)]
    if facets.shape[1] == 4:
        halves = [([0, 1, 2], 0.5), ([0, 2, 3], 0.5), ([0, 1, 3], 0.5), ([1, 2, 3], 0.5)]
    for corners, weight in halves:
        vertices = points[facets[:, corners]]
        areas = (
            np.linalg.norm(
                np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0]), axis=1
            )
            / 2
        )
        np.add.at(shares, facets[:, corners].ravel(), np.repeat(weight * areas / 3, 3))
    return shares


def _in_pattern(matrix: csr_matrix, pattern: csr_matrix) -> csr_matrix:
    """A matrix with zeros at all other entries of a pattern that holds its own."""
    filled = pattern.copy()
    filled.sort_indices()
    matrix = matrix.copy()
    matrix.sort_indices()
    size = np.int64(filled.shape[1])
    keys = (
        np.repeat(np.arange(filled.shape[0], dtype=np.int64), np.diff(filled.indptr)) * size
        + filled.indices
    )
    keys_of_matrix = (
        np.repeat(np.arange(matrix.shape[0], dtype=np.int64), np.diff(matrix.indptr)) * size
        + matrix.indices
    )
    data = np.zeros(keys.size)
    data[np.searchsorted(keys, keys_of_matrix)] = matrix.data
    return csr_matrix((data, filled.indices, filled.indptr), shape=filled.shape)


def node_mass(count: int) -> csr_matrix:
    """Gram matrix of displacements of so many nodes: their mean square, as K has no volumes, (n,
    n).
    """
    return csr_matrix(kron(identity(count) / count, identity(1)))
