"""Projected contact problem (5.23), and the dependence of its stiffness on the parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.linear.dense import lay_out

if TYPE_CHECKING:
    from hhr_dolfinx.amplitudes import Amplitudes
    from hhr_dolfinx.formulas import Modulus


@dataclass(frozen=True)
class ReducedTerms:
    """Parts of a reduced stiffness that depends on parameters, K~ = sum of moduli times parts."""

    stiffness: Annotated[Floats, "parts", "modes", "modes"]  #: parts of K~, (Q, ell, ell)
    #: V[A]^T K_q[A] lifts, by which the loads change with the stiffness, (Q, ell, 1 + T)
    lifts: Annotated[Floats, "parts", "modes", "terms"]
    forces: Annotated[Floats, "modes", "terms"]  #: V[A]^T F[A], loads without these, (ell, 1 + T)
    moduli: Annotated[tuple[Modulus, ...], "parts"]  #: amplitudes of the parts

    def __post_init__(self) -> None:
        lay_out(self)

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults of moduli that do not belong to a stiffness proportional to them."""
        if not self.moduli:
            yield "a stiffness that varies has no parts"

    def weights(self, point: np.ndarray) -> np.ndarray:
        """Weights of the parts at a point, (Q,)."""
        return np.array([modulus.value(point) for modulus in self.moduli])


@dataclass(frozen=True)
class ReducedProblem:
    """Projected contact problem, thesis (5.23).

    Find gamma and lambda >= 0 with K~ gamma + B~1^T lambda = loads θ, B~2 gamma <= gaps θ.

    A generalised saddle point (5.27): B~1 and B~2 differ if conditions of the RID touch its
    interface; otherwise they are equal and it is (1.61).
    """

    #: K~ = V[A]^T K[A, A u I] V[A u I], (1.63), (ell, ell), not symmetric
    stiffness: Annotated[Floats, "modes", "modes"]
    #: B~1 = B[A_lambda, A_c] V[A_c], (5.26), (N_lambda_C, ell): maps forces to loads
    contact_test: Annotated[Floats, "conditions", "modes"]
    #: B~2 = B[A_lambda, A_c~] V[A_c~], (5.26), (N_lambda_C, ell): maps displacements to gaps
    contact_trial: Annotated[Floats, "conditions", "modes"]
    loads: Annotated[Floats, "modes", "terms"]  #: V[A]^T loads[A], (ell, 1 + T)
    gaps: Annotated[Floats, "conditions", "terms"]  #: gaps[A_lambda], (N_lambda_C, 1 + T)
    pairs: Annotated[
        Integers, "conditions"
    ]  #: number of the contact pair of each condition, (N_lambda_C,)
    #: parts of the stiffness if it depends on parameters; `stiffness` and `loads` are then those in
    #: the middle of the box. None for a constant stiffness
    terms: ReducedTerms | None = None
    motions: int = (
        0  # number of modes, the first ones, that are rigid motions of bodies held by contact alone
    )

    def __post_init__(self) -> None:
        lay_out(self)

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults of modes that are not rigid motions."""
        count = self.motions
        ell = len(self.stiffness)
        if count and not (
            0 < count < ell
            and not self.stiffness[:, :count].any()
            and not self.stiffness[:count].any()
        ):
            yield f"{count} of {ell} modes are no rigid motions"

    @property
    def held(self) -> ReducedProblem:
        """The problem without rigid motions, whose K~ is regular; itself if it has none."""
        r = self.motions
        terms = self.terms
        if not r:
            return self
        if terms is not None:
            stiffness = terms.stiffness[:, r:, r:]
            lifts = terms.lifts[:, r:]
            terms = replace(terms, stiffness=stiffness, lifts=lifts, forces=terms.forces[r:])
        return replace(
            self,
            stiffness=self.stiffness[r:, r:],
            contact_test=self.contact_test[:, r:],
            contact_trial=self.contact_trial[:, r:],
            loads=self.loads[r:],
            terms=terms,
            motions=0,
        )

    def changes(
        self, amplitudes: Amplitudes, point: np.ndarray, weights: np.ndarray, unknown: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the right-hand side along the parameters.

        Args:
            amplitudes: θ as a function of the parameters.
            point: parameter, (P,).
            weights: weights of the parts of K~, (Q,).
            unknown: gamma, (ell,).

        Returns:
            f' - K~' gamma, (ell, P), and derivatives of the gaps, (m, P).
        """
        assert self.terms is not None
        theta = amplitudes(point)
        acting, slopes = amplitudes.slopes_at(point)
        right = self.terms.forces[:, acting] @ slopes
        terms = zip(self.terms.stiffness, self.terms.lifts, self.terms.moduli, weights, strict=True)
        for matrix, lift, modulus, weight in terms:
            right -= weight * (lift[:, acting] @ slopes)
            right -= np.outer(matrix @ unknown + lift @ theta, modulus.derivative(point))
        return right, self.gaps[:, acting] @ slopes

    def weighted(self, weights: np.ndarray) -> ReducedProblem:
        """The problem of constant stiffness for weights of its parts, (Q,).

        It is the problem itself without parts.
        """
        if self.terms is None:
            return self
        stiffness = np.tensordot(weights, self.terms.stiffness, 1)
        loads = self.terms.forces - np.tensordot(weights, self.terms.lifts, 1)
        return replace(self, stiffness=stiffness, loads=loads, terms=None)
