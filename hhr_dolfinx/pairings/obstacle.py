"""Contact with a rigid plane, thesis (1.26)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hhr_dolfinx.contact.law import LAW, PairLaw
from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.pairings.surface import (
    Surface,
    along_normal,
    check_facing,
    nodal_rows,
    tangential_order,
    unit,
    warn_of_overlap,
)
from hhr_dolfinx.parameters import Tag, is_number


@dataclass(frozen=True)
class Obstacle(KnownArguments):
    """Contact with a rigid plane ``normal·x = offset``, thesis (1.26): ``u·n <= offset / |normal| -
    x·n``.

    Attributes:
        surface: facet tag of the surface of the body.
        normal: vector from the body towards the obstacle, of any length; n is its direction.
        offset: normal·x of the points x of the plane: its position along n if the normal has the
            length 1.
        friction: coefficient of Coulomb's law, a number or a formula, or its law; None without. A
            plug-in reads it.
        law: any law of a plug-in in addition to unilateral contact, such as ``Coulomb(0.3)``; None
            without.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> from dataclasses import replace
        >>> from hhr_dolfinx.geometries import block
        >>> side = block.side(1, upper=False)
        >>> floor = hhr.Obstacle(side, normal=(0, -1), offset=1e-4, friction=0.3)
        >>> model = hhr.condense(replace(scene, contacts=(floor,)))
        >>> round(model.outputs({"push": 50.0})["peak"], 1)
        85.2
    """

    surface: Tag
    normal: tuple[float, ...]
    offset: float
    friction: PairLaw | float | str | None = field(default=None, metadata=LAW)
    law: PairLaw | None = field(default=None, metadata=LAW)

    def __post_init__(self) -> None:
        if not is_number(self.offset):
            raise SceneError(
                f"the offset {self.offset!r} of the obstacle at surface {self.surface} must be a "
                "finite number: where its position depends on parameters, add an Opening"
            )

    @property
    def tags(self) -> tuple[Tag, ...]:
        """The surface of the body."""
        return (self.surface,)

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """One row u·n <= offset / |normal| - x·n for each node that looks at the plane.

        Args:
            surfaces: the surface of the body.
            dofs: number of dofs.

        Raises:
            SceneError: if the surface does not look at the plane.
        """
        (surface,) = surfaces
        normal = unit(self.normal, surface.points.shape[1])
        offset = self.offset / float(np.linalg.norm(self.normal))
        check_facing(surface, normal, along=True, upright=True)
        facing, areas = along_normal(surface, normal)
        order = facing[tangential_order(surface.points[facing], normal)]
        nodes = surface.nodes[order]
        points = surface.points[order]
        matrix = nodal_rows(
            nodes[:, None], np.tile(normal, (nodes.size, 1)), np.ones((nodes.size, 1)), dofs
        )
        rows = ContactRows(matrix, offset - points @ normal, nodes, points, areas[order])
        warn_of_overlap(surface, rows)
        return surface.averaged(rows)
