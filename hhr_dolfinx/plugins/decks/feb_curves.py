"""Numbers of a file of FEBio at the end of its computation, with their load curves.

Curves follow ``FECore/PointCurve.cpp`` of FEBio 4: a time on the first or the last point has the
value of that point, and others are between two points or outside of all. Other controllers, such as
formulas and PID, are not read.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

from hhr_dolfinx.plugins.decks.feb_items import Item

_SAME = 1e-7
"""Part of the end within which FEBio takes two times as one."""
_LONGEST = 1e6
"""Most repetitions of a curve."""


@dataclass(frozen=True)
class Curve:
    """A load curve: its points with increasing times, and what it does between and outside of
    them.
    """

    times: tuple[float, ...]
    values: tuple[float, ...]
    interpolate: str = "LINEAR"
    extend: str = "CONSTANT"

    def at(self, time: float) -> float | None:
        """Value at a time; None for an interpolation that is not read, and on a jump."""
        t = self.times
        f = self.values
        if len(t) == 1:
            return f[0]
        for k in (0, -1):
            if abs(time - t[k]) <= _SAME * abs(time):
                return f[k]
        if not t[0] < time < t[-1]:
            return self._outside(time)
        if self.interpolate == "STEP" and any(
            abs(time - corner) <= _SAME * abs(time) for corner in t
        ):
            return None
        k = bisect_right(t, time)
        if self.interpolate == "STEP":
            return f[k]
        fraction = (time - t[k - 1]) / (t[k] - t[k - 1])
        if self.interpolate == "SMOOTH STEP":
            fraction = fraction**3 * (10.0 - 15.0 * fraction + 6.0 * fraction**2)
        elif self.interpolate in ("SMOOTH", "C2-SMOOTH") and len(t) > 2:
            parabolas = [
                self._parabola(first, time) for first in (k - 2, k - 1) if 0 <= first <= len(t) - 3
            ]
            return parabolas[0] + fraction * (parabolas[-1] - parabolas[0])
        elif self.interpolate not in ("LINEAR", "SMOOTH", "C2-SMOOTH"):
            return None
        return f[k - 1] + fraction * (f[k] - f[k - 1])

    def _parabola(self, first: int, time: float) -> float:
        """Value of the parabola through three points."""
        t = self.times[first : first + 3]
        value = 0.0
        for k in range(3):
            a, b = (t[j] for j in range(3) if j != k)
            value += self.values[first + k] * (time - a) * (time - b) / ((t[k] - a) * (t[k] - b))
        return value

    def _outside(self, time: float) -> float | None:
        """Value before the first or after the last point."""
        t = self.times
        f = self.values
        before = time < t[0]
        end = 0 if before else -1
        period = t[-1] - t[0]
        if self.extend == "CONSTANT" or (
            self.extend == "EXTRAPOLATE" and self.interpolate in ("STEP", "SMOOTH STEP")
        ):
            return f[end]
        if self.extend == "EXTRAPOLATE":
            # FEBio takes the slope of smooth curves from a thousandth of their length
            step = t[1] - t[0] if self.interpolate == "LINEAR" else 1e-3 * period
            if self.interpolate == "LINEAR" and not before:
                step = t[-1] - t[-2]
            inner = self.at(t[0] + step if before else t[-1] - step)
            slope = None if inner is None else (f[end] - inner) / (-step if before else step)
            return None if slope is None else f[end] + slope * (time - t[end])
        if self.extend in ("REPEAT", "REPEAT OFFSET") and abs(time - t[end]) < _LONGEST * period:
            turns = (
                math.floor((time - t[0]) / period)
                if before
                else math.ceil((time - t[-1]) / period - _SAME)
            )
            value = self.at(time - turns * period)
            offset = turns * (f[-1] - f[0]) if self.extend == "REPEAT OFFSET" else 0.0
            return None if value is None else value + offset
        return None


@dataclass(frozen=True)
class FebNumbers:
    """Numbers of a file at the end of its last step."""

    root: Item

    @cached_property
    def end(self) -> float | None:
        """Time of the end, that of all steps; None if the file does not state it.

        The first step takes over what the file states outside of all steps
        (``FEBioXML/FEModelBuilder.cpp``).
        """
        steps = [
            step
            for section in self.root.items
            if section.tag == "Step"
            for step in section.items
            if step.tag == "step"
        ]
        common = self.root.child("Control")
        total = 0.0
        for controls in [[common]] if not steps else [[step.child("Control")] for step in steps]:
            controls += [common] if steps and not total else []
            count, size = (_first(controls, tag) for tag in ("time_steps", "step_size"))
            if count is None or size is None:
                return None
            total += count * size
        return total

    @cached_property
    def uses_curves(self) -> bool:
        """True if a number has a load curve."""
        return any(_has_curve(section) for section in self.root.items)

    @cached_property
    def _controllers(self) -> dict[str, Item]:
        data = [
            controller
            for section in self.root.items
            if section.tag == "LoadData"
            for controller in section.items
        ]
        return {controller.attributes.get("id", ""): controller for controller in data}

    def of(self, item: Item | None, tag: str) -> float | None:
        """Number of a child at the end.

        Args:
            item: parent of the child; None for none.
            tag: tag of the child.

        Returns:
            The number; None if it is missing, is a formula, or has a controller that is not read.
        """
        child = item.child(tag) if item is not None else None
        number = item.number(tag) if item is not None else None
        if child is None or number is None or "lc" not in child.attributes:
            return number
        factor = self._factor(child.attributes["lc"])
        return number * factor if isinstance(factor, float) else None

    def why_not(self, item: Item) -> str:
        """Reason why the number of an item is not read; empty if nothing prevents it."""
        factor = self._factor(item.attributes["lc"]) if "lc" in item.attributes else 1.0
        return factor if isinstance(factor, str) else ""

    def _factor(self, number: str) -> float | str:
        """Value of a controller at the end, or the reason why it is not read."""
        controller = self._controllers.get(number)
        if controller is None:
            return (
                f"the file has no load_controller {number}: give the number at the end of the "
                "computation"
            )
        kind = controller.attributes.get("type", "loadcurve")
        if kind != "loadcurve":
            return (
                f"load_controller {number} is of type {kind}, which is not read: give the number "
                "at the end"
            )
        curve = _curve(controller)
        if curve is None:
            return (
                f"the points of load_controller {number} are not read: give the number at the end"
            )
        value = curve.values[-1] if self.end is None else curve.at(self.end)
        if value is None:
            words = f"interpolate {curve.interpolate}, extend {curve.extend}"
            return (
                f"load_controller {number}, {words}, is not read at {self.end:g}: give the number "
                "there"
            )
        return float(value)


def _first(items: Sequence[Item | None], tag: str) -> float | None:
    """Number of the first item that has a child."""
    return next(
        (
            parent.number(tag)
            for parent in items
            if parent is not None and parent.child(tag) is not None
        ),
        None,
    )


def _has_curve(item: Item) -> bool:
    return "lc" in item.attributes or any(_has_curve(child) for child in item.items)


def _curve(item: Item) -> Curve | None:
    """Curve of a controller; None for points that are no numbers, or whose times do not
    increase.
    """
    points = item.child("points")
    words = {
        tag: child.text.strip().upper()
        for tag in ("interpolate", "extend")
        if (child := item.child(tag))
    }
    try:
        rows = (
            [tuple(map(float, point.text.split(","))) for point in points.items]
            if points is not None
            else []
        )
    except ValueError:
        return None
    if not rows or any(len(row) != 2 for row in rows) or not _increases([row[0] for row in rows]):
        return None
    times, values = zip(*rows, strict=True)
    return Curve(times, values, **words)


def _increases(times: Sequence[float]) -> bool:
    return all(earlier < later for earlier, later in pairwise(times))
