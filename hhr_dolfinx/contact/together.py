"""Alg. 1.1 for many free slacks at once: those with the same statuses share factors, and are solved by products."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.errors import SingularError
from hhr_dolfinx.linear.dense import Factor, Factorise, LapackLU, solve_columns

ROUNDS = 6
"""Times that statuses are changed for many points together; what is left then is solved point by point."""


def settled(
    schur: np.ndarray, free_slack: np.ndarray, active: np.ndarray, factorise: Factorise = LapackLU
) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Alg. 1.1 for many free slacks, (n, m), from statuses that are changed in place.

    Returns:
        The forces, (n, m); equality problems solved for each point, (n,); and the points that have not settled:
        round-off and singular sets are left to the search of a single point.
    """
    forces, iterations = np.zeros_like(free_slack), np.zeros(len(active), dtype=int)
    factors = KeptFactors(schur, factorise)
    pending, left = np.arange(len(active)), []
    for _ in range(ROUNDS):
        groups: dict[bytes, list[int]] = {}
        for k in pending.tolist():
            groups.setdefault(active[k].tobytes(), []).append(k)
        changed = []
        for key, places in groups.items():
            members = np.array(places)
            index = np.flatnonzero(active[places[0]])
            try:
                found, slack = _equalities(schur, free_slack[members], index, key, factors)
            except SingularError:
                left += places
                continue
            forces[members] = found
            iterations[members] += 1
            # what is not finite is wrong too
            wrong = ~((found >= 0) & (slack >= 0))
            open_ = wrong.any(axis=1)
            active[members[open_]] ^= wrong[open_]
            changed.append(members[open_])
        pending = np.concatenate([np.zeros(0, dtype=int), *changed])
        if not pending.size:
            break
    return forces, iterations, [*left, *pending.tolist()]


class KeptFactors:
    """Factors of blocks of S, (m, m), by statuses; those asked for last are kept, up to ``most_bytes``.

    Attributes:
        kept_bytes: memory of what is kept.
    """

    most_bytes = 64 * 2**20

    def __init__(self, schur: np.ndarray, factorise: Factorise = LapackLU):
        self._schur, self._factorise, self.kept_bytes = schur, factorise, 0
        self._factors: dict[bytes, Factor] = {}  # the one asked for longest ago first

    def of(self, index: np.ndarray, key: bytes) -> Factor:
        """Factors of the block of some conditions, (k,), whose statuses have this key.

        Raises:
            SingularError: if the block is singular.
        """
        found = self._factors.pop(key, None)
        if found is None:
            found = self._factorise(self._schur[np.ix_(index, index)])
            self.kept_bytes += found.nbytes
        self._factors[key] = found
        while self.kept_bytes > self.most_bytes:
            self.kept_bytes -= self._factors.pop(next(iter(self._factors))).nbytes
        return found


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
