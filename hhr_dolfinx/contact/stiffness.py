"""Stiffness at one point of the parameters: an immutable object that solves with its matrix.

Factors are leased from a :class:`FactorStore`, which keeps few of them and factors dropped ones
again.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cached_property
from threading import Lock, RLock, local
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, spmatrix

from hhr_dolfinx.contact.active_set import SchurEqualities

if TYPE_CHECKING:
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.linear.sparse import FreeCholesky

    Factors: TypeAlias = FreeCholesky


class Stiffness(ABC):
    """K at a point with the contact rows B there (n own dofs, m conditions)."""

    symmetric: bool = True  #: equality problems on S use its symmetry

    @abstractmethod
    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """K^-1 times a vector, (n,)."""

    @abstractmethod
    def columns(self, rhs: spmatrix) -> np.ndarray:
        """K^-1 times the columns of a sparse matrix, (n, k)."""

    @abstractmethod
    def response_to_forces(self, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T times contact forces, (m,) or (m, k): (n,) or (n, k)."""

    @property
    @abstractmethod
    def schur(self) -> np.ndarray:
        """S = B K^-1 B^T, (m, m): one array, so that ``is`` shows whether K changed."""

    @abstractmethod
    def held(self) -> AbstractContextManager[object]:
        """Keep the factors of this stiffness in the store meanwhile: saves time, and does not
        change results.
        """

    @cached_property
    def equalities(self) -> SchurEqualities:
        """Equality problems on S, whose dense factors are shared by all users of this stiffness."""
        return (
            SchurEqualities.symmetric(self.schur)
            if self.symmetric
            else SchurEqualities.of(self.schur)
        )


class FactorStore:
    """Factors, by ``make``, of at most ``most`` matrices with one pattern.

    A thread leases the factors of one matrix at a time, so that threads cannot deadlock. All ranks
    request factors in the same order.
    """

    def __init__(self, make: Callable[[csr_matrix], Factors], most: int = 1):
        self._make = make
        self._most = most
        self._slots: list[Factors] = []  # the last one used is the last
        self._lock = RLock()
        self._leased = local()

    @property
    def first(self) -> Factors:
        """The oldest factors in the store."""
        return self._slots[0]

    def of(self, matrix: csr_matrix) -> Lease:
        """Lease the factors of a matrix: a context in which they are not replaced by others."""
        return Lease(self, matrix)

    def solve(self, matrix: csr_matrix, rhs: np.ndarray) -> np.ndarray:
        """K^-1 times a vector; for present factors a lease would take as long as the rest of a
        small query.

        Args:
            matrix: local rows of K.
            rhs: right-hand side, (n,).
        """
        if self._most == 1 and self._slots:
            slot = self._slots[0]
            with slot.lock:
                if slot.holds(matrix):
                    return slot.solve(rhs)
        with self.of(matrix) as slot:
            return slot.solve(rhs)

    def release(self) -> None:
        """Free the memory until the next lease. Collective."""
        for slot in self._slots:
            slot.release()

    def slot(self, matrix: csr_matrix) -> Factors:
        """Factors of a matrix, or those that it would replace."""
        slots = self._slots
        if self._most == 1 and slots:
            return slots[0]
        with self._lock:
            slot_of_matrix = next((slot for slot in slots if slot.holds(matrix)), None)
            if slot_of_matrix is None and len(slots) < self._most:
                slots.append(self._make(matrix))
                return slots[-1]
            slot_of_matrix = slots[0] if slot_of_matrix is None else slot_of_matrix
            slots.append(slots.pop(slots.index(slot_of_matrix)))
            return slot_of_matrix


class Lease:
    """Factors of one matrix in use; a generator would take two microseconds more, of the hundred of
    a query.
    """

    __slots__ = ("_before", "_matrix", "_slot", "_store")

    def __init__(self, store: FactorStore, matrix: csr_matrix):
        self._store = store
        self._matrix = matrix

    def __enter__(self) -> Factors:
        leased = self._store._leased
        self._before = before = getattr(leased, "lease", None)
        if before is not None:
            if before._matrix is not self._matrix:
                raise RuntimeError(
                    "factors of two matrices are leased from one store: end the first lease before"
                )
            self._slot = before._slot
            return self._slot
        self._slot = slot = self._store.slot(self._matrix)
        slot.lock.acquire()
        try:
            if not slot.holds(self._matrix):
                slot.refactor(self._matrix)
        except BaseException:
            slot.lock.release()
            raise
        leased.lease = self
        return slot

    def __exit__(self, *_: object) -> None:
        if self._before is None:
            self._store._leased.lease = None
            self._slot.lock.release()


class SparseStiffness(Stiffness):
    """Local rows of a sparse matrix, (n, N), which must not be modified, and the store that factors
    it.

    ``components`` are the local dofs of each connected component, by which K is scaled; None if it
    never is. K^-1 B^T, (n, m), and S, (m, m), may be known; ``keeps``: the former fits into memory.
    """

    def __init__(
        self, matrix: csr_matrix, problem: ContactProblem, store: FactorStore, *,
        components: list[np.ndarray] | None = None, response: np.ndarray | None = None,
        schur: np.ndarray | None = None, keeps: bool = True, symmetric: bool = True,
    ):  # fmt: skip
        self.matrix = matrix
        self.contact = problem.contact_of_rows
        self.symmetric = symmetric
        self._store = store
        self._spread = problem.spread
        self._idle = None if problem.kernel is None else problem.kernel.idle[problem.rows]
        self._on_rows = problem.on_rows
        self._components = components
        self._response = response
        self._keeps = keeps
        self._schur = schur
        self._parts: np.ndarray | None = None
        self._lock = RLock()
        self._assigning = Lock()

    def held(self) -> AbstractContextManager[object]:
        """See :class:`Stiffness`."""
        return self._store.of(self.matrix)

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """See :class:`Stiffness`."""
        idle = self._idle
        if (on_rows := self._on_rows) is not None:
            return on_rows.prolong @ self._store.solve(self.matrix, on_rows.restrict @ rhs)
        if idle is None:
            return self._store.solve(self.matrix, rhs)
        return self._without(idle, self._store.solve(self.matrix, self._without(idle, rhs)))

    def columns(self, rhs: spmatrix) -> np.ndarray:
        """See :class:`Stiffness`."""
        with self._store.of(self.matrix) as factors:
            if (on_rows := self._on_rows) is not None:
                return on_rows.prolong @ factors.solve_columns(on_rows.columns(rhs))
            solutions = factors.solve_columns(rhs)
            idle = self._idle
            if idle is None or not idle.shape[1]:
                return solutions
            work = self._spread.sum(idle.T @ rhs)
            drawn = np.stack([factors.solve(motion) for motion in idle.T], axis=1)
        return self._without(idle, solutions - drawn @ work)

    def _without(self, idle: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Fields, (n, ...), without motions that nothing resists, (n, l)."""
        return own - idle @ self._spread.sum(idle.T @ own)

    def response_to_forces(self, forces: np.ndarray) -> np.ndarray:
        """See :class:`Stiffness`; takes one more solution if K^-1 B^T is not kept."""
        if self._response is not None:
            return self._response @ forces
        loads = self.contact.T @ forces
        return self.solve(loads) if loads.ndim == 1 else self.columns(csc_matrix(loads))

    @property
    def has_response(self) -> bool:
        """True if K^-1 B^T is kept."""
        return self._response is not None

    @property
    def response(self) -> np.ndarray:
        """K^-1 B^T, (n, m), kept from now on."""
        if self._response is None:
            with self.held():
                if self._response is None:
                    self._response = self.columns(self.contact.T)
        return self._response

    @cached_property
    def schur(self) -> np.ndarray:
        """See :class:`Stiffness`."""
        with self._making():
            if self._schur is None:
                if self._response is None and not self._keeps and self._components is not None:
                    schur = self.parts.sum(axis=0)  # parts are needed later
                else:
                    schur = self._reduced([self.contact])[0]
                with (
                    self._assigning
                ):  # one array for all threads, which may make it by a lease and by a lock at once
                    self._schur = schur if self._schur is None else self._schur
        return self._schur

    def _making(self) -> AbstractContextManager[object]:
        """Context of one thread at a time, by its lease or else by a lock: with both, threads could
        deadlock.
        """
        return self.held() if self._response is None else self._lock

    def lent(self, other: SparseStiffness) -> SparseStiffness:
        """This stiffness with K^-1 B^T of another one of the same matrix, and its S."""
        self.schur  # noqa: B018
        self._response = other._response
        return self

    @property
    def parts(self) -> np.ndarray:
        """S of each connected component, (C, m, m)."""
        if self._parts is None:
            assert self._components is not None
            with self._making():
                if self._parts is None:
                    masks = [
                        np.bincount(dofs, minlength=self.contact.shape[1]) > 0
                        for dofs in self._components
                    ]
                    self._parts = np.stack(
                        self._reduced([csr_matrix(self.contact.multiply(mask)) for mask in masks])
                    )
        return self._parts

    def _reduced(self, rows: list[csr_matrix]) -> list[np.ndarray]:
        """Products of some rows and K^-1 B^T, (m, m) each, by kept columns, or factors that
        eliminate contact last.
        """
        if self._response is None:
            with self._store.of(self.matrix) as factors:
                products = [block for block in map(factors.between_last, rows) if block is not None]
                if len(products) == len(rows):
                    return products
                if not self._keeps:
                    return self._by_blocks(factors, rows)
        return [self._spread.sum(block @ self.response) for block in rows]

    def _by_blocks(self, factors: Factors, rows: list[csr_matrix]) -> list[np.ndarray]:
        """Products of some rows and K^-1 B^T, (m, m) each, by columns that are not kept."""
        touched = np.unique(self.contact.indices)
        touched_rows = [csr_matrix(block_rows[:, touched]) for block_rows in rows]
        products = [np.empty((self.contact.shape[0],) * 2) for _ in rows]
        for span, block in factors.solved_blocks(self.contact.T, touched):
            for local_rows, total in zip(touched_rows, products, strict=True):
                total[:, span] = local_rows @ block
        return [self._spread.sum(total) for total in products]

    def scaled(self, scales: np.ndarray) -> ScaledStiffness:
        """K with connected components scaled by these numbers, (C,); nothing is factored."""
        assert self._components is not None
        scale_of_dofs = np.empty(self.contact.shape[1])
        for scale, dofs in zip(scales, self._components, strict=True):
            scale_of_dofs[dofs] = scale
        return ScaledStiffness(self, scales, scale_of_dofs)


class ScaledStiffness(Stiffness):
    """Stiffness with components scaled by s_c, (C,), in ``own`` of each local dof, (n,): S = sum of
    S_c / s_c.
    """

    def __init__(self, base: SparseStiffness, scales: np.ndarray, own: np.ndarray):
        self.own = own
        self._base = base
        self._scales = scales

    def held(self) -> AbstractContextManager[object]:
        """See :class:`Stiffness`."""
        return self._base.held()

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """See :class:`Stiffness`."""
        return self._base.solve(rhs / self.own)

    def columns(self, rhs: spmatrix) -> np.ndarray:
        """See :class:`Stiffness`."""
        return self._base.columns(csc_matrix(diags(1 / self.own) @ rhs))

    def response_to_forces(self, forces: np.ndarray) -> np.ndarray:
        """See :class:`Stiffness`."""
        return (self._base.response_to_forces(forces).T / self.own).T

    @cached_property
    def schur(self) -> np.ndarray:
        """See :class:`Stiffness`."""
        return np.tensordot(1 / self._scales, self._base.parts, 1)
