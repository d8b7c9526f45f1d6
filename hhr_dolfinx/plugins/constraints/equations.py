"""Equations between displacements of nodes, and cyclic symmetry: *EQUATION of decks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from hhr_dolfinx.amplitudes import Amplitude, check_amplitude
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.loads import Assembler
from hhr_dolfinx.parameters import Place, Tag, as_tuple, check_place, is_number, is_whole
from hhr_dolfinx.plugins.constraints.elimination import ConstraintEquations

COINCIDENT_NODES = 1e-6
"""Distance of nodes over the size of the mesh up to which they coincide: files have about 7
digits.
"""
Rows = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Coefficients, rows and columns of a sparse matrix."""


def equations_of(
    entries: Sequence[Rows],
    dependent: np.ndarray,
    size: int,
    values: np.ndarray | None = None,
    loose: bool = False,
) -> ConstraintEquations:
    """Equations of coefficients.

    Args:
        entries: coefficients with their rows and columns, in one or several parts.
        dependent: dof that each equation determines, (k,).
        size: number of dofs.
        values: right-hand sides for the amplitude 1, (k,); None for 0.
        loose: True if an equation may determine another one of its dofs.
    """
    data, rows, columns = (np.concatenate(arrays) for arrays in zip(*entries, strict=True))
    matrix = csr_matrix((data, (rows, columns)), shape=(dependent.size, size))
    return ConstraintEquations(
        matrix, dependent, np.zeros(dependent.size) if values is None else values, loose
    )


def nodes_at(
    assembler: Assembler, place: Tag | Place, what: object, whole: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the nodes of a place and their coordinates, (n, dim).

    Args:
        assembler: interface of the mesh.
        place: facet tag, set of nodes, or a place.
        what: the constraint, for the message.
        whole: of a set that holds whole facets take all of their nodes.

    Raises:
        SceneError: if there are none.
    """
    nodes = assembler.nodes(place, whole=whole)
    if not nodes.size:
        raise SceneError(f"{what!r} has no node: name a set or a surface of the mesh")
    return nodes, assembler.points()[nodes]


def _in_order(points: np.ndarray) -> np.ndarray:
    """Order of points, (n, dim), by their coordinates, of which the first one counts most."""
    size = np.ptp(points, axis=0).max() or 1.0
    return np.lexsort(np.round(points.T[::-1] / (COINCIDENT_NODES * size)))


@dataclass(frozen=True)
class Equation:
    """Sum of c_k u_k = amplitude, as ``*EQUATION`` of decks.

    The first displacement follows the others.

    Places with several nodes make an equation for each, in the order of coordinates; a place with
    one node stands in each of them.

    Attributes:
        terms: triples of place, component and coefficient, ``(("A", 0, 1.0), ("B", 0, -1.0))``.
        amplitude: right-hand side: a number, an Amplitude, or a formula of the parameters as text.
    """

    terms: tuple[tuple[Tag | Place, int, float], ...]
    amplitude: Amplitude | Formula = Amplitude()

    def __post_init__(self) -> None:
        terms = as_tuple("the terms of an equation", self.terms)
        if not terms or not all(isinstance(term, tuple) and len(term) == 3 for term in terms):
            raise SceneError(
                f"terms = {self.terms!r} of an equation must be triples (place, component, "
                "coefficient)"
            )
        for term_place, component, coefficient in terms:
            check_place("term of an equation", term_place)
            if not is_whole(component, 0) or not is_number(coefficient) or coefficient == 0:
                raise SceneError(
                    f"{(term_place, component, coefficient)} of an equation needs a component and "
                    "a coefficient"
                )
        object.__setattr__(self, "terms", terms)
        check_amplitude(self, "an equation", formulas=True)

    def equations(self, assembler: Assembler) -> ConstraintEquations:
        """See :class:`~hhr_dolfinx.plugins.constraints.elimination.Constraint`.

        Raises:
            SceneError: for a component that does not exist, and for places with different numbers
                of nodes.
        """
        (dim,) = assembler.test.ufl_shape
        nodes_of_terms = []
        for term_place, component, _ in self.terms:
            if component >= dim:
                raise SceneError(
                    f"component {component} of {self!r} does not exist in {dim} dimensions"
                )
            nodes, points = nodes_at(assembler, term_place, self)
            nodes_of_terms.append(nodes[_in_order(points)])
        count = max(nodes.size for nodes in nodes_of_terms)
        if (
            any(nodes.size not in (1, count) for nodes in nodes_of_terms)
            or nodes_of_terms[0].size != count
        ):
            raise SceneError(
                f"places of {self!r} have {[nodes.size for nodes in nodes_of_terms]} nodes: give "
                "one or as many as the first"
            )
        entries = [
            (np.full(count, float(c)), np.arange(count), np.broadcast_to(dim * nodes + k, count))
            for nodes, (_, k, c) in zip(nodes_of_terms, self.terms, strict=True)
        ]
        return equations_of(entries, entries[0][2].copy(), assembler.size, np.ones(count))


@dataclass(frozen=True)
class Periodic:
    """Nodes of one surface move as those of another one, turned by an angle about an axis: cyclic
    symmetry.

    Each node of ``follower``, turned back, must be a node of ``leader``; a node of both, on the
    axis, stays on it.

    Attributes:
        follower, leader: surfaces or sets.
        angle: from leader to follower, in rad; 0 for a periodic structure.
        shift: from leader to follower, (dim,), after the turn; None for none.
        axis: axis of the turn through the origin, 0, 1 or 2; in the plane it is the normal.
        tolerance: distance of nodes over the size of the mesh up to which they coincide.
    """

    follower: Tag | Place
    leader: Tag | Place
    angle: float = 0.0
    shift: tuple[float, ...] | None = None
    axis: int = 2
    tolerance: float = COINCIDENT_NODES
    amplitude: Amplitude = field(default=Amplitude(), init=False)

    def __post_init__(self) -> None:
        check_place("periodic surface", self.follower)
        check_place("periodic surface", self.leader)
        if (
            not is_number(self.angle)
            or not is_whole(self.axis, 0)
            or self.axis > 2
            or not self.tolerance > 0
        ):
            raise SceneError(
                f"angle = {self.angle!r}, axis = {self.axis!r} and tolerance = {self.tolerance!r} "
                "must be a number, 0, 1 or 2, and a positive number"
            )
        if self.shift is not None:
            object.__setattr__(
                self, "shift", as_tuple("the shift of a periodic surface", self.shift)
            )
            if not all(map(is_number, self.shift)):
                raise SceneError(f"the shift {self.shift} of a periodic surface must be finite")

    def turn(self, dim: int) -> np.ndarray:
        """Rotation by the angle, (dim, dim)."""
        rotation = np.eye(dim)
        first, second = (0, 1) if dim == 2 else ((1, 2), (2, 0), (0, 1))[self.axis]
        cosine = np.cos(self.angle)
        sine = np.sin(self.angle)
        rotation[np.ix_([first, second], [first, second])] = [[cosine, -sine], [sine, cosine]]
        return rotation

    def equations(self, assembler: Assembler) -> ConstraintEquations:
        """See :class:`~hhr_dolfinx.plugins.constraints.elimination.Constraint`.

        Raises:
            SceneError: for surfaces that do not match.
        """
        (dim,) = assembler.test.ufl_shape
        if (self.shift is not None and len(self.shift) != dim) or (dim == 2 and self.axis != 2):
            raise SceneError(
                f"{self!r}: in {dim} dimensions a shift has as many numbers, and in the plane "
                "axis = 2"
            )
        if assembler.hypothesis == "axisymmetric" and self.angle:
            raise SceneError(
                f"{self!r} turns the plane (r, z), and an axisymmetric body with it: leave out "
                "the angle"
            )
        followers, follower_points = nodes_at(assembler, self.follower, self)
        leaders, sources = nodes_at(assembler, self.leader, self)
        turn = self.turn(dim)
        turned = sources @ turn.T + (
            0.0 if self.shift is None else np.array(self.shift, dtype=float)
        )
        far, leader_index = cKDTree(turned).query(follower_points)
        size = np.ptp(assembler.points(), axis=0).max()
        if far.max() > self.tolerance * size:
            bad = int(far.argmax())
            raise SceneError(
                f"{self!r}: the node at {follower_points[bad].tolist()} lies {far[bad]:.3g} beside "
                "those of the leader, turned and shifted: mesh both surfaces alike, or tie them"
            )
        count = followers.size * dim
        dofs = (dim * followers[:, None] + np.arange(dim)).ravel()
        entries: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = [
            (np.ones(count), np.arange(count), dofs)
        ]
        for k in range(dim):
            entries.append(
                (
                    -np.tile(turn[:, k], followers.size),
                    np.arange(count),
                    np.repeat(dim * leaders[leader_index] + k, dim),
                )
            )
        # of a node on the axis u = R u says nothing along the axis, nor of a shift
        says = (followers != leaders[leader_index])[:, None] | (
            np.abs(turn - np.eye(dim)).max(axis=1) > COINCIDENT_NODES
        )
        return equations_of(entries, dofs, assembler.size, loose=True).take(says.ravel())
