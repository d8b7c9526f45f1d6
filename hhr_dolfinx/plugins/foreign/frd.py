"""Results of CalculiX, ``.frd`` of text: nodes, elements and displacements.

With ``*NODE FILE, OUTPUT=3D`` shells and beams are the solids that CalculiX expands them to, with
the nodes of its K.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hhr_dolfinx.errors import FileContentError

NODES_OF_TYPE = {1: 8, 2: 6, 3: 4, 4: 20, 5: 15, 6: 10, 7: 3, 8: 6, 9: 4, 10: 8, 11: 2, 12: 3}
"""Number of nodes of each type of element."""
ORDERS = {4: [*range(12), *range(16, 20), *range(12, 16)], 5: [*range(9), 12, 13, 14, 9, 10, 11]}
"""Places in an element of 20 or 15 nodes in the order of the deck: the upper edges come before the
upright ones.
"""


@dataclass(frozen=True, eq=False)
class Results:
    """Contents of a result file.

    Attributes:
        nodes: coordinates by label.
        elements: labels of the nodes of each element by its number, in the order of decks.
        displacements: of the last step with some, by label; empty without.
    """

    nodes: dict[int, tuple[float, float, float]]
    elements: dict[int, list[int]]
    displacements: dict[int, tuple[float, float, float]]


def read_frd(path: Path) -> Results:
    """Nodes, elements and displacements of a result file of text.

    Raises:
        FileContentError: for a file that is damaged, or binary.
    """
    lines = path.read_text(encoding="ascii", errors="replace").splitlines()
    nodes: dict[int, tuple[float, float, float]] = {}
    elements: dict[int, list[int]] = {}
    displacements: dict[int, tuple[float, float, float]] = {}
    try:
        for start, line in enumerate(lines):
            if line.startswith("    2C"):
                nodes = _values(lines, start + 1)
            elif line.startswith("    3C"):
                elements = _elements(lines, start + 1)
            elif line.startswith(" -4  DISP "):
                displacements = _values(lines, start + 1)
    except (ValueError, IndexError, KeyError) as error:
        raise FileContentError(f"{path} is no .frd of text, or is damaged: {error}") from None
    if not nodes:
        raise FileContentError(
            f"{path} has no nodes: it must be an .frd of text (*NODE FILE writes it)"
        )
    return Results(nodes, elements, displacements)


def _values(lines: list[str], start: int) -> dict[int, tuple[float, float, float]]:
    """Three numbers of twelve characters by label, up to the end of a block."""
    values = {}
    for line in lines[start:]:
        if line.startswith(" -3"):
            break
        if line.startswith(" -1"):
            label = int(line[3:13])
            values[label] = (float(line[13:25]), float(line[25:37]), float(line[37:49]))
    return values


def _elements(lines: list[str], start: int) -> dict[int, list[int]]:
    """Labels of the nodes of elements by number, up to the end of a block."""
    elements: dict[int, list[int]] = {}
    kinds: dict[int, int] = {}
    number = 0
    for line in lines[start:]:
        if line.startswith(" -3"):
            break
        if line.startswith(" -1"):
            number = int(line[3:13])
            kinds[number] = int(line[13:18])
            elements[number] = []
        elif line.startswith(" -2"):
            elements[number] += [int(line[k : k + 10]) for k in range(3, len(line.rstrip()), 10)]
    for number, nodes in elements.items():
        if len(nodes) != NODES_OF_TYPE[kinds[number]]:
            raise ValueError(f"element {number} has {len(nodes)} nodes")
        if kinds[number] in ORDERS:
            elements[number] = [nodes[index] for index in ORDERS[kinds[number]]]
    return elements
