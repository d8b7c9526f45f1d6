"""Reduced models on disk: plain arrays and numbers with a version and a checksum, nothing to execute.

Each kind of model has a format of its own, by which its file is known: ``reduced_file``, ``local_file`` for sets of
such models, and ``varying_file`` and ``condensed_flow_file`` for condensed models, which keep all contact conditions.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hhr_dolfinx.errors import FileContentError, ModelFileError, ModelFileWarning, NotOfferedError, SceneError
from hhr_dolfinx.files import read_arrays, write_arrays
from hhr_dolfinx.online.layout import (
    CONDENSED,
    CONDENSED_FLOW,
    CONDENSED_FLOW_VERSION,
    CONDENSED_VERSION,
    FORMAT,
    LOCAL,
    LOCAL_HISTORIES,
    LOCAL_HISTORIES_VERSION,
    LOCAL_VERSION,
    VERSION,
)
from hhr_dolfinx.online.reduced_file import reduced_of, reduced_parts
from hhr_dolfinx.online.values import refused_if_damaged

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed import CondensedModel
    from hhr_dolfinx.models.condensed_flow_model import CondensedFlowModel
    from hhr_dolfinx.models.local import LocalModels
    from hhr_dolfinx.models.local_histories import LocalHistories
    from hhr_dolfinx.models.reduced import ReducedModel

    KeptModel = ReducedModel | LocalModels | LocalHistories | CondensedModel | CondensedFlowModel
    """Models that a file can hold."""

OTHERS = {
    CONDENSED: CONDENSED_VERSION,
    CONDENSED_FLOW: CONDENSED_FLOW_VERSION,
    LOCAL: LOCAL_VERSION,
    LOCAL_HISTORIES: LOCAL_HISTORIES_VERSION,
}
"""Formats of other models than single reduced ones, with their versions."""


def save_model(path: str | Path, model: KeptModel) -> None:
    """Write what build, condense or a training of local models return as one ``.npz`` file.

    An existing file is replaced only by a complete one. What needs the mesh or is code stays behind: the stress of
    elastic bodies, an indicator, the record of how the model was made. Laws and amplitudes of a user's own must be
    frozen dataclasses of numbers, see :mod:`hhr_dolfinx.plain`.

    Raises:
        NotOfferedError: for a model that needs a mesh, or what is no model.
        FileError: if the file cannot be written.
        ModelFileError: if the model itself could not be read back: numbers that are not finite, shapes that do
            not fit, laws that are no data.

    Warns:
        ModelFileWarning: if the model has an indicator.
    """
    kind = getattr(model, "file_format", None)
    if not kind:
        why = "it is no model, give what build or condense returns" if kind is None else model.instead
        raise NotOfferedError(f"a {type(model).__name__} cannot be kept in a file: {why}")
    fields = [one.fields for one in getattr(model, "models", (model,))]
    if any(one.indicator is not None for one in fields):
        why = "the indicator stays behind: answers of the model read from it have no estimate"
        warnings.warn(f"{path} holds no code, {why}", ModelFileWarning, stacklevel=2)
    try:
        _WRITERS[kind](path, model)
    except (FileContentError, SceneError) as error:
        raise ModelFileError(f"this model cannot be kept in {path}: {error}") from error


def _save_reduced(path: str | Path, model: Any) -> None:
    own, arrays = reduced_parts(model)
    write_arrays(path, {"format": FORMAT, "version": VERSION, **own}, arrays)


def _save_local(path: str | Path, model: Any) -> None:
    from hhr_dolfinx.online.local_file import local_parts

    write_arrays(path, *local_parts(model))


def _save_local_histories(path: str | Path, model: Any) -> None:
    from hhr_dolfinx.online.local_file import histories_parts

    write_arrays(path, *histories_parts(model))


def _save_condensed(path: str | Path, model: Any) -> None:
    from hhr_dolfinx.online.condensed_file import save_condensed

    save_condensed(path, model)


def _save_condensed_flow(path: str | Path, model: Any) -> None:
    from hhr_dolfinx.online.condensed_flow_file import save_condensed_flow

    save_condensed_flow(path, model)


_WRITERS = {
    "reduced": _save_reduced,
    "local": _save_local,
    "local histories": _save_local_histories,
    "condensed": _save_condensed,
    "condensed flow": _save_condensed_flow,
}
"""Writers by the ``file_format`` of models; what a kind needs is imported where it is written."""


def load_model(path: str | Path, known: Iterable[type] = ()) -> KeptModel:
    """Read a model written by :func:`save_model`. Needs, and loads, neither DOLFINx nor PETSc nor MPI.

    Args:
        path: the file.
        known: classes of a user's own laws and amplitudes that may come out of the file; none else is looked up.

    Raises:
        ModelFileError: if the file is missing, no model, of another version, or damaged, or holds an unknown class.
        MissingPackageError: for a model of bodies that flow, where what compiles their loops is missing.
    """
    if isinstance(known, type | str) or not isinstance(known, Iterable):
        raise ModelFileError(f"known = {known!r} must be a list of classes, load_model(path, known=[MyLaw])")
    try:
        header, arrays = read_arrays(path, FORMAT, VERSION, OTHERS)
    except FileNotFoundError:
        raise ModelFileError(f"there is no model file {path}") from None
    except FileContentError as error:
        raise ModelFileError(f"{error}: build the model again") from error
    if header["format"] == CONDENSED:
        from hhr_dolfinx.online.varying_file import condensed_of

        return condensed_of(path, header, arrays, known)
    if header["format"] == CONDENSED_FLOW:
        from hhr_dolfinx.online.condensed_flow_file import condensed_flow_of

        return condensed_flow_of(path, header, arrays, known)
    if header["format"] in (LOCAL, LOCAL_HISTORIES):
        from hhr_dolfinx.online.local_file import local_histories_of, local_of

        read: Any = local_of if header["format"] == LOCAL else local_histories_of
        return read(path, header, arrays, known)
    own = {name: value for name, value in header.items() if name not in ("format", "version")}
    with refused_if_damaged(path):
        return reduced_of(own, arrays, known)
