"""Rivals that look for contact forces in a cone of few vectors, thesis section 1.3.2.

Each is a function ``(training) -> rivals`` of a study. Where their papers leave a size to the
reader, it is 20 and 40 dual functions with as many modes as POD at 1e-10 has, at most 60.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg
from scipy.optimize import nnls

from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.plugins.rivals.factors import nonnegative_factors
from hhr_dolfinx.plugins.rivals.projection import (
    ConeModel,
    check_elastic,
    displacement_modes,
    with_supremizers,
)
from hhr_dolfinx.plugins.studies.study import Rival

if TYPE_CHECKING:
    from hhr_dolfinx.snapshots.records import SnapshotSet
    from hhr_dolfinx.study.training.train import Training

MOST_MODES = 60
DUAL_COUNTS = 20, 40
"""Modes at most, and sizes of dual bases."""
MOST_ENTRIES = 400
"""Most entries of a dictionary."""
STABLE = 0.1
"""Inf-sup constant, in norms in which that of the full model is 1, up to which supremizers are
added.
"""
TOUCHING = 1e-9
"""Part of the largest forces of training below which an answer counts as one without contact."""
DEPENDENT = 1e-7
"""Relative size in the norm of S below which a direction of a cone depends on the others."""
CONE_ROUND_OFF = 1e-12
"""Relative distance to a cone that is round-off."""


def galerkin(training: Training) -> Iterator[Rival]:
    """POD of displacements, all contact conditions (E. Delhez et al. 2021; D. Manvelyan et al.
    2021).

    Without supremizers: forces that no mode feels are not determined, thesis (3.1).
    """
    for count in (20, MOST_MODES):
        yield Rival("POD-Galerkin", f"{count} modes", partial(_galerkin, training, count))


def _galerkin(training: Training, count: int) -> ConeModel:
    return ConeModel(training.full_order, displacement_modes(training.snapshots, count))


def nnmf(training: Training) -> Iterator[Rival]:
    """Non-negative factors of the forces (M. Balajewicz, D. Amsallem and C. Farhat, IJNME 106,
    2016).
    """
    yield from _cones("NNMF", training, nonnegative_factors)


def cone_projected_greedy(training: Training) -> Iterator[Rival]:
    """Snapshots that a cone of those before approximates worst (A. Benaceur, A. Ern and V.
    Ehrlacher, IJNME 121, 2020).
    """
    yield from _cones("cone-projected greedy", training, greedy_cone)


def _cones(
    method: str, training: Training, basis: Callable[[np.ndarray, int], np.ndarray]
) -> Iterator[Rival]:
    """Rivals with a supremizer for each dual function."""
    for count in DUAL_COUNTS:

        def made(count: int = count) -> ConeModel:
            full = training.full_order
            check_elastic(full, method)
            cone = basis(touching(training.snapshots), count)
            modes = displacement_modes(training.snapshots, MOST_MODES)
            return ConeModel(full, with_supremizers(full, modes, cone), cone)

        yield Rival(method, f"{count} forces", made)


def inf_sup_greedy(training: Training) -> Iterator[Rival]:
    """The same cone, and supremizers one by one where the inf-sup constant is smallest, after I.
    Niakh et al. 2023 as the thesis describes it.
    """
    for count in DUAL_COUNTS:
        yield Rival("inf-sup greedy", f"{count} forces", partial(_stabilised, training, count))


def _stabilised(training: Training, count: int) -> ConeModel:
    full = training.full_order
    check_elastic(full, "inf-sup greedy")
    cone = greedy_cone(touching(training.snapshots), count)
    basis = displacement_modes(training.snapshots, MOST_MODES)
    stiffness = full.problem.stiffness
    contact = full.problem.contact
    directions = _orthonormal(cone, full.schur)
    for _ in range(directions.shape[1]):
        primal = linalg.cholesky(basis.T @ (stiffness @ basis), lower=True)
        seen = linalg.solve_triangular(primal, (directions.T @ (contact @ basis)).T, lower=True)
        left, values, _ = linalg.svd(seen.T)
        if len(values) == directions.shape[1] and values[-1] >= STABLE:
            break
        basis = with_supremizers(full, basis, (directions @ left[:, -1])[:, None])
    return ConeModel(full, basis, cone)


def _orthonormal(cone: np.ndarray, schur: np.ndarray) -> np.ndarray:
    """Span of a cone, orthonormal in the norm of S, without directions that are round-off."""
    _, values, right = linalg.svd(linalg.cholesky(schur) @ cone, full_matrices=False)
    kept = values > DEPENDENT * values[0]
    return np.asarray(cone @ (right[kept].T / values[kept]))


def reduced_basis(training: Training) -> Iterator[Rival]:
    """Training answers themselves as bases, with supremizers (B. Haasdonk, J. Salomon and B.
    Wohlmuth, SIAM J. Numer. Anal. 50, 2012).
    """
    for count in DUAL_COUNTS:
        yield Rival("reduced basis", f"{count} answers", partial(_of_answers, training, count))


def _of_answers(training: Training, count: int) -> ConeModel:
    full = training.full_order
    snapshots = training.snapshots
    check_elastic(full, "a reduced basis")
    chosen = np.unique(np.linspace(0, len(snapshots.points) - 1, count).round().astype(int))
    few = snapshots.take(chosen)
    cone = touching(few)
    cone = cone / np.linalg.norm(cone, axis=0)
    return ConeModel(full, with_supremizers(full, displacement_modes(few, count), cone), cone)


def dictionary(training: Training) -> Iterator[Rival]:
    """All forces of training as a dictionary, of which each answer takes few, and all
    displacements that they cause (after K. Kollepara et al., arXiv:2406.11461).
    """
    yield Rival("dictionary", "all forces", partial(_dictionary, training))


def _dictionary(training: Training) -> ConeModel:
    full = training.full_order
    check_elastic(full, "a dictionary")
    forces = touching(training.snapshots)
    directions = forces / np.linalg.norm(forces, axis=0)
    step = -(-directions.shape[1] // MOST_ENTRIES)
    directions = directions[:, ::step]
    free = displacement_modes(training.snapshots, MOST_MODES)
    # supremizers of all entries span those of a basis of the entries
    spanned = linalg.svd(directions, full_matrices=False)
    rank = int((spanned[1] > CONE_ROUND_OFF * spanned[1][0]).sum())
    return ConeModel(full, with_supremizers(full, free, spanned[0][:, :rank]), directions)


def touching(snapshots: SnapshotSet) -> np.ndarray:
    """Forces of training answers with contact, (N_lambda, S).

    Raises:
        ReductionError: without contact in training.
    """
    forces = np.maximum(snapshots.forces, 0.0)
    sizes = np.linalg.norm(forces, axis=0)
    pressed = sizes > TOUCHING * sizes.max(initial=0.0)
    if not pressed.any():
        raise ReductionError("no training answer has contact, and a dual basis is made of forces")
    return np.asarray(forces[:, pressed])


def greedy_cone(forces: np.ndarray, count: int, *, relative: bool = False) -> np.ndarray:
    """At most ``count`` columns of forces, each where the cone of those before is farthest.

    Args:
        forces: forces >= 0, none of them zero, (N_lambda, S).
        count: most columns.
        relative: measure distances over the size of each column, so that grazing contact counts.

    Returns:
        These columns over their norm, (N_lambda, r).
    """
    sizes = np.linalg.norm(forces, axis=0)
    directions = forces / sizes
    weights = np.ones_like(sizes) if relative else sizes
    distances = weights.copy()
    chosen = [int(sizes.argmax())]
    least = CONE_ROUND_OFF * weights.max()
    while len(chosen) < count:
        cone = directions[:, chosen]
        for k in np.flatnonzero(distances > least):
            distances[k] = min(distances[k], weights[k] * nnls(cone, directions[:, k])[1])
        if distances.max() <= least:
            break
        chosen.append(int(distances.argmax()))
    return directions[:, chosen]
