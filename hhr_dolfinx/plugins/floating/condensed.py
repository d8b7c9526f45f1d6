"""The contact problem without its primal unknown, for bodies whose rigid motions stay unknowns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs, Status
from hhr_dolfinx.models.answer import Answer, ModelFields, found_as
from hhr_dolfinx.models.gradient import Gradient, grazing
from hhr_dolfinx.plugins.floating.statuses import FloatingEqualities, floating_set, open_motions

if TYPE_CHECKING:
    from hhr_dolfinx.models.eliminations.elimination import CondensedContact


@dataclass(eq=False)  # one for each query, as CondensedContact
class Floating:
    """Rigid motions of bodies that contact alone holds: a :class:`~hhr_dolfinx.contact.kernel.CondensedKernel`."""

    equalities: FloatingEqualities
    driving: np.ndarray
    modes: np.ndarray
    drift: Callable[[np.ndarray, np.ndarray], np.ndarray]

    def answer(
        self, contact: CondensedContact, point: np.ndarray, start: np.ndarray, pairs: Pairs | None, fields: ModelFields,
        gradient: bool,
    ) -> Answer:  # fmt: skip
        """See :class:`~hhr_dolfinx.contact.kernel.CondensedKernel`."""
        equalities = self.equalities
        free_slack = contact.free_slack
        found, motions = floating_set(equalities, free_slack, self.driving, start, pairs)
        unknown = contact.unknown(found.forces) + self.modes @ motions
        if found.status is not Status.CONVERGED:
            return found_as(found, point, unknown, fields)
        slack = free_slack + contact.schur @ found.forces - equalities.contact_of_motions @ motions
        left = open_motions(equalities, found.forces, free_slack, slack, self.modes.T @ unknown)
        if left is None:
            answer = found_as(found, point, unknown, fields)
        else:
            unknown = unknown + self.modes @ left.shift
            slack = slack - equalities.contact_of_motions @ left.shift
            found = found._replace(active=found.active & ~left.opened)
            answer = found_as(found, point, unknown, fields)._replace(undetermined=self.modes @ left.ways)
        if not gradient:
            return answer
        of_slack, of_unknown = contact.at_fixed_forces(found.forces, unknown)
        driven = self.drift(found.forces, unknown)
        changes, opened, of_motions = equalities.several(found.active, of_slack, driven)
        of_unknown = of_unknown - contact.pushed(changes) + self.modes @ of_motions
        return answer._replace(
            gradient=Gradient(of_unknown, changes, grazing(found.active, found.forces, slack), opened)
        )
