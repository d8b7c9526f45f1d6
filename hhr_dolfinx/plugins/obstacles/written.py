"""Gaps to spheres, circles, cylinders and cones as formulas of the parameters: pages and C evaluate
these alone.

They are the closed forms of :meth:`~hhr_dolfinx.plugins.obstacles.rounds.Quadric.along`. A
condition is a factor of 0 or 1, made of ``min`` and ``max``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from hhr_dolfinx.formulas import Formula

SWITCH_FACTOR = 1e300
"""Factor by which a number is 0 or more than 1: a positive one of the size of a gap squared is no
smaller.
"""


def written_gap(
    kind: str,
    inside: bool,
    sizes: Sequence[str],
    point: np.ndarray,
    normal: np.ndarray,
    far: float,
    tip: float,
) -> str:
    """Distance from a point along its normal, (dim,) each, to an obstacle.

    Args:
        kind: ``sphere``, also of a circle, ``cylinder``, or ``cone``.
        inside: True if the point is in the obstacle, a hole.
        sizes: formulas: the place, the axis but for a sphere, then the radius, or the angle in
            degrees.
        point: place of a node.
        normal: unit normal into the obstacle.
        far: distance where the normal misses the obstacle.
        tip: part of the distance to the tip of a cone within which a normal passes through it.
    """
    dim = point.size
    offsets = [f"({_number(x)}-({size}))" for x, size in zip(point, sizes[:dim], strict=True)]
    b = _sum(f"{_number(n)}*{d}" for n, d in zip(normal, offsets, strict=True))
    c = _sum(f"{d}**2" for d in offsets)
    if kind == "sphere":
        root = f"({b})**2-({c}-({sizes[-1]})**2)"
        return _chosen(root, _root(f"{c}-({sizes[-1]})**2", b, root, inside), _number(far))
    axis = _unit(sizes[dim : 2 * dim])
    height = f"({_sum(f'{d}*{component}' for d, component in zip(offsets, axis, strict=True))})"
    rise = _short(
        f"({_sum(f'{_number(n)}*{component}' for n, component in zip(normal, axis, strict=True))})"
    )
    cone = kind == "cone"
    share = _short(f"(1+tan(pi/180*({sizes[-1]}))**2)") if cone else "1"
    size = "0" if cone else f"({sizes[-1]})**2"
    a_axis = _short(f"(1-{share}*({rise})**2)")
    b_axis = f"({b}-{share}*({height})*({rise}))"
    c_axis = f"({c}-{share}*({height})**2-{size})"
    root = f"{b_axis}**2-{a_axis}*{c_axis}"
    gap = _root(c_axis, b_axis, root, inside)
    text = _chosen(root, gap, _number(far))
    if not cone:
        return text
    # the other half of the double cone is no obstacle
    text = _chosen(
        root, _chosen(f"{height}+({gap})*({rise})", gap, _number(far), least=True), _number(far)
    )
    at_tip = f"{_number(tip**2)}*({c})-(({c})-({b})**2)"
    return _chosen(at_tip, _chosen(f"-({height})", f"-({b})", text), text, least=True)


def _short(text: str) -> str:
    """A formula, or its value if it has no parameters."""
    formula = Formula(text)
    return text if formula.variables else _number(float(formula({})))


def _unit(axis: Sequence[str]) -> list[str]:
    """Components of a vector of formulas over its length."""
    length = f"sqrt({_sum(f'({component})**2' for component in axis)})"
    return [_short(f"(({component})/{length})") for component in axis]


def _root(c: str, b: str, root: str, inside: bool) -> str:
    """The root c / (-b + root), or from inside c / (-b - root), of the right sign.

    1 stands for a divisor of zero.
    """
    sign = "-" if inside else "+"
    divisor = f"-({b}){sign}sqrt(max({root},0))"
    return f"({c})/({divisor}+{_if(root)[1]})"


def _if(number: str, least: bool = False) -> tuple[str, str]:
    """Factors that are 1 and 0 where a number is positive, or with ``least`` zero too, and 0 and 1
    elsewhere.
    """
    if least:
        negative = f"min(1,max(0,-({number}))*{SWITCH_FACTOR:g})"
        return f"(1-{negative})", negative
    positive = f"min(1,max(0,{number})*{SWITCH_FACTOR:g})"
    return positive, f"(1-{positive})"


def _chosen(number: str, positive: str, other: str, least: bool = False) -> str:
    yes, no = _if(number, least)
    return f"({yes}*({positive})+{no}*({other}))"


def _number(value: float) -> str:
    return f"({float(value)!r})" if value < 0 else repr(float(value))


def _sum(terms: Iterable[str]) -> str:
    return "+".join(terms)
