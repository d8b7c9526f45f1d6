"""Bounds of the error of what is handed out: a field everywhere and contact forces everywhere, however they were found.

Let K be symmetric and positive definite, the rows of B independent, S = B K^-1 B^T, and (U, Λ) the solution of (1.21)
with the slack σ. Given any forces λ >= 0, let u be the field in equilibrium with them, K u + B^T λ = loads θ, let
s = gaps θ - B u be its slack, and r = s where λ > 0 or s < 0, else 0. As λ·σ >= 0, and Λ s >= 0 where r leaves s out,

    |λ - Λ|_S^2 = (λ - Λ)·(s - σ) <= (λ - Λ)·r,      so that      |λ - Λ|_S = |u - U|_K <= |r|_{S^-1}.

Another field û, of the slack ŝ with its r̂, leaves the residual ρ = loads θ - K û - B^T λ of equilibrium. With
a = |ρ|_{K^-1} its error is at most a + |r|_{S^-1}. The same sums for û itself give |û - U|_K^2 <= a |û - U|_K +
|λ - Λ|_S |r̂|_{S^-1}, which is smaller where û takes part in the contact: the smaller one is the bound. docs/bounds.md
has the proof in full. Theorems 3 to 8 of the thesis bound the same errors through inf-sup constants.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve, solve_triangular

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.active_set import SchurEqualities, Status, active_set

ROUND_OFF = 1e-10
"""Part of an answer that is round-off of the exact one too: nothing is known to be nearer."""


NO_OUTPUTS: Mapping[str, float] = {}
"""Of what has no outputs, or no bounds of them."""


class Estimate(NamedTuple):
    """What is known of the error of an answer.

    Attributes:
        kind: ``bound``, which no error exceeds, or ``indicator``, which follows it.
        primal: of the displacement in energy, (v^T K v)^1/2.
        dual: of the contact forces, (λ^T S λ)^1/2: the energy of the displacement that they make alone.
            Both are infinite of an indicator, which knows no units.
        primal_relative, dual_relative: over the least that the exact answer can have in these norms; infinite where a
            bound is larger than the answer itself.
        outputs: bounds of the errors of the outputs of the scene, by name; those of which nothing is known are left
            out, see :mod:`hhr_dolfinx.models.output_bound`.
    """

    kind: str
    primal: float
    dual: float
    primal_relative: float
    dual_relative: float
    outputs: Mapping[str, float] = NO_OUTPUTS

    @classmethod
    def indicated(cls, value: float) -> Estimate:
        """What an indicator says, in units of its own, taken as relative."""
        return cls("indicator", math.inf, math.inf, value, value)


EXACT = Estimate("bound", 0.0, 0.0, 0.0, 0.0)
"""Of what the full model answers."""


@dataclass(frozen=True)
class ErrorBound:
    """Arrays of the bounds where the stiffness is constant (m conditions, 1 + T terms, ell modes).

    Attributes:
        free_slack: gaps - B K^-1 loads, (m, 1 + T).
        schur: S, (m, m).
        lower: its Cholesky factor, (m, m).
        residual: maps θ, γ and λ one behind another, (1 + T + ell + m,), to coordinates in which the Euclidean norm is
            |ρ|_{K^-1}, (r, 1 + T + ell + m).
        energy: maps θ and γ likewise to coordinates in which it is the energy norm of the displacement,
            (r', 1 + T + ell).
    """

    free_slack: np.ndarray
    schur: np.ndarray
    lower: np.ndarray
    residual: np.ndarray
    energy: np.ndarray

    def closed(self, forces: np.ndarray, theta: Theta) -> np.ndarray:
        """Forces without those where the bodies would be apart by more than the force itself closes, (m,)."""
        slack = self.free_slack @ theta + self.schur @ forces
        return np.where(self.schur.diagonal() * forces < slack, 0.0, forces)

    def improved(self, forces: np.ndarray, theta: Theta) -> tuple[np.ndarray, float]:
        """Forces whose gaps are closed, from the statuses of given ones, (m,); and their error in the S norm at most.

        Where these statuses do not settle, the given ones.
        """
        free = self.free_slack @ theta
        slack = free + self.schur @ forces
        given = forces, self._off(slack, forces)
        touching = (self.schur.diagonal() * forces >= slack) & ((forces > 0) | (slack < 0))
        found = active_set(SchurEqualities.symmetric(self.schur), free, touching)
        if found.status is not Status.CONVERGED:
            return given
        better = np.maximum(found.forces, 0.0)
        return min(given, (better, self._off(free + self.schur @ better, better)), key=itemgetter(1))

    def of(self, unknown: np.ndarray, forces: np.ndarray, slack: np.ndarray, theta: Theta) -> Estimate:
        """Bounds of a field and of forces.

        Args:
            unknown: γ, (ell,).
            forces: not negative, (m,).
            slack: of the field, (m,).
            theta: θ.
        """
        terms = self.free_slack.shape[1]
        free, pushed = self.free_slack @ theta, self.schur @ forces
        # any forces may stand in the proof, so that better ones make the bound sharp, and the distance to them is known
        better = self._improved(forces, free, pushed)
        less = self.schur @ better
        nearer = self._off(free + less, better)
        between = math.sqrt(max((forces - better) @ (pushed - less), 0.0))
        own = np.concatenate([unknown, better])
        unbalanced = float(np.linalg.norm(self.residual[:, :terms] @ theta + self.residual[:, terms:] @ own))
        moved = self.energy[:, :terms] @ theta + self.energy[:, terms:] @ unknown
        sizes = float(np.linalg.norm(moved)), math.sqrt(max(forces @ pushed, 0.0))
        noise = ROUND_OFF * (sizes[1] + math.sqrt(max(better @ less, 0.0)))
        dual = min(self._off(free + pushed, forces), nearer + between) + noise
        root = math.sqrt(unbalanced**2 + 4 * nearer * self._off(slack, better))
        primal = min(unbalanced + nearer, (unbalanced + root) / 2) + ROUND_OFF * sizes[0] + noise
        return Estimate("bound", primal, dual, relative(primal, sizes[0]), relative(dual, sizes[1]))

    def _improved(self, forces: np.ndarray, free: np.ndarray, pushed: np.ndarray) -> np.ndarray:
        """Forces that close the gaps where given ones say that bodies touch, (m,)."""
        touching = np.flatnonzero(
            (self.schur.diagonal() * forces >= free + pushed) & ((forces > 0) | (free + pushed < 0))
        )
        found = np.zeros_like(forces)
        block = self.schur[np.ix_(touching, touching)]
        found[touching] = np.maximum(solve(block, -free[touching], assume_a="pos", check_finite=False), 0.0)
        return found

    def _off(self, slack: np.ndarray, forces: np.ndarray) -> float:
        """|r|_{S^-1} of a slack and forces."""
        left = np.where((forces > 0) | (slack < 0), slack, 0.0)
        return float(np.linalg.norm(solve_triangular(self.lower, left, lower=True, check_finite=False)))


def relative(error: float, size: float) -> float:
    """Error over the least size of what is exact, that of what was found less the error."""
    if error == 0:
        return 0.0
    return float(error / (size - error)) if error < size else float("inf")
