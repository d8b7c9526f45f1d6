"""Steps and amplitudes of a deck as courses of its quantities, for answers that depend on the
path.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from hhr_dolfinx.plugins.decks.deck import Deck, DeckHistory, Item, Left
from hhr_dolfinx.plugins.decks.inp_steps import (
    IMPOSING,
    Imposed,
    Key,
    KeywordBlock,
    State,
    curve_of,
    curves_of,
    in_total_time,
    of_kind,
    points_of,
    state_after,
    steps_of,
)

MOST_TIMES = 100
"""Times of a history.

More are those of a measured curve; the scene then has the end of the last step alone.
"""
SUDDEN = 1e-3
"""Part of a step over which sudden loads rise, as a path cannot jump."""
EQUAL_TIMES = 1e-9
"""Difference of times over the last one up to which they are one, and of values over their size."""
Name = tuple[Hashable, ...]
"""Identity of a row of a deck over its steps.

Of a support its place and component, which each step gives again.
"""


def with_history(
    deck: Deck, blocks: Sequence[KeywordBlock], read: Callable[[Sequence[Imposed]], Deck]
) -> Deck:
    """Deck with the history of its quantities, or unchanged if one step from rest leads to it.

    ``read`` is linear in the factors of supports and loads, so that the value of a quantity at some
    time is that of a deck with the factors of that time.

    Args:
        deck: contents at the end of the last step.
        blocks: keyword blocks of the deck, in the order of its lines.
        read: function that makes a deck of supports and loads.
    """
    times = _times(blocks)
    steps = of_kind(blocks, "STEP")
    if len(times) < 2:
        return deck
    if len(times) > MOST_TIMES:
        return _with_one_step(
            deck,
            steps[-1],
            f"{len(times)} times of steps and amplitudes are more than {MOST_TIMES}",
        )
    states = _states(blocks, times)
    followed = _followed(states, times, read)
    if isinstance(followed, str):
        return _with_one_step(deck, steps[-1], followed)
    if followed.history is None:
        return deck
    return replace(followed, left=in_order((*followed.left, *_released(blocks, states))))


def _followed(
    states: Sequence[State], times: Sequence[float], read: Callable[[Sequence[Imposed]], Deck]
) -> Deck | str:
    """Deck with all that acts at some time, each with its largest value, and their history, None if
    nothing acts.

    The reason why it has none is returned if a quantity has no one course.
    """
    rows_of_deck, factors = _courses(states, merged=True)
    if not _one_course_by_name(rows_of_deck, factors):
        # a later step gives only some nodes of a block again: rows of different blocks stay apart
        rows_of_deck, factors = _courses(states, merged=False)
    # at rest nothing acts, and temperatures are the initial ones
    at_rest = [
        replace(imposed, factor=0.0)
        for imposed in rows_of_deck
        if imposed.block.keyword != "TEMPERATURE"
    ]
    acting = [
        [
            replace(imposed, factor=factor)
            for imposed, factor in zip(rows_of_deck, course_of, strict=True)
        ]
        for course_of in zip(*factors, strict=True)
    ]
    decks = [read(state) for state in (at_rest, *acting)]
    largest = read(
        [
            replace(imposed, factor=max(course_of, key=abs))
            for imposed, course_of in zip(rows_of_deck, factors, strict=True)
        ]
    )
    largest = _with_temperatures(largest, decks)
    amounts = _amounts(largest)
    if len(amounts) < sum(
        map(len, (largest.constraints, largest.loads, largest.supports, largest.pairs))
    ):
        return "rows of one block impose one quantity twice"
    rows = [row for deck in decks if (row := _fractions(_amounts(deck), amounts)) is not None]
    if len(rows) < len(decks) or not _one_course_by_name(rows_of_deck, factors):
        return "values of one block change their proportions between steps"
    columns = zip(*rows, strict=True)
    courses = {
        quantity: course
        for (quantity, value), course in zip(amounts.values(), columns, strict=True)
        if value.any()
    }
    todo = (*largest.left, *(entry for deck in decks for entry in deck.left))
    return replace(
        largest, history=DeckHistory((0.0, *times), courses) if courses else None, left=todo
    )


def in_order(todo: Iterable[Left]) -> tuple[Left, ...]:
    """Parts that are left, each once, in the order of their lines."""
    return tuple(sorted(dict.fromkeys(todo), key=lambda item: int(item.source.rpartition(":")[2])))


def _with_one_step(deck: Deck, block: KeywordBlock, why: str) -> Deck:
    text = f"the answer depends on the path of the steps, and one step from rest is written: {why}"
    return replace(deck, left=in_order((*deck.left, block.left(text))))


def _times(blocks: Sequence[KeywordBlock]) -> list[float]:
    """Times at which courses may have corners: ends of steps, and points of amplitudes in them."""
    curves = curves_of(blocks)
    times: list[float] = []
    going_on: list[
        KeywordBlock
    ] = []  # amplitudes of the time of all steps, which later steps follow too
    for step in steps_of(blocks)[1:]:
        times += [step.start + SUDDEN * (step.end - step.start)] * step.sudden
        amplitudes = [
            curve for block in of_kind(step.blocks, *IMPOSING) if (curve := curve_of(block, curves))
        ]
        going_on += [
            curve for curve in amplitudes if in_total_time(curve) and curve not in going_on
        ]
        amplitudes = [*going_on, *(curve for curve in amplitudes if not in_total_time(curve))]
        corners = (
            time + step.start * (not in_total_time(curve))
            for curve in amplitudes
            for time in points_of(curve)[0]
        )
        times += [time for time in corners if step.start < time < step.end]
        times.append(step.end)
    times.sort()
    return [
        time for before, time in pairwise([0.0, *times]) if time - before > EQUAL_TIMES * times[-1]
    ]


def _states(blocks: Sequence[KeywordBlock], times: Sequence[float]) -> list[State]:
    """Supports and loads at some times."""
    curves = curves_of(blocks)
    before: State = {}
    states = []
    for step in steps_of(blocks):
        after = state_after(step, before, curves)
        for time in (time for time in times if step.start < time <= step.end):
            fraction = 1.0 if step.sudden else (time - step.start) / (step.end - step.start)
            then = state_after(step, before, curves, time)
            states.append(then if time == step.end else _between(before, then, fraction))
        before = after
    return states


def _between(before: State, after: State, fraction: float) -> State:
    """A state in a step, of which a part is over: values without amplitudes change in proportion to
    it.
    """
    state: dict[Key, list[Imposed]] = {}
    for key in {**before, **after}:
        old = list(before.get(key, ()))
        new = list(after.get(key, ()))
        at_once = [imposed for imposed in new if "AMPLITUDE" in imposed.block.options]
        if old == new or (new and len(at_once) == len(new)):
            state[key] = new
        elif key.keyword == "BOUNDARY" and new:
            # of one node and component there is one value
            value = fraction * new[-1].factor + (1 - fraction) * sum(
                imposed.factor for imposed in old
            )
            state[key] = [replace(new[-1], factor=value)]
        else:
            state[key] = [
                replace(imposed, factor=(1 - fraction) * imposed.factor) for imposed in old
            ]
            state[key] += [
                imposed
                if imposed in at_once
                else replace(imposed, factor=fraction * imposed.factor)
                for imposed in new
            ]
    return state


def _courses(states: Sequence[State], merged: bool) -> tuple[list[Imposed], list[list[float]]]:
    """Rows of a deck, and their factors at some times.

    Merged, rows of different steps with one place and component are one, that with the largest
    value.
    """
    imposed_rows: dict[Name, Imposed] = {}
    amounts: dict[Name, list[float]] = {}
    for number, state in enumerate(states):
        for key, rows in state.items():
            for repeated, imposed in enumerate(rows):
                # temperatures are no multiples of each other: what counts is their rise over the
                # initial ones
                together = key.keyword != "TEMPERATURE" and (merged or key.keyword == "BOUNDARY")
                name: Name = key if together else (*key, imposed.block.source, repeated)
                name = (*name, *imposed.row[3:]) if key.keyword in ("DLOAD", "DSLOAD") else name
                amount = imposed.factor * imposed.unit
                if name not in imposed_rows or abs(amount) >= abs(
                    imposed_rows[name].factor * imposed_rows[name].unit
                ):
                    imposed_rows[name] = imposed
                amounts.setdefault(name, [0.0] * len(states))[number] += amount
    return [*imposed_rows.values()], [
        [amount_at / (imposed.unit or 1.0) for amount_at in amounts[name]]
        for name, imposed in imposed_rows.items()
    ]


def _one_course_by_name(
    imposed_rows: Sequence[Imposed], factors: Sequence[Sequence[float]]
) -> bool:
    """True if nodes and faces by numbers that have one name in the mesh have one course."""
    groups: dict[Name, tuple[Imposed, list[Sequence[float]]]] = {}
    for imposed, course in zip(imposed_rows, factors, strict=True):
        if imposed.place != imposed.row[0]:
            groups.setdefault((imposed.place, imposed.component), (imposed, []))[1].append(course)
    return all(
        len({row[0] for row in imposed.block.rows if [*row[1:]] == [*imposed.row[1:]]})
        == len(courses)
        and all(np.allclose(course, courses[0], EQUAL_TIMES, EQUAL_TIMES) for course in courses)
        for imposed, courses in groups.values()
    )


def _with_temperatures(largest: Deck, decks: Sequence[Deck]) -> Deck:
    """Deck with the largest temperatures of its times: those of several steps replace each other
    and do not add up.
    """
    values: dict[Name, list[float]] = {}
    for load in (load for deck in decks for load in deck.loads):
        values.setdefault((load.kind, load.text, load.source), []).append(load.value)
    hot = [load for load in largest.loads if load.kind == "temperature"]
    most = {
        load: max(values.get((load.kind, load.text, load.source), [load.value]), key=abs)
        for load in hot
    }
    return replace(
        largest,
        loads=tuple(replace(load, value=most.get(load, load.value)) for load in largest.loads),
    )


def _released(blocks: Sequence[KeywordBlock], states: Sequence[State]) -> Iterator[Left]:
    """Supports that hold in some steps only, other than lengths of bolts that are fixed."""
    bolts = {block.word("NODE") for block in of_kind(blocks, "PRE-TENSION SECTION")}
    always = {key for key in states[0] if all(key in state for state in states)}
    for key in {key for state in states for key in state} - always:
        block = next(state[key][0].block for state in states if key in state)
        if key.keyword == "BOUNDARY" and not ("FIXED" in block.options and key.place in bolts):
            yield block.left("it holds in some of the steps: here in all of them")


def _amounts(deck: Deck) -> dict[Name, tuple[Item, np.ndarray]]:
    """Quantities of a deck with their values, (1,), or (1 + dim,) of a rigid surface that moves."""
    quantities: dict[Name, tuple[Item, np.ndarray]] = {}
    for load in (*deck.constraints, *deck.loads):
        quantities[load.kind, load.text, load.source] = load, np.array([load.value])
    for support in deck.supports:
        quantities[support.place, support.component, support.source] = (
            support,
            np.array([support.value]),
        )
    for number, pair in enumerate(deck.pairs):
        quantities["pair", number] = pair, np.array([pair.gap, *pair.motion])
    return quantities


def _fractions(
    values: Mapping[Name, tuple[Item, np.ndarray]], amounts: Mapping[Name, tuple[Item, np.ndarray]]
) -> list[float] | None:
    """Values as fractions of others, in their order.

    None if a value is no multiple of the other one.
    """
    fractions = []
    for name, (_, reference) in amounts.items():
        value = values[name][1] if name in values else np.zeros_like(reference)
        fraction = float(value @ reference / (reference @ reference)) if reference.any() else 0.0
        if np.abs(value - fraction * reference).max() > EQUAL_TIMES * np.abs(value).max():
            return None
        fractions.append(round(fraction, 12))
    return (
        None
        if any(value.any() for name, (_, value) in values.items() if name not in amounts)
        else fractions
    )
