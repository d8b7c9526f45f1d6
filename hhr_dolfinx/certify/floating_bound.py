"""Bounds for bodies that contact alone holds, offline: what :mod:`hhr_dolfinx.models.bounds.floating_bound` needs."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import linalg

from hhr_dolfinx.certify.accuracy import least_sizes
from hhr_dolfinx.certify.bounds import MadeOfForces, check_hypotheses, columns_of_forces, load_response
from hhr_dolfinx.errors import BoundError
from hhr_dolfinx.models.bounds.floating_bound import FloatingBound, FloatingResponse, definite


def floating_bound(full: Any, forces: np.ndarray, most: int) -> MadeOfForces:
    """The displacement as loads, contact forces and motions make it, and its bounds, see :func:`field_response`.

    Args:
        full: a full model of constant stiffness, some of whose bodies nothing but contact holds.
        forces: of training, (m, S).
        most: columns at most, those of the motions besides.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    check_hypotheses(full, floating=True)
    problem = full.problem
    taken = full.system.kernel.taken
    if problem.varies:
        raise BoundError("contact alone holds bodies, and their stiffness depends on parameters")
    schur = (full.schur + full.schur.T) / 2
    try:
        lower = linalg.cholesky(definite(schur, taken), lower=True)
    except linalg.LinAlgError:
        raise BoundError("rows of B are dependent, so that forces are not unique: there is no bound on them") from None
    columns, own, onto = columns_of_forces(full, lower, forces, most)
    # energies are those of the part of forces that balances itself, see FloatingBound.pressed
    along = np.linalg.qr(taken)[0]
    least = least_sizes(problem, schur, forces)
    least[0] = least_sizes(problem, schur, forces - along @ (along.T @ forces))[0]
    rows = problem.spread
    given = full.per_load + rows.of(problem.lifts.tocsr()).toarray()
    pulled = problem.stiffness_of_rows @ given
    bound = FloatingBound(
        free_slack=np.asfortranarray(problem.gaps - problem.moved(full.per_load)),
        schur=schur,
        lower=np.asfortranarray(lower),
        taken=np.ascontiguousarray(taken),
        driving=np.asfortranarray(full.system.kernel.loads),
        basis=np.asfortranarray(own),
        work=np.asfortranarray(rows.sum(given.T @ pulled)),
        cross=np.asfortranarray(rows.sum(pulled.T @ full.per_force)),
        areas=problem.contact_areas,
        least=least,
    )
    response = FloatingResponse(*load_response(full), onto)
    return MadeOfForces(response, np.asfortranarray(np.hstack([columns, rows.of(problem.rigid)])), bound)
