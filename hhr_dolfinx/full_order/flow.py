"""Equilibrium of the full mesh for bodies that flow, thesis Alg. 6.1: Newton or elastic search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, active_set
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.full_order.gauss_points import material_at, strain_operator
from hhr_dolfinx.linear.sparse import FreeCholesky
from hhr_dolfinx.materials.constants import check_law
from hhr_dolfinx.materials.strain import ElasticPart, SparsePattern, StrainOperator
from hhr_dolfinx.materials.update import Material
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.equilibrium import Correction
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.trained import Signs

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.full import FullOrderModel


@dataclass(frozen=True)
class GaussModel:
    """Gauss points and laws of a whole mesh.

    Attributes:
        discretisation: mesh and forms.
        operator: strain at all Gauss points.
        material: laws at all Gauss points.
        bodies: body of each cell as its place in the scene, (cells,).
        pattern: sparsity of the stiffness.
        stiffness: elastic stiffness by the same Gauss points, (N, N).
    """

    discretisation: Discretisation
    operator: StrainOperator
    material: Material
    bodies: np.ndarray
    pattern: SparsePattern
    stiffness: csr_matrix

    @classmethod
    def of(cls, scene: Scene, comm: MPI.Comm) -> GaussModel:
        """The Gauss points of a scene.

        Raises:
            SceneError: for a law whose constants are impossible somewhere in the box of the parameters.
        """
        if scene.hypothesis == "plane_stress":
            raise SceneError("flow in plane stress needs the thickness strain solved for: not built in")
        for body in scene.bodies:
            check_law(body.law, scene.parameters, f"body {body.tag} of scene '{scene.name}'")
        discretisation = Discretisation(scene, comm)
        operator, bodies = strain_operator(discretisation), discretisation.cell_bodies()
        material, pattern = material_at(scene, bodies, operator), operator.pattern()
        stiffness = operator.stiffness(material.elastic, pattern)
        return cls(discretisation, operator, material, bodies, pattern, stiffness)


class FullEquilibrium:
    """Equilibrium of U0, see :class:`hhr_dolfinx.models.equilibrium.Equilibrium`; serial.

    Args:
        full: the full model, whose elastic factors are used.
        gauss: Gauss points and laws.

    Attributes:
        lock: held through a history, lest two of them take turns in factoring; they are right without it.
    """

    trained = None

    def __init__(self, full: FullOrderModel, gauss: GaussModel):
        problem = full.problem
        self.fields = self._full = full
        self.problem, self.operator, self.material = problem, gauss.operator, gauss.material
        self.amplitudes, self.parameters = problem.amplitudes, problem.parameters
        self.size, self.conditions = problem.free.size, problem.contact.shape[0]
        self.points, self.per_cell = np.arange(self.operator.gauss_points), self.operator.per_cell
        self._pattern, self._pairs = gauss.pattern, Pairs.of(problem.contact_pairs)
        self._unchanged = ElasticPart(self.material.elastic, gauss.stiffness.data.copy())
        # made for solving, while those of tangents are made for factoring: on one core, in the plane at 13,700 dofs,
        # nd takes 31 ms to factor and 1.1 ms to solve, qmd 53 and 1.4 ms
        self._tangent_solver: FreeCholesky | None = None
        self.lock = RLock()
        factors, push = (gauss.stiffness, full._solver), full.per_force.__matmul__
        self.elastic = _SparseLinearisation(
            problem, self._pairs, factors, full._equalities, push, self.material.elastic
        )
        self._body = np.zeros(self.size, dtype=int)
        self._body[self.operator.dofs] = gauss.bodies[:, None]
        self._sizes = abs(gauss.stiffness)
        self._transposed, self._lifted = problem.contact.T.tocsr(), bool(problem.lifts.nnz)

    def strain(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Strain of U0 + lift at all Gauss points."""
        return self.operator.strain(x + self.problem.lifts @ theta if self._lifted else x)

    def strain_of(self, change: np.ndarray) -> np.ndarray:
        """Strain of a change of U0 at all Gauss points."""
        return self.operator.strain(change)

    def contact_load(self, forces: np.ndarray) -> np.ndarray:
        """B^T λ."""
        return self._transposed @ forces

    def gaps(self, theta: Theta) -> np.ndarray:
        """Gaps less the lift, (N_lambda,)."""
        return self.problem.gaps @ theta

    def residual(self, stress: np.ndarray, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
        """Loads less internal forces on free dofs, and the norm of what they are made of in each body."""
        loads, (internal, size) = self.problem.external @ theta, self.operator.internal(stress)
        free = self.problem.free
        return loads - internal * free, self.norms(np.abs(loads) + size * free)

    def norms(self, residual: np.ndarray) -> np.ndarray:
        """Norm of a residual on the dofs of each body, (bodies,)."""
        return np.sqrt(np.bincount(self._body, residual**2))

    def round_off(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Residual that comes of adding stiffness times displacement in double precision, (bodies,)."""
        return 1e-13 * self.norms(self._sizes @ np.abs(x + self.problem.lifts @ theta))

    def stiffness(self, tangents: np.ndarray) -> csr_matrix:
        """K_T of consistent tangents at all Gauss points, (N, N)."""
        return self.operator.stiffness(tangents, self._pattern, self._unchanged)

    def signs(self, answer: Answer) -> Signs:
        """Residual of the free dofs and its parts; gaps are kept to the tolerance of the solver."""
        residual, sizes = self.residual(answer.state().stress, self.amplitudes(answer.parameter))
        left = (residual - self.contact_load(answer.multipliers)) * self.problem.free
        return Signs(float(np.linalg.norm(left)), float(np.linalg.norm(sizes)), 0.0)

    def linearised(self, tangents: np.ndarray) -> _SparseLinearisation:
        """Factor the tangent stiffness; the linearisation before needs a factorisation again."""
        stiffness = self.stiffness(tangents)
        with self.lock:
            solver = self._tangent_solver
            if solver is None:
                solver = self._tangent_solver = self._full.factors_of(stiffness, "nd")
            else:
                solver.refactor(stiffness)
        columns = _LazyColumns(solver, self.problem.contact)
        equalities = SchurEqualities(columns.images, self.conditions)
        factors = stiffness, solver
        return _SparseLinearisation(self.problem, self._pairs, factors, equalities, columns.push, tangents)


@dataclass(frozen=True)
class _SparseLinearisation:
    """A linearisation of the full problem, see :class:`hhr_dolfinx.models.equilibrium.Linearisation`.

    Attributes:
        problem: the full problem.
        pairs: its conditions by contact pair.
        factors: K, (N, N), and its solver, which may hold the factors of another linearisation meanwhile.
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

    def correct(self, residual: np.ndarray, x: np.ndarray, theta: Theta, active: np.ndarray) -> Correction:
        """Solve K δ + B^T λ = residual, B (x + δ) <= gaps."""
        problem, (stiffness, solver) = self.problem, self.factors
        # one solver serves all linearisations: columns of S are solved for within the active set
        with solver.lock:
            solver.refactor(stiffness)
            free = solver.solve(residual)
            slack = problem.gaps @ theta - problem.contact @ (x + free)
            found = active_set(self.equalities, slack, active, pairs=self.pairs)
        return Correction(free - self.push(found.forces), found)

    def changed(self, residual: np.ndarray, gaps: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve K δ + B^T λ = residual, B δ = gaps where active, λ = 0 elsewhere."""
        stiffness, solver = self.factors
        with solver.lock:
            solver.refactor(stiffness)
            free = solver.solve(residual)
            forces, _ = self.equalities(active, gaps - self.problem.contact @ free)
            return free - self.push(forces), forces


class _LazyColumns:
    """K^-1 B^T and S = B K^-1 B^T by columns, solved for when their conditions first become active, all at once."""

    def __init__(self, solver: FreeCholesky, contact: csr_matrix):
        self._solver, self._contact = solver, contact
        self._columns: dict[int, np.ndarray] = {}
        self._images: dict[int, np.ndarray] = {}

    def images(self, index: np.ndarray) -> np.ndarray:
        """Columns of S as rows, (k, m); see :class:`SchurEqualities`."""
        new = [k for k in index.tolist() if k not in self._columns]
        if new:
            columns = self._solver.solve_columns(self._contact[new].T)
            images = self._contact @ columns
            for place, k in enumerate(new):
                self._columns[k], self._images[k] = columns[:, place], images[:, place]
        return np.array([self._images[k] for k in index.tolist()]).reshape(index.size, self._contact.shape[0])

    def push(self, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T λ for forces on conditions that were active, (N,)."""
        pushed = np.zeros(self._contact.shape[1])
        for k in np.flatnonzero(forces).tolist():
            pushed += forces[k] * self._columns[k]
        return pushed
