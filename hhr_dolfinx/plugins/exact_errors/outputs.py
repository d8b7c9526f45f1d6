"""Errors of outputs for a constant stiffness: outputs of an answer less those of the exact one.

Rows of outputs times the exact field are rows times K^-1 loads and the lift, less rows times K^-1
B^T Λ, all of them as small as the contact surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hhr_dolfinx.declared import Floats
from hhr_dolfinx.models.bound import BOUND_ROUND_OFF
from hhr_dolfinx.models.functionals.functional import Functional, Functionals, State
from hhr_dolfinx.plugins.exact_errors.contact_response import CANCELLED

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Answer
    from hhr_dolfinx.models.displacement import LinearDisplacement

MOST_ENTRIES = 4_000_000
"""Entries of an output times contact conditions up to which its exact value is computed: 32 MB."""


def is_read(item: Functional, conditions: int) -> bool:
    """True if the exact value of an output is computed.

    Args:
        item: the output.
        conditions: number of contact conditions.
    """
    return item.count * conditions <= MOST_ENTRIES


@dataclass(frozen=True)
class OutputDifference:
    """Arrays of the exact outputs (n outputs, m conditions, 1 + T terms)."""

    #: rows of these outputs times the displacement without contact forces, (K', 1 + T), and times
    #: K^-1 B^T, (K', m)
    free: Annotated[Floats, "output rows", "terms"]
    pressed: Annotated[Floats, "output rows", "N_lambda"]
    #: a thousandth of the largest absolute value in training of each output, the least denominator
    #: of an error, (n,)
    least: Annotated[Floats, "outputs"]

    def knows(self, item: Functional) -> bool:
        """True if an output has an estimate."""
        return is_read(item, self.pressed.shape[1])

    def least_of(self, functionals: Functionals, name: str) -> float:
        """Smallest denominator of the relative error of an output.

        Args:
            functionals: outputs of the scene.
            name: name of the output.
        """
        return float(self.least[[functional.name for functional in functionals.items].index(name)])

    def fits(self, functionals: Functionals) -> bool:
        """True if these can be estimates of some outputs.

        Sizes agree, and no smallest denominator is negative.
        """
        rows = sum(functional.count for functional in functionals.items if self.knows(functional))
        return (
            len(self.free) == rows
            and self.least.shape == (len(functionals.items),)
            and bool((self.least >= 0).all())
        )

    def errors(
        self, fields: LinearDisplacement, answer: Answer, forces: np.ndarray, exact: np.ndarray
    ) -> dict[str, float]:
        """Differences for an answer that converged, with the round-off of the subtraction.

        Args:
            fields: fields of the model of the answer.
            answer: the answer.
            forces: the returned forces, (m,).
            exact: the exact forces, (m,).

        Returns:
            The differences, by the names of the outputs.
        """
        functionals: Functionals = fields.functionals
        theta = fields.amplitudes.dense(answer.parameter)
        measured = fields.measured(answer, theta)
        free = self.free @ theta
        nearer = free - self.pressed @ exact
        none = np.zeros_like(exact)
        errors: dict[str, float] = {}
        first = 0
        for functional, span in zip(functionals.items, functionals.places, strict=True):
            if not self.knows(functional):
                continue
            rows = slice(first, first + functional.count)
            first += functional.count
            states = (forces, measured[span]), (exact, nearer[rows]), (none, free[rows])
            value, exact_value, unpressed = (
                functional.value(State(pressed, read, answer.parameter, theta, answer.stress))
                for pressed, read in states
            )
            if np.isnan(value - exact_value):  # a centre of pressure without contact has no error
                continue
            scale = abs(value) + abs(exact_value) + CANCELLED * abs(np.nan_to_num(unpressed))
            errors[functional.name] = abs(value - exact_value) + BOUND_ROUND_OFF * scale
        return errors
