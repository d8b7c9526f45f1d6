"""Naive full-order solver, as a first program would be written: a reference for times."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import bmat, csr_matrix
from scipy.sparse.linalg import splu

from hhr_dolfinx.contact.active_set import Pairs, active_set
from hhr_dolfinx.errors import NotOfferedError, SceneError, SingularError
from hhr_dolfinx.full_order.full import FULL_ORDER_ADVICE, FullOrderModel
from hhr_dolfinx.models.answer import Answer, found_as
from hhr_dolfinx.models.model import AnsweringModel

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import CheckedStart


class NaiveFullOrder(AnsweringModel):
    """Full-order model that stores nothing between queries.

    Each query assembles K, and each active-set iteration factors the saddle-point matrix ((K, B^T),
    (B, 0)) of its active contacts. Serial.

    Args:
        full_order: model whose scene is solved.

    Raises:
        SceneError: on several ranks, or for inelastic bodies.
        NotOfferedError: for friction, and for a K of another code.
    """

    def __init__(self, full_order: FullOrderModel):
        if full_order.comm.size > 1:
            raise SceneError("the naive baseline is serial: give a full model on MPI.COMM_SELF")
        if full_order.equilibrium is not None:
            raise SceneError(
                f"bodies of scene '{full_order.scene.name}' flow, and the naive baseline solves "
                "elastic ones only: ask the full model"
            )
        full_order.problem.require_no_memory("the naive baseline")
        if not full_order.discretisation.has_mesh:
            raise NotOfferedError(
                f"the naive baseline assembles K, and that of scene '{full_order.scene.name}' is "
                "not of elements"
            )
        self._full = full_order
        self.parameters = full_order.parameters
        self.fields = full_order
        self.advice = FULL_ORDER_ADVICE

    @property
    def sizes(self) -> tuple[int, int]:
        """Sizes of answers of the full model."""
        return self._full.sizes

    def _answered(
        self, point: np.ndarray, start: CheckedStart, outside: str, gradient: bool
    ) -> Answer:
        """Assemble and factor everything for this point."""
        if gradient:
            raise NotOfferedError("the naive baseline has no gradient: ask the full model")
        varies = self._full.problem.varies
        problem = self._full.problem.at(point)
        theta = problem.amplitudes(point)
        free = np.flatnonzero(problem.free)
        stiffness = (problem.stiffness if varies else self._assembled())[free][:, free]
        # rows and forces are scaled to the size of K: otherwise LU loses digits if E is large or
        # small
        scale = stiffness.diagonal().mean()
        loads = problem.loads[free] @ theta
        gaps = problem.gaps @ theta
        contact = problem.contact[:, free]
        last = {"free": np.zeros(free.size)}

        def saddle_point(active: np.ndarray, _: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
            """Forces and slack with active conditions, (m,) each.

            Raises:
                SingularError: for a singular matrix.
            """
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

        if start is None or isinstance(start, str):
            _, free_slack = saddle_point(np.zeros(gaps.size, dtype=bool), None)
            start = np.asarray(free_slack < 0)
        statuses = active_set(saddle_point, gaps, start, pairs=Pairs.of(problem.contact_pairs))
        unknown = np.zeros(problem.free.size)
        unknown[free] = last["free"]
        return found_as(statuses, point, problem.prolongation.prolong(unknown), self._full)

    def _assembled(self) -> csr_matrix:
        """K, assembled again."""
        first, *further = self._full.discretisation.stiffness_terms()[0]
        total = sum(further, start=first)
        return self._full.problem.prolongation.stiffness([total])[0]
