"""A law of a body, of which scenes without laws import nothing."""

from dataclasses import dataclass

import hhr_dolfinx as hhr


@dataclass(frozen=True)
class Newtonian(hhr.Law):
    """A law of flow without a threshold: rate of p = σ_eq / η, implicit Euler."""

    viscosity: float

    def statement(self, at):
        """Closed form of η Δp = dt (q_tr - 3 mu Δp)."""
        from hhr_dolfinx.forms.laws import closed

        return closed(
            at, lambda trial, stiff: trial * at.dt / (at.constants.viscosity + stiff * at.dt)
        )
