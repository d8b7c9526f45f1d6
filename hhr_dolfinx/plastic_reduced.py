"""Hyper-reduced model of bodies that flow, thesis (6.17), Alg. 6.2: laws on the Gauss points of the RID only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import linalg

from hhr_dolfinx.active_set import active_set
from hhr_dolfinx.deim import deim
from hhr_dolfinx.enrichment import Enrichment, enrich
from hhr_dolfinx.gauss import ElasticPart
from hhr_dolfinx.march import Correction, History
from hhr_dolfinx.pod import pod
from hhr_dolfinx.reduced import project
from hhr_dolfinx.rid import IndexSets, reduced_domain


@dataclass(frozen=True)
class PlasticSettings:
    """How to reduce a scene that flows; tolerances are epsilon of (1.53).

    Attributes:
        primal, dual, stress, plastic_strain: tolerances of the bases whose DEIM points make the RID (section 6.2.3).
        layers: layers of cells added around.
        zone_nodes: nodes added to the RID.
        kappa_max: kappa(B~1) down to which FE functions are added.
    """

    primal: float = 1e-11
    dual: float = 1e-8
    stress: float = 1e-9
    plastic_strain: float = 1e-6
    layers: int = 5
    zone_nodes: tuple[int, ...] = ()
    kappa_max: float = 1.0


class PlasticReduced:
    """Equilibrium of the reduced unknown gamma for :func:`hhr_dolfinx.march.march`.

    Args:
        full: the full model, of which only arrays are kept.
        basis: V, (N, ell).
        sets: index sets of the RID.
    """

    def __init__(self, full, basis: np.ndarray, sets: IndexSets):
        problem, operator = full.problem, full.operator
        self.sets, self.basis, self.amplitudes = sets, basis, problem.amplitudes
        self.size, self.conditions = basis.shape[1], len(sets.A_lambda)
        inside = np.zeros(problem.free.size, dtype=bool)
        inside[sets.A] = True
        # cells of the RID without a dof of A act on no test function
        self.cells = np.flatnonzero(inside[operator.dofs].any(axis=1))
        columns = np.unique(operator.dofs[self.cells])
        per_cell = operator.weights.shape[1]
        self.points = (self.cells[:, None] * per_cell + np.arange(per_cell)).ravel()
        self.material = full.material.restricted(self.points)
        self.operator = operator.restricted(self.cells, columns)
        self._pattern = self.operator.pattern()
        self._trial = np.vstack([basis[columns], np.zeros((1, self.size))])
        self._lifts = np.vstack([problem.lifts[columns], np.zeros((1, problem.lifts.shape[1]))])
        self._lifted = bool(np.any(self._lifts))
        self._rows = np.flatnonzero(inside[columns])
        self._test = np.ascontiguousarray(self._trial[self._rows].T)
        self._external = self._test @ full.external[columns[self._rows]]
        self.reduced = project(problem, basis, sets)
        self._elastic = _Factored(self.reduced.stiffness, self.reduced)
        # the elastic part of K~ is known: online only what flow changes is projected
        self._unchanged = ElasticPart(self.material.elastic, np.zeros(self._pattern.indices.size))

    def strain(self, x, theta):
        """Strain at the Gauss points of the RID; without lift where ``theta`` is None."""
        field = self._trial @ x
        if self._lifted and theta is not None:
            field += self._lifts @ theta
        return self.operator.strain(field)

    def residual(self, stress, theta):
        """V[A]^T of loads less internal forces."""
        return self._external @ theta - self._test @ self.operator.internal(stress)[self._rows]

    def contact_load(self, forces):
        """B~1^T λ."""
        return forces @ self.reduced.contact_test

    def force_scale(self, theta):
        """Norm of the projected loads."""
        return np.linalg.norm(self._external @ theta)

    def tangent(self, tangents) -> np.ndarray:
        """Projected consistent tangent V[A]^T K_T V, (ell, ell)."""
        change = self.operator.stiffness(tangents, self._pattern, self._unchanged)
        return self.reduced.stiffness + self._test @ _product(change, self._rows, self._trial)

    def linearise(self, tangents):
        """Project and factor the tangent, or take the elastic operator."""
        self._now = self._elastic if tangents is None else _Factored(self.tangent(tangents), self.reduced)

    def correct(self, residual, x, theta, active) -> Correction:
        """Solve one linearised contact problem; see :class:`hhr_dolfinx.march.Equilibrium`."""
        free = linalg.lu_solve(self._now.factors, residual, check_finite=False)
        slack = self.reduced.gaps @ theta - self.reduced.contact_trial @ (x + free)
        found = active_set(self._now, slack, active)
        change = free - self._now.per_force @ found.forces
        return Correction(change, found.forces, found.active, found.status.name == "CONVERGED")

    def displacement(self, x, theta, problem) -> np.ndarray:
        """Displacement on the whole mesh, (N,)."""
        return self.basis @ x + problem.lifts @ theta


def _product(matrix, rows, dense):
    """Some rows of a sparse matrix, many of which are zero, times a dense one."""
    out = np.zeros((rows.size, dense.shape[1]))
    _rows_times(matrix.indptr, matrix.indices, matrix.data, rows, dense, out)
    return out


@njit(cache=True)
def _rows_times(indptr, indices, data, rows, dense, out):
    for r in range(rows.size):
        for position in range(indptr[rows[r]], indptr[rows[r] + 1]):
            value = data[position]
            if value != 0.0:
                column = indices[position]
                for k in range(dense.shape[1]):
                    out[r, k] += value * dense[column, k]


class _Factored:
    """LU of a projected stiffness with the contact Schur complement on it."""

    def __init__(self, stiffness, reduced):
        self.factors = linalg.lu_factor(stiffness, check_finite=False)
        self.per_force = linalg.lu_solve(self.factors, reduced.contact_test.T, check_finite=False)
        self._schur = reduced.contact_trial @ self.per_force

    def __call__(self, active, free_slack):
        """Forces and slacks for given statuses; see :class:`SchurEqualities`."""
        index, forces = np.flatnonzero(active), np.zeros(active.size)
        if index.size == 0:
            return forces, free_slack
        columns = self._schur[:, index]
        forces[index] = np.linalg.solve(columns[index], -free_slack[index])
        slack = free_slack + columns @ forces[index]
        slack[index] = 0.0
        return forces, slack


def snapshot_nodes(full, histories: list[History], settings: PlasticSettings) -> tuple[np.ndarray, np.ndarray]:
    """POD basis of the displacements, and the nodes of all DEIM points (section 6.2.3).

    Args:
        full: the full model.
        histories: its training histories.
        settings: tolerances.

    Returns:
        ``(basis, nodes)``.
    """
    problem = full.problem
    stacked = {
        name: np.concatenate([h.stack(name) for h in histories], axis=-1) for name in ("unknown", "forces", "stress")
    }
    cumulated = np.stack([p.state.cumulated for h in histories for p in h.points], axis=1)
    basis, _ = pod(stacked["unknown"], settings.primal)
    nodes = [deim(basis) // problem.block_size, np.array(settings.zone_nodes, dtype=np.int64)]
    if np.any(stacked["forces"]):
        nodes.append(problem.contact_slaves[deim(pod(stacked["forces"], settings.dual)[0])])
    stresses = stacked["stress"].reshape(-1, cumulated.shape[1])
    points = [deim(pod(stresses, settings.stress)[0]) // full.material.components]
    if np.any(cumulated):
        points.append(deim(pod(cumulated, settings.plastic_strain)[0]))
    cells = full.cell_of_point[np.concatenate(points)]
    nodes.append(problem.cell_nodes[cells].ravel())
    return basis, np.unique(np.concatenate(nodes))


def build_plastic_reduced(full, histories, settings=PlasticSettings()) -> tuple[PlasticReduced, Enrichment]:
    """Basis, RID and projection; one attempt."""
    basis, nodes = snapshot_nodes(full, histories, settings)
    sets = reduced_domain(full.problem, nodes, settings.layers)
    enrichment = enrich(full.problem, basis, sets, settings.kappa_max)
    return PlasticReduced(full, enrichment.basis, sets), enrichment
