"""A certificate proven in rational numbers: what is said of the numbers of the file holds of them.

The formulas are those of :mod:`hhr_dolfinx.plugins.worst_case.check`, which has them in double
precision. Here each number of the file is the fraction that it is, sums, products and inverses are
exact, and square roots are enclosed from above, so that no rounding is forgiven.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import inf, isqrt, nextafter
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError, NotOfferedError
from hhr_dolfinx.files import read_arrays
from hhr_dolfinx.plugins.worst_case.certificate import (
    FORMAT,
    LARGE,
    ROUND_OFF,
    ROUNDS,
    TINY,
    VERSION,
    Part,
    answered,
    check_arrays,
    corners_of,
    parts_of,
    sides_of,
)

MOST_EXACT = 40
"""Most conditions of a certificate that is proven in rational numbers: these grow with the cube of
their number, and their digits with it too.
"""
ROOT_BITS = 160
"""Bits of a square root."""
_exactly = np.vectorize(Fraction, otypes=[object])


def check_exactly(path: str | Path) -> str:
    """Prove a certificate again in rational numbers.

    Args:
        path: file of :meth:`~hhr_dolfinx.plugins.worst_case.search.WorstCase.save`.

    Returns:
        The claim, in words: its value is the one of the file and the 1e-9 of it that the other
        checker forgives.

    Raises:
        FileContentError: if the file is damaged, or its boxes do not prove the value.
        NotOfferedError: for bodies that contact alone holds, and for more than 40 conditions.
    """
    header, arrays = read_arrays(path, FORMAT, VERSION)
    try:
        check_arrays(arrays)
        parts = parts_of(arrays)
        conditions, motions = arrays["motions"].shape
        if motions or conditions > MOST_EXACT:
            raise NotOfferedError(
                f"{conditions} conditions and {motions} motions: {MOST_EXACT} conditions, of "
                "bodies that displacements hold, are proven in rational numbers"
            )
        limit = Fraction(float(arrays["proven"]))
        limit += Fraction(ROUND_OFF) * abs(limit)
        _walk(_Rational.of(arrays), parts, limit)
    except (KeyError, IndexError, ValueError, ZeroDivisionError) as error:
        raise FileContentError(f"the certificate {path} is no proof: {error}") from error
    smallest = header.get("smallest")
    value = nextafter(float(limit), inf)
    claim = f"below {-value!r}" if smallest else f"above {value!r}"
    return (
        f"{header.get('output')} is nowhere in the box {claim}: proven in rational numbers by "
        f"{len(parts)} boxes"
    )


@dataclass(frozen=True)
class _Rational:
    """s = f + G t + S λ, complementary, and candidates c + b^T t + a^T λ, as fractions."""

    schur: np.ndarray  #: (m, m)
    terms: np.ndarray  #: f and G, (m, 1 + P)
    constant: np.ndarray  #: c and b, (K, 1 + P)
    weights: np.ndarray  #: a, (K, m)
    solutions: dict[bytes, np.ndarray]  #: forces at corners, (m,)

    @classmethod
    def of(cls, arrays: dict[str, np.ndarray]) -> _Rational:
        """The problem of a file.

        Raises:
            ValueError: for an S that is not symmetric and positive definite.
        """
        schur = _exactly(arrays["schur"])
        if (schur != schur.T).any():
            raise ValueError("S is not symmetric")
        _solved(schur, schur[:, :0])  # refuses an S that is not positive definite
        corners = zip(arrays["corners"], arrays["solutions"], strict=True)
        return cls(
            schur,
            _exactly(np.column_stack([arrays["free"], arrays["slopes"]])),
            _exactly(np.column_stack([arrays["constant"], arrays["along"]])),
            _exactly(arrays["weights"]),
            {corner.tobytes(): _exactly(forces) for corner, forces in corners},
        )


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution of a symmetric positive definite system, by elimination without pivots.

    Raises:
        ValueError: if the matrix is not positive definite.
    """
    count = len(matrix)
    rows = np.hstack([matrix, right])
    for k in range(count):
        if not rows[k, k] > 0:
            raise ValueError("a matrix is not positive definite")
        rows[k, k:] = rows[k, k:] / rows[k, k]
        others = np.flatnonzero(np.arange(count) != k)
        rows[others, k:] = rows[others, k:] - rows[others, k : k + 1] * rows[k, k:]
    return rows[:, count:]


def root_above(value: Fraction) -> Fraction:
    """A number that is not below the square root of one that is not negative."""
    if value == 0:
        return Fraction(0)
    size = value.numerator.bit_length() - value.denominator.bit_length()
    bits = max(ROOT_BITS - size // 2, 0)
    scaled = (value.numerator << (2 * bits)) // value.denominator
    return Fraction(isqrt(scaled) + 1, 1 << bits)


def _walk(problem: _Rational, parts: list[Part], limit: Fraction) -> None:
    """Raise ValueError unless the boxes prove that no candidate exceeds a value."""
    nothing = np.zeros(len(problem.schur), dtype=bool)
    beyond = np.full(len(parts[0].chosen), Fraction(LARGE) ** 3, dtype=object)
    left = [(0, nothing, nothing, beyond)]
    while left:
        number, closed, opened, known = left.pop()
        part = parts[number]
        rest = _ExactRest(problem, part, closed, opened)
        for _ in range(ROUNDS):
            more_closed, more_open = rest.sure()
            if not (more_closed.any() or more_open.any()):
                break
            closed = closed | more_closed
            opened = opened | more_open
            rest = _ExactRest(problem, part, closed, opened)
        upper = np.minimum(rest.upper(), known)
        missing = part.chosen & (upper > limit).astype(bool)
        slopes = rest.slopes() if part.children else (np.zeros(0), np.zeros(0))
        for child in part.children:
            missing &= ~answered(parts, part, parts[child], slopes)
            left.append((child, closed, opened, upper))
        if missing.any():
            largest = float(max(upper[missing]))
            raise ValueError(f"box {number} leaves candidate {missing.argmax()} at {largest:.17g}")


class _ExactRest:
    """Conditions of a box that may change, the sure ones eliminated."""

    def __init__(self, problem: _Rational, part: Part, closed: np.ndarray, opened: np.ndarray):
        gone = np.flatnonzero(closed)
        rest = np.flatnonzero(~(closed | opened))
        across = problem.schur[np.ix_(gone, rest)]
        right = np.hstack([problem.terms[gone], across])
        passed_on = _solved(problem.schur[np.ix_(gone, gone)], right)
        count = problem.terms.shape[1]
        terms = -passed_on[:, :count]
        forces = -passed_on[:, count:]
        self.size = len(closed)
        self.rest = rest
        self.M = problem.schur[np.ix_(rest, rest)] + across.T @ forces
        self.free = problem.terms[rest] + across.T @ terms
        self.inverse = _solved(self.M, _exactly(np.eye(len(rest))))
        weights = problem.weights[:, gone]
        self.base = problem.constant + weights @ terms
        self.weights = problem.weights[:, rest] + weights @ forces
        sides = sides_of(part)
        corners = list(corners_of(part, sides))
        self.at = _exactly(np.column_stack([[1.0, *corner] for corner in corners]))
        known = [problem.solutions[corner.tobytes()][rest] for corner in corners]
        self.forces = np.column_stack(known)
        self.forces[self.forces < 0] = Fraction(0)
        self.slack = self.free @ self.at + self.M @ self.forces
        self.far = self._distance(len(sides))

    def _distance(self, sides: int) -> Fraction:
        """See the other checker; lacks are what is not well above zero."""
        terms = abs(self.free) @ abs(self.at) + abs(self.M) @ self.forces
        lack = self.slack.copy()
        lack[self.slack > Fraction(TINY) * terms] = Fraction(0)
        residuals = (lack * (self.inverse @ lack)).sum(axis=0)
        residual = root_above(max(residuals, default=Fraction(0)))
        products = self.forces.T @ (self.slack - lack)
        corners = range(2**sides)
        largest = []
        for mask in corners:
            sums: dict[int, Fraction] = {}
            for corner in corners:
                rest = corner & ~mask
                sums[rest] = sums.get(rest, Fraction(0)) + products[corner, corner ^ mask]
            largest.append(max(sums.values()) / 2 ** mask.bit_count())
        inside = []
        for mask in corners:
            chosen = [value for corner, value in enumerate(largest) if corner & ~mask == 0]
            inside.append(sum(chosen, Fraction(0)) / len(chosen))
        return residual / 2 + root_above(residual**2 / 4 + max(*inside, Fraction(0)))

    def sure(self) -> tuple[np.ndarray, np.ndarray]:
        """Conditions, (m,) bool, that are closed and open all over the box."""
        found = np.zeros((2, self.size), dtype=bool)
        for k, condition in enumerate(self.rest):
            closes = min(self.forces[k]) - root_above(self.inverse[k, k]) * self.far > 0
            opens = min(self.slack[k]) - root_above(self.M[k, k]) * self.far > 0
            found[:, condition] = closes and not opens, opens and not closes
        return found[0], found[1]

    @cached_property
    def _squares(self) -> np.ndarray:
        """Squares of the norms of the weights, in that of M^-1, (K,)."""
        return np.asarray(((self.weights @ self.inverse) * self.weights).sum(axis=1))

    def upper(self) -> np.ndarray:
        """Bounds of all candidates, (K,)."""
        values = (self.base @ self.at + self.weights @ self.forces).max(axis=1)
        norms = np.array([root_above(Fraction(value)) for value in self._squares], dtype=object)
        return np.asarray(values + norms * self.far)

    def slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """Signs of the ends of the slopes of all candidates, (K, P) each."""
        full = -(self.inverse @ self.free[:, 1:])
        squares = (full * (self.M @ full)).sum(axis=0)
        twice = 2 * self.base[:, 1:] + self.weights @ full
        # of c -+ r with r² = 4 times the product of both squares, without a root
        inside = _signs(np.outer(self._squares, squares) - twice * twice)
        side = _signs(twice)
        lower = np.where(side > 0, -inside, -np.maximum(np.abs(side), np.maximum(inside, 0)))
        upper = np.where(side < 0, inside, np.maximum(np.abs(side), np.maximum(inside, 0)))
        return lower, upper


def _signs(values: np.ndarray) -> np.ndarray:
    """-1, 0 or 1 for each of them."""
    return np.array(values > 0, dtype=float) - np.array(values < 0, dtype=float)
