"""A scene file of a deck, as text of Python that runs without an edit."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from hhr_dolfinx.plugins.decks.deck import Deck, Pair, Section, Support
from hhr_dolfinx.plugins.decks.parameters import Item, Proposed, amplitudes, proposed

STEPS = 4
"""Steps of the paths on which models of inelastic bodies are trained."""


def scene_text(deck: Deck, target: Path) -> str:
    """Text of the scene file ``target``; the mesh is named relative to its folder."""
    parameters = proposed(deck)
    by_item = amplitudes(parameters)
    mesh = Path(os.path.relpath(deck.path.absolute(), target.absolute().parent)).as_posix()
    lines = [f'"""{deck.title or f"Scene of {deck.path.name}, written by hhr start."}']
    lines += ["", *_instructions(deck, target, parameters), '"""', "", "from pathlib import Path", ""]
    lines += ["import hhr_dolfinx as hhr", "", f"MESH = Path(__file__).parent / {mesh!r}", ""]
    lines += [f"# {left}" for left in deck.left]
    lines += ["", "scene = hhr.Scene(", f"    name={_identifier(deck.path.stem)!r},"]
    lines += ["    geometry=hhr.MeshFile(MESH),", f"    hypothesis={deck.hypothesis!r},"]
    parts: Mapping[str, Iterator[str]] = {
        "bodies": (_body(item, by_item) for item in deck.sections),
        "contacts": map(_pair, deck.pairs),
        "displacements": _supports(deck.supports, 3 if deck.hypothesis == "solid" else 2, by_item),
        "loads": (
            _line(load.text.replace("{}", by_item.get(load, repr(load.value))), load.source) for load in deck.loads
        ),
        "openings": _openings(deck.pairs, by_item),
        "outputs": _outputs(deck.pairs),
    }
    for name, items in parts.items():
        rows = [f"        {row}" for row in items]
        lines += [f"    {name}=(", *rows, "    ),"] if rows else []
    lines += [f"    parameters={_space(parameters)},", ")"]
    if any(item.material.law for item in deck.sections):
        lines += ["", *_paths(deck, parameters)]
    return "\n".join(lines) + "\n"


def _instructions(deck: Deck, target: Path, parameters: Sequence[Proposed]) -> Iterator[str]:
    duration = f" --duration {deck.seconds:g}" if any(item.material.law for item in deck.sections) else ""
    yield f"    hhr check {target.name}    # what is held, loaded and in contact, with a picture"
    yield f"    hhr solve {target.name}{duration}    # the middle of the box, which is the state of the file"
    yield f"    hhr reduce {target.name}   # a small model for all of the box"
    yield ""
    for one in parameters:
        yield f"Parameter {one.name}: {one.box[0]:g} to {one.box[1]:g}, and {one.value:g} in the file."


def _identifier(stem: str) -> str:
    word = re.sub(r"\W", "_", stem)
    return word if word.isidentifier() else f"deck_{word}"


def _line(text: str, source: str, words: str = "") -> str:
    return f"{text},  # {source}{f': {words}' if words else ''}"


def _body(item: Section, by_item: Mapping[Item, str]) -> str:
    material = item.material
    young = by_item.get(item, repr(material.young))
    law = f", law={material.law}" if material.law else ""
    text = f"hhr.Body({item.tag!r}, young={young}, poisson={material.poisson!r}{law})"
    return _line(text, item.source, f"{material.name} of {material.source}")


def _pair(pair: Pair) -> str:
    friction = f", friction={pair.friction!r}" if pair.friction else ""
    return _line(pair.text.replace("{}", friction), pair.source, pair.words)


def _supports(supports: Sequence[Support], dim: int, by_item: Mapping[Item, str]) -> Iterator[str]:
    """One line for each component that is imposed, or for all of them where they are held."""
    held: dict[tuple[object, str], set[int]] = {}
    for item in supports:
        if not item.value:
            held.setdefault((item.place, item.source), set()).add(item.component)
    for item in supports:
        whole = held.get((item.place, item.source), set())
        if item.value:
            text = by_item.get(item, repr(item.value))
            yield _line(f"hhr.Displacement({item.place!r}, {item.component}, {text})", item.source)
        elif len(whole) < dim:
            yield _line(f"hhr.Displacement({item.place!r}, {item.component})", item.source)
        elif item.component == 0:
            yield _line(f"*hhr.Displacement.clamp({item.place!r}, {dim})", item.source)


def _openings(pairs: Sequence[Pair], by_item: Mapping[Item, str]) -> Iterator[str]:
    for number, pair in enumerate(pairs):
        if pair.gap:
            text = by_item.get(pair, repr(pair.gap))
            text = f"hhr.Amplitude(slopes={{{text}: 1.0}})" if text.startswith("'") else text
            text = text if text.startswith("hhr.") else f"hhr.Amplitude({text})"
            yield _line(f"hhr.Opening({number}, {text})", pair.source)


def _outputs(pairs: Sequence[Pair]) -> Iterator[str]:
    for number in range(len(pairs)):
        name = "largest pressure" if len(pairs) == 1 else f"largest pressure of contact {number}"
        yield f"hhr.LargestPressure({name!r}, contact={number}),"


def _space(parameters: Sequence[Proposed]) -> str:
    names = tuple(one.name for one in parameters)
    lower, upper = (tuple(one.box[end] for one in parameters) for end in (0, 1))
    return f"hhr.ParameterSpace({names!r}, {lower!r}, {upper!r})"


def _paths(deck: Deck, parameters: Sequence[Proposed]) -> Iterator[str]:
    """Paths for the reduction of inelastic bodies: from the lower corner of the box to any point."""
    start = {one.name: one.box[0] for one in parameters}
    to = {one.name: one.name for one in parameters}
    yield "# load paths for hhr reduce: from the lower corner of the box to any of its points"
    yield "PATHS = hhr.PathFamily("
    yield f"    'loading', scene.parameters, scene.parameters, {start!r},"
    yield f"    (hhr.Leg({to!r}, {deck.seconds!r}, {STEPS}),),"
    yield ")"
