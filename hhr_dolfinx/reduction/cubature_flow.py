"""Weighted Gauss points for the plastic forces of a reduced model of bodies that flow: fitted to training states."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg
from scipy.sparse import csc_matrix

from hhr_dolfinx.contact.problem import IndexSets
from hhr_dolfinx.errors import ReductionError, UnstableModelError
from hhr_dolfinx.models.cubature_flow import CubatureFlow
from hhr_dolfinx.reduction.cubature import Cubature, compressed, fitted
from hhr_dolfinx.snapshots.records import SnapshotSet

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.flow import FullEquilibrium

CHUNK = 500
"""Gauss points whose rows are made at a time."""
LEFT_OUT = 0.1
"""What compressions of states and of rows may leave out, relative to the tolerance of the weights."""


def cubature_flow(
    full: FullEquilibrium, basis: np.ndarray, sets: IndexSets, snapshots: SnapshotSet, tolerance: float
) -> tuple[CubatureFlow, Cubature]:
    """Gauss points of the cells that act on A, with weights for the plastic forces V[A]^T f_p of training states.

    Candidates are the points that flowed in any training state. There is one integral for each mode and state; modes
    are made orthonormal in the energy, and each state is divided by the energy norm of its force, so that a state with
    little flow counts as much as one with much.

    Args:
        full: equilibrium of the full model.
        basis: V, (N, ell).
        sets: index sets of the RID; of all dofs for a cubature over the whole mesh.
        snapshots: training histories.
        tolerance: relative misfit of the integrals.

    Returns:
        The points as a reduced model uses them, and the cubature, whose points count the candidates.

    Raises:
        ReductionError: where nothing flows in training in the cells that act on A.
        UnstableModelError: if no weights reach ten times the tolerance.
    """
    inside = np.zeros(full.problem.free.size, dtype=bool)
    inside[sets.A] = True
    cells = np.flatnonzero(inside[full.operator.dofs].any(axis=1))
    points = full.operator.points_of(cells)
    if snapshots.cumulated is None or not np.any(snapshots.cumulated[points]):
        raise ReductionError(
            "nothing flows in training where the reduced domain looks: there is nothing to fit a cubature to. Leave "
            "cubature = None, or train where bodies flow"
        )
    points = points[snapshots.cumulated[points].any(axis=1)]
    test = np.where(inside[:, None], basis, 0.0)
    # V R^-1 is orthonormal in the energy
    triangle = linalg.cholesky(basis.T @ (full.problem.stiffness @ basis))
    states = _states(full, points, snapshots)
    tested = linalg.solve_triangular(triangle, test.T, trans="T").T
    states = _scaled(states, lambda: _strains(full, tested, points))
    states = _leading(states, full.operator.weights.ravel()[points], LEFT_OUT * tolerance)

    def rows() -> Iterator[np.ndarray]:
        for part, strain in _strains(full, tested, points):
            table = np.einsum("pck,pcs->ksp", strain, states[part])
            yield table.reshape(-1, table.shape[2])

    found = fitted(compressed(rows, LEFT_OUT * tolerance), tolerance)
    if found.misfit > 10 * tolerance:
        raise UnstableModelError(
            f"weights of {found.points.size} Gauss points leave {found.misfit:.1e} of the plastic forces of training, "
            f"{tolerance:.1e} was asked for: allow more, or keep fewer modes"
        )
    chosen = points[found.points]
    lifts = full.problem.lifts
    return CubatureFlow(
        points=chosen,
        per_cell=full.operator.per_cell,
        trial=_strain_of(full, basis, chosen),
        test=_strain_of(full, test, chosen) * (found.weights * full.operator.weights.ravel()[chosen])[:, None, None],
        lifts=csc_matrix(_strain_of(full, lifts.toarray(), chosen).reshape(-1, lifts.shape[1])),
        material=full.material.restricted(chosen),
    ), found


def _strain_of(full: FullEquilibrium, fields: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Strain of fields (N, k) at some Gauss points, (n, c, k)."""
    cells, places = np.divmod(points, full.operator.per_cell)
    return full.operator.gradients[cells, places] @ fields[full.operator.dofs[cells]]


def _strains(full: FullEquilibrium, fields: np.ndarray, points: np.ndarray) -> Iterator[tuple[slice, np.ndarray]]:
    """Strain of fields times the weight of the quadrature, some points at a time."""
    weights = full.operator.weights.ravel()
    for first in range(0, points.size, CHUNK):
        part = slice(first, min(first + CHUNK, points.size))
        yield part, _strain_of(full, fields, points[part]) * weights[points[part], None, None]


def _states(full: FullEquilibrium, points: np.ndarray, snapshots: SnapshotSet) -> np.ndarray:
    """C ε_p of all training states at some points, (n, c, S)."""
    plastic = [answer.state().state.plastic[points] for history in snapshots.histories for answer in history.answers]
    return full.material.elastic[points] @ np.stack(plastic, axis=2)


def _scaled(states: np.ndarray, strains: Callable[[], Iterator[tuple[slice, np.ndarray]]]) -> np.ndarray:
    """States whose force has the energy norm one; those without any flow are left out."""
    forces: np.ndarray | float = 0.0
    for part, strain in strains():
        forces = forces + np.einsum("pck,pcs->ks", strain, states[part], optimize=True)
    sizes = np.linalg.norm(forces, axis=0)
    kept = sizes > 1e-9 * sizes.max()
    return states[:, :, kept] / sizes[kept]


def _leading(states: np.ndarray, weights: np.ndarray, tolerance: float) -> np.ndarray:
    """Combinations of states that leave out less than ``tolerance`` of their size, each with its singular value."""
    flat = (states * np.sqrt(weights)[:, None, None]).reshape(-1, states.shape[2])
    squares, combinations = linalg.eigh(flat.T @ flat)
    left_out = np.cumsum(np.maximum(squares, 0.0))
    return states @ combinations[:, left_out > tolerance**2 * left_out[-1]]
