"""Kinds of outputs: dependence of a number on forces, displacement and point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.models.functionals.functional import Functional, Slopes, State

TIE = 1e-9
"""Relative difference below which two values both count as the largest.

The derivative is then one-sided.
"""
UNDER_LOAD = 1e-3
"""Part of the largest pressure of a contact above which a condition is under load: smaller forces
that a reduced model completes outside its domain are noise.
"""
_NOTHING = np.zeros(0)
_NOWHERE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Linear(Functional):
    """Forces, displacement and amplitudes times weights."""

    conditions: Annotated[Integers, "conditions"]  #: of the forces, (c,)
    weights: Annotated[Floats, "conditions"]  #: of these
    along: Annotated[Floats, "rows"]  #: weights of its rows, (k,)
    terms: Annotated[Integers, "terms of it"]  #: of the amplitudes, (t,)
    coefficients: Annotated[Floats, "terms of it"]  #: of these

    @classmethod
    def of(
        cls,
        name: str,
        unit: str,
        conditions: np.ndarray = _NOWHERE,
        weights: np.ndarray = _NOTHING,
        *,
        row: csr_matrix | None = None,
        terms: np.ndarray = _NOWHERE,
        coefficients: np.ndarray = _NOTHING,
    ) -> Linear:
        """Output that is linear in forces, displacement and amplitudes.

        Args:
            name: name of the output.
            unit: unit of its value, as text.
            conditions: contact conditions, (c,).
            weights: weights of their forces, (c,).
            row: row of the displacement, sparse (1, N); None for none.
            terms: numbers of the amplitudes, (t,).
            coefficients: weights of these, (t,).
        """
        matrix = (0, _NOWHERE, _NOWHERE, _NOTHING)
        along = _NOTHING
        if row is not None:
            entries = row.tocoo()
            arrays = (
                entries.row.astype(np.int64),
                entries.col.astype(np.int64),
                entries.data.astype(float),
            )
            matrix = (1, *arrays)
            along = np.ones(1)
        forces = conditions.astype(np.int64), np.asarray(weights, dtype=float)
        return cls(
            name,
            unit,
            *matrix,
            *forces,
            along,
            terms.astype(np.int64),
            np.asarray(coefficients, dtype=float),
        )

    @property
    def uses_forces(self) -> bool:  # type: ignore[override]
        """True if it depends on any force."""
        return self.conditions.size > 0

    def value(self, state: State) -> float:
        """The sum of all products."""
        value = state.measured @ self.along + state.theta[self.terms] @ self.coefficients
        return float(
            value + state.forces[self.conditions] @ self.weights if self.uses_forces else value
        )

    def slopes(self, state: State) -> Slopes:
        """The weights."""
        theta = np.zeros(state.theta.size)
        theta[self.terms] = self.coefficients
        return Slopes(self.conditions, self.weights, self.along, theta)

    def indices(self) -> dict[str, np.ndarray]:
        """Conditions and terms."""
        return {"conditions": self.conditions, "terms": self.terms}


@dataclass(frozen=True, eq=False)
class OfPressures(Functional):
    """Output of pressures, force over area."""

    uses_forces: ClassVar[bool] = True

    conditions: Annotated[Integers, "conditions"]  #: (c,)
    areas: Annotated[Floats, "conditions"]  #: of these

    def pressures(self, state: State) -> np.ndarray:
        """Pressure of each condition, (c,)."""
        return state.forces[self.conditions] / self.areas

    def indices(self) -> dict[str, np.ndarray]:
        """Conditions."""
        return {"conditions": self.conditions}


@dataclass(frozen=True, eq=False)
class Largest(OfPressures):
    """Largest pressure."""

    def value(self, state: State) -> float:
        """Largest pressure of all conditions."""
        return float(self.pressures(state).max())

    def slopes(self, state: State) -> Slopes:
        """Slopes of the condition where the maximum is attained."""
        pressures = self.pressures(state)
        index = int(pressures.argmax())
        return Slopes(
            self.conditions[[index]], 1 / self.areas[[index]], kink=tied(pressures, index)
        )

    def followed(self, state: State, there: Functional, shifted: State) -> float:
        """Pressure of the condition where the maximum is attained.

        Args:
            state: arguments that choose the condition.
            there: the output on the other shape.
            shifted: arguments on the other shape.
        """
        assert isinstance(there, Largest)
        index = self.pressures(state).argmax()
        return float(shifted.forces[self.conditions[index]] / there.areas[index])


@dataclass(frozen=True, eq=False)
class Loaded(OfPressures):
    """Area under load times a factor and an offset.

    Its derivatives are zero: it jumps when a condition is loaded.
    """

    offset: float  #: added to the area times the factor
    factor: float

    @property
    def counted(self) -> np.ndarray:
        """Part of each area that counts, (c,)."""
        return self.areas

    def value(self, state: State) -> float:
        """Area whose pressure exceeds :data:`UNDER_LOAD` of the largest pressure."""
        return float(self.offset + self.factor * self.counted[self._loaded(state)].sum())

    def slopes(self, state: State) -> Slopes:
        """Zero."""
        return Slopes()

    def followed(self, state: State, there: Functional, shifted: State) -> float:
        """Area on the other shape of the conditions under load.

        Args:
            state: arguments that choose the conditions.
            there: the output on the other shape.
            shifted: not used.
        """
        assert isinstance(there, Loaded)
        return float(there.offset + there.factor * there.counted[self._loaded(state)].sum())

    def _loaded(self, state: State) -> np.ndarray:
        """Conditions under load, (c,) bool."""
        pressures = self.pressures(state)
        largest = pressures.max()
        return (pressures > UNDER_LOAD * largest) & (largest > 0)


@dataclass(frozen=True, eq=False)
class LoadedShare(Loaded):
    """Area under load of a contact that has a share in some conditions."""

    own: Annotated[Floats, "conditions"]  #: its part of each area, (c,)

    @property
    def counted(self) -> np.ndarray:
        """See :class:`Loaded`."""
        return self.own


def tied(values: np.ndarray, index: int) -> bool:
    """True if another value is as large as the largest, or all are zero.

    Args:
        values: values, (n,).
        index: index of the largest one.
    """
    largest = values[index]
    return bool(np.count_nonzero(values >= largest - TIE * abs(largest)) > 1)
