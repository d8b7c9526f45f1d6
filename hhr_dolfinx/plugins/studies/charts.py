"""Charts of a report as SVG inside the page: they use its colours, stay sharp, print, and need no
network.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np

CHART_WIDTH = 640
HEIGHT = 360
"""Sizes of a chart, in units of the SVG."""
LEFT_MARGIN = 64
RIGHT_MARGIN = 16
TOP = 14
BOTTOM = 46
"""Its margins."""
END = CHART_WIDTH - RIGHT_MARGIN
FLOOR = HEIGHT - BOTTOM
"""Ends of its axes, which begin at ``LEFT_MARGIN`` and ``TOP``."""
LEAST_DRAWN = 1e-16
MOST_DRAWN = 1e16
"""Limits at which values below and above are drawn: zero has no logarithm, and such numbers occur
in no report.
"""
BINS = 24
SHADES = 6
"""Bins of a histogram; steps of colour of a map."""


class Mark(NamedTuple):
    """A method: seconds of a query, its errors at half of the points, at 95 %, at most.

    ``own`` is that of the report.

    NaN and infinity are unknown.
    """

    name: str
    seconds: float
    error: float
    high: float = math.nan
    worst: float = math.nan
    own: bool = False

    @property
    def tail(self) -> tuple[float, float]:
        """Errors of the tick and of the end of its tail."""
        tick = max(self.error, self.high) if math.isfinite(self.high) else self.error
        return tick, max(tick, self.worst) if math.isfinite(self.worst) else tick


class _Axis:
    """A logarithmic axis from ``low`` to ``high``, drawn from ``begin`` to ``end``."""

    def __init__(self, values: Sequence[float], begin: float, end: float):
        logs = [math.log10(min(max(value, LEAST_DRAWN), MOST_DRAWN)) for value in values]
        self.low = math.floor(min(logs) - 0.05)
        self.high = max(math.ceil(max(logs) + 0.05), self.low + 1)
        self.begin = begin
        self.end = end

    def __call__(self, value: float) -> float:
        share = (math.log10(min(max(value, LEAST_DRAWN), MOST_DRAWN)) - self.low) / (
            self.high - self.low
        )
        return self.begin + share * (self.end - self.begin)


def _frame(across: str, up: str, content: Sequence[str], title: str) -> str:
    """A chart with the names of its axes."""
    return (
        f'<svg viewBox="0 0 {CHART_WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}">'
        f'<path class="axis" d="M{LEFT_MARGIN} {TOP}V{FLOOR}H{END}"/>'
        + "".join(content)
        + _text((LEFT_MARGIN + END) / 2, HEIGHT - 8, "middle", escape(across))
        + f'<text transform="translate(14 {(TOP + FLOOR) / 2:.0f}) rotate(-90)" '
        f'text-anchor="middle">{escape(up)}</text></svg>'
    )


def _text(x: float, y: float, anchor: str, content: str | float) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{content}</text>'


def _ticks(axis: _Axis, up: bool = False) -> list[str]:
    """Lines and numbers at the powers of ten."""
    elements = []
    for k in range(axis.low, axis.high + 1, max(1, math.ceil((axis.high - axis.low) / 9))):
        position = axis(10.0**k)
        power = f'10<tspan dy="-5" font-size="9">{k}</tspan>'
        line = f"M{LEFT_MARGIN} {position:.1f}H{END}" if up else f"M{position:.1f} {TOP}V{FLOOR}"
        number = (
            _text(LEFT_MARGIN - 6, position + 4, "end", power)
            if up
            else _text(position, FLOOR + 17, "middle", power)
        )
        elements.append(f'<path class="grid" d="{line}"/>{number}')
    return elements


def front(marks: Sequence[Mark]) -> list[Mark]:
    """Marks that no other one beats in time and in error, from the fastest on."""
    best: list[Mark] = []
    for mark in sorted(marks, key=lambda mark: (mark.seconds, mark.error)):
        if not best or mark.error < best[-1].error:
            best.append(mark)
    return best


def work_precision(marks: Sequence[Mark], error: str) -> str:
    """Chart of errors over seconds of a query, with the Pareto front.

    A tail goes from the median to the largest error, with a tick at 95 %.

    Args:
        marks: one mark for each method and setting.
        error: name of the error.

    Returns:
        An SVG element, empty without finite errors.
    """
    marks = [mark for mark in marks if math.isfinite(mark.error) and 0 < mark.seconds < math.inf]
    if not marks:
        return ""
    across = _Axis([mark.seconds for mark in marks], LEFT_MARGIN, END)
    up = _Axis([value for mark in marks for value in (mark.error, *mark.tail)], FLOOR, TOP)
    best = front(marks)
    line = "L".join(f"{across(mark.seconds):.1f} {up(mark.error):.1f}" for mark in best)
    elements = [*_ticks(across), *_ticks(up, up=True), f'<path class="front" d="M{line}"/>']
    labels: list[float] = []
    for mark in sorted(marks, key=lambda mark: up(mark.error)):
        x = across(mark.seconds)
        y = up(mark.error)
        tick, end = mark.tail
        label = (
            f"{mark.name}: {mark.seconds:.3g} s, {error} {mark.error:.2g} median, {tick:.2g} at "
            f"95 %, {end:.2g} at most"
        )
        elements.append(
            f"<g><title>{escape(label)}</title>"
            f'<path class="tail" d="M{x:.1f} {y:.1f}V{up(end):.1f}"/>'
            f'<path class="tick" d="M{x - 4:.1f} {up(tick):.1f}h8"/>'
        )
        elements.append(
            f'<circle class="{"own" if mark.own else "mark"}" cx="{x:.1f}" cy="{y:.1f}" r="5"/></g>'
        )
        if mark in best or mark.own:
            elements.append(_label(mark.name, x, y, labels))
    return _frame(
        "seconds of a query", error, elements, f"{error} over seconds of a query, method by method"
    )


def _label(name: str, x: float, y: float, used: list[float]) -> str:
    """The name of a mark next to it, below earlier names."""
    level = y + 4
    while any(abs(level - earlier) < 13 for earlier in used):
        level += 13
    used.append(level)
    return (
        _text(x - 9, level, "end", escape(name))
        if x > CHART_WIDTH - 150
        else _text(x + 9, level, "start", escape(name))
    )


def histogram(errors: Sequence[float], bounds: Sequence[float], error: str, bound: str) -> str:
    """Chart of the numbers of answers over errors, as bars; logarithmic.

    A line of steps has the numbers over bounds.

    Args:
        errors: error of each answer.
        bounds: bound or estimate of each answer; empty without.
        error: name of the error.
        bound: name of the bound.

    Returns:
        An SVG element, empty without finite errors.
    """
    errors = [value for value in errors if math.isfinite(value)]
    bounds = [value for value in bounds if math.isfinite(value)]
    if not errors:
        return ""
    across = _Axis([*errors, *bounds], LEFT_MARGIN, END)
    counts = _counted(errors, across)
    limits = _counted(bounds, across)
    most = max(*counts, *limits)
    size = (FLOOR - TOP) / most
    step = (END - LEFT_MARGIN) / BINS
    elements = _ticks(across)
    elements += [
        _text(LEFT_MARGIN - 6, FLOOR - count * size + 4, "end", count)
        for count in range(0, most + 1, max(1, math.ceil(most / 5)))
    ]
    for k, count in enumerate(counts):
        left = LEFT_MARGIN + k * step + 1
        top = FLOOR - count * size
        box = f'x="{left:.1f}" y="{top:.1f}" width="{step - 2:.1f}"'
        label = f"<title>{count} answers</title>"
        elements.append(
            f'<rect class="bar" {box} height="{count * size:.1f}">{label}</rect>' if count else ""
        )
    if bounds:
        steps = "".join(f"V{FLOOR - count * size:.1f}h{step:.2f}" for count in limits)
        elements.append(
            f'<path class="limit" d="M{LEFT_MARGIN} {FLOOR}{steps}V{FLOOR}">'
            f"<title>{escape(bound)}</title></path>"
        )
    return _frame(error, "answers", elements, f"how many answers have which {error}")


def _counted(values: Sequence[float], axis: _Axis) -> list[int]:
    counts: list[int] = np.histogram(
        [axis(value) for value in values], BINS, (axis.begin, axis.end)
    )[0].tolist()
    return counts


def map_of(
    points: Sequence[Sequence[float]],
    errors: Sequence[float],
    names: tuple[str, str],
    box: Sequence[tuple[float, float]],
) -> str:
    """Chart of errors of answers over two parameters.

    The darker and larger a point, the larger its error.

    Args:
        points: values of both parameters for each answer, (n, 2).
        errors: error of each answer.
        names: names of the parameters.
        box: lower and upper end of both parameters.

    Returns:
        An SVG element, empty without finite errors.
    """
    finite = [
        (x, y, error)
        for (x, y), error in zip(points, errors, strict=True)
        if math.isfinite(x + y + error)
    ]
    if not finite:
        return ""
    ends = [
        math.log10(max(pick(error for *_, error in finite), LEAST_DRAWN)) for pick in (min, max)
    ]
    (left, right), (low, high) = box
    elements: list[str] = []
    for x, y, error in sorted(finite, key=lambda item: item[2]):
        share = (math.log10(max(error, LEAST_DRAWN)) - ends[0]) / max(ends[1] - ends[0], 1e-9)
        across = LEFT_MARGIN + (x - left) / (right - left) * (END - LEFT_MARGIN)
        up = FLOOR - (y - low) / (high - low) * (FLOOR - TOP)
        label = (
            f"<title>{escape(names[0])} = {x:.4g}, {escape(names[1])} = {y:.4g}: "
            f"{error:.2g}</title>"
        )
        shade = min(SHADES - 1, int(share * SHADES))
        elements.append(
            f'<circle class="shade{shade}" cx="{across:.1f}" cy="{up:.1f}" '
            f'r="{2.5 + 3 * share:.1f}">{label}</circle>'
        )
    elements += [
        _text(LEFT_MARGIN, FLOOR + 17, "middle", f"{left:.4g}"),
        _text(END, FLOOR + 17, "end", f"{right:.4g}"),
        _text(LEFT_MARGIN - 6, FLOOR, "end", f"{low:.4g}"),
        _text(LEFT_MARGIN - 6, TOP + 8, "end", f"{high:.4g}"),
    ]
    return _frame(*names, elements, f"errors over {names[0]} and {names[1]}")
