"""Parameters of a scene: the box, and checks of numbers, names and tags."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral, Real
from typing import Annotated, Any, Protocol, TypeGuard, TypeVar

import numpy as np

from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import ParameterError, SceneError, StudyError

PointLike = float | Sequence[float] | Mapping[str, float] | np.ndarray
"""A point of the box as users give it: a number, a sequence, or values by name, see
:func:`named_values`.
"""
PointsLike = (
    Sequence[float]
    | Sequence[Sequence[float]]
    | Mapping[str, float | Sequence[float] | np.ndarray]
    | Sequence[Mapping[str, float]]
    | np.ndarray
)
"""Several points of the box: one row each, (S, P), with one parameter also (S,).

Or columns or rows with names.
"""

T = TypeVar("T")

PLAIN = frozenset({float, int, np.float64})
"""Types of numbers that need no conversion."""
LINE_POINTS = 2001
"""Points along a parameter at which formulas are checked: a spike a thousandth of the box wide has
two of them.
"""


def is_number(value: object) -> TypeGuard[float]:
    """True for a finite real number; text and booleans are none."""
    if not isinstance(value, Real) or isinstance(value, bool | np.bool_):
        return False
    try:
        return bool(np.isfinite(float(value)))
    except OverflowError:
        return False


def is_whole(value: object, least: int) -> TypeGuard[int]:
    """True for an integer of at least ``least``; 2.0 and True are none.

    Args:
        value: value to check.
        least: smallest integer that is accepted.
    """
    return isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= least


def as_tuple(name: str, value: Sequence[T] | np.ndarray) -> tuple[T, ...]:
    """Convert a list or an array to a tuple.

    Args:
        name: name of the value, for the message.
        value: list, tuple or array.

    Raises:
        SceneError: for a single item.
    """
    if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray):
        raise SceneError(
            f"{name} must be a tuple, and is {value!r}: write ({type(value).__name__}(...),) for "
            "one item"
        )
    return tuple(value.tolist() if isinstance(value, np.ndarray) else value)


Tag = int | str
"""Tag of cells or facets: a number in the mesh, or a name if the mesh has names."""


class Place(Protocol):
    """Nodes where a displacement is imposed or a force acts, chosen by their coordinates."""

    def nodes(self, points: np.ndarray) -> np.ndarray:
        """Numbers of the chosen ones of all nodes of the mesh, (n, dim)."""


def check_place(what: str, place: Tag | Place) -> None:
    """Check a place of a mesh.

    Args:
        what: name of its owner, for the message.
        place: a tag, or a :class:`Place`.

    Raises:
        SceneError: for anything else.
    """
    if not hasattr(place, "nodes"):
        check_tag(what, place)


def check_tag(what: str, tag: Tag | Place) -> None:
    """Check a tag of a mesh.

    Args:
        what: name of its owner, for the message.
        tag: the tag.

    Raises:
        SceneError: if it is no number from 0 on and no name.
    """
    if not is_whole(tag, 0) and not (isinstance(tag, str) and tag.strip()):
        raise SceneError(
            f"the tag {tag!r} of a {what} must be an integer or a name, as in the mesh"
        )


def named_values(table: Any) -> dict[str, Any] | None:
    """Values by name of an object that has names: a value for each name, or a column, (S,).

    Mappings, data sets, frames, series and structured arrays have names, and so have named tuples
    and tables with ``columns`` or ``column_names``. The order of the names has no meaning. None for
    numbers and sequences, and for frames and series whose labels are integers: their values are in
    the order of the parameters.

    Raises:
        ParameterError: for a labelled array with ``coords``, whose names may be on any axis.
    """
    if fields := getattr(table, "_fields", None):
        return dict(zip(fields, table, strict=True))
    if names := getattr(getattr(table, "dtype", None), "names", None):
        return {name: table[name] for name in names}
    if isinstance(table, np.ndarray):
        return None
    if hasattr(table, "coords") and not hasattr(table, "keys") and np.ndim(table):
        raise ParameterError(
            "a labelled array does not say on which axis the parameters are: give a data set with "
            "a variable for each, to_dataset(dim=...), or its values without labels"
        )
    labels = getattr(table, "column_names", None)
    if labels is None:
        labels = (
            table.keys()
            if callable(getattr(table, "keys", None))
            else getattr(table, "columns", None)
        )
    if labels is None or (
        not isinstance(table, Mapping) and all(is_whole(label, 0) for label in labels)
    ):
        return None
    return {name: table[name] for name in labels}


def _filled(values: Any) -> Any:
    """NaN for what a masked array masks, which NumPy would turn into the number below the mask."""
    masked = isinstance(values, np.ma.MaskedArray) and values.dtype.names is None
    return values.astype(float).filled(np.nan) if masked else values


def has_names(table: Any) -> bool:
    """True for a table whose columns have names.

    For a list or tuple also if its first row has them.
    """
    first = table[:1] if isinstance(table, list | tuple) else ()
    return any(named_values(rows) is not None for rows in (table, *first))


def described(names: Sequence[str], point: np.ndarray) -> str:
    """Values of some parameters in words, for messages.

    Args:
        names: names of the parameters.
        point: their values, (P,).
    """
    return ", ".join(f"{name} = {value:g}" for name, value in zip(names, point, strict=True))


def check_pair_index(what: str, index: int) -> None:
    """Check an index of a contact pair.

    Args:
        what: name of its owner, for the message.
        index: the index.

    Raises:
        SceneError: if it is no integer from 0 on.
    """
    if not is_whole(index, 0):
        raise SceneError(f"{what} must be the place of a pair in Scene.contacts, 0 for the first")


def check_count_and_seed(what: str, count: int, seed: int) -> None:
    """Check a number of points and a seed.

    Args:
        what: name of their owner, for the message.
        count: number of points.
        seed: seed of a generator.

    Raises:
        ParameterError: if the count is not positive, or the seed negative.
    """
    if not is_whole(count, 1) or not is_whole(seed, 0):
        raise ParameterError(
            f"{what}: the count must be a positive integer, the seed an integer that is not "
            "negative"
        )


@dataclass(frozen=True)
class ParameterSpace(KnownArguments):
    """The box in which a scene is solved.

    Attributes:
        names: one name per parameter.
        lower: smallest value of each parameter, in its unit.
        upper: largest value of each parameter.

    Example:
        >>> box = hhr.ParameterSpace(("push", "pull"), lower=(0.0, 0.0), upper=(10.0, 4.0))
        >>> box.point({"pull": 1.0, "push": 2.0})
        array([2., 1.])
        >>> box.middle, box.grid([5, 3]).shape
        (array([5., 2.]), (15, 2))
    """

    names: Annotated[tuple[str, ...], "P"]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self):
        for attribute, kind, content in (
            ("names", str, "names"),
            ("lower", Real, "numbers"),
            ("upper", Real, "numbers"),
        ):
            value = getattr(self, attribute)
            if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray):
                raise SceneError(
                    f"{attribute} = {value!r} of a parameter space must be a tuple: for one "
                    f"parameter, ({value!r},)"
                )
            entries = as_tuple(attribute, value)
            if not all(isinstance(entry, kind) for entry in entries):
                raise SceneError(
                    f"{attribute} = {value!r} of a parameter space must hold {content}"
                )
            object.__setattr__(self, attribute, entries)
        if len(set(self.names)) < len(self.names):
            raise SceneError(
                f"a parameter is named twice in {self.names}: give each a different name"
            )
        if not self.names or not len(self.names) == len(self.lower) == len(self.upper):
            raise SceneError(
                f"parameters {self.names} need one lower and one upper bound each, and have "
                f"{len(self.lower)} and {len(self.upper)}: give each its own"
            )
        if not all(is_number(value) for value in (*self.lower, *self.upper)):
            raise SceneError(
                f"bounds {self.lower} .. {self.upper} of {self.names} must be finite numbers"
            )
        bounds = np.array([self.lower, self.upper], dtype=float)
        if not (bounds[0] < bounds[1]).all():
            index = int((~(bounds[0] < bounds[1])).argmax())
            name = self.names[index]
            low, high = bounds[:, index].tolist()
            remedy = (
                "swap them"
                if low > high
                else "one that does not vary is a number where it is used, no parameter"
            )
            raise SceneError(
                f"bounds {self.lower} .. {self.upper} of {self.names} must be increasing, and "
                f"those of '{name}' are {low:g} .. {high:g}: {remedy}"
            )

    @cached_property
    def _known(self) -> frozenset[str]:
        """The names, without their order."""
        return frozenset(self.names)

    @cached_property
    def _box(self) -> list[tuple[float, float]]:
        """Bounds with a margin for round-off in grids that end on them."""
        bounds = np.array([self.lower, self.upper], dtype=float)
        slack = 1e-12 * (bounds[1] - bounds[0])
        return list(zip((bounds[0] - slack).tolist(), (bounds[1] + slack).tolist(), strict=True))

    def differences(
        self,
        value: Callable[[np.ndarray], np.ndarray],
        point: np.ndarray,
        part: float,
        axes: Iterable[int] | None = None,
    ) -> np.ndarray:
        """Derivatives of a function along parameters by differences, (n, axes).

        Differences are central, or one-sided with three points if an end of the box is nearer than
        a step: the error of both is of second order in the step.

        Args:
            value: the function, (P,) -> (n,).
            point: parameter, (P,).
            part: step over the size of the box.
            axes: numbers of the parameters; None for all.
        """
        columns = []
        for axis in range(point.size) if axes is None else axes:
            step = part * (self.upper[axis] - self.lower[axis])
            total: float | np.ndarray = 0.0
            for steps, weight in self._weights(point[axis], step, axis):
                nearby = point.copy()
                nearby[axis] += steps * step
                total = total + weight * value(nearby)
            columns.append(total / step)
        return np.stack(columns, axis=1)

    def _weights(self, here: float, step: float, place: int) -> tuple[tuple[float, float], ...]:
        """Steps and weights of the derivative at ``here`` of a parabola.

        The parabola goes through points inside the box.
        """
        if here - step < self.lower[place]:
            return ((0, -1.5), (1, 2.0), (2, -0.5))
        if here + step > self.upper[place]:
            return ((0, 1.5), (-1, -2.0), (-2, 0.5))
        return ((-1, -0.5), (1, 0.5))

    @property
    def middle(self) -> np.ndarray:
        """Middle of the box, (P,), a new array."""
        return np.mean([self.lower, self.upper], axis=0)

    def point(self, mu: PointLike) -> np.ndarray:
        """Convert a number, a sequence or values by name to a checked point, (P,).

        See :func:`named_values` for values by name.

        Raises:
            ParameterError: for a wrong length, a missing name, NaN, or a value outside the box.
        """
        if (
            type(mu) is dict
            and mu.keys() == self._known
            and PLAIN.issuperset(map(type, mu.values()))
        ):
            mu = [
                mu[name] for name in self.names
            ]  # the usual ones are quick: those by name, and arrays
        elif type(mu) is not np.ndarray or mu.dtype.names is not None:
            mu = self._in_order(mu)
        try:
            point = np.array(mu, dtype=float, ndmin=1)
        except (TypeError, ValueError, OverflowError):
            raise ParameterError(
                f"expected {len(self.names)} numbers for {self.names}, got {mu!r}"
            ) from None
        if point.shape != (len(self.names),):
            raise ParameterError(
                f"expected {len(self.names)} parameters {self.names}, got shape {point.shape}: "
                "give a value for each"
            )
        for value, (low, high) in zip(point.tolist(), self._box):  # noqa: B905 (hot path)
            if not low <= value <= high:  # NaN fails too
                raise ParameterError(self._complaint(point))
        return point

    def _complaint(self, point: np.ndarray) -> str:
        rows = list(zip(self.names, point, self.lower, self.upper, strict=True))
        strange = [f"{name} = {value:g}" for name, value, *_ in rows if not np.isfinite(value)]
        if strange:
            box = ", ".join(f"{name} in [{low:g}, {high:g}]" for name, _, low, high in rows)
            return f"{', '.join(strange)} is not finite: give a number inside {box}"
        beyond = [
            f"{name} = {value:g} is outside [{low:g}, {high:g}]"
            for name, value, low, high in rows
            if not low <= value <= high
        ]
        return (
            "; ".join(beyond)
            + ": choose a value inside, or widen the parameter space, and train small models anew"
        )

    def described(self, point: np.ndarray) -> str:
        """A point in words, for messages."""
        return described(self.names, point)

    def _in_order(self, values: Any) -> Any:
        """Values or columns with names in the order of the parameters; others as they are."""
        named = named_values(values)
        if named is None:
            return _filled(values)
        if set(self.names) ^ set(named):
            missing = [f"{name!r} is missing" for name in self.names if name not in named]
            unknown = [
                f"{name!r} is unknown" for name in sorted(named, key=str) if name not in self.names
            ]
            faults = ", ".join(missing + unknown)
            raise ParameterError(
                f"{faults}: the names do not match {self.names}: give each of these a value, and "
                "no other"
            )
        return [_filled(named[name]) for name in self.names]

    def table(self, rows: PointsLike, least: int = 0) -> np.ndarray:
        """Convert rows, or columns or rows with names, to numbers, (S, P).

        They may lie outside the box.

        Args:
            rows: the table.
            least: smallest number of rows.

        Raises:
            ParameterError: for another shape, names that do not match, or values that are no
                numbers.
        """
        rows = _filled(rows)
        try:
            if (columns := self._in_order(rows)) is not rows:
                points = np.column_stack(
                    [np.array(column, dtype=float, ndmin=1) for column in columns]
                )
            else:
                several = isinstance(rows, Sequence) and not isinstance(rows, str)
                points = np.array([*map(self._in_order, rows)] if several else rows, dtype=float)
        except ParameterError:  # a ValueError too
            raise
        except (TypeError, ValueError):
            raise ParameterError(
                f"a table of points needs numbers in columns {self.names}, one row per point, got "
                f"{rows!r}"
            ) from None
        count = len(self.names)
        if points.ndim == 1 and count == 1:
            points = points[:, None]
        if points.ndim != 2 or points.shape[1] != count or len(points) < least:
            raise ParameterError(
                f"points have the shape {points.shape}: give one row per point and one column for "
                f"each of {self.names}"
            )
        return points

    def points(self, table: PointsLike) -> np.ndarray:
        """Convert a table, see :meth:`table`, to checked points, (S, P).

        With one parameter also (S,).

        Raises:
            ParameterError: for another shape, values that are no numbers, or a value outside the
                box.
        """
        points = self.table(table, least=1)
        low, high = np.transpose(self._box)
        within = ((points >= low) & (points <= high)).all(axis=1)  # False for NaN
        if not within.all():
            row = int((~within).argmax())
            raise ParameterError(f"row {row}: {self._complaint(points[row])}")
        return points

    def grid(self, counts: Sequence[int]) -> np.ndarray:
        """Regular grid with ``counts`` points along each parameter, (prod(counts), P).

        Raises:
            ParameterError: if there is not one positive count for each parameter.
        """
        checked = list(counts) if isinstance(counts, Sequence | np.ndarray) else [counts]
        if len(checked) != len(self.names) or not all(is_whole(count, 1) for count in checked):
            raise ParameterError(
                f"counts {counts!r} of a grid must be {len(self.names)} positive integers, one "
                f"for each of {self.names}"
            )
        axes = [
            np.linspace(low, high, count)
            for low, high, count in zip(self.lower, self.upper, checked, strict=True)
        ]
        return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)

    def random(self, count: int, seed: int) -> np.ndarray:
        """Uniform random points of the box, (count, P), the same for the same seed.

        Args:
            count: number of points.
            seed: seed of the generator.

        Raises:
            ParameterError: if the count is not positive or the seed negative.
        """
        check_count_and_seed(f"{count!r} random points from seed {seed!r}", count, seed)
        return np.random.default_rng(seed).uniform(self.lower, self.upper, (count, len(self.names)))

    def lines(self, places: Sequence[int], count: int = 3) -> np.ndarray:
        """Points on lines along parameters, ``LINE_POINTS`` on each, (n, P).

        The first line of each parameter is through the middle, others are random.

        Args:
            places: indices of the parameters.
            count: number of lines along each.
        """
        ends = np.array([self.lower, self.upper], dtype=float)
        middle = ends.mean(axis=0)
        bases = np.vstack([middle, self.random(count - 1, seed=1)]) if count > 1 else middle[None]
        samples = np.tile(np.repeat(bases, LINE_POINTS, axis=0), (len(places), 1, 1))
        for points, axis in zip(samples, places, strict=True):
            points[:, axis] = np.tile(np.linspace(ends[0, axis], ends[1, axis], LINE_POINTS), count)
        return samples.reshape(-1, len(self.names))


def check_counts(**given: tuple[object, int]) -> None:
    """Check integers, each given by name with its least value.

    Raises:
        StudyError: for a value that is no integer from its least value to 2^32.
    """
    for name, (value, least) in given.items():
        if not is_whole(value, least) or int(value) >= 2**32:
            raise StudyError(
                f"{name} = {value!r} must be an integer of at least {least}, below 2^32"
            )
