"""Steps of a deck: the supports and loads at the end of the last one, with their amplitudes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.plugins.decks.inp_words import Block

KINDS = ("BOUNDARY", "CLOAD", "DLOAD", "DSLOAD", "TEMPERATURE")
_TYPES = {"ENCASTRE": (0, 1, 2), "PINNED": (0, 1, 2), "XSYMM": (0,), "YSYMM": (1,), "ZSYMM": (2,)}
"""Components that supports by a word hold."""


@dataclass(frozen=True)
class Imposed:
    """A support or a load at the end of the last step.

    Attributes:
        block: its block.
        row: words of its line.
        place: name of the nodes, faces or cells that it acts on.
        component: component of a support or of a force; -1 for other loads.
        factor: value of its amplitude at the end of its step, times the value of a support or of a force.
    """

    block: Block
    row: Sequence[str]
    place: str
    component: int
    factor: float


def imposed_of(found: Sequence[Block]) -> tuple[Imposed, ...]:
    """Supports and loads that act at the end of the last step; rows of later steps replace those of the same place."""
    state: dict[tuple[str, str, object], Imposed] = {}
    curves = {block.option("NAME").upper(): block for block in found if block.keyword == "AMPLITUDE"}
    end = 0.0
    period = 1.0
    fresh: set[str] = set()
    for place, block in enumerate(found):
        if block.keyword == "STEP":
            fresh = set()
            period = next((_period(one) for one in found[place:] if one.keyword in ("STATIC", "VISCO")), 1.0)
            end += period
        if block.keyword not in KINDS:
            continue
        if block.options.get("OP", "").upper() == "NEW" and block.keyword not in fresh:
            state = {key: item for key, item in state.items() if key[0] != block.keyword}
        fresh.add(block.keyword)
        factor = _factor(block, curves, period, end)
        for row in block.rows:
            for detail, item in _rows(block, row, factor):
                key = (block.keyword, row[0].upper(), detail)
                state.pop(key, None)
                state[key] = item
    # rows by numbers that the reader gave one name
    return tuple({(item.place, item.component, *item.row[1:]): item for item in state.values()}.values())


def _rows(block: Block, row: Sequence[str], factor: float) -> Iterator[tuple[object, Imposed]]:
    """Imposed quantities of a line, each with what tells it from others of the same place."""
    if len(row) < 2:
        raise FileContentError(f"{block.source} *{block.keyword}: '{', '.join(row)}' has too few words")
    if block.keyword == "BOUNDARY":
        word = row[1].upper()
        first = 1 if word in _TYPES or not word else _component(block, row[1])
        last = _component(block, row[2]) if len(row) > 2 and row[2] else first
        components = _TYPES.get(word, range(first - 1, last))
        value = block.number(row[3]) if len(row) > 3 and row[3] else 0.0
    elif block.keyword == "CLOAD":
        components = (_component(block, row[1]) - 1,)
        value = block.number(row[2]) if len(row) > 2 else 0.0
    else:
        yield (
            row[1].upper() if block.keyword != "TEMPERATURE" else "",
            Imposed(
                block, row, block.place(row) if block.keyword == "DLOAD" and _on_faces(row) else row[0], -1, factor
            ),
        )
        return
    for component in components:
        yield component, Imposed(block, row, block.place(row), component, factor * value)


def _on_faces(row: Sequence[str]) -> bool:
    """True for a pressure on a face of elements, ``P2``."""
    return len(row[1]) == 2 and row[1][0] in "pP" and row[1][1].isdigit()


def _component(block: Block, word: str) -> int:
    if not word.isdigit():
        raise FileContentError(f"{block.source} *{block.keyword}: '{word}' is no number of a component, nor known")
    return int(word)


def _period(block: Block) -> float:
    return block.number(block.rows[0][1]) if block.rows and len(block.rows[0]) > 1 and block.rows[0][1] else 1.0


def _factor(block: Block, curves: dict[str, Block], period: float, end: float) -> float:
    """Value of the amplitude of a block at the end of the step, 1 without one."""
    name = block.options.get("AMPLITUDE", "").upper()
    if not name:
        return 1.0
    if name not in curves:
        raise FileContentError(f"{block.source} *{block.keyword}: there is no amplitude '{name}'")
    curve = curves[name]
    values = np.array([curve.number(word) for row in curve.rows for word in row if word])
    if values.size % 2 or not values.size:
        raise FileContentError(f"{curve.source} *AMPLITUDE needs pairs of a time and a value")
    time = end if curve.options.get("TIME", "").upper().startswith("TOTAL") else period
    return float(np.interp(time, values[::2], values[1::2]))


def seconds_of(found: Sequence[Block]) -> float:
    """Duration of all steps."""
    return sum(_period(block) for block in found if block.keyword in ("STATIC", "VISCO")) or 1.0


def initial_temperatures(found: Sequence[Block]) -> Iterator[tuple[str, float]]:
    """Sets of nodes and their temperatures at the start."""
    for block in found:
        if block.keyword == "INITIAL CONDITIONS" and block.options.get("TYPE", "").upper() == "TEMPERATURE":
            yield from ((row[0], block.number(row[1])) for row in block.rows if len(row) > 1)
