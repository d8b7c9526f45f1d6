"""Full-order model of bodies that flow, thesis Alg. 6.1: Newton or elastic search on the finite element mesh."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from hhr_dolfinx.contact.active_set import SchurEqualities, active_set
from hhr_dolfinx.errors import NotSolvableError, SceneError
from hhr_dolfinx.flow.gauss import ElasticPart
from hhr_dolfinx.flow.material import Group, Material
from hhr_dolfinx.flow.quasi_static import Correction
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.full_order.elastic import singular_stiffness
from hhr_dolfinx.scene import Scene


class PlasticFullOrder:
    """Equilibrium of the full mesh for :func:`hhr_dolfinx.flow.quasi_static.march`; serial.

    Args:
        scene: the scene; bodies without a law are elastic.

    Attributes:
        problem: the :class:`ContactProblem`, whose stiffness is the elastic one under the same quadrature.
        operator: strain at all Gauss points.
        material: laws at all Gauss points.
        cell_of_point: cell of each Gauss point.
        discretisation: mesh and forms.
    """

    def __init__(self, scene: Scene):
        self.scene = scene
        if scene.hypothesis == "plane_stress":
            raise SceneError("flow in plane stress needs the thickness strain solved for: not built in")
        self.discretisation = Discretisation(scene, MPI.COMM_SELF)
        self.operator, bodies = self.discretisation.strain_operator()
        per_cell = self.operator.weights.shape[1]
        self.cell_of_point = np.repeat(np.arange(len(bodies)), per_cell)
        points = [np.flatnonzero(bodies[self.cell_of_point] == place) for place in range(len(scene.bodies))]
        groups = [Group(p, b.young, b.poisson, b.law) for p, b in zip(points, scene.bodies, strict=True)]
        self.material = Material(groups, self.operator.components)
        self._pattern = self.operator.pattern()
        stiffness = self.operator.stiffness(self.material.elastic, self._pattern)
        self._elastic = ElasticPart(self.material.elastic, stiffness.data.copy())
        self.problem = problem = self.discretisation.contact_problem(_petsc(stiffness))
        self.amplitudes, self.parameters = problem.amplitudes, problem.parameters
        self.external = self.problem.loads + (stiffness @ problem.lifts) * problem.free[:, None]
        self.size, self.conditions = problem.free.size, problem.contact.shape[0]
        self._solver = _Cholesky(stiffness, problem.free, scene.name)
        rows = problem.contact.toarray()
        self.per_force = np.stack([self._solver.solve(row).copy() for row in rows], axis=1)
        self.schur = problem.contact @ self.per_force
        self._equalities = SchurEqualities(self.schur)
        self._check_regular()
        self._tangent_solver = None
        self._body = np.zeros(self.size, dtype=int)
        self._body[self.operator.dofs] = bodies[:, None]
        self._sizes = abs(stiffness)
        self.points = np.arange(self.operator.points)
        self._transposed, self._lifted = problem.contact.T.tocsr(), bool(np.any(problem.lifts))

    def _check_regular(self):
        """Refuse a singular elastic stiffness, which a factorisation does not always notice."""
        known = np.random.default_rng(0).standard_normal(self.size) * self.problem.free
        found = self._solver.solve(self.problem.stiffness @ known * self.problem.free)
        if not np.linalg.norm(found - known) <= 1e-3 * np.linalg.norm(known):
            raise NotSolvableError(singular_stiffness(self.scene.name))

    def strain(self, x, theta):
        """Strain of U0 + lift at all Gauss points; of U0 alone where ``theta`` is None."""
        return self.operator.strain(x if theta is None or not self._lifted else x + self.problem.lifts @ theta)

    def contact_load(self, forces):
        """B^T λ."""
        return self._transposed @ forces

    def residual(self, stress, theta):
        """Loads less internal forces on free dofs, and the norm of what they are made of in each body."""
        loads, (internal, size) = self.external @ theta, self.operator.internal(stress)
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
        return self.operator.stiffness(tangents, self._pattern, self._elastic)

    def linearise(self, tangents):
        """Factor the tangent stiffness, or take the elastic one; see :class:`Equilibrium`."""
        if tangents is None:
            self._now = self._solver, self._equalities, self.per_force
            return
        stiffness = self.stiffness(tangents)
        if self._tangent_solver is None:
            self._tangent_solver = _Cholesky(stiffness, self.problem.free, self.scene.name)
        else:
            self._tangent_solver.refactor(stiffness)
        columns = _LazyColumns(self._tangent_solver, self.problem.contact)
        self._now = self._tangent_solver, columns, columns

    def correct(self, residual, x, theta, active) -> Correction:
        """Solve one linearised contact problem; see :class:`Equilibrium`."""
        problem, (solver, equalities, columns) = self.problem, self._now
        free = solver.solve(residual).copy()
        slack = problem.gaps @ theta - problem.contact @ (x + free)
        found = active_set(equalities, slack, active)
        pushed = columns[:, found.active] @ found.forces[found.active]
        return Correction(free - pushed, found.forces, found.active, found.status.name == "CONVERGED")


class _LazyColumns:
    """K^-1 B^T and the equality problems on it, with columns solved when a condition becomes active."""

    def __init__(self, solver, contact):
        self._solver, self._contact, self._columns, self._images = solver, contact, {}, {}

    def __getitem__(self, key):
        _, active = key
        chosen = [self._column(k) for k in np.flatnonzero(active)]
        return np.stack(chosen, axis=1) if chosen else np.zeros((self._contact.shape[1], 0))

    def _column(self, k):
        if k not in self._columns:
            column = self._solver.solve(self._contact[k].toarray().ravel()).copy()
            self._columns[k], self._images[k] = column, self._contact @ column
        return self._columns[k]

    def __call__(self, active, free_slack):
        """Forces and slacks for given statuses; see :class:`SchurEqualities`."""
        index, forces = np.flatnonzero(active), np.zeros(active.size)
        if index.size == 0:
            return forces, free_slack
        for k in index:
            self._column(k)
        images = np.stack([self._images[k] for k in index], axis=1)
        forces[index] = np.linalg.solve(images[index], -free_slack[index])
        slack = free_slack + images @ forces[index]
        slack[index] = 0.0
        return forces, slack


def _petsc(matrix) -> PETSc.Mat:
    """Copy of a sparse matrix on one rank."""
    return PETSc.Mat().createAIJ(matrix.shape, csr=(matrix.indptr, matrix.indices, matrix.data), comm=PETSc.COMM_SELF)


class _Cholesky:
    """Factors of a stiffness on its free dofs, whose pattern does not change."""

    def __init__(self, stiffness, free, name):
        self._free, self._name = np.flatnonzero(free), name
        self._inside = stiffness[self._free][:, self._free]
        # place of each kept entry in the data of the whole matrix
        marks = stiffness.copy()
        marks.data = np.arange(1.0, marks.nnz + 1)
        self._places = (marks[self._free][:, self._free].data - 1).astype(np.int64)
        self._matrix = _petsc(self._inside)
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        self._ksp.setOptionsPrefix(f"hhr_{name}_plastic_")
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        pc = self._ksp.getPC()
        pc.setType(PETSc.PC.Type.CHOLESKY)
        # factored again and again: 31 ms and 1.1 ms a solve at 13,700 dofs, against 53 and 1.4 ms with qmd
        pc.setFactorOrdering("nd")
        self._ksp.setOperators(self._matrix)
        self._ksp.setFromOptions()
        try:
            self._ksp.setUp()
        except PETSc.Error as error:
            raise NotSolvableError(singular_stiffness(name)) from error
        self._rhs, self._x = self._matrix.createVecs()
        self._out = np.zeros(free.size)

    def refactor(self, stiffness) -> None:
        """Take the values of another matrix with the same pattern."""
        data = stiffness.data[self._places]
        self._matrix.setValuesCSR(self._inside.indptr, self._inside.indices, data)
        self._matrix.assemble()
        self._ksp.setOperators(self._matrix)
        try:
            self._ksp.setUp()
            failed = self._ksp.getPC().getFailedReason() != 0
        except PETSc.Error:
            failed = True
        if failed:
            raise NotSolvableError(f"the tangent stiffness of scene '{self._name}' is singular")

    def solve(self, rhs) -> np.ndarray:
        """Solution on all dofs, zero on imposed ones; the next call overwrites it."""
        self._rhs.array[:] = rhs[self._free]
        self._ksp.solve(self._rhs, self._x)
        self._out[self._free] = self._x.array_r
        return self._out
