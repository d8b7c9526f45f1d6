"""Recipe of the hyper-reduction with friction, and a stage that refuses dependent rows."""

from __future__ import annotations

from hhr_dolfinx.contact.problem import DEPENDENT_ROWS
from hhr_dolfinx.errors import NotSolvableError
from hhr_dolfinx.plugins.contact_laws.reduction import of_paths
from hhr_dolfinx.reduction.build import Draft

with_friction = of_paths


def check_forces(draft: Draft) -> None:
    """Raise NotSolvableError for a singular S of the RID: forces of sticking contacts are then
    undetermined.

    Without friction this may be correct for a body that only contact holds; with friction a second
    solution was found, 10 % off.
    """
    if abs(draft.stability.contact_definite) < DEPENDENT_ROWS:
        raise NotSolvableError(
            "the contact rows are dependent on the modes without rigid motions, so that friction "
            "has several answers: enrich the basis further, enrichment=Enrich(2.0), as the usual "
            "recipe does where its first enrichment is too small, or take a condensed model"
        )
