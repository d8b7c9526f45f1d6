"""Commands of a file of code_aster with their literal arguments: the file is parsed, and nothing of
it is executed.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import EllipsisType
from typing import TypeAlias

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.plugins.decks.comm_keywords import COMMANDS
from hhr_dolfinx.plugins.decks.deck import Left
from hhr_dolfinx.plugins.decks.keywords import OUT, READ

_OPERATORS: Mapping[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: lambda a, b: float(a) ** b,  # of integers it might never end
}
_SIGNS: Mapping[type[ast.unaryop], Callable[[float], float]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
Value: TypeAlias = "str | bytes | complex | EllipsisType | tuple[Value, ...] | Command | None"
"""A literal, several, or a command; None for what is not read."""
_SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda)


@dataclass(frozen=True, eq=False)
class Command:
    """A command, or a factor ``_F``, with the literal arguments that are read, and TODO lines of
    all others.
    """

    name: str
    source: str
    words: Mapping[str, Value] = field(default_factory=dict)
    unread: tuple[Left, ...] = ()

    def factors(self, name: str) -> tuple[Command, ...]:
        """One factor or several."""
        value = self.words.get(name, ())
        return tuple(
            factor
            for factor in (value if isinstance(value, tuple) else (value,))
            if isinstance(factor, Command)
        )

    def groups(self, *names: str) -> tuple[str, ...]:
        """Names of groups."""
        values = [self.words[name] for name in names if name in self.words]
        entries = [
            entry for value in values for entry in (value if isinstance(value, tuple) else (value,))
        ]
        return tuple(entry for entry in entries if isinstance(entry, str))

    def numbers(self, name: str) -> tuple[float, ...] | None:
        """Number or numbers of a keyword.

        None if the file has other values, or does not have the keyword.
        """
        value = self.words.get(name)
        values = [number(word) for word in (value if isinstance(value, tuple) else (value,))]
        return (
            tuple(word for word in values if word is not None)
            if values and None not in values
            else None
        )

    def left(self, why: str) -> Left:
        """This command as one without counterpart."""
        return Left(self.source, self.name, why)


def number(value: Value) -> float | None:
    """A number, and None for anything else, such as a truth value."""
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def commands_of(path: Path) -> Iterator[Command]:
    """Commands of a file in their order.

    Raises:
        FileContentError: for text that is no Python, with the line.
    """
    try:
        tree = ast.parse(path.read_text(errors="replace"))
    except (SyntaxError, ValueError) as error:
        raise FileContentError(
            f"{path.name}:{getattr(error, 'lineno', 0)} is no command file: {error}"
        ) from None
    names = _Names(path.name, _global_names(tree))
    for statement in tree.body:
        yield from names.after(statement)


def _global_names(tree: ast.Module) -> frozenset[str]:
    """Names that functions of the file may change whenever they are called."""
    return frozenset(
        name for node in ast.walk(tree) if isinstance(node, ast.Global) for name in node.names
    )


class _Names:
    """Values of the names of a file, statement by statement.

    A name that may have any value has none.

    Attributes:
        file: name of the file.
        changeable: names that functions of the file change.
    """

    def __init__(self, file: str, changeable: frozenset[str]) -> None:
        self.file = file
        self.changeable = changeable
        self.values: dict[str, Value] = {}
        self.nested: list[Command] = []

    def after(self, statement: ast.stmt) -> Iterator[Command]:
        """Commands of a statement, inner ones first; the names that it binds get their values."""
        value = self.value(getattr(statement, "value", None))
        if isinstance(statement, ast.AugAssign):
            value = self.value(ast.BinOp(_loaded(statement.target), statement.op, statement.value))
        value = admitted(value, value.name) if isinstance(value, Command) else value
        targets: list[ast.expr] = []
        if isinstance(statement, ast.Assign):
            targets = statement.targets
        elif isinstance(statement, ast.AnnAssign | ast.AugAssign):
            targets = [statement.target] if statement.value is not None else []
        self._forget(statement)
        for target in targets:
            self._bind(target, value)
        yield from self.nested
        self.nested = []
        if isinstance(value, Command):
            yield value
        elif not isinstance(
            statement,
            ast.Assign
            | ast.AnnAssign
            | ast.AugAssign
            | ast.Import
            | ast.ImportFrom
            | ast.Expr
            | ast.Pass,
        ):
            yield Command(type(statement).__name__, f"{self.file}:{statement.lineno}", {"": None})

    def _bind(self, target: ast.expr, value: Value) -> None:
        if isinstance(target, ast.Name) and target.id not in self.changeable:
            self.values[target.id] = value
        elif (
            isinstance(target, ast.Tuple | ast.List)
            and isinstance(value, tuple)
            and len(value) == len(target.elts)
        ):
            if not any(isinstance(element, ast.Starred) for element in target.elts):
                for element, element_value in zip(target.elts, value, strict=True):
                    self._bind(element, element_value)

    def _forget(self, statement: ast.stmt) -> None:
        """Drop the values of names that a statement may change: it binds them, or items or parts of
        their values.
        """
        for name in _changed(statement):
            value = self.values.pop(name, None)
            if isinstance(value, tuple):  # a list may have several names
                self.values = {
                    key: bound for key, bound in self.values.items() if bound is not value
                }

    def value(self, node: ast.AST | None) -> Value:
        """Value of a literal, of a sum or product of literals, or of a command; otherwise None."""
        match node:
            case ast.Constant(value=value):
                return value
            case ast.Name(id=name):
                return self.values.get(name)
            case ast.UnaryOp(op=op, operand=inner) if type(op) in _SIGNS:
                operand = number(self.value(inner))
                return None if operand is None else _SIGNS[type(op)](operand)
            case ast.BinOp(left=first, op=op, right=second) if type(op) in _OPERATORS:
                a, b = (number(self.value(term)) for term in (first, second))
                try:
                    return None if a is None or b is None else number(_OPERATORS[type(op)](a, b))
                except ArithmeticError:
                    return None
            case ast.Tuple(elts=items) | ast.List(elts=items):
                return tuple(self._inner(term) for term in items)
            case ast.Call(func=ast.Name(id=name), keywords=words):
                found_words = {word.arg or "**": self._inner(word.value) for word in words}
                return Command(name, f"{self.file}:{node.lineno}", found_words)
        return None

    def _inner(self, node: ast.AST) -> Value:
        """Value of an argument: a command instead of its name is one of the file, and other
        calls are unknown.
        """
        value = self.value(node)
        if not isinstance(node, ast.Call) or not isinstance(value, Command) or value.name == "_F":
            return value
        if value.name not in COMMANDS:
            return None
        self.nested.append(command := admitted(value, value.name))
        return command


def _loaded(target: ast.expr) -> ast.expr:
    """The value that a target has before it is changed."""
    return ast.Name(target.id, ast.Load()) if isinstance(target, ast.Name) else target


def _changed(node: ast.AST) -> Iterator[str]:
    """Names that a statement of the file binds or deletes, or whose methods, items or attributes it
    may change.
    """
    match node:
        case (
            ast.Name(id=name, ctx=ast.Store() | ast.Del())
            | ast.Call(func=ast.Attribute(value=ast.Name(id=name)))
        ):
            yield name
        case ast.Subscript(value=ast.Name(id=name), ctx=ast.Store() | ast.Del()):
            yield name
        case ast.Attribute(value=ast.Name(id=name), ctx=ast.Store() | ast.Del()):
            yield name
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
            yield name
        case ast.alias(name=name, asname=other):
            yield other or name.partition(".")[0]
        case (
            ast.ExceptHandler(name=str(name))
            | ast.MatchAs(name=str(name))
            | ast.MatchStar(name=str(name))
        ):
            yield name
    if not isinstance(node, _SCOPES):
        for inner in ast.iter_child_nodes(node):
            yield from _changed(inner)


def admitted(command: Command, name: str) -> Command:
    """Command or factor with the keywords that the table of its name reads.

    Args:
        command: the command or factor, with all of its keywords.
        name: name of the table of keywords, ``COMMAND`` or ``COMMAND/FACTOR``.
    """
    keyword = COMMANDS.get(name)
    if keyword is None or keyword.rule.outcome != READ:
        return command
    words: dict[str, Value] = {}
    unread: list[Left] = []
    title = name.replace("/", " ")
    for key, word in command.words.items():
        # ("AXIS",) and ["AXIS"] are what "AXIS" is
        value = (
            word[0]
            if isinstance(word, tuple) and len(word) == 1 and isinstance(word[0], str)
            else word
        )
        entries = value if isinstance(value, tuple) else (value,)
        options = [entry.upper() if isinstance(entry, str) else "" for entry in entries] or [""]
        rules = dict.fromkeys(keyword.rule_of(key, option) for option in options)
        empty = isinstance(value, int | float) and not value  # a length or a rotation that is 0
        for rule in (candidate for candidate in rules if candidate.why and not empty):
            text = (
                f"{key}={value}: {rule.why}"
                if isinstance(value, str | int | float)
                else f"{key}: {rule.why}"
            )
            unread.append(Left(command.source, title, text))
        outcomes = {rule.outcome for rule in rules}
        if OUT in outcomes:
            return Command(command.name, command.source, {}, tuple(unread))
        if outcomes == {READ}:
            if any(entry is None for entry in entries):
                unread.append(
                    Left(
                        command.source, title, f"{key} of {name.rpartition('/')[2]} is not literal"
                    )
                )
            factors = [
                admitted(factor, f"{name}/{key}")
                for factor in command.factors(key)
                if factor.name == "_F"
            ]
            unread += [todo for factor in factors for todo in factor.unread]
            words[key] = tuple(factor for factor in factors if factor.words) if factors else value
    return Command(command.name, command.source, words, tuple(unread))
