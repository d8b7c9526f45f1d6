"""Declarations in the annotations of a frozen dataclass: types of its fields, kinds and sizes of
its arrays.

``stiffness: Annotated[Floats, "ell", "ell"]`` is a square array of floating-point numbers. The same
name is the same size everywhere in an object, and in a whole model if it is one of
:data:`SHARED_SIZES`; ``"points * components"`` is a product of sizes. ``Annotated[Integers,
"m", "< N"]`` has indices from 0 to N - 1, and ``Annotated[Size, "N"]`` is itself the size.
Other annotations declare no sizes. Files are written and checked by these declarations, see
:mod:`hhr_dolfinx.plain`.
"""

from __future__ import annotations

import ast
import dataclasses
import difflib
import inspect
import math
from collections.abc import Mapping, Sequence
from functools import cache
from html import escape
from types import MappingProxyType
from typing import Any, NamedTuple, Self, get_args

import numpy as np
from scipy.sparse import issparse

from hhr_dolfinx.errors import FileContentError, SceneError
from hhr_dolfinx.files import NUMBER_KINDS

Floats = np.ndarray
"""Array of float64, in annotations."""
Singles = np.ndarray
"""Array of float32, whose entries are off by 6e-8 of themselves."""
Integers = np.ndarray
"""Array of int64; int32 is converted when a file is read, since compiled loops multiply indices."""
Booleans = np.ndarray
"""Array of bool."""

Size = int
"""A number that is itself a size, in annotations: ``Annotated[Size, "N"]``."""

TYPES: dict[str, np.dtype[Any]] = {
    "Floats": np.dtype(np.float64),
    "Singles": np.dtype(np.float32),
    "Integers": np.dtype(np.int64),
    "Booleans": np.dtype(np.bool_),
}
SHARED_SIZES = frozenset({"N", "N_lambda", "m", "ell", "terms", "P", "components", "gauss points"})
"""Sizes that all parts of a model share: dofs, conditions on the whole surface and of the model,
modes, terms of θ (1 + T), parameters, components of a strain, and Gauss points of the full model.
"""


class DeclaredArray(NamedTuple):
    """Kind and sizes of an array; ``below`` names the size that its indices must be less than."""

    kind: str
    sizes: tuple[str, ...]
    below: str


@cache
def annotations_of(kind: type) -> Mapping[str, ast.expr]:
    """Annotations of the values that a file keeps of a class, by name: of fields, or of arguments
    named in ``kept``.
    """
    if dataclasses.is_dataclass(kind):
        fields = [
            declared_field
            for declared_field in dataclasses.fields(kind)
            if declared_field.init and declared_field.metadata.get("kept", True)
        ]
        return {declared_field.name: _parsed(declared_field.type) for declared_field in fields}
    annotations = inspect.get_annotations(kind.__init__)  # type: ignore[misc]
    names: Sequence[str] = kind.kept  # type: ignore[attr-defined]
    return {name: _parsed(annotations.get(name, "Any")) for name in names}


@cache
def _text(text: str) -> ast.expr:
    try:
        return ast.parse(text, mode="eval").body
    except SyntaxError:  # a user-defined annotation that is no Python expression
        return ast.Name("Any")


def _parsed(annotation: object) -> ast.expr:
    """An annotation as a tree; an unreadable one declares nothing."""
    if isinstance(annotation, str):
        return _text(annotation)
    return _text(
        annotation.__name__
        if isinstance(annotation, type) and not get_args(annotation)
        else repr(annotation)
    )


def shown(node: ast.expr) -> str:
    """An annotation as written, for messages."""
    return ast.unparse(node)


@cache
def _alternatives(node: ast.expr) -> tuple[ast.expr, ...]:
    """Members of a union, or the annotation itself."""
    if isinstance(node, ast.BinOp):
        return *_alternatives(node.left), *_alternatives(node.right)
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return _alternatives(_text(node.value))
    if isinstance(node, ast.Subscript) and _name(node.value) in ("Union", "Optional"):
        members = tuple(
            member for annotation in _items(node) for member in _alternatives(annotation)
        )
        return (*members, ast.Constant(None)) if _name(node.value) == "Optional" else members
    return (node,)


def _name(node: ast.expr) -> str:
    return (
        node.attr
        if isinstance(node, ast.Attribute)
        else node.id
        if isinstance(node, ast.Name)
        else ""
    )


def _items(node: ast.Subscript) -> list[ast.expr]:
    return node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]


def fits(value: object, node: ast.expr, kinds: Mapping[str, type]) -> bool:
    """True if the value of a field has its declared type.

    Names that are not among the known classes accept every value.

    Args:
        value: the value.
        node: annotation of the field.
        kinds: known classes by name.
    """
    return any(_fits(value, alternative, kinds) for alternative in _alternatives(node))


def _fits(value: object, node: ast.expr, kinds: Mapping[str, type]) -> bool:
    if isinstance(node, ast.Constant):
        return value is None if node.value is None else True
    if isinstance(node, ast.Subscript):
        name = _name(node.value)
        arguments = _items(node)
        if name == "Annotated":
            return fits(value, arguments[0], kinds)
        return name != "tuple" or (
            isinstance(value, tuple) and _tuple_fits(value, arguments, kinds)
        )
    name = _name(node)
    name = "int" if name == "Size" else name
    if name in ("float", "int", "bool", "str"):
        return type(value).__name__ == name or (name == "float" and type(value) is int)
    if name in TYPES or name == "ndarray":
        return isinstance(value, np.ndarray)
    if name.endswith("_matrix"):
        return issparse(value) and name.startswith(value.format)  # type: ignore[attr-defined]
    if name == "tuple":
        return isinstance(value, tuple)
    return name not in kinds or name in [base.__name__ for base in type(value).__mro__]


def _tuple_fits(
    value: tuple[object, ...], items: list[ast.expr], kinds: Mapping[str, type]
) -> bool:
    if len(items) == 2 and isinstance(items[1], ast.Constant) and items[1].value is Ellipsis:
        return all(fits(element, items[0], kinds) for element in value)
    return len(items) == len(value) and all(
        fits(*pair, kinds) for pair in zip(value, items, strict=True)
    )


@cache
def declared_array(node: ast.expr) -> DeclaredArray | None:
    """Kind and sizes that an annotation declares; None without any."""
    for alternative in _alternatives(node):
        if isinstance(alternative, ast.Subscript) and _name(alternative.value) == "Annotated":
            kind, *labels = _items(alternative)
            if not _has_sizes(kind):
                return None
            texts = [str(label.value) for label in labels if isinstance(label, ast.Constant)]
            below = [text.removeprefix("<").strip() for text in texts if text.startswith("<")]
            sizes = tuple(text for text in texts if not text.startswith("<"))
            return DeclaredArray(_name(kind), sizes, below[0] if below else "")
    return None


def _has_sizes(kind: ast.expr) -> bool:
    """True for annotations of an array, a size, or a tuple of any length."""
    if isinstance(kind, ast.Subscript):
        return _name(kind.value) == "tuple" and isinstance(_items(kind)[-1], ast.Constant)
    return _name(kind) in (*TYPES, "ndarray", "Size")


def check_layout(
    arrays: Mapping[str, np.ndarray], layout: Mapping[str, Sequence[str]], sizes: Mapping[str, int]
) -> None:
    """Check that arrays have a given layout with consistent sizes.

    Args:
        arrays: the arrays by name.
        layout: for each name the kind (``float``, ``int`` or ``bool``) and the names of the sizes.
        sizes: known sizes by name.

    Raises:
        FileContentError: for an array that is missing, unknown, or of another kind or shape.
    """
    if arrays.keys() != layout.keys():
        missing = sorted(layout.keys() - arrays.keys())
        unknown = sorted(arrays.keys() - layout.keys())
        raise FileContentError(f"arrays {missing} are missing and {unknown} are unknown")
    claimed = Sizes(known=sizes)
    for name, (kind, *labels) in layout.items():
        if NUMBER_KINDS.get(arrays[name].dtype.str) != kind:
            raise FileContentError(f"{name} has type {arrays[name].dtype}, it must be {kind}")
        claimed.claim(name, DeclaredArray(kind, tuple(labels), ""), arrays[name])


class Sizes:
    """Sizes by name, collected while the parts of a model are read; see :data:`SHARED_SIZES`."""

    def __init__(self, whole: bool = False, known: Mapping[str, int] = MappingProxyType({})):
        self.shared: dict[str, int] = dict(known)
        self.own: dict[str, int] = dict(known)
        self._whole = whole
        self._waiting: list[tuple[Sizes, str, str, int | tuple[int, int]]] = []

    def of_part(self) -> Sizes:
        """Sizes of a part: in a model, ``whole``, shared sizes are the same.

        In other values none are.
        """
        sizes = Sizes(self._whole)
        if self._whole:
            sizes.shared = self.shared
            sizes._waiting = self._waiting
        return sizes

    def claim(self, path: str, declared: DeclaredArray, value: np.ndarray | tuple | int) -> None:
        """Record the sizes of an array, a tuple, or a number that is a size.

        Args:
            path: path of the value, for messages.
            declared: its declaration.
            value: the value.

        Raises:
            FileContentError: for sizes that differ from known ones.
        """
        shape = (
            (value,)
            if isinstance(value, int)
            else (len(value),)
            if isinstance(value, tuple)
            else value.shape
        )
        if len(shape) != len(declared.sizes) or not all(
            self._agrees(path, label, size)
            for label, size in zip(declared.sizes, shape, strict=True)
        ):
            labelled = [(label, self._value(label)) for label in declared.sizes]
            wanted = ", ".join(
                label if size is None else f"{label} = {size}" for label, size in labelled
            )
            raise FileContentError(f"{path} has shape {shape}, it must be ({wanted})")
        if declared.below and isinstance(value, np.ndarray) and value.size:
            self._waiting.append((self, path, declared.below, (int(value.min()), int(value.max()))))

    def _agrees(self, path: str, label: str, size: int) -> bool:
        """True if a size agrees with the known one of its name, or is the first one, which is
        recorded.
        """
        if label.isdigit():
            return size == int(label)
        if "*" in label:
            self._waiting.append((self, path, label, size))
            return True
        return (self.shared if label in SHARED_SIZES else self.own).setdefault(label, size) == size

    def _value(self, label: str) -> int | None:
        """A size, or a product of several; None while one of them is unknown."""
        factors = [
            int(name) if name.isdigit() else self.shared.get(name, self.own.get(name))
            for name in map(str.strip, label.split("*"))
        ]
        return None if None in factors else math.prod(factors)  # type: ignore[arg-type]

    def check_known(self, last: bool = False) -> None:
        """Check products and indices whose sizes are known.

        Args:
            last: True at the end of a model, at which all sizes must be known.

        Raises:
            FileContentError: for wrong products, and for indices out of range.
        """
        waiting = list(self._waiting)
        self._waiting[:] = []
        for sizes, path, label, extent in waiting:
            size = sizes._value(label)
            if size is None:
                if last:
                    raise FileContentError(
                        f"{path} depends on the size {label}, which nothing says"
                    )
                self._waiting.append((sizes, path, label, extent))
            elif isinstance(extent, tuple) and not 0 <= extent[0] <= extent[1] < size:
                raise FileContentError(f"{path} has indices outside 0 .. {size - 1}")
            elif isinstance(extent, int) and extent != size:
                raise FileContentError(
                    f"{path} has the length {extent}, it must be {label} = {size}"
                )


USUAL_SYMBOLS = {
    "E": ("young",),
    "e": ("young",),
    "nu": ("poisson",),
    "sigma_y": ("yield_stress",),
    "sigma0": ("yield_stress",),
    "sy": ("yield_stress",),
    "H": ("hardening",),
    "mu": ("friction", "coefficient"),
    "k": ("modulus",),
    "n": ("exponent", "normal"),
    "p": ("amplitude",),
    "value": ("amplitude",),
    "material": ("law",),
}
"""Arguments that symbols of textbooks, and names in other programs, may stand for."""


class KnownArguments:
    """Base of classes of scenes whose constructors refuse an unknown argument by a sentence, with
    the right name.
    """

    def __new__(cls, *_: Any, **named: Any) -> Self:
        """Make an object; SceneError for an argument that its constructor has not."""
        arguments = list(inspect.signature(cls.__init__).parameters.values())[1:]
        names = [argument.name for argument in arguments]
        unknown = [name for name in named if name not in names]
        if unknown and not any(
            argument.kind is inspect.Parameter.VAR_KEYWORD for argument in arguments
        ):
            name = unknown[0]
            near = [symbol for symbol in USUAL_SYMBOLS.get(name, ()) if symbol in names]
            near = near or difflib.get_close_matches(name, names, n=1)
            meant = f": is '{near[0]}' meant?" if near else "."
            raise SceneError(
                f"{cls.__name__} has no argument '{name}'{meant} Its arguments are "
                f"{', '.join(names)}"
            )
        return super().__new__(cls)

    def _repr_html_(self) -> str:
        """The text of several lines if there is one, else a table of the arguments."""
        if "\n" in str(self):
            return f"<pre>{escape(str(self))}</pre>"
        names = [item.name for item in dataclasses.fields(self)]  # type: ignore[arg-type]
        values = [escape(str(getattr(self, name))) for name in names]
        pairs = zip(names, values, strict=True)
        rows = (f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in pairs)
        return f"<table><caption>{type(self).__name__}</caption>{''.join(rows)}</table>"
