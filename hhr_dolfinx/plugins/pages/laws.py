"""Laws of interfaces in the kernel: friction, and laws of other plug-ins that bring C functions for
their rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.plugins.pages.packing import Packed, steps_of

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.contact_laws.interface import Interface


class LawOnPage(Protocol):
    """Facet ``page`` of a law whose solver is a part of the kernel, which solves alone or next to
    other laws.
    """

    key: str  #: name of its data in the tree of a page, and of its part of the kernel
    header: Path  #: file in C that solves by the law, beside the kernels that are compiled of it
    range_header: Path  #: the same next to other laws

    def tree(self, law: object, arrays: Packed) -> dict[str, Any]:
        """Rows and constants of the law.

        Args:
            law: the contact law.
            arrays: packed arrays, to which those of the tree are added.
        """


class LawInC(Protocol):
    """Facet ``kernel`` of a law of independent rows, see ``docs/plug_ins.md``."""

    #: its functions are model_NAME_projection, and with a memory model_NAME_shift and
    #: model_NAME_after
    name: str
    text: str  #: C of these functions
    memory: int  #: numbers that it remembers of each row

    def numbers(self, law: Any) -> np.ndarray:
        """Numbers of each row, (k, n)."""

    def formulas(self, law: Any) -> Sequence[Scalar]:
        """Formulas of the parameters."""


class Laws(NamedTuple):
    """Laws of a kernel: of a part of it, and of ranges by their numbers from 1."""

    part: LawOnPage | None
    ranges: tuple[LawInC, ...]


def laws_of(law: ContactLaw, what: str) -> Laws:
    """Laws of a model in the kernel.

    Args:
        law: contact law of the model.
        what: name of the output in messages.

    Raises:
        NotOfferedError: for a law that brings no C.
    """
    if not law.plugin:
        return Laws(None, ())
    if _alone(law):
        return Laws(_facet(law, "page", what), ())
    part = None
    found: dict[str, LawInC] = {}
    for item in _interface(law, 0).ranges:
        if item.law.plugin and _alone(item.law):
            part = _facet(item.law, "page", what)
        elif item.law.plugin:
            found[item.law.plugin] = _facet(item.law, "kernel", what)
    return Laws(part, tuple(found.values()))


def check_law(law: ContactLaw, what: str, *, flows: bool) -> None:
    """Refuse a law that the kernel does not solve, or not with inelastic bodies.

    Args:
        law: contact law of the model.
        what: name of the output in messages.
        flows: True for inelastic bodies.

    Raises:
        NotOfferedError: for a law that brings no C, or solves no increments.
    """
    laws_of(law, what)
    if flows and law.plugin and not _alone(law):
        raise NotOfferedError(
            f"{what} solves inelastic bodies with one contact problem for each correction, by an "
            f"active set or by friction, and not with {law.name}: ask in Python"
        )


def law_tree(law: ContactLaw, count: int, arrays: Packed) -> dict[str, Any]:
    """Data of the laws on so many conditions.

    Args:
        law: contact law of the model.
        count: number of contact conditions.
        arrays: packed arrays, to which those of the tree are added.
    """
    if not law.plugin:
        return {}
    if _alone(law):
        own: LawOnPage = _facet(law, "page", "a page")
        return {own.key: own.tree(law, arrays)}
    interface = _interface(law, count)
    numbers = {
        item.name: number for number, item in enumerate(laws_of(law, "a page").ranges, start=1)
    }
    tree: dict[str, Any] = {}
    items = []
    for number, part in enumerate(interface.ranges):
        name = f"range{number}"
        item: dict[str, Any] = {
            "rows": arrays.put(f"{name}_rows", part.rows, "<i4"),
            "law": 0,
            "formulas": [],
        }
        item |= {"memory": 0, "remembers": 0}
        values = np.zeros((part.rows.size, 0))
        if part.law.plugin and _alone(part.law):
            own = _facet(part.law, "page", "a page")
            tree[own.key] = own.tree(part.law.among(part.rows), arrays)
            item |= {"law": -1, "remembers": int(part.law.remembers)}
        elif part.law.plugin:
            law_in_c: LawInC = _facet(part.law, "kernel", "a page")
            values = np.asarray(law_in_c.numbers(part.law), dtype=float)
            item |= {
                "law": numbers[law_in_c.name],
                "formulas": [*map(steps_of, law_in_c.formulas(part.law))],
            }
            if part.law.remembers:
                item |= {"memory": law_in_c.memory, "remembers": 1}
        item["numbers"] = arrays.put(f"{name}_numbers", values)
        items.append(item)
    return tree | {"ranges": {"items": items, "remembers": interface.path_dependent}}


def _alone(law: ContactLaw) -> bool:
    """True for a law that is a part of the kernel."""
    known = registry.installed()
    return law.plugin in known and "page" in known[law.plugin].facets


def _interface(law: ContactLaw, count: int) -> Interface:
    from hhr_dolfinx.plugins.contact_laws.interface import ranged

    return ranged(law, count)


def _facet(law: ContactLaw, word: str, what: str) -> Any:
    return registry.facet(law.plugin, word, f"{what} of contacts with {law.name}")
