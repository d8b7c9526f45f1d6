"""Heat that contact forces make where surfaces slide."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hhr_dolfinx.errors import ParameterError, SceneError
from hhr_dolfinx.formulas import IMAGINARY_STEP
from hhr_dolfinx.plugins.contact_heat.newton import CoupledContact, SlidingResponse
from hhr_dolfinx.plugins.contact_heat.parts import SlidingParts


class PerHeat(NamedTuple):
    """Effects of heat of the conditions that slide, per power of each (g of m conditions)."""

    slack: np.ndarray  #: (m, g)
    jump: np.ndarray  #: of the temperature, first surface less second, (m, g)
    supplied: np.ndarray  #: heat to each body that contact alone feeds, (b, g)


class FrictionSources:
    """Heat per force of the conditions that slide (g of m, P parameters).

    Args:
        parts: its data.
        pairs: contact of each condition, (m,).
    """

    def __init__(self, parts: SlidingParts, pairs: np.ndarray):
        self._parts = parts
        self.conditions = parts.conditions
        self._pairs = pairs[self.conditions]

    def factors(self, point: np.ndarray) -> np.ndarray:
        """Heat of each condition over its force, (g,).

        Args:
            point: parameter of the user, (P,).

        Raises:
            SceneError: where friction is negative, or friction or speed is no number.
        """
        found = self._at(point)
        wrong = np.flatnonzero(~(np.isfinite(found) & (found >= 0)))
        if wrong.size:
            row = wrong[0]
            raise SceneError(
                f"friction times speed of contact {self._pairs[row]}, which slides, is "
                f"{found[row]:g} at {self._described(point)}, at the place "
                f"{self._parts.places[row].tolist()}: it must be a number that is not negative"
            )
        return found

    def _described(self, point: np.ndarray) -> str:
        names = self._parts.factors[0].names
        return ", ".join(
            f"{name} = {value:g}" for name, value in zip(names, np.real(point), strict=False)
        )

    def derivatives(self, point: np.ndarray) -> np.ndarray:
        """Derivatives of the factors along the parameters, (g, P).

        Args:
            point: parameter of the user, (P,).
        """
        steps = 1j * IMAGINARY_STEP * np.eye(point.size)
        columns = [np.imag(self._at(point + step)) / IMAGINARY_STEP for step in steps]
        return np.array(columns).reshape(point.size, -1).T

    def _at(self, point: np.ndarray) -> np.ndarray:
        found = np.zeros(self.conditions.size, dtype=point.dtype)
        for contact, scalar in zip(self._parts.contacts, self._parts.factors, strict=True):
            rows = self._pairs == contact
            values = dict(zip(scalar.names, (*point, *self._parts.places[rows].T), strict=True))
            try:
                with np.errstate(all="ignore"):
                    found[rows] = scalar.formula(values)
            except ParameterError as error:
                raise SceneError(
                    f"friction or speed of contact {contact}, which slides, ends at "
                    f"{self._described(point)}: {error}. Let a table reach further"
                ) from None
        return found

    def added(
        self, contact: CoupledContact, per_heat: PerHeat, point: np.ndarray
    ) -> CoupledContact:
        """The problem with the heat that its forces make.

        Args:
            contact: the problem without.
            per_heat: effects of this heat.
            point: parameter of the user, (P,).
        """
        factors = self.factors(point)
        if not factors.any():
            return contact
        size = contact.slack.size
        schur = contact.schur.copy()
        schur[:, self.conditions] += per_heat.slack * factors
        jump = np.zeros((size, size))
        jump[:, self.conditions] = per_heat.jump * factors
        supplied = np.zeros((len(per_heat.supplied), size))
        supplied[:, self.conditions] = per_heat.supplied * factors
        return contact._replace(schur=schur, sliding=SlidingResponse(jump, supplied))
