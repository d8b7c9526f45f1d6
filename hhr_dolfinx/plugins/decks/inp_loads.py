"""Supports and loads of a deck, as parts of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hhr_dolfinx.plugins.decks.deck import DeckLoad, DeckMaterial, Left, Support, Tag
from hhr_dolfinx.plugins.decks.inp_steps import Imposed
from hhr_dolfinx.plugins.decks.named import NamedParts

MANY_FORCES = 8
"""Forces of a block above which they are one load, hhr.NodalForces."""


def loads_of(
    state: Sequence[Imposed],
    parts: NamedParts,
    bodies: Mapping[Tag, DeckMaterial],
    thickness: float,
    left: list[Left],
    axis: int = 2,
) -> tuple[list[Support], list[DeckLoad]]:
    """Supports and loads; rows without counterpart are left, and forces are per thickness in the
    plane.

    ``axis`` is that about which bodies of two dimensions may rotate.
    """
    dim = parts.raw.dim
    supports = []
    forces: dict[str, list[tuple[Tag, int, float]]] = {}
    loads: list[DeckLoad] = []
    for item in state:
        block = item.block
        place = parts.place(item.place)
        if block.keyword in ("DLOAD", "DSLOAD"):
            made = _distributed(item, parts, bodies, axis)
            loads += [] if isinstance(made, str) else [load for load in made if load.value]
            left += [block.left(made)] if isinstance(made, str) else []
        elif block.keyword == "TEMPERATURE" or (item.component >= 3 and not item.factor):
            continue  # nodes of solids have no rotations
        elif place is None or item.component >= max(dim, 3 * (block.keyword == "BOUNDARY")):
            left.append(
                block.left(
                    f"'{item.row[0]}' is no node of the mesh, or has no component "
                    f"{item.component + 1}"
                )
            )
        elif block.keyword == "BOUNDARY" and item.component < dim:
            supports.append(Support(place, item.component, item.factor, block.source))
        elif block.keyword == "CLOAD" and item.factor:
            forces.setdefault(block.source, []).append(
                (place, item.component, item.factor / thickness)
            )
    for source, own in forces.items():
        loads += _forces(source, own, dim)
    return supports, loads


def _unit(component: int, dim: int) -> tuple[float, ...]:
    return tuple(np.eye(dim)[component].tolist())


def _direction(words: Sequence[float], dim: int) -> tuple[float, ...] | str:
    """Unit vector of a direction of any length in space, (dim,), or the reason why there is none.

    CalculiX 2.20 takes (0, 0, -2) of GRAV as (0, 0, -1).
    """
    vector = np.array(words[:3])
    if not vector[:dim].any():
        return "its direction is zero, and it does not act: give it one"
    return tuple((vector / np.linalg.norm(vector))[:dim].tolist())


def _forces(source: str, forces: Sequence[tuple[Tag, int, float]], dim: int) -> list[DeckLoad]:
    """Forces of a block: a load for each set and component, or one load for many of them."""
    if len(forces) <= MANY_FORCES:
        texts = [
            (f"hhr.NodalForce({place!r}, {_unit(axis, dim)}, {{}})", value)
            for place, axis, value in forces
        ]
        return [DeckLoad("force", text, value, source) for text, value in texts]
    vectors: dict[Tag, np.ndarray] = {}
    for place, component, value in forces:
        vectors[place] = vectors.get(place, np.zeros(dim)) + value * np.eye(dim)[component]
    text = repr({place: tuple(vector.tolist()) for place, vector in vectors.items()})
    return [DeckLoad("force", f"hhr.NodalForces({text}, {{}})", 1.0, source)]


def _distributed(
    item: Imposed, parts: NamedParts, bodies: Mapping[Tag, DeckMaterial], axis: int
) -> list[DeckLoad] | str:
    """Loads on a surface, on faces of elements or on their volume, or the reason why there are
    none.
    """
    label = item.row[1].upper()
    dim = parts.raw.dim
    source = item.block.source
    more = [*item.block.numbers(item.row, 2), *(0.0,) * 8]
    value = item.factor * more.pop(0)
    surface = parts.surface(item.place)
    if (label[:1] == "P" and label[1:].isdigit()) or label in ("P", "TRVEC"):
        if surface is None:
            return f"'{item.row[0]}' is no surface of the mesh"
        if label == "TRVEC":
            unit = _direction(more, dim)
            if isinstance(unit, str):
                return unit
            return [DeckLoad("traction", f"hhr.Traction({surface!r}, {unit}, {{}})", value, source)]
        return [DeckLoad("pressure", f"hhr.Pressure({surface!r}, {{}})", value, source)]
    tags = parts.bodies_in(item.row[0], bodies)
    known = label in ("GRAV", "CENTRIF", "BX", "BY", "BZ")
    if not tags or not known:
        return f"'{item.row[0]}' holds no whole body" if known else f"no counterpart: load {label}"
    if (
        label == "CENTRIF"
        and dim == 2
        and any(part for k, part in enumerate(more[3:6]) if k != axis)
    ):
        return f"in two dimensions bodies rotate about the axis {'xyz'[axis]}"
    along = _direction(more, dim) if label == "GRAV" else ()
    if isinstance(along, str):
        return along
    loads = []
    for tag in tags:
        density = 1.0 if label[0] == "B" else bodies[tag].density
        if density is None:
            return f"the material of body '{tag}' has no *DENSITY"
        text = f"hhr.BodyForce({tag!r}, {along}, {{}})"
        if label == "CENTRIF":
            text = (
                f"hhr.Centrifugal({tag!r}, {{}}, "
                f"{tuple(more[:dim])}{f', {tuple(more[3:6])}' if dim == 3 else ''})"
            )
        elif label[0] == "B":
            text = f"hhr.BodyForce({tag!r}, {_unit('XYZ'.index(label[1]), dim)}, {{}})"
        kind = {"G": "weight", "C": "rotation", "B": "body_force"}[label[0]]
        loads.append(DeckLoad(kind, text, value * density, source))
    return loads
