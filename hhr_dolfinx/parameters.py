"""Parameters of a scene and the amplitudes of its loads, as plain data.

Every load of a scene is a sum of terms, each an amplitude times a fixed shape. The amplitudes
theta(mu) = (1, theta_1(mu), ..., theta_T(mu)) are affine in the parameters, or values that say by numbers what they
are, so a model on disk is data only and nothing that is loaded is ever executed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from hhr_dolfinx.errors import ParameterError, SceneError

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix


def is_number(value) -> bool:
    """Whether a value is a finite real number; text and truth values are none."""
    if not isinstance(value, Real) or isinstance(value, bool | np.bool_):
        return False
    try:
        return bool(np.isfinite(float(value)))
    except OverflowError:
        return False


def is_whole(value, least: int) -> bool:
    """Whether a value is an integer of at least ``least``; 2.0 and True are none."""
    return isinstance(value, Integral) and not isinstance(value, bool) and value >= least


def as_tuple(name: str, value: Any) -> tuple:
    """A tuple of a list or an array; a single item is refused.

    Raises:
        SceneError: for what is no sequence.
    """
    if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray):
        raise SceneError(f"{name} must be a tuple, and is {value!r}: write ({type(value).__name__}(...),) for one item")
    return tuple(value.tolist() if isinstance(value, np.ndarray) else value)


def check_tag(what: str, tag: Any) -> None:
    """Refuse what is no tag of a mesh.

    Raises:
        SceneError: if it is not an integer of at least 0.
    """
    if not is_whole(tag, 0):
        raise SceneError(f"the tag {tag!r} of a {what} must be an integer, as in the mesh")


def check_amplitude(item: Any, what: str) -> None:
    """Turn a number that is the amplitude of a frozen item into a constant amplitude, and refuse what is neither.

    Raises:
        SceneError: with what would do.
    """
    if is_number(item.amplitude):
        object.__setattr__(item, "amplitude", Amplitude(item.amplitude))
    if not isinstance(item.amplitude, Amplitude):
        raise SceneError(
            f"the amplitude {item.amplitude!r} of {what} must be a finite number or an Amplitude, for instance "
            "Amplitude(slopes={'name of a parameter': 1.0})"
        )


@dataclass(frozen=True)
class Amplitude:
    """Affine function of the parameters: ``constant + sum(slopes[name] * value of name)``."""

    constant: float = 0.0
    slopes: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self):
        """Refuse what is no finite number."""
        if not isinstance(self.slopes, Mapping):
            raise SceneError(f"the slopes {self.slopes!r} of an amplitude need a number by parameter: {{'name': 1.0}}")
        if not all(is_number(value) for value in (self.constant, *self.slopes.values())):
            raise SceneError(f"amplitude {self.constant!r} with slopes {dict(self.slopes)} must be finite numbers")

    def row(self, space: ParameterSpace) -> np.ndarray:
        """Slopes in the order of the parameters, (P,).

        Raises:
            SceneError: if a slope names an unknown parameter.
        """
        unknown = set(self.slopes) - set(space.names)
        if unknown:
            raise SceneError(f"an amplitude names {sorted(unknown)}, the scene's parameters are {space.names}")
        return np.array([self.slopes.get(name, 0.0) for name in space.names])


@dataclass(frozen=True)
class ParameterSpace:
    """The box in which a scene is solved.

    Attributes:
        names: one name per parameter.
        lower: smallest value of each parameter, in its unit.
        upper: largest value of each parameter.

    Raises:
        SceneError: if a name stands twice, the lengths differ, or a bound is not finite or not below its partner.
    """

    names: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self):
        """Check the box once, and keep its bounds as arrays for the queries."""
        for part in ("names", "lower", "upper"):
            object.__setattr__(self, part, self._as_tuple(part))
        if len(set(self.names)) < len(self.names):
            raise SceneError(f"a parameter is named twice in {self.names}: each needs a name of its own")
        if not self.names or not len(self.names) == len(self.lower) == len(self.upper):
            raise SceneError(f"parameters {self.names} need one lower and one upper bound each")
        if not all(is_number(value) for value in (*self.lower, *self.upper)):
            raise SceneError(f"bounds {self.lower} .. {self.upper} of {self.names} must be finite numbers")
        bounds = np.array([self.lower, self.upper], dtype=float)
        if not (bounds[0] < bounds[1]).all():
            raise SceneError(f"bounds {self.lower} .. {self.upper} of {self.names} must be increasing")
        # room for round-off in grids that end on the bounds
        slack = 1e-12 * (bounds[1] - bounds[0])
        object.__setattr__(
            self, "_box", list(zip((bounds[0] - slack).tolist(), (bounds[1] + slack).tolist(), strict=True))
        )

    def _as_tuple(self, part):
        """A field as a tuple, whatever sequence was given."""
        value, kind = getattr(self, part), str if part == "names" else Real
        if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray):
            raise SceneError(
                f"{part} = {value!r} of a parameter space must be a tuple: for one parameter, ({value!r},)"
            )
        items = tuple(value.tolist() if isinstance(value, np.ndarray) else value)
        if not all(isinstance(item, kind) for item in items):
            raise SceneError(
                f"{part} = {value!r} of a parameter space must hold {'names' if kind is str else 'numbers'}"
            )
        return items

    def point(self, mu) -> np.ndarray:
        """Turn a number, a sequence or a mapping by name into a checked point, shape (P,).

        Raises:
            ParameterError: for a wrong length, a missing name, NaN, or a value outside the box.
        """
        if isinstance(mu, Mapping):
            missing = set(self.names) ^ set(mu)
            if missing:
                raise ParameterError(f"parameters {sorted(missing)} do not match {self.names}")
            mu = [mu[name] for name in self.names]
        try:
            point = np.array(mu, dtype=float, ndmin=1)
        except (TypeError, ValueError, OverflowError):
            raise ParameterError(f"expected {len(self.names)} numbers for {self.names}, got {mu!r}") from None
        if point.shape != (len(self.names),):
            raise ParameterError(f"expected {len(self.names)} parameters {self.names}, got shape {point.shape}")
        for value, (low, high) in zip(point.tolist(), self._box):  # noqa: B905 (hot path)
            if not low <= value <= high:  # NaN fails too
                raise ParameterError(self._complaint(point))
        return point

    def _complaint(self, point):
        lines = [
            f"{name} = {value:g} is outside [{low:g}, {high:g}]"
            for name, value, low, high in zip(self.names, point, self.lower, self.upper, strict=True)
            if not low <= value <= high
        ]
        return "; ".join(lines) + ": widen the parameter space and train again, or choose a value inside"

    def described(self, point: np.ndarray) -> str:
        """A point in words, for messages."""
        return ", ".join(f"{name} = {value:g}" for name, value in zip(self.names, point, strict=True))

    def points(self, table) -> np.ndarray:
        """Turn a table with one row per point into checked points, (S, P); with one parameter (S,) will do.

        Raises:
            ParameterError: for another shape, what is no number, or a value outside the box.
        """
        try:
            points = np.array(table, dtype=float)
        except (TypeError, ValueError):
            raise ParameterError(f"a table of points needs numbers in columns {self.names}, got {table!r}") from None
        count = len(self.names)
        if points.ndim == 1 and count == 1:
            points = points[:, None]
        if points.ndim != 2 or points.shape[1] != count or not points.size:
            raise ParameterError(
                f"points have the shape {points.shape}: give one row per point and one column for each of {self.names}"
            )
        for point in points:
            self.point(point)
        return points

    def grid(self, counts: Sequence[int]) -> np.ndarray:
        """Regular grid with ``counts`` points along each parameter, shape (prod(counts), P).

        Raises:
            ParameterError: if there is not one positive count for each parameter.
        """
        given = list(counts) if isinstance(counts, Sequence | np.ndarray) else [counts]
        if len(given) != len(self.names) or not all(is_whole(count, 1) for count in given):
            raise ParameterError(
                f"counts {counts!r} of a grid must be {len(self.names)} positive integers, one for each of {self.names}"
            )
        axes = [np.linspace(low, high, count) for low, high, count in zip(self.lower, self.upper, given, strict=True)]
        return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)

    def random(self, count: int, seed: int) -> np.ndarray:
        """Uniform random points of the box, shape (count, P), the same for the same seed.

        Raises:
            ParameterError: if the count is not positive or the seed negative.
        """
        if not is_whole(count, 1) or not is_whole(seed, 0):
            raise ParameterError(
                f"{count!r} random points from seed {seed!r}: the count must be a positive integer, "
                "the seed an integer that is not negative"
            )
        return np.random.default_rng(seed).uniform(self.lower, self.upper, (count, len(self.names)))


class Theta:
    """Amplitudes of all terms at one parameter, of which most may be zero.

    ``matrix @ theta`` sums the columns of a matrix with one column per term, dense or sparse; it touches only the
    columns of non-zero terms and is fastest on dense matrices in Fortran order and on sparse ones by columns (csc).

    Attributes:
        terms: numbers of the terms that are given, each once; a slice for all.
        values: their amplitudes.
    """

    __slots__ = ("terms", "values")
    __array_ufunc__ = None  # lets ndarray @ Theta come here; sparse matrices leave to it what they do not know

    def __init__(self, terms: slice | np.ndarray, values: np.ndarray):
        self.terms, self.values = terms, values

    def __rmatmul__(self, matrix: np.ndarray | csc_matrix) -> np.ndarray:
        """Sum the columns of ``matrix``, (n, 1 + T) -> (n,)."""
        if isinstance(matrix, np.ndarray):
            return matrix[:, self.terms] @ self.values
        if isinstance(self.terms, slice):
            return matrix @ self.values
        matrix = matrix.tocsc()
        total, starts = np.zeros(matrix.shape[0]), matrix.indptr
        for term, value in zip(self.terms.tolist(), self.values.tolist(), strict=True):
            entries = slice(starts[term], starts[term + 1])
            # the rows of one column are distinct
            total[matrix.indices[entries]] += matrix.data[entries] * value
        return total


class NonAffine(Protocol):
    """Amplitudes of several columns of a load that are not affine in the parameters; a frozen dataclass of numbers.

    Files and fingerprints of problems know it by its class and its fields.

    Attributes:
        count: number of its columns.
    """

    count: int

    def __call__(self, point: np.ndarray) -> tuple[Sequence[int], Sequence[float]]:
        """Numbers among its own columns, each once, and the amplitudes of those that act at a point (P,)."""


@dataclass(frozen=True)
class Amplitudes:
    """All amplitudes of a scene: affine ones, constant + slopes @ mu, then those that are not.

    Attributes:
        constant: (1 + T0,), whose first entry is the 1 of the parameter-free part.
        slopes: (1 + T0, P).
        nonaffine: amplitudes of several terms each, one after another.
    """

    constant: np.ndarray
    slopes: np.ndarray
    nonaffine: tuple[NonAffine, ...] = ()

    @classmethod
    def collect(
        cls, amplitudes: Sequence[Amplitude], space: ParameterSpace, nonaffine: Sequence[NonAffine] = ()
    ) -> Amplitudes:
        """Stack single affine amplitudes behind the leading constant 1, and the others behind these.

        Raises:
            SceneError: if a slope names an unknown parameter.
        """
        rows = [amplitude.row(space) for amplitude in amplitudes]
        constant = np.array([1.0] + [amplitude.constant for amplitude in amplitudes])
        return cls(constant, np.array([np.zeros(len(space.names)), *rows]), tuple(nonaffine))

    @cached_property
    def firsts(self) -> list[int]:
        """Number of the first term of each amplitude that is not affine, and behind them that of all terms."""
        return np.cumsum([self.constant.size, *(amplitude.count for amplitude in self.nonaffine)]).tolist()

    def __call__(self, point: np.ndarray) -> Theta:
        """Evaluate theta at a checked point."""
        affine = self.constant + self.slopes @ point
        if not self.nonaffine:
            return Theta(slice(None), affine)
        terms, values = list(range(affine.size)), affine.tolist()
        for first, amplitude in zip(self.firsts, self.nonaffine):  # noqa: B905 (hot path; the last is their end)
            columns, weights = amplitude(point)
            terms.extend([first + column for column in columns])
            values.extend(weights)
        return Theta(np.array(terms), np.array(values, dtype=float))

    def sum_columns(self, matrix: np.ndarray | csc_matrix, points: np.ndarray) -> np.ndarray:
        """``matrix @ theta`` at every point, (n, len(points))."""
        return np.stack([matrix @ self(point) for point in points], axis=1)

    def idle(self, space: ParameterSpace) -> tuple[str, ...]:
        """Names of parameters on which no amplitude depends; those that are not affine are tried at random points."""
        used = self.slopes.any(axis=0)
        points = space.random(64, seed=0)
        for place in np.flatnonzero(~used):
            changed = points.copy()
            changed[:, place] = np.roll(points[:, place], 1)
            used[place] = any(
                not np.array_equal(one, two)
                for amplitude in self.nonaffine
                for pair in zip(points, changed, strict=True)
                for one, two in zip(*map(amplitude, pair), strict=True)
            )
        return tuple(name for name, known in zip(space.names, used, strict=True) if not known)
