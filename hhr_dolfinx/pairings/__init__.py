"""Pairings: from tagged surfaces to contact rows, one module each, thesis sections 1.2.4 and 5.1.

A pairing is an object with two members, and a user's own is as good as those here:

* ``tags``: facet tags of the surfaces it needs;
* ``rows(surfaces, dofs)``: the :class:`~hhr_dolfinx.contact.problem.ContactRows` of these surfaces, given as
  :class:`~hhr_dolfinx.pairings.surface.Surface` in the order of the tags, with N columns.

The nodes that a row touches are the columns of its entries; the cells it touches follow from the nodes.
Nothing downstream knows which pairing made a row. Pairings see gathered arrays, so that every MPI rank
builds the same rows in the same order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from hhr_dolfinx.contact.problem import ContactRows
from hhr_dolfinx.pairings.surface import Surface


class Pairing(Protocol):
    """What a scene expects of a contact pair."""

    @property
    def tags(self) -> tuple[int, ...]:
        """Facet tags of the surfaces."""

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """Contact rows of the surfaces, with ``dofs`` columns."""
