"""A law of inelastic bodies of your own, and the manifest by which scenes find it."""

from dataclasses import dataclass
from typing import ClassVar

from hhr_dolfinx import Law
from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(name="my_law", needs=("inelastic",), parts={"laws": {"MyLaw": "my_law:MyLaw"}})


@dataclass(frozen=True)
class MyLaw(Law):
    """Linear creep: rate of p = stress / viscosity, implicit Euler.

    Attributes:
        viscosity: in stress times seconds.
    """

    viscosity: float | str  # TODO: the constants of your law, numbers or formulas of parameters
    limits: ClassVar = {"viscosity": (0.0, float("inf"))}

    def statement(self, at):
        """A step in UFL; see hhr_dolfinx.forms.laws, and its laws with unknowns and memory."""
        from hhr_dolfinx.forms.laws import closed

        # TODO: dp as a function of the trial stress and of 3 mu
        return closed(
            at, lambda trial, stiff: at.dt * trial / (at.constants.viscosity + stiff * at.dt)
        )
