"""Active set of contact with friction: open, stick or slip at each contact, one function for full
and reduced models.

The rows of B are those of pressures, and for each contact with friction one or two tangential ones,
so that forces x = (λ, τ) give slack = free_slack + S x, see
:mod:`hhr_dolfinx.plugins.friction.laws`. The slack of a tangential row is the slip of an increment,
with the sign by which τ opposes it. With c = 1 / S_ii, which turns slacks into forces, and y = x -
c slack the conditions of one increment are projections,

    λ = max(0, y_n),      τ = y_t min(1, b / |y_t|),      b = min(coefficient max(0, y_n), limit),

on the disc of Coulomb's law, not on a pyramid; for Tresca's law b = limit, with an infinite
coefficient. A semi-smooth Newton method solves them: a set of statuses and slip directions gives
one linear system, in which the bound b changes with λ. This is the primal-dual active set of S.
Hüeber, G. Stadler and B. Wohlmuth (SIAM J. Sci. Comput. 30, 2008) on the condensed problem.

Newton's statuses may cycle. Then sweeps over single contacts, by projection (F. Jourdan, P. Alart
and M. Jean, CMAME 155, 1998), improve the forces, and Newton's method starts again from them. If
that does not converge, the status is ``UNSETTLED``, with the contacts that still change.
"""

from __future__ import annotations

from contextlib import suppress
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import SingularError
from hhr_dolfinx.models.gradient import CHANGING_STATUS
from hhr_dolfinx.plugins.contact_laws.ranges import NEWTON_ITERATIONS, PROJECTION_TOLERANCE
from hhr_dolfinx.plugins.friction.laws import Friction, bounds, places_of
from hhr_dolfinx.plugins.friction.sliding_system import (
    SlidingRows,
    SlidingStatuses,
    SlidingSystem,
    SlidingSystems,
)
from hhr_dolfinx.plugins.friction.sweeps import swept

STIFFNESS_FACTORS = (0.2, 1.0, 0.01)
"""Factors of the stiffness by which the slip of a contact enters its status, tried in this order.

Neighbours slip at the same time, so that the stiffness of a single contact overestimates the
change: with the full factor, slip may alternate between directions and never stick. On 256 contacts
in space 0.1 to 0.3 took the fewest iterations.
"""
SWEEPS = (10, 30, 100, 300, 1000, 3000)
"""Sweeps over all contacts between one attempt of Newton's method and the next."""
ELASTIC_SLIP = 1e-4
"""Part of the compliance of a contact by which it yields if another condition repeats its friction.

With 1e-6 one of 40,000 random jumps of the pellet, which has such a corner, did not converge; with
1e-4 all do.
"""
STALLED_REDUCTION = 0.2
"""Reduction of the deviation above which a step with old factors counts as failed, and the factors
are updated.
"""


class Sliding(NamedTuple):
    """Outcome of an increment (M rows, r rigid motions)."""

    forces: np.ndarray  #: of all rows, (M,)
    active: (
        np.ndarray
    )  #: rows whose slack is zero: closed contacts, and tangential rows that stick, (M,) bool
    slack: np.ndarray  #: of all rows, (M,); of tangential rows the slip of the increment
    motions: np.ndarray  #: amplitudes of rigid motions of bodies that only contact holds, (r,)
    iterations: int  #: linear systems solved
    sweeps: int  #: over single contacts, 0 if Newton's method converged alone
    status: Status
    unsettled: np.ndarray = np.zeros(
        0, dtype=np.int64
    )  #: rows of pressure of contacts that still change


class SlidingIncrement(NamedTuple):
    """Loads and friction bounds of an increment."""

    slack: (
        np.ndarray
    )  #: without contact forces; of tangential rows less their position before the increment, (M,)
    coefficient: (
        np.ndarray
    )  #: of friction of each contact with friction, (C,); infinite of Tresca's law
    limit: np.ndarray  #: upper bound of its tangential force at any pressure, (C,)
    driving: np.ndarray  #: loads along rigid motions that only contact holds, (r,)

    def bounds(self, friction: Friction, forces: np.ndarray) -> np.ndarray:
        """Largest tangential force that each contact may bear, (C,).

        Args:
            friction: friction of the rows.
            forces: forces of all rows, (M,).
        """
        return bounds(self.coefficient, self.limit, forces[friction.normal])


class _Given(NamedTuple):
    """Loads and friction bounds of an increment by rows."""

    slack: np.ndarray
    driving: np.ndarray
    coefficient: np.ndarray  #: of each tangential row, (T,)
    limit: np.ndarray  #: of each tangential row, (T,)
    plain: bool  #: only finite coefficients bound tangential forces
    unforced: np.ndarray  #: forces that would compensate the slack, row by row, (M,)
    round_off: float  #: of the slack, as a force
    label: bytes  #: key of the coefficients


class _Iterate(NamedTuple):
    """Statuses and directions of a Newton step, and the deviation of the forces from their
    projection.
    """

    statuses: SlidingStatuses
    limited: np.ndarray  #: tangential rows whose bound is the limit, (T,) bool
    bound: np.ndarray  #: b of each tangential row, (T,)
    off: np.ndarray  #: forces less their projection, (M,)

    def key(self) -> bytes:
        at = self.statuses
        signs = np.sign(at.direction[at.slips])
        return (
            at.acting.tobytes()
            + at.slips.tobytes()
            + self.limited[at.slips].tobytes()
            + signs.tobytes()
        )


class SlidingContact:
    """The contact problem with friction on one S, (M, M), for any number of increments.

    Results are new arrays.

    ``contact_of_motions`` is G = B R of rigid motions that only contact holds, (M, r); None without
    such motions.
    """

    def __init__(
        self, schur: np.ndarray, friction: Friction, contact_of_motions: np.ndarray | None = None
    ):
        self.given = schur
        self.schur = schur = _softened(schur, friction)
        self.friction = friction
        self.contact_of_motions = (
            np.zeros((len(schur), 0)) if contact_of_motions is None else contact_of_motions
        )
        rows = self._rows = friction.tangential
        owner = self._owner = friction.owner
        self._normal = friction.normal[owner]  # row of pressure of each tangential row
        self._pressures = np.flatnonzero(friction.pressing(len(schur)))
        self._curved = np.bincount(owner, minlength=friction.normal.size)[owner] > 1
        self._turns = bool(self._curved.any())
        softness = np.abs(np.diag(schur)).copy()
        # the same for both directions of a contact: the projection is that on a disc
        largest = np.zeros(friction.normal.size)
        np.maximum.at(largest, owner, softness[rows])
        softness[rows] = largest[owner]
        typical = softness[softness > 0].mean() if (softness > 0).any() else 1.0
        self.stiffness = 1.0 / np.where(softness > 0, softness, typical)
        unit = self.stiffness[:, None]
        balance = np.ascontiguousarray(self.contact_of_motions.T)
        scaled = np.hstack([schur, -self.contact_of_motions]) * unit
        self._problem = SlidingRows(scaled, balance, rows, self._normal, self._curved)
        self._nowhere = np.zeros(rows.size, dtype=bool)
        self._systems = SlidingSystems(self._problem)

    def increment(
        self, given: SlidingIncrement, start: np.ndarray, active: np.ndarray | None = None
    ) -> Sliding:
        """Solve an increment from the forces and statuses of the previous one.

        The first system is solved with these statuses.

        Args:
            given: loads and friction bounds of the increment.
            start: forces of the previous increment, (M,).
            active: statuses of the previous increment, (M,) bool; None derives them from forces and
                loads.
        """
        motions = np.zeros(self.contact_of_motions.shape[1])
        if not (np.isfinite(given.slack).all() and np.isfinite(given.driving).all()):
            nothing = np.zeros(len(start))
            return Sliding(nothing, nothing != 0, given.slack, motions, 0, 0, Status.NOT_FINITE)
        prepared = self._prepared(given)
        if active is not None and not motions.size:
            with suppress(SingularError):
                start = self._solved(prepared, self._as_before(prepared, start, active), start)
        solution = self._tried(prepared, start, motions)
        if solution.status is Status.CONVERGED:
            return solution
        return (
            self._by_sweeps(given, prepared, solution)
            if not motions.size
            else self._by_springs(given, prepared, solution)
        )

    def _prepared(self, given: SlidingIncrement) -> _Given:
        unforced = -self.stiffness * given.slack
        plain = bool(np.isfinite(given.coefficient).all() and np.isinf(given.limit).all())
        return _Given(
            given.slack,
            given.driving,
            given.coefficient[self._owner],
            given.limit[self._owner],
            plain,
            unforced,
            1e-15 * np.abs(unforced).max(initial=0.0),
            given.coefficient.tobytes(),
        )

    def _as_before(self, given: _Given, forces: np.ndarray, active: np.ndarray) -> _Iterate:
        """Statuses and directions of a solved increment."""
        acting = active.copy()
        tangential = forces[self._rows]
        size = self._length(tangential)
        bound, limited = self._bound(given, np.maximum(forces, 0.0))
        acting[self._rows] = (bound > 0) | active[self._normal]
        slips = ~active[self._rows] & (size > 0) & acting[self._rows]
        return self._iterate(
            given,
            acting,
            slips,
            limited,
            bound,
            tangential,
            size,
            STIFFNESS_FACTORS[0],
            np.zeros(0),
        )

    def _tried(self, given: _Given, start: np.ndarray, motions: np.ndarray) -> Sliding:
        """Newton's method, with one factor of the slip after another."""
        iterations = 0
        # the first factor again without errors of old factors
        for probe, old in (
            (STIFFNESS_FACTORS[0], True),
            *((probe, False) for probe in STIFFNESS_FACTORS),
        ):
            solution = self._newton(given, start, motions, probe, old)
            iterations += solution.iterations
            if solution.status is Status.CONVERGED:
                break
            self._systems.forget()
        return solution._replace(iterations=iterations)

    def _newton(
        self, given: _Given, start: np.ndarray, motions: np.ndarray, probe: float, old: bool
    ) -> Sliding:
        """Newton's method; the status is ``UNSETTLED`` if statuses repeat, or ``SINGULAR``.

        ``probe`` is one of :data:`STIFFNESS_FACTORS`; ``old`` allows factors of other statuses
        while steps converge.
        """
        forces = start
        seen: set[bytes] = set()
        least = np.inf
        before = np.inf
        status = Status.UNSETTLED
        for iteration in range(NEWTON_ITERATIONS + 1):
            slack = given.slack + self.schur @ forces - self.contact_of_motions @ motions
            at = self._projected(given, forces, slack, probe)
            worst = np.abs(at.off).max(initial=0.0)
            balanced = self._balanced(given, forces)
            noise = PROJECTION_TOLERANCE * np.abs(forces).max(initial=0.0) + given.round_off
            if worst <= noise and balanced:
                # a solution may be round-off of corrected factors
                if old and not self._systems.holds(
                    at.statuses, self._right_of(given, at), np.concatenate([forces, motions])
                ):
                    break
                return self._settled(at.statuses, forces, slack, motions, iteration)
            key = at.key()
            if iteration == NEWTON_ITERATIONS or (key in seen and not worst < 0.5 * least):
                break
            seen.add(key)
            least = min(least, worst)
            near = (
                np.concatenate([forces, motions])
                if old and worst < STALLED_REDUCTION * before
                else None
            )
            before = worst
            if not old:
                self._systems.forget()
            try:
                solved = self._solved(given, at, near)
            except SingularError:
                status = Status.SINGULAR
                break
            forces = solved[: forces.size]
            motions = solved[forces.size :]
        return Sliding(
            forces,
            at.statuses.acting,
            slack,
            motions,
            iteration,
            0,
            status,
            self._pressures[np.abs(at.off[self._pressures]) > noise],
        )

    def changes(
        self,
        given: SlidingIncrement,
        found: Sliding,
        slack: np.ndarray,
        bounds: tuple[np.ndarray, np.ndarray],
        driving: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of forces, (M, P), and of rigid motions, (r, P), along parameters at constant
        statuses.

        Args:
            given, found: loads and bounds of the increment, and its solution.
            slack: derivatives of the slack at constant forces, (M, P).
            bounds: derivatives of coefficient and limit, (C, P) each.
            driving: derivatives of the loads along rigid motions, (r, P).

        Raises:
            SingularError: if statuses leave forces undetermined.
        """
        at = self._at(given, found)
        owner = self._owner
        pressure = np.maximum(found.forces[self._normal], 0.0)[:, None]
        grown = np.where(at.limited[:, None], bounds[1][owner], bounds[0][owner] * pressure)
        right = self._right(
            at.statuses,
            -self.stiffness[:, None] * slack,
            grown * at.statuses.direction[:, None],
            driving,
        )
        solved = SlidingSystem(self._problem, at.statuses).solve(right)
        return solved[: len(slack)], solved[len(slack) :]

    def _at(self, given: SlidingIncrement, found: Sliding) -> _Iterate:
        return self._projected(
            self._prepared(given), found.forces, found.slack, STIFFNESS_FACTORS[0]
        )

    def grazing(self, given: SlidingIncrement, found: Sliding) -> np.ndarray:
        """Rows about to change their status, for which derivatives are one-sided, (M,) bool.

        Args:
            given: loads and friction bounds of the increment.
            found: solution of the increment.
        """
        near = CHANGING_STATUS * np.abs(found.forces).max(initial=0.0)
        at = self._at(given, found)
        scaled = self.stiffness * np.abs(found.slack)
        close = np.where(found.active, np.abs(found.forces) <= near, scaled <= near)
        size, slip = (self._length(values[self._rows]) for values in (found.forces, scaled))
        tangential = np.where(at.statuses.slips, slip <= near, size >= at.bound - near)
        close[self._rows] = tangential & at.statuses.acting[self._normal]
        return close

    def _projected(
        self, given: _Given, forces: np.ndarray, slack: np.ndarray, probe: float
    ) -> _Iterate:
        """Statuses of forces and slacks, and their deviation from a solution."""
        y = forces - self.stiffness * slack
        projected = np.maximum(y, 0.0)
        acting = y > 0
        bound, limited = self._bound(given, projected)
        trial = y[self._rows]
        if self._turns:
            projected[self._rows] = trial * _share(bound, self._length(trial))
        else:
            projected[self._rows] = np.minimum(np.maximum(trial, -bound), bound)
        borne = forces[self._rows]
        tangential = borne + probe * (trial - borne)
        size = self._length(tangential)
        bears = acting[self._normal] if given.plain else (bound > 0) | acting[self._normal]
        acting[self._rows] = bears
        slips = (size > bound) & bears
        return self._iterate(
            given, acting, slips, limited, bound, tangential, size, probe, forces - projected
        )

    def _iterate(
        self,
        given: _Given,
        acting: np.ndarray,
        slips: np.ndarray,
        limited: np.ndarray,
        bound: np.ndarray,
        tangential: np.ndarray,
        size: np.ndarray,
        probe: float,
        off: np.ndarray,
    ) -> _Iterate:
        """Statuses and directions for tangential vectors, (T,), of some magnitude, (T,)."""
        followed = given.coefficient if given.plain else np.where(limited, 0.0, given.coefficient)
        if not self._turns:
            return _Iterate(
                SlidingStatuses(acting, slips, followed, np.sign(tangential), size, probe),
                limited,
                bound,
                off,
            )
        direction = tangential / np.where(size > 0, size, 1.0)
        return _Iterate(
            SlidingStatuses(acting, slips, followed, direction, _share(bound, size), probe),
            limited,
            bound,
            off,
        )

    def _bound(self, given: _Given, pressures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Largest force of each tangential row, (T,), and True for rows bounded by the limit, (T,)
        bool.
        """
        pressure = pressures[self._normal]
        if given.plain:
            return given.coefficient * pressure, self._nowhere
        bound = bounds(given.coefficient, given.limit, pressure)
        return bound, bound >= given.limit

    def _length(self, tangential: np.ndarray) -> np.ndarray:
        """Magnitude of the vector of each contact, on each of its tangential rows, (T,)."""
        if not self._turns:
            return np.abs(tangential)
        return self.friction.lengths(tangential)[self._owner]

    def _balanced(self, given: _Given, forces: np.ndarray) -> bool:
        """True if forces balance the loads along rigid motions."""
        if not given.driving.size:
            return True
        imbalance = np.abs(given.driving - forces @ self.contact_of_motions)
        size = np.abs(given.driving) + np.abs(forces) @ np.abs(self.contact_of_motions)
        return bool((imbalance <= 1e-10 * size.max()).all())

    def _solved(self, given: _Given, at: _Iterate, near: np.ndarray | None = None) -> np.ndarray:
        """Forces and motions on some statuses and directions, (M + r,).

        SingularError if they are undetermined.

        If only directions differ from the factored system, approximate ones, ``near``, are
        improved, which is cheaper.
        """
        statuses = at.statuses
        right = self._right_of(given, at)
        if near is not None and self._turns and (statuses.slips & self._curved).any():
            nearer = self._systems.nearer(statuses, right, given.label, near)
            if nearer is not None:
                return nearer
        return self._systems.solve(statuses, right, given.label)

    def _right_of(self, given: _Given, at: _Iterate) -> np.ndarray:
        """Right-hand sides of an increment on some statuses, (M + r,)."""
        statuses = at.statuses
        if (
            given.plain and not self._turns
        ):  # slip forces follow the pressure, there are no given ones
            right = np.where(statuses.acting, given.unforced, 0.0)
            right[self._rows[statuses.slips]] = 0.0
            return np.concatenate([right, given.driving]) if given.driving.size else right
        prescribed = np.where(at.limited, at.bound * statuses.direction, 0.0)[:, None]
        return self._right(statuses, given.unforced[:, None], prescribed, given.driving[:, None])[
            :, 0
        ]

    def _right(
        self, at: SlidingStatuses, unforced: np.ndarray, known: np.ndarray, driving: np.ndarray
    ) -> np.ndarray:
        """Right-hand sides of all rows, (M + r, P).

        ``unforced``, (M, P), are forces that would compensate the slack, row by row, and ``known``,
        (T, P), those of slipping rows that do not follow a pressure.
        """
        right = np.where(at.acting[:, None], unforced, 0.0)
        turning = at.slips & self._curved
        across = at.measure * right[self._rows[turning]].reshape(-1, 2, unforced.shape[1])
        right[self._rows[at.slips]] = known[at.slips]
        if across.size:
            direction = at.direction[turning].reshape(-1, 2, 1)
            across -= direction * (direction * across).sum(axis=1, keepdims=True)
            across *= at.shrunk[turning].reshape(-1, 2, 1)
            right[self._rows[turning]] += across.reshape(-1, unforced.shape[1])
        return np.concatenate([right, driving]) if len(driving) else right

    def _settled(
        self,
        at: SlidingStatuses,
        forces: np.ndarray,
        slack: np.ndarray,
        motions: np.ndarray,
        count: int,
    ) -> Sliding:
        """A converged solution, with the statuses of its rows."""
        active = at.acting.copy()
        active[self._rows] &= ~at.slips
        slack = slack.copy()
        slack[active] = 0.0
        forces = forces.copy()
        forces[~at.acting] = 0.0
        return Sliding(forces, active, slack, motions, max(count, 1), 0, Status.CONVERGED)

    def _by_sweeps(self, given: SlidingIncrement, own: _Given, solution: Sliding) -> Sliding:
        """Sweeps over single contacts, and Newton's method from their result."""
        forces = np.where(np.isfinite(solution.forces), solution.forces, 0.0)
        iterations = solution.iterations
        total = 0
        for count in SWEEPS:
            forces = swept(
                self.schur, self.friction, self._pressures, self.stiffness, given, forces, count
            )
            total += count
            if not np.isfinite(forces).all():
                break
            solution = self._tried(own, forces, solution.motions)
            iterations += solution.iterations
            if solution.status is Status.CONVERGED:
                break
        return solution._replace(iterations=iterations, sweeps=total)

    @cached_property
    def _sprung(self) -> tuple[tuple[np.ndarray, SlidingContact], ...]:
        """Compliances of springs that hold the bodies, (r,), and the contact problems with these
        springs.
        """
        motions = self.contact_of_motions
        push = (motions**2).mean(axis=0)
        unit = np.abs(np.diag(self.schur)).mean() / np.where(push > 0, push, 1.0)
        from hhr_dolfinx.plugins.floating.statuses import SPRING_COMPLIANCES

        springs = (unit * weak for weak in SPRING_COMPLIANCES)
        return tuple(
            (
                compliance,
                SlidingContact(self.schur + (motions * compliance) @ motions.T, self.friction),
            )
            for compliance in springs
        )

    def _by_springs(self, given: SlidingIncrement, own: _Given, failed: Sliding) -> Sliding:
        """Hold the bodies by weak springs, and update the ends of these, as without friction."""
        from hhr_dolfinx.plugins.floating.statuses import (
            BALANCED_FORCES,
            GAP_ROUND_OFF,
            PROXIMAL_STEPS,
        )

        ends = np.zeros(given.driving.size)
        iterations = failed.iterations
        sweeps = 0
        forces = np.zeros(given.slack.size)
        nothing = GAP_ROUND_OFF * np.abs(given.slack).max() * self.stiffness.max()
        for compliance, sprung in (
            spring for spring in self._sprung for _ in range(PROXIMAL_STEPS)
        ):
            offset = ends + compliance * given.driving
            held = given._replace(
                slack=given.slack - self.contact_of_motions @ offset, driving=given.driving[:0]
            )
            solution = sprung.increment(held, forces)
            iterations += solution.iterations
            sweeps += solution.sweeps
            if solution.status is not Status.CONVERGED:
                return solution._replace(motions=ends, iterations=iterations, sweeps=sweeps)
            forces = solution.forces
            imbalance = given.driving - forces @ self.contact_of_motions
            ends = ends + compliance * imbalance
            direct = self._tried(own, forces, ends)
            iterations += direct.iterations
            largest = (
                np.abs(given.driving) + np.abs(forces) @ np.abs(self.contact_of_motions)
            ).max()
            if direct.status is Status.CONVERGED:
                return direct._replace(iterations=iterations, sweeps=sweeps)
            if (np.abs(imbalance) <= BALANCED_FORCES * largest + nothing).all():
                return solution._replace(motions=ends, iterations=iterations, sweeps=sweeps)
        return failed._replace(status=Status.ADRIFT, iterations=iterations, sweeps=sweeps)


def _softened(schur: np.ndarray, friction: Friction) -> np.ndarray:
    """S with some elastic slip of rows that leave their forces undetermined: the slip selects one
    of these forces.

    A row without effect on unknowns has no compliance, and yields by a part of the compliance of
    its pressure.
    """
    twice = friction.twice
    if not twice.size:
        return schur
    softened = schur.copy()
    softened[twice, twice] += elastic_slip(np.diag(schur), friction)
    return softened


def elastic_slip(diagonal: np.ndarray, friction: Friction) -> np.ndarray:
    """Compliance of the rows that leave their forces undetermined, ``friction.twice``.

    Args:
        diagonal: diagonal of S, (M,).
        friction: friction of the rows.
    """
    twice = friction.twice
    pressure = friction.normal[friction.owner[places_of(twice, friction.tangential)]]
    return ELASTIC_SLIP * np.where(diagonal[twice] > 0, diagonal[twice], diagonal[pressure])


def _share(bound: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Bound over size if that is below one, else one."""
    return np.divide(bound, size, out=np.ones(size.size), where=size > bound)
