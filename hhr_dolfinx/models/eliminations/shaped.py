"""Reduced problems of scenes whose shape depends on parameters: assembled for each query, on the RID only.

The projection of (5.23) does not commute with a change of shape. What it needs of the mesh are the cells of the RID and
the parts of the contact surfaces around its conditions; they are kept as arrays, and moved and integrated anew.
Pairings see only these parts of the surfaces. Where the whole basis is small its arrays are interpolated instead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Annotated, Any, NamedTuple

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs
from scipy.sparse import csr_matrix

from hhr_dolfinx.amplitudes import Amplitudes, Theta
from hhr_dolfinx.contact.problem import ContactRows
from hhr_dolfinx.declared import Booleans, Floats, Integers
from hhr_dolfinx.errors import PairingWarning, ParameterError, SceneError, SingularError
from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.models.eliminations.elimination import CondensedContact, Elimination
from hhr_dolfinx.models.eliminations.interpolation import Interpolant
from hhr_dolfinx.models.eliminations.projected import ReducedProblem
from hhr_dolfinx.models.functionals.cells import CellRule, Middles, element_stiffness
from hhr_dolfinx.pairings.projection import shape_functions
from hhr_dolfinx.pairings.surface import Surface, make_surface
from hhr_dolfinx.parameters import ParameterSpace, Tag
from hhr_dolfinx.shapes import Shape, coordinate_names
from hhr_dolfinx.warn import ignored

DIFFERENCE = 1e-4
"""Part of the box by which the problem is moved to either side for its derivatives: their error is its square."""


@dataclass(frozen=True)
class InterpolatedProblem:
    """A reduced problem whose arrays are interpolated over the parameters of a shape; maps a point to the one there.

    Attributes:
        pairs: number of the contact pair of each condition, (m,).
        moduli: of the parts of its stiffness.
        sizes: these moduli in the middle of the box, by which the parts are multiplied, (Q,).
        interpolant: of the arrays beside each other, in the order of ``shapes``.
        shapes: of the arrays: parts of K~, their lifts, forces, B~1, B~2, gaps.
    """

    pairs: Annotated[Integers, "conditions"]
    moduli: tuple[Modulus, ...]
    sizes: Annotated[Floats, "parts"]
    interpolant: Interpolant
    shapes: tuple[tuple[int, ...], ...]

    def __call__(self, point: np.ndarray) -> ReducedProblem:
        """The problem at a point, (P,), of constant stiffness."""
        values = self.interpolant.value(point)
        first = 0
        parts = []
        for shape in self.shapes:
            size = int(np.prod(shape))
            parts.append(values[first : first + size].reshape(shape))
            first += size
        stiffness, lifts, forces, test, trial, gaps = parts
        weights = np.array([modulus.value(point) for modulus in self.moduli]) / self.sizes
        loads = forces - np.tensordot(weights, lifts, 1)
        return ReducedProblem(np.tensordot(weights, stiffness, 1), test, trial, loads, gaps, self.pairs)


@dataclass(frozen=True)
class ReshapedElimination(Elimination):
    """Eliminates gamma from the problem of each point, (P,).

    Attributes:
        problem_at: makes the reduced problem of a point, of constant stiffness.
        amplitudes: θ as a function of the parameters.
        parameters: the box of the parameters.
    """

    problem_at: Callable[[np.ndarray], ReducedProblem]
    amplitudes: Amplitudes
    parameters: ParameterSpace

    def under(self, point: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """gamma, (ell,), at a point under known contact forces, (m,): one solve, and not one for each condition.

        Raises:
            SingularError: if K~ is singular there.
        """
        problem, theta, factors = self._factored(point)
        return dgetrs(*factors, problem.loads @ theta - problem.contact_test.T @ forces)[0]

    def many_under(self, points: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """The same at many points, (n, P), under forces of each, (n, m): (n, ell)."""
        return np.array([self.under(*one) for one in zip(points, forces, strict=True)])

    def __call__(self, point: np.ndarray) -> CondensedContact:
        """Factor K~ of a point.

        Raises:
            SingularError: if K~ is singular there.
        """
        problem, theta, factors = self._factored(point)
        solved = dgetrs(*factors, np.column_stack([problem.loads @ theta, problem.contact_test.T]))[0]
        free = solved[:, 0]
        per_force = solved[:, 1:]
        slack = problem.gaps @ theta - problem.contact_trial @ free
        changes = partial(self._changes, point, problem.contact_trial, factors)
        return CondensedContact(problem.contact_trial @ per_force, slack, free, partial(np.matmul, per_force), changes)

    def _changes(
        self, point: np.ndarray, trial: np.ndarray, factors: tuple, forces: np.ndarray, unknown: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """K~ gamma' = -R' with the residual R differenced between problems a little to either side."""

        def residual_and_slack(moved: np.ndarray) -> np.ndarray:
            problem = self.problem_at(moved)
            theta = self.amplitudes(moved)
            left = problem.stiffness @ unknown + problem.contact_test.T @ forces - problem.loads @ theta
            return np.append(left, problem.gaps @ theta - problem.contact_trial @ unknown)

        explicit = self.parameters.differences(residual_and_slack, point, DIFFERENCE)
        size = unknown.size
        found = dgetrs(*factors, -explicit[:size])[0]
        return explicit[size:] - trial @ found, found

    def _factored(self, point: np.ndarray) -> tuple[ReducedProblem, Theta, tuple[np.ndarray, np.ndarray]]:
        """The problem of a point, θ there and the LU factors of K~.

        Raises:
            SingularError: if K~ is singular there.
        """
        problem = self.problem_at(point)
        theta = self.amplitudes(point)
        lu, pivots, info = dgetrf(problem.stiffness)
        if info:
            raise SingularError(f"K~ of {len(problem.stiffness)} modes is singular at {point.tolist()}")
        return problem, theta, (lu, pivots)


ROUND_OFF = 1e-12
"""Weight of a node in a condition below which it has nothing to do with it."""


class PlacedNodes(NamedTuple):
    """Nodes of a mesh at one parameter.

    Attributes:
        points: their coordinates, (n, dim).
        weights: of the surface measure there, (n,).
        free: which components of their displacement are not imposed, (n, dim) bool.
    """

    points: np.ndarray
    weights: np.ndarray
    free: np.ndarray

    @classmethod
    def at(cls, points: np.ndarray, hypothesis: str, free: np.ndarray) -> PlacedNodes:
        """Nodes at some points, (n, dim), of a scene of one hypothesis."""
        weights = 2 * np.pi * points[:, 0] if hypothesis == "axisymmetric" else np.ones(len(points))
        return cls(points, weights, free)


@dataclass(frozen=True)
class SurfacePatch:
    """A part of a tagged surface, its nodes by number.

    Attributes:
        tag: facet tag.
        facets: nodes of each facet, (f, k), quadrilaterals in tensor order; all of those of second order.
        behind: corners of the far side of the cell behind each facet, (f, r).
        edge: nodes where the surface goes on beyond the patch, (e,).
    """

    tag: Tag
    facets: Annotated[Integers, "facets", "nodes of a facet"]
    behind: Annotated[Integers, "facets", "nodes behind"]
    edge: Annotated[Integers, "edge"]

    @property
    def nodes(self) -> np.ndarray:
        """All nodes whose coordinates are needed."""
        return np.unique(np.concatenate([self.facets.ravel(), self.behind.ravel()]))

    def renumbered(self, numbers: np.ndarray) -> SurfacePatch:
        """The same for new numbers of the nodes, by the old ones."""
        return replace(self, facets=numbers[self.facets], behind=numbers[self.behind], edge=numbers[self.edge])

    def surface(self, placed: PlacedNodes) -> Surface:
        """The surface where nodes lie at some points."""
        points, weights, free = placed
        facets = self.facets
        if facets.shape[1] > 2 * (points.shape[1] - 1):
            from hhr_dolfinx.pairings.second_order import flat_parts

            facets = flat_parts(facets)
        areas = tributary_areas(facets, points, weights)
        made = make_surface(self.tag, self.facets, points[self.behind].mean(axis=1), points, weights, areas)
        return made if made.quadratic is None else replace(made, free=free[made.nodes])


@dataclass(frozen=True)
class ContactPatch:
    """What a contact pair needs for its conditions in a reduced domain.

    Attributes:
        pairing: the pairing, a frozen dataclass.
        surfaces: parts of its surfaces in the order of its tags.
        slaves: slave node of each condition, (m,).
        places: place of each condition among those of the domain, (m,).
    """

    pairing: Any
    surfaces: tuple[SurfacePatch, ...]
    slaves: Annotated[Integers, "conditions"]
    places: Annotated[Integers, "conditions", "< m"]

    @property
    def nodes(self) -> np.ndarray:
        """All nodes whose coordinates are needed."""
        return np.unique(np.concatenate([self.slaves, *(surface.nodes for surface in self.surfaces)]))

    def renumbered(self, numbers: np.ndarray) -> ContactPatch:
        """The same for new numbers of the nodes, by the old ones."""
        surfaces = tuple(surface.renumbered(numbers) for surface in self.surfaces)
        return replace(self, surfaces=surfaces, slaves=numbers[self.slaves])

    def rows(self, placed: PlacedNodes, tested: np.ndarray) -> ContactRows:
        """Its conditions where nodes lie at some points, in their order.

        Args:
            placed: the nodes.
            tested: dofs on which all contact forces must be known, (n dim,) bool.

        Raises:
            ParameterError: if a condition is not there, reaches beyond the patch, or others act on tested dofs.
        """
        found, kept = self.found(placed)
        others = np.setdiff1d(np.arange(len(found.slaves)), kept)
        if _touch(found.matrix[others], tested):
            raise ParameterError(
                f"for this shape further conditions of the contact {self.pairing} act on the reduced domain than where "
                "it was built: surfaces slide along each other. Narrow the box, or add layers to the domain"
            )
        rows = found.take(kept)
        edge = np.zeros(len(placed.points), dtype=bool)
        edge[np.concatenate([part.edge for part in self.surfaces])] = True
        if _touch(rows.matrix, np.repeat(edge, placed.points.shape[1])):
            raise ParameterError(
                f"for this shape conditions of the contact {self.pairing} reach beyond the part of the surfaces that "
                "the reduced model knows: surfaces slide along each other. Narrow the box"
            )
        return rows

    def found(self, placed: PlacedNodes) -> tuple[ContactRows, np.ndarray]:
        """All conditions that the pairing finds on the patch, and the places of its own among them, (m,).

        Raises:
            ParameterError: if one of its own is not there.
        """
        try:
            with ignored(PairingWarning):  # said where the full model was built
                found = self.pairing.rows([part.surface(placed) for part in self.surfaces], placed.points.size)
        except SceneError as error:
            raise ParameterError(f"the contact {self.pairing} cannot be evaluated for this shape: {error}") from None
        place = np.full(len(placed.points), -1)
        place[found.slaves] = np.arange(len(found.slaves))
        kept = place[self.slaves]
        if (kept < 0).any():
            raise ParameterError(
                f"{int((kept < 0).sum())} conditions of the contact {self.pairing} are not there for this shape: it "
                "changes which surfaces face each other. Narrow the box"
            )
        return found, kept


def _touch(matrix: csr_matrix, dofs: np.ndarray) -> bool:
    """Whether rows have entries at some dofs, by a mask."""
    return bool((abs(matrix) @ dofs.astype(float) > ROUND_OFF).any())


def tributary_areas(facets: np.ndarray, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Integrals of the shape functions of facets over the surface at all nodes, (n,).

    They are exact but for quadrilaterals that are no parallelograms, which have 2 x 2 points; weights, (n,), are linear
    along an edge and constant in space.
    """
    corners = points[facets]
    at_corners = weights[facets]
    if facets.shape[1] == 2:
        length = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
        shares = length[:, None] * (2 * at_corners + at_corners[:, ::-1]) / 6
    elif facets.shape[1] == 3:
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        shares = at_corners * (np.linalg.norm(normals, axis=1) / 6)[:, None]
    else:
        gauss = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3)
        local = np.column_stack([np.tile(gauss, 2), np.repeat(gauss, 2)])
        values, slopes = shape_functions(local, 4)
        along = np.einsum("qkj,fkd->jfqd", slopes, corners)
        shares = at_corners * (np.linalg.norm(np.cross(along[0], along[1]), axis=2) @ values / 4)
    return np.bincount(facets.ravel(), shares.ravel(), len(points))


@dataclass(frozen=True)
class RidShape:
    """A shape, and the nodes of the reduced model that it moves.

    Attributes:
        shape: formulas of the coordinates.
        nodes: numbers within the reduced model, (k,).
    """

    shape: Shape
    nodes: Annotated[Integers, "nodes"]


@dataclass(frozen=True)
class RidBody:
    """Cells of one body in the RID that move.

    Attributes:
        cells: their nodes, numbers within the reduced model, (c, n).
        volume: λ', weight of the change of volume.
        shape: μ', weight of the change of shape.
        mean_dilatation: whether they take the mean dilatation of each cell.
    """

    cells: Annotated[Integers, "cells", "nodes of a cell"]
    volume: Modulus
    shape: Modulus
    mean_dilatation: bool


@dataclass(frozen=True)
class FixedCells:
    """What cells of the RID that do not move add to K~, projected once.

    Attributes:
        moduli: weights of the parts.
        stiffness: V[A]^T K_q[A, :] V, (Q, ell, ell).
        lifts: V[A]^T K_q[A, :] lifts, (Q, ell, 1 + T).
    """

    moduli: tuple[Modulus, ...]
    stiffness: Annotated[Floats, "parts", "modes", "modes"]
    lifts: Annotated[Floats, "parts", "modes", "terms"]


class Conditions(NamedTuple):
    """Contact conditions at one parameter.

    Attributes:
        test: B~1, (m, ell).
        trial: B~2, (m, ell).
        gaps: D - B lift, (m, 1 + T).
        points: position of each condition, (m, dim).
        areas: tributary area of each, (m,).
    """

    test: np.ndarray
    trial: np.ndarray
    gaps: np.ndarray
    points: np.ndarray
    areas: np.ndarray


@dataclass(frozen=True)
class RidAssembly:
    """Maps a point of the parameters to the reduced problem (5.23) of the shape there, of constant stiffness.

    It holds the n nodes of the cells of the RID and of the parts of the surfaces around its conditions. Loads are
    interpolated over the parameters of the shape, all else is exact: it is what ``project`` makes of the full problem
    at that point, but that gaps are read from all nodes that conditions touch there.

    Attributes:
        hypothesis: of the scene.
        names: of the parameters, in the order of a point.
        reference: coordinates of the nodes on the mesh as it was made, (n, dim).
        free: which components of their displacement are not imposed, (n, dim).
        shapes: how they move, in the order of the scene.
        middles: those that stay in the middle of others.
        rule: quadrature on the cells, that of the full model.
        bodies: cells that move.
        fixed: what the others add.
        basis: V, (n dim, ell).
        lifts: imposed displacements, (n dim, 1 + T).
        tested: dofs of A, (a,).
        patches: contact pairs.
        openings: what openings add to the gaps, (m, 1 + T).
        pairs: number of the contact pair of each condition, (m,).
        forces: V[A]^T F[A], (ell (1 + T),), row by row.
    """

    hypothesis: str
    names: tuple[str, ...]
    reference: Annotated[Floats, "nodes", "dim"]
    free: Annotated[Booleans, "nodes", "dim"]
    shapes: tuple[RidShape, ...]
    middles: Middles
    rule: CellRule
    bodies: tuple[RidBody, ...]
    fixed: FixedCells
    basis: Annotated[Floats, "nodes * dim", "modes"]
    lifts: Annotated[Floats, "nodes * dim", "terms"]
    tested: Annotated[Integers, "tested", "< nodes * dim"]
    patches: tuple[ContactPatch, ...]
    openings: Annotated[Floats, "conditions", "terms"]
    pairs: Annotated[Integers, "conditions"]
    forces: Interpolant

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """What is wrong with the numbers of nodes."""
        of_cells = [body.cells for body in self.bodies]
        of_shapes = [part.nodes for part in self.shapes]
        of_surfaces = [patch.nodes for patch in self.patches]
        for nodes in (*of_cells, *of_shapes, *of_surfaces, self.middles.nodes, self.middles.between):
            if nodes.size and not 0 <= nodes.min() <= nodes.max() < len(self.reference):
                yield f"it names nodes outside 0 .. {len(self.reference) - 1}"

    def __call__(self, point: np.ndarray) -> ReducedProblem:
        """The reduced problem at a point, (P,).

        Raises:
            ParameterError: where other conditions act on the domain than where it was built.
        """
        points = self.coordinates(point)
        stiffness, lifted = self.stiffness(point, points)
        found = self.conditions(points)
        return ReducedProblem(
            stiffness=stiffness,
            contact_test=found.test,
            contact_trial=found.trial,
            loads=self.forces.value(point).reshape(lifted.shape) - lifted,
            gaps=found.gaps,
            pairs=self.pairs,
        )

    def coordinates(self, point: np.ndarray) -> np.ndarray:
        """Coordinates of the nodes at a point, (n, dim)."""
        names = coordinate_names(self.hypothesis)
        moved = self.reference.copy()
        values = dict(zip(self.names, point.tolist(), strict=True))
        for part in self.shapes:
            moved[part.nodes] = part.shape.moved(self.reference[part.nodes], names, values)
        return self.middles.placed(moved)

    def stiffness(self, point: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """K~, (ell, ell), and V[A]^T K[A, :] lifts, (ell, 1 + T), with the nodes at some points, (n, dim)."""
        weights = np.array([modulus.value(point) for modulus in self.fixed.moduli])
        stiffness = np.tensordot(weights, self.fixed.stiffness, 1)
        lifted = np.tensordot(weights, self.fixed.lifts, 1)
        for body, projection in zip(self.bodies, self.projections, strict=True):
            moduli = body.volume.value(point), body.shape.value(point)
            cells = element_stiffness(points[body.cells], self.rule, self.hypothesis, *moduli, body.mean_dilatation)
            projection.add(cells, stiffness, lifted)
        return stiffness, lifted

    def conditions(self, points: np.ndarray) -> Conditions:
        """Contact conditions with the nodes at some points, (n, dim)."""
        count = points.shape[0]
        dim = points.shape[1]
        placed = PlacedNodes.at(points, self.hypothesis, self.free)
        tested = np.zeros(count * dim, dtype=bool)
        tested[self.tested] = True
        size = len(self.pairs)
        found = Conditions(
            test=np.zeros((size, self.basis.shape[1])),
            trial=np.zeros((size, self.basis.shape[1])),
            gaps=self.openings.copy(),
            points=np.zeros((size, dim)),
            areas=np.zeros(size),
        )
        for patch in self.patches:
            rows = patch.rows(placed, tested)
            matrix = rows.matrix
            acting = csr_matrix((matrix.data * tested[matrix.indices], matrix.indices, matrix.indptr), matrix.shape)
            found.test[patch.places] = acting @ self.basis
            found.trial[patch.places] = matrix @ self.basis
            found.gaps[patch.places] -= matrix @ self.lifts
            found.gaps[patch.places, 0] += rows.gap
            found.points[patch.places] = rows.points
            found.areas[patch.places] = rows.areas
        return found

    @cached_property
    def projections(self) -> tuple[CellProjection, ...]:
        """Of the cells of each body that moves."""
        fields = self.basis, self.lifts, self.tested, self.reference.shape[1]
        return tuple(CellProjection.of(body.cells, *fields) for body in self.bodies)


@dataclass(frozen=True)
class CellProjection:
    """Adds up the stiffness of cells in a fixed pattern, on the rows of A alone, and projects it.

    Modes and lifts that vanish on the cells are left out: bodies that only contact joins have modes of their own.

    Attributes:
        position: place of each entry of each cell among those of K[A, :], beyond them where its row is not in A.
        indptr, indices: rows of K[A, :] over the dofs of the cells, compressed.
        modes: modes that do not vanish on the cells, (k,).
        columns: lifts that do not, (l,).
        trial: these modes and lifts on the dofs of the cells, (d, k + l).
        test: the modes on A, (k, a).
    """

    position: np.ndarray
    indptr: np.ndarray
    indices: np.ndarray
    modes: np.ndarray
    columns: np.ndarray
    trial: np.ndarray
    test: np.ndarray

    @classmethod
    def of(
        cls, cells: np.ndarray, basis: np.ndarray, lifts: np.ndarray, tested: np.ndarray, dim: int
    ) -> CellProjection:
        """The projection of cells, (c, n), for modes (n dim, ell), lifts (n dim, 1 + T), and the dofs of A, (a,)."""
        own = (np.unique(cells)[:, None] * dim + np.arange(dim)).ravel()
        number = np.full(len(basis), -1)
        number[own] = np.arange(own.size)
        dofs = number[(cells[:, :, None] * dim + np.arange(dim)).reshape(len(cells), -1)]
        inner = np.intersect1d(own, tested)
        row = np.full(own.size, -1)
        row[number[inner]] = np.arange(inner.size)
        rows = row[dofs][:, :, None]
        keys = np.where(rows >= 0, rows * own.size + dofs[:, None], inner.size * own.size)
        every, position = np.unique(keys, return_inverse=True)
        every = every[every < inner.size * own.size]
        modes, columns = (np.flatnonzero(np.any(fields[own], axis=0)) for fields in (basis, lifts))
        return cls(
            position=position.ravel(),
            indptr=np.searchsorted(every, np.arange(inner.size + 1) * own.size).astype(np.int32),
            indices=(every % own.size).astype(np.int32),
            modes=modes,
            columns=columns,
            trial=np.hstack([basis[np.ix_(own, modes)], lifts[np.ix_(own, columns)]]),
            test=np.ascontiguousarray(basis[np.ix_(inner, modes)].T),
        )

    def matrix(self, cells: np.ndarray) -> csr_matrix:
        """K[A, :] of element matrices, (c, d, d), (a, d)."""
        data = np.bincount(self.position, cells.ravel(), self.indices.size)[: self.indices.size]
        shape = self.indptr.size - 1, len(self.trial)
        return csr_matrix((data, self.indices, self.indptr), shape=shape)

    def add(self, cells: np.ndarray, stiffness: np.ndarray, lifted: np.ndarray) -> None:
        """Add what element matrices, (c, d, d), leave to K~, (ell, ell), and to V[A]^T K[A, :] lifts, (ell, 1 + T)."""
        projected = self.test @ (self.matrix(cells) @ self.trial)
        count = self.modes.size
        stiffness[np.ix_(self.modes, self.modes)] += projected[:, :count]
        lifted[np.ix_(self.modes, self.columns)] += projected[:, count:]
