"""Expressions of UFL in a :class:`~hhr_dolfinx.plugins.ufl_programs.graph.Graph`, component by
component.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.ufl_programs.graph import Graph

if TYPE_CHECKING:
    import ufl


def symbols(**shapes: tuple[int, ...]) -> dict[str, ufl.Constant]:
    """Constants of UFL by name.

    It needs basix, not DOLFINx.

    Args:
        shapes: shape of each, by name.

    Raises:
        SceneError: when a function of numbers, such as math.sqrt, is applied to one.
    """
    import basix.ufl
    import ufl

    class Symbol(ufl.Constant):
        """A constant without a value, which UFL would look for without end."""

        def evaluate(self, *_: object) -> float:
            """Refuse functions of numbers.

            Raises:
                SceneError: always.
            """
            raise SceneError(
                "a function of numbers meets a symbol: take that of ufl, ufl.sqrt for math.sqrt"
            )

    mesh = ufl.Mesh(basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,)))
    return {name: Symbol(mesh, shape=shape) for name, shape in shapes.items()}


def nodes_of(
    graph: Graph, expression: ufl.core.expr.Expr, inputs: Mapping[ufl.core.expr.Expr, list[int]]
) -> list[int]:
    """Nodes of all components of an expression of any shape, row by row.

    Args:
        graph: receives the nodes.
        expression: an expression of UFL.
        inputs: nodes of each symbol.

    Raises:
        SceneError: for operations that programs do not have, such as Bessel functions or
            derivatives in space, and for lists and arrays.
    """
    from ufl import as_ufl
    from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
    from ufl.algorithms.apply_derivatives import apply_derivatives

    if isinstance(expression, list | tuple | np.ndarray):
        kind = type(expression).__name__
        raise SceneError(
            f"a {kind} is no expression of UFL: ufl.as_vector and ufl.as_matrix make one of it"
        )
    lowered = apply_derivatives(apply_algebra_lowering(as_ufl(expression)))
    walk = _Walk(graph, inputs)
    return [walk.value(lowered, index, {}) for index in np.ndindex(*lowered.ufl_shape)]


_SCALAR = {
    "Sqrt": "sqrt",
    "Exp": "exp",
    "Ln": "log",
    "Sin": "sin",
    "Cos": "cos",
    "Tan": "tan",
    "Asin": "asin",
    "Acos": "acos",
    "Atan": "atan",
    "Sinh": "sinh",
    "Cosh": "cosh",
    "Tanh": "tanh",
    "Atan2": "atan2",
    "Power": "pow",
    "Abs": "abs",
    "MaxValue": "max",
    "MinValue": "min",
    "LT": "lt",
    "LE": "le",
    "EQ": "eq",
    "AndCondition": "and",
    "OrCondition": "or",
    "NotCondition": "not",
    "Product": "mul",
}
_TURNED = {"GT": "lt", "GE": "le"}
_SAME = {"Variable", "Conj", "Real"}


class _Walk:
    """One walk through an expression.

    Each part is translated once for each component and each free index.
    """

    def __init__(self, graph: Graph, inputs: Mapping[ufl.core.expr.Expr, list[int]]):
        self._graph = graph
        self._inputs = inputs
        self._memo: dict[tuple, int] = {}

    def value(self, part: ufl.core.expr.Expr, place: tuple[int, ...], free: dict[int, int]) -> int:
        """Node of a component of an expression.

        Args:
            part: the expression.
            place: its component.
            free: values of its free indices.
        """
        key = part, place, tuple(free[index] for index in part.ufl_free_indices)
        if key not in self._memo:
            self._memo[key] = self._leaf(part, place, free)
        return self._memo[key]

    def _leaf(self, part: ufl.core.expr.Expr, place: tuple[int, ...], free: dict[int, int]) -> int:
        if part in self._inputs:
            return self._inputs[part][
                int(np.ravel_multi_index(place, part.ufl_shape)) if place else 0
            ]
        kind = type(part).__name__
        if kind == "Zero":
            return self._graph.const(0)
        if kind in ("IntValue", "FloatValue", "RealValue"):
            return self._graph.const(float(part))
        if kind == "Identity":
            return self._graph.const(place[0] == place[1])
        return self._tensor(kind, part, place, free)

    def _tensor(
        self, kind: str, part: ufl.core.expr.Expr, place: tuple[int, ...], free: dict[int, int]
    ) -> int:
        operands = part.ufl_operands
        if kind in _SAME:
            return self.value(operands[0], place, free)
        if kind == "Indexed":
            fixed = ((index, type(index).__name__ == "FixedIndex") for index in operands[1])
            numbers = tuple(
                int(index) if is_fixed else free[index.count()] for index, is_fixed in fixed
            )
            return self.value(operands[0], numbers, free)
        if kind == "ComponentTensor":
            bound = {
                index.count(): number for index, number in zip(operands[1], place, strict=True)
            }
            return self.value(operands[0], (), free | bound)
        if kind == "ListTensor":
            return self.value(operands[place[0]], place[1:], free)
        if kind == "IndexSum":
            (index,) = operands[1]
            total = self._graph.const(0)
            for number in range(part.dimension()):
                total = self._graph.apply(
                    "add", total, self.value(operands[0], place, free | {index.count(): number})
                )
            return total
        if kind == "Sum":
            return self._graph.apply(
                "add", *(self.value(operand, place, free) for operand in operands)
            )
        if kind == "Division":
            return self._graph.apply(
                "div", self.value(operands[0], place, free), self.value(operands[1], (), free)
            )
        if kind == "Conditional":
            chosen = (self.value(operand, place, free) for operand in operands[1:])
            return self._graph.apply("select", self.value(operands[0], (), free), *chosen)
        scalars = [
            self.value(operand, (), free)
            for operand in operands
            if kind in _SCALAR or kind in _TURNED
        ]
        if kind in _TURNED:
            return self._graph.apply(_TURNED[kind], *scalars[::-1])
        if kind in _SCALAR:
            return self._graph.apply(_SCALAR[kind], *scalars)
        raise SceneError(
            f"{kind} is no operation of a program, in {str(part)[:80]}: state it by sums, "
            "products, powers, roots, exponentials, angles, conditionals, and the symbols that "
            "were given"
        )
