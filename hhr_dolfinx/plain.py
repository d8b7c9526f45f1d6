"""Values as a kind and numbers: how laws and amplitudes, a user's own too, are kept in files that execute nothing.

A value is a frozen dataclass whose fields are numbers, strings, truth values, other such values without arrays, tuples
of these, or numpy arrays. A file holds the name of its class and its fields; whoever reads the file says which classes
may come out of it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from hhr_dolfinx.errors import FileContentError, ModelFileError

ARRAY_TYPES = (np.dtype("<f8"), np.dtype("<i8"), np.dtype("<i4"), np.dtype("?"))
"""Kinds of numbers that arrays in files have."""

_REMEDY = (
    "what goes into a file must be a frozen dataclass, `@dataclass(frozen=True)`, whose fields are finite numbers, "
    "strings, truth values, other frozen dataclasses, tuples of these, or numpy arrays of float64, int64, int32 or bool"
)
_SHOWN = 60
_DEEPEST = 8
"""Levels of tuples and values within each other: damaged files must not exhaust the stack."""


def as_plain(value: object) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A frozen dataclass as its kind and numbers, and its arrays by name; JSON can hold the former.

    It is rebuilt once, so that what is written can be read back as the same value.

    Raises:
        FileContentError: for a value that is no such dataclass, or that its class would not take back, with what to do.
    """
    kind = type(value)
    data, arrays = _taken_apart(value)
    again = _taken_apart(restored(data, arrays, by_name(_kinds_in(value))))
    if again[0] != data or any(not np.array_equal(again[1][name], array) for name, array in arrays.items()):
        raise FileContentError(
            f"{_shown(value)} made of its own fields is another {kind.__name__}: its __post_init__ must leave fields "
            "that it has changed once as they are"
        )
    return data, arrays


def by_name(classes: Iterable[type]) -> dict[str, type]:
    """Classes by their names, as :func:`restored` wants them.

    Raises:
        ModelFileError: for what is no dataclass, and for two classes of one name, which no file could tell apart.
    """
    named: dict[str, type] = {}
    for kind in classes:
        if not _is_kind(kind):
            raise ModelFileError(f"{_shown(kind)} is no class of values in files: {_REMEDY}")
        if named.setdefault(kind.__name__, kind) is not kind:
            raise ModelFileError(
                f"two classes are called {kind.__name__}, in {named[kind.__name__].__module__} and in "
                f"{kind.__module__}: files know them by name, rename one"
            )
    return named


def restored(data: object, arrays: Mapping[str, np.ndarray], kinds: Mapping[str, type]) -> Any:
    """Build a value from what :func:`as_plain` returned; tuples may have become lists, as in JSON.

    Nothing that the data name is looked up anywhere but in ``kinds``, the classes that may be built by name.

    Raises:
        ModelFileError: if the kind is unknown, with what to do.
        FileContentError: for fields that are missing, unknown, of the wrong type, not finite, or refused by the class.
    """
    return _restored(data, arrays, kinds, 0)


def _restored(data: object, arrays: Mapping[str, np.ndarray], kinds: Mapping[str, type], depth: int) -> Any:
    """The same, for a value that sits ``depth`` levels within another."""
    if not isinstance(data, Mapping) or data.keys() != {"kind", "numbers"} or not isinstance(data["numbers"], Mapping):
        raise FileContentError(f"{_shown(data)} must have a kind and numbers")
    name, numbers = data["kind"], data["numbers"]
    if not (isinstance(name, str) and name.isidentifier()):
        raise FileContentError(f"the kind {_shown(name)} is no name of a class")
    if name not in kinds:
        raise ModelFileError(
            f"the file holds a {name[:_SHOWN]}, which is none of {', '.join(sorted(kinds)) or 'the classes given'}: "
            f"pass the class, load_model(path, known=[{name[:_SHOWN]}])"
        )
    kind, given = kinds[name], [*numbers, *arrays]
    expected = [field.name for field in dataclasses.fields(kind) if field.init]
    if sorted(map(str, given)) != sorted(expected):
        raise FileContentError(f"a {name} has the fields {expected}, and not {_shown(given)}")
    hints = _hints(kind)
    fields = {key: _unpacked(f"{key} of {name}", value, kinds, depth + 1) for key, value in numbers.items()}
    fields |= {key: _checked_array(f"{key} of {name}", value) for key, value in arrays.items()}
    for key, value in fields.items():
        if not _fits(value, hints.get(key)):
            wanted = getattr(hints[key], "__name__", hints[key])
            formula = isinstance(value, str) and hints[key] is float
            remedy = ": declare it float | str, if it may be a formula" if formula else ""
            raise FileContentError(f"{key} of {name} is {_shown(value)}, and must be a {wanted}{remedy}")
    try:
        return kind(**fields)
    except Exception as error:  # a class of a user's own may raise anything
        raise FileContentError(f"{name} refuses {_shown(fields)} with {type(error).__name__}: {error}") from error


def _taken_apart(value: object, depth: int = 0) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Kind and numbers of a value, and its arrays."""
    kind: Any = type(value)
    if not _is_kind(kind):
        raise FileContentError(f"{_shown(value)} cannot be kept: {_REMEDY}")
    fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(kind) if field.init}
    arrays = {name: field for name, field in fields.items() if type(field) is np.ndarray}
    numbers = {
        name: _packed(f"{name} of {kind.__name__}", field, depth + 1)
        for name, field in fields.items()
        if name not in arrays
    }
    arrays = {name: _checked_array(f"{name} of {kind.__name__}", array) for name, array in arrays.items()}
    return {"kind": kind.__name__, "numbers": numbers}, arrays


def _kinds_in(value: object) -> Iterator[type]:
    """Classes of a value and of all that it holds."""
    if isinstance(value, tuple):
        for item in value:
            yield from _kinds_in(item)
    kind: Any = type(value)
    if _is_kind(kind):
        yield kind
        for field in dataclasses.fields(kind):
            yield from _kinds_in(getattr(value, field.name) if field.init else None)


def _is_kind(kind: Any) -> bool:
    """Whether a class is a frozen dataclass."""
    parameters = getattr(kind, "__dataclass_params__", None)
    return isinstance(kind, type) and parameters is not None and parameters.frozen


def _checked_array(name: str, array: np.ndarray) -> np.ndarray:
    """An array that a file may hold."""
    if type(array) is not np.ndarray or array.dtype not in ARRAY_TYPES or not np.isfinite(array).all():
        kind = getattr(array, "dtype", type(array).__name__)
        raise FileContentError(f"{name} has the type {kind} or is not finite: {_REMEDY}")
    return array


def _packed(name: str, value: object, depth: int) -> Any:
    """A field as Python's own numbers, tuples, and kinds with numbers."""
    _check_depth(name, depth)
    if isinstance(value, tuple):
        return tuple(_packed(name, item, depth + 1) for item in value)
    if not _is_kind(type(value)):
        return _scalar(name, value)
    data, arrays = _taken_apart(value, depth)
    if arrays:
        raise FileContentError(f"{name} is {_shown(value)}, which holds arrays: only the outermost value may hold them")
    return data


def _unpacked(name: str, data: object, kinds: Mapping[str, type], depth: int) -> Any:
    """What :func:`_packed` was given, from what it returned."""
    _check_depth(name, depth)
    if isinstance(data, list | tuple):
        return tuple(_unpacked(name, item, kinds, depth + 1) for item in data)
    return _restored(data, {}, kinds, depth) if isinstance(data, Mapping) else _scalar(name, data)


def _check_depth(name: str, depth: int) -> None:
    """Refuse what nests too deep."""
    if depth > _DEEPEST:
        raise FileContentError(f"{name} nests more than {_DEEPEST} tuples or values")


def _scalar(name: str, value: object) -> bool | int | float | str:
    """A number, string or truth value; numbers of numpy become Python's own."""
    plain: Any = value.item() if isinstance(value, np.generic) else value
    if type(plain) in (bool, str) or (type(plain) is float and math.isfinite(plain)):
        return plain
    if type(plain) is int and abs(plain) < 2**63:
        return plain
    raise FileContentError(f"{name} is {_shown(value)}: {_REMEDY}")


def _hints(kind: type) -> dict[str, Any]:
    """Types of the fields as the class declares them; none where they cannot be told here."""
    try:
        return get_type_hints(kind)
    except Exception:  # names that are known to type checkers only
        return {}


def _fits(value: object, hint: object) -> bool:
    """Whether a field is of its declared type; what is declared in other ways is left to the class."""
    origin = get_origin(hint) or hint
    if origin in (Union, UnionType):
        return any(_fits(value, item) for item in get_args(hint))
    if origin is float:
        return type(value) in (int, float)
    if origin in (int, bool, str, np.ndarray):
        return type(value) is origin
    if origin is not tuple:
        return not _is_kind(origin) or isinstance(value, origin)  # type: ignore[arg-type]
    items = get_args(hint)
    if not isinstance(value, tuple):
        return False
    if items[1:] == (Ellipsis,):
        return all(_fits(item, items[0]) for item in value)
    alike = not items or len(items) == len(value)
    return alike and all(_fits(*pair) for pair in zip(value, items, strict=False))


def _shown(value: object) -> str:
    """Begin of a value, for messages."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # of a class of a user's own, or nested too deep
        text = f"a {type(value).__name__}"
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "..."
