"""Active set for unilateral contact, thesis Alg. 1.1, one function for full and reduced models.

The rule of Alg. 1.1 switches every wrong status at once. It is fast, but it may cycle. When a set
of statuses comes back, the least-index rule of Murty takes over, which switches only the first
wrong status. For a P-matrix S = B K^-1 B^T (K positive definite and B of full rank) it ends in
finitely many steps (K. G. Murty, "Note on a Bard-type scheme for solving the complementarity
problem", Opsearch 11, 1974). If it comes back to a set of statuses too, S is no P-matrix, and the
status reports this: an iterate is never returned as a solution.

A set on the way may be singular although the problem has a solution, since S of a reduced model is
neither symmetric nor definite by construction. Then the least-index rule starts from no contact,
which is never singular, and passes over statuses that would make the set singular.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from enum import Enum
from threading import Lock
from typing import NamedTuple, cast

import numpy as np

from hhr_dolfinx.errors import SingularError
from hhr_dolfinx.linear.dense import (
    Factor,
    Factorise,
    LapackCholesky,
    LapackLU,
    dense_factors,
    solve_columns,
)

STATUS_TOLERANCE = 1e-11
"""Negative forces and slacks below this fraction of the largest of their pair are round-off
(measured 1e-13).
"""

OTHER_PAIRS_ROUND_OFF = 1e-15
"""Fraction of the largest force, or closed gap, of all pairs that reaches the other pairs as
round-off.
"""
MAX_ITERATIONS = 1000
Equalities = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
_Size = float | np.floating | np.ndarray
_Entry = tuple[np.ndarray, Factor | None, np.ndarray]
"""Active conditions (k,), the factors of their block (None if k = 0), columns of S as rows (k,
m).
"""


class Status(Enum):
    """Why the active set stopped, in a sentence for the user."""

    CONVERGED = "the statuses satisfy all contact conditions"
    ITERATION_LIMIT = (
        "the statuses still changed at the iteration limit: start from statuses nearer to the "
        "answer"
    )
    SINGULAR = (
        "the contact conditions that touch are linearly dependent, thesis (1.67), so their forces "
        "are not unique"
    )
    NOT_FINITE = (
        "the contact problem is not finite: check loads, gaps and materials for NaN and infinite "
        "numbers"
    )
    DIVERGED = "the step did not converge: march along a path, in smaller steps"
    ADRIFT = (
        "a body that nothing but contact holds moves off: contact only pushes, and loads pull it "
        "away"
    )
    UNDEFINED = (
        "the problem cannot be made at this parameter: its shape or its stiffness is not one that "
        "can be solved"
    )
    UNSETTLED = (
        "contacts keep changing their status: march in smaller increments, or there is no answer"
    )
    CYCLING = (
        "the statuses repeat even one at a time, so the contact Schur complement is no P-matrix"
    )


class Statuses(NamedTuple):
    """Outcome of the active set: forces, (m,), statuses, (m,) bool, equality problems solved, and
    why it stopped.

    ``cycled``: the plain rule of Alg. 1.1 cycled, or met a singular set, and the terminating rule
    took over.
    """

    forces: np.ndarray
    active: np.ndarray
    iterations: int
    status: Status
    cycled: bool


class Pairs:
    """Conditions by their contact pair, (m,) numbers: a strong pair must not loosen the tolerance
    of a weak one.
    """

    def __init__(self, numbers: np.ndarray):
        _, self._group = np.unique(numbers, return_inverse=True)
        order = np.argsort(self._group, kind="stable")
        self._starts = np.searchsorted(self._group[order], np.arange(self._group.max() + 1))
        # conditions mostly come pair by pair
        self._order = None if np.array_equal(order, np.arange(order.size)) else order

    @classmethod
    def of(cls, numbers: np.ndarray | None) -> Pairs | None:
        """Groups; None for a single pair, or if pairs are unknown."""
        return None if numbers is None or np.ptp(numbers) == 0 else cls(numbers)

    def largest(self, values: np.ndarray) -> np.ndarray:
        """Largest value in the pair of each condition, (m,)."""
        ordered = values if self._order is None else values[self._order]
        return np.maximum.reduceat(ordered, self._starts)[self._group]


def active_set(
    equalities: Equalities,
    free_slack: np.ndarray,
    active: np.ndarray,
    max_iterations: int = MAX_ITERATIONS,
    pairs: Pairs | None = None,
) -> Statuses:
    """Iterate on the statuses until forces and slacks are all non-negative, thesis Alg. 1.1.

    Args:
        equalities: maps the statuses (m,) bool and ``free_slack`` to ``(forces, slack)``, both
            (m,): the solution with slack 0 where active and force 0 elsewhere. See
            :class:`SchurEqualities`.
        free_slack: D - B K^-1 F, the slack without contact forces, (m,), m >= 1.
        active: statuses to start from, (m,) bool; not modified. They are returned for a singular
            set, and for numbers that are not finite.
        max_iterations: bound on the equality problems solved.
        pairs: contact pair of each condition; None takes all for one pair.

    Returns:
        The forces and statuses, the number of equality problems solved, and the status of the
        search.
    """
    seen: set[bytes] = set()
    start = active
    for iteration in range(1, max_iterations + 1):
        try:
            forces, slack = equalities(active, free_slack)
        except SingularError:
            nothing = np.zeros(active.size, dtype=bool)
            outcome = _one_at_a_time(
                equalities, free_slack, nothing, (iteration, max_iterations), pairs, singular=True
            )
            break
        # one factor of each product is 0, and 0 times infinity is NaN: unlike min this finds
        # infinite values
        work = slack.dot(forces)
        if work == 0.0 and slack.min() >= 0 and forces.min() >= 0:
            return Statuses(forces, active, iteration, Status.CONVERGED, False)
        if work != 0.0 and not _finite(forces, slack):
            outcome = Statuses(forces, active, iteration, Status.NOT_FINITE, False)
            break
        # errors in any measure first: the comparison pair by pair takes as long as all the rest
        wrong = _wrong(forces, slack, free_slack, None)
        if not wrong.any() and pairs is not None:
            wrong = _wrong(forces, slack, free_slack, pairs)
        if not wrong.any():
            return Statuses(forces, active, iteration, Status.CONVERGED, False)
        key = active.tobytes()
        if key in seen:
            outcome = _one_at_a_time(
                equalities, free_slack, active, (iteration, max_iterations), pairs, singular=False
            )
            break
        seen.add(key)
        active = active ^ wrong
    else:
        outcome = Statuses(forces, active, max_iterations, Status.ITERATION_LIMIT, False)
    if outcome.status in (Status.SINGULAR, Status.NOT_FINITE):
        return outcome._replace(forces=np.zeros(start.size), active=start)
    return outcome


def _finite(forces: np.ndarray, slack: np.ndarray) -> bool:
    return bool(np.isfinite(slack).all() and np.isfinite(forces).all())


def _noise(forces: np.ndarray, free_slack: np.ndarray, pairs: Pairs | None) -> tuple[_Size, _Size]:
    """Sizes below which negative forces and slacks are round-off, numbers or (m,) each."""
    sizes = abs(free_slack)
    if pairs is None:
        return STATUS_TOLERANCE * forces.max(), STATUS_TOLERANCE * sizes.max()
    # an obstacle out of reach has a large slack, but no force that could bring round-off to other
    # pairs
    closing = max(-free_slack.min(), 0.0)
    pulling = STATUS_TOLERANCE * pairs.largest(forces) + OTHER_PAIRS_ROUND_OFF * forces.max()
    return pulling, STATUS_TOLERANCE * pairs.largest(sizes) + OTHER_PAIRS_ROUND_OFF * closing


def _wrong(
    forces: np.ndarray, slack: np.ndarray, free_slack: np.ndarray, pairs: Pairs | None
) -> np.ndarray:
    """Conditions that pull or penetrate by more than round-off, (m,) bool."""
    pulling, through = _noise(forces, free_slack, pairs)
    return (forces < -pulling) | (slack < -through)


def _one_at_a_time(
    equalities: Equalities,
    free_slack: np.ndarray,
    active: np.ndarray,
    iterations: tuple[int, int],
    pairs: Pairs | None,
    *,
    singular: bool,
) -> Statuses:
    """The least-index rule, which skips statuses that would make the set singular, from a regular
    set.

    ``iterations`` are those so far and their bound; ``singular``: a singular set was met before.
    """
    seen: set[bytes] = set()
    spent, limit = iterations
    forces, slack = equalities(active, free_slack)
    while spent < limit:
        if not _finite(forces, slack):
            return Statuses(forces, active, spent, Status.NOT_FINITE, True)
        wrong = _wrong(forces, slack, free_slack, pairs)
        if not wrong.any():
            # a second copy of a row would split its force arbitrarily; that row has no slack then
            touching = active | (slack <= _noise(forces, free_slack, pairs)[1])
            unique = not singular or _solved(equalities, touching, free_slack) is not None
            return Statuses(
                forces, active, spent, Status.CONVERGED if unique else Status.SINGULAR, True
            )
        key = active.tobytes()
        if key in seen:
            return Statuses(
                forces, active, spent, Status.SINGULAR if singular else Status.CYCLING, True
            )
        seen.add(key)
        step = None
        for index in wrong.nonzero()[0][: limit - spent]:
            trial = active.copy()
            trial[index] = not trial[index]
            spent += 1
            step = _solved(equalities, trial, free_slack)
            if step is not None:
                break
            singular = True
        if step is None:
            return Statuses(forces, active, spent, Status.SINGULAR, True)
        active = trial
        forces, slack = step
    return Statuses(
        forces, active, spent, Status.SINGULAR if singular else Status.ITERATION_LIMIT, True
    )


def _solved(
    equalities: Equalities, active: np.ndarray, free_slack: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Forces and slack of a set of statuses; None if it is singular."""
    try:
        return equalities(active, free_slack)
    except SingularError:
        return None


class SchurEqualities:
    """Equality problems of the active set on S = B K^-1 B^T: slack = free_slack + S lambda.

    ``columns`` maps indices (k,) to the columns of S that belong to them, as rows (k, m). A set of
    statuses costs one dense LU of S[active, active]. The last factors of each size are kept, since
    neighbouring parameters often share statuses: a new block replaces the oldest one of its size,
    and all take less than ``most_bytes``. Factors made by :meth:`prepare` stay. Several threads may
    call an object; if no condition is active the slack is the given array.
    """

    KEPT_PER_SIZE = 2
    most_bytes = 64 * 2**20

    def __init__(
        self,
        columns: Callable[[np.ndarray], np.ndarray],
        size: int,
        factorise: Factorise = dense_factors,
    ):
        self._columns = columns
        self.size = size
        self._factorise = factorise
        self._entries: dict[bytes, _Entry] = {}  # the oldest first
        self._prepared: dict[bytes, _Entry] = {}
        self._kept: defaultdict[int, list[bytes]] = defaultdict(list)
        self.kept_bytes = 0
        self._lock = Lock()

    @classmethod
    def symmetric(cls, schur: np.ndarray) -> SchurEqualities:
        """Equality problems on a known S, (m, m), that is symmetric and usually definite."""
        return cls(schur.__getitem__, schur.shape[0], LapackCholesky)

    @classmethod
    def of(cls, schur: np.ndarray, factorise: Factorise = dense_factors) -> SchurEqualities:
        """Equality problems on a known S, (m, m), not necessarily symmetric.

        Args:
            schur: S, (m, m).
            factorise: factors a dense block of S, (k, k).
        """
        # transposed, so that picking columns of S copies whole rows
        return cls(np.ascontiguousarray(schur.T).__getitem__, schur.shape[0], factorise)

    def whole(self) -> np.ndarray:
        """S, (m, m)."""
        return self._columns(np.arange(self.size)).T

    def __call__(self, active: np.ndarray, free_slack: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces and slack, (m,) each, for given statuses.

        Args:
            active: statuses, (m,) bool.
            free_slack: slack without contact forces, (m,).

        Raises:
            SingularError: if S[active, active] is singular.
        """
        key = active.tobytes()
        # under the lock: another thread must not replace this block before it is used
        with self._lock:
            index, factor, columns = self._entry(active, key)
            local = None if factor is None else factor.solve(-free_slack[index])
        forces = np.zeros(free_slack.size)
        if local is None:
            return forces, free_slack
        forces[index] = local
        slack = free_slack + local @ columns
        slack[index] = 0.0
        return forces, slack

    def several(self, active: np.ndarray, free_slacks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve for many free slacks at once, (m, k): forces and slacks, (m, k) each.

        Args:
            active: common statuses, (m,) bool.
            free_slacks: slacks without contact forces, (m, k).

        Raises:
            SingularError: if S[active, active] is singular.
        """
        with self._lock:
            index, factor, columns = self._entry(active, active.tobytes())
            local = None if factor is None else solve_columns(factor, -free_slacks[index])
        forces = np.zeros(free_slacks.shape)
        if local is None:
            return forces, free_slacks
        forces[index] = local
        slack = free_slacks + columns.T @ local
        slack[index] = 0.0
        return forces, slack

    def prepare(self, statuses: np.ndarray, most_bytes: int) -> None:
        """Factor the regular blocks of statuses that are expected, (n, m), as far as they fit into
        the given memory.

        Args:
            statuses: expected statuses, (n, m) bool.
            most_bytes: memory that the factors may take.
        """
        spent = 0
        for active in statuses:
            index = active.nonzero()[0]
            columns = self._columns(index)
            # a factor has the size of its block
            size = index.nbytes + columns.nbytes + 8 * index.size**2
            if spent + size > most_bytes:
                continue
            spent += size
            with suppress(SingularError):
                factor = self._factorise(columns.take(index, axis=1).T) if index.size else None
                self._prepared[active.tobytes()] = (index, factor, columns)

    def _entry(self, active: np.ndarray, key: bytes) -> _Entry:
        entry = self._prepared.get(key) or self._entries.get(key)
        return self._factor(active.nonzero()[0], key) if entry is None else entry

    def _factor(self, index: np.ndarray, key: bytes) -> _Entry:
        factor: Factor | None
        columns = self._columns(index)
        block = columns.take(index, axis=1).T
        keys = self._kept[index.size]
        if index.size == 0:
            factor = None
        elif len(keys) < self.KEPT_PER_SIZE:
            factor = self._factorise(block)
        else:
            # removed first: a singular block must not leave a stale entry
            factor = cast(Factor, self._forget(keys[0]))
            factor.refactor(block)
        entry = (index, factor, columns)
        keys.append(key)
        self._entries[key] = entry
        self.kept_bytes += _bytes(entry)
        while self.kept_bytes > self.most_bytes:
            self._forget(next(iter(self._entries)))
        return entry

    def _forget(self, key: bytes) -> Factor | None:
        entry = self._entries.pop(key)
        self._kept[entry[0].size].remove(key)
        self.kept_bytes -= _bytes(entry)
        return entry[1]


def _bytes(entry: _Entry) -> int:
    index, factor, columns = entry
    return index.nbytes + columns.nbytes + (0 if factor is None else factor.nbytes)


ROUNDS = 6
"""Rounds in which statuses change for many points at once.

The remaining points are solved one by one.
"""


def settled(
    schur: np.ndarray, free_slack: np.ndarray, active: np.ndarray, factorise: Factorise = LapackLU
) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Run Alg. 1.1 for many free slacks with common factors.

    Args:
        schur: S, (m, m).
        free_slack: slacks without contact forces, (n, m).
        active: statuses to start from, (n, m) bool, which are changed in place.
        factorise: factors a dense block of S, (k, k).

    Returns:
        Forces, (n, m), equality problems solved for each point, (n,), and the points that have not
        converged: round-off and singular sets are left to the search of a single point.
    """
    forces = np.zeros_like(free_slack)
    iterations = np.zeros(len(active), dtype=int)
    factors = KeptFactors(schur, factorise)
    pending = np.arange(len(active))
    unsolved = []
    for _ in range(ROUNDS):
        groups: dict[bytes, list[int]] = {}
        for k in pending.tolist():
            groups.setdefault(active[k].tobytes(), []).append(k)
        changed = []
        for key, points in groups.items():
            members = np.array(points)
            index = np.flatnonzero(active[points[0]])
            try:
                solution, slack = _equalities(schur, free_slack[members], index, key, factors)
            except SingularError:
                unsolved += points
                continue
            forces[members] = solution
            iterations[members] += 1
            # NaN is wrong too
            wrong = ~((solution >= 0) & (slack >= 0))
            open_ = wrong.any(axis=1)
            active[members[open_]] ^= wrong[open_]
            changed.append(members[open_])
        pending = np.concatenate([np.zeros(0, dtype=int), *changed])
        if not pending.size:
            break
    return forces, iterations, [*unsolved, *pending.tolist()]


class KeptFactors:
    """Factors of blocks of S, (m, m), by statuses.

    The most recently used are kept, up to ``most_bytes``.
    """

    most_bytes = 64 * 2**20

    def __init__(self, schur: np.ndarray, factorise: Factorise = LapackLU):
        self._schur = schur
        self._factorise = factorise
        self.kept_bytes = 0
        self._factors: dict[bytes, Factor] = {}  # the least recently used first

    def of(self, index: np.ndarray, key: bytes) -> Factor:
        """Factors of the block of some conditions, (k,), whose statuses have this key.

        Args:
            index: the conditions, (k,).
            key: bytes of their statuses.

        Raises:
            SingularError: if the block is singular.
        """
        factor = self._factors.pop(key, None)
        if factor is None:
            factor = self._factorise(self._schur[np.ix_(index, index)])
            self.kept_bytes += factor.nbytes
        self._factors[key] = factor
        while self.kept_bytes > self.most_bytes:
            self.kept_bytes -= self._factors.pop(next(iter(self._factors))).nbytes
        return factor


def _equalities(
    schur: np.ndarray, free_slack: np.ndarray, index: np.ndarray, key: bytes, factors: KeptFactors
) -> tuple[np.ndarray, np.ndarray]:
    """Forces and slacks, (g, m) each, of points that share their statuses."""
    forces = np.zeros_like(free_slack)
    if not index.size:
        return forces, free_slack
    local = solve_columns(factors.of(index, key), -free_slack[:, index].T).T
    forces[:, index] = local
    slack = free_slack + local @ schur[:, index].T
    slack[:, index] = 0.0
    return forces, slack
