"""Error against run time of all methods of a study, as a picture."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

from hhr_dolfinx.compat import extra

with extra("pictures", "pictures of a study"):
    from matplotlib.figure import Figure

ROUND_OFF = 1e-10
"""Errors below are exact for whoever reads a picture: they stand on a line below all others."""
SHOWN = {"primal_l2": "displacement", "dual_full_floored": "contact forces on the whole surface"}
"""Errors that are drawn, and what they are of."""


class _Point(NamedTuple):
    """A method: seconds of a query, median, 95 % and worst error, and what it is called."""

    seconds: float
    median: float
    p95: float
    worst: float
    method: str
    setting: str

    @property
    def exact(self) -> bool:
        """Whether it is right to round-off."""
        return self.median < ROUND_OFF


def plot_work_precision(rows: list[dict[str, Any]], path: Path) -> None:
    """Error against run time of every method by name and setting: median, 95 % and worst, with the Pareto front.

    What is exact to round-off stands on a line at the bottom.
    """
    figure = Figure(figsize=(13, 5.2), layout="constrained")
    for axis, (error, label) in zip(figure.subplots(1, 2), SHOWN.items(), strict=True):
        axis.set(xscale="log", yscale="log", xlabel="time per query [us]", ylabel=f"relative error, {label}")
        axis.margins(x=0.2, y=0.12)
        axis.grid(alpha=0.25)
        points = [_point(row, error) for row in rows if "online_s" in row]
        measured = [point for point in points if not point.exact and math.isfinite(point.median)]
        floor = min((point.median for point in measured), default=1e-6) / 30
        _draw(axis, points, floor)
        front = _front([(point.seconds * 1e6, point.median) for point in measured])
        if len(front) > 1:
            axis.plot(*zip(*front, strict=True), "-", color="black", linewidth=0.8, zorder=0)
        if any(point.exact for point in points):
            axis.axhline(floor, color="grey", linestyle="--", linewidth=0.8, zorder=0)
    figure.suptitle("points: median of the test points; bars: up to 95 % and the worst seen (ticks); "
                    "on the dashed line: exact to round-off", fontsize=9)  # fmt: skip
    figure.savefig(path, dpi=150)


def _point(row: dict[str, Any], error: str) -> _Point:
    """A row of a report as it is drawn; where only the median is known bars have no length."""
    median = float(row[error])
    p95, worst = (float(row.get(f"{error}_{part}", median)) for part in ("p95", "max"))
    return _Point(row["online_s"], median, p95, worst, str(row["method"]), str(row.get("setting", "")))


def _draw(axis: Any, points: list[_Point], floor: float) -> None:
    """All points, with names beside them that do not lie on each other."""
    colours = {method: f"C{k % 10}" for k, method in enumerate(dict.fromkeys(point.method for point in points))}
    for k, point in enumerate(sorted(points, key=lambda point: point.seconds)):
        x, y, colour = point.seconds * 1e6, max(point.median, floor), colours[point.method]
        if point.exact:
            y = floor
        if not math.isfinite(y):
            continue
        ends = [value for value in (point.p95, point.worst) if math.isfinite(value) and value > y]
        if ends:
            axis.plot([x, x], [y, max(ends)], "-", color=colour, linewidth=1)
            axis.plot([x] * len(ends), ends, "_", color=colour, markersize=9)
        axis.plot([x], [y], "o", color=colour)
        name = point.method if point.exact or not point.setting else f"{point.method}: {point.setting}"
        place = {"xytext": (7, 7 if k % 2 else -13), "textcoords": "offset points"}
        axis.annotate(name, (x, y), fontsize=8, color=colour, **place)


def _front(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Points that no other one beats in time and error."""
    found: list[tuple[float, float]] = []
    for point in sorted(points):
        if not found or point[1] < found[-1][1]:
            found.append(point)
    return found
