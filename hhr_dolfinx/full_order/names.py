"""Names of bodies and surfaces in a mesh, and the numbers of their tags."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries.summary import Summary
from hhr_dolfinx.parameters import Tag

if TYPE_CHECKING:
    from hhr_dolfinx.compat import Group, Groups

Sets = Mapping[Tag, tuple[int, ...]]


@dataclass(frozen=True)
class TagNames:
    """Numbers by name, of the cells and of the facets of one mesh.

    A name may mean several numbers: if sets of a file overlap, each intersection has a separate
    number.
    """

    cells: Sets = field(default_factory=dict)
    facets: Sets = field(default_factory=dict)
    summary: Summary = field(
        default_factory=Summary
    )  #: contents of the file of the mesh; empty without a file

    @classmethod
    def of(
        cls,
        groups: Groups | Mapping[Tag, Group] | None,
        dim: int,
        summary: Summary | None = None,
    ) -> TagNames:
        """Names of the physical groups of a mesh.

        Args:
            groups: ``{name: (dimension, number or numbers)}``, or such pairs.
            dim: dimension of the cells.
            summary: contents of the file of the mesh.
        """
        pairs = list(groups.items() if isinstance(groups, Mapping) else groups or ())
        cells, facets = (
            {name: _numbers(group[1]) for name, group in pairs if int(group[0]) == wanted}
            for wanted in (dim, dim - 1)
        )
        return cls(cells, facets, summary or Summary())

    def cell(self, tag: Tag) -> tuple[int, ...]:
        """Numbers of a body; raises SceneError for an unknown name."""
        return self._found(tag, "body", "bodies", self.cells, "surface", self.facets)

    def facet(self, tag: Tag) -> tuple[int, ...]:
        """Numbers of a surface; raises SceneError for an unknown name."""
        return self._found(tag, "surface", "surfaces", self.facets, "body", self.cells)

    def of_file(self, wanted: Iterable[Tag]) -> str:
        """Lines below an error of missing tags: the reason, and the contents of the file.

        Empty without a file.
        """
        summary = self.summary
        reasons = [
            f"{tag!r} is in the file: {summary.reasons[tag]}"
            for tag in wanted
            if tag in summary.reasons
        ]
        return "".join(
            f"\n{line}" for line in (*reasons, summary.text() if summary.head else "") if line
        )

    def described(self, kind: str, numbers: Iterable[int]) -> str:
        """Description of tags: numbers, and names if they have any.

        Args:
            kind: ``cell`` or ``facet``.
            numbers: the tags.
        """
        names: dict[int, list[str]] = {}
        for name, numbers_of_name in (self.cells if kind == "cell" else self.facets).items():
            for number in numbers_of_name if isinstance(name, str) else ():
                names.setdefault(number, []).append(f"'{name}'")
        return "[" + ", ".join(" ".join([str(n), *names.get(n, ())]) for n in sorted(numbers)) + "]"

    def _found(
        self, tag: Tag, kind: str, plural: str, there: Sets, other: str, others: Sets
    ) -> tuple[int, ...]:
        """Numbers of a tag of a kind; errors mention tags of the other kind."""
        if tag in there:
            return there[tag]
        if not isinstance(tag, str):
            return (int(tag),)
        names = sorted(name for name in there if isinstance(name, str))
        if not names:
            raise SceneError(
                f"no {kind} of the mesh has a name, and '{tag}' is requested: name the physical "
                f"groups of the mesh, or give their numbers{self.of_file([tag])}"
            )
        near = difflib.get_close_matches(tag.lower(), [name.lower() for name in names], n=1)
        hint = "Name one of these, or give the mesh a group of this name."
        if tag in others:
            hint = f"'{tag}' is a {other} of it: a {kind} is needed here."
        elif near:
            hint = f"Is '{next(name for name in names if name.lower() == near[0])}' meant?"
        raise SceneError(
            f"no {kind} of the mesh is called '{tag}': its {plural} are {', '.join(names)}. "
            f"{hint}{self.of_file([tag])}"
        )


def _numbers(given: int | Iterable[int]) -> tuple[int, ...]:
    """One number or several."""
    return tuple(int(number) for number in given) if hasattr(given, "__iter__") else (int(given),)
