"""Laws of von Mises type as numbers: plasticity with hardening and viscoplasticity, thesis section 6.2.

All laws share the radial return. With the trial deviator s_tr = 2 mu dev(ε - εp_old), of equivalent stress q_tr, an
increment Δp of the cumulated plastic strain gives

    s = (1 - 3 mu Δp / q_tr) s_tr,      εp = εp_old + 3/2 Δp s_tr / q_tr.

The law is one scalar equation for Δp(q_tr), its *flow*. A user-defined law is a class with a method ``flow``;
everything else is common. ``forms.return_mapping`` states the same in UFL, and tests compare the two.

A constant may be a text, a formula of the parameters of the scene such as ``"sy * (1 - 4e-4 * T)"``. A step of a
history has the constants of the parameter at its end: a law with these numbers is made for each step. In a user-defined
law, a frozen dataclass, any field that may be a ``float`` may be such a text; a ``__post_init__`` that checks numbers
must accept texts. See :mod:`hhr_dolfinx.plugins.inelastic.constants`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real
from typing import Any, ClassVar, Protocol

import numpy as np

from hhr_dolfinx.errors import SceneError


class Flow(Protocol):
    """Interface of a law of plasticity or creep.

    A law whose flow does not depend on ``dt`` may declare ``rated: ClassVar[bool] = False``: the training range of its
    histories then limits directions of the load, not rates.
    """

    def flow(
        self, trial: np.ndarray, plastic_strain: np.ndarray, shear: float, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Increment of cumulated plastic strain in a step, at Gauss points with given trial stress.

        The derivative speeds up convergence and does not change the solution: compare it with differences of Δp. A step
        that does not converge is cut, so that a rate-dependent law gets smaller steps; ``History.cuts`` counts them.

        Args:
            trial: equivalent trial stress q_tr, (n,), read-only.
            plastic_strain: cumulated plastic strain p before the step, (n,), the only internal variable of a law.
            shear: shear modulus mu.
            dt: time step in seconds.

        Returns:
            Flow Δp, 0 <= 3 mu Δp <= q_tr, and its derivative by q_tr, (n,) each.

        Raises:
            ArithmeticError: if there is no solution; the step is then cut, and the error of a history names the law.
        """


def _holds(what: str, constant: object, possible: Callable[[Any], bool]) -> bool:
    """True if a constant is a valid number, or a text that is a formula, whose values are checked later."""
    if isinstance(constant, str):
        # imported here, since most laws have no formulas
        from hhr_dolfinx.formulas import formula_of

        formula_of(constant, what)
        return True
    return isinstance(constant, Real) and possible(constant)


def _number(constant: float | str) -> float:
    """Value of a constant, which must be a number at this point."""
    if isinstance(constant, str):
        raise TypeError(f"{constant!r} is a formula of the parameters: law_at(law, names, point) has its number")
    return constant


@dataclass(frozen=True)
class Plasticity:
    """Von Mises plasticity with linear isotropic hardening, thesis (6.23)-(6.26): yield at σ0 + H p.

    Attributes:
        yield_stress: σ0, in the unit of stress of the scene, or a formula of the parameters.
        hardening: H >= 0, or a formula.

    Example:
        >>> Plasticity("table(T, 20, 300, 600, 180)", hardening="H").yield_stress
        'table(T, 20, 300, 600, 180)'
    """

    rated: ClassVar[bool] = False
    yield_stress: float | str
    hardening: float | str = 0.0

    def __post_init__(self) -> None:
        yields = _holds("yield_stress of Plasticity", self.yield_stress, lambda value: 0 < value < np.inf)
        hardens = _holds("hardening of Plasticity", self.hardening, lambda value: 0 <= value < np.inf)
        if not (yields and hardens):
            raise SceneError(
                f"yield stress {self.yield_stress} must be positive and hardening {self.hardening} not negative: "
                "softening has no answer that does not depend on the mesh"
            )

    def flow(
        self, trial: np.ndarray, plastic_strain: np.ndarray, shear: float, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Closed form of σ0 + H (p + Δp) = q_tr - 3 mu Δp; see :class:`Flow`."""
        from hhr_dolfinx.plugins.inelastic.compiled_laws import PLASTICITY, flows_at

        constants = _number(self.yield_stress), _number(self.hardening)
        return flows_at(PLASTICITY, constants, trial, plastic_strain, shear, dt)


@dataclass(frozen=True)
class Norton:
    """Norton's viscoplasticity without threshold, thesis (6.28): rate of p = (σ_eq / K)^m, implicit Euler.

    The thesis prints the exponent as n - 1.

    Attributes:
        resistance: K, in stress times s^(1/m), or a formula of the parameters.
        exponent: m >= 1, or a formula.
    """

    resistance: float | str
    exponent: float | str

    def __post_init__(self) -> None:
        resists = _holds("resistance of Norton", self.resistance, lambda value: 0 < value < np.inf)
        if not (resists and _holds("exponent of Norton", self.exponent, lambda value: 1 <= value < np.inf)):
            raise SceneError(f"resistance {self.resistance} must be positive and exponent {self.exponent} at least 1")

    def flow(
        self, trial: np.ndarray, plastic_strain: np.ndarray, shear: float, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Newton's method for x = σ_eq in x + 3 mu dt (x / K)^m = q_tr; see :class:`Flow`.

        Raises:
            ArithmeticError: if the iteration does not converge.
        """
        from hhr_dolfinx.plugins.inelastic.compiled_laws import ITERATIONS, NORTON, flows_at

        constants = _number(self.resistance), _number(self.exponent)
        amount, slope = flows_at(NORTON, constants, trial, plastic_strain, shear, dt)
        lost = np.flatnonzero(np.isfinite(trial) & ~np.isfinite(amount))  # the caller reports a non-finite trial stress
        if lost.size:
            raise ArithmeticError(
                f"Newton's method still moves after {ITERATIONS} iterations under a trial stress of "
                f"{trial[lost[0]]:g} with 3 mu dt = {3 * shear * dt:g}: check units"
            )
        return amount, slope
