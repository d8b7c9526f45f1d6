"""What files hold of local models: the parts of each model, arrays that several share once, and the choice.

Of models of one scene S, its factor, the free slack, gaps, lifts and amplitudes are the same to the last bit. Each
array lies in the file under the number of the first model that has it, ``0.bound.schur``; the header says for each
model where its arrays lie.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.files import check_layout
from hhr_dolfinx.models.choice import Choice
from hhr_dolfinx.models.local import LocalModels
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.online.layout import (
    CHOICE_LAYOUT,
    LOCAL,
    LOCAL_HISTORIES,
    LOCAL_HISTORIES_VERSION,
    LOCAL_VERSION,
    TYPES,
    VERSION,
)
from hhr_dolfinx.online.reduced_file import reduced_of, reduced_parts
from hhr_dolfinx.online.tree import put_together, taken_apart
from hhr_dolfinx.online.values import refused_if_damaged
from hhr_dolfinx.parameters import is_whole
from hhr_dolfinx.plain import by_name
from hhr_dolfinx.trained import TrainedPaths, TrainedRange

if TYPE_CHECKING:
    from hhr_dolfinx.models.local_histories import LocalHistories

TRAINED = "trained"
"""What models of histories were trained on together, in the header and as the first part of names of its arrays."""


def local_parts(local: LocalModels) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a file of models that share the box out.

    Raises:
        FileContentError, SceneError: for models that could not be read back, see :func:`reduced_parts`.
    """
    shared, arrays = _shared_parts(local.models)
    for name, (kind, *_) in CHOICE_LAYOUT.items():
        arrays[name] = np.asarray(getattr(local.choice, name.removeprefix("choice.")), dtype=TYPES[kind])
    return {"format": LOCAL, "version": LOCAL_VERSION, **shared}, arrays


def histories_parts(local: LocalHistories) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a file of models that take turns along a path; see :func:`local_parts`."""
    shared, arrays = _shared_parts(local.models)
    own: dict[str, np.ndarray] = {}
    tree = taken_apart(local.trained, TRAINED, own)
    return {"format": LOCAL_HISTORIES, "version": LOCAL_HISTORIES_VERSION, **shared, TRAINED: tree}, arrays | own


def _shared_parts(models: Sequence[ReducedModel]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of models, those that several have once."""
    headers, places = [], []
    arrays: dict[str, np.ndarray] = {}
    first: dict[tuple, int] = {}
    for number, model in enumerate(models):
        header, own = reduced_parts(model)
        place = {name: first.setdefault((name, *_content(array)), number) for name, array in own.items()}
        arrays |= {f"{number}.{name}": array for name, array in own.items() if place[name] == number}
        headers.append(header)
        places.append(place)
    return {"of": VERSION, "models": headers, "places": places}, arrays


def local_of(
    path: str | Path, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray], known: Iterable[type]
) -> LocalModels:
    """The models of a file whose parts are those of :func:`local_parts`; what they share they share in memory too.

    Args:
        path: of the file, for messages.
        header, arrays: its content.
        known: classes of a user's own amplitudes and outputs that may come out of it.

    Raises:
        ModelFileError: if it is damaged, of another version, or holds an unknown class.
    """
    with refused_if_damaged(path):
        _check_header(header, set())
        own = {name: array for name, array in arrays.items() if name in CHOICE_LAYOUT}
        choice = _choice_of(own)
        return LocalModels(_models_of(header, arrays, own, known), choice)


def local_histories_of(
    path: str | Path, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray], known: Iterable[type]
) -> LocalHistories:
    """The models of a file whose parts are those of :func:`histories_parts`; see :func:`local_of`."""
    from hhr_dolfinx.models.local_histories import LocalHistories

    with refused_if_damaged(path):
        _check_header(header, {TRAINED})
        own = {name: array for name, array in arrays.items() if name.split(".")[0] == TRAINED}
        trained = put_together(header[TRAINED], own, by_name([TrainedPaths, TrainedRange]))
        if not isinstance(trained, TrainedPaths | None):
            raise FileContentError("what its models were trained on is no set of paths")
        return LocalHistories(_models_of(header, arrays, own, known), trained)


def _models_of(
    header: Mapping[str, Any], arrays: Mapping[str, np.ndarray], own: Mapping[str, Any], known: Iterable[type]
) -> list[ReducedModel]:
    """The models of a checked header; ``own`` are arrays of the set, not of its models."""
    rest = {name: array for name, array in arrays.items() if name not in own}
    parts = [_arrays_of(number, place, rest) for number, place in enumerate(header["places"])]
    used = {f"{first}.{name}" for place in header["places"] for name, first in place.items()}
    if used != rest.keys():
        raise FileContentError(f"arrays {sorted(rest.keys() - used)[:5]} are unknown")
    return [reduced_of(*pair, known) for pair in zip(header["models"], parts, strict=True)]


def _content(array: np.ndarray) -> tuple:
    """By what an array is known to be another one again: type, shape, order in memory, and bytes."""
    whole = array if array.flags.c_contiguous or array.flags.f_contiguous else array.copy()
    order = "C" if whole.flags.c_contiguous else "F"
    return whole.dtype.str, whole.shape, order, hashlib.sha256(whole.ravel(order="K").view(np.uint8)).digest()


def _check_header(header: Mapping[str, Any], besides: set[str]) -> None:
    """Raise FileContentError for a header of no models, or of models of another version."""
    if header.keys() != {"format", "version", "of", "models", "places"} | besides:
        raise FileContentError(f"its header has the keys {sorted(header)}")
    if header["of"] != VERSION:
        raise FileContentError(f"its models are of version {repr(header['of'])[:40]}, this release reads {VERSION}")
    for what in ("models", "places"):
        if not isinstance(header[what], list) or not all(isinstance(item, dict) for item in header[what]):
            raise FileContentError(f"the {what} in its header must be a list, an entry for each model")
    if len(header["models"]) != len(header["places"]):
        raise FileContentError(f"it has {len(header['models'])} models and places of {len(header['places'])}")


def _choice_of(arrays: Mapping[str, np.ndarray]) -> Choice:
    """The choice of a file; which models and parameters there are is looked at by the set."""
    check_layout(arrays, CHOICE_LAYOUT, {})
    given = {item.name: (f"choice.{item.name}", CHOICE_LAYOUT[f"choice.{item.name}"][0]) for item in fields(Choice)}
    return Choice(**{name: arrays[key].astype(TYPES[kind], copy=False) for name, (key, kind) in given.items()})


def _arrays_of(number: int, place: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Arrays of a model by name, its own and those that lie with a model before it."""
    found = {}
    for name, first in place.items():
        key = f"{first}.{name}"
        if not is_whole(first, 0) or first > number or key not in arrays:
            raise FileContentError(f"the array {name[:60]} of model {number} is missing: {repr(first)[:40]}")
        found[name] = arrays[key]
    return found
