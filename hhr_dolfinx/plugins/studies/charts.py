"""Charts of a report as SVG inside the page: they use its colours, stay sharp, print, and need no network."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

WIDTH = 640
HEIGHT = 360
"""Sizes of a chart, in units of the SVG."""
LEFT = 64
RIGHT = 16
TOP = 14
BOTTOM = 46
"""Its margins."""
LEAST = 1e-16
MOST = 1e16
"""Limits at which values below and above are drawn: zero has no logarithm, and such numbers occur in no report."""
BINS = 24
SHADES = 6
"""Bins of a histogram; steps of colour of a map."""


class Mark(NamedTuple):
    """A method of the chart of errors over times.

    Attributes:
        name: name of the method.
        seconds: of a query.
        error: at half of the points.
        high: error below which 95 % of the points are; no tail is drawn without it.
        own: whether it is the model of the report.
    """

    name: str
    seconds: float
    error: float
    high: float | None = None
    own: bool = False


class _Axis:
    """A logarithmic axis from ``low`` to ``high``, drawn from ``begin`` to ``end``."""

    def __init__(self, values: Sequence[float], begin: float, end: float):
        logs = [math.log10(min(max(value, LEAST), MOST)) for value in values]
        self.low = math.floor(min(logs) - 0.05)
        self.high = max(math.ceil(max(logs) + 0.05), self.low + 1)
        self.begin = begin
        self.end = end

    def __call__(self, value: float) -> float:
        part = (math.log10(min(max(value, LEAST), MOST)) - self.low) / (self.high - self.low)
        return self.begin + part * (self.end - self.begin)

    def ticks(self) -> list[int]:
        step = max(1, math.ceil((self.high - self.low) / 9))
        return list(range(self.low, self.high + 1, step))


def _frame(across: str, up: str, content: Sequence[str], title: str) -> str:
    """A chart with the names of its axes."""
    middle = (LEFT + WIDTH - RIGHT) / 2
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}">'
        f'<path class="axis" d="M{LEFT} {TOP}V{HEIGHT - BOTTOM}H{WIDTH - RIGHT}"/>'
        + "".join(content)
        + f'<text x="{middle:.0f}" y="{HEIGHT - 8}" text-anchor="middle">{escape(across)}</text>'
        f'<text transform="translate(14 {(TOP + HEIGHT - BOTTOM) / 2:.0f}) rotate(-90)" text-anchor="middle">'
        f"{escape(up)}</text></svg>"
    )


def _power(exponent: int) -> str:
    return f'10<tspan dy="-5" font-size="9">{exponent}</tspan>'


def _ticks_across(axis: _Axis) -> list[str]:
    bottom = HEIGHT - BOTTOM
    return [
        f'<path class="grid" d="M{axis(10.0**k):.1f} {TOP}V{bottom}"/>'
        f'<text x="{axis(10.0**k):.1f}" y="{bottom + 17}" text-anchor="middle">{_power(k)}</text>'
        for k in axis.ticks()
    ]


def _ticks_up(axis: _Axis) -> list[str]:
    return [
        f'<path class="grid" d="M{LEFT} {axis(10.0**k):.1f}H{WIDTH - RIGHT}"/>'
        f'<text x="{LEFT - 6}" y="{axis(10.0**k) + 4:.1f}" text-anchor="end">{_power(k)}</text>'
        for k in axis.ticks()
    ]


def front(marks: Sequence[Mark]) -> list[Mark]:
    """Marks that no other one beats in time and in error, from the fastest on."""
    found: list[Mark] = []
    for mark in sorted(marks, key=lambda mark: (mark.seconds, mark.error)):
        if not found or mark.error < found[-1].error:
            found.append(mark)
    return found


def work_precision(marks: Sequence[Mark], error: str) -> str:
    """Errors over seconds of a query, a tail up to the 95 % error, and the Pareto front."""
    marks = [mark for mark in marks if math.isfinite(mark.error) and 0 < mark.seconds < math.inf]
    if not marks:
        return ""
    across = _Axis([mark.seconds for mark in marks], LEFT, WIDTH - RIGHT)
    up = _Axis([value for mark in marks for value in (mark.error, _tail(mark))], HEIGHT - BOTTOM, TOP)
    best = front(marks)
    line = "L".join(f"{across(mark.seconds):.1f} {up(mark.error):.1f}" for mark in best)
    parts = [*_ticks_across(across), *_ticks_up(up), f'<path class="front" d="M{line}"/>']
    labels: list[float] = []
    for mark in sorted(marks, key=lambda mark: up(mark.error)):
        x = across(mark.seconds)
        y = up(mark.error)
        label = f"{mark.name}: {mark.seconds:.3g} s, {error} {mark.error:.2g} median, {_tail(mark):.2g} at 95 %"
        parts.append(
            f'<g><title>{escape(label)}</title><path class="tail" d="M{x:.1f} {y:.1f}V{up(_tail(mark)):.1f}"/>'
        )
        parts.append(f'<circle class="{"own" if mark.own else "mark"}" cx="{x:.1f}" cy="{y:.1f}" r="5"/></g>')
        if mark in best or mark.own:
            parts.append(_label(mark.name, x, y, labels))
    return _frame("seconds of a query", error, parts, f"{error} over seconds of a query, method by method")


def _tail(mark: Mark) -> float:
    return mark.error if mark.high is None or not math.isfinite(mark.high) else max(mark.high, mark.error)


def _label(name: str, x: float, y: float, used: list[float]) -> str:
    """The name of a mark next to it, below earlier names."""
    place = y + 4
    while any(abs(place - other) < 13 for other in used):
        place += 13
    used.append(place)
    right = x > WIDTH - 150
    return (
        f'<text x="{x - 9 if right else x + 9:.1f}" y="{place:.1f}" text-anchor="{"end" if right else "start"}">'
        f"{escape(name)}</text>"
    )


def histogram(errors: Sequence[float], bounds: Sequence[float], error: str, bound: str) -> str:
    """Numbers of answers over errors, as bars, and over bounds, as a line of steps; logarithmic."""
    errors = [value for value in errors if math.isfinite(value)]
    bounds = [value for value in bounds if math.isfinite(value)]
    if not errors:
        return ""
    across = _Axis([*errors, *bounds], LEFT, WIDTH - RIGHT)
    counts = _counted(errors, across)
    limits = _counted(bounds, across)
    most = max(*counts, *limits)
    bottom = HEIGHT - BOTTOM
    size = (bottom - TOP) / most
    step = (WIDTH - RIGHT - LEFT) / BINS
    parts = [*_ticks_across(across), *_counts_up(most, size)]
    for k, count in enumerate(counts):
        box = f'x="{LEFT + k * step + 1:.1f}" y="{bottom - count * size:.1f}" width="{step - 2:.1f}"'
        label = f"<title>{count} answers</title>"
        parts.append(f'<rect class="bar" {box} height="{count * size:.1f}">{label}</rect>' if count else "")
    if bounds:
        steps = "".join(f"V{bottom - count * size:.1f}h{step:.2f}" for count in limits)
        parts.append(f'<path class="limit" d="M{LEFT} {bottom}{steps}V{bottom}"><title>{escape(bound)}</title></path>')
    return _frame(error, "answers", parts, f"how many answers have which {error}")


def _counted(values: Sequence[float], axis: _Axis) -> list[int]:
    counts = [0] * BINS
    for value in values:
        part = (axis(value) - axis.begin) / (axis.end - axis.begin)
        counts[min(BINS - 1, max(0, int(part * BINS)))] += 1
    return counts


def _counts_up(most: int, size: float) -> list[str]:
    step = max(1, math.ceil(most / 5))
    bottom = HEIGHT - BOTTOM
    return [
        f'<text x="{LEFT - 6}" y="{bottom - count * size + 4:.1f}" text-anchor="end">{count}</text>'
        for count in range(0, most + 1, step)
    ]


def map_of(
    points: Sequence[Sequence[float]],
    errors: Sequence[float],
    names: tuple[str, str],
    box: Sequence[tuple[float, float]],
) -> str:
    """Errors of answers over two parameters: the darker and larger a point, the larger its error."""
    known = [(x, y, error) for (x, y), error in zip(points, errors, strict=True) if math.isfinite(x + y + error)]
    if not known:
        return ""
    ends = [math.log10(max(pick(error for *_, error in known), LEAST)) for pick in (min, max)]
    (left, right), (low, high) = box
    parts: list[str] = []
    for x, y, error in sorted(known, key=lambda item: item[2]):
        part = (math.log10(max(error, LEAST)) - ends[0]) / max(ends[1] - ends[0], 1e-9)
        across = LEFT + (x - left) / (right - left) * (WIDTH - RIGHT - LEFT)
        up = HEIGHT - BOTTOM - (y - low) / (high - low) * (HEIGHT - BOTTOM - TOP)
        label = f"<title>{escape(names[0])} = {x:.4g}, {escape(names[1])} = {y:.4g}: {error:.2g}</title>"
        shade = min(SHADES - 1, int(part * SHADES))
        parts.append(
            f'<circle class="shade{shade}" cx="{across:.1f}" cy="{up:.1f}" r="{2.5 + 3 * part:.1f}">{label}</circle>'
        )
    bottom = HEIGHT - BOTTOM
    parts += [
        f'<text x="{LEFT}" y="{bottom + 17}" text-anchor="middle">{left:.4g}</text>',
        f'<text x="{WIDTH - RIGHT}" y="{bottom + 17}" text-anchor="end">{right:.4g}</text>',
        f'<text x="{LEFT - 6}" y="{bottom}" text-anchor="end">{low:.4g}</text>',
        f'<text x="{LEFT - 6}" y="{TOP + 8}" text-anchor="end">{high:.4g}</text>',
    ]
    return _frame(*names, parts, f"errors over {names[0]} and {names[1]}")
