"""Facet ``deck`` of friction: lines of decks for CalculiX and Abaqus."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from hhr_dolfinx.plugins.friction.pair_laws import Law

STICK = 0.1
"""Stiffness of sticking contacts in a deck, as a part of that of pressures."""


class FrictionDeck:
    """See :class:`hhr_dolfinx.plugins.exporters.deck.LawInDeck`."""

    def limited(self, law: Law) -> bool:
        """True with a limit of the tangential stress."""
        return law.limit is not None

    def lines(self, law: Law, number: Callable[[float | str], float], penalty: float) -> Iterator[str]:
        """Coefficient of friction, unless it is zero, which CalculiX refuses."""
        coefficient = 0.0 if law.coefficient is None else number(law.coefficient)
        if coefficient > 0.0:
            yield from ("*FRICTION", f"{coefficient:.6g}, {STICK * penalty:.6e}")


DECK = FrictionDeck()
