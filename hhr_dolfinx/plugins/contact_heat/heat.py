"""Heat of a scene as a user gives it: conductivities, supplies, conductances of contacts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral
from typing import Any

from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Formula, formula_of
from hhr_dolfinx.parameters import Tag, check_tag, is_number

PRESSURE_NAME = "p"
GAP_NAME = "g"
"""Names of the contact pressure and of the gap in formulas of conductances."""
BY_CONTACT = ("conductance", "sliding")
"""Properties that contacts have, and not bodies."""
EXAMPLES = {"sliding": "hhr.SlidingHeat(0.3, 2.0)"}
"""Values of properties that are no numbers, for messages."""


def _amplitude(item: Any, name: str, what: str) -> None:
    """Convert a number or text of a frozen item to a formula."""
    object.__setattr__(item, name, formula_of(getattr(item, name), f"the {name} of {what}"))


@dataclass(frozen=True)
class FixedTemperature(KnownArguments):
    """Temperature of tagged facets.

    Attributes:
        tag: facet tag, or set of nodes.
        temperature: number, or formula of the parameters as text.
    """

    tag: Tag
    temperature: float | str | Formula

    def __post_init__(self) -> None:
        check_tag("fixed temperature", self.tag)
        _amplitude(self, "temperature", f"tag {self.tag}")


@dataclass(frozen=True)
class HeatFlux(KnownArguments):
    """Heat per area and time into tagged facets.

    Attributes:
        tag: facet tag.
        flux: number, or formula of the parameters as text; power per area.
    """

    tag: Tag
    flux: float | str | Formula

    def __post_init__(self) -> None:
        check_tag("heat flux", self.tag)
        _amplitude(self, "flux", f"tag {self.tag}")


@dataclass(frozen=True)
class HeatSource(KnownArguments):
    """Heat per volume and time in a body, such as that of fission.

    Attributes:
        tag: cell tag of the body.
        power: number, or formula of the parameters as text; power per volume.
    """

    tag: Tag
    power: float | str | Formula

    def __post_init__(self) -> None:
        check_tag("heat source", self.tag)
        _amplitude(self, "power", f"body {self.tag}")


@dataclass(frozen=True)
class Convection(KnownArguments):
    """Heat that leaves tagged facets, ``coefficient`` times the excess over the surroundings.

    Attributes:
        tag: facet tag.
        coefficient: positive number, power per area and temperature.
        surroundings: temperature of the surroundings: number, or formula as text.
    """

    tag: Tag
    coefficient: float
    surroundings: float | str | Formula

    def __post_init__(self) -> None:
        check_tag("convection", self.tag)
        if not is_number(self.coefficient) or self.coefficient <= 0:
            raise SceneError(
                f"the coefficient {self.coefficient!r} of convection on tag {self.tag} must be "
                "positive"
            )
        _amplitude(self, "surroundings", f"convection on tag {self.tag}")


@dataclass(frozen=True)
class SlidingHeat(KnownArguments):
    """Heat of two surfaces that slide past each other: friction times pressure times speed, per
    area.

    The drag itself does not act: it does not change the pressure where surfaces slide out of the
    plane or about the axis, as discs and seals do; elsewhere it is left out.

    Attributes:
        friction: coefficient of friction: number, or formula of the parameters and the coordinates
            as text.
        speed: of the sliding, likewise, ``"omega * r"``; its sign does not matter.
        share: part of the heat that goes into the first surface, from 0 to 1; the second takes the
            rest, which a rigid obstacle carries away.

    Raises:
        SceneError: for a share that is not between 0 and 1, or a text that is no formula.

    Example:
        >>> hhr.SlidingHeat(friction=0.4, speed="omega * r", share=0.9).factor
        '(0.4) * abs(omega * r)'
    """

    friction: float | str | Formula
    speed: float | str | Formula
    share: float = 0.5

    def __post_init__(self) -> None:
        _amplitude(self, "friction", "sliding")
        _amplitude(self, "speed", "sliding")
        if not is_number(self.share) or not 0 <= self.share <= 1:
            raise SceneError(f"the share {self.share!r} of the first surface must be in [0, 1]")

    @property
    def factor(self) -> str:
        """Heat per area over pressure, as text."""
        friction, speed = (formula_of(one, "sliding").text for one in (self.friction, self.speed))
        return f"({friction}) * abs({speed})"


Supply = HeatFlux | HeatSource | Convection
"""Ways by which heat enters and leaves, but for fixed temperatures and contacts."""


@dataclass(frozen=True)
class Heat(KnownArguments):
    """Heat in the bodies of a scene, through its contacts, and the expansion that it causes.

    Contact i conducts conductance(p, g) times the jump of the temperature, per area: p is the
    contact pressure, not negative, g the gap. Everything is in the units of the scene: with N and
    mm a conductivity is in mW / (mm K), a conductance in mW / (mm^2 K).

    Attributes:
        conductivity: positive number of each body, by its cell tag.
        conductance: of each contact, by its number in the scene: number, or formula as text of the
            pressure ``p``, the gap ``g`` and the parameters, ``"2.5 * p**0.95 + 0.3 / (g +
            1e-3)"``. Contacts without one do not conduct.
        expansion: coefficient of linear expansion, by cell tag; bodies without one do not expand.
        reference: temperature without thermal strain: a number, or one by cell tag for each body
            that expands.
        temperatures: fixed temperatures.
        supplies: heat fluxes, heat sources and convection.
        capacity: positive heat capacity per volume of each body, density times specific heat, by
            cell tag: for :func:`condense_transient_heat`; steady heat does not read it.
        sliding: heat of contacts whose surfaces slide, by the number of the contact.

    Raises:
        SceneError: for numbers that are not positive, or unknown names in formulas.
    """

    conductivity: Mapping[Tag, float]
    conductance: Mapping[int, float | str]
    expansion: Mapping[Tag, float] = field(default_factory=dict)
    reference: float | Mapping[Tag, float] = 0.0
    temperatures: Sequence[FixedTemperature] = ()
    supplies: Sequence[Supply] = ()
    capacity: Mapping[Tag, float] = field(default_factory=dict)
    sliding: Mapping[int, SlidingHeat] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("conductivity", "conductance", "expansion", "capacity", "sliding"):
            if not isinstance(getattr(self, name), Mapping):
                raise SceneError(
                    f"the {name} {getattr(self, name)!r} of heat must be a mapping, such as "
                    f"{{1: {EXAMPLES.get(name, '50.0')}}}, by "
                    f"{'contact' if name in BY_CONTACT else 'cell tag'}"
                )
        for name, kinds in (("temperatures", FixedTemperature), ("supplies", Supply)):
            given = getattr(self, name)
            items = (given,) if isinstance(given, kinds) else given
            if not isinstance(items, Iterable):
                raise SceneError(f"the {name} {given!r} of heat must be a sequence")
            object.__setattr__(self, name, tuple(items))
            wrong = [item for item in getattr(self, name) if not isinstance(item, kinds)]
            if wrong:
                raise SceneError(f"{wrong[0]!r} does not belong to the {name} of heat")
        for contact in (*self.conductance, *self.sliding):
            if isinstance(contact, bool) or not isinstance(contact, Integral):
                raise SceneError(f"the contact {contact!r} of heat must be a whole number")
        for contact, item in self.sliding.items():
            if not isinstance(item, SlidingHeat):
                raise SceneError(
                    f"the sliding {item!r} of contact {contact} must be a "
                    "hhr.SlidingHeat(friction, speed)"
                )
        for name in ("conductivity", "capacity"):
            for tag, value in getattr(self, name).items():
                if not is_number(value) or value <= 0:
                    raise SceneError(f"the {name} {value!r} of body {tag} must be positive")
        for tag, value in self.expansion.items():
            if not is_number(value):
                raise SceneError(f"the expansion {value!r} of body {tag} must be a number")
        self._check_reference()

    def _check_reference(self) -> None:
        """Raise SceneError unless each body that expands has a reference."""
        if not isinstance(self.reference, Mapping):
            if not is_number(self.reference):
                raise SceneError(f"the reference {self.reference!r} must be a temperature")
            return
        for tag, value in self.reference.items():
            if tag not in self.conductivity:
                raise SceneError(f"the reference of heat names a body {tag!r} without conductivity")
            if not is_number(value):
                raise SceneError(f"the reference {value!r} of body {tag} must be a temperature")
        for tag in self.expansion:
            if tag not in self.reference:
                raise SceneError(f"body {tag} expands, and needs a reference: name it too")

    def reference_of(self, tag: Tag) -> float:
        """Temperature of a body without thermal strain.

        Args:
            tag: cell tag of the body.
        """
        if isinstance(self.reference, Mapping):
            return float(self.reference[tag])
        return float(self.reference)
