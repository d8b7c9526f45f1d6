"""Straight-line programs: integers and numbers, which a file keeps and any language evaluates in
forty lines.

Nothing in a program can loop, call or allocate. The worst that a changed one can do is compute
other numbers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hhr_dolfinx.declared import Floats, Integers, Size
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plain import Rebuilt
from hhr_dolfinx.plugins.ufl_programs.graph import OPERATIONS, Graph

CODES = {name: code for code, name in enumerate(OPERATIONS)}
"""Number of each operation in a file."""
_COUNTS = np.array(list(OPERATIONS.values()))
MOST_REGISTERS = 100_000
"""Registers above which a program is refused: its memory would be too large."""


@dataclass(frozen=True, eq=False)
class Program(Rebuilt):
    """Parts of straight-line code on common registers.

    These are the inputs, then the numbers, then results of operations.

    Raises:
        SceneError: for unknown operations, and registers that do not exist or are not computed
            before.
    """

    #: operation, register of its result, and registers of its operands, of which those not needed
    #: are 0
    rows: Annotated[Integers, "rows", 5]
    numbers: Annotated[Floats, "numbers"]  #: constants, in the registers after the inputs
    ends: Annotated[Integers, "parts"]  #: end of each part in ``rows``
    outputs: Annotated[Integers, "outputs"]  #: registers of the results of all parts
    output_ends: Annotated[Integers, "parts"]  #: end of each part in ``outputs``
    inputs: int  #: number of inputs
    registers: int  #: number of registers

    def __post_init__(self) -> None:
        fault = next(self._faults(), None)
        if fault is not None:
            raise SceneError(f"this is no program: {fault}")

    def _faults(self) -> Iterator[str]:
        rows = self.rows
        defined_before = self.inputs + len(self.numbers)
        if (
            rows.ndim != 2
            or rows.shape[1] != 5
            or not defined_before <= self.registers <= MOST_REGISTERS
        ):
            yield f"its rows are {rows.shape}, its registers {self.registers}"
            return
        ends = ((self.ends, len(rows)), (self.output_ends, len(self.outputs)))
        if any(
            len(all_) == 0 or (np.diff(all_, prepend=0) < 0).any() or all_[-1] != last
            for all_, last in ends
        ):
            yield "its parts do not end with it"
            return
        if not ((rows[:, 0] >= 0) & (rows[:, 0] < len(CODES))).all():
            yield "an operation is unknown"
            return
        defined = np.zeros(self.registers, dtype=bool)
        defined[:defined_before] = True
        for number in range(len(self.ends)):
            yield from self._undefined(number, defined_before, defined)

    def _undefined(self, part: int, known: int, defined: np.ndarray) -> Iterator[str]:
        rows = self.rows[self.ends[part - 1] if part else 0 : self.ends[part]]
        for code, result, *operands in rows.tolist():
            used = operands[: _COUNTS[code]]
            if not all(
                0 <= register < self.registers and defined[register] for register in used
            ) or any(operands[_COUNTS[code] :]):
                yield f"an operand of {used} is not computed before"
                return
            if not known <= result < self.registers:
                yield f"register {result} is no result"
                return
            defined[result] = True
        output_registers = self.outputs[
            self.output_ends[part - 1] if part else 0 : self.output_ends[part]
        ]
        if not all(
            0 <= register < self.registers and defined[register]
            for register in output_registers.tolist()
        ):
            yield f"an output of part {part} is not computed"

    def depends(self, line: Sequence[int], inputs: int, first: int = 0) -> bool:
        """True if outputs of the last of some parts, executed in turn, depend on some inputs.

        Args:
            line: numbers of the parts, in their order.
            inputs: number of the inputs, the first ones.
            first: index of the first output.
        """
        dependent = np.zeros(self.registers, dtype=bool)
        dependent[:inputs] = True
        starts, firsts = (np.append(0, ends) for ends in (self.ends, self.output_ends))
        for number in line:
            for code, result, *operands in self.rows[starts[number] : starts[number + 1]].tolist():
                dependent[result] = dependent[operands[: _COUNTS[code]]].any()
        return bool(dependent[self.outputs[firsts[line[-1]] + first : firsts[line[-1] + 1]]].any())

    @classmethod
    def of(
        cls,
        graph: Graph,
        inputs: Mapping[str, Size],
        parts: Sequence[Sequence[int]],
        order: Order | None = None,
    ) -> Program:
        """Program of parts, each with the nodes of its outputs.

        By default parts share no values.

        Args:
            graph: has the nodes.
            inputs: names with sizes, in their order.
            parts: nodes of the outputs of each part.
            order: order of the parts, which lets them share values.

        Raises:
            SceneError: for too many registers.
            KeyError: for other inputs.
        """
        firsts = dict(zip(inputs, np.cumsum([0, *inputs.values()]).tolist(), strict=False))
        count = sum(inputs.values())
        needed = [graph.needed(part_nodes) for part_nodes in parts]
        values = sorted(
            {
                graph.nodes[node][1]
                for part_nodes in needed
                for node in part_nodes
                if graph.nodes[node][0] == "const"
            }
        )
        registers = {value: count + number for number, value in enumerate(values)}
        fixed: dict[int, int] = {}
        for node in {node for part_nodes in needed for node in part_nodes}:
            kind, *description = graph.nodes[node]
            if kind == "const":
                fixed[node] = registers[description[0]]
            elif kind == "input":
                fixed[node] = firsts[description[0]] + description[1]
        order = Order((None,) * len(parts)) if order is None else order
        allocated = _Registers(graph, fixed, count + len(values), order)
        allocated.add(parts, order.homes(graph, needed))
        return cls(
            np.array([row for code in allocated.rows for row in code], dtype=np.int64).reshape(
                -1, 5
            ),
            np.array(values, dtype=float),
            np.cumsum([len(code) for code in allocated.rows]),
            np.array(
                [register for results in allocated.outputs for register in results], dtype=np.int64
            ),
            np.cumsum([len(results) for results in allocated.outputs]),
            count,
            allocated.size,
        )


@dataclass(frozen=True)
class Order:
    """Order in which parts are executed on the same registers.

    Values of a part are available in the parts after it.
    """

    parents: tuple[int | None, ...]  #: part before each, as a tree; None for the first
    moving: str = ""  #: name of an input that changes between parts; empty without one
    settled: frozenset[int] = frozenset()  #: parts before it is set
    repeated: int = -1  #: part that is executed again and again, as it changes; -1 without one

    def line(self, part: int | None) -> list[int]:
        """Numbers of a part and of those before it, the last one first; none for None."""
        numbers = []
        while part is not None:
            numbers.append(part)
            part = self.parents[part]
        return numbers

    def homes(self, graph: Graph, needed: Sequence[Sequence[int]]) -> list[list[int]]:
        """Nodes that each part computes.

        A value that several parts need is computed once, before all of them.

        Args:
            graph: has the nodes.
            needed: nodes that each part needs.
        """
        users: dict[int, list[int]] = {}
        for number, nodes in enumerate(needed):
            for node in nodes:
                users.setdefault(node, []).append(number)
        moves: dict[int, bool] = {}
        computed: list[list[int]] = [[] for _ in needed]
        for node in sorted(users):
            kind, *args = graph.nodes[node]
            if kind in ("const", "input"):
                moves[node] = kind == "input" and args[0] == self.moving
                continue
            moves[node] = any(moves[arg] for arg in args)
            groups: dict[int | None, list[int]] = {}
            for number in users[node]:
                top = [
                    candidate
                    for candidate in self.line(number)
                    if not (moves[node] and candidate in self.settled)
                ][-1]
                groups.setdefault(top, []).append(number)
            for group in groups.values():
                home = next(
                    candidate
                    for candidate in self.line(group[0])
                    if all(candidate in self.line(number) for number in group)
                )
                if home == self.repeated and not moves[node]:
                    home = self.parents[home] or 0
                computed[home].append(node)
        return computed


class _Registers:
    """Registers of values.

    One is used again after the last use of its value, if no later part needs it.
    """

    def __init__(self, graph: Graph, fixed: dict[int, int], first: int, order: Order):
        self._graph = graph
        self._fixed = fixed
        self._order = order
        self._places: list[dict[int, int]] = []
        self.rows: list[list[list[int]]] = []
        self.outputs: list[list[int]] = []
        self.size = first

    def add(self, parts: Sequence[Sequence[int]], homes: Sequence[list[int]]) -> None:
        """Allocate all parts, each with its operations and outputs.

        Args:
            parts: nodes of the outputs of each part.
            homes: nodes that each part computes, see :meth:`Order.homes`.
        """
        free: list[int] = []
        for number, operations in enumerate(homes):
            later = [k for k in range(number + 1, len(homes)) if number in self._order.line(k)]
            reserved = {
                arg for k in later for node in homes[k] for arg in self._graph.nodes[node][1:]
            }
            reserved |= {node for k in (number, *later) for node in parts[k]}
            self._places.append({})
            free = self._allocate(number, operations, reserved, free)
            self.outputs.append([self._place(number, node) for node in parts[number]])

    def _place(self, part: int, node: int) -> int:
        if node in self._fixed:
            return self._fixed[node]
        return next(
            self._places[number][node]
            for number in self._order.line(part)
            if node in self._places[number]
        )

    def _allocate(self, part: int, own: list[int], kept: set[int], free: list[int]) -> list[int]:
        """Allocate the operations of a part; returns the registers that are free after it."""
        nodes = self._graph.nodes
        last = {arg: when for when, node in enumerate(own) for arg in nodes[node][1:]}
        registers = self._places[part]
        rows: list[list[int]] = []
        for when, node in enumerate(own):
            kind, *args = nodes[node]
            used = [self._place(part, arg) for arg in args]
            if not free:
                free = [self.size]
                self.size += 1
            registers[node] = (
                free.pop()
            )  # no operand, as loops over points that overwrite one do not vectorise
            ended = {
                arg for arg in args if last[arg] == when and arg in registers and arg not in kept
            }
            free += sorted((registers[arg] for arg in ended), reverse=True)
            rows.append([CODES[kind], registers[node], *used, *[0] * (3 - len(used))])
        self.rows.append(rows)
        return free
