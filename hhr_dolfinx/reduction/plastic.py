"""Hyper-reduced model of bodies that flow, thesis (6.17), Alg. 6.2: laws on the Gauss points of the RID only."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np

from hhr_dolfinx.compat import compiled
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, active_set
from hhr_dolfinx.contact.problem import IndexSets
from hhr_dolfinx.linear.dense import LapackLU
from hhr_dolfinx.materials.strain import ElasticPart
from hhr_dolfinx.models.equilibrium import Correction
from hhr_dolfinx.reduction.projection import project
from hhr_dolfinx.trained import Signs, TrainedPaths


class PlasticReduced:
    """Equilibrium of the reduced unknown gamma for :func:`hhr_dolfinx.models.march.march`.

    Args:
        full: the full model, of which only arrays are kept.
        basis: V, (N, ell).
        sets: index sets of the RID.

    Attributes:
        reduced: the elastic projection, (5.23).
        elastic: the elastic linearisation.
        size, conditions: ell and N_lambda_C.
        cells: cells of the RID that act on A.
        points: numbers of their Gauss points in the full model.
        operator, material: strain and laws at these points.
        trained: what it was trained on, None until that is known.
        lock: nothing, see :class:`hhr_dolfinx.full_order.plastic.PlasticFullOrder`: histories share no factors here.
    """

    trained: TrainedPaths | None = None

    def __init__(self, full, basis: np.ndarray, sets: IndexSets):
        problem, operator = full.problem, full.operator
        self.sets, self.basis, self.lock = sets, basis, nullcontext()
        self.amplitudes, self.parameters = problem.amplitudes, problem.parameters
        self.size, self.conditions = basis.shape[1], len(sets.A_lambda)
        inside = np.zeros(problem.free.size, dtype=bool)
        inside[sets.A] = True
        # cells of the RID without a dof of A act on no test function
        self.cells = np.flatnonzero(inside[operator.dofs].any(axis=1))
        self.operator, columns = operator.restricted(self.cells)
        self.points = (self.cells[:, None] * operator.per_cell + np.arange(operator.per_cell)).ravel()
        self.material = full.material.restricted(self.points)
        self._pattern = self.operator.pattern()
        self._trial, self._lifts = np.ascontiguousarray(basis[columns]), problem.lifts[columns]
        self._lifted = self._lifts.nnz > 0
        self._sizes = abs(self.operator.stiffness(self.material.elastic, self._pattern))
        self._rows = np.flatnonzero(inside[columns])
        self._test = np.ascontiguousarray(self._trial[self._rows].T)
        self._loads = problem.external[columns[self._rows]]
        self._external = self._test @ self._loads
        self._motion, self._gaps = problem.contact @ basis, problem.gaps
        self._contact = problem.contact[sets.A_lambda][:, columns[self._rows]].T.tocsr()
        self.reduced = project(problem, basis, sets)
        self.elastic = _Operator(self.reduced, self.reduced.stiffness, self.material.elastic)
        # the elastic part of K~ is known: online only what flow changes is projected
        self._unchanged = ElasticPart(self.material.elastic, np.zeros(self._pattern.indices.size))

    def strain(self, x, theta):
        """Strain at the Gauss points of the RID, lift included."""
        field = self._trial @ x
        return self.operator.strain(field + self._lifts @ theta if self._lifted else field)

    def strain_of(self, change):
        """Strain of a change of gamma at the Gauss points of the RID."""
        return self.operator.strain(self._trial @ change)

    def residual(self, stress, theta):
        """V[A]^T of loads less internal forces, and the norm of what they are made of on A, (1,)."""
        loads, (internal, size) = self._external @ theta, self.operator.internal(stress)
        return loads - self._test @ internal[self._rows], self.norms(loads) + self.norms(size[self._rows])

    def norms(self, residual):
        """Norm of a residual; modes span all bodies, (1,)."""
        return np.array([np.sqrt(residual @ residual)])

    def round_off(self, x, theta):
        """Residual that comes of adding stiffness times displacement in double precision, (1,)."""
        return 1e-13 * self.norms(self._sizes @ np.abs(self._trial @ x + self._lifts @ theta))

    def contact_load(self, forces):
        """B~1^T λ."""
        return forces @ self.reduced.contact_test

    def signs(self, point) -> Signs:
        """Residual on A before it is projected, and gaps on the whole contact surface.

        In the reduced space the residual vanishes whatever the path, and no gap of the RID is violated; on A, and
        outside, it shows what the modes cannot do.
        """
        theta, rows = self.amplitudes(point.parameter), self._rows
        loads, (internal, sizes) = self._loads @ theta, self.operator.internal(point.stress)
        contact = self._contact @ point.forces
        size = np.linalg.norm(loads) + np.linalg.norm(sizes[rows]) + np.linalg.norm(contact)
        depth = (self._motion @ point.unknown - self._gaps @ theta).max()
        return Signs(float(np.linalg.norm(loads - internal[rows] - contact)), float(size), max(float(depth), 0.0))

    def tangent(self, tangents) -> np.ndarray:
        """Projected consistent tangent V[A]^T K_T V, (ell, ell)."""
        change = self.operator.stiffness(tangents, self._pattern, self._unchanged)
        return self.reduced.stiffness + self._test @ _product(change, self._rows, self._trial)

    def linearised(self, tangents) -> _Operator:
        """Project and factor the tangent."""
        return _Operator(self.reduced, self.tangent(tangents), tangents)


def _product(matrix, rows, dense):
    """Some rows of a sparse matrix, many of which are zero, times a dense one."""
    out = np.zeros((rows.size, dense.shape[1]))
    _rows_times(matrix.indptr, matrix.indices, matrix.data, rows, dense, out)
    return out


@compiled()
def _rows_times(indptr, indices, data, rows, dense, out):
    for r in range(rows.size):
        for position in range(indptr[rows[r]], indptr[rows[r] + 1]):
            value = data[position]
            if value != 0.0:
                column = indices[position]
                for k in range(dense.shape[1]):
                    out[r, k] += value * dense[column, k]


class _Operator:
    """A linearisation on dense blocks, see :class:`hhr_dolfinx.models.equilibrium.Operator`."""

    def __init__(self, reduced, stiffness, moduli):
        self.moduli, self._reduced, self._factor = moduli, reduced, LapackLU(stiffness)
        self._pairs = Pairs.of(reduced.pairs)
        self._per_force = self._factor.solve(reduced.contact_test.T)
        self._equalities = SchurEqualities.of(reduced.contact_trial @ self._per_force, LapackLU)

    def correct(self, residual, x, theta, active) -> Correction:
        """Solve K~ δ + B~1^T λ = residual, B~2 (x + δ) <= gaps."""
        free, reduced = self._factor.solve(residual), self._reduced
        slack = reduced.gaps @ theta - reduced.contact_trial @ (x + free)
        found = active_set(self._equalities, slack, active, pairs=self._pairs)
        return Correction(free - self._per_force @ found.forces, found.forces, found.active, found.status)
