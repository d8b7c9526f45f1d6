"""Summary of a mesh file: cells, bodies, surfaces and sets with sizes and positions, and the parts
left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hhr_dolfinx.geometries.cells import PLURAL
from hhr_dolfinx.geometries.conforming import counted
from hhr_dolfinx.geometries.raw_mesh import RawMesh

Lines = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Summary:
    """Contents of a mesh file.

    Attributes:
        head: file, nodes, cells and extent.
        parts: names and descriptions of bodies, surfaces and so on, by title.
        reasons: reasons why names of the file are no bodies or surfaces, by name.
        left_out: the reasons for parts of the file that are not in the mesh.
    """

    head: str = ""
    parts: Mapping[str, Lines] = field(default_factory=dict)
    reasons: Mapping[str | int, str] = field(default_factory=dict)
    left_out: Mapping[str | int, str] = field(default_factory=dict)

    def text(self, most: int = 12) -> str:
        """The whole summary, with at most ``most`` lines for each part."""
        rows = [self.head]
        for title, lines in self.parts.items():
            rows.append(f"  {title}:")
            width = max(len(name) for name, _ in lines[:most])
            rows += [f"    {name:{width}}  {description}" for name, description in lines[:most]]
            if len(lines) > most:
                rows.append(f"    and {len(lines) - most} more")
        return "\n".join(rows)


def summary_of(raw: RawMesh, path: Path, scale: float = 1.0) -> Summary:
    """Summarise a file that was read.

    Args:
        raw: contents of the file.
        path: path of the file.
        scale: factor of the coordinates.
    """
    points = raw.points * scale
    surfaces = raw.all_surfaces()
    order = "first" if raw.sides is None else "second"
    count = f"{len(raw.cells)} {raw.kind if len(raw.cells) == 1 else PLURAL[raw.kind]}"
    head = f"{path.name}: {len(points)} nodes, {count} of {order} order, {_extent(points)}"
    bodies = _lines(
        {name: (len(rows), raw.cells[rows]) for name, rows in raw.bodies.items()}, 3, points
    )
    without = len(raw.cells) - np.unique(np.concatenate(list(raw.bodies.values()))).size
    if without:
        bodies += (("in none", counted(without, 3)),)
    outer = _lines(
        {name: (len(facets), facets) for name, facets in surfaces.items()}, raw.dim - 1, points
    )
    lines = {
        name: nodes for name, nodes in raw.nodes.items() if name not in surfaces and len(nodes)
    }
    sets = _lines({name: (len(nodes), nodes) for name, nodes in lines.items()}, 0, points)
    left_out = tuple((str(name), reason) for name, reason in raw.left_out.items())
    sections = {
        "bodies": bodies,
        "surfaces": outer,
        "sets of nodes that hold no whole facet, for displacements and forces at nodes": sets,
        "left out": left_out,
    }
    reasons = {
        name: (
            f"a set of {counted(len(nodes), 0)} that holds no whole facet, as pressures, "
            "tractions and contacts need"
        )
        for name, nodes in lines.items()
    }
    shown = {title: rows for title, rows in sections.items() if rows}
    return Summary(head, shown, {**raw.left_out, **reasons}, raw.left_out)


def _lines(sets: Mapping[str | int, tuple[int, np.ndarray]], dim: int, points: np.ndarray) -> Lines:
    """Names, counts and positions of sets, given by counts and nodes.

    A number of a set with a name stands after it.
    """
    content = {name: (count, np.asarray(nodes).tobytes()) for name, (count, nodes) in sets.items()}
    named = {content[name] for name in sets if isinstance(name, str)}
    numbers = {content[name]: name for name in sets if not isinstance(name, str)}
    return tuple(
        (
            f"{name} ({numbers[content[name]]})"
            if content[name] in numbers and isinstance(name, str)
            else str(name),
            f"{counted(count, dim)}, {_extent(points[np.unique(nodes)])}",
        )
        for name, (count, nodes) in sets.items()
        if isinstance(name, str) or content[name] not in named
    )


def _extent(points: np.ndarray) -> str:
    """Range of the coordinates of points."""
    if not len(points):
        return "nowhere"
    size = max(float(np.abs(points).max()), 1e-300)
    # sines of turned parts leave round-off
    low, high = (
        np.where(np.abs(ends) < 1e-14 * size, 0.0, ends)
        for ends in (points.min(axis=0), points.max(axis=0))
    )
    flat = high - low <= 1e-9 * size
    return ", ".join(
        f"{axis} = {a:.6g}" if same else f"{axis} {a:.6g} to {b:.6g}"
        for axis, a, b, same in zip("xyz", low, high, flat, strict=False)
    )
