"""Where only the moduli of whole bodies vary: K(mu) is block diagonal, and each block is a number times a fixed matrix.

Bodies touch only through contact, so that each connected component of K is a block K_c of its own. Where all of it has
one factor, K_c(mu) is s_c(mu) times K_c in the middle of the box, K^-1(mu) is K_c^-1 / s_c, and S(mu) the sum of
S_c / s_c: nothing is factored anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Modulus, Scalar


def dependence(
    moduli: Sequence[Modulus], others: tuple[int, ...], names: tuple[str, ...]
) -> tuple[Scalar | None, np.ndarray]:
    """The factor that all parts of a stiffness share, if it varies, and the places of the parameters of the rest.

    ``others`` are places of parameters that count in any case.
    """
    factor, rests = None, [scalar for modulus in moduli for scalar in (modulus.factor_scalar, modulus.rest_scalar)]
    if len({modulus.factor for modulus in moduli}) == 1:
        rests = [modulus.rest_scalar for modulus in moduli]
        factor = moduli[0].factor_scalar if moduli[0].factor_scalar.formula.variables else None
    named = {name for scalar in rests for name in scalar.formula.variables}
    return factor, np.array(sorted({names.index(name) for name in named} | set(others)), dtype=np.int64)


def moduli_of(problem: ContactProblem, body: np.ndarray) -> list[Modulus]:
    """Moduli of the parts of K that have entries on some dofs, (n,)."""
    pairs = zip(problem.moduli, problem.stiffness_terms, strict=False)
    return [modulus for modulus, term in pairs if term[body].count_nonzero()]


@dataclass(frozen=True)
class ScaledBodies:
    """The factors of what hangs together.

    Attributes:
        problem: whose stiffness it is, with all rows.
        factors: modulus of each connected component of K, None for a constant one, in the order of ``problem.bodies``.
    """

    problem: ContactProblem
    factors: tuple[Scalar | None, ...]

    @classmethod
    def of(cls, problem: ContactProblem) -> ScaledBodies | None:
        """Of a problem; None where more than factors of whole components varies, or nothing does."""
        if not problem.moduli or problem.reshaped is not None or not problem.whole:
            return None
        factors = []
        for body in problem.bodies:
            factor, axes = dependence(moduli_of(problem, body), (), problem.parameters.names)
            if axes.size:
                return None
            factors.append(factor)
        return cls(problem, tuple(factors))

    def at(self, point: np.ndarray) -> np.ndarray:
        """s_c at a point, (P,), beside 1 in the middle of the box, (C,)."""
        values = (1.0 if factor is None else factor.value(point) for factor in self.factors)
        return np.fromiter(values, dtype=float, count=len(self.factors)) / self._middle

    def on_dofs(self, scales: np.ndarray) -> np.ndarray:
        """Numbers of the components, (C,), on their dofs, (N,)."""
        return scales[self._component]

    def parts(self, per_force: np.ndarray) -> np.ndarray:
        """S_c of each component, (C, m, m), from K^-1 B^T in the middle of the box, (N, m)."""
        contact = self.problem.contact
        return np.array([contact[:, body] @ per_force[body] for body in self.problem.bodies])

    @cached_property
    def _component(self) -> np.ndarray:
        found = np.empty(self.problem.free.size, dtype=np.int64)
        for number, body in enumerate(self.problem.bodies):
            found[body] = number
        return found

    @cached_property
    def _middle(self) -> np.ndarray:
        middle = self.problem.middle
        return np.array([1.0 if factor is None else factor.value(middle) for factor in self.factors])
