"""Contact with a rigid obstacle that moves with a tool.

A row of an obstacle is n·u, with u of nodes of the surface. Beside a tool it is n·(u - U), where U
is the motion of the tool at the place that the node meets: the motion of the nodes of its cell,
which moves as a rigid body, continued affinely. Tangents of friction have the same weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, kron

from hhr_dolfinx.contact.law import LAW, PairLaw
from hhr_dolfinx.contact.rows import ContactRows, normals_of
from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.pairings.obstacle import Obstacle
from hhr_dolfinx.pairings.surface import Surface
from hhr_dolfinx.parameters import ParameterSpace, Tag

LAWS = "friction", "law"
"""Fields of a pairing that a pairing around it has in its place."""


@dataclass(frozen=True)
class OnTool(KnownArguments):
    """Contact with a rigid obstacle that moves with a tool: :func:`~.drive.drive` makes it."""

    obstacle: Any  #: the obstacle, a pairing of one surface
    tool: Tag  #: surface of the tool
    friction: PairLaw | float | str | None = field(default=None, metadata=LAW)
    law: PairLaw | None = field(default=None, metadata=LAW)

    @classmethod
    def of(cls, obstacle: Any, tool: Tag) -> OnTool:
        """The obstacle on a tool, with its laws.

        Args:
            obstacle: the obstacle.
            tool: surface of the tool.
        """
        laws = {name: getattr(obstacle, name, None) for name in LAWS}
        stated = {name: None for name, law in laws.items() if law is not None}
        return cls(replace(obstacle, **stated) if stated else obstacle, tool, **laws)

    @property
    def tags(self) -> tuple[Tag, ...]:
        """Surfaces of the body and of the tool."""
        return (*self.obstacle.tags, self.tool)

    @property
    def same_everywhere(self) -> bool:
        """True for a plane, along which bodies may slide by any length."""
        return isinstance(self.obstacle, Obstacle)

    def same_as(self, other: object) -> bool:
        """True for a pairing with the same conditions.

        Args:
            other: another pairing of these surfaces.
        """
        if not isinstance(other, OnTool):
            return False
        with suppress(ValueError):  # curves are arrays
            return bool(self.obstacle is other.obstacle or self.obstacle == other.obstacle)
        return False

    def within(self, parameters: ParameterSpace) -> OnTool:
        """The pairing for a box.

        Args:
            parameters: the box.
        """
        if not hasattr(self.obstacle, "within"):
            return self
        changed = replace(self.obstacle, **{name: getattr(self, name) for name in LAWS})
        return OnTool.of(changed.within(parameters), self.tool)

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """Rows of the obstacle, less the motion of the tool.

        Args:
            surfaces: surfaces of the body and of the tool.
            dofs: number of dofs.

        Raises:
            SceneError: those of the obstacle.
        """
        surface, tool = surfaces
        rows = self.obstacle.rows([surface], dofs)
        dim = surface.points.shape[1]
        met = surface.points.copy()
        index = np.searchsorted(surface.nodes, rows.slaves)
        met[index] += rows.gap[:, None] * normals_of(rows.matrix, rows.slaves, dim)
        follows = _follows(met, tool.points)
        nodes = np.repeat(surface.nodes, len(tool.nodes)), np.tile(tool.nodes, len(met))
        shape = (dofs // dim,) * 2
        motion = kron(csr_matrix((follows.ravel(), nodes), shape=shape), np.eye(dim), format="csr")
        return replace(rows, matrix=csr_matrix(rows.matrix - rows.matrix @ motion))

    def gap_terms(self, surfaces: Sequence[Surface], rows: ContactRows) -> list[Any]:
        """Changes of the gaps of the obstacle over the box.

        Args:
            surfaces: surfaces of the body and of the tool.
            rows: conditions.
        """
        if not hasattr(self.obstacle, "gap_terms"):
            return []
        terms: list[Any] = self.obstacle.gap_terms(surfaces[:1], rows)
        return terms


def _follows(points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Shares of the motions of nodes of a tool, (k, dim), in that of places on it, (n, k).

    They are the smallest that are exact for affine motions, of which rigid ones are some.
    """
    middle = nodes.mean(axis=0)
    size = np.ptp(nodes, axis=0).max()
    known, wanted = (
        np.column_stack([np.ones(len(some)), (some - middle) / size]) for some in (nodes, points)
    )
    shares: np.ndarray = wanted @ np.linalg.pinv(known)
    return shares
