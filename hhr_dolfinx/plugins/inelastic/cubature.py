"""Cubature: few points with non-negative weights that integrate functions seen in training.

Find weights w >= 0, most of them zero, with |A w - A 1| <= tolerance |A 1|, where a column of A
holds the contribution of a point of integration to each integral. As in energy-conserving sampling
and weighting (Farhat, Avery, Chapman and Cortial, 2014, doi 10.1002/nme.4668) this is non-negative
least squares, stopped as soon as the misfit is small. As in empirical cubature (Hernandez, Caicedo
and Ferrer, 2017, doi 10.1016/j.cma.2016.10.022) the next point is the one whose column, scaled to
length one, is the most parallel to the misfit, and a factorisation follows the points.

The iteration is that of Lawson and Hanson (Solving Least Squares Problems, chapter 23) with a QR
factor of the chosen columns that gains and loses single columns: normal equations would lose half
of the digits. The expensive step compares all candidates with the misfit. So good candidates from
the whole mesh are copied to a short list, which supplies points until it has no good ones left.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.linear.dense import GrowingColumns

SAME_WORTH = 1e-9
"""Relative difference up to which two points reduce the misfit alike."""
LISTED = 1000
"""Approximate number of candidates on the short list: a block of so many columns fits into the
cache.
"""
WORTH = 0.5
"""The list is good as long as it has a candidate this parallel to the misfit, relative to its best
one at first.
"""
SKETCHED = 1000
"""Number of rows above which their compression computes eigenvectors in a subspace."""
SUBSPACE_GROWTH = 128
"""Number of vectors by which the subspace grows."""
SUBSPACE_SHARE = 0.1
"""Part of the error allowed to a compression that may lie outside the subspace."""
DEPENDENT_COLUMN = 1e-12
"""A column with a smaller part outside the chosen columns, relative to its length, counts as
dependent on them.
"""
LEAST_MISFIT = 1e-15
"""If no candidate is more parallel to the misfit, relative to the integrals, the least misfit is
reached.
"""
MOST_POINTS_PER_ROW = 20
"""Most points added for each row; normally one or two suffice."""
REFRESHED = 200
"""Number of changes after which the factor is recomputed, to limit round-off."""


@dataclass(frozen=True)
class Cubature:
    """Points of integration with their weights."""

    points: np.ndarray  #: numbers of the points among the candidates, increasing, (n,)
    weights: np.ndarray  #: factors of their contributions, > 0, (n,)
    misfit: float  #: |A w - A 1| / |A 1| for the rows of the fit


def fitted(
    rows: np.ndarray, tolerance: float, most: int | None = None, start: Cubature | None = None
) -> Cubature:
    """Few points and weights >= 0 whose sums are near those of all points.

    None for integrals that are all zero.

    Args:
        rows: contribution of each of P points to each of R integrals, weights of the quadrature
            included, (R, P).
        tolerance: relative misfit at which the search stops, in [0, 1); 0 continues to the least
            misfit.
        most: largest number of points, from 1, which may not reach the tolerance; None for the
            number of rows.
        start: a cubature of the same candidates for other integrals, such as those of fewer modes,
            to start from.

    Raises:
        ReductionError: for rows that are not finite.

    Example:
        >>> found = fitted(np.array([[1.0, 1.0, 1.0], [0.0, 1.0, 2.0]]), 1e-10)
        >>> found.points, found.weights.round(9), found.misfit < 1e-10
        (array([1]), array([3.]), True)
    """
    lengths = np.sqrt(np.einsum("rp,rp->p", rows, rows))
    if not np.isfinite(lengths).all():
        bad = int(np.argmin(np.isfinite(lengths)))
        raise ReductionError(
            f"the contributions of point {bad} to the rows of a cubature are not finite, or too "
            "large"
        )
    wanted = rows.sum(axis=1)
    size = float(np.linalg.norm(wanted))
    if size == 0:
        return Cubature(np.zeros(0, dtype=np.int64), np.zeros(0), 0.0)
    search = _Search(rows, lengths, wanted)
    most = min(most or len(rows), len(rows))
    if start is not None:
        search.begin(start, most)
    chosen = search.run(tolerance * size, most)
    order = np.argsort(chosen.points)
    points = np.array(chosen.points, dtype=np.int64)[order]
    weights = chosen.weights[order] / lengths[points]
    points = points[weights > 0]
    weights = weights[weights > 0]
    return Cubature(
        points, weights, float(np.linalg.norm(rows[:, points] @ weights - wanted)) / size
    )


def compressed(chunks: Callable[[], Iterable[np.ndarray]], tolerance: float) -> np.ndarray:
    """Fewer rows with nearly the same products: the leading right singular vectors times their
    singular values.

    The singular vectors come from the Gram matrix of the rows, so that memory holds R' P + R^2
    numbers and one chunk, never the whole table. With many rows only a subspace is searched, which
    contains all but a known part: all eigenvectors of 3500 rows took 17 s, those in the subspace 4
    s. Squares lose half of the digits: values below 1e-7 of the largest are round-off. Returns (R',
    P).

    Args:
        chunks: called twice; yields all rows of some points at a time, (R, p) each, in the same
            order both times.
        tolerance: size of the part that may be left out, relative to that of all rows (Frobenius
            norms), in (0, 1).

    Raises:
        ReductionError: for chunks that are not finite, do not fit, or are missing.
    """
    gram = _gram(chunks())
    total = float(np.trace(gram))
    if total == 0:
        return np.hstack([chunk[:0] for chunk in chunks()])
    basis, small = _large_part(gram, SUBSPACE_SHARE * tolerance**2 * total)
    # the sum of all smaller ones is below the part that may be left out, and round-off is below
    # that
    least = max(
        (1 - SUBSPACE_SHARE) * tolerance**2 * total / len(small), np.finfo(float).eps * total
    )
    squares, directions = linalg.eigh(small, subset_by_value=(least, np.inf), check_finite=False)
    directions = directions if basis is None else basis @ directions
    left_out = np.cumsum(np.append(max(total - squares.sum(), 0.0), squares))
    first = int((left_out[1:] <= tolerance**2 * total).sum())
    chosen = np.ascontiguousarray(directions[:, ::-1][:, : squares.size - first].T)
    return np.hstack([chosen @ chunk for chunk in chunks()])


def _gram(chunks: Iterable[np.ndarray]) -> np.ndarray:
    """Sum of the products of rows, (R, R)."""
    gram: np.ndarray | None = None
    for number, chunk in enumerate(chunks):
        if chunk.ndim != 2 or (gram is not None and len(chunk) != len(gram)):
            raise ReductionError(
                f"chunk {number} of the rows of a cubature has shape {chunk.shape}, not (R, p)"
            )
        product = chunk @ chunk.T
        if not np.isfinite(product).all():
            raise ReductionError(
                f"chunk {number} of the rows of a cubature is not finite, or too large"
            )
        gram = product if gram is None else np.add(gram, product, out=gram)
    if gram is None or not gram.size:
        raise ReductionError(
            "a cubature of no rows integrates nothing: give one row for each integral"
        )
    return gram


def _large_part(gram: np.ndarray, outside: float) -> tuple[np.ndarray | None, np.ndarray]:
    """Basis of a subspace (R, k), None for the whole space, and the Gram matrix on it, (k, k).

    It lacks at most ``outside`` of the trace. The subspace is that of images of random vectors
    (Halko, Martinsson and Tropp, 2011, doi 10.1137/090771806), with a fixed seed, and grows by
    blocks.
    """
    count = len(gram)
    generator = np.random.default_rng(0)
    if count <= SKETCHED:
        return None, gram
    basis = np.zeros((count, 0))
    images = np.zeros((count, 0))
    trace = float(np.trace(gram))
    floor = np.finfo(float).eps * count * float(np.trace(gram))
    while trace > max(outside, floor):
        if basis.shape[1] + SUBSPACE_GROWTH > count // 2:  # a subspace saves nothing then
            return None, gram
        block = generator.normal(size=(count, SUBSPACE_GROWTH))
        block = gram @ (block - basis @ (basis.T @ block))
        for _ in range(2):  # twice is enough for orthogonality to round-off
            block, _ = linalg.qr(
                block - basis @ (basis.T @ block), mode="economic", check_finite=False
            )
        image = gram @ block
        basis = np.hstack([basis, block])
        images = np.hstack([images, image])
        trace -= float(np.vdot(block, image))
    return basis, basis.T @ images


class _Factor:
    """QR factor of the chosen columns, each of length one, and the least squares of the integrals
    in them.
    """

    def __init__(self, wanted: np.ndarray) -> None:
        self.wanted = wanted
        self.points: list[int] = []
        self.weights = np.zeros(0)
        self._columns = GrowingColumns(np.zeros((wanted.size, 0)))
        self._q = GrowingColumns(np.zeros((wanted.size, 0)))
        self._r = np.zeros((0, 0), order="F")
        self._changes = 0

    def misfit(self) -> np.ndarray:
        """Misfit of the integrals under the weights, (R,)."""
        return self.wanted - self._columns.all @ self.weights

    def add(self, point: int, column: np.ndarray) -> bool:
        """Add a column with weight zero.

        Args:
            point: its number among the candidates.
            column: its contributions, (R,), of length one.

        Returns:
            False, if it depends on the chosen ones: then nothing is added.
        """
        residual = column
        shares = np.zeros(len(self.points))
        q = self._q.all
        for _ in range(2):  # twice is enough for orthogonality to round-off
            projection = q.T @ residual
            residual = residual - q @ projection
            shares = shares + projection
        length = np.linalg.norm(residual)
        if length <= DEPENDENT_COLUMN:
            return False
        count = len(self.points)
        r = np.zeros((count + 1, count + 1), order="F")
        r[:count, :count] = self._r
        r[:count, count] = shares
        r[count, count] = length
        self._q.append(residual / length)
        self._r = r
        self._columns.append(column)
        self.points.append(point)
        self.weights = np.append(self.weights, 0.0)
        self._changed()
        return True

    def take(self, points: np.ndarray, columns: np.ndarray, weights: np.ndarray) -> None:
        """Start with some columns; those that depend on others are left out.

        Args:
            points: their numbers among the candidates, (n,).
            columns: their contributions, (R, n), n <= R.
            weights: weight of each, (n,), > 0.
        """
        q, r, order = linalg.qr(columns, mode="economic", pivoting=True, check_finite=False)
        independent = np.abs(np.diag(r)) > DEPENDENT_COLUMN
        order = order[: int(independent.sum())]
        self._q = GrowingColumns(q[:, : order.size])
        self._r = np.asfortranarray(r[: order.size, : order.size])
        self._columns = GrowingColumns(columns[:, order])
        self.points = [int(point) for point in points[order]]
        self.weights = weights[order]

    def remove(self, place: int) -> None:
        """Remove the column at an index."""
        count = len(self.points) - 1
        q, r = linalg.qr_delete(self._q.all, self._r, place, which="col", check_finite=False)
        self._q, self._r = (
            GrowingColumns(q[:, :count]),
            r[:count],
        )  # a square factor keeps the remaining columns
        self._columns = GrowingColumns(np.delete(self._columns.all, place, axis=1))
        self.weights = np.delete(self.weights, place)
        del self.points[place]
        self._changed()

    def least_squares(self) -> np.ndarray:
        """Weights of any sign that give the least misfit."""
        return linalg.solve_triangular(self._r, self._q.all.T @ self.wanted, check_finite=False)

    def _changed(self) -> None:
        self._changes += 1
        if self._changes % REFRESHED == 0 and self.points:
            q, self._r = linalg.qr(self._columns.all, mode="economic", check_finite=False)
            self._q = GrowingColumns(q)


class _ShortList:
    """Candidates parallel to a misfit, with their columns, each of length one.

    It has the most parallel one of each block of successive points: the best of all would be
    neighbours in the mesh, with nearly equal columns.
    """

    def __init__(self, rows: np.ndarray, lengths: np.ndarray, misfit: np.ndarray) -> None:
        inverse = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0)
        along = (misfit @ rows) * inverse
        blocks = np.arange(0, along.size, -(-along.size // LISTED))
        highest = np.maximum.reduceat(along, blocks)
        sizes = np.diff(np.append(blocks, along.size))
        self.points = np.flatnonzero(along == np.repeat(highest, sizes))
        self.best = float(highest.max())
        self.columns = rows[:, self.points] * inverse[self.points]

    def along(self, misfit: np.ndarray, left_out: set[int]) -> np.ndarray:
        """Cosines of the columns with a misfit; -inf for points left out.

        Args:
            misfit: misfit of the integrals, (R,).
            left_out: numbers of points to leave out.
        """
        along = misfit @ self.columns
        along[np.isin(self.points, list(left_out))] = -np.inf
        return along


class _Search:
    """Lawson and Hanson's iteration on rows, (R, P), with lengths of their columns, (P,), for the
    integrals, (R,).
    """

    def __init__(self, rows: np.ndarray, lengths: np.ndarray, wanted: np.ndarray) -> None:
        self.rows = rows
        self.lengths = lengths
        self.factor = _Factor(wanted)
        self.least = self.size = float(np.linalg.norm(wanted))
        self.tried: set[int] = set()

    def run(self, tolerance: float, most: int) -> _Factor:
        """Add points until the misfit is at most ``tolerance``, there are ``most``, or none reduces
        it.
        """
        floor = LEAST_MISFIT * self.size
        remaining = MOST_POINTS_PER_ROW * len(self.rows)

        def open_() -> bool:
            return remaining > 0 and self.least > tolerance and len(self.factor.points) < most

        while open_():
            listed = _ShortList(self.rows, self.lengths, self.factor.misfit())
            worth = floor
            helped = False
            while open_() and self._take_best(listed, worth):
                worth = max(floor, WORTH * listed.best)
                helped = True
                remaining -= 1
            if not helped:
                break
        return self.factor

    def begin(self, start: Cubature, most: int) -> None:
        """Start from the points of another cubature, with the best weights for them.

        Args:
            start: the other cubature.
            most: largest number of points.
        """
        heavy = np.argsort(-start.weights * self.lengths[start.points], kind="stable")[:most]
        points = start.points[heavy]
        points = points[self.lengths[points] > 0]
        weights = dict(zip(start.points, start.weights, strict=True))
        lengths = self.lengths[points]
        self.factor.take(
            points, self.rows[:, points] / lengths, np.array([weights[k] for k in points]) * lengths
        )
        self._settle()
        self.least = float(np.linalg.norm(self.factor.misfit()))

    def _settle(self) -> None:
        """Compute weights of the least misfit on the chosen points.

        Remove points with negative weights.
        """
        free = self.factor.least_squares()
        while free.size and not free.min() > 0:
            self._step_to_zero(free)
            free = self.factor.least_squares()
        self.factor.weights = free

    def _take_best(self, listed: _ShortList, worth: float) -> bool:
        """Add the best point of the list that reduces the misfit.

        Returns False if none of enough worth does.
        """
        while True:
            along = listed.along(self.factor.misfit(), self.tried.union(self.factor.points))
            # of points that are alike the first: round-off, which processors change, chooses none
            alike = np.flatnonzero(along >= (1 - SAME_WORTH) * along.max())
            best = int(alike[listed.points[alike].argmin()]) if alike.size else 0
            if not along[best] > worth:
                return False
            if self._brought_in(int(listed.points[best]), listed.columns[:, best]):
                self.tried.clear()
                return True
            self.tried.add(int(listed.points[best]))

    def _brought_in(self, point: int, column: np.ndarray) -> bool:
        """Try a point; returns True if it reduced the misfit. Other points may be removed."""
        factor = self.factor
        if not factor.add(point, column):
            return False
        free = factor.least_squares()
        if not free[-1] > 0:  # only by round-off: its part along the misfit is positive
            factor.remove(len(factor.points) - 1)
            return False
        self._settle()
        before = self.least
        self.least = float(np.linalg.norm(factor.misfit()))
        return self.least < before

    def _step_to_zero(self, free: np.ndarray) -> None:
        """Move towards weights of any sign until the first becomes zero, and remove the points
        where it does.
        """
        factor = self.factor
        negative = free <= 0
        ways = np.full(free.size, np.inf)
        down = factor.weights[negative] - free[negative]
        ways[negative] = np.divide(
            factor.weights[negative], down, out=np.zeros_like(down), where=down > 0
        )
        step = ways.min()
        factor.weights = factor.weights + step * (free - factor.weights)
        for index in np.flatnonzero(ways <= step * (1 + 1e-12))[::-1]:
            factor.remove(int(index))
