"""Gaskets as a user gives them to a pair."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.parameters import is_number
from hhr_dolfinx.plugins.contact_laws.curve_pairs import CurvePair, points_of_table, straight
from hhr_dolfinx.plugins.gaskets.behaviour import GasketCurve
from hhr_dolfinx.plugins.gaskets.laws import GasketLayers

SETS_ROUND_OFF = 1e-12
"""Slope by which sets may fall: a way back along the way there leaves zero but for round-off."""


@dataclass(frozen=True)
class GasketLayer(CurvePair):
    """A gasket between the surfaces of a pair, which is not meshed: it loads along one curve,
    unloads along another one, and keeps a set.

    The closure c counts from the touched gasket: c = thickness - initial_gap - gap of the surfaces.

    Attributes:
        loading: (closure, pressure) of each point, from (0, 0) on, straight between them; beyond
            the last as the last segment. The gasket yields at the second point.
        unloading: (largest closure, set) of each point: the closure at which the pressure is gone
            after that largest one, straight between them from (yield, 0) on. The way there is
            straight, and closing again goes the same way. Without it this way has the slope of the
            first segment.
        thickness: of the gasket where the mesh has none; a number.
        initial_gap: between the surfaces and the gasket; a number.
        scale: factor of the pressures; a formula of parameters may stand for it.

    Example:
        >>> seal = hhr.GasketLayer(loading=[(0, 0), (0.1, 20), (0.4, 30)], thickness=1.5)
        >>> seal.words
        'gasket of 3 points, yields at 20'
    """

    plugin: ClassVar[str] = "gaskets"
    noun: ClassVar[str] = "a gasket"
    conditions: ClassVar[Callable[..., GasketLayers]] = GasketLayers

    loading: Sequence[tuple[float, float]]
    unloading: Sequence[tuple[float, float]] | None = None
    thickness: float = 0.0
    initial_gap: float = 0.0
    scale: float | str = 1.0

    def __post_init__(self) -> None:
        self.check_constant()
        for name in ("thickness", "initial_gap"):
            if not is_number(value := getattr(self, name)) or value < 0:
                raise SceneError(
                    f"the {name} {value!r} of a gasket must be a number that is not negative"
                )
        for name in ("loading", "unloading"):  # equal and hashable, as arrays and lists are not
            if (table := getattr(self, name)) is not None:
                try:
                    object.__setattr__(self, name, tuple(map(tuple, table)))
                except TypeError:
                    raise SceneError(
                        f"the {name} of a gasket needs points of two numbers"
                    ) from None
        self._points()

    @property
    def constant(self) -> float | str:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.curve_pairs.CurvePair`."""
        return self.scale

    @property
    def words(self) -> str:
        """See :class:`~hhr_dolfinx.contact.law.PairLaw`."""
        times = "" if self.scale == 1.0 else f" times {self.scale}"
        return f"gasket of {len(self.loading)} points{times}, yields at {self.loading[1][1]:g}"

    def _points(self) -> np.ndarray:
        """Closures, pressures and sets of all points, (n, 3)."""
        loading = points_of_table(self.loading, "the loading of a gasket", "closure")
        closures, pressures = loading.T
        if closures[0] != 0:
            raise SceneError(
                f"the loading of a gasket begins at the closure {closures[0]:g}, and the first "
                "must be 0, where the gasket is touched: thickness and initial_gap say where"
            )
        if not pressures[1] > 0:
            raise SceneError("a gasket needs a pressure at its second point, where it yields")
        sets = self._sets(closures, pressures)
        places = np.union1d(closures, sets[:, 0])
        curves = [straight(places, *points.T)[0] for points in (loading, sets)]
        return np.column_stack([places, *curves])

    def _sets(self, closures: np.ndarray, pressures: np.ndarray) -> np.ndarray:
        """Largest closures and the sets that they leave, (n, 2).

        Raises:
            SceneError: for sets that fall, or that are not below their largest closures.
        """
        if self.unloading is not None:
            sets = self._way_back(closures[1])
            what = "sets in the unloading of a gasket"
        else:
            sets = np.column_stack([closures, closures - pressures * closures[1] / pressures[1]])
            sets[1] = closures[1], 0.0
            what = (
                "a gasket that stiffens beyond its first segment needs unloading: sets by the "
                "slope of that segment"
            )
        rises = np.diff(sets[:, 1]) / np.diff(sets[:, 0])
        if (rises < -SETS_ROUND_OFF).any() or (sets[1:, 1] >= sets[1:, 0]).any():
            raise SceneError(f"{what} must not fall, and stay below their largest closures")
        # beyond the last point a set does not catch up with its closure
        return sets if rises[-1] <= 1 else np.vstack([sets, sets[-1] + sets[-1, 0]])

    def _way_back(self, yields: float) -> np.ndarray:
        """Points of the unloading, (n, 2), from that where the gasket yields on.

        Raises:
            SceneError: for largest closures that do not grow.
        """
        try:
            points = np.array([(0.0, 0.0), (yields, 0.0), *(self.unloading or ())], dtype=float)
        except (TypeError, ValueError):
            points = np.zeros(0)
        if points.ndim != 2 or points.shape[1:] != (2,) or not np.isfinite(points).all():
            raise SceneError("the unloading of a gasket needs points (largest closure, set)")
        if (np.diff(points[:, 0]) <= 0).any():
            raise SceneError(
                f"largest closures in the unloading of a gasket must grow, from {yields:g} on, "
                "where it yields"
            )
        return points

    def curve_of(self, factor: Scalar) -> GasketCurve:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.curve_pairs.CurvePair`."""
        closures, pressures, sets = self._points().T
        begins = float(self.thickness - self.initial_gap)
        return GasketCurve(factor, begins, closures.copy(), pressures.copy(), sets.copy())
