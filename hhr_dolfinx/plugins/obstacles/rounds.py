"""Obstacles of second degree: spheres, circles, cylinders and cones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.pairings.surface import normalised
from hhr_dolfinx.plugins.obstacles.rigid import Rigid

TIP = 1e-7
"""Part of the distance to the tip of a cone within which a normal passes through it."""


@dataclass(frozen=True)
class Quadric:
    """Sphere or circle of sizes (centre, radius), cylinder (point, axis, radius) or cone (tip, axis, degrees)."""

    kind: str
    inside: bool

    def sides(self) -> Sequence[Quadric]:
        """See :class:`~hhr_dolfinx.plugins.obstacles.rigid.RigidShape`."""
        return (self,)

    def normals(self, sizes: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`~hhr_dolfinx.plugins.obstacles.rigid.RigidShape`; zero at a centre or on an axis."""
        dim = points.shape[1]
        offsets = points - sizes[:dim]
        outward = offsets
        if self.kind != "sphere":
            axis = _axis(sizes, dim)
            height = offsets @ axis
            outward = offsets - np.outer(height, axis)
        outward = normalised(outward)
        if self.kind == "cone":
            angle = np.deg2rad(sizes[-1])
            # distance from the tip along the nearest line of the cone
            along = height * np.cos(angle) + np.einsum("md,md->m", offsets, outward) * np.sin(angle)
            side = outward * np.cos(angle) - axis * np.sin(angle)
            outward = np.where((along > 0)[:, None], side, normalised(offsets))
        return outward if self.inside else -outward, np.zeros(len(points), dtype=bool)

    def along(self, sizes: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.plugins.obstacles.rigid.RigidShape`.

        With offsets d from the place, a g^2 + 2 b g + c = 0. The value c is negative inside, and falls along the
        normal from outside, so that of both roots only g = c / (-b + root) comes into question, from inside
        g = c / (-b - root).
        """
        dim = points.shape[1]
        offsets = points - sizes[:dim]
        a, b, c = (np.einsum("md,md->m", *pair) for pair in
                   ((normals, normals), (offsets, normals), (offsets, offsets)))  # fmt: skip
        distance, straight = c, -b
        if self.kind == "sphere":
            c = c - sizes[-1] ** 2
        else:
            axis = _axis(sizes, dim)
            height, rise = offsets @ axis, normals @ axis
            share = 1.0 if self.kind == "cylinder" else 1 + np.tan(np.deg2rad(1.0) * sizes[-1]) ** 2
            a, b, c = a - share * rise**2, b - share * height * rise, c - share * height**2
            if self.kind == "cylinder":
                c = c - sizes[-1] ** 2
        inner = b * b - a * c
        root = np.sqrt(np.where(np.real(inner) >= 0, inner, np.nan))
        with np.errstate(all="ignore"):
            found = c / (-b + (-root if self.inside else root))
            if self.kind == "cone":
                found = np.where(np.real(height + found * rise) >= 0, found, np.nan)
                aside = np.real(distance - straight**2) <= TIP**2 * np.real(distance)
                found = np.where(aside & (np.real(height) < 0), straight, found)
        return found


def _axis(sizes: np.ndarray, dim: int) -> np.ndarray:
    """Unit axis, of complex sizes too."""
    axis = sizes[dim : 2 * dim]
    return axis / np.sqrt((axis * axis).sum())


@dataclass(frozen=True)
class Sphere(Rigid):
    """Contact with a rigid sphere, ``hhr.Sphere("TOP", center=(0, 0, "2 - depth"), radius="R")``.

    Attributes:
        surface: facet tag of the surface of the body.
        center: centre, three numbers or formulas of the parameters.
        radius: radius, a number or a formula.
        inside: True if the body is in the sphere, a hole.
    """

    center: tuple[Any, ...] = ()
    radius: Any = 0.0
    inside: bool = False

    @property
    def shape(self) -> Quadric:
        """See :class:`Rigid`."""
        return Quadric("sphere", bool(self.inside))

    @property
    def sizes(self) -> Sequence[Any]:
        """Centre and radius."""
        return (*self.vector("center"), self.radius)

    @property
    def rate(self) -> float:
        """See :class:`Rigid`."""
        return 1.0 if self.inside else -1.0


@dataclass(frozen=True)
class Circle(Sphere):
    """Contact with a rigid circle in the plane, the section of a cylinder; in axisymmetry of a sphere or a torus.

    Attributes as of :class:`Sphere`, with two coordinates of the centre.
    """

    dimension: ClassVar[int] = 2


@dataclass(frozen=True)
class Cylinder(Rigid):
    """Contact with an infinite rigid cylinder.

    Attributes:
        surface: facet tag of the surface of the body.
        point: a point of the axis, three numbers or formulas of the parameters.
        axis: vector along the axis, of any length.
        radius: radius, a number or a formula.
        inside: True if the body is in the cylinder, a hole.
    """

    point: tuple[Any, ...] = ()
    axis: tuple[Any, ...] = ()
    radius: Any = 0.0
    inside: bool = False

    @property
    def shape(self) -> Quadric:
        """See :class:`Rigid`."""
        return Quadric("cylinder", bool(self.inside))

    @property
    def sizes(self) -> Sequence[Any]:
        """Point, axis and radius."""
        return (*self.vector("point"), *_nonzero(self), self.radius)

    @property
    def rate(self) -> float:
        """See :class:`Rigid`."""
        return 1.0 if self.inside else -1.0


@dataclass(frozen=True)
class Cone(Rigid):
    """Contact with a rigid cone, which is infinite beyond its tip.

    Attributes:
        surface: facet tag of the surface of the body.
        tip: the tip, three numbers or formulas of the parameters.
        axis: vector along the axis, from the tip into the cone.
        angle: degrees between the axis and the side, a number or a formula.
        inside: True if the body is in the cone, a conical hole.
    """

    tip: tuple[Any, ...] = ()
    axis: tuple[Any, ...] = ()
    angle: Any = 0.0
    inside: bool = False

    @property
    def shape(self) -> Quadric:
        """See :class:`Rigid`."""
        return Quadric("cone", bool(self.inside))

    @property
    def sizes(self) -> Sequence[Any]:
        """Tip, axis and angle."""
        return (*self.vector("tip"), *_nonzero(self), self.angle)

    @property
    def limits(self) -> tuple[float, float]:
        """Open interval of the angle."""
        return 0.0, 90.0


def _nonzero(item: Cylinder | Cone) -> tuple[Any, ...]:
    axis = item.vector("axis")
    if all(isinstance(part, int | float) and part == 0 for part in axis):
        raise SceneError(f"axis = {axis} of a {type(item).__name__} must not be zero")
    return axis
