"""Bounds of the thesis, theorems 3, 4, 5, 6 and 8 of chapter 2, with both sides evaluated and hypotheses checked.

Let u, lambda be the full model's answer, u_HR, lambda_HR the reduced one on Omega_A, r and r' the parts of u and u_HR
on the interface I (lifts that vanish inside, (2.40)), u^0 = u - r on A. With the constants of a and b:

    3           |lambda - lambda_HR|_A <= M_a / beta_HR |u - u_HR|_A                                            (2.70)
    4           |u - u_HR^H|_A <= M_a / alpha inf_w |u^0 - w|_A                               under (H), (2.67), (2.73)
    4 kernel    |u - u_HR^H|_A <= (1 + M_a / alpha_K) inf_w |u^0 - w|_A                       under (H),        (2.74)
    5           |u - u_HR|_A <= (1 + M_a / alpha_K) (inf_w |u^0 - w|_A + |r - r'|_A)                            (2.80)
    6           |u - u_HR| <= (1 + M_a / alpha') inf_w |u - w|                                under (2.46),      (2.87)
    8           |u - u_HR|_A <= |R|_A' / alpha + (1 + M_a / alpha) |r - r'|_A                 under (H2),       (2.116)

where u_HR^H answers (2.33) with r' = r. The infima are those of the proofs: over w for which w - u_HR lies in the
kernel of b, that is, which close the gaps as u_HR does. The text takes more, all w that penetrate nothing, for which
(2.77), (2.83) and (2.90) do not hold. The figures of section 2.6 take all w of the reduced space, (2.142): that is
``as_printed``, and is called no bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hhr_dolfinx.certify.ellipticity import Ellipticity
from hhr_dolfinx.certify.imposed_interface import ImposedInterface
from hhr_dolfinx.certify.rid_norms import Directions, Domain, EnergyNorms, EuclideanNorms, Norms
from hhr_dolfinx.certify.theorem_constants import (
    OVER_ALL,
    Spaces,
    beyond,
    check_models,
    given_constants,
    refused,
    sharp_constants,
)
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import BoundError, ParameterError
from hhr_dolfinx.models.answer import Answer

THEOREMS = ("3", "4", "4 kernel", "5", "6", "8")
ROUND_OFF = 1e-10
"""Part of an answer that is round-off, added to each right side."""


class Sides(NamedTuple):
    """Both sides of an inequality.

    Attributes:
        left: the error.
        right: what is said to be no less.
    """

    left: float
    right: float

    @property
    def effectivity(self) -> float:
        """Right over left, (2.153); infinite where there is no error."""
        return self.right / self.left if self.left > 0 else math.inf


@dataclass(frozen=True)
class ThesisBounds:
    """The theorems for a reduced model, prepared once.

    Attributes:
        problem: the full problem.
        norms: in which both sides are taken.
        basis: V, (N, ell).
        sets: of the RID.
        imposed: the reduced problem under (H).
        constants: of each theorem that can be evaluated: M_a, and alpha or what stands in its place.
        near: spaces of the infima on Omega_A and on the whole domain.
        refused: the hypothesis that fails, by theorem.
    """

    problem: ContactProblem
    norms: Norms
    basis: np.ndarray
    sets: IndexSets
    imposed: ImposedInterface
    constants: dict[str, Ellipticity]
    near: tuple[Directions, Directions]
    refused: dict[str, str]

    @classmethod
    def of(
        cls,
        full: Any,
        model: Any,
        norm: str = "energy",
        constants: Ellipticity | None = None,
        *,
        as_printed: bool = False,
    ) -> ThesisBounds:
        """Prepare the theorems.

        Args:
            full: the full model, on one rank.
            model: a reduced model of it, as it was built.
            norm: ``energy``, with the L2 norm of the pressure, or ``euclidean`` as in the thesis.
            constants: M_a and alpha in this norm; None takes the smallest and the largest that the proofs allow, by
                eigenvalues on the spaces of the proofs.
            as_printed: as the figures of section 2.6 were made, in the Euclidean norm: constants by (2.143) and (2.144)
                if none are given, infima over all of the reduced space, (2.148) to (2.152), alpha in the place of
                alpha', beta_HR as the smallest singular value of B~.

        Raises:
            BoundError: with the hypothesis that fails for all theorems.
            ReductionError: for a model that does not know how it was made, or of another full model.
        """
        check_models(full, model)
        if as_printed and constants is None:
            constants = Ellipticity.of_materials(full.scene.bodies)
        problem, record = full.problem, model.offline
        norms = _norms(norm, Domain.of(full, record.sets), problem)
        spaces = Spaces.of(norms, model.problem, record.basis)
        near = spaces.test_kernel, spaces.trial_kernel
        used = sharp = sharp_constants(norms, spaces, getattr(record.stability, norm))
        failed = refused(problem, norms, sharp)
        if constants is not None:
            used = given_constants(sharp, constants, record.stability.sigma_min if as_printed else None)
            failed = beyond(used, sharp) | failed
        if as_printed:
            near = spaces.test, Directions.spanned(record.basis, norms.whole)
            failed = {name: OVER_ALL for name in ("4", "4 kernel", "5", "6")} | failed
        imposed = ImposedInterface.of(problem, norms.domain, record.basis[record.sets.A])
        return cls(problem, norms, record.basis, record.sets, imposed, used, near, failed)

    def bound(self, theorem: str, answer: Answer, exact: Answer) -> Sides:
        """Both sides of a theorem whose hypotheses hold.

        Args:
            theorem: one of ``THEOREMS``.
            answer: of the reduced model.
            exact: of the full one, at the same parameter.

        Raises:
            BoundError: with the hypothesis that fails.
            ParameterError: for answers to two parameters.
        """
        if theorem not in THEOREMS:
            raise BoundError(f"theorem {theorem!r} is none of {', '.join(THEOREMS)}")
        if theorem in self.refused:
            raise BoundError(f"theorem {theorem}: {self.refused[theorem]}")
        return self._sides(theorem, *self._errors(answer, exact))

    def bounds(self, answer: Answer, exact: Answer) -> dict[str, Sides]:
        """Both sides of all theorems whose hypotheses hold, see :meth:`bound`."""
        errors = self._errors(answer, exact)
        return {name: self._sides(name, *errors) for name in THEOREMS if name not in self.refused}

    def sides(self, answer: Answer, exact: Answer) -> dict[str, Sides]:
        """Both sides of all theorems that can be evaluated, also of those refused: numbers of which nothing is said."""
        errors = self._errors(answer, exact)
        return {name: self._sides(name, *errors) for name in THEOREMS if name in self.constants}

    def _errors(self, answer: Answer, exact: Answer) -> tuple[Answer, Answer, np.ndarray]:
        """The answers and the difference of their displacements, (N,)."""
        if not np.allclose(answer.parameter, exact.parameter, rtol=1e-12, atol=0):
            raise ParameterError(f"answers to {answer.parameter} and to {exact.parameter}: give those to one parameter")
        for name, found in (("the reduced model", answer), ("the full model", exact)):
            if not found.converged:
                raise BoundError(f"{name} has no answer at {found.parameter}: the theorems are on solutions")
        return answer, exact, exact.unknown - self.basis @ answer.unknown

    def _sides(self, theorem: str, answer: Answer, exact: Answer, error: np.ndarray) -> Sides:
        """Both sides of one theorem."""
        size = self.norms.on_domain(exact.unknown) if theorem != "6" else self._whole(exact.unknown)
        if theorem == "3":
            found = self._forces(answer, exact, error)
        elif theorem in ("4", "4 kernel"):
            found = self._imposed(theorem, exact)
        elif theorem == "6":
            factor = 1 + self._ratio("6")
            found = Sides(self._whole(error), factor * self.near[1].distance(error))
        else:
            found = self._inside(theorem, answer, error)
        scale = self._ratio("3") if theorem == "3" else 1.0
        return Sides(found.left, found.right + ROUND_OFF * scale * size)

    def _forces(self, answer: Answer, exact: Answer, error: np.ndarray) -> Sides:
        """(2.70)."""
        forces = exact.multipliers[self.sets.A_lambda] - answer.multipliers
        return Sides(self.norms.of_forces(forces), self._ratio("3") * self.norms.on_domain(error))

    def _imposed(self, theorem: str, exact: Answer) -> Sides:
        """(2.73), (2.74); what is left of the displacement lies in V^0."""
        theta = self.problem.theta(exact.parameter)
        left = exact.unknown[self.sets.A] - self.imposed.solve(exact.unknown, theta)
        factor = self._ratio(theorem) + (0.0 if theorem == "4" else 1.0)
        return Sides(self._norm_inside(left), factor * self.near[0].distance(left))

    def _inside(self, theorem: str, answer: Answer, error: np.ndarray) -> Sides:
        """(2.80), (2.116)."""
        lift = error.copy()
        lift[self.sets.A] = 0.0
        between = self.norms.on_domain(lift)
        factor = 1 + self._ratio(theorem)
        if theorem == "5":
            right = factor * (self.near[0].distance(error[self.sets.A]) + between)
        else:
            constants = self.constants["8"]
            right = self.norms.of_residual(self._residual(answer)) / constants.coercivity + factor * between
        return Sides(self.norms.on_domain(error), right)

    def _residual(self, answer: Answer) -> np.ndarray:
        """(2.91) on functions of V^0, (|A|,)."""
        problem, sets = self.problem, self.sets
        loads = (problem.loads @ problem.theta(answer.parameter))[sets.A]
        inner = self.norms.domain.rows @ (self.basis @ answer.unknown)
        return loads - inner - problem.contact[sets.A_lambda][:, sets.A].T @ answer.multipliers

    def _ratio(self, theorem: str) -> float:
        constants = self.constants[theorem]
        return constants.continuity / constants.coercivity

    def _norm_inside(self, field: np.ndarray) -> float:
        return math.sqrt(max(float(field @ self.norms.inside(field)), 0.0))

    def _whole(self, field: np.ndarray) -> float:
        return math.sqrt(max(float(field @ self.norms.whole(field)), 0.0))


def _norms(name: str, domain: Domain, problem: ContactProblem) -> Norms:
    """Norms by their name."""
    if name == "euclidean":
        return EuclideanNorms(domain)
    if name == "energy":
        return EnergyNorms(domain, 1.0 / problem.contact_areas[domain.sets.A_lambda])
    raise BoundError(f"norm = {name!r} is none of 'energy' and 'euclidean'")
