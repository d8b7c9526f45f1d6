"""Graph of scalar operations: each node once, constants folded, derivatives in the graph itself.

Derivatives are made in the graph, which is quicker than in UFL and shares operations with the
value.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from itertools import compress

OPERATIONS = {
    "add": 2,
    "sub": 2,
    "mul": 2,
    "div": 2,
    "neg": 1,
    "sqrt": 1,
    "exp": 1,
    "log": 1,
    "pow": 2,
    "abs": 1,
    "sin": 1,
    "cos": 1,
    "tan": 1,
    "asin": 1,
    "acos": 1,
    "atan": 1,
    "sinh": 1,
    "cosh": 1,
    "tanh": 1,
    "atan2": 2,
    "max": 2,
    "min": 2,
    "lt": 2,
    "le": 2,
    "eq": 2,
    "and": 2,
    "or": 2,
    "not": 1,
    "select": 3,
}
"""Operations with their numbers of operands.

Comparisons are 1.0 or 0.0; ``select`` is its second operand if the first one is not 0, and else its
third.
"""

_SYMMETRIC = {"add", "mul", "max", "min", "eq", "and", "or"}
_STEPS = {"lt", "le", "eq", "and", "or", "not"}
_FOLDED: dict[str, Callable[..., float]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": operator.neg,
    "pow": operator.pow,
    "abs": abs,
    "sqrt": math.sqrt,
    "exp": math.exp,
    "log": math.log,
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "max": max,
    "min": min,
}
LARGEST_POWER = 32
"""Largest whole exponent that becomes products."""

Node = tuple


class Graph:
    """Nodes, each an operation with the numbers of its operands.

    ``("const", value)`` or ``("input", name, place)``.
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._known: dict[Node, int] = {}
        self._derivatives: dict[int, dict[int, int]] = {}

    def input(self, name: str, place: int = 0) -> int:
        """Node of a component of an input, the same for the same arguments.

        Args:
            name: name of the input.
            place: index of the component.
        """
        return self._node(("input", name, place))

    def const(self, value: float) -> int:
        """Node of a constant."""
        return self._node(("const", float(value)))

    def number(self, node: int) -> float | None:
        """Value of a node that is a constant; None for other nodes."""
        kind, *values = self.nodes[node]
        return values[0] if kind == "const" else None

    def _node(self, key: Node) -> int:
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(key)
        return self._known[key]

    def apply(self, operation: str, *args: int) -> int:
        """Node of one of :data:`OPERATIONS` on nodes, simplified.

        Constants are folded if the result is finite.
        """
        numbers = [self.number(arg) for arg in args]
        folded = self._folded(operation, numbers)
        if folded is not None:
            return folded
        simpler = getattr(self, f"_{operation}", None)
        simplified: int | None = None if simpler is None else simpler(*args, *numbers)
        if simplified is not None:
            return simplified
        return self._node((operation, *(sorted(args) if operation in _SYMMETRIC else args)))

    def _folded(self, operation: str, numbers: Sequence[float | None]) -> int | None:
        if None in numbers or operation not in _FOLDED:
            return None
        try:
            value = _FOLDED[operation](*numbers)
            return self.const(value) if math.isfinite(value) else None
        except (ArithmeticError, ValueError, TypeError):  # the program computes infinity or NaN
            return None

    def _is(self, node: int, operation: str) -> bool:
        return self.nodes[node][0] == operation

    def _add(self, a: int, b: int, x: float | None, y: float | None) -> int | None:
        if x == 0 or y == 0:
            return b if x == 0 else a
        if self._is(b, "neg"):
            return self.apply("sub", a, self.nodes[b][1])
        return self.apply("sub", b, self.nodes[a][1]) if self._is(a, "neg") else None

    def _sub(self, a: int, b: int, x: float | None, y: float | None) -> int | None:
        if a == b:
            return self.const(0)
        if x == 0 or y == 0:
            return self.apply("neg", b) if x == 0 else a
        return self.apply("add", a, self.nodes[b][1]) if self._is(b, "neg") else None

    def _neg(self, a: int, _: float | None) -> int | None:
        if self._is(a, "neg"):
            return int(self.nodes[a][1])
        return self._node(("sub", *self.nodes[a][:0:-1])) if self._is(a, "sub") else None

    def _mul(self, a: int, b: int, x: float | None, y: float | None) -> int | None:
        if y is not None:
            return self._mul(b, a, y, None) if x is None else None
        if x == 0:
            return self.const(0)
        if x == 1:
            return b
        if x == -1:
            return self.apply("neg", b)
        for factor, other_factor in ((a, b), (b, a)):
            if self._is(factor, "neg"):
                return self.apply("neg", self.apply("mul", self.nodes[factor][1], other_factor))
        if x is not None and self._is(b, "mul"):  # constants together
            for first, second in (self.nodes[b][1:], self.nodes[b][:0:-1]):
                inner = self.number(first)
                if inner is not None:
                    return self.apply("mul", self.const(x * inner), second)
        return None

    def _div(self, a: int, b: int, x: float | None, y: float | None) -> int | None:
        if x == 0:
            return a
        if y:
            return self.apply("mul", a, self.const(1 / y))
        return self.const(1) if a == b else None

    def _pow(self, a: int, b: int, _: float | None, y: float | None) -> int | None:
        if y is None:
            return None
        if y in (0, 1):
            return a if y else self.const(1)
        if y in (0.5, -0.5):
            root = self.apply("sqrt", a)
            return root if y > 0 else self.apply("div", self.const(1), root)
        if y != int(y) or abs(y) > LARGEST_POWER:
            return None
        if y < 0:
            return self.apply("div", self.const(1), self.apply("pow", a, self.const(-y)))
        half = self.apply("pow", a, self.const(y // 2))
        square = self.apply("mul", half, half)
        return self.apply("mul", a, square) if y % 2 else square

    def _select(
        self, test: int, yes: int, no: int, x: float | None, *_: float | None
    ) -> int | None:
        if yes == no or x is not None:
            return yes if yes == no or x else no
        return None

    def substituted(self, nodes: Sequence[int], table: dict[int, int]) -> list[int]:
        """Nodes with some others replaced, simplified again.

        Args:
            nodes: the nodes.
            table: replacement of each node that is replaced.

        Returns:
            As many nodes as were given.
        """
        memo = dict(table)
        for index in self.needed(nodes):
            if index not in memo:
                kind, *args = self.nodes[index]
                leaf = kind in ("const", "input") or all(memo[arg] == arg for arg in args)
                memo[index] = index if leaf else self.apply(kind, *(memo[arg] for arg in args))
        return [memo[node] for node in nodes]

    def needed(self, nodes: Sequence[int]) -> list[int]:
        """All nodes that ``nodes`` depend on, and these, without repetition, operands first."""
        needed = bytearray(max(nodes, default=-1) + 1)
        for node in nodes:
            needed[node] = 1
        for index in range(len(needed) - 1, -1, -1):
            kind, *args = self.nodes[index]
            if needed[index] and kind not in ("const", "input"):
                for arg in args:
                    needed[arg] = 1
        return list(compress(range(len(needed)), needed))

    def derivative(self, node: int, by: int) -> int:
        """Node of a derivative by an input.

        Forwards, so that NaN of branches not chosen does not spread.

        Args:
            node: the node.
            by: node of the input.
        """
        memo = self._derivatives.setdefault(by, {})
        for index in self.needed([node]):
            if index not in memo:
                memo[index] = self._derived(index, by, memo)
        return memo[node]

    def jacobian(self, nodes: Sequence[int], by: Sequence[int]) -> list[int]:
        """Nodes of derivatives of nodes by inputs, row by row.

        Args:
            nodes: the nodes.
            by: nodes of the inputs.
        """
        return [self.derivative(node, input_node) for node in nodes for input_node in by]

    def _derived(self, place: int, by: int, memo: dict[int, int]) -> int:
        kind, *args = self.nodes[place]
        if kind in ("const", "input"):
            return self.const(place == by)
        zero = self.const(0)
        changes = [memo[arg] for arg in args]
        if kind in _STEPS or all(change == zero for change in changes):
            return zero
        if kind in ("add", "sub", "neg"):
            return self.apply(kind, *changes)
        if kind == "select":
            return self.apply("select", args[0], *changes[1:])
        if kind in ("max", "min"):
            less = self.apply("lt", *args)
            return self.apply("select", less, *(changes[::-1] if kind == "max" else changes))
        products = [
            zero
            if change == zero
            else self.apply("mul", self._slope(kind, number, place, args), change)
            for number, change in enumerate(changes)
        ]
        return products[0] if len(products) == 1 else self.apply("add", *products)

    def _slope(self, kind: str, number: int, place: int, args: list[int]) -> int:
        """Derivative of an operation by its operand ``number``."""
        do = self.apply
        unit = self.const(1)
        a = args[0]
        b = args[-1]
        rules: dict[tuple[str, int], Callable[[], int]] = {
            ("mul", 0): lambda: b,
            ("mul", 1): lambda: a,
            ("div", 0): lambda: do("div", unit, b),
            ("div", 1): lambda: do("neg", do("div", place, b)),
            ("pow", 0): lambda: do("mul", b, do("pow", a, do("sub", b, unit))),
            ("pow", 1): lambda: do("mul", place, do("log", a)),
            ("abs", 0): lambda: do("select", do("lt", a, self.const(0)), self.const(-1), unit),
            ("sqrt", 0): lambda: do("div", self.const(0.5), place),
            ("exp", 0): lambda: place,
            ("log", 0): lambda: do("div", unit, a),
            ("sin", 0): lambda: do("cos", a),
            ("cos", 0): lambda: do("neg", do("sin", a)),
            ("tan", 0): lambda: do("add", unit, do("mul", place, place)),
            ("asin", 0): lambda: do("div", unit, do("sqrt", do("sub", unit, do("mul", a, a)))),
            ("acos", 0): lambda: do(
                "div", self.const(-1), do("sqrt", do("sub", unit, do("mul", a, a)))
            ),
            ("atan", 0): lambda: do("div", unit, do("add", unit, do("mul", a, a))),
            ("sinh", 0): lambda: do("cosh", a),
            ("cosh", 0): lambda: do("sinh", a),
            ("tanh", 0): lambda: do("sub", unit, do("mul", place, place)),
            ("atan2", 0): lambda: do("div", b, do("add", do("mul", a, a), do("mul", b, b))),
            ("atan2", 1): lambda: do(
                "neg", do("div", a, do("add", do("mul", a, a), do("mul", b, b)))
            ),
        }
        return rules[kind, number]()
