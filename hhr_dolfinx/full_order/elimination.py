"""Elimination of everything but the contact for one parameter: where the stiffness depends on it, and for gradients."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.floating import FloatingEqualities
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.eliminations.elimination import CondensedContact, Floating, answer_of

DIFFERENCE = 1e-5
"""Part of the box by which a mesh is moved to difference what is assembled on it: the error is its square, and below it
round-off of the assembly grows."""


@dataclass(frozen=True)
class FullStiffness:
    """The full problem at one parameter, factored; on several ranks vectors of dofs are this rank's own.

    Attributes:
        full: the model, whose solver leases factors of one stiffness at a time.
        problem: the problem at this parameter, of constant stiffness; where only moduli of whole bodies vary that of
            all parameters, whose factors serve all of them.
        point: the parameter, (P,).
        free: unknown without contact forces, (own dofs,).
        schur, free_slack: S, (m, m), and the slack without contact forces, (m,).
        stiffness: own rows of the matrix that is factored, (own dofs, N); each solution makes sure of its factors.
        per_force: K^-1 B^T, (own dofs, m); None where it takes solutions, or is that of the full model times the scale.
        scale: K over the matrix that is factored, on own dofs, (own dofs,); 1 if they are equal.
    """

    full: Any
    problem: ContactProblem
    point: np.ndarray
    free: np.ndarray
    schur: np.ndarray
    free_slack: np.ndarray
    stiffness: csr_matrix
    per_force: np.ndarray | None = None
    scale: np.ndarray | float = 1.0

    @classmethod
    def at(cls, full: Any, point: np.ndarray) -> FullStiffness:
        """Factor the stiffness of a point, unless it is that at hand, or known from another one."""
        if full.scaled is not None:
            return cls._scaled(full, point)
        theta = full.problem.amplitudes(point)  # first, since it refuses moduli that are impossible
        problem = full.problem.at(point)
        if full.problem.varies:
            _, stiffness, per_force, schur = full.condensed_at(problem, point)
        else:
            stiffness = full.problem.own_stiffness
            per_force = None
            schur = full.schur
        free = full.solve_with(stiffness, problem.loads[problem.rows] @ theta)
        slack = problem.gaps @ theta - problem.moved(free)
        return cls(full, problem, point, free, schur, slack, stiffness, per_force)

    @classmethod
    def _scaled(cls, full: Any, point: np.ndarray) -> FullStiffness:
        """From the factors in the middle of the box, see :class:`ScaledBodies`."""
        scaled = full.scaled
        problem = full.problem
        assert scaled is not None
        scales = scaled.at(point)
        scale = scaled.on_dofs(scales)
        theta = problem.amplitudes(point)
        stiffness = problem.own_stiffness
        free = full.solve_with(stiffness, problem.spread.of(problem.loads_at(point, theta)) / scale)
        schur = full.schur_of(scales)
        slack = problem.gaps @ theta - problem.moved(free)
        return cls(full, problem, point, free, schur, slack, stiffness, scale=scale)

    def contact(self) -> CondensedContact:
        """What is left once the displacement is eliminated, on all ranks."""
        free = self.full.spread.whole(self.free)
        return CondensedContact(
            self.schur, self.free_slack, free, self.pushed, self.at_fixed_forces, symmetric=True,
            floating=self.floating, factored=None if self.full.problem.varies else self.full.equalities,
        )  # fmt: skip

    def pushed(self, forces: np.ndarray) -> np.ndarray:
        """K^-1 B^T times forces, (m,) or (m, k), on all dofs, (N,) or (N, k)."""
        own = self._pushed(forces)
        return self.full.spread.whole((own.T / self.scale).T)

    def _pushed(self, forces: np.ndarray) -> np.ndarray:
        """The same on own dofs, and without the scale."""
        if self.per_force is not None:
            return self.per_force @ forces
        if self.stiffness is self.full.problem.own_stiffness:
            return self.full.pushed(forces)
        return self.full.pushed_at(self.stiffness, self.problem.contact_of_rows, forces)

    def at_fixed_forces(self, forces: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """K U' = -R', where R is the residual K U + B^T lambda - F; and the slack that goes with it."""
        left, slack = self._explicit(forces, unknown)
        with self.full.factors.lock:  # all columns by the same factors, which other threads would replace in between
            found = np.stack([self.full.solve_with(self.stiffness, -column / self.scale) for column in left.T], axis=1)
        return slack - self.problem.moved(found), self.full.spread.whole(found)

    @cached_property
    def floating(self) -> Floating | None:
        """Rigid motions that only contact holds; None where there are none."""
        rigid = self.problem.rigid
        if rigid is None:
            return None
        # of lifts there is no part, since a rigid motion does not strain
        loads = self.full.rigid_loads
        varies = self.full.problem.varies
        equalities = FloatingEqualities(self.schur, self.full.rigid_taken) if varies else self.full.floating
        acting, slopes = self.problem.amplitudes.slopes_at(self.point)
        driving = loads @ self.problem.amplitudes(self.point)
        changes = loads[:, acting] @ slopes
        return Floating(equalities, driving, rigid, lambda *_: changes)

    def _explicit(self, forces: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the residual on own dofs and of the slack, while unknown and forces stay."""
        problem = self.full.problem
        point = self.point
        rows = self.problem.rows
        if problem.reshaped is not None:
            return self._differenced(forces, unknown)
        acting, slopes = problem.amplitudes.slopes_at(point)
        loads = self.problem.loads if self.full.scaled is None else problem.at(point).loads
        left = -(loads[rows][:, acting] @ slopes)
        theta = problem.amplitudes(point)
        parts = zip(problem.moduli, problem.stiffness_terms, problem.lift_terms, strict=True) if problem.moduli else ()
        for modulus, part, lift in parts:
            left += np.outer(part @ unknown + lift[rows] @ theta, modulus.derivative(point))
        return left, problem.gaps[:, acting] @ slopes

    def _differenced(self, forces: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same by central differences of what is assembled on meshes moved a little to either side."""

        def residual_and_slack(moved: np.ndarray) -> np.ndarray:
            problem = self.full.problem.at(moved)
            theta = problem.amplitudes(moved)
            residual = problem.stiffness @ unknown + problem.contact.T @ forces - problem.loads @ theta
            return np.append(residual, problem.gaps @ theta - problem.contact @ unknown)

        found = self.full.parameters.differences(residual_and_slack, self.point, DIFFERENCE)
        return found[: unknown.size], found[unknown.size :]


def solved_anew(full: Any, point: np.ndarray, start: np.ndarray | None, *, gradient: bool) -> Answer:
    """Answer of a full model at a checked point, by factors of its own stiffness."""
    if full.scaled is not None:
        contact = FullStiffness.at(full, point).contact()
        return answer_of(contact, point, start, full.pairs, full, gradient=gradient)
    with full.factors.lock:  # of which another thread might make those of another point
        contact = FullStiffness.at(full, point).contact()
        return answer_of(contact, point, start, full.pairs, full, gradient=gradient)
