"""Functions of the parameters written as text: ``"E0 * (1 - 2e-4 * T)"``.

A formula is parsed once, checked, and stored as data; it is never executed as code. Its grammar has
numbers, names, ``+ - * / **``, ``pi``, the functions of :data:`FUNCTIONS`, and ``table(x, x0, y0,
x1, y1, ...)``, which is linear between its points and raises an error beyond them.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hhr_dolfinx.errors import ParameterError, SceneError
from hhr_dolfinx.parameters import ParameterSpace, is_number
from hhr_dolfinx.plain import Rebuilt

Number = float | complex | np.ndarray
Values = Mapping[str, Number]
"""Numbers or arrays by name; complex ones have a derivative in the imaginary part."""
_Evaluate = Callable[[Values], Any]

IMAGINARY_STEP = 1e-30
"""Imaginary step of a derivative: f(x + i h) = f(x) + i h f'(x) has no cancellation, so that h may
be this small.
"""
LONGEST_FORMULA = 20_000
"""Largest number of characters of a formula."""
DEEPEST_FORMULA = 400
"""Largest depth of nested operations, such as a sum of 400 terms: each takes a frame of Python,
which allows 1000.
"""


def coordinate_names(hypothesis: str) -> tuple[str, ...]:
    """Names of the coordinates of a mesh in formulas."""
    return {"axisymmetric": ("r", "z"), "solid": ("x", "y", "z")}.get(hypothesis, ("x", "y"))


def _chosen(choose: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
    return lambda x, y: np.where(choose(np.real(x), np.real(y)), x, y)


FUNCTIONS: Mapping[str, tuple[int, Callable[..., np.ndarray]]] = {
    **{
        name: (1, getattr(np, name)) for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "tanh")
    },
    "abs": (
        1,
        lambda x: np.where(np.real(x) < 0, -x, x),
    ),  # the modulus of complex numbers would lose the derivative
    "min": (2, _chosen(np.less)),
    "max": (2, _chosen(np.greater)),
}
"""Functions that a formula may call, in addition to ``table``: number of arguments, and
implementation.
"""


def _power(a: Any, b: Any) -> Number:
    """Power a ** b; NaN for the root of a negative number, of which Python returns a complex one.

    Python computes large powers of complex numbers by their angle, which loses the derivative at a
    negative real part.
    """
    if np.iscomplexobj(a) and not np.any(np.imag(b)):
        base = np.asarray(np.real(a))
        exponent = np.real(b)
        with np.errstate(all="ignore"):
            slope = np.where(exponent == 0, 0.0, exponent * base ** (exponent - 1))
            return base**exponent + 1j * slope * np.imag(a)
    power = a**b
    return (
        math.nan
        if isinstance(power, complex) and isinstance(a, float) and isinstance(b, float)
        else power
    )


_OPERATORS: Mapping[type, Callable[[Number, Number], Number]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: _power,
}


@dataclass(frozen=True)
class Formula(Rebuilt):
    """A function of named numbers, as text.

    Attributes:
        text: text in the grammar of this module.

    Raises:
        SceneError: for other text, with the position of the fault.

    Example:
        >>> formula = Formula("E * (1 - 2e-4 * T)")
        >>> formula.variables, float(formula({"E": 200e3, "T": 100.0}))
        (('E', 'T'), 196000.0)
    """

    text: str

    def __post_init__(self) -> None:
        if not isinstance(self.text, str) or not 0 < len(self.text) <= LONGEST_FORMULA:
            raise SceneError(
                f"a formula must be a text, such as '2 * E', and is {str(self.text)[:60]!r}"
            )
        if "#" in self.text:  # would hide the text after it, for example in a product
            raise SceneError(
                f"the formula {self.text[:80]!r} holds a comment: write it beside the formula"
            )
        self._parsed  # noqa: B018 (faults are reported where the formula is written)

    @cached_property
    def _parsed(self) -> tuple[_Evaluate, tuple[str, ...]]:
        label = f"the formula {self.text[:80]!r}"
        names: dict[str, None] = {}
        try:
            tree = ast.parse(self.text.strip(), mode="eval").body
            level = 0
            nodes = [tree]
            while nodes and level <= DEEPEST_FORMULA:
                level += 1
                nodes = [
                    inner
                    for node in nodes
                    for inner in ast.iter_child_nodes(node)
                    if isinstance(inner, ast.expr)
                ]
            if level > DEEPEST_FORMULA:
                raise SceneError(
                    f"{label} nests more than {DEEPEST_FORMULA} operations: put parts of a "
                    f"long sum in "
                    "brackets"
                )
            return _compiled(tree, names, label), tuple(names)
        except SceneError:
            raise
        except SyntaxError as error:
            raise SceneError(
                f"{label} cannot be read: {error.msg}. Write numbers without units: '2 * E'"
            ) from None
        except (RecursionError, MemoryError, ValueError) as error:
            raise SceneError(f"{label} cannot be read: {error}") from None

    @cached_property
    def _calls(self) -> bool:
        """True if the formula calls functions, which may warn outside their domain."""
        return "(" in self.text and any(name in self.text for name in (*FUNCTIONS, "table"))

    @property
    def variables(self) -> tuple[str, ...]:
        """Names in the formula, in their order."""
        return self._parsed[1]

    def __call__(self, values: Values) -> Any:
        """Value for numbers or arrays by name; ParameterError beyond the ends of a table."""
        try:
            if not self._calls:
                return self._parsed[0](values)
            with np.errstate(all="ignore"):
                return self._parsed[0](values)
        except (OverflowError, ZeroDivisionError):
            return math.nan

    def times(self, other: Formula) -> Formula:
        """The product of two formulas."""
        return Formula(f"({self.text}) * ({other.text})")


def formula_of(value: float | str | Formula, what: str) -> Formula:
    """A number or a text as a formula.

    Args:
        value: number, text or formula.
        what: name of the value, for the message.

    Raises:
        SceneError: for anything else.
    """
    if is_number(value):
        return Formula(repr(float(value)))
    if isinstance(value, Formula):
        return value
    if isinstance(value, str):
        try:
            return Formula(value)
        except SceneError as error:
            raise SceneError(f"{what}: {error}") from None
    raise SceneError(
        f"{what} = {value!r} must be a finite number, the name of a parameter, or a formula of "
        "parameters as text"
    )


@dataclass(frozen=True)
class Scalar(Rebuilt):
    """Formula of the parameters of a scene, ``names``.

    An amplitude of a single column, or a factor in K.
    """

    text: str
    names: tuple[str, ...]

    count = 1

    def __post_init__(self) -> None:
        unknown = set(self.formula.variables) - set(self.names)
        if "pi" in self.names:
            raise SceneError(
                "a parameter is named 'pi', which formulas take for 3.14...: rename it"
            )
        if unknown:
            raise SceneError(
                f"the formula {self.text[:80]!r} names {sorted(unknown)}, the parameters are "
                f"{self.names}: correct the name, or add it to the ParameterSpace"
            )

    @cached_property
    def formula(self) -> Formula:
        """The parsed formula."""
        return Formula(self.text)

    @cached_property
    def _places(self) -> tuple[tuple[str, int], ...]:
        return tuple((name, self.names.index(name)) for name in self.formula.variables)

    def value(self, point: np.ndarray) -> float:
        """Value at a point, (P,); NaN outside its domain."""
        # numbers of Python are several times as fast as those of numpy, and complex where numpy
        # returns NaN
        value = self.formula({name: float(point[index]) for name, index in self._places})
        return math.nan if isinstance(value, complex) else float(value)

    def values(self, points: np.ndarray) -> np.ndarray:
        """Values at many points, (n, P): (n,); NaN outside its domain."""
        with np.errstate(all="ignore"):
            result = self.formula({name: points[:, index] for name, index in self._places})
        return np.broadcast_to(np.asarray(result, dtype=float), len(points))

    def derivative(self, point: np.ndarray) -> np.ndarray:
        """Derivatives along the parameters at a point, exact to round-off, (P,)."""
        derivatives = np.zeros(len(self.names))
        values = {name: complex(point[index]) for name, index in self._places}
        for name, index in self._places:
            changed = self.formula(values | {name: values[name] + 1j * IMAGINARY_STEP})
            derivatives[index] = np.imag(changed) / IMAGINARY_STEP
        return derivatives

    def __call__(self, point: np.ndarray) -> tuple[list[int], list[float]]:
        """Column and value, see :class:`~hhr_dolfinx.amplitudes.NonAffine`."""
        return [0], [self.value(point)]


@dataclass(frozen=True)
class Modulus(Rebuilt):
    """Amplitude of one part of a stiffness.

    The factor of the body, its Young's modulus, times the factor of this part.
    """

    factor: str
    rest: str
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        # unknown names are reported where they are written
        self.factor_scalar, self.rest_scalar  # noqa: B018

    @cached_property
    def factor_scalar(self) -> Scalar:
        """The common factor, bound to the parameters."""
        return Scalar(self.factor, self.names)

    @cached_property
    def rest_scalar(self) -> Scalar:
        """The factor of this part, bound to the parameters."""
        return Scalar(self.rest, self.names)

    def value(self, point: np.ndarray) -> float:
        """Factor times rest at a point, (P,)."""
        return self.factor_scalar.value(point) * self.rest_scalar.value(point)

    def values(self, points: np.ndarray) -> np.ndarray:
        """Factor times rest at many points, (n, P): (n,)."""
        return self.factor_scalar.values(points) * self.rest_scalar.values(points)

    def derivative(self, point: np.ndarray) -> np.ndarray:
        """Derivatives along the parameters, (P,)."""
        factor_scalar = self.factor_scalar
        rest_scalar = self.rest_scalar
        return factor_scalar.value(point) * rest_scalar.derivative(point) + rest_scalar.value(
            point
        ) * factor_scalar.derivative(point)


def check_over_box(
    scalar: Scalar, space: ParameterSpace, what: str, low: float, high: float, remedy: str
) -> None:
    """Check a scalar at corners of the box, 256 points between, and on dense lines.

    Args:
        scalar: the scalar.
        space: the box of the parameters.
        what: name of the value, for the message.
        low, high: ends of the open interval of its values.
        remedy: advice for a value outside it.

    Raises:
        SceneError: for a value outside the interval, or a point beyond a table.
    """
    for point in (*box_samples(space), *_doubtful(scalar, space, low, high)):
        try:
            value = scalar.value(point)
        except ParameterError as error:
            raise SceneError(
                f"{what} = {scalar.text}: {error}. Give the table further points, or narrow the box"
            ) from None
        if not low < value < high:
            raise SceneError(
                f"{what} = {scalar.text} is {value:g} at {space.described(point)}: {remedy}"
            )


def box_samples(space: ParameterSpace, count: int = 256) -> np.ndarray:
    """Corners of the box, its middle, and random points, for checks over the whole box, (n, P).

    Args:
        space: the box of the parameters.
        count: number of random points.
    """
    ends = np.array([space.lower, space.upper], dtype=float)
    dimension = len(space.names)
    bits = np.arange(2 ** min(dimension, 10))
    corners = np.array(
        [[ends[(k >> (axis % 10)) & 1, axis] for axis in range(dimension)] for k in bits]
    )
    return np.vstack([ends.mean(axis=0), corners, space.random(count, seed=0)])


def _doubtful(scalar: Scalar, space: ParameterSpace, low: float, high: float) -> np.ndarray:
    """First point at which a scalar leaves (low, high), (1, P), or (0, P) without one.

    Many points along its parameters are tried.
    """
    points = space.lines([space.names.index(name) for name in scalar.formula.variables])
    try:
        values = scalar.values(points)
    except ParameterError:  # a point beyond a table: the caller finds it one by one
        return points
    return points[~((low < values) & (values < high))][:1]


def _compiled(node: ast.expr, names: dict[str, None], what: str) -> _Evaluate:
    """A node as a function of values by name.

    SceneError, of ``what``, for syntax that formulas do not have.
    """
    if (
        isinstance(node, ast.Constant)
        and isinstance(node.value, int | float)
        and is_number(node.value)
    ):
        number = float(node.value)
        return lambda values: number
    if isinstance(node, ast.Name):
        if node.id == "pi":
            return lambda values: math.pi
        name = node.id
        names[name] = None
        return lambda values: values[name]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        inner = _compiled(node.operand, names, what)
        return (lambda values: -inner(values)) if isinstance(node.op, ast.USub) else inner
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        operator = _OPERATORS[type(node.op)]
        left = _compiled(node.left, names, what)
        right = _compiled(node.right, names, what)
        return lambda values: operator(left(values), right(values))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        return _called(node.func.id, node.args, names, what)
    raise SceneError(
        f"{what} holds {ast.unparse(node)[:40]!r}, which is unknown: numbers, parameters, + - * / "
        f"**, pi, table and {', '.join(FUNCTIONS)} are known"
    )


def _called(
    name: str, arguments: Sequence[ast.expr], names: dict[str, None], what: str
) -> _Evaluate:
    inner = [_compiled(argument, names, what) for argument in arguments]
    if name == "table":
        return _table(inner, what)
    if name not in FUNCTIONS:
        raise SceneError(f"{what} calls {name!r}: table and {', '.join(FUNCTIONS)} are known")
    count, function = FUNCTIONS[name]
    if len(inner) != count:
        raise SceneError(f"{what} gives {name} {len(inner)} arguments: it takes {count}")
    if count == 1:
        first = inner[0]
        return lambda values: function(first(values))
    first, second = inner
    return lambda values: function(first(values), second(values))


def _table(inner: list[_Evaluate], what: str) -> _Evaluate:
    try:
        with np.errstate(all="ignore"):
            numbers = [float(entry({})) for entry in inner[1:]]
    except (KeyError, ArithmeticError):
        raise SceneError(f"the table of {what} must hold numbers after its variable") from None
    at = np.array(numbers[::2])
    values = np.array(numbers[1::2])
    finite = np.isfinite(numbers).all()
    if len(at) < 2 or len(at) != len(values) or not finite or not (np.diff(at) > 0).all():
        raise SceneError(
            f"the table of {what} must be table(x, x0, y0, x1, y1, ...) with two points or more, "
            "x0 < x1 < ..., all of them finite"
        )
    variable = inner[0]
    slopes = np.diff(values) / np.diff(at)

    def evaluate(arguments: Values) -> np.ndarray:
        """Interpolated values of the table.

        Raises:
            ParameterError: outside the table.
        """
        x = np.asarray(variable(arguments))
        real = np.real(x)
        slack = 1e-9 * (at[-1] - at[0])
        beyond = (real < at[0] - slack) | (real > at[-1] + slack)
        if beyond.any():
            raise ParameterError(
                f"{real[beyond].ravel()[0]:g} is outside the table from {at[0]:g} to {at[-1]:g}"
            )
        piece = np.clip(np.searchsorted(at, real, side="right") - 1, 0, len(slopes) - 1)
        return values[piece] + slopes[piece] * (x - at[piece])

    return evaluate
