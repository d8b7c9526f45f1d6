"""Laws of bodies of a user's own, stated in UFL."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import ufl
from needs import present

import hhr_dolfinx as hhr
from hhr_dolfinx.forms.laws import At, Stated, closed, hardening

NOT_NEGATIVE = (-5e-324, float("inf"))


@dataclass(frozen=True)
class Bingham(hhr.Law if present("inelastic") else object):  # type: ignore[misc]
    """Linear viscoplasticity with a threshold: rate of p = max(σ_eq - σ0, 0) / η, implicit Euler.

    η is in stress times seconds; 0 is perfect plasticity.
    """

    yield_stress: float | str
    viscosity: float | str
    limits: ClassVar = {"yield_stress": NOT_NEGATIVE, "viscosity": NOT_NEGATIVE}

    def statement(self, at: At) -> Stated:
        """η Δp = dt (q_tr - 3 mu Δp - σ0) in closed form."""
        c = at.constants

        def flow(trial, stiff):
            return at.dt * ufl.max_value(trial - c.yield_stress, 0) / (c.viscosity + stiff * at.dt)

        return closed(at, flow)


@dataclass(frozen=True)
class Ludwik(hhr.Law if present("inelastic") else object):  # type: ignore[misc]
    """Hardening σ0 + K p^n, whose slope is infinite at p = 0 if n < 1; Hollomon's with σ0 = 0."""

    yield_stress: float | str
    strength: float | str
    exponent: float | str
    unknowns: ClassVar = {"amount": 1}
    limits: ClassVar = {
        "yield_stress": NOT_NEGATIVE,
        "strength": NOT_NEGATIVE,
        "exponent": (0.0, 2.0),
    }

    def statement(self, at: At) -> Stated:
        """q = σ0 + K p^n."""
        c = at.constants
        return hardening(at, lambda p: c.yield_stress + c.strength * p**c.exponent)
