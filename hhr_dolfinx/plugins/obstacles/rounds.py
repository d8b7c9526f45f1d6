"""Obstacles of second degree: spheres, circles, cylinders and cones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from hhr_dolfinx.pairings.surface import normalised
from hhr_dolfinx.plugins.obstacles.rigid import Rigid, Size
from hhr_dolfinx.plugins.obstacles.written import written_gap

TIP = 1e-7
"""Part of the distance to the tip of a cone within which a normal passes through it."""


@dataclass(frozen=True)
class Quadric:
    """Sphere or circle of sizes (centre, radius), cylinder (point, axis, radius) or cone (tip,
    axis, degrees).

    Methods are those of :class:`~hhr_dolfinx.plugins.obstacles.rigid.RigidShape`.
    """

    kind: str
    inside: bool

    def sides(self) -> Sequence[Quadric]:
        """The shape alone."""
        return (self,)

    def normals(self, sizes: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit normals, zero at a centre or on an axis.

        Args:
            sizes: sizes of the obstacle, (k,).
            points: the points, (m, dim).

        Returns:
            Unit normals, (m, dim), and False for each point: nothing lies beyond an end.
        """
        dim = points.shape[1]
        offsets = points - sizes[:dim]
        axis = _axis(sizes, dim) if self.kind != "sphere" else np.zeros(dim)
        height = offsets @ axis
        outward = normalised(offsets - np.outer(height, axis))
        if self.kind == "cone":
            sine = np.sin(np.deg2rad(sizes[-1]))
            cosine = np.cos(np.deg2rad(sizes[-1]))
            # distance from the tip along the nearest line of the cone
            along = height * cosine + np.einsum("md,md->m", offsets, outward) * sine
            outward = np.where(
                (along > 0)[:, None], outward * cosine - axis * sine, normalised(offsets)
            )
        return outward if self.inside else -outward, np.zeros(len(points), dtype=bool)

    def along(self, sizes: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Distances along normals, (m,).

        With offsets d from the place, a g^2 + 2 b g + c = 0. The value is negative inside, and
        falls along a normal from outside, which decides between both roots: g = c / (-b + root),
        from inside g = c / (-b - root).

        Args:
            sizes: sizes of the obstacle, (k,).
            points: the points, (m, dim).
            normals: unit normals, (m, dim).
        """
        dim = points.shape[1]
        offsets = points - sizes[:dim]
        pairs = ((normals, normals), (offsets, normals), (offsets, offsets))
        a, b, c = (np.einsum("md,md->m", *pair) for pair in pairs)
        straight = -b
        at_place = np.real(c - b * b) <= TIP**2 * np.real(c)  # normals that pass through the place
        axis = _axis(sizes, dim) if self.kind != "sphere" else np.zeros(dim)
        height = offsets @ axis
        rise = normals @ axis
        share = 1 + np.tan(np.pi / 180 * sizes[-1]) ** 2 if self.kind == "cone" else 1.0
        a = a - share * rise**2
        b = b - share * height * rise
        c = c - share * height**2 - (0.0 if self.kind == "cone" else sizes[-1] ** 2)
        inner = b * b - a * c
        root = np.sqrt(np.where(np.real(inner) >= 0, inner, np.nan))
        with np.errstate(all="ignore"):
            gaps = c / (-b + (-root if self.inside else root))
            if self.kind == "cone":
                # the other half of the double cone is no obstacle
                gaps = np.where(np.real(height + gaps * rise) >= 0, gaps, np.nan)
                gaps = np.where(at_place & (np.real(height) < 0), straight, gaps)
        return gaps

    def written(
        self, sizes: Sequence[str], point: np.ndarray, normal: np.ndarray, far: float
    ) -> str:
        """Distance along a normal as a formula of the sizes.

        Args:
            sizes: formulas of the sizes.
            point: the point, (dim,).
            normal: unit normal, (dim,).
            far: distance if the normal misses the obstacle.
        """
        return written_gap(self.kind, self.inside, sizes, point, normal, far, TIP)


def _axis(sizes: np.ndarray, dim: int) -> np.ndarray:
    """Unit axis, of complex sizes too."""
    axis = sizes[dim : 2 * dim]
    return axis / np.sqrt((axis * axis).sum())


@dataclass(frozen=True)
class _Round(Rigid):
    #: True if the body is in the obstacle, a hole
    inside: bool = field(default=False, kw_only=True)

    kind: ClassVar[str] = "sphere"

    @property
    def _shape(self) -> Quadric:
        return Quadric(self.kind, bool(self.inside))

    @property
    def _rate(self) -> float:
        return 0.0 if self.kind == "cone" else 1.0 if self.inside else -1.0


@dataclass(frozen=True)
class Sphere(_Round):
    """Contact with a rigid sphere, ``hhr.Sphere("TOP", center=(0, 0, "2 - depth"), radius="R")``.

    Attributes:
        surface: facet tag of the surface of the body.
        center: centre, three numbers or formulas of the parameters.
        radius: radius, a number or a formula.
        inside: True if the body is in the sphere, a hole.
        friction, law: as of :class:`~hhr_dolfinx.pairings.obstacle.Obstacle`.
    """

    center: tuple[Size, ...] = ()
    radius: Size = 0.0

    @property
    def _sizes(self) -> tuple[Size, ...]:
        return (*self._vector("center"), self.radius)


@dataclass(frozen=True)
class Circle(Sphere):
    """Contact with a rigid circle in the plane, the section of a cylinder.

    In axisymmetry of a sphere or a torus.

    Attributes are those of :class:`Sphere`, with two coordinates of the centre.
    """

    dimension: ClassVar[int] = 2


@dataclass(frozen=True)
class Cylinder(_Round):
    """Contact with an infinite rigid cylinder.

    Attributes:
        surface: facet tag of the surface of the body.
        point: a point of the axis, three numbers or formulas of the parameters.
        axis: vector along the axis, of any length.
        radius: radius, a number or a formula.
        inside: True if the body is in the cylinder, a hole.
        friction, law: as of :class:`~hhr_dolfinx.pairings.obstacle.Obstacle`.
    """

    point: tuple[Size, ...] = ()
    axis: tuple[Size, ...] = ()
    radius: Size = 0.0

    kind: ClassVar[str] = "cylinder"

    @property
    def _sizes(self) -> tuple[Size, ...]:
        return (*self._vector("point"), *self._vector("axis"), self.radius)


@dataclass(frozen=True)
class Cone(_Round):
    """Contact with a rigid cone, which is infinite beyond its tip.

    Attributes:
        surface: facet tag of the surface of the body.
        tip: the tip, three numbers or formulas of the parameters.
        axis: vector along the axis, from the tip into the cone.
        angle: degrees between the axis and the side, a number or a formula.
        inside: True if the body is in the cone, a conical hole.
        friction, law: as of :class:`~hhr_dolfinx.pairings.obstacle.Obstacle`.
    """

    tip: tuple[Size, ...] = ()
    axis: tuple[Size, ...] = ()
    angle: Size = 0.0

    kind: ClassVar[str] = "cone"
    limits: ClassVar[tuple[float, float]] = (0.0, 90.0)

    @property
    def _sizes(self) -> tuple[Size, ...]:
        return (*self._vector("tip"), *self._vector("axis"), self.angle)
