"""Data of models with heat, as files keep them: neither DOLFINx nor PETSc."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Self

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.parameters import ParameterSpace, Tag
from hhr_dolfinx.plain import Rebuilt


@dataclass(frozen=True, eq=False)
class Conduction(Rebuilt):
    """Temperatures by supplies, heat flows of contacts and levels of bodies.

    n nodes, m conditions, b bodies that contact alone feeds, or modes of transient heat, t supplies
    and fixed temperatures.
    """

    has_own_sizes: ClassVar[bool] = True

    amplitudes: tuple[Scalar, ...]  #: of the supplies and fixed temperatures, (t,)
    temperatures: Annotated[Floats, "n", "t"]  #: per amplitude
    #: fall of the temperature per heat flow, K_T^-1 B_T^T, (n, m), and per heat of conditions that
    #: slide, (n, g), below 0
    per_heat: Annotated[Floats, "n", "m"]
    levels: Annotated[Floats, "n", "b"]  #: 1 in each body that contact alone feeds; modes
    #: B_T, temperature of the first surface less that of the second, (m, n), and less that of both
    #: by the shares of the heat that conditions make which slide, (g, n)
    jumps: Annotated[csc_matrix, "m", "n"]
    #: heat to each body that contact alone feeds, per amplitude; 0 of modes
    supplied: Annotated[Floats, "b", "t"]

    def supplies(self, point: np.ndarray) -> np.ndarray:
        """Amplitudes of supplies and fixed temperatures, (t,).

        Args:
            point: parameter of the user, (P,).
        """
        return np.array([scalar.value(point) for scalar in self.amplitudes])

    def temperature(self, point: np.ndarray, count: int) -> np.ndarray:
        """Temperature at the nodes, (n,).

        Args:
            point: parameter of the user, followed by heat flows, heat of conditions that slide and
                levels, (P + m + g + b,).
            count: number of the parameters of the user.
        """
        flows, levels = np.split(point[count:], [self.per_heat.shape[1]])
        still = self.temperatures @ self.supplies(point[:count])
        return still - self.per_heat @ flows + self.levels @ levels


@dataclass(frozen=True, eq=False)
class SlidingParts(Rebuilt):
    """Contacts that make heat as they slide."""

    has_own_sizes: ClassVar[bool] = True

    contacts: Annotated[Integers, "k"]  #: their numbers
    #: heat per force of each; names are those of the parameters and the coordinates
    factors: tuple[Scalar, ...]
    conditions: Annotated[Integers, "g"]  #: numbers of their conditions
    places: Annotated[Floats, "g", "d"]  #: of these conditions

    @classmethod
    def none(cls) -> Self:
        """Parts where no surface slides."""
        nothing = np.zeros(0, dtype=np.int64)
        return cls(nothing, (), nothing, np.zeros((0, 0)))


@dataclass(frozen=True, eq=False)
class HeatParts(Rebuilt):
    """All that a model with heat is made of."""

    has_own_sizes: ClassVar[bool] = True

    parameters: ParameterSpace  #: of the user
    #: condensed model of the scene with heat flows and levels as further parameters
    mechanical: CondensedModel
    conduction: Conduction
    contacts: Annotated[Integers, "c"]  #: numbers of the contacts with a conductance, (c,)
    #: their conductances; the last two names are the pressure and the gap
    conductances: tuple[Scalar, ...]
    areas: Annotated[Floats, "m"]  #: tributary areas, (m,)
    #: contacts that make heat as they slide
    sliding: SlidingParts = field(default_factory=SlidingParts.none)

    def outputs_by_condition(self, pairs: np.ndarray) -> dict[str, np.ndarray]:
        """Numbers among the outputs of heat: of the flow to which each condition adds, (m,), and of
        the heat of friction, (g,); -1 for none.

        Args:
            pairs: contact of each condition, (m,).
        """
        return {
            "flow_output": _places(pairs, self.contacts),
            "friction_output": _places(pairs[self.sliding.conditions], self.sliding.contacts),
        }


def _places(pairs: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Place of each contact among known ones; -1 for others."""
    numbers = known.tolist()
    return np.array(
        [numbers.index(pair) if pair in numbers else -1 for pair in pairs.tolist()], dtype=np.int64
    )


@dataclass(frozen=True, eq=False)
class TransientParts(Rebuilt):
    """All that a model with transient heat is made of; its levels are modes."""

    has_own_sizes: ClassVar[bool] = True

    heated: HeatParts
    rates: Annotated[Floats, "b"]  #: of decay, 1 / time
    grown: Annotated[Floats, "b", "t"]  #: growth of amplitudes per supply and time
    drained: Annotated[Floats, "b", "m"]  #: fall of amplitudes per heat flow and time
    capacity: Annotated[csc_matrix, "n", "n"]  #: M_T, heat that nodes store per rise
    #: largest error of what one step changes, over that change, where the steady temperatures of a
    #: supply, a heat flow or a warm body vanish, by the heat that they store in that body, at
    #: lengths of steps for which modes were not made; 0 with all modes
    step_error: float
    shortest: float = 0.0  #: shortest step that modes were made for; 0 for any
    tags: tuple[Tag, ...] = ()  #: bodies
    owners: Annotated[Integers, "n"] | None = None  #: number of the body of each node
