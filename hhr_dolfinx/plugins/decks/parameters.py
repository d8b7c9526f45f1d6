"""Parameters of a scene from a deck: at most three quantities, each within 20 % of its value in the
deck.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hhr_dolfinx.plugins.decks.deck import Deck, Item

MOST_PARAMETERS = 3
"""Parameters of a scene: two or three can be plotted, and training grows with their number."""
SPREAD = 0.2
"""Half of the width of the box over the value of the deck, which lies in its middle."""


@dataclass(frozen=True)
class Proposed:
    """A parameter, its value in the deck, which is 1 for a factor of several values, and the values
    that it drives.
    """

    name: str
    value: float
    items: Mapping[
        Item, float
    ]  #: parts of the deck with their values, which are proportional to the parameter
    #: fractions of the value at the times of the history of the deck
    course: tuple[float, ...] = ()
    free: bool = True  #: False for one that follows its course with the values of the deck

    @property
    def box(self) -> tuple[float, float]:
        """Bounds of the value, of which the smaller comes first."""
        low, high = sorted(_short((1 + change) * self.value) for change in (-SPREAD, SPREAD))
        return (low, high) if self.free else (self.value, self.value)

    @property
    def reach(self) -> tuple[float, float]:
        """Bounds over the whole course."""
        ends = [_short(fraction * end) for fraction in self.course or (1.0,) for end in self.box]
        return min(ends), max(ends)

    def amplitude(self, value: float) -> str:
        """Amplitude that is ``value`` at the value of the deck, as text of Python."""
        return (
            repr(self.name)
            if value == self.value
            else f"hhr.Amplitude(slopes={{{self.name!r}: {value!r}}})"
        )

    def at(self, number: int) -> str:
        """Value at a time of the history, as text of Python.

        A number, or a formula if the parameter is free.
        """
        fraction = self.course[number]
        if not (self.free and fraction):
            return repr(_short(fraction * self.value))
        over = (
            f"{_short(fraction * self.value)!r} / {self.value!r}"
            if self.value != 1
            else repr(fraction)
        )
        return repr(self.name if fraction == 1 else f"{over} * {self.name}")


def proposed(deck: Deck) -> tuple[Proposed, ...]:
    """Parameters of a scene, one for each block of the deck.

    Preloads, loads, imposed displacements and gaps come first. Moduli are parameters only without
    others: models of them are larger, and none is exact for a body that contact alone holds. Along
    a history further parameters drive other quantities that change.
    """
    groups = _groups(deck)
    chosen = groups[:MOST_PARAMETERS]
    kinds = [group.kind for group in chosen]
    parameters = []
    for number, (kind, course, driven) in enumerate(chosen):
        values = set(driven.values())
        value = values.pop() if len(values) == 1 else 1.0
        parameters.append(
            Proposed(
                _numbered(kind, kinds.count(kind), kinds[:number].count(kind)),
                value,
                driven,
                course,
            )
        )
    further: dict[tuple[float, ...], dict[Item, float]] = {}
    for _, course, driven in groups[MOST_PARAMETERS:]:
        if len(set(course)) > 1:
            further.setdefault(course, {}).update(driven)
    for number, (course, driven) in enumerate(further.items()):
        parameters.append(
            Proposed(_numbered("others", len(further), number), 1.0, driven, course, free=False)
        )
    return tuple(parameters)


class _Group(NamedTuple):
    """Parts of one block of the deck with one course, and their values."""

    kind: str
    course: tuple[float, ...]
    items: dict[Item, float]


def _groups(deck: Deck) -> list[_Group]:
    """Groups of all parts whose values are not zero, in the order in which they become
    parameters.
    """
    courses = deck.history.courses if deck.history else {}
    quantities: list[tuple[str, Item, float]] = [
        (part_of_deck.kind, part_of_deck, part_of_deck.value) for part_of_deck in deck.constraints
    ]
    quantities += [
        (part_of_deck.kind, part_of_deck, part_of_deck.value) for part_of_deck in deck.loads
    ]
    quantities += [
        ("displacement", part_of_deck, part_of_deck.value) for part_of_deck in deck.supports
    ]
    if deck.heat is not None:
        quantities += [
            (heated.kind, heated, heated.value)
            for heated in (*deck.heat.temperatures, *deck.heat.supplies)
        ]
    quantities += [("gap", part_of_deck, part_of_deck.gap) for part_of_deck in deck.pairs]
    quantities += [
        ("motion", part_of_deck, math.hypot(*part_of_deck.motion))
        for part_of_deck in deck.pairs
        if part_of_deck.motion
    ]
    groups: dict[tuple[str, str, tuple[float, ...]], _Group] = {}
    for kind, part_of_deck, value in quantities:
        if value:
            course = courses.get(part_of_deck, ())
            groups.setdefault((kind, part_of_deck.source, course), _Group(kind, course, {})).items[
                part_of_deck
            ] = value
    return [*groups.values()] or [
        _Group("young", (), {part_of_deck: part_of_deck.material.young})
        for part_of_deck in deck.sections
    ]


def _short(value: float) -> float:
    """The number without its round-off, and without the sign of zero."""
    return float(f"{value:.12g}") + 0.0


def _numbered(kind: str, count: int, number: int) -> str:
    return kind if count == 1 else f"{kind}_{1 + number}"


def amplitudes(parameters: Sequence[Proposed]) -> Mapping[Item, str]:
    """Amplitudes of the parts that parameters drive, as texts of Python."""
    return {
        driven: parameter.amplitude(value)
        for parameter in parameters
        for driven, value in parameter.items.items()
    }
