"""The displacement of loads and contact forces, offline: what :class:`hhr_dolfinx.models.contact_response` needs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular, svd
from scipy.sparse import csc_matrix

from hhr_dolfinx.certify.bounds import ROUND_OFF, constant_response, unit_energy
from hhr_dolfinx.models.contact_response import FieldResponse, ResponseBound

if TYPE_CHECKING:
    from hhr_dolfinx.models.floating_bound import FloatingBound


class MadeOfForces(NamedTuple):
    """The map, its columns C, (N, c), and the bounds of what it makes."""

    response: FieldResponse
    columns: np.ndarray
    bound: ResponseBound | FloatingBound


def field_response(full: Any, forces: np.ndarray, most: int) -> MadeOfForces:
    """The displacement as loads and contact forces make it, with no more columns than a reduced model has modes.

    All columns of K^-1 B^T if that is enough for them; else the leading directions, in energy, of what the forces of
    training press in, each with the same weight, so that grazing contact counts as much as strong contact, and then of
    what any forces do.

    Args:
        full: a full model on one rank whose stiffness is constant.
        forces: of training, (m, S).
        most: columns at most.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    arrays = constant_response(full, forces)
    lower, per_force = arrays["lower"], full.per_force
    columns, own, onto = per_force, np.zeros((len(lower), 0)), None
    if len(lower) > most:
        own = leading(lower.T @ forces, lower, most)
        columns = per_force @ solve_triangular(lower, own, lower=True, trans="T")
        onto = np.asfortranarray(own.T @ lower.T)
    response = FieldResponse(*load_response(full), onto)
    nothing = np.zeros((len(per_force), 0))
    others = unit_energy(full.problem, per_force, lower, nothing, full.per_load) | {"basis": np.asfortranarray(own)}
    return MadeOfForces(response, np.asfortranarray(columns), ResponseBound(**arrays, **others))


def load_response(full: Any) -> tuple[np.ndarray, csc_matrix]:
    """K^-1 loads, (N, 1 + T), as a product of few columns, (N, k), and a sparse matrix, (k, 1 + T).

    The columns belong to the terms that load something, or to the dofs that are loaded if there are fewer of these, as
    where a pressure reaches up to a height that is a parameter.
    """
    loads = csc_matrix(full.problem.loads)
    terms, dofs = np.flatnonzero(np.diff(loads.indptr)), np.unique(loads.indices)
    if dofs.size < terms.size:
        units = csc_matrix((np.ones(dofs.size), (dofs, np.arange(dofs.size))), shape=(loads.shape[0], dofs.size))
        return np.asfortranarray(full.solved_columns(units)), csc_matrix(loads[dofs])
    chosen = csc_matrix((np.ones(terms.size), (np.arange(terms.size), terms)), shape=(terms.size, loads.shape[1]))
    return np.asfortranarray(full.per_load[:, terms]), chosen


def leading(columns: np.ndarray, lower: np.ndarray, count: int) -> np.ndarray:
    """Orthonormal directions of what forces press in, most important ones first, (m, count).

    Args:
        columns: L^T times the forces of training, (m, S), each of which is divided by its length.
        lower: L; what is left over goes to the directions along which forces move bodies most.
        count: of directions, up to m.
    """
    sizes = np.linalg.norm(columns, axis=0)
    directions, values, _ = svd(columns[:, sizes > 0] / sizes[sizes > 0], full_matrices=False)
    own = directions[:, values > ROUND_OFF * values.max(initial=0.0)][:, :count]
    rest = lower.T - own @ (own.T @ lower.T)
    return np.hstack([own, svd(rest)[0][:, : count - own.shape[1]]])
