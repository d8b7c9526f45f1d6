"""Differences to the exact answer, offline: what :mod:`hhr_dolfinx.models.bounds.difference` needs."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import linalg
from scipy.linalg import solve_triangular, svd
from scipy.sparse import csc_matrix, csr_matrix, vstack

from hhr_dolfinx.certify.accuracy import FORCE_FLOOR, least_sizes
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import BoundError
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.bounds.difference import ExactDifference, definite
from hhr_dolfinx.models.field_response import FieldResponse
from hhr_dolfinx.models.full import FullModel, plain_outputs

if TYPE_CHECKING:
    from hhr_dolfinx.certify.accuracy import Solutions
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.models.bounds.output_difference import OutputDifference


ROUND_OFF = 1e-13
"""Part of a column that is round-off of those before it."""
SYMMETRIC = 1e-10
"""Largest entry of K - K^T over the largest of K."""
MOST_READ = 50
"""Training answers of which outputs are read."""


def exact_difference(full: FullModel, basis: np.ndarray, forces: np.ndarray | None = None) -> ExactDifference:
    """Differences of answers with a basis, (own rows, ell), of a full model whose bodies are held.

    Of forces of training, (N_lambda, S), a thousandth is what relative errors are taken over at least.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    check_hypotheses(full)
    lower, arrays = exact_arrays(full, forces)
    modes, loads = unit_energy(full, lower, basis)
    return ExactDifference(**arrays, modes=modes, loads=loads)


def exact_arrays(full: FullModel, forces: np.ndarray | None) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Cholesky factor of S, and arrays of the exact answer, see :class:`ExactDifference`; ``forces`` as there.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    problem = full.problem
    check_hypotheses(full, floating=True)
    if problem.varies:
        raise BoundError("the stiffness depends on parameters, and the exact answer takes an S of its own")
    schur = (full.schur + full.schur.T) / 2
    terms = full.per_load.shape[1]
    kernel = full.system.kernel
    taken = np.zeros((len(schur), 0)) if kernel is None else np.ascontiguousarray(kernel.taken)
    least = least_sizes(problem, schur, forces)
    if forces is not None:  # energies are those of the part of forces that balances itself
        along = np.linalg.qr(taken)[0]
        least[0] = least_sizes(problem, schur, forces - along @ (along.T @ forces))[0]
    rows = problem.spread
    lifts = rows.of(problem.lifts.tocsr()).toarray()
    given = full.per_load + lifts
    values, ways = linalg.eigh(rows.sum(given.T @ (problem.stiffness_of_rows @ given)))
    # K^-1 K u0 is K^-1 loads, and of lifts what K does not know of their imposed dofs
    cross = problem.moved(full.per_load)
    lifted = np.flatnonzero(rows.sum(np.abs(lifts).sum(axis=0)))
    cross[:, lifted] += problem.moved(full.stiffness.columns(csc_matrix(problem.stiffness_of_rows @ lifts[:, lifted])))
    return factor_of(definite(schur, taken)), {
        "free_slack": np.asfortranarray(problem.gaps - problem.moved(full.per_load)),
        "schur": schur,
        "taken": taken,
        "driving": np.zeros((0, terms)) if kernel is None else np.asfortranarray(kernel.loads),
        "given": np.asfortranarray(np.sqrt(np.maximum(values, 0.0))[:, None] * ways.T),
        "cross": np.asfortranarray(cross),
        "lifting": energies(problem, lifts),
        "areas": problem.contact_areas,
        "least": least,
    }


def factor_of(schur: np.ndarray) -> np.ndarray:
    """Cholesky factor of S.

    Raises:
        BoundError: if it is not definite.
    """
    try:
        return linalg.cholesky(schur, lower=True)
    except linalg.LinAlgError:
        raise BoundError("rows of B are dependent, so that forces are not unique: no error of them is known") from None


def check_hypotheses(full: FullModel, *, floating: bool = False) -> None:
    """Refuse what no error is known of, or bodies that contact alone holds unless these are ``floating``.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    problem = full.problem
    if full.equilibrium is not None:
        raise BoundError("bodies flow, and errors are those of elastic ones: histories have signs of error")
    if problem.pins is not None and not floating:
        raise BoundError(
            "contact alone holds bodies, and K, whose inverse is in all errors, is singular along their motions: "
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


def unit_energy(full: FullModel, lower: np.ndarray, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns of V, (own rows, ell), and of K^-1 loads in directions of unit energy, see :class:`ExactDifference`.

    The first are X L^-T, where X = K^-1 B^T and X^T K X = S = L L^T. What lies along them is L^-1 X^T K times a field,
    which is L^-1 B times one that vanishes where motions are imposed. X itself is not asked for.
    """
    problem = full.problem
    rest = np.hstack([basis, full.per_load])
    sizes = energies(problem, rest)
    along = np.zeros((len(lower), rest.shape[1]))
    for _ in range(2):
        more = solve_triangular(lower, problem.moved(rest), lower=True)
        along += more
        rest = rest - full.stiffness.response_to_forces(solve_triangular(lower, more, lower=True, trans="T"))
    ell = basis.shape[1]
    left = energy_coordinates(problem, rest, ROUND_OFF * sizes)
    # directions come in the order of the columns that need them
    count = len(lower) + np.count_nonzero(left[:, :ell].any(axis=1))
    found = np.vstack([along, left])
    return np.asfortranarray(found[:count, :ell]), np.asfortranarray(found[:, ell:])


def energies(problem: ContactProblem, columns: np.ndarray) -> np.ndarray:
    """Energy norm of each column, (own rows, k): (k,)."""
    squares = np.einsum("nk,nk->k", columns, problem.stiffness_of_rows @ columns)
    return np.sqrt(np.maximum(problem.spread.sum(squares), 0.0))


def energy_coordinates(problem: ContactProblem, columns: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Columns, (own rows, k), in directions of unit energy, (r, k), by Gram and Schmidt, twice.

    Unlike a factor of the Gram matrix they are right to round-off of the columns where these are dependent. ``least``
    is the energy norm up to which what is left of each column is round-off, (k,).
    """
    total = problem.spread.sum
    directions, pushed = (np.empty(columns.shape, order="F") for _ in range(2))
    coordinates = np.zeros((columns.shape[1],) * 2, order="F")
    rank = 0
    for k, left in enumerate(columns.T):
        for _ in range(2):
            along = total(pushed[:, :rank].T @ left)
            coordinates[:rank, k] += along
            left = left - directions[:, :rank] @ along
        push = problem.stiffness_of_rows @ left
        length = float(np.sqrt(max(total(left @ push), 0.0)))
        if length > least[k]:
            directions[:, rank] = left / length
            pushed[:, rank] = push / length
            coordinates[rank, k] = length
            rank += 1
    return coordinates[:rank]


class MadeOfForces(NamedTuple):
    """The map, its columns C, (own, c), and the errors of what it makes; own rows of columns in the map too."""

    response: FieldResponse
    columns: np.ndarray
    bound: ExactDifference


def field_response(full: FullModel, forces: np.ndarray, most: int) -> MadeOfForces:
    """The displacement as loads and contact forces make it, with no more columns than a reduced model has modes.

    All columns of K^-1 B^T if that is enough for them; else the leading directions, in energy, of what the forces of
    training press in, each with the same weight, so that grazing contact counts as much as strong contact, and then of
    what any forces do. Behind them are the rigid motions of bodies that contact alone holds.

    Args:
        full: a full model whose stiffness is constant.
        forces: of training, (m, S).
        most: columns at most, those of the motions besides.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    lower, arrays = exact_arrays(full, forces)
    columns, own, onto = columns_of_forces(full, lower, forces, most)
    if full.problem.rigid is not None:
        columns = np.hstack([columns, full.problem.spread.of(full.problem.rigid)])
    difference = ExactDifference(**arrays, kept=np.asfortranarray(own))
    return MadeOfForces(FieldResponse(*load_response(full), onto), np.asfortranarray(columns), difference)


def load_response(full: FullModel) -> tuple[np.ndarray, csc_matrix]:
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
    full: FullModel, lower: np.ndarray, forces: np.ndarray, most: int
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


def output_difference(full: FullModel, training: Solutions | None = None) -> OutputDifference:
    """Outputs of the exact answers of a full model that has outputs, whose stiffness is constant.

    ``training`` are snapshots, whose outputs say what is large.
    """
    from hhr_dolfinx.models.bounds.output_difference import OutputDifference, is_read

    problem = full.problem
    size = problem.free.size
    outputs = plain_outputs(full)
    assert outputs is not None
    read = [item.matrix(size) for item in outputs.items if is_read(item, len(problem.gaps))]
    rows = csr_matrix(vstack([csr_matrix((0, size)), *read]))
    loaded = problem.spread.sum(rows.tocsc()[:, problem.rows] @ full.per_load)
    free = np.asfortranarray(loaded + (rows @ problem.lifts).toarray())
    return OutputDifference(free, np.asfortranarray(full.pressed(rows)), _least_outputs(full, training))


def _least_outputs(full: FullModel, training: Solutions | None) -> np.ndarray:
    """A thousandth of the largest absolute value of each output in some training answers; zero without any, (n,)."""
    assert full.functionals is not None
    if training is None:
        return np.zeros(len(full.functionals.items))
    answers = []
    for k in np.unique(np.linspace(0, len(training.points) - 1, MOST_READ).astype(int)):
        forces = training.forces[:, k]
        how = forces, forces > 0, 0, Status.CONVERGED, False, full
        unknown = full.problem.spread.whole(training.displacements[:, k])
        answers.append(Answer(training.points[k], unknown, *how).outputs().values)
    return FORCE_FLOOR * np.abs([list(values.values()) for values in answers]).max(axis=0)
