"""Words of a deck: a block of a keyword, its numbers, and errors with its line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.abaqus_deck import name_of_loaded
from hhr_dolfinx.plugins.decks.deck import Left


@dataclass(frozen=True)
class Block:
    """A keyword with its options and data lines.

    Attributes:
        file: name of the deck.
        line: number of the keyword's line.
        keyword: in capitals, without the star.
        options: options by their names in capitals.
        rows: words of the data lines.
    """

    file: str
    line: int
    keyword: str
    options: Mapping[str, str]
    rows: Sequence[Sequence[str]]

    @property
    def source(self) -> str:
        """File and line."""
        return f"{self.file}:{self.line}"

    def option(self, name: str) -> str:
        """An option that must be there; FileContentError without it."""
        if name not in self.options:
            raise FileContentError(f"{self.source} *{self.keyword} has no option {name}=")
        return self.options[name]

    def number(self, word: str) -> float:
        """A number, also in the notation 1.0D+00; FileContentError for other words."""
        try:
            return float(word.upper().replace("D", "E"))
        except ValueError:
            raise FileContentError(f"{self.source} *{self.keyword}: '{word}' is no number") from None

    def numbers(self, row: Sequence[str], first: int = 0) -> list[float]:
        """Numbers of a data line from a word on; blank words are 0."""
        return [self.number(word) if word else 0.0 for word in row[first:]]

    def left(self, why: str) -> Left:
        """This block as one without counterpart."""
        return Left(self.source, f"*{self.keyword}", why)

    def place(self, row: Sequence[str]) -> str:
        """Name of the nodes or faces of a row: as written, or that of the mesh reader for numbers."""
        by_number = row[0].isdigit() if self.keyword != "DLOAD" else True
        return name_of_loaded(f"{self.keyword}:{self.line}", list(row)) if by_number else row[0]
