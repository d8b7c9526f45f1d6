"""Several laws on ranges of rows of one condensed contact problem, slack = free slack + S x, solved
together.

A law relates the forces x and the slacks s of its rows. Its residual is x less a projection of
x - c s, and at any iterate it gives rows P x' + Q s' = r for the next one. One semi-smooth Newton
method solves the rows of all ranges, and the balance of bodies that contact alone holds. If it does
not converge, projections x <- projection of x - c s with c < 2 / |S| precede it. For monotone laws,
whose projections are resolvents, these converge from anywhere (forward and backward splitting,
P.-L. Lions and B. Mercier, SIAM J. Numer. Anal. 16, 1979). Friction is not monotone, so that
nothing is proved with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

import numpy as np
from scipy import linalg

from hhr_dolfinx.contact.active_set import OTHER_PAIRS_ROUND_OFF, Status
from hhr_dolfinx.errors import NotSolvableError
from hhr_dolfinx.memory import NO_MEMORY, Memory

if TYPE_CHECKING:
    from hhr_dolfinx.contact.law import ContactLaw

PROJECTION_TOLERANCE = 1e-11
"""Relative deviation of forces from their projection up to which they have converged (measured
round-off: 1e-14).
"""
EPSILON = 4e-16
"""Round-off of one sum, relative to its terms; loops that ask for less do not end."""
ATTEMPTS = 3
"""Number of ways in which a law may choose its statuses."""
NEWTON_ITERATIONS = 40
"""Iterations of Newton's method before another attempt.

Two to five are usual from the previous increment.
"""
PROJECTIONS = (30, 100, 300, 1000, 3000, 10000)
"""Projections between one round of Newton's method and the next."""
RANGE_COMPLIANCES = (1e3, 1e5, 1e7, 1e9)
"""Compliances of springs that hold bodies, relative to that of contact."""
RANGE_STEPS = 30
"""Steps of the proximal point method with springs of one compliance."""
BALANCED_RANGES = 1e-12
"""Imbalance of the forces on bodies, relative to the largest, up to which they are balanced."""


class OffDiagonal(NamedTuple):
    """Entries of P and Q off the diagonal, (e,) each; no place twice."""

    rows: np.ndarray
    columns: np.ndarray
    on_forces: np.ndarray
    on_slack: np.ndarray


class Linearised(NamedTuple):
    """A law of k rows at an iterate; P and Q are diagonal but for some entries."""

    off: np.ndarray  #: forces less their projection, (k,)
    on_forces: np.ndarray  #: diagonal of P, (k,)
    on_slack: np.ndarray  #: diagonal of Q, (k,)
    right: np.ndarray  #: r, (k,)
    key: bytes  #: statuses; if the same ones come back, the iteration cycles
    active: (
        np.ndarray
    )  #: rows that touch: rows with a force, and tangential rows that stick, (k,) bool
    coupling: OffDiagonal | None = None

    def of_slack(self, values: np.ndarray) -> np.ndarray:
        """Q times values of the rows, (k, ...)."""
        product = (values.T * self.on_slack).T
        if self.coupling is not None:
            rows, columns, _, entries = self.coupling
            np.add.at(product, rows, (values[columns].T * entries).T)
        return product


class RangeStep:
    """Base of a law of k rows in one increment, from its memory at the beginning.

    Defaults are those without memory.
    """

    shift: np.ndarray  #: part that the memory adds to the free slack, (k,)

    def linearised(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, attempt: int
    ) -> Linearised:
        """Linearise at forces and slacks of the rows.

        Other attempts than 1 may choose their statuses as helps the search.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
            attempt: number of the way to choose statuses; 1 gives those of the residual.

        Raises:
            NotImplementedError: a law must state it.
        """
        raise NotImplementedError

    def after(self, forces: np.ndarray, slack: np.ndarray, active: np.ndarray) -> Memory:
        """Memory at the end of the increment.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            active: rows that touch or stick, (k,) bool.
        """
        return NO_MEMORY

    def after_slip(self, memory: Memory, rubbed: np.ndarray) -> Memory:
        """Memory at the end of an increment in which rows have slipped, under friction.

        Args:
            memory: that of ``after``.
            rubbed: pressure integrated along the slip of the increment, stress times length, (k,).
        """
        return memory

    def slopes(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray
    ) -> np.ndarray | float:
        """Derivatives of the residual along the parameters at constant forces, slacks and memory,
        (k, P).

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
        """
        return 0.0

    def shifted(self, before: np.ndarray) -> np.ndarray:
        """Derivatives of the slacks by those of the memory, (k, P): of a shift, the same.

        It is called after ``linearised``, at the solution.

        Args:
            before: derivatives of the memory, (k, P).
        """
        return before

    def carried(
        self, before: np.ndarray, forces: np.ndarray, slack: np.ndarray, active: np.ndarray
    ) -> np.ndarray:
        """Derivatives of the next shift, or of what of the memory ``shifted`` reads, (k, P).

        Args:
            before: derivatives of the shift, (k, P).
            forces: derivatives of the forces, (k, P).
            slack: derivatives of the slacks, (k, P).
            active: rows that touch or stick, (k,) bool.
        """
        return before

    def grazing(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, near: float
    ) -> np.ndarray:
        """Mask of the rows at a kink, where derivatives are one-sided, (k,) bool.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
            near: force below which a row counts as at a kink.
        """
        return np.abs(forces - stiffness * slack) <= near


StateOfRange = TypeVar("StateOfRange")
LawOfRange = TypeVar("LawOfRange", bound="ContactLaw")


class RangeSolver(Generic[LawOfRange, StateOfRange]):
    """Base of the facet ``range``: a law of a plug-in on its rows, in a scene with other laws, or
    without memory.

    A law must be monotone, a force that never falls while its gap closes, or say by ``coupling``
    how far it is not.
    """

    def __init__(self, law: LawOfRange):
        self.law = law

    def compliance(self, diagonal: np.ndarray) -> np.ndarray | float:
        """Elastic compliance of rows that leave their forces undetermined, by the diagonal of S,
        (k,).
        """
        return 0.0

    def at_rest(self) -> Memory:
        """Memory of undeformed bodies."""
        return NO_MEMORY

    def memory_at_rest(self, gaps: np.ndarray, point: np.ndarray) -> Memory:
        """Memory of undeformed bodies, if it depends on their gaps or on parameters.

        Args:
            gaps: gaps of the rows, (k,).
            point: parameter at rest, (P,).
        """
        return self.at_rest()

    def step(self, before: Memory, point: np.ndarray, seconds: float) -> RangeStep:
        """Increment from a memory to a point.

        A law without memory gets an empty one, and NaN seconds.

        Args:
            before: memory at its start.
            point: parameter at its end, (P,).
            seconds: its duration.

        Raises:
            NotImplementedError: a law must state it.
        """
        raise NotImplementedError

    def difference(
        self, off: float, ends: Sequence[StateOfRange], rows: np.ndarray, largest: float
    ) -> float:
        """Error of a step in two halves.

        Args:
            off: error of its forces, relative to ``largest``.
            ends: states at the start, after the first half, after the second, and after the whole
                step.
            rows: numbers of the rows among all conditions, (k,).
            largest: largest norm of the forces so far.
        """
        return off

    def check(self, memory: Memory, place: str) -> None:
        """Check the memory at the end of a step, and warn; ``place`` is the parameter, in words."""

    def coupling(self, schur: np.ndarray, rows: np.ndarray, point: np.ndarray) -> float:
        """Part of the law in :meth:`AnsweringModel.coupling`; a monotone law has none.

        Args:
            schur: S, (M, M).
            rows: numbers of the rows among all conditions, (k,).
            point: parameter, (P,).
        """
        return 0.0


class CurveStep(RangeStep):
    """A pressure over the closure of each row, minus its slack; without memory.

    A law derives ``curve``, and ``curve_slopes`` if it depends on parameters.
    """

    def __init__(self, size: int):
        self.shift = np.zeros(size)

    def curve(self, closure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces at closures >= 0, (k,), and their derivatives.

        Raises:
            NotImplementedError: a law must state it.
        """
        raise NotImplementedError

    def curve_slopes(self, closure: np.ndarray) -> np.ndarray | float:
        """Derivatives of the forces along the parameters at constant closures, (k, P)."""
        return 0.0

    def linearised(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, attempt: int
    ) -> Linearised:
        """By the resolvent of the curve.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
            attempt: number of the way to choose statuses; 1 gives those of the residual.
        """
        force, slope, _ = resolvent(self.curve, forces - stiffness * slack, stiffness)
        return closing(forces, slack, stiffness, force, slope)

    def slopes(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray
    ) -> np.ndarray | float:
        """Derivatives of x - f(d) at constant x - c s: 1 - J = c / (f' + c) times those of the
        curve.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
        """
        _, slope, closure = resolvent(self.curve, forces - stiffness * slack, stiffness)
        return -(np.transpose(self.curve_slopes(closure)) * (1.0 - slope)).T


def closing(
    forces: np.ndarray,
    slack: np.ndarray,
    stiffness: np.ndarray,
    projection: np.ndarray,
    slope: np.ndarray,
) -> Linearised:
    """Linearised law of independent rows, by the projection of x - c s and its slope, 0 <= J <= 1.

    Args:
        forces: forces of the rows, (k,).
        slack: slacks of the rows, (k,).
        stiffness: c, force per slack of each row, (k,).
        projection: projection of x - c s, (k,).
        slope: its slope J, (k,).
    """
    right = projection - slope * (forces - stiffness * slack)
    touching = slope > 0
    return Linearised(
        forces - projection,
        1.0 - slope,
        slope * stiffness,
        right,
        slope.tobytes(),  # a curve of segments may come back to a status on another one
        touching | (projection > 0),
    )


def resolvent(
    curve: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    y: np.ndarray,
    stiffness: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forces f(d) with f(d) + c d = y and d >= 0, their derivatives along y, and d, (k,) each.

    Newton's method, bracketed by d in [0, y / c]. A force is y - c d where the curve is stiffer
    than c and f(d) where it is softer, which are accurate there.

    Args:
        curve: function that gives f and its derivative at closures >= 0, (k,).
        y: x - c s, (k,).
        stiffness: c, force per slack of each row, (k,).

    Raises:
        NotSolvableError: for a curve that falls: forces may then be several, and projections need
            not converge.
    """
    low = np.zeros_like(y)
    closes = y > curve(low)[0]
    high = closure = np.where(closes, y, 0.0) / stiffness
    for _ in range(200):
        force, slope = curve(closure)
        if (slope < 0).any():
            raise NotSolvableError(
                "the pressure of a contact law falls at the closure "
                f"{closure[np.argmin(slope)]:.6g}: only laws whose pressure never falls while the "
                "gap closes are built in, as others may have several answers"
            )
        residual = force + stiffness * closure - y
        change = residual / (slope + stiffness)
        settled = (
            ~closes | (np.abs(change) <= EPSILON * closure) | (np.abs(residual) <= EPSILON * y)
        )
        if settled.all():
            break
        low = np.where(residual < 0, closure, low)
        high = np.where(residual < 0, high, closure)
        # Newton's method comes down slowly from far above on a steep curve
        new = np.where(force > 4.0 * y, 0.25 * closure, closure - change)
        new = np.where((new > low) & (new < high), new, 0.5 * (low + high))
        closure = np.where(settled, closure, new)
    force, slope = curve(closure)
    with np.errstate(divide="ignore"):
        share = 1.0 / (1.0 + stiffness / slope)
    force = np.where(slope > stiffness, y - stiffness * closure, force)
    return np.where(closes, force, np.maximum(y, 0.0)), np.where(closes, share, y > 0), closure


class UnilateralStep(RangeStep):
    """Unilateral contact of some rows."""

    def __init__(self, size: int):
        self.shift = np.zeros(size)

    def linearised(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, attempt: int
    ) -> Linearised:
        """Force or slack is zero.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
            attempt: number of the way to choose statuses; 1 gives those of the residual.
        """
        y = forces - stiffness * slack
        return closing(forces, slack, stiffness, np.maximum(y, 0.0), (y > 0).astype(float))


class Together(NamedTuple):
    """Outcome of an increment (M rows, r rigid motions)."""

    forces: np.ndarray
    slack: np.ndarray
    active: np.ndarray  #: see :class:`Linearised`
    motions: np.ndarray  #: amplitudes of motions of bodies that contact alone holds, (r,)
    iterations: int  #: linear systems solved
    projections: int
    status: Status
    unsettled: np.ndarray  #: rows that still change

    def followed(self, last: Together, projections: int) -> Together:
        """The outcome of a further attempt, and the systems and projections of both.

        Args:
            last: outcome of the further attempt.
            projections: projections before it.
        """
        spent = self.projections + projections + last.projections
        return last._replace(iterations=self.iterations + last.iterations, projections=spent)


class Ranges:
    """Laws on ranges of rows of one S, (M, M), for any number of increments.

    ``compliance`` is added to the diagonal of S, (M,); ``motions`` is G = B R of motions of bodies
    that contact alone holds, (M, r).
    """

    def __init__(
        self,
        schur: np.ndarray,
        rows: Sequence[np.ndarray],
        compliance: np.ndarray,
        motions: np.ndarray | None = None,
    ):
        self.given = schur
        self.schur = schur + np.diag(compliance) if compliance.any() else schur
        self.rows = tuple(rows)
        self.motions = np.zeros((len(schur), 0)) if motions is None else motions
        diagonal = np.abs(np.diag(self.schur))
        self.typical = float(diagonal[diagonal > 0].mean()) if (diagonal > 0).any() else 1.0
        self.stiffness = 1.0 / np.where(diagonal > 0, diagonal, self.typical)
        self._sizes = np.abs(self.schur)
        bordered = np.hstack([self.schur, -self.motions])
        self._whole = [bordered[indices] for indices in self.rows]

    def solve(
        self,
        free_slack: np.ndarray,
        steps: Sequence[RangeStep],
        start: np.ndarray,
        driving: np.ndarray | None = None,
    ) -> Together:
        """Solve an increment.

        Args:
            free_slack: slack without contact forces, (M,).
            steps: increment of each law.
            start: forces to start from, (M,).
            driving: loads along the motions, (r,); None without any.
        """
        free = free_slack.copy()
        for rows, step in zip(self.rows, steps, strict=True):
            free[rows] += step.shift
        driving = np.zeros(0) if driving is None else driving
        nothing = np.zeros(len(free))
        if not (np.isfinite(free).all() and np.isfinite(driving).all()):
            none = np.zeros(0, dtype=np.int64)
            return Together(nothing, free, nothing != 0, 0 * driving, 0, 0, Status.NOT_FINITE, none)
        return self._found(free, steps, start, driving)

    def _found(
        self, free: np.ndarray, steps: Sequence[RangeStep], start: np.ndarray, driving: np.ndarray
    ) -> Together:
        """Solve by Newton's method, and if it does not converge, with projections or springs before
        it.
        """
        outcome = self._newton(free, steps, start, 0 * driving, driving)
        if outcome.status is Status.CONVERGED:
            return outcome
        if driving.size:
            return self._by_springs(free, steps, start, driving, outcome)
        forces = start
        for count in PROJECTIONS:
            forces = self._projected(free, steps, np.where(np.isfinite(forces), forces, 0.0), count)
            outcome = outcome.followed(self._newton(free, steps, forces, driving, driving), count)
            if outcome.status is Status.CONVERGED:
                break
        return outcome

    def linearised(
        self,
        slack: np.ndarray,
        steps: Sequence[RangeStep],
        forces: np.ndarray,
        stiffness: np.ndarray,
        attempt: int,
    ) -> list[Linearised]:
        """Linearise all laws at forces and slacks.

        Args:
            slack: slacks of all rows, (M,).
            steps: increment of each law.
            forces: forces of all rows, (M,).
            stiffness: c of all rows, (M,).
            attempt: number of the way to choose statuses; 1 gives those of the residual.
        """
        pairs = zip(self.rows, steps, strict=True)
        return [
            step.linearised(forces[rows], slack[rows], stiffness[rows], attempt)
            for rows, step in pairs
        ]

    def solved(
        self,
        parts: Sequence[Linearised],
        right: np.ndarray,
        solver: Callable[[np.ndarray, np.ndarray], np.ndarray] = np.linalg.solve,
    ) -> np.ndarray:
        """Forces and motions that solve P x + Q (S x - G a) = right, G^T x = driving, (M + r, ...).

        Args:
            parts: linearised law of each range.
            right: right-hand sides, (M + r, ...).
            solver: solves a linear system.

        Raises:
            LinAlgError: if they are undetermined.
        """
        m, r = self.motions.shape
        matrix = np.zeros((m + r, m + r))
        for rows, linearised, bordered in zip(self.rows, parts, self._whole, strict=True):
            block = linearised.of_slack(bordered)
            block[np.arange(rows.size), rows] += linearised.on_forces
            if linearised.coupling is not None:
                block[linearised.coupling.rows, rows[linearised.coupling.columns]] += (
                    linearised.coupling.on_forces
                )
            matrix[rows] = block
        matrix[m:, :m] = self.motions.T
        # rows that read no force but their own are known at once, as those of open contacts are
        diagonal = np.diag(matrix)
        alone = (np.count_nonzero(matrix, axis=1) == 1) & (diagonal != 0)
        solution = np.zeros_like(right)
        solution[alone] = (right[alone].T / diagonal[alone]).T
        coupled = np.flatnonzero(~alone)
        nonzero = np.flatnonzero(solution.any(axis=1) if solution.ndim > 1 else solution)
        system = matrix[coupled]
        solution[coupled] = solver(
            system[:, coupled], right[coupled] - system[:, nonzero] @ solution[nonzero]
        )
        return solution

    def slopes(self, parts: Sequence[Linearised], right: np.ndarray) -> np.ndarray:
        """As :meth:`solved`; motions that nothing determines, as of bodies without contact, are the
        smallest, (M + r, P).

        Args:
            parts: linearised law of each range.
            right: right-hand sides, (M + r, P).
        """
        try:
            return self.solved(parts, right)
        except np.linalg.LinAlgError:
            return self.solved(parts, right, lambda matrix, b: linalg.lstsq(matrix, b)[0])

    def _newton(
        self,
        free: np.ndarray,
        steps: Sequence[RangeStep],
        start: np.ndarray,
        motions: np.ndarray,
        driving: np.ndarray,
    ) -> Together:
        """Newton's method with one way to choose statuses after another."""
        outcome = self._attempt(free, steps, start, motions, driving, 0)
        for attempt in range(1, ATTEMPTS):
            if outcome.status is Status.CONVERGED:
                break
            outcome = outcome.followed(
                self._attempt(free, steps, start, motions, driving, attempt), 0
            )
        return outcome._replace(iterations=max(outcome.iterations, 1))

    def _attempt(
        self, free: np.ndarray, steps: Sequence[RangeStep], forces: np.ndarray, motions: np.ndarray,
        driving: np.ndarray, attempt: int,
    ) -> Together:  # fmt: skip
        seen: set[bytes] = set()
        least = np.inf
        status = Status.UNSETTLED
        for iteration in range(NEWTON_ITERATIONS + 1):
            slack = free + self.schur @ forces - self.motions @ motions
            linearisations = self.linearised(slack, steps, forces, self.stiffness, attempt)
            off, noise = self._off(linearisations, free, forces, motions)
            if (off <= noise).all() and self._balanced(forces, driving, free):
                active = np.zeros(len(forces), dtype=bool)
                for rows, linearised in zip(self.rows, linearisations, strict=True):
                    active[rows] = linearised.active
                none = np.zeros(0, dtype=np.int64)
                return Together(
                    forces, slack, active, motions, iteration, 0, Status.CONVERGED, none
                )
            worst = float((off / noise).max())
            key = b"".join(linearised.key for linearised in linearisations)
            if (
                iteration == NEWTON_ITERATIONS
                or not np.isfinite(worst)
                or (key in seen and not worst < 0.5 * least)
            ):
                break
            seen.add(key)
            least = min(least, worst)
            right = np.concatenate([np.zeros(len(free)), driving])
            for rows, linearised in zip(self.rows, linearisations, strict=True):
                right[rows] = linearised.right - linearised.of_slack(free[rows])
            try:
                forces, motions = np.split(self.solved(linearisations, right), [len(forces)])
            except np.linalg.LinAlgError:
                status = Status.SINGULAR
                break
        return Together(
            forces, slack, off > noise, motions, iteration, 0, status, np.flatnonzero(off > noise)
        )

    def _off(
        self, parts: Sequence[Linearised], free: np.ndarray, forces: np.ndarray, motions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Deviations of all rows, and their round-off, (M,) each, by range: a stiff one does not
        loosen a weak one.
        """
        size = np.abs(forces)
        # a slack is not more exact than the terms of its sum
        noise = (
            EPSILON
            * self.stiffness
            * (np.abs(free) + self._sizes @ size + np.abs(self.motions) @ np.abs(motions))
        )
        noise += OTHER_PAIRS_ROUND_OFF * size.max(initial=0.0) + 1e-300
        off = np.zeros(len(forces))
        for rows, linearised in zip(self.rows, parts, strict=True):
            off[rows] = np.abs(linearised.off)
            noise[rows] += PROJECTION_TOLERANCE * size[rows].max(initial=0.0)
        return off, noise

    def _balanced(self, forces: np.ndarray, driving: np.ndarray, free: np.ndarray) -> bool:
        if not driving.size:
            return True
        ways = np.abs(self.motions)
        sizes = np.abs(driving) + np.abs(forces) @ ways
        # without loads forces are round-off of those that would close the gaps
        nothing = EPSILON * (self.stiffness * np.abs(free)) @ ways
        admitted = np.maximum(BALANCED_RANGES * sizes.max(), nothing)
        return bool((np.abs(driving - forces @ self.motions) <= admitted).all())

    def _projected(
        self, free: np.ndarray, steps: Sequence[RangeStep], forces: np.ndarray, count: int
    ) -> np.ndarray:
        """Forces after some projections."""
        stiffness = np.full(len(forces), 1.9 / np.linalg.norm(self.schur, 2))
        for _ in range(count):
            linearisations = self.linearised(
                free + self.schur @ forces, steps, forces, stiffness, 1
            )
            forces = forces.copy()
            for rows, linearised in zip(self.rows, linearisations, strict=True):
                forces[rows] -= linearised.off
        return forces

    def _by_springs(
        self,
        free: np.ndarray,
        steps: Sequence[RangeStep],
        start: np.ndarray,
        driving: np.ndarray,
        outcome: Together,
    ) -> Together:
        """Hold bodies by weak springs whose ends move until they bear nothing (proximal points).

        Newton's method ends.

        R. T. Rockafellar, SIAM J. Control Optim. 14, 1976.
        """
        push = (self.motions**2).mean(axis=0)
        ends = 0 * driving
        forces = start
        for weak in RANGE_COMPLIANCES:
            springs = weak * self.typical / np.where(push > 0, push, 1.0)
            held = self.schur + (self.motions * springs) @ self.motions.T
            ranges = Ranges(held, self.rows, np.zeros(len(free)))
            for _ in range(RANGE_STEPS):
                sprung = ranges._found(
                    free - self.motions @ (ends + springs * driving), steps, forces, driving[:0]
                )
                outcome = outcome.followed(sprung, 0)
                if sprung.status is not Status.CONVERGED:
                    return outcome._replace(motions=ends)
                forces = sprung.forces
                ends = ends + springs * (driving - forces @ self.motions)
                if self._balanced(forces, driving, free):
                    return outcome._replace(motions=ends)
                outcome = outcome.followed(self._newton(free, steps, forces, ends, driving), 0)
                if outcome.status is Status.CONVERGED:
                    return outcome
        return outcome._replace(status=Status.ADRIFT)
