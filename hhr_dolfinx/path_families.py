"""Families of paths: histories as values with a name and parameters of their own, drawn from a sampling like points.

A family says where its paths start and by which legs they go on. What it says are formulas of its own parameters, such
as a height, a hold, a pace: texts that are parsed and never executed, see :mod:`hhr_dolfinx.formulas`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np

from hhr_dolfinx.errors import ParameterError, SceneError
from hhr_dolfinx.formulas import Scalar, box_samples, formula_of
from hhr_dolfinx.parameters import ParameterSpace, is_number, is_whole

Targets = Mapping[str, float | str] | tuple[tuple[str, float | str], ...]
"""Numbers or formulas of the own parameters, by the names of parameters of the scene."""

NOTHING = 1e-12
"""Fraction of the longest leg, and of a parameter's range, that is round-off of a formula that was to be zero."""
MOST_STEPS = 100_000


@runtime_checkable
class Sampling(Protocol):
    """What paths are drawn from: ``Sobol``, ``LatinHypercube``, or an object of your own."""

    def points(self, space: ParameterSpace) -> np.ndarray:
        """Points of a box, (n, P)."""


class NamedPath(list[tuple[float, np.ndarray]]):
    """A path, a list of times in s and parameters (P,), that knows what it is called and where it was drawn.

    Attributes:
        name: of its family, with the values; it labels the path in reports.
        values: own parameters of the family by name.
    """

    def __init__(self, pairs: Iterable[tuple[float, np.ndarray]], name: str, values: Mapping[str, float]):
        super().__init__(pairs)
        self.name = name
        self.values = dict(values)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, NamedPath):
            return NotImplemented
        alike = (self.name, self.values, len(self)) == (other.name, other.values, len(other))
        return alike and all(
            time == there and np.array_equal(point, target)
            for (time, point), (there, target) in zip(self, other, strict=True)
        )

    __hash__ = None

    def __repr__(self) -> str:
        return f"<path {self.name!r}: {len(self)} times{f' to {self[-1][0]:g} s' if self else ''}>"


@dataclass(frozen=True)
class Leg:
    """A part of a path along which parameters of the scene change linearly in time.

    Attributes:
        to: where it ends, by the names of parameters of the scene: numbers or formulas of the family's own parameters.
            What is not named stays as it is.
        seconds: how long it takes, a number or a formula. A leg that takes no time is left out.
        steps: of equal length; the value of a formula is rounded, and at least one.

    Raises:
        SceneError: for what is neither a number nor a formula, negative seconds, and steps that are none.
    """

    to: Targets
    seconds: float | str
    steps: int | str

    def __post_init__(self) -> None:
        object.__setattr__(self, "to", _targets("a leg", self.to))
        object.__setattr__(self, "seconds", _kept("the seconds of a leg", self.seconds))
        if not isinstance(self.seconds, str) and self.seconds < 0:
            raise SceneError(f"a leg takes {self.seconds:g} s: give it a duration that is not negative")
        if isinstance(self.steps, str):
            formula_of(self.steps, "the steps of a leg")
        elif not is_whole(self.steps, 1):
            raise SceneError(f"steps = {self.steps!r} of a leg must be a positive integer, or a formula as text")
        else:
            object.__setattr__(self, "steps", int(self.steps))


@dataclass(frozen=True)
class PathFamily:
    """Paths of one kind, a value for each point of a box of their own parameters.

    Attributes:
        name: of the family.
        space: parameters of the scene, ``scene.parameters``, in whose order points of a path are.
        own: the family's own parameters; formulas may name these and no others.
        start: where paths start, at time 0: every parameter of the scene, as a number or a formula.
        legs: how they go on, one behind the other.

    Raises:
        SceneError: for an unknown name, a parameter of the scene without a start, a formula that names what is no own
            parameter, and where a path somewhere in the box of the own parameters is none: a point outside the box of
            the scene, a negative duration, what is not finite.

    Example:
        >>> space = ParameterSpace(("load", "gap"), (0.0, 0.0), (450.0, 0.02))
        >>> own = ParameterSpace(("gap", "hold"), (5.0, 0.0), (15.0, 10.0))
        >>> start = {"load": 0.0, "gap": "1e-3 * gap"}
        >>> family = PathFamily("held", space, own, start, (Leg({"load": 450.0}, 1.0, 40), Leg({}, "hold", 10)))
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
            raise SceneError(f"the name {self.name!r} of a family of paths must be a text that is not empty")
        for part in ("space", "own"):
            if not isinstance(getattr(self, part), ParameterSpace):
                raise SceneError(
                    f"{part} = {getattr(self, part)!r} of the family '{self.name}' must be a ParameterSpace: give "
                    "space=scene.parameters, and a box of the family's own parameters"
                )
        legs = tuple(self.legs) if isinstance(self.legs, list | tuple) else ()
        if not legs or not all(isinstance(leg, Leg) for leg in legs):
            raise SceneError(f"legs = {self.legs!r} of the family '{self.name}' must be a tuple of one Leg or more")
        object.__setattr__(self, "legs", legs)
        with self._naming():
            object.__setattr__(self, "start", _targets("the start", self.start))
        missing = [name for name in self.space.names if name not in dict(self.start)]
        if missing:
            raise SceneError(
                f"the start of the family '{self.name}' gives no {', '.join(missing)}: add a value of each"
            )
        self._formulas  # noqa: B018 (unknown names are refused where they are written)
        for point in box_samples(self.own):
            try:
                self._corners(point)
            except ParameterError as error:
                raise SceneError(f"{error}; or narrow the box of the family's own parameters") from None

    def path(self, point: Any) -> NamedPath:
        """The path of a point of the own parameters: a sequence, (P_own,), or a mapping by name.

        Raises:
            ParameterError: for a point outside the family's own box, or where the path leaves the box of the scene or
                its times do not increase.
        """
        with self._naming():
            values = self.own.point(point)
        time, (here, *ends) = 0.0, self._corners(values)
        pairs = [(time, here.target)]
        for end in ends:
            shares = np.arange(1, end.steps + 1) / end.steps
            times = time + end.seconds * shares
            if not (np.diff(times, prepend=time) > 0).all():
                raise ParameterError(
                    f"{self._at(values)}: times must increase, and {end.steps} steps in {end.seconds:g} s are too "
                    f"short behind {time:g} s. Make the legs more alike"
                )
            # what does not change stays the same to the last bit, and each leg ends where the next begins
            targets = [here.target + (end.target - here.target) * share for share in shares[:-1]] + [end.target]
            pairs += [(float(instant), target.copy()) for instant, target in zip(times, targets, strict=True)]
            time, here = float(times[-1]), end
        return NamedPath(pairs, self._called(values), dict(zip(self.own.names, values.tolist(), strict=True)))

    def paths(self, drawn: Sampling | np.ndarray) -> list[NamedPath]:
        """Paths of a sampling, such as ``Sobol(12)``, or of points of the own parameters, (n, P_own).

        Raises:
            ParameterError: as :meth:`path` does, and for what is neither.
        """
        with self._naming():
            table = drawn.points(self.own) if isinstance(drawn, Sampling) else drawn
            points = self.own.points(table)
        return [self.path(point) for point in points]

    @cached_property
    def _formulas(self) -> tuple[dict[str, Scalar], tuple[tuple[dict[str, Scalar], Scalar, Scalar], ...]]:
        """Start by names, and of each leg where it ends, its seconds and its steps."""

        def scalars(what: str, targets: Targets) -> dict[str, Scalar]:
            unknown = sorted(set(dict(targets)) - set(self.space.names))
            if unknown:
                raise SceneError(
                    f"{what} of the family '{self.name}' names {unknown}, the scene has {self.space.names}: correct it"
                )
            return {name: scalar(f"{name} in {what}", value) for name, value in dict(targets).items()}

        def scalar(what: str, value: float | str) -> Scalar:
            with self._naming():
                try:
                    return Scalar(formula_of(value, what).text, self.own.names)
                except SceneError as error:
                    raise SceneError(f"{what}: {error}") from None

        legs = tuple(
            (
                scalars(f"leg {k}", leg.to),
                scalar(f"seconds of leg {k}", leg.seconds),
                scalar(f"steps of leg {k}", leg.steps),
            )
            for k, leg in enumerate(self.legs, 1)
        )
        return scalars("the start", self.start), legs

    def _corners(self, values: np.ndarray) -> list[_Corner]:
        """The start and the ends of the legs that take time, for own parameters (P_own,)."""
        start, legs = self._formulas
        value = self._values_at(values)
        seconds = [value(f"seconds of leg {k}", leg[1]) for k, leg in enumerate(legs, 1)]
        nothing = NOTHING * max(map(abs, seconds))
        here = self._target(values, "the start", {name: value(f"{name} at the start", start[name]) for name in start})
        found = [_Corner(here, 0.0, 0)]
        for k, (to, _, steps) in enumerate(legs, 1):
            changes = {name: value(f"{name} at the end of leg {k}", scalar) for name, scalar in to.items()}
            target = self._target(
                values, f"the end of leg {k}", dict(zip(self.space.names, here, strict=True)) | changes
            )
            if seconds[k - 1] < -nothing:
                raise ParameterError(
                    f"{self._at(values)}: leg {k} takes {seconds[k - 1]:g} s, which must not be negative"
                )
            if seconds[k - 1] > nothing:
                count = max(round(value(f"steps of leg {k}", steps)), 1)
                if count > MOST_STEPS:
                    raise ParameterError(f"{self._at(values)}: leg {k} has {count} steps, {MOST_STEPS} at most")
                found.append(_Corner(target, seconds[k - 1], count))
                here = target
            elif (jumps := np.abs(target - here) > NOTHING * np.subtract(self.space.upper, self.space.lower)).any():
                name = self.space.names[int(np.argmax(jumps))]
                raise ParameterError(
                    f"{self._at(values)}: leg {k} takes no time and changes {name}: give it a duration"
                )
        if len(found) < 2:
            raise ParameterError(f"{self._at(values)}: no leg takes any time, so that there is no path")
        return found

    def _values_at(self, values: np.ndarray) -> Callable[[str, Scalar], float]:
        """How formulas are evaluated: by what is to be named, and the formula."""

        def value(what: str, scalar: Scalar) -> float:
            try:
                found = scalar.value(values)
            except ParameterError as error:
                raise ParameterError(f"{self._at(values)}: {what} = {scalar.text}: {error}") from None
            if not math.isfinite(found):
                raise ParameterError(f"{self._at(values)}: {what} = {scalar.text} is {found:g}: correct the formula")
            return found

        return value

    def _target(self, values: np.ndarray, where: str, given: Mapping[str, float]) -> np.ndarray:
        """A point of the scene, (P,)."""
        try:
            return self.space.point(given)
        except ParameterError as error:
            named = ", ".join(f"{name} = {given[name]:g}" for name in self.space.names)
            raise ParameterError(
                f"{self._at(values)} leaves the box of the scene at {where} ({named}): {error}"
            ) from None

    @contextmanager
    def _naming(self) -> Iterator[None]:
        """Put the family's name before errors."""
        try:
            yield
        except (ParameterError, SceneError) as error:
            raise type(error)(f"family of paths '{self.name}': {error}") from None

    def _called(self, values: np.ndarray) -> str:
        return f"{self.name} ({self.own.described(values)})"

    def _at(self, values: np.ndarray) -> str:
        return f"path '{self._called(values)}'"


@dataclass(frozen=True)
class _Corner:
    """Where a leg ends, (P,), its seconds, and its steps."""

    target: np.ndarray
    seconds: float
    steps: int


def _kept(what: str, value: Any) -> float | str:
    """A number or the text of a formula; SceneError for what is neither."""
    return float(value) if is_number(value) else formula_of(value, what).text


def _targets(what: str, given: Any) -> tuple[tuple[str, float | str], ...]:
    """Pairs of names and values of a mapping, or of such pairs."""
    try:
        pairs = tuple((name, value) for name, value in (given.items() if isinstance(given, Mapping) else given))
    except (TypeError, ValueError):
        raise SceneError(f"{what} must map names of the scene's parameters to values, and is {given!r}") from None
    names = [name for name, _ in pairs]
    if not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise SceneError(f"{what} must name parameters of the scene once each by texts, and names {names}")
    return tuple((name, _kept(f"{name} in {what}", value)) for name, value in sorted(pairs, key=lambda pair: pair[0]))
