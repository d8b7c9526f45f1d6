"""Obstacles drawn by points: a curve in the plane, or a surface of triangles in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.sparse import coo_matrix

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import formula_of
from hhr_dolfinx.pairings.surface import Surface, area_vectors, normalised
from hhr_dolfinx.plugins.nonmatching.projection import closest_points
from hhr_dolfinx.plugins.obstacles.rigid import Rigid, Size

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

CURVE_ITERATIONS = 8
"""Newton steps on a curve: from a chord three to four reach round-off."""
CURVE_CHORDS = 8
"""Chords of a curve between two points, which start the search on it."""
CURVE_SAMPLES = 801
"""Points of a curve given by a formula.

a spline through them is off by the fourth power of their distance.
"""
SMOOTH = np.cos(np.deg2rad(20.0))
"""Cosine of half the angle of a crease: normals of smooth surfaces deviate less from the way to the
closest point.
"""
EDGE_ROUND_OFF = 1e-6
"""Part of a facet by which round-off puts a point off its edge."""
OBSTACLE_PAIRS = 2_000_000
"""Pairs of a node and a facet in one batch."""


@dataclass(frozen=True)
class Facets:
    """Segments in the plane or triangles in space, of sizes (place, scale).

    On a curve if they are its chords.

    Points are relative to the place, and in units of the scale. Methods are those of
    :class:`~hhr_dolfinx.plugins.obstacles.rigid.RigidShape`.
    """

    corners: Annotated[
        Floats, "rigid facets", "rigid dimension", "rigid dimension"
    ]  #: of each facet, (f, dim, dim)
    flat: Annotated[Floats, "rigid facets", "rigid dimension"]  #: unit normals
    smooth: Annotated[
        Floats, "rigid facets", "rigid dimension", "rigid dimension"
    ]  #: those at corners, up to creases
    ends: Annotated[
        Integers, "rigid facets", "rigid dimension"
    ]  #: 1 for a corner on the end of the obstacle
    #: cubic polynomials of the pieces of a curve, (4, pieces, 2); none of a polyline or a surface
    curve: Annotated[Floats, "powers", "pieces", "plane"]
    turned: float = 1.0  #: -1 if unit normals point to the body

    def sides(self) -> Sequence[Facets]:
        """Both orientations."""
        return self, replace(self, turned=-self.turned)

    def normals(self, sizes: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit normals of the smooth surface at the closest points; at an edge the direction to it.

        Args:
            sizes: place and scale, (dim + 1,).
            points: the points, (m, dim).

        Returns:
            Unit normals, (m, dim), and points beyond the end, (m,) bool.
        """
        local = (points - sizes[:-1]) / sizes[-1]
        facets, weights, offsets = closest_points(local, self.corners)
        flat = self.flat[facets]
        smooth = normalised(np.einsum("mk,mkd->md", weights, self.smooth[facets]))
        if self.curve.size:
            curve_points, tangent = self._on_curve(facets, weights, local, None)
            offsets = local - curve_points
            flat = smooth = normalised(_rotated(tangent))
        lengths = np.linalg.norm(np.ptp(self.corners[facets], axis=1), axis=1)
        heights = np.einsum("md,md->m", offsets, flat)
        # all corners of the facet that bear the closest point are on the end
        end = ((self.ends[facets] == 1) | (weights <= EDGE_ROUND_OFF)).all(axis=1)
        beyond = end & (
            np.linalg.norm(offsets - heights[:, None] * flat, axis=1) > EDGE_ROUND_OFF * lengths
        )
        away = np.linalg.norm(offsets, axis=1)
        straight = normalised(offsets) * np.where(heights < 0, -1.0, 1.0)[:, None]
        edge = (
            ~end
            & (away > EDGE_ROUND_OFF * lengths)
            & (np.einsum("md,md->m", straight, smooth) < SMOOTH)
        )
        return self.turned * np.where(edge[:, None], straight, smooth), beyond

    def along(self, sizes: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Distances along normals to the nearest front, (m,).

        Args:
            sizes: place and scale, (dim + 1,).
            points: the points, (m, dim).
            normals: unit normals, (m, dim).
        """
        local = (points - sizes[:-1]) / sizes[-1]
        count = max(1, OBSTACLE_PAIRS // len(self.corners))
        batches = [slice(first, first + count) for first in range(0, len(local), count)]
        crossings = [self._crossed(np.real(local[batch]), normals[batch]) for batch in batches]
        entries, vectors = (np.concatenate(batch) for batch in zip(*crossings, strict=True))
        with np.errstate(all="ignore"):
            across = np.einsum("md,md->m", normals, vectors)
            return sizes[-1] * np.einsum("md,md->m", entries - local, vectors) / across

    def _crossed(self, local: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest points at which lines along normals enter the obstacle, NaN without one, and its
        normals there.
        """
        middles = self.corners.mean(axis=1)
        reach = np.linalg.norm(self.corners - middles[:, None], axis=2).max(axis=1)
        rise = normals @ middles.T - np.einsum("md,md->m", normals, local)[:, None]
        away = (
            (middles**2).sum(axis=1)
            - 2 * local @ middles.T
            + (local**2).sum(axis=1)[:, None]
            - rise**2
        )
        slack = (
            1e-12 * (np.abs(middles).max() + np.abs(local).max()) ** 2
        )  # cancellation of these squares
        near = (away <= (1 + EDGE_ROUND_OFF) ** 2 * reach**2 + slack) & (
            self.turned * normals @ self.flat.T > EDGE_ROUND_OFF
        )
        point, facet = np.nonzero(near)
        start = self.corners[facet, 0]
        edges = self.corners[facet, 1:] - start[:, None]
        normal = self.flat[facet]
        gap = np.einsum("pd,pd->p", start - local[point], normal) / np.einsum(
            "pd,pd->p", normals[point], normal
        )
        inner = np.einsum(
            "pd,pde->pe",
            local[point] + gap[:, None] * normals[point] - start,
            np.linalg.pinv(edges),
        )
        weights = np.column_stack([1 - inner.sum(axis=1), inner])
        order = np.lexsort((np.abs(gap), point))
        order = order[(weights[order] >= -EDGE_ROUND_OFF).all(axis=1)]
        hit, first = np.unique(point[order], return_index=True)
        facet = facet[order[first]]
        weights = weights[order[first]]
        entries = np.full_like(local, np.nan)
        vectors = np.zeros_like(local)
        entries[hit] = np.einsum("mk,mkd->md", weights, self.corners[facet])
        vectors[hit] = self.flat[facet]
        if self.curve.size:
            entries[hit], tangents = self._on_curve(facet, weights, local[hit], normals[hit])
            vectors[hit] = _rotated(tangents)
        return entries, vectors

    def _on_curve(
        self, chords: np.ndarray, weights: np.ndarray, local: np.ndarray, normals: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points of the curve closest to points, or on lines along normals, and tangents: Newton's
        method from chords.

        The place on the curve is the index of a piece plus a fraction of it.
        """
        pieces = self.curve.shape[1]
        position = (chords + weights[:, 1]) * pieces / len(self.corners)
        for step in range(CURVE_ITERATIONS + 1):
            piece = np.clip(np.floor(position).astype(int), 0, pieces - 1)
            t = (position - piece)[:, None]
            a, b, c, d = self.curve[:, piece]
            point = ((a * t + b) * t + c) * t + d
            tangent = (3 * a * t + 2 * b) * t + c
            second = 6 * a * t + 2 * b
            if step == CURVE_ITERATIONS:
                break
            across = tangent if normals is None else _rotated(normals)
            slope = np.einsum("md,md->m", tangent, across)
            if normals is None:  # in a bend the closest point may be no minimum of the parabola
                slope = np.maximum(
                    slope + np.einsum("md,md->m", point - local, second), 0.1 * slope
                )
            change = np.einsum("md,md->m", point - local, across) / slope
            position = position - np.clip(change, -0.5, 0.5)
            position = (
                np.clip(position, 0.0, pieces) if self.ends.any() else np.mod(position, pieces)
            )
        return point, tangent


def _rotated(vectors: np.ndarray) -> np.ndarray:
    """Vectors rotated clockwise by 90 degrees, as normals of segments."""
    return np.column_stack([vectors[:, 1], -vectors[:, 0]])


def facets_of(points: np.ndarray, facets: np.ndarray, curve: np.ndarray | None = None) -> Facets:
    """Segments or triangles, oriented alike, with smooth normals.

    Args:
        points: the nodes, (n, dim).
        facets: nodes of the segments or triangles, (f, dim).
        curve: coefficients of the pieces of a cubic curve, (4, pieces, 2), of which segments are
            the chords.

    Raises:
        SceneError: for a surface with one side.
    """
    count, k = facets.shape
    # sides of facets, without a corner each, and +1 or -1 by their direction
    sides = np.concatenate([facets[:, [(i + 1 + j) % k for j in range(k - 1)]] for i in range(k)])
    signs = (
        np.where(sides[:, 0] < sides[:, 1], 1.0, -1.0) if k == 3 else np.repeat([1.0, -1.0], count)
    )
    nodes, side, numbers = np.unique(
        np.sort(sides, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    border = coo_matrix((signs, (side.ravel(), np.tile(np.arange(count), k)))).tocsr()
    turned = np.zeros(count)
    while (turned == 0).any():
        fresh = np.arange(count) == (turned == 0).argmax()
        while fresh.any():
            turned = turned + fresh
            fresh = np.where(turned == 0, -np.sign(border.T @ (border @ turned)), 0.0)
    if (np.abs(border @ turned) > 1).any():
        raise SceneError("the facets of a rigid obstacle have no consistent sides: mend the mesh")
    facets = np.where((turned < 0)[:, None], facets[:, ::-1], facets)
    vectors = area_vectors(points[facets])
    sizes = np.linalg.norm(vectors, axis=1)
    ones = np.ones(len(points))
    surface = Surface(
        "", np.arange(len(points)), points, facets, normalised(vectors), sizes, ones, ones, sizes
    )
    ends = np.isin(facets, nodes[numbers == 1]).astype(np.int64)
    powers = np.zeros((4, 0, 2)) if curve is None else curve
    return Facets(surface.corners, surface.outward, surface.corner_normals, ends, powers)


@dataclass(frozen=True)
class _Drawn(Rigid):
    @property
    def _sizes(self) -> tuple[Size, ...]:
        return (*self._vector("place"), self.scale)  # type: ignore[attr-defined]

    @cached_property
    def _shape(self) -> Facets:
        return self._drawn()

    def _drawn(self) -> Facets:
        raise NotImplementedError


@dataclass(frozen=True)
class Profile(_Drawn):
    """Contact with a rigid curve in the plane, in axisymmetry with a surface of revolution.

    ``hhr.Profile("TOP", "0.1 * x**2", between=(-1, 1), place=(0, "1 - depth"))``. The body may be
    on either side.

    Attributes:
        surface: facet tag of the surface of the body.
        curve: points in their order, (n, 2), a closed curve if the first is the last; or a formula:
            y of x, z of r, or x of y, r of z.
        between: ends of the variable of a formula.
        smooth: True for a cubic spline through the points, False for straight lines between them.
        place: shift of the curve, numbers or formulas of the parameters.
        scale: factor of its points before the shift, a number or a formula.
        friction, law: as of :class:`~hhr_dolfinx.pairings.obstacle.Obstacle`.
    """

    curve: Any = ()
    between: tuple[float, float] | None = None
    smooth: bool = True
    place: tuple[Size, ...] = (0.0, 0.0)
    scale: Size = 1.0

    dimension: ClassVar[int] = 2

    def _drawn(self) -> Facets:
        points, knots = (
            self._sampled() if isinstance(self.curve, str) else (_array(self.curve), None)
        )
        steps = (
            np.linalg.norm(np.diff(points, axis=0), axis=1)
            if points.shape[1:] == (2,)
            else np.zeros(0)
        )
        if not steps.size or not np.isfinite(points).all() or not steps.all():
            raise SceneError(
                "the curve of a Profile needs two or more distinct points, (n, 2), not "
                f"{self.curve!r:.80}"
            )
        closed = np.array_equal(points[0], points[-1])
        powers = None
        if self.smooth and len(steps) > 1:
            chords = CURVE_CHORDS if knots is None else 1
            knots = np.append(0.0, np.cumsum(steps)) if knots is None else knots
            spline = CubicSpline(knots, points, bc_type="periodic" if closed else "not-a-knot")
            powers = spline.c * (np.diff(knots) ** np.arange(3, -1, -1)[:, None])[:, :, None]
            points = spline(
                np.interp(np.arange(chords * len(steps) + 1) / chords, np.arange(len(knots)), knots)
            )
        count = len(points) - 1
        following = np.arange(1, count + 1) % (count if closed else count + 1)
        return facets_of(
            points[: count if closed else None],
            np.column_stack([np.arange(count), following]),
            powers,
        )

    def _sampled(self) -> tuple[np.ndarray, np.ndarray]:
        """Points of a formula, (n, 2), and values of its variable."""
        formula = formula_of(self.curve, f"the curve of a Profile at surface {self.surface}")
        name = formula.variables[0] if formula.variables else "x"
        between = _array(self.between)
        increases = between.shape == (2,) and -np.inf < between[0] < between[1] < np.inf
        if len(formula.variables) > 1 or name not in "xyrz" or not increases:
            raise SceneError(
                f"the curve {self.curve!r} of a Profile must be a formula of one of x, y, r and "
                "z, and its ends increase, between=(-1, 1)"
            )
        positions = np.linspace(between[0], between[1], CURVE_SAMPLES)
        with np.errstate(all="ignore"):
            values = np.broadcast_to(formula({name: positions}), CURVE_SAMPLES)
        if not np.isfinite(values).all():
            bad = positions[~np.isfinite(values)][0]
            raise SceneError(
                f"the curve {self.curve!r} of a Profile is not finite at {name} = {bad:g}: move "
                "its ends"
            )
        return np.column_stack(
            [positions, values] if name in "xr" else [values, positions]
        ), positions


@dataclass(frozen=True)
class RigidMesh(_Drawn):
    """Contact with a rigid surface of triangles, on either side of it.

    Normals are smooth up to edges of 40 degrees.

    Attributes:
        surface: facet tag of the surface of the body.
        mesh: a file that meshio reads, such as STL; or points, (n, 3), and nodes of triangles or
            quadrilaterals.
        place: shift of the mesh, numbers or formulas of the parameters.
        scale: factor of its points before the shift, a number or a formula.
        friction, law: as of :class:`~hhr_dolfinx.pairings.obstacle.Obstacle`.
    """

    mesh: Any = ()
    place: tuple[Size, ...] = (0.0, 0.0, 0.0)
    scale: Size = 1.0

    def _drawn(self) -> Facets:
        listed = isinstance(self.mesh, tuple | list)
        arrays = (
            _read(Path(self.mesh))
            if isinstance(self.mesh, str | Path)
            else tuple(self.mesh if listed else ())
        )
        points, *facet_blocks = (_array(block) for block in arrays or ((),))
        # a polygon of more corners would lose the others
        facet_blocks = [
            block.astype(np.int64)
            for block in facet_blocks
            if block.ndim == 2 and block.shape[1] in (3, 4)
        ]
        three = [
            block[:, corners]
            for block in facet_blocks
            for corners in ([0, 1, 2], [0, 2, 3])
            if block.shape[1] > max(corners)
        ]
        facets = np.concatenate([np.zeros((0, 3), dtype=np.int64), *three])
        wrong = points.shape[1:] != (3,) or not np.isfinite(points).all() or not facets.size
        if wrong or facets.min() < 0 or facets.max() >= len(points):
            raise SceneError(
                f"the mesh {self.mesh!r:.80} of a RigidMesh must be a file or (points, facets) "
                "with triangles"
            )
        # files of triangles repeat their nodes
        extent = np.ptp(points, axis=0).max() or 1.0
        _, first, names = np.unique(
            np.round(points / extent, 10), axis=0, return_index=True, return_inverse=True
        )
        points = points[first]
        facets = names.ravel()[facets]
        facets = facets[np.linalg.norm(area_vectors(points[facets]), axis=1) > 1e-14 * extent**2]
        if not facets.size:
            raise SceneError(
                f"the mesh {self.mesh!r:.80} of a RigidMesh has no triangle with an area"
            )
        used, numbers = np.unique(facets, return_inverse=True)
        return facets_of(points[used], numbers.reshape(-1, 3))


def _array(given: ArrayLike | None) -> np.ndarray:
    """Numbers as an array; an empty one for anything else."""
    try:
        return np.array(given, dtype=float)
    except (TypeError, ValueError):
        return np.zeros(0)


def _read(path: Path) -> tuple[np.ndarray, ...]:
    """Points, triangles and quadrilaterals of a file."""
    from hhr_dolfinx.geometries.by_meshio import opened

    try:
        mesh = opened(path)
    except Exception as error:  # readers of meshio raise anything
        raise SceneError(f"the mesh file {path} of a RigidMesh cannot be read: {error}") from error
    return (
        mesh.points,
        *(block.data for block in mesh.cells if block.type in ("triangle", "quad")),
    )
