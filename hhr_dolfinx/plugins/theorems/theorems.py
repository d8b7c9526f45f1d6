"""Bounds of the thesis, theorems 3, 4, 5, 6 and 8 of chapter 2, with both sides evaluated and
hypotheses checked.

Let u, lambda be the full model's answer, u_HR, lambda_HR the reduced one on Omega_A, r and r' the
parts of u and u_HR on the interface I (lifts that vanish inside, (2.40)), u^0 = u - r on A. With
the constants of a and b:

    3           |lambda - lambda_HR|_A <= M_a / beta_HR |u - u_HR|_A
    (2.70) 4           |u - u_HR^H|_A <= M_a / alpha inf_w |u^0 - w|_A
    under (H), (2.67), (2.73) 4 kernel    |u - u_HR^H|_A <= (1 + M_a / alpha_K) inf_w |u^0 - w|_A
    under (H),        (2.74) 5           |u - u_HR|_A <= (1 + M_a / alpha_K) (inf_w |u^0 - w|_A + |r
    - r'|_A)                            (2.80) 6           |u - u_HR| <= (1 + M_a / alpha') inf_w |u
    - w|                                under (2.46),      (2.87) 8           |u - u_HR|_A <= |R|_A'
    / alpha + (1 + M_a / alpha) |r - r'|_A                 under (H2),       (2.116)

Theorem 7, (2.95), is 8 under (H), where r = r' and the last term is zero: it has no separate number
here.

Above u_HR^H answers (2.33) with r' = r. The infima are those of the proofs: over w for which w -
u_HR lies in the kernel of b, that is, which close the gaps as u_HR does. The text takes more, all w
that penetrate nothing, for which (2.77), (2.83) and (2.90) do not hold. The figures of section 2.6
take all w of the reduced space, (2.142): that is ``as_printed``, and is called no bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, active_set
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import BoundError, ParameterError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.plugins.theorems.constants import (
    OVER_ALL,
    Spaces,
    beyond,
    check_models,
    given_constants,
    refused,
    sharp_constants,
)
from hhr_dolfinx.plugins.theorems.ellipticity import Ellipticity
from hhr_dolfinx.plugins.theorems.rid_norms import (
    Directions,
    Domain,
    EnergyNorms,
    EuclideanNorms,
    Norms,
    root,
)

THEOREMS = ("3", "4", "4 kernel", "5", "6", "8")
RIGHT_SIDE_ROUND_OFF = 1e-10
"""Part of an answer that is round-off, added to each right side."""


class Sides(NamedTuple):
    """Both sides of an inequality: the error, and its upper bound by the theorem."""

    left: float
    right: float

    @property
    def effectivity(self) -> float:
        """Right over left, (2.153); infinite if the error is zero."""
        return self.right / self.left if self.left > 0 else math.inf


@dataclass(frozen=True)
class ImposedInterface:
    """Hypothesis (H), (2.67): the RID interface has the displacements of the full model, (2.33).

    Find u in V^0_HR and lambda >= 0 with K~ u + B~^T lambda = F~, B~ u <= g~. V^0_HR has functions
    that are orthonormal in energy, (|A|, k), so that K~ is the identity and S~ = B~ B~^T.
    """

    problem: ContactProblem
    domain: Domain
    space: Directions
    contact: np.ndarray
    equalities: SchurEqualities
    pairs: Pairs | None

    @classmethod
    def of(cls, problem: ContactProblem, domain: Domain, test: np.ndarray) -> ImposedInterface:
        """Reduced problem with imposed values on the interface of a RID.

        Args:
            problem: the contact problem.
            domain: the RID.
            test: modes cut off outside A, (|A|, ell).
        """
        sets = domain.sets
        space = Directions.spanned(test, lambda columns: domain.inner @ columns)
        contact = domain.acting.T @ space.vectors
        pairs = Pairs.of(problem.contact_pairs[sets.A_lambda])
        return cls(problem, domain, space, contact, SchurEqualities.of(contact @ contact.T), pairs)

    def solve(self, field: np.ndarray, theta: Theta) -> np.ndarray:
        """Solution on A, (|A|,), with the interface values of a field.

        Args:
            field: the field, (N,).
            theta: θ of the parameter.

        Raises:
            BoundError: if the statuses do not converge.
        """
        sets = self.domain.sets
        lift = field.copy()
        lift[sets.A] = 0.0
        loads = (self.problem.loads @ theta)[sets.A] - self.domain.rows @ lift
        free = self.space.vectors.T @ loads
        gaps = self.problem.gaps[sets.A_lambda] @ theta - self.domain.contact @ lift
        slack = gaps - self.contact @ free
        statuses = active_set(self.equalities, slack, slack < 0, pairs=self.pairs)
        if statuses.status.name != "CONVERGED":
            raise BoundError(
                f"the reduced problem under (H), (2.33), has no answer: "
                f"{statuses.status.name.lower()}"
            )
        return self.space.vectors @ (free - self.contact.T @ statuses.forces)


@dataclass(frozen=True)
class ThesisBounds:
    """The theorems for a reduced model, prepared once."""

    problem: ContactProblem
    norms: Norms
    basis: np.ndarray
    imposed: ImposedInterface
    constants: dict[
        str, Ellipticity
    ]  #: of each theorem that can be evaluated: M_a, and alpha or what replaces it
    near: tuple[Directions, Directions]  #: spaces of the infima on Omega_A and on the whole domain
    refused: dict[str, str]  #: the hypothesis that fails, by theorem

    @classmethod
    def of(
        cls,
        full: FullOrderModel,
        model: ReducedModel,
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
            constants: M_a and alpha in this norm; None takes the smallest and the largest that the
                proofs allow, by eigenvalues on the spaces of the proofs.
            as_printed: as the figures of section 2.6 were made, in the Euclidean norm: constants by
                (2.143) and (2.144) if none are given, infima over all of the reduced space, (2.148)
                to (2.152), alpha instead of alpha', beta_HR as the smallest singular value of B~.

        Raises:
            BoundError: with the hypothesis that fails for all theorems.
            ReductionError: for a model without a record of its construction, or of another full
                model.
        """
        check_models(full, model)
        if as_printed and constants is None:
            constants = Ellipticity.of_materials(full.scene.bodies)
        problem = full.problem
        record = model.offline
        norms = _norms(norm, Domain.of(full, record.sets), problem)
        spaces = Spaces.of(norms, model.problem, record.basis)
        near = spaces.test_kernel, spaces.trial_kernel
        used = sharp = sharp_constants(norms, spaces, getattr(record.stability, norm))
        failed = refused(norms, sharp)
        if constants is not None:
            used = given_constants(
                sharp, constants, record.stability.sigma_min if as_printed else None
            )
            failed = beyond(used, sharp) | failed
        if as_printed:
            near = spaces.test, Directions.spanned(record.basis, norms.whole)
            failed = {name: OVER_ALL for name in ("4", "4 kernel", "5", "6")} | failed
        imposed = ImposedInterface.of(problem, norms.domain, record.basis[record.sets.A])
        return cls(problem, norms, record.basis, imposed, used, near, failed)

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
            raise BoundError(f"theorem {theorem!r} is not one of {', '.join(THEOREMS)}")
        if theorem in self.refused:
            raise BoundError(f"theorem {theorem}: {self.refused[theorem]}")
        return self._pair(answer, exact).sides(theorem)

    def bounds(self, answer: Answer, exact: Answer) -> dict[str, Sides]:
        """Both sides of all theorems whose hypotheses hold, see :meth:`bound`.

        Args:
            answer: answer of the reduced model.
            exact: answer of the full model to the same parameter.
        """
        pair = self._pair(answer, exact)
        return {name: pair.sides(name) for name in THEOREMS if name not in self.refused}

    def sides(self, answer: Answer, exact: Answer) -> dict[str, Sides]:
        """Both sides of all theorems that can be evaluated.

        One whose hypothesis fails proves nothing.

        Args:
            answer: answer of the reduced model.
            exact: answer of the full model to the same parameter.
        """
        pair = self._pair(answer, exact)
        return {name: pair.sides(name) for name in THEOREMS if name in self.constants}

    def _pair(self, answer: Answer, exact: Answer) -> _Pair:
        """The answers, which must be to one parameter."""
        if not np.allclose(answer.parameter, exact.parameter, rtol=1e-12, atol=0):
            raise ParameterError(
                f"answers to {answer.parameter} and to {exact.parameter}: give those to one "
                "parameter"
            )
        for name, checked in (("the reduced model", answer), ("the full model", exact)):
            if not checked.converged:
                raise BoundError(
                    f"{name} has no answer at {checked.parameter}: the theorems are on solutions"
                )
        return _Pair(self, answer, exact)


@dataclass(frozen=True)
class _Pair:
    """A reduced answer and the full one."""

    bounds: ThesisBounds
    answer: Answer
    exact: Answer

    def sides(self, theorem: str) -> Sides:
        """Both sides of a theorem; the right one with round-off of the answer."""
        norms = self.bounds.norms
        constants = self.bounds.constants[theorem]
        ratio = constants.continuity / constants.coercivity
        near, near_whole = self.bounds.near
        noise = RIGHT_SIDE_ROUND_OFF * self._size
        match theorem:
            case "3":
                forces = (
                    self.exact.multipliers[norms.domain.sets.A_lambda] - self.answer.multipliers
                )
                return Sides(norms.of_forces(forces), ratio * (self._moved + noise))
            case "5":
                nearest = near.distance(self._error[self._inside])
                return Sides(self._moved, (1 + ratio) * (nearest + self._lifted) + noise)
            case "6":
                noise = RIGHT_SIDE_ROUND_OFF * self._whole(self.exact.unknown)
                return Sides(
                    self._whole(self._error), (1 + ratio) * near_whole.distance(self._error) + noise
                )
            case "8":
                return Sides(
                    self._moved,
                    self._residual / constants.coercivity + (1 + ratio) * self._lifted + noise,
                )
        factor = ratio if theorem == "4" else 1 + ratio
        error = root(self._imposed @ norms.inside(self._imposed))
        return Sides(error, factor * near.distance(self._imposed) + noise)

    @property
    def _inside(self) -> np.ndarray:
        return self.bounds.norms.domain.sets.A

    @cached_property
    def _error(self) -> np.ndarray:
        """u - u_HR, (N,)."""
        return self.exact.unknown - self.bounds.basis @ self.answer.unknown

    @cached_property
    def _moved(self) -> float:
        """|u - u_HR| on Omega_A."""
        return self.bounds.norms.on_domain(self._error)

    @cached_property
    def _size(self) -> float:
        """|u| on Omega_A."""
        return self.bounds.norms.on_domain(self.exact.unknown)

    @cached_property
    def _lifted(self) -> float:
        """|r - r'| on Omega_A."""
        lift = self._error.copy()
        lift[self._inside] = 0.0
        return self.bounds.norms.on_domain(lift)

    @cached_property
    def _imposed(self) -> np.ndarray:
        """u - u_HR^H, which vanishes on the interface, (|A|,)."""
        theta = self.bounds.problem.theta(self.exact.parameter)
        return self.exact.unknown[self._inside] - self.bounds.imposed.solve(
            self.exact.unknown, theta
        )

    @cached_property
    def _residual(self) -> float:
        """Norm of (2.91) on functions of V^0."""
        problem = self.bounds.problem
        domain = self.bounds.norms.domain
        loads = (problem.loads @ problem.theta(self.answer.parameter))[self._inside]
        inner = domain.rows @ (self.bounds.basis @ self.answer.unknown)
        return self.bounds.norms.of_residual(
            loads - inner - domain.acting @ self.answer.multipliers
        )

    def _whole(self, field: np.ndarray) -> float:
        """Norm of a field, (N,), on the whole domain."""
        return root(field @ self.bounds.norms.whole(field))


def _norms(name: str, domain: Domain, problem: ContactProblem) -> Norms:
    if name == "euclidean":
        return EuclideanNorms(domain)
    if name == "energy":
        return EnergyNorms(domain, 1.0 / problem.contact_areas[domain.sets.A_lambda])
    raise BoundError(f"norm = {name!r} must be 'energy' or 'euclidean'")
