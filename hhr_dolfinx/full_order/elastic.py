"""Full-order model: the finite element contact problem (1.21), solved on any number of ranks."""

from __future__ import annotations

from threading import Lock

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from hhr_dolfinx import ranks
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, active_set
from hhr_dolfinx.contact.problem import ContactSolution, Status, outcome
from hhr_dolfinx.errors import NotSolvableError, SceneError
from hhr_dolfinx.full_order.checks import check_regular
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.linear.dense import factorised
from hhr_dolfinx.linear.sparse import cholesky_solver, singular_stiffness, solve_columns
from hhr_dolfinx.scene import Scene

FULL_ORDER_ADVICE = {Status.SINGULAR: "list each contact pair once, and let no two conditions hold the same dofs"}


class FullOrderModel:
    """Solves the full problem with K factored once and the contact on its Schur complement.

    Every query costs one solve with K, the statuses on S = B K^-1 B^T, and u = K^-1 F - K^-1 B^T lambda.
    The answer is the same on every rank. PETSc options take the prefix ``hhr_<scene>_``. On one rank several threads
    may ask; on more they must not, since the ranks would meet in different orders.

    Args:
        scene: the scene.
        comm: MPI communicator.

    Attributes:
        problem: the gathered :class:`ContactProblem`.
        comm: MPI communicator.
        discretisation: mesh and forms.
        per_force: K^-1 B^T on the dofs of this rank, (own dofs, N_lambda).
        schur: S, (N_lambda, N_lambda).
    """

    def __init__(self, scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD):
        if not isinstance(scene, Scene):
            raise SceneError(f"{scene!r} is no scene: give a Scene")
        if any(body.law is not None for body in scene.bodies):
            raise SceneError(
                f"bodies of scene '{scene.name}' flow: use PlasticFullOrder, and march along a path in time"
            )
        self.scene, self.comm = scene, comm
        with ranks.together(comm, f"building the full model of scene '{scene.name}'"):
            self._build()

    def _build(self):
        scene, comm = self.scene, self.comm
        self.discretisation = Discretisation(scene, comm)
        stiffness = self.discretisation.assemble_stiffness()
        self.problem = self.discretisation.contact_problem(self.discretisation.gathered(stiffness))
        self.discretisation.check(self.problem)
        self._own, self._lock = self.discretisation.rows, Lock()
        self._ksp = self._factor(stiffness)
        self._rhs, self._solution = (np.zeros(self._own.stop - self._own.start) for _ in range(2))
        self._vectors = [
            PETSc.Vec().createWithArray(array, size=(array.size, self.problem.free.size), comm=comm)
            for array in (self._rhs, self._solution)
        ]
        check_regular(self.problem, lambda rhs: self._gather(self.solve_stiffness(rhs[self._own])), scene.name)
        self._contact = self.problem.contact[:, self._own]
        self._own_loads = self.problem.loads[self._own]
        self.per_force = solve_columns(self._ksp, self._contact.T)
        self.schur = comm.allreduce(self._contact @ self.per_force)
        self._equalities, self._pairs = SchurEqualities.of(self.schur), Pairs.of(self.problem.contact_pairs)

    def solve(self, mu, *, start=None, raise_on_failure: bool = True) -> ContactSolution:
        """Solve for one parameter.

        Args:
            mu: number, sequence or mapping by name.
            start: statuses to start from, (N_lambda,) bool; by default where the free slack is negative.
            raise_on_failure: raise instead of returning an answer with NaN and a status.

        Returns:
            Solution whose ``primal`` is the whole displacement U0 + lift, (N,).

        Raises:
            ParameterError: if ``mu`` is not finite or outside the box.
            ConvergenceError: if the statuses do not settle.
            NotSolvableError: if contact rows are dependent.
        """
        point = self.problem.parameters.point(mu)
        theta = self.problem.amplitudes(point)
        free = self.solve_stiffness(self._own_loads @ theta)
        free_slack = self.problem.gaps @ theta - self._sum(self._contact @ free)
        start = free_slack < 0 if start is None else start
        found = active_set(self._equalities, free_slack, start, pairs=self._pairs)
        primal = self._gather(free - self.per_force @ found.forces) + self.problem.lifts @ theta
        return outcome(primal, found, point, raise_on_failure, FULL_ORDER_ADVICE)

    def _factor(self, stiffness) -> PETSc.KSP:
        """Factor K with imposed dofs eliminated.

        Measured on one core: PETSc's own Cholesky with the ordering qmd solves plane problems fastest (1.1 ms against
        2.3 ms by LU and 1.6 ms by MUMPS at 14,000 dofs), MUMPS those in space (8 ms against 13 ms at 22,000 dofs).
        """
        matrix = stiffness.copy()
        imposed = np.flatnonzero(~self.problem.free[self._own]) + self._own.start
        # a diagonal of the size of K keeps the pivots alike in any system of units
        diagonal = self.problem.stiffness.diagonal().mean()
        matrix.zeroRowsColumns(imposed.astype(PETSc.IntType), diag=diagonal)
        in_space = self.problem.block_size == 3 and PETSc.Sys.hasExternalPackage("mumps")
        ksp = cholesky_solver(matrix, "mumps" if in_space else "qmd", f"hhr_{self.scene.name}_")
        if not factorised(ksp):
            raise NotSolvableError(singular_stiffness(self.scene.name))
        return ksp

    def solve_stiffness(self, own_rhs) -> np.ndarray:
        """K^-1 times a vector, each rank with its own rows."""
        with self._lock:
            self._rhs[:] = own_rhs
            self._ksp.solve(*self._vectors)
            return self._solution.copy()

    def _sum(self, part):
        return part if self.comm.size == 1 else self.comm.allreduce(part)

    def _gather(self, own):
        return own if self.comm.size == 1 else np.concatenate(self.comm.allgather(own))
