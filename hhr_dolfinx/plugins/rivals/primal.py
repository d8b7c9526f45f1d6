"""Rivals without multipliers: pressures are functions of the displacement, interpolated from few
nodes.

    K~ γ + V^T B^T p = f~,    p = U (P^T U)^-1 max(0, q_P),    q = ε (B V γ - g) + q_0

U are POD modes of training forces, P the conditions that the discrete empirical interpolation (S.
Chaturantabut and D. Sorensen, SIAM J. Sci. Comput. 32, 2010) chooses for them. With q_0 = 0 it is a
penalty, with the forces that the displacement itself leaves over it is Nitsche's method.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg
from scipy.sparse import linalg as sparse_linalg

from hhr_dolfinx.contact.active_set import Status, Statuses
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.models.answer import Answer, found_as
from hhr_dolfinx.plugins.rivals.cones import DUAL_COUNTS, MOST_MODES, touching
from hhr_dolfinx.plugins.rivals.projection import (
    ConeFields,
    RivalModel,
    check_elastic,
    displacement_modes,
    whole,
    with_supremizers,
)
from hhr_dolfinx.plugins.studies.study import Rival
from hhr_dolfinx.reduction.modes import deim, pod
from hhr_dolfinx.reduction.projection import project

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.study.training.train import Training

PENALTY_FACTOR = 1000.0
NITSCHE = 10.0
"""Force of a unit overlap, over that by which the node of a condition alone yields."""
MOST_LINEAR = 100
"""Most linear problems of an answer."""
FORCE_MODES_LEFT_OUT = 1e-12
"""Part of the squared sum of training forces that their modes leave out."""


def penalty(training: Training) -> Iterator[Rival]:
    """Penalties at nodes of empirical interpolation (after E. Bader, Z. Zhang and K. Veroy, MCMDS
    22, 2016).
    """
    yield from _rivals("penalty, DEIM", training, nitsche=False)


def nitsche(training: Training) -> Iterator[Rival]:
    """Nitsche's method with empirical interpolation (after I. Niakh, G. Drouet, V. Ehrlacher and A.
    Ern, SMAI J. Comput. Math. 10, 2024), without their friction.
    """
    yield from _rivals("Nitsche, DEIM", training, nitsche=True)


def _rivals(method: str, training: Training, *, nitsche: bool) -> Iterator[Rival]:
    for count in DUAL_COUNTS:
        made = partial(_made, training, method, count, nitsche=nitsche)
        yield Rival(method, f"{count} nodes", made)


def _made(training: Training, method: str, count: int, *, nitsche: bool) -> PrimalModel:
    full = training.full_order
    check_elastic(full, method)
    modes = pod(touching(training.snapshots), FORCE_MODES_LEFT_OUT)[0][:, :count]
    basis = with_supremizers(full, displacement_modes(training.snapshots, MOST_MODES), modes)
    return PrimalModel(full, basis, modes, nitsche=nitsche)


class PrimalModel(RivalModel):
    """Galerkin model whose contact forces are interpolated from few conditions.

    Args:
        full: the full model, on one rank, with a constant stiffness.
        basis: V, orthonormal, (N, ell).
        modes: U, modes of forces, (N_lambda, r).
        nitsche: add the forces that the displacement itself leaves over, with a small penalty.

    Raises:
        NotOfferedError: see :func:`~hhr_dolfinx.plugins.rivals.projection.check_elastic`, and for
            moduli that are parameters.
        ReductionError: for rows of contact that Nitsche's method cannot tell apart.
    """

    def __init__(
        self, full: FullOrderModel, basis: np.ndarray, modes: np.ndarray, *, nitsche: bool
    ):
        check_elastic(full, "interpolated contact", one_stiffness=True)
        problem = full.problem
        self.parameters = full.parameters
        nodes = deim(modes)
        #: forces on all conditions from those at the nodes, (N_lambda, r)
        interpolated = linalg.solve(modes[nodes].T, modes.T).T
        self.fields = ConeFields(full, basis, interpolated)
        self._problem = problem
        reduced = project(problem, basis, whole(problem))
        self._stiffness = reduced.stiffness
        self._loads = reduced.loads
        self._push = reduced.contact_trial.T @ interpolated
        scale = (NITSCHE if nitsche else PENALTY_FACTOR) / full.schur.diagonal()[nodes, None]
        self._rows = scale * reduced.contact_trial[nodes]
        self._shift = -scale * reduced.gaps[nodes]
        if nitsche:
            followed, still = left_over(full, basis)
            self._rows -= followed[nodes]
            self._shift += still[nodes]
        self.advice = {Status.CYCLING: "pressures at the nodes of interpolation do not settle"}

    @property
    def sizes(self) -> tuple[int, int]:
        """Modes, and nodes of interpolation."""
        return self._push.shape

    def answered(self, point: np.ndarray) -> Answer:
        """See :class:`~hhr_dolfinx.plugins.rivals.projection.RivalModel`."""
        theta = self._problem.amplitudes(point)
        loads = self._loads @ theta
        shift = self._shift @ theta
        closed = np.zeros(len(shift), dtype=bool)
        count = 0
        settled = False
        while not settled and count < MOST_LINEAR:
            stiffness = self._stiffness + self._push[:, closed] @ self._rows[closed]
            unknown = np.linalg.solve(stiffness, loads - self._push[:, closed] @ shift[closed])
            pressures = self._rows @ unknown + shift
            count += 1
            before = closed
            closed = pressures > 0
            settled = bool((before == closed).all())
        forces = self.fields.cone @ np.where(closed, pressures, 0.0)
        status = Status.CONVERGED if settled else Status.CYCLING
        return found_as(
            Statuses(forces, forces > 0, count, status, False), point, unknown, self.fields
        )


def left_over(full: FullOrderModel, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Contact forces that balance a displacement best, (B B^T)^-1 B (F - K V γ) = s θ - m γ.

    Args:
        full: the full model, on one rank.
        basis: V, (N, ell).

    Returns:
        m, (N_lambda, ell), and s, (N_lambda, 1 + T).

    Raises:
        ReductionError: for rows of contact that depend on each other.
    """
    problem = full.problem
    rows = problem.contact.tocsc()
    try:
        gram = sparse_linalg.splu((rows @ rows.T).tocsc())
    except RuntimeError as error:
        raise ReductionError("Nitsche's method needs independent rows of contact") from error
    followed = gram.solve(np.asarray(rows @ (problem.own_stiffness @ basis)))
    still = gram.solve((rows @ problem.loads).toarray())
    return followed, still
