"""Bounds of the errors of outputs, offline: what :class:`hhr_dolfinx.models.bounds.output_bound.OutputBound` needs."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse import csr_matrix, vstack

from hhr_dolfinx.certify.accuracy import FORCE_FLOOR
from hhr_dolfinx.certify.bounds import ROUND_OFF, energies, energy_directions
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.bounds.error_bound import ErrorBound
from hhr_dolfinx.models.bounds.output_bound import UNKNOWN, OutputBound, is_read_nearer
from hhr_dolfinx.models.functionals.functional import Functional

MOST_READ = 50
"""Training answers of which outputs are read."""


def output_bound(full: Any, bound: ErrorBound, basis: np.ndarray, training: Any = None) -> OutputBound:
    """Bounds of the outputs of answers with a basis, (own rows, ell), of a full model with outputs that has a bound.

    ``training`` are snapshots, whose outputs say what is large.
    """
    problem = full.problem
    items = full.functionals.items
    size = problem.free.size
    m = len(bound.lower)
    per_condition = solve_triangular(bound.lower, np.eye(m), lower=True).T
    nearer = [item.matrix(size) for item in items if is_read_nearer(item, m)]
    rows = csr_matrix(vstack([csr_matrix((0, size)), *nearer]))
    loads = full.per_load
    free = _read(problem, rows, loads) + (rows @ problem.lifts).toarray()
    pressed = full.pressed(rows)
    steepness = np.full((len(items), 2), UNKNOWN)
    first = 0
    directions = None
    for number, item in enumerate(items):
        if is_read_nearer(item, m):
            own = -pressed[first : first + item.count] @ per_condition
            first += item.count
            if not item.affine:
                steepness[number, 1] = _known(item.steepness(own.__getitem__, per_condition))
            continue
        if not full.keeps_columns:
            continue  # its Lipschitz constant takes all of them
        if directions is None:
            # all errors of displacements are combinations of these columns
            columns = np.hstack([full.per_force, loads, basis])
            lengths = energies(problem, columns)
            directions = energy_directions(problem, columns, ROUND_OFF * lengths)[0]
        moving = _read(problem, item.matrix(size), directions)
        steepness[number] = _along_both(item, moving, per_condition)
    return OutputBound(steepness, np.asfortranarray(free), np.asfortranarray(pressed), _least(full, training))


def _least(full: Any, training: Any) -> np.ndarray:
    """A thousandth of the largest absolute value of each output in some training answers; zero without any, (n,)."""
    if training is None:
        return np.zeros(len(full.functionals.items))
    answers = []
    for k in np.unique(np.linspace(0, len(training.points) - 1, MOST_READ).astype(int)):
        forces = training.forces[:, k]
        how = forces, forces > 0, 0, Status.CONVERGED, False, full
        unknown = full.problem.spread.whole(training.displacements[:, k])
        answers.append(Answer(training.points[k], unknown, *how).outputs().values)
    return FORCE_FLOOR * np.abs([list(values.values()) for values in answers]).max(axis=0)


def _read(problem: ContactProblem, rows: csr_matrix, columns: np.ndarray) -> np.ndarray:
    """Rows of outputs, (K, N), times own rows of fields, (own, k)."""
    return problem.spread.sum(rows.tocsc()[:, problem.rows] @ columns)


def _along_both(item: Functional, moved: np.ndarray, per_condition: np.ndarray) -> tuple[float, float]:
    """Lipschitz constants of an output along displacements, which move its rows, (count, r), and along forces.

    Both are there, or none.
    """
    none = np.zeros((len(per_condition), moved.shape[1]))

    def still(place: slice) -> np.ndarray:
        return np.zeros((len(range(*place.indices(item.count))), per_condition.shape[1]))

    found = _known(item.steepness(moved.__getitem__, none)), _known(item.steepness(still, per_condition))
    return found if UNKNOWN not in found else (UNKNOWN, UNKNOWN)


def _known(constant: float | None) -> float:
    return UNKNOWN if constant is None else float(constant)
