"""Elimination of the constraints of a scene, by the tool ``constraints`` of a plug-in.

The tool is a function ``(scene, assembler, cell_nodes, free, imposed) -> Eliminated`` of a scene
with constraints, the :class:`~hhr_dolfinx.loads.Assembler` of an item, the nodes of each cell, the
dofs that are not imposed, (N,) bool, and the terms of those that are. It raises SceneError for
constraints that contradict each other or imposed displacements.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.contact.prolongation import Prolongation
from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.loads import Term

Conditions = tuple[ContactRows, np.ndarray, np.ndarray]
"""Contact conditions, the pair of each, (m,), and values of each, (m, k)."""


def all_of_them(prolongation: Prolongation, *conditions: *Conditions) -> Conditions:
    """All conditions: none is the same as another one for V."""
    return conditions


@dataclass(frozen=True)
class DependentDofs:
    """Dependent dofs of a scene.

    Attributes:
        prolongation: that of its constraints, without lifts.
        terms: lifts of the values of equations.
        joined: function of a prolongation and :data:`Conditions`, with openings, that leaves out
            those at nodes which constraints join to the other surface.
        merged: function of a prolongation and :data:`Conditions` that leaves out conditions which
            others repeat for V.
    """

    prolongation: Prolongation
    terms: Sequence[Term] = ()
    joined: Callable[..., Conditions] = all_of_them
    merged: Callable[..., Conditions] = all_of_them
