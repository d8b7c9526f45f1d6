"""VTK's numbers of cells, and their corners."""

from __future__ import annotations

TRIANGLE_KINDS = (5, 69)
QUADRILATERAL_KINDS = (9, 70)
TETRAHEDRON_KINDS = (10, 71)
HEXAHEDRON_KINDS = (12, 72)
"""VTK's numbers of cells: linear and of second order."""
CORNERS_OF_KIND = dict.fromkeys(TRIANGLE_KINDS, 3) | dict.fromkeys(
    QUADRILATERAL_KINDS + TETRAHEDRON_KINDS, 4
)
CORNERS_OF_KIND |= dict.fromkeys(HEXAHEDRON_KINDS, 8)
"""Corners of cells by VTK's numbers, which come first."""
