"""Digests of settings that are the same in another run: of numbers, texts, arrays, functions and
classes.
"""

from __future__ import annotations

import dis
import hashlib
import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cached_property, partial
from pathlib import Path
from types import (
    BuiltinFunctionType,
    CodeType,
    FunctionType,
    MemberDescriptorType,
    MethodType,
    ModuleType,
)
from typing import Any

import numpy as np
from scipy.sparse import issparse

from hhr_dolfinx.errors import StudyError
from hhr_dolfinx.snapshots.store import arrays_of, bytes_of

DEEPEST_VALUE = 50
"""Largest depth of nested values; deeper ones count as values that contain themselves."""


def digest_of_values(value: object, what: str) -> str:
    """Hexadecimal digest of settings: of their types, numbers, texts, arrays and functions.

    Their ``repr`` is not enough: that of an array leaves out its middle, and that of an object may
    be its address. User-defined functions and classes enter with the globals that they read and
    their class attributes, those of installed packages with their names.

    Args:
        value: the settings.
        what: name of these, for the message.

    Raises:
        StudyError: for an object whose values are not accessible.
    """
    digest = hashlib.sha256()
    for piece in _pieces(value, what, 0, {}):
        digest.update(len(piece).to_bytes(8, "little") + piece)
    return digest.hexdigest()


def _pieces(value: object, what: str, depth: int, seen: dict[int, int]) -> Iterator[bytes]:
    """Bytes that identify a value uniquely.

    Functions and classes that occur again enter with their number.
    """
    if depth > DEEPEST_VALUE:
        raise StudyError(
            f"{what} holds values more than {DEEPEST_VALUE} deep, or itself: no digest "
            f"can be made of it"
        )
    kind = type(value)
    yield f"{kind.__module__}.{kind.__qualname__}".encode()
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        yield repr(value).encode()
        return
    if isinstance(value, FunctionType | type):
        if id(value) in seen:
            yield f"again {seen[id(value)]}".encode()
            return
        seen[id(value)] = len(seen)
    for member in _values_of(value, what):
        if isinstance(member, np.ndarray) and member.dtype != object:
            yield bytes_of(member)
        else:
            yield from _pieces(member, what, depth + 1, seen)
    yield b"end"


def _values_of(value: Any, what: str) -> list[Any]:
    """Parts of a value that is neither number nor text."""
    if issparse(value):
        return [value.shape, *arrays_of(value.tocsr())]
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        return [array] if array.dtype != object else array.tolist()
    if isinstance(value, Mapping):
        return [member for key in sorted(value, key=repr) for member in (key, value[key])]
    if isinstance(value, set | frozenset):
        return sorted(digest_of_values(member, what) for member in value)
    if isinstance(value, list | tuple):
        return list(value)
    if isinstance(value, BuiltinFunctionType | np.ufunc):
        return [getattr(value, "__module__", ""), getattr(value, "__qualname__", value.__name__)]
    if isinstance(value, MethodType):
        return [value.__func__, value.__self__]
    if isinstance(value, FunctionType):
        return _values_of_function(value)
    if isinstance(value, CodeType):
        return [value.co_code, value.co_consts, value.co_names]
    if isinstance(value, partial):
        return [value.func, value.args, value.keywords]
    if isinstance(value, ModuleType):
        return [value.__name__]
    if isinstance(value, type):
        return [value.__module__, value.__qualname__, *_class_attributes(value)]
    if is_dataclass(value):
        return [
            type(value),
            *((member.name, getattr(value, member.name)) for member in fields(value)),
        ]
    if hasattr(value, "__dict__"):
        return [type(value), vars(value)]
    raise StudyError(
        f"{what} holds {value!r}, of which no digest can be made that is the same in another run: "
        "write it as a frozen dataclass of numbers, texts and arrays"
    )


def _installed(module: str) -> bool:
    """True for a module of Python, of this package or of another installed one."""
    first = module.partition(".")[0]
    file = getattr(sys.modules.get(first), "__file__", None) or ""
    if first in sys.stdlib_module_names or first == __name__.partition(".")[0]:
        return True
    return bool({"site-packages", "dist-packages"} & set(Path(file).parts))


def _values_of_function(function: FunctionType) -> list[Any]:
    """Code, defaults, closure and, for a user-defined function, the globals that its code reads."""
    held = [cell.cell_contents for cell in function.__closure__ or ()]
    names = [function.__module__, function.__qualname__]
    values = [*names, function.__code__, function.__defaults__, function.__kwdefaults__, held]
    if _installed(function.__module__ or ""):
        return values
    globals_read: dict[str, Any] = {}
    for code in _codes(function.__code__):
        for name in {
            step.argval for step in dis.get_instructions(code) if step.opname == "LOAD_GLOBAL"
        }:
            if name not in function.__globals__:
                continue  # a built-in of Python
            value = globals_read[name] = function.__globals__[name]
            if isinstance(value, ModuleType) and not _installed(value.__name__):
                globals_read |= {
                    f"{name}.{attribute}": vars(value)[attribute]
                    for attribute in code.co_names
                    if attribute in vars(value)
                }
    return [*values, globals_read]


def _codes(code: CodeType) -> Iterator[CodeType]:
    """A code object and those of the functions defined in it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _class_attributes(kind: type) -> list[Any]:
    """Attributes and methods of a user-defined class and its user-defined bases.

    Those generated by Python are left out.
    """
    attributes: list[Any] = []
    for base in kind.__mro__:
        if _installed(base.__module__):
            continue
        for name, attribute in vars(base).items():
            if isinstance(attribute, staticmethod | classmethod):
                attribute = attribute.__func__
            elif isinstance(attribute, property | cached_property):
                attribute = attribute.fget if isinstance(attribute, property) else attribute.func
            written = (
                isinstance(attribute, FunctionType) and attribute.__code__.co_filename != "<string>"
            )
            plain = (
                not name.startswith("__")
                and name != "_abc_impl"
                and not isinstance(attribute, FunctionType)
            )
            if written or (
                plain and not isinstance(attribute, MemberDescriptorType)
            ):  # descriptors of __slots__
                attributes.append((name, attribute))
    return attributes
