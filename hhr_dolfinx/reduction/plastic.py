"""Hyper-reduced model of bodies that flow, thesis (6.17), Alg. 6.2: laws on the Gauss points of the RID only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import linalg

from hhr_dolfinx.compat import compiled
from hhr_dolfinx.contact.active_set import SchurEqualities, active_set
from hhr_dolfinx.contact.dense import LapackLU
from hhr_dolfinx.contact.problem import ContactSolution, Status
from hhr_dolfinx.errors import NotSolvableError, ReductionError, UnstableModelError
from hhr_dolfinx.flow.gauss import ElasticPart
from hhr_dolfinx.flow.quasi_static import Correction, History, Point
from hhr_dolfinx.reduction.deim import deim
from hhr_dolfinx.reduction.enrichment import Enrichment, enrich
from hhr_dolfinx.reduction.offline import loaded_nodes
from hhr_dolfinx.reduction.pod import pod
from hhr_dolfinx.reduction.reconstruct import Reconstruction, prepare_reconstruction
from hhr_dolfinx.reduction.reduced import project
from hhr_dolfinx.reduction.rid import IndexSets, reduced_domain
from hhr_dolfinx.snapshots.solutions import SnapshotSet


@dataclass(frozen=True)
class PlasticSettings:
    """How to reduce a scene that flows; tolerances are epsilon of (1.53).

    Attributes:
        primal, dual, stress, plastic_strain: tolerances of the bases whose DEIM points make the RID (section 6.2.3).
        layers: layers of cells added around, to begin with.
        most_layers: layers up to which the RID grows until the projected tangents are positive.
        zone_nodes: nodes added to the RID; None takes one node for each load.
        kappa_max: kappa(B~1) down to which FE functions are added.
        least_tangent: smallest eigenvalue wanted of the projected tangents, see :func:`tangent_margin`; of
            twenty recipes for the pellet all above 0.1 kept within 5 % of the displacement at every step; all below
            -0.2 left it at some step, by up to 26 %, or failed.
        checked_states: training states of each history at which tangents are checked.
    """

    primal: float = 1e-9
    dual: float = 1e-8
    stress: float = 1e-9
    plastic_strain: float = 1e-6
    layers: int = 3
    most_layers: int = 8
    zone_nodes: tuple[int, ...] | None = None
    kappa_max: float = 1.0
    least_tangent: float = 0.1
    checked_states: int = 4


class PlasticReduced:
    """Equilibrium of the reduced unknown gamma for :func:`hhr_dolfinx.flow.quasi_static.march`.

    Args:
        full: the full model, of which only arrays are kept.
        basis: V, (N, ell).
        sets: index sets of the RID.
    """

    def __init__(self, full, basis: np.ndarray, sets: IndexSets):
        problem, operator = full.problem, full.operator
        self.sets, self.basis = sets, basis
        self.amplitudes, self.parameters = problem.amplitudes, problem.parameters
        self.size, self.conditions = basis.shape[1], len(sets.A_lambda)
        inside = np.zeros(problem.free.size, dtype=bool)
        inside[sets.A] = True
        # cells of the RID without a dof of A act on no test function
        self.cells = np.flatnonzero(inside[operator.dofs].any(axis=1))
        self.operator, columns = operator.restricted(self.cells)
        per_cell = operator.weights.shape[1]
        self.points = (self.cells[:, None] * per_cell + np.arange(per_cell)).ravel()
        self.material = full.material.restricted(self.points)
        self._pattern = self.operator.pattern()
        self._trial, self._lifts = np.ascontiguousarray(basis[columns]), problem.lifts[columns]
        self._lifted = bool(np.any(self._lifts))
        self._sizes = abs(self.operator.stiffness(self.material.elastic, self._pattern))
        self._rows = np.flatnonzero(inside[columns])
        self._test = np.ascontiguousarray(self._trial[self._rows].T)
        self._external = self._test @ full.external[columns[self._rows]]
        self.reduced = project(problem, basis, sets)
        self._elastic = _Operator(self.reduced.stiffness, self.reduced)
        # the elastic part of K~ is known: online only what flow changes is projected
        self._unchanged = ElasticPart(self.material.elastic, np.zeros(self._pattern.indices.size))

    def strain(self, x, theta):
        """Strain at the Gauss points of the RID; without lift where ``theta`` is None."""
        field = self._trial @ x
        if self._lifted and theta is not None:
            field += self._lifts @ theta
        return self.operator.strain(field)

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

    def tangent(self, tangents) -> np.ndarray:
        """Projected consistent tangent V[A]^T K_T V, (ell, ell)."""
        change = self.operator.stiffness(tangents, self._pattern, self._unchanged)
        return self.reduced.stiffness + self._test @ _product(change, self._rows, self._trial)

    def linearise(self, tangents):
        """Project and factor the tangent, or take the elastic operator."""
        self._now = self._elastic if tangents is None else _Operator(self.tangent(tangents), self.reduced)

    def correct(self, residual, x, theta, active) -> Correction:
        """Solve one linearised contact problem; see :class:`Equilibrium`."""
        free = self._now.factor.solve(residual)
        slack = self.reduced.gaps @ theta - self.reduced.contact_trial @ (x + free)
        found = active_set(self._now.equalities, slack, active)
        change = free - self._now.per_force @ found.forces
        return Correction(change, found.forces, found.active, found.status is Status.CONVERGED)


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
    """LU of a projected stiffness with the equality problems on it."""

    def __init__(self, stiffness, reduced):
        self.factor = LapackLU(stiffness)
        self.per_force = self.factor.solve(reduced.contact_test.T)
        self.equalities = SchurEqualities.of(reduced.contact_trial @ self.per_force, LapackLU)


class GappyField(NamedTuple):
    """A field of the Gauss points from its values in the RID (gappy POD, section 6.2.3).

    Attributes:
        modes: POD modes of training states, (values everywhere, modes).
        fit: amplitudes of the modes per value in the RID, (modes, values in the RID).
    """

    modes: np.ndarray
    fit: np.ndarray

    def everywhere(self, inside: np.ndarray) -> np.ndarray:
        """The field everywhere, fitted to its values in the RID by least squares."""
        return self.modes @ (self.fit @ inside)


@dataclass(frozen=True)
class PlasticReduction:
    """A reduced model of a scene that flows, with what completes it.

    Attributes:
        model: equilibrium of gamma, for :func:`hhr_dolfinx.flow.quasi_static.march`.
        forces: contact forces outside the RID, (1.70)-(1.71).
        stress: how the stress is completed.
        cumulated: how the cumulated plastic strain is completed; None where nothing flowed in training.
        enrichment: how the basis was enriched.
        layers: layers of cells of the RID.
        gauss_points: number of Gauss points of the full model.
        tangent: smallest real part of the eigenvalues of the projected tangents, see :func:`tangent_margin`.
        refused: attempts that were given up, and why.
    """

    model: PlasticReduced
    forces: Reconstruction
    stress: GappyField
    cumulated: GappyField | None
    enrichment: Enrichment
    layers: int
    gauss_points: int
    tangent: float
    refused: list[dict]

    def displacement_everywhere(self, point: Point) -> np.ndarray:
        """Displacement on the whole mesh, (N,)."""
        return self.forces.displacement(point.unknown, self.model.amplitudes(point.parameter))

    def forces_everywhere(self, point: Point) -> np.ndarray:
        """Contact forces on the whole surface, (N_lambda,)."""
        answer = ContactSolution(point.unknown, point.forces, point.active, 1, Status.CONVERGED, False)
        return self.forces.forces(answer, self.model.amplitudes(point.parameter))

    def plastic_strain_everywhere(self, point: Point) -> np.ndarray:
        """Cumulated plastic strain at all Gauss points, (points,): the model's own in the RID, fitted elsewhere."""
        if self.cumulated is None:
            return np.zeros(self.gauss_points)
        everywhere = np.maximum(self.cumulated.everywhere(point.state.cumulated), 0.0)
        everywhere[self.model.points] = point.state.cumulated
        return everywhere

    def stress_everywhere(self, point: Point) -> np.ndarray:
        """Stress at all Gauss points, (points, components): the model's own in the RID, fitted elsewhere."""
        everywhere = self.stress.everywhere(point.stress.ravel()).reshape(self.gauss_points, -1)
        everywhere[self.model.points] = point.stress
        return everywhere


def build_plastic_reduction(
    full, histories: list[History], settings: PlasticSettings = PlasticSettings()
) -> PlasticReduction:
    """Build a reduced model whose projected tangents are well positive at training states, or refuse.

    A RID that is too small for its modes makes the projected consistent tangent indefinite under flow; steps then
    fail, or converge to a wrong path with the smallest residuals. The elastic operator shows nothing of it.

    Args:
        full: the full model, a :class:`hhr_dolfinx.full_order.plastic.PlasticFullOrder`.
        histories: its training histories.
        settings: how to reduce.

    Raises:
        ReductionError: if there is nothing to train on.
        UnstableModelError: if tangents are still not positive at ``most_layers``.
        NotSolvableError: if contact rows are dependent on the basis, (5.24)-(5.25).
    """
    if not histories or not all(history.points for history in histories):
        raise ReductionError("a reduced model needs at least one training history, each with at least one step")
    basis, nodes = snapshot_nodes(full, histories, settings)
    states = _training_tangents(full, histories, settings.checked_states)
    refused = []
    for layers in range(settings.layers, max(settings.layers, settings.most_layers) + 1):
        sets = reduced_domain(full.problem, nodes, layers)
        enrichment = enrich(full.problem, basis, sets, settings.kappa_max)
        if not np.isfinite(enrichment.kappas[-1]):
            raise NotSolvableError("the contact rows are dependent on the reduced basis, thesis (5.24)-(5.25)")
        model = PlasticReduced(full, enrichment.basis, sets)
        margin = min((tangent_margin(model, *state) for state in states), default=1.0)
        if margin > settings.least_tangent:
            return PlasticReduction(
                model,
                *_completion(full, model, histories, settings),
                enrichment,
                layers,
                full.operator.points,
                margin,
                refused,
            )
        refused.append({"layers": layers, "why": f"a projected tangent has an eigenvalue of real part {margin:.2g}"})
    raise UnstableModelError(
        f"with {layers} layers a projected tangent at a training state still has an eigenvalue of real part "
        f"{margin:.2g}: steps would fail or follow a wrong path. Allow more layers or keep fewer modes"
    )


def tangent_margin(model: PlasticReduced, tangents: np.ndarray, stiffness) -> float:
    """Smallest real part of the eigenvalues of V[A]^T K_T V relative to V^T K_T V, 1 where the RID is everything.

    Args:
        model: the reduced model.
        tangents: consistent tangents at all Gauss points of the full model.
        stiffness: K_T of the full model.
    """
    whole = model.basis.T @ (stiffness @ model.basis)
    return float(linalg.eigvals(np.linalg.solve(whole, model.tangent(tangents[model.points]))).real.min())


def _training_tangents(full, histories, count):
    """Tangents and stiffness of the full model at some states of each history, the last one among them."""
    states = []
    for history in histories:
        steps = np.unique(np.linspace(0, len(history.points), count + 1).astype(int)[1:]) - 1
        for step in steps:
            here = history.points[step]
            time, state = history.start, full.material.at_rest()
            if step > 0:
                time, state = history.points[step - 1].time, history.points[step - 1].state
            strain = full.strain(here.unknown, full.amplitudes(here.parameter))
            tangents = full.material.update(strain, state, here.time - time, tangent=True).tangents
            states.append((tangents, full.stiffness(tangents)))
    return states if full.material.flows else []


def _completion(full, model, histories, settings):
    """Reconstruction of contact forces, of the stress and of the cumulated plastic strain."""
    points = [point for history in histories for point in history.points]
    columns = (np.stack([getattr(p, name) for p in points], axis=1) for name in ("unknown", "forces", "active"))
    snapshots = SnapshotSet(np.stack([point.parameter for point in points]), *columns)
    forces = prepare_reconstruction(full.problem, model.basis, model.sets, snapshots)
    components = full.material.components
    values = (model.points[:, None] * components + np.arange(components)).ravel()
    stress = _gappy(np.stack([point.stress.ravel() for point in points], axis=1), values, settings.stress)
    cumulated = np.stack([point.state.cumulated for point in points], axis=1)
    if not np.any(cumulated):
        return forces, stress, None
    return forces, stress, _gappy(cumulated, model.points, settings.plastic_strain)


def _gappy(snapshots, inside, tolerance) -> GappyField:
    modes, _ = pod(snapshots, tolerance)
    return GappyField(modes, np.linalg.pinv(modes[inside]))


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
    unknown, forces, stress = (
        np.concatenate([history.stack(name) for history in histories], axis=-1)
        for name in ("unknown", "forces", "stress")
    )
    basis, _ = pod(unknown, settings.primal)
    zone = loaded_nodes(problem) if settings.zone_nodes is None else np.array(settings.zone_nodes, dtype=np.int64)
    nodes = [deim(basis) // problem.block_size, zone]
    if np.any(forces):
        nodes.append(problem.contact_slaves[deim(pod(forces, settings.dual)[0])])
    points = [deim(pod(stress.reshape(-1, stress.shape[-1]), settings.stress)[0]) // full.material.components]
    cumulated = np.stack([point.state.cumulated for history in histories for point in history.points], axis=1)
    if np.any(cumulated):
        points.append(deim(pod(cumulated, settings.plastic_strain)[0]))
    nodes.append(problem.cell_nodes[full.cell_of_point[np.concatenate(points)]].ravel())
    return basis, np.unique(np.concatenate(nodes))
