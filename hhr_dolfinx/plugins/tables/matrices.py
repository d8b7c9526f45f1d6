"""Condensation of contact problems of other programs from their matrices, without DOLFINx, PETSc or
a mesh.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import linalg
from scipy.sparse import csc_matrix, issparse
from scipy.sparse.linalg import SuperLU, splu

from hhr_dolfinx.amplitudes import Amplitude, Amplitudes, bound
from hhr_dolfinx.errors import NotSolvableError, SceneError
from hhr_dolfinx.formulas import Formula, Scalar, check_over_box
from hhr_dolfinx.linear.dense import LapackLU
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.eliminations.constant import ConstantElimination
from hhr_dolfinx.models.eliminations.elimination import Responses
from hhr_dolfinx.models.exact import ExactFields
from hhr_dolfinx.models.functionals.functional import Functional, Functionals
from hhr_dolfinx.models.functionals.kinds import Largest, Linear
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.parameters import ParameterSpace, as_tuple, is_number

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from scipy.sparse import spmatrix

STATUS_POINTS = 64
"""Points at which initial statuses are computed."""
PIVOT = 1e-14
"""Largest ratio of a pivot to its diagonal entry in a matrix that is singular to round-off."""
SYMMETRIC_STIFFNESS = 1e-10
"""Largest difference of a stiffness from its transpose over its largest entry: ten digits, as files
have them.
"""


def condense_matrices(
    parameters: ParameterSpace,
    stiffness: ArrayLike | spmatrix,
    contact: ArrayLike | spmatrix,
    loads: ArrayLike | spmatrix,
    gaps: ArrayLike | spmatrix,
    amplitudes: Sequence[str | float | Amplitude],
    *,
    areas: ArrayLike | None = None,
    pairs: ArrayLike | None = None,
    displacement_outputs: Mapping[str, ArrayLike] | None = None,
    force_outputs: Mapping[str, ArrayLike] | None = None,
) -> CondensedModel:
    """Condense a contact problem from its matrices, thesis (1.21).

        K u + B^T λ = F(μ),  B u <= g(μ),  λ >= 0,  λ·(B u - g) = 0.

    K is constant and without imposed dofs; loads and gaps are sums of columns times amplitudes,

        F(μ) = sum_t a_t(μ) F_t,    g(μ) = sum_t a_t(μ) g_t.

    The model has the interfaces of one of ``hhr.condense``: exact answers, tables, files, C, and
    other programs.

    Args:
        parameters: box of the parameters.
        stiffness: K, (N, N), symmetric and positive definite; sparse, or convertible by SciPy.
        contact: B, (m, N), one row for each condition, pointing from the first body to the second.
        loads: F_t, (N, T).
        gaps: g_t, (m, T).
        amplitudes: a_t, (T,): formulas of the parameters as texts, numbers, or amplitudes.
        areas: areas of the conditions, (m,), for the largest pressure as an output, ``peak``.
        pairs: number of the contact pair of each condition, (m,); None for a single pair.
        displacement_outputs: rows of the displacement, (N,) each, by name.
        force_outputs: weights of the contact forces, (m,) each, by name.

    Raises:
        SceneError: for arrays of inconsistent shapes or with non-finite values, and for invalid
            amplitudes.
        NotSolvableError: for a stiffness that is not positive definite, or rows of contact that
            depend on each other.
    """
    if not isinstance(parameters, ParameterSpace):
        raise SceneError(f"parameters = {parameters!r} must be a ParameterSpace")
    matrix = _matrix("stiffness", stiffness)
    rows = _matrix("contact", contact)
    conditions, size = rows.shape
    _check(matrix, rows)
    theta, forces, slack = _terms(parameters, amplitudes, loads, gaps, (size, conditions))
    factor = _factored(matrix)
    free = factor.solve(forces)
    per_force = factor.solve(rows.T.toarray())
    schur = rows @ per_force
    schur = (schur + schur.T) / 2
    _check_definite(schur)
    outputs = _outputs(size, conditions, areas, displacement_outputs, force_outputs)
    functionals = Functionals(outputs, size, theta) if outputs else None
    fields = ExactFields(
        theta, csc_matrix(forces.shape), per_force, free, dimension=1, functionals=functionals
    )
    responses = Responses(free[:0], per_force[:0], slack - rows @ free, schur)
    groups = None if pairs is None else _pairs(pairs, conditions)
    return _started(parameters, ConstantElimination(responses, theta, LapackLU), fields, groups)


def _started(
    parameters: ParameterSpace,
    eliminated: ConstantElimination,
    fields: ExactFields,
    pairs: np.ndarray | None,
) -> CondensedModel:
    """Make the model, with initial statuses from solutions without any."""
    nothing = KnownStatuses(parameters.middle[None], np.zeros((1, fields.conditions), dtype=bool))
    model = CondensedModel(parameters, eliminated, nothing, fields, pairs)
    points = parameters.random(STATUS_POINTS, 0)
    statuses = KnownStatuses.solved(
        lambda point, start: model.solve(point, start=start, raise_on_failure=False), points
    )
    return CondensedModel(parameters, eliminated, statuses or nothing, fields, pairs)


def _matrix(name: str, value: ArrayLike | spmatrix) -> csc_matrix:
    """A sparse matrix of real numbers, from anything that SciPy can convert."""
    try:
        matrix = csc_matrix(value)
        if np.ndim(value) not in (0, 2) or value is None or matrix.dtype.kind not in "fiub":
            raise ValueError
        return csc_matrix(matrix, dtype=float)
    except (TypeError, ValueError):
        raise SceneError(f"{name} must be a matrix of real numbers, sparse or dense") from None


def _pairs(value: ArrayLike, conditions: int) -> np.ndarray:
    """Numbers of contact pairs, checked to be integers from 0 on, (m,)."""
    numbers = _array("pairs", value, (conditions,))
    if (numbers != np.floor(numbers)).any() or numbers.min() < 0 or numbers.max() >= conditions:
        raise SceneError(
            "pairs must be whole numbers from 0 on, one for each condition, and less than "
            f"{conditions}"
        )
    return numbers.astype(np.int64)


def _array(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """An array, checked to have a shape and finite values."""
    try:
        plain = np.asarray(value.toarray() if issparse(value) else value)
        if plain.dtype.kind == "c":
            raise TypeError
        array = plain.astype(float)
    except (TypeError, ValueError):
        raise SceneError(f"{name} must be real numbers, {shape}") from None
    if array.shape != shape:
        raise SceneError(f"{name} are {array.shape} and must be {shape}")
    if not np.isfinite(array).all():
        raise SceneError(f"{name} hold numbers that are not finite")
    return array


def _check(stiffness: csc_matrix, contact: csc_matrix) -> None:
    """SceneError for matrices of inconsistent shapes, non-finite values, or a stiffness that is not
    symmetric.
    """
    conditions, size = contact.shape
    if stiffness.shape != (size, size):
        raise SceneError(
            f"the stiffness is {stiffness.shape} and contact {contact.shape}: they are of {size} "
            "dofs"
        )
    if not conditions or not size:
        raise SceneError("there must be a contact condition and a dof at least")
    for name, matrix in (("stiffness", stiffness), ("contact", contact)):
        if not np.isfinite(matrix.data).all():
            raise SceneError(f"{name} holds numbers that are not finite")
    off = abs(stiffness - stiffness.T).max()
    if off > SYMMETRIC_STIFFNESS * abs(stiffness).max():
        raise SceneError(
            f"the stiffness is not symmetric: it differs from its transpose by {off:.3g}"
        )


def _terms(
    parameters: ParameterSpace,
    amplitudes: Sequence[str | float | Amplitude],
    loads: ArrayLike | spmatrix,
    gaps: ArrayLike | spmatrix,
    sizes: tuple[int, int],
) -> tuple[Amplitudes, np.ndarray, np.ndarray]:
    """Amplitudes in the order of a model, affine ones first.

    Columns of loads and gaps after those of amplitude 1.
    """
    amplitudes_of = [
        _amplitude(amplitude, parameters) for amplitude in as_tuple("amplitudes", amplitudes)
    ]
    theta = Amplitudes.collect(amplitudes_of, parameters)
    order = sorted(
        range(len(amplitudes_of)), key=lambda index: not isinstance(amplitudes_of[index], Amplitude)
    )
    of_loads, of_gaps = (
        np.pad(_array(name, columns, (size, len(amplitudes_of)))[:, order], ((0, 0), (1, 0)))
        for name, columns, size in zip(("loads", "gaps"), (loads, gaps), sizes, strict=True)
    )
    return theta, of_loads, of_gaps


def _amplitude(value: Any, parameters: ParameterSpace) -> Amplitude | Scalar:
    """An amplitude over the box, from a text, a number or an Amplitude."""
    amplitude = (
        Amplitude(float(value))
        if is_number(value)
        else Formula(value)
        if isinstance(value, str)
        else value
    )
    if not isinstance(amplitude, Amplitude | Formula):
        raise SceneError(f"an amplitude must be a text, a number or an Amplitude, not {value!r}")
    scalar = bound(amplitude, parameters)
    if isinstance(scalar, Scalar):
        remedy = "it must be finite everywhere in the box: change the formula, or narrow the box"
        check_over_box(scalar, parameters, "an amplitude", -np.inf, np.inf, remedy)
    return scalar


def _factored(stiffness: csc_matrix) -> SuperLU:
    """Factors of K without pivoting, which show that it is positive definite.

    Else raise NotSolvableError.
    """
    with suppress(RuntimeError):  # a column of zeros
        factor = splu(
            stiffness,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        sizes = np.empty(stiffness.shape[0])
        sizes[factor.perm_c] = stiffness.diagonal()
        # a zero pivot exchanges rows
        exchanged = (factor.perm_r != factor.perm_c).any()
        if not exchanged and (factor.U.diagonal() > PIVOT * np.abs(sizes)).all():
            return factor
    raise NotSolvableError(
        "the stiffness is not positive definite: leave out dofs that are imposed, and hold all "
        "bodies"
    )


def _check_definite(schur: np.ndarray) -> None:
    """Raise NotSolvableError if rows of B depend on each other."""
    sizes = np.sqrt(np.diag(schur))
    try:
        linalg.cholesky(schur / np.outer(sizes, sizes) if (sizes > 0).all() else schur)
    except linalg.LinAlgError:
        raise NotSolvableError(
            "rows of contact depend on each other, or one of them moves nothing: thesis (1.67); "
            "leave those out"
        ) from None


def _outputs(
    size: int,
    conditions: int,
    areas: ArrayLike | None,
    displacements: Mapping[str, ArrayLike] | None,
    forces: Mapping[str, ArrayLike] | None,
) -> tuple[Functional, ...]:
    displacements, forces = (
        {} if by_name is None else by_name for by_name in (displacements, forces)
    )
    for by_name in (displacements, forces):
        if not isinstance(by_name, Mapping) or not all(
            isinstance(name, str) and name for name in by_name
        ):
            raise SceneError(
                f"outputs must be arrays by name, {{'force': [1.0, ...]}}, and are {by_name!r}"
            )
    functionals: list[Functional] = []
    if areas is not None:
        checked = _array("areas", areas, (conditions,))
        if not (checked > 0).all():
            raise SceneError("areas must be positive")
        nowhere = np.zeros(0, dtype=np.int64)
        functionals.append(
            Largest("peak", "", 0, nowhere, nowhere, np.zeros(0), np.arange(conditions), checked)
        )
    for name, row in displacements.items():
        functionals.append(
            Linear.of(name, "", row=csc_matrix(_array(name, row, (size,))[None]).tocsr())
        )
    for name, weights in forces.items():
        functionals.append(
            Linear.of(name, "", np.arange(conditions), _array(name, weights, (conditions,)))
        )
    if len({functional.name for functional in functionals}) < len(functionals):
        raise SceneError("two outputs have the same name")
    return tuple(functionals)
