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
        low, high = sorted(_short((1 + part) * self.value) for part in (-SPREAD, SPREAD))
        return (low, high) if self.free else (self.value, self.value)

    @property
    def reach(self) -> tuple[float, float]:
        """Bounds over the whole course."""
        ends = [_short(part * end) for part in self.course or (1.0,) for end in self.box]
        return min(ends), max(ends)

    def amplitude(self, value: float) -> str:
        """Amplitude that is ``value`` at the value of the deck, as text of Python."""
        return (
            repr(self.name)
            if value == self.value
            else f"hhr.Amplitude(slopes={{{self.name!r}: {value!r}}})"
        )

    def at(self, number: int) -> str:
        """Value at a time of the history, as text of Python: a number, or a formula if it is
        free.
        """
        part = self.course[number]
        if not (self.free and part):
            return repr(_short(part * self.value))
        over = f"{_short(part * self.value)!r} / {self.value!r}" if self.value != 1 else repr(part)
        return repr(self.name if part == 1 else f"{over} * {self.name}")


def proposed(deck: Deck) -> tuple[Proposed, ...]:
    """Parameters, one for each block of the deck: preloads, loads, imposed displacements and gaps,
    then moduli.

    Moduli are parameters only without others: models of them are larger, and none is exact for a
    body that contact alone holds. Along a history further parameters drive what changes beside
    them.
    """
    groups = _groups(deck)
    chosen = groups[:MOST_PARAMETERS]
    kinds = [group.kind for group in chosen]
    found = []
    for number, (kind, course, items) in enumerate(chosen):
        values = set(items.values())
        value = values.pop() if len(values) == 1 else 1.0
        found.append(
            Proposed(
                _numbered(kind, kinds.count(kind), kinds[:number].count(kind)), value, items, course
            )
        )
    others: dict[tuple[float, ...], dict[Item, float]] = {}
    for _, course, items in groups[MOST_PARAMETERS:]:
        if len(set(course)) > 1:
            others.setdefault(course, {}).update(items)
    for number, (course, items) in enumerate(others.items()):
        found.append(
            Proposed(_numbered("others", len(others), number), 1.0, items, course, free=False)
        )
    return tuple(found)


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
    parts: list[tuple[str, Item, float]] = [
        (item.kind, item, item.value) for item in deck.constraints
    ]
    parts += [(item.kind, item, item.value) for item in deck.loads]
    parts += [("displacement", item, item.value) for item in deck.supports]
    parts += [("gap", item, item.gap) for item in deck.pairs]
    parts += [("motion", item, math.hypot(*item.motion)) for item in deck.pairs if item.motion]
    groups: dict[tuple[str, str, tuple[float, ...]], _Group] = {}
    for kind, item, value in parts:
        if value:
            course = courses.get(item, ())
            groups.setdefault((kind, item.source, course), _Group(kind, course, {})).items[item] = (
                value
            )
    return [*groups.values()] or [
        _Group("young", (), {item: item.material.young}) for item in deck.sections
    ]


def _short(value: float) -> float:
    """The number without its round-off, and without the sign of zero."""
    return float(f"{value:.12g}") + 0.0


def _numbered(kind: str, count: int, number: int) -> str:
    return kind if count == 1 else f"{kind}_{1 + number}"


def amplitudes(parameters: Sequence[Proposed]) -> Mapping[Item, str]:
    """Amplitudes of the parts that parameters drive, as texts of Python."""
    return {item: one.amplitude(value) for one in parameters for item, value in one.items.items()}
