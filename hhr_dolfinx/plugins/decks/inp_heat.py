"""Heat of a deck: conductivities, temperatures, fluxes, films, and conductances of its contacts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from hhr_dolfinx.plugins.decks.deck import DeckHeat, DeckLoad, Left, Pair, Section, Tag
from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
from hhr_dolfinx.plugins.decks.inp_steps import (
    COUPLED_STEPS,
    FILMS,
    HEATING,
    Imposed,
    KeywordBlock,
    merged,
    of_kind,
    period_of,
)
from hhr_dolfinx.plugins.decks.inp_temperatures import cells_of, initial_of
from hhr_dolfinx.plugins.decks.named import NamedParts

TEMPERATURE = 10
"""Component of a temperature in *BOUNDARY, which decks count from 1."""
BEYOND = 1e9
"""Last pressure or gap of a table, up to which its last conductance goes on."""
_BY_PRESSURE = (
    "the second number is a pressure, as in CalculiX; in Abaqus, without PRESSURE, it is a "
    "clearance: write table(g, ...)"
)
_BY_CLEARANCE = (
    "conductances fall with the second number, which is read as a clearance, as in Abaqus; in "
    "CalculiX it is a pressure: write table(p, ...)"
)
_OF_NODES = "heat of single nodes has no counterpart: hhr.HeatFlux on a surface"


@dataclass
class _HeatItems:
    """Heat of a deck while it is read."""

    temperatures: list[DeckLoad] = field(default_factory=list)
    supplies: list[DeckLoad] = field(default_factory=list)


def is_heat(imposed: Imposed) -> bool:
    """True for a row that imposes a temperature or heat, and no displacement or force.

    Args:
        imposed: the row.
    """
    keyword = imposed.block.keyword
    return keyword in HEATING or (keyword == "BOUNDARY" and imposed.component == TEMPERATURE)


def heat_of(
    blocks: Sequence[KeywordBlock],
    state: Sequence[Imposed],
    sections: Sequence[Section],
    constraints: Sequence[DeckLoad],
    parts: NamedParts,
    nodes: DeckNodes,
    todo: list[Left],
) -> DeckHeat | None:
    """Heat of a deck whose bodies conduct and follow no constraints; None of others.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        state: rows of supports, loads and heat that act.
        sections: its bodies.
        constraints: its constraints.
        parts: bodies, surfaces and sets of the mesh.
        nodes: nodes of the deck by number.
        todo: list to which TODO lines are appended.
    """
    heated = [row for row in state if is_heat(row)]
    steps = of_kind(blocks, *COUPLED_STEPS)
    if not heated and not steps:
        return None
    constrained = next(iter(constraints), None)
    if constrained is not None:
        reason = "no HEAT is written: heat is for bodies without constraints, such as ties"
        todo.append(Left(constrained.source, "heat", reason))
        return None
    lacking = [section for section in sections if section.material.conductivity is None]
    if lacking:
        first = heated[0].block if heated else steps[0]
        reason = f"no HEAT is written, as body '{lacking[0].tag}' has no *CONDUCTIVITY"
        todo.append(first.left(reason))
        return None
    found = _HeatItems()
    for row in merged(heated):
        _read(row, sections, parts, found, todo)
    todo += [
        block.left("contact and heat are solved together here, not one after another")
        for block in steps
        if block.keyword.startswith("UNCOUPLED")
    ]
    last = steps[-1] if steps else None
    transient = last is not None and "STEADY STATE" not in last.options
    if last is not None and transient:
        todo += _of_time(last, heated, sections)
    start = _starts(blocks, sections, nodes, todo)
    return DeckHeat(
        tuple(found.temperatures),
        tuple(found.supplies),
        start,
        period_of(last) if last is not None and transient else 0.0,
    )


def _of_time(
    step: KeywordBlock, heated: Sequence[Imposed], sections: Sequence[Section]
) -> Iterator[Left]:
    """TODO lines of a step in time."""
    lacking = [section.tag for section in sections if section.material.capacity is None]
    if lacking:
        yield step.left(
            f"body '{lacking[0]}' has no *DENSITY or no *SPECIFIC HEAT: the steady state is written"
        )
    varied = {row.block.source: row.block for row in heated if "AMPLITUDE" in row.block.options}
    for block in varied.values():
        yield block.left(
            "AMPLITUDE: its value at the end counts in all steps here: give model.march a point "
            "for each step"
        )


def _read(
    row: Imposed,
    sections: Sequence[Section],
    parts: NamedParts,
    found: _HeatItems,
    todo: list[Left],
) -> None:
    """Add the heat of a row, or a TODO line."""
    block = row.block
    source = block.source
    label = row.row[1].upper()
    surface = parts.surface(row.place)
    if block.keyword == "BOUNDARY":
        place = parts.place(row.place)
        if place is None:
            todo.append(block.left(f"'{row.row[0]}' is no node of the mesh"))
            return
        text = f"hhr.FixedTemperature({place!r}, {{}})"
        found.temperatures.append(DeckLoad("temperature", text, row.factor, source))
    elif block.keyword == "CFLUX":
        todo.append(block.left(_OF_NODES))
    elif label == "BF":
        tags = parts.bodies_in(row.row[0], [section.tag for section in sections])
        todo += [] if tags else [block.left(f"'{row.row[0]}' holds no whole body")]
        for tag in tags:
            text = f"hhr.HeatSource({tag!r}, {{}})"
            found.supplies.append(DeckLoad("power", text, row.factor * row.unit, source))
    elif label[:1] not in ("S", "F") or not set(label[1:]) <= set("123456"):
        todo.append(block.left(f"no counterpart: {label}"))
    elif surface is None:
        todo.append(block.left(f"'{row.row[0]}' is no surface of the mesh"))
    elif block.keyword in FILMS:
        coefficient = block.value(row.row, 3)
        text = f"hhr.Convection({surface!r}, {coefficient!r}, {{}})"
        found.supplies.append(DeckLoad("surroundings", text, row.factor * row.unit, source))
    else:
        text = f"hhr.HeatFlux({surface!r}, {{}})"
        found.supplies.append(DeckLoad("flux", text, row.factor * row.unit, source))


def _starts(
    blocks: Sequence[KeywordBlock],
    sections: Sequence[Section],
    nodes: DeckNodes,
    todo: list[Left],
) -> Mapping[Tag, float]:
    """Initial temperature of each body, which is that without thermal strain."""
    values = initial_of(blocks, nodes)
    starts: dict[Tag, float] = {}
    for section in sections:
        of_body = {
            values.get(number, 0.0)
            for _, numbers in cells_of(nodes, section.tag)
            for number in numbers
        }
        starts[section.tag] = min(of_body, default=0.0)
        if len(of_body) > 1:
            first = starts[section.tag]
            reason = f"body '{section.tag}' has several temperatures: its reference is {first:g}"
            todo.append(Left(section.source, "*INITIAL CONDITIONS", reason))
    return starts


def with_conductances(
    blocks: Sequence[KeywordBlock], pairs: Sequence[Pair], todo: list[Left]
) -> tuple[Pair, ...]:
    """Pairs with their conductances and heat of friction, and without friction.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        pairs: its contact pairs.
        todo: list to which TODO lines are appended.
    """
    given = _of_interactions(blocks, todo)
    stated = {block.source: block.word("INTERACTION") for block in of_kind(blocks, "CONTACT PAIR")}
    heated = []
    for pair in pairs:
        conductance, heat = given.get(stated.get(pair.source, ""), ("", None))
        sliding = ""
        if heat is not None:
            sliding = _sliding(heat, pair.friction, todo)
        if pair.friction:
            reason = "heat is for pairs without friction: friction= is left out of the pair"
            todo.append(Left(pair.source, "*FRICTION", reason))
        if pair.curve:
            reason = f"heat is for hard contact: law={pair.curve} is left out of the pair"
            todo.append(Left(pair.source, "*SURFACE BEHAVIOR", reason))
        changed = replace(pair, friction=0.0, curve="")
        heated.append(replace(changed, conductance=conductance, sliding=sliding))
    return tuple(heated)


def _sliding(block: KeywordBlock, friction: float, todo: list[Left]) -> str:
    """Heat of friction as text of Python; empty without a speed."""
    share = block.value(block.rows[0], 1)
    speed = block.value(block.rows[0], 2)
    if len(block.rows[0]) < 2 or not block.rows[0][1]:
        share = 0.5
    coefficient = friction * block.value(block.rows[0], 0)
    if not coefficient:
        todo.append(block.left("its pair has no *FRICTION, and makes no heat"))
        return ""
    if speed <= 0:
        todo.append(
            block.left(
                "the speed is that of the surfaces, which is not read: give it, "
                f"sliding={{CONTACT: hhr.SlidingHeat({coefficient!r}, SPEED, {share!r})}} of HEAT"
            )
        )
        return ""
    return f"hhr.SlidingHeat({coefficient!r}, {speed!r}, {share!r})"


def _of_interactions(
    blocks: Sequence[KeywordBlock], todo: list[Left]
) -> dict[str, tuple[str, KeywordBlock | None]]:
    """Conductance, and heat of friction, by the name of the interaction in capitals."""
    found: dict[str, tuple[str, KeywordBlock | None]] = {}
    name = ""
    for block in blocks:
        if block.keyword == "SURFACE INTERACTION":
            name = block.option("NAME").upper()
            found[name] = ("", None)
        elif block.keyword == "GAP CONDUCTANCE" and block.rows and name:
            found[name] = (_conductance(block, todo), found[name][1])
        elif block.keyword == "GAP HEAT GENERATION" and block.rows and name:
            found[name] = (found[name][0], block)
    return found


def _conductance(block: KeywordBlock, todo: list[Left]) -> str:
    """Conductance as a number, or a formula of the pressure or the gap, as text of Python."""
    rows = [(*block.numbers(row), 0.0, 0.0)[:3] for row in block.rows]
    first = [row[:2] for row in rows if row[2] == rows[0][2]]
    if len(first) < len(rows):
        todo.append(block.left(f"depends on temperature: that at {rows[0][2]:g} counts"))
    if len(first) == 1:
        return repr(first[0][0])
    at = [place for _, place in first]
    values = [value for value, _ in first]
    variable = "p"
    if "PRESSURE" not in block.options:
        falls = values[-1] < values[0]
        variable = "g" if falls else "p"
        todo.append(block.left(_BY_CLEARANCE if falls else _BY_PRESSURE))
    points = list(_points(at, values))
    return repr(f"table({variable}, {', '.join(points)})")


def _points(at: Sequence[float], values: Sequence[float]) -> Iterator[str]:
    """Points of a table that goes on with its first and last values."""
    if at[0] > 0:
        yield f"0.0, {values[0]!r}"
    yield from (f"{place!r}, {value!r}" for place, value in zip(at, values, strict=True))
    yield f"{BEYOND!r}, {values[-1]!r}"
