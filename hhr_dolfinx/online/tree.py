"""Frozen dataclasses within frozen dataclasses as plain data: a tree of kinds and numbers, and arrays by path.

As in :mod:`hhr_dolfinx.plain`, of which this is the nested form: whoever reads says which classes may come out, each is
given by name, and nothing that is read is looked up anywhere else or executed.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix, issparse

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.plain import ARRAY_TYPES

DEEPEST = 12
"""Levels of a tree; what is deeper is no model."""


def taken_apart(value: Any, path: str, arrays: dict[str, np.ndarray], depth: int = 0) -> Any:
    """A value as JSON can hold it; its arrays go to ``arrays`` by their paths.

    Raises:
        FileContentError: for what is no number, text, array, sparse matrix, tuple, or frozen dataclass of these.
    """
    if depth > DEEPEST:
        raise FileContentError(f"{path} is nested too deeply to be kept")
    if value is None or isinstance(value, bool | str):
        return {"value": value}
    if isinstance(value, int | float | np.integer | np.floating) and math.isfinite(value):
        return {"value": value.item() if isinstance(value, np.generic) else value}
    if isinstance(value, np.ndarray):
        if value.dtype not in ARRAY_TYPES or not np.isfinite(value).all():
            raise FileContentError(f"{path} has the type {value.dtype} or is not finite")
        arrays[path] = value
        return {"array": path, "order": "F" if value.flags.f_contiguous and not value.flags.c_contiguous else "C"}
    if issparse(value):
        entries = coo_matrix(value)
        arrays[f"{path}.rows"], arrays[f"{path}.columns"] = (
            part.astype(np.int64) for part in (entries.row, entries.col)
        )
        arrays[f"{path}.values"] = entries.data
        return {"sparse": path, "shape": list(entries.shape)}
    if isinstance(value, tuple | list):
        return {"items": [taken_apart(item, f"{path}.{k}", arrays, depth + 1) for k, item in enumerate(value)]}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {item.name: getattr(value, item.name) for item in _kept(value)}
        parts = {name: taken_apart(part, f"{path}.{name}", arrays, depth + 1) for name, part in fields.items()}
        return {"kind": type(value).__name__, "fields": parts}
    raise FileContentError(f"{path} is a {type(value).__name__}, which no file can hold")


def put_together(tree: Any, arrays: Mapping[str, np.ndarray], kinds: Mapping[str, type], depth: int = 0) -> Any:
    """The value of a tree; only classes in ``kinds`` are made.

    Raises:
        FileContentError: for a tree that is none, arrays that are missing, or fields that a class refuses.
    """
    if not isinstance(tree, dict) or depth > DEEPEST:
        raise FileContentError("a part of the file is no tree of values")
    if tree.keys() == {"value"}:
        if not isinstance(tree["value"], bool | int | float | str | None):
            raise FileContentError("a value of the file is no number and no text")
        return tree["value"]
    if tree.keys() == {"array", "order"}:
        array = _array(arrays, tree["array"])
        return np.asfortranarray(array) if tree["order"] == "F" else np.ascontiguousarray(array)
    if tree.keys() == {"sparse", "shape"}:
        return _sparse(tree, arrays)
    if tree.keys() == {"items"} and isinstance(tree["items"], list):
        return tuple(put_together(item, arrays, kinds, depth + 1) for item in tree["items"])
    if tree.keys() != {"kind", "fields"} or tree["kind"] not in kinds or not isinstance(tree["fields"], dict):
        raise FileContentError(
            f"a part of the file is of the kind {str(tree.get('kind'))[:40]!r}, which is unknown here"
        )
    kind = kinds[tree["kind"]]
    expected = {item.name for item in _kept(kind)}
    if tree["fields"].keys() != expected:
        raise FileContentError(f"a {tree['kind']} has the fields {sorted(expected)}, not {sorted(tree['fields'])[:20]}")
    parts = {name: put_together(part, arrays, kinds, depth + 1) for name, part in tree["fields"].items()}
    try:
        return kind(**parts)
    except (TypeError, ValueError, KeyError, IndexError) as error:
        raise FileContentError(f"a {tree['kind']} refuses what the file says of it: {error}") from error


def _kept(kind: Any) -> list[dataclasses.Field]:
    """Fields that a file keeps: those that make a value, but for code."""
    return [item for item in dataclasses.fields(kind) if item.init and item.metadata.get("kept", True)]


def _array(arrays: Mapping[str, np.ndarray], path: Any) -> np.ndarray:
    if not isinstance(path, str) or path not in arrays:
        raise FileContentError(f"the array {str(path)[:60]!r} is missing")
    return arrays[path]


def _sparse(tree: dict, arrays: Mapping[str, np.ndarray]) -> csc_matrix:
    rows, columns, values = (_array(arrays, f"{tree['sparse']}.{name}") for name in ("rows", "columns", "values"))
    shape = tree["shape"]
    if not isinstance(shape, list) or len(shape) != 2 or not all(type(n) is int and n >= 0 for n in shape):
        raise FileContentError("a sparse matrix of the file has no shape")
    inside = all(
        not part.size or (part.min() >= 0 and part.max() < n) for part, n in zip((rows, columns), shape, strict=True)
    )
    if not inside or not len(rows) == len(columns) == len(values):
        raise FileContentError("a sparse matrix of the file has entries outside of it")
    return csc_matrix(coo_matrix((values, (rows, columns)), shape=shape))
