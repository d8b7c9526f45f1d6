"""Names of bodies and surfaces: what a mesh calls its tags, and which numbers a name stands for."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.parameters import Tag

Sets = Mapping[Tag, tuple[int, ...]]


@dataclass(frozen=True)
class TagNames:
    """Numbers by name, of the cells and of the facets of one mesh.

    A name may stand for several numbers: where sets of a file overlap, what is in the same ones has one of its own.

    Attributes:
        cells, facets: numbers by name, and of those tags that are more than one number.
    """

    cells: Sets = field(default_factory=dict)
    facets: Sets = field(default_factory=dict)

    @classmethod
    def of(cls, groups: Any, dim: int) -> TagNames:
        """Of physical groups, ``{name: (dimension, number or numbers)}`` or such pairs, of a mesh of a dimension."""
        pairs = list(groups.items() if isinstance(groups, Mapping) else groups or ())
        cells, facets = ({name: _numbers(group[1]) for name, group in pairs if int(group[0]) == wanted}
                         for wanted in (dim, dim - 1))  # fmt: skip
        return cls(cells, facets)

    def cell(self, tag: Tag) -> tuple[int, ...]:
        """Numbers of a body; raises SceneError for a name that is not there."""
        return _found("body", tag, self.cells, "surface", self.facets)

    def facet(self, tag: Tag) -> tuple[int, ...]:
        """Numbers of a surface; raises SceneError for a name that is not there."""
        return _found("surface", tag, self.facets, "body", self.cells)

    def described(self, kind: str, numbers: Iterable[int]) -> str:
        """Tags of a kind, ``cell`` or ``facet``, in words: numbers, and names where they have any."""
        names: dict[int, list[str]] = {}
        for name, own in (self.cells if kind == "cell" else self.facets).items():
            for number in own if isinstance(name, str) else ():
                names.setdefault(number, []).append(f"'{name}'")
        return "[" + ", ".join(" ".join([str(n), *names.get(n, ())]) for n in sorted(numbers)) + "]"


def _numbers(given: Any) -> tuple[int, ...]:
    """One number or several."""
    return tuple(int(number) for number in given) if hasattr(given, "__iter__") else (int(given),)


def _found(kind: str, tag: Tag, there: Sets, other: str, others: Sets) -> tuple[int, ...]:
    """Numbers of a tag of a kind, where another kind of tags is beside it."""
    if tag in there:
        return there[tag]
    if not isinstance(tag, str):
        return (int(tag),)
    plural = {"body": "bodies", "surface": "surfaces"}
    names = sorted(name for name in there if isinstance(name, str))
    if not names:
        raise SceneError(
            f"no {kind} of the mesh has a name, and '{tag}' is asked for: name the physical groups of the mesh, or "
            "give their numbers"
        )
    near = difflib.get_close_matches(tag.lower(), [name.lower() for name in names], n=1)
    hint = " Name one of these, or give the mesh a group of this name."
    if near:
        hint = f" Is '{next(name for name in names if name.lower() == near[0])}' meant?"
    if tag in others:
        hint = f" '{tag}' is a {other} of it: a {kind} is needed here."
    raise SceneError(f"no {kind} of the mesh is called '{tag}': its {plural[kind]} are {', '.join(names)}.{hint}")
