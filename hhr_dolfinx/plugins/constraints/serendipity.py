"""Serendipity elements: quadrilaterals of 8 and hexahedra of 20 nodes, as C3D20 of decks."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from hhr_dolfinx import compat
from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.loads import Assembler
from hhr_dolfinx.plugins.constraints.elimination import ConstraintEquations
from hhr_dolfinx.plugins.constraints.equations import equations_of

MID_FACE_CELLS = {9: "quadrilateral", 27: "hexahedron"}
"""Cells of second order that have nodes in the middle of their faces, by their number of nodes."""


@dataclass(frozen=True)
class Serendipity:
    """Nodes in the middle of faces and cells follow those of edges, which leaves 8 or 20 nodes of
    each cell.

    The displacement is then that of serendipity elements on the same mesh: at the middle of a face
    it is half of the sum at the middles of the four edges less a quarter of that at the corners, in
    the middle of a hexahedron a quarter of both sums.
    """

    amplitude: Amplitude = field(default=Amplitude(), init=False)

    def equations(self, assembler: Assembler) -> ConstraintEquations:
        """See :class:`~hhr_dolfinx.plugins.constraints.elimination.Constraint`.

        Raises:
            SceneError: for other cells.
        """
        cells = assembler.cells()
        if cells.shape[1] not in MID_FACE_CELLS:
            raise SceneError("Serendipity() needs quadrilaterals or hexahedra of second order")
        middle, sources, shares = _middles(MID_FACE_CELLS[cells.shape[1]])
        # the middle of a face between two cells is determined once, by the first of them
        nodes, first = np.unique(cells[:, middle], return_index=True)
        cell, middle_index = np.unravel_index(first, (len(cells), middle.size))
        (dim,) = assembler.test.ufl_shape
        count = dim * nodes.size
        dofs = (dim * nodes[:, None] + np.arange(dim)).ravel()
        entries = [(np.ones(count), np.arange(count), dofs)]
        for k, node in enumerate(sources):
            columns = (dim * cells[cell, node][:, None] + np.arange(dim)).ravel()
            values = np.repeat(-shares[middle_index, k], dim)
            entries.append((values[values != 0], np.flatnonzero(values), columns[values != 0]))
        return replace(equations_of(entries, dofs, assembler.size, loose=True), middle=True)


def _middles(cell: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes in the middle of faces and of the cell, (m,), corners and nodes of edges, (n,), and
    shares, (m, n).

    The value in the middle is that of the shape functions of the serendipity element there: -1/4 at
    each corner, and 1/2 at the edges of a face, or 1/4 at those of a hexahedron.
    """
    edges, faces = (np.array(arrays) for arrays in compat.topology(cell))
    corners = int(edges.max()) + 1
    ends = np.concatenate(
        [np.arange(corners)[:, None].repeat(2, axis=1), edges]
    )  # corners on both sides of each node
    all_corners = np.arange(corners)
    if cell == "hexahedron":
        sides = [*faces, all_corners]
        of_edges = np.array([*[0.5] * len(faces), 0.25])
    else:
        sides = [all_corners]
        of_edges = np.array([0.5])
    on_side = np.array([np.isin(ends, side).all(axis=1) for side in sides])
    shares = on_side * np.where(np.arange(len(ends)) < corners, -0.25, of_edges[:, None])
    return len(ends) + np.arange(len(sides)), np.arange(len(ends)), shares
