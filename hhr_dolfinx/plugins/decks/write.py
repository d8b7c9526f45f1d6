"""A scene file of a deck, as text of Python that runs without an edit."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from hhr_dolfinx.plugins.decks.deck import Deck, History, Item, Load, Pair, Section, Support
from hhr_dolfinx.plugins.decks.parameters import Proposed, amplitudes, proposed
from hhr_dolfinx.plugins.decks.with_outside import OUTSIDE

STEPS = 4
"""Steps of the paths on which models of inelastic bodies are trained."""


def scene_text(deck: Deck, file: Path, target: Path) -> str:
    """Text of the scene file ``target`` of a deck in a file; the mesh is named relative to the folder of the target."""
    parameters = proposed(deck)
    of = amplitudes(parameters)
    mesh = Path(os.path.relpath(deck.path.absolute(), target.absolute().parent)).as_posix()
    stem = re.sub(r"\W", "_", file.stem)
    parts: Mapping[str, Iterator[str]] = {
        "bodies": (_body(item, of) for item in deck.sections),
        "contacts": (_pair(item, of) for item in deck.pairs),
        "displacements": _supports(deck.supports, 3 if deck.hypothesis == "solid" else 2, of),
        "loads": (
            f"{item.text.replace('{}', of.get(item, repr(item.value)))},  # {item.source}" for item in deck.loads
        ),
        "constraints": (_constraint(item, of) for item in deck.constraints),
        "openings": _openings(deck.pairs, of),
        "outputs": _outputs(deck.pairs),
    }
    lines = [f'"""Scene of {file.name}, written by hhr start.', "", *_instructions(deck, target, parameters), '"""', ""]
    lines += ["from pathlib import Path", "", "import hhr_dolfinx as hhr", ""]
    lines += [f"MESH = Path(__file__).parent / {mesh!r}", *(f"# {left}" for left in deck.left), ""]
    lines += ["scene = hhr.Scene(", f"    name={stem if stem.isidentifier() else f'deck_{stem}'!r},"]
    lines += [f"    geometry={_geometry(deck)},", f"    hypothesis={deck.hypothesis!r},"]
    for name, items in parts.items():
        if name == "constraints" and not deck.constraints:
            continue
        lines += [f"    {name}=(", *(f"        {row}" for row in items), "    ),"]
    bounds = (tuple(one.name for one in parameters), *zip(*(one.reach for one in parameters), strict=True))
    lines += [f"    parameters=hhr.ParameterSpace{bounds},", ")"]
    if deck.history is not None:
        lines += _steps(deck.history, parameters)
    elif _flows(deck):
        lines += _paths(deck, parameters)
    return "\n".join(lines) + "\n"


def _geometry(deck: Deck) -> str:
    outside = any(repr(OUTSIDE) in pair.text for pair in deck.pairs)
    text = "hhr.WithOutside(MESH)" if outside else "hhr.MeshFile(MESH)"
    if deck.sides:
        text = "hhr.WithOutside(MESH, sides=True)"
    if deck.cuts:
        text = f"hhr.CutMesh(MESH, sections={deck.cuts!r})"
    return f"hhr.Untangled({text})" if deck.folded else text


def _outputs(pairs: Sequence[Pair]) -> Iterator[str]:
    for number, pair in enumerate(pairs):
        yield f'hhr.LargestPressure("largest pressure {number}", contact={number}),'
        if pair.direction:
            yield f'hhr.ContactForce("force {number}", contact={number}, direction={pair.direction!r}),'


def _flows(deck: Deck) -> bool:
    return any(item.material.law for item in deck.sections)


def _instructions(deck: Deck, target: Path, parameters: Sequence[Proposed]) -> Iterator[str]:
    duration = f" --duration {deck.seconds:g}" if _flows(deck) else ""
    yield f"    hhr check {target.name}    # what is held, loaded and in contact, with a picture"
    if deck.history is None:
        yield f"    hhr solve {target.name}{duration}    # the middle of the box, which is the state of the file"
    else:
        yield f"    hhr march {target.name}    # the steps of the file, one after another"
    yield f"    hhr reduce {target.name}   # a small model for all of the box"
    yield ""
    for one in (one for one in parameters if one.free):
        yield f"Parameter {one.name}: {one.box[0]:g} to {one.box[1]:g}, and {one.value:g} in the file."


def _body(item: Section, of: Mapping[Item, str]) -> str:
    material = item.material
    law = f", law={material.law}" if material.law else ""
    text = f"hhr.Body({item.tag!r}, young={of.get(item, repr(material.young))}, poisson={material.poisson!r}{law})"
    return f"{text},  # {item.source}: {material.name} of {material.source}"


def _pair(pair: Pair, of: Mapping[Item, str]) -> str:
    friction = f", friction={pair.friction!r}" if pair.friction else ""
    origin = pair.origin or (0.0,) * len(pair.motion)
    place: tuple[float | str, ...] = tuple(a + b for a, b in zip(origin, pair.motion, strict=True))
    if pair in of:
        # the amplitude of the length of the motion: a name, or a name and its factor
        name, factor = re.findall(r"'(\w+)'(?:: ([^}]*))?", of[pair])[0]
        parts = [value / math.hypot(*pair.motion) * float(factor or 1) for value in pair.motion]
        place = tuple(_moved(a, part, name) for a, part in zip(origin, parts, strict=True))
    return f"{pair.text.replace('{}', friction).replace('{place}', repr(place))},  # {pair.source}"


def _moved(start: float, part: float, name: str) -> float | str:
    """A coordinate that follows a parameter."""
    return (f"{start!r} + {part!r} * {name}" if start else f"{part!r} * {name}") if part else start


def _constraint(item: Load, of: Mapping[Item, str]) -> str:
    amplitude = of.get(item, repr(item.value))
    text = item.text.replace("{}", amplitude) if item.value else item.text.replace(", {}", "")
    return f"{text},  # {item.source}"


def _supports(supports: Sequence[Support], dim: int, of: Mapping[Item, str]) -> Iterator[str]:
    """One line for each component that is imposed, or for all of them where they are held."""
    held = [(item.place, item.source) for item in supports if not item.value]
    for item in supports:
        end = f"),  # {item.source}"
        if item.value:
            yield f"hhr.Displacement({item.place!r}, {item.component}, {of.get(item, repr(item.value))}{end}"
        elif held.count((item.place, item.source)) < dim:
            yield f"hhr.Displacement({item.place!r}, {item.component}{end}"
        elif item.component == 0:
            yield f"*hhr.Displacement.clamp({item.place!r}, {dim}{end}"


def _openings(pairs: Sequence[Pair], of: Mapping[Item, str]) -> Iterator[str]:
    for number, pair in enumerate(pairs):
        if pair.gap:
            text = of.get(pair, repr(pair.gap))
            text = f"hhr.Amplitude(slopes={{{text}: 1.0}})" if text.startswith("'") else text
            text = text if text.startswith("hhr.") else f"hhr.Amplitude({text})"
            yield f"hhr.Opening({number}, {text}),  # {pair.source}"


def _paths(deck: Deck, parameters: Sequence[Proposed]) -> Iterator[str]:
    """Paths for the reduction of inelastic bodies: from the corner of the box with the smallest loads to any point."""
    start = {one.name: min(one.box, key=abs) for one in parameters}
    to = {one.name: one.name for one in parameters}
    yield "# load paths for hhr reduce: from the smallest loads of the box to any of its points"
    yield "PATHS = hhr.PathFamily("
    yield f"    'loading', scene.parameters, scene.parameters, {start!r}, (hhr.Leg({to!r}, {deck.seconds!r}, {STEPS}),)"
    yield ")"


def _steps(history: History, parameters: Sequence[Proposed]) -> Iterator[str]:
    """Paths over the steps of the deck, with values within the boxes of the parameters."""
    free = [one for one in parameters if one.free]
    bounds = (tuple(one.name for one in free), *zip(*(one.box for one in free), strict=True))
    yield "# the steps of the file, for hhr march and hhr reduce: values at the ends of legs, seconds, number of steps"
    yield "PATHS = hhr.PathFamily("
    yield "    'steps',"
    yield "    scene.parameters,"
    yield f"    hhr.ParameterSpace{bounds},"
    yield f"    {{{', '.join(f'{one.name!r}: {one.at(0)}' for one in parameters)}}},"
    yield "    ("
    for number, (before, time) in enumerate(pairwise(history.times), 1):
        changed = [one for one in parameters if one.course[number] != one.course[number - 1]]
        to = ", ".join(f"{one.name!r}: {one.at(number)}" for one in changed)
        yield f"        hhr.Leg({{{to}}}, {time - before!r}, {STEPS}),"
    yield "    ),"
    yield ")"
