"""Linear systems that are S with some rows replaced, which differ in few rows from one to the next.

The last system that was factored serves those like it: with E the columns of the identity at the rows that differ and V
these rows less the old ones, (M + E V)^-1 = M^-1 - M^-1 E (1 + V M^-1 E)^-1 V M^-1 (Sherman, Morrison and Woodbury).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg.lapack import dgesv, dgetrf, dgetrs

from hhr_dolfinx.errors import SingularError

GIVEN = 0
"""Code of a row that gives its unknown: x_i = right_i."""
WHOLE = 1
"""Code of a row of S."""
ANEW = -1
"""Code of a row that is another one each time."""
SINGULAR = 1e-8
"""Residual of a system, in parts of its right-hand side, from which on it is singular to round-off."""
ROUND_OFF = 1e-13
"""Residual in parts of the solution, in units in which rows are about one."""
HUGE = 1e9
"""Factor by which a solution may be above its right-hand side: what elastic slip holds reaches 1e6."""
PART = 0.3
"""Part of the size of the factored block that may differ before another one is factored."""
FEW = 8
"""Rows that may differ in any case."""

DEPENDENT = "the contacts that touch leave their forces undetermined"

Rows = Callable[[np.ndarray], np.ndarray]
"""Maps numbers of rows of other codes, (k,), to these rows, (k, n)."""


class ReplacedRows:
    """Solves systems of rows of one matrix, of the identity, and others.

    Corrections add round-off: who meets too much of it lets it :meth:`forget` what is kept, and solves anew.

    Args:
        whole: the matrix, (n, n).
    """

    def __init__(self, whole: np.ndarray):
        self.whole = whole
        self._codes: np.ndarray | None = None  # of the factored system
        self._label = b""

    def solve(self, codes: np.ndarray, others: Rows, right: np.ndarray, label: bytes) -> np.ndarray:
        """The solution, (n,) or (n, p).

        Args:
            codes: of each row, :data:`GIVEN`, :data:`WHOLE`, :data:`ANEW`, or another number, which stands for a row
                as long as the label is the same.
            others: makes the rows that are neither given nor whole.
            right: (n,) or (n, p).
            label: what rows of other codes depend on.

        Raises:
            SingularError: if the system is singular.
        """
        changed = self._changed(codes, label)
        if changed is None:
            self._factor(codes, others, label)
        found = self._solved(right)
        if changed is not None and changed.size:
            updated = self._updated(found, changed, codes, others, right)
            if self._holds(updated, right, np.isin(self._acting, changed, invert=True)):
                return updated
            self.forget()  # nearly singular, of which corrections know nothing
            return self.solve(codes, others, right, label)
        if changed is not None:
            return found
        if not self._holds(found, right, np.ones(self._acting.size, dtype=bool)):
            self.forget()
            raise SingularError(DEPENDENT)
        return found

    def _holds(self, found: np.ndarray, right: np.ndarray, rows: np.ndarray) -> bool:
        """Whether some of the factored rows, (k,) bool, hold, and the solution is no round-off of a singular system."""
        left = np.abs((self._whole_rows @ found - right[self._acting])[rows]).max(initial=0.0)
        size = np.abs(found).max(initial=0.0)
        given = np.abs(right).max(initial=1e-300)
        return bool(left <= SINGULAR * given + ROUND_OFF * size and size <= HUGE * given)

    def forget(self) -> None:
        """Factor the next system, whatever it is."""
        self._codes = None

    def _changed(self, codes: np.ndarray, label: bytes) -> np.ndarray | None:
        """Rows that differ from the factored system; None where another one is to be factored."""
        if self._codes is None or label != self._label:
            return None
        changed = np.flatnonzero((codes != self._codes) | (codes == ANEW))
        return None if changed.size > max(FEW, PART * self._acting.size) else changed

    def _factor(self, codes: np.ndarray, others: Rows, label: bytes) -> None:
        """Factor the block of rows that are not given."""
        self._codes = None
        acting = np.flatnonzero(codes != GIVEN)
        rows = self._rows(acting, codes, others)
        if acting.size:  # LAPACK knows no matrix of nothing
            self._block, self._pivots, info = dgetrf(rows[:, acting], overwrite_a=1)
            if info != 0:
                raise SingularError(DEPENDENT)
        self._acting = acting
        self._whole_rows = rows
        self._codes = codes.copy()
        self._label = label
        self._columns = np.zeros((0, len(codes)))  # of its inverse, those asked for, as rows
        self._slots = np.full(len(codes), -1)  # where those of each row are among them

    def _rows(self, rows: np.ndarray, codes: np.ndarray, others: Rows) -> np.ndarray:
        """Rows of a system, (k, n)."""
        own = codes[rows]
        found = self.whole[rows]
        found[own == GIVEN] = 0.0
        given = np.flatnonzero(own == GIVEN)
        found[given, rows[given]] = 1.0
        special = np.flatnonzero((own != GIVEN) & (own != WHOLE))
        if special.size:
            found[special] = others(rows[special])
        return found

    def _solved(self, right: np.ndarray) -> np.ndarray:
        """Solve with the factored system."""
        found = right.copy()
        found[self._acting] = 0.0
        own = right[self._acting]
        if found.any():
            own = own - self._whole_rows @ found
        found[self._acting] = dgetrs(self._block, self._pivots, own)[0] if self._acting.size else own
        return found

    def _updated(
        self, found: np.ndarray, changed: np.ndarray, codes: np.ndarray, others: Rows, right: np.ndarray
    ) -> np.ndarray:
        """Correct a solution of the factored system for rows that changed."""
        new = changed[self._slots[changed] < 0]
        if new.size:
            unit = np.zeros((len(found), new.size))
            unit[new, np.arange(new.size)] = 1.0
            self._slots[new] = len(self._columns) + np.arange(new.size)
            self._columns = np.concatenate([self._columns, self._solved(unit).T])
        columns = self._columns[self._slots[changed]]
        rows = self._rows(changed, codes, others)
        _, _, step, info = dgesv(rows @ columns.T, rows @ found - right[changed])
        if info != 0:
            raise SingularError(DEPENDENT)
        return found - columns.T @ step
