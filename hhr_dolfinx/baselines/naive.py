"""The full problem as a first program would solve it: the measure of every claim of speed."""

from __future__ import annotations

import numpy as np
from scipy.sparse import bmat
from scipy.sparse.linalg import splu

from hhr_dolfinx.contact.active_set import Pairs, active_set
from hhr_dolfinx.contact.problem import ContactSolution, outcome
from hhr_dolfinx.errors import SingularError
from hhr_dolfinx.full_order.elastic import FULL_ORDER_ADVICE, FullOrderModel


class NaiveFullOrder:
    """Nothing is kept between queries.

    Each query assembles K anew, and each active-set iteration factors the saddle-point matrix
    ((K, B^T), (B, 0)) of its active contacts anew. Serial.

    Args:
        full_order: model whose scene is solved.
    """

    def __init__(self, full_order: FullOrderModel):
        if full_order.comm.size > 1:
            raise ValueError("the naive baseline is serial: run it on one rank")
        self._full = full_order

    def solve(self, mu, *, start=None, raise_on_failure: bool = True) -> ContactSolution:
        """Solve for one parameter; see :meth:`FullOrderModel.solve`."""
        problem = self._full.problem
        point = problem.parameters.point(mu)
        theta = problem.amplitudes(point)
        free = np.flatnonzero(problem.free)
        matrix = self._full.discretisation.assemble_stiffness()
        indptr, indices, data = matrix.getValuesCSR()
        matrix.destroy()
        stiffness = type(problem.stiffness)((data, indices, indptr))[free][:, free]
        # rows and forces scaled to the size of K: without it LU loses digits where E is large or small
        scale = stiffness.diagonal().mean()
        loads, gaps, contact = problem.loads[free] @ theta, problem.gaps @ theta, problem.contact[:, free]
        last = {"free": np.zeros(free.size)}

        def saddle_point(active, _):
            rows = scale * contact[active]
            matrix = bmat([[stiffness, rows.T], [rows, None]], format="csc")
            try:
                solution = splu(matrix).solve(np.concatenate([loads, scale * gaps[active]]))
            except RuntimeError as error:  # scipy's word for a singular matrix
                raise SingularError(str(error)) from error
            forces = np.zeros(active.size)
            forces[active] = scale * solution[free.size :]
            last["free"] = solution[: free.size]
            slack = gaps - contact @ last["free"]
            slack[active] = 0.0
            return forces, slack

        if start is None:
            _, free_slack = saddle_point(np.zeros(gaps.size, dtype=bool), None)
            start = free_slack < 0
        found = active_set(saddle_point, gaps, start, pairs=Pairs.of(problem.contact_pairs))
        primal = problem.lifts @ theta
        primal[free] += last["free"]
        return outcome(primal, found, point, raise_on_failure, FULL_ORDER_ADVICE)
