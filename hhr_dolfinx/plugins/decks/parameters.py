"""Parameters of a scene from a deck: at most three quantities, each within 20 % of its value in the deck."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from hhr_dolfinx.plugins.decks.deck import Deck, Load, Pair, Section, Support

MOST = 3
"""Parameters of a scene: the tables of answers to more are long, and two or three can be plotted."""
SPREAD = 0.2
"""Half of the width of the box over the value of the deck, which lies in its middle."""
Item = Load | Support | Pair | Section


@dataclass(frozen=True)
class Proposed:
    """A parameter.

    Attributes:
        name: its name.
        value: value of the deck, or 1 for a common factor of several values.
        items: parts that it drives, with their values.
    """

    name: str
    value: float
    items: tuple[tuple[Item, float], ...]

    @property
    def box(self) -> tuple[float, float]:
        """Bounds, of which the smaller comes first."""
        low, high = sorted(((1 - SPREAD) * self.value, (1 + SPREAD) * self.value))
        return low, high

    def amplitude(self, value: float) -> str:
        """Text of Python of an amplitude that is ``value`` at the value of the deck."""
        if value == self.value:
            return repr(self.name)
        return f"hhr.Amplitude(slopes={{{self.name!r}: {value / self.value!r}}})"


def proposed(deck: Deck) -> tuple[Proposed, ...]:
    """Parameters: loads first, then imposed displacements and gaps. Moduli only without these.

    Each modulus as a parameter makes models larger, and bodies that contact alone holds have none that is exact.
    """
    groups = list(_groups(deck))
    if not groups:
        groups = [(f"young_{_word(item.tag)}", [(item, item.material.young)]) for item in deck.sections]
    names: list[str] = []
    found = []
    for kind, items in groups[:MOST]:
        count = sum(kind == other for other, _ in groups[:MOST])
        name = kind if count == 1 else f"{kind}_{1 + sum(one.startswith(f'{kind}_') for one in names)}"
        names.append(name)
        values = {value for _, value in items}
        found.append(Proposed(name, values.pop() if len(values) == 1 else 1.0, tuple(items)))
    return tuple(found)


def _groups(deck: Deck) -> Iterator[tuple[str, Sequence[tuple[Item, float]]]]:
    """Kinds and parts that change by one parameter: those of one block of the deck."""
    blocks: dict[tuple[str, str], list[tuple[Item, float]]] = {}
    for load in deck.loads:
        blocks.setdefault((load.kind, load.source), []).append((load, load.value))
    for support in deck.supports:
        if support.value:
            blocks.setdefault(("displacement", support.source), []).append((support, support.value))
    for pair in deck.pairs:
        if pair.gap:
            blocks.setdefault(("gap", pair.source), []).append((pair, pair.gap))
    for (kind, _), items in blocks.items():
        yield kind, items


def _word(tag: object) -> str:
    return re.sub(r"\W", "_", str(tag))


def amplitudes(parameters: Sequence[Proposed]) -> Mapping[Item, str]:
    """Amplitudes of the parts that parameters drive, as texts."""
    return {item: one.amplitude(value) for one in parameters for item, value in one.items}
