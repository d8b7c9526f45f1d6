"""Obstacles drawn by points: a curve in the plane, or a surface of triangles in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components

from hhr_dolfinx.compat import extra
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import formula_of
from hhr_dolfinx.pairings.surface import CREASE, area_vectors, normalised
from hhr_dolfinx.plugins.nonmatching.projection import closest_points
from hhr_dolfinx.plugins.obstacles.rigid import BOTH, Rigid

PARTS = 8
"""Chords of a piece of a curve between two points, which start the search on it."""
STEPS = 8
"""Newton steps on a curve: from a chord three to four reach round-off."""
SAMPLES = 401
"""Points of a curve given by a formula; a spline through them is off by the fourth power of their distance."""
SMOOTH = np.cos(np.deg2rad(20.0))
"""Cosine of half the angle of a crease: normals of smooth surfaces deviate less from the way to the closest point."""
EDGE = 1e-6
"""Part of a facet by which round-off puts a point off its edge."""
AT_ONCE = 200_000
"""Pairs of a node and a facet in one batch."""


@dataclass(frozen=True)
class Facets:
    """Segments in the plane or triangles in space, of sizes (place, scale); on a curve if they are its chords.

    Points are relative to the place, and in units of the scale.
    """

    points: Annotated[Floats, "rigid nodes", "rigid dimension"]
    facets: Annotated[Integers, "rigid facets", "rigid dimension"]  # nodes of each facet
    corner_normals: Annotated[Floats, "rigid facets", "rigid dimension", "rigid dimension"]  # smooth up to creases
    open: Annotated[Integers, "rigid facets", "rigid dimension"]  # 1 for a corner on the end of the obstacle
    # cubic polynomials of the pieces of a curve, (4, pieces, 2); none of a polyline or a surface
    curve: Annotated[Floats, "powers", "pieces", "plane"]
    turned: float = 1.0  # -1 if the body is on the side to which corner normals point

    def sides(self) -> Sequence[Facets]:
        """See :class:`~hhr_dolfinx.plugins.obstacles.rigid.RigidShape`."""
        return self, replace(self, turned=-self.turned)

    @property
    def _corners(self) -> np.ndarray:
        return self.points[self.facets]

    def normals(self, sizes: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`~hhr_dolfinx.plugins.obstacles.rigid.RigidShape`.

        The normal is that of the smooth surface at the closest point, at an edge the way to it.
        """
        local = (points - sizes[:-1]) / sizes[-1]
        facets, weights, offsets = closest_points(local, self._corners)
        smooth = self.turned * normalised(np.einsum("mk,mkd->md", weights, self.corner_normals[facets]))
        if self.curve.size:
            places = self._refined((facets + weights[:, 1]) / PARTS, local, None)
            offsets = self._at(places)[0] - local
            smooth = self.turned * _rotated(self._at(places)[1])
        else:
            offsets = np.einsum("mk,mkd->md", weights, self._corners[facets]) - local
        away = np.linalg.norm(offsets, axis=1)
        flat = smooth if self.curve.size else self.turned * _oriented(self._corners, self.corner_normals)[facets]
        straight = normalised(offsets) * np.where(np.einsum("md,md->m", offsets, smooth) < 0, -1.0, 1.0)[:, None]
        aligned = np.einsum("md,md->m", straight, smooth)
        # all corners of the facet that bear the closest point are on the end
        end = ((self.open[facets] == 1) | (weights <= EDGE)).all(axis=1)
        sideways = np.linalg.norm(offsets - np.einsum("md,md->m", offsets, flat)[:, None] * flat, axis=1)
        lengths = np.linalg.norm(np.ptp(self._corners[facets], axis=1), axis=1)
        beyond = end & (sideways > EDGE * lengths)
        edge = (away > EDGE * lengths) & (aligned < SMOOTH) & ~end
        return np.where(edge[:, None], straight, smooth), beyond

    def along(self, sizes: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.plugins.obstacles.rigid.RigidShape`."""
        place, scale = sizes[:-1], sizes[-1]
        local = (points - place) / scale
        hits, tangential = self._hit(np.real(local), normals)
        with np.errstate(all="ignore"):
            across = np.einsum("md,md->m", normals, tangential)
            return scale * np.einsum("md,md->m", hits - local, tangential) / across

    def _hit(self, local: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest points of the front of the obstacle on lines along normals, NaN without one, and normals there."""
        corners = self._corners
        vectors = self.turned * _oriented(corners, self.corner_normals)
        hits = np.full_like(local, np.nan)
        there = np.zeros_like(local)
        chunk = max(1, AT_ONCE // len(corners))
        for first in range(0, len(local), chunk):
            some = slice(first, first + chunk)
            facets, weights = _nearest_crossing(local[some], normals[some], corners, vectors)
            found = np.flatnonzero(facets >= 0)
            facet = facets[found]
            hits[first + found] = np.einsum("mk,mkd->md", weights[found], corners[facet])
            there[first + found] = vectors[facet]
            if self.curve.size and found.size:
                starts = (facet + weights[found, 1]) / PARTS
                on_curve = self._at(self._refined(starts, local[first + found], normals[first + found]))
                hits[first + found] = on_curve[0]
                there[first + found] = self.turned * _rotated(on_curve[1])
        return hits, there

    def _at(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points, tangents and second derivatives of the curve at places, pieces and fractions of these, (m,)."""
        count = self.curve.shape[1]
        piece = np.clip(np.floor(places).astype(int), 0, count - 1)
        t = (places - piece)[:, None]
        a, b, c, d = self.curve[:, piece]
        return ((a * t + b) * t + c) * t + d, (3 * a * t + 2 * b) * t + c, 6 * a * t + 2 * b

    def _refined(self, places: np.ndarray, local: np.ndarray, normals: np.ndarray | None) -> np.ndarray:
        """Places on the curve closest to points, or on lines along normals, by Newton's method from chords."""
        count = self.curve.shape[1]
        for _ in range(STEPS):
            point, tangent, second = self._at(places)
            offset = point - local
            if normals is None:
                residual = np.einsum("md,md->m", offset, tangent)
                slope = np.einsum("md,md->m", tangent, tangent) + np.einsum("md,md->m", offset, second)
                # far inside of a bend the closest point is no minimum of the parabola
                slope = np.maximum(slope, 0.1 * np.einsum("md,md->m", tangent, tangent))
            else:
                across = _rotated(normals, unit=False)
                residual = np.einsum("md,md->m", offset, across)
                slope = np.einsum("md,md->m", tangent, across)
            step = np.divide(residual, slope, out=np.zeros_like(residual), where=slope != 0)
            places = places - np.clip(step, -0.5, 0.5)
            places = np.mod(places, count) if not self.open.any() else np.clip(places, 0.0, count)
        return places


def _rotated(tangents: np.ndarray, *, unit: bool = True) -> np.ndarray:
    """Vectors rotated clockwise by 90 degrees, of length 1."""
    turned = np.column_stack([tangents[:, 1], -tangents[:, 0]])
    return normalised(turned) if unit else turned


def _oriented(corners: np.ndarray, corner_normals: np.ndarray) -> np.ndarray:
    """Unit normals of facets on the side of those at their corners, (f, dim)."""
    vectors = normalised(area_vectors(corners))
    return vectors * np.where(np.einsum("fd,fkd->f", vectors, corner_normals) < 0, -1.0, 1.0)[:, None]


def _nearest_crossing(
    points: np.ndarray, normals: np.ndarray, corners: np.ndarray, vectors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Facets whose front lines along normals cross nearest to the points, -1 without one, (m,), and their weights."""
    count, dim = points.shape
    across = normals @ vectors.T
    front = across > EDGE
    planes = np.einsum("fd,fd->f", corners[:, 0], vectors)
    with np.errstate(all="ignore"):
        gaps = np.where(front, (planes - points @ vectors.T) / across, np.inf)
    point, facet = np.nonzero(front)
    places = points[point] + gaps[point, facet][:, None] * normals[point] - corners[facet, 0]
    edges = corners[:, 1:] - corners[:, :1]
    inverse = np.linalg.pinv(edges)[facet]  # (pairs, dim, dim - 1)
    inner = np.einsum("pd,pde->pe", places, inverse)
    weights = np.column_stack([1 - inner.sum(axis=1), inner])
    inside = (weights >= -EDGE).all(axis=1)
    distance = np.full((count, len(corners)), np.inf)
    distance[point[inside], facet[inside]] = np.abs(gaps[point[inside], facet[inside]])
    nearest = distance.argmin(axis=1)
    found = np.where(np.isfinite(distance[np.arange(count), nearest]), nearest, -1)
    all_weights = np.zeros((count, len(corners), dim))
    all_weights[point, facet] = weights
    return found, all_weights[np.arange(count), nearest]


def facets_of(points: np.ndarray, facets: np.ndarray, curve: np.ndarray | None = None) -> Facets:
    """Segments or triangles, (f, dim), with consistent orientation, smooth normals and their ends."""
    facets = _alike(facets)
    corners = points[facets]
    vectors = area_vectors(corners)
    sizes = np.linalg.norm(vectors, axis=1)
    unit = normalised(vectors)
    count, k = facets.shape
    # sum of the normals of facets at the node of each corner that meet this one smoothly
    at_node = coo_matrix((np.ones(count * k), (facets.ravel(), np.repeat(np.arange(count), k)))).tocsr()
    pairs = (at_node.T @ at_node).tocoo()
    smooth = np.einsum("pd,pd->p", unit[pairs.row], unit[pairs.col]) >= CREASE
    one, other = pairs.row[smooth], pairs.col[smooth]
    normals = np.zeros((count, k, k))
    for corner in range(k):
        shared = (facets[other] == facets[one, corner][:, None]).any(axis=1)
        np.add.at(normals[:, corner], one[shared], unit[other[shared]] * sizes[other[shared], None])
    ends = _ends(facets)
    powers = np.zeros((4, 0, 2)) if curve is None else curve
    return Facets(points, facets, normalised(normals), np.isin(facets, ends).astype(np.int64), powers)


def _sides_of(facets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of sides, sorted, (s, dim - 1), facet of each, and sign of its direction in the facet, (s,)."""
    count, k = facets.shape
    sides = np.concatenate([facets[:, [j % k for j in range(i + 1, i + k)]] for i in range(k)])
    signs = np.where(sides[:, 0] <= sides[:, -1], 1, -1) if k > BOTH else np.repeat([1, -1], count)
    return np.sort(sides, axis=1), np.tile(np.arange(count), k), signs


def _ends(facets: np.ndarray) -> np.ndarray:
    """Nodes of the sides of only one facet."""
    sides, numbers = np.unique(_sides_of(facets)[0], axis=0, return_counts=True)
    return np.unique(sides[numbers == 1])


def _alike(facets: np.ndarray) -> np.ndarray:
    """The facets of each connected part turned like its first one; SceneError for a surface with one side."""
    sides, owner, signs = _sides_of(facets)
    _, side = np.unique(sides, axis=0, return_inverse=True)
    order = np.argsort(side.ravel(), kind="stable")
    same = np.flatnonzero(np.diff(side.ravel()[order]) == 0)
    one, other = order[same], order[same + 1]
    relative = np.where(signs[one] == signs[other], -1, 1)
    links = coo_matrix((np.ones(one.size), (owner[one], owner[other])), shape=(len(facets),) * 2).tocsr()
    relation = dict(zip(zip(owner[one].tolist(), owner[other].tolist(), strict=True), relative.tolist(), strict=True))
    turned = np.ones(len(facets))
    _, parts = connected_components(links, directed=False)
    for first in np.unique(parts, return_index=True)[1]:
        sequence, before = breadth_first_order(links, first, directed=False)
        for facet in sequence[1:].tolist():
            last = int(before[facet])
            turned[facet] = turned[last] * (relation.get((facet, last)) or relation[last, facet])
    if (turned[owner[one]] * turned[owner[other]] != relative).any():
        raise SceneError("the facets of a RigidMesh have no consistent sides: mend the mesh")
    return np.where((turned < 0)[:, None], facets[:, ::-1], facets)


@dataclass(frozen=True)
class Profile(Rigid):
    """Contact with a rigid curve in the plane, in axisymmetry a surface of revolution.

    ``hhr.Profile("TOP", "0.1 * x**2", between=(-1, 1), place=(0, "1 - depth"))``. The body may be on either side.

    Attributes:
        surface: facet tag of the surface of the body.
        curve: points in their order, (n, 2), a closed curve if the first is the last; or a formula: y of x, z of r, or
            x of y, r of z.
        between: ends of the variable of a formula.
        smooth: True for a cubic spline through the points, False for straight lines between them.
        place: shift of the curve, numbers or formulas of the parameters.
        scale: factor of its points before the shift, a number or a formula.
    """

    curve: Any = ()
    between: tuple[float, float] | None = None
    smooth: bool = True
    place: tuple[Any, ...] = (0.0, 0.0)
    scale: Any = 1.0

    dimension: ClassVar[int] = 2

    @property
    def sizes(self) -> Sequence[Any]:
        """Place and scale."""
        return (*self.vector("place"), self.scale)

    @cached_property
    def shape(self) -> Facets:  # type: ignore[override]
        """See :class:`Rigid`; SceneError for a curve without length."""
        points = self._points()
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1) if points.ndim == points.shape[-1] == BOTH else []
        if len(steps) < 1 or not np.isfinite(points).all() or not np.min(steps) > 0:
            raise SceneError(f"the curve of a Profile needs two or more distinct points, (n, 2), not {self.curve!r:.80}")
        closed = np.array_equal(points[0], points[-1])
        powers = None
        count = len(steps)
        if self.smooth and count > 1:
            # a formula is a function of its variable, points are one of the length of chords
            knots = np.linspace(*self.between, SAMPLES) if self.between else np.append(0.0, np.cumsum(steps))
            spline = CubicSpline(knots, points, bc_type="periodic" if closed else "not-a-knot")
            powers = spline.c * (np.diff(knots)[:, None] ** np.arange(3, -1, -1)).T[:, :, None]
            places = np.linspace(0.0, count, PARTS * count + 1)
            points = spline(np.interp(places, np.arange(count + 1), knots))
            count *= PARTS
        numbers = np.arange(count + 1) % (count if closed else count + 1)
        return facets_of(points[: numbers.max() + 1], np.column_stack([numbers[:-1], numbers[1:]]), powers)

    def _points(self) -> np.ndarray:
        if not isinstance(self.curve, str):
            if self.between is not None:
                raise SceneError("the points of a Profile have their own ends: leave out between")
            try:
                return np.array(self.curve, dtype=float)
            except (TypeError, ValueError):
                return np.zeros(0)
        formula = formula_of(self.curve, f"the curve of a Profile at surface {self.surface}")
        known = formula.variables in [(name,) for name in "xyrz"] or not formula.variables
        if not known or self.between is None or not self.between[0] < self.between[1]:
            raise SceneError(
                f"the curve {self.curve!r} of a Profile must be a formula of one of x, y, r and z, and its ends "
                "increase, between=(-1, 1)"
            )
        (name,) = formula.variables or ("x",)
        places = np.linspace(*self.between, SAMPLES)
        values = np.broadcast_to(formula({name: places}), SAMPLES)
        return np.column_stack([places, values] if name in "xr" else [values, places])


@dataclass(frozen=True)
class RigidMesh(Rigid):
    """Contact with a rigid surface of triangles, on either side of it.

    Normals are smooth up to edges of 40 degrees.

    Attributes:
        surface: facet tag of the surface of the body.
        mesh: a file that meshio reads, such as STL; or points, (n, 3), and nodes of triangles or quadrilaterals, (f, k).
        place: shift of the mesh, numbers or formulas of the parameters.
        scale: factor of its points before the shift, a number or a formula.
    """

    mesh: Any = ()
    place: tuple[Any, ...] = (0.0, 0.0, 0.0)
    scale: Any = 1.0

    @property
    def sizes(self) -> Sequence[Any]:
        """Place and scale."""
        return (*self.vector("place"), self.scale)

    @cached_property
    def shape(self) -> Facets:  # type: ignore[override]
        """See :class:`Rigid`; SceneError for a mesh without triangles or an unreadable file."""
        given = _read(Path(self.mesh)) if isinstance(self.mesh, str | Path) else self.mesh
        try:
            points, *parts = given
            points = np.array(points, dtype=float)
            facets = np.concatenate([_triangles(np.array(part, dtype=np.int64)) for part in parts])
        except (TypeError, ValueError, IndexError):
            facets = np.zeros((0, 3), dtype=np.int64)
        wrong = not facets.size or points.ndim != BOTH or points.shape[1] != self.dimension
        if wrong or not np.isfinite(points).all() or facets.min() < 0 or facets.max() >= len(points):
            raise SceneError(f"the mesh {self.mesh!r:.80} of a RigidMesh must be a file or (points, facets) with triangles")
        # files of triangles repeat their nodes
        extent = np.ptp(points, axis=0).max() or 1.0
        _, first, names = np.unique(np.round(points / extent, 10), axis=0, return_index=True, return_inverse=True)
        facets = names.ravel()[facets]
        points = points[first]
        sizes = np.linalg.norm(area_vectors(points[facets]), axis=1)
        used, facets = np.unique(facets[sizes > 1e-14 * extent**2], return_inverse=True)
        if not used.size:
            raise SceneError(f"the mesh {self.mesh!r:.80} of a RigidMesh has no triangle with an area")
        return facets_of(points[used], facets.reshape(-1, self.dimension))


def _triangles(facets: np.ndarray) -> np.ndarray:
    if facets.ndim != BOTH or facets.shape[1] not in (3, 4):
        raise ValueError
    return facets if facets.shape[1] == 3 else np.concatenate([facets[:, [0, 1, 2]], facets[:, [0, 2, 3]]])


def _read(path: Path) -> tuple[np.ndarray, ...]:
    """Points, and triangles and quadrilaterals of a file."""
    with extra("mesh", f"the mesh file {path}"):
        import meshio
    if not path.is_file():
        raise SceneError(f"there is no file {path} for a RigidMesh in {Path.cwd()}")
    try:
        mesh = meshio.read(path)
    except (Exception, SystemExit) as error:  # meshio ends the program where it cannot read
        raise SceneError(f"the file {path} of a RigidMesh cannot be read: {type(error).__name__}: {error}") from error
    return (mesh.points, *(block.data for block in mesh.cells if block.type in ("triangle", "quad")))
