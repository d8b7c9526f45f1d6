"""Active set for unilateral contact, thesis Alg. 1.1, one function for full and reduced models.

The rule of Alg. 1.1 switches every wrong status at once. It is fast, but it may cycle. When a set
of statuses comes back, the least-index rule of Murty takes over: it switches only the first wrong
status. For a P-matrix S = B K^-1 B^T (K positive definite and B of full rank) it reaches the
solution in finitely many steps (K. G. Murty, "Note on a Bard-type scheme for solving the
complementarity problem", Opsearch 11, 1974). If it comes back to a set of statuses too, S is no
P-matrix, and the answer says so instead of passing an iterate for a solution.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hhr_dolfinx.contact.dense import Factorise, PetscLU
from hhr_dolfinx.contact.problem import Status, Statuses
from hhr_dolfinx.errors import SingularError

TOLERANCE = 1e-11
"""Negative forces and slacks below this fraction of the largest are round-off (measured 1e-13)."""

MAX_ITERATIONS = 1000


def active_set(
    equalities: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
    free_slack: np.ndarray,
    active: np.ndarray,
    max_iterations: int = MAX_ITERATIONS,
) -> Statuses:
    """Iterate on the statuses until forces and slacks are all non-negative, thesis Alg. 1.1.

    Args:
        equalities: maps the statuses (m,) bool and ``free_slack`` to ``(forces, slack)``, both (m,): the
            solution with slack 0 where active and force 0 elsewhere. See :class:`SchurEqualities`.
        free_slack: D - B K^-1 F, the slack without contact forces, (m,), m >= 1.
        active: statuses to start from, (m,) bool; not modified.
        max_iterations: bound on the equality problems solved.

    Returns:
        The statuses; ``forces`` solve the contact problem only if ``status`` is ``CONVERGED``. Where a set is singular
        or numbers are not finite, the statuses are those of the start.
    """
    seen: set[bytes] = set()
    cycled, start = False, active
    for iteration in range(1, max_iterations + 1):
        try:
            forces, slack = equalities(active, free_slack)
        except SingularError:
            return Statuses(np.zeros(free_slack.size), start, iteration, Status.SINGULAR, cycled)
        if slack.min() >= 0 and forces.min() >= 0:
            return Statuses(forces, active, iteration, Status.CONVERGED, cycled)
        if not (np.isfinite(slack).all() and np.isfinite(forces).all()):
            return Statuses(np.zeros(free_slack.size), start, iteration, Status.NOT_FINITE, cycled)
        wrong = (forces < -TOLERANCE * forces.max()) | (slack < -TOLERANCE * abs(free_slack).max())
        if not wrong.any():
            return Statuses(forces, active, iteration, Status.CONVERGED, cycled)
        key = active.tobytes()
        if key in seen:
            if cycled:
                return Statuses(forces, active, iteration, Status.CYCLING, cycled)
            cycled = True
            seen.clear()
        seen.add(key)
        if cycled:
            active = active.copy()
            first = wrong.argmax()
            active[first] = not active[first]
        else:
            active = active ^ wrong
    return Statuses(forces, active, max_iterations, Status.ITERATION_LIMIT, cycled)


class SchurEqualities:
    """Equality problems of the active set on the Schur complement: slack = free_slack + S lambda.

    With K factored once, S = B K^-1 B^T and free_slack = D - B K^-1 F hold all there is to know
    about the contact. A set of statuses costs one dense LU of S[active, active]. The last factors of
    each size are kept: neighbouring parameters often share their statuses, and where they do not, a
    new block is factored in the place of an old one of its size.

    Args:
        columns: maps indices (k,) to the columns of S that belong to them, as rows (k, m).
        size: m.
        factorise: what factors a dense block.
    """

    KEPT_PER_SIZE = 2

    def __init__(self, columns: Callable[[np.ndarray], np.ndarray], size: int, factorise: Factorise = PetscLU):
        self._columns, self._factorise = columns, factorise
        self._entries: dict[bytes, tuple] = {}
        self._kept: list[list[bytes]] = [[] for _ in range(size + 1)]

    @classmethod
    def of(cls, schur: np.ndarray, factorise: Factorise = PetscLU) -> SchurEqualities:
        """On a known S, (m, m), not necessarily symmetric."""
        # transposed, so that picking columns of S copies whole rows
        return cls(np.ascontiguousarray(schur.T).__getitem__, schur.shape[0], factorise)

    def __call__(self, active: np.ndarray, free_slack: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve with the given statuses; returns ``(forces, slack)``, both (m,).

        Raises:
            SingularError: if S[active, active] is singular.
        """
        key = active.tobytes()
        entry = self._entries.get(key)
        if entry is None:
            entry = self._factor(active.nonzero()[0], key)
        index, factor, columns = entry
        forces = np.zeros(free_slack.size)
        if factor is None:
            return forces, free_slack
        local = factor.solve(-free_slack[index])
        forces[index] = local
        slack = free_slack + local @ columns
        slack[index] = 0.0
        return forces, slack

    def _factor(self, index, key):
        columns = self._columns(index)
        block = columns.take(index, axis=1).T
        kept = self._kept[index.size]
        if index.size == 0:
            factor = None
        elif len(kept) < self.KEPT_PER_SIZE:
            factor = self._factorise(block)
        else:
            # out of the books first: a singular block must not leave a stale entry behind
            _, factor, _ = self._entries.pop(kept.pop(0))
            factor.refactor(block)
        entry = (index, factor, columns)
        kept.append(key)
        self._entries[key] = entry
        return entry
