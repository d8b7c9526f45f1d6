"""Weighted Gauss points for the internal forces of a reduced model of bodies that flow, fitted to training states.

What is integrated are the forces of the whole stress, not of its plastic part alone, and beside them the stiffness of
each mode under the tangents of training. On the pellet (31 modes, tolerance 1e-3) forces of trained histories were then
0.1 % off with 147 points, the margin of the tangents 0.8; by the plastic part alone 45 % or 2 % with as many points, a
margin of 0.2 or below 0, and without the stiffness of modes tangents that were singular.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg
from scipy.sparse import csc_matrix

from hhr_dolfinx.contact.problem import IndexSets
from hhr_dolfinx.errors import UnstableModelError
from hhr_dolfinx.models.reduced_flow import CubatureFlow
from hhr_dolfinx.reduction.cubature import Cubature, compressed, fitted
from hhr_dolfinx.reduction.flow import rows_of
from hhr_dolfinx.snapshots.records import SnapshotSet

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.flow import FullEquilibrium

CHUNK = 500
"""Gauss points whose rows are made at a time."""
ROWS = 3000
"""Integrals of forces that weights are fitted to at most, before compression: most time goes to their products."""
LEFT_OUT = 0.5
"""What compressions of states and of rows may leave out, relative to the tolerance of the weights."""


def cubature_flow(
    full: FullEquilibrium,
    basis: np.ndarray,
    sets: IndexSets,
    snapshots: SnapshotSet,
    tangents: Sequence[np.ndarray],
    tolerance: float,
    stiffness: float,
) -> tuple[CubatureFlow, Cubature]:
    """Gauss points of the cells that act on A, with weights for the forces V[A]^T f of training states.

    There is one integral for each mode and state; modes are made orthonormal in the energy, and each state is divided
    by the energy norm of its force, so that a state with little load counts as much as one with much.

    Args:
        full: equilibrium of the full model.
        basis: V, (N, ell).
        sets: index sets of the RID; of all dofs for a cubature over the whole mesh.
        snapshots: training histories.
        tangents: at training states, each (Gauss points, c, c); the elastic ones are taken besides.
        tolerance: relative misfit of the forces.
        stiffness: relative misfit of the stiffness of a mode.

    Returns:
        The points as a reduced model uses them, and the cubature, whose points count the Gauss points of these cells.

    Raises:
        UnstableModelError: if no weights come near the tolerance.
    """
    inside = np.zeros(full.problem.free.size, dtype=bool)
    inside[sets.A] = True
    points = full.operator.points_of(np.flatnonzero(inside[full.operator.dofs].any(axis=1)))
    test = np.where(inside[:, None], basis, 0.0)
    rows = _Rows(full, basis, test, points)
    states = rows.states(snapshots, LEFT_OUT * tolerance)
    moduli = [*_elastic_parts(full, points), *(item[points] for item in tangents)]
    found = fitted(
        compressed(lambda: rows.chunks(states, moduli, tolerance / stiffness), LEFT_OUT * tolerance), tolerance
    )
    if found.misfit > 10 * tolerance:
        raise UnstableModelError(
            f"weights of {found.points.size} Gauss points leave {found.misfit:.1e} of the forces of training, "
            f"{tolerance:.1e} was asked for: allow more, or keep fewer modes"
        )
    chosen, lifts = points[found.points], full.problem.lifts
    lifted = csc_matrix(_strain_of(full, lifts.toarray(), chosen).reshape(-1, lifts.shape[1]))
    weights = found.weights * full.operator.weights.ravel()[chosen]
    flow = CubatureFlow(
        points=chosen,
        per_cell=full.operator.per_cell,
        trial=_strain_of(full, basis, chosen),
        test=_strain_of(full, test, chosen) * weights[:, None, None],
        given=csc_matrix(lifted - full.eigenstrains.tocsr()[rows_of(chosen, full.operator.components)]),
        loads=np.asfortranarray((full.problem.external.T @ test).T),
        material=full.material.restricted(chosen),
    )
    return flow, found


class _Rows:
    """What points contribute to forces and stiffness of modes that are orthonormal in the energy."""

    def __init__(self, full: FullEquilibrium, basis: np.ndarray, test: np.ndarray, points: np.ndarray):
        triangle = linalg.cholesky(basis.T @ (full.problem.stiffness @ basis))
        self._full, self._points = full, points
        self._trial, self._test = (linalg.solve_triangular(triangle, part.T, trans="T").T for part in (basis, test))
        self._weights = full.operator.weights.ravel()[points]

    def _parts(self) -> Iterator[tuple[slice, np.ndarray]]:
        """Strain of the test functions times the weight of the quadrature, some points at a time."""
        for first in range(0, self._points.size, CHUNK):
            part = slice(first, first + CHUNK)
            yield part, _strain_of(self._full, self._test, self._points[part]) * self._weights[part, None, None]

    def states(self, snapshots: SnapshotSet, tolerance: float) -> np.ndarray:
        """Stress of training, (n, c, S'), of force one in the energy norm; combinations that leave out little."""
        stress = np.stack([state.stress[self._points] for state in snapshots.states], axis=2)
        forces = sum(np.einsum("pck,pcs->ks", strain, stress[part], optimize=True) for part, strain in self._parts())
        sizes = np.linalg.norm(forces, axis=0)
        kept = sizes > 1e-9 * sizes.max()
        stress = stress[:, :, kept] / sizes[kept]
        flat = (stress * np.sqrt(self._weights)[:, None, None]).reshape(-1, stress.shape[2])
        squares, combinations = linalg.eigh(flat.T @ flat)
        left_out = np.cumsum(np.maximum(squares, 0.0))
        wanted = int((left_out > tolerance**2 * left_out[-1]).sum())
        most = max(ROWS // forces.shape[0], 1)
        return stress @ combinations[:, -min(wanted, most) :]

    def chunks(self, states: np.ndarray, moduli: Sequence[np.ndarray], scale: float) -> Iterator[np.ndarray]:
        """Rows of forces, and of the stiffness of each mode times ``scale``, of some points at a time."""
        for part, strain in self._parts():
            forces = np.einsum("pck,pcs->ksp", strain, states[part], optimize=True)
            moved = _strain_of(self._full, self._trial, self._points[part])
            bent = [np.einsum("pck,pck->kp", strain, item[part] @ moved) for item in moduli]
            yield np.vstack([forces.reshape(-1, forces.shape[2]), *(scale * item for item in bent)])


def _elastic_parts(full: FullEquilibrium, points: np.ndarray) -> list[np.ndarray]:
    """Elastic tangents in the middle of the box, (points, c, c), of each modulus that is a formula and of the rest.

    Weights that are right for each part are right for all values of the moduli.
    """
    material = full.material.moduli_at(full.problem.middle)
    texts = [group.young if isinstance(group.young, str) else "" for group in full.material.groups]
    parts = []
    for text in sorted(set(texts)):
        own = np.zeros(material.gauss_points, dtype=bool)
        for group, label in zip(material.groups, texts, strict=True):
            own[group.indices] |= label == text
        if own[points].any():
            parts.append(np.where(own[points, None, None], material.elastic[points], 0.0))
    return parts


def _strain_of(full: FullEquilibrium, fields: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Strain of fields (N, k) at some Gauss points, (n, c, k)."""
    cells, places = np.divmod(points, full.operator.per_cell)
    return full.operator.gradients[cells, places] @ fields[full.operator.dofs[cells]]
