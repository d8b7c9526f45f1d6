"""Full-order model of bodies that flow, thesis Alg. 6.1: Newton or elastic search on the finite element mesh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from threading import RLock

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, active_set
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.full_order.checks import check_regular
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.full_order.gauss_points import material_at, strain_operator
from hhr_dolfinx.linear.sparse import FreeCholesky, ordering_of
from hhr_dolfinx.materials.strain import ElasticPart
from hhr_dolfinx.models.equilibrium import Correction
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.trained import Signs


class PlasticFullOrder:
    """Equilibrium of the full mesh for :func:`hhr_dolfinx.models.march.march`; serial.

    Args:
        scene: the scene; bodies without a law are elastic.

    Attributes:
        problem: the :class:`ContactProblem`, whose stiffness is the elastic one under the same quadrature.
        operator: strain at all Gauss points.
        material: laws at all Gauss points.
        schur: S = B K^-1 B^T of the elastic stiffness, (N_lambda, N_lambda).
        elastic: the elastic linearisation.
        size, conditions: N and N_lambda.
        points: numbers of the Gauss points, all of them.
        cell_of_point: cell of each Gauss point.
        discretisation: mesh and forms.
        trained: None, since nothing is outside what a full model can answer.
        lock: to be held through a history, lest two of them take turns in factoring; they are right without it.
    """

    trained = None

    def __init__(self, scene: Scene):
        if not isinstance(scene, Scene):
            raise SceneError(f"{scene!r} is no scene: give a Scene")
        self.scene = scene
        if scene.hypothesis == "plane_stress":
            raise SceneError("flow in plane stress needs the thickness strain solved for: not built in")
        self.discretisation = Discretisation(scene, MPI.COMM_SELF)
        self.operator, bodies = strain_operator(self.discretisation), self.discretisation.cell_bodies()
        self.cell_of_point = np.repeat(np.arange(len(bodies)), self.operator.per_cell)
        self.material = material_at(scene, bodies, self.operator)
        self._pattern = self.operator.pattern()
        stiffness = self.operator.stiffness(self.material.elastic, self._pattern)
        self._unchanged = ElasticPart(self.material.elastic, stiffness.data.copy())
        self.problem = problem = self.discretisation.contact_problem(stiffness)
        self.discretisation.check(problem)
        self.amplitudes, self.parameters = problem.amplitudes, problem.parameters
        self.size, self.conditions = problem.free.size, problem.contact.shape[0]
        solver = self._factored(stiffness)
        check_regular(problem, solver.solve, scene.name)
        per_force = solver.solve_columns(problem.contact.T)
        self.schur = problem.contact @ per_force
        equalities = SchurEqualities.of(self.schur)
        self._pairs = Pairs.of(problem.contact_pairs)
        factors = stiffness, solver
        self.elastic = _Operator(problem, self._pairs, factors, equalities, per_force.__matmul__, self.material.elastic)
        self._tangent_solver, self.lock = None, RLock()
        self._body = np.zeros(self.size, dtype=int)
        self._body[self.operator.dofs] = bodies[:, None]
        self._sizes = abs(stiffness)
        self.points = np.arange(self.operator.gauss_points)
        self._transposed, self._lifted = problem.contact.T.tocsr(), bool(np.any(problem.lifts))

    def strain(self, x, theta):
        """Strain of U0 + lift at all Gauss points."""
        return self.operator.strain(x + self.problem.lifts @ theta if self._lifted else x)

    def strain_of(self, change):
        """Strain of a change of U0 at all Gauss points."""
        return self.operator.strain(change)

    def contact_load(self, forces):
        """B^T λ."""
        return self._transposed @ forces

    def residual(self, stress, theta):
        """Loads less internal forces on free dofs, and the norm of what they are made of in each body."""
        loads, (internal, size) = self.problem.external @ theta, self.operator.internal(stress)
        free = self.problem.free
        return loads - internal * free, self.norms(np.abs(loads) + size * free)

    def norms(self, residual):
        """Norm of a residual on the dofs of each body, (bodies,)."""
        return np.sqrt(np.bincount(self._body, residual**2))

    def round_off(self, x, theta):
        """Residual that comes of adding stiffness times displacement in double precision, (bodies,)."""
        return 1e-13 * self.norms(self._sizes @ np.abs(x + self.problem.lifts @ theta))

    def displacement(self, point):
        """Displacement of a point of a history, lift included, (N,)."""
        return point.unknown + self.problem.lifts @ self.amplitudes(point.parameter)

    def stiffness(self, tangents):
        """K_T of consistent tangents at all Gauss points, (N, N)."""
        return self.operator.stiffness(tangents, self._pattern, self._unchanged)

    def signs(self, point) -> Signs:
        """Residual of the free dofs and its parts; gaps are kept to the tolerance of the solver."""
        residual, sizes = self.residual(point.stress, self.amplitudes(point.parameter))
        left = (residual - self.contact_load(point.forces)) * self.problem.free
        return Signs(float(np.linalg.norm(left)), float(np.linalg.norm(sizes)), 0.0)

    def linearised(self, tangents) -> _Operator:
        """Factor the tangent stiffness; the operator before needs a factorisation again. See :class:`Equilibrium`."""
        stiffness = self.stiffness(tangents)
        with self.lock:
            if self._tangent_solver is None:
                self._tangent_solver = self._factored(stiffness)
            else:
                self._tangent_solver.refactor(stiffness)
        columns = _LazyColumns(self._tangent_solver, self.problem.contact)
        equalities = SchurEqualities(columns.images, self.conditions)
        factors = stiffness, self._tangent_solver
        return _Operator(self.problem, self._pairs, factors, equalities, columns.push, tangents)

    def _factored(self, stiffness) -> FreeCholesky:
        """Factors that are made again and again.

        On one core: 31 ms and 1.1 ms a solve at 13,700 dofs in the plane with nd, against 53 and 1.4 ms with qmd.
        """
        ordering = ordering_of(self.problem.block_size, "nd")
        return FreeCholesky(stiffness, self.problem.free, self.scene.name, ordering)


@dataclass(frozen=True)
class _Operator:
    """A linearisation, see :class:`hhr_dolfinx.models.equilibrium.Operator`.

    Attributes:
        problem: the full problem.
        pairs: its conditions by contact pair.
        factors: K, (N, N), and its solver, which may hold the factors of another operator meanwhile.
        equalities: on S = B K^-1 B^T.
        push: maps forces to K^-1 B^T λ, (N,).
        moduli: tangents at the Gauss points.
    """

    problem: ContactProblem
    pairs: Pairs | None
    factors: tuple[csr_matrix, FreeCholesky]
    equalities: SchurEqualities
    push: Callable[[np.ndarray], np.ndarray]
    moduli: np.ndarray

    def correct(self, residual, x, theta, active) -> Correction:
        """Solve K δ + B^T λ = residual, B (x + δ) <= gaps."""
        problem, (stiffness, solver) = self.problem, self.factors
        # one solver serves all linearisations: columns of S are solved for within the active set
        with solver.lock:
            solver.refactor(stiffness)
            free = solver.solve(residual)
            slack = problem.gaps @ theta - problem.contact @ (x + free)
            found = active_set(self.equalities, slack, active, pairs=self.pairs)
        return Correction(free - self.push(found.forces), found.forces, found.active, found.status)


class _LazyColumns:
    """K^-1 B^T and S = B K^-1 B^T by columns, solved for when their conditions first become active, all at once."""

    def __init__(self, solver: FreeCholesky, contact):
        self._solver, self._contact, self._columns, self._images = solver, contact, {}, {}

    def images(self, index: np.ndarray) -> np.ndarray:
        """Columns of S as rows, (k, m); see :class:`SchurEqualities`."""
        new = [k for k in index if k not in self._columns]
        if new:
            columns = self._solver.solve_columns(self._contact[new].T)
            images = self._contact @ columns
            for place, k in enumerate(new):
                self._columns[k], self._images[k] = columns[:, place], images[:, place]
        return np.array([self._images[k] for k in index]).reshape(index.size, self._contact.shape[0])

    def push(self, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T λ for forces on conditions that were active, (N,)."""
        pushed = np.zeros(self._contact.shape[1])
        for k in np.flatnonzero(forces):
            pushed += forces[k] * self._columns[k]
        return pushed
