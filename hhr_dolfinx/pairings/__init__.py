"""Pairings: from tagged surfaces to contact rows, one module each, thesis sections 1.2.4 and 5.1.

A pairing is an object with two members; user-defined ones work like those here:

* ``tags``: facet tags of the surfaces it needs;
* ``rows(surfaces, dofs)``: the :class:`ContactRows` of these surfaces, given as :class:`Surface` in
  the order of the tags, with N columns.

``obstacle.py`` is the shortest one, and ``surface.py`` has what all of them need:
:func:`nodal_rows` hides how dofs are numbered, :func:`tangential_order` puts rows in an order that
does not depend on node numbers, and :func:`warn_of_overlap` reports deep overlaps. Rows keep the
length of a unit normal: the scale of forces. Pairings receive gathered arrays, so that every MPI
rank builds the same rows in the same order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.pairings.surface import (
    Surface,
    mean_normal,
    nodal_rows,
    tangential_order,
    unit,
    warn_of_overlap,
)
from hhr_dolfinx.parameters import Tag

__all__ = [
    "ContactRows",
    "Pairing",
    "Surface",
    "mean_normal",
    "nodal_rows",
    "tangential_order",
    "unit",
    "warn_of_overlap",
]


class Pairing(Protocol):
    """Interface of a contact pair in a scene.

    Two methods are optional, for gaps that depend on parameters: ``within(parameters)`` returns the
    pairing for a box, whose rows have the gaps of the middle of the box; ``gap_terms(surfaces,
    rows)`` returns the changes from there for its rows, each a :class:`~hhr_dolfinx.loads.Term`
    with columns (conditions, k) whose amplitude is not affine.
    """

    @property
    def tags(self) -> tuple[Tag, ...]:
        """Facet tags of the surfaces."""

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """Contact rows of the surfaces.

        PairingWarnings report nodes beyond the edge of the other surface, which get no condition,
        and deep overlaps.

        Args:
            surfaces: surfaces of the tags, in their order.
            dofs: number of dofs, the columns of the rows.

        Raises:
            SceneError: if the surfaces do not face each other.
        """
