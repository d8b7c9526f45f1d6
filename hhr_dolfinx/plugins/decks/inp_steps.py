"""Blocks and steps of a deck: the supports and loads at the end of the last step, with their amplitudes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.abaqus_blocks import name_of_loaded, number_of
from hhr_dolfinx.plugins.decks.deck import Left

_TYPES = {"ENCASTRE": tuple(range(6)), "PINNED": (0, 1, 2), "XSYMM": (0, 4, 5), "YSYMM": (1, 3, 5), "ZSYMM": (2, 3, 4)}
"""Components that supports by a word hold, 3 to 5 are rotations of reference nodes."""


@dataclass(frozen=True)
class Block:
    """A keyword in capitals without its star, its options by names in capitals, and the words of its data lines."""

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

    def word(self, name: str) -> str:
        """An option in capitals, empty without it."""
        return self.options.get(name, "").upper()

    def number(self, word: str) -> float:
        """A number, also in the notation 1.0D+00; FileContentError for other words."""
        with suppress(ValueError):
            if word and math.isfinite(value := number_of(word)):
                return value
        raise FileContentError(f"{self.source} *{self.keyword}: '{word}' is no finite number")

    def numbers(self, row: Sequence[str], first: int = 0) -> list[float]:
        """Numbers of a data line from a word on; blank words are 0."""
        return [self.number(word) if word else 0.0 for word in row[first:]]

    def left(self, why: str) -> Left:
        """This block as one without counterpart."""
        return Left(self.source, f"*{self.keyword}", why)


def of_kind(found: Sequence[Block], *keywords: str) -> list[Block]:
    """Blocks of some keywords."""
    return [block for block in found if block.keyword in keywords]


@dataclass(frozen=True)
class Imposed:
    """A row of a support or a load that acts at the end of the last step."""

    block: Block
    row: Sequence[str]
    place: str  # name of the nodes, faces or cells
    component: int  # of a support or of a force, -1 for other loads
    factor: float  # amplitude at the end of its step, times the value of a support or of a force

    def moves(self, dim: int) -> bool:
        """True for a support that imposes a translation, or no rotation."""
        return self.block.keyword == "BOUNDARY" and (self.component < dim or not self.factor)


def imposed_of(found: Sequence[Block]) -> tuple[Imposed, ...]:
    """Supports and loads that act at the end of the last step.

    Rows of later steps replace those of the same place but FIXED ones; loads of one step add up, and of supports the
    last one holds.
    """
    state: dict[tuple[str, str, object], list[Imposed]] = {}
    curves = {block.option("NAME").upper(): block for block in of_kind(found, "AMPLITUDE")}
    end = 0.0
    period = 1.0
    seen: set[str] = set()
    of_step: set[tuple[str, str, object]] = set()
    for number, block in enumerate(found):
        if block.keyword == "STEP":
            seen = set()
            of_step = set()
            period = next(map(period_of, of_kind(found[number:], "STATIC", "VISCO")), 1.0)
            end += period
        if block.keyword not in ("BOUNDARY", "CLOAD", "DLOAD", "DSLOAD", "TEMPERATURE"):
            continue
        if block.word("OP") == "NEW" and block.keyword not in seen:
            state = {key: item for key, item in state.items() if key[0] != block.keyword}
        seen.add(block.keyword)
        factor = _factor(block, curves, period, end)
        for row in block.rows:
            for detail, item in _rows(block, row, factor):
                key = (block.keyword, row[0].upper(), detail)
                if key in state and "FIXED" in block.options:
                    continue
                before = state.pop(key, [])
                adds = key in of_step and block.keyword in ("CLOAD", "DLOAD", "DSLOAD")
                state[key] = [*before, item] if adds else [item]
                of_step.add(key)
    return tuple(item for items in state.values() for item in items)


def merged(state: Sequence[Imposed]) -> tuple[Imposed, ...]:
    """Supports and loads by the names of their nodes: the reader gives rows by numbers with the same load one name."""
    named = {
        (item.place, item.component, *item.row[1:], id(item) if item.place == item.row[0] else 0): item
        for item in state
    }
    return tuple(named.values())


def _rows(block: Block, row: Sequence[str], factor: float) -> Iterator[tuple[object, Imposed]]:
    """Quantities that a row imposes, with what tells each from others of the same place."""
    if len(row) < 2:
        raise FileContentError(f"{block.source} *{block.keyword}: '{', '.join(row)}' has too few words")
    word = row[1].upper()
    components: Sequence[int] = (-1,)
    value = 1.0
    by_number = row[0].rpartition(".")[2].isdigit()  # 7, or Instance.7
    if block.keyword == "BOUNDARY":
        first = 1 if word in _TYPES or not word else _component(block, word)
        last = _component(block, row[2]) if len(row) > 2 and row[2] else first
        components = _TYPES.get(word, range(first - 1, last))
        value = sum(block.numbers(row[:4], 3))
    elif block.keyword == "CLOAD":
        components = (_component(block, word) - 1,)
        value = sum(block.numbers(row[:3], 2))
    else:
        by_number = block.keyword == "DLOAD" and word[:1] == "P" and word[1:].isdigit()
    place = name_of_loaded(f"{block.keyword}:{block.line}", row[1:]) if by_number else row[0]
    for component in components:
        detail: object = word if block.keyword in ("DLOAD", "DSLOAD") else component
        detail = (word, *map(float, block.numbers(row, 3))) if word == "GRAV" else detail
        yield detail, Imposed(block, row, place, component, factor * value)


def _component(block: Block, word: str) -> int:
    if not word.isdigit():
        raise FileContentError(f"{block.source} *{block.keyword}: '{word}' is no number of a component, nor known")
    return int(word)


def period_of(block: Block) -> float:
    """Duration of a step by its *STATIC or *VISCO."""
    return block.number(block.rows[0][1]) if block.rows and len(block.rows[0]) > 1 and block.rows[0][1] else 1.0


def _factor(block: Block, curves: Mapping[str, Block], period: float, end: float) -> float:
    """Value of the amplitude of a block at the end of the step, 1 without one."""
    name = block.word("AMPLITUDE")
    if not name:
        return 1.0
    if name not in curves:
        raise FileContentError(f"{block.source} *{block.keyword}: there is no amplitude '{name}'")
    curve = curves[name]
    values = [curve.number(word) for row in curve.rows for word in row if word]
    if len(values) % 2 or not values:
        raise FileContentError(f"{curve.source} *AMPLITUDE needs pairs of a time and a value")
    time = end if curve.word("TIME").startswith("TOTAL") else period
    delay = curve.number(block.options.get("TIME DELAY", "0"))
    return float(np.interp(time - delay, values[::2], values[1::2]))
