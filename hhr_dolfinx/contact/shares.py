"""Conditions that several contacts state together, and the share of each contact in their areas and
forces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, vstack


@dataclass(frozen=True)
class Shares:
    """Shares of contacts in common conditions, (s,); all other conditions are those of one
    contact.
    """

    conditions: np.ndarray  #: number of the condition, (s,)
    pairs: np.ndarray  #: contact, by its index in the scene, (s,)
    shares: np.ndarray  #: share in the area and the force, (s,): those of one condition sum to 1
    nodes: csr_matrix  #: share in the entries of its row at each node, (s, nodes)

    def of(self, pair: int, pairs: np.ndarray) -> np.ndarray:
        """Share of a contact in each condition, whose first contacts are ``pairs``, (m,)."""
        found = (pairs == pair).astype(float)
        found[self.conditions] = 0.0
        own = self.pairs == pair
        found[self.conditions[own]] = self.shares[own]
        return found

    def rows_of(self, pair: int, conditions: np.ndarray, rows: csr_matrix) -> csr_matrix:
        """Rows of some conditions, (c, N), as far as they are those of a contact."""
        entry = np.full(int(max(conditions.max(initial=0), self.conditions.max())) + 1, -1)
        own = np.flatnonzero(self.pairs == pair)
        entry[self.conditions[own]] = own
        entries = rows.tocoo()
        entry = entry[conditions][entries.row]
        common = entry >= 0
        scale = np.ones(entries.nnz)
        node = entries.col[common] // (rows.shape[1] // self.nodes.shape[1])
        scale[common] = np.asarray(self.nodes[entry[common], node]).ravel()
        return csr_matrix((entries.data * scale, (entries.row, entries.col)), shape=rows.shape)

    def extended(self, slaves: np.ndarray, pairs: np.ndarray, count: int) -> Shares:
        """Shares in rows of a law too, which follow ``count`` conditions, by slaves and pairs of
        all, (m,).
        """
        own = np.array([slaves, pairs])
        known = own[:, self.conditions]
        entries, rows = np.nonzero((known[:, :, None] == own[:, None, count:]).all(axis=0))
        return Shares(
            np.concatenate([self.conditions, count + rows]),
            np.concatenate([self.pairs, self.pairs[entries]]),
            np.concatenate([self.shares, self.shares[entries]]),
            csr_matrix(vstack([self.nodes, self.nodes[entries]])),
        )

    def ordered(self, order: np.ndarray) -> Shares:
        """Shares of the conditions in another order, (m,)."""
        return replace(self, conditions=np.argsort(order)[self.conditions])
