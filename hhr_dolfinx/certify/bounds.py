"""Bounds of errors, offline: what :class:`~hhr_dolfinx.models.bounds.error_bound.ErrorBound` needs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import linalg
from scipy.linalg import solve_triangular, svd
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.certify.accuracy import least_sizes
from hhr_dolfinx.errors import BoundError
from hhr_dolfinx.models.bounds.error_bound import ErrorBound, FieldResponse, ResponseBound

if TYPE_CHECKING:
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.models.bounds.floating_bound import FloatingBound


ROUND_OFF = 1e-13
"""Part of a column that is round-off of those before it."""
PANEL = 32
"""Columns that are made orthogonal to all before them at once."""
SYMMETRIC = 1e-10
"""Largest entry of K - K^T over the largest of K."""


def error_bound(full: Any, basis: np.ndarray, forces: np.ndarray | None = None) -> ErrorBound:
    """Bounds for answers with a basis, (own rows, ell), of a full model whose stiffness is constant.

    Of forces of training, (N_lambda, S), a thousandth is what relative errors are taken over at least.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    arrays = constant_response(full, forces)
    return ErrorBound(**arrays, **unit_energy(full, arrays["lower"], basis))


def constant_response(full: Any, forces: np.ndarray | None) -> dict[str, np.ndarray]:
    """Arrays that bounds of any map of the displacement share, see :class:`ErrorBound`; ``forces`` as there.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    problem = full.problem
    check_hypotheses(full)
    if problem.varies:
        raise BoundError("the stiffness depends on parameters, and these bounds are those of a constant one")
    schur = (full.schur + full.schur.T) / 2
    try:
        lower = linalg.cholesky(schur, lower=True)
    except linalg.LinAlgError:
        raise BoundError("rows of B are dependent, so that forces are not unique: there is no bound on them") from None
    free_slack = np.asfortranarray(problem.gaps - problem.moved(full.per_load))
    sizes = {"areas": problem.contact_areas, "least": least_sizes(problem, schur, forces)}
    return {"free_slack": free_slack, "schur": schur, "lower": np.asfortranarray(lower), **sizes}


def check_hypotheses(full: Any, *, floating: bool = False) -> None:
    """Refuse what the bounds are not proved for, or those of bodies that contact holds where these are ``floating``.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    problem = full.problem
    if full.equilibrium is not None:
        raise BoundError("bodies flow, and the bounds are those of elastic ones: histories have signs of error")
    if problem.pins is not None and not floating:
        raise BoundError(
            "contact alone holds bodies, and K, whose inverse is in the bounds, is singular along their motions: "
            + problem.loose
        )
    signs = np.random.default_rng(0).choice((-1.0, 1.0), size=(len(problem.free), 2))  # no copies of K
    rows = problem.spread
    turned = rows.sum(problem.own_stiffness.T @ rows.of(signs))
    _, skew = rows.largest(np.abs(problem.own_stiffness @ signs - rows.of(turned)).max(axis=1))
    entries = problem.own_stiffness.data
    _, size = rows.largest(np.array([entries.max(), -entries.min()]))
    if skew > SYMMETRIC * size:
        raise BoundError(f"K is not symmetric, by {skew / size:.1e} of its entries: it has no energy")


def unit_energy(full: Any, lower: np.ndarray, basis: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of V, (own rows, ell), of K^-1 loads and of the lifts in directions of unit energy: :class:`ErrorBound`.

    The first are X L^-T, where X = K^-1 B^T and X^T K X = S = L L^T. What lies along them is L^-1 X^T K times a field,
    which is L^-1 B times one that vanishes where motions are imposed. X itself is not asked for.
    """
    problem = full.problem
    loads = full.per_load
    lifted = np.flatnonzero(np.asarray(abs(problem.lifts).sum(axis=0)).ravel())
    stiffness = problem.stiffness_of_rows
    every = [basis, loads, problem.spread.of(problem.lifts.tocsr()[:, lifted]).toarray()]
    along = []
    left = []
    for columns, moves in zip(every, (False, False, True), strict=True):
        own = np.zeros((len(lower), columns.shape[1]))
        rest = columns
        for _ in range(2 if columns.shape[1] else 0):
            freed = full.stiffness.columns(csc_matrix(stiffness @ rest)) if moves else rest
            more = solve_triangular(lower, problem.moved(freed), lower=True)
            own += more
            rest = rest - full.stiffness.response_to_forces(solve_triangular(lower, more, lower=True, trans="T"))
        along.append(own)
        left.append(rest)
    sizes = energies(problem, np.hstack(every))
    rest = energy_directions(problem, np.hstack(left), ROUND_OFF * sizes)[1]
    ends = np.cumsum([columns.shape[1] for columns in every])
    found = [np.vstack([own, part]) for own, part in zip(along, np.split(rest, ends[:-1], axis=1), strict=True)]
    # directions come in the order of the columns that need them
    ranks = [len(lower) + np.count_nonzero(rest[:, :end].any(axis=1)) for end in ends]
    moved = np.zeros((ranks[2] if lifted.size else 0, loads.shape[1]))
    moved[:, lifted] = found[2][: len(moved)]
    arrays = {"basis": found[0][: ranks[0]], "loads": found[1][: ranks[1]], "lifts": moved}
    return {name: np.asfortranarray(array) for name, array in arrays.items()}


def energies(problem: ContactProblem, columns: np.ndarray) -> np.ndarray:
    """Energy norm of each column, (own rows, k): (k,)."""
    squares = np.einsum("nk,nk->k", columns, problem.stiffness_of_rows @ columns)
    return np.sqrt(np.maximum(problem.spread.sum(squares), 0.0))


def energy_directions(problem: ContactProblem, columns: np.ndarray, least: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions of unit energy, (own rows, r), and columns in them, (r, k), by Gram and Schmidt, twice.

    Unlike a factor of the Gram matrix it is right to round-off of the columns where these are dependent.

    Args:
        problem: whose K it is.
        columns: own rows of them, (own, k).
        least: energy norm up to which what is left of each column is round-off, (k,).
    """
    stiffness = problem.stiffness_of_rows
    total = problem.spread.sum
    directions, pushed = (np.empty(columns.shape, order="F") for _ in range(2))
    coordinates = np.zeros((columns.shape[1],) * 2, order="F")
    rank = 0
    for first in range(0, columns.shape[1], PANEL):
        # once against all directions before the panel, by products of matrices
        block = slice(first, first + PANEL)
        along = total(pushed[:, :rank].T @ columns[:, block])
        coordinates[:rank, block] = along
        panel = columns[:, block] - directions[:, :rank] @ along
        before = rank
        for k, left in enumerate(panel.T, start=first):
            for start in (before, 0):
                along = total(pushed[:, start:rank].T @ left)
                coordinates[start:rank, k] += along
                left = left - directions[:, start:rank] @ along
            push = stiffness @ left
            length = float(np.sqrt(max(total(left @ push), 0.0)))
            if length > least[k]:
                directions[:, rank] = left / length
                pushed[:, rank] = push / length
                coordinates[rank, k] = length
                rank += 1
    return directions[:, :rank], coordinates[:rank]


class MadeOfForces(NamedTuple):
    """The map, its columns C, (own, c), and the bounds of what it makes; own rows of columns in the map too."""

    response: FieldResponse
    columns: np.ndarray
    bound: ResponseBound | FloatingBound


def field_response(full: Any, forces: np.ndarray, most: int) -> MadeOfForces:
    """The displacement as loads and contact forces make it, with no more columns than a reduced model has modes.

    All columns of K^-1 B^T if that is enough for them; else the leading directions, in energy, of what the forces of
    training press in, each with the same weight, so that grazing contact counts as much as strong contact, and then of
    what any forces do.

    Args:
        full: a full model whose stiffness is constant.
        forces: of training, (m, S).
        most: columns at most.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    arrays = constant_response(full, forces)
    lower = arrays["lower"]
    columns, own, onto = columns_of_forces(full, lower, forces, most)
    response = FieldResponse(*load_response(full), onto)
    nothing = full.per_load[:, :0]
    others = unit_energy(full, lower, nothing) | {"basis": np.asfortranarray(own)}
    return MadeOfForces(response, np.asfortranarray(columns), ResponseBound(**arrays, **others))


def load_response(full: Any) -> tuple[np.ndarray, csc_matrix]:
    """K^-1 loads, (own, 1 + T), as a product of few columns, (own, k), and a sparse matrix, (k, 1 + T).

    The columns belong to the terms that load something, or to the dofs that are loaded if there are fewer of these, as
    where a pressure reaches up to a height that is a parameter.
    """
    loads = csc_matrix(full.problem.loads)
    terms = np.flatnonzero(np.diff(loads.indptr))
    dofs = np.unique(loads.indices)
    if dofs.size < terms.size:
        units = csr_matrix((np.ones(dofs.size), (dofs, np.arange(dofs.size))), shape=(loads.shape[0], dofs.size))
        own = csc_matrix(full.problem.spread.of(units))
        return np.asfortranarray(full.stiffness.columns(own)), csc_matrix(loads[dofs])
    chosen = csc_matrix((np.ones(terms.size), (np.arange(terms.size), terms)), shape=(terms.size, loads.shape[1]))
    return np.asfortranarray(full.per_load[:, terms]), chosen


def columns_of_forces(
    full: Any, lower: np.ndarray, forces: np.ndarray, most: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """What spans the displacements of forces: all of K^-1 B^T, or combinations of it where these are too many.

    Args:
        full: the full model, which pushes with K^-1 B^T.
        lower: L of S = L L^T, (m, m).
        forces: of training, (m, S).
        most: columns at most.

    Returns:
        The columns, (own, c); the directions in energy that they are of, (m, c), c = 0 where all are kept; and what
        maps forces to their coordinates, (c, m), None where these are the forces.
    """
    if len(lower) <= most:
        return full.per_force, np.zeros((len(lower), 0)), None
    own = leading(lower.T @ forces, lower, most)
    columns = full.stiffness.response_to_forces(solve_triangular(lower, own, lower=True, trans="T"))
    return columns, own, np.asfortranarray(own.T @ lower.T)


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
