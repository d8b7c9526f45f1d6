"""Digests of arrays and of settings by their values: what is equal to the last bit has one digest in every run."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType
from typing import Any

import numpy as np
from scipy.sparse import issparse

from hhr_dolfinx.errors import StudyError

DEEPEST = 50
"""Values within each other: what goes deeper holds itself."""


def add_to(digest: Any, parts: list[Any]) -> None:
    """Tell a digest of arrays, sparse or not, numbers and texts, and of lists of these, to the last bit."""
    for part in parts:
        for item in part if isinstance(part, tuple | list) else (part,):
            for array in _arrays(item):
                digest.update(f"{array.dtype.str}{array.shape}".encode() + array.tobytes())


def digest_of_values(value: Any, what: str) -> str:
    """A digest of settings, hexadecimal: of their types, numbers, texts, arrays and functions, not of their ``repr``.

    That of an array leaves out what is in its middle, and that of an object may be its address.

    Args:
        value: numbers, texts, arrays, functions, types, and dataclasses, collections and objects that hold such.
        what: the value in words, for the message.

    Raises:
        StudyError: for an object whose values cannot be told.
    """
    digest = hashlib.sha256()
    for piece in _pieces(value, what, 0):
        digest.update(len(piece).to_bytes(8, "little") + piece)
    return digest.hexdigest()


def _arrays(item: Any) -> tuple[np.ndarray, ...]:
    return (item.indptr, item.indices, item.data) if issparse(item) else (np.ascontiguousarray(item),)


def _pieces(value: Any, what: str, depth: int) -> Iterator[bytes]:
    """Bytes that stand for a value and for no other one."""
    if depth > DEEPEST:
        raise StudyError(f"{what} holds values more than {DEEPEST} deep, or itself: no digest can be made of it")
    kind = type(value)
    yield f"{kind.__module__}.{kind.__qualname__}".encode()
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        yield repr(value).encode()
        return
    for part in _values_of(value, what):
        if isinstance(part, np.ndarray) and part.dtype != object:
            yield f"{part.dtype.str}{part.shape}".encode() + np.ascontiguousarray(part).tobytes()
        else:
            yield from _pieces(part, what, depth + 1)
    yield b"end"


def _values_of(value: Any, what: str) -> list[Any]:
    """What a value that is no number or text is made of."""
    if issparse(value):
        return [value.shape, *_arrays(value.tocsr())]
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        return [array] if array.dtype != object else array.tolist()
    if isinstance(value, Mapping):
        return [item for key in sorted(value, key=repr) for item in (key, value[key])]
    if isinstance(value, set | frozenset):
        return sorted(digest_of_values(item, what) for item in value)
    if isinstance(value, list | tuple):
        return list(value)
    if isinstance(value, type | BuiltinFunctionType | np.ufunc):
        return [getattr(value, "__module__", ""), getattr(value, "__qualname__", value.__name__)]
    if isinstance(value, MethodType):
        return [value.__func__, value.__self__]
    if isinstance(value, FunctionType):
        held = [cell.cell_contents for cell in value.__closure__ or ()]
        return [value.__module__, value.__qualname__, value.__code__, value.__defaults__, value.__kwdefaults__, held]
    if isinstance(value, CodeType):
        return [value.co_code, value.co_consts, value.co_names]
    if isinstance(value, partial):
        return [value.func, value.args, value.keywords]
    if is_dataclass(value):
        return [(item.name, getattr(value, item.name)) for item in fields(value)]
    if hasattr(value, "__dict__"):
        return [vars(value)]
    raise StudyError(
        f"{what} holds {value!r}, of which no digest can be made that is the same in another run: write it as a frozen "
        "dataclass of numbers, texts and arrays"
    )
