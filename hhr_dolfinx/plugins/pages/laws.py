"""Laws of interfaces in the kernel: friction, and laws of other plug-ins that bring C functions for
their rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.plugins.pages.packing import Json, Packed, steps_of

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.contact_laws.interface import Interface, Range


class LawOnPage(Protocol):
    """Facet ``page`` of a law whose solver is a part of the kernel, which solves alone or next to
    other laws.
    """

    key: str  #: name of its data in the tree of a page, and of its part of the kernel
    header: Path  #: file in C that solves by the law, beside the kernels that are compiled of it
    range_header: Path  #: the same next to other laws

    def tree(self, law: ContactLaw, arrays: Packed) -> dict[str, Json]:
        """Rows and constants of the law.

        Args:
            law: the contact law.
            arrays: packed arrays, to which those of the tree are added.
        """

    def beneath(self, law: ContactLaw) -> Sequence[Range]:
        """Laws that give the forces which the law reads, on some of its conditions.

        Args:
            law: the contact law.
        """


class LawInC(Protocol):
    """Facet ``kernel`` of a law of independent rows, see ``docs/plug_ins.md``."""

    #: its functions are model_NAME_projection, and with a memory model_NAME_shift and
    #: model_NAME_after
    name: str
    text: str  #: C of these functions
    memory: int  #: numbers that it remembers of each row

    def numbers(self, law: ContactLaw) -> np.ndarray:
        """Numbers of each row, (k, n)."""

    def formulas(self, law: ContactLaw) -> Sequence[Scalar]:
        """Formulas of the parameters."""


class Laws(NamedTuple):
    """Laws of a kernel: of a part of it, and of ranges by their numbers from 1."""

    part: LawOnPage | None
    ranges: tuple[LawInC, ...]
    beneath: bool = False  #: whether some of these are beneath the part


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
    law_alone: LawOnPage | None = None
    beneath: Sequence[Range] = ()
    laws_in_c: dict[str, LawInC] = {}
    for law_range in _interface(law, 0).ranges:
        if law_range.law.plugin and _alone(law_range.law):
            law_alone = _facet(law_range.law, "page", what)
            beneath = law_alone.beneath(law_range.law)
    for law_range in (*beneath, *_interface(law, 0).ranges):
        if law_range.law.plugin and not _alone(law_range.law):
            laws_in_c[law_range.law.plugin] = _facet(law_range.law, "kernel", what)
    return Laws(law_alone, tuple(laws_in_c.values()), bool(beneath))


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


def law_tree(law: ContactLaw, count: int, arrays: Packed) -> dict[str, Json]:
    """Data of the laws on so many conditions.

    Args:
        law: contact law of the model.
        count: number of contact conditions.
        arrays: packed arrays, to which those of the tree are added.
    """
    if not law.plugin:
        return {}
    if _alone(law):
        law_on_page: LawOnPage = _facet(law, "page", "a page")
        return {law_on_page.key: law_on_page.tree(law, arrays)}
    interface = _interface(law, count)
    numbers = {
        entry.name: number for number, entry in enumerate(laws_of(law, "a page").ranges, start=1)
    }
    tree: dict[str, Json] = {}
    entries = []
    for number, law_range in enumerate(_in_turn(interface)):
        name = f"range{number}"
        entry: dict[str, Json] = {
            "rows": arrays.put(f"{name}_rows", law_range.rows, "<i4"),
            "law": 0,
            "formulas": [],
        }
        entry |= {"memory": 0, "remembers": 0}
        values = np.zeros((law_range.rows.size, 0))
        if law_range.law.plugin and _alone(law_range.law):
            law_on_page = _facet(law_range.law, "page", "a page")
            tree[law_on_page.key] = law_on_page.tree(law_range.law.among(law_range.rows), arrays)
            entry |= {"law": -1, "remembers": int(law_range.law.remembers)}
        elif law_range.law.plugin:
            law_in_c: LawInC = _facet(law_range.law, "kernel", "a page")
            values = np.asarray(law_in_c.numbers(law_range.law), dtype=float)
            entry |= {
                "law": numbers[law_in_c.name],
                "formulas": [*map(steps_of, law_in_c.formulas(law_range.law))],
            }
            if law_range.law.remembers:
                entry |= {"memory": law_in_c.memory, "remembers": 1}
        entry["numbers"] = arrays.put(f"{name}_numbers", values)
        entries.append(entry)
    return tree | {"ranges": {"items": entries, "remembers": interface.path_dependent}}


def _in_turn(interface: Interface) -> Iterator[Range]:
    """Ranges of the kernel: those beneath a law before it."""
    for law_range in interface.ranges:
        if law_range.law.plugin and _alone(law_range.law):
            law_on_page: LawOnPage = _facet(law_range.law, "page", "a page")
            for under in law_on_page.beneath(law_range.law):
                yield replace(under, rows=law_range.rows[under.rows])
        yield law_range


def _alone(law: ContactLaw) -> bool:
    """True for a law that is a part of the kernel."""
    plugins = registry.installed()
    return law.plugin in plugins and "page" in plugins[law.plugin].facets


def _interface(law: ContactLaw, count: int) -> Interface:
    from hhr_dolfinx.plugins.contact_laws.interface import ranged

    return ranged(law, count)


def _facet(law: ContactLaw, word: str, what: str) -> Any:
    return registry.facet(law.plugin, word, f"{what} of contacts with {law.name}")
