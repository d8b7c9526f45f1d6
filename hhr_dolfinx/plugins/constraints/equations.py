"""Equations between displacements of nodes: *EQUATION, couplings and symmetries of decks."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import qr
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from hhr_dolfinx.amplitudes import Amplitude, check_amplitude
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import elasticity
from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.full_order.constraints import Equations
from hhr_dolfinx.full_order.free_bodies import rigid_motions
from hhr_dolfinx.loads import Assembler
from hhr_dolfinx.parameters import Place, Tag, as_tuple, check_place, is_number, is_whole

ALIKE = 1e-6
"""Distance of nodes over the size of the mesh up to which they coincide: files have about 7 digits."""
Rows = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Coefficients, rows and columns of a sparse matrix."""


def equations_of(
    entries: Sequence[Rows], dependent: np.ndarray, size: int, values: np.ndarray | None = None
) -> Equations:
    """Equations of coefficients; right-hand sides are 0 if none are given."""
    data, rows, columns = (np.concatenate(part) for part in zip(*entries, strict=True))
    matrix = csr_matrix((data, (rows, columns)), shape=(dependent.size, size))
    return Equations(matrix, dependent, np.zeros(dependent.size) if values is None else values)


def nodes_at(assembler: Assembler, place: Tag | Place, what: object) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of nodes and their coordinates, (n, dim); SceneError if there are none."""
    nodes = assembler.nodes(place, whole=True)
    if not nodes.size:
        raise SceneError(f"{what!r} has no node: name a set or a surface of the mesh")
    return nodes, assembler.points()[nodes]


def _in_order(points: np.ndarray) -> np.ndarray:
    """Order of points, (n, dim), by their coordinates, of which the first one counts most."""
    size = np.ptp(points, axis=0).max() or 1.0
    return np.lexsort(np.round(points.T[::-1] / (ALIKE * size)))


@dataclass(frozen=True)
class Equation:
    """Sum of c_k u_k = amplitude, as *EQUATION of decks; the first displacement follows the others.

    Places with several nodes make an equation for each, in the order of coordinates; a place with one node stands in
    each of them.

    Attributes:
        terms: triples of place, component and coefficient, ``(("A", 0, 1.0), ("B", 0, -1.0))``.
        amplitude: right-hand side: a number, an Amplitude, or a formula of the parameters as text.
    """

    terms: tuple[tuple[Tag | Place, int, float], ...]
    amplitude: Amplitude | Formula = Amplitude()

    def __post_init__(self) -> None:
        terms = as_tuple("the terms of an equation", self.terms)
        if not terms or not all(isinstance(term, tuple) and len(term) == 3 for term in terms):
            raise SceneError(f"terms = {self.terms!r} of an equation must be triples (place, component, coefficient)")
        for place, component, coefficient in terms:
            check_place("term of an equation", place)
            if not is_whole(component, 0) or not is_number(coefficient) or coefficient == 0:
                raise SceneError(
                    f"{(place, component, coefficient)} of an equation needs a component and a coefficient"
                )
        object.__setattr__(self, "terms", terms)
        check_amplitude(self, "an equation", formulas=True)

    def equations(self, assembler: Assembler) -> Equations:
        """See :class:`~hhr_dolfinx.full_order.constraints.Constraint`."""
        (dim,) = assembler.test.ufl_shape
        found = []
        for place, component, _ in self.terms:
            if component >= dim:
                raise SceneError(f"component {component} of {self!r} does not exist in {dim} dimensions")
            nodes, points = nodes_at(assembler, place, self)
            found.append(nodes[_in_order(points)])
        count = max(nodes.size for nodes in found)
        if any(nodes.size not in (1, count) for nodes in found) or found[0].size != count:
            raise SceneError(
                f"places of {self!r} have {[nodes.size for nodes in found]} nodes: give one or as many as the first"
            )
        entries = [
            (np.full(count, float(c)), np.arange(count), np.broadcast_to(dim * nodes + k, count))
            for nodes, (_, k, c) in zip(found, self.terms, strict=True)
        ]
        return equations_of(entries, entries[0][2].copy(), assembler.size, np.ones(count))


@dataclass(frozen=True)
class MeanMotion:
    """The mean displacement of some nodes along a component is the amplitude: a distributing coupling.

    A force on its reference point is a traction of the surface with that resultant.

    Attributes:
        place: set, surface or :class:`~hhr_dolfinx.parameters.Place`; on a surface nodes count by their areas.
        component: 0, 1 or 2.
        amplitude: the mean: a number, an Amplitude, or a formula of the parameters as text.
    """

    place: Tag | Place
    component: int
    amplitude: Amplitude | Formula = Amplitude()

    def __post_init__(self) -> None:
        check_place("mean motion", self.place)
        if not is_whole(self.component, 0):
            raise SceneError(f"component {self.component!r} of a mean motion must be 0, 1 or 2")
        check_amplitude(self, f"the mean motion of {self.place!r}", formulas=True)

    def equations(self, assembler: Assembler) -> Equations:
        """See :class:`~hhr_dolfinx.full_order.constraints.Constraint`."""
        (dim,) = assembler.test.ufl_shape
        if self.component >= dim:
            raise SceneError(f"component {self.component} of {self!r} does not exist in {dim} dimensions")
        nodes, _ = nodes_at(assembler, self.place, self)
        weights = np.full(nodes.size, 1.0 / nodes.size)
        if isinstance(self.place, int | str):
            with suppress(SceneError):  # a set of nodes without facets
                surface = assembler.surface(self.place)
                weights = np.bincount(np.searchsorted(nodes, surface.nodes), surface.areas, nodes.size)
                if surface.quadratic is not None:  # the integral of each function, whose corners have less than areas
                    along = np.eye(dim)[self.component].tolist()
                    form = elasticity.traction(assembler.test, along, assembler.hypothesis, assembler.ds(self.place))
                    weights = assembler.vector(form)[dim * nodes + self.component]
                weights = weights / weights.sum()
        dofs = dim * nodes + self.component
        entries = weights, np.zeros(nodes.size, dtype=int), dofs
        return equations_of([entries], dofs[[weights.argmax()]], assembler.size, np.ones(1))


def _leading(motions: np.ndarray, first: np.ndarray, among: np.ndarray) -> np.ndarray:
    """Dofs from which motions, (k, n), follow, the best of all: given ones, then some of a mask, (n,)."""
    basis = np.linalg.qr(motions[:, first])[0]
    left = np.where(among, motions - basis @ (basis.T @ motions), 0.0)
    _, triangle, order = qr(left, mode="economic", pivoting=True)
    count = int((np.abs(np.diag(triangle)) > 1e-9 * np.abs(motions).max()).sum())
    return np.append(first, order[:count])


@dataclass(frozen=True)
class RigidMotion:
    """Some nodes move as a rigid body: a rigid coupling, which forces and displacements on its nodes then move.

    Attributes:
        place: set, surface or :class:`~hhr_dolfinx.parameters.Place`.
    """

    place: Tag | Place
    amplitude: Amplitude = field(default=Amplitude(), init=False)

    def __post_init__(self) -> None:
        check_place("rigid motion", self.place)

    def equations(self, assembler: Assembler) -> Equations:
        """See :class:`~hhr_dolfinx.full_order.constraints.Constraint`; SceneError for too few nodes."""
        nodes, points = nodes_at(assembler, self.place, self)
        dim = points.shape[1]
        if len(points) < 2 or assembler.hypothesis == "axisymmetric":
            raise SceneError(f"{self!r} needs two nodes or more, and a mesh that is not axisymmetric")
        motions = rigid_motions(points, assembler.hypothesis).reshape(-1, points.size)
        dofs = (dim * nodes[:, None] + np.arange(dim)).ravel()
        free = np.ones(dofs.size, dtype=bool) if assembler.free is None else assembler.free[dofs]
        leading = _leading(motions, np.zeros(0, dtype=int), ~free)
        leading = _leading(motions, leading, np.ones(dofs.size, dtype=bool))
        rank = leading.size
        rest = np.setdiff1d(np.arange(dofs.size), leading)
        follows = np.linalg.lstsq(motions[:, leading], motions[:, rest], rcond=None)[0]
        # imposed dofs follow from imposed ones alone
        follows[np.abs(follows) < 1e-12] = 0.0
        count = rest.size
        entries: list[Any] = [(np.ones(count), np.arange(count), dofs[rest])]
        entries += [(-follows[k], np.arange(count), np.full(count, dofs[leading[k]])) for k in range(rank)]
        return equations_of(entries, dofs[rest], assembler.size)


@dataclass(frozen=True)
class Periodic:
    """Nodes of one surface move as those of another one, turned by an angle about an axis: cyclic symmetry.

    Each node of ``follower``, turned back, must be a node of ``leader``; a node of both, on the axis, stays on it.

    Attributes:
        follower, leader: surfaces or sets.
        angle: from leader to follower, in rad; 0 for a periodic structure.
        shift: from leader to follower, (dim,), after the turn; None for none.
        axis: axis of the turn through the origin, 0, 1 or 2; in the plane it is the normal.
    """

    follower: Tag | Place
    leader: Tag | Place
    angle: float = 0.0
    shift: tuple[float, ...] | None = None
    axis: int = 2
    amplitude: Amplitude = field(default=Amplitude(), init=False)

    def __post_init__(self) -> None:
        check_place("periodic surface", self.follower)
        check_place("periodic surface", self.leader)
        if not is_number(self.angle) or not is_whole(self.axis, 0) or self.axis > 2:
            raise SceneError(f"angle = {self.angle!r} and axis = {self.axis!r} must be a number, and 0, 1 or 2")
        if self.shift is not None:
            object.__setattr__(self, "shift", as_tuple("the shift of a periodic surface", self.shift))
            if not all(map(is_number, self.shift)):
                raise SceneError(f"the shift {self.shift} of a periodic surface must be finite")

    def turn(self, dim: int) -> np.ndarray:
        """Rotation by the angle, (dim, dim)."""
        found = np.eye(dim)
        one, other = (0, 1) if dim == 2 else ((1, 2), (2, 0), (0, 1))[self.axis]
        cosine = np.cos(self.angle)
        sine = np.sin(self.angle)
        found[np.ix_([one, other], [one, other])] = [[cosine, -sine], [sine, cosine]]
        return found

    def equations(self, assembler: Assembler) -> Equations:
        """See :class:`~hhr_dolfinx.full_order.constraints.Constraint`; SceneError for surfaces that do not match."""
        (dim,) = assembler.test.ufl_shape
        if (self.shift is not None and len(self.shift) != dim) or (dim == 2 and self.axis != 2):
            raise SceneError(f"{self!r}: in {dim} dimensions a shift has as many numbers, and in the plane axis = 2")
        if assembler.hypothesis == "axisymmetric" and self.angle:
            raise SceneError(f"{self!r} turns the plane (r, z), and an axisymmetric body with it: leave out the angle")
        own, places = nodes_at(assembler, self.follower, self)
        others, sources = nodes_at(assembler, self.leader, self)
        turn = self.turn(dim)
        turned = sources @ turn.T + (0.0 if self.shift is None else np.array(self.shift, dtype=float))
        far, which = cKDTree(turned).query(places)
        size = np.ptp(assembler.points(), axis=0).max()
        if far.max() > ALIKE * size:
            bad = int(far.argmax())
            raise SceneError(
                f"{self!r}: the node at {places[bad].tolist()} lies {far[bad]:.3g} beside those of the leader, turned "
                "and shifted: mesh both surfaces alike, or tie them"
            )
        count = own.size * dim
        dofs = (dim * own[:, None] + np.arange(dim)).ravel()
        entries: list[Any] = [(np.ones(count), np.arange(count), dofs)]
        for k in range(dim):
            entries.append((-np.tile(turn[:, k], own.size), np.arange(count), np.repeat(dim * others[which] + k, dim)))
        # of a node on the axis u = R u says nothing along the axis, nor of a shift
        says = (own != others[which])[:, None] | (np.abs(turn - np.eye(dim)).max(axis=1) > ALIKE)
        return equations_of(entries, dofs, assembler.size).take(says.ravel())
