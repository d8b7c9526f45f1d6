"""Stiffness of one iterate of a step: columns of K^-1 B^T are solved for when their conditions first become active."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from hhr_dolfinx.contact.active_set import SchurEqualities
from hhr_dolfinx.contact.stiffness import SparseStiffness


class LazyStiffness(SparseStiffness):
    """Stiffness whose columns of K^-1 B^T and S are solved for when their conditions first become active: tangents."""

    @cached_property
    def equalities(self) -> SchurEqualities:
        """See :class:`Stiffness`."""
        self._known: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        return SchurEqualities(self._images, self.contact.shape[0])

    def _images(self, index: np.ndarray) -> np.ndarray:
        """Columns of S as rows, (k, m)."""
        new = [k for k in index.tolist() if k not in self._known]
        if new:
            columns = self.columns(self.contact[new].T)
            images = self.contact @ columns
            for place, k in enumerate(new):
                self._known[k] = columns[:, place], images[:, place]
        return np.array([self._known[k][1] for k in index.tolist()]).reshape(index.size, self.contact.shape[0])

    def response_to_forces(self, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T times forces on conditions that have been active, (m,): (n,)."""
        found = np.zeros(self.contact.shape[1])
        for k in np.flatnonzero(forces).tolist():
            found += forces[k] * self._known[k][0]
        return found
