"""Interpolation of smooth functions of a few parameters by polynomials on adaptive sparse grids.

Each polynomial has a level per axis and adds one node, so that a function of d parameters costs as
many evaluations as it has terms. Nodes along an axis are Leja points, which are nested and nearly
as good as Chebyshev's. The next term is chosen by its surplus, the error of the interpolation so
far at its node (T. Gerstner and M. Griebel, Computing 71, 2003; A. Chkifa, A. Cohen and C. Schwab,
Found. Comput. Math. 14, 2014).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Annotated

import numpy as np
from scipy.linalg import solve_triangular, svd

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import SceneError

MOST_LEVELS = 40
"""Most nodes along one axis."""
FIRST_LEVELS = 2
"""Levels along each axis that are always included: one surplus may vanish by chance, two hardly
do.
"""

RANDOM_WEIGHTS = 2
"""Points of the final check of an interpolation against its function."""
FINAL_CHECK_ERROR = 10.0
"""Error allowed there, in tolerances."""
FAR = 30.0
"""Error allowed in tolerances at the worst of thousands of places.

Two random places miss the corners of a box.
"""


@cache
def leja_points() -> tuple[float, ...]:
    """Leja points of [-1, 1]: each one is farthest from those before, by the product of distances.

    The first is 0.
    """
    candidates = np.cos(np.linspace(0, np.pi, 20_001))
    points = [0.0]
    product = np.abs(candidates)
    while len(points) < MOST_LEVELS:
        points.append(float(candidates[product.argmax()]))
        product = product * np.abs(candidates - points[-1])
    return tuple(points)


@dataclass(frozen=True)
class Interpolant:
    """A vector-valued polynomial, sum of ``modes @ weights[:, k] h_k``."""

    axes: Annotated[Integers, "axes", "< P"]  #: indices of its d parameters in a point, (d,)
    lower: Annotated[Floats, "axes"]  #: their box, (d,), as the next
    upper: Annotated[Floats, "axes"]
    #: of each polynomial along each axis, (n, d)
    levels: Annotated[Integers, "polynomials", "axes"]
    #: directions of the values; fastest in Fortran order
    modes: Annotated[Floats, "values", "rank"]
    weights: Annotated[Floats, "rank", "polynomials"]  #: of the polynomials along them, (r, n)

    def __post_init__(self) -> None:
        d = self.axes.size
        rank, n = self.weights.shape
        fits = self.lower.shape == self.upper.shape == (d,) and self.levels.shape == (n, d)
        if (
            not fits
            or self.modes.ndim != 2
            or self.modes.shape[1] != rank
            or not (self.lower < self.upper).all()
        ):
            raise SceneError(
                f"an interpolation over {d} parameters of {n} polynomials has arrays of other sizes"
            )
        if self.levels.size and not 0 <= self.levels.min() <= self.levels.max() < MOST_LEVELS:
            raise SceneError(
                f"levels of an interpolation must be whole numbers from 0 to {MOST_LEVELS - 1}"
            )

    @cached_property
    def _bases(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes and denominators of the polynomials along an axis, (L,) each.

        They go up to the largest level.
        """
        return _bases_up_to(int(self.levels.max(initial=0)))

    def value(self, point: np.ndarray) -> np.ndarray:
        """Value at a point of the whole box, (M,)."""
        return self.modes @ self.along_modes(point)

    def along_modes(self, point: np.ndarray) -> np.ndarray:
        """Components of the value along the modes, (r,)."""
        return self.weights @ self.polynomials(point)

    def many_along_modes(self, points: np.ndarray) -> np.ndarray:
        """Components along the modes at many points, (n, P): (n, r)."""
        scaled = 2 * (points[:, self.axes] - self.lower) / (self.upper - self.lower) - 1
        return polynomials_of(self.levels, scaled) @ self.weights.T

    def slopes_along_modes(self, point: np.ndarray) -> np.ndarray:
        """Derivatives of these components along its axes, (r, d)."""
        if not self.axes.size:
            return np.zeros((len(self.weights), 0))
        sides = (self.upper - self.lower).tolist()
        columns = [
            self.weights @ (self.polynomials(point, k) * 2 / side) for k, side in enumerate(sides)
        ]
        return np.stack(columns, axis=1)

    @property
    def nodes(self) -> np.ndarray:
        """Coordinates along its axes at which the function was evaluated, (n, d).

        They are in the order of the polynomials.
        """
        return self.lower + (nodes_of(self.levels) + 1) / 2 * (self.upper - self.lower)

    def polynomials(self, point: np.ndarray, derived: int = -1) -> np.ndarray:
        """All polynomials at a point, (n,), or their derivatives along one of the axes.

        Args:
            point: parameters, (P,).
            derived: index of the axis along which all polynomials are differentiated; -1 for
                values.
        """
        product = np.ones(len(self.levels))
        scaled = 2 * (point[self.axes] - self.lower) / (self.upper - self.lower) - 1
        for axis, x in enumerate(scaled):
            values, slopes = _one_dimensional(float(x), *self._bases)
            product = product * (slopes if axis == derived else values)[self.levels[:, axis]]
        return product


@cache
def _bases_up_to(level: int) -> tuple[np.ndarray, np.ndarray]:
    nodes = np.array(leja_points()[: level + 1])
    return nodes, np.array([np.prod(nodes[k] - nodes[:k]) for k in range(level + 1)])


def _one_dimensional(
    x: float, nodes: np.ndarray, sizes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """h_k(x) = prod_{i<k} (x - z_i) / (z_k - z_i) and their slopes, (L,) each."""
    values = [1.0]
    slopes = [0.0]
    for node in nodes[:-1].tolist():
        slopes.append(slopes[-1] * (x - node) + values[-1])
        values.append(values[-1] * (x - node))
    return np.array(values) / sizes, np.array(slopes) / sizes


def polynomials_of(levels: np.ndarray, scaled: np.ndarray) -> np.ndarray:
    """Polynomials at points of [-1, 1]^d, (k, n).

    Args:
        levels: level of each polynomial along each axis, (n, d).
        scaled: points in [-1, 1]^d, (k, d).
    """
    products = np.ones((len(scaled), len(levels)))
    for x, along in zip(scaled.T, levels.T, strict=True):
        nodes, sizes = _bases_up_to(int(along.max(initial=0)))
        table = np.ones((len(nodes), len(x)))
        for k, node in enumerate(nodes[:-1]):
            table[k + 1] = table[k] * (x - node)
        products *= (table / sizes[:, None])[along].T
    return products


def nodes_of(levels: np.ndarray) -> np.ndarray:
    """The node in [-1, 1]^d that each polynomial adds, of the shape of the levels, (n, d)."""
    return np.array(leja_points())[levels]


def values_between(levels: np.ndarray, known: np.ndarray, scaled: np.ndarray) -> np.ndarray:
    """Values of the interpolation at points of [-1, 1]^d, (k, v).

    Args:
        levels: levels of the polynomials, (n, d).
        known: values at the nodes of these levels, (n, v).
        scaled: points in [-1, 1]^d, (k, d).
    """
    # each polynomial vanishes at the nodes before its node
    surpluses = solve_triangular(polynomials_of(levels, nodes_of(levels)), known, lower=True)
    return polynomials_of(levels, scaled) @ surpluses


def unstacked(values: np.ndarray, shapes: Iterable[tuple[int, ...]]) -> list[np.ndarray]:
    """Views of arrays that were stacked row by row.

    Args:
        values: the stacked rows, (rows, ...).
        shapes: shapes of the arrays, each without the further axes of ``values``.

    Returns:
        The arrays, in their shapes followed by the further axes of ``values``.
    """
    shapes = list(shapes)
    blocks = np.split(values, np.cumsum([math.prod(shape) for shape in shapes]))
    return [
        block.reshape((*shape, *values.shape[1:]))
        for block, shape in zip(blocks, shapes, strict=False)
    ]


def probes_of(dimension: int) -> np.ndarray:
    """Random points of [-1, 1]^d, (n, d).

    No function of interest vanishes there unless it is zero.
    """
    return np.random.default_rng(0).uniform(-1, 1, (RANDOM_WEIGHTS, dimension))


@dataclass(frozen=True)
class GrownGrid:
    """Result of the growth of a sparse grid."""

    interpolant: Interpolant  #: the interpolation
    surplus: (
        float  # largest surplus of the terms tried last, or error elsewhere, relative to the values
    )
    evaluations: int  #: number of evaluations of the function
    unresolved: float = (
        0.0  # largest error of a cheap function that depends on the parameters as this one does
    )


def grow(
    function: Callable[[np.ndarray], np.ndarray],
    scale: Callable[[np.ndarray], float],
    box: tuple[np.ndarray, np.ndarray, np.ndarray],
    tolerance: float,
    budget: int,
    *,
    compressed: bool = True,
    least: int = 0,
    everywhere: Callable[[np.ndarray], float] | None = None,
) -> GrownGrid:
    """Interpolate a function, term by term, until the surplus of the next terms is small.

    Args:
        function: maps parameters, (d,), to values, (M,).
        scale: size of a surplus, (M,), relative to that of the values.
        box: axes, lower and upper ends, (d,) each.
        tolerance: target surplus.
        budget: most evaluations.
        compressed: keep only the directions of the values that the tolerance needs, not all of
            them.
        least: number of terms to include in any case.
        everywhere: maps levels of polynomials, (n, d), to the largest error that they leave in a
            cheap function at thousands of points: a few places do not detect spikes between them.
            None if there is no such function.
    """
    axes, lower, upper = box
    growing = _Growing(function, scale, lower, upper)

    def unresolved() -> float:
        return 0.0 if everywhere is None else everywhere(growing.levels)

    missed = last = 0.0
    while growing.waiting and len(growing.order) < budget:
        chosen = growing.next()
        if (
            growing.waiting[chosen] <= tolerance
            and not growing.is_early(chosen)
            and len(growing.order) >= least
        ):
            missed = max(growing.off(), unresolved() * FINAL_CHECK_ERROR / FAR)
            if missed <= FINAL_CHECK_ERROR * tolerance:
                missed = last = 0.0
                break
            # no surplus shows where the error is: one more level along every axis
            growing.waiting = dict.fromkeys(growing.waiting, missed)
        last = growing.follow(chosen, budget)
    values = growing.surplus_columns()
    order = growing.order
    modes, weights = (
        _compressed(values, tolerance * 0.1) if compressed else (values, np.eye(len(order)))
    )
    grown = Interpolant(axes, lower, upper, growing.levels, modes, weights)
    # if the budget ends the growth, the next terms are unknown; the surplus of the last one stands
    # for them
    final_surplus = (
        max(*growing.ended, *growing.waiting.values(), missed, last) if axes.size else 0.0
    )
    return GrownGrid(grown, final_surplus, len(order) + len(growing.probes), unresolved())


@dataclass
class _Growing:
    """Terms of an interpolation as it grows; see :func:`grow` for the first four."""

    function: Callable[[np.ndarray], np.ndarray]
    scale: Callable[[np.ndarray], float]
    lower: np.ndarray
    upper: np.ndarray
    order: list[tuple[int, ...]] = field(default_factory=list)  #: levels of the terms
    surpluses: list[np.ndarray] = field(default_factory=list)  #: of each term
    waiting: dict[tuple[int, ...], float] = field(
        default_factory=dict
    )  #: their sizes, if no successor was tried
    ended: list[float] = field(
        default_factory=lambda: [0.0]
    )  #: the same of terms that no longer axis could follow
    probes: list[tuple[np.ndarray, np.ndarray]] = field(
        default_factory=list
    )  #: random places, and the function there

    def __post_init__(self) -> None:
        self._try((0,) * self.lower.size)

    @property
    def levels(self) -> np.ndarray:
        """Levels of the terms, (n, d)."""
        return np.array(self.order, dtype=np.int64).reshape(len(self.order), len(self.lower))

    def next(self) -> tuple[int, ...]:
        """The next term: first the levels that are always included, then by the largest surplus."""
        early = [levels for levels in self.waiting if self.is_early(levels)]
        return early[0] if early else max(self.waiting, key=self.waiting.__getitem__)

    @staticmethod
    def is_early(levels: tuple[int, ...]) -> bool:
        """True if a term is always followed."""
        return sum(levels) < FIRST_LEVELS and int(np.count_nonzero(levels)) <= 1

    def follow(self, chosen: tuple[int, ...], budget: int) -> float:
        """Try the successors of a term, and return its surplus.

        Args:
            chosen: levels of the term, which is no longer waiting.
            budget: most terms.
        """
        surplus = self.waiting.pop(chosen)
        for axis in range(len(chosen)):
            after = (*chosen[:axis], chosen[axis] + 1, *chosen[axis + 1 :])
            if after[axis] == MOST_LEVELS:
                self.ended.append(surplus)
            elif _admissible(after, self.order) and len(self.order) < budget:
                self._try(after)
        return surplus

    def surplus_columns(self) -> np.ndarray:
        """All surpluses as columns, (M, n).

        The list is emptied, since it may take half of the memory.
        """
        columns = np.empty((self.surpluses[0].size, len(self.surpluses)), order="F")
        for index in range(len(self.surpluses)):
            columns[:, index] = self.surpluses[index]
            self.surpluses[index] = np.zeros(0)
        return columns

    def off(self) -> float:
        """Largest error at random places: a term that vanishes at its node hides its successors."""
        if not self.probes and len(self.lower):
            self.probes = [
                (position, self._at(position)) for position in probes_of(len(self.lower))
            ]
        return max(
            (self.scale(self._left(value, position)) for position, value in self.probes),
            default=0.0,
        )

    def _try(self, levels: tuple[int, ...]) -> None:
        node = nodes_of(np.array(levels, dtype=np.int64))
        surplus = self._left(self._at(node), node)
        self.order.append(levels)
        self.surpluses.append(surplus)
        self.waiting[levels] = self.scale(surplus)

    def _at(self, place: np.ndarray) -> np.ndarray:
        return self.function(self.lower + (place + 1) / 2 * (self.upper - self.lower))

    def _left(self, value: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Residual of a value after all terms."""
        factors = polynomials_of(self.levels, place[None])[0]
        for k in np.flatnonzero(factors):
            value = value - factors[k] * self.surpluses[k]
        return value


def _admissible(levels: tuple[int, ...], order: list[tuple[int, ...]]) -> bool:
    """True if all terms one level below are there, and this one is not."""
    if levels in order:
        return False
    return all(
        (*levels[:axis], level - 1, *levels[axis + 1 :]) in order
        for axis, level in enumerate(levels)
        if level > 0
    )


def _compressed(values: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Few directions for all columns.

    The remainder is less than ``tolerance`` of the largest singular value.
    """
    modes, sizes, weights = svd(values, full_matrices=False, overwrite_a=True)
    rank = max(1, int((sizes > tolerance * sizes[0]).sum()))
    modes *= sizes
    return np.asfortranarray(modes[:, :rank]), np.ascontiguousarray(weights[:rank])
