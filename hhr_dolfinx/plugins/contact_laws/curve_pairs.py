"""Pairs whose pressure is a curve of how far they have closed, as laws of plug-ins have it.

The overclosure h is positive where surfaces overlap, negative across a gap. A curve acts from h =
-reach on; its argument, the closure d = h + reach, is not negative there. Each is a factor, which
may depend on parameters, times a shape, which does not.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, ClassVar, Generic, Self, TypeVar, cast

import numpy as np

from hhr_dolfinx.contact.law import ContactLaw, MeshArrays, PairLaw
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Scalar, check_over_box, formula_of
from hhr_dolfinx.parameters import is_number
from hhr_dolfinx.plugins.contact_laws.interface import check_areas
from hhr_dolfinx.plugins.contact_laws.ranges import CurveStep

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

    from hhr_dolfinx.contact.rows import ContactRows
    from hhr_dolfinx.parameters import ParameterSpace
    from hhr_dolfinx.scene import Scene


class PressureCurve(ABC):
    """A monotone curve of the pressure."""

    factor: Scalar  #: of the shape

    @property
    @abstractmethod
    def reach(self) -> float:
        """Gap at which the pressure begins; negative if surfaces overlap freely at first."""

    @abstractmethod
    def parts(self) -> list[str | np.ndarray]:
        """Texts and arrays on which pressures depend, for a fingerprint."""


CurveOfPair = TypeVar("CurveOfPair", bound=PressureCurve)


class CurveConditions(ContactLaw):
    """Curves of the conditions, (m,), of which no parameter is ``fixed``.

    A law derives a frozen dataclass and adds its ``curves``.
    """

    floats: ClassVar[bool] = True
    fixed: ClassVar[np.ndarray] = np.zeros(0, dtype=np.int64)  # type: ignore[misc]

    area: Annotated[Floats, "m"]
    number: Annotated[Integers, "m"]  #: index of the curve of each condition
    curves: tuple[PressureCurve, ...]

    def within(self, conditions: np.ndarray) -> Self:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        changed: Self = replace(  # type: ignore[type-var]
            self, area=self.area[conditions], number=self.number[conditions]
        )
        return changed

    @property
    def reach(self) -> np.ndarray:
        """Gap at which the pressure of each condition begins, (m,)."""
        return np.array([curve.reach for curve in self.curves])[self.number]

    def parts(self) -> list[str | np.ndarray]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        parts: list[str | np.ndarray] = [self.area, self.number]
        for curve in self.curves:
            parts += [*curve.parts(), curve.factor.text]
        return parts


class CurvesStep(CurveStep, ABC, Generic[CurveOfPair]):
    """Curves of some conditions at a point, (P,)."""

    def __init__(self, law: CurveConditions, point: np.ndarray):
        self.shift = -law.reach
        self._law = law
        self._point = point
        self._curves = cast("tuple[CurveOfPair, ...]", law.curves)
        self._rows = [np.flatnonzero(law.number == k) for k in range(len(law.curves))]

    @abstractmethod
    def shape(
        self, curve: CurveOfPair, rows: np.ndarray, closure: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Pressures of some rows over the factor, and their derivatives, (k,) each.

        Args:
            curve: their curve.
            rows: their numbers, (k,).
            closure: closures, not negative, (k,).
        """

    def curve(self, closure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.CurveStep`."""
        force = np.empty_like(closure)
        slope = np.empty_like(closure)
        for curve, rows in zip(self._curves, self._rows, strict=True):
            factor = self._law.area[rows] * curve.factor.value(self._point)
            pressure, rise = self.shape(curve, rows, closure[rows])
            force[rows] = factor * pressure
            slope[rows] = factor * rise
        return force, slope

    def curve_slopes(self, closure: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.CurveStep`."""
        slopes = np.zeros((closure.size, self._point.size))
        for curve, rows in zip(self._curves, self._rows, strict=True):
            pressure, _ = self.shape(curve, rows, closure[rows])
            along = curve.factor.derivative(self._point)
            slopes[rows] = np.outer(self._law.area[rows] * pressure, along)
        return slopes


class CurvePair(PairLaw):
    """Base of a law that gives each pair a curve."""

    #: makes the law on all conditions of their areas, (m,), numbers of curves, (m,), and curves
    conditions: ClassVar[Callable[..., CurveConditions]]
    noun: ClassVar[str]  #: of the law in messages, as "soft contact"

    @property
    @abstractmethod
    def constant(self) -> float | str:
        """Factor of the pressures, which may be a formula."""

    @abstractmethod
    def curve_of(self, factor: Scalar) -> PressureCurve:
        """The curve with its factor."""

    @property
    def texts(self) -> tuple[str, ...]:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`."""
        return (self.constant,) if isinstance(self.constant, str) else ()

    def check_constant(self) -> None:
        """Raise SceneError for a number that is not positive."""
        if is_number(self.constant) and self.constant <= 0:
            raise SceneError(f"{self._positive} in place of {self.constant!r}")

    @property
    def _positive(self) -> str:
        return f"the pressure of {self.noun} must grow: give a positive number"

    def curve(self, space: ParameterSpace, what: str) -> PressureCurve:
        """The curve over a box.

        Args:
            space: the parameters.
            what: description of the contact for the message.

        Raises:
            SceneError: for a constant that is not positive all over the box.
        """
        named = f"{self.noun} of {what}"
        factor = Scalar(formula_of(self.constant, named).text, space.names)
        check_over_box(factor, space, named, 0.0, np.inf, self._positive)
        return self.curve_of(factor)

    def check(self, scene: Scene, what: str) -> None:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`.

        Args:
            scene: the scene.
            what: description of the contact for the message.
        """
        self.curve(scene.parameters, what)

    @classmethod
    def attached(
        cls,
        laws: Mapping[int, Self],
        scene: Scene,
        rows: ContactRows,
        pairs: np.ndarray,
        free: np.ndarray,
        lifts: csc_matrix,
        mesh: MeshArrays,
    ) -> tuple[ContactRows, np.ndarray, CurveConditions]:
        """No further rows, see :class:`~hhr_dolfinx.contact.law.PairLaw`.

        Args:
            laws: laws by pair.
            scene: scene of the contacts.
            rows: conditions of the pressures.
            pairs: contact pair of each of them, (m,).
            free, lifts, mesh: not read.
        """
        check_areas(scene, laws)
        places = list(laws)
        number = np.array([places.index(k) if k in laws else 0 for k in pairs], dtype=np.int64)
        curves = tuple(law.curve(scene.parameters, f"contact {k}") for k, law in laws.items())
        return rows, pairs, cls.conditions(rows.areas, number, curves)


def points_of_table(table: Sequence[tuple[float, float]] | None, noun: str, way: str) -> np.ndarray:
    """Points of a curve of the pressure, (n, 2).

    Args:
        table: abscissa and pressure of each point; the first pressure is 0.
        noun: name of the table, for messages.
        way: name of its abscissas, for messages.

    Raises:
        SceneError: unless abscissas grow, and pressures from zero do not fall.
    """
    try:
        points = np.array(table, dtype=float)
    except (TypeError, ValueError):
        points = np.zeros(0)
    if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 2:
        raise SceneError(f"{noun} needs two points ({way}, pressure)")
    if not np.isfinite(points).all() or (np.diff(points[:, 0]) <= 0).any():
        raise SceneError(f"{way}s in {noun} must be finite and grow")
    if points[0, 1] != 0:
        raise SceneError(
            f"{noun} begins with the pressure {points[0, 1]:g}, and the first must be 0, where "
            "the pressure begins"
        )
    if (np.diff(points[:, 1]) < 0).any():
        raise SceneError(
            f"the pressure in {noun} falls: contact that softens may have several answers, and is "
            "not built in"
        )
    if points[-1, 1] <= 0:
        raise SceneError(f"{noun} has no pressure")
    return points


def straight(
    x: np.ndarray, points: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Values between points, beyond the last as the last segment, and their derivatives, (k,) each.

    Args:
        x: abscissas, not below the first point, (k,).
        points: abscissas of the points, growing, (n,).
        values: their values, (n,).
    """
    rises = np.diff(values) / np.diff(points)
    segment = np.clip(np.searchsorted(points, x, side="right") - 1, 0, len(rises) - 1)
    return values[segment] + rises[segment] * (x - points[segment]), rises[segment]
