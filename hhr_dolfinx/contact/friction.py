"""Friction of contact pairs: laws that a user writes, and the rows that they add to B.

A contact with friction has one tangential row in the plane and two in space beside that of its pressure: with the
relative displacement of slave and master the same weights at the same nodes, along tangents in the place of the normal.
So B U <= D of thesis (1.27) gains rows whose slack is less the relative displacement along a tangent, and whose
multiplier τ is the tangential force on the slave with the opposite sign. Coulomb's law says

    |τ| <= min(coefficient λ, limit area),     and where the slack of an increment is not zero τ is opposed to it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from scipy.sparse import block_diag, csr_matrix, vstack

from hhr_dolfinx.contact.problem import ContactRows, joined
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Scalar, check_over_box, formula_of
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plain import Rebuilt

PARALLEL = 1e-9
"""Part of a row that may not be along its normal; more, and the row has no tangents."""
DEPENDENT = 1e-9
"""Part of a tangential row, in its own length, below which imposed displacements leave nothing of it."""


@dataclass(frozen=True)
class Coulomb:
    """Coulomb's law: the tangential force of a contact is at most its pressure times a coefficient.

    Attributes:
        coefficient: not negative; a number, or a formula of the parameters as text.
        limit: shear stress that no pressure exceeds, in the unit of stress; likewise, None without one.
    """

    coefficient: float | str
    limit: float | str | None = None

    def __post_init__(self) -> None:
        formula_of(self.coefficient, "the coefficient of friction")
        if self.limit is not None:
            formula_of(self.limit, "the limit of friction")


@dataclass(frozen=True)
class Tresca:
    """Tresca's law: the tangential stress is at most a given one, whatever the pressure, also where contact is open.

    That is the classical problem, which has one solution. A stress that ends where contact opens is a limit of
    Coulomb's law, ``Coulomb(coefficient, limit)``.

    Attributes:
        limit: shear stress, not negative, in the unit of stress; a number, or a formula of the parameters as text.
    """

    limit: float | str
    coefficient: ClassVar[None] = None

    def __post_init__(self) -> None:
        formula_of(self.limit, "the limit of friction")


Law = Coulomb | Tresca


def law_of(friction: Any, what: str) -> Law | None:
    """What a user gave as friction of a pair: None, a law, or the coefficient of Coulomb's.

    Raises:
        SceneError: for anything else.
    """
    if friction is None or isinstance(friction, Coulomb | Tresca):
        return friction
    try:
        return Coulomb(friction)
    except SceneError:
        raise SceneError(
            f"friction = {friction!r} of {what} is unknown: give the coefficient as a number or a formula, "
            "friction=0.3, or a law, Coulomb(0.3, limit) or Tresca(limit)"
        ) from None


@dataclass(frozen=True)
class FrictionLaw(Rebuilt):
    """A law of friction whose constants are functions of the parameters.

    Attributes:
        coefficient: of Coulomb's law; None of Tresca's.
        limit: of the tangential stress; None without one.
    """

    coefficient: Scalar | None
    limit: Scalar | None

    @classmethod
    def of(cls, law: Law, space: ParameterSpace, what: str) -> FrictionLaw:
        """A law over the box of a scene.

        Raises:
            SceneError: where a constant is negative or not finite somewhere in the box, or names an unknown parameter.
        """
        found: list[Scalar | None] = []
        for name, value in (("coefficient", law.coefficient), ("limit", law.limit)):
            found.append(None if value is None else _scalar(value, space, f"the {name} of friction of {what}"))
        return cls(*found)

    def at(self, point: np.ndarray) -> tuple[float, float]:
        """Coefficient and limit at a point, (P,); infinite where there is none."""
        coefficient, limit = (
            np.inf if scalar is None else scalar.value(point) for scalar in (self.coefficient, self.limit)
        )
        return coefficient, limit


def _scalar(value: float | str, space: ParameterSpace, called: str) -> Scalar:
    try:
        scalar = Scalar(formula_of(value, called).text, space.names)
    except SceneError as error:
        raise SceneError(f"{called}: {error}") from None
    remedy = "it must be finite and not negative everywhere in the box: change the formula, or narrow the box"
    check_over_box(scalar, space, called, -1e-300, np.inf, remedy)
    return scalar


@dataclass(frozen=True)
class Friction(Rebuilt):
    """Which rows of B are tangential, and what bounds their forces (C contacts with friction, T tangential rows).

    Attributes:
        normal: row of the pressure of each contact, (C,).
        area: its tributary area, (C,).
        law: its law, a place in ``laws``, (C,).
        tangential: tangential rows, contact by contact, (T,): none where no dof moves along the surface.
        owner: contact of each of them, (T,).
        tangents: its unit vector, (T, dim).
        laws: of the pairs.
        fixed: places of the parameters on which laws, moduli or shapes depend: they stay while loads grow in
            proportion.
    """

    normal: Annotated[Integers, "frictional"]
    area: Annotated[Floats, "frictional"]
    law: Annotated[Integers, "frictional"]
    tangential: Annotated[Integers, "tangential"]
    owner: Annotated[Integers, "tangential"]
    tangents: Annotated[Floats, "tangential", "dimension"]
    laws: tuple[FrictionLaw, ...]
    fixed: Annotated[Integers, "fixed parameters"]

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Rows that are not there, or not in order."""
        rows = np.concatenate([self.normal, self.tangential])
        if rows.size and not (0 <= rows.min() and rows.max() < sizes.get("m", 1 + int(rows.max()))):
            yield "rows of friction are not among the contact conditions"
        if np.unique(rows).size != rows.size:
            yield "rows of friction are there twice"
        if self.owner.size and (np.diff(self.owner).min(initial=0) < 0 or self.owner.max() >= self.normal.size):
            yield "tangential rows belong to no contact"
        if self.law.size and not (0 <= self.law.min() and self.law.max() < len(self.laws)):
            yield "contacts have a law of friction that is not there"

    def pressures(self, rows: int) -> np.ndarray:
        """Rows that are not tangential of so many."""
        return np.setdiff1d(np.arange(rows), self.tangential, assume_unique=True)

    def bounds(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficient and largest tangential force of each contact at a point, (C,) each, see :meth:`FrictionLaw.at`."""
        coefficients, limits = np.array([law.at(point) for law in self.laws]).T
        limits = limits[self.law]
        return coefficients[self.law], np.where(np.isinf(limits), np.inf, limits * self.area)

    def statuses(self, active: np.ndarray) -> np.ndarray:
        """Status of each contact from those of all rows, (M,) bool: 0 open, 1 sticks, 2 slips, (C,)."""
        sticks = np.bincount(self.owner, ~active[self.tangential], self.normal.size) == 0
        return np.where(active[self.normal], np.where(sticks, 1, 2), 0)

    def take(self, rows: np.ndarray, count: int) -> Friction | None:
        """What is left on some of so many rows, numbered as in ``rows``; None without a contact.

        A contact whose pressure is not among them is left out, with its tangential rows.
        """
        place = np.full(count, -1)
        place[rows] = np.arange(rows.size)
        kept = np.flatnonzero(place[self.normal] >= 0)
        if not kept.size:
            return None
        number = np.full(self.normal.size, -1)
        number[kept] = np.arange(kept.size)
        own = np.flatnonzero((place[self.tangential] >= 0) & (number[self.owner] >= 0))
        return Friction(
            place[self.normal[kept]], self.area[kept], self.law[kept],
            place[self.tangential[own]], number[self.owner[own]], self.tangents[own], self.laws, self.fixed,
        )  # fmt: skip


class SlipState(NamedTuple):
    """What friction remembers (T tangential rows, C contacts).

    Attributes:
        position: slack of the tangential rows, from which the next increment slips, (T,).
        path: length that each contact has slipped while it was closed, (C,).
        work: energy that friction has dissipated there, (C,).
        wear: integral of the pressure along what has slipped, (C,): Archard's wear in depth per unit of his constant.
    """

    position: np.ndarray
    path: np.ndarray
    work: np.ndarray
    wear: np.ndarray

    @classmethod
    def at_rest(cls, friction: Friction) -> SlipState:
        """Nothing has slipped."""
        nothing = np.zeros((3, friction.normal.size))
        return cls(np.zeros(friction.tangential.size), *nothing)

    def after(self, friction: Friction, forces: np.ndarray, slack: np.ndarray, active: np.ndarray) -> SlipState:
        """After an increment, with forces and slack of all rows, (M,) each; tangential slack is what slipped."""
        moved = slack[friction.tangential]
        count = friction.normal.size
        slipped = np.sqrt(np.bincount(friction.owner, moved**2, count)) * active[friction.normal]
        work = np.bincount(friction.owner, -moved * forces[friction.tangential], count)
        pressure = np.divide(forces[friction.normal], friction.area, out=np.zeros(count), where=friction.area > 0)
        return SlipState(self.position + moved, self.path + slipped, self.work + work, self.wear + pressure * slipped)


def with_tangents(
    rows: ContactRows, pairs: np.ndarray, laws: Mapping[int, FrictionLaw], free: np.ndarray, fixed: np.ndarray
) -> tuple[ContactRows, np.ndarray, Friction]:
    """Conditions with the tangential rows of some pairs behind them, the pair of each, and the friction on them.

    Along what imposed displacements hold nothing slips: such tangents are left out.

    Args:
        rows: conditions of pressures.
        pairs: contact pair of each, (n,).
        laws: of the pairs that have friction.
        free: dofs that are not imposed, (N,) bool.
        fixed: see :class:`Friction`.

    Raises:
        SceneError: for rows that are not along one normal each.
    """
    dim = rows.points.shape[1]
    normal = np.flatnonzero(np.isin(pairs, list(laws)))
    own = rows.take(normal)
    normals = normals_of(own.matrix, own.slaves, dim)
    tangents = tangents_of(normals)
    matrix = tangential_rows(own.matrix, normals, tangents)
    owner = np.repeat(np.arange(normal.size), dim - 1)
    turns, owner = _movable(matrix, owner, free)
    matrix = csr_matrix(turns @ matrix)
    tangents = turns @ tangents.reshape(-1, dim)
    behind = ContactRows(matrix, np.zeros(owner.size), own.slaves[owner], own.points[owner], own.areas[owner])
    numbers = np.array(list(laws))
    friction = Friction(
        normal, own.areas, np.searchsorted(numbers, pairs[normal]),
        len(pairs) + np.arange(owner.size), owner, tangents, tuple(laws.values()), fixed,
    )  # fmt: skip
    return joined([rows, behind]), np.concatenate([pairs, pairs[normal][owner]]), friction


def _movable(matrix: csr_matrix, owner: np.ndarray, free: np.ndarray) -> tuple[csr_matrix, np.ndarray]:
    """Combinations of the tangential rows of each contact, (T', T), that are independent on free dofs, and their owner.

    Where all of its rows are they stay as they are; else they are turned, and what is held is left out.
    """
    moving = csr_matrix(matrix.multiply(free.astype(float)))
    every = np.asarray(matrix.multiply(matrix).sum(axis=1)).ravel()
    k = int(np.bincount(owner).max(initial=1))
    blocks = []
    for first in range(0, owner.size, k):
        rows = moving[first : first + k]
        sizes, ways = np.linalg.eigh((rows @ rows.T).toarray())
        kept = sizes > DEPENDENT * every[first : first + k].max()
        blocks.append(np.eye(k) if kept.all() else ways[:, kept].T)
    turns = csr_matrix(block_diag(blocks))
    return turns, np.repeat(owner[::k], [len(block) for block in blocks])


def normals_of(matrix: csr_matrix, slaves: np.ndarray, dimension: int) -> np.ndarray:
    """Unit normal of each row of B, at its slave, (m, dim)."""
    rows = np.arange(matrix.shape[0])
    found = np.column_stack([np.asarray(matrix[rows, slaves * dimension + axis]).ravel() for axis in range(dimension)])
    lengths = np.linalg.norm(found, axis=1)
    return found / np.where(lengths > 0, lengths, 1.0)[:, None]


def tangents_of(normals: np.ndarray) -> np.ndarray:
    """Orthonormal tangents of each normal, (m, dim - 1, dim): turned by a right angle, in space along two axes."""
    m, dim = normals.shape
    if dim == 2:
        return np.stack([-normals[:, 1], normals[:, 0]], axis=1)[:, None, :]
    # the axis that is most nearly tangential for the whole surface, so that neighbours agree
    axis = np.zeros((m, 3))
    axis[np.arange(m), np.abs(normals).argmin(axis=1)] = 1.0
    first = axis - (axis * normals).sum(axis=1)[:, None] * normals
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normals, first)], axis=1)


def tangential_rows(matrix: csr_matrix, normals: np.ndarray, tangents: np.ndarray) -> csr_matrix:
    """Rows of B with tangents in the place of their normals, (m k, N), the k of each row behind each other.

    Args:
        matrix: rows sum_j w_j n·u_j, (m, N).
        normals: n of each row, (m, dim).
        tangents: (m, k, dim).

    Raises:
        SceneError: for rows that are not along one normal.
    """
    m, dim = normals.shape
    coo = matrix.tocoo()
    node, component = np.divmod(coo.col, dim)
    weights = csr_matrix((coo.data * normals[coo.row, component], (coo.row, node)), shape=(m, matrix.shape[1] // dim))
    weights = weights.tocoo()
    columns = weights.col[:, None] * dim + np.arange(dim)

    def along(vectors: np.ndarray) -> csr_matrix:
        entries = weights.data[:, None] * vectors[weights.row]
        rows = np.repeat(weights.row, dim)
        return csr_matrix((entries.ravel(), (rows, columns.ravel())), shape=matrix.shape)

    off = abs(matrix - along(normals))
    if off.nnz and off.max() > PARALLEL * abs(matrix).max():
        raise SceneError("friction needs rows that are along one normal each: those of this pairing are not")
    k = tangents.shape[1]
    parts = vstack([along(tangents[:, j]) for j in range(k)])
    return csr_matrix(csr_matrix(parts)[np.arange(m * k).reshape(k, m).T.ravel()])
