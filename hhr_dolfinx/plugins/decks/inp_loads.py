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
    todo: list[Left],
    axis: int = 2,
) -> tuple[list[Support], list[DeckLoad]]:
    """Supports and loads of a deck; rows without counterpart become TODO lines.

    Args:
        state: rows of supports and loads that act.
        parts: bodies, surfaces and sets of the mesh.
        bodies: material of each body.
        thickness: thickness of plane bodies, a length; forces are divided by it.
        todo: list to which TODO lines are appended.
        axis: axis about which bodies of two dimensions may rotate.
    """
    dim = parts.raw.dim
    supports = []
    forces: dict[str, list[tuple[Tag, int, float]]] = {}
    loads: list[DeckLoad] = []
    for imposed in state:
        block = imposed.block
        target = parts.place(imposed.place)
        if block.keyword in ("DLOAD", "DSLOAD"):
            distributed = _distributed(imposed, parts, bodies, axis)
            loads += (
                [] if isinstance(distributed, str) else [load for load in distributed if load.value]
            )
            todo += [block.left(distributed)] if isinstance(distributed, str) else []
        elif block.keyword == "TEMPERATURE" or (imposed.component >= 3 and not imposed.factor):
            continue  # nodes of solids have no rotations
        elif target is None or imposed.component >= max(dim, 3 * (block.keyword == "BOUNDARY")):
            todo.append(
                block.left(
                    f"'{imposed.row[0]}' is no node of the mesh, or has no component "
                    f"{imposed.component + 1}"
                )
            )
        elif block.keyword == "BOUNDARY" and imposed.component < dim:
            supports.append(Support(target, imposed.component, imposed.factor, block.source))
        elif block.keyword == "CLOAD" and imposed.factor:
            forces.setdefault(block.source, []).append(
                (target, imposed.component, imposed.factor / thickness)
            )
    for source, forces_of_block in forces.items():
        loads += _forces(source, forces_of_block, dim)
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
            (f"hhr.NodalForce({target!r}, {_unit(axis, dim)}, {{}})", value)
            for target, axis, value in forces
        ]
        return [DeckLoad("force", text, value, source) for text, value in texts]
    vectors: dict[Tag, np.ndarray] = {}
    for target, component, value in forces:
        vectors[target] = vectors.get(target, np.zeros(dim)) + value * np.eye(dim)[component]
    text = repr({target: tuple(vector.tolist()) for target, vector in vectors.items()})
    return [DeckLoad("force", f"hhr.NodalForces({text}, {{}})", 1.0, source)]


def _distributed(
    imposed: Imposed, parts: NamedParts, bodies: Mapping[Tag, DeckMaterial], axis: int
) -> list[DeckLoad] | str:
    """Loads on a surface, on faces of elements or on their volume, or the reason why there are
    none.
    """
    label = imposed.row[1].upper()
    dim = parts.raw.dim
    source = imposed.block.source
    more = [*imposed.block.numbers(imposed.row, 2), *(0.0,) * 8]
    value = imposed.factor * more.pop(0)
    surface = parts.surface(imposed.place)
    if (label[:1] == "P" and label[1:].isdigit()) or label in ("P", "TRVEC"):
        if surface is None:
            return f"'{imposed.row[0]}' is no surface of the mesh"
        if label == "TRVEC":
            unit = _direction(more, dim)
            if isinstance(unit, str):
                return unit
            return [DeckLoad("traction", f"hhr.Traction({surface!r}, {unit}, {{}})", value, source)]
        return [DeckLoad("pressure", f"hhr.Pressure({surface!r}, {{}})", value, source)]
    tags = parts.bodies_in(imposed.row[0], bodies)
    supported = label in ("GRAV", "CENTRIF", "BX", "BY", "BZ")
    if not tags or not supported:
        return (
            f"'{imposed.row[0]}' holds no whole body"
            if supported
            else f"no counterpart: load {label}"
        )
    if (
        label == "CENTRIF"
        and dim == 2
        and any(direction for k, direction in enumerate(more[3:6]) if k != axis)
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
