"""What a class of a user's own does: its code as Python runs it, and all of the user's own that this code names.

The text of a class is not enough. A law may call a function beside it, or read a constant there; a notebook that
imported a file before it was edited runs what the file no longer says; and what was typed in has no text. Another
version of Python compiles other code, for which snapshots are solved anew.
"""

from __future__ import annotations

import sys
import sysconfig
from collections.abc import Iterator, Mapping
from functools import lru_cache, partial
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

_SAYS_NOTHING = {
    *("__module__", "__qualname__", "__doc__", "__dict__", "__weakref__", "__firstlineno__", "__static_attributes__"),
    *("__annotations__", "__annotate__", "__annotate_func__", "__annotations_cache__", "__conditional_annotations__"),
    *("__dataclass_fields__", "__dataclass_params__", "__match_args__", "__abstractmethods__", "_abc_impl"),
    *("__repr__", "__eq__", "__hash__", "__setattr__", "__delattr__", "__replace__", "__parameters__"),
}
"""Members of a class on which no answer depends; dataclasses make most of them."""

_INSIDE = ("__func__", "__wrapped__", "py_func", "fget", "fset", "func")
"""Where methods, properties, caches and compiled functions keep what they call."""

_CACHED = type(lru_cache(len))
_PLAIN = (tuple, frozenset, CodeType, np.ndarray)


def meaning(kind: type) -> list:
    """Names, code and values that say what a class does; the same in each run, whatever the addresses of objects.

    Of packages of others, and of this one, only names count.
    """
    reader = _Reader(_top(kind.__module__))
    reader.read(kind)
    return reader.parts


class _Reader:
    """Walks from a class to everything of the user's own that its code can reach by name.

    Args:
        own: package that is the user's own even where it is installed.
    """

    def __init__(self, own: str):
        self.parts: list[Any] = []
        self._own = own
        self._seen: dict[int, tuple[int, Any]] = {}  # with the objects, whose addresses are not given away then

    def read(self, value: Any) -> None:
        """Add a value, once."""
        if value is None or isinstance(value, str | bytes | int | float | complex | np.generic):
            self.parts.append(f"{type(value).__name__} {value!r}")
            return
        if not isinstance(value, _PLAIN):  # of these equal ones may be one object in one run and two in the next
            if id(value) in self._seen:
                self.parts.append(f"number {self._seen[id(value)][0]}")
                return
            self._seen[id(value)] = len(self._seen), value
        self.parts.append(type(value).__qualname__)
        self._inside(value)

    def _inside(self, value: Any) -> None:
        """Add what a value consists of."""
        if isinstance(value, np.ndarray):
            self.parts.append(str(value.dtype) if value.dtype.hasobject else value)
        elif isinstance(value, CodeType):
            self._all((value.co_code, value.co_exceptiontable, value.co_names, value.co_consts))
        elif isinstance(value, tuple | list):
            self.parts.append(len(value))
            self._all(value)
        elif isinstance(value, set | frozenset):
            self.parts.append(repr(sorted(map(repr, value))))
        elif isinstance(value, Mapping):
            self.parts.append(len(value))
            self._all(part for item in sorted(value.items(), key=lambda item: repr(item[0])) for part in item)
        elif isinstance(value, type):
            self._class(value)
        elif isinstance(value, FunctionType) and self._is_own(value.__module__):
            self._function(value)
        elif self._is_own(type(value).__module__):
            self._all((type(value), getattr(value, "__dict__", None)))
        else:
            self._others(value)

    def _all(self, values: Any) -> None:
        for value in values:
            self.read(value)

    def _class(self, kind: type) -> None:
        """Members of a class and of those it is derived from."""
        for base in kind.__mro__[:-1]:
            self.parts.append(base.__qualname__)
            if self._is_own(base.__module__):
                members = ((name, member) for name, member in vars(base).items() if name not in _SAYS_NOTHING)
                self._all(part for item in sorted(members, key=lambda item: item[0]) for part in item)

    def _function(self, function: FunctionType) -> None:
        """Code, defaults, what it encloses, and what it finds in its module."""
        self._all((function.__code__, function.__defaults__, function.__kwdefaults__))
        for cell in function.__closure__ or ():
            try:
                self.read(cell.cell_contents)
            except ValueError:  # not yet filled
                self.parts.append("empty")
        names = sorted(set(_names(function.__code__)))
        for name in names:
            if name in function.__globals__:
                value = function.__globals__[name]
                if isinstance(value, ModuleType) and self._is_own(value.__name__):
                    self._all(
                        part for inner in names if hasattr(value, inner) for part in (inner, getattr(value, inner))
                    )
                else:
                    self._all((name, value))

    def _others(self, value: Any) -> None:
        """What is known by its name, and what is called through it."""
        self.parts.append(str(getattr(value, "__qualname__", getattr(value, "__name__", ""))))
        if isinstance(value, partial):
            self._all((value.func, value.args, value.keywords))
        elif not isinstance(value, FunctionType | ModuleType):
            inner = (getattr(value, name, None) for name in _INSIDE)
            self._all(item for item in inner if isinstance(item, FunctionType | _CACHED))

    def _is_own(self, module: str | None) -> bool:
        """Whether a module is the user's own: neither of this package, nor Python's, nor installed."""
        top = _top(module)
        if top in ("", "__main__", self._own):
            return top != "hhr_dolfinx"
        if top == "hhr_dolfinx" or top in sys.stdlib_module_names:
            return False
        file = getattr(sys.modules.get(top), "__file__", None)
        if file is None:
            return True
        places = [Path(sysconfig.get_path(name)) for name in ("purelib", "platlib", "stdlib")]
        return not any(Path(file).is_relative_to(place) for place in places) and "dist-packages" not in file


def _top(module: str | None) -> str:
    return (module or "").partition(".")[0]


def _names(code: CodeType) -> Iterator[str]:
    """Names that code looks up, in functions inside it too."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)
