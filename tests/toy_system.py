"""A system of a user's own, in one file: bodies on an elastic foundation whose stiffness is a
parameter, K + k M.

K is that of the bodies at the point: their moduli may be parameters.
On several ranks each has its rows of K and M, (own, N), and of the loads, (own,).
"""

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.full_order.system import System


class Foundation(System):
    """K + k M with the Gram matrix M of the L2 product; ``k`` is a parameter of the scene."""

    def __init__(self, *given):
        super().__init__(*given)
        problem = self.problem
        self.axis = problem.parameters.names.index("k")
        own = problem.own_stiffness
        rows = np.repeat(np.arange(own.shape[0]), np.diff(own.indptr))
        entries = np.asarray(csr_matrix(problem.mass)[rows, own.indices]).ravel()
        self.mass = csr_matrix((entries, own.indices, own.indptr), shape=own.shape)
        self.pulled = (
            csc_matrix(self.mass @ problem.lifts)
            .multiply(problem.free[problem.rows][:, None])
            .tocsc()
        )

    def equations(self, point, theta):
        problem, k = self.problem, point[self.axis]
        own = problem.combined(problem.weights(point)) if problem.moduli else problem.own_stiffness
        matrix = csr_matrix(
            (own.data + k * self.mass.data, own.indices, own.indptr), shape=own.shape
        )
        loads = problem.spread.of(problem.loads_at(point, theta))
        return problem, self.made(matrix, problem), loads - k * (self.pulled @ theta)

    def explicit(self, point, forces, unknown):
        left, slack = super().explicit(point, forces, unknown)
        acting, slopes = self.problem.amplitudes.slopes_at(point)
        left += point[self.axis] * (self.pulled[:, acting] @ slopes)
        left[:, self.axis] += self.mass @ unknown + self.pulled @ self.problem.amplitudes(point)
        return left, slack


class Parted(Foundation):
    """The same with parts: reductors read K and M with their weights."""

    def parts(self):
        problem, names = self.problem, self.problem.parameters.names
        moduli = problem.moduli or (Modulus("1", "1", names),)
        of_bodies = problem.stiffness_terms if problem.moduli else (problem.own_stiffness,)
        return (*moduli, Modulus("k", "1", names)), (*of_bodies, self.mass)
