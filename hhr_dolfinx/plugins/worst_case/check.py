"""A checker of certificates that shares no code with the search.

It reads the numbers of a certificate, walks from the whole box to its smallest parts, and bounds
the candidates in each again, by explicit inverses. Forces at corners need not be right: what they
lack of a solution enlarges the bounds. It needs to trust this file, certificate.py and NumPy.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.files import read_arrays
from hhr_dolfinx.plugins.worst_case.certificate import (
    FORMAT,
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

_LEAST = 1e-7
"""Least singular value of the motions of conditions, of size 1, that hold bodies."""
BALANCE = 1e-11
"""Relative difference of loads and forces along a motion that counts as round-off: the distance is
bounded for forces in balance alone.
"""
DEFINITE = 1e-12
"""Least eigenvalue of S with a diagonal of 1 to 4: round-off of its inverse falsifies the bounds of
a problem that is nearer to a singular one.
"""


def check_certificate(path: str | Path, *, exact: bool = False) -> str:
    """Prove the claim of a certificate again.

    Args:
        path: file of :meth:`~hhr_dolfinx.plugins.worst_case.search.WorstCase.save`.
        exact: compute in rational numbers, without round-off, see
            :mod:`~hhr_dolfinx.plugins.worst_case.exact_check`: for up to 40 conditions of bodies
            that displacements hold.

    Returns:
        The claim, in words, which holds.

    Raises:
        FileContentError: if the file is damaged, or its boxes do not prove the value.
        NotOfferedError: for what rational numbers are too slow for.
    """
    if exact:
        from hhr_dolfinx.plugins.worst_case.exact_check import check_exactly

        return check_exactly(path)
    header, arrays = read_arrays(path, FORMAT, VERSION)
    try:
        check_arrays(arrays)
        parts = parts_of(arrays)
        proven = float(arrays["proven"])
        names = ("schur", "free", "slopes", "motions", "driving", "corners", "solutions")
        problem = _Problem(*(arrays[name] for name in names))
        outputs = arrays["constant"], arrays["along"], problem.scaled(arrays["weights"])
        with np.errstate(all="ignore"):  # what is not finite proves nothing
            _check(problem, outputs, parts, proven)
    except (KeyError, IndexError, ValueError, np.linalg.LinAlgError) as error:
        raise FileContentError(f"the certificate {path} is no proof: {error}") from error
    side, value = ("below", -proven) if header.get("smallest") else ("above", proven)
    claim = f"{header.get('output')} is nowhere in the box {side} {value!r}"
    return f"{claim}: proven again by {len(parts)} boxes"


class _Problem:
    """s = f + G t + S λ - R α, complementary, R^T λ = d."""

    def __init__(
        self,
        schur: np.ndarray,
        free: np.ndarray,
        slopes: np.ndarray,
        motions: np.ndarray,
        driving: np.ndarray,
        corners: np.ndarray,
        solutions: np.ndarray,
    ):
        if not np.array_equal(schur, schur.T) or not (np.diag(schur) > 0).all():
            raise ValueError("S is not symmetric and positive definite")
        # units of conditions by powers of two, without round-off, to a diagonal of 1 to 4
        self.unit = 0.5 ** np.floor(0.5 * np.log2(np.diag(schur)))
        schur = schur * self.unit * self.unit[:, None]
        if not np.linalg.eigvalsh(schur)[0] > DEFINITE:
            raise ValueError("S is not positive definite, or no more than by round-off")
        free, slopes, motions = ((self.unit * part.T).T for part in (free, slopes, motions))
        solutions = solutions / np.append(self.unit, np.ones(motions.shape[1]))
        self.schur = schur
        self.motions = motions
        count = motions.shape[1]
        self.whole = np.block([[schur, -motions], [motions.T, np.zeros((count, count))]])
        self.terms = np.vstack([np.column_stack([free, slopes]), -driving])
        # each corner may come from several boxes, whose ends are equal bit by bit
        self.solutions = {t.tobytes(): row for t, row in zip(corners, solutions, strict=True)}

    def scaled(self, weights: np.ndarray) -> np.ndarray:
        """Weights, (K, m + r), of forces in the units of this problem."""
        return weights * np.append(self.unit, np.ones(self.motions.shape[1]))


def _check(
    problem: _Problem, outputs: tuple[np.ndarray, ...], parts: list[Part], proven: float
) -> None:
    """Raise ValueError unless the boxes prove that no candidate exceeds a value."""
    nothing = np.zeros(len(problem.schur), dtype=bool)
    limit = proven + ROUND_OFF * abs(proven)
    left = [(0, nothing, nothing, np.full(len(parts[0].chosen), np.inf))]
    while left:
        number, closed, opened, known = left.pop()
        part = parts[number]
        closed, opened, upper, slopes = _bounds(problem, outputs, part, closed, opened)
        upper = np.minimum(np.where(np.isfinite(upper), upper, np.inf), known)
        missing = part.chosen & (upper > limit)
        # an end of the slopes of a single condition is zero but for round-off
        loss = TINY * (np.abs(slopes[0]) + np.abs(slopes[1]))
        slopes = slopes[0] + loss, slopes[1] - loss
        for child in part.children:
            missing &= ~answered(parts, part, parts[child], slopes)
            left.append((child, closed, opened, upper))
        if missing.any():
            largest = upper[missing].max()
            raise ValueError(f"box {number} leaves candidate {missing.argmax()} at {largest:.6g}")


def _bounds(
    problem: _Problem,
    outputs: tuple[np.ndarray, ...],
    part: Part,
    closed: np.ndarray,
    opened: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Sure conditions of a box, bounds of all candidates and ends of their slopes."""
    for _ in range(ROUNDS):
        rest = _Rest(problem, part, closed, opened)
        more_closed, more_open = rest.sure()
        if not (more_closed.any() or more_open.any()):
            break
        closed = closed | more_closed
        opened = opened | more_open
    rest = _Rest(problem, part, closed, opened)
    return closed, opened, *rest.bounds(*outputs)


class _Rest:
    """Conditions of a box that may change, the sure ones eliminated."""

    def __init__(self, problem: _Problem, part: Part, closed: np.ndarray, opened: np.ndarray):
        m, count = problem.motions.shape
        sure = np.flatnonzero(closed)
        # in units of the file, in which motions have the size 1
        reach = problem.motions[sure] / problem.unit[sure, None]
        held = np.linalg.matrix_rank(reach, tol=_LEAST) == count
        # motions that nothing sure holds stay as they are, and so do all closed conditions
        self.loose = count > 0 and not held
        gone = np.zeros(0, dtype=int) if self.loose else np.append(sure, m + np.arange(count))
        self.gone = gone
        self.rest = np.flatnonzero(~opened if self.loose else ~(closed | opened))
        self.size = m
        inverse = -np.linalg.inv(problem.whole[np.ix_(gone, gone)])
        self.onto_terms = inverse @ problem.terms[gone]
        self.onto_rest = inverse @ problem.whole[np.ix_(gone, self.rest)]
        back = problem.whole[np.ix_(self.rest, gone)]
        self.M = problem.schur[np.ix_(self.rest, self.rest)] + back @ self.onto_rest
        self.M = 0.5 * (self.M + self.M.T)
        self.free = problem.terms[self.rest] + back @ self.onto_terms
        self.inverse = np.linalg.inv(self.M)
        self.free_sides = sides_of(part)
        corners = list(corners_of(part, self.free_sides))
        self.at = np.column_stack([np.concatenate([[1.0], corner]) for corner in corners])
        solutions = np.column_stack([problem.solutions[corner.tobytes()] for corner in corners])
        self.forces = np.maximum(solutions[self.rest], 0)
        self.slack = self.free @ self.at + self.M @ self.forces
        if self.loose:
            self._check_balance(problem)
            self.slack = self.slack - problem.motions[self.rest] @ solutions[m:]
        self.known = closed[self.rest]
        self.far = self._distance()

    def _check_balance(self, problem: _Problem) -> None:
        """Forces at corners, without negative ones, balance the loads along each motion, or the
        distance is not bounded.
        """
        # in units of the file: of a node at a centre of rotation only round-off is left of R
        motions = (problem.motions / problem.unit[:, None])[self.rest].T
        forces = problem.unit[self.rest, None] * self.forces
        driving = problem.terms[self.size :]
        off = np.abs(motions @ forces + driving @ self.at)
        acting = np.abs(motions).max(axis=1, keepdims=True) * ((motions != 0) @ forces)
        if not (off <= BALANCE * (acting + np.abs(driving) @ self.at)).all():
            raise ValueError("forces at a corner do not balance the loads")

    def _distance(self) -> float:
        """How far solutions are from the interpolated forces, in the norm of M."""
        terms = np.abs(self.free) @ np.abs(self.at) + np.abs(self.M) @ self.forces
        lack = np.where(self.slack <= TINY * terms, self.slack, 0)
        squares = np.sum(lack * (self.inverse @ lack), axis=0)
        residual = np.sqrt(squares.max(initial=0.0))
        products = self.forces.T @ (self.slack - lack)
        number = len(self.free_sides)
        largest = np.zeros(2**number)
        corners = np.arange(2**number)
        for mask in corners:
            pairs = products[corners, corners ^ mask]
            # one mean for each place of the sides that do not differ
            rest = corners & ~mask
            sums = np.bincount(rest, weights=pairs, minlength=2**number)
            largest[mask] = sums.max() / 2 ** int(mask).bit_count()
        inside = [largest[(corners & ~mask) == 0].mean() for mask in corners]
        # unlike Python's, this maximum keeps what is no number
        return float(0.5 * residual + np.sqrt(0.25 * residual**2 + np.max(inside, initial=0.0)))

    def sure(self) -> tuple[np.ndarray, np.ndarray]:
        """Conditions, (m,) bool, that are closed and open all over the box."""
        of_force = self.forces.min(axis=1) - np.sqrt(np.diag(self.inverse)) * self.far
        of_slack = self.slack.min(axis=1) - np.sqrt(np.diag(self.M)) * self.far
        found = []
        closes = (of_force > 0) & ~self.known
        opens = (of_slack > 0) & (not self.loose)
        for which in (closes & ~opens, opens & ~closes):
            sure = np.zeros(self.size, dtype=bool)
            sure[self.rest[which]] = True
            found.append(sure)
        return found[0], found[1]

    def bounds(
        self, constant: np.ndarray, along: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Bounds of all candidates, (K,), and ends of their slopes, (K, P) each.

        Args:
            constant: c of the candidates, (K,).
            along: b, (K, P).
            weights: a, (K, m + r).
        """
        passed = weights[:, self.gone]
        base = np.column_stack([constant, along]) + passed @ self.onto_terms
        w = weights[:, self.rest] + passed @ self.onto_rest
        norms = np.sqrt(np.maximum(((w @ self.inverse) * w).sum(axis=1), 0))
        upper = (base @ self.at + w @ self.forces).max(axis=1) + norms * self.far
        if self.loose:
            endless = np.full(along.shape, np.inf)
            moving = weights[:, self.size :].any(axis=1)
            return np.where(moving, np.inf, upper), (-endless, endless)
        full = -self.inverse @ self.free[:, 1:]
        radius = 0.5 * norms[:, None] * np.sqrt(np.maximum((full * (self.M @ full)).sum(axis=0), 0))
        centre = base[:, 1:] + 0.5 * w @ full
        return upper, (centre - radius, centre + radius)
