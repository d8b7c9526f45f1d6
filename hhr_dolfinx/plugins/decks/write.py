"""A scene file of a deck, as text of Python that runs without an edit."""

from __future__ import annotations

import math
import os
import re
import textwrap
import tokenize
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from hhr_dolfinx.plugins.decks.deck import (
    Deck,
    DeckHeat,
    DeckHistory,
    DeckLoad,
    Item,
    Pair,
    Section,
    Support,
    Tag,
)
from hhr_dolfinx.plugins.decks.parameters import Proposed, amplitudes, proposed
from hhr_dolfinx.plugins.decks.with_outside import OUTSIDE_SURFACE

HEAT_STEPS = 10
"""Steps of heat in time, all of one length."""
TRAINING_STEPS = 4
"""Steps of the paths on which models of inelastic bodies are trained."""
LONGEST_LINE = 120
"""Longest line of a scene file, other than TODO lines and names of a deck, which stay whole for
searches.
"""


def scene_text(deck: Deck, file: Path, target: Path) -> str:
    """Text of a scene file.

    The mesh is named relative to the folder of the target.

    Args:
        deck: contents of the deck.
        file: file of the deck.
        target: the scene file.
    """
    parameters = proposed(deck)
    amplitude_of = amplitudes(parameters)
    mesh = Path(os.path.relpath(deck.path.absolute(), target.absolute().parent)).as_posix()
    lines = [
        f'"""Scene of {file.name}, written by hhr start.',
        "",
        *_instructions(deck, target, parameters),
        '"""',
        "",
    ]
    lines += ["from pathlib import Path", "", "import hhr_dolfinx as hhr", ""]
    lines += [
        f"MESH = Path(__file__).parent / {mesh!r}",
        *(f"# {todo_line}" for todo_line in deck.left),
        "",
    ]
    lines += [
        "scene = hhr.Scene(",
        *(f"    {row}" for row in _scene(deck, file, parameters, amplitude_of)),
        ")",
    ]
    if deck.heat is not None:
        lines += _heat(deck, deck.heat, amplitude_of)
    if deck.history is not None:
        lines += _steps(deck.history, parameters)
    elif _has_laws(deck):
        lines += _paths(deck, parameters)
    return _double_quoted("\n".join(lines) + "\n")


def _heat(deck: Deck, heat: DeckHeat, amplitude_of: Mapping[Item, str]) -> Iterator[str]:
    """Heat of the bodies and contacts, and what solves it."""
    materials = {section.tag: section.material for section in deck.sections}
    numbered = list(enumerate(deck.pairs))
    items: dict[str, dict[Tag, float | None]] = {
        "conductivity": {tag: one.conductivity for tag, one in materials.items()},
        "expansion": {tag: one.expansion for tag, one in materials.items() if one.expansion},
        "reference": {tag: start for tag, start in heat.starts.items() if materials[tag].expansion},
        "capacity": {tag: one.capacity for tag, one in materials.items() if one.capacity},
    }
    yield ""
    yield "HEAT = hhr.Heat("
    yield from (f"    {name}={value!r}," for name, value in items.items() if value)
    for name in ("conductance", "sliding"):
        texts = [f"{k}: {getattr(pair, name)}" for k, pair in numbered if getattr(pair, name)]
        if texts or name == "conductance":
            yield f"    {name}={{{', '.join(texts)}}},"
    given = {"temperatures": heat.temperatures, "supplies": heat.supplies}
    for name, loads in ((name, loads) for name, loads in given.items() if loads):
        yield f"    {name}=["
        for load in loads:
            value = _formula(amplitude_of.get(load, repr(load.value)))
            yield f"        {load.text.replace('{}', value)},  # {load.source}"
        yield "    ],"
    yield ")"
    alike = len(set(heat.starts.values())) == 1
    start = next(iter(heat.starts.values())) if alike else dict(heat.starts)
    yield ""
    yield 'if __name__ == "__main__":  # contact and heat together'
    yield "    point = scene.parameters.middle"
    if heat.seconds and len(items["capacity"]) == len(materials):
        times = [heat.seconds * (k + 1) / HEAT_STEPS for k in range(HEAT_STEPS)]
        yield "    model = hhr.condense_transient_heat(scene, HEAT)"
        yield f"    for answer in model.march(point, {times!r}, {start!r}):"
        yield "        print(answer.outputs())"
    else:
        yield "    print(hhr.condense_heat(scene, HEAT).solve(point).outputs())"


def _formula(amplitude: str) -> str:
    """An amplitude as a formula, text of Python."""
    found = re.fullmatch(r"hhr\.Amplitude\(slopes=\{'(\w+)': (.*)\}\)", amplitude)
    return amplitude if found is None else repr(f"{found[2]} * {found[1]}")


def _scene(
    deck: Deck, file: Path, parameters: Sequence[Proposed], amplitude_of: Mapping[Item, str]
) -> Iterator[str]:
    """Arguments of the scene; parts that the deck does not have are left out."""
    stem = re.sub(r"\W", "_", file.stem)
    sections: Mapping[str, list[str]] = {
        "bodies": [row for entry in deck.sections for row in _body(entry, amplitude_of)],
        "contacts": [_pair(entry, amplitude_of) for entry in deck.pairs],
        "displacements": [
            *_supports(deck.supports, 3 if deck.hypothesis == "solid" else 2, amplitude_of)
        ],
        "loads": [
            f"{entry.text.replace('{}', amplitude_of.get(entry, repr(entry.value)))},"
            f"  # {entry.source}"
            for entry in deck.loads
        ],
        "constraints": [_constraint(entry, amplitude_of) for entry in deck.constraints],
        "openings": [*_openings(deck.pairs, amplitude_of)],
        "outputs": [*_outputs(deck.pairs)],
    }
    yield f"name={stem if stem.isidentifier() else f'deck_{stem}'!r},"
    yield f"geometry={_geometry(deck)},"
    yield f"hypothesis={deck.hypothesis!r},"
    for name, rows in ((name, rows) for name, rows in sections.items() if rows):
        yield from (f"{name}=(", *(f"    {line}" for row in rows for line in _fitted(row)), "),")
    yield (f"parameters={_space([mu.name for mu in parameters], [mu.reach for mu in parameters])},")


def _space(names: Sequence[str], bounds: Sequence[tuple[float, float]]) -> str:
    lower, upper = zip(*bounds, strict=True)
    return f"hhr.ParameterSpace({tuple(names)!r}, lower={lower!r}, upper={upper!r})"


def _fitted(row: str) -> Iterator[str]:
    """A row of the scene; its comment stands above it if both are longer than a line."""
    text, mark, comment = row.rpartition(",  # ")
    if mark and len(row) > LONGEST_LINE - 8:
        yield f"# {comment}"
        row = f"{text},"
    yield from _of_table(row)


BETWEEN_ROWS = re.compile(r"(?<=[\d.]\]), (?=\[-?\d)")
"""What separates rows of numbers in a table."""


def _of_table(text: str) -> Iterator[str]:
    """Lines of a text, which end between rows of its tables: reading a line takes the square of its
    length.
    """
    line = ""
    for row in BETWEEN_ROWS.split(text):
        longer = f"{line}, {row}" if line else row
        if line and len(longer) > LONGEST_LINE - 10:
            yield f"{line},"
            longer = f"    {row}"
        line = longer
    yield line


def _double_quoted(text: str) -> str:
    """Python with its strings in double quotes, as formatters write them.

    Those that have some inside stay.
    """
    rows = text.splitlines(keepends=True)
    for token in [*tokenize.generate_tokens(iter(rows).__next__)]:
        if token.type == tokenize.STRING and token.string[0] == "'" and '"' not in token.string:
            number, start = token.start
            row = rows[number - 1]
            rows[number - 1] = f'{row[:start]}"{token.string[1:-1]}"{row[token.end[1] :]}'
    return "".join(rows)


def _geometry(deck: Deck) -> str:
    has_outside = any(repr(OUTSIDE_SURFACE) in pair.text for pair in deck.pairs)
    text = "hhr.WithOutside(MESH)" if has_outside else "hhr.MeshFile(MESH)"
    if deck.sides:
        text = "hhr.WithOutside(MESH, sides=True)"
    if deck.cuts:
        text = f"hhr.CutMesh(MESH, sections={deck.cuts!r})"
    return f"hhr.Untangled({text})" if deck.folded else text


def _outputs(pairs: Sequence[Pair]) -> Iterator[str]:
    for number, pair in enumerate(pairs):
        yield f'hhr.LargestPressure("largest pressure {number}", contact={number}),'
        if pair.direction:
            along = f"contact={number}, direction={pair.direction!r}"
            yield f'hhr.ContactForce("force {number}", {along}),'


def _has_laws(deck: Deck) -> bool:
    return any(section.material.law for section in deck.sections)


def _instructions(deck: Deck, target: Path, parameters: Sequence[Proposed]) -> Iterator[str]:
    duration = f" --duration {deck.seconds:g}" if _has_laws(deck) else ""
    middle = (
        "the middle of the box"
        if deck.proposal
        else "the middle of the box, which is the state of the file"
    )
    yield f"    hhr check {target.name}    # what is held, loaded and in contact, with a picture"
    if deck.heat is not None:
        yield f"    python {target.name}    # contact and heat together, in {middle}"
    elif deck.history is None:
        yield f"    hhr solve {target.name}{duration}    # {middle}"
    else:
        yield f"    hhr march {target.name}    # the steps of the file, one after another"
    if deck.heat is None:
        yield f"    hhr reduce {target.name}   # a small model for all of the box"
    else:
        yield ""
        yield "Other commands leave HEAT out; its parameters, of which they say that they have no"
        yield "effect, must stay."
    yield ""
    for mu in (mu for mu in parameters if mu.free):
        value = "a proposal" if deck.proposal else f"and {mu.value:g} in the file, {_origin(mu)}"
        yield f"Parameter {mu.name}: {mu.box[0]:g} to {mu.box[1]:g}, {value}."


def _origin(parameter: Proposed) -> str:
    """Lines of a parameter, and its meaning if it is no number of these lines."""
    lines = ", ".join(dict.fromkeys(driven.source for driven in parameter.items))
    texts = [driven.text for driven in parameter.items if isinstance(driven, DeckLoad)]
    if any(text.startswith("hhr.ThermalExpansion") for text in texts):
        return f"{lines}: the largest change from the initial temperature"
    if len({*parameter.items.values()}) > 1:
        return f"{lines}: a common factor"
    return lines


def _body(section: Section, amplitude_of: Mapping[Item, str]) -> Iterator[str]:
    """Rows of a body, one for each argument if they are longer than a line."""
    material = section.material
    origin = f"{section.source}: {material.name}"
    origin += f" of {material.source}" if material.source != section.source else ""
    origin += (
        ", constant after its table" if material.law.startswith("hhr.TabulatedHardening") else ""
    )
    arguments = [
        repr(section.tag),
        f"young={amplitude_of.get(section, repr(material.young))}",
        f"poisson={material.poisson!r}",
        *([f"law={material.law}"] if material.law else []),
    ]
    row = f"hhr.Body({', '.join(arguments)}),  # {origin}"
    if len(row) <= LONGEST_LINE - 8 or not material.law:
        yield row
        return
    yield f"hhr.Body(  # {origin}"
    yield from (f"    {line}" for text in arguments for line in _wrapped(f"{text},"))
    yield "),"


def _wrapped(text: str) -> list[str]:
    """Lines of a long table; text with strings stays whole, as no line may end inside of one."""
    if "'" in text:
        return [text]
    return textwrap.wrap(text, LONGEST_LINE - 12, subsequent_indent="    ", break_long_words=False)


def _pair(pair: Pair, amplitude_of: Mapping[Item, str]) -> str:
    law = (
        repr(pair.friction)
        if pair.limit == math.inf
        else f"hhr.Coulomb({pair.friction!r}, {pair.limit!r})"
    )
    friction = f", friction={law}" if pair.friction else ""
    soft = f", law={pair.curve}" if pair.curve else ""
    origin = pair.origin or (0.0,) * len(pair.motion)
    position: tuple[float | str, ...] = tuple(
        a + b for a, b in zip(origin, pair.motion, strict=True)
    )
    if pair in amplitude_of:
        # the amplitude of the length of the motion: a name, or a name and its factor
        name, factor = re.findall(r"'(\w+)'(?:: ([^}]*))?", amplitude_of[pair])[0]
        slopes = [value / math.hypot(*pair.motion) * float(factor or 1) for value in pair.motion]
        position = tuple(
            _coordinate(a, slope, name) for a, slope in zip(origin, slopes, strict=True)
        )
    return (
        f"{pair.text.replace('{}', friction + soft).replace('{place}', repr(position))},"
        f"  # {pair.source}"
    )


def _coordinate(start: float, slope: float, name: str) -> float | str:
    """A coordinate that follows a parameter."""
    return (
        (f"{start!r} + {slope!r} * {name}" if start else f"{slope!r} * {name}") if slope else start
    )


def _constraint(load: DeckLoad, amplitude_of: Mapping[Item, str]) -> str:
    amplitude = amplitude_of.get(load, repr(load.value))
    text = load.text.replace("{}", amplitude) if load.value else load.text.replace(", {}", "")
    return f"{text},  # {load.source}"


def _supports(
    supports: Sequence[Support], dim: int, amplitude_of: Mapping[Item, str]
) -> Iterator[str]:
    """One line for each component that is imposed, or for all of them where they are held."""
    held = [(support.place, support.source) for support in supports if not support.value]
    for support in supports:
        end = f"),  # {support.source}"
        if support.value:
            yield (
                f"hhr.Displacement({support.place!r}, {support.component}, "
                f"{amplitude_of.get(support, repr(support.value))}{end}"
            )
        elif held.count((support.place, support.source)) < dim:
            yield f"hhr.Displacement({support.place!r}, {support.component}{end}"
        elif support.component == 0:
            yield f"*hhr.Displacement.clamp({support.place!r}, {dim}{end}"


def _openings(pairs: Sequence[Pair], amplitude_of: Mapping[Item, str]) -> Iterator[str]:
    for number, pair in enumerate(pairs):
        if pair.gap or pair.overwrites:
            text = amplitude_of.get(pair, repr(pair.gap))
            text = f"hhr.Amplitude(slopes={{{text}: 1.0}})" if text.startswith("'") else text
            text = text if text.startswith("hhr.") else f"hhr.Amplitude({text})"
            yield (
                f"hhr.Opening({number}, {text}{', overwrites=True' * pair.overwrites}),  # "
                f"{pair.source}"
            )


def _paths(deck: Deck, parameters: Sequence[Proposed]) -> Iterator[str]:
    """Paths for the reduction of inelastic bodies: from the corner of the box with the smallest
    loads to any point.
    """
    start = {mu.name: min(mu.box, key=abs) for mu in parameters}
    to = {mu.name: mu.name for mu in parameters}
    yield "# load paths for hhr reduce: from the smallest loads of the box to any of its points"
    yield "PATHS = hhr.PathFamily("
    yield "    'loading',"
    yield "    scene.parameters,"
    yield "    scene.parameters,"
    yield f"    {start!r},"
    yield f"    (hhr.Leg({to!r}, {deck.seconds!r}, {TRAINING_STEPS}),),"
    yield ")"


def _steps(history: DeckHistory, parameters: Sequence[Proposed]) -> Iterator[str]:
    """Paths over the steps of the deck, with values within the boxes of the parameters."""
    free = [mu for mu in parameters if mu.free]
    yield (
        "# the steps of the file, for hhr march and hhr reduce: values at the ends of legs, "
        "seconds, number of steps"
    )
    yield "PATHS = hhr.PathFamily("
    yield "    'steps',"
    yield "    scene.parameters,"
    yield f"    {_space([mu.name for mu in free], [mu.box for mu in free])},"
    yield f"    {{{', '.join(f'{mu.name!r}: {mu.at(0)}' for mu in parameters)}}},"
    yield "    ("
    for number, (before, time) in enumerate(pairwise(history.times), 1):
        changed = [mu for mu in parameters if mu.course[number] != mu.course[number - 1]]
        to = ", ".join(f"{mu.name!r}: {mu.at(number)}" for mu in changed)
        yield f"        hhr.Leg({{{to}}}, {time - before!r}, {TRAINING_STEPS}),  # until {time:g} s"
    yield "    ),"
    yield ")"
