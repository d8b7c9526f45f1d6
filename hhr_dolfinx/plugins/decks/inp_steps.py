"""Blocks and steps of a deck: the supports and loads at the end of the last step, with their
amplitudes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.abaqus_blocks import is_face, name_of_loaded, number_of
from hhr_dolfinx.plugins.decks.deck import Left

FLUXES = ("DFLUX", "DSFLUX", "CFLUX")
FILMS = ("FILM", "SFILM")
HEATING = (*FLUXES, *FILMS)
IMPOSING = ("BOUNDARY", "CLOAD", "DLOAD", "DSLOAD", "TEMPERATURE", *HEATING)
"""Keywords of supports and loads, and of heat."""
COUPLED_STEPS = ("COUPLED TEMPERATURE-DISPLACEMENT", "UNCOUPLED TEMPERATURE-DISPLACEMENT")
TIMED = ("STATIC", "VISCO", *COUPLED_STEPS)
"""Keywords of steps with a duration."""
_TYPES = {
    "ENCASTRE": tuple(range(6)),
    "PINNED": (0, 1, 2),
    "XSYMM": (0, 4, 5),
    "YSYMM": (1, 3, 5),
    "ZSYMM": (2, 3, 4),
}
"""Components that supports by a word hold, 3 to 5 are rotations of reference nodes."""


@dataclass(frozen=True)
class KeywordBlock:
    """A keyword in capitals without its star, its options by names in capitals, and the words of
    its data lines.
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
        """An option that the block must have.

        Raises:
            FileContentError: without it.
        """
        if name not in self.options:
            raise FileContentError(f"{self.source} *{self.keyword} has no option {name}=")
        return self.options[name]

    def word(self, name: str) -> str:
        """An option in capitals, empty without it."""
        return self.options.get(name, "").upper()

    def number(self, word: str) -> float:
        """A number, also in the notation 1.0D+00.

        Raises:
            FileContentError: for other words.
        """
        with suppress(ValueError):
            if word and math.isfinite(value := number_of(word)):
                return value
        raise FileContentError(f"{self.source} *{self.keyword}: '{word}' is no finite number")

    def numbers(self, row: Sequence[str], first: int = 0) -> list[float]:
        """Numbers of a data line from a word on; blank words are 0.

        Args:
            row: words of the data line.
            first: index of the first word that is read.
        """
        return [self.number(word) if word else 0.0 for word in row[first:]]

    def value(self, row: Sequence[str], place: int) -> float:
        """Number of a data line, 0 if the line ends before it.

        Args:
            row: words of the data line.
            place: index of the word.
        """
        return sum(self.numbers(row[: place + 1], place))

    def left(self, why: str) -> Left:
        """This block as one without counterpart."""
        return Left(self.source, f"*{self.keyword}", why)


def of_kind(blocks: Sequence[KeywordBlock], *keywords: str) -> list[KeywordBlock]:
    """Blocks of some keywords."""
    return [block for block in blocks if block.keyword in keywords]


@dataclass(frozen=True)
class Imposed:
    """A row of a support or a load that acts, with its value there: the factor times the unit."""

    block: KeywordBlock
    row: Sequence[str]
    place: str  #: name of the nodes, faces or cells
    component: int  #: of a support or of a force, -1 for other loads
    #: amplitude, by default at the end of its step; times the value of a support or of a force
    factor: float
    value: float = 1.0  #: the factor without the amplitude
    since: float = 0.0  #: time at which its step begins

    @property
    def unit(self) -> float:
        """Value of the row that the factor multiplies, 1 for a support or a force."""
        second = dict.fromkeys(("DLOAD", "DSLOAD", *HEATING), 2)
        index = (second | {"TEMPERATURE": 1}).get(self.block.keyword, len(self.row))
        return self.block.value(self.row, index) if index < len(self.row) else 1.0

    def moves(self, dim: int) -> bool:
        """True for a support that imposes a translation, or no rotation."""
        return self.block.keyword == "BOUNDARY" and (self.component < dim or not self.factor)


@dataclass(frozen=True)
class DeckStep:
    """A step of a deck: its first and last total time, and its blocks.

    Blocks before all steps are one, too.
    """

    start: float
    end: float
    blocks: Sequence[KeywordBlock]

    @property
    def sudden(self) -> bool:
        """True if loads without an amplitude act at once, not in proportion to the time of the
        step.

        So they do in a *VISCO, if its *STEP does not say RAMP.
        """
        kind = self.blocks[0].word("AMPLITUDE") or (
            "STEP" if of_kind(self.blocks, "VISCO") else "RAMP"
        )
        return self.blocks[0].keyword == "STEP" and kind == "STEP"


Detail = str | int | tuple[str | float, ...]
"""Label or component; of gravity with its direction."""


class Key(NamedTuple):
    """Quantity that rows of a deck impose: keyword, name or number of the place in capitals, label
    or component.
    """

    keyword: str
    place: str
    detail: Detail


State = Mapping[Key, Sequence[Imposed]]
"""Rows that act, by the quantity that they impose; rows of one quantity add up."""


def steps_of(blocks: Sequence[KeywordBlock]) -> list[DeckStep]:
    """Steps of a deck in their order, before them the blocks without a step."""
    starts = [
        0,
        *(number for number, block in enumerate(blocks) if block.keyword == "STEP"),
        len(blocks),
    ]
    steps = []
    end = 0.0
    for first, last in pairwise(starts):
        step_blocks = blocks[first:last]
        start = end
        if first:
            end += next(map(period_of, of_kind(step_blocks, *TIMED)), 1.0)
        steps.append(DeckStep(start, end, step_blocks))
    return steps


def state_after(
    step: DeckStep, before: State, curves: Mapping[str, KeywordBlock], time: float = math.inf
) -> State:
    """Supports and loads after a step, or at a time in it.

    Amplitudes have their values at this time. Rows replace those of earlier steps of the same
    quantity but FIXED ones; loads of one step add up, and of supports the last one holds. Rows of
    earlier steps keep their values, or follow their amplitudes of the time of all steps.

    Args:
        step: the step.
        before: rows that act before it.
        curves: amplitudes by name in capitals.
        time: total time, by default the end of the step.
    """
    state = {
        key: [_later(imposed, curves, min(time, step.end)) for imposed in rows_of_key]
        for key, rows_of_key in before.items()
    }
    seen: set[str] = (
        set()
    )  # keywords: of several blocks of one keyword OP=NEW of the first one counts
    of_step: set[Key] = set()  # quantities that this step has given so far
    for block in of_kind(step.blocks, *IMPOSING):
        if block.word("OP") == "NEW" and block.keyword not in seen:
            state = {
                key: rows_of_key
                for key, rows_of_key in state.items()
                if key.keyword != block.keyword
            }
        seen.add(block.keyword)
        factor = _factor(block, curves, min(time, step.end) - step.start, min(time, step.end))
        for row in block.rows:
            for detail, imposed in _rows(block, row, factor):
                key = Key(block.keyword, row[0].upper(), detail)
                if key in state and "FIXED" in block.options:
                    continue
                imposed = replace(imposed, since=step.start)
                previous = state.pop(key, [])
                adds = key in of_step and block.keyword in ("CLOAD", "DLOAD", "DSLOAD")
                state[key] = [*previous, imposed] if adds else [imposed]
                of_step.add(key)
    return state


def _later(imposed: Imposed, curves: Mapping[str, KeywordBlock], total: float) -> Imposed:
    """A row of an earlier step at a time of all steps."""
    curve = curve_of(imposed.block, curves)
    goes_on = curve is not None and in_total_time(curve)
    return (
        replace(imposed, factor=imposed.value * _factor(imposed.block, curves, total, total))
        if goes_on
        else imposed
    )


def curves_of(blocks: Sequence[KeywordBlock]) -> dict[str, KeywordBlock]:
    """Amplitudes by their names in capitals."""
    return {block.option("NAME").upper(): block for block in of_kind(blocks, "AMPLITUDE")}


def imposed_of(blocks: Sequence[KeywordBlock]) -> tuple[Imposed, ...]:
    """Supports and loads that act at the end of the last step."""
    state: State = {}
    curves = curves_of(blocks)
    for step in steps_of(blocks):
        state = state_after(step, state, curves)
    return tuple(imposed for rows in state.values() for imposed in rows)


def merged(state: Sequence[Imposed]) -> tuple[Imposed, ...]:
    """Supports and loads, of which those of numbers of nodes with one name in the mesh are one.

    The mesh has one set for all rows of a block that give the same load at numbers of nodes or
    faces.
    """
    named: dict[tuple[object, ...], Imposed] = {}
    for imposed in state:
        by_number = imposed.place != imposed.row[0]
        named[
            (imposed.place, imposed.component, *imposed.row[1:]) if by_number else (id(imposed),)
        ] = imposed
    return tuple(named.values())


def _rows(
    block: KeywordBlock, row: Sequence[str], factor: float
) -> Iterator[tuple[Detail, Imposed]]:
    """Quantities that a row imposes, each with the detail of its key."""
    if len(row) < 2:
        raise FileContentError(
            f"{block.source} *{block.keyword}: '{', '.join(row)}' has too few words"
        )
    word = row[1].upper()
    components: Sequence[int] = (-1,)
    value = 1.0
    by_number = row[0].rpartition(".")[2].isdigit()  # 7, or Instance.7
    if block.keyword == "BOUNDARY":
        first = 1 if word in _TYPES or not word else _component(block, word)
        last = _component(block, row[2]) if len(row) > 2 and row[2] else first
        components = _TYPES.get(word, range(first - 1, last))
        value = block.value(row, 3)
    elif block.keyword == "CLOAD":
        components = (_component(block, word) - 1,)
        value = block.value(row, 2)
    else:
        by_number = is_face(block.keyword, word)
    target = name_of_loaded(f"{block.keyword}:{block.line}", row[1:]) if by_number else row[0]
    for component in components:
        detail: Detail = word if block.keyword in ("DLOAD", "DSLOAD", *HEATING) else component
        if word == "GRAV":  # gravity along several directions adds up
            detail = (word, *block.numbers(row, 3))
        yield detail, Imposed(block, row, target, component, factor * value, value)


def _component(block: KeywordBlock, word: str) -> int:
    if not word.isdigit():
        raise FileContentError(
            f"{block.source} *{block.keyword}: '{word}' is no number of a component, nor known"
        )
    return int(word)


def period_of(block: KeywordBlock) -> float:
    """Duration of a step by its *STATIC, *VISCO or step of heat."""
    return (
        block.number(block.rows[0][1])
        if block.rows and len(block.rows[0]) > 1 and block.rows[0][1]
        else 1.0
    )


def points_of(curve: KeywordBlock) -> tuple[Sequence[float], Sequence[float]]:
    """Times of an amplitude, with its delay, and its values there.

    Raises:
        FileContentError: if it is no table of them.
    """
    values = [curve.number(word) for row in curve.rows for word in row if word]
    if len(values) % 2 or not values:
        raise FileContentError(f"{curve.source} *AMPLITUDE needs pairs of a time and a value")
    delay = curve.number(curve.options.get("TIME DELAY", "0"))
    return [time + delay for time in values[::2]], values[1::2]


def curve_of(block: KeywordBlock, curves: Mapping[str, KeywordBlock]) -> KeywordBlock | None:
    """Amplitude of a block, None without one.

    Args:
        block: block of supports or loads.
        curves: amplitudes by name in capitals.

    Raises:
        FileContentError: for an amplitude that the deck does not have.
    """
    name = block.word("AMPLITUDE")
    if name and name not in curves:
        raise FileContentError(f"{block.source} *{block.keyword}: there is no amplitude '{name}'")
    return curves[name] if name else None


def in_total_time(curve: KeywordBlock) -> bool:
    """True for an amplitude of the time of all steps."""
    return curve.word("TIME").startswith("TOTAL")


def _factor(
    block: KeywordBlock, curves: Mapping[str, KeywordBlock], of_step: float, total: float
) -> float:
    """Value of the amplitude of a block at a time of the step and of all steps, 1 without one."""
    curve = curve_of(block, curves)
    return (
        1.0
        if curve is None
        else float(np.interp(total if in_total_time(curve) else of_step, *points_of(curve)))
    )
