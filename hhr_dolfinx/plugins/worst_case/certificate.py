"""Contents of a certificate: boxes, their corners, and how parts make up a whole.

Both checkers read it, and share no code with the search.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

FORMAT = "hhr_dolfinx worst case"
VERSION = 1
LARGE = 1e100
"""Largest size of numbers, and with its reciprocal of those that are not zero: squares of others
leave the range of double precision.
"""
ROUND_OFF = 1e-9
"""Relative difference of two bounds that counts as round-off of different ways to compute them."""
TINY = 1e-13
"""Round-off of slopes, and of the slack of closed conditions, relative to their terms: the latter
counts as lacking, since the root of its product with the force would be much larger.
"""
ROUNDS = 5
"""Rounds in which sure conditions sharpen the bounds of the others: more than the search makes."""
MOST_SIDES = 12
"""Most parameters along which a box has a length: each doubles its corners."""


@dataclass(frozen=True)
class Part:
    """A box of a certificate.

    Attributes:
        lower: (P,).
        upper: (P,).
        chosen: candidates that it answers for, (K,) bool.
        children: numbers of the boxes that take its place.
    """

    lower: np.ndarray
    upper: np.ndarray
    chosen: np.ndarray
    children: tuple[int, ...]


def check_arrays(arrays: dict[str, np.ndarray]) -> None:
    """Raise ValueError for arrays of other kinds, shapes or sizes, which might pass unseen."""
    boxes, candidates = arrays["chosen"].shape
    conditions, motions = arrays["motions"].shape
    corners, parameters = arrays["corners"].shape
    unknowns = conditions + motions
    shapes = {
        "schur": (conditions, conditions),
        "free": (conditions,),
        "slopes": (conditions, parameters),
        "motions": (conditions, motions),
        "driving": (motions, 1 + parameters),
        "constant": (candidates,),
        "along": (candidates, parameters),
        "weights": (candidates, unknowns),
        "proven": (),
        "parents": (boxes,),
        "lower": (boxes, parameters),
        "upper": (boxes, parameters),
        "chosen": (boxes, candidates),
        "corners": (corners, parameters),
        "solutions": (corners, unknowns),
    }
    if not (boxes and candidates and conditions):
        raise ValueError("there is no box, no candidate or no condition")
    for name, shape in shapes.items():
        array = arrays[name]
        kind = {"parents": "i", "chosen": "b"}.get(name, "f")
        if array.shape != shape or array.dtype.kind != kind:
            raise ValueError(f"{name} is {array.dtype} {array.shape}, not '{kind}' {shape}")
        if kind == "f" and np.abs(array).max(initial=0.0) > LARGE:
            raise ValueError(f"{name} has numbers above {LARGE:g}")
    loads = np.column_stack([arrays["free"], arrays["slopes"]])
    for name, sizes in (
        ("loads", np.abs(loads).max(keepdims=True)),
        ("weights", np.abs(arrays["weights"]).max(axis=1)),
        ("the diagonal of S", np.diag(arrays["schur"])),
    ):
        if (sizes[sizes != 0] < 1 / LARGE).any():
            raise ValueError(f"{name}: a size below {1 / LARGE:g} that is not zero")


def parts_of(arrays: dict[str, np.ndarray]) -> list[Part]:
    """The boxes of a file, the whole one first.

    Raises:
        ValueError: for a part of a later box, and a first box that is not all of it.
    """
    children: dict[int, list[int]] = {}
    for number, parent in enumerate(arrays["parents"].tolist()):
        if parent >= number:
            raise ValueError(f"box {number} is a part of a later one")
        children.setdefault(parent, []).append(number)
    columns = (arrays[name] for name in ("lower", "upper", "chosen"))
    parts = [
        Part(lower, upper, chosen, tuple(children.get(number, ())))
        for number, (lower, upper, chosen) in enumerate(zip(*columns, strict=True))
    ]
    root = parts[0]
    if root.lower.any() or (root.upper != 1).any() or not root.chosen.all():
        raise ValueError("the first box is not the whole one with all candidates")
    return parts


def answered(
    parts: list[Part], part: Part, child: Part, slopes: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Candidates of a box that a part answers for, (K,) bool: on a face where they are largest, or
    with the other half.

    Args:
        parts: all boxes.
        part: the box.
        child: its part.
        slopes: ends of the slopes of all candidates, (K, P) each.

    Raises:
        ValueError: for a part that is not within its box.
    """
    if (child.lower < part.lower).any() or (child.upper > part.upper).any():
        raise ValueError("a part is not within its box")
    cut_above = child.upper < part.upper
    cut_below = child.lower > part.lower
    falls = (slopes[1] <= 0) | ~cut_above
    rises = (slopes[0] >= 0) | ~cut_below
    on_face = (child.lower == child.upper) | ~(cut_above | cut_below)
    whole: np.ndarray = child.chosen & (falls & rises).all(axis=1) & on_face.all()
    cut = np.flatnonzero(cut_above | cut_below)
    if cut.size == 1:
        others = [parts[other] for other in part.children if parts[other] is not child]
        for other in others:
            whole = whole | (child.chosen & other.chosen & _halves(part, child, other, int(cut[0])))
    return whole


def _halves(part: Part, one: Part, other: Part, axis: int) -> bool:
    """True if two boxes make up a third one, divided along an axis."""
    rest = np.arange(len(part.lower)) != axis
    low, high = (one, other) if one.lower[axis] <= other.lower[axis] else (other, one)
    same = all(
        np.array_equal(half.lower[rest], part.lower[rest])
        and np.array_equal(half.upper[rest], part.upper[rest])
        for half in (low, high)
    )
    ends = low.lower[axis] == part.lower[axis] and high.upper[axis] == part.upper[axis]
    return bool(same and ends and low.upper[axis] >= high.lower[axis])


def sides_of(part: Part) -> np.ndarray:
    """Parameters along which a box has a length.

    Raises:
        ValueError: for more than twelve.
    """
    sides = np.flatnonzero(part.lower < part.upper)
    if len(sides) > MOST_SIDES:
        raise ValueError(f"a box has more than {MOST_SIDES} sides with a length")
    return sides


def corners_of(part: Part, sides: np.ndarray) -> Iterator[np.ndarray]:
    """Corners of a box, (P,) each; bit k of their number is that of side k.

    Args:
        part: the box.
        sides: parameters along which it has a length.
    """
    for number in range(2 ** len(sides)):
        corner = part.lower.copy()
        for k, side in enumerate(sides):
            if number >> k & 1:
                corner[side] = part.upper[side]
        yield corner
