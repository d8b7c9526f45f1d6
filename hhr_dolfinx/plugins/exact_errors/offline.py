"""Arrays of differences from the exact answer, offline."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg
from scipy.linalg import solve_triangular, svd
from scipy.sparse import csc_matrix, csr_matrix, vstack

from hhr_dolfinx.certify.accuracy import FORCE_FLOOR, Solutions, least_sizes
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import BoundError
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.bound import Bounding
from hhr_dolfinx.models.full import FullModel, plain_outputs
from hhr_dolfinx.plugins.exact_errors.difference import ExactDifference, definite
from hhr_dolfinx.plugins.exact_errors.field_response import FieldResponse

if TYPE_CHECKING:
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.plugins.exact_errors.outputs import OutputDifference
    from hhr_dolfinx.reduction.build import Draft
    from hhr_dolfinx.timing import Announce


COLUMN_ROUND_OFF = 1e-13
"""Part of a column up to which it is round-off of the columns before it."""
STIFFNESS_SKEWNESS = 1e-10
"""Largest entry of K - K^T over the largest of K."""
MOST_READ = 50
"""Number of training answers whose outputs are read."""


def bounding(
    full: FullModel, basis: np.ndarray, forces: np.ndarray, *, cone: bool, announce: Announce
) -> Bounding:
    """Differences for a basis, see :func:`exact_difference`.

    Args:
        full: the full model.
        basis: columns of the displacement, (own, ell).
        forces: training forces, (N_lambda, S).
        cone: True if training forces complete forces and displacement; otherwise S does.
        announce: reports progress; not used.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    return (
        Bounding(exact_difference(full, basis, forces), basis)
        if cone
        else field_response(full, forces, basis.shape[1])
    )


def read_outputs(draft: Draft) -> None:
    """Stage: errors of outputs."""
    shared = draft.shared
    if isinstance(draft.fields.bound, ExactDifference):
        with shared.log.stage("bound", shared.task.announce):
            read = output_difference(shared.full, shared.snapshots)
            draft.fields = replace(draft.fields, output_bound=read)


def exact_difference(
    full: FullModel, basis: np.ndarray, forces: np.ndarray | None = None
) -> ExactDifference:
    """Exact differences for answers of a full model whose bodies are held.

    Args:
        full: the full model.
        basis: columns of the displacement, (own rows, ell).
        forces: training forces, (N_lambda, S); relative errors use at least a thousandth of the
            largest one as the denominator.

    Raises:
        BoundError: see :func:`exact_arrays`.
    """
    lower, arrays = exact_arrays(full, forces)
    modes, loads = unit_energy(full, lower, basis)
    return ExactDifference(**arrays, modes=modes, loads=loads)


def exact_arrays(
    full: FullModel, forces: np.ndarray | None, *, floating: bool = False
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Cholesky factor of S, and arrays of the exact answer, see :class:`ExactDifference`.

    Args:
        full: the full model.
        forces: training forces, (N_lambda, S), see :func:`exact_difference`; None without any.
        floating: allow bodies that only contact holds.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    problem = full.problem
    check_hypotheses(full, floating=floating)
    if problem.varies:
        raise BoundError(
            "the stiffness depends on parameters, and so does the S of the exact answer"
        )
    schur = (full.schur + full.schur.T) / 2
    terms = full.per_load.shape[1]
    kernel = problem.kernel
    contact_of_motions = (
        np.zeros((len(schur), 0))
        if kernel is None
        else np.ascontiguousarray(kernel.contact_of_motions)
    )
    least = least_sizes(problem, schur, forces)
    if forces is not None:  # energies are those of the self-balancing part of forces
        along = np.linalg.qr(contact_of_motions)[0]
        least[0] = least_sizes(problem, schur, forces - along @ (along.T @ forces))[0]
    rows = problem.spread
    # K times lifts, whose energy K without dependent dofs lacks
    pulled = problem.pulled.toarray()
    gram, mixed, lift_gram = rows.sum(
        np.stack(
            [
                full.per_load.T @ (problem.stiffness_of_rows @ full.per_load),
                full.per_load.T @ rows.of(pulled),
                rows.of(problem.lifts.tocsr()).T @ rows.of(pulled),
            ]
        )
    )
    gram = gram + mixed + mixed.T + lift_gram
    lifting = np.sqrt(np.maximum(np.diag(lift_gram), 0.0))
    values, ways = linalg.eigh(gram)
    # K^-1 K u0 is K^-1 loads, plus the part of lifts on imposed dofs that K^-1 does not contain
    cross = problem.contact_rows_times(full.per_load)
    lifted = np.flatnonzero(np.diff(problem.lifts.tocsc().indptr))
    cross[:, lifted] += problem.contact_rows_times(
        full.stiffness.columns(csc_matrix(rows.of(pulled[:, lifted])))
    )
    return factor_of(definite(schur, contact_of_motions)), {
        "free_slack": np.asfortranarray(problem.gaps - problem.contact_rows_times(full.per_load)),
        "schur": schur,
        "taken": contact_of_motions,
        "driving": np.zeros((0, terms)) if kernel is None else np.asfortranarray(kernel.loads),
        "given": np.asfortranarray(np.sqrt(np.maximum(values, 0.0))[:, None] * ways.T),
        "cross": np.asfortranarray(cross),
        "lifting": lifting,
        "areas": problem.contact_areas,
        "least": least,
    }


def factor_of(schur: np.ndarray) -> np.ndarray:
    """Cholesky factor of S.

    Raises:
        BoundError: if S is not definite.
    """
    try:
        return linalg.cholesky(schur, lower=True)
    except linalg.LinAlgError:
        raise BoundError(
            "rows of B are dependent, so that forces are not unique: no error of them is known"
        ) from None


def singular_along(problem: ContactProblem) -> str:
    """Reason why nothing bounds errors where K is singular along motions of bodies."""
    assert problem.kernel is not None
    cause = (
        "contact alone holds bodies"
        if problem.held_by_contact
        else "nothing resists some motions of bodies"
    )
    return (
        f"{cause}, and K, whose inverse is in all errors, is singular along their motions: "
        f"{problem.kernel.described}"
    )


def check_hypotheses(full: FullModel, *, floating: bool = False) -> None:
    """Refuse models without known errors.

    Args:
        full: the full model.
        floating: allow bodies that only contact holds.

    Raises:
        BoundError: with the hypothesis that fails.
    """
    problem = full.problem
    if full.equilibrium is not None:
        raise BoundError(
            "bodies have laws, and errors are of elastic ones: histories have signs of error"
        )
    if problem.kernel is not None and not floating:
        raise BoundError(singular_along(problem))
    signs = np.random.default_rng(0).choice(
        (-1.0, 1.0), size=(len(problem.free), 2)
    )  # random vectors: no copies of K
    rows = problem.spread
    turned = rows.sum(problem.own_stiffness.T @ rows.of(signs))
    _, skew = rows.largest(np.abs(problem.own_stiffness @ signs - rows.of(turned)).max(axis=1))
    entries = problem.own_stiffness.data
    _, size = rows.largest(np.array([entries.max(), -entries.min()]))
    if skew > STIFFNESS_SKEWNESS * size:
        raise BoundError(
            f"K is not symmetric, by {skew / size:.1e} of its entries: it has no energy"
        )


def unit_energy(
    full: FullModel, lower: np.ndarray, basis: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Columns of V and of K^-1 loads in directions of unit energy, see :class:`ExactDifference`.

    The first are X L^-T, with X = K^-1 B^T and X^T K X = S = L L^T. The components along them are
    L^-1 X^T K times a field, which is L^-1 B times a field that vanishes on imposed dofs. X itself
    is not needed.

    Args:
        full: the full model.
        lower: L, (m, m).
        basis: V, (own rows, ell).

    Returns:
        Components of V, (r, ell), and of K^-1 loads, (r, 1 + T).
    """
    problem = full.problem
    remainder = np.hstack([basis, full.per_load])
    sizes = energies(problem, remainder)
    along = np.zeros((len(lower), remainder.shape[1]))
    for _ in range(2):
        more = solve_triangular(lower, problem.contact_rows_times(remainder), lower=True)
        along += more
        remainder = remainder - full.stiffness.response_to_forces(
            solve_triangular(lower, more, lower=True, trans="T")
        )
    ell = basis.shape[1]
    coordinates = energy_coordinates(problem, remainder, COLUMN_ROUND_OFF * sizes)
    # directions are in the order of the columns that need them
    count = len(lower) + np.count_nonzero(coordinates[:, :ell].any(axis=1))
    components = np.vstack([along, coordinates])
    return np.asfortranarray(components[:count, :ell]), np.asfortranarray(components[:, ell:])


def energies(problem: ContactProblem, columns: np.ndarray) -> np.ndarray:
    """Energy norm of each column, (k,).

    Args:
        problem: the contact problem.
        columns: the columns, (own rows, k).
    """
    squares = np.einsum("nk,nk->k", columns, problem.stiffness_of_rows @ columns)
    return np.sqrt(np.maximum(problem.spread.sum(squares), 0.0))


def energy_coordinates(
    problem: ContactProblem, columns: np.ndarray, least: np.ndarray
) -> np.ndarray:
    """Columns in directions of unit energy, (r, k), by Gram and Schmidt, twice.

    Unlike a factor of the Gram matrix they are accurate to round-off of the columns even if these
    are dependent.

    Args:
        problem: the contact problem.
        columns: the columns, (own rows, k).
        least: energy norm up to which the remainder of each column is round-off, (k,).
    """
    total = problem.spread.sum
    directions, images = (np.empty(columns.shape, order="F") for _ in range(2))
    coordinates = np.zeros((columns.shape[1],) * 2, order="F")
    rank = 0
    for k, column in enumerate(columns.T):
        for _ in range(2):
            along = total(images[:, :rank].T @ column)
            coordinates[:rank, k] += along
            column = column - directions[:, :rank] @ along
        image = problem.stiffness_of_rows @ column
        length = float(np.sqrt(max(total(column @ image), 0.0)))
        if length > least[k]:
            directions[:, rank] = column / length
            images[:, rank] = image / length
            coordinates[rank, k] = length
            rank += 1
    return coordinates[:rank]


def field_response(full: FullModel, forces: np.ndarray, most: int) -> Bounding:
    """The displacement as a function of loads and contact forces, in few columns.

    All columns of K^-1 B^T if these are few enough. Otherwise the leading directions, in energy, of
    the response to training forces, each with the same weight, so that weak contact counts as much
    as strong contact, followed by those of the response to any forces. The rigid motions of bodies
    that only contact holds come last and do not count.

    Args:
        full: the full model, of constant stiffness.
        forces: training forces, (m, S).
        most: largest number of columns, that of the modes of the model.

    Raises:
        BoundError: see :func:`exact_arrays`.
    """
    lower, arrays = exact_arrays(full, forces, floating=True)
    columns, directions, onto = columns_of_forces(full, lower, forces, most)
    if full.problem.kernel is not None:
        columns = np.hstack([columns, full.problem.spread.of(full.problem.kernel.motions)])
    difference = ExactDifference(**arrays, kept=np.asfortranarray(directions))
    loaded, loading = load_response(full)
    response = FieldResponse(full.problem.spread.whole(loaded), loading, onto)
    return Bounding(difference, np.asfortranarray(columns), response)


def load_response(full: FullModel) -> tuple[np.ndarray, csc_matrix]:
    """K^-1 loads, (own, 1 + T), as a product of few columns and a sparse matrix.

    The columns are (own, k), the matrix is (k, 1 + T).

    The columns belong to the nonzero terms, or to the loaded dofs if there are fewer of these, as
    for a pressure up to a height that is a parameter.
    """
    loads = csc_matrix(full.problem.loads)
    terms = np.flatnonzero(np.diff(loads.indptr))
    dofs = np.unique(loads.indices)
    if dofs.size < terms.size:
        units = csr_matrix(
            (np.ones(dofs.size), (dofs, np.arange(dofs.size))), shape=(loads.shape[0], dofs.size)
        )
        unit_loads = csc_matrix(full.problem.spread.of(units))
        return np.asfortranarray(full.stiffness.columns(unit_loads)), csc_matrix(loads[dofs])
    chosen = csc_matrix(
        (np.ones(terms.size), (np.arange(terms.size), terms)), shape=(terms.size, loads.shape[1])
    )
    return np.asfortranarray(full.per_load[:, terms]), chosen


def columns_of_forces(
    full: FullModel, lower: np.ndarray, forces: np.ndarray, most: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Basis of the displacements of forces: all of K^-1 B^T, or combinations of it.

    Args:
        full: the full model.
        lower: L of S = L L^T, (m, m).
        forces: training forces, (m, S).
        most: largest number of columns.

    Returns:
        The columns, (own, c); their directions in energy, (m, c), c = 0 if all are kept; and the
        map from forces to their coordinates, (c, m), None if these are the forces.
    """
    if len(lower) <= most:
        return full.per_force, np.zeros((len(lower), 0)), None
    directions = leading(lower.T @ forces, lower, most)
    columns = full.stiffness.response_to_forces(
        solve_triangular(lower, directions, lower=True, trans="T")
    )
    return columns, directions, np.asfortranarray(directions.T @ lower.T)


def leading(columns: np.ndarray, lower: np.ndarray, count: int) -> np.ndarray:
    """Orthonormal directions of the response to forces, most important ones first, (m, count).

    The columns are normalised. The remaining directions are those along which forces have the
    largest response.

    Args:
        columns: L^T times the training forces, (m, S).
        lower: L, (m, m).
        count: number of directions, at most m.
    """
    sizes = np.linalg.norm(columns, axis=0)
    directions, values, _ = svd(columns[:, sizes > 0] / sizes[sizes > 0], full_matrices=False)
    selected = directions[:, values > COLUMN_ROUND_OFF * values.max(initial=0.0)][:, :count]
    remainder = lower.T - selected @ (selected.T @ lower.T)
    return np.hstack([selected, svd(remainder)[0][:, : count - selected.shape[1]]])


def output_difference(full: FullModel, training: Solutions | None = None) -> OutputDifference:
    """Outputs of the exact answers of a full model with outputs and constant stiffness.

    Args:
        full: the full model.
        training: snapshots, whose outputs set the scale; None without any.
    """
    from hhr_dolfinx.plugins.exact_errors.outputs import OutputDifference, is_read

    problem = full.problem
    size = problem.free.size
    outputs = plain_outputs(full)
    assert outputs is not None
    read = [
        functional.matrix(size)
        for functional in outputs.items
        if is_read(functional, len(problem.gaps))
    ]
    rows = csr_matrix(vstack([csr_matrix((0, size)), *read]))
    loaded = problem.spread.sum(rows.tocsc()[:, problem.rows] @ full.per_load)
    free = np.asfortranarray(loaded + (rows @ problem.lifts).toarray())
    return OutputDifference(
        free, np.asfortranarray(full.pressed(rows)), _least_outputs(full, training)
    )


def _least_outputs(full: FullModel, training: Solutions | None) -> np.ndarray:
    """A thousandth of the largest absolute value of each output in some training answers.

    Zero without any, (n,).
    """
    assert full.functionals is not None
    if training is None:
        return np.zeros(len(full.functionals.items))
    answers = []
    for k in np.unique(np.linspace(0, len(training.points) - 1, MOST_READ).astype(int)):
        forces = training.forces[:, k]
        answer_fields = forces, forces > 0, 0, Status.CONVERGED, False, full
        unknown = full.problem.spread.whole(training.displacements[:, k])
        answers.append(Answer(training.points[k], unknown, *answer_fields).outputs().values)
    sizes = np.abs([list(values.values()) for values in answers])
    return FORCE_FLOOR * np.nan_to_num(sizes).max(axis=0)
