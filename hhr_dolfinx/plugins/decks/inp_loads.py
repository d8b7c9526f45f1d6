"""Supports and loads of a deck, as parts of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hhr_dolfinx.plugins.decks.deck import Left, Load, Material, Support, Tag
from hhr_dolfinx.plugins.decks.inp_steps import Imposed
from hhr_dolfinx.plugins.decks.named import NamedParts

MANY = 8
"""Forces of a block from which on they are one load, hhr.NodalForces."""
Found = tuple[list[Load], list[Left]]


def loads_of(
    state: Sequence[Imposed],
    parts: NamedParts,
    bodies: Mapping[Tag, Material],
    thickness: float,
    initial: Sequence[tuple[str, float]] = (),
) -> tuple[list[Support], list[Load], list[Left]]:
    """Supports and loads, and rows without counterpart; forces are per thickness in the plane."""
    of = {kind: [item for item in state if item.block.keyword == kind]
          for kind in ("BOUNDARY", "CLOAD", "DLOAD", "DSLOAD", "TEMPERATURE")}  # fmt: skip
    supports, left = _supports(of["BOUNDARY"], parts)
    loads: list[Load] = []
    for own, lost in (
        _forces(of["CLOAD"], parts, thickness),
        *(_pressed(item, parts) if item.block.keyword == "DSLOAD" else _distributed(item, parts, bodies)
          for item in (*of["DLOAD"], *of["DSLOAD"])),
        _heated(of["TEMPERATURE"], initial, parts, bodies),
    ):  # fmt: skip
        loads += own
        left += lost
    return supports, loads, list(dict.fromkeys(left))


def _supports(items: Sequence[Imposed], parts: NamedParts) -> tuple[list[Support], list[Left]]:
    supports = []
    left = []
    for item in items:
        place = parts.place(item.place)
        if item.component >= 3:  # rotations, which nodes of solids lack, and temperatures
            continue
        if place is None:
            left.append(item.block.left(f"'{item.row[0]}' is no node of the mesh"))
        elif item.component < parts.raw.dim:
            supports.append(Support(place, item.component, item.factor, item.block.source))
    return supports, left


def _unit(component: int, dim: int, value: float = 1.0) -> tuple[float, ...]:
    return tuple(value if k == component else 0.0 for k in range(dim))


def _forces(items: Sequence[Imposed], parts: NamedParts, thickness: float) -> Found:
    """Forces at nodes: one load for each set and component, or one for a block that has many of them."""
    loads = []
    left = []
    blocks: dict[str, list[tuple[Tag, int, float]]] = {}
    for item in items:
        place = parts.place(item.place)
        if place is None or item.component >= parts.raw.dim:
            left.append(item.block.left(f"'{item.row[0]}' has no such component, or is no node of the mesh"))
        elif item.factor:
            blocks.setdefault(item.block.source, []).append((place, item.component, item.factor / thickness))
    for source, forces in blocks.items():
        if len(forces) <= MANY:
            loads += [Load("force", f"hhr.NodalForce({place!r}, {_unit(component, parts.raw.dim)}, {{}})", value, source)
                      for place, component, value in forces]  # fmt: skip
            continue
        vectors: dict[Tag, np.ndarray] = {}
        for place, component, value in forces:
            vectors[place] = vectors.get(place, 0.0) + np.array(_unit(component, parts.raw.dim, value))
        text = repr({place: tuple(vector.tolist()) for place, vector in vectors.items()})
        loads.append(Load("force", f"hhr.NodalForces({text}, {{}})", 1.0, source))
    return loads, left


def _pressed(item: Imposed, parts: NamedParts) -> Found:
    """A pressure, or a traction, on a surface."""
    surface = parts.surface(item.place)
    label = item.row[1].upper()
    numbers = item.block.numbers(item.row, 2)
    if surface is None:
        return [], [item.block.left(f"'{item.row[0]}' is no surface of the mesh")]
    if not numbers or (label.startswith("TRVEC") and len(numbers) < 1 + parts.raw.dim):
        return [], [item.block.left(f"'{', '.join(item.row)}' has too few numbers")]
    if label == "TRVEC":
        direction = np.array(numbers[1 : 1 + parts.raw.dim])
        unit = tuple((direction / np.linalg.norm(direction)).tolist())
        text = f"hhr.Traction({surface!r}, {unit}, {{}})"
        return [Load("traction", text, item.factor * numbers[0], item.block.source)], []
    if label == "P" or (label[0] == "P" and label[1:].isdigit()):
        value = item.factor * numbers[0]
        return [Load("pressure", f"hhr.Pressure({surface!r}, {{}})", value, item.block.source)] if value else [], []
    return [], [item.block.left(f"a load {label} has no counterpart")]


def _distributed(item: Imposed, parts: NamedParts, bodies: Mapping[Tag, Material]) -> Found:
    """A load on faces of elements or on their volume."""
    label = item.row[1].upper()
    if label[0] == "P" and label[1:].isdigit():
        return _pressed(item, parts)
    tags = parts.bodies_in(item.row[0], bodies)
    if not tags or label not in ("GRAV", "CENTRIF", "BX", "BY", "BZ"):
        why = f"a load {label} has no counterpart" if tags else f"'{item.row[0]}' holds no whole body"
        return [], [item.block.left(why)]
    dim = parts.raw.dim
    value, *more = (*item.block.numbers(item.row, 2), *(0.0,) * 7)
    value *= item.factor
    loads = []
    for tag in tags:
        density = bodies[tag].density
        if label[0] != "B" and density is None:
            return [], [item.block.left(f"body '{tag}' has no *DENSITY")]
        if label == "CENTRIF":
            where = f", {tuple(more[:dim])}, {tuple(more[3:6])}" if dim == 3 else f", {tuple(more[:2])}"
            text = f"hhr.Centrifugal({tag!r}, {{}}{where})"
            kind = "rotation"
        else:
            direction = tuple(more[:dim]) if label == "GRAV" else _unit("XYZ".index(label[1]), dim)
            text = f"hhr.BodyForce({tag!r}, {direction}, {{}})"
            kind = "weight" if label == "GRAV" else "body_force"
        loads.append(Load(kind, text, value * (density or 1.0) if label[0] != "B" else value, item.block.source))
    return loads, []


def _heated(
    items: Sequence[Imposed], initial: Sequence[tuple[str, float]], parts: NamedParts, bodies: Mapping[Tag, Material]
) -> Found:
    """Thermal expansion of bodies with one temperature each."""
    loads = []
    left = []
    given = [(item.row[0], item.factor * item.block.number(item.row[1])) for item in items]
    before, after = (_temperatures(rows, parts) for rows in (initial, given))
    for tag, material in bodies.items():
        nodes = np.unique(parts.raw.cells[parts.raw.bodies[tag]])
        rise = np.unique((after - before)[nodes].round(9))
        if not items or material.expansion is None or not np.nan_to_num(rise).any():
            continue
        if rise.size > 1 or np.isnan(rise).any():
            left.append(
                items[0].block.left(f"the temperature of body '{tag}' is not the same everywhere: give a field")
            )
            continue
        text = f"hhr.ThermalExpansion({tag!r}, {material.expansion!r}, {{}})"
        loads.append(Load("temperature", text, float(rise[0]), items[0].block.source))
    return loads, left


def _temperatures(rows: Sequence[tuple[str, float]], parts: NamedParts) -> np.ndarray:
    """Temperatures of all nodes; 0 where none is given."""
    found = np.zeros(len(parts.raw.points))
    for name, value in rows:
        if (place := parts.place(name)) is not None:
            found[parts.nodes(place)] = value
    return found
