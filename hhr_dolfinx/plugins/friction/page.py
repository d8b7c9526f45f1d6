"""Facet ``page`` of friction: its rows and laws for pages and C headers, and the file that solves
by them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hhr_dolfinx.plugins.contact_laws.interface import Range
from hhr_dolfinx.plugins.friction.laws import Friction
from hhr_dolfinx.plugins.friction.over import FrictionOver
from hhr_dolfinx.plugins.pages.packing import Json, Packed, steps_of

_FOLDER = Path(__file__).parent


class _Page:
    """See :class:`hhr_dolfinx.plugins.pages.laws.LawOnPage`."""

    key = "friction"
    header = _FOLDER / "friction.h"
    range_header = _FOLDER / "friction_range.h"

    def tree(self, law: Friction, arrays: Packed) -> dict[str, Json]:
        """Arrays of friction for a page, see :class:`~hhr_dolfinx.plugins.pages.laws.LawOnPage`.

        Args:
            law: friction of the conditions.
            arrays: arrays of the page, to which those of the law are added.
        """
        tree: dict[str, Json] = {
            name: arrays.put(f"friction_{name}", getattr(law, name), "<i4")
            for name in ("normal", "tangential", "owner", "law", "twice")
        }
        tree["area"] = arrays.put("friction_area", law.area)
        tree["tangents"] = arrays.put("friction_tangents", law.tangents)
        tree["laws"] = [
            [steps_of(pair_law.coefficient), steps_of(pair_law.limit)] for pair_law in law.laws
        ]
        return tree

    def beneath(self, law: Friction) -> Sequence[Range]:
        """Laws of the pressures, see :class:`~hhr_dolfinx.plugins.pages.laws.LawOnPage`.

        Args:
            law: friction of the conditions.
        """
        if not isinstance(law, FrictionOver):
            return ()
        return [replace(part, rows=law.normal[part.rows]) for part in law.under.ranges]


PAGE = _Page()
