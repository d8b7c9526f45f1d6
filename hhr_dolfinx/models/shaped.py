"""Reduced problems of scenes whose shape depends on parameters: assembled for each query, on the RID only.

The projection of (5.23) does not commute with a change of shape. What it needs of the mesh are the cells of the RID and
the parts of the contact surfaces around its conditions; they are kept as arrays, and moved and integrated anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.models.cells import CellRule, element_stiffness
from hhr_dolfinx.models.interpolation import Interpolant
from hhr_dolfinx.models.patches import ContactPatch
from hhr_dolfinx.models.projected import ReducedProblem
from hhr_dolfinx.shapes import Shape, coordinate_names


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
        shapes: how they move, in the order of the scene.
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
    shapes: tuple[RidShape, ...]
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
        names, moved = coordinate_names(self.hypothesis), self.reference.copy()
        values = dict(zip(self.names, point.tolist(), strict=True))
        for part in self.shapes:
            moved[part.nodes] = part.shape.moved(self.reference[part.nodes], names, values)
        return moved

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
        count, dim = points.shape[0], points.shape[1]
        weights = 2 * np.pi * points[:, 0] if self.hypothesis == "axisymmetric" else np.ones(count)
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
            rows = patch.rows(points, weights, tested)
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
