"""Families of load paths with a name and family parameters, drawn from a sampling like points.

A family defines the start of its paths and their legs by formulas of the family parameters, such as
a load level, a hold time or a rate. Formulas are texts that are parsed and never executed, see
:mod:`hhr_dolfinx.formulas`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from hhr_dolfinx.errors import ParameterError, SceneError
from hhr_dolfinx.formulas import Scalar, box_samples, formula_of
from hhr_dolfinx.parameters import ParameterSpace, is_number, is_whole
from hhr_dolfinx.sampling import Sobol

if TYPE_CHECKING:
    from hhr_dolfinx.parameters import PointLike

Targets = Mapping[str, float | str] | tuple[tuple[str, float | str], ...]
"""Numbers or formulas of the family parameters, by the names of parameters of the scene."""

LEG_ROUND_OFF = 1e-12
"""Fraction of the longest leg, and of a parameter's range, below which the value of a formula
counts as zero.
"""
MOST_LEG_STEPS = 100_000
"""Most steps of a leg: each of them is a solution."""
LEAST_PART = 0.1
"""Smallest fraction of a load in training paths."""


@runtime_checkable
class Sampling(Protocol):
    """Interface of a sampling: ``Sobol``, ``LatinHypercube``, or a user-defined object."""

    def points(self, space: ParameterSpace) -> np.ndarray:
        """Points of a box, (n, P)."""


class NamedPath(list[tuple[float, np.ndarray]]):
    """A load path with a name and its family parameters.

    It is a list of times in s and parameters, (P,).

    Attributes:
        name: name of the family, with the values; it labels the path in reports.
        values: family parameters by name.
    """

    def __init__(
        self, pairs: Iterable[tuple[float, np.ndarray]], name: str, values: Mapping[str, float]
    ):
        super().__init__(pairs)
        self.name = name
        self.values = dict(values)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, NamedPath):
            return False  # a list would use comparisons of arrays as booleans
        alike = (self.name, self.values, len(self)) == (other.name, other.values, len(other))
        return alike and all(
            time == other_time and np.array_equal(point, target)
            for (time, point), (other_time, target) in zip(self, other, strict=True)
        )

    def __ne__(self, other: object) -> bool:
        return not self == other

    __hash__ = None

    def __repr__(self) -> str:
        return f"<path {self.name!r}: {len(self)} times{f' to {self[-1][0]:g} s' if self else ''}>"


@dataclass(frozen=True)
class Leg:
    """A part of a path along which parameters of the scene change linearly in time.

    Attributes:
        to: values at its end, by the names of parameters of the scene: numbers or formulas of the
            family parameters. Other parameters do not change.
        seconds: duration in s, a number or a formula. A leg of no duration is left out.
        steps: number of equal steps; the value of a formula is rounded, and at least one.

    Raises:
        SceneError: for values that are neither numbers nor formulas, negative seconds, and invalid
            steps.
    """

    to: Targets
    seconds: float | str
    steps: int | str

    def __post_init__(self) -> None:
        object.__setattr__(self, "to", _targets("a leg", self.to))
        object.__setattr__(self, "seconds", _kept("the seconds of a leg", self.seconds))
        if not isinstance(self.seconds, str) and self.seconds < 0:
            raise SceneError(
                f"a leg takes {self.seconds:g} s: give it a duration that is not negative"
            )
        if isinstance(self.steps, str):
            formula_of(self.steps, "the steps of a leg")
        elif not is_whole(self.steps, 1):
            raise SceneError(
                f"steps = {self.steps!r} of a leg must be a positive integer, or a formula as text"
            )
        else:
            object.__setattr__(self, "steps", int(self.steps))


@dataclass(frozen=True)
class PathFamily:
    """Load paths of one kind, one for each point of a box of family parameters.

    Attributes:
        name: name of the family.
        space: parameters of the scene, ``scene.parameters``, which define the order of a path's
            points.
        own: family parameters; formulas may name these and no others.
        start: values of all parameters of the scene at time 0, numbers or formulas.
        legs: legs of the paths in their order.

    Raises:
        SceneError: for an unknown name, a parameter of the scene without a start, a formula of
            unknown names, and an invalid path anywhere in the box of the family parameters: a point
            outside the box of the scene, a negative duration, a value that is not finite.

    Example:
        >>> space = hhr.ParameterSpace(("load", "gap"), (0.0, 0.0), (450.0, 0.02))
        >>> own = hhr.ParameterSpace(("gap", "hold"), (5.0, 0.0), (15.0, 10.0))
        >>> start = {"load": 0.0, "gap": "1e-3 * gap"}
        >>> legs = hhr.Leg({"load": 450.0}, 1.0, 40), hhr.Leg({}, "hold", 10)
        >>> family = hhr.PathFamily("held", space, own, start, legs)
        >>> family.path({"gap": 10.0, "hold": 2.0})
        <path 'held (gap = 10, hold = 2)': 51 times to 3 s>
    """

    name: str
    space: ParameterSpace
    own: ParameterSpace
    start: Targets
    legs: tuple[Leg, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise SceneError(
                f"the name {self.name!r} of a family of paths must be a text that is not empty"
            )
        for field in ("space", "own"):
            if not isinstance(getattr(self, field), ParameterSpace):
                raise SceneError(
                    f"{field} = {getattr(self, field)!r} of the family '{self.name}' must be a "
                    "ParameterSpace: give space=scene.parameters, and a box of the family's own "
                    "parameters"
                )
        legs = tuple(self.legs) if isinstance(self.legs, list | tuple) else ()
        if not legs or not all(isinstance(leg, Leg) for leg in legs):
            raise SceneError(
                f"legs = {self.legs!r} of the family '{self.name}' must be a tuple of one Leg or "
                "more"
            )
        object.__setattr__(self, "legs", legs)
        with _naming(self._title):
            object.__setattr__(self, "start", _targets("the start", self.start))
            missing = [name for name in self.space.names if name not in dict(self.start)]
            if missing:
                raise SceneError(
                    f"the start says nothing of {', '.join(missing)}: give a value of each "
                    "parameter"
                )
            self._formulas  # noqa: B018 (unknown names are reported where they are written)
        for point in box_samples(self.own):
            try:
                self._corners(point)
            except ParameterError as error:
                raise SceneError(
                    f"{error}; or narrow the box of the family's own parameters"
                ) from None

    def path(self, point: PointLike) -> NamedPath:
        """Path of a point of the family parameters, a sequence, (P_own,), or a mapping by name.

        Raises:
            ParameterError: for a point outside the box of the family, or a path that leaves the box
                of the scene or whose times do not increase.
        """
        with _naming(self._title):
            values = self.own.point(point)
        start, *ends = self._corners(values)
        time = 0.0
        position = start.target
        pairs = [(0.0, start.target)]
        for end in ends:
            shares = np.arange(1, end.steps + 1) / end.steps
            times = time + end.seconds * shares
            if not (np.diff(times, prepend=time) > 0).all():
                raise ParameterError(
                    f"path '{self._called(values)}': times must increase, and {end.steps} steps "
                    f"in {end.seconds:g} s are lost after {time:g} s. Make the legs more alike"
                )
            # constant values stay the same to the last bit, and each leg ends exactly at the start
            # of the next one
            targets = [position + (end.target - position) * share for share in shares[:-1]] + [
                end.target
            ]
            pairs += zip(times.tolist(), targets, strict=True)
            time = float(times[-1])
            position = end.target
        return NamedPath(
            pairs, self._called(values), dict(zip(self.own.names, values.tolist(), strict=True))
        )

    def paths(self, drawn: Sampling | np.ndarray) -> list[NamedPath]:
        """Paths of a sampling, such as ``Sobol(12)``, or of points of the family parameters.

        Points are (n, P_own).

        Raises:
            ParameterError: as :meth:`path`, and for other objects.
        """
        with _naming(self._title):
            table: Any = drawn
            if isinstance(drawn, Sampling) and not isinstance(drawn, type):
                table = drawn.points(self.own)
            points = self.own.points(table)
        return [self.path(point) for point in points]

    def training(
        self, count: int, seed: int = 1, *, least_part: float = LEAST_PART, cycles: int = 1
    ) -> list[NamedPath]:
        """Training paths: corners of the family parameters, then points inside.

        Every other one is at a part load.

        The largest plastic strains occur at corners, which points inside never reach: on two
        rollers 5 % of all paths, with errors of forces of 31 to 46 %, were near one corner.
        Residual states after a part load are not fractions of those after the full load: a model
        trained on full loads alone has errors of 50 %. Up to half of the paths are corners: all of
        them, or as many as fit, with each parameter about equally often at either end. Part loads
        are fractions of the way from the start, from 0.1 on, uniform in their logarithm, at the
        rates of full loads.

        For tests, draw from a sampling: ``family.paths(Sobol(20, seed=2))``.

        Args:
            count: number of paths; powers of 2 are best.
            seed: seed of the sampling.
            least_part: smallest part load, in (0, 1]. 1 leaves them out, for families that set the
                load level themselves.
            cycles: number of times that each path is followed; between two times it is followed
                back to its start.

        Raises:
            ParameterError: for an invalid count, seed, part or number of cycles, and as
                :meth:`path`.
        """
        if not (is_number(least_part) and 0 < least_part <= 1 and is_whole(cycles, 1)):
            raise ParameterError(
                f"least_part = {least_part!r} must be a fraction in (0, 1], cycles = {cycles!r} a "
                "whole number from 1"
            )
        size = len(self.own.names)
        axes = tuple(map(str, range(size + 1)))  # the last one is the part of the load
        drawn = Sobol(count, seed).points(
            ParameterSpace(axes, (0.0,) * len(axes), (1.0,) * len(axes))
        )
        corners = (
            np.indices((2,) * size).reshape(size, -1).T if 2 ** min(size, 31) <= count / 2 else None
        )
        if corners is None:
            # half of the first 2^m points lie in the upper half of each parameter
            room = 2 ** int(np.log2(count / 2)) if count > 1 else 0
            corners = np.unique(drawn[:room, :size].round(), axis=0)
        lower, upper = np.array([self.own.lower, self.own.upper], dtype=float)
        paths = [self.path(np.where(corner, upper, lower)) for corner in corners]
        for number, unit in enumerate(drawn[: count - len(paths)]):
            path = self.path(lower + unit[:size] * (upper - lower))
            paths.append(
                _part_of(path, least_part ** unit[size]) if number % 2 and least_part < 1 else path
            )
        return [_cycled(path, cycles) for path in paths]

    @cached_property
    def _formulas(self) -> tuple[_Formulas, ...]:
        """Formulas of the start, then of each leg."""

        def scalar(what: str, value: float | str) -> Scalar:
            """Formula of a value; ``what`` names it in messages."""
            with _naming(what):
                return Scalar(formula_of(value, what).text, self.own.names)

        def formulas(what: str, to: Targets, seconds: float | str, steps: int | str) -> _Formulas:
            """Formulas of targets ``to``, of seconds and of steps; ``what`` names the leg.

            Raises:
                SceneError: for unknown parameters.
            """
            unknown = sorted(set(dict(to)) - set(self.space.names))
            if unknown:
                raise SceneError(
                    f"{what} names {unknown}, the parameters of the scene are {self.space.names}"
                )
            targets = {name: scalar(f"{name} at {what}", value) for name, value in dict(to).items()}
            return _Formulas(
                targets, scalar(f"seconds of {what}", seconds), scalar(f"steps of {what}", steps)
            )

        legs = (
            formulas(f"leg {k}", leg.to, leg.seconds, leg.steps)
            for k, leg in enumerate(self.legs, 1)
        )
        return formulas("the start", self.start, 0.0, 1), *legs

    def _corners(self, values: np.ndarray) -> list[_Corner]:
        """The start, and the ends of legs with a duration, for family parameters, (P_own,)."""
        with _naming(f"path '{self._called(values)}'"):
            start, *legs = self._formulas
            seconds = [
                _value(f"seconds of leg {k}", leg.seconds, values) for k, leg in enumerate(legs, 1)
            ]
            nothing = LEG_ROUND_OFF * max(map(abs, seconds))
            if not nothing:
                raise ParameterError("no leg takes any time: give one of them a duration")
            position = self._target("the start", start, values, {})
            corners = [_Corner(position, 0.0, 0)]
            for k, (leg, duration) in enumerate(zip(legs, seconds, strict=True), 1):
                before = dict(zip(self.space.names, position, strict=True))
                target = self._target(f"the end of leg {k}", leg, values, before)
                if duration < -nothing:
                    raise ParameterError(
                        f"leg {k} takes {duration:g} s, which must not be negative: correct the "
                        "formula"
                    )
                if duration > nothing:
                    steps = max(round(_value(f"steps of leg {k}", leg.steps, values)), 1)
                    if steps > MOST_LEG_STEPS:
                        raise ParameterError(f"leg {k} has {steps} steps: {MOST_LEG_STEPS} at most")
                    corners.append(_Corner(target, duration, steps))
                    position = target
                    continue
                jumps = np.abs(target - position) > LEG_ROUND_OFF * np.subtract(
                    self.space.upper, self.space.lower
                )
                if jumps.any():
                    changed = self.space.names[int(np.argmax(jumps))]
                    raise ParameterError(
                        f"leg {k} takes no time and changes {changed}: give it a duration"
                    )
            return corners

    def _target(
        self, where: str, leg: _Formulas, values: np.ndarray, before: Mapping[str, float]
    ) -> np.ndarray:
        """Point of the scene at the end of a leg, (P,).

        Parameters that it does not name are as before.
        """
        named = {
            name: _value(f"{name} at {where}", scalar, values) for name, scalar in leg.to.items()
        }
        with _naming(f"{where} is outside the box of the scene"):
            return self.space.point({**before, **named})

    @property
    def _title(self) -> str:
        return f"family of paths '{self.name}'"

    def _called(self, values: np.ndarray) -> str:
        return f"{self.name} ({self.own.described(values)})"


def _part_of(path: NamedPath, share: float) -> NamedPath:
    """Path over a fraction of the way from the start, at the same rates."""
    time, start = path[0]
    pairs = [(time + share * (end - time), start + share * (point - start)) for end, point in path]
    return NamedPath(pairs, f"{share:.2g} of {path.name}", {**path.values, "part": share})


def _cycled(path: NamedPath, cycles: int) -> NamedPath:
    """Path that is followed ``cycles`` times at the same rates.

    It is followed backwards between two times.
    """
    pairs = list(path)
    for _ in range(cycles - 1):
        for way in (path[::-1], path):
            turn = pairs[-1][0]
            first = way[0][0]
            pairs += [(turn + abs(time - first), point) for time, point in way[1:]]
    name = path.name if cycles == 1 else f"{cycles} cycles of {path.name}"
    return NamedPath(pairs, name, path.values)


class _Formulas(NamedTuple):
    """Formulas of a leg: values at its end by name, its seconds and its steps."""

    to: dict[str, Scalar]
    seconds: Scalar
    steps: Scalar


class _Corner(NamedTuple):
    """End of a leg, (P,), with its seconds and its steps."""

    target: np.ndarray
    seconds: float
    steps: int


@contextmanager
def _naming(what: str) -> Iterator[None]:
    """Prefix the messages of errors with their subject."""
    try:
        yield
    except (ParameterError, SceneError) as error:
        raise type(error)(f"{what}: {error}") from None


def _value(what: str, scalar: Scalar, values: np.ndarray) -> float:
    """Value of a formula at a point; ParameterError if it is not finite."""
    with _naming(f"{what} = {scalar.text}"):
        value = scalar.value(values)
        if not math.isfinite(value):
            raise ParameterError(f"is {value:g}, and must be finite: correct the formula")
        return value


def _kept(what: str, value: float | str) -> float | str:
    """A number or the text of a formula; SceneError for other values."""
    return float(value) if is_number(value) else formula_of(value, what).text


def _targets(what: str, given: Targets) -> tuple[tuple[str, float | str], ...]:
    """Pairs of names and values, from a mapping or from such pairs."""
    try:
        pairs = tuple(
            (name, value)
            for name, value in (given.items() if isinstance(given, Mapping) else given)
        )
    except (TypeError, ValueError):
        raise SceneError(
            f"{what} must map names of the scene's parameters to values, and is {given!r}"
        ) from None
    names = [name for name, _ in pairs]
    if not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise SceneError(
            f"{what} must name parameters of the scene once each by texts, and names {names}"
        )
    return tuple(
        (name, _kept(f"{name} in {what}", value))
        for name, value in sorted(pairs, key=lambda pair: pair[0])
    )
