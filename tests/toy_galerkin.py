"""A way to reduce of a user's own, in one file: POD-Galerkin on the whole mesh, with all contact
conditions kept.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.linalg import cho_factor, cho_solve, orth

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.eliminations.constant import ConstantElimination
from hhr_dolfinx.models.eliminations.elimination import Responses
from hhr_dolfinx.models.exact import ExactFields
from hhr_dolfinx.reduction.modes import pod
from hhr_dolfinx.reduction.reductor import Reductor, Task


class GalerkinFields(ExactFields):
    """Fields whose errors only a comparison knows."""

    exact = False
    unbounded = "plain Galerkin has no bound"

    def estimate(self, answer):
        return None


@dataclass(frozen=True)
class Galerkin(Reductor[Task]):
    """Modes of training displacements and one for each contact condition, more of them until errors
    are small.

    An error of displacements and forces of ``small`` is small enough.
    """

    small: float = 1e-3
    fields: type = GalerkinFields
    method: ClassVar[str] = "galerkin"
    remedy = "train on more points"

    def check(self, task):
        full, problem = task.full, task.full.problem
        if (
            full.equilibrium is not None
            or full.law.plugin
            or problem.varies
            or problem.kernel is not None
        ):
            raise NotOfferedError(
                "Galerkin is for elastic bodies of constant stiffness that are held"
            )

    def levels(self, task):
        return (1e-4, 1e-8, 1e-12)

    def attempt(self, prepared, level):
        full, problem = prepared.full, prepared.full.problem
        modes = pod(prepared.snapshots.displacements * problem.free[:, None], level)[0]
        contact = problem.contact.toarray() * problem.free
        basis = orth(np.column_stack([modes, contact.T]), rcond=1e-10)
        factor = cho_factor(basis.T @ (problem.stiffness @ basis))
        free, per_force = (
            basis @ cho_solve(factor, basis.T @ b) for b in (problem.loads.toarray(), contact.T)
        )
        slack = problem.gaps - problem.contact @ free
        responses = Responses(free[:0], per_force[:0], slack, problem.contact @ per_force)
        fields = self.fields(problem.amplitudes, problem.lifts, per_force, free, problem.block_size,
                             stress_of=full.stress_of, functionals=full.functionals)  # fmt: skip
        known = prepared.snapshots.known_statuses()
        eliminated = ConstantElimination(responses, problem.amplitudes)
        model = CondensedModel(full.parameters, eliminated, known, fields, problem.contact_pairs)
        return model, {"modes": basis.shape[1]}

    def off(self, comparison):
        return max(comparison.primal.max(), comparison.dual.max()) / self.small
