"""Stage of the hyper-reduction: errors of bodies that contact alone holds, at new points."""

from __future__ import annotations

import math

from hhr_dolfinx.certify.compare import Comparison, Row
from hhr_dolfinx.certify.trust import check_comparison
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.reduction.build import Draft

ON_S = 200
"""Random points at which forces are compared with those of the contact problem on S, at half a
millisecond each.
"""


def check_on_s(draft: Draft) -> None:
    """Check a model whose bounds solve the contact problem on S anyway at random new points.

    Raises:
        UnstableModelError: for errors beyond the limits of the recipe.
    """
    limits = draft.shared.recipe.trust
    if limits is not None and draft.model.fields.bound is not None:
        check_comparison(compare_on_s(draft.model), limits)


def compare_on_s(model: AnsweringModel) -> Comparison:
    """Errors at these points.

    A few points in hundreds have large errors, where a body tilts or a contact has just closed;
    validation points may miss all of them.
    """
    points = model.parameters.random(ON_S, seed=ON_S)
    many = model.solve_many(points, outside="ignore", raise_on_failure=False)
    estimates = many.estimates()
    rows = list[Row]()
    for k, (point, answered) in enumerate(zip(points, many.converged, strict=True)):
        errors = (math.inf, math.inf)
        if answered and estimates is not None:
            errors = float(estimates.primal_relative[k]), float(estimates.forces_euclid_relative[k])
        rows.append((model.parameters.described(point), *errors))
    return Comparison.of(rows)
