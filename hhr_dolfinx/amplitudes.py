"""Amplitudes of the loads of a scene, theta(mu) = (1, theta_1(mu), ..., theta_T(mu)).

They are affine in the parameters, or dataclasses of numbers: a model on disk is data, and nothing
of it is executed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Protocol, TypeVar

import numpy as np

from hhr_dolfinx.declared import Floats, KnownArguments
from hhr_dolfinx.errors import NotSolvableError, SceneError
from hhr_dolfinx.parameters import ParameterSpace, described, is_number, is_whole

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix, csr_matrix

    from hhr_dolfinx.formulas import Formula, Scalar

Numbers = TypeVar("Numbers", float, np.ndarray)
"""A number, or an array of numbers."""


@dataclass(frozen=True)
class Amplitude(KnownArguments):
    """Affine function of the parameters: ``constant + sum(slopes[name] * value of name)``.

    Example:
        >>> box = hhr.ParameterSpace(("push", "pull"), lower=(0.0, 0.0), upper=(10.0, 4.0))
        >>> amplitude = hhr.Amplitude(constant=5.0, slopes={"push": 2.0})
        >>> float(amplitude.constant + amplitude.row(box) @ box.point({"push": 3.0, "pull": 1.0}))
        11.0
    """

    constant: float = 0.0
    slopes: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self):
        if not isinstance(self.slopes, Mapping):
            raise SceneError(
                f"the slopes {self.slopes!r} of an amplitude need a number by parameter: "
                "{'name': 1.0}"
            )
        if not all(is_number(value) for value in (self.constant, *self.slopes.values())):
            raise SceneError(
                f"amplitude {self.constant!r} with slopes {dict(self.slopes)} must be finite "
                "numbers"
            )

    def row(self, space: ParameterSpace) -> np.ndarray:
        """Slopes in the order of the parameters, (P,).

        Raises:
            SceneError: for a name that is no parameter.
        """
        unknown = set(self.slopes) - set(space.names)
        if unknown:
            raise SceneError(
                f"an amplitude names {sorted(unknown)}, the scene's parameters are {space.names}: "
                "correct the name, or add it to the ParameterSpace"
            )
        return np.array([self.slopes.get(name, 0.0) for name in space.names])


def check_amplitude(item: Any, what: str, *, formulas: bool = False) -> None:
    """Convert the amplitude of a frozen item.

    A number becomes a constant amplitude, a text a Formula if the item accepts these.

    Args:
        item: dataclass with an ``amplitude``, such as a load.
        what: name of the item, for the message.
        formulas: accept formulas.

    Raises:
        SceneError: for anything else.
    """
    if is_number(item.amplitude):
        object.__setattr__(item, "amplitude", Amplitude(item.amplitude))
    if formulas and (isinstance(item.amplitude, str) or hasattr(item.amplitude, "variables")):
        from hhr_dolfinx.formulas import formula_of

        object.__setattr__(
            item, "amplitude", formula_of(item.amplitude, f"the amplitude of {what}")
        )
        return
    if not isinstance(item.amplitude, Amplitude):
        raise SceneError(
            f"the amplitude {item.amplitude!r} of {what} must be a finite number or an Amplitude, "
            "for instance Amplitude(slopes={'name of a parameter': 1.0})"
            + (", or a formula of parameters as text" if formulas else "")
        )


EVERYWHERE = (-math.inf, math.inf)
FINITE = "an amplitude must be finite everywhere in the box: change the formula, or narrow the box"


def check_formula(
    text: str,
    space: ParameterSpace,
    what: str,
    ends: tuple[float, float] = EVERYWHERE,
    remedy: str = FINITE,
) -> None:
    """Check a formula of parameters over the box.

    Args:
        text: the formula.
        space: the box of the parameters.
        what: name of the value, for the message.
        ends: open interval of the values.
        remedy: advice for values outside it.

    Raises:
        SceneError: for unknown parameters, or a value outside the interval in the box.
    """
    from hhr_dolfinx.formulas import Scalar, check_over_box

    try:
        scalar = Scalar(text, space.names)
    except SceneError as error:
        raise SceneError(f"{what}: {error}") from None
    check_over_box(scalar, space, what, *ends, remedy)


def bound(amplitude: Any, space: ParameterSpace) -> Any:
    """Bind a formula to parameters.

    A single number or name becomes affine: answers of affine scenes are tabulated.

    Args:
        amplitude: an amplitude, or a formula.
        space: the box of the parameters.
    """
    # a test of the attribute does not import the module of formulas
    if not hasattr(amplitude, "variables"):
        return amplitude
    from hhr_dolfinx.formulas import Scalar

    scalar = Scalar(amplitude.text, space.names)
    if not scalar.formula.variables:
        return Amplitude(scalar.value(np.zeros(0)))
    name = scalar.text.strip()
    return Amplitude(slopes={name: 1.0}) if scalar.formula.variables == (name,) else scalar


class Theta:
    """Amplitudes at one parameter: numbers of some terms and ``values``; others are zero.

    ``matrix @ theta`` sums the columns of a matrix with one column per term, dense or sparse. It
    touches only columns of given terms, and is fastest on dense matrices in Fortran order and on
    sparse ones by columns (csc). ``terms`` holds each number once; a slice is all.
    """

    __slots__ = ("terms", "values")
    __array_ufunc__ = (
        None  # makes ndarray @ Theta call __rmatmul__, as sparse matrices do for unknown types
    )

    def __init__(self, terms: slice | np.ndarray, values: np.ndarray):
        self.terms = terms
        self.values = values

    def __rmatmul__(self, matrix: np.ndarray | csc_matrix) -> np.ndarray:
        """Sum the columns of ``matrix``, (n, 1 + T) -> (n,)."""
        if isinstance(matrix, np.ndarray):
            return matrix[:, self.terms] @ self.values
        if isinstance(self.terms, slice):
            return matrix @ self.values
        matrix = matrix.tocsc()
        total = np.zeros(matrix.shape[0])
        starts = matrix.indptr
        for term, value in zip(self.terms.tolist(), self.values.tolist(), strict=True):
            entries = slice(starts[term], starts[term + 1])
            # the rows of one column are distinct
            total[matrix.indices[entries]] += matrix.data[entries] * value
        return total


class NonAffine(Protocol):
    """Amplitudes of several columns of a load that are not affine in the parameters.

    A frozen dataclass of numbers. Files and fingerprints of problems identify it by its class and
    its fields.
    """

    @property
    def count(self) -> int:
        """Number of columns."""

    def __call__(self, point: np.ndarray) -> tuple[Sequence[int], Sequence[float]]:
        """Numbers, each once, and amplitudes of the columns that act at a point, (P,)."""


def checked_count(amplitude: NonAffine, space: ParameterSpace, owner: object) -> int:
    """Number of columns of a non-affine amplitude, checked in the middle of the box.

    Args:
        amplitude: the amplitude.
        space: the box of the parameters.
        owner: its load, for the message.

    Raises:
        SceneError: if it is no frozen dataclass with a count, or returns invalid columns or values.
    """
    if (
        isinstance(amplitude, type)
        or not callable(amplitude)
        or not hasattr(amplitude, "__dataclass_fields__")
    ):
        raise SceneError(
            f"the amplitude {amplitude!r} of {owner!r} must be an Amplitude, or a frozen "
            "dataclass with a count that returns (columns, values) for a point"
        )
    count = getattr(amplitude, "count", None)
    if not is_whole(count, 1):
        raise SceneError(
            f"the count {count!r} of {amplitude!r} of {owner!r} must be its number of columns"
        )
    try:
        columns, values = amplitude(space.middle)
        fits = len(columns) == len(values) == len(set(columns)) and all(
            is_number(value) for value in values
        )
    except (TypeError, ValueError):
        fits = False
        columns = ()
    if not fits or not all(is_whole(column, 0) and column < count for column in columns):
        raise SceneError(
            f"{amplitude!r} of {owner!r} must return columns, each once and below its count "
            f"{count}, and as many values"
        )
    return count


AMPLITUDE_STEP = 1e-5
"""Step over the size of the box in differences of amplitudes: the truncation error is 1e-10,
round-off 1e-11.
"""


def _derivative(
    amplitude: NonAffine, point: np.ndarray, space: ParameterSpace | None
) -> np.ndarray:
    derivative = getattr(amplitude, "derivative", None)
    columns, values = amplitude(point)
    if derivative is not None:
        return np.reshape(derivative(point), (len(values), point.size))

    def acting(nearby: np.ndarray) -> np.ndarray:
        by_column = dict(zip(*amplitude(nearby), strict=True))
        return np.array([by_column.get(column, 0.0) for column in columns])

    if space is None:
        sizes = np.where(point == 0, 1.0, np.abs(point))
        space = ParameterSpace(
            tuple(map(str, range(point.size))), tuple(point - sizes), tuple(point + sizes)
        )
    return space.differences(acting, point, AMPLITUDE_STEP)


def _shapes(degree: int, s: float) -> tuple[float, ...]:
    """Shape functions of the nodes of an edge at the fraction s of its length."""
    return (1 - s, s) if degree == 1 else ((1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1))


def edge_integrals(degree: int, s: Numbers) -> tuple[Numbers, ...]:
    """Integrals of the shape functions of an edge from 0 to s.

    Every query calls this with a number: no arrays.

    Args:
        degree: 1 or 2.
        s: fraction of the length of the edge, or an array of them.
    """
    if degree == 1:
        return s - s * s / 2, s * s / 2
    cube = 2 * s * s * s / 3
    return s - 1.5 * s * s + cube, 2 * s * s - 2 * cube, cube - s * s / 2


@dataclass(frozen=True)
class Coverage:
    """Amplitudes of a pressure on a straight line up to the parameter ``extent``.

    They are exact for cells of degree 1 or 2.

    A line of n nodes at increasing ``positions``, (n,), has E edges of 1 + degree nodes each. It
    has E columns for whole edges from its start (column e is the load on all edges before edge e)
    and n columns for its nodes. If the pressure ``constant + slopes @ mu`` ends in edge e, at the
    fraction s of its length L, the load is column e plus, for each node of the edge, L times the
    integral of its shape function up to s.
    """

    positions: Annotated[Floats, "nodes"]
    extent: int
    constant: float
    slopes: Annotated[Floats, "P"]
    degree: int = 1

    def __post_init__(self) -> None:
        line = self.positions
        slopes = self.slopes
        if self.degree not in (1, 2):
            raise SceneError(
                f"a partial pressure acts on cells of degree 1 or 2, not {self.degree!r}"
            )
        if line.ndim != 1 or line.size < 1 + self.degree or not (line[:-1] < line[1:]).all():
            least = "two" if self.degree == 1 else "three"
            raise SceneError(
                f"positions of a partial pressure must be at least {least} and increase"
            )
        if (line.size - 1) % self.degree:
            raise SceneError(
                f"a partial pressure of degree {self.degree} has {line.size} nodes, which make no "
                "edges"
            )
        if slopes.ndim != 1 or not 0 <= self.extent < slopes.size:
            raise SceneError(
                f"a partial pressure extends up to parameter {self.extent}, and has slopes along "
                f"{slopes.size} of them"
            )

    @cached_property
    def _ends(self) -> np.ndarray:
        return self.positions[:: self.degree]

    @property
    def edges(self) -> int:
        """Number of edges, E."""
        return (len(self.positions) - 1) // self.degree

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.edges + len(self.positions)

    def _place(self, point: np.ndarray) -> tuple[int, float, float]:
        """Edge at which the pressure ends, its length, and the fraction before the end.

        The fraction is not clipped.
        """
        ends = self._ends
        edge = min(max(int(ends.searchsorted(point[self.extent])) - 1, 0), self.edges - 1)
        length = ends[edge + 1] - ends[edge]
        return edge, length, (point[self.extent] - ends[edge]) / length

    def __call__(self, point: np.ndarray) -> tuple[list[int], list[float]]:
        """Numbers and amplitudes of the columns that act at a point."""
        edge, length, fraction = self._place(point)
        s = min(max(fraction, 0.0), 1.0)
        amplitude = self.constant + self.slopes @ point
        weights = [
            amplitude,
            *(amplitude * length * integral for integral in edge_integrals(self.degree, s)),
        ]
        first = self.edges + self.degree * edge
        return [edge, *range(first, first + self.degree + 1)], weights

    def rows(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns that act at many points, (n, P).

        Returns:
            Numbers and amplitudes of the columns, (n, 2 + degree) each.
        """
        ends = self._ends
        edge = np.clip(ends.searchsorted(points[:, self.extent]) - 1, 0, self.edges - 1)
        lengths = np.diff(ends)[edge]
        s = np.clip((points[:, self.extent] - ends[edge]) / lengths, 0.0, 1.0)
        weights = np.stack(
            [np.ones(len(s)), *(lengths * integral for integral in edge_integrals(self.degree, s))],
            axis=1,
        )
        first = self.edges + self.degree * edge
        columns = np.stack([edge, *(first + k for k in range(self.degree + 1))], axis=1)
        return columns, (self.constant + points @ self.slopes)[:, None] * weights

    def derivative(self, point: np.ndarray) -> np.ndarray:
        """Derivatives of the amplitudes along the parameters, (2 + degree, P).

        From the left at a node.
        """
        amplitude = self.constant + self.slopes @ point
        _, length, fraction = self._place(point)
        s = min(max(fraction, 0.0), 1.0)
        derivatives = np.outer(
            np.append(1.0, length * np.array(edge_integrals(self.degree, s))), self.slopes
        )
        if 0.0 <= fraction <= 1.0:
            derivatives[:, self.extent] += amplitude * np.append(0.0, _shapes(self.degree, s))
        return derivatives


RANGES = {"young": (0.0, math.inf), "poisson": (-1.0, 0.5)}
"""Open intervals of the constants of an isotropic elastic body, by name."""
_MUST = {
    "young": ("the modulus", "be positive"),
    "poisson": ("Poisson's ratio", "lie in (-1, 0.5)"),
}


@dataclass(frozen=True)
class Limits:
    """Interval of an elastic constant that is a formula, ``young`` or ``poisson``.

    The constant must be in its interval at every point.

    The box is checked at points only, and a model that interpolates between points never evaluates
    the formula. ``names`` are those of the parameters, in the order of a point.
    """

    constant: str
    text: str
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.constant not in RANGES:
            raise SceneError(f"{self.constant!r} is no elastic constant: {', '.join(RANGES)} are")

    @property
    def ends(self) -> tuple[float, float]:
        """Open interval of the constant."""
        return RANGES[self.constant]

    @cached_property
    def scalar(self) -> Scalar:
        """The formula, bound to the parameters."""
        from hhr_dolfinx.formulas import Scalar

        return Scalar(self.text, self.names)

    def check(self, point: np.ndarray) -> None:
        """Check the constant at a point, (P,).

        Raises:
            NotSolvableError: if it is outside its interval.
        """
        low, high = self.ends
        value = self.scalar.value(point)
        if not low < value < high:
            raise NotSolvableError(self._refused(value, point))

    def check_many(self, points: np.ndarray) -> None:
        """Check the constant at many points, (n, P).

        Raises:
            NotSolvableError: if it is outside its interval at any of them.
        """
        if len(points) == 1:  # quicker: forces of one answer ask for it
            return self.check(points[0])
        low, high = self.ends
        values = self.scalar.values(points)
        bad = np.flatnonzero(~((values > low) & (values < high)))
        if bad.size:
            raise NotSolvableError(self._refused(values[bad[0]], points[bad[0]]))

    def _refused(self, value: float, point: np.ndarray) -> str:
        constant, must = _MUST[self.constant]
        location = described(self.names, point)
        return (
            f"{constant} {self.text[:60]} is {value:g} at {location}, and must {must}: change it, "
            "or narrow the box"
        )


@dataclass(frozen=True)
class Amplitudes:
    """All amplitudes of a scene.

    Affine ones, constant + slopes @ mu, come first, then non-affine ones, of several terms each.
    """

    #: constant, slopes: of the affine ones, (1 + T0,) and (1 + T0, P); the first is the 1 of the
    #: parameter-free part
    constant: Annotated[Floats, "affine"]
    slopes: Annotated[Floats, "affine", "P"]
    nonaffine: tuple[NonAffine, ...] = ()  #: non-affine amplitudes in their order
    limits: tuple[
        Limits, ...
    ] = ()  #: elastic constants that are checked at each point at which theta is evaluated
    #: parameter box for differences of amplitudes without a derivative; None if all have one
    space: ParameterSpace | None = None

    def faults_for(self, space: ParameterSpace, terms: int) -> Iterator[str]:
        """Faults of amplitudes from a file.

        Args:
            space: the box of the parameters.
            terms: number of terms, 1 + T.
        """
        if self.constant[0] != 1 or self.slopes[0].any():
            yield "the first amplitude must be the constant 1"
        if any(getattr(value, "names", space.names) != space.names for value in self.nonaffine):
            yield f"a formula is one of other parameters than {space.names}"
        if any(limit.names != space.names for limit in self.limits):
            yield f"an elastic constant is one of other parameters than {space.names}"
        counts = [checked_count(value, space, "its file") for value in self.nonaffine]
        if self.constant.size + sum(counts) != terms:
            yield f"the amplitudes are {self.constant.size} and {counts}, the loads {terms}"

    @classmethod
    def collect(
        cls,
        amplitudes: Sequence[Amplitude | Formula | NonAffine],
        space: ParameterSpace,
        limits: tuple[Limits, ...] = (),
    ) -> Amplitudes:
        """Stack the constant 1, the affine amplitudes, and the non-affine ones.

        Args:
            amplitudes: amplitudes of all terms; those of a kind keep their order.
            space: the box of the parameters.
            limits: elastic constants that are checked at each point.
        """
        converted = [bound(amplitude, space) for amplitude in amplitudes]
        affine = [amplitude for amplitude in converted if isinstance(amplitude, Amplitude)]
        nonaffine = tuple(
            amplitude for amplitude in converted if not isinstance(amplitude, Amplitude)
        )
        constant = np.array([1.0] + [amplitude.constant for amplitude in affine])
        slopes = np.array(
            [np.zeros(len(space.names)), *(amplitude.row(space) for amplitude in affine)]
        )
        differentiable = all(hasattr(amplitude, "derivative") for amplitude in nonaffine)
        return cls(constant, slopes, nonaffine, limits, None if differentiable else space)

    @cached_property
    def firsts(self) -> list[int]:
        """Number of the first term of each non-affine amplitude, then that of all terms."""
        return np.cumsum(
            [self.constant.size, *(amplitude.count for amplitude in self.nonaffine)]
        ).tolist()

    def __call__(self, point: np.ndarray) -> Theta:
        """Theta at a checked point.

        SceneError for columns of other amplitudes, NotSolvableError outside a limit.
        """
        for limit in self.limits:
            limit.check(point)
        affine = self.constant + self.slopes @ point
        if not self.nonaffine:
            return Theta(slice(None), affine)
        terms = list(range(affine.size))
        values = affine.tolist()
        # hot path: the last of the firsts is the end
        for first, amplitude in zip(self.firsts, self.nonaffine):  # noqa: B905
            columns, weights = amplitude(point)
            if len(columns) != len(weights) or not all(
                0 <= column < amplitude.count for column in columns
            ):
                raise SceneError(
                    f"{amplitude!r} returns columns {columns} and {len(weights)} values at "
                    f"{point.tolist()}: give as many values as columns, 0 to {amplitude.count - 1}"
                )
            terms.extend([first + column for column in columns])
            values.extend(weights)
        return Theta(np.array(terms), np.array(values, dtype=float))

    def dense(self, point: np.ndarray) -> np.ndarray:
        """θ at a checked point with the zeros of terms that do not act, (1 + T,)."""
        acting = self(point)
        theta = np.zeros(self.firsts[-1])
        theta[acting.terms] = acting.values
        return theta

    def of_many(self, points: np.ndarray) -> np.ndarray | csr_matrix:
        """θ at every point, (n, 1 + T); sparse if most terms may be zero."""
        from scipy.sparse import csr_matrix

        for limit in self.limits:
            limit.check_many(points)
        affine = self.constant + points @ self.slopes.T
        if not self.nonaffine:
            return affine
        terms = [np.broadcast_to(np.arange(affine.shape[1]), affine.shape)]
        values = [affine]
        quick = [amplitude for amplitude in self.nonaffine if isinstance(amplitude, Coverage)]
        if len(quick) == len(self.nonaffine):
            for first, amplitude in zip(self.firsts, quick, strict=False):
                columns, weights = amplitude.rows(points)
                terms.append(first + columns)
                values.append(weights)
            columns = np.hstack(terms)
            entries = np.hstack(values)
            starts = np.arange(len(points) + 1) * columns.shape[1]
        else:
            thetas = [self(point) for point in points]
            columns, entries = (
                np.concatenate([getattr(theta, attribute) for theta in thetas])
                for attribute in Theta.__slots__
            )
            starts = np.cumsum([0, *(theta.values.size for theta in thetas)])
        return csr_matrix(
            (entries.ravel(), columns.ravel(), starts), shape=(len(points), self.firsts[-1])
        )

    def sum_columns(self, matrix: np.ndarray | csc_matrix, points: np.ndarray) -> np.ndarray:
        """``matrix @ theta`` at every point, (n, len(points)).

        Args:
            matrix: columns of each term, (n, 1 + T).
            points: parameters, (S, P).

        Returns:
            The sums, (n, S).
        """
        return np.stack([matrix @ self(point) for point in points], axis=1)

    def slopes_at(self, point: np.ndarray) -> tuple[slice | np.ndarray, np.ndarray]:
        """Terms that act at a checked point, and the derivatives of their amplitudes, (k, P)."""
        if not self.nonaffine:
            return slice(None), self.slopes
        terms = list(range(len(self.slopes)))
        values = [self.slopes]
        # the last of the firsts is their end
        for first, amplitude in zip(self.firsts, self.nonaffine):  # noqa: B905
            columns, _ = amplitude(point)
            terms.extend([first + column for column in columns])
            values.append(_derivative(amplitude, point, self.space))
        return np.array(terms), np.vstack(values)

    def least(self, columns: np.ndarray, space: ParameterSpace) -> tuple[np.ndarray, np.ndarray]:
        """Smallest value of each sum ``columns @ theta`` in a box.

        An affine sum, a row of ``columns`` with affine terms alone, is smallest at a corner. Others
        are evaluated at the corners and at random points.

        Args:
            columns: coefficients of the sums, (m, 1 + T).
            space: the box of the parameters.

        Returns:
            The values, (m,), and the points where they are attained, (m, P).
        """
        affine = columns[:, : self.constant.size]
        slopes = affine @ self.slopes
        points = np.where(slopes > 0, space.lower, space.upper)
        values = affine @ self.constant + np.einsum("mp,mp->m", slopes, points)
        nonaffine = np.flatnonzero(columns[:, self.constant.size :].any(axis=1))
        if nonaffine.size:
            from hhr_dolfinx.formulas import box_samples  # scenes without formulas do not load it

            samples = box_samples(space)
            sums = replace(self, limits=()).sum_columns(columns[nonaffine], samples)
            values[nonaffine] = sums.min(axis=1)
            points[nonaffine] = samples[sums.argmin(axis=1)]
        return values, points

    def idle(self, space: ParameterSpace) -> tuple[str, ...]:
        """Names of parameters on which no amplitude depends.

        Non-affine ones are evaluated at random points.
        """
        used = self.slopes.any(axis=0)
        points = space.random(64, seed=0)
        for index in np.flatnonzero(~used):
            changed = points.copy()
            changed[:, index] = np.roll(points[:, index], 1)
            used[index] = any(
                not np.array_equal(before, after)
                for amplitude in self.nonaffine
                for pair in zip(points, changed, strict=True)
                for before, after in zip(*map(amplitude, pair), strict=True)
            )
        return tuple(name for name, acts in zip(space.names, used, strict=True) if not acts)
