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
    deck: Deck, found: Sequence[KeywordBlock], read: Callable[[Sequence[Imposed]], Deck]
) -> Deck:
    """Deck with the history of its quantities, or as it is if one step from rest leads to it.

    ``read`` makes a deck of supports and loads. It is linear in their factors, so that the value of
    a quantity at some time is that of a deck with the factors of that time.
    """
    times = _times(found)
    steps = of_kind(found, "STEP")
    if len(times) < 2:
        return deck
    if len(times) > MOST_TIMES:
        return _with_one_step(
            deck,
            steps[-1],
            f"{len(times)} times of steps and amplitudes are more than {MOST_TIMES}",
        )
    states = _states(found, times)
    made = _followed(states, times, read)
    if isinstance(made, str):
        return _with_one_step(deck, steps[-1], made)
    if made.history is None:
        return deck
    return replace(made, left=in_order((*made.left, *_released(found, states))))


def _followed(
    states: Sequence[State], times: Sequence[float], read: Callable[[Sequence[Imposed]], Deck]
) -> Deck | str:
    """Deck with all that acts at some time, each with its largest value, and their history, None if
    nothing acts.

    The reason why it has none is returned if a quantity has no one course.
    """
    items, factors = _courses(states, merged=True)
    if not _one_course_by_name(items, factors):
        # a later step gives only some nodes of a block again: rows of different blocks stay apart
        items, factors = _courses(states, merged=False)
    # at rest nothing acts, and temperatures are the initial ones
    rest = [replace(item, factor=0.0) for item in items if item.block.keyword != "TEMPERATURE"]
    acting = [
        [replace(item, factor=one) for item, one in zip(items, own, strict=True)]
        for own in zip(*factors, strict=True)
    ]
    decks = [read(state) for state in (rest, *acting)]
    largest = read(
        [replace(item, factor=max(own, key=abs)) for item, own in zip(items, factors, strict=True)]
    )
    largest = _with_temperatures(largest, decks)
    amounts = _amounts(largest)
    if len(amounts) < sum(
        map(len, (largest.constraints, largest.loads, largest.supports, largest.pairs))
    ):
        return "rows of one block impose one quantity twice"
    rows = [row for one in decks if (row := _fractions(_amounts(one), amounts)) is not None]
    if len(rows) < len(decks) or not _one_course_by_name(items, factors):
        return "values of one block change their proportions between steps"
    columns = zip(*rows, strict=True)
    courses = {
        item: course
        for (item, value), course in zip(amounts.values(), columns, strict=True)
        if value.any()
    }
    left = (*largest.left, *(item for one in decks for item in one.left))
    return replace(
        largest, history=DeckHistory((0.0, *times), courses) if courses else None, left=left
    )


def in_order(left: Iterable[Left]) -> tuple[Left, ...]:
    """Parts that are left, each once, in the order of their lines."""
    return tuple(sorted(dict.fromkeys(left), key=lambda item: int(item.source.rpartition(":")[2])))


def _with_one_step(deck: Deck, block: KeywordBlock, why: str) -> Deck:
    text = f"the answer depends on the path of the steps, and one step from rest is written: {why}"
    return replace(deck, left=in_order((*deck.left, block.left(text))))


def _times(found: Sequence[KeywordBlock]) -> list[float]:
    """Times at which courses may have corners: ends of steps, and points of amplitudes in them."""
    curves = curves_of(found)
    times: list[float] = []
    going_on: list[
        KeywordBlock
    ] = []  # amplitudes of the time of all steps, which later steps follow too
    for step in steps_of(found)[1:]:
        times += [step.start + SUDDEN * (step.end - step.start)] * step.sudden
        own = [
            curve for block in of_kind(step.blocks, *IMPOSING) if (curve := curve_of(block, curves))
        ]
        going_on += [curve for curve in own if in_total_time(curve) and curve not in going_on]
        own = [*going_on, *(curve for curve in own if not in_total_time(curve))]
        inside = (
            time + step.start * (not in_total_time(curve))
            for curve in own
            for time in points_of(curve)[0]
        )
        times += [time for time in inside if step.start < time < step.end]
        times.append(step.end)
    times.sort()
    return [
        time for before, time in pairwise([0.0, *times]) if time - before > EQUAL_TIMES * times[-1]
    ]


def _states(found: Sequence[KeywordBlock], times: Sequence[float]) -> list[State]:
    """Supports and loads at some times."""
    curves = curves_of(found)
    before: State = {}
    states = []
    for step in steps_of(found):
        after = state_after(step, before, curves)
        for time in (time for time in times if step.start < time <= step.end):
            part = 1.0 if step.sudden else (time - step.start) / (step.end - step.start)
            then = state_after(step, before, curves, time)
            states.append(then if time == step.end else _between(before, then, part))
        before = after
    return states


def _between(before: State, after: State, part: float) -> State:
    """A state in a step, of which a part is over: values without amplitudes change in proportion to
    it.
    """
    state: dict = {}
    for key in {**before, **after}:
        old = list(before.get(key, ()))
        new = list(after.get(key, ()))
        at_once = [item for item in new if "AMPLITUDE" in item.block.options]
        if old == new or (new and len(at_once) == len(new)):
            state[key] = new
        elif key.keyword == "BOUNDARY" and new:
            # of one node and component there is one value
            value = part * new[-1].factor + (1 - part) * sum(item.factor for item in old)
            state[key] = [replace(new[-1], factor=value)]
        else:
            state[key] = [replace(item, factor=(1 - part) * item.factor) for item in old]
            state[key] += [
                item if item in at_once else replace(item, factor=part * item.factor)
                for item in new
            ]
    return state


def _courses(states: Sequence[State], merged: bool) -> tuple[list[Imposed], list[list[float]]]:
    """Rows of a deck, and their factors at some times.

    Merged, rows of different steps with one place and component are one, that with the largest
    value.
    """
    items: dict[Name, Imposed] = {}
    amounts: dict[Name, list[float]] = {}
    for number, state in enumerate(states):
        for key, rows in state.items():
            for repeated, item in enumerate(rows):
                # temperatures are no multiples of each other: what counts is their rise over the
                # initial ones
                together = key.keyword != "TEMPERATURE" and (merged or key.keyword == "BOUNDARY")
                name: Name = key if together else (*key, item.block.source, repeated)
                name = (*name, *item.row[3:]) if key.keyword in ("DLOAD", "DSLOAD") else name
                amount = item.factor * item.unit
                if name not in items or abs(amount) >= abs(items[name].factor * items[name].unit):
                    items[name] = item
                amounts.setdefault(name, [0.0] * len(states))[number] += amount
    return [*items.values()], [
        [one / (item.unit or 1.0) for one in amounts[name]] for name, item in items.items()
    ]


def _one_course_by_name(items: Sequence[Imposed], factors: Sequence[Sequence[float]]) -> bool:
    """True if nodes and faces by numbers that have one name in the mesh have one course."""
    groups: dict[Name, tuple[Imposed, list[Sequence[float]]]] = {}
    for item, course in zip(items, factors, strict=True):
        if item.place != item.row[0]:
            groups.setdefault((item.place, item.component), (item, []))[1].append(course)
    return all(
        len({row[0] for row in item.block.rows if [*row[1:]] == [*item.row[1:]]}) == len(courses)
        and all(np.allclose(course, courses[0], EQUAL_TIMES, EQUAL_TIMES) for course in courses)
        for item, courses in groups.values()
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


def _released(found: Sequence[KeywordBlock], states: Sequence[State]) -> Iterator[Left]:
    """Supports that hold in some steps only, other than lengths of bolts that are fixed."""
    bolts = {block.word("NODE") for block in of_kind(found, "PRE-TENSION SECTION")}
    always = {key for key in states[0] if all(key in state for state in states)}
    for key in {key for state in states for key in state} - always:
        block = next(state[key][0].block for state in states if key in state)
        if key.keyword == "BOUNDARY" and not ("FIXED" in block.options and key.place in bolts):
            yield block.left("it holds in some of the steps: here in all of them")


def _amounts(deck: Deck) -> dict[Name, tuple[Item, np.ndarray]]:
    """Quantities of a deck with their values, (1,), or (1 + dim,) of a rigid surface that moves."""
    found: dict[Name, tuple[Item, np.ndarray]] = {}
    for load in (*deck.constraints, *deck.loads):
        found[load.kind, load.text, load.source] = load, np.array([load.value])
    for support in deck.supports:
        found[support.place, support.component, support.source] = support, np.array([support.value])
    for number, pair in enumerate(deck.pairs):
        found["pair", number] = pair, np.array([pair.gap, *pair.motion])
    return found


def _fractions(
    own: Mapping[Name, tuple[Item, np.ndarray]], amounts: Mapping[Name, tuple[Item, np.ndarray]]
) -> list[float] | None:
    """Values as fractions of others, in their order.

    None if a value is no multiple of the other one.
    """
    fractions = []
    for name, (_, whole) in amounts.items():
        value = own[name][1] if name in own else np.zeros_like(whole)
        fraction = float(value @ whole / (whole @ whole)) if whole.any() else 0.0
        if np.abs(value - fraction * whole).max() > EQUAL_TIMES * np.abs(value).max():
            return None
        fractions.append(round(fraction, 12))
    return (
        None
        if any(value.any() for name, (_, value) in own.items() if name not in amounts)
        else fractions
    )
