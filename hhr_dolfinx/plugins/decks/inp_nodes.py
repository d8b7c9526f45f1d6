"""Nodes of a deck by their numbers: which are no nodes of cells, and their coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.abaqus_blocks import STRIDE, DeckContents
from hhr_dolfinx.geometries.cells import DIMENSION


@dataclass(frozen=True)
class DeckNodes:
    """Nodes of a deck whose parts are joined; numbers are those of the joined deck."""

    deck: DeckContents

    def numbers(self, word: str) -> tuple[int, ...]:
        """Nodes of a set, or one by its number, ``7`` or ``Instance.7``.

        Empty if there are none.
        """
        name = word.upper()
        if name in self.deck.node_sets:
            return tuple(self.deck.members(name))
        instance, _, local = name.rpartition(".")
        first = {
            name_of_instance.upper(): k * STRIDE
            for k, name_of_instance in enumerate(self.deck.instances, start=1)
        } | {"": 0}
        number = first.get(instance, 0) + int(local) if local.isdigit() else 0
        return (number,) if number in self.deck.nodes else ()

    def single(self, word: str) -> int | None:
        """The one node of a word; None for none and for several."""
        numbers = self.numbers(word)
        return numbers[0] if len(numbers) == 1 else None

    def point(self, number: int) -> np.ndarray:
        """Coordinates of a node, (3,).

        Raises:
            FileContentError: for a node that the deck does not have.
        """
        if number not in self.deck.nodes:
            raise FileContentError(
                f"node {self.deck.label(number)} of an element or a set is not in the deck"
            )
        return np.array(self.deck.nodes[number])

    @cached_property
    def cells(self) -> list[int]:
        """Numbers of the elements of the highest dimension."""
        kinds = {
            number: DIMENSION.get(kind, 3 if kind != "line" else 1)
            for number, (kind, _) in self.solids.items()
        }
        most = max(kinds.values(), default=0)
        return [number for number, dim in kinds.items() if dim == most]

    @cached_property
    def of_cells(self) -> frozenset[int]:
        """Nodes of the elements of the highest dimension."""
        return frozenset(node for number in self.cells for node in self.deck.whole[number])

    @property
    def types(self) -> set[str]:
        """Types of the elements of the highest dimension."""
        return {self.deck.types[number].strip() for number in self.cells}

    @property
    def solids(self) -> dict[int, tuple[str, list[int]]]:
        """Elements without rigid ones and lines."""
        return {
            number: element
            for number, element in self.deck.elements.items()
            if element[0] != "line" and not self.deck.types[number].startswith("R")
        }

    def free_of_cells(self, word: str) -> bool:
        """True for nodes that are all no nodes of cells."""
        numbers = self.numbers(word)
        return bool(numbers) and not self.of_cells & set(numbers)
