"""An elimination of a user's own, in one file: a full problem with dense matrices, K inverted once and for all."""

from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.models.eliminations.elimination import CondensedContact, Elimination


@dataclass(frozen=True)
class DenseElimination(Elimination):
    """Eliminates with K^-1 as a dense matrix (n unknowns, m conditions, 1 + T terms).

    Attributes:
        inverse: K^-1, (n, n).
        contact: B, (m, n).
        loads, gaps: as terms of θ, (n, 1 + T) and (m, 1 + T).
        amplitudes: θ as a function of the parameters.
    """

    inverse: Annotated[Floats, "unknowns", "unknowns"]
    contact: Annotated[Floats, "m", "unknowns"]
    loads: Annotated[Floats, "unknowns", "terms"]
    gaps: Annotated[Floats, "m", "terms"]
    amplitudes: Amplitudes

    def __call__(self, point):
        theta, pushed = self.amplitudes(point), self.inverse @ self.contact.T
        free = self.inverse @ (self.loads @ theta)
        slack = self.gaps @ theta - self.contact @ free
        changes = partial(self._changes, point)
        return CondensedContact(self.contact @ pushed, slack, free, partial(np.matmul, pushed), changes)

    def _changes(self, point, forces, unknown):
        acting, slopes = self.amplitudes.slopes_at(point)
        moved = self.inverse @ (self.loads[:, acting] @ slopes)
        return self.gaps[:, acting] @ slopes - self.contact @ moved, moved
