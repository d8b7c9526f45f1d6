"""Reduced problems of scenes whose shape depends on parameters: their arrays are interpolated
between few shapes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from hhr_dolfinx.amplitudes import Amplitudes, Theta
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import SingularError
from hhr_dolfinx.formulas import Modulus
from hhr_dolfinx.models.eliminations.elimination import CondensedContact, Elimination
from hhr_dolfinx.models.eliminations.projected import ReducedProblem
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.moduli.interpolation import Interpolant, unstacked

RESIDUAL_STEP = 1e-4
"""Step of the central differences, as a part of the box: their error is its square."""


@dataclass(frozen=True)
class InterpolatedProblem:
    """Reduced problem whose arrays are interpolated over the shape parameters.

    Maps a point to the problem there.
    """

    pairs: Annotated[Integers, "conditions"]  #: number of the contact pair of each condition, (m,)
    moduli: tuple[Modulus, ...]  #: of the parts of its stiffness
    sizes: Annotated[
        Floats, "parts"
    ]  #: of these moduli in the box, by which the parts are multiplied, (Q,)
    interpolant: Interpolant  #: of the concatenated arrays, in the order of ``shapes``
    shapes: tuple[
        tuple[int, ...], ...
    ]  #: of the arrays: parts of K~, their lifts, forces, B~1, B~2, gaps

    def __call__(self, point: np.ndarray) -> ReducedProblem:
        """The problem at a point, (P,), of constant stiffness."""
        stiffness, lifts, forces, test, trial, gaps = unstacked(
            self.interpolant.value(point), self.shapes
        )
        weights = np.array([modulus.value(point) for modulus in self.moduli]) / self.sizes
        loads = forces - np.tensordot(weights, lifts, 1)
        return ReducedProblem(
            np.tensordot(weights, stiffness, 1), test, trial, loads, gaps, self.pairs
        )


@dataclass(frozen=True)
class ReshapedElimination(Elimination):
    """Eliminates gamma from the problem of each point, (P,)."""

    problem_at: Callable[
        [np.ndarray], ReducedProblem
    ]  #: makes the reduced problem of a point, of constant stiffness
    amplitudes: Amplitudes  #: θ as a function of the parameters
    parameters: ParameterSpace  #: the box of the parameters

    def under(self, point: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """γ, (ell,), under given contact forces.

        Args:
            point: parameters, (P,).
            forces: contact forces, (m,).

        Raises:
            SingularError: if K~ is singular there.
        """
        problem, theta, factors = self._factored(point)
        return dgetrs(*factors, problem.loads @ theta - problem.contact_test.T @ forces)[0]

    def many_under(self, points: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """γ at many points, (n, ell).

        Args:
            points: parameters, (n, P).
            forces: contact forces at each point, (n, m).
        """
        return np.array([self.under(*query) for query in zip(points, forces, strict=True)])

    def __call__(self, point: np.ndarray) -> CondensedContact:
        """Contact problem at a point, with factors of K~ there; SingularError if it is singular."""
        problem, theta, factors = self._factored(point)
        solved = dgetrs(*factors, np.column_stack([problem.loads @ theta, problem.contact_test.T]))[
            0
        ]
        free = solved[:, 0]
        per_force = solved[:, 1:]
        slack = problem.gaps @ theta - problem.contact_trial @ free
        changes = partial(self._changes, point, problem.contact_trial, factors)
        return CondensedContact(
            problem.contact_trial @ per_force, slack, free, partial(np.matmul, per_force), changes
        )

    def _changes(
        self,
        point: np.ndarray,
        trial: np.ndarray,
        factors: tuple[np.ndarray, np.ndarray],
        forces: np.ndarray,
        unknown: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives from K~ gamma' = -R', with central differences of the residual R."""

        def residual_and_slack(shifted: np.ndarray) -> np.ndarray:
            problem = self.problem_at(shifted)
            theta = self.amplitudes(shifted)
            residual = (
                problem.stiffness @ unknown
                + problem.contact_test.T @ forces
                - problem.loads @ theta
            )
            return np.append(residual, problem.gaps @ theta - problem.contact_trial @ unknown)

        explicit = self.parameters.differences(residual_and_slack, point, RESIDUAL_STEP)
        size = unknown.size
        unknown_changes = dgetrs(*factors, -explicit[:size])[0]
        return explicit[size:] - trial @ unknown_changes, unknown_changes

    def _factored(
        self, point: np.ndarray
    ) -> tuple[ReducedProblem, Theta, tuple[np.ndarray, np.ndarray]]:
        """Problem of a point, θ there and LU factors of K~."""
        problem = self.problem_at(point)
        theta = self.amplitudes(point)
        lu, pivots, info = dgetrf(problem.stiffness)
        if info:
            raise SingularError(
                f"K~ of {len(problem.stiffness)} modes is singular at {point.tolist()}"
            )
        return problem, theta, (lu, pivots)
