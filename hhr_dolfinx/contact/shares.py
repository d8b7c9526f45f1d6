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
        """Share of a contact in each condition, whose first contacts are ``pairs``, (m,).

        Args:
            pair: index of the contact.
            pairs: first contact of each condition, (m,).
        """
        shares = (pairs == pair).astype(float)
        shares[self.conditions] = 0.0
        of_pair = self.pairs == pair
        shares[self.conditions[of_pair]] = self.shares[of_pair]
        return shares

    def rows_of(self, pair: int, conditions: np.ndarray, rows: csr_matrix) -> csr_matrix:
        """Rows of some conditions, (c, N), as far as they are those of a contact.

        Args:
            pair: index of the contact.
            conditions: the conditions, (c,).
            rows: their rows, (c, N).
        """
        entry = np.full(int(max(conditions.max(initial=0), self.conditions.max())) + 1, -1)
        of_pair = np.flatnonzero(self.pairs == pair)
        entry[self.conditions[of_pair]] = of_pair
        entries = rows.tocoo()
        entry = entry[conditions][entries.row]
        common = entry >= 0
        scale = np.ones(entries.nnz)
        node = entries.col[common] // (rows.shape[1] // self.nodes.shape[1])
        scale[common] = np.asarray(self.nodes[entry[common], node]).ravel()
        return csr_matrix((entries.data * scale, (entries.row, entries.col)), shape=rows.shape)

    def extended(self, slaves: np.ndarray, pairs: np.ndarray, count: int) -> Shares:
        """Shares that also cover the rows of a law, which follow the conditions.

        Args:
            slaves: slave nodes of all rows, (m,).
            pairs: contact of each row, (m,).
            count: number of conditions before the rows of the law.
        """
        keys = np.array([slaves, pairs])
        common = keys[:, self.conditions]
        entries, rows = np.nonzero((common[:, :, None] == keys[:, None, count:]).all(axis=0))
        return Shares(
            np.concatenate([self.conditions, count + rows]),
            np.concatenate([self.pairs, self.pairs[entries]]),
            np.concatenate([self.shares, self.shares[entries]]),
            csr_matrix(vstack([self.nodes, self.nodes[entries]])),
        )

    def ordered(self, order: np.ndarray) -> Shares:
        """Shares of the conditions in another order, (m,)."""
        return replace(self, conditions=np.argsort(order)[self.conditions])
