"""Mesh of an Abaqus or CalculiX deck (``.inp``): cells of one kind, with its sets and surfaces.

Meshio reads such decks too, but without surfaces, parts and plane-strain and axisymmetric elements;
of several blocks of elements with the same set it keeps the last one.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.abaqus_blocks import DeckContents, blocks
from hhr_dolfinx.geometries.abaqus_parts import Assembly
from hhr_dolfinx.geometries.cells import (
    DIMENSION,
    FACES,
    are_sides,
    of_other_kinds,
    one_kind,
    outer_faces_of_cells,
    sides_of,
)
from hhr_dolfinx.geometries.raw_mesh import RawMesh


def read_deck(path: Path) -> RawMesh:
    """Read the mesh of a deck with its includes; other parts are left out with the reason.

    Raises:
        FileContentError: for a deck without a mesh, or a damaged one.
    """
    return _mesh_of(flat_deck(path), path)


def flat_deck(path: Path) -> DeckContents:
    """Nodes, elements and sets of a deck with its includes.

    Raises:
        FileContentError: for a damaged deck, with the line.
    """
    assembly = Assembly()
    for line, keyword, options, rows in blocks(path):
        try:
            assembly.take(keyword, options, rows, line)
        except (ValueError, IndexError, KeyError) as error:
            reason = f"it has no option {error}" if isinstance(error, KeyError) else error
            raise FileContentError(f"{path}, block *{keyword} at line {line}: {reason}") from None
    return assembly.flat()


def _solid_elements(deck: DeckContents, path: Path) -> dict[int, tuple[str, list[int]]]:
    """Elements of the highest dimension by number: kind and nodes of each."""
    dimensions = {DIMENSION.get(kind, 3) for kind, _ in deck.elements.values() if kind != "line"}
    if not dimensions:
        types = sorted(set(deck.types.values()))
        raise FileContentError(
            f"{path} has no elements of the plane or of space"
            + (f" that are understood: {', '.join(types)}" if types else "")
        )
    return {
        number: element
        for number, element in deck.elements.items()
        if element[0] != "line" and DIMENSION.get(element[0], 3) == max(dimensions)
    }


def _mesh_of(deck: DeckContents, path: Path) -> RawMesh:
    """Make the mesh of a deck: cells of the highest dimension, and sets of them."""
    solid = _solid_elements(deck, path)
    rows_of: dict[tuple[str, int], list[list[int]]] = {}
    for number, (of, _) in solid.items():
        rows_of.setdefault((of, len(deck.whole[number])), []).append(deck.whole[number])
    kind, left_out = one_kind(((of, np.array(rows)) for (of, _), rows in rows_of.items()), path)
    cells = {
        number: nodes for number, (kind_of_cell, nodes) in solid.items() if kind_of_cell == kind
    }
    lost = next(
        (number for number in cells if not deck.nodes.keys() >= set(deck.whole[number])), None
    )
    if lost is not None:
        raise FileContentError(
            f"{path}: element {deck.label(lost)} has a node that is not in the deck"
        )
    node_of = {number: k for k, number in enumerate(deck.nodes)}
    row_of = {number: k for k, number in enumerate(cells)}
    array = np.array([[node_of[n] for n in nodes] for nodes in cells.values()], dtype=np.int64)
    bodies = {
        deck.spelling["elset", name]: np.array(
            [row_of[n] for n in numbers if n in row_of], dtype=np.int64
        )
        for name, numbers in deck.element_sets.items()
    }
    counts = {len(deck.whole[number]) for number in cells}
    node_rows = [
        np.array(
            [[node_of[n] for n in deck.whole[k]] for k in cells if len(deck.whole[k]) == count]
        )
        for count in counts
    ]
    sides = sides_of(kind, node_rows, path)
    facets = _facets(deck, kind, array, node_of)
    surfaces, reasons = _surfaces(deck, kind, array, row_of, facets)
    nodes = {
        deck.spelling["nset", name]: np.array(
            [node_of[n] for n in numbers if n in node_of], dtype=np.int64
        )
        for name, numbers in deck.node_sets.items()
    }
    other_kinds = {number: cell[0] for number, cell in solid.items() if cell[0] != kind}
    reasons_of_kinds = _others(deck, other_kinds, kind)
    bodies = {
        name: rows for name, rows in bodies.items() if rows.size and name not in reasons_of_kinds
    }
    bodies = bodies or {"all": np.arange(len(array))}
    left_out |= (
        deck.left_out
        | _idle_elements(deck, cells.keys() | facets.keys())
        | reasons
        | reasons_of_kinds
    )
    return RawMesh(
        np.array(list(deck.nodes.values())), kind, array, bodies, surfaces, nodes, sides, left_out
    )


def _others(deck: DeckContents, kinds: dict[int, str], kept: str) -> dict[str | int, str]:
    """Reasons why sets with elements of other kinds, by number, are no bodies."""
    counts: dict[str | int, Counter[str]] = {}
    for name, numbers in deck.element_sets.items():
        if count := Counter(kinds[number] for number in numbers if number in kinds):
            counts[deck.spelling["elset", name]] = count
    return of_other_kinds(counts, kept)


def _facets(
    deck: DeckContents, kind: str, cells: np.ndarray, node_of: dict[int, int]
) -> dict[int, np.ndarray]:
    """Corners of the elements that are sides of cells, by number: shells on a solid, lines around a
    plane body.
    """
    width = len(FACES[kind][0])
    candidates = {
        number: np.array([node_of[n] for n in nodes])
        for number, (of, nodes) in deck.elements.items()
        if DIMENSION.get(of, 1) == DIMENSION[kind] - 1
        and len(nodes) == width
        and all(n in node_of for n in nodes)
    }
    if not candidates:
        return {}
    are_facets = are_sides(kind, cells, np.array(list(candidates.values())))
    return {
        number: corners
        for (number, corners), is_facet in zip(candidates.items(), are_facets, strict=True)
        if is_facet
    }


def _idle_elements(deck: DeckContents, used: set[int]) -> dict[str | int, str]:
    """Elements that are neither cells nor sides of cells, by set, or by type if they are in
    none.
    """
    idle: dict[str, set[int]] = {}
    for number, name in deck.types.items():
        if number not in used:
            idle.setdefault(name, set()).add(number)
    reasons: dict[str | int, str] = {}
    for name, numbers in idle.items():
        description = f"{len(numbers)} element{'' if len(numbers) == 1 else 's'} of type {name}"
        sets = [
            deck.spelling["elset", key]
            for key, members in deck.element_sets.items()
            if numbers & set(members)
        ]
        for key in sets or [description]:
            more = f"; {reasons[key]}" if key in reasons else ""
            reasons[key] = (
                f"{description} in it, " if sets else ""
            ) + f"neither cells nor sides of cells{more}"
    return reasons


def _surfaces(
    deck: DeckContents,
    kind: str,
    cells: np.ndarray,
    row_of: dict[int, int],
    facets: dict[int, np.ndarray],
) -> tuple[dict[str | int, np.ndarray], dict[str | int, str]]:
    """Corners of the facets of sets of elements and of surfaces, (f, k), by name, and reasons for
    those without.
    """
    surfaces: dict[str | int, np.ndarray] = {}
    reasons: dict[str | int, str] = {}
    for name, numbers in deck.element_sets.items():
        corners = [facets[n] for n in numbers if n in facets]
        if corners:
            surfaces[deck.spelling["elset", name]] = np.array(corners)
    for name, face_list in deck.faces.items():
        spelt = deck.spelling["surface", name]
        results = [_faces(deck, face, kind, cells, row_of, facets, spelt) for face in face_list]
        failures = [result for result in results if isinstance(result, str)]
        if failures:
            reasons[spelt] = failures[0]
        else:
            surfaces[spelt] = np.concatenate(
                [np.zeros((0, len(FACES[kind][0])), dtype=np.int64), *results]
            )
    for name, members in deck.unions.items():
        spelt = deck.spelling["surface", name]
        spelt_members = [deck.spelling.get(("surface", member), "") for member in members]
        if members and all(member in surfaces for member in spelt_members):
            surfaces[spelt] = np.concatenate([surfaces[member] for member in spelt_members])
        else:
            reasons[spelt] = f"a union of surfaces that are not all there: {', '.join(members)}"
    return surfaces, reasons


def _faces(
    deck: DeckContents, item: tuple[str, str], kind: str, cells: np.ndarray, row_of: dict[int, int],
    facets: dict[int, np.ndarray], name: str,
) -> np.ndarray | str:  # fmt: skip
    """Corners of the faces of an element or a set in a surface, (f, k), or the reason why there are
    none.

    Raises:
        FileContentError: for a face that the cells do not have.
    """
    element, face = item
    corners = np.array(FACES[kind])
    numbers = [int(element)] if element.isdigit() else deck.element_sets.get(element.upper(), [])
    rows = [row_of[n] for n in numbers if n in row_of]
    if face in ("SPOS", "SNEG"):
        corners_of = [facets[n] for n in numbers if n in facets]
        return (
            np.array(corners_of)
            if corners_of
            else f"its elements '{element}' are no sides of cells"
        )
    if not rows:
        types = sorted({deck.types[n] for n in numbers if n in deck.types})
        return f"'{element}' has no cells of the mesh" + (
            f", but elements of type {', '.join(types)}" if types else ""
        )
    if not face:
        # all outer faces of the set
        outer, of = outer_faces_of_cells(kind, cells)
        return outer[np.isin(of, rows)]
    number = int(face[1:]) if face.startswith("S") and face[1:].isdigit() else 0
    if not 1 <= number <= len(corners):
        label = deck.label(numbers[0]) if element.isdigit() else element
        raise FileContentError(
            f"surface '{name}': '{label}, {face}' is no face of cells of kind {kind}"
        )
    return cells[rows][:, corners[number - 1]]
