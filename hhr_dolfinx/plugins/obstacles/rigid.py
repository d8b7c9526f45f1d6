"""Contact of nodes with a rigid obstacle: the conditions, and their gaps as functions of
parameters.

A node x touches the obstacle along the unit normal n at the closest point, ``u·n <= g``, where x +
g n is on the obstacle. If place and size of the obstacle depend on parameters, n is that in the
middle of the box, and g(mu) is the distance along it, by the exact intersection.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Protocol

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.amplitudes import FINITE, check_formula
from hhr_dolfinx.contact.law import LAW, PairLaw
from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.declared import Floats, KnownArguments
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import (
    IMAGINARY_STEP,
    LONGEST_FORMULA,
    Formula,
    Scalar,
    box_samples,
    formula_of,
)
from hhr_dolfinx.pairings.surface import (
    GRAZING_NORMAL,
    Surface,
    looking,
    nodal_rows,
    tangential_order,
    warn,
    warn_of_overlap,
)
from hhr_dolfinx.parameters import ParameterSpace, Tag, as_tuple, check_tag
from hhr_dolfinx.plain import Rebuilt

if TYPE_CHECKING:
    from hhr_dolfinx.loads import Term

Size = float | str
"""A number, or a formula of the parameters."""
TURN = 10.0
"""Degrees by which the normal at a node near the obstacle may turn over the box without a
warning.
"""
NORMAL_SAMPLES = 32
"""Random points of the box, in addition to its corners, at which normals are compared."""
FAR = 10.0
"""Gap of a node whose normal misses the obstacle, over the extent of the surface: it never
closes.
"""


class RigidShape(Protocol):
    """Geometry of an obstacle of given sizes, (k,): its place, then what else depends on
    parameters.
    """

    def normals(self, sizes: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit normals from points into the obstacle.

        Args:
            sizes: sizes of the obstacle, (k,).
            points: the points, (m, dim).

        Returns:
            Unit normals, (m, dim), and points beyond the end of the obstacle, (m,) bool.
        """

    def along(self, sizes: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Distances along unit normals, (m,), NaN where these miss it.

        Args:
            sizes: sizes of the obstacle, (k,); complex ones carry a derivative.
            points: the points, (m, dim).
            normals: unit normals, (m, dim).
        """

    def sides(self) -> Sequence[RigidShape]:
        """The shape, or both of its orientations if none is given."""


def distances(
    shape: RigidShape, sizes: np.ndarray, points: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Distances along unit normals, (m,), large ones where these miss the obstacle.

    Args:
        shape: the obstacle.
        sizes: its sizes, (k,).
        points: the points, (m, dim).
        normals: unit normals, (m, dim).
    """
    gaps = shape.along(sizes, points, normals)
    return np.where(np.isnan(np.real(gaps)), FAR * np.ptp(points, axis=0).max(initial=0.0), gaps)


@dataclass(frozen=True)
class Distances(Rebuilt):
    """Gaps of m conditions less those in the middle of the box, as a non-affine amplitude of m
    columns.
    """

    shape: Any  #: a RigidShape
    sizes: tuple[str, ...]  #: formulas of the parameters
    names: tuple[str, ...]  #: names of the parameters
    points: Annotated[Floats, "rigid conditions", "rigid dimension"]
    normals: Annotated[Floats, "rigid conditions", "rigid dimension"]
    still: Annotated[Floats, "rigid conditions"]  #: gaps in the middle of the box

    @property
    def count(self) -> int:
        """Number of columns, one for each condition."""
        return len(self.still)

    @cached_property
    def _formulas(self) -> tuple[Formula, ...]:
        return tuple(Scalar(text, self.names).formula for text in self.sizes)

    def _at(self, values: Mapping[str, float] | Mapping[str, complex]) -> np.ndarray:
        sizes = np.array([formula(values) for formula in self._formulas])
        return distances(self.shape, sizes, self.points, self.normals)

    def __call__(self, point: np.ndarray) -> tuple[list[int], list[float]]:
        """Columns and changes of the gaps at a point, (P,)."""
        changes = self._at(dict(zip(self.names, point.tolist(), strict=True))) - self.still
        return list(range(self.count)), changes.tolist()

    def scalars(self) -> tuple[Scalar, ...] | None:
        """Formulas of the columns, for programs that evaluate formulas alone.

        None without a closed form.
        """
        written = getattr(self.shape, "written", None)
        if written is None:
            return None
        far = FAR * np.ptp(self.points, axis=0).max(initial=0.0)
        rows = zip(self.points, self.normals, self.still, strict=True)
        texts = [
            f"{written(self.sizes, point, normal, far)}-({float(gap)!r})"
            for point, normal, gap in rows
        ]
        too_long = max(map(len, texts), default=0) > LONGEST_FORMULA
        return None if too_long else tuple(Scalar(text, self.names) for text in texts)

    def derivative(self, point: np.ndarray) -> np.ndarray:
        """Derivatives of the gaps along the parameters, exact to round-off, (m, P)."""
        values = dict(zip(self.names, map(complex, point), strict=True))
        columns = [
            self._at(values | {name: values[name] + 1j * IMAGINARY_STEP}) for name in self.names
        ]
        return np.stack([np.imag(column) / IMAGINARY_STEP for column in columns], axis=1)


@dataclass(frozen=True)
class Rigid(KnownArguments):
    """Base of the pairings with a rigid obstacle.

    ``friction`` and ``law`` are those of :class:`~hhr_dolfinx.pairings.obstacle.Obstacle`; the
    scene sets ``box``.
    """

    surface: Tag
    friction: PairLaw | str | float | None = field(default=None, metadata=LAW, kw_only=True)
    law: PairLaw | None = field(default=None, metadata=LAW, kw_only=True)
    box: ParameterSpace | None = field(default=None, kw_only=True, repr=False)

    dimension: ClassVar[int] = 3
    limits: ClassVar[tuple[float, float]] = (0.0, np.inf)  #: open interval of the last of the sizes

    def __post_init__(self) -> None:
        check_tag(f"surface of {type(self).__name__}", self.surface)
        # faults are reported where the obstacle is written
        self._shape, self._formulas  # noqa: B018

    @property
    def _shape(self) -> RigidShape:
        raise NotImplementedError

    @property
    def _sizes(self) -> tuple[Size, ...]:
        """Numbers or formulas of the place, (dim,), and the other sizes of the shape."""
        raise NotImplementedError

    @property
    def _rate(self) -> float:
        """Change of every gap by the last of the sizes; 0 if it differs from node to node."""
        return 0.0

    @property
    def tags(self) -> tuple[Tag, ...]:
        """The surface of the body."""
        return (self.surface,)

    @cached_property
    def _formulas(self) -> tuple[Formula, ...]:
        return tuple(formula_of(size, f"a size of {self!r}") for size in self._sizes)

    def _vector(self, name: str) -> tuple[Size, ...]:
        """A field that is a vector of numbers or formulas."""
        components = as_tuple(f"{name} of a {type(self).__name__}", getattr(self, name))
        if len(components) != self.dimension or (
            name == "axis" and all(component == 0 for component in components)
        ):
            description = f"{name} = {components} of a {type(self).__name__}"
            raise SceneError(
                f"{description} must have {self.dimension} components, and an axis a length"
            )
        return components

    @property
    def _varies(self) -> bool:
        return any(formula.variables for formula in self._formulas)

    def within(self, parameters: ParameterSpace) -> Rigid:
        """The obstacle for a box; SceneError for unknown parameters, and for sizes out of their
        limits in the box.
        """
        for formula in self._formulas[:-1]:
            check_formula(formula.text, parameters, f"a size of {self!r}", remedy=FINITE)
        low, high = self.limits
        remedy = f"it must be in ({low:g}, {high:g}). Change it, or narrow the box"
        check_formula(
            self._formulas[-1].text, parameters, f"the size of {self!r}", self.limits, remedy
        )
        return replace(self, box=parameters)

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """One row u·n <= g for each node that looks at the obstacle, with g in the middle of the
        box.

        Args:
            surfaces: the surface of the body.
            dofs: number of dofs.

        Raises:
            SceneError: if the surface does not look at the obstacle.
        """
        (surface,) = surfaces
        shape, rows, normals, lost = self._conditions(surface, dofs)
        if lost.any():
            warn(
                f"{int(lost.sum())} of {lost.size} nodes of surface {surface.tag} lie beyond the "
                f"end of the {type(self).__name__} and get no contact condition, e.g. at "
                f"{surface.points[lost][0].tolist()}"
            )
            self._warn_of_ends(shape, surface.points[lost])
        warn_of_overlap(surface, rows)
        self._warn_of_turns(shape, surface, rows, normals)
        return surface.averaged(rows)

    def gap_terms(self, surfaces: Sequence[Surface], rows: ContactRows) -> list[Term]:
        """Changes of the gaps of the rows over the box; none if no size depends on parameters.

        Args:
            surfaces: the surface of the body.
            rows: its conditions.
        """
        if not self._varies or self.box is None:
            return []
        from hhr_dolfinx.loads import Term  # a model file has these classes and needs no forms

        shape, nodal, normals, _ = self._conditions(surfaces[0], rows.matrix.shape[1])
        # rows are means of those of nodes, whose normals have length 1
        means = csc_matrix(rows.matrix @ nodal.matrix.T)
        if self._rate and not any(formula.variables for formula in self._formulas[:-1]):
            text = self._formulas[-1].text
            middle = Scalar(text, self.box.names).value(self.box.middle)
            return [
                Term(Formula(f"({text}) - {middle!r}"), csc_matrix(self._rate * means.sum(axis=1)))
            ]
        sizes = tuple(formula.text for formula in self._formulas)
        return [
            Term(Distances(shape, sizes, self.box.names, nodal.points, normals, nodal.gap), means)
        ]

    def _at(self, point: np.ndarray | None) -> np.ndarray:
        """Sizes at a point, (P,); None for those of an obstacle without parameters."""
        values = (
            {}
            if point is None or self.box is None
            else dict(zip(self.box.names, point.tolist(), strict=True))
        )
        if self._varies and not values:
            raise SceneError(f"{self!r} names parameters: list it in the contacts of a scene")
        return np.array([float(formula(values)) for formula in self._formulas])

    def _conditions(
        self, surface: Surface, dofs: int
    ) -> tuple[RigidShape, ContactRows, np.ndarray, np.ndarray]:
        """Oriented shape, rows of nodes and their normals, (m, dim).

        Nodes that look beyond its end, a mask (n,).
        """
        dim = surface.points.shape[1]
        if dim != self.dimension:
            raise SceneError(
                f"a {type(self).__name__} is an obstacle in {self.dimension} dimensions, the mesh "
                f"has {dim}"
            )
        sizes = self._at(None if self.box is None else self.box.middle)
        sides = []
        for shape in self._shape.sides():
            normals, beyond = shape.normals(sizes, surface.points)
            looks, areas = looking(surface, normals, GRAZING_NORMAL)
            gaps = distances(shape, sizes, surface.points, normals)
            nodes = np.flatnonzero(looks & ~beyond)
            # of both sides of an obstacle the body is on that which is nearer to what looks at it
            distance = np.abs(gaps[nodes]).mean() if nodes.size else np.inf
            sides.append((distance, shape, nodes, normals, gaps, areas, looks & beyond))
        _, shape, nodes, normals, gaps, areas, lost = min(sides, key=lambda one: one[0])
        if not nodes.size:
            raise SceneError(
                f"surface {surface.tag} around {surface.points.mean(axis=0).tolist()} does not "
                f"look at the obstacle {self!r:.200}, or lies beyond its end: correct its place, "
                "or inside=True for a body inside of it"
            )
        nodes = nodes[tangential_order(surface.points[nodes], np.zeros(dim))]
        numbers = surface.nodes[nodes]
        matrix = nodal_rows(numbers[:, None], normals[nodes], np.ones((nodes.size, 1)), dofs)
        rows = ContactRows(matrix, gaps[nodes], numbers, surface.points[nodes], areas[nodes])
        return shape, rows, normals[nodes], lost

    def _warn_of_ends(self, shape: RigidShape, lost: np.ndarray) -> None:
        """Warn of nodes beyond the end, (n, dim), that the obstacle moves to elsewhere in the
        box.
        """
        met = np.zeros(len(lost), dtype=bool)
        for point in (
            box_samples(self.box, NORMAL_SAMPLES) if self._varies and self.box is not None else ()
        ):
            met |= ~shape.normals(self._at(point), lost)[1]
        if met.any():
            warn(
                f"{int(met.sum())} of these nodes lie before {self!r} elsewhere in the box, e.g. "
                f"at {lost[met][0].tolist()}: they have no condition there either, and penetrate "
                "it. Narrow the box"
            )

    def _warn_of_turns(
        self, shape: RigidShape, surface: Surface, rows: ContactRows, normals: np.ndarray
    ) -> None:
        """Warn if the normal of a node closer than a cell turns over the box."""
        sizes = surface.cell_sizes()[np.searchsorted(surface.nodes, rows.slaves)]
        worst = np.ones(len(sizes))  # smallest cosine of each node
        for point in (
            box_samples(self.box, NORMAL_SAMPLES) if self._varies and self.box is not None else ()
        ):
            sizes_at_point = self._at(point)
            now, beyond = shape.normals(sizes_at_point, rows.points)
            near = (distances(shape, sizes_at_point, rows.points, normals) < sizes) & ~beyond
            worst = np.where(near, np.minimum(worst, np.einsum("md,md->m", now, normals)), worst)
        angle = np.rad2deg(np.arccos(np.clip(worst.min(), -1.0, 1.0)))
        if angle > TURN:
            warn(
                f"the normal of {self!r} at {rows.points[worst.argmin()].tolist()} turns by up to "
                f"{angle:.0f} degrees over the box: gaps and forces are along that of its middle. "
                "Narrow the box"
            )
