"""A distributed full model with all rows on each rank: the tool ``all_rows``."""

from __future__ import annotations

from copy import copy

from hhr_dolfinx.contact.stiffness import FactorStore
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.full_order.system import system_of
from hhr_dolfinx.linear.sparse import FreeCholesky


def gathered(full: FullOrderModel) -> FullOrderModel:
    """The model with all rows, whose factors all ranks share. Collective."""
    model = copy(full)
    vars(model).pop("per_load", None)  # that of local rows
    model.problem = problem = full.problem.gathered(full.comm)
    local_stiffness = full.problem.own_stiffness  # raises an error if reductors cannot read it
    stiffness = problem.own_stiffness
    with full.store.of(local_stiffness) as factors:
        assert isinstance(factors, FreeCholesky)
        shared = full.group.shared_factors(factors, full.problem.rows, local_stiffness, stiffness)
    model.store = FactorStore(lambda _: shared)
    with model.store.of(stiffness):
        # a user-defined system is that of its parts, which were compared
        model.system = system_of(problem, lambda: model.stiffness, model._stiffness_of)
    response = full.spread.whole(full.stiffness.response) if full.stiffness.has_response else None
    model.stiffness = model._middle(response=response, schur=vars(full).get("schur"))
    return model
