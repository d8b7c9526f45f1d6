"""Linear system of an increment with friction on some statuses, without unknowns along the slip of
slipping contacts.

Closed contacts bear a pressure, sticking ones a tangential force, and both have no slack. A
slipping contact bears b along its direction d. The bound b follows the pressure, or is given by a
limit or Tresca's law. In the plane that is all. In space the direction may turn: Newton's step for
the projection on a disc is the row

    τ - b d - (b / |y|) (1 - d d^T) y,      y = τ - c slack.

Along d this is τ·d = b. Across, with e in the plane of the contact, τ·e = α is an unknown: the
contact sticks across the slip, with a compliance that grows with the slip. Forces are x = known + E
z with the unknowns z. R is E without the coefficients of followed pressures and tests the slack.
R^T S E has as many rows as there are pressures, sticking rows and turning contacts.

Sets of statuses that differ in few rows share factors: with E the columns of the identity at the
rows that differ and V these rows, (M + E (V - M_E))^-1 right = x - Y (V Y)^-1 (V x - right_E), with
x = M^-1 right and Y = M^-1 E (Sherman, Morrison and Woodbury).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgesv, dgetrf, dgetrs

from hhr_dolfinx.errors import SingularError

SINGULAR_RESIDUAL = 1e-8
"""Relative residual of a system above which it counts as singular."""
RESIDUAL_ROUND_OFF = 1e-13
"""Residual relative to the solution, in units in which rows are about one."""
HUGE = 1e9
"""Factor by which a solution may exceed its right-hand side: with elastic slip it reaches 1e6."""
CHANGED_ROWS = 0.3
"""Part of the factored rows that may differ; with more, another system is factored."""
FEW = 8
"""Number of rows that may always differ."""
TURNING, GIVEN, HELD, UP, DOWN = range(-1, 4)
"""Codes of rows: that slip in space, whose coefficients change each time; with a given force;
without slack; that slip in one direction or the other, with a bound that follows the pressure.
"""

UNDETERMINED_FORCES = "the contacts that touch leave their forces undetermined"
"""Message if the equations of active contacts are dependent."""


class SlidingRows(NamedTuple):
    """The problem to which statuses refer (M rows, T tangential rows, r rigid motions)."""

    scaled: np.ndarray
    """S, followed by the effect of rigid motions on the slack, (M, M + r).

    Its rows are multiplied by the factor that gives them the unit of forces: otherwise products
    with given forces cancel.
    """
    balance: np.ndarray  #: resultants of forces along rigid motions, (r, M)
    tangential: np.ndarray  #: tangential rows, contact by contact, (T,)
    normal: np.ndarray  #: row of the pressure of each, (T,)
    curved: np.ndarray  #: True for rows of contacts that slip in two directions, (T,) bool


class SlidingStatuses(NamedTuple):
    """Statuses and directions on which a Newton step is based."""

    #: rows that bear a force: closed contacts, and tangential rows that friction resists, (M,) bool
    acting: np.ndarray
    slips: np.ndarray  #: acting tangential rows that slip, (T,) bool
    followed: (
        np.ndarray
    )  #: coefficient of rows whose bound follows their pressure, 0 of others, (T,)
    direction: np.ndarray  #: d = y_t / |y_t|, (T,)
    shrunk: np.ndarray  #: b / |y_t|, (T,)
    measure: float  #: factor of the stiffness by which slip enters y

    def codes(self, rows: SlidingRows) -> np.ndarray:
        """Kind of each row, (M,) int8."""
        kinds = self.acting.astype(np.int8)
        slips = self.slips
        of_slip = np.where(self.direction > 0, np.int8(UP), np.int8(DOWN))
        of_slip[self.followed == 0] = GIVEN
        of_slip[rows.curved] = TURNING
        kinds[rows.tangential[slips]] = of_slip[slips]
        return kinds


class SlidingSystem:
    """Factors of the system on some statuses; SingularError if it is singular."""

    def __init__(self, rows: SlidingRows, at: SlidingStatuses):
        self._rows = rows
        held = at.acting.copy()
        held[rows.tangential[at.slips]] = False
        self._held = np.flatnonzero(held)
        self.size = self._held.size
        follows = np.flatnonzero(at.slips & (at.followed != 0) & at.acting[rows.normal])
        self._followers = rows.tangential[follows]
        self._leaders = rows.normal[follows]
        self._share = (at.followed[follows] * at.direction[follows])[:, None]
        turning = at.slips & rows.curved
        self._turning = rows.tangential[turning].reshape(-1, 2)
        self._along = at.direction[turning].reshape(-1, 2)
        self._across = self._along[:, ::-1] * (-1.0, 1.0)
        self._yielding = at.shrunk[turning][::2]
        self._turns = slice(
            self.size, self.size + self._yielding.size
        )  # unknowns of turning contacts
        m = len(rows.scaled)
        moving = np.arange(m, m + len(rows.balance))
        self._tests = np.concatenate([self._held, self._turning[:, 0], moving])
        self._tested = self._tested_rows(at.measure)
        self._matrix = self._assembled()
        if self._matrix.size:  # LAPACK refuses empty matrices
            self._factors, self._pivots, info = dgetrf(self._matrix)
            if info != 0:
                raise SingularError(UNDETERMINED_FORCES)

    def _tested_rows(self, measure: float) -> np.ndarray:
        """R^T S and the balance below it, with the effect of rigid motions in the last columns, (k
        + r, M + r).
        """
        scaled = self._rows.scaled
        blocks = [scaled[self._held]]
        if self._yielding.size:
            weights = (measure * self._yielding)[:, None] * self._across
            first, second = self._turning.T
            blocks.append(weights[:, :1] * scaled[first] + weights[:, 1:] * scaled[second])
        balance = self._rows.balance
        if len(balance):
            blocks.append(np.hstack([balance, np.zeros((len(balance),) * 2)]))
        return np.concatenate(blocks) if len(blocks) > 1 else blocks[0]

    def _assembled(self) -> np.ndarray:
        """R^T S E, bordered by rigid motions, (k + r, k + r)."""
        m = len(self._rows.scaled)
        values = self._tested[:, :m]
        matrix = values[:, self._held]
        if self._followers.size:
            leaders = np.searchsorted(self._held, self._leaders)
            second = np.zeros(leaders.size, dtype=bool)
            second[1:] = leaders[1:] == leaders[:-1]
            for chosen in (~second, second):  # two rows of one contact follow the same pressure
                if chosen.any():
                    matrix[:, leaders[chosen]] += (
                        values[:, self._followers[chosen]] * self._share[chosen, 0]
                    )
        blocks = [matrix]
        if self._yielding.size:
            first, partner = self._turning.T
            across = values[:, first] * self._across[:, 0] + values[:, partner] * self._across[:, 1]
            turned = np.arange(self._yielding.size)
            across[self.size + turned, turned] += 1.0 - self._yielding
            blocks.append(across)
        if len(self._rows.balance):
            blocks.append(self._tested[:, m:])
        return np.concatenate(blocks, axis=1) if len(blocks) > 1 else matrix

    def solve(self, right: np.ndarray, check: bool = True) -> np.ndarray:
        """Forces and amplitudes of rigid motions for right-hand sides of all rows, (M + r, P) each.

        Args:
            right: right-hand sides, (M + r, P).
            check: look for round-off of a singular system.

        Raises:
            SingularError: if they are undetermined.
        """
        m = len(self._rows.scaled)
        solution = right.copy()
        solution[self._held] = 0.0
        solution[m:] = 0.0
        reduced = right[self._tests]
        if self._yielding.size:
            pairs = right[self._turning]  # (contacts, 2, P)
            along, across = (
                (pairs * way[:, :, None]).sum(axis=1) for way in (self._along, self._across)
            )
            solution[self._turning] = self._along[:, :, None] * along[:, None]
            reduced[self._turns] = across
        if solution.any():
            reduced -= self._tested[:, :m] @ solution[:m]
        unknown = dgetrs(self._factors, self._pivots, reduced)[0] if reduced.size else reduced
        if check and not _sound(self._matrix @ unknown - reduced, unknown, reduced):
            raise SingularError(UNDETERMINED_FORCES)
        solution[self._held] = unknown[: self.size]
        solution[m:] = unknown[self._turns.stop :]
        if self._followers.size:
            solution[self._followers] += self._share * solution[self._leaders]
        if self._yielding.size:
            solution[self._turning] += self._across[:, :, None] * unknown[self._turns][:, None]
        return solution

    def holds(self, unknowns: np.ndarray, right: np.ndarray, changed: np.ndarray) -> bool:
        """True if all rows without slack hold, except some rows.

        Args:
            unknowns: unknowns, (M + r,).
            right: right-hand sides, (M + r,).
            changed: rows to leave out, (k,).
        """
        unchanged = np.ones(len(self._rows.scaled), dtype=bool)
        unchanged[changed] = False
        residual = self._tested[: self.size] @ unknowns - right[self._held]
        return _sound(residual[unchanged[self._held]], unknowns, right)


def _sound(left: np.ndarray, found: np.ndarray, right: np.ndarray) -> bool:
    """False for a solution that is round-off of a singular system, by its residual and its size."""
    size = np.abs(found).max(initial=0.0)
    wanted = np.abs(right).max(initial=1e-300)
    return bool(
        np.abs(left).max(initial=0.0) <= SINGULAR_RESIDUAL * wanted + RESIDUAL_ROUND_OFF * size
        and size <= HUGE * wanted
    )


class SlidingSystems:
    """Solves systems of statuses in turn, with factors of a similar system while the differences
    are few.
    """

    def __init__(self, rows: SlidingRows):
        self._rows = rows
        self._place = np.full(len(rows.scaled), -1)  # of each row among the tangential ones
        self._place[rows.tangential] = np.arange(rows.tangential.size)
        self._factored: SlidingSystem | None = None
        self._codes = np.full(len(rows.scaled), TURNING, dtype=np.int8)
        self._label = b""
        self._columns = np.empty(
            (len(rows.scaled), rows.scaled.shape[1])
        )  # of the inverse, as rows

    def solve(self, at: SlidingStatuses, right: np.ndarray, label: bytes) -> np.ndarray:
        """Forces and amplitudes of rigid motions, (M + r,).

        Args:
            at: statuses and directions of the rows.
            right: right-hand sides, (M + r,).
            label: key of the coefficients.

        Raises:
            SingularError: if they are undetermined.
        """
        codes = at.codes(self._rows)
        factored = self._factored if label == self._label else None
        changed = self._changed(codes)
        if factored is None or changed.size > max(FEW, CHANGED_ROWS * factored.size):
            self._factored = None  # remains None if the next one is singular
            factored = SlidingSystem(self._rows, at)
            self._found = factored.solve(right[:, None])[:, 0]
            self._factored = factored
            self._codes = codes
            self._label = label
            self._slots = np.full(
                len(codes), -1
            )  # of each row among the columns of the inverse that are known
            self._known = 0
            self._right = right
            return self._found
        same = right == self._right
        same[changed] = True  # these rows are corrected
        if not same.all():
            self._right = right
            self._found = factored.solve(right[:, None], check=False)[:, 0]
        if not changed.size:
            return self._found
        return self._corrected(changed, codes, at, right)

    def holds(self, at: SlidingStatuses, right: np.ndarray, unknowns: np.ndarray) -> bool:
        """True if unknowns solve the system of some statuses, which corrections do not guarantee.

        In a nearly singular system they may be round-off.

        Args:
            at: statuses and directions of the rows.
            right: right-hand sides, (M + r,).
            unknowns: unknowns, (M + r,).
        """
        changed = self._changed(at.codes(self._rows))
        return self._factored is not None and self._factored.holds(unknowns, right, changed)

    def nearer(
        self, at: SlidingStatuses, right: np.ndarray, label: bytes, unknowns: np.ndarray
    ) -> np.ndarray | None:
        """Improve approximate unknowns by factors of a system with other slip directions.

        None if the statuses differ.

        Args:
            at: statuses and directions of the rows.
            right: right-hand sides, (M + r,).
            label: key of the coefficients.
            unknowns: unknowns, (M + r,).
        """
        codes = at.codes(self._rows)
        if self._factored is None or label != self._label or not np.array_equal(codes, self._codes):
            return None
        residual = -right
        residual[: codes.size] += self._values(unknowns[None], np.arange(codes.size), codes, at)[
            :, 0
        ]
        residual[codes.size :] += self._rows.balance @ unknowns[: codes.size]
        return unknowns - self._factored.solve(residual[:, None], check=False)[:, 0]

    def _changed(self, codes: np.ndarray) -> np.ndarray:
        """Rows that differ from the factored system."""
        return np.flatnonzero((codes != self._codes) | (codes == TURNING))

    def forget(self) -> None:
        """Factor the next system in any case: corrections add round-off."""
        self._factored = None

    def _corrected(
        self, changed: np.ndarray, codes: np.ndarray, at: SlidingStatuses, right: np.ndarray
    ) -> np.ndarray:
        """Solution of the factored system, (M + r,), corrected for changed rows."""
        assert self._factored is not None
        solution = self._found
        new = changed[self._slots[changed] < 0]
        if new.size:
            self._slots[new] = self._known + np.arange(new.size)
            unit = np.zeros((self._columns.shape[1], new.size))
            unit[new, np.arange(new.size)] = 1.0
            self._columns[self._slots[new]] = self._factored.solve(unit, check=False).T
            self._known += new.size
        columns = self._columns[np.append(self._slots[changed], -1)]
        columns[-1] = solution
        values = self._values(columns, changed, codes, at)
        columns = columns[:-1]
        _, _, step, info = dgesv(values[:, :-1], values[:, -1] - right[changed])
        if info != 0:
            raise SingularError(UNDETERMINED_FORCES)
        return solution - step @ columns

    def _values(
        self, unknowns: np.ndarray, chosen: np.ndarray, codes: np.ndarray, at: SlidingStatuses
    ) -> np.ndarray:
        """Left-hand sides of some rows, (k, P), for some unknowns, (P, M + r)."""
        rows = self._rows
        kinds = codes[chosen]
        values = unknowns[:, chosen].T
        scaled = rows.scaled if chosen.size == codes.size else rows.scaled[chosen]
        slack = scaled @ unknowns.T
        held = kinds == HELD
        values[held] = slack[held]
        slips = kinds >= UP
        if slips.any():
            position = self._place[chosen[slips]]
            share = at.followed[position] * at.direction[position]
            values[slips] -= share[:, None] * unknowns[:, rows.normal[position]].T
        turns = np.flatnonzero(kinds == TURNING)
        if turns.size:
            position = self._place[chosen[turns]]
            turns = turns[np.argsort(position)]
            position.sort()
            direction = at.direction[position].reshape(-1, 2, 1)
            y = (values[turns] - at.measure * slack[turns]).reshape(len(direction), 2, -1)
            y -= direction * (direction * y).sum(axis=1, keepdims=True)
            y *= at.shrunk[position].reshape(-1, 2, 1)
            share = (at.followed[position] * at.direction[position])[:, None]
            # for a row bounded by a limit the pressure may be zero, without a column
            values[turns] -= (
                y.reshape(turns.size, -1) + share * unknowns[:, rows.normal[position]].T
            )
        return values
