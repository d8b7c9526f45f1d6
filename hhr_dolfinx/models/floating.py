"""Models of bodies that nothing but contact holds: the primal unknown is eliminated, rigid motions are not.

In a reduced model the first modes are rigid motions R, on which K~ has columns of zeros; the equations tested with
them are the balance of whole bodies, see ``reduction.projection``. Gamma of the other modes is eliminated like
everywhere, and G^T lambda = driving is left, see ``contact.floating``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.floating import FloatingEqualities
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.linear.dense import LapackLU
from hhr_dolfinx.models.elimination import CondensedContact, Elimination, Floating, Responses
from hhr_dolfinx.models.projected import ReducedProblem
from hhr_dolfinx.plain import Rebuilt

Changed = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class FloatingResponses(Rebuilt, Elimination):
    """What elimination leaves at one stiffness (n unknowns, m conditions, r motions, 1 + T terms).

    Attributes:
        responses: of the unknown, which is pinned.
        taken: what the motions take from the slack, (m, r).
        driving: loads along the motions, (r, 1 + T).
        modes: the motions as unknowns, (n, r).
        amplitudes: θ as a function of the parameters.
    """

    responses: Responses
    taken: Annotated[Floats, "m", "motions"]
    driving: Annotated[Floats, "motions", "terms"]
    modes: Annotated[Floats, "unknowns", "motions"]
    amplitudes: Amplitudes

    @cached_property
    def equalities(self) -> FloatingEqualities:
        """On S with the motions."""
        return FloatingEqualities(self.responses.schur, self.taken)

    def __call__(self, point: np.ndarray) -> FloatingElimination:
        """What is left at a point, (P,)."""
        return FloatingElimination(self, point)


@dataclass(frozen=True, eq=False)
class FloatingElimination(CondensedContact):
    """See :class:`hhr_dolfinx.models.elimination.CondensedContact`.

    Attributes:
        left: what elimination leaves at the stiffness of the point.
        point: the parameter, (P,).
        changed: maps point and unknown to derivatives of slack, unknown and balance while forces and motions stay;
            None where the stiffness is constant.
    """

    left: FloatingResponses
    point: np.ndarray
    changed: Changed | None = None

    @property
    def schur(self) -> np.ndarray:
        """S, (m, m)."""
        return self.left.responses.schur

    @cached_property
    def free_slack(self) -> np.ndarray:
        """Slack without contact forces and motions, (m,)."""
        return self.left.responses.free_slack @ self.left.amplitudes(self.point)

    @property
    def floating(self) -> Floating:
        """The motions."""
        left = self.left
        driving = left.driving @ left.amplitudes(self.point)
        return Floating(left.equalities, driving, left.modes, lambda forces, unknown: self._changes(unknown)[2])

    def unknown(self, forces: np.ndarray) -> np.ndarray:
        """The unknown under contact forces, pinned, (n,)."""
        return self.left.responses.free_primal @ self.left.amplitudes(self.point) - self.pushed(forces)

    def pushed(self, forces: np.ndarray) -> np.ndarray:
        """What forces, (m,) or (m, k), take from the unknown."""
        return self.left.responses.primal_per_force @ forces

    def at_fixed_forces(self, forces: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of slack and unknown while forces and motions stay."""
        return self._changes(unknown)[:2]

    def _changes(self, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if self.changed is not None:
            return self.changed(self.point, unknown)
        acting, slopes = self.left.amplitudes.slopes_at(self.point)
        responses = self.left.responses
        parts = responses.free_slack, responses.free_primal, self.left.driving
        slack, free, driving = (part[:, acting] @ slopes for part in parts)
        return slack, free, driving


@dataclass(frozen=True)
class FloatingReduction(Elimination):
    """Eliminates gamma of a reduced problem at any parameter; once for all where its stiffness is constant.

    Attributes:
        problem: the projected problem, with its motions.
        amplitudes: θ as a function of the parameters.
    """

    problem: ReducedProblem
    amplitudes: Amplitudes

    def __call__(self, point: np.ndarray) -> FloatingElimination:
        """Eliminate at a point, (P,)."""
        if self.problem.terms is None:
            return self._constant(point)
        factor, left = self._eliminated(self.problem.weighted(self.problem.terms.weights(point)))
        return replace(left(point), changed=lambda point, unknown: self._changed(factor, point, unknown))

    @cached_property
    def _constant(self) -> FloatingResponses:
        return self._eliminated(self.problem)[1]

    def _eliminated(self, problem: ReducedProblem) -> tuple[LapackLU, FloatingResponses]:
        """Factors of K~ without the motions, and what elimination leaves, of a problem of constant stiffness."""
        r, held = problem.motions, problem.held
        factor = LapackLU(held.stiffness)
        found = Responses.eliminate(factor, held.loads, held.gaps, held.contact_test, held.contact_trial)
        taken = np.ascontiguousarray(problem.contact_trial[:, :r])
        free, per_force = (_after(r, part) for part in (found.free_primal, found.primal_per_force))
        responses = replace(found, free_primal=free, primal_per_force=per_force)
        return factor, FloatingResponses(responses, taken, problem.loads[:r], np.eye(len(free), r), self.amplitudes)

    def _changed(
        self, factor: LapackLU, point: np.ndarray, unknown: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """K~ gamma' = f' - K~' gamma, and what goes with it."""
        problem, r = self.problem, self.problem.motions
        terms = problem.terms
        assert terms is not None  # of a stiffness that varies
        acting, slopes = self.amplitudes.slopes_at(point)
        theta, right = self.amplitudes(point), terms.forces[:, acting] @ slopes
        for part, lift, modulus in zip(terms.stiffness, terms.lifts, terms.moduli, strict=True):
            right = right - modulus.value(point) * (lift[:, acting] @ slopes)
            right = right - np.outer(part @ unknown + lift @ theta, modulus.derivative(point))
        held = factor.solve(right[r:])
        slack = problem.gaps[:, acting] @ slopes - problem.contact_trial[:, r:] @ held
        return slack, _after(r, held), right[:r]


def _after(count: int, rows: np.ndarray) -> np.ndarray:
    """Rows behind as many rows of zeros."""
    return np.concatenate([np.zeros((count, *rows.shape[1:])), rows])
