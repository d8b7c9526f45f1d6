"""Reduced problem under hypothesis (H), (2.67): the RID interface has the displacements of the full model, (2.33)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, active_set
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import BoundError
from hhr_dolfinx.plugins.theorems.rid_norms import Directions, Domain


@dataclass(frozen=True)
class ImposedInterface:
    """Find u in V^0_HR and lambda >= 0 with K~ u + B~^T lambda = F~, B~ u <= g~, where K~ is the identity.

    Attributes:
        problem: the full problem.
        domain: the RID.
        space: V^0_HR, modes cut off outside A, by functions that are orthonormal in energy, (|A|, k).
        contact: B~, (N_lambda_C, k).
        equalities: on S~ = B~ B~^T.
        pairs: contact pairs of the conditions.
    """

    problem: ContactProblem
    domain: Domain
    space: Directions
    contact: np.ndarray
    equalities: SchurEqualities
    pairs: Pairs | None

    @classmethod
    def of(cls, problem: ContactProblem, domain: Domain, test: np.ndarray) -> ImposedInterface:
        """From modes cut off outside A, (|A|, ell)."""
        sets = domain.sets
        space = Directions.spanned(test, lambda columns: domain.inner @ columns)
        contact = domain.acting.T @ space.vectors
        pairs = Pairs.of(problem.contact_pairs[sets.A_lambda])
        return cls(problem, domain, space, contact, SchurEqualities.of(contact @ contact.T), pairs)

    def solve(self, field: np.ndarray, theta: Theta) -> np.ndarray:
        """Solution on A, (|A|,), with imposed values on the interface from a field, (N,).

        Raises:
            BoundError: if the statuses do not converge.
        """
        sets = self.domain.sets
        lift = field.copy()
        lift[sets.A] = 0.0
        loads = (self.problem.loads @ theta)[sets.A] - self.domain.rows @ lift
        free = self.space.vectors.T @ loads
        gaps = self.problem.gaps[sets.A_lambda] @ theta - self.domain.contact @ lift
        slack = gaps - self.contact @ free
        found = active_set(self.equalities, slack, slack < 0, pairs=self.pairs)
        if found.status.name != "CONVERGED":
            raise BoundError(f"the reduced problem under (H), (2.33), has no answer: {found.status.name.lower()}")
        return self.space.vectors @ (free - self.contact.T @ found.forces)
