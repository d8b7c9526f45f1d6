"""Parameters of a scene from a deck: at most three quantities, each within 20 % of its value in the deck."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hhr_dolfinx.plugins.decks.deck import Deck, Load, Pair, Section, Support

MOST = 3
"""Parameters of a scene: two or three can be plotted, and training grows with their number."""
SPREAD = 0.2
"""Half of the width of the box over the value of the deck, which lies in its middle."""
Item = Load | Support | Pair | Section


@dataclass(frozen=True)
class Proposed:
    """A parameter, its value in the deck, which is 1 for a factor of several values, and the values that it drives."""

    name: str
    value: float
    items: Mapping[Item, float]

    @property
    def box(self) -> tuple[float, float]:
        """Bounds, of which the smaller comes first."""
        low, high = sorted(round((1 + part) * self.value, 15) for part in (-SPREAD, SPREAD))
        return low, high

    def amplitude(self, value: float) -> str:
        """Amplitude that is ``value`` at the value of the deck, as text of Python."""
        return repr(self.name) if value == self.value else f"hhr.Amplitude(slopes={{{self.name!r}: {value!r}}})"


def proposed(deck: Deck) -> tuple[Proposed, ...]:
    """Parameters, one for each block of the deck: loads, then imposed displacements and gaps, then moduli.

    Moduli are parameters only without others: models of them are larger, and none is exact for a body that contact
    alone holds.
    """
    groups: dict[tuple[str, str], dict[Item, float]] = {}
    driven: list[tuple[str, Item, float]] = [(item.kind, item, item.value) for item in deck.loads]
    driven += [("displacement", item, item.value) for item in deck.supports]
    driven += [(item.kind, item, item.value) for item in deck.constraints]
    driven += [("gap", item, item.gap) for item in deck.pairs]
    driven += [("motion", item, math.hypot(*item.motion)) for item in deck.pairs if item.motion]
    for kind, item, value in driven:
        if value:
            groups.setdefault((kind, item.source), {})[item] = value
    if not groups:
        groups = {("young", item.source): {item: item.material.young} for item in deck.sections}
    kept = list(groups.items())[:MOST]
    kinds = [kind for (kind, _), _ in kept]
    found = []
    for number, (kind, (_, items)) in enumerate(zip(kinds, kept, strict=True)):
        name = kind if kinds.count(kind) == 1 else f"{kind}_{1 + kinds[:number].count(kind)}"
        values = set(items.values())
        found.append(Proposed(name, values.pop() if len(values) == 1 else 1.0, items))
    return tuple(found)


def amplitudes(parameters: Sequence[Proposed]) -> Mapping[Item, str]:
    """Amplitudes of the parts that parameters drive, as texts of Python."""
    return {item: one.amplitude(value) for one in parameters for item, value in one.items.items()}
